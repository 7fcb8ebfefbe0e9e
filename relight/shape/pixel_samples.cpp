// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/shape/pixel_samples.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/count.h"

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
                           const std::vector<int>& use)
    : lights_(lights),
      use_(all_or(use, dims.n_lights)),
      channels_(dims.channels),
      n_lights_(dims.n_lights),
      are_lambertian_(lights.are_near &&
                      std::all_of(lights.near.begin(), lights.near.end(),
                                  [](const NearLight& light) { return light.mu == 1.0; })),
      gain_(dims.channels, static_cast<Eigen::Index>(use_.size())),
      positions_(Eigen::ArrayX3d::Zero(static_cast<Eigen::Index>(use_.size()), 3)),
      axes_(Eigen::ArrayX3d::Zero(static_cast<Eigen::Index>(use_.size()), 3)) {
  for (Eigen::ArrayXd* array : {&x_, &y_, &z_, &value_, &scale_, &lobe_}) {
    array->setOnes(n());
  }
  for (int j = 0; j < n(); ++j) {
    const std::size_t k = count(light(j));
    const Vector3d power = lights.are_near         ? lights.near[k].power
                           : lights.powers.empty() ? Vector3d(Vector3d::Ones())
                                                   : lights.powers[k];
    for (int c = 0; c < channels_; ++c) {
      gain_(c, j) = 1.0 / (channels_ == 3 ? power[c] : power.mean());
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

void PixelSamples::take(std::span<const float> values, int i, int width) {
  value_.setZero();
  for (int c = 0; c < channels_; ++c) {
    const float* of_channel =
        values.data() + (count(c) * count(width) + count(i)) * count(n_lights_);
    for (int j = 0; j < n(); ++j) {
      value_[j] += double{of_channel[use_[count(j)]]} * gain_(c, j);
    }
  }
  value_ *= scale_ / channels_;
}

bool PixelSamples::is_clipped(std::span<const float> values, std::span<const float> errors,
                              std::span<const float> saturation, int i, int j,
                              int width) const {
  // One level per light, or one for each of its channels.
  const std::size_t step = saturation.size() > count(n_lights_) ? count(n_lights_) : 0;
  for (int c = 0; c < channels_; ++c) {
    const std::size_t at = index(c, i, j, width);
    if ((!errors.empty() && errors[at] < 0.0F) ||
        (!saturation.empty() && values[at] >= saturation[count(c) * step + count(light(j))])) {
      return true;
    }
  }
  return false;
}

void PixelSamples::aim(const Vector3d& point) {
  if (!lights_.are_near) {
    return;  // once for all, in the constructor
  }
  x_ = positions_.col(0) - point.x();
  y_ = positions_.col(1) - point.y();
  z_ = positions_.col(2) - point.z();
  scale_ = x_.square() + y_.square() + z_.square();
  lobe_ = scale_.sqrt().inverse();
  x_ *= lobe_;
  y_ *= lobe_;
  z_ *= lobe_;
  lobe_ = -(axes_.col(0) * x_ + axes_.col(1) * y_ + axes_.col(2) * z_);
  if (are_lambertian_) {
    scale_ = (lobe_ > 0.0).select(scale_ / lobe_, 0.0);
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
