// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <initializer_list>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"

/// @file
/// Files that a reader of meshes must refuse.

namespace haarlight::render::test {

/// Each is an Error(bad_input) at `where` that has `what` in its text, and a hint.
/// @param parse  reads one of them
/// @return       how many there were
template <class Broken, class Parse>
std::size_t expect_refused(std::initializer_list<std::vector<Broken>> lists,
                           const Parse& parse) {
  std::size_t n_broken = 0;
  for (const std::vector<Broken>& list : lists) {
    for (const Broken& item : list) {
      ++n_broken;
      try {
        parse(item);
        ADD_FAILURE() << "read: " << item.what;
      } catch (const Error& error) {
        EXPECT_EQ(error.where(), item.where) << error.what();
        EXPECT_THAT(error.problem(), ::testing::HasSubstr(item.what));
        EXPECT_FALSE(error.hint().empty()) << item.what;
        EXPECT_EQ(error.code(), ExitCode::bad_input);
      }
    }
  }
  return n_broken;
}

}  // namespace haarlight::render::test
