// SPDX-License-Identifier: Apache-2.0
#include "core/plot.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include <fmt/format.h>

#include "core/markup.h"
#include "haarlight/core/error.h"

namespace haarlight {

namespace {

constexpr double kWidth = 460.0;  // of a panel
constexpr double kHeight = 380.0;
constexpr double kLeft = 66.0;
constexpr double kRight = 14.0;
constexpr double kTop = 34.0;
constexpr double kBottom = 50.0;
constexpr double kTitle = 40.0;
constexpr double kLegendRow = 20.0;
constexpr int kMarks = 5;
constexpr int kMostTicks = 20;  // about five are wanted

constexpr std::array<const char*, 8> kColours = {"#0072b2", "#d55e00", "#009e73", "#cc79a7",
                                                 "#e69f00", "#56b4e9", "#333333", "#8a7a00"};

const char* colour(int look) {
  return kColours[static_cast<std::size_t>(look) % kColours.size()];
}

/// A marker at (x, y); the colours of looks repeat after 8, the markers after 5.
std::string mark(int look, double x, double y) {
  const char* fill = colour(look);
  switch (look % kMarks) {
    case 0:
      return fmt::format("<circle cx='{:.1f}' cy='{:.1f}' r='3.5' fill='{}'/>", x, y, fill);
    case 1:
      return fmt::format("<rect x='{:.1f}' y='{:.1f}' width='6.4' height='6.4' fill='{}'/>",
                         x - 3.2, y - 3.2, fill);
    case 2:
      return fmt::format("<path d='M{:.1f} {:.1f}l4 7h-8z' fill='{}'/>", x, y - 4.2, fill);
    case 3:
      return fmt::format("<path d='M{:.1f} {:.1f}l4.2 4.2l-4.2 4.2l-4.2 -4.2z' fill='{}'/>", x,
                         y - 4.2, fill);
    default:
      return fmt::format(
          "<path d='M{0:.1f} {1:.1f}l6 6m0 -6l-6 6' stroke='{2}' stroke-width='1.8'/>", x - 3.0,
          y - 3.0, fill);
  }
}

/// The range of one axis: decades where it is logarithmic.
class Axis {
 public:
  Axis(PlotScale scale, const std::optional<PlotRange>& range)
      : is_log_(scale == PlotScale::logarithmic), is_given_(range.has_value()) {
    if (range) {
      low_ = on_axis(range->low);
      high_ = on_axis(range->high);
    }
  }

  /// Whether the axis can show a value.
  [[nodiscard]] bool has(double value) const {
    return std::isfinite(value) && (!is_log_ || value > 0.0) &&
           (!is_given_ || (on_axis(value) >= low_ && on_axis(value) <= high_));
  }
  void add(double value) {
    if (!is_given_) {
      low_ = std::min(low_, on_axis(value));
      high_ = std::max(high_, on_axis(value));
    }
  }
  void pad() {
    if (!is_given_) {
      const double margin = std::max(0.04 * (high_ - low_), is_log_ ? 0.06 : 1e-9);
      low_ -= margin;
      high_ += margin;
    }
  }
  [[nodiscard]] double position(double value) const {
    return (on_axis(value) - low_) / (high_ - low_);
  }
  [[nodiscard]] std::vector<double> ticks() const { return is_log_ ? decades() : steps(); }

 private:
  [[nodiscard]] double on_axis(double value) const {
    return is_log_ ? std::log10(value) : value;
  }
  /// 1, 2, 5 of each decade; decades alone where there are many.
  [[nodiscard]] std::vector<double> decades() const {
    std::vector<double> found;
    const bool has_parts = high_ - low_ < 2.5;
    for (int decade = static_cast<int>(std::floor(low_)); decade <= high_; ++decade) {
      for (const double part : {1.0, 2.0, 5.0}) {
        const double value = part * std::pow(10.0, decade);
        if ((part == 1.0 || has_parts) && std::log10(value) >= low_ &&
            std::log10(value) <= high_) {
          found.push_back(value);
        }
      }
    }
    return found;
  }
  /// About five round numbers.
  [[nodiscard]] std::vector<double> steps() const {
    const double decade = std::pow(10.0, std::floor(std::log10((high_ - low_) / 5.0)));
    const double parts = (high_ - low_) / 5.0 / decade;
    const double step = decade * (parts > 5.0   ? 10.0
                                  : parts > 2.0 ? 5.0
                                  : parts > 1.0 ? 2.0
                                                : 1.0);
    std::vector<double> found;
    const double first = std::ceil(low_ / step);
    const double end = std::floor(high_ / step);
    for (int i = 0; i < kMostTicks && first + i <= end; ++i) {
      found.push_back(first + i == 0.0 ? 0.0 : (first + i) * step);
    }
    return found;
  }

  bool is_log_;
  bool is_given_;
  double low_ = std::numeric_limits<double>::infinity();
  double high_ = -std::numeric_limits<double>::infinity();
};

std::string tick_text(double value) {
  if (value >= 1e6) {
    return fmt::format("{:g} M", value / 1e6);
  }
  if (value >= 1e4) {
    return fmt::format("{:g} k", value / 1e3);
  }
  return value > 0.0 && value < 1e-4 ? fmt::format("{:.0e}", value)
                                     : fmt::format("{:g}", value);
}

std::string draw_series(const PlotSeries& series,
                        const std::vector<std::pair<double, double>>& points) {
  std::string path;
  std::string marks;
  for (const auto& [x, y] : points) {
    path += fmt::format("{}{:.1f} {:.1f}", path.empty() ? "M" : "L", x, y);
    if (series.style == PlotStyle::marked_line) {
      marks += mark(series.look, x, y);
    } else if (series.style == PlotStyle::dots) {
      marks += fmt::format("<circle cx='{:.1f}' cy='{:.1f}' r='1.7' fill='{}'/>", x, y,
                           colour(series.look));
    }
  }
  if (path.empty() || series.style == PlotStyle::dots) {
    return marks;
  }
  return fmt::format("<path d='{}' fill='none' stroke='{}' stroke-width='1.6'{}/>{}", path,
                     colour(series.look), series.is_dashed ? " stroke-dasharray='5 4'" : "",
                     marks);
}

std::string draw_panel(const PlotPanel& panel, double x0, double y0) {
  Axis horizontal(panel.scale, panel.x_range);
  Axis vertical(panel.scale, panel.y_range);
  const auto is_shown = [&](const std::pair<double, double>& point) {
    return horizontal.has(point.first) && vertical.has(point.second);
  };
  bool is_empty = true;
  for (const PlotSeries& series : panel.series) {
    for (const auto& point : series.points) {
      if (is_shown(point)) {
        horizontal.add(point.first);
        vertical.add(point.second);
        is_empty = false;
      }
    }
  }
  const double left = x0 + kLeft;
  const double top = y0 + kTop;
  const double width = kWidth - kLeft - kRight;
  const double height = kHeight - kTop - kBottom;
  std::string out = fmt::format(
      "<text x='{:.1f}' y='{:.1f}' font-weight='600'>{}</text>"
      "<rect x='{:.1f}' y='{:.1f}' width='{:.1f}' height='{:.1f}' fill='none' stroke='#888'/>",
      left, y0 + 22.0, escaped(panel.title), left, top, width, height);
  if (is_empty) {
    return out + fmt::format(
                     "<text x='{:.1f}' y='{:.1f}' text-anchor='middle'>nothing to "
                     "show</text>",
                     left + 0.5 * width, top + 0.5 * height);
  }
  horizontal.pad();
  vertical.pad();
  const auto px = [&](double x) { return left + horizontal.position(x) * width; };
  const auto py = [&](double y) { return top + (1.0 - vertical.position(y)) * height; };
  for (const double tick : horizontal.ticks()) {
    out += fmt::format(
        "<path d='M{0:.1f} {1:.1f}V{2:.1f}' stroke='#ddd'/>"
        "<text x='{0:.1f}' y='{3:.1f}' text-anchor='middle'>{4}</text>",
        px(tick), top, top + height, top + height + 16.0, tick_text(tick));
  }
  for (const double tick : vertical.ticks()) {
    out += fmt::format(
        "<path d='M{0:.1f} {1:.1f}H{2:.1f}' stroke='#ddd'/>"
        "<text x='{3:.1f}' y='{4:.1f}' text-anchor='end'>{5}</text>",
        left, py(tick), left + width, left - 6.0, py(tick) + 4.0, tick_text(tick));
  }
  out += fmt::format(
      "<text x='{:.1f}' y='{:.1f}' text-anchor='middle'>{}</text>"
      "<text x='{:.1f}' y='{:.1f}' text-anchor='middle' transform='rotate(-90 {:.1f} "
      "{:.1f})'>{}</text>",
      left + 0.5 * width, top + height + 36.0, escaped(panel.x_name), x0 + 16.0,
      top + 0.5 * height, x0 + 16.0, top + 0.5 * height, escaped(panel.y_name));
  for (const PlotSeries& series : panel.series) {
    std::vector<std::pair<double, double>> points;
    for (const auto& point : series.points) {
      if (is_shown(point)) {
        points.emplace_back(px(point.first), py(point.second));
      }
    }
    out += draw_series(series, points);
  }
  return out;
}

}  // namespace

std::string draw_panels(const std::string& title, const std::vector<PlotPanel>& panels,
                        int columns) {
  HAARLIGHT_EXPECTS(columns > 0 && !panels.empty(), "a panel");
  std::vector<PlotSeries> legend;
  for (const PlotPanel& panel : panels) {
    for (const PlotSeries& series : panel.series) {
      if (std::none_of(legend.begin(), legend.end(),
                       [&](const PlotSeries& known) { return known.name == series.name; })) {
        legend.push_back({series.name, {}, series.look, series.is_dashed, series.style});
      }
    }
  }
  const int used = std::min(columns, static_cast<int>(panels.size()));
  const int rows = (static_cast<int>(panels.size()) + columns - 1) / columns;
  const double width = used * kWidth;
  constexpr double kEntry = 290.0;
  const int in_row = std::max(1, static_cast<int>((width - 20.0) / kEntry));
  const int legend_rows = (static_cast<int>(legend.size()) + in_row - 1) / in_row;
  const double height = kTitle + rows * kHeight + legend_rows * kLegendRow + 16.0;
  std::string out = fmt::format(
      "<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {0:.0f} {1:.0f}' width='{0:.0f}' "
      "height='{1:.0f}' role='img' font-family='sans-serif' font-size='12' fill='#222' "
      "aria-label='{2}'><rect width='{0:.0f}' height='{1:.0f}' fill='#fff'/>"
      "<text x='20' y='26' font-size='16' font-weight='600'>{2}</text>\n",
      width, height, escaped(title));
  for (std::size_t i = 0; i < panels.size(); ++i) {
    const std::size_t column = i % static_cast<std::size_t>(columns);
    const std::size_t row = i / static_cast<std::size_t>(columns);
    out +=
        draw_panel(panels[i], double(column) * kWidth, kTitle + double(row) * kHeight) + "\n";
  }
  for (std::size_t i = 0; i < legend.size(); ++i) {
    const std::size_t column = i % static_cast<std::size_t>(in_row);
    const std::size_t row = i / static_cast<std::size_t>(in_row);
    const double x = 20.0 + double(column) * kEntry;
    const double y = kTitle + rows * kHeight + 10.0 + double(row) * kLegendRow;
    PlotSeries line = legend[i];
    line.style = line.style == PlotStyle::dots ? PlotStyle::dots : PlotStyle::line;
    out += draw_series(line, {{x, y}, {x + 15.0, y}, {x + 30.0, y}});
    if (legend[i].style == PlotStyle::marked_line) {
      out += mark(legend[i].look, x + 15.0, y);
    }
    out += fmt::format("<text x='{:.1f}' y='{:.1f}'>{}</text>\n", x + 38.0, y + 4.0,
                       escaped(legend[i].name));
  }
  return out + "</svg>\n";
}

}  // namespace haarlight
