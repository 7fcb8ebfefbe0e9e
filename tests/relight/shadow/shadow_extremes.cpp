// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include <gtest/gtest.h>

#include "haarlight/relight/shadow/area_mean.h"
#include "haarlight/relight/shadow/predict.h"
#include "haarlight/relight/shadow/projection.h"
#include "haarlight/relight/shadow/receiver_light.h"
#include "haarlight/relight/shadow/visibility.h"
#include "haarlight/render/analytic/polygon_light.h"
#include "relight/shadow/rig_predict.h"
#include "tests/extremes.h"
#include "tests/relight/shadow/shadow_scene.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;
using extremes::both;
using extremes::bounded;
using extremes::exact;
using extremes::refused;
using extremes::stated;

constexpr double kEps = 0x1p-52;
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInfinity = std::numeric_limits<double>::infinity();
const Vector3d kUp = Vector3d::UnitZ();

// ---- projection ----

EXTREMES_OF(projection, "relight/shadow", "shadow projection onto a plane, eq. (4)")

ProjectionStatus status_of(const Plane& plane, const Vector3d& light, const Vector3d& vertex) {
  return project_to_plane(plane, light, vertex).status;
}

NO_EXTREME(projection, dark, "no light in it")
NO_EXTREME(projection, one, "point by point")
NO_EXTREME(projection, largest, "point by point")
NO_EXTREME(projection, odd_size, "point by point")
EXTREME(projection, scale) {
  // Powers of two: the same bits, scaled.
  const Plane plane{{0.1, 0.2, 0.9}, 30.0};
  const Vector3d light(20.0, -70.0, 900.0);
  const Vector3d vertex(-10.0, 35.0, 100.0);
  const Vector3d one = project_to_plane(plane, light, vertex).point;
  for (const double s : {0x1p-100, 0x1p100}) {
    const Plane other{plane.n, plane.d * s};
    EXPECT_EQ(project_to_plane(other, s * light, s * vertex).point, Vector3d(s * one));
    EXPECT_EQ(project_to_plane({plane.n * s, plane.d * s}, light, vertex).point, one);
  }
  return exact("lengths, or the plane's normal, scaled by 2^±100: the same bits, scaled");
}
EXTREME(projection, subnormal) {
  const double s = std::numeric_limits<double>::min();
  const PlaneProjection p = project_to_plane({}, {0.0, 0.0, 8.0 * s}, {s, 0.0, 4.0 * s});
  EXPECT_EQ(p.status, ProjectionStatus::above);
  return bounded((p.point - Vector3d(2.0 * s, 0.0, 0.0)).norm() / s, 4.0 * kEps,
                 "lengths of 1e-307: error / length", "4 eps N, docs/numerics/shadow.md");
}
EXTREME(projection, not_finite) {
  for (const double bad : {kNan, kInfinity}) {
    EXPECT_FALSE(is_valid(status_of({}, {0.0, 0.0, bad}, {1.0, 0.0, 100.0})));
    EXPECT_FALSE(is_valid(status_of({}, {0.0, 0.0, 900.0}, {1.0, bad, 100.0})));
    EXPECT_FALSE(is_valid(status_of({{0.0, 0.0, bad}, 0.0}, {0, 0, 900.0}, {1, 0, 100.0})));
  }
  return stated("no point: a status that is not valid");
}
EXTREME(projection, degenerate) {
  EXPECT_EQ(status_of({Vector3d::Zero(), 1.0}, {0, 0, 900}, {1, 0, 100}),
            ProjectionStatus::invalid_plane);
  EXPECT_EQ(status_of({}, {5, 0, 0}, {0, 0, 1}), ProjectionStatus::light_in_plane);
  EXPECT_EQ(status_of({}, {0, 0, 900}, {0, 0, 900}), ProjectionStatus::at_light_height)
      << "vertex and light coincide";
  EXPECT_EQ(status_of({}, {0, 0, 900}, {7, 0, 900}), ProjectionStatus::at_light_height);
  EXPECT_EQ(status_of({}, {0, 0, 900}, {7, 0, 901}), ProjectionStatus::beyond_light);
  EXPECT_EQ(status_of({}, {0, 0, -900}, {1, 0, -901}), ProjectionStatus::beyond_light);
  const PlaneProjection own = project_to_plane({}, {0, 0, 900}, {7, 3, 0});
  EXPECT_EQ(own.status, ProjectionStatus::on_plane);
  EXPECT_EQ(own.point, Vector3d(7, 3, 0));
  return stated(
      "a plane without normal, a light in the plane, a vertex at the light, at its height or "
      "beyond it: no point, and which it is; a vertex on the plane is its own shadow");
}
EXTREME(projection, grazing) {
  // A hair below the light's height: the shadow is 1e12 heights away.
  const double w = 0x1p-40;
  const PlaneProjection p = project_to_plane({}, {0.0, 0.0, 1.0}, {1.0, 0.0, 1.0 - w});
  EXPECT_EQ(p.status, ProjectionStatus::above);
  EXPECT_EQ(status_of({}, {0, 0, 1e-300}, {1e300, 0, 1e-300 * (1.0 - kEps)}),
            ProjectionStatus::at_light_height);
  return both(bounded(std::abs(p.point.x() * w - 1.0), 8.0 * kEps,
                      "2^-40 rad below the light: relative error", "4 eps N"),
              stated("a point beyond the largest double: no point"));
}
EXTREME(projection, far_near) {
  double worst = 0.0;
  for (const double far : {1e-6, 1e6}) {
    // Height 100, light at 100 + far.
    const PlaneProjection p = project_to_plane({}, {0.0, 0.0, 100.0 + far}, {1.0, 0.0, 100.0});
    const double height = (100.0 + far) - 100.0;
    worst = std::max(worst, std::abs(p.point.x() * height / (100.0 + far) - 1.0));
  }
  return bounded(worst, 8.0 * kEps, "the light 1e-6 or 1e6 mm above the vertex: relative error",
                 "4 eps N");
}
NO_EXTREME(projection, duplicate, "point by point")
NO_EXTREME(projection, clipped, "no samples")

// ---- soft edges ----

EXTREMES_OF(window, "relight/shadow", "soft edges: means over the light's window, eq. (5)")

struct Picture {
  Image<float> value;
  Image<std::uint8_t> known;
};
Picture picture(int width, int height, float value, bool is_known = true) {
  Picture p{Image<float>(height, width, 1), Image<std::uint8_t>(height, width, 1)};
  std::fill(p.value.pixels().begin(), p.value.pixels().end(), value);
  std::fill(p.known.pixels().begin(), p.known.pixels().end(), is_known ? 1 : 0);
  return p;
}
WindowSums sums_of(const Picture& p) { return {p.value.view(), p.known.view()}; }

EXTREME(window, dark) {
  const WindowSums sums = sums_of(picture(9, 7, 0.0F));
  EXPECT_EQ(sums.mean(1.3, 7.8, 0.2, 6.9).value, 0.0);
  const WindowMean unknown = sums_of(picture(9, 7, 0.0F, false)).mean(1.3, 7.8, 0.2, 6.9);
  EXPECT_EQ(unknown.value, 0.5);
  EXPECT_EQ(unknown.unknown, 1.0);
  return both(exact("all in shadow: 0"), stated("all unknown: 0.5, unknown fraction 1"));
}
EXTREME(window, one) {
  const WindowSums sums = sums_of(picture(1, 1, 0.25F));
  EXPECT_EQ(sums.mean(0.0, 1.0, 0.0, 1.0).value, 0.25);
  EXPECT_EQ(sums.mean(0.25, 0.5, 0.25, 0.5).value, 0.25);
  return exact("one pixel: its value");
}
EXTREME(window, largest) {
  const WindowSums sums = sums_of(picture(1500, 1100, 0.25F));
  return bounded(std::abs(sums.mean(700.1, 700.2, 500.3, 500.4).value - 0.25), 1e-7,
                 "a window of 0.1 pixels in 1500 × 1100: absolute error",
                 "sums of 4e5 of 2^-53 each, over 0.01");
}
EXTREME(window, odd_size) {
  const WindowSums sums = sums_of(picture(17, 1, 0.25F));
  return bounded(std::abs(sums.mean(3.3, 11.7, 0.0, 1.0).value - 0.25), 1e-13,
                 "17 × 1 pixels: absolute error", "sums of 4 of 2^-53 each");
}
EXTREME(window, scale) {
  const WindowMean vast = sums_of(picture(9, 7, 0.0F)).mean(-1e15, 1e15, -1e15, 1e15);
  EXPECT_NEAR(vast.value, 1.0, 1e-12);
  EXPECT_NEAR(vast.outside, 1.0, 1e-12);
  return stated("a window of 1e15 pixels: lit, fraction outside the picture 1");
}
NO_EXTREME(window, subnormal, "visibilities of 0 to 1")
NO_EXTREME(window, not_finite, "visibilities are clamped when they are made")
EXTREME(window, degenerate) {
  const WindowSums sums = sums_of(picture(9, 7, 0.25F));
  const Eigen::Vector2d at(4.5, 3.5);
  for (const WindowMean& mean :
       {sums.mean({at, at, at, at}),
        sums.mean({at, Eigen::Vector2d(6.0, 3.5), Eigen::Vector2d(6.0, 3.5), at}),
        sums.mean(4.5, 4.5, 3.5, 3.5)}) {
    EXPECT_EQ(mean.value, 0.25);
  }
  return exact("a window without area, a point or a line: the pixel there");
}
EXTREME(window, grazing) {
  render::SquareLight light;
  light.centre = {0.0, 0.0, 900.0};
  light.width_mm = light.height_mm = 28.0;
  light.u = Vector3d::UnitZ();  // a corner is above the vertex, one below
  const LightWindow window =
      project_window({}, light.centre, render::light_corners(light), {5.0, 0.0, 895.0});
  EXPECT_FALSE(window.has_corners);
  EXPECT_EQ(corrected_window_scale(-0.5, 0.0), 1.0);
  EXPECT_EQ(widening_above(0.2, 0.2), kInfinity);
  EXPECT_EQ(widening_above(0.3, 0.2), kInfinity);
  return stated(
      "a vertex at the height of a corner of the light: the window says it has no corners; at "
      "the edge's height the widening is infinite");
}
EXTREME(window, far_near) {
  render::SquareLight light;
  light.width_mm = light.height_mm = 28.0;
  double worst = 0.0;
  for (const double height : {1e-3, 9e8}) {
    light.centre = {0.0, 0.0, 100.0 + height};
    const LightWindow window =
        project_window({}, light.centre, render::light_corners(light), {0.0, 0.0, 100.0});
    const double side = window_side(28.0, 100.0, 100.0 + height);
    worst =
        std::max(worst, std::abs((window.corners[1] - window.corners[0]).norm() / side - 1.0));
  }
  return bounded(worst, 1e-12,
                 "the light 1e-6 and 1e6 of 900 mm above: relative error of the side",
                 "eps of 100 mm over 1e-3 mm");
}
NO_EXTREME(window, duplicate, "light by light")
NO_EXTREME(window, clipped, "visibilities are clamped when they are made")

// ---- visibility ----

EXTREMES_OF(visibility, "relight/shadow", "visibility from radiance and clean plate")

EXTREME(visibility, dark) {
  const std::vector<float> black(64, 0.0F);
  const std::vector<float> ones(64, 1.0F);
  EXPECT_FALSE(shows_plane(black, ones));
  EXPECT_FALSE(shows_plane(ones, black));
  EXPECT_EQ(fit_plate_scale(black, std::vector<double>(64, 1.0)), 0.0);
  EXPECT_EQ(fit_plate_scale(ones, std::vector<double>(64, 0.0)), 0.0);
  EXPECT_EQ(fit_plate_scale({}, {}), 0.0);
  return stated("a black pixel or clean plate: not the plane, scale 0");
}
EXTREME(visibility, one) {
  const std::vector<float> value(1, 0.4F);
  EXPECT_TRUE(shows_plane(value, value));
  EXPECT_EQ(fit_plate_scale(value, std::vector<double>(1, 0.8)), double{0.4F} / 0.8);
  return exact("one light: its ratio");
}
NO_EXTREME(visibility, largest, "no limit")
NO_EXTREME(visibility, odd_size, "no grid")
EXTREME(visibility, scale) {
  for (const float scale : {1e-30F, 1e30F}) {
    const std::vector<float> values(64, scale);
    EXPECT_TRUE(shows_plane(values, values));
    EXPECT_EQ(fit_plate_scale(values, std::vector<double>(64, double{scale})), 1.0);
  }
  return exact("1e±30: the ratio 1");
}
EXTREME(visibility, subnormal) {
  const std::vector<float> values(64, 1e-40F);
  EXPECT_TRUE(shows_plane(values, values));
  EXPECT_EQ(fit_plate_scale(values, std::vector<double>(64, double{1e-40F})), 1.0);
  return exact("1e-40: the ratio 1");
}
EXTREME(visibility, not_finite) {
  std::vector<float> spoilt(64, 1.0F);
  std::fill(spoilt.begin(), spoilt.begin() + 60, static_cast<float>(kNan));
  EXPECT_FALSE(shows_plane(spoilt, std::vector<float>(64, 1.0F)));
  return stated("NaN is no value of the plane; stacks refuse it");
}
EXTREME(visibility, degenerate) {
  render::SquareLight light;
  light.centre = {0.0, 0.0, 900.0};
  EXPECT_EQ(plate_falloff(light, light.centre, kUp), 0.0);
  EXPECT_EQ(plate_falloff(light, {0.0, 0.0, 901.0}, kUp), 0.0);
  EXPECT_EQ(plate_falloff(light, {500.0, 0.0, 900.0}, kUp), 0.0);
  return exact("fall-off at the light, in its plane and above it: 0");
}
EXTREME(visibility, grazing) {
  render::SquareLight light;
  light.centre = {1000.0, 0.0, 1e-6};
  const double truth = 1e-9 * 1e-9 / 1e6;
  return bounded(std::abs(plate_falloff(light, Vector3d::Zero(), kUp) / truth - 1.0), 1e-13,
                 "fall-off 1e-9 rad above the plane: relative error", "10 roundings");
}
EXTREME(visibility, far_near) {
  render::SquareLight light;
  double worst = 0.0;
  for (const double height : {1e-6, 1e6}) {
    light.centre = {0.0, 0.0, height};
    worst = std::max(
        worst, std::abs(plate_falloff(light, Vector3d::Zero(), kUp) * height * height - 1.0));
  }
  return bounded(worst, 1e-14, "1e±6 mm: relative error of 1/r²", "10 roundings");
}
NO_EXTREME(visibility, duplicate, "light by light")
EXTREME(visibility, clipped) {
  VisibilityCount count;
  for (const double v : {0.25, 1.25, -0.05, 1.01}) {
    count.add_value(v);
  }
  EXPECT_EQ(count.n_excess, 1U);
  EXPECT_EQ(count.worst_excess, 0.25);
  return stated("above 1: clamped, counted, with the largest excess");
}

// ---- receivers ----

EXTREMES_OF(receivers, "relight/shadow", "shadows at receivers: `shadow_at_points`")

using shadow_scene::ceiling;
using shadow_scene::environment;
using shadow_scene::few;
using shadow_scene::hills;
using shadow_scene::plate_shadow;

struct PlateScene {
  PlaneFrame frame = shadow_scene::ground();
  std::vector<render::SquareLight> lights = ceiling(16);
  std::vector<Vector3d> smooth = environment(shadow_scene::Kind::smooth, lights, 4);

  [[nodiscard]] PointsResult run(const std::vector<render::SurfacePoint>& points,
                                 const std::vector<Vector3d>& weights, double l2 = 0.0) const {
    PointsOptions options = few();
    options.tolerance = {l2, kInfinity};
    const std::vector<SamplingPlane> planes{
        {frame,
         [this](int k) { return plate_shadow(frame, lights[static_cast<std::size_t>(k)]); },
         HeightRange{100.0, 100.0}}};
    return shadow_at_points(points, planes, lights, weights, options);
  }
};

EXTREME(receivers, dark) {
  const PlateScene scene;
  const std::vector<SamplingPlane> never{
      {scene.frame, [](int) -> Visibility { throw std::logic_error("nobody may ask"); }, {}}};
  PointsOptions options = few();
  options.tolerance.relative_l2 = 0.01;
  const PointsResult dark =
      shadow_at_points(hills(40), never, scene.lights,
                       std::vector<Vector3d>(scene.lights.size(), Vector3d::Zero()), options);
  EXPECT_EQ(dark.report.n_lights, 0);
  for (const PointTotal& total : dark.totals) {
    EXPECT_EQ(total.shadowed, Vector3d::Zero());
  }
  return exact("a black environment: 0, and no shadow picture is requested");
}
EXTREME(receivers, one) {
  const PlateScene scene;
  const std::vector<render::SurfacePoint> points = hills(40);
  const std::vector<Vector3d> one = environment(shadow_scene::Kind::one, scene.lights, 4);
  EXPECT_TRUE(shadow_scene::same_bits(scene.run(points, one, 0.01), scene.run(points, one)));
  EXPECT_TRUE(scene.run(points, one, 0.01).report.is_exact);
  const std::vector<render::SurfacePoint> single(points.begin() + 7, points.begin() + 8);
  EXPECT_TRUE(scene.run(single, scene.smooth, 0.5).report.is_exact);
  EXPECT_TRUE(scene.run({}, scene.smooth, 0.01).totals.empty());
  return exact(
      "one light or one receiver: the exact sum, whatever the tolerance; no receiver: nothing");
}
NO_EXTREME(receivers, largest, "no limit; memory bounds the tables")
NO_EXTREME(receivers, odd_size, "the tree's: render/light")
EXTREME(receivers, scale) {
  const PlateScene scene;
  const std::vector<render::SurfacePoint> points = hills(40);
  const PointsResult one = scene.run(points, scene.smooth, 0.01);
  double worst = 0.0;
  for (const double scale : {0x1p-100, 0x1p100}) {
    std::vector<Vector3d> weights = scene.smooth;
    for (Vector3d& w : weights) {
      w *= scale;
    }
    const PointsResult other = scene.run(points, weights, 0.01);
    EXPECT_LE(other.report.relative_l2_limit, 0.01);
    for (std::size_t i = 0; i < points.size(); ++i) {
      worst =
          std::max(worst, (other.totals[i].shadowed / scale - one.totals[i].shadowed).norm() /
                              one.totals[i].unshadowed.norm());
    }
  }
  return bounded(worst, 0.05,
                 "weights of 2^±100 (1e±30), tolerance 1 %: relative change of a receiver",
                 "twice the tolerance, of the whole picture");
}
EXTREME(receivers, subnormal) {
  const PlateScene scene;
  std::vector<Vector3d> weights = scene.smooth;
  for (Vector3d& w : weights) {
    w *= 1e-310;
  }
  for (const PointTotal& total : scene.run(hills(40), weights, 0.01).totals) {
    EXPECT_TRUE(total.shadowed.allFinite());
    EXPECT_LE(total.shadowed.maxCoeff(), 1e-305);
  }
  return stated("weights of 1e-310: finite sums of at most as much");
}
NO_EXTREME(receivers, not_finite, "weights come from an environment or a list, which refuse it")
EXTREME(receivers, degenerate) {
  const PlateScene scene;
  std::vector<render::SurfacePoint> odd(3, hills(40)[0]);
  odd[0].point.z() = shadow_scene::kH + 50.0;
  odd[1].normal = odd[1].flat_normal = -kUp;
  odd[2].point.z() = shadow_scene::kH;
  for (const PointTotal& total : scene.run(odd, scene.smooth).totals) {
    EXPECT_EQ(total.shadowed, Vector3d::Zero());
  }
  std::vector<Vector3d> negative = scene.smooth;
  negative[3] *= -1.0;
  EXPECT_TRUE(scene.run(hills(40), negative, 0.01).report.is_exact);
  return exact(
      "receivers above the lights, in their plane or turned away: 0; negative weights: the "
      "exact sum");
}
EXTREME(receivers, grazing) {
  render::SquareLight light;
  light.centre = {500.0, 0.0, 20.0};
  light.width_mm = light.height_mm = 28.0;
  light.emits = -Vector3d::UnitX();
  light.u = Vector3d::UnitY();
  light.v = kUp;
  const double truth = render::light_irradiance(light, Vector3d::Zero(), kUp);
  return bounded(std::abs(receiver_irradiance(light, Vector3d::Zero(), kUp) / truth - 1.0),
                 1e-6, "0.04 rad above a receiver: relative error of its irradiance",
                 "four Gauss points, receiver_light.h");
}
EXTREME(receivers, far_near) {
  render::SquareLight light;
  double worst = 0.0;
  for (const double height : {1e-3, 1e6}) {
    light.centre = {0.0, 0.0, height};
    const double truth = render::light_irradiance(light, Vector3d::Zero(), kUp);
    worst = std::max(worst,
                     std::abs(receiver_irradiance(light, Vector3d::Zero(), kUp) / truth - 1.0));
  }
  return bounded(worst, 1e-6, "1e-3 and 1e6 sides away: relative error of the irradiance",
                 "four Gauss points, receiver_light.h");
}
EXTREME(receivers, duplicate) {
  PlateScene scene;
  scene.lights.assign(40, scene.lights[100]);
  const std::vector<Vector3d> ones(40, Vector3d::Ones());
  const PointsResult all = scene.run(hills(40), ones, 0.01);
  scene.lights.resize(1);
  const PointsResult one = scene.run(hills(40), {Vector3d::Constant(40.0)});
  double worst = 0.0;
  for (std::size_t i = 0; i < one.totals.size(); ++i) {
    worst = std::max(worst, (all.totals[i].shadowed - one.totals[i].shadowed).norm() /
                                std::max(1e-300, one.totals[i].unshadowed.norm()));
  }
  return bounded(
      worst, 1e-6,
      "40 lights at the same position, against one of 40 times the weight: relative change",
      "four Gauss points of a block");
}
NO_EXTREME(receivers, clipped, "visibilities are clamped when they are made")

// ---- predictions ----

EXTREMES_OF(predict, "relight/shadow", "`rig predict`")

Rig cube() { return read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/cube32.toml"); }

EXTREME(predict, dark) {
  Rig down = cube();
  down.faces[0].emits = kUp;
  return refused("from above",
                 [&] { (void)predict_rig(down, {.low_mm = 1.0, .high_mm = 2.0}); });
}
EXTREME(predict, one) {
  Rig rig = cube();
  rig.faces[0].rows = rig.faces[0].cols = 1;
  const RigPrediction found = predict_rig(rig, {.low_mm = 10.0, .high_mm = 20.0});
  EXPECT_FALSE(found.planes.empty() && found.notes.empty());
  for (const PlanePrediction& plane : found.planes) {
    for (const EdgePrediction& edge : plane.edges) {
      EXPECT_TRUE(std::isfinite(edge.spacing_mm.most) && std::isfinite(edge.penumbra_mm.most) &&
                  std::isfinite(edge.ripple));
    }
  }
  return stated("one light: a prediction of finite numbers, or a note why there is none");
}
NO_EXTREME(predict, largest, "lengths alone")
NO_EXTREME(predict, odd_size, "lengths alone")
EXTREME(predict, scale) {
  double worst = 0.0;
  for (const double s : {1e-30, 1e30}) {
    worst = std::max(worst, std::abs(shadow_spacing(30.0 * s, 100.0 * s, 900.0 * s) /
                                         (s * shadow_spacing(30.0, 100.0, 900.0)) -
                                     1.0));
    worst = std::max(
        worst,
        std::abs(off_grid_error(3.5 * s, 3.75 * s) / (s * off_grid_error(3.5, 3.75)) - 1.0));
  }
  return bounded(worst, 1e-14, "all lengths scaled: relative change", "6 roundings");
}
NO_EXTREME(predict, subnormal, "lengths in mm")
EXTREME(predict, not_finite) {
  return refused("between plane and light", [] { (void)shadow_spacing(30.0, kNan, 900.0); });
}
EXTREME(predict, degenerate) {
  EXPECT_EQ(shadow_spacing(30.0, 0.0, 900.0), 0.0);
  EXPECT_EQ(penumbra_width(28.0, 0.0, 900.0), 0.0);
  Rig bare = cube();
  bare.planes.clear();
  return both(exact("an edge on the plane: spacing and penumbra 0"), refused("[[plane]]", [&] {
                (void)predict_rig(bare, {.low_mm = 1.0, .high_mm = 2.0});
              }));
}
EXTREME(predict, grazing) {
  EXPECT_GT(penumbra_width(28.0, 900.0 * (1.0 - 1e-12), 900.0), 1e13);
  return both(stated("an edge 1e-12 below the light: a penumbra of 1e13 mm"),
              refused("no face is above",
                      [] { (void)predict_rig(cube(), {.low_mm = 0.0, .high_mm = 950.0}); }));
}
EXTREME(predict, far_near) {
  return bounded(std::abs(shadow_spacing(30.0, 100.0, 1e9) / (3000.0 / (1e9 - 100.0)) - 1.0),
                 1e-14, "lights 1e6 times as far: relative error", "4 roundings");
}
NO_EXTREME(predict, duplicate, "lengths alone")
NO_EXTREME(predict, clipped, "no samples")

}  // namespace
}  // namespace haarlight::relight
