// Forward kinematics of a tree of joints, and covectors of links on its joints; hands/chain.py says what they are.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

namespace grasp_refine {

// The constants of `chain.Numbers`: m joints below the root by level, k of them columns of the axes.
struct Tree {
  using Terms = std::vector<std::pair<int64_t, double>>;  // Columns that are not 0, with their factors.

  size_t dof, joints;
  std::vector<Terms> values;                    // (m): of the independent joints.
  std::vector<double> offset;                   // (m,)
  std::vector<double> constant, of_cos, of_sin, of_value;  // (m, 4, 4)
  std::vector<int64_t> parent;                  // (m,): frames, of which 0 is the root's and 1 + i that of joint i.
  std::vector<int64_t> link_frame;              // (L,)
  std::vector<double> T_frame_link;             // (L, 4, 4)
  std::vector<int64_t> column;                  // (k,): joint of each column.
  std::vector<uint8_t> slides;                  // (k,)
  std::vector<int64_t> leader;                  // (m,) or none: independent joint that each joint follows on a curve.
  std::vector<double> slope_offset, higher;     // (m,), (m, powers)
  std::vector<Terms> gains;                     // (6 + k) or none, for the identity.
  std::vector<uint8_t> follows;                 // (links + m, 6 + k)

  size_t columns() const { return 6 + column.size(); }
  size_t unknowns() const { return gains.empty() ? columns() : 6 + dof; }
};

// The upper three rows of a product of transforms, and its last row.
inline void multiply(const double* a, const double* b, double* out) {
  for (int r = 0; r < 4; ++r)
    for (int c = 0; c < 4; ++c)
      out[4 * r + c] = a[4 * r] * b[c] + a[4 * r + 1] * b[4 + c] + a[4 * r + 2] * b[8 + c] + a[4 * r + 3] * b[12 + c];
}

// The unit twist of a rotation about an axis z through p, or of a translation along it, as column c of `axes`.
inline void write_twist(const double* p, const double* z, bool slide, double slope, double* axes, size_t c, size_t n) {
  const double v[3] = {p[1] * z[2] - p[2] * z[1], p[2] * z[0] - p[0] * z[2], p[0] * z[1] - p[1] * z[0]};
  for (int i = 0; i < 3; ++i) {
    axes[i * n + c] = (slide ? z[i] : v[i]) * slope;
    axes[(3 + i) * n + c] = slide ? 0.0 : z[i] * slope;
  }
}

class Kinematics {
 public:
  // Write the poses of the links (L, 4, 4) and the twists of the columns (6, 6 + k) at one configuration. Where a joint
  // value is not finite, no joint has a pose.
  void forward(const Tree& tree, const double* T_root, const double* q, double* T_link, double* axes) {
    const size_t m = tree.joints, n = tree.columns();
    const bool known = std::all_of(q, q + tree.dof, [](double x) { return std::isfinite(x); });
    frames_.resize(16 * (m + 1)), slope_.assign(m, 1.0);
    std::copy_n(T_root, 16, frames_.data());
    for (size_t j = 0; j < m; ++j) {
      double value = known ? 0.0 : std::numeric_limits<double>::quiet_NaN();
      for (const auto& [i, factor] : tree.values[j]) value += q[i] * factor;
      value += tree.offset[j];
      if (!tree.leader.empty()) value += curved(tree, j, q[tree.leader[j]]);
      const double cosine = std::cos(value), sine = std::sin(value);
      double local[16];
      for (int e = 0; e < 16; ++e) {
        const size_t at = 16 * j + e;
        local[e] = tree.constant[at] + cosine * tree.of_cos[at] + sine * tree.of_sin[at] + value * tree.of_value[at];
      }
      multiply(frame(tree.parent[j]), local, frame(1 + j));
    }
    for (size_t l = 0; l < tree.link_frame.size(); ++l)
      multiply(frame(tree.link_frame[l]), tree.T_frame_link.data() + 16 * l, T_link + 16 * l);
    const double root[3] = {T_root[3], T_root[7], T_root[11]};
    for (int i = 0; i < 3; ++i) {
      double unit[3] = {0, 0, 0};
      unit[i] = 1;
      write_twist(root, unit, true, 1.0, axes, i, n);
      write_twist(root, unit, false, 1.0, axes, 3 + i, n);
    }
    for (size_t c = 0; c < tree.column.size(); ++c) {
      const double* T = frame(1 + tree.column[c]);
      const double p[3] = {T[3], T[7], T[11]}, z[3] = {T[2], T[6], T[10]};
      write_twist(p, z, tree.slides[c], slope_[tree.column[c]], axes, 6 + c, n);
    }
  }

  // Write the row (6 + n) of a covector (6,) on the twist of a link, less that of another link (-1: none).
  void to_joints(const Tree& tree, const double* axes, const double* covector, int64_t link, int64_t minus,
                 double* out) {
    const size_t n = tree.columns();
    row_.assign(n, 0.0);
    const uint8_t* moves = tree.follows.data() + n * link;
    const uint8_t* other = minus < 0 ? nullptr : tree.follows.data() + n * minus;
    for (size_t c = 0; c < n; ++c) {
      const int sign = moves[c] - (other ? other[c] : 0);
      if (!sign) continue;
      double sum = 0;
      for (int i = 0; i < 6; ++i) sum += covector[i] * axes[i * n + c];
      row_[c] = sign * sum;
    }
    if (tree.gains.empty()) {
      std::copy(row_.begin(), row_.end(), out);
      return;
    }
    std::fill_n(out, tree.unknowns(), 0.0);
    for (size_t c = 0; c < n; ++c)
      if (row_[c] != 0)
        for (const auto& [i, factor] : tree.gains[c]) out[i] += row_[c] * factor;
  }

 private:
  double* frame(int64_t number) { return frames_.data() + 16 * number; }

  // The higher powers of a coupling by Horner's rule, and its slope.
  double curved(const Tree& tree, size_t j, double x) {
    const size_t powers = tree.higher.size() / tree.joints;
    double value = 0, slope = 0;
    for (size_t power = powers + 1; power > 1; --power) {
      const double coefficient = tree.higher[powers * j + power - 2];
      value = (value + coefficient) * x;
      slope = (slope + static_cast<double>(power) * coefficient) * x;
    }
    slope_[j] = slope + tree.slope_offset[j];
    return value * x;
  }

  std::vector<double> frames_, slope_, row_;
};

}  // namespace grasp_refine
