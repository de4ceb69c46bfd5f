// Arrays of a batch of items, and the loop over its items on several threads.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <unistd.h>

#include <exception>
#include <mutex>
#include <numeric>
#include <vector>

namespace grasp_refine {

namespace nb = nanobind;

template <class T>
using In = nb::ndarray<const T, nb::c_contig, nb::device::cpu>;
template <class T>
using Out = nb::ndarray<T, nb::c_contig, nb::device::cpu>;

template <class T>
std::vector<T> list_of(const In<T>& array) {
  return {array.data(), array.data() + array.size()};
}

// The process that loaded this module. A fork of it has lost the threads of OpenMP and would wait for them for ever.
inline const pid_t kProcess = getpid();

// Call work(i) for all i of `order` on several threads; the first error is thrown.
template <class Work>
void for_each(const std::vector<size_t>& order, int threads, const Work& work) {
  if (getpid() != kProcess) threads = 1;
  std::exception_ptr error;
  std::mutex guard;
  const auto count = static_cast<int64_t>(order.size());
#pragma omp parallel for schedule(dynamic, 16) num_threads(threads) if (threads > 1)
  for (int64_t k = 0; k < count; ++k) {
    try {
      work(order[k]);
    } catch (...) {
      std::lock_guard<std::mutex> lock(guard);
      if (!error) error = std::current_exception();
    }
  }
  if (error) std::rethrow_exception(error);
}

// Items in their order.
inline std::vector<size_t> in_order(size_t count) {
  std::vector<size_t> order(count);
  std::iota(order.begin(), order.end(), 0);
  return order;
}

// Items of equal keys follow each other, so that their pieces stay in the processor's cache.
template <class Key>
std::vector<size_t> by_key(size_t count, size_t keys, const Key& key) {
  std::vector<size_t> start(keys + 1), order(count);
  for (size_t i = 0; i < count; ++i) ++start[key(i) + 1];
  std::partial_sum(start.begin(), start.end(), start.begin());
  for (size_t i = 0; i < count; ++i) order[start[key(i)]++] = i;
  return order;
}

}  // namespace grasp_refine
