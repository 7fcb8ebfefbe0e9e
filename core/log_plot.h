// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <utility>
#include <vector>

/// @file
/// Figures on logarithmic axes as SVG: panels side by side with one legend. Colours that
/// readers with any colour vision can distinguish [Okabe08], plus a marker per series; readable
/// on paper and on a dark page (the background is drawn).

namespace haarlight {

struct PlotSeries {
  std::string name;
  std::vector<std::pair<double, double>> points;  ///< those not above 0 are left out
  /// Series of one look share colour and marker in every panel, and one line of the legend.
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
