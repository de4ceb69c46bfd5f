// The narrow phase: closest or deepest points of convex pieces, from coal (GJK and EPA).
//
// certified_distance.py lists coal's traps. Every query is a function of its arguments alone.
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
  int64_t winner = -1, num_queries = 0;
  bool failed = false;
};

// The piece pairs and the tolerances of their queries.
struct NarrowPhase {
  std::vector<PiecePair> pairs;
  Tolerances tolerances;

  // Query entries, bounds ascending, until no bound is below the best distance; answers have to be below
  // `found.distance` and `limit`. Null: no guess.
  void query(const Entry* entry, const Entry* end, const Transform3s& T, double limit, const Vec3s* guess,
             Found& found) const {
    CertifiedQuery& query = certified_query();
    double best = std::min(found.distance, limit);
    for (; entry != end && entry->bound < best; ++entry) {
      ++found.num_queries;
      const PiecePair& pair = pairs[entry->pair];
      const Vec3s start = guess ? Vec3s(*guess / pair.unit) : Vec3s();
      const double d =
          pair.unit * query.distance(pair, in_unit(T, pair), entry->bound / pair.unit, guess ? &start : nullptr);
      if (std::isnan(d)) {
        found.failed = true;
      } else if (d < best) {
        best = found.distance = d;
        found.point = pair.unit * query.point;
        found.normal = query.normal;
        found.winner = entry->pair;
      }
    }
  }

  // Coal's unchecked distance of a piece pair, in metres.
  double distance(int64_t index, const Transform3s& T) const {
    const PiecePair& pair = pairs[index];
    return pair.unit * certified_query().query_pieces(pair, in_unit(T, pair), nullptr);
  }

 private:
  static Transform3s in_unit(const Transform3s& T, const PiecePair& pair) {
    return Transform3s(T.getRotation(), T.getTranslation() / pair.unit);
  }

  // The query object of this thread; its solver keeps its allocated memory.
  CertifiedQuery& certified_query() const {
    thread_local CertifiedQuery query;
    query.set(tolerances);
    return query;
  }
};

}  // namespace grasp_refine
