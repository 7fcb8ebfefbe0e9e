// SPDX-License-Identifier: Apache-2.0
#include "relight/reflectance/fit/near_fit.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <span>
#include <string>
#include <utility>

#include <Eigen/Core>
#include <fmt/format.h>

#include "core/linear_algebra.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "relight/reflectance/fit/light_interpolation.h"
#include "relight/reflectance/fit/near_kernel.h"
#include "relight/reflectance/fit/pixel_band.h"

namespace haarlight::relight {

namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr std::size_t kBandBytes = std::size_t{48} << 20U;
/// A light that gives a pixel less than this fraction of its on-axis light is ignored there.
constexpr double kLeastLobe = 1e-3;
/// Grid nodes further apart than this fraction of the lights' distance are refused, and so are
/// longer linear segments between them: at 0.158 and 0.048 a picture 37 dB from the truth loses
/// up to 0.007 dB, at 0.21 and 0.083 up to 0.05 dB.
constexpr double kCoarsestCell = 0.16;
constexpr double kCoarsestStep = 0.05;
/// The same for the light nearest to the picture, relative to its height.
constexpr double kCoarsestOfNearest = 0.25;

/// Pixels that share one pass of an interpolated matrix through the caches.
constexpr std::size_t kSpan = 1024;
static_assert(kSpan % kNearBlock == 0 && kNearBlock % kNearStep == 0);

/// Cubics through this many grid nodes per axis.
constexpr std::size_t kTaps = 4;
static_assert(kNearChunk % kNearStep == 0);

/// Evenly spaced grid nodes along one side of the picture, including its borders.
struct GridNodes {
  std::size_t n = 0;
  double spacing = 1.0;  ///< pixels
  GridNodes(int n_pixels, int grid)
      : n(std::max<std::size_t>(kTaps,
                                static_cast<std::size_t>((n_pixels + grid - 1) / grid) + 1)),
        spacing(n_pixels / static_cast<double>(n - 1)) {}
  /// The first of the kTaps grid nodes around a position, in pixels.
  [[nodiscard]] std::size_t first_around(double position) const {
    const double cell = std::floor(position / spacing);
    return static_cast<std::size_t>(
        std::clamp(cell - 1.0, 0.0, static_cast<double>(n - kTaps)));
  }
  /// Lagrange weights of these grid nodes.
  [[nodiscard]] std::array<float, kTaps> weights_at(double position) const {
    const double s = position / spacing - static_cast<double>(first_around(position));
    std::array<float, kTaps> weights{};
    for (std::size_t i = 0; i < kTaps; ++i) {
      double weight = 1.0;
      for (std::size_t j = 0; j < kTaps; ++j) {
        if (j != i) {
          weight *=
              (s - static_cast<double>(j)) / (static_cast<double>(i) - static_cast<double>(j));
        }
      }
      weights[i] = static_cast<float>(weight);
    }
    return weights;
  }
};

/// All lights seen from one pixel.
struct LightsSeen {
  std::vector<Eigen::Vector3d> directions;  ///< picture frame
  VectorXd gains;                           ///< 0: ignored
};

double reference_of(const NearGeometry& geometry, const StackDims& shape) {
  if (geometry.reference_mm > 0.0) {
    return geometry.reference_mm;
  }
  const Eigen::Vector3d middle = geometry.points.at(0.5 * shape.width, 0.5 * shape.height);
  double sum = 0.0;
  for (const NearLight& light : geometry.lights) {
    sum += (light.position_mm - middle).norm();
  }
  return sum / static_cast<double>(geometry.lights.size());
}

/// Normalises a light's values to one power at the reference distance; the colours of lights
/// are kept.
double scale_of(const NearLight& light, double reference_mm) {
  return 1.0 / (reference_mm * reference_mm * light.power.mean());
}

LightsSeen lights_seen(const NearGeometry& geometry, double reference_mm,
                       const Eigen::Vector3d& point) {
  LightsSeen seen;
  seen.gains.resize(static_cast<Index>(geometry.lights.size()));
  for (std::size_t i = 0; i < geometry.lights.size(); ++i) {
    const NearLight& light = geometry.lights[i];
    const Eigen::Vector3d way = light.position_mm - point;
    const double r = way.norm();
    if (r == 0.0) {  // at the point itself: no direction
      seen.gains[static_cast<Index>(i)] = 0.0;
      seen.directions.emplace_back(Eigen::Vector3d::UnitZ());
      continue;
    }
    const double cosine = -light.axis.dot(way) / r;
    double lobe = 1.0;
    if (light.mu != 0.0) {
      lobe = cosine > 0.0 ? std::pow(cosine, light.mu) : 0.0;
    }
    seen.gains[static_cast<Index>(i)] =
        lobe > kLeastLobe ? scale_of(light, reference_mm) * r * r / lobe : 0.0;
    seen.directions.emplace_back(geometry.points.picture_from_world() * way / r);
  }
  return seen;
}

VectorXd ridge_diagonal(const NearFitOptions& options, std::size_t n_lights) {
  return static_cast<double>(n_lights) * options.ridge *
             ridge_shape(options.basis, options.n_terms).array() +
         1e-12;
}

/// The fit's matrix at a pixel, (n_terms, n_lights), without gains: coefficients = matrix *
/// (gain * value). Ignored lights have zero columns.
MatrixXd matrix_at(const NearFitOptions& options, const LightsSeen& seen) {
  MatrixXd terms = terms_of(options.basis, options.n_terms, seen.directions);
  for (Index i = 0; i < terms.rows(); ++i) {
    if (seen.gains[i] == 0.0) {
      terms.row(i).setZero();
    }
  }
  MatrixXd normal = terms.transpose() * terms;
  normal.diagonal() += ridge_diagonal(options, seen.directions.size());
  return solve_symmetric(normal, MatrixXd(terms.transpose()));
}

/// Linear and cubic interpolation between grid nodes must suffice for every light.
void require_fine_grid(const NearGeometry& geometry, const StackDims& shape, int grid,
                       double reference) {
  const GridNodes across(shape.width, grid);
  const GridNodes down(shape.height, grid);
  const Eigen::Vector3d middle = geometry.points.at(0.5 * shape.width, 0.5 * shape.height);
  const auto length_of = [&](double pixels) {
    const double x = 0.5 * shape.width + pixels;
    return (geometry.points.at(x, 0.5 * shape.height) - middle).norm();
  };
  const double pixels = std::max(across.spacing, down.spacing);
  const double cell = length_of(pixels);
  const auto refuse = [&](const std::string& which, double distance) {
    throw Error(fmt::format("{:.0f} pixels are {:.0f} mm, {} {:.0f} mm away: too coarse to "
                            "interpolate between",
                            pixels, cell, which, distance),
                "the picture", "fit it with --near exact", ExitCode::usage);
  };
  if (cell > kCoarsestCell * reference ||
      length_of(static_cast<double>(kNearStep)) > kCoarsestStep * reference) {
    refuse("the lights", reference);
  }
  for (std::size_t i = 0; i < geometry.lights.size(); ++i) {
    double nearest = std::numeric_limits<double>::infinity();
    for (std::size_t y = 0; y < down.n; ++y) {
      for (std::size_t x = 0; x < across.n; ++x) {
        const Eigen::Vector3d grid_node = geometry.points.at(
            static_cast<double>(x) * across.spacing, static_cast<double>(y) * down.spacing);
        nearest = std::min(nearest, (geometry.lights[i].position_mm - grid_node).norm());
      }
    }
    if (cell > kCoarsestOfNearest * nearest) {
      refuse(fmt::format("light {}", i), nearest);
    }
  }
}

void require_lights(const NearGeometry& geometry, const StackDims& shape,
                    const NearFitOptions& options) {
  HAARLIGHT_EXPECTS(static_cast<int>(geometry.lights.size()) == shape.n_lights,
                    "one position per light");
  HAARLIGHT_EXPECTS(
      options.basis == ReflectanceBasis::ptm || options.basis == ReflectanceBasis::hsh,
      "ptm or hsh");
  HAARLIGHT_EXPECTS(options.grid > 0, "pixels between grid nodes");
  const double reference = reference_of(geometry, shape);
  for (const double x : {0.0, 0.5, 1.0}) {
    for (const double y : {0.0, 0.5, 1.0}) {
      const Eigen::Vector3d point = geometry.points.at(x * shape.width, y * shape.height);
      for (std::size_t i = 0; i < geometry.lights.size(); ++i) {
        if ((geometry.lights[i].position_mm - point).norm() < 1e-6 * reference) {
          throw Error(fmt::format("light {} is at the pixel ({:.0f}, {:.0f}) itself", i,
                                  x * shape.width, y * shape.height),
                      "the lights' positions",
                      "look at the list of lights: positions are mm from the picture's middle");
        }
      }
    }
  }
  if (options.solve == NearSolve::interpolated) {
    require_fine_grid(geometry, shape, options.grid, reference);
  }
  const Eigen::Vector3d middle_point =
      geometry.points.at(0.5 * shape.width, 0.5 * shape.height);
  const LightsSeen middle = lights_seen(geometry, reference, middle_point);
  const TermsCondition condition =
      terms_condition(options.basis, options.n_terms, middle.directions);
  if (condition.rank < options.n_terms && options.ridge == 0.0) {
    throw Error(fmt::format("{} lights tell {} of {} terms apart", geometry.lights.size(),
                            condition.rank, options.n_terms),
                "the lights' positions",
                "choose a basis of fewer terms, or a ridge above 0, which takes the smoothest");
  }
}

/// Codes of a plane's coefficients: the range possible with the middle's matrix, with a margin.
std::vector<PlaneCodes> near_codes(const NearGeometry& geometry, const StackDims& shape,
                                   const NearFitOptions& options) {
  const LightsSeen seen =
      lights_seen(geometry, reference_of(geometry, shape),
                  geometry.points.at(0.5 * shape.width, 0.5 * shape.height));
  const MatrixXd matrix = matrix_at(options, seen);
  std::vector<PlaneCodes> codes;
  for (int p = 0; p < 3 * options.n_terms; ++p) {
    const auto row = matrix.row(p % options.n_terms);
    constexpr double kRoom = 2.0;  // corrected values exceed white, borders differ
    const double low = kRoom * row.cwiseMin(0.0).sum();
    const double high = kRoom * row.cwiseMax(0.0).sum();
    const double step = (high - low) / 65535.0;
    codes.push_back({low, step > 0.0 ? step : 1.0});
  }
  return codes;
}

/// A row of grid nodes or of positions between them: matrices in float, (n_lights, n_terms)
/// each.
using MatrixRow = std::vector<std::vector<float>>;

/// What the pixels of a row are interpolated from.
struct RowBetween {
  MatrixRow matrices;          ///< at every grid node's column
  std::vector<float> gains;    ///< (n_lights, n_places), every kNearBlock / 2 pixels from 0 on
  std::vector<char> is_rough;  ///< (n_lights): a parabola does not suffice somewhere
};

/// Everything that blocks of pixels share.
class NearFitter {
 public:
  NearFitter(const NearGeometry& geometry, const StackDims& shape,
             const NearFitOptions& options)
      : geometry_(geometry),
        options_(options),
        shape_(shape),
        reference_(reference_of(geometry, shape)),
        ridge_(ridge_diagonal(options, geometry.lights.size())),
        form_{options.basis, options.n_terms, options.transfer == Transfer::srgb},
        n_terms_(static_cast<std::size_t>(options.n_terms)),
        across_(shape.width, options.grid),
        down_(shape.height, options.grid) {
    const Eigen::Matrix3d& turn = geometry.points.picture_from_world();
    for (const NearLight& light : geometry.lights) {
      const Eigen::Vector3f at = (turn * light.position_mm).cast<float>();
      const Eigen::Vector3f axis = (turn * light.axis).cast<float>();
      sources_.push_back({at.x(),
                          at.y(),
                          at.z(),
                          {axis.x(), axis.y(), axis.z()},
                          static_cast<float>(light.mu),
                          static_cast<float>(scale_of(light, reference_) / kWhite)});
    }
  }

  struct Work {
    // Exact: (kNearChunk, n_padded + 3, kNearBlock); (kSpan / kNearBlock, n_padded, n_padded +
    // 3, kNearBlock).
    std::vector<float> columns;
    std::vector<float> sums;
    // Interpolated.
    std::vector<float> values;  ///< (kNearChunk, 3, kNearBlock)
    std::vector<float> nodes;   ///< (kSpan / kNearStep + 1, kNearChunk, n_terms)
    std::vector<float> steps;   ///< from node to node
    std::vector<float> gains;   ///< (kNearBlock)
    // Both: (kSpan / kNearBlock, n_planes, kNearBlock).
    std::vector<float> planes;
  };
  [[nodiscard]] Work make_work() const {
    Work work;
    if (options_.solve == NearSolve::exact) {
      const std::size_t n_padded = near_terms_padded(options_.n_terms);
      work.columns.resize(kNearChunk * (n_padded + 3) * kNearBlock);
      work.sums.resize(n_padded * (n_padded + 3) * n_blocks_from(0) * kNearBlock);
    } else {
      work.values.resize(kNearChunk * 3 * kNearBlock);
      work.nodes.resize((kSpan / kNearStep + 1) * kNearChunk * n_terms_);
      work.steps.resize(kSpan / kNearStep * kNearChunk * n_terms_);
      work.gains.resize(kNearBlock);
    }
    work.planes.resize(3 * n_terms_ * kSpan);
    return work;
  }
  /// The planes of a block of kNearBlock pixels in the work, (n_planes, kNearBlock).
  [[nodiscard]] float* planes_of_block(Work& work, std::size_t i_block) const {
    return work.planes.data() + i_block * 3 * n_terms_ * kNearBlock;
  }

  /// kSpan pixels from x0; those beyond the picture's width are meaningless.
  /// @param row  (n_lights, width, 3) and a margin of 3 * kNearBlock
  void fit_exact(const std::uint16_t* row, std::size_t y, std::size_t x0, Work& work) const {
    const std::size_t n_padded = near_terms_padded(options_.n_terms);
    const std::size_t n_columns = n_padded + 3;
    const std::size_t n_sums = n_padded * n_columns * kNearBlock;
    const std::size_t n_blocks = n_blocks_from(x0);
    std::array<NearBlock, kSpan / kNearBlock> blocks;
    for (std::size_t i = 0; i < n_blocks; ++i) {
      blocks[i] = block_at(x0 + i * kNearBlock, y);
    }
    std::fill(work.sums.begin(), work.sums.end(), 0.0F);
    for (std::size_t first = 0; first < sources_.size(); first += kNearChunk) {
      const std::size_t n_chunk = std::min(kNearChunk, sources_.size() - first);
      for (std::size_t i = 0; i < n_blocks; ++i) {
        for (std::size_t l = 0; l < n_chunk; ++l) {
          fetch_ahead(row, first + l, x0, i, n_blocks);
          near_columns(form_, sources_[first + l], blocks[i],
                       codes_of(row, first + l, x0 + i * kNearBlock),
                       work.columns.data() + l * n_columns * kNearBlock);
        }
        add_near_products(work.columns.data(), n_chunk, n_padded,
                          work.sums.data() + i * n_sums);
      }
    }
    for (std::size_t i = 0; i < n_blocks; ++i) {
      solve_near(work.sums.data() + i * n_sums, ridge_.data(), options_.n_terms,
                 planes_of_block(work, i));
    }
  }

  /// Rows of the picture that lie among the same kTaps rows of grid nodes as row y.
  [[nodiscard]] std::size_t n_rows_alike(std::size_t y) const {
    const std::size_t first = first_node_row(y);
    std::size_t n = 1;
    while (y + n < static_cast<std::size_t>(shape_.height) && first_node_row(y + n) == first) {
      ++n;
    }
    return n;
  }
  /// The first of the rows of grid nodes that a row of pixels needs.
  [[nodiscard]] std::size_t first_node_row(std::size_t y) const {
    return down_.first_around(static_cast<double>(y) + 0.5);
  }

  /// The matrices of a row of grid nodes.
  [[nodiscard]] MatrixRow make_grid_nodes(std::size_t row) const {
    MatrixRow grid_nodes(across_.n);
    parallel_for(across_.n, 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        const LightsSeen seen =
            lights_seen(geometry_, reference_,
                        geometry_.points.at(static_cast<double>(i) * across_.spacing,
                                            static_cast<double>(row) * down_.spacing));
        const Eigen::MatrixXf values = matrix_at(options_, seen).cast<float>();
        grid_nodes[i].resize(n_padded_numbers());
        std::copy_n(values.data(), values.size(), grid_nodes[i].begin());
      }
    });
    return grid_nodes;
  }

  /// Rows interpolated from the rows of grid nodes around them. @param grid_nodes  kTaps rows
  /// from first_node_row(y0)
  void between_rows(const std::vector<MatrixRow>& grid_nodes, std::size_t y0,
                    std::span<RowBetween> rows) const {
    for (RowBetween& row : rows) {
      row.matrices.resize(across_.n, std::vector<float>(n_padded_numbers()));
    }
    parallel_for(across_.n, 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        mix_column(grid_nodes, i, y0, rows);
      }
    });
    parallel_for(rows.size(), 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t k = begin; k < end; ++k) {
        make_gains(y0 + k, rows[k]);
      }
    });
  }

  /// As fit_exact. @param between  between_rows of this row
  void fit_interpolated(const std::uint16_t* row, const RowBetween& between, std::size_t y,
                        std::size_t x0, Work& work) const {
    const std::size_t n_blocks = n_blocks_from(x0);
    const auto width = static_cast<std::size_t>(shape_.width);
    std::fill(work.planes.begin(), work.planes.end(), 0.0F);
    for (std::size_t first = 0; first < sources_.size(); first += kNearChunk) {
      const std::size_t n_chunk = std::min(kNearChunk, sources_.size() - first);
      make_nodes(between.matrices, first, x0, work);
      for (std::size_t i = 0; i < n_blocks; ++i) {
        const std::size_t x = x0 + i * kNearBlock;
        for (std::size_t l = 0; l < n_chunk; ++l) {
          fetch_ahead(row, first + l, x0, i, n_blocks);
        }
        const float* gains = &between.gains[first * n_positions() + 2 * x / kNearBlock];
        bent_near_values(gains, n_positions(), codes_of(row, first, x), 3 * width, n_chunk,
                         form_.is_coded, work.values.data());
        for (std::size_t l = 0; l < n_chunk; ++l) {
          if (between.is_rough[first + l] != 0 &&
              has_rough_gains(gains + l * n_positions(), 1)) {
            near_gains(sources_[first + l], block_at(x, y), work.gains.data());
            near_values(work.gains.data(), codes_of(row, first + l, x), form_.is_coded,
                        work.values.data() + l * 3 * kNearBlock);
          }
        }
        constexpr std::size_t kSteps = kNearBlock / kNearStep;
        for (std::size_t s = 0; s < kSteps; ++s) {
          const std::size_t at = (i * kSteps + s) * kNearChunk * n_terms_;
          add_near_between(work.nodes.data() + at, work.steps.data() + at, options_.n_terms,
                           n_chunk, work.values.data() + s * kNearStep,
                           planes_of_block(work, i) + s * kNearStep);
        }
      }
    }
  }

 private:
  static constexpr double kWhite = 65535.0;

  /// Blocks of a span that begin within the picture.
  [[nodiscard]] std::size_t n_blocks_from(std::size_t x0) const {
    const std::size_t n = std::min(kSpan, static_cast<std::size_t>(shape_.width) - x0);
    return (n + kNearBlock - 1) / kNearBlock;
  }
  /// Positions along a row at which gains are known, including the last block's end.
  [[nodiscard]] std::size_t n_positions() const {
    return 2 * ((static_cast<std::size_t>(shape_.width) + kNearBlock - 1) / kNearBlock) + 1;
  }
  /// Numbers of all lights' terms at one position, in whole chunks.
  [[nodiscard]] std::size_t n_padded_numbers() const {
    return (sources_.size() + kNearChunk - 1) / kNearChunk * kNearChunk * n_terms_;
  }

  [[nodiscard]] const std::uint16_t* codes_of(const std::uint16_t* row, std::size_t light,
                                              std::size_t x) const {
    return row + (light * static_cast<std::size_t>(shape_.width) + x) * 3;
  }
  /// Prefetches the codes needed after block i of a span, chunk by chunk: each light's lie
  /// elsewhere in memory. A no-op past the end of the band.
  void fetch_ahead(const std::uint16_t* row, std::size_t light, std::size_t x0, std::size_t i,
                   std::size_t n_blocks) const {
    const std::size_t soon = i + 1;
    const std::uint16_t* codes =
        soon < n_blocks
            ? codes_of(row, light, x0 + soon * kNearBlock)
            : codes_of(row, light + kNearChunk, x0 + (soon - n_blocks) * kNearBlock);
    constexpr std::size_t kLine = 64 / sizeof(std::uint16_t);
    for (std::size_t k = 0; k < 3 * kNearBlock; k += kLine) {
      __builtin_prefetch(codes + k);
    }
  }

  /// Cubics down a column of grid nodes: its matrices at some rows, a few lights at a time, so
  /// that those of the grid nodes are read once.
  void mix_column(const std::vector<MatrixRow>& grid_nodes, std::size_t column, std::size_t y0,
                  std::span<RowBetween> rows) const {
    const std::size_t n = kNearChunk * n_terms_;
    for (std::size_t first = 0; first < n_padded_numbers(); first += n) {
      std::array<const float*, kTaps> from{};
      for (std::size_t k = 0; k < kTaps; ++k) {
        from[k] = grid_nodes[k][column].data() + first;
      }
      for (std::size_t y = 0; y < rows.size(); ++y) {
        mix_near(from, down_.weights_at(static_cast<double>(y0 + y) + 0.5), n,
                 rows[y].matrices[column].data() + first);
      }
    }
  }

  /// Each light's gains along a row.
  void make_gains(std::size_t y, RowBetween& row) const {
    row.gains.resize(sources_.size() * n_positions());
    row.is_rough.resize(sources_.size());
    std::array<float, kNearBlock> gains{};
    for (std::size_t first = 0; first < n_positions(); first += kNearBlock) {
      NearBlock positions;
      constexpr std::size_t kStep = kNearBlock / 2;
      for (std::size_t k = 0; k < kNearBlock; ++k) {
        put(positions, k, static_cast<double>((first + k) * kStep),
            static_cast<double>(y) + 0.5);
      }
      for (std::size_t l = 0; l < sources_.size(); ++l) {
        near_gains(sources_[l], positions, gains.data());
        std::copy_n(gains.begin(), std::min(kNearBlock, n_positions() - first),
                    row.gains.begin() + static_cast<std::ptrdiff_t>(l * n_positions() + first));
      }
    }
    for (std::size_t l = 0; l < sources_.size(); ++l) {
      const bool is_rough =
          has_rough_gains(&row.gains[l * n_positions()], (n_positions() - 1) / 2);
      row.is_rough[l] = static_cast<char>(is_rough);
    }
  }

  /// Cubics along the row: the chunk's matrices every kNearStep pixels, and their steps.
  void make_nodes(const MatrixRow& matrices, std::size_t first_light, std::size_t x0,
                  Work& work) const {
    const std::size_t stride = kNearChunk * n_terms_;
    for (std::size_t s = 0; s <= n_blocks_from(x0) * kNearBlock / kNearStep; ++s) {
      // The last step may end beyond the picture: the cubic is extrapolated.
      const auto position = static_cast<double>(x0 + s * kNearStep);
      const std::size_t first = across_.first_around(position);
      std::array<const float*, kTaps> from{};
      for (std::size_t k = 0; k < kTaps; ++k) {
        from[k] = matrices[first + k].data() + first_light * n_terms_;
      }
      float* node = work.nodes.data() + s * stride;
      mix_near(from, across_.weights_at(position), stride, node);
      if (s > 0) {
        subtract_near(node, node - stride, stride, work.steps.data() + (s - 1) * stride);
      }
    }
  }

  [[nodiscard]] NearBlock block_at(std::size_t x0, std::size_t y) const {
    NearBlock block;
    for (std::size_t k = 0; k < kNearBlock; ++k) {
      // Beyond the picture's last column the block repeats it.
      const std::size_t x = std::min(x0 + k, static_cast<std::size_t>(shape_.width) - 1);
      put(block, k, static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5);
    }
    return block;
  }
  /// Stores the point seen at (x, y) of the picture as the block's k-th.
  void put(NearBlock& block, std::size_t k, double x, double y) const {
    const Eigen::Vector3f at =
        (geometry_.points.picture_from_world() * geometry_.points.at(x, y)).cast<float>();
    block.x[k] = at.x();
    block.y[k] = at.y();
    block.z[k] = at.z();
  }

  const NearGeometry& geometry_;
  const NearFitOptions& options_;
  StackDims shape_;
  double reference_;
  VectorXd ridge_;
  NearForm form_;
  std::size_t n_terms_;
  GridNodes across_;
  GridNodes down_;
  std::vector<NearSource> sources_;
};

/// The rows of grid nodes around a row of pixels, from top to bottom.
class GridNodeRows {
 public:
  explicit GridNodeRows(const NearFitter& fitter) : fitter_(fitter) {}
  /// kTaps rows of grid nodes.
  const std::vector<MatrixRow>& around(std::size_t y) {
    const std::size_t first = fitter_.first_node_row(y);
    const std::size_t known = first_ + rows_.size();
    const std::size_t past = std::min(first - first_, rows_.size());
    rows_.erase(rows_.begin(), rows_.begin() + static_cast<std::ptrdiff_t>(past));
    for (std::size_t row = std::max(first, known); row < first + kTaps; ++row) {
      rows_.push_back(fitter_.make_grid_nodes(row));
    }
    first_ = first;
    return rows_;
  }

 private:
  const NearFitter& fitter_;
  std::vector<MatrixRow> rows_;
  std::size_t first_ = 0;
};

}  // namespace

VectorXd near_planes_of(const NearGeometry& geometry, const NearFitOptions& options,
                        const VectorXd& values, double x, double y) {
  HAARLIGHT_EXPECTS(geometry.reference_mm > 0.0, "a reference distance");
  const LightsSeen seen =
      lights_seen(geometry, geometry.reference_mm, geometry.points.at(x, y));
  const MatrixXd matrix = matrix_at(options, seen);
  const Index n = options.n_terms;
  VectorXd planes(3 * n);
  for (Index c = 0; c < 3; ++c) {
    VectorXd v(seen.gains.size());
    for (Index i = 0; i < v.size(); ++i) {
      v[i] = values[3 * i + c] * seen.gains[i];
      if (options.transfer == Transfer::srgb) {
        v[i] = static_cast<double>(srgb_from_linear(static_cast<float>(v[i])));
      }
    }
    planes.segment(c * n, n) = matrix * v;
  }
  return planes;
}

FitResult fit_near(PictureRows& rows, const NearGeometry& geometry,
                   const NearFitOptions& options) {
  const StackDims shape = rows.dims();
  HAARLIGHT_EXPECTS(rows.transfer() == Transfer::linear, "linear rows");
  require_lights(geometry, shape, options);
  const NearFitter fitter(geometry, shape, options);
  PlaneWriter writer(shape.width, shape.height, near_codes(geometry, shape, options),
                     options.planes);
  const auto width = static_cast<std::size_t>(shape.width);
  const auto height = static_cast<std::size_t>(shape.height);
  const auto n_lights = static_cast<std::size_t>(shape.n_lights);
  const std::size_t n_planes = writer.n_planes();
  const std::size_t n_row = width * 3 * n_lights;
  const std::size_t most_rows =
      std::clamp<std::size_t>(kBandBytes / (n_row * sizeof(std::uint16_t)), 1, 64);
  PixelBand band(most_rows * n_row + 3 * kNearBlock);
  const std::size_t n_blocks = (width + kSpan - 1) / kSpan;
  const bool is_exact = options.solve == NearSolve::exact;
  GridNodeRows grid_nodes(fitter);
  std::vector<RowBetween> between(is_exact ? 0 : most_rows);
  Progress progress("fit", height, options.progress);
  rows.rewind();
  for (std::size_t y0 = 0; y0 < height;) {
    std::size_t n = std::min(most_rows, height - y0);
    if (!is_exact) {
      n = std::min(n, fitter.n_rows_alike(y0));
      fitter.between_rows(grid_nodes.around(y0), y0, std::span(between).first(n));
    }
    rows.read(static_cast<int>(n), band.codes().first(n * n_row));
    const std::span<std::uint16_t> lines = writer.next_rows(n);
    parallel_for(n * n_blocks, 1, [&](std::size_t begin, std::size_t end) {
      NearFitter::Work work = fitter.make_work();
      for (std::size_t i = begin; i < end; ++i) {
        const std::size_t y = i / n_blocks;
        const std::size_t x0 = i % n_blocks * kSpan;
        const std::uint16_t* row = &band.codes()[y * n_row];
        if (is_exact) {
          fitter.fit_exact(row, y0 + y, x0, work);
        } else {
          fitter.fit_interpolated(row, between[y], y0 + y, x0, work);
        }
        for (std::size_t p = 0; p < n_planes; ++p) {
          for (std::size_t x = x0; x < std::min(x0 + kSpan, width); x += kNearBlock) {
            const float* planes = fitter.planes_of_block(work, (x - x0) / kNearBlock);
            writer.encode(p, {planes + p * kNearBlock, std::min(kNearBlock, width - x)}, 0.0,
                          &lines[(y * n_planes + p) * width + x]);
          }
        }
      }
    });
    writer.append();
    progress.advance(n);
    y0 += n;
  }
  ReflectanceModel model;
  model.basis = options.basis;
  model.n_terms = options.n_terms;
  model.transfer = options.transfer;
  return writer.finish(std::move(model));
}

}  // namespace haarlight::relight
