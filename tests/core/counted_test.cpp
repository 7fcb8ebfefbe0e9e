// SPDX-License-Identifier: Apache-2.0
#include "core/counted.h"

#include <cstdint>

#include <gtest/gtest.h>

namespace haarlight {
namespace {

TEST(Counted, OneIsSingularAndAllElseIsPlural) {
  EXPECT_EQ(counted(0, "light"), "0 lights");
  EXPECT_EQ(counted(1, "light"), "1 light");
  EXPECT_EQ(counted(std::uint64_t{1} << 40U, "light"), "1099511627776 lights");
  EXPECT_EQ(counted(-1, "step"), "-1 steps");
}

TEST(Counted, AnotherPluralIsTakenAsItIs) {
  EXPECT_EQ(counted(1, "mesh", "meshes"), "1 mesh");
  EXPECT_EQ(counted(2, "mesh", "meshes"), "2 meshes");
  EXPECT_EQ(counted(0, "face is", "faces are"), "0 faces are");
}

}  // namespace
}  // namespace haarlight
