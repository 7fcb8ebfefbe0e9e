// SPDX-License-Identifier: Apache-2.0
#include "core/report.h"

#include <limits>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "haarlight/core/files.h"
#include "tests/temporary_folder.h"

namespace haarlight {
namespace {

TEST(Report, HasTheFieldsOfItsSchema) {
  Report report("relight");
  report.add_input("a.hlb");
  report.add_requested("max_error", 0.01);
  report.add_achieved("relative_l2", 0.008);
  report.add_achieved("psnr_db", std::numeric_limits<double>::infinity());
  report.add_detail("lights", std::vector<double>{1, 2});
  report.set_bytes(77);
  const testing::TemporaryFolder folder;
  report.write(folder / "r.json");
  const auto json = nlohmann::json::parse(read_file(folder / "r.json"));
  const auto schema = nlohmann::json::parse(
      read_file(HAARLIGHT_SOURCE_DIR "/docs/reference/report.schema.json"));
  for (const auto& key : schema["required"]) {
    EXPECT_TRUE(json.contains(key.get<std::string>())) << key;
  }
  for (const auto& [key, value] : json.items()) {
    EXPECT_TRUE(schema["properties"].contains(key)) << key;
  }
  EXPECT_EQ(json["asked"]["max_error"], 0.01);
  EXPECT_TRUE(json["reached"]["psnr_db"].is_null());
  EXPECT_EQ(json["bytes"], 77);
  EXPECT_GT(json["peak_memory_bytes"], 1'000'000);
}

}  // namespace
}  // namespace haarlight
