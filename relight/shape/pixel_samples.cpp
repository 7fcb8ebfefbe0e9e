// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/shape/pixel_samples.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/count.h"
#include "relight/shape/sample_kernels.h"

namespace haarlight::relight {

namespace {

using Eigen::Vector3d;

std::vector<int> all_or(const std::vector<int>& use, int n_lights) {
  if (!use.empty()) {
    return use;
  }
  std::vector<int> all(count(n_lights));
  std::iota(all.begin(), all.end(), 0);
  return all;
}

}  // namespace

std::vector<Vector3d> directions_from(const StereoLights& lights, const Vector3d& point) {
  if (!lights.are_near) {
    return lights.directions;
  }
  std::vector<Vector3d> directions;
  for (const NearLight& light : lights.near) {
    directions.push_back((light.position_mm - point).normalized());
  }
  return directions;
}

PixelSamples::PixelSamples(const StackDims& dims, const StereoLights& lights,
                           const std::vector<int>& use, std::span<const float> saturation)
    : lights_(lights),
      use_(all_or(use, dims.n_lights)),
      channels_(dims.channels),
      n_lights_(dims.n_lights),
      are_lambertian_(lights.are_near &&
                      std::all_of(lights.near.begin(), lights.near.end(),
                                  [](const NearLight& light) { return light.mu == 1.0; })),
      gain_(static_cast<Eigen::Index>(use_.size()), dims.channels),
      raw_(static_cast<Eigen::Index>(use_.size()), dims.channels),
      positions_(Eigen::ArrayX3d::Zero(static_cast<Eigen::Index>(use_.size()), 3)),
      axes_(Eigen::ArrayX3d::Zero(static_cast<Eigen::Index>(use_.size()), 3)) {
  for (Eigen::ArrayXd* array : {&x_, &y_, &z_, &value_, &scale_, &lobe_}) {
    array->setOnes(n());
  }
  clipped_.setZero(n());
  left_out_.setZero(n());
  if (!saturation.empty()) {
    // One level per light, or one for each of its channels.
    const std::size_t step = saturation.size() > count(n_lights_) ? count(n_lights_) : 0;
    limit_.resize(n(), channels_);
    for (int c = 0; c < channels_; ++c) {
      for (int j = 0; j < n(); ++j) {
        limit_(j, c) = saturation[count(c) * step + count(light(j))];
      }
    }
  }
  for (int j = 0; j < n(); ++j) {
    const std::size_t k = count(light(j));
    const Vector3d power = lights.are_near         ? lights.near[k].power
                           : lights.powers.empty() ? Vector3d(Vector3d::Ones())
                                                   : lights.powers[k];
    for (int c = 0; c < channels_; ++c) {
      gain_(j, c) = 1.0 / (channels_ == 3 ? power[c] : power.mean());
    }
    if (lights.are_near) {
      positions_.row(j) = lights.near[k].position_mm.transpose().array();
      axes_.row(j) = lights.near[k].axis.transpose().array();
    } else {
      x_[j] = lights.directions[k].x();
      y_[j] = lights.directions[k].y();
      z_[j] = lights.directions[k].z();
    }
  }
}

void PixelSamples::take(std::span<const float> values, int i, int width,
                        std::span<const float> errors) {
  value_.setZero();
  clipped_.setZero();
  const int* const use = use_.data();
  const int n_used = n();
  for (int c = 0; c < channels_; ++c) {
    const std::size_t first = (count(c) * count(width) + count(i)) * count(n_lights_);
    const float* const of_channel = values.data() + first;
    float* const raw = raw_.col(c).data();
    for (int j = 0; j < n_used; ++j) {
      raw[j] = of_channel[use[j]];
    }
    add_channel(raw, gain_.col(c).data(), n_used, value_.data());
    if (limit_.size() != 0) {
      mark_reaching(raw, limit_.col(c).data(), n_used, clipped_.data());
    }
    if (!errors.empty()) {
      const float* const of_errors = errors.data() + first;
      for (int j = 0; j < n_used; ++j) {
        clipped_[j] |= of_errors[use[j]] < 0.0F ? std::uint8_t{1} : std::uint8_t{0};
      }
    }
  }
  scale_mean(scale_.data(), channels_, n_used, value_.data());
}

void PixelSamples::give(LambertFitter& fitter) {
  const int n_clipped = leave_out(scale_.data(), clipped_.data(), n(), left_out_.data());
  const auto all = [&](const auto& column) { return std::span(column.data(), count(n())); };
  fitter.clear();
  fitter.add(all(x_), all(y_), all(z_), all(value_), all(left_out_));
  fitter.add_clipped(n_clipped);
}

void PixelSamples::aim(const Vector3d& point) {
  if (!lights_.are_near) {
    return;  // once for all, in the constructor
  }
  LightColumns columns;
  columns.n = n();
  for (int c = 0; c < 3; ++c) {
    columns.position[c] = positions_.col(c).data();
    columns.axis[c] = axes_.col(c).data();
  }
  double* const directions[3] = {x_.data(), y_.data(), z_.data()};
  aim_at(columns, point, are_lambertian_, directions, scale_.data(), lobe_.data());
  if (are_lambertian_) {
    return;
  }
  for (int j = 0; j < n(); ++j) {
    const double mu = lights_.near[count(light(j))].mu;
    if (mu == 0.0) {
      continue;
    }
    if (!(lobe_[j] > 0.0) || !std::isfinite(x_[j])) {
      scale_[j] = 0.0;
    } else {
      scale_[j] /= mu == 1.0 ? lobe_[j] : std::pow(lobe_[j], mu);
    }
  }
}

}  // namespace haarlight::relight
