// SPDX-License-Identifier: Apache-2.0
#include "relight/shadow/plane_views.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "haarlight/core/error.h"

namespace haarlight::relight {
namespace {

constexpr double kSamePlaneTexels = 0.25;
constexpr double kBorderTexels = 1.0;

}  // namespace

PlaneRelation relate_planes(const PlaneFrame& frame, const PlaneFrame& other) {
  const std::array<Eigen::Vector3d, 4> corners{
      other.world_of(0.0, 0.0), other.world_of(other.width, 0.0),
      other.world_of(0.0, other.height), other.world_of(other.width, other.height)};
  Eigen::Vector2d low = Eigen::Vector2d::Constant(std::numeric_limits<double>::infinity());
  Eigen::Vector2d high = -low;
  for (const Eigen::Vector3d& corner : corners) {
    if (!(std::abs(frame.height_of(corner)) <= kSamePlaneTexels * frame.texel_mm)) {
      return PlaneRelation::apart;
    }
    const Eigen::Vector2d at = frame.picture_of(corner);
    low = low.cwiseMin(at);
    high = high.cwiseMax(at);
  }
  const Eigen::Vector2d size(frame.width, frame.height);
  if (((low.array() >= -kBorderTexels) && (high.array() <= size.array() + kBorderTexels))
          .all()) {
    return PlaneRelation::same;
  }
  const bool meets =
      ((high.array() > kBorderTexels) && (low.array() < size.array() - kBorderTexels)).all();
  return meets ? PlaneRelation::reaches_out : PlaneRelation::apart;
}

Visibility join_views(std::span<const Visibility> views, std::span<const double> weights) {
  HAARLIGHT_EXPECTS(!views.empty() && views.size() == weights.size(), "one weight per view");
  const Visibility& first = views[0];
  Visibility joined{Image<float>(first.value.height(), first.value.width(), 1),
                    Image<std::uint8_t>(first.value.height(), first.value.width(), 1),
                    {}};
  for (const Visibility& view : views) {
    HAARLIGHT_EXPECTS(view.value.width() == first.value.width() &&
                          view.value.height() == first.value.height(),
                      "views in one frame");
    joined.count.add(view.count);
    joined.deviation = std::max(joined.deviation, view.deviation);
  }
  for (std::size_t i = 0; i < joined.value.pixels().size(); ++i) {
    double sum = 0.0;
    double weight = 0.0;
    for (std::size_t v = 0; v < views.size(); ++v) {
      if (views[v].known.pixels()[i] != 0) {
        sum += weights[v] * static_cast<double>(views[v].value.pixels()[i]);
        weight += weights[v];
      }
    }
    if (weight > 0.0) {
      joined.value.pixels()[i] = static_cast<float>(sum / weight);
      joined.known.pixels()[i] = 1;
    }
  }
  return joined;
}

}  // namespace haarlight::relight
