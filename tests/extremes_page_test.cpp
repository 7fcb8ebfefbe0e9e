// SPDX-License-Identifier: Apache-2.0
#include <cstdlib>
#include <fstream>
#include <sstream>
#include <string>

#include <gtest/gtest.h>

#include "tests/extremes.h"

namespace haarlight::extremes {
namespace {

constexpr const char* kPage = HAARLIGHT_SOURCE_DIR "/docs/numerics/extremes.md";

/// The first line in which the texts differ, of both.
std::string first_difference(const std::string& committed, const std::string& made) {
  std::istringstream a(committed);
  std::istringstream b(made);
  std::string line_a;
  std::string line_b;
  for (int number = 1;; ++number) {
    const bool has_a = static_cast<bool>(std::getline(a, line_a));
    const bool has_b = static_cast<bool>(std::getline(b, line_b));
    if (!has_a && !has_b) {
      return "";
    }
    if (has_a != has_b || line_a != line_b) {
      return "line " + std::to_string(number) + "\n- " + (has_a ? line_a : "(end)") + "\n+ " +
             (has_b ? line_b : "(end)");
    }
  }
}

TEST(ExtremesPage, EveryAlgorithmHasACellForEveryKind) {
  const Page page = make_page();
  EXPECT_EQ(page.missing, "");
}

TEST(ExtremesPage, IsWhatTheTestsFound) {
  const Page page = make_page();
  if (std::getenv("HAARLIGHT_UPDATE") != nullptr) {
    std::ofstream(kPage) << page.text;
  }
  std::ifstream file(kPage);
  std::stringstream committed;
  committed << file.rdbuf();
  EXPECT_EQ(first_difference(committed.str(), page.text), "")
      << "docs/numerics/extremes.md differs from what its tests found. If they are right:\n"
         "  HAARLIGHT_UPDATE=1 build/dev/tests/extremes_test\n"
         "and commit the page with the change.";
}

}  // namespace
}  // namespace haarlight::extremes
