// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "haarlight/relight/shape/integrate_normals.h"
#include "haarlight/relight/shape/photometric_stereo.h"
#include "haarlight/relight/shape/slope_field.h"
#include "tests/extremes.h"
#include "tests/relight/shape/made_lights.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;
using extremes::both;
using extremes::bounded;
using extremes::Cell;
using extremes::exact;
using extremes::refused;
using extremes::stated;
using testing::degrees_between;
using testing::dome_directions;
using testing::far_capture;
using testing::far_lights;
using testing::kMethods;
using testing::MadeSurface;
using testing::vector_at;
using testing::with;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

// ---- photometric stereo ----

EXTREMES_OF(stereo, "relight/shape", "photometric stereo, far and near lights, all three fits")

/// Normals within 35 degrees of z.
Vector3d bowl_normal(int y, int x) {
  return Vector3d(0.1 * (x - 2.5), 0.1 * (2.5 - y), 1.0).normalized();
}
MadeSurface bowl(double albedo = 1.0) {
  return {[](int, int) { return Vector3d(Vector3d::Zero()); }, bowl_normal,
          [albedo](int) { return albedo; }};
}

/// No NaN anywhere, and a normal exactly where the pixel is good.
void expect_told(const SurfaceEstimate& found) {
  for (int y = 0; y < found.state.height(); ++y) {
    for (int x = 0; x < found.state.width(); ++x) {
      EXPECT_TRUE(vector_at(found.normal, y, x).allFinite());
      EXPECT_TRUE(std::isfinite(found.albedo(y, x)) && std::isfinite(found.error(y, x)));
      EXPECT_EQ(vector_at(found.normal, y, x).isZero(),
                found.state(y, x) != static_cast<int>(PixelState::good));
    }
  }
}

/// Largest error of a normal, degrees, over the three fits; all pixels must be good.
double worst_normal(const MemoryStack& stack, const StereoLights& lights,
                    ImageView<const float> points = {}) {
  double worst = 0.0;
  for (const LambertMethod method : kMethods) {
    const SurfaceEstimate found = photometric_stereo(stack, lights, points, {}, with(method));
    expect_told(found);
    EXPECT_EQ(found.n_in(PixelState::good), stack.dims().width * stack.dims().height);
    for (int y = 0; y < stack.dims().height; ++y) {
      for (int x = 0; x < stack.dims().width; ++x) {
        worst =
            std::max(worst, degrees_between(vector_at(found.normal, y, x), bowl_normal(y, x)));
      }
    }
  }
  return worst;
}

/// Every pixel of a stack of which pixel 0 alone has these values.
SurfaceEstimate one_pixel(LambertMethod method, const std::function<double(int k)>& value) {
  MemoryStack stack({1, 1, 1, 8});
  for (int k = 0; k < 8; ++k) {
    stack.at(0, 0, 0, k) = static_cast<float>(value(k));
  }
  StereoOptions options = with(method);
  options.saturation.assign(8, 1.0F);
  SurfaceEstimate found = photometric_stereo(stack, far_lights(8), {}, {}, options);
  expect_told(found);
  return found;
}

bool all_say(PixelState state, const std::function<double(int k)>& value) {
  return std::all_of(std::begin(kMethods), std::end(kMethods), [&](LambertMethod method) {
    return one_pixel(method, value).state(0, 0) == static_cast<int>(state);
  });
}

constexpr const char* kDegrees = "largest error of a normal, degrees";
constexpr const char* kFloats = "samples in float: 6e-8 of each";

/// An eigenvector's signs, and which one of equal eigenvalues it is, differ between machines.
Cell without_direction(Cell cell) {
  const std::size_t begin = cell.text.find('(');
  cell.text.replace(begin, cell.text.find(')') - begin + 1, "(x, y, z)");
  return cell;
}

EXTREME(stereo, dark) {
  EXPECT_TRUE(all_say(PixelState::too_dark, [](int) { return 0.0; }));
  EXPECT_TRUE(all_say(PixelState::too_dark, [](int) { return -0.01; }));
  EXPECT_TRUE(all_say(PixelState::too_dark, [](int k) { return k < 2 ? 0.5 : 0.0; }));
  return stated("black, below black, or lit by two lights alone: no normal, state too_dark");
}
EXTREME(stereo, one) {
  const MemoryStack three = far_capture(2, 2, 1, dome_directions(3), bowl());
  const MemoryStack two = far_capture(2, 2, 1, dome_directions(2), bowl());
  return both(bounded(worst_normal(three, far_lights(3)), 1e-4,
                      std::string("three lights: ") + kDegrees, kFloats),
              refused("three", [&] { (void)photometric_stereo(two, far_lights(2), {}, {}); }));
}
EXTREME(stereo, largest) {
  const MemoryStack stack = far_capture(2, 2, 1, dome_directions(4096), bowl());
  return bounded(worst_normal(stack, far_lights(4096)), 1e-4,
                 std::string("4096 lights: ") + kDegrees, kFloats);
}
EXTREME(stereo, odd_size) {
  const MemoryStack stack = far_capture(67, 1, 1, dome_directions(13),
                                        {[](int, int) { return Vector3d(Vector3d::Zero()); },
                                         [](int, int) { return bowl_normal(1, 1); }});
  for (const LambertMethod method : kMethods) {
    EXPECT_EQ(
        photometric_stereo(stack, far_lights(13), {}, {}, with(method)).n_in(PixelState::good),
        67);
  }
  return exact("67 × 1 pixels, 13 lights: every pixel is good");
}
EXTREME(stereo, scale) {
  double worst = 0.0;
  for (const double scale : {1e-30, 1e30}) {
    const MemoryStack stack = far_capture(6, 6, 1, dome_directions(20), bowl(scale));
    worst = std::max(worst, worst_normal(stack, far_lights(20)));
  }
  return bounded(worst, 1e-4, std::string("albedo 1e±30: ") + kDegrees, kFloats);
}
EXTREME(stereo, subnormal) {
  for (const LambertMethod method : kMethods) {
    expect_told(photometric_stereo(far_capture(6, 6, 1, dome_directions(20), bowl(1e-40)),
                                   far_lights(20), {}, {}, with(method)));
  }
  return stated("albedo 1e-40: finite normals, or none with a state");
}
EXTREME(stereo, not_finite) {
  for (const float bad : {kNan, std::numeric_limits<float>::infinity()}) {
    for (const LambertMethod method : kMethods) {
      MemoryStack stack = far_capture(6, 6, 1, dome_directions(20), bowl());
      stack.at(0, 2, 3, 4) = bad;
      const SurfaceEstimate found =
          photometric_stereo(stack, far_lights(20), {}, {}, with(method));
      for (int y = 0; y < 6; ++y) {
        for (int x = 0; x < 6; ++x) {
          if (y != 2 || x != 3) {
            EXPECT_LT(degrees_between(vector_at(found.normal, y, x), bowl_normal(y, x)), 1e-4);
          }
        }
      }
      EXPECT_TRUE(vector_at(found.normal, 2, 3).allFinite());
      EXPECT_TRUE(std::isfinite(found.albedo(2, 3)));
    }
  }
  return stated(
      "that pixel has a finite normal or none, the others are untouched; stacks refuse such "
      "values");
}
EXTREME(stereo, degenerate) {
  std::vector<Vector3d> arc;
  for (int k = 0; k < 6; ++k) {
    arc.emplace_back(std::sin(-1.0 + 0.4 * k), 0.0, std::cos(-1.0 + 0.4 * k));
  }
  StereoLights lights;
  lights.directions = arc;
  const MemoryStack stack = far_capture(2, 2, 1, arc, bowl());
  LambertFitter fitter(6, {});
  for (int k = 0; k < 5; ++k) {
    const double t = -0.8 + 0.4 * k;
    fitter.add({0.0, std::sin(t), std::cos(t)}, 0.5 + 0.01 * k, k);
  }
  fitter.add({1.0, 0.0, 0.0}, 0.0, 5);  // the one that would tell is dark
  const LambertFit fit = fitter.fit();
  EXPECT_EQ(fit.state, PixelState::ambiguous);
  EXPECT_NEAR(std::abs(fit.unknown.x()), 1.0, 1e-9);
  EXPECT_TRUE(fit.b.isZero());
  return both(without_direction(refused(
                  "(0.000, 1.000, ", [&] { (void)photometric_stereo(stack, lights, {}, {}); })),
              stated("a pixel that only lights of one plane reach: ambiguous, with the unknown "
                     "direction"));
}
EXTREME(stereo, grazing) {
  // Lights 0.5 degrees above the surface all round, one from above.
  StereoLights lights;
  for (int k = 0; k < 8; ++k) {
    lights.directions.push_back(
        Vector3d(std::cos(0.785 * k), std::sin(0.785 * k), 0.0087).normalized());
  }
  lights.directions.emplace_back(Vector3d::UnitZ());
  const MadeSurface flat{[](int, int) { return Vector3d(Vector3d::Zero()); },
                         [](int, int) { return Vector3d(Vector3d::UnitZ()); }};
  double worst = 0.0;
  for (const LambertMethod method : kMethods) {
    const SurfaceEstimate found = photometric_stereo(
        far_capture(2, 2, 1, lights.directions, flat), lights, {}, {}, with(method));
    EXPECT_EQ(found.n_in(PixelState::good), 4);
    worst = std::max(worst, degrees_between(vector_at(found.normal, 1, 1), Vector3d::UnitZ()));
  }
  lights.directions.emplace_back(Vector3d::UnitZ());
  for (const LambertMethod method : kMethods) {
    const SurfaceEstimate found = photometric_stereo(
        far_capture(2, 2, 1, lights.directions, flat), lights, {}, {}, with(method));
    expect_told(found);
    EXPECT_EQ(found.n_in(PixelState::too_dark), 4);
  }
  return both(
      bounded(worst, 1e-4,
              std::string("eight lights 0.5° above the surface, one overhead: ") + kDegrees,
              kFloats),
      stated("two overhead, a tenth of all: the others are below 5 % of the bright level and "
             "count as shadow: too_dark"));
}
EXTREME(stereo, far_near) {
  double worst = 0.0;
  for (const double scale : {1e-6, 1e6}) {
    StereoLights lights;
    lights.are_near = true;
    lights.near = testing::light_array(5, 120.0 * scale, 400.0 * scale, 1.7);
    const auto point = [scale](int y, int x) {
      return Vector3d(scale * Vector3d(20.0 * x - 50, 50 - 20.0 * y, 3.0 * x));
    };
    Image<float> points(6, 6, 3);
    for (int y = 0; y < 6; ++y) {
      for (int x = 0; x < 6; ++x) {
        for (int c = 0; c < 3; ++c) {
          points(y, x, c) = static_cast<float>(point(y, x)[c]);
        }
      }
    }
    const MemoryStack stack = testing::near_capture(6, 6, lights.near, {point, bowl_normal});
    worst = std::max(worst, worst_normal(stack, lights, points.view()));
  }
  return bounded(worst, 1e-4,
                 std::string("near lights, all lengths scaled by 1e±6: ") + kDegrees,
                 "points and samples in float");
}
EXTREME(stereo, duplicate) {
  StereoLights lights;
  lights.directions.assign(5, Vector3d::UnitZ());
  const MemoryStack same = far_capture(2, 2, 1, lights.directions, bowl());
  std::vector<Vector3d> twice = dome_directions(12);
  twice.insert(twice.end(), twice.begin(), twice.begin() + 12);
  StereoLights doubled;
  doubled.directions = twice;
  return both(without_direction(refused(
                  "lie in one plane", [&] { (void)photometric_stereo(same, lights, {}, {}); })),
              bounded(worst_normal(far_capture(6, 6, 1, twice, bowl()), doubled), 1e-4,
                      std::string("every light twice: ") + kDegrees, kFloats));
}
EXTREME(stereo, clipped) {
  EXPECT_TRUE(all_say(PixelState::saturated, [](int k) { return k < 2 ? 0.5 : 1.0; }));
  MemoryStack stack = far_capture(6, 6, 1, dome_directions(20), bowl());
  MemoryStack errors({6, 6, 1, 20});
  for (int i = 0; i < 36; ++i) {
    for (const int k : {2, 7}) {
      stack.at(0, i / 6, i % 6, k) *= 0.5F;  // where the sensor ended
      errors.at(0, i / 6, i % 6, k) = -1.0F;
    }
  }
  double worst = 0.0;
  for (const LambertMethod method : kMethods) {
    StereoOptions options = with(method);
    options.errors = &errors;
    const SurfaceEstimate found = photometric_stereo(stack, far_lights(20), {}, {}, options);
    worst = std::max(worst, degrees_between(vector_at(found.normal, 1, 4), bowl_normal(1, 4)));
  }
  return both(
      bounded(worst, 1e-4, std::string("clipped samples are left out: ") + kDegrees, kFloats),
      stated("clipped but for two: no normal, state saturated"));
}

// ---- heights ----

EXTREMES_OF(heights, "relight/shape",
            "heights from normals: poisson, frankot-chellappa, robust")

constexpr Integrator kIntegrators[] = {Integrator::poisson, Integrator::frankot_chellappa,
                                       Integrator::robust};

struct Tilted {
  Image<float> normals;
  Image<std::uint8_t> known;
};
/// A plane that rises by `slope` along x.
Tilted tilted(int width, int height, double slope) {
  Tilted plane{Image<float>(height, width, 3), Image<std::uint8_t>(height, width, 1)};
  const Vector3d normal = Vector3d(-slope, 0.0, 1.0).normalized();
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      for (int c = 0; c < 3; ++c) {
        plane.normals(y, x, c) = static_cast<float>(normal[c]);
      }
      plane.known(y, x) = 1;
    }
  }
  return plane;
}

HeightMap integrate(const Tilted& s, Integrator method, double mm = 1.0) {
  IntegrateOptions options;
  options.method = method;
  HeightMap map =
      integrate_slopes(orthographic_slopes(s.normals.view(), s.known.view(), mm), options);
  for (const float value : map.height.pixels()) {
    EXPECT_TRUE(std::isfinite(value));
  }
  return map;
}

/// Largest error of a step along x, relative to a step, of those that integrate a plane exactly.
double worst_step(int width, int height, double slope, double mm = 1.0) {
  double worst = 0.0;
  for (const Integrator method : {Integrator::poisson, Integrator::robust}) {
    const HeightMap map = integrate(tilted(width, height, slope), method, mm);
    const double rise = double{map.height(0, width - 1)} - double{map.height(0, 0)};
    worst = std::max(worst, std::abs(rise / (slope * mm * (width - 1)) - 1.0));
  }
  return worst;
}
constexpr const char* kRise = "a tilted plane's rise: relative error";
constexpr const char* kRiseWhy = "normals and heights in float; the solver's 1e-7";

EXTREME(heights, dark) {
  Tilted nothing = tilted(4, 3, 0.5);
  std::fill(nothing.known.pixels().begin(), nothing.known.pixels().end(), 0);
  for (const Integrator method : {Integrator::poisson, Integrator::robust}) {
    EXPECT_EQ(integrate(nothing, method).parts.n_parts, 0);
  }
  return exact("no pixel is known: no part, height 0");
}
EXTREME(heights, one) {
  Tilted single = tilted(4, 3, 0.5);
  std::fill(single.known.pixels().begin(), single.known.pixels().end(), 0);
  single.known(1, 1) = 1;
  for (const Integrator method : {Integrator::poisson, Integrator::robust}) {
    const HeightMap map = integrate(single, method);
    EXPECT_EQ(map.parts.n_parts, 1);
    EXPECT_EQ(map.height(1, 1), 0.0F);
    EXPECT_EQ(integrate(tilted(1, 1, 0.5), method).height(0, 0), 0.0F);
  }
  return exact("one pixel: one part of height 0");
}
NO_EXTREME(heights, largest, "no limit")
EXTREME(heights, odd_size) {
  return bounded(
      std::max({worst_step(37, 1, 0.5), worst_step(101, 53, 0.5), worst_step(2, 67, 0.5)}),
      1e-5, std::string("37 × 1, 101 × 53, 2 × 67 pixels: ") + kRise, kRiseWhy);
}
EXTREME(heights, scale) {
  return bounded(std::max(worst_step(16, 12, 0.5, 1e-30), worst_step(16, 12, 0.5, 1e30)), 1e-5,
                 std::string("pixels of 1e±30 mm: ") + kRise, kRiseWhy);
}
EXTREME(heights, subnormal) {
  for (const Integrator method : kIntegrators) {
    (void)integrate(tilted(16, 12, 0.5), method, 1e-40);
  }
  return stated("pixels of 1e-40 mm: finite heights");
}
EXTREME(heights, not_finite) {
  Tilted spoilt = tilted(16, 12, 0.5);
  spoilt.normals(5, 5, 0) = kNan;
  spoilt.known(5, 5) = 0;
  for (const Integrator method : kIntegrators) {
    (void)integrate(spoilt, method);
  }
  return stated("normals are known or masked: NaN under the mask is not read");
}
EXTREME(heights, degenerate) {
  // Two parts that touch at a corner alone.
  Tilted parts = tilted(8, 8, 0.5);
  for (int y = 0; y < 8; ++y) {
    for (int x = 0; x < 8; ++x) {
      parts.known(y, x) = (y < 4) == (x < 4) ? 1 : 0;
    }
  }
  EXPECT_EQ(integrate(parts, Integrator::poisson).parts.n_parts, 2);
  return stated("parts that touch at a corner are two, each of mean 0");
}
EXTREME(heights, grazing) {
  Tilted steep = tilted(8, 8, 0.1);
  steep.normals(3, 3, 0) = 1.0F;
  steep.normals(3, 3, 1) = 0.0F;
  steep.normals(3, 3, 2) = -0.2F;
  EXPECT_EQ(orthographic_slopes(steep.normals.view(), steep.known.view(), 1.0).n_steep, 1);
  for (const Integrator method : kIntegrators) {
    (void)integrate(steep, method);
  }
  return stated(
      "edge-on and backward normals count as 88.9° steep, and are counted; heights are finite");
}
NO_EXTREME(heights, far_near, "parallel projection; the scale of a pixel is above")
NO_EXTREME(heights, duplicate, "one normal per pixel")
NO_EXTREME(heights, clipped, "the normals' own states say so")

}  // namespace
}  // namespace haarlight::relight
