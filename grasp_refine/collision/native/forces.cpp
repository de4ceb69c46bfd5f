// Contact forces of a batch of grasps, on several threads.
#include "forces.h"

#include <nanobind/stl/optional.h>

#include <optional>
#include <stdexcept>

#include "batch.h"

namespace grasp_refine {

namespace {

// The grasps of a batch, each under P loads.
struct Grasps {
  size_t contacts, rows, loads;
  const double* G;      // (N, K, R, 3)
  const bool* there;    // (N, K)
  const double* load;   // (N, P, R)
  const double* start;  // (N, P, K, 3), or null.
  double friction, share, ridge;
  double* force;        // (N, P, K, 3)
  bool* solved;         // (N, P)

  // The forces of grasp n; what is no contact has none.
  void solve(size_t n) const {
    thread_local ForceProgram program;
    thread_local std::vector<size_t> contact;
    thread_local std::vector<double> map, found;
    const size_t block = 3 * rows;
    contact.clear(), map.clear();
    for (size_t k = 0; k < contacts; ++k) {
      if (!there[n * contacts + k]) continue;
      contact.push_back(k);
      const double* from = G + (n * contacts + k) * block;
      map.insert(map.end(), from, from + block);
    }
    const size_t count = contact.size();
    std::fill_n(force + n * loads * contacts * 3, loads * contacts * 3, 0.0);
    std::fill_n(solved + n * loads, loads, false);
    if (!count) return;
    const Pyramid pyramid(friction, std::max(share, 1.0 / double(count)));
    found.resize(3 * count);
    program.prepare(map.data(), count, rows, pyramid, ridge);
    for (size_t p = 0; p < loads; ++p) {
      const double* w = load + (n * loads + p) * rows;
      bool started = false;
      if (start) {
        const double* from = start + (n * loads + p) * contacts * 3;
        for (size_t c = 0; c < count; ++c) std::copy_n(from + 3 * contact[c], 3, &found[3 * c]);
        started = program.start_from(found.data());
      }
      // Else they start where those of the last load are.
      if (!started && (p == 0 || !solved[n * loads + p - 1])) program.start(w);
      if (!program.solve(w, found.data())) continue;
      solved[n * loads + p] = true;
      double* to = force + (n * loads + p) * contacts * 3;
      for (size_t c = 0; c < count; ++c) std::copy_n(&found[3 * c], 3, to + 3 * contact[c]);
    }
  }
};

// `solve_programs` of programs.py.
void solve_forces(In<double> G, In<bool> there, In<double> load, std::optional<In<double>> start, double friction,
                  double share, double ridge, Out<double> force, Out<bool> solved, int threads) {
  const size_t N = G.shape(0), K = G.shape(1), R = G.shape(2), P = load.shape(1);
  if (there.size() != N * K || load.size() != N * P * R || force.size() != N * P * K * 3 || solved.size() != N * P ||
      (start && start->size() != force.size()))
    throw std::invalid_argument("forces, loads and contacts are of other shapes");
  const Grasps grasps{K, R, P, G.data(), there.data(), load.data(), start ? start->data() : nullptr,
                      friction, share, ridge, force.data(), solved.data()};

  nb::gil_scoped_release without_the_gil;
  for_each(in_order(N), threads, [&](size_t n) { grasps.solve(n); });
}

}  // namespace

void bind_forces(nb::module_& m) {
  using namespace nb::literals;
  m.def("solve_forces", &solve_forces, "G"_a, "there"_a, "load"_a, "start"_a.none(), "friction"_a, "share"_a, "ridge"_a,
        "force"_a.noconvert(), "solved"_a.noconvert(), "threads"_a);
}

}  // namespace grasp_refine
