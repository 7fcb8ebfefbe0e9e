// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/shadow/area_mean.h"

#include <cmath>
#include <cstdio>
#include <vector>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <rapidcheck/gtest.h>

#include "core/random.h"
#include "haarlight/render/analytic/polygon_light.h"
#include "relight/shadow/shadow_lookup.h"
#include "tests/golden_file.h"
#include "tests/relight/shadow/shadow_scene.h"

namespace haarlight::relight {
namespace {

using shadow_scene::edge_width;

using nlohmann::json;
constexpr double kEps = 0x1p-52;

Eigen::Vector3d vector_of(const json& v) {
  return {v[0].get<double>(), v[1].get<double>(), v[2].get<double>()};
}

render::SquareLight square(const Eigen::Vector3d& centre, double side) {
  render::SquareLight light;
  light.centre = centre;
  light.width_mm = side;
  light.height_mm = side;
  return light;
}

TEST(AreaMean, WindowHoldsToTheGoldenFile) {
  const json golden = test::read_golden("area_mean.json");
  ASSERT_EQ(golden.at("cases").size(), 7U);
  for (const json& c : golden.at("cases")) {
    const double side = c.at("led_side").get<double>();
    const double height = c.at("H").get<double>();
    const Eigen::Vector3d v = vector_of(c.at("v"));
    const Plane plane{vector_of(c.at("n")), c.at("d").get<double>()};
    const render::SquareLight led = square(vector_of(c.at("led_centre")), side);
    const LightWindow window = project_window(plane, led.centre, render::light_corners(led), v);
    EXPECT_EQ(window.has_corners, c.at("valid").get<bool>()) << c.at("name");
    if (!c.at("valid").get<bool>()) {
      continue;
    }
    // The condition of p for a plane through the origin is at most 2 (|l| + |v|) H/(H - h).
    const double tolerance = 16 * kEps * 2000.0 * height / (height - v.z());
    for (std::size_t i = 0; i < 4; ++i) {
      EXPECT_LE((window.corners[i] - vector_of(c.at("corners")[i])).cwiseAbs().maxCoeff(),
                tolerance)
          << c.at("name");
    }
    EXPECT_NEAR(window_side(side, v.z(), height), c.at("window").get<double>(),
                8 * kEps * c.at("window").get<double>());
    EXPECT_NEAR(window_side(c.at("led_pitch").get<double>(), v.z(), height),
                c.at("spacing").get<double>(), 8 * kEps * c.at("spacing").get<double>());
    EXPECT_NEAR((window.corners[2] - window.corners[0]).head<2>().cwiseAbs().maxCoeff(),
                c.at("window").get<double>(), 2 * tolerance);
  }
}

struct Picture {
  Image<float> value;
  Image<std::uint8_t> known;
};

Picture random_picture(int height, int width, std::uint64_t seed, double unknown_fraction) {
  Picture picture{Image<float>(height, width, 1), Image<std::uint8_t>(height, width, 1)};
  for (std::size_t i = 0; i < picture.value.pixels().size(); ++i) {
    picture.value.pixels()[i] = static_cast<float>(uniform_unit(hash_key(seed, i, 1)));
    picture.known.pixels()[i] = uniform_unit(hash_key(seed, i, 2)) < unknown_fraction ? 0 : 1;
  }
  return picture;
}

/// Mean over a rectangle inside the picture by adding up the pixels' overlaps.
WindowMean slow_mean(const Picture& picture, double x0, double x1, double y0, double y1) {
  double sum = 0.0;
  double unknown = 0.0;
  for (int y = 0; y < picture.value.height(); ++y) {
    for (int x = 0; x < picture.value.width(); ++x) {
      const double w = std::max(0.0, std::min(x1, x + 1.0) - std::max(x0, double(x)));
      const double h = std::max(0.0, std::min(y1, y + 1.0) - std::max(y0, double(y)));
      (picture.known(y, x) != 0 ? sum : unknown) +=
          w * h * (picture.known(y, x) != 0 ? double(picture.value(y, x)) : 1.0);
    }
  }
  const double area = (x1 - x0) * (y1 - y0);
  return {(sum + 0.5 * unknown) / area, unknown / area, 0.0};
}

RC_GTEST_PROP(WindowSums, EqualTheSumOfOverlaps, (std::uint32_t seed)) {
  const Picture picture = random_picture(9, 13, seed, 0.2);
  const WindowSums sums(picture.value.view(), picture.known.view());
  const double x0 = 12.0 * uniform_unit(hash_key(seed, 3));
  const double x1 = x0 + 0.05 + (12.9 - x0) * uniform_unit(hash_key(seed, 4));
  const double y0 = 8.0 * uniform_unit(hash_key(seed, 5));
  const double y1 = y0 + 0.05 + (8.9 - y0) * uniform_unit(hash_key(seed, 6));
  const WindowMean fast = sums.mean(x0, x1, y0, y1);
  const WindowMean slow = slow_mean(picture, x0, x1, y0, y1);
  // Differences of sums up to 117, divided by areas down to 0.0025.
  RC_ASSERT(std::abs(fast.value - slow.value) < 117 * 16 * kEps / 0.0025);
  RC_ASSERT(std::abs(fast.unknown - slow.unknown) < 117 * 16 * kEps / 0.0025);
}

RC_GTEST_PROP(WindowSums, QuadAlongTheAxesEqualsItsRectangle, (std::uint32_t seed)) {
  const Picture picture = random_picture(9, 13, seed, 0.2);
  const WindowSums sums(picture.value.view(), picture.known.view());
  const double x0 = 20.0 * uniform_unit(hash_key(seed, 3)) - 4.0;
  const double x1 = x0 + 0.1 + 9.0 * uniform_unit(hash_key(seed, 4));
  const double y0 = 16.0 * uniform_unit(hash_key(seed, 5)) - 4.0;
  const double y1 = y0 + 0.1 + 9.0 * uniform_unit(hash_key(seed, 6));
  const WindowMean rectangle = sums.mean(x0, x1, y0, y1);
  const WindowMean quad = sums.mean({Eigen::Vector2d(x0, y0), Eigen::Vector2d(x1, y0),
                                     Eigen::Vector2d(x1, y1), Eigen::Vector2d(x0, y1)});
  RC_ASSERT(std::abs(rectangle.value - quad.value) < 1e-9);
  RC_ASSERT(std::abs(rectangle.unknown - quad.unknown) < 1e-9);
  RC_ASSERT(std::abs(rectangle.outside - quad.outside) < 1e-9);
}

TEST(WindowSums, TurnedSquareOverARampHasItsCentresValue) {
  Picture ramp{Image<float>(64, 64, 1), Image<std::uint8_t>(64, 64, 1)};
  for (int y = 0; y < 64; ++y) {
    for (int x = 0; x < 64; ++x) {
      ramp.value(y, x) = (static_cast<float>(x) + 0.5F) / 64.0F;
      ramp.known(y, x) = 1;
    }
  }
  const WindowSums sums(ramp.value.view(), ramp.known.view());
  for (int i = 0; i < 16; ++i) {
    const double angle = 0.1 * i;
    const Eigen::Vector2d a(8.0 * std::cos(angle), 8.0 * std::sin(angle));
    const Eigen::Vector2d b(-a.y(), a.x());
    const Eigen::Vector2d c(30.3, 31.7);
    const WindowMean mean = sums.mean({Eigen::Vector2d(c - a), Eigen::Vector2d(c - b),
                                       Eigen::Vector2d(c + a), Eigen::Vector2d(c + b)});
    EXPECT_NEAR(mean.value, 30.3 / 64.0, 2e-3);  // pixels are steps of 1/64
  }
}

TEST(WindowSums, BoundsTheUnknownAndCountsTheOutside) {
  Picture picture{Image<float>(4, 4, 1), Image<std::uint8_t>(4, 4, 1)};
  for (float& v : picture.value.pixels()) {
    v = 1.0F;
  }
  for (int y = 0; y < 4; ++y) {
    picture.known(y, 0) = 1;
    picture.known(y, 1) = 1;  // columns 2 and 3 are unknown
  }
  const WindowSums sums(picture.value.view(), picture.known.view());
  const WindowMean inside = sums.mean(0.0, 4.0, 0.0, 4.0);
  EXPECT_DOUBLE_EQ(inside.value, 0.75);
  EXPECT_DOUBLE_EQ(inside.unknown, 0.5);
  const WindowMean half_out = sums.mean(-2.0, 2.0, 0.0, 4.0);
  EXPECT_DOUBLE_EQ(half_out.outside, 0.5);
  EXPECT_DOUBLE_EQ(half_out.value, 1.0);
  const WindowMean out = sums.mean(10.0, 11.0, 0.0, 1.0);
  EXPECT_DOUBLE_EQ(out.outside, 1.0);
  EXPECT_DOUBLE_EQ(out.value, 1.0);
}

TEST(WindowSums, WithoutAreaAWindowIsThePixelThere) {
  Picture picture{Image<float>(7, 9, 1), Image<std::uint8_t>(7, 9, 1)};
  std::fill(picture.known.pixels().begin(), picture.known.pixels().end(), std::uint8_t{1});
  picture.value(3, 4) = 0.25F;
  const WindowSums sums(picture.value.view(), picture.known.view());
  EXPECT_EQ(sums.mean(4.5, 4.5, 3.5, 3.5).value, 0.25);
  EXPECT_EQ(sums.mean(4.0, 5.0, 3.5, 3.5).value, 0.25);
}

// A straight edge at height h_o under a light of side s at height H: every width has a closed
// form.

constexpr double kH = 900.0;
constexpr double kSide = 28.0;
constexpr double kEdge = 150.0;

/// Visibility of the light from (x, height) past a blade that covers x > 0 at kEdge: the
/// fraction of the light that lies beyond the ray through the edge.
double true_visibility(double light_x, double x, double height) {
  // The ray from (x, height) through the edge (0, kEdge) reaches the light's height at:
  const double at = x - x * (kH - height) / (kEdge - height);
  return std::clamp((at - (light_x - 0.5 * kSide)) / kSide, 0.0, 1.0);
}

struct Widths {
  double truth;
  double none;
  double plain;
  double corrected;
};

Widths measure_widths(double receiver_height) {
  const double light_x = 15.0;
  PlaneFrame frame;
  frame.texel_mm = 0.02;
  frame.width = 4000;
  frame.height = 8;
  frame.x0_mm = -40.0;
  frame.y0_mm = 0.08;
  Picture shadow{Image<float>(frame.height, frame.width, 1),
                 Image<std::uint8_t>(frame.height, frame.width, 1)};
  for (int y = 0; y < frame.height; ++y) {
    for (int x = 0; x < frame.width; ++x) {
      const double world_x = frame.world_of(x + 0.5, y + 0.5).x();
      shadow.value(y, x) = static_cast<float>(true_visibility(light_x, world_x, 0.0));
      shadow.known(y, x) = 1;
    }
  }
  const WindowSums sums(shadow.value.view(), shadow.known.view());
  const PlaneLight placed = place_light(frame, square({light_x, 0.0, kH}, kSide));
  std::vector<std::vector<double>> profiles(4);
  constexpr double kStep = 0.02;
  for (double x = -30.0; x < 30.0; x += kStep) {
    const PlaneSpot receiver = locate_point(frame, {x, 0.0, receiver_height});
    profiles[0].push_back(true_visibility(light_x, x, receiver_height));
    for (const WindowRule rule : {WindowRule::none, WindowRule::plain, WindowRule::corrected}) {
      profiles[1 + static_cast<std::size_t>(rule)].push_back(
          look_up(frame, HeightRange{kEdge, kEdge}, {rule, false}, placed, sums, receiver)
              .value);
    }
  }
  return {edge_width(profiles[0], kStep), edge_width(profiles[1], kStep),
          edge_width(profiles[2], kStep), edge_width(profiles[3], kStep)};
}

TEST(EdgeWidth, TruthFollowsThePenumbraFormula) {
  std::printf("| receiver mm | truth mm | none | plain | corrected |\n|---|---|---|---|---|\n");
  for (const double h : {-400.0, -180.0, -150.0, -50.0, 0.0, 50.0, 100.0}) {
    const Widths w = measure_widths(h);
    EXPECT_NEAR(w.truth, kSide * (kEdge - h) / (kH - kEdge), 0.01) << h;
    std::printf("| %+.0f | %.2f | %.2f | %.2f | %.2f |\n", h, w.truth, w.none / w.truth,
                w.plain / w.truth, w.corrected / w.truth);
  }
}

TEST(EdgeWidth, AbovePlaneTheWindowMakesItWorse) {
  // spec/relight.md: without 1.4 and 2.7 times, with 1.5 and 3.1 times.
  const Widths at_50 = measure_widths(50.0);
  EXPECT_NEAR(at_50.none / at_50.truth, 1.4, 0.05);
  EXPECT_NEAR(at_50.plain / at_50.truth, 1.5, 0.05);
  const Widths at_100 = measure_widths(100.0);
  EXPECT_NEAR(at_100.none / at_100.truth, 2.7, 0.05);
  EXPECT_NEAR(at_100.plain / at_100.truth, 3.1, 0.05);
  EXPECT_NEAR(at_100.none / at_100.truth, widening_above(100.0 / kH, kEdge / kH), 0.01);
  EXPECT_DOUBLE_EQ(at_100.corrected, at_100.none);
}

TEST(EdgeWidth, OnThePlaneNothingIsNeeded) {
  const Widths w = measure_widths(0.0);
  EXPECT_NEAR(w.none / w.truth, 1.0, 2e-3);
  EXPECT_NEAR(w.plain / w.truth, 1.0, 2e-3);
}

TEST(EdgeWidth, BelowThePlaneOnlyTheCorrectedWindowIsRight) {
  for (const double h : {-20.0, -50.0, -150.0, -400.0}) {
    const Widths w = measure_widths(h);
    EXPECT_NEAR(w.corrected / w.truth, 1.0, 0.01) << h;
    EXPECT_LT(w.none, w.plain);
    EXPECT_LT(w.plain, w.truth);
  }
  // "A quarter short": deepest where B = W.
  const Widths w = measure_widths(-180.0);
  RecordProperty("plain_at_minus_180", std::to_string(w.plain / w.truth));
  EXPECT_NEAR(w.plain / w.truth, 0.71, 0.02);
}

TEST(EdgeWidth, CorrectedScaleIsTheFormulaOfTheSpec) {
  for (const double h : {-1.0, -50.0, -700.0}) {
    const double B = kSide * kEdge / (kH - kEdge);
    const double W = window_side(kSide, h, kH);
    EXPECT_NEAR(W * corrected_window_scale(h / kH, kEdge / kH), std::sqrt(W * W + 2 * B * W),
                1e-12);
  }
}

}  // namespace
}  // namespace haarlight::relight
