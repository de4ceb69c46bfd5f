// Search for the closest piece pair of each item.
//
// One piece pair is queried first. Its answer is an upper bound, and along its normal u every other pair is at least
// min_b u . y - max_a u . x apart, which rules out nearly all of them at the cost of one number a piece. Boxes are
// compared for those that remain; then they are queried, best bound first. bounds.py says why these bounds hold.
#pragma once

#include <cmath>
#include <tuple>

#include "narrow_phase.h"

namespace grasp_refine {

// As `QueryStatus` in query.py.
enum Status : int8_t { kSeparated, kPenetrating, kFar, kFailed, kNotFinite };

// The bodies on one side of the body pairs; pieces of all bodies, body by body.
struct Side {
  std::vector<int64_t> body;            // The body of each body pair.
  std::vector<int64_t> first;           // Start of each body's pieces, and the end of the last.
  std::vector<Vec3s> center, half;      // Centres of boxes and spheres, half side lengths of the boxes.
  std::vector<Matrix3s> axes;           // Axes of the boxes, one a row.
  std::vector<double> radius;           // Radii of the spheres.
  const double* supports;               // Support functions (body, direction, piece), see bounds.py.
  size_t directions, width, cells;      // Number of directions, most pieces of a body, number of cells.

  // A sphere around the centres of a body's pieces, and the largest radius of its pieces.
  struct Whole {
    Vec3s center = Vec3s::Zero();
    double spread = 0, radius = -kInfinity;
  };
  std::vector<Whole> whole;

  void enclose() {
    for (size_t k = 0; k + 1 < first.size(); ++k) {
      Whole of;
      for (int64_t i = first[k]; i < first[k + 1]; ++i) of.center += center[i] / double(first[k + 1] - first[k]);
      for (int64_t i = first[k]; i < first[k + 1]; ++i) {
        of.spread = std::max(of.spread, (center[i] - of.center).norm());
        of.radius = std::max(of.radius, radius[i]);
      }
      whole.push_back(of);
    }
  }

  int64_t begin(int64_t pair) const { return first[body[pair]]; }
  int64_t count(int64_t pair) const { return first[body[pair] + 1] - begin(pair); }

  // Upper bounds of max u . x over each piece of a body.
  void reach(int64_t pair, const Vec3s& u, std::vector<double>& out) const {
    int side;
    const double scale = u.cwiseAbs().maxCoeff(&side);
    // Intersection of u with the cube, in cells.
    double x = (u[(side + 1) % 3] / scale + 1.0) * (cells / 2.0), y = (u[(side + 2) % 3] / scale + 1.0) * (cells / 2.0);
    const size_t i = std::min<size_t>(x, cells - 1), j = std::min<size_t>(y, cells - 1), row = cells + 1;
    x -= i, y -= j;
    const double* low = supports + (body[pair] * directions + ((2 * side + (u[side] < 0)) * row + i) * row + j) * width;
    const double* high = low + row * width;
    const double w0 = (1 - x) * (1 - y) * scale, w1 = (1 - x) * y * scale, w2 = x * (1 - y) * scale, w3 = x * y * scale;
    out.resize(width);
    for (size_t k = 0; k < width; ++k)
      out[k] = w0 * low[k] + w1 * low[width + k] + w2 * high[k] + w3 * high[width + k];
  }
};

// Support function max u . x of vertices (count, 3) in directions u, coordinate by coordinate (3, size).
inline void support(const double* vertex, size_t count, const double* direction, size_t size, double* out) {
  constexpr size_t kBlock = 128;  // Directions whose maxima stay in the processor's cache.
  for (size_t start = 0; start < size; start += kBlock) {
    const size_t width = std::min(kBlock, size - start);
    const double *x = direction + start, *y = x + size, *z = y + size;
    double* best = out + start;
    std::fill(best, best + width, -kInfinity);
    for (const double* v = vertex; v != vertex + 3 * count; v += 3)
      for (size_t k = 0; k < width; ++k) {
        const double reach = v[0] * x[k] + v[1] * y[k] + v[2] * z[k];
        best[k] = reach > best[k] ? reach : best[k];
      }
  }
}

// The last answer for an item.
struct Warm {
  int64_t winner = -1;  // -1: none.
  Vec3s guess;          // x_a - x_b in the frame of body a.
  bool apart = false;   // True: the guess may be used.
};

// Buffers of one thread in a search.
struct Scratch {
  Eigen::Matrix<double, Eigen::Dynamic, 3> y;  // Centres of the spheres of b in the frame of a,
  std::vector<double> y_square;                // and the squares of their lengths.
  std::vector<double> between;                 // Lower bounds of the distances from a's pieces to all centres of b.
  std::vector<double> square;                  // Squared distances of centres (count_a, count_b),
  std::vector<char> known;                     // and mask of the pieces of a for which they are computed.
  std::vector<double> reach_a, reach_b;
  std::vector<Entry> left;
  std::vector<Entry>* trace = nullptr;  // Record of the queries; null: none.
};

// Rounding must not make squared distances longer, nor distances by more than this.
constexpr double kShorter = 1.0 - 16 * std::numeric_limits<double>::epsilon(), kRounding = 1e-9;

class Search {
 public:
  NarrowPhase narrow_phase;
  Side a, b;
  std::vector<int64_t> first_pair;  // The first piece pair of each body pair; (i, j) follows i count_b + j later.

  // The closest piece pair of body pair `pair` that is below the limit.
  Found minimum(int64_t pair, const Transform3s& T, double limit, const Warm& warm, Scratch& scratch) const {
    // No distance is below a NaN limit.
    if (std::isnan(limit)) return Found();
    const int64_t columns = a.count(pair) * b.count(pair);
    place(pair, T, scratch);
    int64_t column = warm.winner - first_pair[pair];
    if (column < 0 || column >= columns) column = likeliest(pair, scratch);
    Found found;
    // A single piece pair without a limit is queried whatever its bound is.
    double bound = a.width * b.width == 1 && std::isinf(limit) ? -kInfinity : sphere_bound(pair, column, scratch);
    if (bound < limit && std::isfinite(limit)) bound = std::max(bound, box_bound(pair, column, T));
    if (bound < limit) {
      const Entry first{bound, first_pair[pair] + column};
      // Even beyond the limit, the normal of an answer is useful.
      narrow_phase.query(&first, &first + 1, T, kInfinity, warm.apart ? &warm.guess : nullptr, found);
      if (scratch.trace) scratch.trace->push_back(first);
    }
    if (columns > 1) rest(pair, T, limit, column, scratch, found);
    if (found.distance >= limit) {
      const int64_t num_queries = found.num_queries;
      const bool failed = found.failed;
      found = Found();
      found.num_queries = num_queries, found.failed = failed;
    }
    return found;
  }

 private:
  void place(int64_t pair, const Transform3s& T, Scratch& scratch) const {
    const int64_t count_a = a.count(pair), count_b = b.count(pair);
    scratch.y.resize(count_b, 3), scratch.y_square.resize(count_b), scratch.square.resize(count_a * count_b);
    scratch.known.assign(count_a, false);
    for (int64_t j = 0; j < count_b; ++j) {
      const Vec3s y = T.getRotation() * b.center[b.begin(pair) + j] + T.getTranslation();
      scratch.y.row(j) = y;
      scratch.y_square[j] = kShorter * y.squaredNorm();
    }
    const Side::Whole& whole = b.whole[b.body[pair]];
    const Vec3s middle = T.getRotation() * whole.center + T.getTranslation();
    scratch.between.resize(count_a);
    for (int64_t i = 0; i < count_a; ++i)
      scratch.between[i] = (a.center[a.begin(pair) + i] - middle).norm() - whole.spread - kRounding;
  }

  // The squared distances from the center of a's piece i to those of all of b, computed once.
  const double* squares(int64_t pair, int64_t i, Scratch& scratch) const {
    const int64_t count = scratch.y_square.size();
    double* row = scratch.square.data() + i * count;
    if (scratch.known[i]) return row;
    scratch.known[i] = true;
    const Vec3s &x = a.center[a.begin(pair) + i], u = -2 * x;
    const double *y0 = scratch.y.col(0).data(), *y1 = scratch.y.col(1).data(), *y2 = scratch.y.col(2).data();
    const double *y_square = scratch.y_square.data(), x_square = kShorter * x.squaredNorm();
    for (int64_t j = 0; j < count; ++j)
      row[j] = std::max(u[0] * y0[j] + u[1] * y1[j] + u[2] * y2[j] + x_square + y_square[j], 0.0);
    return row;
  }

  double sphere_bound(int64_t pair, int64_t column, Scratch& scratch) const {
    const auto [i, j] = split(pair, column);
    const double* square = squares(pair, i - a.begin(pair), scratch);
    return std::sqrt(square[j - b.begin(pair)]) - (a.radius[i] + b.radius[j]);
  }

  // The closest piece pair with spheres of half the size: pieces seldom fill theirs.
  int64_t likeliest(int64_t pair, Scratch& scratch) const {
    const int64_t count_a = a.count(pair), count_b = b.count(pair);
    const double *radius_a = a.radius.data() + a.begin(pair), *radius_b = b.radius.data() + b.begin(pair);
    const double widest = b.whole[b.body[pair]].radius;
    const auto& between = scratch.between;
    int64_t start = 0, best = 0;
    for (int64_t i = 1; i < count_a; ++i)
      if (between[i] - 0.5 * radius_a[i] < between[start] - 0.5 * radius_a[start]) start = i;
    double least = kInfinity;
    // The most promising piece first rules out most others.
    for (int64_t k = 0; k < count_a; ++k) {
      const int64_t i = k == 0 ? start : k <= start ? k - 1 : k;
      if (between[i] - 0.5 * (radius_a[i] + widest) > least) continue;
      const double* square = squares(pair, i, scratch);
      for (int64_t j = 0; j < count_b; ++j) {
        const double radii = 0.5 * (radius_a[i] + radius_b[j]), reach = least + radii + kRounding;
        // Most are ruled out without a root.
        if (reach <= 0 || square[j] > reach * reach) continue;
        const double gap = std::sqrt(square[j]) - radii;
        const int64_t column = i * count_b + j;
        if (gap < least || (gap == least && column < best)) least = gap, best = column;
      }
    }
    return best;
  }

  // Query all columns but one that can be closer than the answer found.
  void rest(int64_t pair, const Transform3s& T, double limit, int64_t done, Scratch& scratch, Found& found) const {
    const double best = std::min(found.distance, limit);
    auto& left = scratch.left;
    below(pair, best, done, scratch);
    if (left.empty()) return;
    raise_by_gaps(pair, T, best, found.normal, scratch);
    for (Entry& entry : left) entry.bound = std::max(entry.bound, box_bound(pair, entry.pair, T));
    drop(left, best);
    std::sort(left.begin(), left.end(), [](const Entry& p, const Entry& q) {
      return std::tie(p.bound, p.pair) < std::tie(q.bound, q.pair);
    });
    for (Entry& entry : left) entry.pair += first_pair[pair];
    const int64_t before = found.num_queries;
    narrow_phase.query(left.data(), left.data() + left.size(), T, limit, nullptr, found);
    if (scratch.trace)
      scratch.trace->insert(scratch.trace->end(), left.begin(), left.begin() + (found.num_queries - before));
  }

  // The columns whose spheres are nearer than `best`.
  void below(int64_t pair, double best, int64_t done, Scratch& scratch) const {
    scratch.left.clear();
    const int64_t count_b = b.count(pair);
    const double* radius_b = b.radius.data() + b.begin(pair);
    for (int64_t i = 0; i < a.count(pair); ++i) {
      const double radius = a.radius[a.begin(pair) + i];
      if (scratch.between[i] - radius - b.whole[b.body[pair]].radius >= best) continue;
      const double* square = squares(pair, i, scratch);
      for (int64_t j = 0; j < count_b; ++j) {
        const double radii = radius + radius_b[j], reach = best + radii;
        // Most are ruled out without a root.
        if (reach <= 0 || square[j] > reach * reach * (1 + 1e-14) || i * count_b + j == done) continue;
        const double bound = std::sqrt(square[j]) - radii;
        if (bound < best) scratch.left.push_back({bound, i * count_b + j});
      }
    }
  }

  static void drop(std::vector<Entry>& left, double best) {
    left.erase(std::remove_if(left.begin(), left.end(), [best](const Entry& e) { return !(e.bound < best); }),
               left.end());
  }

  // Raise bounds by the gaps between the pieces along the normal found.
  void raise_by_gaps(int64_t pair, const Transform3s& T, double best, Vec3s u, Scratch& scratch) const {
    // Any unit direction gives a bound: without an answer all are equally good.
    if (!(std::abs(u.squaredNorm() - 1.0) <= 1e-12)) u = Vec3s::UnitX();
    a.reach(pair, u, scratch.reach_a);
    b.reach(pair, -(T.getRotation().transpose() * u), scratch.reach_b);
    const double offset = u.dot(T.getTranslation());
    for (Entry& entry : scratch.left) {
      const int64_t i = entry.pair / b.count(pair), j = entry.pair % b.count(pair);
      entry.bound = std::max(entry.bound, offset - scratch.reach_b[j] - scratch.reach_a[i]);
    }
    drop(scratch.left, best);
  }

  // The largest gap of two oriented boxes along their axes and the line between their centres.
  double box_bound(int64_t pair, int64_t column, const Transform3s& T) const {
    const auto [i, j] = split(pair, column);
    const Matrix3s axes_b = b.axes[j] * T.getRotation().transpose();
    const Vec3s offset = T.getRotation() * b.center[j] + T.getTranslation() - a.center[i];
    const Matrix3s cosines = (a.axes[i] * axes_b.transpose()).cwiseAbs();
    const Vec3s offset_a = (a.axes[i] * offset).cwiseAbs(), offset_b = (axes_b * offset).cwiseAbs();
    const double along_a = (offset_a - a.half[i] - cosines * b.half[j]).maxCoeff();
    const double along_b = (offset_b - b.half[j] - cosines.transpose() * a.half[i]).maxCoeff();
    const double length = offset.norm(), reach = offset_a.dot(a.half[i]) + offset_b.dot(b.half[j]);
    // Concentric boxes have no such line.
    const double along_line = length > 0 ? length - reach / length : -kInfinity;
    return std::max({along_a, along_b, along_line});
  }

  // The pieces of a column, among those of all bodies.
  std::pair<int64_t, int64_t> split(int64_t pair, int64_t column) const {
    return {a.begin(pair) + column / b.count(pair), b.begin(pair) + column % b.count(pair)};
  }
};

}  // namespace grasp_refine
