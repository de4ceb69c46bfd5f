// Patches where flat faces of a link meet flat faces of the object: their corners, gaps, and how these move.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

namespace grasp_refine {

// Flat faces of bodies, as in `geometry.facets.Facets`; those of body b are first_face[b] to first_face[b + 1].
struct FaceTable {
  const int64_t* first_face;
  const double* normal;            // (F, 3)
  const double* offset;            // (F,)
  const int64_t* first_polygon;    // (F + 1,)
  const int64_t* first_vertex;     // (Q + 1,)
  const double* vertices;          // (V, 3)
};

struct PatchLimits {
  double cos_tilt;    // Least cosine of the angle between two faces, and between a face and the contact normal.
  double near;        // Largest distance of a witness point from the plane of its face.
  double min_extent;  // Least extent of a patch.
  double min_width;   // Width below which a patch is a segment.
};

// The patch of one contact.
struct Patch {
  static constexpr int kMost = 4;
  int count = 0;
  Eigen::Vector3d normal;                                // Outward normal of the object's face.
  double cosine, extent;                                 // Of the angle between the faces; largest distance of corners.
  Eigen::Vector3d point[kMost];                          // Corners on the object's face.
  double gap[kMost];                                     // Distance of the link's face from there along the normal.
  Eigen::Matrix<double, 3, 6, Eigen::RowMajor> motion[kMost];  // Derivative of the points in the link's twist.
  Eigen::Matrix<double, 1, 6> slope[kMost];              // Derivative of the gaps.
};

class PatchFinder {
 public:
  // Patch of a link (face table, body, pose) and an object (face table, body), which rests at the origin, about
  // witness points.
  void find(const FaceTable& of_link, size_t link, const Eigen::Matrix4d& T, const FaceTable& of_object,
            size_t object, const Eigen::Vector3d& x_link, const Eigen::Vector3d& x_object, const Eigen::Vector3d& n,
            const PatchLimits& limits, Patch& out) {
    using namespace Eigen;
    out.count = 0;
    const Matrix3d R = T.topLeftCorner<3, 3>();
    const Vector3d t = T.topRightCorner<3, 1>();
    const Vector3d local = R.transpose() * (x_link - t), n_local = R.transpose() * n;
    candidates(of_link, link, local, n_local, limits, link_faces);
    if (link_faces.empty()) return;
    candidates(of_object, object, x_object, -n, limits, object_faces);
    if (object_faces.empty()) return;
    double best = limits.cos_tilt;
    int64_t f = -1, g = -1;
    for (const int64_t i : link_faces) {
      const Vector3d n_a = R * vector(of_link.normal, i);
      for (const int64_t j : object_faces) {
        const double cosine = -n_a.dot(vector(of_object.normal, j));
        if (cosine > best) best = cosine, f = i, g = j;
      }
    }
    if (f < 0) return;
    // The plane of the object's face, with coordinates about the witness point.
    const Vector3d n_b = vector(of_object.normal, g), n_a = R * vector(of_link.normal, f);
    const double offset_a = of_link.offset[f] + n_a.dot(t);
    const Vector3d origin = x_object + (of_object.offset[g] - n_b.dot(x_object)) * n_b;
    // As `se3.tangents`.
    const double sign = n_b.z() < 0 ? -1.0 : 1.0, a = -1.0 / (sign + n_b.z()), b = n_b.x() * n_b.y() * a;
    Matrix<double, 3, 2> E;
    E << 1.0 + sign * n_b.x() * n_b.x() * a, b, sign * b, sign + n_b.y() * n_b.y() * a, -sign * n_b.x(), -n_b.y();

    corners.clear();
    for (int64_t p = of_link.first_polygon[f]; p < of_link.first_polygon[f + 1]; ++p) {
      shape.clear();
      // Seen along the object's normal, the link's polygon is clockwise.
      for (int64_t v = of_link.first_vertex[p + 1]; v-- > of_link.first_vertex[p];)
        shape.push_back({E.transpose() * (R * vector(of_link.vertices, v) + t - origin), {}, true});
      for (size_t k = 0; k < shape.size(); ++k) shape[k].across = across(shape[k].at, shape[(k + 1) % shape.size()].at);
      for (int64_t q = of_object.first_polygon[g]; q < of_object.first_polygon[g + 1]; ++q) {
        clipped = shape;
        const int64_t begin = of_object.first_vertex[q], end = of_object.first_vertex[q + 1];
        Vector2d from = E.transpose() * (vector(of_object.vertices, end - 1) - origin);
        for (int64_t v = begin; v < end && !clipped.empty(); ++v) {
          const Vector2d to = E.transpose() * (vector(of_object.vertices, v) - origin);
          clip(from, across(from, to));
          from = to;
        }
        for (size_t k = 0; k < clipped.size(); ++k) {
          const Edge& last = clipped[(k + clipped.size() - 1) % clipped.size()];
          corners.push_back({clipped[k].at, {last.across, clipped[k].across}, {last.of_link, clipped[k].of_link}});
        }
      }
    }
    choose(limits, out);
    out.normal = n_b, out.cosine = best;
    for (int k = 0; k < out.count; ++k) {
      const Corner& corner = corners[chosen[k]];
      const Vector3d x = origin + E * corner.at;
      const double along = n_a.dot(n_b), gap = (offset_a - n_a.dot(x)) / along;
      const Vector3d on_link = x + gap * n_b;
      Matrix<double, 3, 6> velocity;
      velocity << Matrix3d::Identity(), -hat(on_link);
      const Matrix<double, 2, 6> slide = E.transpose() * velocity;
      Matrix2d m;
      Matrix<double, 2, 6> moved = Matrix<double, 2, 6>::Zero();
      for (int side = 0; side < 2; ++side) {
        m.row(side) = corner.across[side].transpose();
        if (corner.of_link[side]) moved.row(side) = corner.across[side].transpose() * slide;
      }
      const double determinant = m(0, 0) * m(1, 1) - m(0, 1) * m(1, 0);
      Matrix<double, 2, 6> du;
      if (std::abs(determinant) > kParallel)
        du = (Matrix2d() << m(1, 1), -m(0, 1), -m(1, 0), m(0, 0)).finished() * moved / determinant;
      else if (corner.of_link[0] || corner.of_link[1])
        du = slide;
      else
        du.setZero();
      out.point[k] = x, out.gap[k] = gap;
      out.motion[k] = E * du;
      out.slope[k] = (n_a.transpose() * velocity - (n_a.transpose() * E) * du) / along;
    }
  }

 private:
  static constexpr double kParallel = 1e-6;  // Sine of the angle between edges that count as parallel.

  // A corner of a polygon with the outward normal of the edge that follows.
  struct Edge {
    Eigen::Vector2d at, across;
    bool of_link;
  };
  struct Corner {
    Eigen::Vector2d at, across[2];
    bool of_link[2];
  };
  std::vector<int64_t> link_faces, object_faces;
  std::vector<Edge> shape, clipped, next;
  std::vector<Corner> corners;
  std::vector<size_t> hull;
  std::vector<double> side;
  size_t chosen[Patch::kMost];

  static Eigen::Vector3d vector(const double* array, int64_t i) { return Eigen::Vector3d(array + 3 * i); }

  static Eigen::Matrix3d hat(const Eigen::Vector3d& v) {
    return (Eigen::Matrix3d() << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0).finished();
  }

  static Eigen::Vector2d across(const Eigen::Vector2d& from, const Eigen::Vector2d& to) {
    const Eigen::Vector2d edge = to - from;
    const double length = std::sqrt(edge.squaredNorm());
    return length > 0 ? Eigen::Vector2d(edge.y() / length, -edge.x() / length) : Eigen::Vector2d(0, 0);
  }

  static double turn(const Eigen::Vector2d& a, const Eigen::Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); }

  // Faces of a body whose planes pass near x and face along n.
  static void candidates(const FaceTable& of, size_t body, const Eigen::Vector3d& x, const Eigen::Vector3d& n,
                         const PatchLimits& limits, std::vector<int64_t>& found) {
    found.clear();
    for (int64_t f = of.first_face[body]; f < of.first_face[body + 1]; ++f) {
      const Eigen::Vector3d normal = vector(of.normal, f);
      if (normal.dot(n) > limits.cos_tilt && std::abs(normal.dot(x) - of.offset[f]) <= limits.near) found.push_back(f);
    }
  }

  // Keep the part of `clipped` inside an edge through a point, with an outward normal.
  void clip(const Eigen::Vector2d& from, const Eigen::Vector2d& outward) {
    next.clear(), side.clear();
    for (const Edge& edge : clipped) side.push_back(outward.dot(edge.at - from));
    for (size_t k = 0; k < clipped.size(); ++k) {
      const size_t after = (k + 1) % clipped.size();
      const bool inside = side[k] <= 0, stays = side[after] <= 0;
      if (inside) next.push_back(clipped[k]);
      if (inside == stays) continue;
      const double share = side[k] / (side[k] - side[after]);
      const Eigen::Vector2d at = clipped[k].at + share * (clipped[after].at - clipped[k].at);
      // Leaving: the clipping edge follows; coming back: the present one does.
      if (inside)
        next.push_back({at, outward, false});
      else
        next.push_back({at, clipped[k].across, clipped[k].of_link});
    }
    std::swap(clipped, next);
  }

  // Choose at most four corners of the hull: the farthest two, and the farthest on both sides of the line between them.
  void choose(const PatchLimits& limits, Patch& out) {
    out.count = 0, out.extent = 0;
    if (corners.size() < 2) return;
    size_t i = 0, j = 0;
    double most = 0;
    for (size_t p = 0; p < corners.size(); ++p)
      for (size_t q = p + 1; q < corners.size(); ++q) {
        const double squared = (corners[p].at - corners[q].at).squaredNorm();
        if (squared > most * (1 + kTie)) most = squared, i = p, j = q;
      }
    out.extent = std::sqrt(most);
    if (!(out.extent >= limits.min_extent)) return;
    const Eigen::Vector2d line = (corners[j].at - corners[i].at) / out.extent;
    size_t left = i, right = i;
    double above = 0, below = 0;
    for (size_t p = 0; p < corners.size(); ++p) {
      const double height = turn(line, corners[p].at - corners[i].at);
      if (height > above + kTie * out.extent) above = height, left = p;
      if (height < below - kTie * out.extent) below = height, right = p;
    }
    const bool wide = std::max(above, -below) >= limits.min_width;
    chosen[out.count++] = i;
    if (wide && right != i && -below > kSliver * out.extent) chosen[out.count++] = right;
    chosen[out.count++] = j;
    if (wide && left != i && above > kSliver * out.extent) chosen[out.count++] = left;
  }

  static constexpr double kTie = 1e-6;     // Relative difference of distances that are taken as equal.
  static constexpr double kSliver = 1e-3;  // Height, relative to the extent, below which a corner is on the line.
};

}  // namespace grasp_refine
