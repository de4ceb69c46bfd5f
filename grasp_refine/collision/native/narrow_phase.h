// The narrow phase of narrowphase.py, without Python: closest or deepest points of convex pieces, asked from coal.
//
// What is said there about coal's traps holds here, too. Every query is a function of its arguments alone.
#pragma once

#include <coal/distance_func_matrix.h>
#include <coal/shape/convex.h>
#include <coal/shape/geometric_shapes.h>

#include <algorithm>
#include <cstdint>
#include <limits>
#include <memory>
#include <utility>
#include <vector>

namespace grasp_refine {

using coal::Matrix3s;
using coal::Transform3s;
using coal::Vec3s;

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kWild = 1e300;  // A distance beyond this, either way, is no answer.

struct Tolerances {
  double gjk, epa, retry, slack;
};

// A convex piece as coal sees it.
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
    prepare(tight_, tolerances.gjk, tolerances.epa);
    prepare(loose_, tolerances.retry, tolerances.retry);
    slack_ = tolerances.slack;
  }

  // Ask entries, bounds ascending, until no bound is below the best distance; that has to beat `found.distance`
  // and `limit`. A null guess is none.
  template <class Pairs>
  void ask(const Pairs& pairs, const Entry* entry, const Entry* end, const Transform3s& T, double limit,
           const Vec3s* guess, Found& found) {
    double best = std::min(found.distance, limit);
    for (; entry != end && entry->bound < best; ++entry) {
      ++found.asked;
      const Shape &a = *pairs[entry->pair].first, &b = *pairs[entry->pair].second;
      const double floor = std::max(entry->bound - slack_, -kWild);
      double d = distance(a, b, T, tight_, guess);
      if (!(floor <= d && d < kWild)) d = distance(a, b, T, loose_, nullptr);
      if (!(floor <= d && d < kWild)) {
        found.failed = true;
      } else if (d < best) {
        best = found.distance = d;
        found.point = result_.nearest_points[0];
        found.normal = result_.normal;
        found.winner = entry->pair;
      }
    }
  }

  double distance(const Shape& a, const Shape& b, const Transform3s& T, const Vec3s* guess) {
    return distance(a, b, T, tight_, guess);
  }

 private:
  static void prepare(coal::DistanceRequest& request, double gjk, double epa) {
    request.gjk_tolerance = gjk;
    request.epa_tolerance = epa;
    // Without a guess of its own a request starts from where the solver was last.
    request.gjk_initial_guess = coal::GJKInitialGuess::CachedGuess;
  }

  double distance(const Shape& a, const Shape& b, const Transform3s& T, coal::DistanceRequest& request,
                  const Vec3s* guess) {
    static const coal::DistanceFunctionMatrix table;
    request.cached_gjk_guess = guess ? *guess : Vec3s(1, 0, 0);
    request.cached_support_func_guess.setZero();
    solver_.set(request);
    result_.clear();
    const auto function = table.distance_matrix[a.geometry->getNodeType()][b.geometry->getNodeType()];
    return function(a.geometry.get(), a.placement, b.geometry.get(), b.placed ? T * b.placement : T, &solver_,
                    request, result_);
  }

  coal::GJKSolver solver_;
  coal::DistanceRequest tight_, loose_;
  coal::DistanceResult result_;
  double slack_ = 0;
};

// The piece pairs that are asked, and how.
struct NarrowPhase {
  std::vector<std::pair<std::shared_ptr<Shape>, std::shared_ptr<Shape>>> pairs;
  Tolerances tolerances;

  // The one of this thread; its solver keeps the memory that it once took.
  Asker& asker() const {
    thread_local Asker mine;
    mine.set(tolerances);
    return mine;
  }
};

}  // namespace grasp_refine
