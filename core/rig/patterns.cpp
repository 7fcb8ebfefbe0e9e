// SPDX-License-Identifier: Apache-2.0
#include "haarlight/core/rig/patterns.h"

#include <algorithm>
#include <bit>
#include <cstdint>
#include <limits>

#include "haarlight/core/error.h"

namespace haarlight {

namespace {

bool is_power_of_two(int n) { return n >= 1 && std::has_single_bit(static_cast<unsigned>(n)); }

bool is_prime(int n) {
  for (std::int64_t divisor = 2; divisor * divisor <= n; ++divisor) {
    if (n % divisor == 0) {
      return false;
    }
  }
  return n >= 2;
}

/// Which lights the first row of a quadratic-residue S-matrix lights: 0 and the residues.
std::vector<bool> residue_row(int order) {
  std::vector<bool> is_lit(static_cast<std::size_t>(order), false);
  for (std::int64_t i = 0; i < order; ++i) {
    is_lit[static_cast<std::size_t>(i * i % order)] = true;
  }
  return is_lit;
}

void append_bins(const FaceGrid& face, int bin, int offset,
                 std::vector<std::vector<int>>& shots) {
  for (int row0 = 0; row0 < face.rows; row0 += bin) {
    for (int col0 = 0; col0 < face.cols; col0 += bin) {
      std::vector<int> lit;
      for (int row = row0; row < row0 + bin; ++row) {
        for (int col = col0; col < col0 + bin; ++col) {
          lit.push_back(offset + row * face.cols + col);
        }
      }
      shots.push_back(std::move(lit));
    }
  }
}

void append_s_block(const SBlock& block, int offset, std::vector<std::vector<int>>& shots) {
  if (block.order == 1) {
    shots.push_back({offset + block.first_light});
    return;
  }
  const bool is_fast = is_sylvester(block.order);
  const std::vector<bool> row = is_fast ? std::vector<bool>() : residue_row(block.order);
  for (int shot = 0; shot < block.order; ++shot) {
    std::vector<int> lit;
    for (int light = 0; light < block.n_lights; ++light) {
      const bool is_lit = is_fast ? s_entry(block.order, shot, light)
                                  : row[static_cast<std::size_t>((shot + light) % block.order)];
      if (is_lit) {
        lit.push_back(offset + block.first_light + light);
      }
    }
    shots.push_back(std::move(lit));
  }
}

void append_wavelet(const FaceGrid& face, int index, int offset,
                    std::vector<std::vector<int>>& shots) {
  const Wavelet wavelet = wavelet_at(face.rows, index);
  std::vector<int> positive;
  std::vector<int> negative;
  for (int row = wavelet.row0; row < wavelet.row0 + wavelet.size; ++row) {
    for (int col = wavelet.col0; col < wavelet.col0 + wavelet.size; ++col) {
      (wavelet.sign(row, col) > 0 ? positive : negative)
          .push_back(offset + row * face.cols + col);
    }
  }
  shots.push_back(std::move(positive));
  if (!negative.empty()) {
    shots.push_back(std::move(negative));
  }
}

bool wavelets_fit(const PatternParameters& parameters) {
  const int n2 = parameters.faces.front().n_lights();
  std::vector<int> sorted = parameters.wavelets;
  std::sort(sorted.begin(), sorted.end());
  if (std::adjacent_find(sorted.begin(), sorted.end()) != sorted.end() || sorted.empty() ||
      sorted.front() < 0 || sorted.back() >= parameters.n_lights()) {
    return false;
  }
  for (std::size_t face = 0; face < parameters.faces.size(); ++face) {
    if (!std::binary_search(sorted.begin(), sorted.end(), static_cast<int>(face) * n2)) {
      return false;
    }
  }
  return std::all_of(parameters.faces.begin(), parameters.faces.end(),
                     [&](const FaceGrid& face) {
                       return face == parameters.faces.front() && face.rows == face.cols &&
                              is_power_of_two(face.rows);
                     });
}

}  // namespace

int PatternParameters::n_lights() const {
  std::int64_t n = 0;
  for (const FaceGrid& face : faces) {
    n += std::int64_t{face.rows} * face.cols;
  }
  return static_cast<int>(std::min<std::int64_t>(n, std::numeric_limits<int>::max()));
}

bool fits(const PatternParameters& parameters) {
  const bool has_faces =
      !parameters.faces.empty() &&
      std::all_of(parameters.faces.begin(), parameters.faces.end(),
                  [](const FaceGrid& f) { return f.rows >= 1 && f.cols >= 1; });
  switch (parameters.family) {
    case PatternFamily::list:
    case PatternFamily::target:
      return false;
    case PatternFamily::one_at_a_time:
    case PatternFamily::s_matrix:
      return has_faces;
    case PatternFamily::bins:
      return has_faces && parameters.bin >= 1 &&
             std::all_of(parameters.faces.begin(), parameters.faces.end(),
                         [&](const FaceGrid& f) {
                           return f.rows % parameters.bin == 0 && f.cols % parameters.bin == 0;
                         });
    case PatternFamily::haar:
      return has_faces && wavelets_fit(parameters);
  }
  return false;
}

std::vector<std::vector<int>> lit_lights(const PatternParameters& parameters) {
  HAARLIGHT_EXPECTS(fits(parameters), "a grid that the family of patterns fits");
  std::vector<std::vector<int>> shots;
  if (parameters.family == PatternFamily::haar) {
    const int n2 = parameters.faces.front().n_lights();
    for (const int index : parameters.wavelets) {
      append_wavelet(parameters.faces.front(), index % n2, index / n2 * n2, shots);
    }
    return shots;
  }
  int offset = 0;
  for (const FaceGrid& face : parameters.faces) {
    if (parameters.family == PatternFamily::bins) {
      append_bins(face, parameters.bin, offset, shots);
    } else if (parameters.family == PatternFamily::s_matrix) {
      for (const SBlock& block : s_blocks(face.n_lights())) {
        append_s_block(block, offset, shots);
      }
    } else {
      for (int k = 0; k < face.n_lights(); ++k) {
        shots.push_back({offset + k});
      }
    }
    offset += face.n_lights();
  }
  return shots;
}

bool is_sylvester(int order) { return order >= 3 && is_power_of_two(order + 1); }

bool has_s_matrix(int order) {
  return is_sylvester(order) || (order >= 3 && order % 4 == 3 && is_prime(order));
}

bool s_entry(int order, int shot, int light) {
  HAARLIGHT_ASSERT(shot >= 0 && shot < order && light >= 0 && light < order);
  if (is_sylvester(order)) {
    return std::popcount(static_cast<unsigned>(shot + 1) & static_cast<unsigned>(light + 1)) %
               2 ==
           1;
  }
  return residue_row(order)[static_cast<std::size_t>((shot + light) % order)];
}

std::vector<SBlock> s_blocks(int n_lights) {
  HAARLIGHT_EXPECTS(n_lights >= 1, "at least one light");
  if (n_lights < 3) {
    std::vector<SBlock> singles;
    singles.reserve(static_cast<std::size_t>(n_lights));
    for (int k = 0; k < n_lights; ++k) {
      singles.push_back({k, 1, 1});
    }
    return singles;
  }
  if (is_power_of_two(n_lights)) {
    return {{0, n_lights - 1, n_lights - 1}, {n_lights - 1, 1, 1}};
  }
  int order = n_lights;
  while (!has_s_matrix(order)) {
    ++order;
  }
  return {{0, n_lights, order}};
}

int Wavelet::sign(int row, int col) const {
  if (row < row0 || row >= row0 + size || col < col0 || col >= col0 + size) {
    return 0;
  }
  const bool is_flipped_x = is_x && col >= col0 + size / 2;
  const bool is_flipped_y = is_y && row >= row0 + size / 2;
  return is_flipped_x == is_flipped_y ? 1 : -1;
}

// The coefficient array of the nonstandard transform: the mean at (0, 0); the details of the
// h x h grid of squares of side n/h fill the rest of the leading 2h x 2h corner.
Wavelet wavelet_at(int n, int index) {
  HAARLIGHT_EXPECTS(is_power_of_two(n) && index >= 0 && index < n * n,
                    "a coefficient of a grid of a power of two");
  const int row = index / n;
  const int col = index % n;
  const int largest = std::max(row, col);
  if (largest == 0) {
    return {0, 0, n, false, false};
  }
  const int h = static_cast<int>(std::bit_floor(static_cast<unsigned>(largest)));
  const int size = n / h;
  return {row % h * size, col % h * size, size, col >= h, row >= h};
}

}  // namespace haarlight
