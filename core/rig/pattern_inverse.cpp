// SPDX-License-Identifier: Apache-2.0
#include "core/rig/pattern_inverse.h"

#include <algorithm>
#include <bit>
#include <cstdint>
#include <numeric>
#include <utility>

#include <Eigen/Core>
#include <fmt/format.h>

#include "core/count.h"
#include "core/linear_algebra.h"
#include "core/wavelet_synthesis.h"
#include "haarlight/core/error.h"

namespace haarlight {

namespace {

bool is_power_of_two(std::size_t n) { return n >= 1 && std::has_single_bit(n); }

/// One butterfly of the transform on two rows: sums and differences.
void butterfly(double* a, double* b, std::size_t width) {
  for (std::size_t i = 0; i < width; ++i) {
    const double sum = a[i] + b[i];
    b[i] = a[i] - b[i];
    a[i] = sum;
  }
}

/// Two steps at once on four rows: half the passes over memory.
void double_butterfly(double* a, double* b, double* c, double* d, std::size_t width) {
  for (std::size_t i = 0; i < width; ++i) {
    const double ab = a[i] + b[i];
    const double a_b = a[i] - b[i];
    const double cd = c[i] + d[i];
    const double c_d = c[i] - d[i];
    a[i] = ab + cd;
    b[i] = a_b + c_d;
    c[i] = ab - cd;
    d[i] = a_b - c_d;
  }
}

/// y = M_j summed over the shots that light each light.
void residue_sums(int order, std::span<const double> x, std::size_t width,
                  std::vector<double>& lit) {
  std::vector<int> residues;
  for (int i = 0; i < order; ++i) {
    if (s_entry(order, 0, i)) {
      residues.push_back(i);
    }
  }
  lit.assign(x.size(), 0.0);
  for (int light = 0; light < order; ++light) {
    double* out = lit.data() + count(light) * width;
    for (const int residue : residues) {
      const int shot = (residue - light + order) % order;
      const double* in = x.data() + count(shot) * width;
      for (std::size_t i = 0; i < width; ++i) {
        out[i] += in[i];
      }
    }
  }
}

/// x <- S x for the first `order` rows of lights.
void s_matrix_forward(int order, std::span<double> x, std::size_t width) {
  const auto n = count(order);
  std::vector<double> sum(width, 0.0);
  for (std::size_t k = 0; k < n; ++k) {
    for (std::size_t i = 0; i < width; ++i) {
      sum[i] += x[k * width + i];
    }
  }
  if (is_sylvester(order)) {
    // S = (J - H')/2, H' = H without its first row and column.
    std::vector<double> padded((n + 1) * width, 0.0);
    std::copy(x.begin(), x.end(), padded.begin() + static_cast<std::ptrdiff_t>(width));
    walsh_hadamard(padded, n + 1, width);
    for (std::size_t j = 0; j < n; ++j) {
      for (std::size_t i = 0; i < width; ++i) {
        x[j * width + i] = 0.5 * (sum[i] - padded[(j + 1) * width + i]);
      }
    }
    return;
  }
  std::vector<double> lit;
  residue_sums(order, x, width, lit);  // the quadratic-residue matrix is symmetric
  std::copy(lit.begin(), lit.end(), x.begin());
}

}  // namespace

void walsh_hadamard(std::span<double> x, std::size_t n, std::size_t width) {
  HAARLIGHT_EXPECTS(is_power_of_two(n) && x.size() == n * width, "2^k rows");
  std::size_t h = 1;
  for (; 4 * h <= n; h *= 4) {
    for (std::size_t base = 0; base < n; base += 4 * h) {
      for (std::size_t j = base; j < base + h; ++j) {
        double* a = x.data() + j * width;
        double_butterfly(a, a + h * width, a + 2 * h * width, a + 3 * h * width, width);
      }
    }
  }
  for (; 2 * h <= n; h *= 2) {
    for (std::size_t base = 0; base < n; base += 2 * h) {
      for (std::size_t j = base; j < base + h; ++j) {
        butterfly(x.data() + j * width, x.data() + (j + h) * width, width);
      }
    }
  }
}

void s_matrix_inverse(int order, std::span<double> x, std::size_t width) {
  const auto n = count(order);
  HAARLIGHT_EXPECTS(has_s_matrix(order) && x.size() == n * width, "one row per shot");
  const double scale = 2.0 / (order + 1);
  if (is_sylvester(order)) {
    // 2 S^T - J = -H'
    std::vector<double> padded((n + 1) * width, 0.0);
    std::copy(x.begin(), x.end(), padded.begin() + static_cast<std::ptrdiff_t>(width));
    walsh_hadamard(padded, n + 1, width);
    for (std::size_t i = 0; i < n * width; ++i) {
      x[i] = -scale * padded[i + width];
    }
    return;
  }
  std::vector<double> sum(width, 0.0);
  for (std::size_t j = 0; j < n; ++j) {
    for (std::size_t i = 0; i < width; ++i) {
      sum[i] += x[j * width + i];
    }
  }
  std::vector<double> lit;
  residue_sums(order, x, width, lit);
  for (std::size_t k = 0; k < n; ++k) {
    for (std::size_t i = 0; i < width; ++i) {
      x[k * width + i] = scale * (2.0 * lit[k * width + i] - sum[i]);
    }
  }
}

void wavelets_to_lights(int n, std::span<double> x, std::size_t width) {
  HAARLIGHT_EXPECTS(is_power_of_two(count(n)) && x.size() == count(n) * count(n) * width,
                    "an n x n grid");
  synthesise_wavelets(n, x, width,
                      [](double mean, double dx, double dy, double dxy, double& top_left,
                         double& top_right, double& low_left, double& low_right) {
                        top_left = 0.5 * (mean + dx + dy + dxy);
                        top_right = 0.5 * (mean - dx + dy - dxy);
                        low_left = 0.5 * (mean + dx - dy - dxy);
                        low_right = 0.5 * (mean - dx - dy + dxy);
                      });
}

void lights_to_wavelets(int n, std::span<double> x, std::size_t width) {
  const auto side = count(n);
  HAARLIGHT_EXPECTS(is_power_of_two(side) && x.size() == side * side * width, "an n x n grid");
  std::vector<double> old(x.size());
  for (std::size_t h = side / 2; h >= 1; h /= 2) {
    for (std::size_t row = 0; row < 2 * h; ++row) {
      std::copy_n(x.data() + row * side * width, 2 * h * width,
                  old.data() + row * side * width);
    }
    for (std::size_t row = 0; row < h; ++row) {
      for (std::size_t col = 0; col < h; ++col) {
        const double* top = old.data() + (2 * row * side + 2 * col) * width;
        const double* low = top + side * width;
        double* mean = x.data() + (row * side + col) * width;
        double* dx = mean + h * width;
        double* dy = mean + h * side * width;
        double* dxy = dy + h * width;
        for (std::size_t i = 0; i < width; ++i) {
          const double a = top[i];
          const double b = top[width + i];
          const double c = low[i];
          const double d = low[width + i];
          mean[i] = 0.5 * (a + b + c + d);
          dx[i] = 0.5 * (a - b + c - d);
          dy[i] = 0.5 * (a + b - c - d);
          dxy[i] = 0.5 * (a - b - c + d);
        }
      }
    }
  }
}

PatternInverse::PatternInverse(PatternParameters parameters,
                               std::vector<std::vector<LightDriveLevel>> shots, int n_lights)
    : parameters_(std::move(parameters)), shots_(std::move(shots)), n_lights_(n_lights) {
  HAARLIGHT_EXPECTS(!shots_.empty() && n_lights_ >= 1, "shots and lights");
  for (const auto& shot : shots_) {
    for (const LightDriveLevel& light : shot) {
      HAARLIGHT_EXPECTS(light.light >= 0 && light.light < n_lights_ && light.drive > 0.0,
                        "lights of the session, lit");
    }
  }
  constexpr std::size_t kMaxTargets = 8;
  if (parameters_.family == PatternFamily::target) {
    HAARLIGHT_EXPECTS(shots_.size() <= kMaxTargets, "at most 8 target shots");
    needs_plate_ = true;
  } else if (parameters_.family == PatternFamily::list) {
    PatternMatrix patterns =
        PatternMatrix::Zero(static_cast<Eigen::Index>(shots_.size()), n_lights_);
    for (std::size_t j = 0; j < shots_.size(); ++j) {
      for (const LightDriveLevel& light : shots_[j]) {
        patterns(static_cast<Eigen::Index>(j), light.light) = light.drive;
      }
    }
    const LeastSquares solver =
        least_squares(patterns, Eigen::MatrixXd::Identity(patterns.rows(), patterns.rows()));
    if (solver.rank < n_lights_) {
      throw Error(fmt::format("{} patterns cannot tell {} lights apart (rank {})",
                              shots_.size(), n_lights_, solver.rank),
                  "patterns",
                  "shoot a plan with as many independent patterns as lights, or one with "
                  "patterns = \"bins\"");
    }
    inverse_ = solver.solution;
  } else {
    const std::vector<std::vector<int>> expected = lit_lights(parameters_);
    HAARLIGHT_EXPECTS(expected.size() == shots_.size() && parameters_.n_lights() == n_lights_,
                      "the shots of the parameters");
    drive_ = shots_.front().front().drive;
    for (std::size_t j = 0; j < shots_.size(); ++j) {
      bool is_equal = expected[j].size() == shots_[j].size();
      for (std::size_t i = 0; is_equal && i < expected[j].size(); ++i) {
        is_equal = shots_[j][i].light == expected[j][i] && shots_[j][i].drive == drive_;
      }
      HAARLIGHT_EXPECTS(is_equal, "the lights of the parameters at one drive level");
    }
    const bool is_complete =
        parameters_.family == PatternFamily::haar
            ? parameters_.wavelets.size() == count(n_lights_)
            : parameters_.family != PatternFamily::bins || parameters_.bin == 1;
    needs_plate_ = !is_complete;
  }
}

void PatternInverse::apply(std::span<const double> measured, std::span<const double> plate,
                           std::size_t width, std::span<double> lights) const {
  HAARLIGHT_EXPECTS(measured.size() == shots_.size() * width &&
                        lights.size() == count(n_lights_) * width &&
                        (plate.empty() || plate.size() == lights.size()),
                    "(shots, width) to (lights, width)");
  switch (parameters_.family) {
    case PatternFamily::one_at_a_time:
      for (std::size_t i = 0; i < lights.size(); ++i) {
        lights[i] = measured[i] / drive_;
      }
      return;
    case PatternFamily::s_matrix:
      apply_s_matrix(measured, width, lights);
      return;
    case PatternFamily::haar:
      apply_haar(measured, plate, width, lights);
      return;
    case PatternFamily::bins:
      apply_bins(measured, plate, width, lights);
      return;
    case PatternFamily::target:
      apply_target(measured, plate, width, lights);
      return;
    case PatternFamily::list: {
      using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
      const auto columns = static_cast<Eigen::Index>(width);
      const Eigen::Map<const RowMajor> m(measured.data(), n_shots(), columns);
      Eigen::Map<RowMajor>(lights.data(), n_lights_, columns).noalias() = inverse_ * m;
      return;
    }
  }
}

void PatternInverse::apply_s_matrix(std::span<const double> measured, std::size_t width,
                                    std::span<double> lights) const {
  std::size_t shot = 0;
  std::size_t light = 0;
  std::vector<double> x;
  for (const FaceGrid& face : parameters_.faces) {
    for (const SBlock& block : s_blocks(face.n_lights())) {
      const auto order = count(block.order);
      const auto kept = count(block.n_lights) * width;
      x.assign(measured.begin() + static_cast<std::ptrdiff_t>(shot * width),
               measured.begin() + static_cast<std::ptrdiff_t>((shot + order) * width));
      if (block.order > 1) {
        s_matrix_inverse(block.order, x, width);
      }
      std::transform(x.begin(), x.begin() + static_cast<std::ptrdiff_t>(kept),
                     lights.begin() + static_cast<std::ptrdiff_t>(light * width),
                     [this](double value) { return value / drive_; });
      shot += order;
      light += count(block.n_lights);
    }
  }
}

// Wavelets that were shot come from their shots; the others from g B, the clean plate at the
// gain given by the face's mean shot.
void PatternInverse::apply_haar(std::span<const double> measured, std::span<const double> plate,
                                std::size_t width, std::span<double> lights) const {
  const int n = parameters_.faces.front().rows;
  const auto n2 = count(n) * count(n);
  std::fill(lights.begin(), lights.end(), 0.0);
  const auto for_each_wavelet = [&](auto visit) {
    std::size_t shot = 0;
    for (const int index : parameters_.wavelets) {
      const Wavelet wavelet = wavelet_at(n, index % static_cast<int>(n2));
      visit(index, wavelet, shot);
      shot += wavelet.is_x || wavelet.is_y ? 2 : 1;
    }
  };
  if (needs_plate_ && !plate.empty()) {
    for_each_wavelet([&](int index, const Wavelet& wavelet, std::size_t shot) {
      if (wavelet.is_x || wavelet.is_y) {
        return;
      }
      const auto face = count(index) * width;  // the mean is the face's first coefficient
      for (std::size_t i = 0; i < width; ++i) {
        double sum = 0.0;
        for (std::size_t k = 0; k < n2; ++k) {
          sum += plate[face + k * width + i];
        }
        const double gain = sum > 0.0 ? measured[shot * width + i] / (drive_ * sum) : 0.0;
        for (std::size_t k = 0; k < n2; ++k) {
          lights[face + k * width + i] = gain * plate[face + k * width + i];
        }
      }
    });
    for (std::size_t face = 0; face < parameters_.faces.size(); ++face) {
      lights_to_wavelets(n, lights.subspan(face * n2 * width, n2 * width), width);
    }
  }
  for_each_wavelet([&](int index, const Wavelet& wavelet, std::size_t shot) {
    const double scale = 1.0 / (drive_ * wavelet.size);
    const double* positive = measured.data() + shot * width;
    const bool is_pair = wavelet.is_x || wavelet.is_y;
    double* out = lights.data() + count(index) * width;
    for (std::size_t i = 0; i < width; ++i) {
      out[i] = scale * (positive[i] - (is_pair ? positive[width + i] : 0.0));
    }
  });
  for (std::size_t face = 0; face < parameters_.faces.size(); ++face) {
    wavelets_to_lights(n, lights.subspan(face * n2 * width, n2 * width), width);
  }
}

Eigen::MatrixXd PatternInverse::gram_inverse(std::span<const double> b) const {
  const auto m = static_cast<Eigen::Index>(shots_.size());
  Eigen::MatrixXd rows = Eigen::MatrixXd::Zero(m, n_lights_);
  for (Eigen::Index j = 0; j < m; ++j) {
    for (const LightDriveLevel& light : shots_[static_cast<std::size_t>(j)]) {
      rows(j, light.light) = light.drive;
    }
  }
  const Eigen::Map<const Eigen::VectorXd> weights(b.data(), n_lights_);
  const Eigen::MatrixXd gram = rows * weights.asDiagonal() * rows.transpose();
  return pseudo_inverse(gram, 1e-9);  // for environment colours that agree to 1e-9
}

// T_k = B_k M_b / (P B)_b, B = 1 at pixels where some block's clean plate is dark.
void PatternInverse::apply_bins(std::span<const double> measured, std::span<const double> plate,
                                std::size_t width, std::span<double> lights) const {
  std::vector<double> sum(shots_.size() * width, 0.0);  // P B
  std::vector<std::uint8_t> is_even(width, plate.empty() ? 1 : 0);
  if (!plate.empty()) {
    shoot(plate, width, sum);
    for (std::size_t j = 0; j < shots_.size(); ++j) {
      for (std::size_t i = 0; i < width; ++i) {
        if (!(sum[j * width + i] > 0.0)) {
          is_even[i] = 1;
        }
      }
    }
  }
  std::vector<double> gain(width);
  for (std::size_t j = 0; j < shots_.size(); ++j) {
    double total_level = 0.0;
    for (const LightDriveLevel& light : shots_[j]) {
      total_level += light.drive;
    }
    for (std::size_t i = 0; i < width; ++i) {
      gain[i] = measured[j * width + i] / (is_even[i] != 0 ? total_level : sum[j * width + i]);
    }
    for (const LightDriveLevel& light : shots_[j]) {
      const std::size_t first = count(light.light) * width;
      for (std::size_t i = 0; i < width; ++i) {
        lights[first + i] = gain[i] * (is_even[i] != 0 ? 1.0 : plate[first + i]);
      }
    }
  }
}

// T = g B + diag(B) P^T l, g = sum M / sum P B, l such that P T = M: every shot is reproduced
// exactly.
void PatternInverse::apply_target(std::span<const double> measured,
                                  std::span<const double> plate, std::size_t width,
                                  std::span<double> lights) const {
  const auto n = count(n_lights_);
  const std::size_t m = shots_.size();
  std::vector<double> b(n);
  std::vector<double> pb(m);
  for (std::size_t i = 0; i < width; ++i) {
    const auto read_plate = [&](bool is_even) {
      for (std::size_t k = 0; k < n; ++k) {
        b[k] = is_even ? 1.0 : plate[k * width + i];
      }
      shoot(b, 1, pb);
    };
    read_plate(plate.empty());
    if (*std::min_element(pb.begin(), pb.end()) <= 0.0) {
      read_plate(true);
    }
    double measured_sum = 0.0;
    double plate_sum = 0.0;
    for (std::size_t j = 0; j < m; ++j) {
      measured_sum += measured[j * width + i];
      plate_sum += pb[j];
    }
    const double gain = measured_sum / plate_sum;
    std::vector<double> fraction(n, gain);
    if (m > 1) {
      Eigen::VectorXd rest(static_cast<Eigen::Index>(m));
      for (std::size_t j = 0; j < m; ++j) {
        rest[static_cast<Eigen::Index>(j)] = measured[j * width + i] - gain * pb[j];
      }
      const Eigen::VectorXd multiplier = gram_inverse(b) * rest;
      for (std::size_t j = 0; j < m; ++j) {
        for (const LightDriveLevel& light : shots_[j]) {
          fraction[count(light.light)] +=
              multiplier[static_cast<Eigen::Index>(j)] * light.drive;
        }
      }
    }
    for (std::size_t k = 0; k < n; ++k) {
      lights[k * width + i] = fraction[k] * b[k];
    }
  }
}

void PatternInverse::haar_weights(std::span<const double> w, std::span<const double> plate,
                                  std::span<double> a) const {
  const int n = parameters_.faces.front().rows;
  const auto n2 = count(n) * count(n);
  std::vector<double> l(w.begin(), w.end());
  std::vector<double> b(plate.begin(), plate.end());
  for (std::size_t face = 0; face < parameters_.faces.size(); ++face) {
    lights_to_wavelets(n, std::span(l).subspan(face * n2, n2), 1);
  }
  std::vector<double> missing(parameters_.faces.size(), 0.0);  // sum of l_i b_i not shot
  std::vector<double> plate_sum(parameters_.faces.size(), 0.0);
  if (needs_plate_ && !plate.empty()) {
    for (std::size_t k = 0; k < b.size(); ++k) {
      plate_sum[k / n2] += plate[k];
      missing[k / n2] += w[k] * plate[k];  // by Parseval the sum of all l_i b_i
    }
    for (std::size_t face = 0; face < parameters_.faces.size(); ++face) {
      lights_to_wavelets(n, std::span(b).subspan(face * n2, n2), 1);
    }
    for (const int index : parameters_.wavelets) {
      missing[count(index) / n2] -= l[count(index)] * b[count(index)];
    }
  }
  std::size_t shot = 0;
  for (const int index : parameters_.wavelets) {
    const Wavelet wavelet = wavelet_at(n, index % static_cast<int>(n2));
    const double weight = l[count(index)] / (drive_ * wavelet.size);
    a[shot] = weight;
    if (wavelet.is_x || wavelet.is_y) {
      a[shot + 1] = -weight;
      shot += 2;
      continue;
    }
    const std::size_t face = count(index) / n2;
    if (plate_sum[face] > 0.0) {
      a[shot] += missing[face] / (drive_ * plate_sum[face]);
    }
    ++shot;
  }
}

// The adjoint of apply() at one pixel.
void PatternInverse::shot_weights(std::span<const double> w, std::span<const double> plate,
                                  std::span<double> a) const {
  HAARLIGHT_EXPECTS(w.size() == count(n_lights_) && a.size() == shots_.size() &&
                        (plate.empty() || plate.size() == w.size()),
                    "weights of the lights to weights of the shots");
  switch (parameters_.family) {
    case PatternFamily::one_at_a_time:
      std::transform(w.begin(), w.end(), a.begin(), [this](double x) { return x / drive_; });
      return;
    case PatternFamily::s_matrix: {
      // S and its inverse are symmetric; columns that are not lit have weight 0.
      std::size_t shot = 0;
      std::size_t light = 0;
      for (const FaceGrid& face : parameters_.faces) {
        for (const SBlock& block : s_blocks(face.n_lights())) {
          std::vector<double> x(count(block.order), 0.0);
          std::copy_n(w.begin() + static_cast<std::ptrdiff_t>(light), block.n_lights,
                      x.begin());
          if (block.order > 1) {
            s_matrix_inverse(block.order, x, 1);
          }
          for (const double value : x) {
            a[shot++] = value / drive_;
          }
          light += count(block.n_lights);
        }
      }
      return;
    }
    case PatternFamily::haar:
      haar_weights(w, plate, a);
      return;
    case PatternFamily::list: {
      const Eigen::Map<const Eigen::VectorXd> weights(w.data(), n_lights_);
      Eigen::Map<Eigen::VectorXd>(a.data(), n_shots()) = inverse_.transpose() * weights;
      return;
    }
    case PatternFamily::bins:
    case PatternFamily::target:
      shared_weights(w, plate, a);
      return;
  }
}

void PatternInverse::shared_weights(std::span<const double> w, std::span<const double> plate,
                                    std::span<double> a) const {
  if (parameters_.family == PatternFamily::bins) {
    // What one unit measured in every shot becomes, summed by shot.
    const std::vector<double> ones(shots_.size(), 1.0);
    std::vector<double> lights(count(n_lights_));
    apply_bins(ones, plate, 1, lights);
    for (std::size_t j = 0; j < shots_.size(); ++j) {
      a[j] = 0.0;
      for (const LightDriveLevel& light : shots_[j]) {
        a[j] += w[count(light.light)] * lights[count(light.light)];
      }
    }
    return;
  }
  std::vector<double> lights(count(n_lights_));
  for (std::size_t j = 0; j < shots_.size(); ++j) {
    std::vector<double> measured(shots_.size(), 0.0);
    measured[j] = 1.0;
    apply_target(measured, plate, 1, lights);
    a[j] = std::inner_product(w.begin(), w.end(), lights.begin(), 0.0);
  }
}

void PatternInverse::shoot(std::span<const double> lights, std::size_t width,
                           std::span<double> measured) const {
  HAARLIGHT_EXPECTS(
      measured.size() == shots_.size() * width && lights.size() == count(n_lights_) * width,
      "(lights, width) to (shots, width)");
  if (parameters_.family == PatternFamily::s_matrix) {
    std::size_t shot = 0;
    std::size_t light = 0;
    for (const FaceGrid& face : parameters_.faces) {
      for (const SBlock& block : s_blocks(face.n_lights())) {
        std::vector<double> x(count(block.order) * width, 0.0);
        std::copy_n(lights.begin() + static_cast<std::ptrdiff_t>(light * width),
                    count(block.n_lights) * width, x.begin());
        if (block.order > 1) {
          s_matrix_forward(block.order, x, width);
        }
        std::transform(x.begin(), x.end(),
                       measured.begin() + static_cast<std::ptrdiff_t>(shot * width),
                       [this](double value) { return value * drive_; });
        shot += count(block.order);
        light += count(block.n_lights);
      }
    }
    return;
  }
  std::fill(measured.begin(), measured.end(), 0.0);
  for (std::size_t j = 0; j < shots_.size(); ++j) {
    double* out = measured.data() + j * width;
    for (const LightDriveLevel& light : shots_[j]) {
      const double* in = lights.data() + count(light.light) * width;
      for (std::size_t i = 0; i < width; ++i) {
        out[i] += light.drive * in[i];
      }
    }
  }
}

}  // namespace haarlight
