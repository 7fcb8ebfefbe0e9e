// SPDX-License-Identifier: Apache-2.0
#include "render/film/smoothing.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "core/parallel.h"
#include "haarlight/core/error.h"

namespace haarlight::render {

namespace {

/// Neighbours of a pixel within a square, in one order, itself not among them.
template <class Visit>
void for_neighbours(int y, int x, int radius, int height, int width, const Visit& visit) {
  for (int v = std::max(0, y - radius); v <= std::min(height - 1, y + radius); ++v) {
    for (int u = std::max(0, x - radius); u <= std::min(width - 1, x + radius); ++u) {
      if (v != y || u != x) {
        visit(v, u);
      }
    }
  }
}

template <class Body>
void for_rows(int height, const Body& body) {
  parallel_for(static_cast<std::size_t>(height), 4, [&](std::size_t begin, std::size_t end) {
    for (std::size_t y = begin; y < end; ++y) {
      body(static_cast<int>(y));
    }
  });
}

/// Exchanges between neighbours: of a symmetric affinity g, each pixel's own 1, the weights are
/// w_pq = g_pq/max(W_p, W_q), W the sums of g: symmetric, and none gives more than it has.
template <class Affinity>
std::vector<double> exchanged(const std::vector<double>& picture, int height, int width,
                              int channels, int radius, const Affinity& affinity) {
  const auto at = [width](int y, int x) {
    return static_cast<std::size_t>(y) * static_cast<std::size_t>(width) +
           static_cast<std::size_t>(x);
  };
  std::vector<double> sums(static_cast<std::size_t>(height) * static_cast<std::size_t>(width));
  for_rows(height, [&](int y) {
    for (int x = 0; x < width; ++x) {
      double sum = 1.0;
      for_neighbours(y, x, radius, height, width,
                     [&](int v, int u) { sum += affinity(y, x, v, u); });
      sums[at(y, x)] = sum;
    }
  });
  std::vector<double> result(picture);
  const auto n = static_cast<std::size_t>(channels);
  for_rows(height, [&](int y) {
    for (int x = 0; x < width; ++x) {
      const std::size_t p = at(y, x);
      for_neighbours(y, x, radius, height, width, [&](int v, int u) {
        const std::size_t q = at(v, u);
        const double weight = affinity(y, x, v, u) / std::max(sums[p], sums[q]);
        for (std::size_t c = 0; c < n && weight > 0.0; ++c) {
          result[n * p + c] += weight * (picture[n * q + c] - picture[n * p + c]);
        }
      });
    }
  });
  return result;
}

/// The middle one of 3 x 3, of an even number at an edge the mean of the two.
std::vector<double> medians(const std::vector<double>& picture, int height, int width,
                            int channels) {
  std::vector<double> result(picture.size());
  for_rows(height, [&](int y) {
    std::vector<double> values;
    for (int x = 0; x < width; ++x) {
      for (int c = 0; c < channels; ++c) {
        const auto at = [&](int v, int u) {
          return (static_cast<std::size_t>(v) * static_cast<std::size_t>(width) +
                  static_cast<std::size_t>(u)) *
                     static_cast<std::size_t>(channels) +
                 static_cast<std::size_t>(c);
        };
        values.assign(1, picture[at(y, x)]);
        for_neighbours(y, x, 1, height, width,
                       [&](int v, int u) { values.push_back(picture[at(v, u)]); });
        std::ranges::sort(values);
        const std::size_t n = values.size();
        result[at(y, x)] = 0.5 * values[(n - 1) / 2] + 0.5 * values[n / 2];
      }
    }
  });
  return result;
}

/// How alike two pixels are, 0..1; the same both ways.
class Likeness {
 public:
  Likeness(ImageView<const float> picture, const PictureFeatures& features,
           const SmoothingOptions& options)
      : picture_(picture), features_(features), options_(options) {}

  double operator()(int y, int x, int v, int u) const {
    double exponent =
        squared(features_.normal, y, x, v, u) / (options_.normal * options_.normal) +
        squared(features_.albedo, y, x, v, u) / (options_.albedo * options_.albedo);
    const double near = std::min(features_.depth(y, x), features_.depth(v, u));
    const double gap = double{features_.depth(y, x)} - features_.depth(v, u);
    const double pixels = std::hypot(v - y, u - x);
    const double allowed = options_.depth * std::abs(near) * pixels;
    if (gap != 0.0) {
      exponent += std::pow(gap / std::max(allowed, 1e-300), 2);
    }
    exponent += pixels * pixels / std::pow(0.5 * options_.radius + 0.5, 2);
    if (!features_.error.is_empty()) {
      exponent += std::pow(standard_errors(y, x, v, u) / options_.colour, 2);
    }
    return std::exp(-0.5 * std::min(exponent, 1e3));
  }

 private:
  static double squared(ImageView<const float> image, int y, int x, int v, int u) {
    double sum = 0.0;
    for (int c = 0; c < image.channels(); ++c) {
      const double difference = double{image(y, x, c)} - image(v, u, c);
      sum += difference * difference;
    }
    return sum;
  }

  /// By how many of them the colours differ; noise alone makes about one.
  [[nodiscard]] double standard_errors(int y, int x, int v, int u) const {
    double difference = 0.0;
    double variance = 0.0;
    for (int c = 0; c < picture_.channels(); ++c) {
      difference = std::hypot(difference, double{picture_(y, x, c)} - picture_(v, u, c));
      variance = std::hypot(variance, std::hypot(double{features_.error(y, x, c)},
                                                 double{features_.error(v, u, c)}));
    }
    return difference == 0.0 ? 0.0 : std::min(difference / std::max(variance, 1e-300), 1e100);
  }

  ImageView<const float> picture_;
  PictureFeatures features_;
  SmoothingOptions options_;
};

bool has_size_of(ImageView<const float> image, ImageView<const float> picture) {
  return image.height() == picture.height() && image.width() == picture.width();
}

}  // namespace

Image<float> smooth(ImageView<const float> picture, const PictureFeatures& features,
                    const SmoothingOptions& options) {
  const int height = picture.height();
  const int width = picture.width();
  const int channels = picture.channels();
  std::vector<double> values;
  for (int y = 0; y < height; ++y) {
    values.insert(values.end(), picture.row(y).begin(), picture.row(y).end());
  }
  const auto alike = [](int, int, int, int) { return 1.0; };
  switch (options.kind) {
    case SmoothingKind::low_pass:
      values = exchanged(values, height, width, channels, 1, alike);
      break;
    case SmoothingKind::median: {
      const std::vector<double> middle = medians(values, height, width, channels);
      for (std::size_t i = 0; i < values.size(); ++i) {
        values[i] -= middle[i];
      }
      values = exchanged(values, height, width, channels, 1, alike);
      for (std::size_t i = 0; i < values.size(); ++i) {
        values[i] += middle[i];
      }
      break;
    }
    case SmoothingKind::features:
      HAARLIGHT_EXPECTS(
          has_size_of(features.albedo, picture) && has_size_of(features.normal, picture) &&
              has_size_of(features.depth, picture) &&
              (features.error.is_empty() ||
               (has_size_of(features.error, picture) && features.error.channels() == channels)),
          "features of the picture's size");
      values = exchanged(values, height, width, channels, options.radius,
                         Likeness(picture, features, options));
      break;
  }
  Image<float> result(height, width, std::max(channels, 1));
  std::ranges::transform(values, result.pixels().begin(),
                         [](double value) { return static_cast<float>(value); });
  return result;
}

}  // namespace haarlight::render
