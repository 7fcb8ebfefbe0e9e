// SPDX-License-Identifier: Apache-2.0
#include "render/analytic/sheet.h"

#include <array>
#include <cmath>

#include <gtest/gtest.h>

#include "core/random.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;

/// 100 x 50 mm, upright at y = 200.
const Sheet kSheet{{-50.0, 200.0, 0.0}, {100.0, 0.0, 0.0}, {0.0, 0.0, 50.0}};

SquareLight light_at(const Vector3d& centre) {
  SquareLight light;
  light.centre = centre;
  light.width_mm = 40.0;
  light.height_mm = 20.0;
  return light;
}

TEST(Sheet, HidesHalfOfALightAtItsEdge) {
  // From the origin the sheet's upper edge is seen at a slope of 1/4, its sides at +-1/4.
  EXPECT_NEAR(hidden_fraction(kSheet, light_at({0.0, 400.0, 100.0}), Vector3d::Zero()), 0.5,
              0.02);  // nearer parts of the light look larger
  SquareLight upright = light_at({100.0, 400.0, 50.0});
  upright.v = Vector3d::UnitZ();
  EXPECT_NEAR(hidden_fraction(kSheet, upright, Vector3d::Zero()), 0.5, 1e-12);
  upright.centre.z() = 100.0;  // a corner
  EXPECT_NEAR(hidden_fraction(kSheet, upright, Vector3d::Zero()), 0.25, 1e-12);
}

TEST(Sheet, HidesNothingBeforeItOrFromItsOwnPlane) {
  EXPECT_EQ(hidden_fraction(kSheet, light_at({0.0, 150.0, 20.0}), Vector3d::Zero()), 0.0);
  EXPECT_EQ(hidden_fraction(kSheet, light_at({0.0, 400.0, 20.0}), {0.0, 200.0, 10.0}), 0.0);
  EXPECT_EQ(hidden_fraction(kSheet, light_at({0.0, 400.0, 20.0}), Vector3d::Zero()), 1.0);
}

TEST(Sheet, HidesWhatItsRaysMeet) {
  constexpr int kGrid = 64;
  for (std::uint64_t i = 0; i < 50; ++i) {
    const auto draw = [i](std::uint64_t what) { return uniform_unit(hash_key(7, i, what)); };
    const Vector3d point(60.0 * (draw(0) - 0.5), 100.0 * draw(1), 30.0 * draw(2));
    const SquareLight light =
        light_at({200.0 * (draw(3) - 0.5), 220.0 + 200.0 * draw(4), 150.0 * draw(5)});
    int n_met = 0;
    for (int j = 0; j < kGrid * kGrid; ++j) {
      const Vector3d at =
          light.centre +
          ((j % kGrid + 0.5) / kGrid - 0.5) * light.width_mm * light.u +  // NOLINT
          ((j / kGrid + 0.5) / kGrid - 0.5) * light.height_mm * light.v;  // NOLINT
      const double length = (at - point).norm();
      n_met += distance_to(kSheet, point, (at - point) / length) < length ? 1 : 0;
    }
    // An edge crosses at most two rows' worth of the samples.
    EXPECT_NEAR(hidden_fraction(kSheet, light, point),
                n_met / static_cast<double>(kGrid * kGrid), 2.0 / kGrid)
        << i;
  }
}

TEST(Sheet, OthersHideAndItselfDoesNot) {
  const std::array<Sheet, 2> sheets{
      Sheet{{-500.0, -500.0, 0.0}, {1000.0, 0.0, 0.0}, {0.0, 1000.0, 0.0}}, kSheet};
  EXPECT_EQ(visible_fraction(sheets, 0, light_at({0.0, 400.0, 20.0}), Vector3d::Zero()), 0.0);
  EXPECT_EQ(visible_fraction(sheets, 1, light_at({0.0, 400.0, 20.0}), {0.0, 200.0, 10.0}), 1.0);
}

}  // namespace
}  // namespace haarlight::render
