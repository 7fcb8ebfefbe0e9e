// SPDX-License-Identifier: Apache-2.0
/// @file
/// How far the results of `haarlight shape` are from a known truth, and whether the stated
/// errors hold; the tables of docs/numerics/shape.md.
///
///     relight_shape_score FOLDER.shape --scene SCENE.toml --rig RIG.toml
///     relight_shape_score FOLDER.shape --normals TRUE.png [--only MASK]
///     relight_shape_score FOLDER.shape --ball MASK

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <numbers>
#include <string>
#include <vector>

#include <fmt/format.h>

#include "apps/command_line.h"
#include "core/report.h"
#include "haarlight/core/error.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/relight/light/near_light.h"
#include "haarlight/render/direct/picture.h"
#include "haarlight/render/scene/scene.h"

namespace haarlight {
namespace {

using Eigen::Vector3d;
namespace fs = std::filesystem;

struct Truth {
  Image<float> normal;  ///< (height, width, 3), the picture's frame; 0: not known
  Image<float> height;  ///< (height, width) mm above z = 0; empty: not known
  Image<float>
      object;  ///< (height, width) fraction of the pixel that is object; empty: not known
};

Vector3d vector_at(const Image<float>& picture, int y, int x) {
  return {double{picture(y, x, 0)}, double{picture(y, x, 1)}, double{picture(y, x, 2)}};
}

void store(const Vector3d& n, int y, int x, Image<float>& picture) {
  for (int c = 0; c < 3; ++c) {
    picture(y, x, c) = static_cast<float>(n[c]);
  }
}

/// A pixel's normal: the mean of albedo times normal over the object in its footprint, which is
/// what a photometric fit of all of it finds. The object is whatever rises above z = 0.
Truth truth_of_scene(const std::string& scene_file, const std::string& rig_file) {
  const render::Scene scene =
      render::with_instances_expanded(render::read_scene(scene_file).scene, scene_file);
  const CameraModel camera = read_rig(rig_file).cameras.front().model;
  const relight::PixelPoints pixels =
      relight::PixelPoints::on_plane(camera, Vector3d::UnitZ(), 0.0);
  const render::RayCaster caster(scene);
  constexpr int kSub = 4;
  constexpr double kOnGround = 0.01;  // mm
  Truth truth{Image<float>(camera.height, camera.width, 3),
              Image<float>(camera.height, camera.width, 1),
              Image<float>(camera.height, camera.width, 1)};
  for (int y = 0; y < camera.height; ++y) {
    for (int x = 0; x < camera.width; ++x) {
      Vector3d sum = Vector3d::Zero();
      double height = 0.0;
      double n_object = 0.0;
      for (int i = 0; i < kSub * kSub; ++i) {
        const auto hit = render::visible_surface(caster, camera, x + (i % kSub + 0.5) / kSub,
                                                 y + (i / kSub + 0.5) / kSub);
        if (!hit) {
          continue;
        }
        const render::Material& material =
            scene.materials[static_cast<std::size_t>(hit->material)];
        sum += material.kd.mean() * hit->normal;
        if (hit->point.z() > kOnGround) {
          n_object += 1.0;
          height += hit->point.z();
        }
      }
      if (sum.norm() > 0.0) {
        store(pixels.picture_from_world() * sum.normalized(), y, x, truth.normal);
      }
      truth.object(y, x) = static_cast<float>(n_object / (kSub * kSub));
      truth.height(y, x) = static_cast<float>(n_object > 0.0 ? height / n_object : 0.0);
    }
  }
  return truth;
}

Truth truth_of_picture(const std::string& file) {
  Truth truth;
  truth.normal = read_picture(file).pixels;
  for (float& value : truth.normal.pixels()) {
    value = 2.0F * value - 1.0F;
  }
  return truth;
}

/// A ball that fills its mask, seen from far: its middle and area give the circle.
Truth truth_of_ball(const std::string& file) {
  const Image<float> mask = read_picture(file).pixels;
  double n = 0.0;
  double mx = 0.0;
  double my = 0.0;
  for (int y = 0; y < mask.height(); ++y) {
    for (int x = 0; x < mask.width(); ++x) {
      if (mask(y, x) > 0.5F) {
        n += 1.0;
        mx += x + 0.5;
        my += y + 0.5;
      }
    }
  }
  mx /= n;
  my /= n;
  const double radius = std::sqrt(n / std::numbers::pi);
  Truth truth;
  truth.normal = Image<float>(mask.height(), mask.width(), 3);
  truth.object = Image<float>(mask.height(), mask.width(), 1);
  for (int y = 0; y < mask.height(); ++y) {
    for (int x = 0; x < mask.width(); ++x) {
      const double u = (x + 0.5 - mx) / radius;
      const double v = (my - y - 0.5) / radius;
      if (u * u + v * v < 1.0) {
        store({u, v, std::sqrt(1.0 - u * u - v * v)}, y, x, truth.normal);
        truth.object(y, x) = 1.0F;
      }
    }
  }
  return truth;
}

double ranked(std::vector<double> values, double fraction) {
  if (values.empty()) {
    return 0.0;
  }
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(fraction * static_cast<double>(values.size() - 1))];
}

void score(const fs::path& folder, const Truth& truth) {
  const Image<float> normal = read_picture(folder / "normals.exr").pixels;
  const Image<float> sigma = read_picture(folder / "sigma.exr").pixels;
  const Image<float> mask = read_picture(folder / "mask.png").pixels;
  const Image<float> height = read_picture(folder / "height.exr").pixels;
  std::vector<double> errors;
  std::vector<double> sigmas;
  std::vector<double> heights;
  double n_within = 0.0;
  double n_object = 0.0;
  double n_found = 0.0;
  double n_wrong = 0.0;
  for (int y = 0; y < normal.height(); ++y) {
    for (int x = 0; x < normal.width(); ++x) {
      const bool is_object = !truth.object.is_empty() && truth.object(y, x) > 0.99F;
      const bool is_masked = mask(y, x) <= 0.5F;
      n_object += is_object ? 1.0 : 0.0;
      n_found += is_object && !is_masked ? 1.0 : 0.0;
      n_wrong +=
          !truth.object.is_empty() && truth.object(y, x) == 0.0F && !is_masked ? 1.0 : 0.0;
      const Vector3d n = vector_at(normal, y, x);
      const Vector3d t = vector_at(truth.normal, y, x);
      if (n.norm() < 0.5 || t.norm() < 0.5) {
        continue;
      }
      const double error = std::atan2(n.cross(t).norm(), n.dot(t)) * 180.0 / std::numbers::pi;
      errors.push_back(error);
      sigmas.push_back(double{sigma(y, x)});
      n_within += error <= 2.0 * double{sigma(y, x)} ? 1.0 : 0.0;
      if (is_object && !truth.height.is_empty()) {
        heights.push_back(double{height(y, x)} - double{truth.height(y, x)});
      }
    }
  }
  double mean = 0.0;
  for (const double error : errors) {
    mean += error / static_cast<double>(errors.size());
  }
  const auto n = static_cast<double>(errors.size());
  fmt::print(
      "{} pixels: error mean {:.3f} median {:.3f}, 90 % {:.3f}; sigma median {:.3f}, "
      "90 % {:.3f}; within 2 sigma {:.4f}\n",
      errors.size(), mean, ranked(errors, 0.5), ranked(errors, 0.9), ranked(sigmas, 0.5),
      ranked(sigmas, 0.9), n_within / n);
  if (!truth.object.is_empty()) {
    fmt::print("mask: {:.4f} of the object's {:.0f} pixels, and {:.0f} that show none of it\n",
               n_found / std::max(1.0, n_object), n_object, n_wrong);
  }
  if (!heights.empty()) {
    double square = 0.0;
    for (const double value : heights) {
      square += value * value / static_cast<double>(heights.size());
    }
    fmt::print("heights: median error {:.2f} mm, rms {:.2f}, 10 % {:.2f}, 90 % {:.2f}\n",
               ranked(heights, 0.5), std::sqrt(square), ranked(heights, 0.1),
               ranked(heights, 0.9));
  }
}

int run(int argc, char** argv) {
  std::string folder;
  std::string scene;
  std::string rig;
  std::string normals;
  std::string ball;
  std::string mask;
  apps::CommandLine line("relight_shape_score", "errors of shape against a truth",
                         std::string(kVersion));
  line.root().option("FOLDER", &folder, "What haarlight shape wrote", {.is_required = true});
  line.root().option("--scene", &scene, "The twin's scene");
  line.root().option("--rig", &rig, "and its rig");
  line.root().option("--normals", &normals, "A normal map");
  line.root().option("--ball", &ball, "A ball's mask");
  line.root().option("--write-mask", &mask, "Write the true mask here");
  if (const auto end = line.parse(argc, argv)) {
    return static_cast<int>(*end);
  }
  const Truth truth = !scene.empty()     ? truth_of_scene(scene, rig)
                      : !normals.empty() ? truth_of_picture(normals)
                                         : truth_of_ball(ball);
  if (!mask.empty()) {
    // Drawn one pixel inside the rim, whose pixels show what is behind too.
    Image<float> all(truth.object.height(), truth.object.width(), 1);
    for (int y = 1; y + 1 < all.height(); ++y) {
      for (int x = 1; x + 1 < all.width(); ++x) {
        bool is_inner = true;
        for (int i = 0; i < 9; ++i) {
          is_inner = is_inner && truth.object(y + i / 3 - 1, x + i % 3 - 1) > 0.99F;
        }
        all(y, x) = is_inner ? 1.0F : 0.0F;
      }
    }
    write_image(mask, all.view());
  }
  score(folder, truth);
  return 0;
}

}  // namespace
}  // namespace haarlight

int main(int argc, char** argv) {
  try {
    return haarlight::run(argc, argv);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
