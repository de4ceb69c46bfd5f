// Sliding and rolling of witness points on two surfaces: witness/contact_kinematics.py, where it is explained, in C++.
#pragma once

#include <Eigen/Dense>

#include <algorithm>
#include <cmath>

#include "curvature.h"

namespace grasp_refine {

using Matrix26 = Eigen::Matrix<double, 2, 6>;
using Vector6 = Eigen::Matrix<double, 6, 1>;

// Largest absolute eigenvalue of a symmetric matrix.
inline double max_curvature(const Matrix2& K) {
  const double mean = 0.5 * (K(0, 0) + K(1, 1)), half = 0.5 * (K(0, 0) - K(1, 1));
  return std::abs(mean) + std::sqrt(half * half + K(0, 1) * K(0, 1));
}

inline double effective_distance(const Matrix2& K_a, const Matrix2& K_b, double distance) {
  const double bend = distance * (K_b * K_a).trace();
  const double x = std::abs(distance) * std::min(max_curvature(K_a), max_curvature(K_b));
  return bend < 0 && x > 0.5 ? (1.0 - x) / x * distance : distance;
}

// Tangents of a unit normal, as `se3.tangents`.
inline Tangents tangents_of(const Vector3& n) {
  const double sign = n[2] < 0 ? -1.0 : 1.0, a = -1.0 / (sign + n[2]), b = n[0] * n[1] * a;
  Tangents E;
  E << 1.0 + sign * n[0] * n[0] * a, b, sign * b, sign + n[1] * n[1] * a, -sign * n[0], -n[1];
  return E;
}

// A witness pair: normal from a to b, point on b, curvatures of both surfaces in the tangents E.
struct Contact {
  Vector3 normal, point_b;
  Tangents E;
  Matrix2 K_a, K_b;
  double d;   // Effective signed distance.
  Matrix2 S;  // Relative curvature.

  Contact(const Vector3& normal, const Vector3& point_b, double distance, const Tangents& E, const Matrix2& K_a,
          const Matrix2& K_b)
      : normal(normal), point_b(point_b), E(E), K_a(K_a), K_b(K_b), d(effective_distance(K_a, K_b, distance)),
        S(K_a + K_b + d * (K_b * K_a)) {}

  // Jacobians of the slip of the witness points on their bodies in the spatial twist of b relative to a.
  void slip_jacobians(Matrix26& U_a, Matrix26& U_b) const {
    Matrix26 moved, turned = Matrix26::Zero();
    for (int k = 0; k < 2; ++k) moved.row(k) << E.col(k).transpose(), point_b.cross(E.col(k)).transpose();
    turned.block<1, 3>(0, 3) = E.col(1).transpose();
    turned.block<1, 3>(1, 3) = -E.col(0).transpose();
    U_a = S.inverse() * (turned + K_b * moved);
    U_b = U_a + d * (K_a * U_a) - moved;
  }

  // Wrenches on both bodies from covectors on points and normal.
  void pull_back(const Vector3& point_a, const Vector3& force_a, const Vector3& force_b, const Vector3& force_n,
                 Vector6& wrench_a, Vector6& wrench_b) const {
    const Vector2 on_b = E.transpose() * force_b;
    const Vector2 in_plane = E.transpose() * force_a + on_b + K_a * (d * on_b + E.transpose() * force_n);
    const Vector2 slide = S.transpose().inverse() * in_plane;
    const Vector3 force = force_b.dot(normal) * normal + E * (K_b * slide);
    wrench_b << force, point_b.cross(force) + normal.cross(E * slide);
    wrench_a << force_a + force_b, point_a.cross(force_a) + point_b.cross(force_b) + normal.cross(force_n);
    wrench_a -= wrench_b;
  }
};

}  // namespace grasp_refine
