// Bindings of curvatures and contact kinematics, for a batch of items on several threads.
#include "curvature.h"

#include <nanobind/stl/optional.h>
#include <nanobind/stl/vector.h>

#include <optional>
#include <stdexcept>

#include "batch.h"
#include "contact_kinematics.h"
#include "search.h"

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

  // Curvatures of both bodies of a pair at witness points; `winner`: the closest piece pair, -1: none.
  std::pair<Matrix2, Matrix2> curvatures(size_t pair, const Spot& at_a, const Spot& at_b, int64_t winner) const {
    Matrix2 K_a = curvature(pair, false, at_a, winner), K_b = curvature(pair, true, at_b, winner);
    raise_eigenvalues(K_a, K_b, floor[pair]);
    return {K_a, K_b};
  }

 private:
  // Curvature of the first or second body.
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

Eigen::Map<const Vector3> vector(const double* array, size_t i) { return Eigen::Map<const Vector3>(array + 3 * i); }

// A witness point in the frame of a body; its outward normal is `sign` times the contact normal.
Spot spot(const double* pose, const Vector3& point, const Vector3& normal, double sign, const Tangents& E,
          double radius) {
  const Eigen::Map<const RowTransform> T(pose);
  const Eigen::Matrix3d R = T.topLeftCorner<3, 3>().transpose();
  return {R * (point - T.topRightCorner<3, 1>()), sign * (R * normal), R * E, radius};
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
    const auto [curved_a, curved_b] =
        pairs.curvatures(p, spot(T_a.data() + 16 * i, vector(point_a.data(), i), n, 1.0, tangents, radius.data()[i]),
                         spot(T_b.data() + 16 * i, vector(point_b.data(), i), n, -1.0, tangents, radius.data()[i + count]),
                         winner.data()[i]);
    // Symmetric: rows or columns first is the same.
    Eigen::Map<Matrix2>(K_a.data() + 4 * i) = curved_a;
    Eigen::Map<Matrix2>(K_b.data() + 4 * i) = curved_b;
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
    const auto at = [i](const In<double>& array) { return vector(array.data(), i); };
    const Vector3 on_normal = force_n ? Vector3(at(*force_n)) : Vector3::Zero();
    Vector6 a, b;
    contacts[i].pull_back(at(point_a), at(force_a), at(force_b), on_normal, a, b);
    Eigen::Map<Vector6>(wrench_a.data() + 6 * i) = a;
    Eigen::Map<Vector6>(wrench_b.data() + 6 * i) = b;
  }
}

// As `se3.ambient_gradient`.
void write_gradient(const double* pose, const Vector6& wrench, double* out) {
  const Eigen::Map<const RowTransform> T(pose);
  const Vector3 force = wrench.head<3>(), position = T.topRightCorner<3, 1>();
  const Vector3 moment = wrench.tail<3>() - position.cross(force);
  Eigen::Map<RowTransform> G(out);
  for (int c = 0; c < 3; ++c) G.block<3, 1>(0, c) = 0.5 * moment.cross(T.block<3, 1>(0, c));
  G.topRightCorner<3, 1>() = force;
  G.row(3).setZero();
}

// `ContactKinematics.pose_gradients`: items are all body pairs, repeated.
void pose_gradients(const CurvaturePairs& pairs, In<double> T_a, In<double> T_b, In<double> point_a, In<double> point_b,
                    In<double> normal, In<double> distance, In<int8_t> status, In<int64_t> winner, In<double> radius,
                    std::optional<In<double>> force_a, std::optional<In<double>> force_b,
                    std::optional<In<double>> force_n, std::optional<In<double>> force_d, Out<double> G_a,
                    Out<double> G_b, int threads) {
  const size_t count = distance.size(), size = pairs.size(), rows = count / size;
  const auto fits = [](const std::optional<In<double>>& force, size_t wanted) {
    return !force || force->size() == wanted;
  };
  // One radius a body, or one a witness point.
  const size_t radii = radius.size() / (2 * size);
  check(count == rows * size && (radii == 1 || radii == rows) && radius.size() == 2 * size * radii &&
        T_a.size() == 16 * count && T_b.size() == 16 * count && point_a.size() == 3 * count &&
        point_b.size() == 3 * count && normal.size() == 3 * count && status.size() == count &&
        winner.size() == count && fits(force_a, 3 * count) && fits(force_b, 3 * count) && fits(force_n, 3 * count) &&
        fits(force_d, count) && G_a.size() == 16 * count && G_b.size() == 16 * count);
  nb::gil_scoped_release without_the_gil;
  for_each(by_key(count, size, [=](size_t i) { return i % size; }), threads, [&](size_t i) {
    const auto covector = [i](const std::optional<In<double>>& force) {
      return force ? Vector3(vector(force->data(), i)) : Vector3::Zero();
    };
    double *const moved_a = G_a.data() + 16 * i, *const moved_b = G_b.data() + 16 * i;
    if (status.data()[i] > kPenetrating) {
      std::fill_n(moved_a, 16, 0.0), std::fill_n(moved_b, 16, 0.0);
      return;
    }
    Vector6 on_a = Vector6::Zero(), on_b = Vector6::Zero();
    const Vector3 f_a = covector(force_a), f_b = covector(force_b), f_n = covector(force_n);
    const Vector3 x_a = vector(point_a.data(), i), x_b = vector(point_b.data(), i), n = vector(normal.data(), i);
    // Without covectors on points and normal, the curvatures do not matter.
    if (!(f_a.isZero(0) && f_b.isZero(0) && f_n.isZero(0))) {
      const size_t p = i % size, row = radii == 1 ? 0 : i / size;
      const Tangents E = tangents_of(n);
      const auto [K_a, K_b] =
          pairs.curvatures(p, spot(T_a.data() + 16 * i, x_a, n, 1.0, E, radius.data()[p * radii + row]),
                           spot(T_b.data() + 16 * i, x_b, n, -1.0, E, radius.data()[(size + p) * radii + row]),
                           winner.data()[i]);
      Contact(n, x_b, distance.data()[i], E, K_a, K_b).pull_back(x_a, f_a, f_b, f_n, on_a, on_b);
    }
    if (force_d) {
      // Both witness points lie on the line of the normal, so the bodies get equal and opposite wrenches.
      const Vector3 force = force_d->data()[i] * n, moment = x_b.cross(force);
      on_a.head<3>() -= force, on_a.tail<3>() -= moment;
      on_b.head<3>() += force, on_b.tail<3>() += moment;
    }
    write_gradient(T_a.data() + 16 * i, on_a, moved_a);
    write_gradient(T_b.data() + 16 * i, on_b, moved_b);
  });
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
      .def("fit", &fit)
      .def("pose_gradients", &pose_gradients, "T_a"_a, "T_b"_a, "point_a"_a, "point_b"_a, "normal"_a, "distance"_a,
           "status"_a, "winner"_a, "radius"_a, "force_a"_a.none(), "force_b"_a.none(), "force_n"_a.none(),
           "force_d"_a.none(), "G_a"_a.noconvert(), "G_b"_a.noconvert(), "threads"_a);
  m.def("pull_back", &pull_back, "point_a"_a, "point_b"_a, "normal"_a, "distance"_a, "E"_a, "K_a"_a, "K_b"_a,
        "force_a"_a, "force_b"_a, "force_n"_a.none(), "wrench_a"_a.noconvert(), "wrench_b"_a.noconvert());
  m.def("slip_jacobians", &slip_jacobians);
}

}  // namespace grasp_refine
