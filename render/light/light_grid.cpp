// SPDX-License-Identifier: Apache-2.0
#include "haarlight/render/light/light_grid.h"

#include <cstddef>

namespace haarlight::render {

namespace {

using Eigen::Vector3d;

bool almost_equal(const Vector3d& a, const Vector3d& b, double scale) {
  return (a - b).norm() <= 1e-9 * scale;
}

bool same_form(const SquareLight& a, const SquareLight& b) {
  return a.u == b.u && a.v == b.v && a.emits == b.emits && a.width_mm == b.width_mm &&
         a.height_mm == b.height_mm;
}

}  // namespace

std::vector<LightGrid> find_light_grids(std::span<const SquareLight> lights) {
  std::vector<LightGrid> grids;
  std::size_t i = 0;
  while (i < lights.size()) {
    LightGrid grid;
    grid.first = static_cast<int>(i);
    const double scale = lights[i].centre.norm() + lights[i].width_mm + lights[i].height_mm;
    // Columns: equal steps along u, no shorter than the light.
    if (i + 1 < lights.size() && same_form(lights[i], lights[i + 1])) {
      const Vector3d step = lights[i + 1].centre - lights[i].centre;
      const double along = step.dot(lights[i].u);
      if (along >= lights[i].width_mm && almost_equal(step, along * lights[i].u, scale)) {
        grid.step_u = step;
        std::size_t end = i + 1;
        while (end < lights.size() && same_form(lights[i], lights[end]) &&
               almost_equal(lights[end].centre,
                            lights[i].centre + static_cast<double>(end - i) * step, scale)) {
          ++end;
        }
        grid.cols = static_cast<int>(end - i);
      }
    }
    const auto cols = static_cast<std::size_t>(grid.cols);
    const auto row_fits = [&](std::size_t row) {
      if (i + (row + 1) * cols > lights.size()) {
        return false;
      }
      for (std::size_t c = 0; c < cols; ++c) {
        const SquareLight& light = lights[i + row * cols + c];
        const Vector3d wanted = lights[i + c].centre + static_cast<double>(row) * grid.step_v;
        if (!same_form(lights[i], light) || !almost_equal(light.centre, wanted, scale)) {
          return false;
        }
      }
      return true;
    };
    if (grid.cols > 1 && i + cols < lights.size()) {
      const Vector3d step = lights[i + cols].centre - lights[i].centre;
      const double along = step.dot(lights[i].v);
      if (along >= lights[i].height_mm && almost_equal(step, along * lights[i].v, scale)) {
        grid.step_v = step;
        std::size_t rows = 1;
        while (row_fits(rows)) {
          ++rows;
        }
        grid.rows = static_cast<int>(rows);
      }
    }
    i += cols * static_cast<std::size_t>(grid.rows);
    grids.push_back(grid);
  }
  return grids;
}

}  // namespace haarlight::render
