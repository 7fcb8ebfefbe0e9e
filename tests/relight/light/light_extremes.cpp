// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/relight/light/light_weights.h"
#include "haarlight/relight/light/near_light.h"
#include "tests/extremes.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;
using extremes::bounded;
using extremes::exact;
using extremes::refused;
using extremes::stated;

constexpr double kPi = std::numbers::pi;

// ---- weights of an environment ----

EXTREMES_OF(rig_weights, "relight/light: weights", "environment to a rig's weights")

Rig top_rig(int rows = 8, int cols = 8, double scale = 1.0) {
  Rig rig;
  rig.name = "top";
  rig.object_centre = scale * Vector3d(0.0, 0.0, 45.0);
  Face face;
  face.id = "top";
  face.centre = scale * Vector3d(0.0, 0.0, 900.0);
  face.rows = rows;
  face.cols = cols;
  face.pitch_mm = 120.0 * scale;
  face.emitter_w_mm = face.emitter_h_mm = 100.0 * scale;
  rig.faces = {face};
  return rig;
}

render::Environment sky(int width, int height, float scale = 1.0F) {
  Image<float> image(height, width, 1);
  std::uint64_t i = 0;
  for (float& v : image.pixels()) {
    v = scale * static_cast<float>(0.1 + uniform_unit(hash_key(8, ++i)));
  }
  return render::Environment::from_picture(std::move(image), "made");
}

constexpr const char* kConserved = "light lost or counted twice / all";
constexpr const char* kConservedWhy = "solid angles of 1e-13 each";

double worst_conservation(const std::vector<EnvironmentWeights>& all) {
  double worst = 0.0;
  for (const EnvironmentWeights& found : all) {
    EXPECT_TRUE(found.weights.allFinite());
    EXPECT_GE(found.weights.minCoeff(), 0.0);
    worst = std::max(worst, found.conservation_error);
  }
  return worst;
}

EXTREME(rig_weights, dark) {
  const EnvironmentWeights found = rig_weights(sky(64, 32, 0.0F), top_rig());
  EXPECT_TRUE(found.weights.isZero(0.0));
  EXPECT_EQ(found.missing_fraction, 0.0);
  EXPECT_EQ(found.conservation_error, 0.0);
  return exact("black: all weights 0, nothing missing");
}
EXTREME(rig_weights, one) {
  return bounded(worst_conservation({rig_weights(sky(2, 1), top_rig(1, 1))}), 1e-12, kConserved,
                 kConservedWhy);
}
NO_EXTREME(rig_weights, largest, "no limit")
EXTREME(rig_weights, odd_size) {
  return bounded(worst_conservation({rig_weights(sky(62, 31), top_rig(3, 7)),
                                     rig_weights(sky(44, 33), top_rig(1, 13))}),
                 1e-12, kConserved, kConservedWhy);
}
EXTREME(rig_weights, scale) {
  const EnvironmentWeights one = rig_weights(sky(64, 32), top_rig());
  double worst = 0.0;
  for (const float scale : {0x1p-90F, 0x1p60F}) {
    const EnvironmentWeights other = rig_weights(sky(64, 32, scale), top_rig());
    worst = std::max(worst, (other.weights / double{scale} - one.weights).norm());
  }
  return bounded(worst / one.weights.norm(), 1e-12, "radiance of 2^-90, 2^60: relative change",
                 "scales by powers of two round alike");
}
EXTREME(rig_weights, subnormal) {
  return bounded(worst_conservation({rig_weights(sky(64, 32, 1e-40F), top_rig())}), 1e-12,
                 kConserved, kConservedWhy);
}
NO_EXTREME(rig_weights, not_finite, "environment maps refuse it")
EXTREME(rig_weights, degenerate) {
  Rig crossing = top_rig();
  crossing.faces.push_back(crossing.faces[0]);
  crossing.faces[1].id = "again";
  return refused("two faces", [&] { (void)rig_weights(sky(64, 32), crossing); });
}
EXTREME(rig_weights, grazing) {
  // The object's centre in the plane of a face: it sees the face edge-on.
  Rig rig = top_rig();
  rig.object_centre.z() = 900.0;
  const EnvironmentWeights found = rig_weights(sky(64, 32), rig);
  EXPECT_TRUE(found.weights.isZero(0.0));
  EXPECT_EQ(found.missing_fraction, 1.0);
  return stated("a face seen edge-on or from behind: weights 0, all of the light is missing");
}
EXTREME(rig_weights, far_near) {
  const EnvironmentWeights one = rig_weights(sky(64, 32), top_rig());
  double worst = 0.0;
  for (const double scale : {1e-6, 1e6}) {
    const EnvironmentWeights other = rig_weights(sky(64, 32), top_rig(8, 8, scale));
    worst = std::max(worst, (other.weights - one.weights).norm());
  }
  return bounded(worst / one.weights.norm(), 1e-10,
                 "all lengths scaled by 1e±6: relative change", "G_k is a ratio of lengths");
}
NO_EXTREME(rig_weights, duplicate, "the same face twice is refused: degenerate")
NO_EXTREME(rig_weights, clipped, "no samples")

EXTREMES_OF(voronoi, "relight/light: weights", "environment to free lights' weights (Voronoi)")

std::vector<Vector3d> spread(int n) {
  std::vector<Vector3d> directions;
  for (int k = 0; k < n; ++k) {
    const double z = (k + 0.5) / n;
    const double r = std::sqrt(1.0 - z * z);
    directions.emplace_back(r * std::cos(2.4 * k), r * std::sin(2.4 * k), z);
  }
  return directions;
}

EXTREME(voronoi, dark) {
  EXPECT_TRUE(voronoi_weights(sky(64, 32, 0.0F), spread(5)).weights.isZero(0.0));
  return exact("black: all weights 0");
}
EXTREME(voronoi, one) {
  const EnvironmentWeights found = voronoi_weights(sky(64, 32), {Vector3d::UnitX()});
  return bounded(std::abs(found.cell_solid_angle[0] / (4.0 * kPi) - 1.0), 1e-12,
                 "one light has the whole sphere: relative error of 4π", kConservedWhy);
}
NO_EXTREME(voronoi, largest, "no limit")
EXTREME(voronoi, odd_size) {
  return bounded(worst_conservation({voronoi_weights(sky(62, 31), spread(7)),
                                     voronoi_weights(sky(44, 33), spread(47))}),
                 1e-12, kConserved, kConservedWhy);
}
EXTREME(voronoi, scale) {
  const EnvironmentWeights one = voronoi_weights(sky(64, 32), spread(9));
  double worst = 0.0;
  for (const float scale : {0x1p-90F, 0x1p60F}) {
    const EnvironmentWeights other = voronoi_weights(sky(64, 32, scale), spread(9));
    worst = std::max(worst, (other.weights / double{scale} - one.weights).norm());
  }
  return bounded(worst / one.weights.norm(), 1e-12, "radiance of 2^-90, 2^60: relative change",
                 "scales by powers of two round alike");
}
EXTREME(voronoi, subnormal) {
  return bounded(worst_conservation({voronoi_weights(sky(64, 32, 1e-40F), spread(9))}), 1e-12,
                 kConserved, kConservedWhy);
}
NO_EXTREME(voronoi, not_finite, "environment maps and lists of lights refuse it")
EXTREME(voronoi, degenerate) {
  // All on one great circle; a pole; opposite ones.
  std::vector<Vector3d> ring;
  for (int k = 0; k < 6; ++k) {
    ring.emplace_back(std::cos(k * kPi / 3.0), std::sin(k * kPi / 3.0), 0.0);
  }
  return bounded(worst_conservation(
                     {voronoi_weights(sky(64, 32), ring),
                      voronoi_weights(sky(64, 32), {Vector3d::UnitZ(), -Vector3d::UnitZ()})}),
                 1e-12,
                 std::string("lights on one circle, and at opposite poles: ") + kConserved,
                 kConservedWhy);
}
NO_EXTREME(voronoi, grazing, "no surface")
NO_EXTREME(voronoi, far_near, "directions alone")
EXTREME(voronoi, duplicate) {
  std::vector<Vector3d> twice = spread(5);
  twice.push_back(twice[2]);
  Vector3d near = twice[3];
  near.x() += 1e-14;
  twice.push_back(near);
  const EnvironmentWeights once = voronoi_weights(sky(64, 32), spread(5));
  const EnvironmentWeights found = voronoi_weights(sky(64, 32), twice);
  EXPECT_NEAR(found.weights(2, 0), 0.5 * once.weights(2, 0), 1e-12 * once.weights(2, 0));
  EXPECT_NEAR(found.weights(5, 0), 0.5 * once.weights(2, 0), 1e-12 * once.weights(2, 0));
  return bounded(worst_conservation({found}), 1e-12,
                 std::string("equal lights, or 1e-14 apart, share their cell: ") + kConserved,
                 kConservedWhy);
}
NO_EXTREME(voronoi, clipped, "no samples")

// ---- the near light ----

EXTREMES_OF(near_light, "relight/light: near light",
            "near light: irradiance of a point with a lobe")

const Vector3d kUp = Vector3d::UnitZ();

NearLight above(double height, double mu = 1.0) {
  NearLight light;
  light.position_mm = {0.0, 0.0, height};
  light.mu = mu;
  return light;
}

NO_EXTREME(near_light, dark, "no power in it")
NO_EXTREME(near_light, one, "light by light")
NO_EXTREME(near_light, largest, "no sizes")
NO_EXTREME(near_light, odd_size, "no sizes")
EXTREME(near_light, scale) {
  double worst = 0.0;
  for (const double scale : {1e-30, 1e30}) {
    for (const double mu : {0.0, 1.0, 30.0}) {
      const double one = light_stencil(above(200.0, mu), {70.0, 20.0, 0.0}, kUp);
      const double other =
          light_stencil(above(200.0 * scale, mu), scale * Vector3d(70.0, 20.0, 0.0), kUp);
      worst = std::max(worst, std::abs(other * scale * scale / one - 1.0));
    }
  }
  return bounded(worst, 1e-13, "all lengths scaled by 1e±30: relative change", "20 roundings");
}
EXTREME(near_light, subnormal) {
  NearLight light = above(1e-310);
  EXPECT_FALSE(std::isfinite(light_stencil(light, Vector3d::Zero(), kUp)));
  return stated("lengths of 1e-310 mm: the irradiance is beyond a double, infinite or NaN");
}
EXTREME(near_light, not_finite) {
  EXPECT_FALSE(light_stencil(above(std::numeric_limits<double>::quiet_NaN()), Vector3d::Zero(),
                             kUp) > 0.0);
  EXPECT_EQ(
      light_stencil(above(std::numeric_limits<double>::quiet_NaN()), Vector3d::Zero(), kUp),
      0.0);
  return stated("a NaN position lights nothing; lists of lights and rig files refuse it");
}
EXTREME(near_light, degenerate) {
  for (const double mu : {0.0, 1.0, 30.0}) {
    EXPECT_EQ(light_stencil(above(0.0, mu), Vector3d::Zero(), kUp), 0.0) << "at the light";
    EXPECT_EQ(light_stencil(above(0.0, mu), {5.0, 0.0, 0.0}, kUp), 0.0) << "in the plane";
    EXPECT_EQ(light_stencil(above(10.0, mu), {0.0, 0.0, 20.0}, kUp), 0.0) << "above the light";
  }
  NearLight line = above(10.0);
  line.emitter_mm.col(0) = Vector3d(2.0, 0.0, 0.0);
  const double point = light_stencil(above(10.0), Vector3d::Zero(), kUp);
  EXPECT_NEAR(light_stencil(line, Vector3d::Zero(), kUp) / point, 1.0, 0.02)
      << "a line of 0.2 h";
  return exact("at the light, in its plane, behind it: 0; an emitter without width is a line");
}
EXTREME(near_light, grazing) {
  double worst = 0.0;
  for (const double height : {1e-12, 1e-6, 1e-3}) {
    NearLight light = above(height, 0.0);
    light.position_mm.x() = 100.0;
    const double truth = height / std::pow(100.0 * 100.0 + height * height, 1.5);
    worst =
        std::max(worst, std::abs(light_stencil(light, Vector3d::Zero(), kUp) / truth - 1.0));
  }
  return bounded(worst, 1e-14, "1e-14 rad above the surface: relative error", "8 roundings");
}
EXTREME(near_light, far_near) {
  double worst = 0.0;
  for (const double height : {1e-6, 1e6}) {
    worst = std::max(
        worst,
        std::abs(light_stencil(above(height), Vector3d::Zero(), kUp) * height * height - 1.0));
  }
  return bounded(worst, 1e-14, "1e±6 mm above: relative error of 1/r²", "8 roundings");
}
NO_EXTREME(near_light, duplicate, "light by light")
NO_EXTREME(near_light, clipped, "no samples")

}  // namespace
}  // namespace haarlight::relight
