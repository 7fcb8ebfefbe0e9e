// SPDX-License-Identifier: Apache-2.0
#include "relight/reflectance/fit/far_fit.h"

#include <algorithm>
#include <array>
#include <utility>

#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "relight/reflectance/fit/fit_kernel.h"
#include "relight/reflectance/fit/pixel_band.h"

namespace haarlight::relight {

namespace {

using Eigen::Index;

/// Approximate size of a band of rows.
constexpr std::size_t kBandBytes = std::size_t{48} << 20U;
/// The luminance of lrgb is at most 1.37 (colours 0..1, the factor's largest channel 1).
constexpr double kMostLuminance = 1.5;

/// Bounds of each plane's values, from its matrix row: inputs are 0..1.
PlaneCodes bounds_of(const Eigen::MatrixXd& matrix, Index row, double added, double most) {
  double low = added;
  double high = added;
  for (Index i = 0; i < matrix.cols(); ++i) {
    (matrix(row, i) < 0.0 ? low : high) += most * matrix(row, i);
  }
  const double step = (high - low) / 65535.0;
  return {low, step > 0.0 ? step : 1.0};
}

/// The planes of blocks of pixels.
class BlockFitter {
 public:
  BlockFitter(const FarFit& fit, std::size_t n_lights)
      : colour_(fit.model.colour),
        // For rgb, the matrix is applied to the raw codes of the pictures.
        matrix_(colour_ == ReflectanceColour::rgb ? Eigen::MatrixXd(fit.matrix / 65535.0)
                                                  : fit.matrix),
        n_lights_(n_lights) {
    const auto n_planes = static_cast<std::size_t>(n_planes_of(colour_, fit.model.n_terms));
    const bool is_lrgb = colour_ == ReflectanceColour::lrgb;
    for (std::size_t p = 0; p < n_planes; ++p) {
      if (is_lrgb && p >= matrix_.n_out()) {
        codes_.push_back({0.0, 1.0 / 65535.0});
        added_.push_back(0.0);
        continue;
      }
      const auto row = static_cast<Index>(p % matrix_.n_out());
      codes_.push_back(
          bounds_of(fit.matrix, row, fit.added[row], is_lrgb ? kMostLuminance : 1.0));
      added_.push_back(fit.added[row]);
    }
  }

  [[nodiscard]] const std::vector<PlaneCodes>& codes() const { return codes_; }

  struct Work {
    std::vector<float> in;       ///< (n_lights, 3, 64): not for rgb
    std::vector<float> factors;  ///< (n_lights, 64): lrgb
    std::vector<float> out;      ///< (n rows of the matrix, 64 or 3 * 64)
  };
  [[nodiscard]] Work make_work() const {
    const bool is_rgb = colour_ == ReflectanceColour::rgb;
    const bool is_lrgb = colour_ == ReflectanceColour::lrgb;
    // For lrgb three more rows: the colour.
    return {std::vector<float>(is_rgb ? 0 : n_lights_ * 3 * kFitBlock),
            std::vector<float>(is_lrgb ? n_lights_ * kFitBlock : 0),
            std::vector<float>((fit_rows_padded(matrix_.n_out()) + 3) * kFitBlock *
                               (is_rgb ? 3 : 1))};
  }

  /// Pixels [x0, x0 + n) of a row, n <= kFitBlock.
  /// @param row   (n_lights, width, 3)
  /// @param line  (n_planes, width): the codes of the row
  void fit(const PlaneWriter& writer, const std::uint16_t* row, std::size_t width,
           std::size_t x0, std::size_t n, Work& work, std::uint16_t* line) const {
    if (colour_ == ReflectanceColour::rgb) {
      fit_channels(writer, row, width, x0, n, work, line);
      return;
    }
    for (std::size_t l = 0; l < n_lights_; ++l) {
      float* r = work.in.data() + l * 3 * kFitBlock;
      split_codes(row + (l * width + x0) * 3, n, r, r + kFitBlock, r + 2 * kFitBlock);
    }
    if (colour_ == ReflectanceColour::pca) {
      matrix_.multiply(work.in.data(), kFitBlock, kFitBlock, work.out.data(), kFitBlock);
    } else {
      split_luminance(work);
    }
    for (std::size_t p = 0; p < codes_.size(); ++p) {
      writer.encode(p, {work.out.data() + p * kFitBlock, n}, added_[p], line + p * width + x0);
    }
  }

 private:
  /// One matrix for all channels: they stay interleaved until their planes are computed.
  void fit_channels(const PlaneWriter& writer, const std::uint16_t* row, std::size_t width,
                    std::size_t x0, std::size_t n, Work& work, std::uint16_t* line) const {
    constexpr std::size_t kValues = 3 * kFitBlock;
    // Past the row's last pixel lies the next row, or the band's margin.
    matrix_.multiply(row + 3 * x0, 3 * width, kValues, work.out.data(), kValues);
    const std::size_t n_terms = matrix_.n_out();
    for (std::size_t t = 0; t < n_terms; ++t) {
      writer.encode_threes(t, n_terms, {work.out.data() + t * kValues, 3 * n}, added_[t],
                           line + t * width + x0);
    }
  }

  /// The pixel's colour k is the sum over its lights, scaled so that the largest channel is 1;
  /// each light's factor y is the least-squares one: (v . k) / (k . k). A pixel that is black
  /// under every light keeps k = 0 and y = 0.
  void split_luminance(Work& work) const {
    const std::size_t n_terms = matrix_.n_out();
    std::array<std::array<float, kFitBlock>, 3> k{};
    std::array<std::array<float, kFitBlock>, 3> towards{};
    for (std::size_t l = 0; l < n_lights_; ++l) {
      for (std::size_t c = 0; c < 3; ++c) {
        const float* v = work.in.data() + (l * 3 + c) * kFitBlock;
        for (std::size_t x = 0; x < kFitBlock; ++x) {
          k[c][x] += v[x];
        }
      }
    }
    for (std::size_t x = 0; x < kFitBlock; ++x) {
      const float most = std::max({k[0][x], k[1][x], k[2][x]});
      const float scale = most > 0.0F ? 1.0F / most : 0.0F;
      float norm = 0.0F;
      for (std::size_t c = 0; c < 3; ++c) {
        k[c][x] *= scale;
        norm += k[c][x] * k[c][x];
      }
      for (std::size_t c = 0; c < 3; ++c) {
        towards[c][x] = norm > 0.0F ? k[c][x] / norm : 0.0F;
      }
    }
    for (std::size_t l = 0; l < n_lights_; ++l) {
      const float* v = work.in.data() + l * 3 * kFitBlock;
      float* y = work.factors.data() + l * kFitBlock;
      for (std::size_t x = 0; x < kFitBlock; ++x) {
        y[x] = v[x] * towards[0][x] + v[kFitBlock + x] * towards[1][x] +
               v[2 * kFitBlock + x] * towards[2][x];
      }
    }
    matrix_.multiply(work.factors.data(), kFitBlock, kFitBlock, work.out.data(), kFitBlock);
    for (std::size_t c = 0; c < 3; ++c) {
      std::copy(k[c].begin(), k[c].end(),
                work.out.begin() + static_cast<std::ptrdiff_t>((n_terms + c) * kFitBlock));
    }
  }

  ReflectanceColour colour_;
  FitMatrix matrix_;
  std::size_t n_lights_;
  std::vector<PlaneCodes> codes_;
  std::vector<double> added_;
};

void require_shapes(const StackDims& shape, const FarFit& fit) {
  const Index n_in = fit.model.colour == ReflectanceColour::pca ? 3 * Index{shape.n_lights}
                                                                : Index{shape.n_lights};
  HAARLIGHT_EXPECTS(fit.matrix.cols() == n_in && fit.matrix.rows() == fit.model.n_terms &&
                        fit.added.size() == fit.matrix.rows(),
                    "a fit for these lights");
}

}  // namespace

Eigen::VectorXd planes_of(const FarFit& fit, const Eigen::VectorXd& values) {
  const Index n_lights = values.size() / 3;
  const Index n_terms = fit.matrix.rows();
  if (fit.model.colour == ReflectanceColour::pca) {
    return fit.matrix * values + fit.added;
  }
  const Eigen::Map<const Eigen::MatrixXd> by_channel(values.data(), 3, n_lights);
  if (fit.model.colour == ReflectanceColour::rgb) {
    Eigen::VectorXd planes(3 * n_terms);
    for (Index c = 0; c < 3; ++c) {
      planes.segment(c * n_terms, n_terms) =
          fit.matrix * by_channel.row(c).transpose() + fit.added;
    }
    return planes;
  }
  Eigen::Vector3d colour = by_channel.rowwise().sum();
  Eigen::VectorXd planes = Eigen::VectorXd::Zero(n_terms + 3);
  if (colour.maxCoeff() > 0.0) {
    colour /= colour.maxCoeff();
    planes.head(n_terms) =
        fit.matrix * (by_channel.transpose() * colour / colour.squaredNorm()) + fit.added;
    planes.tail(3) = colour;
  }
  return planes;
}

FitResult fit_far(PictureRows& rows, const FarFit& fit, const FarFitOptions& options) {
  const StackDims shape = rows.dims();
  require_shapes(shape, fit);
  const auto width = static_cast<std::size_t>(shape.width);
  const auto n_lights = static_cast<std::size_t>(shape.n_lights);
  const BlockFitter fitter(fit, n_lights);
  PlaneWriter writer(shape.width, shape.height, fitter.codes(), options.planes);
  const std::size_t n_planes = writer.n_planes();
  const std::size_t n_row = width * 3 * n_lights;
  const std::size_t band_rows =
      std::clamp<std::size_t>(kBandBytes / (n_row * sizeof(std::uint16_t)), 1, 64);
  PixelBand band(band_rows * n_row + 3 * kFitBlock);
  const std::size_t n_blocks = (width + kFitBlock - 1) / kFitBlock;
  const auto height = static_cast<std::size_t>(shape.height);
  Progress progress("fit", height, options.progress);
  rows.rewind();
  for (std::size_t y0 = 0; y0 < height; y0 += band_rows) {
    const std::size_t n = std::min(band_rows, height - y0);
    rows.read(static_cast<int>(n), band.codes().first(n * n_row));
    const std::span<std::uint16_t> lines = writer.next_rows(n);
    parallel_for(n * n_blocks, 16, [&](std::size_t begin, std::size_t end) {
      BlockFitter::Work work = fitter.make_work();
      for (std::size_t i = begin; i < end; ++i) {
        const std::size_t y = i / n_blocks;
        const std::size_t x0 = i % n_blocks * kFitBlock;
        fitter.fit(writer, &band.codes()[y * n_row], width, x0, std::min(kFitBlock, width - x0),
                   work, &lines[y * n_planes * width]);
      }
    });
    writer.append();
    progress.advance(n);
  }
  band = PixelBand();
  ReflectanceModel model = fit.model;
  model.transfer = rows.transfer();
  return writer.finish(std::move(model));
}

}  // namespace haarlight::relight
