// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/calibrate/board_page.h"

#include <cmath>

#include <fmt/format.h>

#include "core/markup.h"

namespace haarlight::relight {

namespace {

/// A picture's corners as dots, with their residuals as lines a hundred times as long.
std::string misses_svg(const CameraModel& camera, const std::vector<Eigen::Vector2d>& corners,
                       const std::vector<Eigen::Vector2d>& misses) {
  constexpr double kLonger = 100.0;
  std::string out = fmt::format(
      "<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {0} {1}' width='420' role='img'>"
      "<rect width='{0}' height='{1}' fill='#eee'/>",
      camera.width, camera.height);
  const double dot = camera.width / 250.0;
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const Eigen::Vector2d end = corners[i] + kLonger * misses[i];
    out += fmt::format(
        "<circle cx='{0:.2f}' cy='{1:.2f}' r='{4:.2f}' fill='#06c'/><path d='M{0:.2f} {1:.2f} "
        "L{2:.2f} {3:.2f}' stroke='#c00' stroke-width='{5:.2f}'/>",
        corners[i].x(), corners[i].y(), end.x(), end.y(), dot, 0.6 * dot);
  }
  return out + "</svg>";
}

}  // namespace

std::string board_page(const std::string& title, const std::string& summary,
                       const CameraModel& camera, const std::vector<SeenBoard>& seen,
                       const std::vector<std::vector<Eigen::Vector2d>>& misses) {
  std::string body;
  for (std::size_t i = 0; i < seen.size(); ++i) {
    double sum = 0.0;
    for (const Eigen::Vector2d& miss : misses[i]) {
      sum += miss.squaredNorm() / static_cast<double>(misses[i].size());
    }
    body += fmt::format("<figure><figcaption>{}: {:.3f} px rms</figcaption>{}</figure>",
                        escaped(seen[i].picture), std::sqrt(sum),
                        misses_svg(camera, seen[i].corners, misses[i]));
  }
  return fmt::format(
      "<!doctype html><html lang='en'><meta charset='utf-8'><title>{0}</title>"
      "<style>body{{font-family:sans-serif;max-width:60em;margin:2em auto}}"
      "figure{{display:inline-block;margin:0.5em}}</style><h1>{0}</h1><pre>{1}</pre>"
      "<p>Blue: a corner as found. Red: its miss, a hundred times as long. Lines that all "
      "point "
      "one way at one side of the picture: the lens needs another model, or the board is not "
      "flat.</p>{2}</html>\n",
      escaped(title), escaped(summary), body);
}

}  // namespace haarlight::relight
