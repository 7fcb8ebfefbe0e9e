// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/float_sums.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "relight/basis/relight_kernels.h"

namespace haarlight::relight {

namespace {

// Still normal when multiplied by the smallest half (2^-24) or the smallest pixel step (2^-40).
constexpr double kSmallestFactor = 0x1p-60;

}  // namespace

int unit_exponent(std::span<const double> factors) {
  double most = 0.0;
  for (const double factor : factors) {
    most = std::max(most, std::abs(factor));
  }
  return most > 0.0 ? std::ilogb(most) + 1 : 0;
}

float in_units(double factor, int exponent) {
  const double scaled = std::ldexp(factor, -exponent);
  return std::abs(scaled) < kSmallestFactor ? 0.0F : static_cast<float>(scaled);
}

double float_sum_error(double factor, int exponent, int n_roundings) {
  if (std::abs(std::ldexp(factor, -exponent)) < kSmallestFactor) {
    return std::abs(factor);
  }
  const double sum = n_roundings * 0x1p-24;
  return std::abs(factor) * sum / (1.0 - sum);
}

std::vector<float> root_round_up(std::span<const double> squares) {
  std::vector<float> roots(squares.size());
  std::transform(squares.begin(), squares.end(), roots.begin(), [](double square) {
    const double root = std::sqrt(square);
    const auto rounded = static_cast<float>(root);
    return double{rounded} < root
               ? std::nextafter(rounded, std::numeric_limits<float>::infinity())
               : rounded;
  });
  return roots;
}

std::vector<std::vector<const LightQuery*>> batches_of_channel(const LightQueries& requested,
                                                               int channel) {
  std::vector<std::vector<const LightQuery*>> batches;
  for (const LightQuery& query : requested.queries()) {
    if (query.channel != channel) {
      continue;
    }
    if (batches.empty() || batches.back().size() == kBatch) {
      batches.emplace_back();
    }
    batches.back().push_back(&query);
  }
  return batches;
}

void put_sums(std::span<const float> sums, std::size_t stride, int exponent,
              const TileRect& rect, const LightQuery& query,
              std::vector<RelitPicture>& pictures) {
  Image<float>& picture = pictures[static_cast<std::size_t>(query.environment)].picture;
  const double unit = std::ldexp(1.0, exponent);
  const auto small_unit = static_cast<float>(unit);
  const bool is_small = std::isnormal(small_unit);  // a power of two: the same product
  const bool is_double = std::isnormal(unit);
  const auto width = static_cast<std::size_t>(rect.width);
  const auto channels = static_cast<std::size_t>(picture.channels());
  for (int y = 0; y < rect.height; ++y) {
    float* to = &picture(rect.y0 + y, rect.x0, query.out_channel);
    const float* from = sums.data() + static_cast<std::size_t>(y) * width * stride;
    if (is_small && channels == 1 && stride == 1) {
      for (std::size_t k = 0; k < width; ++k) {
        to[k] = small_unit * from[k];
      }
    } else {
      for (std::size_t k = 0; k < width; ++k) {
        const double sum = from[k * stride];
        // 0 times a unit that overflows double would be NaN.
        to[k * channels] =
            static_cast<float>(is_double ? unit * sum : std::ldexp(sum, exponent));
      }
    }
  }
}

}  // namespace haarlight::relight
