// SPDX-License-Identifier: Apache-2.0
/// @file
/// Shadows at many points: exact sums against the plain formula, blocks of lights against exact
/// sums, and the odd ends.

#include "relight/shadow/shadow_points.h"

#include <atomic>
#include <cmath>
#include <cstring>
#include <numbers>
#include <vector>

#include <gtest/gtest.h>

#include "core/parallel.h"
#include "core/random.h"
#include "haarlight/relight/shadow/receiver_light.h"
#include "haarlight/render/analytic/polygon_light.h"
#include "haarlight/render/light/light_tree.h"
#include "tests/relight/shadow/shadow_scene.h"
#include "tests/relight/shadow/window_reference.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;
using namespace shadow_scene;  // NOLINT(google-build-using-namespace): one scene's words

TEST_F(ShadowPoints, ExactSumsAreTheFormula) {
  const std::vector<render::SurfacePoint> receivers = hills(12);
  const std::vector<Vector3d> weights = environment(Kind::coloured, lights_, 3);
  const PointsResult found = run(receivers, weights);
  EXPECT_TRUE(found.report.is_exact);
  EXPECT_EQ(found.report.n_lights, 256);
  std::vector<Vector3d> sums(receivers.size(), Vector3d::Zero());
  for (std::size_t k = 0; k < lights_.size(); ++k) {
    const Visibility v = plate_shadow(frame_, lights_[k]);
    const WindowSums sums_k(v.value.view(), v.known.view());
    for (std::size_t i = 0; i < receivers.size(); ++i) {
      const LightWindow window =
          project_window(frame_.plane, lights_[k].centre, render::light_corners(lights_[k]),
                         receivers[i].point);
      const WindowMean mean =
          window_visibility(frame_, sums_k, window, WindowRule::corrected, 100.0 / kH);
      const render::SquareLight& light = lights_[k];
      if (receivers[i].flat_normal.dot(light.centre - receivers[i].point) <= 0.0) {
        continue;  // a light whose centre is below the surface gives nothing
      }
      sums[i] += mean.value *
                 receiver_irradiance(light, receivers[i].point, receivers[i].normal) *
                 weights[k];
    }
  }
  for (std::size_t i = 0; i < receivers.size(); ++i) {
    EXPECT_LT((found.totals[i].shadowed - sums[i]).norm(), 1e-10 * sums[i].norm()) << i;
  }
}

/// An occluder that says what it is asked about.
class Told final : public Occluder {
 public:
  explicit Told(OccluderLook look) : look_(look) {}
  [[nodiscard]] OccluderLook look(const Vector3d& /*point*/,
                                  const render::SquareLight& /*light*/) const override {
    ++n_asked;
    return look_;
  }
  [[nodiscard]] std::optional<OccluderLook> look_at_all(const Vector3d& /*point*/,
                                                        const Vector3d& /*centre*/,
                                                        double /*radius_mm*/) const override {
    return std::nullopt;
  }
  [[nodiscard]] double resolution_mm() const override { return 2.0; }
  mutable std::atomic<int> n_asked{0};

 private:
  OccluderLook look_;
};

/// One receiver under one light, the plane's picture known where x < 0 and lit there.
PointsResult under_one_light(double x, double z, ShadowMethod method,
                             const Occluder& occluder) {
  const std::vector<render::SquareLight> lights = ceiling(1, 30.0);
  const PlaneFrame frame = ground();
  const std::vector<SamplingPlane> planes{{frame,
                                           [&](int) {
                                             Visibility v = blank_picture(frame);
                                             for (int row = 0; row < frame.height; ++row) {
                                               for (int column = 0; column < frame.width / 2;
                                                    ++column) {
                                                 v.known(row, column) = 1;
                                                 v.value(row, column) = 1.0F;
                                               }
                                             }
                                             return v;
                                           },
                                           {}}};
  const std::vector<render::SurfacePoint> receivers{
      {{x, 0.0, z}, Vector3d::UnitZ(), Vector3d::UnitZ(), Vector3d::UnitZ(), 0}};
  return shadow_at_points(receivers, planes, lights, std::vector<Vector3d>{Vector3d::Ones()},
                          {.method = method, .occluder = &occluder});
}
double visible(const PointsResult& found) {
  return found.totals[0].shadowed.x() / found.totals[0].unshadowed.x();
}
double unseen(const PointsResult& found) {
  return found.totals[0].unseen.x() / found.totals[0].unshadowed.x();
}
double spread(const PointsResult& found) {
  return found.totals[0].spread.x() / found.totals[0].unshadowed.x();
}

TEST_F(ShadowPoints, TheOccluderTellsWhereThePicturesDoNot) {
  const Told told({0.25, 0.125, 0.5});
  // Hidden, on the plane: the pictures alone know nothing between dark and lit.
  const PointsResult plane = under_one_light(50.0, 0.0, ShadowMethod::plane, told);
  EXPECT_NEAR(visible(plane), 0.5, 1e-12);
  EXPECT_NEAR(unseen(plane), 0.5, 1e-12);
  EXPECT_EQ(told.n_asked, 0);
  const PointsResult both = under_one_light(50.0, 0.0, ShadowMethod::both, told);
  EXPECT_NEAR(visible(both), 0.25, 1e-12);
  EXPECT_NEAR(unseen(both), 0.25, 1e-12);  // to the farther bound
  EXPECT_EQ(told.n_asked, 1);
  // Known, on the plane and below it: measured, the occluder is not asked.
  for (const double z : {0.0, -20.0}) {
    EXPECT_NEAR(visible(under_one_light(-50.0, z, ShadowMethod::both, told)), 1.0, 1e-12);
  }
  EXPECT_EQ(told.n_asked, 1);
  // Above the plane, and beyond its picture: the occluder's answer.
  EXPECT_NEAR(visible(under_one_light(-50.0, 30.0, ShadowMethod::both, told)), 0.25, 1e-12);
  EXPECT_NEAR(visible(under_one_light(-300.0, 0.0, ShadowMethod::both, told)), 0.25, 1e-12);
  EXPECT_NEAR(visible(under_one_light(-50.0, 0.0, ShadowMethod::hull, told)), 0.25, 1e-12);
}

TEST_F(ShadowPoints, AWindowOfWhichHalfIsKnownIsHalfMeasured) {
  const Told told({0.0, 0.0, 0.0});
  // Below the plane the window is 28 h/(H + h) wide; its middle is at the border of the known.
  const PointsResult found = under_one_light(0.0, -400.0, ShadowMethod::both, told);
  EXPECT_NEAR(visible(found), 0.5, 1e-6);
  EXPECT_NEAR(unseen(found), 0.0, 1e-6);
  EXPECT_EQ(spread(found), 0.0);  // not requested
}

/// A shadow with a straight edge at x = 0 in every picture, and one receiver on the plane.
PointsResult beside_an_edge(double x, double resolution_mm, double deviation, int n_side,
                            float dark = 0.0F, const Occluder* occluder = nullptr) {
  const std::vector<render::SquareLight> lights = ceiling(n_side, 30.0);
  const PlaneFrame frame = ground();
  const std::vector<SamplingPlane> planes{
      {frame,
       [&](int) {
         Visibility v = blank_picture(frame);
         v.deviation = deviation;
         for (int row = 0; row < frame.height; ++row) {
           for (int column = 0; column < frame.width; ++column) {
             v.known(row, column) = 1;
             v.value(row, column) =
                 frame.world_of(column + 0.5, row + 0.5).x() < 0.0 ? dark : 1.0F;
           }
         }
         return v;
       },
       {},
       resolution_mm}};
  const std::vector<render::SurfacePoint> receivers{
      {{x, 0.0, 0.0}, Vector3d::UnitZ(), Vector3d::UnitZ(), Vector3d::UnitZ(), 0}};
  const std::vector<Vector3d> weights(lights.size(), Vector3d::Ones());
  return shadow_at_points(
      receivers, planes, lights, weights,
      {.method = occluder != nullptr ? ShadowMethod::both : ShadowMethod::plane,
       .occluder = occluder,
       .has_spread = true});
}

TEST_F(ShadowPoints, NoiseIsSettledWhereTheOccluderAgrees) {
  constexpr double kNoise = 0.02;
  const auto in_the_dark = [](float measured, const Occluder& occluder) {
    return beside_an_edge(-50.0, 0.0, kNoise, 1, measured, &occluder);
  };
  const Told hidden({0.0, 0.0, 0.0});
  const Told clear({1.0, 1.0, 1.0});
  const Told partly({0.03, 0.0, 1.0});
  // Within three deviations it is the occluder's; the bounds do not move.
  EXPECT_EQ(visible(in_the_dark(0.05F, hidden)), 0.0);
  EXPECT_EQ(unseen(in_the_dark(0.05F, hidden)), 0.0);
  EXPECT_NEAR(spread(in_the_dark(0.05F, hidden)), 0.05 + 3.0 * kNoise, 1e-6);
  EXPECT_NEAR(visible(in_the_dark(0.95F, clear)), 1.0, 1e-12);
  // What is measured stands against a hull that contradicts it: transparent matter.
  EXPECT_NEAR(visible(in_the_dark(0.3F, hidden)), 0.3 - 0.06 * 0.06 / 0.3, 1e-6);
  EXPECT_NEAR(visible(in_the_dark(0.3F, clear)), 0.3 + 0.06 * 0.06 / 0.7, 1e-6);
  // An edge of the occluder settles nothing.
  EXPECT_NEAR(visible(in_the_dark(0.05F, partly)), 0.05, 1e-6);
}

TEST_F(ShadowPoints, TheSpreadHoldsEdgesThatLieElsewhereWithinTheResolution) {
  const double texel = ground().texel_mm;
  for (const double resolution : {0.0, 6.0, 25.0}) {
    const double reach = std::max(texel, resolution);
    SCOPED_TRACE(resolution);
    for (const double side : {-1.0, 1.0}) {
      // Bilinear between texels: the edge is one texel wide itself.
      EXPECT_NEAR(spread(beside_an_edge(side * (reach + 0.6 * texel), resolution, 0.0, 1)), 0.0,
                  1e-9);
      EXPECT_NEAR(spread(beside_an_edge(side * (reach - 0.6 * texel), resolution, 0.0, 1)),
                  reach > texel ? 1.0 : 0.9, 1e-9);
    }
  }
}

TEST_F(ShadowPoints, TheSpreadHoldsThreeDeviationsOfMeasuredValues) {
  // Half dark far from the edge: only noise is left. It adds up over lights as variances do.
  for (const int n_side : {1, 4}) {
    const double n = n_side * n_side;
    const PointsResult found = beside_an_edge(-100.0, 0.0, 0.02, n_side, 0.5F);
    EXPECT_NEAR(visible(found), 0.5, 1e-6);
    // Equal lights would give exactly this; those at the side are weaker.
    EXPECT_GE(spread(found), 3.0 * 0.02 / std::sqrt(n) - 1e-12) << n_side;
    EXPECT_LT(spread(found), 1.3 * 3.0 * 0.02 / std::sqrt(n)) << n_side;
  }
  // What is settled as lit has none, and no spread exceeds what light there is.
  EXPECT_EQ(spread(beside_an_edge(100.0, 0.0, 0.02, 1)), 0.0);
  EXPECT_NEAR(spread(beside_an_edge(-100.0, 0.0, 9.0, 1, 0.75F)), 0.75, 1e-6);
}

// The edges of a block's lights are moved together, not each to where it changes most.
TEST_F(ShadowPoints, BlocksHaveMostOfTheSpreadOfTheirLights) {
  const std::vector<render::SurfacePoint> receivers = hills(40);
  const std::vector<Vector3d> weights = environment(Kind::smooth, lights_, 1);
  PointsOptions options = few();
  options.has_spread = true;
  const PointsResult exact = shadow_at_points(receivers, planes(), lights_, weights, options);
  options.tolerance.relative_l2 = 0.01;
  const PointsResult found = shadow_at_points(receivers, planes(), lights_, weights, options);
  ASSERT_FALSE(found.report.is_exact);
  double sum = 0.0;
  double exact_sum = 0.0;
  for (std::size_t i = 0; i < receivers.size(); ++i) {
    sum += found.totals[i].spread.sum();
    exact_sum += exact.totals[i].spread.sum();
  }
  EXPECT_GT(sum / exact_sum, 0.5);
  EXPECT_LT(sum / exact_sum, 1.05);
}

TEST_F(ShadowPoints, ToleranceZeroIsExactToTheBit) {
  const std::vector<render::SurfacePoint> receivers = hills(40);
  const std::vector<Vector3d> weights = environment(Kind::smooth, lights_, 1);
  const PointsResult exact =
      shadow_at_points(receivers, planes(), lights_, weights, PointsOptions{});
  EXPECT_TRUE(same_bits(run(receivers, weights, 0.0, 0.01), exact));
  EXPECT_TRUE(same_bits(run(receivers, weights, 0.01, 0.0), exact));
  // A tolerance that no block can keep refines all of them.
  const PointsResult fine = run(receivers, weights, 1e-12);
  EXPECT_LT(compare(fine, exact).relative_l2, 1e-12);
}

TEST_F(ShadowPoints, TheErrorIsKeptOnNoisyPictures) {
  const std::vector<render::SurfacePoint> receivers = hills(40);
  const std::vector<Vector3d> weights = environment(Kind::smooth, lights_, 5);
  const std::vector<SamplingPlane> noisy = planes(0.01);
  PointsOptions options = few();
  const PointsResult exact = shadow_at_points(receivers, noisy, lights_, weights, options);
  options.tolerance.relative_l2 = 0.01;
  const PointsResult found = shadow_at_points(receivers, noisy, lights_, weights, options);
  EXPECT_LE(compare(found, exact).relative_l2, 0.01);
  EXPECT_LT(found.report.lookups_a_point, 0.5 * 256.0);
}

TEST_F(ShadowPoints, OwnShadowsAreTheSameFactorInBothWays) {
  render::Scene scene;
  scene.materials.push_back({"grey", Vector3d::Constant(0.5), 0.0, 1.0});
  scene.meshes.push_back(
      render::make_quad({20, -200, 200}, {120, -200, 200}, {120, 200, 200}, {20, 200, 200}, 0));
  const render::RayCaster caster(scene);
  lights_ = ceiling(8);
  for (render::SquareLight& light : lights_) {
    light.width_mm = light.height_mm = 50.0;
  }
  const std::vector<render::SurfacePoint> receivers = hills(40);
  const std::vector<Vector3d> weights = environment(Kind::smooth, lights_, 2);
  PointsOptions options = few();
  options.own_shadows = &caster;
  const PointsResult exact = shadow_at_points(receivers, planes(), lights_, weights, options);
  const PointsResult open = run(receivers, weights);
  options.tolerance.relative_l2 = 0.01;
  const PointsResult found = shadow_at_points(receivers, planes(), lights_, weights, options);
  EXPECT_LE(compare(found, exact).relative_l2, 0.01);
  EXPECT_GT(compare(exact, open).relative_l2, 0.1);  // the plate does throw a shadow
}

/// Six faces round the origin, 8 x 8 lights each.
std::vector<render::SquareLight> cube() {
  std::vector<render::SquareLight> lights;
  for (int axis = 0; axis < 3; ++axis) {
    for (const double sign : {-1.0, 1.0}) {
      const Vector3d out = sign * Vector3d::Unit(axis);
      const Vector3d u = Vector3d::Unit((axis + 1) % 3);
      const Vector3d v = Vector3d::Unit((axis + 2) % 3);
      for (int row = 0; row < 8; ++row) {
        for (int col = 0; col < 8; ++col) {
          render::SquareLight light;
          light.centre = 900.0 * out + (col - 3.5) * 120.0 * u + (row - 3.5) * 120.0 * v;
          light.u = u;
          light.v = v;
          light.emits = -out;
          light.width_mm = light.height_mm = 50.0;
          lights.push_back(light);
        }
      }
    }
  }
  return lights;
}

TEST_F(ShadowPoints, SixFacesKeepTheToleranceOverTwoPlanes) {
  lights_ = cube();
  // A floor and a wall, with blots for shadows.
  ShadowPlane wall;
  wall.n = Vector3d::UnitX();
  wall.d = 150.0;
  wall.origin = {-150.0, 0.0, 100.0};
  wall.u = Vector3d::UnitY();
  wall.v = Vector3d::UnitZ();
  wall.extent_u_mm = wall.extent_v_mm = 400.0;
  wall.texel_mm = 4.0;
  const PlaneFrame wall_frame = make_plane_frame(wall);
  const auto blots = [](const PlaneFrame& frame) {
    return [&frame](int k) {
      Visibility v = blank_picture(frame);
      for (int y = 0; y < frame.height; ++y) {
        for (int x = 0; x < frame.width; ++x) {
          const double dx = x - 40.0 - k % 8;
          const double dy = y - 45.0 - k / 8 % 8;
          const double r = std::sqrt(dx * dx + dy * dy);
          v.value(y, x) = static_cast<float>(std::clamp(0.25 * (r - 16.0), 0.0, 1.0));
          v.known(y, x) = 1;
        }
      }
      return v;
    };
  };
  const std::vector<SamplingPlane> two{{frame_, blots(frame_), HeightRange{90.0, 120.0}},
                                       {wall_frame, blots(wall_frame), std::nullopt}};
  const std::vector<render::SurfacePoint> receivers = hills(40);
  for (const Kind kind : {Kind::smooth, Kind::nine}) {
    const std::vector<Vector3d> weights = environment(kind, lights_, 6);
    PointsOptions options = few();
    const PointsResult exact = shadow_at_points(receivers, two, lights_, weights, options);
    options.tolerance.relative_l2 = 0.01;
    const PointsResult found = shadow_at_points(receivers, two, lights_, weights, options);
    EXPECT_LE(compare(found, exact).relative_l2, 0.01);
    double no_point = 0.0;
    double light = 0.0;
    for (const PointTotal& total : exact.totals) {
      EXPECT_TRUE(total.shadowed.allFinite());
      EXPECT_TRUE((total.shadowed.array() <= total.unshadowed.array() * (1 + 1e-12)).all());
      no_point += total.no_point;
      light += total.light;
    }
    EXPECT_LT(no_point, light);
  }
}

TEST_F(ShadowPoints, TwoPlanesMeetTheTruthOnBothAndBeatOneBetween) {
  const PlaneFrame low = ground(-100.0, 2.0);
  frame_ = ground(0.0, 2.0);
  lights_ = ceiling(8);
  const auto source = [&](const PlaneFrame& frame) {
    return [&](int k) { return plate_shadow(frame, lights_[static_cast<std::size_t>(k)]); };
  };
  const SamplingPlane upper{frame_, source(frame_), HeightRange{100.0, 100.0}};
  const SamplingPlane lower{low, source(low), HeightRange{200.0, 200.0}};
  const std::vector<SamplingPlane> both{upper, lower};
  std::vector<Vector3d> weights(lights_.size(), Vector3d::Zero());
  weights[27] = Vector3d::Ones();
  const auto flat = [](double z) {
    std::vector<render::SurfacePoint> points = hills(90);
    for (render::SurfacePoint& point : points) {
      point.point.z() = z;
      point.normal = point.flat_normal = Vector3d::UnitZ();
    }
    return points;
  };
  const auto error = [&](const std::vector<SamplingPlane>& planes, double z) {
    const std::vector<render::SurfacePoint> points = flat(z);
    PointsOptions options = few();
    options.rule = WindowRule::none;
    const PointsResult found = shadow_at_points(points, planes, lights_, weights, options);
    const PlaneFrame there = ground(z, 0.5);
    const Visibility truth = plate_shadow(there, lights_[27]);
    const WindowSums sums(truth.value.view(), truth.known.view());
    double wrong = 0.0;
    for (std::size_t i = 0; i < points.size(); ++i) {
      const Eigen::Vector2d p = there.picture_of(points[i].point);
      const double v = sums.mean(p.x() - 0.5, p.x() + 0.5, p.y() - 0.5, p.y() + 0.5).value;
      const double got = found.totals[i].shadowed.x() / found.totals[i].unshadowed.x();
      wrong += std::pow(got - v, 2);
    }
    return std::sqrt(wrong / static_cast<double>(points.size()));
  };
  EXPECT_NEAR(error(both, 0.0), error({upper}, 0.0), 1e-12);
  EXPECT_NEAR(error(both, -100.0), error({lower}, -100.0), 1e-12);
  for (const double z : {-25.0, -50.0, -75.0}) {
    RecordProperty("both_at_" + std::to_string(static_cast<int>(-z)),
                   std::to_string(error(both, z)));
    EXPECT_LT(error(both, z), error({upper}, z)) << z;
    EXPECT_LT(error(both, z), error({lower}, z)) << z;
  }
}

// ---- the tree ----

TEST(LightTree, HoldsEveryActiveLightOnceAndMomentsAgree) {
  const std::vector<render::SquareLight> lights = ceiling(32);
  for (const Kind kind : {Kind::one, Kind::nine, Kind::smooth, Kind::rough}) {
    const std::vector<Vector3d> weights = environment(kind, lights, 8);
    std::vector<int> seen(lights.size(), 0);
    for (const render::LightRoot& root : render::build_light_trees(lights, weights, 8)) {
      for (std::size_t i = 0; i < root.nodes.size(); ++i) {
        const render::LightNode& node = root.nodes[i];
        if (node.n_children == 0) {
          ++seen[static_cast<std::size_t>(node.light)];
          continue;
        }
        ASSERT_GE(node.n_children, 2);
        Vector3d weight = Vector3d::Zero();
        double fraction = 0.0;
        Vector3d centre = Vector3d::Zero();
        for (int c = 0; c < node.n_children; ++c) {
          const int child_index = node.first_child + c;
          const render::LightNode& child = root.nodes[static_cast<std::size_t>(child_index)];
          weight += child.weight;
          fraction += child.fraction;
          centre += child.fraction * child.block.centre;
        }
        EXPECT_NEAR(fraction, 1.0, 1e-12);
        EXPECT_LT((weight - node.weight).norm(), 1e-12 * node.weight.norm());
        EXPECT_LT((centre - node.block.centre).norm(), 1e-9);
      }
    }
    for (std::size_t k = 0; k < lights.size(); ++k) {
      EXPECT_EQ(seen[k], weights[k].isZero(0.0) ? 0 : 1);
    }
  }
}

TEST(LightTree, AFullBlockIsTheSquareOfItsLights) {
  const std::vector<render::SquareLight> lights = ceiling(8);
  const std::vector<Vector3d> weights(lights.size(), Vector3d::Ones());
  const std::vector<render::LightRoot> roots = render::build_light_trees(lights, weights, 8);
  ASSERT_EQ(roots.size(), 1U);
  EXPECT_EQ(roots[0].nodes.size(), 64U + 16U + 4U + 1U);
  const render::SquareLight& block = roots[0].nodes[0].block;
  EXPECT_NEAR(block.width_mm, 960.0, 1.0);  // the last gap is missing
  EXPECT_LT((block.centre - Vector3d(0, 0, kH)).norm(), 1e-9);
  EXPECT_NEAR(roots[0].nodes[0].centres.width_mm, 840.0, 1e-9);
}

// ---- look-ups ----

TEST(ShadowLookup, IsProjectWindowAndWindowVisibility) {
  double worst = 0.0;
  for (std::uint64_t i = 0; i < 3000; ++i) {
    auto draw = [&, j = std::uint64_t{0}]() mutable {
      return 2.0 * uniform_unit(hash_key(31, i, ++j)) - 1.0;
    };
    ShadowPlane plane;
    const bool is_tilted = i % 3 != 0;
    const Eigen::AngleAxisd turn(is_tilted ? 0.4 * draw() : 0.0,
                                 Vector3d(draw(), draw(), 0.3).normalized());
    plane.n = turn * Vector3d::UnitZ();
    plane.u = turn * Vector3d::UnitX();
    plane.v = turn * Vector3d::UnitY();
    plane.origin = 30.0 * Vector3d(draw(), draw(), draw());
    plane.d = -plane.n.dot(plane.origin);
    plane.extent_u_mm = plane.extent_v_mm = 300.0;
    plane.texel_mm = 5.0;
    const PlaneFrame frame = make_plane_frame(plane);
    Visibility v{Image<float>(60, 60, 1), Image<std::uint8_t>(60, 60, 1), {}};
    for (std::size_t p = 0; p < v.value.pixels().size(); ++p) {
      v.value.pixels()[p] = static_cast<float>(0.5 + 0.5 * draw());
      v.known.pixels()[p] = p % 17 != i % 17 ? 1 : 0;
    }
    const WindowSums sums(v.value.view(), v.known.view());
    render::SquareLight light;
    light.centre = {400.0 * draw(), 400.0 * draw(), kH};
    light.width_mm = light.height_mm = 60.0;
    const Vector3d vertex(100.0 * draw(), 100.0 * draw(), 150.0 * draw());
    for (const WindowRule rule : {WindowRule::none, WindowRule::plain, WindowRule::corrected}) {
      const double object = 40.0 + 200.0 * (0.5 + 0.5 * draw());
      const HeightRange range{object, object};
      const ShadowLook found = look_up(frame, range, {rule, false}, place_light(frame, light),
                                       sums, locate_point(frame, vertex));
      if (found.side == PlaneSide::above && frame.height_of(vertex) >= object) {
        EXPECT_EQ(found.value, 1.0);
        continue;
      }
      const LightWindow window =
          project_window(frame.plane, light.centre, render::light_corners(light), vertex);
      const WindowMean mean =
          window_visibility(frame, sums, window, rule, object / frame.height_of(light.centre));
      worst = std::max(worst, std::abs(found.value - mean.value));
      worst = std::max(worst, std::abs(found.unknown - mean.unknown));
      worst = std::max(worst, std::abs(found.outside - mean.outside));
    }
  }
  EXPECT_LT(worst, 1e-7);  // of 5 mm pixels; strips of slanted windows
}

TEST(ShadowLookup, WhereABlockIsAllLitEveryLightIs) {
  const PlaneFrame frame = ground(0.0, 5.0);
  const std::vector<render::SquareLight> lights = ceiling(8);
  const std::vector<Vector3d> weights(lights.size(), Vector3d::Ones());
  const render::LightRoot root = render::build_light_trees(lights, weights, 8)[0];
  int n_lit = 0;
  for (std::uint64_t i = 0; i < 400; ++i) {
    auto draw = [&, j = std::uint64_t{0}]() mutable {
      return uniform_unit(hash_key(41, i, ++j));
    };
    // Dark pixels here and there.
    Visibility v{Image<float>(80, 80, 1), Image<std::uint8_t>(80, 80, 1), {}};
    for (std::size_t p = 0; p < v.value.pixels().size(); ++p) {
      v.value.pixels()[p] = draw() < 0.002 ? 0.0F : 1.0F;
      v.known.pixels()[p] = 1;
    }
    const WindowSums sums(v.value.view(), v.known.view());
    const HeightRange range{50.0, 120.0};
    const Vector3d vertex(200.0 * (draw() - 0.5), 200.0 * (draw() - 0.5),
                          250.0 * (draw() - 0.7));
    const PlaneSpot spot = locate_point(frame, vertex);
    for (std::size_t at = 1; at < root.nodes.size(); ++at) {
      const render::LightNode& node = root.nodes[at];
      const auto rule = static_cast<WindowRule>(i % 3);
      if (node.n_children == 0 ||
          !is_all_lit(frame, range, rule, place_light(frame, node.centres),
                      place_light(frame, lights[0]), sums, spot)) {
        continue;
      }
      ++n_lit;
      for (int c = 0; c < node.n_children; ++c) {
        const int child_index = node.first_child + c;
        const render::LightNode& child = root.nodes[static_cast<std::size_t>(child_index)];
        if (child.n_children == 0) {
          EXPECT_NEAR(
              look_up(frame, range, {rule, false}, place_light(frame, child.block), sums, spot)
                  .value,
              1.0, 1e-6);
        }
      }
    }
  }
  EXPECT_GT(n_lit, 100);
}

}  // namespace
}  // namespace haarlight::relight
