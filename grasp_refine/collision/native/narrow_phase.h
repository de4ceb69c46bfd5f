// The narrow phase of narrowphase.py, without Python: closest or deepest points of convex pieces, asked from coal.
//
// What is said there about coal's traps holds here, too. Every query is a function of its arguments alone.
#pragma once

#include <coal/distance_func_matrix.h>
#include <coal/shape/convex.h>
#include <coal/shape/geometric_shapes.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <memory>
#include <vector>

namespace grasp_refine {

using coal::Matrix3s;
using coal::Transform3s;
using coal::Vec3s;

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kWild = 1e300;  // A distance beyond this, either way, is no answer.
constexpr double kDistant = 2.0; // Beyond this one, in units of the pieces, GJK is asked again.

struct Tolerances {
  double gjk, epa, retry, slack;
};

// A convex piece as coal sees it, in a unit of length of its own.
struct Shape {
  std::unique_ptr<coal::ShapeBase> geometry;
  Transform3s placement;  // In the frame of the body.
  bool placed = false;    // Whether that is more than the identity.
};

inline std::shared_ptr<std::vector<Vec3s>> points_of(const double* xyz, size_t count) {
  auto points = std::make_shared<std::vector<Vec3s>>(count);
  for (size_t i = 0; i < count; ++i) (*points)[i] = Eigen::Map<const Vec3s>(xyz + 3 * i);
  return points;
}

inline Shape sphere(double radius, const Vec3s& center) {
  return {std::make_unique<coal::Sphere>(radius), Transform3s(Matrix3s::Identity(), center), true};
}

inline Shape capsule(double radius, double length, const Matrix3s& frame, const Vec3s& center) {
  return {std::make_unique<coal::Capsule>(radius, length), Transform3s(frame, center), true};
}

inline Shape swept(coal::ShapeBase* geometry, double radius) {
  Shape shape{std::unique_ptr<coal::ShapeBase>(geometry), Transform3s(), false};
  if (radius > 0) shape.geometry->setSweptSphereRadius(radius);
  return shape;
}

inline Shape hull(std::shared_ptr<std::vector<Vec3s>> points, double radius) {
  const auto count = static_cast<unsigned>(points->size());
  return swept(coal::ConvexBase::convexHull(points, count, true, "Qt"), radius);
}

inline Shape polytope(std::shared_ptr<std::vector<Vec3s>> points,
                      std::shared_ptr<std::vector<coal::Triangle>> triangles, double radius) {
  const auto vertices = static_cast<unsigned>(points->size()), faces = static_cast<unsigned>(triangles->size());
  return swept(new coal::Convex<coal::Triangle>(std::move(points), vertices, std::move(triangles), faces), radius);
}

// Two pieces that are asked together.
struct PiecePair {
  std::shared_ptr<Shape> a, b;
  double unit;  // Of length, in metres.
};

// One piece pair and a lower bound of its signed distance.
struct Entry {
  double bound;
  int64_t pair;
};

// The closest piece pair so far.
struct Found {
  double distance = kInfinity;
  Vec3s point = Vec3s::Zero(), normal = Vec3s::Zero();  // In the frame of body a; the point is on a.
  int64_t winner = -1, asked = 0;
  bool failed = false;
};

// What one thread writes to; of two queries the second does not see what the first one left.
class Asker {
 public:
  void set(const Tolerances& tolerances) {
    tolerances_ = tolerances;
    prepare(tight_, tolerances.gjk, tolerances.epa);
    prepare(far_, tolerances.gjk, tolerances.epa);
    prepare(loose_, tolerances.retry, tolerances.retry);
  }

  // Ask entries, bounds ascending, until no bound is below the best distance; that has to beat `found.distance`
  // and `limit`. A null guess is none.
  void ask(const std::vector<PiecePair>& pairs, const Entry* entry, const Entry* end, const Transform3s& T,
           double limit, const Vec3s* guess, Found& found) {
    double best = std::min(found.distance, limit);
    for (; entry != end && entry->bound < best; ++entry) {
      ++found.asked;
      const PiecePair& pair = pairs[entry->pair];
      const double d = pair.unit * distance(pair, in_unit(T, pair), entry->bound / pair.unit, start(pair, guess));
      if (std::isnan(d)) {
        found.failed = true;
      } else if (d < best) {
        best = found.distance = d;
        found.point = pair.unit * result_.nearest_points[0];
        found.normal = result_.normal;
        found.winner = entry->pair;
      }
    }
  }

  // The signed distance of two pieces in metres, whatever it is.
  double distance(const PiecePair& pair, const Transform3s& T, const Vec3s* guess) {
    return pair.unit * ask(pair, in_unit(T, pair), tight_, start(pair, guess));
  }

 private:
  static void prepare(coal::DistanceRequest& request, double gjk, double epa) {
    request.gjk_tolerance = gjk;
    request.epa_tolerance = epa;
    // Without a guess of its own a request starts from where the solver was last.
    request.gjk_initial_guess = coal::GJKInitialGuess::CachedGuess;
  }

  static Transform3s in_unit(const Transform3s& T, const PiecePair& pair) {
    return Transform3s(T.getRotation(), T.getTranslation() / pair.unit);
  }

  static Vec3s start(const PiecePair& pair, const Vec3s* guess) {
    return guess ? Vec3s(*guess / pair.unit) : no_guess();
  }

  static Vec3s no_guess() { return Vec3s(1, 0, 0); }

  // The signed distance of two pieces in their unit, at least `bound`; NaN if no answer is usable.
  double distance(const PiecePair& pair, const Transform3s& T, double bound, const Vec3s& guess) {
    const double floor = std::max(bound - tolerances_.slack, -kWild), gjk = tolerances_.gjk;
    const auto usable = [floor](double d) { return floor <= d && d < kWild; };
    const double d = ask(pair, T, tight_, guess);
    if (!usable(d)) {
      const double again = ask(pair, T, loose_, no_guess());
      return usable(again) ? again : std::numeric_limits<double>::quiet_NaN();
    }
    if (d <= kDistant) return d;
    far_.gjk_tolerance = gjk / (1 + d);
    const double closer = ask(pair, T, far_, -d * result_.normal);
    // Too tight a tolerance may have no answer.
    return d - 2 * gjk * (1 + d) <= closer && closer <= d ? closer : ask(pair, T, tight_, guess);
  }

  double ask(const PiecePair& pair, const Transform3s& T, coal::DistanceRequest& request, const Vec3s& guess) {
    static const coal::DistanceFunctionMatrix table;
    const Shape &a = *pair.a, &b = *pair.b;
    request.cached_gjk_guess = guess;
    request.cached_support_func_guess.setZero();
    solver_.set(request);
    result_.clear();
    const auto function = table.distance_matrix[a.geometry->getNodeType()][b.geometry->getNodeType()];
    return function(a.geometry.get(), a.placement, b.geometry.get(), b.placed ? T * b.placement : T, &solver_,
                    request, result_);
  }

  coal::GJKSolver solver_;
  coal::DistanceRequest tight_, far_, loose_;
  coal::DistanceResult result_;
  Tolerances tolerances_{};
};

// The piece pairs that are asked, and how.
struct NarrowPhase {
  std::vector<PiecePair> pairs;
  Tolerances tolerances;

  // The one of this thread; its solver keeps the memory that it once took.
  Asker& asker() const {
    thread_local Asker mine;
    mine.set(tolerances);
    return mine;
  }
};

}  // namespace grasp_refine
