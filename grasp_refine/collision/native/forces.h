// Best contact forces of one grasp under a load: a strictly convex quadratic program, by a primal active-set method.
//
// The forces x_c = (pressure, two tangents) of C contacts minimise |w + sum G_c x_c|^2 + ridge sum |x_c|^2, where w is
// the load. Each is in a pyramid of 8 sides about its normal, at most `cap` high, and the pressures sum to 1.
//
// An active set is a face of each pyramid (`Face`), in whose plane the force is free. The best forces in these planes
// solve a linear system of R + 1 unknowns, whatever the number of contacts: with z = (nu, w + G x) / ridge, nu the
// multiplier of the pressures' sum, and G' = G with a row of ones over the pressures,
//   x_c = P_c (-G'_c^T z),  (diag(0, ridge, ..., ridge) + sum G'_c J_c G'_c^T) z = (-1, w) + sum G'_c o_c,
// where P_c(v) = J_c v + o_c is the projection onto the plane. A step towards them ends where the first force meets the
// boundary of its face, which it then stays in; after a full step the constraint with the most negative multiplier is
// left. The forces stay feasible, so that those under one load are where the next load starts.
// Nocedal and Wright 2006, "Numerical Optimization", algorithm 16.3.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace grasp_refine {

// Faces of a pyramid, by the constraints that hold with equality. The last three are at the cap.
enum Face { kApex, kEdge, kSide, kInterior, kCorner, kRim, kLid };

// Multipliers within this times the largest number that they are computed from count as 0. Should constraints be met
// and left for ever nevertheless, it grows after more steps than usual.
constexpr double kTolerance = 1e-12, kGrowth = 2.0;

// Distance, per unit of total pressure, within which a force is in a face.
constexpr double kOnFace = 1e-12;

// Where a force is: in a face of its pyramid, next to the side with this unit normal n across the axis; b is
// perpendicular to n, towards the edge where one is meant.
struct Place {
  Face face;
  double n[2], b[2];
};

// A pyramid whose cross-section at pressure 1 is an octagon with corners at `friction`, the first of them along x.
struct Pyramid {
  // Cosine and sine of half the angle between two corners, cosine of the angle itself.
  static constexpr double kCos = 0.92387953251128675613, kSin = 0.38268343236508977173, kCosine = 0.70710678118654752440;

  double cap, side, half;          // Largest pressure; distance of a side, and half its length, at pressure 1.
  double along_side, along_edge;   // 1 over the squared lengths of (1, side) and (1, side, half).
  double cosine;                   // Of the angle between the normals of two neighbouring sides.

  Pyramid(double friction, double cap) : cap(cap), side(friction * kCos), half(friction * kSin) {
    along_side = 1.0 / (1.0 + side * side);
    along_edge = 1.0 / (1.0 + side * side + half * half);
    cosine = (side * side + kCosine) * along_side;
  }

  // Place of a face next to the edge nearest to a tangential vector.
  static Place nearest(Face face, double t0, double t1) {
    const bool swapped = std::abs(t1) > std::abs(t0);
    const double s0 = t0 < 0 ? -1.0 : 1.0, s1 = t1 < 0 ? -1.0 : 1.0;
    Place place{face, {s0 * (swapped ? kSin : kCos), s1 * (swapped ? kCos : kSin)}, {}};
    place.b[0] = s0 * (swapped ? kCos : -kSin), place.b[1] = s1 * (swapped ? -kSin : kCos);
    if (place.b[0] * t0 + place.b[1] * t1 < 0) place.b[0] = -place.b[0], place.b[1] = -place.b[1];
    return place;
  }

  // The place of a force.
  Place place_of(const double* x) const {
    Place a = nearest(kApex, x[1], x[2]);
    if (x[0] < kOnFace) return a;
    const bool top = x[0] > cap - kOnFace;
    const bool out = a.n[0] * x[1] + a.n[1] * x[2] > side * x[0] - kOnFace;
    const bool end = a.b[0] * x[1] + a.b[1] * x[2] > half * x[0] - kOnFace;
    a.face = !out ? (top ? kLid : kInterior) : end ? (top ? kCorner : kEdge) : (top ? kRim : kSide);
    return a;
  }

  // The same edge, seen from its other side.
  static Place across(Face face, const Place& a) {
    return {face,
            {kCosine * (a.n[0] + a.b[0]), kCosine * (a.n[1] + a.b[1])},
            {kCosine * (a.n[0] - a.b[0]), kCosine * (a.n[1] - a.b[1])}};
  }

  // Component of v along its nearest edge, times the length of (1, side, half).
  double along_nearest_edge(const double* v) const {
    const double x = std::abs(v[1]), y = std::abs(v[2]);
    return v[0] + half / kSin * std::max(std::max(x, y), kCosine * (x + y));
  }

  // Projection of v onto the plane of a face.
  void project(const Place& a, const double* v, double* x) const {
    if (a.face == kApex) {
      x[0] = x[1] = x[2] = 0.0;
    } else if (a.face == kInterior || a.face == kLid) {
      x[0] = a.face == kLid ? cap : v[0], x[1] = v[1], x[2] = v[2];
    } else {
      const double s = a.n[0] * v[1] + a.n[1] * v[2], q = a.b[0] * v[1] + a.b[1] * v[2];
      const double p = a.face == kSide   ? (v[0] + side * s) * along_side
                       : a.face == kEdge ? (v[0] + side * s + half * q) * along_edge
                                         : cap;
      const double outward = side * p, sideways = a.face == kSide || a.face == kRim ? q : half * p;
      x[0] = p, x[1] = outward * a.n[0] + sideways * a.b[0], x[2] = outward * a.n[1] + sideways * a.b[1];
    }
  }

  // Direction (1, side, half) of an edge.
  void edge(const Place& a, double* u) const {
    u[0] = 1.0, u[1] = side * a.n[0] + half * a.b[0], u[2] = side * a.n[1] + half * a.b[1];
  }

  // The step, in units of dx, with which a force x leaves its face, and where it then is.
  double step(const Place& a, const double* x, const double* dx, Place& next) const {
    double least = std::numeric_limits<double>::infinity();
    // Room that is left, and its decrease; `turned`: at the other end of the side.
    const auto meet = [&](double room, double decrease, Face face, bool turned = false) {
      if (!(decrease > 0)) return;
      const double t = std::max(room, 0.0) / decrease;
      if (t >= least) return;
      least = t, next = a, next.face = face;
      if (turned) next.b[0] = -a.b[0], next.b[1] = -a.b[1];
    };
    if (a.face == kEdge) meet(x[0], -dx[0], kApex);
    if (a.face == kSide || a.face == kRim) {
      const double q = a.b[0] * x[1] + a.b[1] * x[2], dq = a.b[0] * dx[1] + a.b[1] * dx[2];
      const Face end = a.face == kSide ? kEdge : kCorner;
      meet(half * x[0] - q, dq - half * dx[0], end);
      meet(half * x[0] + q, -dq - half * dx[0], end, true);
    }
    if (a.face == kInterior || a.face == kLid) {
      static constexpr double normals[8][2] = {{kCos, kSin},   {kSin, kCos},   {-kSin, kCos}, {-kCos, kSin},
                                               {-kCos, -kSin}, {-kSin, -kCos}, {kSin, -kCos}, {kCos, -kSin}};
      for (const auto& n : normals) {
        const double leaving = n[0] * dx[1] + n[1] * dx[2] - side * dx[0];
        if (!(leaving > 0)) continue;
        const double t = std::max(side * x[0] - n[0] * x[1] - n[1] * x[2], 0.0) / leaving;
        if (t < least) least = t, next = {a.face == kLid ? kRim : kSide, {n[0], n[1]}, {-n[1], n[0]}};
      }
    }
    if (a.face < kCorner) meet(cap - x[0], dx[0], a.face == kEdge ? kCorner : a.face == kSide ? kRim : kLid);
    return least;
  }

  // How much the most hindering constraint of a force x hinders it from going to v, as minus its multiplier with a
  // unit normal, and the face without this constraint.
  double pull(const Place& a, const double* v, const double* x, Place& next) const {
    const double r[3] = {v[0] - x[0], v[1] - x[1], v[2] - x[2]}, unit = std::sqrt(along_side);
    const auto outward = [&](const Place& at) { return at.n[0] * r[1] + at.n[1] * r[2]; };
    next = a;
    switch (a.face) {
      case kInterior:
        return 0.0;
      case kApex:
        return along_nearest_edge(v) * std::sqrt(along_edge);  // To its `nearest` edge.
      case kSide:
        next.face = kInterior;
        return (side * r[0] - outward(a)) * unit;
      case kEdge: {
        const Place other = across(kSide, a);
        const double h = outward(a) - side * r[0], k = outward(other) - side * r[0];
        const double first = h - cosine * k, second = k - cosine * h, scale = unit / (1.0 - cosine * cosine);
        if (first < second) next = other; else next.face = kSide;
        return -std::min(first, second) * scale;
      }
      case kLid:
        next.face = kInterior;
        return -r[0];
      case kRim: {
        const double first = outward(a), top = r[0] + side * first;
        next.face = first < top ? kLid : kSide;
        return -std::min(first, top);
      }
      case kCorner: {
        const Place other = across(kRim, a);
        const double h = outward(a), k = outward(other);
        const double first = 2.0 * (h - kCosine * k), second = 2.0 * (k - kCosine * h);
        const double top = r[0] + side * (first + second);
        if (top < first && top < second) {
          next.face = kEdge;
          return -top;
        }
        if (first < second) next = other; else next.face = kRim;
        return -std::min(first, second);
      }
    }
    return 0.0;
  }

  // The force across the sum of pressures, in units of v, at which the pressure of a force x at the apex or at the cap
  // is as good as free: at the apex it must not be below, at the cap not above.
  double threshold(const Place& a, const double* v, const double* x) const {
    if (a.face == kApex) return along_nearest_edge(v);
    const double r[3] = {v[0] - x[0], v[1] - x[1], v[2] - x[2]};
    const auto outward = [&](const Place& at) { return at.n[0] * r[1] + at.n[1] * r[2]; };
    if (a.face == kLid) return r[0];
    if (a.face == kRim) return r[0] + side * outward(a);
    return r[0] + side * 2.0 * (1.0 - kCosine) * (outward(a) + outward(across(kRim, a)));
  }
};

// The programs of one grasp. Memory is kept for the next one.
class ForceProgram {
 public:
  // Set the grasp map (C, R, 3).
  void prepare(const double* grasp_map, size_t contacts, size_t rows, const Pyramid& shape, double weight) {
    C = contacts, D = rows + 1, L = D * (D + 1) / 2, pyramid = &shape, ridge = weight;
    x.resize(3 * C), v.resize(3 * C), target.resize(3 * C), place.resize(C);
    z.resize(D), row.resize(D), S.resize(L);
    G.resize(3 * C * D), square.assign(C * L, 0.0), share.resize(C * (L + D));
    for (size_t c = 0; c < C; ++c)
      for (size_t k = 0; k < 3; ++k) {
        row[0] = k == 0;
        for (size_t r = 1; r < D; ++r) row[r] = grasp_map[(c * rows + r - 1) * 3 + k];
        for (size_t j = 0; j < D; ++j) G[j * 3 * C + 3 * c + k] = row[j];
        add(1.0, row.data(), &square[c * L]);
      }
  }

  // Start from the pushes that balance a load (R,) best, one after another.
  void start(const double* load) {
    double left = 1.0;
    std::fill(x.begin(), x.end(), 0.0);
    std::fill(place.begin(), place.end(), Pyramid::nearest(kApex, 0.0, 0.0));
    row[0] = 0.0;
    std::copy(load, load + D - 1, &row[1]);
    while (left > 1e-12) {
      size_t best = C;
      double least = std::numeric_limits<double>::infinity();
      const double push_of[3] = {std::min(left, pyramid->cap), 0.0, 0.0};
      for (size_t c = 0; c < C; ++c) {
        if (place[c].face != kApex) continue;
        z = row;
        push(c, push_of, z.data());
        double sum = 0.0;
        for (size_t j = 1; j < D; ++j) sum += z[j] * z[j];
        if (best == C || sum < least) best = c, least = sum;
      }
      if (best == C) break;
      push(best, push_of, row.data());
      x[3 * best] = push_of[0], left -= push_of[0];
      place[best].face = push_of[0] < pyramid->cap ? kInterior : kLid;
    }
    for (size_t c = 0; c < C; ++c) place_changed(c);
  }

  // Start from forces (C, 3) of another solution, with the same pyramids; false: they are none, and nothing is changed.
  bool start_from(const double* forces) {
    double sum = 0.0;
    for (size_t c = 0; c < C; ++c) {
      // Of a single contact the cap is higher than of several.
      if (forces[3 * c] > pyramid->cap + kOnFace) return false;
      sum += forces[3 * c];
    }
    if (!(std::abs(sum - 1.0) < kOnFace)) return false;
    for (size_t c = 0; c < C; ++c) {
      place[c] = pyramid->place_of(forces + 3 * c);
      pyramid->project(place[c], forces + 3 * c, &x[3 * c]);
      place_changed(c);
    }
    return true;
  }

  // Find the best forces under a load (R,), into (C, 3); false: not found.
  bool solve(const double* load, double* force) {
    const size_t usual = 50 + 10 * C;
    double tolerance = kTolerance;
    for (size_t count = 0; count < 4 * usual; ++count) {
      solve_planes(load);
      if (!advance()) continue;
      if (!release(tolerance)) return finish(load, force);
      if (count > usual) tolerance *= kGrowth;
    }
    return false;
  }

 private:
  size_t C, D, L;  // Contacts, unknowns of the linear system, numbers in a lower triangle of its matrix.
  const Pyramid* pyramid;
  double ridge;
  std::vector<Place> place;
  std::vector<double> x, v, target;  // (C, 3): forces, -G'^T z, and the best forces in the planes of the faces.
  std::vector<double> G;             // (D, C, 3): G'.
  std::vector<double> square;        // G'_c G'_c^T of each contact. Of symmetric matrices only lower triangles are kept.
  std::vector<double> share;         // G'_c J_c G'_c^T, then G'_c o_c, of each contact.
  std::vector<double> S, z, row;     // Cholesky factor, with reciprocals on the diagonal; (D,).

  // Add scale y y^T to a matrix.
  void add(double scale, const double* y, double* to) const {
    for (size_t i = 0; i < D; ++i) {
      const double part = scale * y[i];
      for (size_t j = 0; j <= i; ++j) *to++ += part * y[j];
    }
  }

  // Add G'_c f to y.
  void push(size_t c, const double* f, double* y) const {
    const double* g = &G[3 * c];
    for (size_t j = 0; j < D; ++j, g += 3 * C) y[j] += g[0] * f[0] + g[1] * f[1] + g[2] * f[2];
  }

  // v = -G'^T y.
  void pull_back(const double* y) {
    const size_t n = 3 * C;
    const double* __restrict g = G.data();
    double* __restrict to = v.data();
    for (size_t i = 0; i < n; ++i) to[i] = -y[0] * g[i];
    for (size_t j = 1; j < D; ++j) {
      const double scale = y[j];
      g += n;
      for (size_t i = 0; i < n; ++i) to[i] -= scale * g[i];
    }
  }

  // Compute the share of a contact in the linear system.
  void place_changed(size_t c) {
    const Place& a = place[c];
    double *matrix = &share[c * (L + D)], *offset = matrix + L;
    const bool plane = a.face == kSide || a.face == kInterior || a.face == kLid;
    if (plane)
      std::copy_n(&square[c * L], L, matrix);
    else
      std::fill_n(matrix, L, 0.0);
    std::fill_n(offset, D, 0.0);
    // Normal of the plane, or the direction of the line.
    double u[3] = {1.0, 0.0, 0.0}, squared = 1.0;
    if (a.face == kSide) u[0] = -pyramid->side, u[1] = a.n[0], u[2] = a.n[1], squared = 1.0 / pyramid->along_side;
    if (a.face == kEdge) pyramid->edge(a, u), squared = 1.0 / pyramid->along_edge;
    if (a.face == kRim) u[0] = 0.0, u[1] = a.b[0], u[2] = a.b[1];
    if (a.face != kApex && a.face != kInterior && a.face != kCorner) {
      std::fill(row.begin(), row.end(), 0.0);
      push(c, u, row.data());
      add((plane ? -1.0 : 1.0) / squared, row.data(), matrix);
    }
    if (a.face >= kCorner) {
      static constexpr double zero[3] = {0.0, 0.0, 0.0};
      pyramid->project(a, zero, u);
      push(c, u, offset);
    }
  }

  // Find z, and v, for the planes of the present faces.
  void solve_planes(const double* load) {
    std::fill(S.begin(), S.end(), 0.0);
    z[0] = -1.0;
    for (size_t r = 1; r < D; ++r) S[r * (r + 3) / 2] = ridge, z[r] = load[r - 1];
    for (size_t c = 0; c < C; ++c) {
      if (place[c].face == kApex) continue;
      const double* part = &share[c * (L + D)];
      for (size_t i = 0; i < L; ++i) S[i] += part[i];
      if (place[c].face < kCorner) continue;
      for (size_t j = 0; j < D; ++j) z[j] += part[L + j];
    }
    factor();
    backsolve(z.data());
    pull_back(z.data());
  }

  // Cholesky factor of S in place. Its pivots are at least the ridge; the first is 0 where no pressure is free.
  void factor() {
    double* at = S.data();
    for (size_t i = 0; i < D; at += ++i) {
      const double* other = S.data();
      for (size_t j = 0; j < i; other += ++j) {
        double sum = at[j];
        for (size_t k = 0; k < j; ++k) sum -= at[k] * other[k];
        at[j] = sum * other[j];
      }
      double pivot = at[i];
      for (size_t k = 0; k < i; ++k) pivot -= at[k] * at[k];
      at[i] = i ? 1.0 / std::sqrt(std::max(pivot, ridge)) : presses() ? 1.0 / std::sqrt(pivot) : 0.0;
    }
  }

  void backsolve(double* y) const {
    const double* at = S.data();
    for (size_t i = 0; i < D; at += ++i) {
      for (size_t k = 0; k < i; ++k) y[i] -= at[k] * y[k];
      y[i] *= at[i];
    }
    for (size_t i = D; i-- > 0;) {
      at -= i + 1;
      y[i] *= at[i];
      for (size_t k = 0; k < i; ++k) y[k] -= at[k] * y[i];
    }
  }

  // Whether any pressure is free.
  bool presses() const {
    return std::any_of(place.begin(), place.end(), [](const Place& a) { return kEdge <= a.face && a.face <= kInterior; });
  }

  // Go to the best forces in the present planes; false: a boundary was met first.
  bool advance() {
    double step = 1.0;
    size_t blocked = C;
    Place next, last;
    for (size_t c = 0; c < C; ++c) {
      const double* from = &x[3 * c];
      double* to = &target[3 * c];
      if (place[c].face == kApex || place[c].face == kCorner) {
        std::copy(from, from + 3, to);
        continue;
      }
      pyramid->project(place[c], &v[3 * c], to);
      const double dx[3] = {to[0] - from[0], to[1] - from[1], to[2] - from[2]};
      const double t = pyramid->step(place[c], from, dx, next);
      if (t < step) step = t, blocked = c, last = next;
    }
    if (blocked == C) {
      std::swap(x, target);
      return true;
    }
    for (size_t i = 0; i < 3 * C; ++i) x[i] += step * (target[i] - x[i]);
    place[blocked] = last;
    const double met[3] = {x[3 * blocked], x[3 * blocked + 1], x[3 * blocked + 2]};
    pyramid->project(last, met, &x[3 * blocked]);
    place_changed(blocked);
    return false;
  }

  // Leave the most hindering constraint; false: there is none.
  bool release(double tolerance) {
    double scale = 1.0;
    for (const double value : v) scale = std::max(scale, std::abs(value));
    double most = tolerance * scale;
    if (!presses()) {
      // The multiplier of the sum is any between those at which a pressure at the apex, or at the cap, is as good as free.
      double low = -std::numeric_limits<double>::infinity(), high = -low;
      size_t rising = C, falling = C;
      for (size_t c = 0; c < C; ++c) {
        const double t = pyramid->threshold(place[c], &v[3 * c], &x[3 * c]);
        if (place[c].face == kApex && t > low) low = t, rising = c;
        if (place[c].face != kApex && t < high) high = t, falling = c;
      }
      if (low > high + most) {
        place[rising] = Pyramid::nearest(kEdge, v[3 * rising + 1], v[3 * rising + 2]);
        Face& face = place[falling].face;
        face = face == kLid ? kInterior : face == kRim ? kSide : kEdge;
        place_changed(rising), place_changed(falling);
        return true;
      }
      const double middle = rising < C ? 0.5 * (low + high) : high - scale;
      for (size_t c = 0; c < C; ++c) v[3 * c] -= middle;
    }
    size_t which = C;
    Place next, last;
    for (size_t c = 0; c < C; ++c) {
      const double pull = pyramid->pull(place[c], &v[3 * c], &x[3 * c], next);
      if (pull > most) most = pull, which = c, last = next;
    }
    if (which == C) return false;
    if (last.face == kApex) last = Pyramid::nearest(kEdge, v[3 * which + 1], v[3 * which + 2]);
    place[which] = last;
    place_changed(which);
    return true;
  }

  // Remove most of the rounding of the solution, and return it; false: the load is not finite.
  bool finish(const double* load, double* force) {
    row[0] = -1.0;
    for (size_t r = 1; r < D; ++r) row[r] = load[r - 1] - ridge * z[r];
    for (size_t c = 0; c < C; ++c) push(c, &x[3 * c], row.data());
    backsolve(row.data());
    pull_back(row.data());
    bool finite = true;
    for (size_t c = 0; c < C; ++c) {
      for (size_t k = 3 * c; k < 3 * c + 3; ++k) target[k] = x[k] + v[k];
      pyramid->project(place[c], &target[3 * c], &x[3 * c]);
      for (size_t k = 3 * c; k < 3 * c + 3; ++k) force[k] = x[k], finite = finite && std::isfinite(target[k]);
    }
    return finite;
  }
};

}  // namespace grasp_refine
