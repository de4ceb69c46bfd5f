// Python module: shapes, the narrow phase, and witness queries for a batch of items on several threads.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/vector.h>

#include <coal/config.hh>

#include <optional>
#include <stdexcept>

#include "batch.h"
#include "search.h"

namespace grasp_refine {
void bind_bounded_step(nb::module_& m);
void bind_chain(nb::module_& m);
void bind_curvature(nb::module_& m);
void bind_face_patch(nb::module_& m);
void bind_forces(nb::module_& m);
void bind_products(nb::module_& m);
}  // namespace grasp_refine

using namespace grasp_refine;
using namespace nb::literals;

using RowMatrix = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

// The pose of body b in the frame of body a, from two (4, 4) poses in the world.
Transform3s relative(const double* a, const double* b) {
  Matrix3s R;
  Vec3s t;
  const Vec3s between(b[3] - a[3], b[7] - a[7], b[11] - a[11]);
  for (int c = 0; c < 3; ++c) {
    for (int k = 0; k < 3; ++k) R(c, k) = b[k] * a[c] + b[4 + k] * a[4 + c] + b[8 + k] * a[8 + c];
    t[c] = between[0] * a[c] + between[1] * a[4 + c] + between[2] * a[8 + c];
  }
  return Transform3s(R, t);
}

void check(bool fits) {
  if (!fits) throw std::invalid_argument("poses, limits and the last answer are for other items, or of other shapes");
}

struct Poses {
  const double *T_a, *T_b;  // (4, 4) each.

  Transform3s relative(size_t i) const { return ::relative(T_a + 16 * i, T_b + 16 * i); }
};

struct Previous {
  const int64_t* winner = nullptr;
  const double *point_a = nullptr, *point_b = nullptr;
  const int8_t* status = nullptr;

  Warm item(size_t i, const double* a) const {
    Warm warm;
    if (!winner) return warm;
    const double *p = point_a + 3 * i, *q = point_b + 3 * i;
    const Vec3s v(p[0] - q[0], p[1] - q[1], p[2] - q[2]);
    for (int c = 0; c < 3; ++c) warm.guess[c] = v[0] * a[c] + v[1] * a[4 + c] + v[2] * a[8 + c];
    warm.winner = winner[i];
    warm.apart = status[i] == kSeparated && warm.guess.allFinite();
    return warm;
  }
};

struct Answers {
  double *point_a, *point_b, *normal, *distance;
  int8_t* status;
  int64_t *winner, *num_queries;

  // Write world coordinates and a status, from the answer in the frame of body a.
  void write(size_t i, const Found& found, const double* a, bool finite, double limit) const {
    const int8_t code = !finite            ? kNotFinite
                        : found.failed     ? kFailed
                        : found.winner < 0 ? kFar
                                           : found.distance <= 0;
    const bool valid = code <= kPenetrating;
    for (int r = 0; r < 3; ++r) {
      const double *row = a + 4 * r, *x = found.point.data(), *n = found.normal.data();
      const double turned = row[0] * n[0] + row[1] * n[1] + row[2] * n[2];
      const double point = row[0] * x[0] + row[1] * x[1] + row[2] * x[2] + row[3];
      normal[3 * i + r] = valid ? turned : 0.0;
      point_a[3 * i + r] = valid ? point : 0.0;
      point_b[3 * i + r] = valid ? point + found.distance * turned : 0.0;
    }
    // FAR: no piece pair was, or can be, below the limit.
    distance[i] = valid ? found.distance : code == kFar ? limit : std::numeric_limits<double>::quiet_NaN();
    status[i] = code, winner[i] = found.winner, num_queries[i] = found.num_queries;
  }
};

// `query_items` of query.py; without `pair`, the items are all body pairs, repeated.
void query(const Search& search, std::optional<In<int64_t>> pair, In<double> T_a, In<double> T_b, In<double> limit,
           std::optional<In<int64_t>> winner, std::optional<In<double>> point_a, std::optional<In<double>> point_b,
           std::optional<In<int8_t>> status, Out<double> new_point_a, Out<double> new_point_b, Out<double> new_normal,
           Out<double> new_distance, Out<int8_t> new_status, Out<int64_t> new_winner, Out<int64_t> new_num_queries,
           int threads) {
  const Poses poses{T_a.data(), T_b.data()};
  const Answers answers{new_point_a.data(), new_point_b.data(), new_normal.data(), new_distance.data(),
                        new_status.data(),  new_winner.data(),  new_num_queries.data()};
  Previous previous;
  if (winner) previous = {winner->data(), point_a->data(), point_b->data(), status->data()};
  const size_t pairs = search.first_pair.size(), count = limit.size();
  const int64_t* listed = pair ? pair->data() : nullptr;
  const double* limits = limit.data();
  const auto pair_of = [=](size_t i) { return listed ? static_cast<size_t>(listed[i]) : i % pairs; };
  check(T_a.size() == 16 * count && T_b.size() == 16 * count && (!pair || pair->size() == count));
  check(!listed || std::all_of(listed, listed + count, [=](int64_t p) { return 0 <= p && p < int64_t(pairs); }));
  check(new_point_a.size() == 3 * count && new_point_b.size() == 3 * count && new_normal.size() == 3 * count);
  check(new_distance.size() == count && new_status.size() == count && new_winner.size() == count &&
        new_num_queries.size() == count);
  check(!winner || (winner->size() == count && point_a->size() == 3 * count && point_b->size() == 3 * count &&
                    status->size() == count));

  nb::gil_scoped_release without_the_gil;
  for_each(by_key(count, pairs, pair_of), threads, [&](size_t i) {
    thread_local Scratch scratch;
    const Transform3s T = poses.relative(i);
    const bool finite = T.getRotation().allFinite() && T.getTranslation().allFinite();
    const double* a = poses.T_a + 16 * i;
    Found found;
    if (finite)
      found = search.minimum(pair_of(i), T, limits[i], previous.item(i, a), scratch);
    answers.write(i, found, a, finite, limits[i]);
  });
}

// The queries of the items, in order, item by item: (item, piece pair) of each.
std::vector<std::pair<int64_t, int64_t>> trace(const Search& search, In<int64_t> pair, In<double> T_a, In<double> T_b,
                                               In<double> limit) {
  const Poses poses{T_a.data(), T_b.data()};
  std::vector<std::pair<int64_t, int64_t>> queries;
  for (size_t i = 0; i < limit.size(); ++i) {
    std::vector<Entry> entries;
    Scratch scratch;
    scratch.trace = &entries;
    search.minimum(pair.data()[i], poses.relative(i), limit.data()[i], Warm(), scratch);
    for (const Entry& entry : entries) queries.emplace_back(i, entry.pair);
  }
  return queries;
}

// Only the distances of piece pairs (N,) of items (N,): the queries that a search cannot avoid.
void distances(const NarrowPhase& narrow_phase, In<int64_t> item, In<int64_t> pair, In<double> T_a, In<double> T_b,
               Out<double> distance, int threads) {
  nb::gil_scoped_release without_the_gil;
  const Poses poses{T_a.data(), T_b.data()};
  for_each(in_order(item.size()), threads, [&](size_t k) {
    distance.data()[k] = narrow_phase.distance(pair.data()[k], poses.relative(item.data()[k]));
  });
}

Side side_of(In<int64_t> body, In<int64_t> first, In<double> center, In<double> half, In<double> axes,
             In<double> radius, In<double> supports, size_t cells) {
  Side side{list_of(body), list_of(first), {}, {}, {}, list_of(radius), supports.data(), supports.shape(1),
            supports.shape(2), cells, {}};
  for (size_t k = 0; k < radius.size(); ++k) {
    side.center.push_back(Eigen::Map<const Vec3s>(center.data() + 3 * k));
    side.half.push_back(Eigen::Map<const Vec3s>(half.data() + 3 * k));
    side.axes.push_back(Eigen::Map<const RowMatrix>(axes.data() + 9 * k));
  }
  side.enclose();
  return side;
}

using Shapes = std::vector<std::shared_ptr<Shape>>;

NarrowPhase narrow_phase_of(const Shapes& a, const Shapes& b, const std::vector<double>& unit, double gjk, double epa,
                            double retry, double slack) {
  NarrowPhase made{{}, {gjk, epa, retry, slack}};
  for (size_t k = 0; k < a.size(); ++k) made.pairs.push_back({a[k], b.at(k), unit.at(k)});
  return made;
}

NB_MODULE(_native, m) {
  // Pieces, and their shapes with them, may be alive at exit.
  nb::set_leak_warnings(false);
  m.attr("coal_version") = COAL_VERSION;
  m.attr("sources") = GRASP_REFINE_SOURCES;
#ifdef _OPENMP
  m.attr("openmp") = true;
#else
  m.attr("openmp") = false;
#endif

  nb::class_<Shape>(m, "Shape")
      .def_static("sphere", [](double radius, In<double> center) {
        return std::make_shared<Shape>(sphere(radius, Eigen::Map<const Vec3s>(center.data())));
      })
      .def_static("capsule", [](double radius, double length, In<double> frame, In<double> center) {
        const Matrix3s R = Eigen::Map<const RowMatrix>(frame.data());
        return std::make_shared<Shape>(capsule(radius, length, R, Eigen::Map<const Vec3s>(center.data())));
      })
      .def_static("hull", [](In<double> points, double radius) {
        return std::make_shared<Shape>(hull(points_of(points.data(), points.shape(0)), radius));
      })
      .def_static("polytope", [](In<double> points, In<int64_t> faces, double radius) {
        auto triangles = std::make_shared<std::vector<coal::Triangle>>();
        for (const int64_t* f = faces.data(); f != faces.data() + faces.size(); f += 3)
          triangles->emplace_back(f[0], f[1], f[2]);
        return std::make_shared<Shape>(polytope(points_of(points.data(), points.shape(0)), triangles, radius));
      })
      .def("set_core", [](Shape& shape, In<double> vertices, double radius) {
        const auto count = static_cast<Eigen::Index>(vertices.shape(1));
        shape.core.vertices = Eigen::Map<const decltype(Core::vertices)>(vertices.data(), count, 3);
        shape.core.radius = radius;
        shape.core.center =
            0.5 * (shape.core.vertices.colwise().minCoeff() + shape.core.vertices.colwise().maxCoeff()).transpose();
      });

  m.def("support", [](In<double> vertices, In<double> directions, Out<double> out) {
    check(vertices.size() % 3 == 0 && directions.size() == 3 * out.size());
    support(vertices.data(), vertices.size() / 3, directions.data(), out.size(), out.data());
  });

  nb::class_<NarrowPhase>(m, "NarrowPhase")
      .def("__init__", [](NarrowPhase* self, const Shapes& a, const Shapes& b, const std::vector<double>& unit,
                          double gjk, double epa, double retry, double slack) {
        new (self) NarrowPhase(narrow_phase_of(a, b, unit, gjk, epa, retry, slack));
      })
      .def("distances", &distances);

  nb::class_<Side>(m, "Side").def(
      "__init__",
      [](Side* self, In<int64_t> body, In<int64_t> first, In<double> center, In<double> half, In<double> axes,
         In<double> radius, In<double> supports, size_t cells) {
        new (self) Side(side_of(body, first, center, half, axes, radius, supports, cells));
      },
      // Keeps the table of supports alive, which is not copied.
      nb::keep_alive<1, 8>(), "body"_a, "first"_a, "center"_a, "half"_a, "axes"_a, "radius"_a,
      "supports"_a.noconvert(), "cells"_a);

  nb::class_<Search>(m, "Search")
      .def(
          "__init__",
          [](Search* self, const NarrowPhase& narrow_phase, const Side& a, const Side& b, In<int64_t> first_pair) {
            new (self) Search{narrow_phase, a, b, list_of(first_pair)};
          },
          nb::keep_alive<1, 3>(), nb::keep_alive<1, 4>())
      .def("query", &query, "pair"_a.none(), "T_a"_a, "T_b"_a, "limit"_a, "winner"_a.none(), "point_a"_a.none(),
           "point_b"_a.none(), "status"_a.none(), "new_point_a"_a.noconvert(), "new_point_b"_a.noconvert(),
           "new_normal"_a.noconvert(), "new_distance"_a.noconvert(), "new_status"_a.noconvert(),
           "new_winner"_a.noconvert(), "new_num_queries"_a.noconvert(), "threads"_a)
      .def("trace", &trace);

  bind_bounded_step(m);
  bind_chain(m);
  bind_curvature(m);
  bind_face_patch(m);
  bind_forces(m);
  bind_products(m);
}
