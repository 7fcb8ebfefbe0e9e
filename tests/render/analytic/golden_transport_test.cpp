// SPDX-License-Identifier: Apache-2.0
/// @file
/// Closed forms against tests/golden/transport.json, by its tiers: 1e-10 relative in normal cases, 1e-6
/// in extreme ones, where plain double code loses every digit.

#include <optional>
#include <string>

#include <gtest/gtest.h>

#include "render/analytic/disk_light.h"
#include "render/analytic/form_factor.h"
#include "tests/golden_file.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;

double number(const nlohmann::json& value) {
  return value.is_string() ? std::stod(value.get<std::string>()) : value.get<double>();
}

Vector3d vector_of(const nlohmann::json& value) {
  return {number(value[0]), number(value[1]), number(value[2])};
}

/// Nothing known: other tests have the other kinds.
std::optional<double> computed(const std::string& kind, const nlohmann::json& geometry) {
  const auto at = [&geometry](const char* key) { return number(geometry.at(key)); };
  if (kind.starts_with("disk_emitter_irradiance")) {
    return disk_irradiance({.centre = vector_of(geometry["disk_centre"]),
                            .normal = vector_of(geometry["disk_normal"]),
                            .radius_mm = at("disk_radius")},
                           vector_of(geometry["receiver"]),
                           vector_of(geometry["receiver_normal"]));
  }
  if (kind == "form_factor_parallel_rectangles") {
    return form_factor_parallel(at("a"), at("b"), at("gap"));
  }
  if (kind == "form_factor_perpendicular_rectangles") {
    return form_factor_perpendicular(at("common_edge"), at("w_from"), at("h_to"));
  }
  if (kind == "form_factor_coaxial_disks") {
    return form_factor_coaxial_disks(at("r1"), at("r2"), at("gap"));
  }
  return std::nullopt;
}

TEST(GoldenTransport, DisksAndFormFactors) {
  const nlohmann::json golden = test::read_golden("transport.json");
  int n_checked = 0;
  for (const auto& item : golden.at("cases")) {
    const std::string kind = item["kind"];
    if (const std::optional<double> value = computed(kind, item["geometry"])) {
      const double truth = number(item["value"]);
      const bool is_extreme = item.value("tier", "") == "extreme";
      EXPECT_NEAR(*value, truth, (is_extreme ? 1e-6 : 1e-10) * truth) << item["id"];
      ++n_checked;
    }
  }
  EXPECT_EQ(n_checked, 15);
}

TEST(GoldenTransport, FormFactorsAreReciprocal) {
  EXPECT_NEAR(3.0 * form_factor_perpendicular(2.0, 3.0, 0.7),
              0.7 * form_factor_perpendicular(2.0, 0.7, 3.0), 1e-14);
  EXPECT_NEAR(9.0 * form_factor_coaxial_disks(3.0, 0.5, 2.0),
              0.25 * form_factor_coaxial_disks(0.5, 3.0, 2.0), 1e-14);
  // A closed box of 1 x 2 x 3: what leaves its floor arrives somewhere.
  const double sum = form_factor_parallel(1.0, 2.0, 3.0) +
                     2.0 * form_factor_perpendicular(1.0, 2.0, 3.0) +
                     2.0 * form_factor_perpendicular(2.0, 1.0, 3.0);
  EXPECT_NEAR(sum, 1.0, 1e-14);
}

TEST(GoldenTransport, ADiskAtTheHorizonIsNotTold) {
  const EmittingDisk disk{
      .centre = Vector3d(3, 0, 2), .normal = -Vector3d::UnitZ(), .radius_mm = 1.0};
  EXPECT_TRUE(disk_irradiance(disk, Vector3d::Zero(), Vector3d::UnitX()).has_value());
  EXPECT_FALSE(disk_irradiance(disk, Vector3d(2.5, 0, 0), Vector3d::UnitX()).has_value());
  EXPECT_EQ(disk_irradiance(disk, Vector3d(0, 0, 3), Vector3d::UnitZ()), 0.0);  // from behind
}

}  // namespace
}  // namespace haarlight::render
