// SPDX-License-Identifier: Apache-2.0
#include "relight/study/array_binning.h"

#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

/// Calls work(first light of the bin) for every bin of every face.
template <class Work>
void for_bins(const ArrayGrid& grid, int side, Work work) {
  for (int face = 0; face < grid.n_faces; ++face) {
    for (int y = 0; y < grid.rows; y += side) {
      for (int x = 0; x < grid.cols; x += side) {
        work(face * grid.n_face() + y * grid.cols + x);
      }
    }
  }
}

}  // namespace

std::vector<BinChoice> bin_choices(const ArrayGrid& grid) {
  std::vector<BinChoice> choices;
  for (const int side : {2, 4}) {
    if (!grid.is_grid() || grid.rows % side != 0 || grid.cols % side != 0 ||
        grid.rows / side < 2 || grid.cols / side < 2) {
      continue;
    }
    choices.push_back({side, true, 0, 0});
    for (const int row : {side / 2 - 1, side / 2}) {
      for (const int col : {side / 2 - 1, side / 2}) {
        choices.push_back({side, false, row, col});
      }
    }
  }
  return choices;
}

Eigen::VectorXd binned_weights(const Eigen::VectorXd& weights, const ArrayGrid& grid,
                               const BinChoice& choice) {
  HAARLIGHT_EXPECTS(weights.size() == Eigen::Index{grid.n_face()} * grid.n_faces,
                    "one weight per light");
  Eigen::VectorXd binned = Eigen::VectorXd::Zero(weights.size());
  for_bins(grid, choice.side, [&](int first) {
    double sum = 0.0;
    for (int y = 0; y < choice.side; ++y) {
      for (int x = 0; x < choice.side; ++x) {
        sum += weights[first + y * grid.cols + x];
      }
    }
    if (!choice.is_area) {
      binned[first + choice.row * grid.cols + choice.col] = sum;
      return;
    }
    for (int y = 0; y < choice.side; ++y) {
      for (int x = 0; x < choice.side; ++x) {
        binned[first + y * grid.cols + x] = sum / (choice.side * choice.side);
      }
    }
  });
  return binned;
}

double binned_energy(std::span<const float> lights, const ArrayGrid& grid,
                     const BinChoice& choice) {
  HAARLIGHT_EXPECTS(lights.size() == static_cast<std::size_t>(grid.n_face() * grid.n_faces),
                    "one value per light");
  double energy = 0.0;
  for_bins(grid, choice.side, [&](int first) {
    const auto at = [&](int y, int x) {
      const int light = first + y * grid.cols + x;
      return double{lights[static_cast<std::size_t>(light)]};
    };
    double stand_in = 0.0;
    if (choice.is_area) {
      for (int y = 0; y < choice.side; ++y) {
        for (int x = 0; x < choice.side; ++x) {
          stand_in += at(y, x) / (choice.side * choice.side);
        }
      }
    } else {
      stand_in = at(choice.row, choice.col);
    }
    for (int y = 0; y < choice.side; ++y) {
      for (int x = 0; x < choice.side; ++x) {
        const double off = at(y, x) - stand_in;
        energy += off * off;
      }
    }
  });
  return energy;
}

}  // namespace haarlight::relight
