// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <span>

#include "core/count.h"
#include "haarlight/core/error.h"

namespace haarlight {

/// out[i, j] = rows[i, columns[j]]: of rows of values by light, some lights'.
/// @param rows     (n, n_columns)
/// @param columns  0 to n_columns - 1, in any order
/// @param out      (n, columns.size())
inline void pick_columns(std::span<const float> rows, std::size_t n_columns,
                         std::span<const int> columns, std::span<float> out) {
  HAARLIGHT_EXPECTS(rows.size() * columns.size() == out.size() * n_columns,
                    "as many rows out as in");
  float* to = out.data();
  for (std::size_t row = 0; row + n_columns <= rows.size(); row += n_columns) {
    for (const int column : columns) {
      *to++ = rows[row + count(column)];
    }
  }
}

}  // namespace haarlight
