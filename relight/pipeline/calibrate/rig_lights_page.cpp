// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/calibrate/rig_lights_page.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>

#include "core/markup.h"

namespace haarlight::relight {

namespace {

/// A grid of numbers as coloured squares, from `low` (blue) over white to `high` (red).
std::string map_svg(const std::vector<double>& values, int rows, int cols, double low,
                    double high) {
  constexpr int kSide = 12;
  std::string out = fmt::format(
      "<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {} {}' width='{}' role='img'>",
      cols * kSide, rows * kSide, std::min(cols * kSide, 560));
  for (int y = 0; y < rows; ++y) {
    for (int x = 0; x < cols; ++x) {
      const double value = values[static_cast<std::size_t>(y) * static_cast<std::size_t>(cols) +
                                  static_cast<std::size_t>(x)];
      std::string colour = "#888";
      if (std::isfinite(value)) {
        const double t = std::clamp((value - low) / std::max(high - low, 1e-300), 0.0, 1.0);
        const int fade = static_cast<int>(255.0 * (1.0 - std::abs(2.0 * t - 1.0)));
        colour = t < 0.5 ? fmt::format("#{0:02x}{0:02x}ff", fade)
                         : fmt::format("#ff{0:02x}{0:02x}", fade);
      }
      out += fmt::format(
          "<rect x='{}' y='{}' width='{}' height='{}' fill='{}'><title>{},{}: {:.4g}</title>"
          "</rect>",
          x * kSide, y * kSide, kSide, kSide, colour, y, x, value);
    }
  }
  return out + "</svg>";
}

std::string mapped(std::string_view title, const std::vector<double>& values, int rows,
                   int cols) {
  double low = std::numeric_limits<double>::max();
  double high = std::numeric_limits<double>::lowest();
  for (const double value : values) {
    if (std::isfinite(value)) {
      low = std::min(low, value);
      high = std::max(high, value);
    }
  }
  return fmt::format("<figure><figcaption>{} (blue {:.4g}, red {:.4g})</figcaption>{}</figure>",
                     escaped(title), low, high, map_svg(values, rows, cols, low, high));
}

/// One face: a table and maps.
std::string face_section(const Face& face, const FaceCalibration& found,
                         const SheetSamples& sheet) {
  const MeasuredFace m = measured_face(face, found);
  std::string body = fmt::format("<h2>Face {}</h2><table>", escaped(face.id));
  const auto row = [&body](std::string_view name, const std::string& value) {
    body += fmt::format("<tr><th>{}</th><td>{}</td></tr>", name, value);
  };
  const bool is_known = !found.lights.is_model_wrong();
  row("middle, mm",
      fmt::format("{:.3f} {:.3f} {:.3f}", m.centre.x(), m.centre.y(), m.centre.z()) +
          (is_known ? fmt::format(" &plusmn; {:.3f} {:.3f} {:.3f}", m.centre_sigma.x(),
                                  m.centre_sigma.y(), m.centre_sigma.z())
                    : std::string(": the model is wrong, the error is not known")));
  row("test of the model", test_text(found.lights.test));
  row("moved from the rig file's position",
      fmt::format("{:.3f} mm, turned {:.3f} degrees", found.moved_mm, found.turned_deg));
  if (is_known) {
    row("turn known to, degrees", fmt::format("{:.4f} {:.4f} {:.4f}", m.turn_sigma_deg.x(),
                                              m.turn_sigma_deg.y(), m.turn_sigma_deg.z()));
    row("sheet and lens", escaped(sheet_text(found.lights)));
  }
  row("lobe exponent",
      fmt::format("{:.4f}", found.lights.mu) +
          (is_known ? fmt::format(" &plusmn; {:.4f}", found.lights.mu_sigma) : std::string()));
  row("fit", fmt::format("chi&sup2; {:.3f} a degree of freedom (1: noise alone)",
                         found.lights.reduced_chi2));
  std::vector<double> used;
  std::int64_t saturated = 0;
  std::int64_t dark = 0;
  std::int64_t shadowed = 0;
  std::int64_t outlying = 0;
  for (const CalibratedLight& light : found.lights.lights) {
    used.push_back(static_cast<double>(light.counts.used));
    saturated += light.counts.saturated;
    dark += light.counts.dark;
    shadowed += light.counts.shadowed;
    outlying += light.counts.outlying;
  }
  row("left out", fmt::format("{} saturated, {} dark, {} shadowed, {} outlying samples",
                              saturated, dark, shadowed, outlying));
  body += "</table>";
  std::vector<double> power = m.power;
  for (double& p : power) {
    p = p > 0.0 ? p : std::numeric_limits<double>::quiet_NaN();
  }
  body += mapped("Power of each light", power, face.rows, face.cols);
  body += mapped("Samples used of each light", used, face.rows, face.cols);
  std::vector<double> albedo(
      found.lights.albedo.begin(),
      found.lights.albedo.begin() + static_cast<std::ptrdiff_t>(sheet.samples.n_points()));
  for (double& a : albedo) {
    a = a > 0.0 ? a : std::numeric_limits<double>::quiet_NaN();
  }
  body += mapped("What remains of the sheet: its albedo times the camera's vignetting", albedo,
                 sheet.samples.rows, sheet.samples.cols);
  return body;
}

}  // namespace

std::string rig_lights_page(const Rig& rig, const RigFaces& fit, const std::string& date,
                            const std::string& session) {
  std::string body;
  for (const FaceCalibration& found : fit.faces) {
    body += face_section(rig.faces[static_cast<std::size_t>(found.face)], found, fit.sheet);
  }
  return fmt::format(
      "<!doctype html><html lang='en'><meta charset='utf-8'><title>Lights of {0}</title>"
      "<style>body{{font-family:sans-serif;max-width:60em;margin:2em auto}}"
      "th{{text-align:left;padding-right:1em}}figure{{margin:1em 0}}</style>"
      "<h1>Lights of {0}, calibrated</h1><p>{1}, from {2}; {3} x {4} blocks of {5} x {5} "
      "pixels, noise {6:.2f} % a block.</p>{7}</html>\n",
      escaped(rig.name), escaped(date), escaped(session), fit.sheet.samples.cols,
      fit.sheet.samples.rows, fit.sheet.block, 100.0 * fit.sheet.relative_noise, body);
}

}  // namespace haarlight::relight
