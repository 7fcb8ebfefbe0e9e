// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <utility>
#include <vector>

/// @file
/// Figures on logarithmic axes as SVG: panels side by side with one legend. Colours that people
/// with any colour vision tell apart [Okabe08], a mark of its own for each series beside the
/// colour, readable on paper and on a dark page (the ground is drawn).

namespace haarlight {

struct PlotSeries {
  std::string name;
  std::vector<std::pair<double, double>> points;  ///< those not above 0 are left out
  /// Series of one look share colour and mark in every panel, and a line of the legend.
  int look = 0;
  bool is_dashed = false;
};

struct PlotPanel {
  std::string title;
  std::string x_name;
  std::string y_name;
  std::vector<PlotSeries> series;
};

/// @param columns  panels in a row
/// A panel without a point says so.
[[nodiscard]] std::string draw_log_panels(const std::string& title,
                                          const std::vector<PlotPanel>& panels, int columns);

}  // namespace haarlight
