// Bindings of curvatures and contact kinematics, for a batch of items on several threads.
#include "curvature.h"

#include <nanobind/stl/optional.h>
#include <nanobind/stl/vector.h>

#include <optional>
#include <stdexcept>

#include "batch.h"
#include "contact_kinematics.h"

namespace grasp_refine {

// The bodies' surfaces and pieces.
struct Bodies {
  std::vector<Surface> surfaces;
  std::vector<std::vector<Features>> pieces;
};

// Body pairs: the fields of `PairCurvatures`.
struct CurvaturePairs {
  const Bodies& bodies;
  std::vector<int64_t> body, first_piece_pair;  // (2 P,) and (P,).
  std::vector<double> floor, corner;            // (P,).

  size_t size() const { return floor.size(); }

  // Curvature of the first or second body of a pair at a witness point; `winner`: the closest piece pair, -1: none.
  Matrix2 curvature(size_t pair, bool second, const Spot& at, int64_t winner) const {
    const int64_t b = body[pair + second * size()];
    if (at.radius > 0) return bodies.surfaces[b].fit(at);
    if (winner < 0) return Matrix2::Zero();
    const auto others = static_cast<int64_t>(bodies.pieces[body[pair + size()]].size());
    const int64_t number = winner - first_piece_pair[pair];
    return bodies.pieces[b].at(second ? number % others : number / others).curvature(at, corner[pair]);
  }
};

namespace {

using RowTangents = Eigen::Matrix<double, 3, 2, Eigen::RowMajor>;
using RowMatrix26 = Eigen::Matrix<double, 2, 6, Eigen::RowMajor>;
using RowTransform = Eigen::Matrix<double, 4, 4, Eigen::RowMajor>;

void check(bool fits) {
  if (!fits) throw std::invalid_argument("poses, witness points or radii are of other items, or of other shapes");
}

// `PairCurvatures.fit_within`; a radius of 0 means the exact feature.
void fit(const CurvaturePairs& pairs, In<int64_t> pair, In<double> T_a, In<double> T_b, In<double> point_a,
         In<double> point_b, In<double> normal, In<double> E, In<double> radius, In<int64_t> winner, Out<double> K_a,
         Out<double> K_b, int threads) {
  const size_t count = pair.size();
  const auto known = [&](int64_t p) { return 0 <= p && p < static_cast<int64_t>(pairs.size()); };
  check(T_a.size() == 16 * count && T_b.size() == 16 * count && point_a.size() == 3 * count &&
        point_b.size() == 3 * count && normal.size() == 3 * count && E.size() == 6 * count &&
        radius.size() == 2 * count && winner.size() == count && K_a.size() == 4 * count && K_b.size() == 4 * count &&
        std::all_of(pair.data(), pair.data() + count, known));
  nb::gil_scoped_release without_the_gil;
  for_each(by_key(count, pairs.size(), [&](size_t i) { return pair.data()[i]; }), threads, [&](size_t i) {
    const auto p = static_cast<size_t>(pair.data()[i]);
    const Eigen::Map<const Vector3> n(normal.data() + 3 * i);
    const Eigen::Map<const RowTangents> tangents(E.data() + 6 * i);
    Matrix2 K[2];
    for (const bool second : {false, true}) {
      const Eigen::Map<const RowTransform> T((second ? T_b : T_a).data() + 16 * i);
      const Eigen::Matrix3d R = T.topLeftCorner<3, 3>().transpose();
      const Eigen::Map<const Vector3> point((second ? point_b : point_a).data() + 3 * i);
      const Spot at{R * (point - T.topRightCorner<3, 1>()), (second ? -1.0 : 1.0) * (R * n), R * tangents,
                    radius.data()[i + second * count]};
      K[second] = pairs.curvature(p, second, at, winner.data()[i]);
    }
    raise_eigenvalues(K[0], K[1], pairs.floor[p]);
    // Symmetric: rows or columns first is the same.
    Eigen::Map<Matrix2>(K_a.data() + 4 * i) = K[0];
    Eigen::Map<Matrix2>(K_b.data() + 4 * i) = K[1];
  });
}

// Witness pairs with their curvatures: arguments of `contact_kinematics`.
struct Contacts {
  const double *point_b, *normal, *distance, *E, *K_a, *K_b;
  size_t count;

  Contacts(const In<double>& point_b, const In<double>& normal, const In<double>& distance, const In<double>& E,
           const In<double>& K_a, const In<double>& K_b)
      : point_b(point_b.data()), normal(normal.data()), distance(distance.data()), E(E.data()), K_a(K_a.data()),
        K_b(K_b.data()), count(distance.size()) {
    check(point_b.size() == 3 * count && normal.size() == 3 * count && E.size() == 6 * count &&
          K_a.size() == 4 * count && K_b.size() == 4 * count);
  }

  Contact operator[](size_t i) const {
    return {vector(normal, i), vector(point_b, i), distance[i], Eigen::Map<const RowTangents>(E + 6 * i),
            Eigen::Map<const Matrix2>(K_a + 4 * i), Eigen::Map<const Matrix2>(K_b + 4 * i)};
  }

  static Eigen::Map<const Vector3> vector(const double* array, size_t i) {
    return Eigen::Map<const Vector3>(array + 3 * i);
  }
};

// Wrenches (M, 6) on both bodies from covectors on points and normals.
void pull_back(In<double> point_a, In<double> point_b, In<double> normal, In<double> distance, In<double> E,
               In<double> K_a, In<double> K_b, In<double> force_a, In<double> force_b,
               std::optional<In<double>> force_n, Out<double> wrench_a, Out<double> wrench_b) {
  const Contacts contacts(point_b, normal, distance, E, K_a, K_b);
  const size_t count = contacts.count;
  check(point_a.size() == 3 * count && force_a.size() == 3 * count && force_b.size() == 3 * count &&
        (!force_n || force_n->size() == 3 * count) && wrench_a.size() == 6 * count && wrench_b.size() == 6 * count);
  nb::gil_scoped_release without_the_gil;
  for (size_t i = 0; i < count; ++i) {
    const auto at = [i](const In<double>& array) { return Contacts::vector(array.data(), i); };
    const Vector3 on_normal = force_n ? Vector3(at(*force_n)) : Vector3::Zero();
    Vector6 a, b;
    contacts[i].pull_back(at(point_a), at(force_a), at(force_b), on_normal, a, b);
    Eigen::Map<Vector6>(wrench_a.data() + 6 * i) = a;
    Eigen::Map<Vector6>(wrench_b.data() + 6 * i) = b;
  }
}

// Jacobians U_a and U_b (M, 2, 6) of the slip of the witness points.
void slip_jacobians(In<double> point_b, In<double> normal, In<double> distance, In<double> E, In<double> K_a,
                    In<double> K_b, Out<double> U_a, Out<double> U_b) {
  const Contacts contacts(point_b, normal, distance, E, K_a, K_b);
  check(U_a.size() == 12 * contacts.count && U_b.size() == 12 * contacts.count);
  nb::gil_scoped_release without_the_gil;
  for (size_t i = 0; i < contacts.count; ++i) {
    Matrix26 a, b;
    contacts[i].slip_jacobians(a, b);
    Eigen::Map<RowMatrix26>(U_a.data() + 12 * i) = a;
    Eigen::Map<RowMatrix26>(U_b.data() + 12 * i) = b;
  }
}

Features features_of(In<double> vertices, In<double> normals, In<double> offsets, double radius) {
  const Eigen::Map<const Eigen::Matrix3Xd> corners(vertices.data(), 3, vertices.shape(0));
  Features made;
  made.radius = radius;
  made.size = 2.0 * (corners.colwise() - corners.rowwise().mean().eval()).colwise().norm().maxCoeff();
  made.normals = Eigen::Map<const Eigen::Matrix3Xd>(normals.data(), 3, normals.shape(0)).transpose();
  made.offsets = Eigen::Map<const Eigen::ArrayXd>(offsets.data(), offsets.size());
  if (corners.cols() <= 2) made.middle = corners.rowwise().mean();
  if (corners.cols() == 2) made.axis = (corners.col(1) - corners.col(0)) / made.size;
  return made;
}

}  // namespace

void bind_curvature(nb::module_& m) {
  using namespace nb::literals;
  nb::class_<Features>(m, "Features").def("__init__", [](Features* self, In<double> vertices, In<double> normals,
                                                         In<double> offsets, double radius) {
    new (self) Features(features_of(vertices, normals, offsets, radius));
  });
  nb::class_<Bodies>(m, "CurvedBodies")
      .def(nb::init<>())
      .def("add", [](Bodies& bodies, In<double> points, In<double> normals, double area,
                      const std::vector<Features>& pieces) {
        if (points.size() != normals.size() || points.shape(1) != 3)
          throw std::invalid_argument("points and normals have different shapes");
        bodies.surfaces.emplace_back(points.data(), normals.data(), points.shape(0), area);
        bodies.pieces.push_back(pieces);
      })
      .def("fit", [](const Bodies& bodies, In<int64_t> body, In<double> x, In<double> normal, In<double> E,
                     In<double> radius, Out<double> K, int threads) {
        const size_t count = body.size();
        const auto known = [&](int64_t b) { return 0 <= b && b < static_cast<int64_t>(bodies.surfaces.size()); };
        check(x.size() == 3 * count && normal.size() == 3 * count && E.size() == 6 * count && radius.size() == count &&
              K.size() == 4 * count && std::all_of(body.data(), body.data() + count, known));
        nb::gil_scoped_release without_the_gil;
        const auto key = [&](size_t i) { return body.data()[i]; };
        for_each(by_key(count, bodies.surfaces.size(), key), threads, [&](size_t i) {
          const Spot at{Eigen::Map<const Vector3>(x.data() + 3 * i), Eigen::Map<const Vector3>(normal.data() + 3 * i),
                        Eigen::Map<const RowTangents>(E.data() + 6 * i), radius.data()[i]};
          Eigen::Map<Matrix2>(K.data() + 4 * i) = bodies.surfaces[body.data()[i]].fit(at);
        });
      });
  nb::class_<CurvaturePairs>(m, "CurvaturePairs")
      .def(
          "__init__",
          [](CurvaturePairs* self, const Bodies& bodies, In<int64_t> body, In<int64_t> first_piece_pair,
             In<double> floor, In<double> corner) {
            new (self) CurvaturePairs{bodies, list_of(body), list_of(first_piece_pair), list_of(floor), list_of(corner)};
          },
          nb::keep_alive<1, 2>())
      .def("fit", &fit);
  m.def("pull_back", &pull_back, "point_a"_a, "point_b"_a, "normal"_a, "distance"_a, "E"_a, "K_a"_a, "K_b"_a,
        "force_a"_a, "force_b"_a, "force_n"_a.none(), "wrench_a"_a.noconvert(), "wrench_b"_a.noconvert());
  m.def("slip_jacobians", &slip_jacobians);
}

}  // namespace grasp_refine
