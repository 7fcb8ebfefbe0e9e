// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include <Eigen/Core>

#include "haarlight/render/film/film_settings.h"

/// @file
/// Reconstruction filters by importance sampling [Ernst06]: a pixel's samples are drawn about its
/// centre as the filter weighs them, so that each belongs to one pixel, and tiles and parts of a
/// picture never meet.

namespace haarlight::render {

/// The filter at a distance along one axis, not normalised; the whole is a product of two.
[[nodiscard]] double filter_value(FilterKind kind, double x);

class PixelFilter {
 public:
  explicit PixelFilter(FilterKind kind);

  struct Sample {
    Eigen::Vector2d offset;  ///< from the pixel's centre, pixels
    double weight;           ///< of what is seen there; the mean of all weights is 1
  };
  /// @param square  in [0, 1)^2
  [[nodiscard]] Sample sample(const Eigen::Vector2d& square) const;

  /// How far from its centre a pixel still looks, along each axis.
  [[nodiscard]] double radius() const noexcept { return radius_; }
  /// How a pixel weighs what is seen there: its integral is 1. What sample() draws has that as the
  /// mean of its weights. @param offset  from the pixel's centre
  [[nodiscard]] double value(const Eigen::Vector2d& offset) const {
    return filter_value(kind_, offset.x()) * filter_value(kind_, offset.y()) /
           (integral_ * integral_);
  }

 private:
  struct Along {
    double offset;
    double weight;
  };
  [[nodiscard]] Along along(double number) const;

  FilterKind kind_;
  double radius_ = 0.5;
  double integral_ = 1.0;
  std::vector<double>
      up_to_;  ///< of |filter| over equal cells, the fraction up to each cell's end
};

}  // namespace haarlight::render
