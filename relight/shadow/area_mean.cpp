// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/shadow/area_mean.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "haarlight/core/error.h"

namespace haarlight::relight {

LightWindow project_window(const Plane& plane, const Eigen::Vector3d& light_centre,
                           const std::array<Eigen::Vector3d, 4>& light_corners,
                           const Eigen::Vector3d& vertex) {
  LightWindow window;
  const PlaneProjection centre = project_to_plane(plane, light_centre, vertex);
  window.status = centre.status;
  window.centre = centre.point;
  window.ratio = centre.ratio;
  window.has_corners = true;
  for (std::size_t i = 0; i < 4; ++i) {
    const PlaneProjection corner = project_to_plane(plane, light_corners[i], vertex);
    window.corners[i] = corner.point;
    window.has_corners = window.has_corners && is_valid(corner.status);
  }
  return window;
}

double window_side(double side, double vertex_height, double light_height) {
  return side * std::abs(vertex_height) / (light_height - vertex_height);
}

double corrected_window_scale(double ratio, double object_height_fraction) {
  HAARLIGHT_ASSERT(ratio < 0.0 && object_height_fraction >= 0.0 &&
                   object_height_fraction < 1.0);
  // B/s = h_o/(H - h_o), W/s = |h|/(H - h); both only through the fractions of H.
  const double b = object_height_fraction / (1.0 - object_height_fraction);
  const double w = -ratio / (1.0 - ratio);
  return std::sqrt(1.0 + 2.0 * b / w);
}

double widening_above(double ratio, double object_height_fraction) {
  const double b = object_height_fraction / (1.0 - object_height_fraction);
  const double w = ratio / (1.0 - ratio);
  return w < b ? b / (b - w) : std::numeric_limits<double>::infinity();
}

WindowSums::WindowSums(ImageView<const float> visibility, ImageView<const std::uint8_t> known,
                       double deviation)
    : width_(visibility.width()), height_(visibility.height()), deviation_(deviation) {
  HAARLIGHT_EXPECTS(known.width() == width_ && known.height() == height_,
                    "one mask per picture");
  const auto stride = static_cast<std::size_t>(width_) + 1;
  const std::size_t n = stride * (static_cast<std::size_t>(height_) + 1);
  visible_.resize(n);
  Table unknown(n);
  for (int y = 0; y < height_; ++y) {
    Sum row;
    for (int x = 0; x < width_; ++x) {
      if (known(y, x) != 0) {
        row.visible += static_cast<double>(visibility(y, x));
      } else {
        row.unknown += 1.0;
      }
      const std::size_t at =
          (static_cast<std::size_t>(y) + 1) * stride + static_cast<std::size_t>(x) + 1;
      visible_[at] = visible_[at - stride] + row.visible;
      unknown[at] = unknown[at - stride] + row.unknown;
    }
  }
  if (unknown.back() > 0.0) {
    unknown_ = std::make_shared<const Table>(std::move(unknown));
  }
}

WindowSums::WindowSums(std::span<const WindowSums* const> parts,
                       std::span<const double> weights)
    : width_(parts[0]->width_), height_(parts[0]->height_), unknown_(parts[0]->unknown_) {
  HAARLIGHT_EXPECTS(parts.size() == weights.size(), "one weight per picture");
  const auto blend = [&](Table& out, const auto& table_of) {
    out.assign(visible_.size(), 0.0);
    for (std::size_t p = 0; p < parts.size(); ++p) {
      const Table* in = table_of(*parts[p]);
      for (std::size_t i = 0; in != nullptr && i < out.size(); ++i) {
        out[i] += weights[p] * (*in)[i];
      }
    }
  };
  visible_.resize(parts[0]->visible_.size());
  for (std::size_t p = 0; p < parts.size(); ++p) {
    HAARLIGHT_EXPECTS(parts[p]->width_ == width_ && parts[p]->height_ == height_, "one size");
    deviation_ = std::hypot(deviation_, weights[p] * parts[p]->deviation_);
  }
  blend(visible_, [](const WindowSums& part) { return &part.visible_; });
  const bool is_shared = std::all_of(parts.begin(), parts.end(), [&](const WindowSums* part) {
    return part->unknown_ == unknown_;
  });
  if (!is_shared) {
    Table unknown;
    blend(unknown, [](const WindowSums& part) { return part.unknown_.get(); });
    unknown_ = std::make_shared<const Table>(std::move(unknown));
  }
}

void WindowSums::share_unknown(const WindowSums& other) {
  if (unknown_ && other.unknown_ && *unknown_ == *other.unknown_) {
    unknown_ = other.unknown_;
  }
}

WindowSums::Sum WindowSums::integral(double x0, double x1, double y0, double y1) const {
  x0 = std::clamp(x0, 0.0, static_cast<double>(width_));
  x1 = std::clamp(x1, 0.0, static_cast<double>(width_));
  y0 = std::clamp(y0, 0.0, static_cast<double>(height_));
  y1 = std::clamp(y1, 0.0, static_cast<double>(height_));
  if (x0 >= x1 || y0 >= y1) {
    return {};
  }
  // Within a pixel the tables are bilinear.
  const int left = std::min(static_cast<int>(x0), width_ - 1);
  const int right = std::min(static_cast<int>(x1), width_ - 1);
  const int top = std::min(static_cast<int>(y0), height_ - 1);
  const int bottom = std::min(static_cast<int>(y1), height_ - 1);
  const double f_left = x0 - left;
  const double f_right = x1 - right;
  const double f_top = y0 - top;
  const double f_bottom = y1 - bottom;
  const std::size_t stride = static_cast<std::size_t>(width_) + 1;
  const auto sum = [&](const Table& table) {
    const auto between = [&](const double* row) {
      const double* a = row + left;
      const double* b = row + right;
      return (b[0] + f_right * (b[1] - b[0])) - (a[0] + f_left * (a[1] - a[0]));
    };
    const double* upper = table.data() + static_cast<std::size_t>(top) * stride;
    const double* lower = table.data() + static_cast<std::size_t>(bottom) * stride;
    const double u0 = between(upper);
    const double l0 = between(lower);
    return (l0 + f_bottom * (between(lower + stride) - l0)) -
           (u0 + f_top * (between(upper + stride) - u0));
  };
  return {sum(visible_), unknown_ ? sum(*unknown_) : 0.0};
}

namespace {

/// The mean with bounds V = 0 and V = 1 in the unknown part; lit beyond the picture.
WindowMean mean_of(double visible, double unknown, double inside, double area) {
  WindowMean mean;
  mean.unknown = std::clamp(unknown / area, 0.0, 1.0);
  mean.outside = std::clamp(1.0 - inside / area, 0.0, 1.0);
  mean.value = std::clamp(visible / area + mean.outside + 0.5 * mean.unknown, 0.0, 1.0);
  return mean;
}

/// Where the quadrilateral's border crosses the line y: its smallest and largest x.
std::array<double, 2> span_at(const std::array<Eigen::Vector2d, 4>& quad, double y) {
  double low = std::numeric_limits<double>::infinity();
  double high = -low;
  for (std::size_t i = 0; i < 4; ++i) {
    const Eigen::Vector2d& p = quad[i];
    const Eigen::Vector2d& q = quad[(i + 1) % 4];
    if ((p.y() <= y) == (q.y() <= y)) {
      continue;
    }
    const double x = p.x() + (q.x() - p.x()) * ((y - p.y()) / (q.y() - p.y()));
    low = std::min(low, x);
    high = std::max(high, x);
  }
  return {low, high};
}

}  // namespace

WindowMean WindowSums::mean(double x0, double x1, double y0, double y1) const {
  const double area = (x1 - x0) * (y1 - y0);
  if (!(area > 0.0)) {
    return mean_around({0.5 * (x0 + x1), 0.5 * (y0 + y1)});
  }
  const Sum sum = integral(x0, x1, y0, y1);
  const auto overlap = [](double low, double high, double size) {
    return std::max(0.0, std::min(high, size) - std::max(low, 0.0));
  };
  const double inside = overlap(x0, x1, width_) * overlap(y0, y1, height_);
  return mean_of(sum.visible, sum.unknown, inside, area);
}

WindowMean WindowSums::mean_around(const Eigen::Vector2d& at) const {
  return mean(at.x() - 0.5, at.x() + 0.5, at.y() - 0.5, at.y() + 0.5);
}

bool WindowSums::is_lit(double x0, double x1, double y0, double y1) const {
  const double left = std::clamp(std::floor(x0), 0.0, static_cast<double>(width_));
  const double right = std::clamp(std::ceil(x1), 0.0, static_cast<double>(width_));
  const double top = std::clamp(std::floor(y0), 0.0, static_cast<double>(height_));
  const double bottom = std::clamp(std::ceil(y1), 0.0, static_cast<double>(height_));
  if (left >= right || top >= bottom) {
    return true;  // beyond the picture: lit
  }
  const auto at = [&](double x, double y) {
    return visible_[static_cast<std::size_t>(y) * (static_cast<std::size_t>(width_) + 1) +
                    static_cast<std::size_t>(x)];
  };
  const double sum = (at(right, bottom) - at(left, bottom)) - (at(right, top) - at(left, top));
  constexpr double kRounding = 1e-6;  // pixels; the tables' own is below 1e-9
  return sum >= (right - left) * (bottom - top) - kRounding;
}

WindowMean WindowSums::mean(const std::array<Eigen::Vector2d, 4>& quad) const {
  // Strip borders: the pixel rows' borders inside the picture and the corners.
  std::array<double, 4> ys{quad[0].y(), quad[1].y(), quad[2].y(), quad[3].y()};
  std::sort(ys.begin(), ys.end());
  double visible = 0.0;
  double unknown = 0.0;
  double inside = 0.0;
  double area = 0.0;
  const auto add_strip = [&](double y0, double y1) {
    if (!(y1 > y0)) {
      return;
    }
    const auto [x0, x1] = span_at(quad, 0.5 * (y0 + y1));
    if (!(x1 > x0)) {
      return;
    }
    const Sum sum = integral(x0, x1, y0, y1);
    visible += sum.visible;
    unknown += sum.unknown;
    area += (x1 - x0) * (y1 - y0);
    const double in_x = std::max(0.0, std::min(x1, double(width_)) - std::max(x0, 0.0));
    const double in_y = std::max(0.0, std::min(y1, double(height_)) - std::max(y0, 0.0));
    inside += in_x * in_y;
  };
  for (std::size_t i = 0; i < 3; ++i) {
    double y = ys[i];
    const double end = ys[i + 1];
    // Outside the picture there is nothing to resolve: one strip.
    const double first = std::clamp(y, 0.0, static_cast<double>(height_));
    const double last = std::clamp(end, 0.0, static_cast<double>(height_));
    add_strip(y, std::min(first, end));
    y = std::max(y, first);
    while (y < last) {
      const double next = std::min(std::floor(y) + 1.0, last);
      add_strip(y, next);
      y = next;
    }
    add_strip(std::max(y, ys[i]), end);
  }
  if (!(area > 0.0)) {
    return mean_around(0.25 * (quad[0] + quad[1] + quad[2] + quad[3]));
  }
  return mean_of(visible, unknown, inside, area);
}

}  // namespace haarlight::relight
