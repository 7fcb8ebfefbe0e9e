// SPDX-License-Identifier: Apache-2.0
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <numbers>
#include <optional>

#include <gtest/gtest.h>

#include "haarlight/core/picture/image_io.h"
#include "haarlight/relight/light/near_light.h"
#include "haarlight/render/direct/picture.h"
#include "haarlight/session/light_file.h"
#include "relight/shape/corrected_light.h"
#include "relight/shape/near_alternation.h"
#include "sim/transport.h"
#include "tests/relight/shape/known_captures.h"
#include "tests/relight/shape/made_lights.h"

/// Captures whose normals are known: rendered by others (rti_synth), and by the twin.

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;
using testing::capture_twin;
using testing::degrees_between;
using testing::ground;
using testing::kSynthetic;
using testing::read_rendered;
using testing::Rendered;
using testing::Twin;
using testing::twin_rig;
using testing::vector_at;
namespace fs = std::filesystem;

struct Found {
  double mean_deg = 0.0;
  std::int64_t n = 0;
};

Found compare_normals(const SurfaceEstimate& found, const Image<float>& truth) {
  Found result;
  for (int y = 0; y < truth.height(); ++y) {
    for (int x = 0; x < truth.width(); ++x) {
      if (found.state(y, x) == static_cast<int>(PixelState::good)) {
        result.mean_deg +=
            degrees_between(vector_at(found.normal, y, x), vector_at(truth, y, x));
        ++result.n;
      }
    }
  }
  result.mean_deg /= static_cast<double>(std::max<std::int64_t>(1, result.n));
  return result;
}

class RtiSynth : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!fs::exists(kSynthetic)) {
      GTEST_SKIP() << "no data beside the project: " << kSynthetic;
    }
  }
  static Found measure(const std::string& name, bool is_decoded, const LambertOptions& fit) {
    const Rendered capture = read_rendered(name, is_decoded);
    StereoOptions options;
    options.fit = fit;
    const SurfaceEstimate found =
        photometric_stereo(*capture.stack, capture.lights, {}, {}, options);
    const Found result = compare_normals(found, capture.normals);
    std::printf("%s, %s, %s: %.3f degrees over %lld pixels\n", name.c_str(),
                is_decoded ? "linear" : "as coded", std::string(to_string(fit.method)).c_str(),
                result.mean_deg, static_cast<long long>(result.n));
    EXPECT_EQ(result.n, 320 * 320);
    return result;
  }
};

constexpr const char* kSingle = "Single_Object1_material4";
constexpr const char* kMulti = "Multi_Object2_material3";

TEST_F(RtiSynth, LeastSquaresOnTheNumbersAsCoded) {
  EXPECT_LE(measure(kSingle, false, {.method = LambertMethod::least_squares}).mean_deg, 4.2);
}

TEST_F(RtiSynth, TheDefaultOnLinearLightIsWithinBothBounds) {
  EXPECT_LE(measure(kSingle, true, {}).mean_deg, 4.2);
  EXPECT_LE(measure(kMulti, true, {}).mean_deg, 10.4);
}

TEST_F(RtiSynth, TheMEstimatorOnLinearLight) {
  for (const RobustLoss loss : {RobustLoss::huber, RobustLoss::cauchy, RobustLoss::tukey}) {
    LambertOptions fit;
    fit.method = LambertMethod::m_estimator;
    fit.loss = loss;
    static_cast<void>(measure(kSingle, true, fit));
    EXPECT_LE(measure(kMulti, true, fit).mean_deg, 10.4) << static_cast<int>(loss);
  }
}

TEST_F(RtiSynth, LeastSquaresOnLinearLightForTheRecord) {
  EXPECT_LT(measure(kSingle, true, {.method = LambertMethod::least_squares}).mean_deg, 7.0);
  EXPECT_LT(measure(kMulti, true, {.method = LambertMethod::least_squares}).mean_deg, 13.0);
}

TEST(TwinShape, ALambertSphereUnderNearLights) {
  const Rig rig = twin_rig(100, 75);
  render::Scene scene = ground();
  scene.materials.push_back({"plaster", Vector3d::Constant(0.6), 0.0, 1.0});
  scene.meshes.push_back(render::make_sphere({0, 0, 110}, 100.0, 6, 1));
  Twin twin = capture_twin(rig, scene);
  const CameraModel& camera = rig.cameras[0].model;
  const render::RayCaster caster(scene);
  Image<std::uint8_t> mask(camera.height, camera.width, 1);
  Image<float> truth(camera.height, camera.width, 3);
  double height = 0.0;
  int n = 0;
  for (int y = 0; y < camera.height; ++y) {
    for (int x = 0; x < camera.width; ++x) {
      bool is_sphere = true;
      for (const double dx : {0.01, 0.99}) {
        for (const double dy : {0.01, 0.99}) {
          const auto corner = render::visible_surface(caster, camera, x + dx, y + dy);
          is_sphere = is_sphere && corner && corner->material == 1;
        }
      }
      const auto middle = render::visible_surface(caster, camera, x + 0.5, y + 0.5);
      if (is_sphere && middle && middle->material == 1) {
        mask(y, x) = 1;
        height += middle->point.z();
        ++n;
        for (int c = 0; c < 3; ++c) {
          truth(y, x, c) = static_cast<float>(middle->normal[c]);
        }
      }
    }
  }
  ASSERT_GT(n, 1000);
  height /= n;  // as a ruler gives it
  const PixelPoints pixels = PixelPoints::on_plane(camera, Vector3d::UnitZ(), -height);
  for (const LambertMethod method :
       {LambertMethod::least_squares, LambertMethod::trimmed, LambertMethod::m_estimator}) {
    ShapeOptions options;
    options.stereo.fit.method = method;
    const Shape near = recover_shape(twin.stack, twin.lights, pixels, mask.view(), options);
    StereoLights far = twin.lights;
    far.are_near = false;
    const Shape by_far = recover_shape(twin.stack, far, pixels, mask.view(), options);
    const Found found = compare_normals(near.surface, truth);
    std::printf(
        "sphere of %d pixels, %s: near %.3f degrees over %lld pixels, %zu rounds; far %.3f\n",
        n, std::string(to_string(method)).c_str(), found.mean_deg,
        static_cast<long long>(found.n), near.changes.size(),
        compare_normals(by_far.surface, truth).mean_deg);
    EXPECT_LE(found.mean_deg, 0.6);
    EXPECT_TRUE(near.is_settled);
    EXPECT_GT(found.n, 0.98 * n);  // below, no light reaches the sphere
  }
}

TEST(TwinShape, FlatPaperIsNoPotatoChip) {
  const Rig rig = twin_rig(80, 60);
  Twin twin = capture_twin(rig, ground());
  const CameraModel& camera = rig.cameras[0].model;
  const PixelPoints pixels = PixelPoints::on_plane(camera, Vector3d::UnitZ(), 0.0);
  const double width = (pixels.at(0, 30) - pixels.at(80, 30)).norm();
  const Shape near = recover_shape(twin.stack, twin.lights, pixels, {});
  StereoLights lights = twin.lights;
  lights.are_near = false;
  const Shape far = recover_shape(twin.stack, lights, pixels, {});
  std::printf("twin's paper, %.0f mm wide: far model bows by %.2f %%, near model by %.4f %%\n",
              width, 100.0 * far.bow_mm / width, 100.0 * near.bow_mm / width);
  EXPECT_LE(near.bow_mm / width, 0.001);
  EXPECT_GT(far.bow_mm, 10.0 * near.bow_mm);
  // Each light's picture, even after correction.
  const LightCorrection correction(twin.lights.near, pixels, 80, 60, Vector3d::UnitZ(),
                                   FallOff::plane);
  double worst = 0.0;
  double worst_before = 0.0;
  const auto spread = [](const Image<float>& picture) {
    double mean = 0.0;
    double square = 0.0;
    const auto n = static_cast<double>(picture.pixels().size());
    for (const float value : picture.pixels()) {
      mean += double{value} / n;
      square += double{value} * double{value} / n;
    }
    return std::sqrt(std::max(0.0, square - mean * mean)) / mean;
  };
  for (int k = 0; k < rig.n_lights(); ++k) {
    Image<float> picture(60, 80, 1);
    for (int y = 0; y < 60; ++y) {
      for (int x = 0; x < 80; ++x) {
        picture(y, x) = twin.stack.at(0, y, x, k);
      }
    }
    worst_before = std::max(worst_before, spread(picture));
    worst = std::max(worst, spread(correction.corrected(picture.view(), k)));
  }
  std::printf("worst light's std/mean: %.3f before, %.5f after\n", worst_before, worst);
  EXPECT_LE(worst, 0.01);
}

}  // namespace
}  // namespace haarlight::relight
