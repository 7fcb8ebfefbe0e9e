// SPDX-License-Identifier: Apache-2.0
#include "core/pick_columns.h"

#include <vector>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"

namespace haarlight {
namespace {

std::vector<float> picked(const std::vector<float>& rows, std::size_t n_columns,
                          const std::vector<int>& columns) {
  std::vector<float> out(rows.size() / n_columns * columns.size());
  pick_columns(rows, n_columns, columns, out);
  return out;
}

TEST(PickColumns, InTheirOrderAndAsOftenAsNamed) {
  const std::vector<float> rows{1, 2, 3, 4, 5, 6};
  EXPECT_EQ(picked(rows, 3, {2, 0}), (std::vector<float>{3, 1, 6, 4}));
  EXPECT_EQ(picked(rows, 3, {1, 1, 2}), (std::vector<float>{2, 2, 3, 5, 5, 6}));
  EXPECT_EQ(picked(rows, 3, {0, 1, 2}), rows);
  EXPECT_TRUE(picked(rows, 3, {}).empty());
  EXPECT_TRUE(picked({}, 3, {1}).empty());
}

TEST(PickColumns, RefusesRoomOfAnotherSize) {
  std::vector<float> out(3);
  EXPECT_THROW(pick_columns(std::vector<float>{1, 2, 3, 4}, 2, std::vector<int>{1}, out),
               ContractViolation);
}

}  // namespace
}  // namespace haarlight
