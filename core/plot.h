// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <string>
#include <utility>
#include <vector>

/// @file
/// Figures as SVG: panels side by side with one legend, axes logarithmic or linear. Colours
/// that readers with any colour vision can distinguish [Okabe08], plus a marker per series;
/// readable on paper and on a dark page (the background is drawn).

namespace haarlight {

enum class PlotStyle {
  marked_line,
  line,
  dots,  ///< small, for hundreds of samples
};

struct PlotSeries {
  std::string name;
  /// Left out: values not finite, beyond the panel's range, or not above 0 on a logarithmic
  /// axis.
  std::vector<std::pair<double, double>> points;
  /// Series of one look share colour and marker in every panel, and one line of the legend.
  int look = 0;
  bool is_dashed = false;
  PlotStyle style = PlotStyle::marked_line;
};

enum class PlotScale { logarithmic, linear };

struct PlotRange {
  double low = 0.0;
  double high = 1.0;
};

struct PlotPanel {
  std::string title;
  std::string x_name;
  std::string y_name;
  std::vector<PlotSeries> series;
  PlotScale scale = PlotScale::logarithmic;  ///< of both axes
  std::optional<PlotRange> x_range = {};     ///< nothing: all points, with a margin
  std::optional<PlotRange> y_range = {};
};

/// @param columns  panels in a row
/// A panel without a point says so.
[[nodiscard]] std::string draw_panels(const std::string& title,
                                      const std::vector<PlotPanel>& panels, int columns);

}  // namespace haarlight
