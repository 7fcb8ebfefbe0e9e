// SPDX-License-Identifier: Apache-2.0
#include "render/light/environment_light.h"

#include <algorithm>
#include <cstddef>
#include <span>

#include "haarlight/core/error.h"
#include "render/sampling/warp.h"

namespace haarlight::render {

using Eigen::Vector2d;
using Eigen::Vector3d;

std::optional<Environment> read_environment(const Scene& scene) {
  if (!scene.environment) {
    return std::nullopt;
  }
  Environment environment = Environment::read(scene.environment->file);
  environment.rotate(scene.environment->rotate_z_rad);
  return environment;
}

std::uint64_t EnvironmentLight::bytes_needed(const Environment& environment) {
  const auto n_rows = static_cast<std::uint64_t>(environment.n_rows());
  const auto n_cols = static_cast<std::uint64_t>(environment.row_texels());
  const std::uint64_t own = sizeof(float) * (environment.is_colour() ? 3U : 1U);
  return n_rows * (n_cols * (own + sizeof(double)) + sizeof(double));
}

EnvironmentLight::EnvironmentLight(const Environment& environment, double scale)
    : environment_(&environment), scale_(scale) {
  const int n_rows = environment.n_rows();
  const int n_cols = environment.row_texels();
  rows_.reserve(static_cast<std::size_t>(n_rows));
  texels_.reserve(static_cast<std::size_t>(n_rows) * static_cast<std::size_t>(n_cols));
  for (int row = 0; row < n_rows; ++row) {
    double sum = 0.0;
    for (int col = 0; col < n_cols; ++col) {
      const EnvironmentPosition middle{.row = row, .col = col};
      sum += environment.radiance_at(middle).mean() * environment.solid_angle_density(middle);
      texels_.push_back(sum);
    }
    total_ += sum;
    rows_.push_back(total_);
  }
  total_ *= scale;
}

EnvironmentDirection EnvironmentLight::sample(const Vector2d& square) const {
  HAARLIGHT_EXPECTS(total_ > 0.0, "an environment that is not black");
  const CutUnit row = cut_unit(rows_, square.y());
  const auto n_cols = static_cast<std::size_t>(environment_->row_texels());
  const CutUnit col =
      cut_unit(std::span(texels_).subspan(row.index * n_cols, n_cols), square.x());
  const EnvironmentPosition position{.row = static_cast<int>(row.index),
                                     .col = static_cast<int>(col.index),
                                     .u = col.within,
                                     .v = row.within};
  return {.direction = environment_->direction(position),
          .radiance = scale_ * environment_->radiance_at(position),
          .density = density(position)};
}

double EnvironmentLight::density(const EnvironmentPosition& position) const {
  // The probability of the texel, even over its (u, v).
  const auto n_cols = static_cast<std::size_t>(environment_->row_texels());
  const std::size_t texel =
      static_cast<std::size_t>(position.row) * n_cols + static_cast<std::size_t>(position.col);
  const double before = position.col == 0 ? 0.0 : texels_[texel - 1];
  return (texels_[texel] - before) /
         (rows_.back() * environment_->solid_angle_density(position));
}

double EnvironmentLight::density(const Vector3d& direction) const {
  return total_ > 0.0 ? density(environment_->position_of(direction)) : 0.0;
}

Vector3d EnvironmentLight::radiance(const Vector3d& direction) const {
  return scale_ * environment_->radiance(direction);
}

}  // namespace haarlight::render
