// SPDX-License-Identifier: Apache-2.0
#include "relight/study/error_tally.h"

#include <cmath>
#include <limits>

#include "core/parallel.h"
#include "haarlight/core/error.h"

namespace haarlight::relight {

void ErrorTally::add(Region region, double stack, std::span<const double> pictures,
                     double factor) {
  HAARLIGHT_ASSERT(pictures.size() == pictures_.size());
  const auto r = static_cast<std::size_t>(region);
  stack_[0] += factor * stack;
  if (r != 0) {
    stack_[r] += factor * stack;
  }
  for (std::size_t i = 0; i < pictures.size(); ++i) {
    const double square = factor * pictures[i] * pictures[i];
    pictures_[i][0] += square;
    if (r != 0) {
      pictures_[i][r] += square;
    }
  }
}

RowSums sum_rows(std::span<const float> rows, const Eigen::MatrixXd& weights) {
  constexpr std::size_t kPiece = 128;
  const auto n_lights = static_cast<std::size_t>(weights.rows());
  HAARLIGHT_EXPECTS(n_lights > 0 && rows.size() % n_lights == 0, "whole pixels");
  const std::size_t n = rows.size() / n_lights;
  RowSums sums;
  sums.energy.resize(n);
  sums.pictures.resize(static_cast<Eigen::Index>(n), weights.cols());
  parallel_for(n, kPiece, [&](std::size_t begin, std::size_t end) {
    using RowsOfFloat = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
    for (std::size_t at = begin; at < end; at += kPiece) {
      const std::size_t some = std::min(kPiece, end - at);
      const auto first = static_cast<Eigen::Index>(at);
      const auto height = static_cast<Eigen::Index>(some);
      const Eigen::Map<const RowsOfFloat> part(rows.data() + at * n_lights, height,
                                               weights.rows());
      const Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> wide =
          part.cast<double>();
      sums.pictures.middleRows(first, height).noalias() = wide * weights;
      for (std::size_t i = 0; i < some; ++i) {
        sums.energy[at + i] = wide.row(static_cast<Eigen::Index>(i)).squaredNorm();
      }
    }
  });
  return sums;
}

ByRegion relative_errors(const ByRegion& error, const ByRegion& truth) {
  ByRegion relative{};
  for (std::size_t i = 0; i < relative.size(); ++i) {
    relative[i] = truth[i] > 0.0 ? std::sqrt(error[i] / truth[i])
                                 : std::numeric_limits<double>::quiet_NaN();
  }
  return relative;
}

}  // namespace haarlight::relight
