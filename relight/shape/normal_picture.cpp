// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/shape/normal_picture.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "core/order_statistics.h"
#include "haarlight/core/error.h"
#include "haarlight/core/picture/image_io.h"

namespace haarlight::relight {

namespace {

using Eigen::Vector3d;

Vector3d normal_at(ImageView<const float> normals, int y, int x) {
  return {double{normals(y, x, 0)}, double{normals(y, x, 1)}, double{normals(y, x, 2)}};
}

}  // namespace

Image<float> turned_normals(ImageView<const float> normals, const Eigen::Matrix3d& turn) {
  HAARLIGHT_EXPECTS(normals.channels() == 3, "normals");
  Image<float> out(normals.height(), normals.width(), 3);
  for (int y = 0; y < normals.height(); ++y) {
    for (int x = 0; x < normals.width(); ++x) {
      const Vector3d n = turn * normal_at(normals, y, x);
      for (int c = 0; c < 3; ++c) {
        out(y, x, c) = static_cast<float>(n[c]);
      }
    }
  }
  return out;
}

Image<float> normal_map(ImageView<const float> normals) {
  HAARLIGHT_EXPECTS(normals.channels() == 3, "normals");
  Image<float> out(normals.height(), normals.width(), 3);
  for (int y = 0; y < normals.height(); ++y) {
    for (int x = 0; x < normals.width(); ++x) {
      const Vector3d n = normal_at(normals, y, x);
      if (n.isZero()) {
        continue;
      }
      for (int c = 0; c < 3; ++c) {
        out(y, x, c) = linear_from_srgb(static_cast<float>(0.5 * (n[c] + 1.0)));
      }
    }
  }
  return out;
}

Image<float> enhanced_picture(ImageView<const float> normals, ImageView<const float> albedo,
                              const EnhancedLook& look) {
  const int h = normals.height();
  const int w = normals.width();
  HAARLIGHT_EXPECTS(normals.channels() == 3 && albedo.height() == h && albedo.width() == w,
                    "normals and albedo of one size");
  HAARLIGHT_EXPECTS(look.light.norm() > 0.0, "a light somewhere");
  const Vector3d light = look.light.normalized();
  const Vector3d half = (light + Vector3d::UnitZ()).normalized();
  std::vector<float> values;
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      if (!normal_at(normals, y, x).isZero()) {
        for (int c = 0; c < albedo.channels(); ++c) {
          values.push_back(albedo(y, x, c));
        }
      }
    }
  }
  const double bright = values.empty() ? 0.0 : double{quantile(std::move(values), 0.99)};
  const double scale = bright > 0.0 ? look.diffuse / bright : 0.0;
  Image<float> out(h, w, 3);
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      const Vector3d n = normal_at(normals, y, x);
      if (n.isZero()) {
        continue;
      }
      const double facing = std::max(0.0, n.dot(light));
      const double gloss =
          facing > 0.0 && half.allFinite()
              ? look.specular * std::pow(std::max(0.0, n.dot(half)), look.exponent)
              : 0.0;
      for (int c = 0; c < 3; ++c) {
        const float a = std::max(albedo(y, x, albedo.channels() == 3 ? c : 0), 0.0F);
        out(y, x, c) = static_cast<float>(scale * double{a} * facing + gloss);
      }
    }
  }
  return out;
}

}  // namespace haarlight::relight
