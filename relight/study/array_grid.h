// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace haarlight::relight {

/// Lights in rows x cols grids, faces one after the other; rows = 0: in no grid.
struct ArrayGrid {
  int rows = 0;
  int cols = 0;
  int n_faces = 0;
  [[nodiscard]] bool is_grid() const noexcept { return rows > 0; }
  [[nodiscard]] int n_face() const noexcept { return rows * cols; }
};

}  // namespace haarlight::relight
