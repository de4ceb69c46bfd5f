// The narrow phase of narrowphase.py, without Python: closest or deepest points of convex pieces.
//
// What is said there about coal's traps holds here, too. Every query is a function of its arguments alone.
#pragma once

#include <coal/shape/convex.h>
#include <coal/shape/geometric_shapes.h>

#include <cstdint>
#include <utility>
#include <vector>

#include "certified_distance.h"

namespace grasp_refine {

inline std::shared_ptr<std::vector<Vec3s>> points_of(const double* xyz, size_t count) {
  auto points = std::make_shared<std::vector<Vec3s>>(count);
  for (size_t i = 0; i < count; ++i) (*points)[i] = Eigen::Map<const Vec3s>(xyz + 3 * i);
  return points;
}

inline Shape sphere(double radius, const Vec3s& center) {
  return {std::make_unique<coal::Sphere>(radius), Transform3s(Matrix3s::Identity(), center), true, {}};
}

inline Shape capsule(double radius, double length, const Matrix3s& frame, const Vec3s& center) {
  return {std::make_unique<coal::Capsule>(radius, length), Transform3s(frame, center), true, {}};
}

inline Shape swept(coal::ShapeBase* geometry, double radius) {
  Shape shape{std::unique_ptr<coal::ShapeBase>(geometry), Transform3s(), false, {}};
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

// The piece pairs that are asked, and how.
struct NarrowPhase {
  std::vector<PiecePair> pairs;
  Tolerances tolerances;

  // Ask entries, bounds ascending, until no bound is below the best distance; that has to beat `found.distance`
  // and `limit`. A null guess is none.
  void ask(const Entry* entry, const Entry* end, const Transform3s& T, double limit, const Vec3s* guess,
           Found& found) const {
    Asker& asker = this->asker();
    double best = std::min(found.distance, limit);
    for (; entry != end && entry->bound < best; ++entry) {
      ++found.asked;
      const PiecePair& pair = pairs[entry->pair];
      const Vec3s start = guess ? Vec3s(*guess / pair.unit) : Vec3s();
      const double d =
          pair.unit * asker.distance(pair, in_unit(T, pair), entry->bound / pair.unit, guess ? &start : nullptr);
      if (std::isnan(d)) {
        found.failed = true;
      } else if (d < best) {
        best = found.distance = d;
        found.point = pair.unit * asker.point;
        found.normal = asker.normal;
        found.winner = entry->pair;
      }
    }
  }

  // What coal says of a piece pair, in metres.
  double distance(int64_t index, const Transform3s& T, const Vec3s* guess) const {
    const PiecePair& pair = pairs[index];
    const Vec3s start = guess ? Vec3s(*guess / pair.unit) : Vec3s();
    return pair.unit * asker().ask(pair, in_unit(T, pair), guess ? &start : nullptr);
  }

 private:
  static Transform3s in_unit(const Transform3s& T, const PiecePair& pair) {
    return Transform3s(T.getRotation(), T.getTranslation() / pair.unit);
  }

  // The one of this thread; its solver keeps the memory that it once took.
  Asker& asker() const {
    thread_local Asker mine;
    mine.set(tolerances);
    return mine;
  }
};

}  // namespace grasp_refine
