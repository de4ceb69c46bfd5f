// Curvatures of surfaces at witness points: witness/curvature.py and pair_curvature.py, where they are explained, in C++.
#pragma once

#include <Eigen/Dense>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numeric>
#include <vector>

namespace grasp_refine {

// As in curvature.py, neighborhood.py and pair_curvature.py.
constexpr double kRidgeRatio = 1e-3, kCosNormals = -0.5, kFeatureTolerance = 1e-6, kEnoughCandidates = 32;

constexpr double kStep = 1e300;  // Slope of a step from 0 to 1, which is a vector operation; a comparison is none.
constexpr int kBlockSize = 16;              // Candidates of a block.
constexpr double kPadding = 1e100;          // Coordinates of padding, metres.

using Vector2 = Eigen::Vector2d;
using Vector3 = Eigen::Vector3d;
using Matrix2 = Eigen::Matrix2d;
using Tangents = Eigen::Matrix<double, 3, 2>;
using Lanes = Eigen::Array<double, kBlockSize, 1>;

// A witness point on a body, in its frame: outward normal, tangents, and radius rho of the neighbourhood.
struct Spot {
  Vector3 x, normal;
  Tangents E;
  double radius;
};

// Weighted sums over candidates: 1, e, m, e e^T, e m^T, with e = E^T (v - x) and m = E^T n.
struct Sums {
  double weight = 0;
  Vector2 e = Vector2::Zero(), m = Vector2::Zero();
  Matrix2 ee = Matrix2::Zero(), em = Matrix2::Zero();
};

// Symmetric matrix with a function applied to its eigenvalues; the eigenvectors stay.
template <class Function>
Matrix2 with_eigenvalues(const Matrix2& K, const Function& function) {
  const double middle = 0.5 * (K(0, 0) + K(1, 1)), difference = K(0, 0) - middle, mixed = K(0, 1);
  const double half = std::sqrt(difference * difference + mixed * mixed);
  const double high = function(middle + half), low = function(middle - half);
  const double mean = 0.5 * (high + low), factor = half > 0 ? 0.5 * (high - low) / half : 0.0;
  Matrix2 result;
  result << mean + factor * difference, factor * mixed, factor * mixed, mean - factor * difference;
  return result;
}

// A few candidates close to each other.
struct Block {
  Lanes v[3], n[3];  // Points and normals; padding is far away.

  // Add those within the radius whose normals agree with the contact normal.
  void add(const Spot& at, Sums& sums) const {
    const Lanes x = v[0] - at.x[0], y = v[1] - at.x[1], z = v[2] - at.x[2];
    const Lanes cosine = n[0] * at.normal[0] + n[1] * at.normal[1] + n[2] * at.normal[2];
    const Lanes weight = (1.0 - (x * x + y * y + z * z) * (1.0 / (at.radius * at.radius))).max(0.0) *
                         ((cosine - kCosNormals) * kStep).max(0.0).min(1.0);
    const double total = weight.sum();
    if (total == 0) return;
    const Lanes e0 = x * at.E(0, 0) + y * at.E(1, 0) + z * at.E(2, 0);
    const Lanes e1 = x * at.E(0, 1) + y * at.E(1, 1) + z * at.E(2, 1);
    const Lanes m0 = n[0] * at.E(0, 0) + n[1] * at.E(1, 0) + n[2] * at.E(2, 0);
    const Lanes m1 = n[0] * at.E(0, 1) + n[1] * at.E(1, 1) + n[2] * at.E(2, 1);
    const Lanes we0 = weight * e0, we1 = weight * e1;
    sums.weight += total;
    sums.e += Vector2(we0.sum(), we1.sum());
    sums.m += Vector2((weight * m0).sum(), (weight * m1).sum());
    const double mixed = (we0 * e1).sum();
    sums.ee += (Matrix2() << (we0 * e0).sum(), mixed, mixed, (we1 * e1).sum()).finished();
    sums.em += (Matrix2() << (we0 * m0).sum(), (we0 * m1).sum(), (we1 * m0).sum(), (we1 * m1).sum()).finished();
  }
};

// Some surface candidates of a body, in blocks with bounding spheres.
class Sample {
 public:
  // The points and normals `order`, which is changed.
  Sample(const Eigen::Matrix3Xd& points, const Eigen::Matrix3Xd& normals, std::vector<int> order) {
    sort(points, order, 0, order.size());
    const size_t count = order.size(), blocks = (count + kBlockSize - 1) / kBlockSize;
    for (auto* array : {&x_, &y_, &z_, &reach_}) array->resize(blocks);
    blocks_.resize(blocks);
    for (size_t b = 0; b < blocks; ++b) {
      Block& block = blocks_[b];
      for (int c = 0; c < 3; ++c) block.v[c] = kPadding, block.n[c] = 0.0;
      const size_t first = b * kBlockSize, size = std::min<size_t>(kBlockSize, count - first);
      Eigen::Matrix3Xd members(3, size);
      for (size_t k = 0; k < size; ++k) {
        members.col(k) = points.col(order[first + k]);
        for (int c = 0; c < 3; ++c) {
          block.v[c][k] = members(c, k);
          block.n[c][k] = normals(c, order[first + k]);
        }
      }
      const Vector3 middle = 0.5 * (members.rowwise().minCoeff() + members.rowwise().maxCoeff());
      x_[b] = middle[0], y_[b] = middle[1], z_[b] = middle[2];
      reach_[b] = (members.colwise() - middle).colwise().norm().maxCoeff();
    }
  }

  // Weighted sums over the neighbourhood.
  Sums near(const Spot& at) const {
    thread_local Eigen::ArrayXd outside;
    outside = (x_ - at.x[0]).square() + (y_ - at.x[1]).square() + (z_ - at.x[2]).square();
    outside -= (reach_ + at.radius).square();
    Sums sums;
    for (size_t b = 0; b < blocks_.size(); ++b)
      if (!(outside[b] > 0)) blocks_[b].add(at, sums);
    return sums;
  }

 private:
  // Order candidates such that blocks of consecutive ones are small.
  static void sort(const Eigen::Matrix3Xd& points, std::vector<int>& order, size_t first, size_t last) {
    const size_t blocks = (last - first + kBlockSize - 1) / kBlockSize;
    // The same blocks, and the same order in each, with any standard library.
    if (blocks < 2) return std::sort(order.begin() + first, order.begin() + last);
    Vector3 low = points.col(order[first]), high = low;
    for (size_t k = first; k < last; ++k) {
      low = low.cwiseMin(points.col(order[k]));
      high = high.cwiseMax(points.col(order[k]));
    }
    int axis;
    (high - low).maxCoeff(&axis);
    const size_t middle = first + blocks / 2 * kBlockSize;
    std::nth_element(order.begin() + first, order.begin() + middle, order.begin() + last, [&](int i, int j) {
      return points(axis, i) != points(axis, j) ? points(axis, i) < points(axis, j) : i < j;
    });
    sort(points, order, first, middle);
    sort(points, order, middle, last);
  }

  std::vector<Block> blocks_;
  Eigen::ArrayXd x_, y_, z_, reach_;  // Centres and radii of the blocks' bounding spheres.
};

// The surface candidates of a body, and random halves, quarters and so on of them for wide neighbourhoods.
class Surface {
 public:
  // Candidates (N, 3) in random order, row by row, and the surface's area.
  Surface(const double* points, const double* normals, size_t count, double area)
      : density_(static_cast<double>(count) / area) {
    const Eigen::Map<const Eigen::Matrix3Xd> v(points, 3, count), n(normals, 3, count);
    std::vector<int> order(count);
    std::iota(order.begin(), order.end(), 0);
    do {
      samples_.emplace_back(v, n, order);
      order.resize(order.size() / 2);
    } while (order.size() >= kEnoughCandidates);
  }

  // Fitted curvature K, positive for convex: E^T n = b + K E^T (v - x), eigenvalues clipped to [-1/rho, 4/rho].
  Matrix2 fit(const Spot& at) const {
    const Sums sums = sample(at.radius).near(at);
    const double per = 1.0 / std::max<double>(sums.weight, std::numeric_limits<float>::min());
    const Vector2 e = per * sums.e, m = per * sums.m;
    const Matrix2 A = per * sums.ee - e * e.transpose(), B = per * sums.em - e * m.transpose();
    const double ridge = kRidgeRatio * at.radius * at.radius;
    const double a = A(0, 0) + ridge, b = A(0, 1), c = A(1, 1) + ridge, scale = 1.0 / (a * c - b * b);
    Matrix2 K;
    K(0, 0) = (c * B(0, 0) - b * B(1, 0)) * scale;
    K(1, 1) = (a * B(1, 1) - b * B(0, 1)) * scale;
    K(0, 1) = K(1, 0) = 0.5 * scale * (c * B(0, 1) - b * B(1, 1) + a * B(1, 0) - b * B(0, 0));
    const double low = -1.0 / at.radius, high = 4.0 / at.radius;
    return with_eigenvalues(K, [=](double value) { return std::min(std::max(value, low), high); });
  }

 private:
  // The smallest sample with enough candidates within a radius on a flat surface.
  const Sample& sample(double radius) const {
    const int halvings = std::ilogb(density_ * M_PI * radius * radius / kEnoughCandidates);
    return samples_[std::clamp<int>(halvings, 0, samples_.size() - 1)];
  }

  std::vector<Sample> samples_;
  double density_;  // Candidates per square metre.
};

// The faces, edges and vertices of a convex piece: `feature_slip` of analytical.py, at infinite distance.
struct Features {
  Eigen::MatrixX3d normals;  // Of the core's faces; without any, the core is a point or a segment.
  Eigen::ArrayXd offsets;
  Vector3 middle = Vector3::Zero(), axis = Vector3::Zero();  // Of a segment; the axis of a point is zero.
  double radius = 0, size = 0;                               // `size`: `Piece.extent`.

  // Projection (3, 3) onto the directions in which the feature at x extends.
  Eigen::Matrix3d along(const Vector3& x, const Vector3& normal) const {
    const Vector3 core = x - radius * normal;
    if (!normals.rows()) {
      const bool inside = std::abs((core - middle).dot(axis)) < (0.5 - kFeatureTolerance) * size;
      return inside ? Eigen::Matrix3d(axis * axis.transpose()) : Eigen::Matrix3d::Zero();
    }
    const double slack = kFeatureTolerance * size;
    thread_local Eigen::ArrayXd away;
    away = normals.col(0).array() * core[0] + normals.col(1).array() * core[1] + normals.col(2).array() * core[2];
    away -= offsets;
    Eigen::Matrix3d gram = Eigen::Matrix3d::Zero();
    for (Eigen::Index f = 0; f < away.size(); ++f)
      if (std::abs(away[f]) < slack) gram += normals.row(f).transpose() * normals.row(f);
    // The null space of the active normals; nearly parallel ones count as one face.
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(gram);
    const Vector3& values = solver.eigenvalues();
    Eigen::Matrix3d found = Eigen::Matrix3d::Zero();
    for (int k = 0; k < 3; ++k)
      if (values[k] < 1e-9 * std::max(values[2], 1.0))
        found += solver.eigenvectors().col(k) * solver.eigenvectors().col(k).transpose();
    return found;
  }

  // Curvature: none along the feature; across, that of a round piece, or else `corner`.
  Matrix2 curvature(const Spot& at, double corner) const {
    const Matrix2 across = Matrix2::Identity() - at.E.transpose() * along(at.x, at.normal) * at.E;
    return (radius > 0 ? 1.0 / radius : corner) * across;
  }
};

// Raise the eigenvalues of K_a + K_b to the floor, half by each.
inline void raise_eigenvalues(Matrix2& K_a, Matrix2& K_b, double floor) {
  const auto missing = [=](double value) { return std::max(floor - value, 0.0); };
  const Matrix2 half = 0.5 * with_eigenvalues(K_a + K_b, missing);
  K_a += half, K_b += half;
}

}  // namespace grasp_refine
