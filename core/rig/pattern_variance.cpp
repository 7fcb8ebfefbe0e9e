// SPDX-License-Identifier: Apache-2.0
/// @file
/// How the noise of the shots propagates to the lights computed from them. Every family's sum_j
/// A_kj^2 v_j has a closed form that costs no more than apply() itself.

#include <algorithm>

#include "core/count.h"
#include "core/rig/pattern_inverse.h"
#include "core/wavelet_synthesis.h"
#include "haarlight/core/error.h"

namespace haarlight {

namespace {

/// Wavelets of independent coefficients, variances for values: every +-1/2 becomes 1/4.
void spread_wavelets(int n, std::span<double> x, std::size_t width) {
  synthesise_wavelets(n, x, width,
                      [](double mean, double dx, double dy, double dxy, double& top_left,
                         double& top_right, double& low_left, double& low_right) {
                        top_left = 0.25 * (mean + dx + dy + dxy);
                        top_right = low_left = low_right = top_left;
                      });
}

}  // namespace

void PatternInverse::apply_variance(std::span<const double> shots,
                                    std::span<const double> plate, std::size_t width,
                                    std::span<double> lights) const {
  HAARLIGHT_EXPECTS(shots.size() == shots_.size() * width &&
                        lights.size() == count(n_lights_) * width &&
                        (plate.empty() || plate.size() == lights.size()),
                    "(shots, width) to (lights, width)");
  switch (parameters_.family) {
    case PatternFamily::one_at_a_time:
      std::transform(shots.begin(), shots.end(), lights.begin(),
                     [this](double v) { return v / (drive_ * drive_); });
      return;
    case PatternFamily::s_matrix:
      s_matrix_variance(shots, width, lights);
      return;
    case PatternFamily::haar:
      haar_variance(shots, plate, width, lights);
      return;
    case PatternFamily::bins: {
      // One shot per light: its fraction of a unit, squared.
      const std::vector<double> ones(shots.size(), 1.0);
      apply_bins(ones, plate, width, lights);
      for (std::size_t j = 0; j < shots_.size(); ++j) {
        for (const LightDriveLevel& light : shots_[j]) {
          double* out = lights.data() + count(light.light) * width;
          for (std::size_t i = 0; i < width; ++i) {
            out[i] *= out[i] * shots[j * width + i];
          }
        }
      }
      return;
    }
    case PatternFamily::target:
      target_variance(shots, plate, width, lights);
      return;
    case PatternFamily::list: {
      using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
      const auto columns = static_cast<Eigen::Index>(width);
      const Eigen::Map<const RowMajor> v(shots.data(), n_shots(), columns);
      Eigen::Map<RowMajor>(lights.data(), n_lights_, columns).noalias() =
          inverse_.cwiseAbs2() * v;
      return;
    }
  }
}

// All entries of S^-1 are +-2/(order + 1) [Sloane79]: every light of a block has the same
// noise.
void PatternInverse::s_matrix_variance(std::span<const double> shots, std::size_t width,
                                       std::span<double> lights) const {
  std::size_t shot = 0;
  std::size_t light = 0;
  std::vector<double> sum(width);
  for (const FaceGrid& face : parameters_.faces) {
    for (const SBlock& block : s_blocks(face.n_lights())) {
      const double entry = block.order > 1 ? 2.0 / (block.order + 1) : 1.0;
      const double scale = entry * entry / (drive_ * drive_);
      std::fill(sum.begin(), sum.end(), 0.0);
      for (const std::size_t end = shot + count(block.order); shot < end; ++shot) {
        for (std::size_t i = 0; i < width; ++i) {
          sum[i] += scale * shots[shot * width + i];
        }
      }
      for (const std::size_t end = light + count(block.n_lights); light < end; ++light) {
        std::copy(sum.begin(), sum.end(),
                  lights.begin() + static_cast<std::ptrdiff_t>(light * width));
      }
    }
  }
}

// Wavelets other than the mean: each from shots of its own, spread by the squares of W. The
// mean's shot also sets the gain of what was not shot: A_k,mean = (1/size + (B_k - sum over
// shot wavelets of W_ki b_i) / sum B) / drive.
void PatternInverse::haar_variance(std::span<const double> shots, std::span<const double> plate,
                                   std::size_t width, std::span<double> lights) const {
  const int n = parameters_.faces.front().rows;
  const auto n2 = count(n) * count(n);
  const bool has_rest = needs_plate_ && !plate.empty();
  std::fill(lights.begin(), lights.end(), 0.0);
  std::vector<double> rest(has_rest ? plate.begin() : plate.end(), plate.end());
  std::vector<std::size_t> mean_shot(parameters_.faces.size(), shots_.size());
  if (has_rest) {
    for (std::size_t face = 0; face < parameters_.faces.size(); ++face) {
      lights_to_wavelets(n, std::span(rest).subspan(face * n2 * width, n2 * width), width);
    }
  }
  double mean_size = 1.0;
  std::size_t shot = 0;
  for (const int index : parameters_.wavelets) {
    const Wavelet wavelet = wavelet_at(n, index % static_cast<int>(n2));
    const bool is_pair = wavelet.is_x || wavelet.is_y;
    if (has_rest) {
      std::fill_n(rest.begin() + static_cast<std::ptrdiff_t>(count(index) * width), width, 0.0);
    }
    if (!is_pair) {
      mean_shot[count(index) / n2] = shot++;
      mean_size = wavelet.size;
      continue;
    }
    const double scale = 1.0 / (drive_ * wavelet.size);
    double* out = lights.data() + count(index) * width;
    const double* v = shots.data() + shot * width;
    for (std::size_t i = 0; i < width; ++i) {
      out[i] = scale * scale * (v[i] + v[width + i]);
    }
    shot += 2;
  }
  for (std::size_t face = 0; face < parameters_.faces.size(); ++face) {
    const std::size_t first = face * n2 * width;
    spread_wavelets(n, lights.subspan(first, n2 * width), width);
    if (mean_shot[face] == shots_.size()) {
      continue;
    }
    std::vector<double> sum(width, 0.0);
    if (has_rest) {
      wavelets_to_lights(n, std::span(rest).subspan(first, n2 * width), width);
      for (std::size_t k = 0; k < n2; ++k) {
        for (std::size_t i = 0; i < width; ++i) {
          sum[i] += plate[first + k * width + i];
        }
      }
    }
    const double* v = shots.data() + mean_shot[face] * width;
    for (std::size_t k = 0; k < n2; ++k) {
      for (std::size_t i = 0; i < width; ++i) {
        const std::size_t at = first + k * width + i;
        // The mean wavelet is 1/n everywhere.
        double a = 1.0 / (mean_size * n);
        if (sum[i] > 0.0) {
          a += rest[at] / sum[i];
        }
        lights[at] += a * a / (drive_ * drive_) * v[i];
      }
    }
  }
}

// At most 8 shots: what one unit of each contributes to every light.
void PatternInverse::target_variance(std::span<const double> shots,
                                     std::span<const double> plate, std::size_t width,
                                     std::span<double> lights) const {
  std::fill(lights.begin(), lights.end(), 0.0);
  std::vector<double> unit(shots.size(), 0.0);
  std::vector<double> fraction(lights.size());
  for (std::size_t j = 0; j < shots_.size(); ++j) {
    std::fill(unit.begin(), unit.end(), 0.0);
    std::fill_n(unit.begin() + static_cast<std::ptrdiff_t>(j * width), width, 1.0);
    apply_target(unit, plate, width, fraction);
    for (std::size_t at = 0; at < fraction.size(); ++at) {
      lights[at] += fraction[at] * fraction[at] * shots[j * width + at % width];
    }
  }
}

}  // namespace haarlight
