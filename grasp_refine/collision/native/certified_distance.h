// Certified distance queries of two convex pieces with coal: certified_distance.py, where they are explained, in C++.
#pragma once

#include <coal/distance_func_matrix.h>
#include <coal/narrowphase/narrowphase.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>

namespace grasp_refine {

using coal::Matrix3s;
using coal::Transform3s;
using coal::Vec3s;

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kMaxDistance = 1e300;  // Largest absolute distance that counts as an answer.

// As in certified_distance.py, in units of the pieces.
constexpr double kGapTolerance = 1e-10, kRoundingTolerance = 1e-15, kContactDistance = 4e-9, kMinLength = 1e-12, kUnitTolerance = 1e-6;
constexpr double kSideOffset = 0.25, kFineEpaTolerance = 1e-10;
constexpr double kQueryGaps[] = {0.25, 1.0 / 16384}, kStepLengths[] = {1, 8, 64, 512};
constexpr int kMaxIterations = 32, kEpaIterations = 256;
constexpr int kFewEpaIterations = 32;  // Mostly enough; EPA first clears memory for all that it is allowed.

struct Tolerances {
  double gjk, epa, retry, slack;
};

// A piece: all points within `radius` of the hull of its vertices, in the frame of the body.
struct Core {
  Eigen::Matrix<double, Eigen::Dynamic, 3> vertices;
  double radius = 0;
  Vec3s center = Vec3s::Zero();  // Centre of the vertices' bounding box.

  // u . x of the vertices.
  auto along(const Vec3s& u) const {
    return u[0] * vertices.col(0).array() + u[1] * vertices.col(1).array() + u[2] * vertices.col(2).array();
  }
};

// Coal's shape of a convex piece, in a unit of length of its own.
struct Shape {
  std::unique_ptr<coal::ShapeBase> geometry;
  Transform3s placement;  // Pose in the frame of the body.
  bool placed = false;    // False: the placement is the identity.
  Core core;
};

// A pair of pieces, in a unit of length of its own.
struct PiecePair {
  std::shared_ptr<Shape> a, b;
  double unit;  // Unit of length, in metres.

  // The gap min u . y - max u . x, at most the signed distance for any unit vector u.
  double gap(const Transform3s& T, const Vec3s& u) const {
    const Matrix3s& R = T.getRotation();
    Vec3s v;
    for (int k = 0; k < 3; ++k) v[k] = u[0] * R(0, k) + u[1] * R(1, k) + u[2] * R(2, k);
    return dot(u, T.getTranslation()) + (b->core.along(v).minCoeff() - b->core.radius) -
           (a->core.along(u).maxCoeff() + a->core.radius);
  }

  // From the centre of a to that of b.
  Vec3s between(const Transform3s& T) const {
    const Matrix3s& R = T.getRotation();
    const Vec3s &x = a->core.center, &y = b->core.center;
    Vec3s m;
    for (int k = 0; k < 3; ++k)
      m[k] = R(k, 0) * y[0] + R(k, 1) * y[1] + R(k, 2) * y[2] + T.getTranslation()[k] - x[k];
    return m;
  }

  // A vector perpendicular to the axes of two capsules; zero for other pieces.
  Vec3s across(const Transform3s& T) const {
    const auto &x = a->core.vertices, &y = b->core.vertices;
    if (x.rows() != 2 || y.rows() != 2) return Vec3s::Zero();
    const Matrix3s& R = T.getRotation();
    const Vec3s u = x.row(1) - x.row(0), w = y.row(1) - y.row(0);
    Vec3s v;
    for (int k = 0; k < 3; ++k) v[k] = R(k, 0) * w[0] + R(k, 1) * w[1] + R(k, 2) * w[2];
    return Vec3s(u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]);
  }

  static double dot(const Vec3s& u, const Vec3s& v) { return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]; }
};

// Distance queries of one thread; each is independent of the queries before it.
class CertifiedQuery {
 public:
  Vec3s point, normal;  // Last answer: witness point on a, in the unit of the pieces, and normal; in the frame of a.

  void set(const Tolerances& tolerances) {
    tolerances_ = tolerances;
    prepare(tight_, tolerances.gjk, tolerances.epa);
    prepare(fine_, tolerances.gjk, kFineEpaTolerance);
    prepare(loose_, tolerances.retry, tolerances.retry);
  }

  // The signed distance in the unit of the pieces, at least `bound`; NaN if no answer is usable. Null: no guess.
  double distance(const PiecePair& pair, const Transform3s& T, double bound, const Vec3s* guess) {
    // An answer is limited even without a bound.
    const double floor = std::max(bound - tolerances_.slack, -kMaxDistance);
    const auto usable = [floor](double d) { return floor <= d && d < kMaxDistance; };
    double d = query_pieces(pair, T, guess);
    if (!usable(d)) d = query_pieces(pair, T, loose_, no_guess());
    if (!usable(d)) d = kNaN;
    if (std::abs(d) > kContactDistance && is_certified(pair, T, d)) return d;
    d = resolve(pair, T, d);
    return d >= floor ? d : kNaN;
  }

  // Coal's unchecked answer.
  double query_pieces(const PiecePair& pair, const Transform3s& T, const Vec3s* guess) {
    return query_pieces(pair, T, tight_, guess ? *guess : no_guess());
  }

 private:
  // End of an ascent along the normal.
  struct Ascent {
    double gap;
    Vec3s normal, point = Vec3s::Zero();
    bool closed = false;    // True: GJK's distance there equals the gap.
    bool answered = false;  // True: GJK gave an answer.
  };

  static void prepare(coal::DistanceRequest& request, double gjk, double epa) {
    request.gjk_tolerance = gjk;
    request.epa_tolerance = epa;
    // Without a cached guess a request would start from the solver's last state.
    request.gjk_initial_guess = coal::GJKInitialGuess::CachedGuess;
  }

  // The gap along coal's normal is d.
  bool is_certified(const PiecePair& pair, const Transform3s& T, double d) const {
    return std::abs(d - pair.gap(T, normal)) <= kGapTolerance && has_normal();
  }

  // Coal's normal is zero where the axes of capsules meet.
  bool has_normal() const { return std::abs(PiecePair::dot(normal, normal) - 1) <= kUnitTolerance; }

  static Vec3s no_guess() { return Vec3s(1, 0, 0); }

  double query_pieces(const PiecePair& pair, const Transform3s& T, coal::DistanceRequest& request, const Vec3s& guess) {
    static const coal::DistanceFunctionMatrix table;
    const Shape &a = *pair.a, &b = *pair.b;
    const auto function = table.distance_matrix[a.geometry->getNodeType()][b.geometry->getNodeType()];
    const Transform3s placement = b.placed ? T * b.placement : T;
    double d;
    for (const int iterations : {kFewEpaIterations, kEpaIterations}) {
      request.epa_max_iterations = iterations;
      request.cached_gjk_guess = guess;
      request.cached_support_func_guess.setZero();
      solver_.set(request);
      result_.clear();
      d = function(a.geometry.get(), a.placement, b.geometry.get(), placement, &solver_, request, result_);
      // Any other end may be for want of iterations.
      using Status = coal::details::EPA::Status;
      if (solver_.epa.status == Status::DidNotRun || solver_.epa.status == Status::AccuracyReached) break;
    }
    point = result_.nearest_points[0], normal = result_.normal;
    return d;
  }

  // The largest gap found, where coal's distance d (NaN: none) is not certified.
  double resolve(const PiecePair& pair, const Transform3s& T, double d) {
    const double close = 0.5 * tolerances_.gjk * (1 + std::abs(d));
    Vec3s starts[10];
    int count = starting_directions(pair, T, starts);
    // In contact, coal's normal is mostly right but for rounding: then the smaller move is enough.
    Ascent best = ascend_separation(pair, T, starts[0], std::abs(d) <= kContactDistance);
    // Otherwise there may be a larger gap in another direction.
    const auto sure = [&] {
      return best.closed && (std::abs(d - best.gap) <= close || (std::isnan(d) && best.gap > 0));
    };
    if (std::abs(d) <= kContactDistance && !sure()) best = ascend_separation(pair, T, starts[0]);
    if (d <= kContactDistance && !sure()) {
      query_pieces(pair, T, fine_, no_guess());
      if (has_normal()) {
        std::copy_backward(starts + 1, starts + count, starts + count + 1);
        starts[1] = normal, ++count;
      }
    }
    for (int k = 1; k < count + 6 && !sure(); ++k) {
      const Vec3s u = k < count ? starts[k] : Vec3s(normalized(best.normal + kSideOffset * axis(k - count)));
      const Ascent found = ascend_separation(pair, T, u);
      if (found.gap > best.gap) best = found;
    }
    if (!best.answered || (std::isnan(d) && !best.closed)) return kNaN;
    point = best.point, normal = best.normal;
    return best.gap;
  }

  // Starting directions: coal's normal, across two capsules, the line between the centres, and the axes; returns their
  // number.
  int starting_directions(const PiecePair& pair, const Transform3s& T, Vec3s* out) const {
    int count = 0;
    if (has_normal()) out[count++] = normal;
    for (const Vec3s& u : {pair.across(T), pair.between(T)})
      if (PiecePair::dot(u, u) > kMinLength * kMinLength) out[count++] = normalized(u);
    for (int k = 0; k < 6; ++k) out[count++] = axis(k);
    return count;
  }

  // One of the six directions along axes.
  static Vec3s axis(int k) { return (k % 2 ? -1.0 : 1.0) * Vec3s::Unit(k / 2); }

  static Vec3s normalized(const Vec3s& u) { return u / std::sqrt(PiecePair::dot(u, u)); }

  // Follow the normal from a starting direction until the gap stops growing; `near`: at the smaller move alone, closed
  // only up to rounding.
  Ascent ascend_separation(const PiecePair& pair, const Transform3s& T, const Vec3s& start, bool near = false) {
    Ascent found{pair.gap(T, start), start};
    for (const double apart : kQueryGaps) {
      if (near && apart != kQueryGaps[1]) continue;
      for (int iteration = 0; iteration < kMaxIterations; ++iteration) {
        const Vec3s u = found.normal;
        const double move = apart - found.gap;
        const Transform3s moved(T.getRotation(), T.getTranslation() + move * u);
        const double d = query_pieces(pair, moved, tight_, -apart * u);
        if (!(0 < d && d < kMaxDistance)) break;
        found.point = point, found.answered = true;
        found.closed = std::abs(d - move - found.gap) <= (near ? kRoundingTolerance : kGapTolerance);
        Vec3s n = normal;
        double gap = pair.gap(T, n);
        if (found.gap > 1) {
          // Far apart, a small turn has a large effect: the turn to the line between the points counts.
          const Vec3s turn = normalized(d * n - move * u) - u;
          for (const double step : kStepLengths) {
            const Vec3s w = normalized(u + step * turn);
            const double along = pair.gap(T, w);
            if (along > gap) n = w, gap = along;
          }
        }
        if (!(gap > found.gap + 1e-14)) break;
        found.gap = gap, found.normal = n;
      }
    }
    return found;
  }

  coal::GJKSolver solver_;
  coal::DistanceRequest tight_, fine_, loose_;
  coal::DistanceResult result_;
  Tolerances tolerances_{};
};

}  // namespace grasp_refine
