// Products of matrices whose sums run in order: zeros between the terms, and other rows, change no bit of them.
#include <stdexcept>

#include "batch.h"

namespace grasp_refine {

namespace {

// out (N, R, U) = A (N, R, K) B (N, K, U).
void products(In<double> A, In<double> B, Out<double> out, int threads) {
  const size_t N = A.shape(0), R = A.shape(1), K = A.shape(2), U = B.shape(2);
  if (B.shape(0) != N || B.shape(1) != K || out.size() != N * R * U)
    throw std::invalid_argument("matrices are of other shapes");
  nb::gil_scoped_release without_the_gil;
  for_each(in_order(N), threads, [&](size_t n) {
    for (size_t r = 0; r < R; ++r) {
      double* sums = out.data() + U * (n * R + r);
      std::fill_n(sums, U, 0.0);
      for (size_t k = 0; k < K; ++k) {
        const double factor = A.data()[(n * R + r) * K + k];
        if (factor == 0) continue;
        const double* row = B.data() + U * (n * K + k);
        for (size_t u = 0; u < U; ++u) sums[u] += factor * row[u];
      }
    }
  });
}

}  // namespace

void bind_products(nb::module_& m) {
  using namespace nb::literals;
  m.def("products", &products, "A"_a, "B"_a, "out"_a.noconvert(), "threads"_a);
}

}  // namespace grasp_refine
