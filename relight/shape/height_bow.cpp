// SPDX-License-Identifier: Apache-2.0
#include "relight/shape/height_bow.h"

#include <algorithm>
#include <limits>

#include <Eigen/Cholesky>
#include <Eigen/Core>

#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

using Vector6d = Eigen::Matrix<double, 6, 1>;

struct Range {
  double low = std::numeric_limits<double>::infinity();
  double high = -std::numeric_limits<double>::infinity();
  void add(double value) {
    low = std::min(low, value);
    high = std::max(high, value);
  }
};

}  // namespace

HeightBow height_bow(ImageView<const float> height, ImageView<const std::uint8_t> is_known) {
  const int h = height.height();
  const int w = height.width();
  HAARLIGHT_EXPECTS(is_known.height() == h && is_known.width() == w, "pictures of one size");
  const auto terms = [&](int y, int x) {
    const double u = (2.0 * x + 1.0) / w - 1.0;
    const double v = (2.0 * y + 1.0) / h - 1.0;
    Vector6d t;
    t << 1.0, u, v, u * u, u * v, v * v;
    return t;
  };
  Eigen::Matrix<double, 6, 6> matrix = Eigen::Matrix<double, 6, 6>::Zero();
  Vector6d right = Vector6d::Zero();
  int n = 0;
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      if (is_known(y, x) != 0) {
        const Vector6d t = terms(y, x);
        matrix += t * t.transpose();
        right += double{height(y, x)} * t;
        ++n;
      }
    }
  }
  if (n < right.size()) {
    return {};
  }
  const Vector6d a = matrix.ldlt().solve(right);
  Range bow;
  Range rest;
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      if (is_known(y, x) != 0) {
        const double value = a.dot(terms(y, x));
        bow.add(value);
        rest.add(double{height(y, x)} - value);
      }
    }
  }
  return {bow.high - bow.low, rest.high - rest.low};
}

}  // namespace haarlight::relight
