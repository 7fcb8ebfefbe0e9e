// SPDX-License-Identifier: Apache-2.0
#include "relight/reflectance/formats/plane_weights.h"

#include <algorithm>
#include <cmath>

#include "haarlight/relight/reflectance/formats/refit.h"

namespace haarlight::relight {

namespace {

using Eigen::Index;

constexpr int kSpread = 64;
constexpr std::size_t kSample = 4096;  // pixels of lrgb

/// Bytes of evenly spaced pixels, (n_planes, n).
Eigen::MatrixXd sample_bytes(const ReflectanceModel& model) {
  const auto bytes = model.planes.pixels();
  const auto n_planes = static_cast<std::size_t>(model.n_planes());
  const std::size_t n_pixels = bytes.size() / n_planes;
  const std::size_t n = std::min(n_pixels, kSample);
  Eigen::MatrixXd sample(static_cast<Index>(n_planes), static_cast<Index>(n));
  for (std::size_t i = 0; i < n; ++i) {
    const std::size_t at = (2 * i + 1) * n_pixels / (2 * n);
    for (std::size_t p = 0; p < n_planes; ++p) {
      sample(static_cast<Index>(p), static_cast<Index>(i)) = bytes[at * n_planes + p];
    }
  }
  return sample;
}

}  // namespace

std::vector<double> plane_weights(const ReflectanceModel& model) {
  const std::vector<Eigen::Vector3d> lights =
      model.lights.empty() ? spread_over_hemisphere(kSpread) : model.lights;
  const bool is_lrgb = model.colour == ReflectanceColour::lrgb;
  const Index n_planes = model.n_planes();
  const Index n_mapped = is_lrgb ? n_planes - 3 : n_planes;
  Eigen::VectorXd squares = Eigen::VectorXd::Zero(n_planes);
  Eigen::Vector3d colours = Eigen::Vector3d::Ones();  // mean squares
  Eigen::MatrixXd sample;
  if (is_lrgb) {
    sample = sample_bytes(model);
    for (Index c = 0; c < 3; ++c) {
      const PlaneScale& scale = model.scales[static_cast<std::size_t>(n_mapped + c)];
      colours[c] =
          (sample.row(n_mapped + c).array() * scale.scale + scale.offset).square().mean();
    }
  }
  for (const Eigen::Vector3d& light : lights) {
    const ColourMap map = colour_map(model, light);
    for (Index p = 0; p < n_mapped; ++p) {
      squares[p] += map.factors.col(p).cwiseAbs2().dot(colours) / 3.0;
    }
    if (is_lrgb) {
      const double luminance =
          ((map.factors.row(0) * sample).array() + map.added[0]).square().mean();
      for (Index c = 0; c < 3; ++c) {
        const double scale = model.scales[static_cast<std::size_t>(n_mapped + c)].scale;
        squares[n_mapped + c] += scale * scale * luminance / 3.0;
      }
    }
  }
  std::vector<double> weights;
  for (Index p = 0; p < n_planes; ++p) {
    weights.push_back(std::sqrt(squares[p] / static_cast<double>(lights.size())));
  }
  return weights;
}

}  // namespace haarlight::relight
