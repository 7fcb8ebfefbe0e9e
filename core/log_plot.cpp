// SPDX-License-Identifier: Apache-2.0
#include "core/log_plot.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include <fmt/format.h>

#include "core/error.h"
#include "core/markup.h"

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

/// A range of one axis in decades.
struct Axis {
  double low = std::numeric_limits<double>::infinity();
  double high = -std::numeric_limits<double>::infinity();

  void add(double value) {
    low = std::min(low, std::log10(value));
    high = std::max(high, std::log10(value));
  }
  [[nodiscard]] bool is_empty() const { return !(low <= high); }
  void pad() {
    const double margin = std::max(0.04 * (high - low), 0.06);
    low -= margin;
    high += margin;
  }
  [[nodiscard]] double place(double value) const {
    return (std::log10(value) - low) / (high - low);
  }
  /// 1, 2, 5 of each decade; decades alone where there are many.
  [[nodiscard]] std::vector<double> ticks() const {
    std::vector<double> found;
    const bool has_parts = high - low < 2.5;
    for (int decade = static_cast<int>(std::floor(low)); decade <= high; ++decade) {
      for (const double part : {1.0, 2.0, 5.0}) {
        const double value = part * std::pow(10.0, decade);
        if ((part == 1.0 || has_parts) && std::log10(value) >= low &&
            std::log10(value) <= high) {
          found.push_back(value);
        }
      }
    }
    return found;
  }
};

std::string tick_text(double value) {
  if (value >= 1e6) {
    return fmt::format("{:g} M", value / 1e6);
  }
  if (value >= 1e4) {
    return fmt::format("{:g} k", value / 1e3);
  }
  return value < 1e-4 ? fmt::format("{:.0e}", value) : fmt::format("{:g}", value);
}

bool is_shown(const std::pair<double, double>& point) {
  return point.first > 0.0 && point.second > 0.0 && std::isfinite(point.first) &&
         std::isfinite(point.second);
}

std::string draw_panel(const PlotPanel& panel, double x0, double y0) {
  Axis horizontal;
  Axis vertical;
  for (const PlotSeries& series : panel.series) {
    for (const auto& point : series.points) {
      if (is_shown(point)) {
        horizontal.add(point.first);
        vertical.add(point.second);
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
  if (horizontal.is_empty()) {
    return out + fmt::format(
                     "<text x='{:.1f}' y='{:.1f}' text-anchor='middle'>nothing to "
                     "show</text>",
                     left + 0.5 * width, top + 0.5 * height);
  }
  horizontal.pad();
  vertical.pad();
  const auto px = [&](double x) { return left + horizontal.place(x) * width; };
  const auto py = [&](double y) { return top + (1.0 - vertical.place(y)) * height; };
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
    std::string path;
    std::string marks;
    for (const auto& point : series.points) {
      if (is_shown(point)) {
        path += fmt::format("{}{:.1f} {:.1f}", path.empty() ? "M" : "L", px(point.first),
                            py(point.second));
        marks += mark(series.look, px(point.first), py(point.second));
      }
    }
    if (!path.empty()) {
      out += fmt::format("<path d='{}' fill='none' stroke='{}' stroke-width='1.6'{}/>{}", path,
                         colour(series.look), series.is_dashed ? " stroke-dasharray='5 4'" : "",
                         marks);
    }
  }
  return out;
}

}  // namespace

std::string draw_log_panels(const std::string& title, const std::vector<PlotPanel>& panels,
                            int columns) {
  HAARLIGHT_EXPECTS(columns > 0 && !panels.empty(), "a panel");
  std::vector<PlotSeries> legend;
  for (const PlotPanel& panel : panels) {
    for (const PlotSeries& series : panel.series) {
      if (std::none_of(legend.begin(), legend.end(),
                       [&](const PlotSeries& known) { return known.name == series.name; })) {
        legend.push_back({series.name, {}, series.look, series.is_dashed});
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
    out += fmt::format(
        "<path d='M{:.1f} {:.1f}h30' fill='none' stroke='{}' stroke-width='1.6'{}/>{}"
        "<text x='{:.1f}' y='{:.1f}'>{}</text>\n",
        x, y, colour(legend[i].look), legend[i].is_dashed ? " stroke-dasharray='5 4'" : "",
        mark(legend[i].look, x + 15.0, y), x + 38.0, y + 4.0, escaped(legend[i].name));
  }
  return out + "</svg>\n";
}

}  // namespace haarlight
