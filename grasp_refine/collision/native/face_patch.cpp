// Patches of a batch of contacts, on several threads.
#include "face_patch.h"

#include <stdexcept>

#include "batch.h"

namespace grasp_refine {

namespace {

void face_patches(In<int64_t> link, In<int64_t> number, In<double> T, In<double> point_a, In<double> point_b, In<double> n,
                  In<int64_t> first_face_a, In<double> normal_a, In<double> offset_a, In<int64_t> first_polygon_a,
                  In<int64_t> first_vertex_a, In<double> vertices_a, In<int64_t> first_face_b, In<double> normal_b,
                  In<double> offset_b, In<int64_t> first_polygon_b, In<int64_t> first_vertex_b, In<double> vertices_b,
                  double cos_tilt, double near, double min_extent, double min_width, Out<int64_t> count,
                  Out<double> normal, Out<double> cosine, Out<double> extent, Out<double> point, Out<double> gap,
                  Out<double> motion, Out<double> slope, int threads) {
  const size_t M = link.size();
  if (number.size() != M || T.size() != 16 * M || point_a.size() != 3 * M || point_b.size() != 3 * M || n.size() != 3 * M ||
      count.size() != M || normal.size() != 3 * M || cosine.size() != M || extent.size() != M ||
      point.size() != 12 * M || gap.size() != 4 * M || motion.size() != 72 * M || slope.size() != 24 * M)
    throw std::invalid_argument("contacts and patches are of other shapes");
  const FaceTable a{first_face_a.data(), normal_a.data(), offset_a.data(), first_polygon_a.data(), first_vertex_a.data(),
                    vertices_a.data()};
  const FaceTable b{first_face_b.data(), normal_b.data(), offset_b.data(), first_polygon_b.data(), first_vertex_b.data(),
                    vertices_b.data()};
  const PatchLimits limits{cos_tilt, near, min_extent, min_width};
  nb::gil_scoped_release without_the_gil;
  for_each(in_order(M), threads, [&](size_t i) {
    thread_local PatchFinder finder;
    thread_local Patch patch;
    using Row = Eigen::Matrix<double, 4, 4, Eigen::RowMajor>;
    const Eigen::Matrix4d pose = Eigen::Map<const Row>(T.data() + 16 * i);
    const auto vector = [&](const In<double>& array) { return Eigen::Vector3d(array.data() + 3 * i); };
    finder.find(a, link.data()[i], pose, b, number.data()[i], vector(point_a), vector(point_b), vector(n), limits, patch);
    count.data()[i] = patch.count;
    if (!patch.count) return;
    std::copy_n(patch.normal.data(), 3, normal.data() + 3 * i);
    cosine.data()[i] = patch.cosine, extent.data()[i] = patch.extent;
    for (int k = 0; k < patch.count; ++k) {
      std::copy_n(patch.point[k].data(), 3, point.data() + 12 * i + 3 * k);
      gap.data()[4 * i + k] = patch.gap[k];
      std::copy_n(patch.motion[k].data(), 18, motion.data() + 72 * i + 18 * k);
      std::copy_n(patch.slope[k].data(), 6, slope.data() + 24 * i + 6 * k);
    }
  });
}

}  // namespace

void bind_face_patch(nb::module_& m) { m.def("face_patches", &face_patches); }

}  // namespace grasp_refine
