// SPDX-License-Identifier: Apache-2.0
#include "render/scene/texture.h"

#include <array>
#include <cmath>
#include <span>
#include <utility>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"

namespace haarlight::render {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

/// In [0, 1): of -1e-300, too, whose difference from its floor is rounded to 1.
double fraction_of(double coordinate) {
  const double fraction = coordinate - std::floor(coordinate);
  return fraction < 1.0 ? fraction : 0.0;
}

/// The two texels between whose centres a coordinate lies, and the second one's weight.
struct Between {
  int first;
  int second;
  double weight;
};
/// @param fraction  in [0, 1) of a side of n texels
Between between(double fraction, int n) {
  const double at = fraction * n - 0.5;
  const double below = std::floor(at);  // -1..n-1
  const int first = static_cast<int>(below);
  return {.first = first < 0 ? n - 1 : first,
          .second = first + 1 < n ? first + 1 : 0,
          .weight = at - below};
}

std::string hash_of_picture(const Image<float>& picture) {
  ContentHash hash;
  const std::array<int, 3> shape = {picture.height(), picture.width(), picture.channels()};
  hash.add(std::as_bytes(std::span(shape)));
  hash.add(std::as_bytes(picture.pixels()));
  return hash.text();
}

}  // namespace

Texture::Texture(Image<float> picture)
    : picture_(std::move(picture)), hash_(hash_of_picture(picture_)) {
  HAARLIGHT_EXPECTS(!picture_.is_empty(), "a texel or more");
  HAARLIGHT_EXPECTS(picture_.channels() == 1 || picture_.channels() == 3, "grey or RGB");
}

Vector3d Texture::at(const Vector2d& uv) const {
  const Between column = between(fraction_of(uv.x()), picture_.width());
  const Between row = between(fraction_of(-uv.y()), picture_.height());  // rows go down
  const auto channel = [&](int c) {
    const auto along = [&](int y) {
      return (1.0 - column.weight) * picture_(y, column.first, c) +
             column.weight * picture_(y, column.second, c);
    };
    return (1.0 - row.weight) * along(row.first) + row.weight * along(row.second);
  };
  if (picture_.channels() == 1) {
    return Vector3d::Constant(channel(0));
  }
  return {channel(0), channel(1), channel(2)};
}

}  // namespace haarlight::render
