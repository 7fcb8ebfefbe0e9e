// SPDX-License-Identifier: Apache-2.0
/// @file
/// Circles in the mean of all pictures by a Hough vote of edges for centre and radius.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <numbers>

#include "core/order_statistics.h"
#include "haarlight/core/error.h"
#include "relight/calibration/mirror_ball.h"

namespace haarlight::relight {

namespace {

using Eigen::Vector2d;

constexpr int kCoarse = 320;            // longer side of the voting picture, pixels
constexpr double kEdgeFraction = 0.06;  // of the pixels: the strongest edges vote
constexpr double kLeastAlong = 0.9;     // cosine between an edge's normal and the radius
constexpr int kAngles = 360;
constexpr double kBand = 0.07;  // of the radius: search range for an edge
constexpr int kFitRounds = 10;
constexpr double kBlur = 2.0;  // pixels: width of a blurred edge

/// Edges count relative to the surrounding light, so that a dark ball before a dark wall has an
/// outline as well.
struct Edges {
  Image<float> x;  ///< unit normals
  Image<float> y;
  Image<float> strength;
};

double middle_value(const Image<float>& picture) {
  std::vector<float> values(picture.pixels().begin(), picture.pixels().end());
  return static_cast<double>(upper_median(values));
}

Image<float> shrunk(ImageView<const float> picture, int factor) {
  Image<float> out(picture.height() / factor, picture.width() / factor, 1);
  for (int y = 0; y < out.height(); ++y) {
    for (int x = 0; x < out.width(); ++x) {
      double sum = 0.0;
      for (int j = 0; j < factor; ++j) {
        for (int i = 0; i < factor; ++i) {
          sum += static_cast<double>(picture(y * factor + j, x * factor + i));
        }
      }
      out(y, x) = static_cast<float>(sum / (factor * factor));
    }
  }
  return out;
}

Edges edges_of(const Image<float>& s) {
  Edges e{Image<float>(s.height(), s.width(), 1), Image<float>(s.height(), s.width(), 1),
          Image<float>(s.height(), s.width(), 1)};
  const double floor = 0.25 * middle_value(s) + 1e-4;
  for (int y = 1; y + 1 < s.height(); ++y) {
    for (int x = 1; x + 1 < s.width(); ++x) {
      const auto at = [&](int j, int i) { return static_cast<double>(s(y + j, x + i)); };
      const double gx =
          (at(-1, 1) + 2.0 * at(0, 1) + at(1, 1)) - (at(-1, -1) + 2.0 * at(0, -1) + at(1, -1));
      const double gy =
          (at(1, -1) + 2.0 * at(1, 0) + at(1, 1)) - (at(-1, -1) + 2.0 * at(-1, 0) + at(-1, 1));
      const double g = std::hypot(gx, gy);
      double around = 0.0;
      for (int j = -1; j <= 1; ++j) {
        for (int i = -1; i <= 1; ++i) {
          around += at(j, i) / 9.0;
        }
      }
      if (g > 0.0) {
        e.x(y, x) = static_cast<float>(gx / g);
        e.y(y, x) = static_cast<float>(gy / g);
        e.strength(y, x) = static_cast<float>(g / (8.0 * (around + floor)));
      }
    }
  }
  return e;
}

struct EdgePoint {
  Vector2d at;
  Vector2d normal;
};

std::vector<EdgePoint> strongest(const Edges& e) {
  std::vector<float> all(e.strength.pixels().begin(), e.strength.pixels().end());
  const float least = std::max(quantile(all, 1.0 - kEdgeFraction), 1e-4F);
  std::vector<EdgePoint> out;
  for (int y = 0; y < e.strength.height(); ++y) {
    for (int x = 0; x < e.strength.width(); ++x) {
      if (e.strength(y, x) >= least) {
        out.push_back({{x + 0.5, y + 0.5}, {e.x(y, x), e.y(y, x)}});
      }
    }
  }
  return out;
}

/// Votes (radius, y, x).
class Votes {
 public:
  Votes(int height, int width, int least, int most)
      : height_(height), width_(width), least_(least), n_(std::max(0, most - least + 1)) {
    of_.assign(static_cast<std::size_t>(n_) * static_cast<std::size_t>(height) *
                   static_cast<std::size_t>(width),
               0);
  }
  void add(const EdgePoint& edge) {
    for (int i = 0; i < n_; ++i) {
      for (const double side : {-1.0, 1.0}) {
        const Vector2d c = edge.at + side * (least_ + i) * edge.normal;
        const int x = static_cast<int>(std::floor(c.x()));
        const int y = static_cast<int>(std::floor(c.y()));
        if (x >= 0 && x < width_ && y >= 0 && y < height_) {
          ++of_[index(i, y, x)];
        }
      }
    }
  }
  /// Best first: votes of 3 x 3 x 3 cells over the square root of the radius.
  [[nodiscard]] std::vector<PictureCircle> peaks(int most) const {
    std::vector<float> score(of_.size(), 0.0F);
    for (int i = 0; i < n_; ++i) {
      for (int y = 1; y + 1 < height_; ++y) {
        for (int x = 1; x + 1 < width_; ++x) {
          score[index(i, y, x)] = around(i, y, x);
        }
      }
    }
    std::vector<PictureCircle> out;
    while (static_cast<int>(out.size()) < most) {
      const auto best = std::max_element(score.begin(), score.end());
      if (!(*best > 0.0F)) {
        break;
      }
      const auto at = static_cast<int>(best - score.begin());
      const int i = at / (height_ * width_);
      const int y = at / width_ % height_;
      const int x = at % width_;
      out.push_back({x + 0.5, y + 0.5, static_cast<double>(least_ + i)});
      clear_near(i, y, x, score);
    }
    return out;
  }

 private:
  [[nodiscard]] std::size_t index(int i, int y, int x) const {
    return (static_cast<std::size_t>(i) * static_cast<std::size_t>(height_) +
            static_cast<std::size_t>(y)) *
               static_cast<std::size_t>(width_) +
           static_cast<std::size_t>(x);
  }
  [[nodiscard]] float around(int i, int y, int x) const {
    int sum = 0;
    for (int k = std::max(0, i - 1); k <= std::min(n_ - 1, i + 1); ++k) {
      for (int j = -1; j <= 1; ++j) {
        sum +=
            of_[index(k, y + j, x - 1)] + of_[index(k, y + j, x)] + of_[index(k, y + j, x + 1)];
      }
    }
    // The square root: divided by the radius itself, a texture's smallest circles would come
    // first.
    return static_cast<float>(sum) / std::sqrt(static_cast<float>(least_ + i));
  }
  void clear_near(int i, int y, int x, std::vector<float>& score) const {
    const int r = least_ + i;
    const int reach = std::max(2, r / 8);
    for (int k = std::max(0, i - reach); k <= std::min(n_ - 1, i + reach); ++k) {
      for (int v = std::max(0, y - reach); v <= std::min(height_ - 1, y + reach); ++v) {
        for (int u = std::max(0, x - reach); u <= std::min(width_ - 1, x + reach); ++u) {
          score[index(k, v, u)] = 0.0F;
        }
      }
    }
  }

  int height_;
  int width_;
  int least_;
  int n_;
  std::vector<std::uint16_t> of_;
};

/// Fraction of the circle that has an edge running along it.
double seen_fraction(const Edges& e, const PictureCircle& circle, float least) {
  constexpr int kArcs = 72;
  int n = 0;
  for (int a = 0; a < kArcs; ++a) {
    const double angle = 2.0 * std::numbers::pi * (a + 0.5) / kArcs;
    const Vector2d out(std::cos(angle), std::sin(angle));
    bool is_seen = false;
    for (int half = -3; half <= 3; ++half) {
      const double d = 0.5 * half;
      const int x = static_cast<int>(std::floor(circle.x + (circle.radius + d) * out.x()));
      const int y = static_cast<int>(std::floor(circle.y + (circle.radius + d) * out.y()));
      if (x < 0 || y < 0 || x >= e.x.width() || y >= e.x.height()) {
        continue;
      }
      const double along =
          static_cast<double>(e.x(y, x)) * out.x() + static_cast<double>(e.y(y, x)) * out.y();
      is_seen = is_seen || (e.strength(y, x) >= least && std::abs(along) > kLeastAlong);
    }
    n += is_seen ? 1 : 0;
  }
  return static_cast<double>(n) / kArcs;
}

double sample(ImageView<const float> picture, double x, double y) {
  const double u = std::clamp(x - 0.5, 0.0, picture.width() - 1.0001);
  const double v = std::clamp(y - 0.5, 0.0, picture.height() - 1.0001);
  const int i = static_cast<int>(u);
  const int j = static_cast<int>(v);
  const double a = u - i;
  const double b = v - j;
  const auto at = [&](int p, int q) { return static_cast<double>(picture(q, p)); };
  return (1 - b) * ((1 - a) * at(i, j) + a * at(i + 1, j)) +
         b * ((1 - a) * at(i, j + 1) + a * at(i + 1, j + 1));
}

struct RadialEdge {
  Vector2d at;
  double strength = 0.0;
};

/// The strongest step along one radius, with sub-pixel precision.
RadialEdge edge_along(ImageView<const float> picture, const PictureCircle& circle, double angle,
                      double band, double floor) {
  const Vector2d out(std::cos(angle), std::sin(angle));
  const double step = std::max(0.5, band / 40.0);
  const auto strength = [&](double r) {
    const double a =
        sample(picture, circle.x + (r - step) * out.x(), circle.y + (r - step) * out.y());
    const double b =
        sample(picture, circle.x + (r + step) * out.x(), circle.y + (r + step) * out.y());
    return std::abs(b - a) / (0.5 * (a + b) + floor);
  };
  double best = 0.0;
  double at = circle.radius;
  const int n_steps = static_cast<int>(std::floor(2.0 * band / step));
  for (int i = 0; i <= n_steps; ++i) {
    const double r = circle.radius - band + i * step;
    const double x = circle.x + r * out.x();
    const double y = circle.y + r * out.y();
    if (x < 1.0 || y < 1.0 || x > picture.width() - 1.0 || y > picture.height() - 1.0) {
      continue;
    }
    const double s = strength(r);
    if (s > best) {
      best = s;
      at = r;
    }
  }
  // Located in linear light: relative steps and square roots are biased to the dark side of a
  // blur.
  const auto slope = [&](double r) {
    const double low =
        sample(picture, circle.x + (r - step) * out.x(), circle.y + (r - step) * out.y());
    const double high =
        sample(picture, circle.x + (r + step) * out.x(), circle.y + (r + step) * out.y());
    return std::abs(high * high - low * low);
  };
  double steepest = 0.0;
  const double from = at;
  const int n_quarters = static_cast<int>(std::floor(4.0 * kBlur));
  for (int i = -n_quarters; i <= n_quarters; ++i) {
    const double r = from + 0.25 * i;
    const double s = slope(r);
    if (s > steepest) {
      steepest = s;
      at = r;
    }
  }
  const double before = slope(at - 0.25);
  const double after = slope(at + 0.25);
  const double bend = before - 2.0 * steepest + after;
  if (bend < 0.0) {
    at += std::clamp(0.5 * (before - after) / bend, -1.0, 1.0) * 0.25;
  }
  return {Vector2d(circle.x, circle.y) + at * out, best};
}

/// A coarse circle measured at full resolution; nothing if its edge is not found.
std::optional<MeasuredBall> measured(ImageView<const float> picture, PictureCircle circle,
                                     double floor) {
  std::vector<Vector2d> kept;
  double band = std::max(3.0, kBand * circle.radius);
  for (int round = 0; round < kFitRounds; ++round) {
    std::vector<RadialEdge> edges;
    std::vector<double> strengths;
    for (int a = 0; a < kAngles; ++a) {
      const double angle = 2.0 * std::numbers::pi * (a + 0.5) / kAngles;
      edges.push_back(edge_along(picture, circle, angle, band, floor));
      strengths.push_back(edges.back().strength);
    }
    const double least = 0.25 * upper_median(strengths);
    std::vector<double> misses;
    misses.reserve(edges.size());
    for (const RadialEdge& e : edges) {
      misses.push_back(std::abs((e.at - Vector2d(circle.x, circle.y)).norm() - circle.radius));
    }
    const double most =
        std::min(std::max(1.0, 3.0 * upper_median(misses)), 0.7 + 0.02 * circle.radius);
    kept.clear();
    for (std::size_t i = 0; i < edges.size(); ++i) {
      if (edges[i].strength > least && misses[i] <= most) {
        kept.push_back(edges[i].at);
      }
    }
    if (kept.size() < kAngles / 3) {
      return std::nullopt;
    }
    try {
      circle = fit_circle(kept);
    } catch (const Error&) {
      return std::nullopt;  // the remaining points lie on a line: no ball
    }
    band = std::max(2.5, 0.7 * band);
  }
  try {
    const auto n = static_cast<double>(kept.size());
    MeasuredBall ball = measure_ball(std::move(kept));
    ball.seen = n / kAngles;
    return ball;
  } catch (const Error&) {
    return std::nullopt;  // less than a third of a circle
  }
}

}  // namespace

void BallPictures::add(ImageView<const float> picture) {
  if (n_ == 0) {
    sum_ = Image<float>(picture.height(), picture.width(), 1);
  }
  HAARLIGHT_EXPECTS(picture.height() == sum_.height() && picture.width() == sum_.width(),
                    "pictures of one size");
  for (int y = 0; y < picture.height(); ++y) {
    for (int x = 0; x < picture.width(); ++x) {
      double value = 0.0;
      for (int c = 0; c < picture.channels(); ++c) {
        value += static_cast<double>(picture(y, x, c)) / picture.channels();
      }
      sum_(y, x) += static_cast<float>(std::sqrt(std::max(value, 0.0)));
    }
  }
  ++n_;
}

Image<float> BallPictures::mean() const {
  Image<float> out = sum_;
  for (float& value : out.pixels()) {
    value /= static_cast<float>(std::max(n_, 1));
  }
  return out;
}

std::vector<MeasuredBall> find_circles(ImageView<const float> mean,
                                       const BallSearchOptions& options) {
  const int factor = std::max(1, std::max(mean.width(), mean.height()) / kCoarse);
  const Image<float> small = shrunk(mean, factor);
  if (small.width() < 16 || small.height() < 16) {
    return {};
  }
  const Edges edges = edges_of(small);
  const std::vector<EdgePoint> voters = strongest(edges);
  float least = 1e9F;
  for (const EdgePoint& v : voters) {
    least =
        std::min(least, edges.strength(static_cast<int>(v.at.y()), static_cast<int>(v.at.x())));
  }
  const double shorter = std::min(small.width(), small.height());
  Votes votes(small.height(), small.width(),
              std::max(4, static_cast<int>(options.least_radius * shorter)),
              static_cast<int>(options.most_radius * shorter));
  for (const EdgePoint& v : voters) {
    votes.add(v);
  }
  const double floor = 0.25 * middle_value(small) + 1e-4;
  std::vector<MeasuredBall> out;
  for (PictureCircle circle : votes.peaks(options.most)) {
    if (seen_fraction(edges, circle, least) < options.least_seen) {
      continue;
    }
    circle.x *= factor;
    circle.y *= factor;
    circle.radius *= factor;
    std::optional<MeasuredBall> ball = measured(mean, circle, floor);
    if (!ball) {
      continue;
    }
    // Nearby votes lead to the same circle.
    const auto is_known = [&](const MeasuredBall& known) {
      const PictureCircle& a = ball->circle;
      const PictureCircle& b = known.circle;
      return std::hypot(a.x - b.x, a.y - b.y) + std::abs(a.radius - b.radius) < 0.03 * b.radius;
    };
    if (std::none_of(out.begin(), out.end(), is_known)) {
      out.push_back(std::move(*ball));
    }
  }
  std::stable_sort(out.begin(), out.end(), [](const MeasuredBall& a, const MeasuredBall& b) {
    return a.seen > b.seen;
  });
  return out;
}

}  // namespace haarlight::relight
