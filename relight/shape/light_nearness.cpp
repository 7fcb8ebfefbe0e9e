// SPDX-License-Identifier: Apache-2.0
#include "relight/shape/light_nearness.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <vector>

#include <Eigen/LU>

#include "haarlight/core/error.h"
#include "haarlight/relight/shape/pixel_samples.h"

namespace haarlight::relight {

namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr int kPixelsAcross = 40;  // sampled, and at most as many down
constexpr int kBlocks = 4;         // across and down
constexpr double kDegrees = 180.0 / std::numbers::pi;

/// Sums of one block of the picture: r q and q q, over |b|^2.
struct BlockSums {
  double above = 0.0;
  double below = 0.0;
};

Vector3d position_of(int y, int x, int height, int width) {
  return {(x + 0.5) / width - 0.5, (0.5 * height - y - 0.5) / width, 0.0};
}

/// One pixel's evidence. @return  the angle by which 1/D = 1 turns its normal
double add_pixel(const LambertFitter& fitter, const LambertFit& fit,
                 const PixelSamples& samples, const Vector3d& position, BlockSums& sums) {
  const int n = fitter.n_samples();
  std::vector<double> q(static_cast<std::size_t>(n));
  Matrix3d matrix = Matrix3d::Zero();
  Vector3d right = Vector3d::Zero();
  for (int i = 0; i < n; ++i) {
    const Vector3d s = fitter.direction(i);
    const double value = 3.0 * s.dot(position) * fit.b.dot(s) - fit.b.dot(position);
    q[static_cast<std::size_t>(i)] = value;
    matrix += fitter.weight(i) * s * s.transpose();
    right += fitter.weight(i) * value * s;
  }
  Matrix3d inverse;
  bool is_invertible = false;
  matrix.computeInverseWithCheck(inverse, is_invertible, 0.0);
  if (!is_invertible) {
    return 0.0;
  }
  const Vector3d absorbed = inverse * right;
  const double scale = 1.0 / fit.b.squaredNorm();
  for (int i = 0; i < n; ++i) {
    const Vector3d s = fitter.direction(i);
    const double left = q[static_cast<std::size_t>(i)] - absorbed.dot(s);
    const double residual = samples.value(fitter.light(i)) - fit.b.dot(s);
    sums.above += fitter.weight(i) * scale * residual * left;
    sums.below += fitter.weight(i) * scale * left * left;
  }
  return fit.b.cross(absorbed).norm() * scale;
}

}  // namespace

LightNearness find_nearness(const StackSource& stack, const StereoLights& lights,
                            const SurfaceEstimate& surface, const StereoOptions& options) {
  HAARLIGHT_EXPECTS(!lights.are_near, "lights known by direction");
  const StackDims dims = stack.dims();
  const int step = std::max(1, dims.width / kPixelsAcross);
  PixelSamples samples(dims, lights, {}, options.saturation);
  LambertOptions fit_options = options.fit;
  fit_options.has_sigma = false;
  LambertFitter fitter(samples.n(), fit_options);
  std::vector<float> values(static_cast<std::size_t>(dims.channels) *
                            static_cast<std::size_t>(dims.n_lights));
  std::vector<float> errors(options.errors != nullptr ? values.size() : 0);
  std::array<BlockSums, std::size_t{kBlocks} * kBlocks> blocks{};
  double turns = 0.0;
  double positions = 0.0;
  for (int y = step / 2; y < dims.height; y += step) {
    for (int x = step / 2; x < dims.width; x += step) {
      if (surface.state(y, x) != static_cast<std::uint8_t>(PixelState::good)) {
        continue;
      }
      stack.read_tile({x, y, 1, 1}, values);
      if (options.errors != nullptr) {
        options.errors->read_tile({x, y, 1, 1}, errors);
      }
      samples.take(values, 0, 1, errors);
      samples.give(fitter);
      const LambertFit fit = fitter.fit();
      if (fit.state != PixelState::good) {
        continue;
      }
      const Vector3d position = position_of(y, x, dims.height, dims.width);
      const int block = y * kBlocks / dims.height * kBlocks + x * kBlocks / dims.width;
      const double turn =
          add_pixel(fitter, fit, samples, position, blocks[static_cast<std::size_t>(block)]);
      turns += turn * turn;
      positions += position.squaredNorm();
    }
  }
  BlockSums all;
  for (const BlockSums& block : blocks) {
    all.above += block.above;
    all.below += block.below;
  }
  LightNearness found;
  if (!(all.below > 0.0) || !(positions > 0.0)) {
    return found;
  }
  found.inverse = all.above / all.below;
  found.turn = std::sqrt(turns / positions);
  double sum = 0.0;
  int n = 0;
  for (const BlockSums& block : blocks) {
    if (block.below > 0.0 && all.below > block.below) {
      const double other = (all.above - block.above) / (all.below - block.below);
      sum += (other - found.inverse) * (other - found.inverse);
      ++n;
    }
  }
  found.sigma = n > 1 ? std::sqrt(sum * (n - 1) / n) : std::abs(found.inverse);
  return found;
}

void add_nearness(const LightNearness& nearness, SurfaceEstimate& surface) {
  const int h = surface.sigma_deg.height();
  const int w = surface.sigma_deg.width();
  // Uncertain to two of its own standard errors.
  const double inverse = std::abs(nearness.inverse) + 2.0 * nearness.sigma;
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      if (surface.state(y, x) != static_cast<std::uint8_t>(PixelState::good)) {
        continue;
      }
      const double turned = nearness.turn * inverse * position_of(y, x, h, w).norm() * kDegrees;
      surface.sigma_deg(y, x) = static_cast<float>(
          std::min(90.0, std::hypot(double{surface.sigma_deg(y, x)}, turned)));
    }
  }
}

}  // namespace haarlight::relight
