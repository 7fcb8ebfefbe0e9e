// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <span>
#include <vector>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "core/count.h"
#include "haarlight/render/analytic/plane_irradiance.h"
#include "haarlight/render/analytic/polygon_light.h"
#include "haarlight/render/direct/direct_light.h"
#include "haarlight/render/light/environment_texels.h"
#include "haarlight/render/light/light_tree.h"
#include "haarlight/render/scene/scene.h"
#include "tests/extremes.h"
#include "tests/render/square_light.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;
using extremes::both;
using extremes::bounded;
using extremes::exact;
using extremes::refused;
using testing::square;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
const Vector3d kUp = Vector3d::UnitZ();

/// Turned so that it emits towards the origin.
SquareLight facing(const Vector3d& centre, double size, double mu = 1.0) {
  SquareLight light = square(centre, size, mu);
  light.emits = -centre.normalized();
  light.u = light.emits.unitOrthogonal();
  light.v = light.emits.cross(light.u);
  return light;
}

/// Midpoint rule on n x n cells, for radiance 1.
long double midpoint(const SquareLight& light, const Vector3d& p, const Vector3d& n,
                     int cells) {
  long double sum = 0.0L;
  for (int j = 0; j < cells; ++j) {
    for (int i = 0; i < cells; ++i) {
      const Vector3d r = light.centre + ((i + 0.5) / cells - 0.5) * light.width_mm * light.u +
                         ((j + 0.5) / cells - 0.5) * light.height_mm * light.v - p;
      const double d = r.norm();
      sum += static_cast<long double>(
          std::max(0.0, n.dot(r) / d) *
          std::pow(std::max(0.0, -light.emits.dot(r) / d), light.lobe_mu) *
          (light.width_mm / d) * (light.height_mm / d));
    }
  }
  return sum / (static_cast<long double>(cells) * cells);
}

/// Richardson's extrapolation: fourth order for lights wholly above the horizon.
double reference(const SquareLight& light, const Vector3d& n) {
  const Vector3d origin = Vector3d::Zero();
  return static_cast<double>(
      (4.0L * midpoint(light, origin, n, 64) - midpoint(light, origin, n, 32)) / 3.0L);
}

double seen(const SquareLight& light, const Vector3d& n = kUp) {
  return light_irradiance(light, Vector3d::Zero(), n);
}

/// At the middle below a parallel square of side 1 [Lambert1760].
double lambert_middle(long double h) {
  const long double a = std::hypot(0.5L, h);
  return static_cast<double>(4.0L * 0.5L / a * std::atan(0.5L / a));
}

// ---- lights in closed form ----

EXTREMES_OF(polygon, "render/analytic", "irradiance of a flat light, lobes 1 and 2.5")

constexpr double kLobes[] = {1.0, 2.5};

EXTREME(polygon, dark) {
  for (const double mu : kLobes) {
    SquareLight light = square({0.1, 0.2, 3.0}, 1.0, mu);
    light.radiance = 0.0;
    EXPECT_EQ(seen(light), 0.0);
  }
  return exact("radiance 0: 0");
}
NO_EXTREME(polygon, one, "light by light")
EXTREME(polygon, largest) {
  return bounded(std::abs(seen(square({0, 0, 1}, 2e5)) - std::numbers::pi), 4e-10,
                 "a half space of light, π: absolute error",
                 "its missing rim, (height / half side)²; error of the closed form 1e-12");
}
NO_EXTREME(polygon, odd_size, "no grid")
EXTREME(polygon, scale) {
  double worst = 0.0;
  for (const double mu : kLobes) {
    const Vector3d n = Vector3d(0.2, 0.3, 0.9).normalized();
    for (const double distance : {0.6, 3.0, 40.0}) {
      const double one = seen(square({0.3, -0.2, distance}, 1.0, mu), n);
      for (const double scale : {1e-30, 1e-6, 1e6, 1e30}) {
        const double other = seen(square(scale * Vector3d(0.3, -0.2, distance), scale, mu), n);
        worst = std::max(worst, std::abs(other / one - 1.0));
      }
    }
  }
  return bounded(worst, 1e-12, "all lengths scaled: relative change",
                 "the accuracy required of the closed form");
}
NO_EXTREME(polygon, subnormal, "lengths in mm; 1e-30 of them above")
EXTREME(polygon, not_finite) {
  for (const double mu : kLobes) {
    (void)refused("finite positions", [mu] { (void)seen(square({0.0, kNan, 3.0}, 1.0, mu)); });
  }
  return refused("finite positions", [] { (void)seen(square({0.0, kNan, 3.0}, 1.0)); });
}
EXTREME(polygon, degenerate) {
  for (const double mu : kLobes) {
    SquareLight line = square({0.1, 0.2, 3.0}, 1.0, mu);
    line.height_mm = 0.0;
    EXPECT_EQ(seen(line), 0.0);
    EXPECT_EQ(seen(square({0, 0, 1}, 0.0, mu)), 0.0);
    EXPECT_EQ(seen(square({0, 0, 0}, 1.0, mu)), 0.0) << "in the light's plane";
    EXPECT_EQ(seen(square({0.5, 0.5, 0}, 1.0, mu)), 0.0) << "at its corner";
    EXPECT_EQ(seen(square({0, 0, -1}, 1.0, mu), -kUp), 0.0) << "behind it";
    EXPECT_EQ(seen(square({0, 0, 1}, 1.0, mu), -kUp), 0.0) << "below the horizon";
  }
  const std::vector<Vector3d> coincident(3, Vector3d(0, 0, 1));
  EXPECT_EQ(polygon_irradiance(coincident, Vector3d::Zero(), kUp).value, 0.0);
  return exact("no area, the point in the light's plane, behind it or turned away: 0");
}
EXTREME(polygon, grazing) {
  double worst = 0.0;
  for (const double mu : kLobes) {
    for (const double above : {1e-6, 1e-4, 1e-2}) {
      // All of it above the horizon, by its own size.
      const SquareLight light = facing({1.0, 0.0, above}, 0.5 * above, mu);
      worst = std::max(worst, std::abs(seen(light) / reference(light, kUp) - 1.0));
    }
  }
  return bounded(worst, 1e-6, "a light 1e-6 rad above the horizon: relative error",
                 "what the specification requires of extreme cases");
}
EXTREME(polygon, far_near) {
  double worst = 0.0;
  for (const double h : {1e-6, 1e-3}) {
    worst = std::max(worst, std::abs(seen(square({0, 0, h}, 1.0)) / lambert_middle(h) - 1.0));
  }
  for (const double mu : kLobes) {
    const SquareLight far = facing({3e5, 2e5, 9e5}, 1.0, mu);
    worst = std::max(worst, std::abs(seen(far) / reference(far, kUp) - 1.0));
  }
  return bounded(worst, 1e-10, "1e-6 and 1e6 sides away: relative error",
                 "what the specification requires in normal cases");
}
NO_EXTREME(polygon, duplicate, "light by light")
NO_EXTREME(polygon, clipped, "no samples")

EXTREMES_OF(plane, "render/analytic", "`PlaneIrradiance`: many lights over one plane")

double on_plane(const SquareLight& light, double tolerance) {
  double value = -1.0;
  PlaneIrradiance(std::span(&light, 1), kUp, 0.0, tolerance)
      .evaluate(Vector3d::Zero(), {&value, 1});
  return value;
}

/// Against light_irradiance(), whose own row is above.
double worst_on_plane(const std::vector<SquareLight>& lights, double tolerance) {
  double worst = 0.0;
  for (const SquareLight& light : lights) {
    const double truth = seen(light);
    const double found = on_plane(light, tolerance);
    worst = std::max(worst, truth == found ? 0.0 : std::abs(found / truth - 1.0));
  }
  return worst;
}

EXTREME(plane, dark) {
  PlaneIrradiance({}, kUp, 0.0, 1e-12).evaluate(Vector3d::Zero(), {});
  SquareLight light = square({0.1, 0.2, 3.0}, 1.0);
  light.radiance = 0.0;
  EXPECT_EQ(on_plane(light, 1e-12), 0.0);
  return exact("no light: nothing; radiance 0: 0");
}
NO_EXTREME(plane, one, "light by light")
EXTREME(plane, largest) {
  return bounded(worst_on_plane({square({0, 0, 1}, 2e5)}, 1e-12), 1e-12,
                 "a light of 2e5 distances: relative error", "as requested");
}
NO_EXTREME(plane, odd_size, "no grid")
EXTREME(plane, scale) {
  std::vector<SquareLight> lights;
  for (const double scale : {1e-30, 1e-6, 1e6, 1e30}) {
    for (const double distance : {0.6, 3.0, 40.0}) {
      lights.push_back(square(scale * Vector3d(0.3, -0.2, distance), scale));
    }
  }
  return bounded(worst_on_plane(lights, 1e-12), 2e-12, "all lengths scaled: relative error",
                 "as requested, and the closed form's 1e-12");
}
NO_EXTREME(plane, subnormal, "lengths in mm; 1e-30 of them above")
EXTREME(plane, not_finite) {
  return refused("finite positions", [] {
    (void)on_plane(square({0.0, kNan, 3.0}, 1.0), 1e-12);
  });
}
EXTREME(plane, degenerate) {
  EXPECT_EQ(on_plane(square({0, 0, 0}, 1.0), 1e-12), 0.0);
  EXPECT_EQ(on_plane(square({0, 0, -1}, 1.0), 1e-12), 0.0);
  EXPECT_EQ(on_plane(square({0, 0, 1}, 0.0), 1e-12), 0.0);
  return exact("a light in the plane, below it or without area: 0");
}
EXTREME(plane, grazing) {
  std::vector<SquareLight> lights;
  for (const double above : {1e-6, 1e-4, 1e-2}) {
    lights.push_back(facing({1.0, 0.0, above}, 0.5 * above));
    lights.push_back(facing({1.0, 0.0, above}, 10.0 * above));  // cut by the plane
  }
  return bounded(worst_on_plane(lights, 1e-12), 2e-12,
                 "1e-6 rad above the plane, or cut by it: relative error",
                 "as requested, and the closed form's 1e-12");
}
EXTREME(plane, far_near) {
  const SquareLight far = facing({3e5, 2e5, 9e5}, 1.0);
  const double worst = std::max(
      std::abs(on_plane(square({0, 0, 1e-6}, 1.0), 1e-12) / lambert_middle(1e-6) - 1.0),
      std::abs(on_plane(far, 1e-12) / reference(far, kUp) - 1.0));
  return bounded(worst, 1e-10, "1e-6 and 1e6 sides away: relative error",
                 "the bound of the closed form there, which near lights use");
}
NO_EXTREME(plane, duplicate, "light by light")
NO_EXTREME(plane, clipped, "no samples")

// ---- the tree of lights ----

EXTREMES_OF(tree, "render/light", "tree of lights")

std::vector<SquareLight> led_face(int rows, int cols, double scale = 1.0) {
  std::vector<SquareLight> lights;
  for (int i = 0; i < rows * cols; ++i) {
    const int row = i / cols;
    const int col = i % cols;
    lights.push_back(square(scale * Vector3d(30.0 * col, 30.0 * row, 900.0), 28.0 * scale));
  }
  return lights;
}

/// Every lit light in one leaf; returns the largest relative error of a node's weight and fraction.
double tree_error(const std::vector<SquareLight>& lights, const std::vector<Vector3d>& weights,
                  int side) {
  double worst = 0.0;
  std::size_t n_leaves = 0;
  for (const LightRoot& root : build_light_trees(lights, weights, side)) {
    n_leaves += root.leaves.size();
    for (const LightNode& node : root.nodes) {
      EXPECT_TRUE(node.block.centre.allFinite() && std::isfinite(node.block.width_mm) &&
                  std::isfinite(node.area_ratio));
      Vector3d sum = Vector3d::Zero();
      double fraction = 0.0;
      for (int i = 0; i < node.n_children; ++i) {
        const LightNode& child = root.nodes[count(node.first_child + i)];
        sum += child.weight;
        fraction += child.fraction;
      }
      if (node.n_children > 0) {
        worst =
            std::max(worst, (sum - node.weight).norm() / std::max(node.weight.norm(), 1e-300));
        worst = std::max(worst, std::abs(fraction - 1.0));
      }
    }
  }
  EXPECT_EQ(n_leaves, static_cast<std::size_t>(
                          std::count_if(weights.begin(), weights.end(),
                                        [](const Vector3d& w) { return !w.isZero(0.0); })));
  return worst;
}
constexpr const char* kTreeOf = "weights and fractions of the parts: relative error";
constexpr const char* kTreeWhy = "sums of up to 64 roundings of 2^-53";

EXTREME(tree, dark) {
  EXPECT_TRUE(build_light_trees(led_face(8, 8), std::vector<Vector3d>(64, Vector3d::Zero()), 8)
                  .empty());
  EXPECT_TRUE(build_light_trees({}, {}, 8).empty());
  return exact("no light, or none that shines: no tree");
}
EXTREME(tree, one) {
  const auto roots =
      build_light_trees(led_face(1, 1), std::vector<Vector3d>(1, Vector3d::Ones()), 8);
  EXPECT_EQ(roots.size(), 1U);
  EXPECT_EQ(roots.at(0).nodes.size(), 1U);
  EXPECT_EQ(roots.at(0).nodes.at(0).light, 0);
  return exact("one light: a leaf that is the root");
}
NO_EXTREME(tree, largest, "no limit")
EXTREME(tree, odd_size) {
  const std::vector<SquareLight> lights = led_face(5, 13);
  const double worst = tree_error(lights, std::vector<Vector3d>(65, Vector3d::Ones()), 4);
  return both(bounded(worst, 1e-14, kTreeOf, kTreeWhy), refused("a power of two", [&] {
                (void)build_light_trees(lights, std::vector<Vector3d>(65, Vector3d::Ones()), 3);
              }));
}
EXTREME(tree, scale) {
  double worst = 0.0;
  for (const double scale : {1e-30, 1e30}) {
    std::vector<Vector3d> weights(64);
    for (std::size_t k = 0; k < 64; ++k) {
      weights[k] = scale * Vector3d(1.0 + double(k), 2.0, 1e-20);
    }
    worst = std::max(worst, tree_error(led_face(8, 8), weights, 8));
  }
  return bounded(worst, 1e-14, kTreeOf, kTreeWhy);
}
EXTREME(tree, subnormal) {
  std::vector<Vector3d> weights(64, Vector3d::Constant(1e-310));
  return bounded(tree_error(led_face(8, 8), weights, 8), 1e-10, kTreeOf,
                 "1e-310 has 13 digits less than a normal number");
}
NO_EXTREME(tree, not_finite, "weights come from an environment or a list, which refuse it")
EXTREME(tree, degenerate) {
  std::vector<Vector3d> weights(64, Vector3d(1.0, -1.0, 0.0));  // cancel in the mean
  return bounded(tree_error(led_face(8, 8), weights, 8), 1e-14,
                 std::string("colours that cancel: ") + kTreeOf, kTreeWhy);
}
NO_EXTREME(tree, grazing, "no receiver")
EXTREME(tree, far_near) {
  double worst = 0.0;
  for (const double scale : {1e-6, 1e6}) {
    worst = std::max(worst, tree_error(led_face(8, 8, scale),
                                       std::vector<Vector3d>(64, Vector3d::Ones()), 8));
  }
  return bounded(worst, 1e-14, std::string("all lengths scaled: ") + kTreeOf, kTreeWhy);
}
EXTREME(tree, duplicate) {
  const std::vector<SquareLight> lights(5, square({0, 0, 900}, 28.0));
  return bounded(tree_error(lights, std::vector<Vector3d>(5, Vector3d::Ones()), 8), 1e-14,
                 std::string("lights at the same position: ") + kTreeOf, kTreeWhy);
}
NO_EXTREME(tree, clipped, "no samples")

// ---- direct light ----

EXTREMES_OF(direct, "render", "direct light with shadows")

Scene ground(double scale = 1.0) {
  Scene scene;
  scene.materials.emplace_back();
  const double s = 1000.0 * scale;
  scene.meshes.push_back(make_quad({-s, -s, 0}, {s, -s, 0}, {s, s, 0}, {-s, s, 0}, 0));
  return scene;
}

SurfacePoint at(const Vector3d& point, const Vector3d& normal = kUp) {
  SurfacePoint surface;
  surface.point = point;
  surface.normal = surface.flat_normal = normal;
  surface.to_eye = normal;
  return surface;
}

std::vector<LightContribution> lit(const Scene& scene, const std::vector<SquareLight>& lights,
                                   const SurfacePoint& surface) {
  const RayCaster caster(scene);
  std::vector<LightContribution> contributions(lights.size());
  Material glossy;
  glossy.ks = 0.3;
  glossy.exponent = 20.0;
  DirectLight(caster, lights).evaluate(surface, glossy, 1, contributions);
  for (const LightContribution& contribution : contributions) {
    EXPECT_TRUE(std::isfinite(contribution.diffuse) && std::isfinite(contribution.specular) &&
                contribution.diffuse >= 0.0 && contribution.specular >= 0.0);
  }
  return contributions;
}

/// Against the closed form where nothing is in the way; largest relative error.
double open_error(const Scene& scene, const std::vector<SquareLight>& lights,
                  const SurfacePoint& surface) {
  const std::vector<LightContribution> contributions = lit(scene, lights, surface);
  double worst = 0.0;
  for (std::size_t k = 0; k < lights.size(); ++k) {
    const double truth =
        light_irradiance(lights[k], surface.point, surface.normal) / std::numbers::pi;
    worst = std::max(worst, truth == contributions[k].diffuse
                                ? 0.0
                                : std::abs(contributions[k].diffuse / truth - 1.0));
  }
  return worst;
}
constexpr const char* kOpenOf = "unoccluded, against the closed form: relative error";
constexpr const char* kOpenWhy = "2 × 2 Gauss points, docs/numerics/direct-light.md";
EXTREME(direct, dark) {
  EXPECT_TRUE(lit(ground(), {}, at(Vector3d::Zero())).empty());
  Scene roofed = ground();
  roofed.meshes.push_back(
      make_quad({-900, -900, 5}, {-900, 900, 5}, {900, 900, 5}, {900, -900, 5}, 0));
  for (const LightContribution& contribution : lit(roofed, led_face(3, 3), at({1, 2, 0}))) {
    EXPECT_EQ(contribution.diffuse, 0.0);
    EXPECT_EQ(contribution.visible, 0.0);
  }
  return exact("no light: nothing; all hidden: 0");
}
EXTREME(direct, one) {
  return bounded(open_error(ground(), {square({20, 30, 900}, 28.0)}, at({1, 2, 0})), 1e-6,
                 kOpenOf, kOpenWhy);
}
NO_EXTREME(direct, largest, "no limit")
EXTREME(direct, odd_size) {
  return bounded(open_error(ground(), led_face(3, 7), at({1, 2, 0})), 1e-6, kOpenOf, kOpenWhy);
}
EXTREME(direct, scale) {
  double worst = 0.0;
  for (const double scale : {1e-6, 1e6}) {
    worst = std::max(
        worst, open_error(ground(scale), led_face(3, 3, scale), at(scale * Vector3d(1, 2, 0))));
  }
  return bounded(worst, 1e-6, std::string("all lengths scaled by 1e±6; ") + kOpenOf, kOpenWhy);
}
NO_EXTREME(direct, subnormal, "rays are cast in floats of mm")
EXTREME(direct, not_finite) {
  return refused(
      "", [] { (void)read_obj(HAARLIGHT_SOURCE_DIR "/tests/render/corpus/obj/nan.obj"); });
}
EXTREME(direct, degenerate) {
  const auto contributions =
      lit(ground(), {square({0, 0, 1}, 0.0), square({500, 0, 0}, 28.0)}, at(Vector3d::Zero()));
  EXPECT_EQ(contributions[0].diffuse, 0.0);
  EXPECT_EQ(contributions[1].diffuse, 0.0);
  return exact("a light without area, or in the surface: 0");
}
EXTREME(direct, grazing) {
  return bounded(open_error(ground(), {square({500, 0, 3.0}, 28.0)}, at(Vector3d::Zero())),
                 1e-4, std::string("0.006 rad above the surface; ") + kOpenOf,
                 "strata at the horizon, docs/reference/simulator.md");
}
EXTREME(direct, far_near) {
  return bounded(open_error(ground(), {square({2e5, 1e5, 9e8}, 28.0)}, at(Vector3d::Zero())),
                 1e-6, std::string("1e6 times as far; ") + kOpenOf, kOpenWhy);
}
EXTREME(direct, duplicate) {
  const std::vector<SquareLight> same(4, square({20, 30, 900}, 28.0));
  return bounded(open_error(ground(), same, at({1, 2, 0})), 1e-6,
                 std::string("the same light four times, each; ") + kOpenOf, kOpenWhy);
}
NO_EXTREME(direct, clipped, "no samples")

// ---- environments ----

EXTREMES_OF(environment, "render/light", "environment map")

Image<float> sky(int width, int height, float value) {
  Image<float> image(height, width, 1);
  std::fill(image.pixels().begin(), image.pixels().end(), value);
  return image;
}

/// Integral of the solid angle and of the radiance over all texels.
std::pair<double, double> totals(const Environment& environment) {
  double area = 0.0;
  double light = 0.0;
  const EnvironmentTexels texels(environment);
  for (int row = 0; row < texels.n_rows(); ++row) {
    texels.for_each(row, [&](const EnvironmentTexel& texel) {
      area += texel.solid_angle;
      light += texel.solid_angle * texel.radiance.x();
    });
  }
  return {area / (4.0 * std::numbers::pi), light};
}

EXTREME(environment, dark) {
  EXPECT_EQ(totals(Environment::from_picture(sky(64, 32, 0.0F), "made")).second, 0.0);
  return exact("black: no light");
}
EXTREME(environment, one) {
  const auto [area, light] = totals(Environment::from_picture(sky(2, 1, 1.0F), "made"));
  (void)light;
  return bounded(std::abs(area - 1.0), 1e-12, "2 × 1 texels: relative error of 4π",
                 "sums of solid angles of 1e-13 each");
}
EXTREME(environment, largest) {
  return refused("at most 1e+20", [] {
    Image<float> image = sky(4, 2, 1.0F);
    image(1, 2) = 2e20F;
    (void)Environment::from_picture(std::move(image), "made");
  });
}
EXTREME(environment, odd_size) {
  double worst = 0.0;
  for (const auto& [w, h] : {std::pair{62, 31}, {44, 33}, {33, 44}, {42, 7}}) {
    worst = std::max(
        worst,
        std::abs(totals(Environment::from_picture(sky(w, h, 1.0F), "made")).first - 1.0));
  }
  return both(
      bounded(worst, 1e-12, "31 rows, crosses and a strip of 7 and 11: relative error of 4π",
              "sums of solid angles of 1e-13 each"),
      refused("31 x 17 pixels",
              [] { (void)Environment::from_picture(sky(31, 17, 1.0F), "made"); }));
}
EXTREME(environment, scale) {
  double worst = 0.0;
  for (const float scale : {1e-30F, 1e19F}) {
    const auto [area, light] = totals(Environment::from_picture(sky(64, 32, scale), "made"));
    worst = std::max(worst,
                     std::abs(light / (4.0 * std::numbers::pi * double{scale} * area) - 1.0));
  }
  return bounded(worst, 1e-12, "radiance 1e-30 and 1e19: relative error of its integral",
                 "2048 roundings of 2^-53");
}
EXTREME(environment, subnormal) {
  const auto [area, light] = totals(Environment::from_picture(sky(64, 32, 1e-40F), "made"));
  return bounded(std::abs(light / (4.0 * std::numbers::pi * double{1e-40F} * area) - 1.0),
                 1e-12, "radiance 1e-40: relative error of its integral",
                 "2048 roundings of 2^-53");
}
EXTREME(environment, not_finite) {
  return refused("radiance nan at column 2, row 1", [] {
    Image<float> image = sky(4, 2, 1.0F);
    image(1, 2) = static_cast<float>(kNan);
    (void)Environment::from_picture(std::move(image), "made");
  });
}
EXTREME(environment, degenerate) {
  const Environment map = Environment::from_picture(sky(64, 32, 2.0F), "made");
  for (const Vector3d& d :
       {Vector3d(0, 0, 1), {0, 0, -1}, {1, 0, 0}, {-1, 0, 0}, {-1, -0.0, 0}}) {
    EXPECT_EQ(map.radiance(d).x(), 2.0);
  }
  return exact("poles and the seam: the texel's radiance");
}
NO_EXTREME(environment, grazing, "no surface")
EXTREME(environment, far_near) {
  const Environment map = Environment::from_picture(sky(64, 32, 2.0F), "made");
  EXPECT_EQ(map.radiance(1e-30 * Vector3d(1, 2, 3)).x(), 2.0);
  EXPECT_EQ(map.radiance(1e30 * Vector3d(1, 2, 3)).x(), 2.0);
  return exact("directions of length 1e±30: the texel's radiance");
}
NO_EXTREME(environment, duplicate, "texels do not overlap")
EXTREME(environment, clipped) {
  return refused("radiance -0.5 at column 1, row 0", [] {
    Image<float> image = sky(4, 2, 1.0F);
    image(0, 1) = -0.5F;
    (void)Environment::from_picture(std::move(image), "made");
  });
}

}  // namespace
}  // namespace haarlight::render
