// SPDX-License-Identifier: Apache-2.0
#include "session/develop/bad_pixels.h"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "core/order_statistics.h"
#include "haarlight/core/error.h"

namespace haarlight::session {

namespace {

// 8 sigma keeps false alarms below one in 10^14 normal pixels.
constexpr double kHotSigmas = 8.0;
constexpr double kHotFraction = 0.01;
constexpr std::size_t kMostBad = 20;  // one in this many

}  // namespace

void mark_hot(const Image<float>& dark, double range, BadPixelMap& map) {
  map.is_bad.resize(static_cast<std::size_t>(dark.height()) *
                    static_cast<std::size_t>(dark.width()));
  std::vector<float> values(dark.pixels().begin(), dark.pixels().end());
  const float median = upper_median(std::span(values));
  for (float& value : values) {
    value = std::abs(value - median);
  }
  const double sigma = kSigmaPerMad * upper_median(std::span(values));
  const double limit = median + std::max(kHotSigmas * sigma, kHotFraction * range);
  for (std::size_t i = 0; i < dark.pixels().size(); ++i) {
    const std::size_t pixel = i / static_cast<std::size_t>(dark.channels());
    if (dark.pixels()[i] > limit && !map.is_bad[pixel]) {
      map.is_bad[pixel] = true;
      ++map.n_hot;
    }
  }
}

void require_few_bad(const Session& session, const BadPixelMap& map) {
  const auto n_bad = static_cast<std::size_t>(map.n_hot) + static_cast<std::size_t>(map.n_dead);
  if (n_bad * kMostBad > map.is_bad.size()) {
    throw Error(
        fmt::format("{} of {} pixels are hot in the dark frames or dead in the flat field",
                    n_bad, map.is_bad.size()),
        session.folder().string(),
        "take the dark and flat frames again: the cap off, the flat lit evenly");
  }
}

void inpaint(const FrameForm& form, const BadPixelMap& map, int y0, Image<float>& rows,
             Image<float>& variance) {
  const auto is_bad = [&](int y, int x) {
    return map.is_bad[static_cast<std::size_t>(y) * static_cast<std::size_t>(form.width) +
                      static_cast<std::size_t>(x)];
  };
  const int step = form.bayer == BayerPattern::none ? 1 : 2;
  const Image<float> before = rows;
  const Image<float> variance_before = variance;
  std::vector<float> good;
  for (int y = 0; y < rows.height(); ++y) {
    for (int x = 0; x < rows.width(); ++x) {
      if (!is_bad(y0 + y, x)) {
        continue;
      }
      for (int c = 0; c < rows.channels(); ++c) {
        good.clear();
        bool is_bound = false;
        for (int reach = 1; good.empty() && reach <= 2; ++reach) {
          for (int v = y - reach * step; v <= y + reach * step; v += step) {
            for (int u = x - reach * step; u <= x + reach * step; u += step) {
              if (v >= 0 && v < rows.height() && u >= 0 && u < rows.width() &&
                  !is_bad(y0 + v, u)) {
                good.push_back(before(v, u, c));
                is_bound = is_bound || variance_before(v, u, c) < 0.0F;
              }
            }
          }
        }
        if (good.empty()) {
          continue;
        }
        double mean = 0.0;
        double squares = 0.0;
        for (const float value : good) {
          mean += value / static_cast<double>(good.size());
        }
        for (const float value : good) {
          squares += (value - mean) * (value - mean);
        }
        rows(y, x, c) = upper_median(std::span(good));
        const auto n = static_cast<double>(std::max<std::size_t>(good.size() - 1, 1));
        variance(y, x, c) = is_bound ? -1.0F : static_cast<float>(squares / n);
      }
    }
  }
}

}  // namespace haarlight::session
