// Steps of damped least squares within bounds; bounded_step.py says what they are.
#pragma once

#include <Eigen/Dense>

#include <algorithm>
#include <vector>

namespace grasp_refine {

// The steps of one member after another: n unknowns and m residuals; the buffers keep their memory.
class BoundedStep {
 public:
  using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  using Rows = Eigen::Map<const Matrix>;
  using Values = Eigen::Map<const Eigen::VectorXd>;

  // Write the step that minimises |J dx + r|^2 + damping dx . W dx, and return the fall of |r|^2 that it predicts.
  // Rows of `unilateral` (null: none) count only where they are positive.
  double solve(const Rows& J, const Values& r, double damping, const Values& metric, const Values& lower,
               const Values& upper, const bool* unilateral, int passes, Eigen::Ref<Eigen::VectorXd> dx) {
    const Eigen::Index m = J.rows();
    counts_.resize(m);
    for (Eigen::Index i = 0; i < m; ++i) counts_[i] = !(unilateral && unilateral[i]) || r[i] > 0;
    const double before = square(r);
    for (int pass = 0; pass < passes; ++pass) {
      counted_.resize(m, J.cols()), value_.resize(m);
      Eigen::Index rows = 0;
      // Rows of zeros, of links that only other grasps touch with, would change the order of the sums.
      for (Eigen::Index i = 0; i < m; ++i)
        if (counts_[i] && (J.row(i).array() != 0).any()) counted_.row(rows) = J.row(i), value_[rows++] = r[i];
      const auto A = counted_.topRows(rows);
      damped_.setZero(J.cols(), J.cols());
      damped_.selfadjointView<Eigen::Lower>().rankUpdate(A.transpose());
      damped_.diagonal() += damping * metric;
      damped_.triangularView<Eigen::StrictlyUpper>() = damped_.transpose();
      g_.noalias() = A.transpose() * value_.head(rows);
      within_bounds(lower, upper, dx);
      after_.noalias() = J * dx;
      after_ += r;
      if (!unilateral) break;
      bool same = true;
      for (Eigen::Index i = 0; i < m; ++i) {
        const char now = !unilateral[i] || after_[i] > 0;
        same &= now == counts_[i];
        counts_[i] = now;
      }
      if (same) break;
    }
    return before - square(after_);
  }

 private:
  static constexpr int kPasses = 10, kHeldPasses = 3;

  template <class Vector>
  double square(const Vector& values) const {
    double sum = 0;
    for (Eigen::Index i = 0; i < values.size(); ++i)
      if (counts_[i]) sum += values[i] * values[i];
    return sum;
  }

  // Primal-dual active sets: hold unknowns beyond a bound there, release those that would come back.
  void within_bounds(const Values& lower, const Values& upper, Eigen::Ref<Eigen::VectorXd> dx) {
    const Eigen::Index n = dx.size();
    held_.assign(n, false), value_at_bound_.setZero(n);
    solve_free(dx);
    if ((dx.array() >= lower.array()).all() && (dx.array() <= upper.array()).all()) return;
    for (int number = 0; number < kPasses - 1; ++number) {
      const bool keep = number > kPasses - 1 - kHeldPasses;
      bool changed = false;
      slope_.noalias() = damped_ * dx;
      slope_ += g_;
      for (Eigen::Index i = 0; i < n; ++i) {
        const bool kept = keep && held_[i];
        // A held unknown is released if the slope points back into its bounds.
        const double wanted = dx[i] - (held_[i] && !kept ? slope_[i] / damped_(i, i) : 0.0);
        const double limited = std::min(std::max(wanted, lower[i]), upper[i]);
        const bool outside = limited != wanted || kept;
        changed |= outside != bool(held_[i]) || (outside && limited != dx[i]);
        held_[i] = outside, value_at_bound_[i] = limited;
      }
      if (!changed) break;
      solve_free(dx);
    }
    dx = dx.cwiseMax(lower).cwiseMin(upper);
  }

  // Solve damped dx = -g in the free unknowns, the held ones at their bounds; no step where rounding leaves no solution.
  void solve_free(Eigen::Ref<Eigen::VectorXd> dx) {
    free_.clear();
    for (Eigen::Index i = 0; i < dx.size(); ++i) {
      if (held_[i]) dx[i] = value_at_bound_[i];
      else free_.push_back(i);
    }
    const auto count = static_cast<Eigen::Index>(free_.size());
    system_.resize(count, count), right_.resize(count);
    for (Eigen::Index a = 0; a < count; ++a) {
      right_[a] = -g_[free_[a]];
      for (Eigen::Index b = 0; b < count; ++b) system_(a, b) = damped_(free_[a], free_[b]);
      for (Eigen::Index i = 0; i < dx.size(); ++i)
        if (held_[i]) right_[a] -= damped_(free_[a], i) * value_at_bound_[i];
    }
    cholesky_.compute(system_);
    if (cholesky_.info() == Eigen::Success) cholesky_.solveInPlace(right_);
    else right_.setZero();
    for (Eigen::Index a = 0; a < count; ++a) dx[free_[a]] = right_[a];
  }

  std::vector<char> counts_, held_;
  std::vector<Eigen::Index> free_;
  Matrix counted_;
  Eigen::MatrixXd damped_, system_;
  Eigen::VectorXd value_, value_at_bound_, g_, after_, slope_, right_;
  Eigen::LLT<Eigen::MatrixXd> cholesky_;
};

}  // namespace grasp_refine
