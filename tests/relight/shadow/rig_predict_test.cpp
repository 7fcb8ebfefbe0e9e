// SPDX-License-Identifier: Apache-2.0
/// @file
/// The design tool's numbers against pictures that the renderer of the virtual rig makes:
/// spacing, penumbra and ripple measured on them agree within 5 %.

#include "relight/shadow/rig_predict.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/relight/shadow/predict.h"
#include "haarlight/render/direct/picture.h"
#include "haarlight/render/light/rig_lights.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;

Rig cube() { return read_rig("configs/rigs/cube32.toml"); }

/// A camera that sees a strip of the plane in front of the object, 20 pixels a mm along it.
CameraModel strip_camera(const Vector3d& target, int height, double focal = 6000.0) {
  CameraModel camera;
  camera.width = 12;
  camera.height = height;
  camera.fx = camera.fy = focal;
  camera.cx = 0.5 * camera.width;
  camera.cy = 0.5 * camera.height;
  camera.world_from_cam = look_at({0.0, -560.0, 520.0}, target, Vector3d::UnitZ());
  return camera;
}

render::Scene ground(const Vector3d& u, const Vector3d& v) {
  render::Scene scene;
  scene.materials.push_back({"white", Vector3d::Constant(0.8), 0.0, 1.0});
  const Vector3d a = 1000.0 * u;
  const Vector3d b = 1000.0 * v;
  scene.meshes.push_back(render::make_quad(-a - b, a - b, a + b, -a + b, 0));
  return scene;
}

/// V along the picture's rows, and how far along the direction each row looks on the plane.
struct Profile {
  std::vector<double> at_mm;
  std::vector<double> value;
};

Profile profile(const render::Scene& empty, const render::Scene& full,
                const CameraModel& camera, std::span<const render::SquareLight> lights,
                std::span<const Vector3d> weights, const Plane& plane, const Vector3d& along) {
  render::LitOptions options;
  options.n_subpixels = 1;
  const render::LitPicture lit = render::render_lit(full, camera, lights, weights, options);
  const render::LitPicture plate = render::render_lit(empty, camera, lights, weights, options);
  Profile found;
  for (int y = camera.height; y-- > 0;) {
    double t = 0.0;
    double b = 0.0;
    for (int x = 0; x < camera.width; ++x) {
      t += static_cast<double>(lit.radiance(y, x, 1));
      b += static_cast<double>(plate.radiance(y, x, 1));
    }
    const CameraRay ray = ray_through(camera, 0.5 * camera.width, y + 0.5);
    const double height = plane.n.dot(ray.origin_world) + plane.d;
    const Vector3d foot =
        ray.origin_world - ray.direction_world * (height / plane.n.dot(ray.direction_world));
    found.at_mm.push_back(foot.dot(along));
    found.value.push_back(t / b);
  }
  return found;
}

/// Position and width (root of 12 times the rms width) of the one edge in a profile.
struct Edge {
  double position = 0.0;
  double width = 0.0;
};

Edge edge_of(const Profile& p) {
  double mass = 0.0;
  double first = 0.0;
  double second = 0.0;
  for (std::size_t i = 1; i < p.value.size(); ++i) {
    const double step = p.value[i] - p.value[i - 1];
    const double x = 0.5 * (p.at_mm[i] + p.at_mm[i - 1]);
    mass += step;
    first += step * x;
    second += step * x * x;
  }
  const double mean = first / mass;
  return {mean, std::sqrt(12.0 * (second / mass - mean * mean))};
}

std::vector<Vector3d> only(std::size_t n, std::size_t k) {
  std::vector<Vector3d> weights(n, Vector3d::Zero());
  weights[k] = Vector3d::Ones();
  return weights;
}

TEST(RigPredict, SpacingAndPenumbraAreThoseOfThePictures) {
  const Rig rig = cube();
  const std::vector<render::SquareLight> lights = render::rig_lights(rig);
  for (const double h : {76.0, 150.0}) {
    const RigPrediction prediction = predict_rig(rig, {.low_mm = h, .high_mm = h});
    ASSERT_EQ(prediction.planes.size(), 1U);
    const EdgePrediction& edge = prediction.planes[0].edges.at(0);
    // A half plane with its edge at y = 0, seen from below and in front.
    const render::Scene empty = ground(Vector3d::UnitX(), Vector3d::UnitY());
    render::Scene full = empty;
    full.meshes.push_back(
        render::make_quad({-400, 0, h}, {400, 0, h}, {400, 600, h}, {-400, 600, h}, 0));
    const Plane plane{Vector3d::UnitZ(), 0.0};
    std::vector<Edge> edges;
    for (const std::size_t row : {20U, 21U}) {
      const std::size_t k = row * 32 + 16;
      const double y = -lights[k].centre.y() * h / (900.0 - h);
      edges.push_back(edge_of(profile(empty, full, strip_camera({0.0, y, 0.0}, 200), lights,
                                      only(lights.size(), k), plane, Vector3d::UnitY())));
    }
    const double spacing = std::abs(edges[1].position - edges[0].position);
    RecordProperty("spacing_" + std::to_string(static_cast<int>(h)),
                   std::to_string(spacing / edge.spacing_mm.middle));
    RecordProperty("penumbra_" + std::to_string(static_cast<int>(h)),
                   std::to_string(edges[0].width / edge.penumbra_mm.middle));
    EXPECT_NEAR(spacing, edge.spacing_mm.middle, 0.05 * edge.spacing_mm.middle);
    EXPECT_NEAR(edges[0].width, edge.penumbra_mm.middle, 0.05 * edge.penumbra_mm.middle);
    EXPECT_NEAR(edges[1].width, edge.penumbra_mm.middle, 0.05 * edge.penumbra_mm.middle);
    EXPECT_NEAR(edge.spacing_mm.middle, shadow_spacing(30.0, h, 900.0), 1e-9);
    EXPECT_NEAR(edge.penumbra_mm.most, penumbra_width(28.0, h, 900.0), 1e-9);
  }
}

TEST(RigPredict, RippleIsThatOfThePictures) {
  const Rig rig = cube();
  const std::vector<render::SquareLight> lights = render::rig_lights(rig);
  constexpr double kHeight = 95.0;
  // As seen from the plane the strip covers 3 pitches and 16 mm: the gap can hide in it whole.
  const double strip = 106.0 * kHeight / 900.0;
  const RigPrediction prediction =
      predict_rig(rig, {.low_mm = kHeight, .high_mm = kHeight, .strip_mm = strip});
  const render::Scene empty = ground(Vector3d::UnitX(), Vector3d::UnitY());
  render::Scene full = empty;
  const double half = 0.5 * strip;
  full.meshes.push_back(render::make_quad({-300, -half, kHeight}, {300, -half, kHeight},
                                          {300, half, kHeight}, {-300, half, kHeight}, 0));
  // One row of lights across the strip: others add the same ripple. Their falloff is taken
  // out, so that the gaps alone are left.
  std::vector<Vector3d> weights(lights.size(), Vector3d::Zero());
  for (std::size_t row = 0; row < 32; ++row) {
    const std::size_t k = row * 32 + 16;
    weights[k].setConstant(1e-4 * std::pow(lights[k].centre.squaredNorm() / 810000.0, 2));
  }
  const Profile found = profile(empty, full, strip_camera({0.0, 0.0, 0.0}, 120, 12000.0),
                                lights, weights, {Vector3d::UnitZ(), 0.0}, Vector3d::UnitY());
  // Over whole periods: the depth's mean, and its two levels.
  const double period = shadow_spacing(30.0, kHeight, 900.0);
  std::vector<double> depth;
  for (std::size_t i = 0; i < found.value.size(); ++i) {
    if (found.at_mm[i] < found.at_mm[0] + 2.0 * period) {
      depth.push_back(1.0 - found.value[i]);
    }
  }
  ASSERT_GT(found.at_mm.back() - found.at_mm[0], 2.0 * period);
  std::sort(depth.begin(), depth.end());
  const auto mean_of = [&](double from, double to) {
    double sum = 0.0;
    double n = 0.0;
    for (auto i = static_cast<std::size_t>(from * static_cast<double>(depth.size()));
         i < static_cast<std::size_t>(to * static_cast<double>(depth.size())); ++i) {
      sum += depth[i];
      n += 1.0;
    }
    return sum / n;
  };
  const double ripple = (mean_of(0.7, 0.95) - mean_of(0.05, 0.3)) / mean_of(0.0, 1.0);
  const double predicted = prediction.planes[0].edges[0].ripple;
  RecordProperty("ripple_measured", std::to_string(ripple));
  RecordProperty("ripple_predicted", std::to_string(predicted));
  EXPECT_NEAR(ripple, predicted, 0.05 * predicted);
}

TEST(RigPredict, OnATiltedPlaneSpacingChangesFromPositionToPositionAsInThePictures) {
  Rig rig = cube();
  const double tilt = 20.0 * std::numbers::pi / 180.0;
  ShadowPlane& plane = rig.planes[0];
  plane.n = {0.0, -std::sin(tilt), std::cos(tilt)};
  plane.v = {0.0, std::cos(tilt), std::sin(tilt)};
  const double h = 100.0;
  const RigPrediction prediction = predict_rig(rig, {.low_mm = h, .high_mm = h});
  const PlanePrediction& found = prediction.planes.at(0);
  EXPECT_NEAR(found.tilt_deg, 20.0, 1e-9);
  const Span spacing = found.edges[0].spacing_mm;
  EXPECT_LT(spacing.least, 0.95 * spacing.most);
  const std::vector<render::SquareLight> lights = render::rig_lights(rig);
  const Plane tilted{plane.n, 0.0};
  for (const double position : {-120.0, 0.0, 120.0}) {
    // A half plane parallel to the shadow plane, its edge over `position`.
    const Vector3d edge = position * plane.v + h * plane.n;
    const render::Scene empty = ground(plane.u, plane.v);
    render::Scene full = empty;
    full.meshes.push_back(render::make_quad(edge - 400.0 * plane.u, edge + 400.0 * plane.u,
                                            edge + 400.0 * plane.u + 500.0 * plane.v,
                                            edge - 400.0 * plane.u + 500.0 * plane.v, 0));
    std::vector<double> positions;
    for (const std::size_t row : {24U, 25U}) {
      const std::size_t k = row * 32 + 16;
      const Vector3d target = project_to_plane(tilted, lights[k].centre, edge).point;
      positions.push_back(edge_of(profile(empty, full, strip_camera(target, 240), lights,
                                          only(lights.size(), k), tilted, plane.v))
                              .position);
    }
    const double measured = std::abs(positions[1] - positions[0]);
    const double predicted = *shadow_distance(tilted, edge, lights[24 * 32 + 16].centre,
                                              lights[25 * 32 + 16].centre);
    EXPECT_NEAR(measured, predicted, 0.05 * predicted) << position;
    EXPECT_GE(predicted, spacing.least);
    EXPECT_LE(predicted, spacing.most);
  }
}

TEST(RigPredict, ReceiversAndPixels) {
  const Rig rig = cube();
  const RigPrediction prediction =
      predict_rig(rig, {.low_mm = 150.0, .high_mm = 150.0, .receivers = {-100.0, 0.0, 50.0}});
  const EdgePrediction& edge = prediction.planes[0].edges.at(0);
  ASSERT_EQ(edge.receivers.size(), 3U);
  EXPECT_NEAR(edge.receivers[0].penumbra_mm, 28.0 * 250.0 / 750.0, 1e-9);
  EXPECT_NEAR(edge.receivers[0].drawn_mm, edge.receivers[0].penumbra_mm, 1e-6);
  EXPECT_NEAR(edge.receivers[1].drawn_mm, edge.receivers[1].penumbra_mm, 1e-9);
  EXPECT_NEAR(edge.receivers[2].drawn_mm / edge.receivers[2].penumbra_mm, 1.42, 0.01);
  EXPECT_NEAR(edge.off_grid_error_mm / edge.spacing_mm.middle, 0.048, 0.001);
  ASSERT_TRUE(edge.hard_sun_error_mm);
  // The camera's pixel by its focal length: 1.7 mm across, longer along its line of sight.
  ASSERT_EQ(prediction.pixels.size(), 1U);
  const double across = (rig.cameras[0].model.centre_world()).norm() / 439.6;
  EXPECT_NEAR(prediction.pixels[0].pixel_mm.middle, across / 0.68, 0.05 * across);
}

TEST(RigPredict, SaysWhatIsWrong) {
  const Rig rig = cube();
  const auto message = [](const Rig& r, const PredictOptions& options) {
    try {
      (void)predict_rig(r, options);
    } catch (const Error& error) {
      return std::string(error.what());
    }
    return std::string("no error");
  };
  EXPECT_NE(message(rig, {.low_mm = -5.0, .high_mm = 10.0}).find("under the plane"),
            std::string::npos);
  EXPECT_NE(message(rig, {.low_mm = 50.0, .high_mm = 10.0}).find("not above its lowest"),
            std::string::npos);
  EXPECT_NE(message(rig, {.low_mm = 0.0, .high_mm = 950.0}).find("no face is above"),
            std::string::npos);
  EXPECT_NE(message(rig, {.low_mm = 0.0, .high_mm = 9.0, .strip_mm = 0.0}).find("strip"),
            std::string::npos);
  EXPECT_NE(
      message(rig, {.low_mm = 0.0, .high_mm = 9.0, .receivers = {900.0}}).find("below the"),
      std::string::npos);
  Rig bare = rig;
  bare.planes.clear();
  EXPECT_NE(message(bare, {.low_mm = 1.0, .high_mm = 2.0}).find("[[plane]]"),
            std::string::npos);
  Rig down = rig;
  down.faces[0].emits = Vector3d::UnitZ();
  EXPECT_NE(message(down, {.low_mm = 1.0, .high_mm = 2.0}).find("from above"),
            std::string::npos);
}

}  // namespace
}  // namespace haarlight::relight
