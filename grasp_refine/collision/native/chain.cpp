// Forward kinematics of a batch of configurations, and covectors on joints, on several threads.
#include "chain.h"

#include <nanobind/stl/optional.h>

#include <optional>
#include <stdexcept>

#include "batch.h"

namespace grasp_refine {

namespace {

std::vector<Tree::Terms> terms_of(const In<double>& matrix) {
  std::vector<Tree::Terms> rows(matrix.shape(0));
  for (size_t r = 0; r < rows.size(); ++r)
    for (size_t c = 0; c < matrix.shape(1); ++c)
      if (const double factor = matrix.data()[r * matrix.shape(1) + c]; factor != 0) rows[r].emplace_back(c, factor);
  return rows;
}

void check_tree(bool fits) {
  if (!fits) throw std::invalid_argument("poses, joint values and rows are of other shapes, or of other links");
}

void forward(const Tree& tree, In<double> T_root, In<double> q, Out<double> T_link, Out<double> axes, int threads) {
  const size_t M = q.shape(0), L = tree.link_frame.size(), n = tree.columns();
  check_tree(q.size() == M * tree.dof && T_root.size() == 16 * M && T_link.size() == 16 * M * L &&
             axes.size() == 6 * M * n);
  nb::gil_scoped_release without_the_gil;
  for_each(in_order(M), threads, [&](size_t i) {
    thread_local Kinematics kinematics;
    kinematics.forward(tree, T_root.data() + 16 * i, q.data() + tree.dof * i, T_link.data() + 16 * L * i,
                       axes.data() + 6 * n * i);
  });
}

// `link` and `minus` are (R,), the same for all members, or (M, R).
void to_joints(const Tree& tree, In<double> axes, In<double> covector, In<int64_t> link,
               std::optional<In<int64_t>> minus, Out<double> out, int threads) {
  const size_t M = covector.shape(0), R = covector.shape(1), n = tree.columns(), u = tree.unknowns();
  const auto links = static_cast<int64_t>(tree.follows.size() / n);
  const auto known = [&](const In<int64_t>& index) {
    return (index.size() == R || index.size() == M * R) &&
           std::all_of(index.data(), index.data() + index.size(), [=](int64_t l) { return 0 <= l && l < links; });
  };
  check_tree(covector.size() == 6 * M * R && axes.size() == 6 * M * n && out.size() == M * R * u && known(link) &&
             (!minus || known(*minus)));
  nb::gil_scoped_release without_the_gil;
  for_each(in_order(M), threads, [&](size_t i) {
    thread_local Kinematics kinematics;
    const auto of = [&](const In<int64_t>& index, size_t r) { return index.data()[index.size() == R ? r : i * R + r]; };
    for (size_t r = 0; r < R; ++r)
      kinematics.to_joints(tree, axes.data() + 6 * n * i, covector.data() + 6 * (i * R + r), of(link, r),
                           minus ? of(*minus, r) : -1, out.data() + u * (i * R + r));
  });
}

}  // namespace

void bind_chain(nb::module_& m) {
  using namespace nb::literals;
  nb::class_<Tree>(m, "Tree")
      .def("__init__",
           [](Tree* self, In<double> values, In<double> offset, In<double> constant, In<double> of_cos,
              In<double> of_sin, In<double> of_value, In<int64_t> parent, In<int64_t> link_frame,
              In<double> T_frame_link, In<int64_t> column, In<uint8_t> slides, std::optional<In<int64_t>> leader,
              std::optional<In<double>> slope_offset, std::optional<In<double>> higher,
              std::optional<In<double>> gains, In<uint8_t> follows) {
             new (self) Tree{values.shape(1), offset.size(), terms_of(values), list_of(offset), list_of(constant),
                             list_of(of_cos), list_of(of_sin), list_of(of_value), list_of(parent),
                             list_of(link_frame), list_of(T_frame_link), list_of(column), list_of(slides),
                             leader ? list_of(*leader) : std::vector<int64_t>(),
                             slope_offset ? list_of(*slope_offset) : std::vector<double>(),
                             higher ? list_of(*higher) : std::vector<double>(),
                             gains ? terms_of(*gains) : std::vector<Tree::Terms>(), list_of(follows)};
           },
           "values"_a, "offset"_a, "constant"_a, "of_cos"_a, "of_sin"_a, "of_value"_a, "parent"_a, "link_frame"_a,
           "T_frame_link"_a, "column"_a, "slides"_a, "leader"_a.none(), "slope_offset"_a.none(), "higher"_a.none(),
           "gains"_a.none(), "follows"_a)
      .def("forward", &forward, "T_root"_a, "q"_a, "T_link"_a.noconvert(), "axes"_a.noconvert(), "threads"_a)
      .def("to_joints", &to_joints, "axes"_a, "covector"_a, "link"_a, "minus"_a.none(), "out"_a.noconvert(),
           "threads"_a);
}

}  // namespace grasp_refine
