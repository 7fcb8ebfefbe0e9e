// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>
#include <vector>

#include <Eigen/Geometry>

#include "haarlight/core/image.h"
#include "haarlight/core/stack/stack_source.h"
#include "haarlight/relight/light/near_light.h"
#include "haarlight/relight/shape/photometric_stereo.h"

/// @file
/// Lambertian captures by closed form, for tests of shape.

namespace haarlight::testing {

/// `n` directions over the dome, 25 to 80 degrees above the horizon.
inline std::vector<Eigen::Vector3d> dome_directions(int n) {
  std::vector<Eigen::Vector3d> directions;
  for (int k = 0; k < n; ++k) {
    const double elevation = (25.0 + 55.0 * k / std::max(1, n - 1)) * std::numbers::pi / 180.0;
    const double azimuth = 2.399963 * k;  // the golden angle: even over the circle
    directions.emplace_back(std::cos(elevation) * std::cos(azimuth),
                            std::cos(elevation) * std::sin(azimuth), std::sin(elevation));
  }
  return directions;
}

inline relight::StereoLights far_lights(int n) {
  relight::StereoLights lights;
  lights.directions = dome_directions(n);
  return lights;
}

inline relight::StereoOptions with(relight::LambertMethod method) {
  relight::StereoOptions options;
  options.fit.method = method;
  return options;
}

inline constexpr relight::LambertMethod kMethods[] = {relight::LambertMethod::least_squares,
                                                      relight::LambertMethod::trimmed,
                                                      relight::LambertMethod::m_estimator};

/// A square of n x n lights with pitch `pitch_mm`, `height_mm` above the plane, facing down.
inline std::vector<relight::NearLight> light_array(int n, double pitch_mm, double height_mm,
                                                   double mu) {
  std::vector<relight::NearLight> lights;
  for (int row = 0; row < n; ++row) {
    for (int col = 0; col < n; ++col) {
      relight::NearLight light;
      light.position_mm = {pitch_mm * (col - 0.5 * (n - 1)), pitch_mm * (row - 0.5 * (n - 1)),
                           height_mm};
      light.mu = mu;
      lights.push_back(light);
    }
  }
  return lights;
}

/// What is where in a picture.
struct MadeSurface {
  std::function<Eigen::Vector3d(int y, int x)> point;   ///< mm
  std::function<Eigen::Vector3d(int y, int x)> normal;  ///< unit
  std::function<double(int c)> albedo = [](int) { return 1.0; };
};

inline MemoryStack far_capture(int width, int height, int channels,
                               const std::vector<Eigen::Vector3d>& directions,
                               const MadeSurface& surface) {
  MemoryStack stack({width, height, channels, static_cast<int>(directions.size())});
  for (int c = 0; c < channels; ++c) {
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        for (std::size_t k = 0; k < directions.size(); ++k) {
          stack.at(c, y, x, static_cast<int>(k)) = static_cast<float>(
              surface.albedo(c) * std::max(0.0, surface.normal(y, x).dot(directions[k])));
        }
      }
    }
  }
  return stack;
}

inline MemoryStack near_capture(int width, int height,
                                const std::vector<relight::NearLight>& lights,
                                const MadeSurface& surface) {
  MemoryStack stack({width, height, 1, static_cast<int>(lights.size())});
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      for (std::size_t k = 0; k < lights.size(); ++k) {
        stack.at(0, y, x, static_cast<int>(k)) = static_cast<float>(
            1e6 * surface.albedo(0) *
            relight::light_stencil(lights[k], surface.point(y, x), surface.normal(y, x)));
      }
    }
  }
  return stack;
}

inline Eigen::Vector3d vector_at(const Image<float>& picture, int y, int x) {
  return {double{picture(y, x, 0)}, double{picture(y, x, 1)}, double{picture(y, x, 2)}};
}

inline double degrees_between(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b)) * 180.0 / std::numbers::pi;
}

}  // namespace haarlight::testing
