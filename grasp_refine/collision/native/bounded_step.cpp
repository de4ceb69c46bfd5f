// Steps of damped least squares of a batch of members.
#include "bounded_step.h"

#include <nanobind/stl/optional.h>

#include <optional>
#include <stdexcept>

#include "batch.h"

namespace grasp_refine {

namespace {

void bounded_steps(In<double> J, In<double> r, In<double> damping, In<double> metric, In<double> lower,
                   In<double> upper, std::optional<In<bool>> unilateral, int passes, Out<double> dx,
                   Out<double> predicted, int threads) {
  const size_t M = damping.size(), m = J.shape(1), n = J.shape(2);
  if (J.shape(0) != M || r.size() != M * m || metric.size() != M * n || lower.size() != M * n ||
      upper.size() != M * n || dx.size() != M * n || predicted.size() != M || (unilateral && unilateral->size() != M * m))
    throw std::invalid_argument("residuals, derivatives and bounds are of other shapes");
  nb::gil_scoped_release without_the_gil;
  for_each(in_order(M), threads, [&](size_t k) {
    thread_local BoundedStep step;
    using Values = BoundedStep::Values;
    const auto values = [&](const In<double>& array, size_t size) { return Values(array.data() + k * size, size); };
    Eigen::Map<Eigen::VectorXd> out(dx.data() + k * n, n);
    predicted.data()[k] =
        step.solve(BoundedStep::Rows(J.data() + k * m * n, m, n), values(r, m), damping.data()[k], values(metric, n),
                   values(lower, n), values(upper, n), unilateral ? unilateral->data() + k * m : nullptr, passes, out);
  });
}

}  // namespace

void bind_bounded_step(nb::module_& m) {
  using namespace nb::literals;
  m.def("bounded_steps", &bounded_steps, "J"_a, "r"_a, "damping"_a, "metric"_a, "lower"_a, "upper"_a,
        "unilateral"_a.none(), "passes"_a, "dx"_a.noconvert(), "predicted"_a.noconvert(), "threads"_a);
}

}  // namespace grasp_refine
