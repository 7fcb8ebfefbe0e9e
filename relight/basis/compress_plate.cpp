// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/compress_plate.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <utility>
#include <vector>

#include "core/count.h"
#include "core/parallel.h"
#include "core/random.h"
#include "haarlight/core/error.h"
#include "relight/basis/coder/quantiser.h"
#include "relight/basis/compress_parameters.h"
#include "relight/basis/error_gram.h"
#include "relight/basis/light_basis.h"
#include "relight/basis/picture_bound.h"
#include "relight/basis/plate/smooth_plate.h"
#include "relight/basis/plate/tile_plate.h"

namespace haarlight::relight {

namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;
using RowMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using RowMatrixF = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

constexpr int kMaxRank = 24;
// Rms error allowed to vectors and polynomials, each as a fraction of the target: here no
// residual follows that would make up for it, as it does in a capture.
constexpr std::array<double, 2> kFractions = {0.6, kPlateFraction};
constexpr double kSmoothFraction = 1e-3;  // of the target: error allowed to the tiles' series
constexpr int kChecks = 256;              // pixels compared with light_irradiance()
constexpr double kCheckFactor = 2.0;      // of their rms: the stated error
constexpr double kNearPeak = 0.8;         // of the largest sampled value: inspected closely

/// Result of checking randomly drawn pixels.
struct CheckSums {
  VectorXd light;        ///< (n_lights): sum of squared errors of the coordinates
  VectorXd coefficient;  ///< the same of its basis coefficients
  double missed = 0.0;
  double energy = 0.0;
  double worst = 0.0;  ///< of a pixel, as StackError::worst_pixel
  double n = 0.0;
};

/// One tile as in the file, and its sums in coordinates of the vectors.
struct PlateTile {
  PackedTile packed;
  MatrixXd errors;       ///< sum over the pixels of e e'
  double longest = 0.0;  ///< ||e||
  CheckSums checks;
  double worst_pixel = 0.0;
};

class PlateCompressor {
 public:
  PlateCompressor(const ComputedPlate& plate, const SmoothPlate& smooth, BasisHeader header)
      : plate_(plate),
        smooth_(smooth),
        header_(std::move(header)),
        basis_(make_basis(header_)),
        here_(smooth.chosen_here()) {
    coefficient_vectors_ = smooth_.vectors();
    for (Eigen::Index i = 0; i < coefficient_vectors_.cols(); ++i) {
      basis_->forward(std::span(coefficient_vectors_.col(i).data(), count(n_lights())));
    }
  }

  /// @param target  of the polynomials. @return  whether the requested error is achieved
  [[nodiscard]] bool code(double target);
  [[nodiscard]] CompressSummary write(const std::filesystem::path& file);

 private:
  [[nodiscard]] int n_lights() const { return header_.dims.n_lights; }
  void choose_steps();
  [[nodiscard]] double find_peak() const;
  [[nodiscard]] PlateTile code_tile(int i_tile) const;
  [[nodiscard]] CheckSums check(int i_tile, const PixelBlock& pixels, const MatrixXd& u,
                                const MatrixXd& rest) const;
  [[nodiscard]] double worst_value() const;
  [[nodiscard]] VectorXd pictures(const MatrixXd& vectors, const MatrixXd& sums) const;
  [[nodiscard]] std::vector<double> products() const;

  const ComputedPlate& plate_;
  const SmoothPlate& smooth_;
  BasisHeader header_;
  std::shared_ptr<const FixedBasis> basis_;
  PlateVectors here_;             ///< the file's vectors in coordinates
  MatrixXd coefficient_vectors_;  ///< (n_lights, n_vectors): the basis of each vector
  MatrixXd energies_;             ///< sum over all pixels of y y'
  MatrixXd errors_;               ///< of e e'
  CheckSums checks_;
  std::vector<PlateTile> tiles_;
};

/// The largest value: every pixel is searched for the lights that come near it in a tile.
double PlateCompressor::find_peak() const {
  constexpr int kSteps = 3;  // positions sampled along a tile
  std::vector<MatrixXd> seen(count(smooth_.n_tiles()));
  parallel_for(seen.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const TileRect rect = smooth_.tile_rect(static_cast<int>(i));
      const MatrixXd y = smooth_.tile_coordinates(static_cast<int>(i));
      MatrixXd some(y.rows(), kSteps * kSteps);
      for (int p = 0; p < kSteps * kSteps; ++p) {
        const int row = (rect.height - 1) * (p / kSteps) / (kSteps - 1);
        some.col(p) = y.col(row * rect.width + (rect.width - 1) * (p % kSteps) / (kSteps - 1));
      }
      seen[i] = (smooth_.vectors() * some).rowwise().maxCoeff();
    }
  });
  double peak = 0.0;
  for (const MatrixXd& of_tile : seen) {
    peak = std::max(peak, of_tile.maxCoeff());
  }
  const double near_peak = kNearPeak * peak;
  for (std::size_t i = 0; i < seen.size(); ++i) {
    if (seen[i].maxCoeff() < near_peak) {
      continue;
    }
    const MatrixXd y = smooth_.tile_coordinates(static_cast<int>(i));
    for (Eigen::Index k = 0; k < seen[i].rows(); ++k) {
      if (seen[i](k, 0) >= near_peak) {
        peak = std::max(peak, (smooth_.vectors().row(k) * y).maxCoeff());
      }
    }
  }
  return peak;
}

void PlateCompressor::choose_steps() {
  std::vector<MatrixXd> sums(count(smooth_.n_tiles()));
  parallel_for(sums.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const MatrixXd y = smooth_.tile_coordinates(static_cast<int>(i));
      sums[i] = y * y.transpose();
    }
  });
  energies_ = MatrixXd::Zero(smooth_.n_vectors(), smooth_.n_vectors());
  for (const MatrixXd& sum : sums) {
    energies_ += sum;
  }
  header_.stack_norm = std::sqrt(energies_.trace());
  const double rms_pixel =
      header_.stack_norm / std::sqrt(static_cast<double>(header_.dims.n_pixels()));
  header_.dark_norm = kDarkFloor * rms_pixel;
  header_.gain_step = kGainStep * header_.requested_relative_l2 * rms_pixel;
  header_.peak = find_peak();
  // Nothing is kept: no coefficient exceeds peak sqrt(n_lights).
  header_.step = 4.0 * header_.peak * std::sqrt(static_cast<double>(n_lights()));
}

PlateTile PlateCompressor::code_tile(int i_tile) const {
  const TileRect rect = smooth_.tile_rect(i_tile);
  const int n_pixels = rect.n_pixels();
  const int rank = header_.plate_rank;
  PlateTile tile;
  PixelBlock pixels;
  pixels.shift.resize(count(n_pixels));
  pixels.gain.resize(count(n_pixels));
  pixels.plate = fit_tile_plate(smooth_, 0, rect, here_, header_.plate_degree);
  const std::vector<double> terms = plate_terms(rect, header_.plate_degree);
  const auto n_terms = static_cast<Eigen::Index>(terms.size()) / n_pixels;
  const Eigen::Map<const RowMatrix> c(terms.data(), n_pixels, n_terms);
  const Eigen::Map<const RowMatrixF> a(pixels.plate.data(), rank, n_terms);
  const MatrixXd u = a.cast<double>() * c.transpose();  // (rank, pixels)
  MatrixXd rest = smooth_.tile_coordinates(i_tile);
  for (int p = 0; p < n_pixels; ++p) {
    auto e = rest.col(p);
    const double norm = std::max(e.norm(), header_.dark_norm);
    const double length = u.col(p).squaredNorm();
    const double gain = length > 0.0 ? e.head(rank).dot(u.col(p)) / length : 0.0;
    const double quantum =
        std::clamp(std::round(gain / header_.gain_step), -kLargestQuantum, kLargestQuantum);
    pixels.gain[count(p)] = static_cast<std::int32_t>(quantum);
    e.head(rank) -= header_.gain_step * quantum * u.col(p);
    tile.longest = std::max(tile.longest, e.norm());
    tile.worst_pixel = std::max(tile.worst_pixel, e.norm() / norm);
  }
  tile.errors = rest * rest.transpose();
  tile.checks = check(i_tile, pixels, u, rest);
  tile.packed.pixels.bytes = encode_pixels(pixels);
  tile.packed.groups.resize(header_.group_ends.size());
  return tile;
}

/// The file's error that the coordinates do not capture, at drawn pixels: computed from the
/// file's own floats and light_irradiance(), independent of the approximations so far.
CheckSums PlateCompressor::check(int i_tile, const PixelBlock& pixels, const MatrixXd& u,
                                 const MatrixXd& rest) const {
  const TileRect rect = smooth_.tile_rect(i_tile);
  CheckSums sums;
  sums.light = VectorXd::Zero(n_lights());
  sums.coefficient = VectorXd::Zero(n_lights());
  const int n_tiles = smooth_.n_tiles();
  const int step = std::max(1, n_tiles / kChecks);
  const int n = i_tile % step == 0 ? (kChecks + n_tiles - 1) / n_tiles : 0;
  const Eigen::Map<const RowMatrixF> v(smooth_.chosen().vectors.data(), header_.plate_rank,
                                       n_lights());
  VectorXd exact(n_lights());
  for (int i = 0; i < n; ++i) {
    const auto draw = [&](std::uint64_t axis, int below) {
      return std::min(
          below - 1,
          static_cast<int>(
              below * uniform_unit(hash_key(0x636865636b, static_cast<std::uint64_t>(i_tile),
                                            static_cast<std::uint64_t>(i), axis))));
    };
    const int x = draw(0, rect.width);
    const int y = draw(1, rect.height);
    const int p = y * rect.width + x;
    plate_.evaluate_exactly(rect.x0 + x + 0.5, rect.y0 + y + 0.5,
                            {exact.data(), count(n_lights())});
    const VectorXd decoded =
        header_.gain_step * pixels.gain[count(p)] * (v.transpose().cast<double>() * u.col(p));
    VectorXd missed = exact - decoded - smooth_.vectors() * rest.col(p);
    const double norm = std::max(exact.norm(), header_.dark_norm);
    sums.worst = std::max(sums.worst, missed.norm() / norm);
    sums.missed += missed.squaredNorm();
    sums.energy += exact.squaredNorm();
    sums.light += missed.cwiseAbs2();
    basis_->forward(std::span(missed.data(), count(n_lights())));
    sums.coefficient += missed.cwiseAbs2();
    sums.n += 1.0;
  }
  return sums;
}

/// Bound on the error of any value: a pixel's whole error times the longest row of the vectors.
double PlateCompressor::worst_value() const {
  double longest = 0.0;
  for (const PlateTile& tile : tiles_) {
    longest = std::max(longest, tile.longest);
  }
  return longest * smooth_.vectors().rowwise().norm().maxCoeff();
}

/// Squared norms of the lights' pictures made of the vectors: diag(V S V').
VectorXd PlateCompressor::pictures(const MatrixXd& vectors, const MatrixXd& sums) const {
  return (vectors * sums).cwiseProduct(vectors).rowwise().sum().cwiseMax(0.0);
}

/// <E_i, E_j>, as fit_picture_bound() takes them.
std::vector<double> PlateCompressor::products() const {
  const std::vector<int> order = coefficient_order(header_);
  std::vector<double> all;
  all.reserve(gram_size(n_lights()));
  for (int begin = 0; begin < n_lights(); begin += kGramBlock) {
    const int n = std::min(kGramBlock, n_lights() - begin);
    MatrixXd block(n, smooth_.n_vectors());
    for (int i = 0; i < n; ++i) {
      block.row(i) = coefficient_vectors_.row(order[count(begin + i)]);
    }
    const MatrixXd gram = block * errors_ * block.transpose();
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j <= i; ++j) {
        all.push_back(gram(i, j));
      }
    }
  }
  return all;
}

bool PlateCompressor::code(double target) {
  header_.plate_rank = smooth_.chosen().rank;
  header_.plate_degree = choose_plate_degree(smooth_, here_, kTile, target);
  header_.group_ends = default_group_ends(header_);
  choose_steps();
  tiles_.resize(count(smooth_.n_tiles()));
  parallel_for(tiles_.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      tiles_[i] = code_tile(static_cast<int>(i));
    }
  });
  errors_ = MatrixXd::Zero(smooth_.n_vectors(), smooth_.n_vectors());
  checks_.light = VectorXd::Zero(n_lights());
  checks_.coefficient = VectorXd::Zero(n_lights());
  double worst_pixel = 0.0;
  for (const PlateTile& tile : tiles_) {
    errors_ += tile.errors;
    checks_.light += tile.checks.light;
    checks_.coefficient += tile.checks.coefficient;
    checks_.missed += tile.checks.missed;
    checks_.energy += tile.checks.energy;
    checks_.worst = std::max(checks_.worst, tile.checks.worst);
    checks_.n += tile.checks.n;
    worst_pixel = std::max(worst_pixel, tile.worst_pixel);
  }
  StackError& achieved = header_.achieved;
  achieved.relative_l2 = std::sqrt(errors_.trace()) / header_.stack_norm +
                         kCheckFactor * std::sqrt(checks_.missed / checks_.energy);
  achieved.worst_pixel = worst_pixel + kCheckFactor * checks_.worst;
  return achieved.relative_l2 <= header_.requested_relative_l2 &&
         achieved.worst_pixel <= header_.requested_worst_pixel;
}

CompressSummary PlateCompressor::write(const std::filesystem::path& file) {
  // Extrapolates the checked pixels' sums to all pixels.
  const double scale =
      kCheckFactor * kCheckFactor * static_cast<double>(header_.dims.n_pixels()) / checks_.n;
  const VectorXd light_missed = (scale * checks_.light).cwiseSqrt();
  const VectorXd coefficient_missed = (scale * checks_.coefficient).cwiseSqrt();
  header_.achieved.worst_value =
      (worst_value() + kCheckFactor * std::sqrt(checks_.light.maxCoeff())) / header_.peak;
  const auto rounded = [](const VectorXd& values) {
    std::vector<float> up(static_cast<std::size_t>(values.size()));
    std::transform(values.begin(), values.end(), up.begin(), round_up);
    return up;
  };
  const VectorXd light_norms = pictures(smooth_.vectors(), energies_).cwiseSqrt();
  const VectorXd light_errors = pictures(smooth_.vectors(), errors_).cwiseSqrt() + light_missed;
  BasisTables tables;
  tables.plate_vectors = smooth_.chosen().vectors;
  tables.coefficient_norms.assign(count(n_lights()), 0.0F);
  tables.coefficient_errors =
      rounded(pictures(coefficient_vectors_, errors_).cwiseSqrt() + coefficient_missed);
  tables.light_norms = rounded(light_norms + light_missed);
  tables.light_errors = rounded(light_errors);
  BasisWriter writer(file);
  double block_bytes = 0.0;
  for (const PlateTile& tile : tiles_) {
    writer.append(tile.packed);
    block_bytes += static_cast<double>(tile.packed.pixels.bytes.size());
  }
  const std::vector<double> rests = {coefficient_missed.maxCoeff()};
  tables.coded_bound =
      fit_picture_bound(header_, products(), tables.coefficient_errors, rests, block_bytes);
  // Nothing but the plate is stored, so nothing can be dropped.
  tables.term_bound.fractions.assign(count(n_gram_blocks(n_lights())), 0.0F);
  tables.term_bound.rests = tables.term_bound.fractions;
  CompressSummary summary;
  summary.bytes = writer.finish(header_, tables);
  summary.header = header_;
  for (Eigen::Index k = 0; k < light_norms.size(); ++k) {
    if (light_norms[k] > 0.0) {
      summary.worst_light = std::max(summary.worst_light, light_errors[k] / light_norms[k]);
    }
  }
  summary.n_checked = static_cast<int>(checks_.n);
  summary.checked_error = std::sqrt(checks_.missed / checks_.energy);
  return summary;
}

}  // namespace

std::optional<CompressSummary> compress_smooth_plate(const ComputedPlate& plate,
                                                     const CompressSource& source,
                                                     const std::filesystem::path& file,
                                                     const CompressOptions& options,
                                                     int degree) {
  BasisHeader header = first_header(source, options);
  if (header.coding != BasisCoding::quantised || options.rank.n != 1) {
    return std::nullopt;
  }
  const double requested = options.relative_l2;
  if (degree == 0) {
    degree = smooth_degree(plate, kTile, kSmoothFraction * requested).value_or(0);
  }
  if (degree == 0) {
    return std::nullopt;
  }
  header.plate = source.plate_origin;
  header.plate_source = source.plate_source;
  for (const double fraction : kFractions) {
    const SmoothPlate smooth(plate, kTile, degree, fraction * requested, kMaxRank);
    if (smooth.chosen().rank == 0) {
      return std::nullopt;
    }
    PlateCompressor compressor(plate, smooth, header);
    if (compressor.code(fraction * requested)) {
      return compressor.write(file);
    }
  }
  return std::nullopt;
}

}  // namespace haarlight::relight
