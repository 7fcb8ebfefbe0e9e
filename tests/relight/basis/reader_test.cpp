// SPDX-License-Identifier: Apache-2.0
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <string>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "haarlight/core/files.h"
#include "haarlight/relight/basis/compress.h"
#include "haarlight/relight/basis/compress_session.h"
#include "tests/relight/basis/cropped_rig.h"
#include "tests/relight/basis/made_stack.h"
#include "tests/session/small_session.h"

/// docs/reference/read_hlb.py, written from docs/reference/basis-format.md alone, must read
/// what we write.

namespace haarlight::relight {
namespace {

using test::made_source;
using test::make_stack;

class NumpyReader : public testing::Test {
 protected:
  void SetUp() override {
    if (std::system("/usr/bin/python3 -c 'import numpy' 2>/dev/null") != 0) {
      GTEST_SKIP() << "needs /usr/bin/python3 with numpy (Debian: python3-numpy)";
    }
  }

  /// Largest difference between numpy's array and our own decoding, as a fraction of the peak.
  double compare_with_numpy(const CompressSource& source, const CompressOptions& options) {
    const auto hlb = folder_.path() / "a.hlb";
    (void)compress_stack(source, hlb, options);
    return compare_file_with_numpy(hlb);
  }

  double compare_file_with_numpy(const std::filesystem::path& hlb) {
    const auto npy = folder_.path() / "a.npy";
    const std::string command =
        fmt::format("/usr/bin/python3 {}/docs/reference/read_hlb.py {} {}",
                    HAARLIGHT_SOURCE_DIR, hlb.string(), npy.string());
    EXPECT_EQ(std::system(command.c_str()), 0);
    const MemoryStack own = read_all(BasisSource(BasisFile::open(hlb)));
    const std::string bytes = read_file(npy);
    const std::size_t n = own.values().size();
    if (bytes.size() < n * sizeof(double)) {
      ADD_FAILURE() << "numpy wrote " << bytes.size() << " bytes";
      return 1.0;
    }
    const char* data = bytes.data() + (bytes.size() - n * sizeof(double));
    double worst = 0.0;
    double peak = 0.0;
    for (std::size_t i = 0; i < n; ++i) {
      double value = 0.0;
      std::memcpy(&value, data + i * sizeof(double), sizeof(double));
      worst = std::max(worst, std::abs(value - double{own.values()[i]}));
      peak = std::max(peak, std::abs(value));
    }
    return worst / peak;
  }

  test::TemporaryFolder folder_;
};

TEST_F(NumpyReader, ReadsTheFileOfAComputedPlate) {
  const auto hlb = folder_.path() / "plate.hlb";
  const CompressSummary made = compress_plate(test::cropped_rig(), hlb, {.relative_l2 = 1e-3});
  EXPECT_GT(made.n_checked, 0);
  EXPECT_LT(compare_file_with_numpy(hlb), 1e-6);
}

TEST_F(NumpyReader, ReadsHaarWithPlateAndPixelShifts) {
  const MemoryStack stack = make_stack({.channels = 3});
  const MemoryStack plate = make_stack({.has_sphere = false});
  // Ours is float, numpy's double.
  EXPECT_LE(compare_with_numpy(made_source(stack, 16, &plate), {.worst_pixel = 0.03}), 1e-6);
}

TEST_F(NumpyReader, ReadsUnbalancedGrids) {
  const MemoryStack stack = make_stack({.grid = 7, .rows = 5});
  const MemoryStack plate = make_stack({.grid = 7, .has_sphere = false, .rows = 5});
  CompressSource source = made_source(stack, HaarGrid{5, 7}, &plate);
  EXPECT_LE(compare_with_numpy(source, {}), 1e-6);
  EXPECT_EQ(compare_with_numpy(source, {.relative_l2 = 0.0}), 0.0);
  source.units.assign(35, 1.0 / 6000.0);
  EXPECT_EQ(compare_with_numpy(source, {.is_integer = true}), 0.0);
}

TEST_F(NumpyReader, ReadsSeveralUnbalancedGridsAndRows) {
  const MemoryStack one = make_stack({.grid = 10, .rows = 6});
  MemoryStack stack({40, 36, 1, 60}, {one.values().begin(), one.values().end()});
  for (const HaarGrid grid : {HaarGrid{3, 5}, {30, 1}, {1, 60}, {17, 30}}) {
    if (stack.dims().n_lights % grid.size() != 0) {
      stack = make_stack({.width = 12, .height = 10, .grid = grid.cols, .rows = grid.rows});
    }
    EXPECT_LE(compare_with_numpy(made_source(stack, grid), {}), 1e-6)
        << grid.rows << " x " << grid.cols;
  }
}

TEST_F(NumpyReader, ReadsSeveralGrids) {
  const MemoryStack one = make_stack({.grid = 16});
  MemoryStack stack({40, 36, 1, 256}, {one.values().begin(), one.values().end()});
  EXPECT_LE(compare_with_numpy(made_source(stack, 8), {}), 1e-6);  // four grids of 8 x 8
}

TEST_F(NumpyReader, ReadsLossless) {
  const MemoryStack stack = make_stack({.width = 35, .noise = 0.01});
  EXPECT_EQ(compare_with_numpy(made_source(stack, 16), {.relative_l2 = 0.0}), 0.0);
}

TEST_F(NumpyReader, ReadsWholeStepsToTheBit) {
  const MemoryStack stack = make_stack({.width = 35, .channels = 3, .noise = 0.02});
  const MemoryStack plate = make_stack({.width = 35, .has_sphere = false});
  CompressSource source = made_source(stack, 16, &plate);
  source.units.assign(256, 1.0 / 6000.0);
  EXPECT_EQ(compare_with_numpy(source, {.is_integer = true}), 0.0);
}

TEST_F(NumpyReader, ReadsTheDctOfAnyGrid) {
  const MemoryStack stack = make_stack({.grid = 7, .rows = 5});
  const MemoryStack plate = make_stack({.grid = 7, .has_sphere = false, .rows = 5});
  const CompressSource source = made_source(stack, HaarGrid{5, 7}, &plate);
  const CompressOptions options{.worst_pixel = 0.03, .basis = BasisKind::dct};
  EXPECT_LE(compare_with_numpy(source, options), 1e-6);
  EXPECT_EQ(compare_with_numpy(source, {.relative_l2 = 0.0, .basis = BasisKind::dct}), 0.0);
  const MemoryStack large = make_stack({.width = 12, .height = 10, .grid = 17, .rows = 30});
  EXPECT_LE(compare_with_numpy(made_source(large, HaarGrid{30, 17}), {.basis = BasisKind::dct}),
            1e-6);
}

TEST_F(NumpyReader, ReadsStandardHaarAndSeveralGrids) {
  const MemoryStack one = make_stack({.grid = 16});
  const MemoryStack stack({40, 36, 1, 256}, {one.values().begin(), one.values().end()});
  for (const BasisKind kind : {BasisKind::haar_standard, BasisKind::dct}) {
    for (const HaarGrid grid : {HaarGrid{16, 16}, {8, 8}, {4, 16}, {1, 128}}) {
      EXPECT_LE(compare_with_numpy(made_source(stack, grid), {.basis = kind}), 1e-6)
          << to_string(kind) << " " << grid.rows << " x " << grid.cols;
    }
  }
}

TEST_F(NumpyReader, ReadsDirect) {
  const MemoryStack stack = make_stack({.width = 33, .height = 34, .grid = 8});
  const MemoryStack plate =
      make_stack({.width = 33, .height = 34, .grid = 8, .has_sphere = false});
  EXPECT_LE(compare_with_numpy(made_source(stack, 0, &plate), {.basis = BasisKind::direct}),
            1e-6);
}

}  // namespace
}  // namespace haarlight::relight
