// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/shadow/predict.h"

#include <algorithm>

#include "haarlight/core/error.h"

namespace haarlight::relight {

double shadow_spacing(double light_spacing, double h, double H) {
  HAARLIGHT_EXPECTS(h >= 0.0 && h < H, "the edge is between plane and light");
  return light_spacing * h / (H - h);
}

double penumbra_width(double side, double h, double H) { return shadow_spacing(side, h, H); }

double penumbra_width_at(double side, double h, double H, double h_receiver) {
  HAARLIGHT_EXPECTS(h < H, "the edge is below the light");
  return std::max(0.0, side * (h - h_receiver) / (H - h));
}

double gap_ripple(double side, double light_spacing, double strip, double h, double H) {
  HAARLIGHT_EXPECTS(side > 0.0 && side <= light_spacing && strip > 0.0 && h < H, "lengths");
  return (light_spacing - side) / side * light_spacing * h / (strip * H);
}

double hard_sun_error(double window, double sun) {
  HAARLIGHT_EXPECTS(window > 0.0 && sun >= 0.0 && sun <= window,
                    "a sun smaller than the light");
  return (window - sun) * (window - sun) / (12.0 * window);
}

double off_grid_error(double window, double spacing) {
  HAARLIGHT_EXPECTS(window > 0.0 && spacing >= 0.0, "lengths");
  // The squared distance of two distribution functions is E|X - Y| - E|X - X'|/2 - E|Y - Y'|/2.
  // Edges are uniform of width W; the difference of two is triangular: h(d) = E|d + T|.
  const auto h = [window](double d) {
    const double rest = window - d;
    return d >= window ? d : d + rest * rest * rest / (3.0 * window * window);
  };
  return h(0.5 * spacing) - 0.75 * h(0.0) - 0.25 * h(spacing);
}

double largest_pixel(double window) { return 0.5 * window; }

}  // namespace haarlight::relight
