// SPDX-License-Identifier: Apache-2.0
/// Files of version 2, written by the last program that did: they stay readable.
/// Provenance: tests/relight/basis/version2/*.hlb by commit db91f8f: `haarlight plate
/// configs/rigs/small8.toml --max-error 0.05`, and `haarlight compress --basis direct --plate
/// none` of tests/apps/programs.py's write_capture() with --max-error 0.02 and 0. The sums are
/// numpy's over what docs/reference/read_hlb.py of that commit read.

#include <cstring>

#include <gtest/gtest.h>

#include "haarlight/core/files.h"
#include "haarlight/relight/basis/basis_file.h"
#include "haarlight/relight/basis/relight.h"

namespace haarlight::relight {
namespace {

const std::string kFolder = HAARLIGHT_SOURCE_DIR "/tests/relight/basis/version2/";

struct Known {
  const char* name;
  double sum;
  double energy;
  double value;  ///< at (5, 3) under light 1
};

TEST(Version2, FilesAreReadAsTheyWere) {
  for (const Known& known :
       {Known{"plate.hlb", 633.0387529415116, 2.2350347298564395, 0.0014390912557555758},
        Known{"direct.hlb", 28.975187637527494, 3.9898192242336297, 0.09508563962195776},
        Known{"exact.hlb", 28.94763245806098, 3.981236537214392, 0.09530748426914215}}) {
    SCOPED_TRACE(known.name);
    const BasisFile basis = BasisFile::open(kFolder + known.name);
    EXPECT_FALSE(basis.header().clipped.has_value());  // nobody counted
    EXPECT_TRUE(basis.header().sections.empty());
    const MemoryStack stack = read_all(BasisSource(basis));
    double sum = 0.0;
    double energy = 0.0;
    for (const float v : stack.values()) {
      sum += double{v};
      energy += double{v} * double{v};
    }
    // 2^-22: decoding rounds coefficients and values to float.
    EXPECT_NEAR(sum, known.sum, 0x1p-22 * known.sum);
    EXPECT_NEAR(energy, known.energy, 0x1p-21 * known.energy);
    const auto n_lights = static_cast<std::size_t>(basis.header().dims.n_lights);
    const auto at =
        (std::size_t{5} * static_cast<std::size_t>(basis.header().dims.width) + 3) * n_lights +
        1;
    EXPECT_NEAR(double{stack.values()[at]}, known.value, 0x1p-22 * basis.header().peak);
  }
}

TEST(Version2, BoundIsTheOneOfThen) {
  const BasisFile basis = BasisFile::open(kFolder + "direct.hlb");
  LightWeights w = LightWeights::Zero(4, 1);
  w(1, 0) = 1.0;
  w(2, 0) = 0.5;
  const RelightBound bound = relight(basis, w).bound;
  EXPECT_NEAR(bound.relative_l2, 0.022064189678230015, 1e-12);  // that program's report
  EXPECT_FALSE(bound.clipped_fraction.has_value());
}

}  // namespace
}  // namespace haarlight::relight
