#include "relight/fit/near_fit.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include <Eigen/Dense>
#include <fmt/format.h>

#include "core/error.h"
#include "core/parallel.h"
#include "relight/fit/fit_kernel.h"
#include "relight/fit/light_recipe.h"
#include "relight/fit/near_kernel.h"
#include "relight/fit/transfer_table.h"

namespace haarlight {

namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr std::size_t kBandBytes = std::size_t{48} << 20U;
/// A light that gives less than this share of its axis' light says nothing of a pixel.
constexpr double kLeastLobe = 1e-3;
/// Knots further apart than this share of the lights' distance are refused: at 0.096 pictures
/// are 45.6 dB from the exact fit's, and the error grows with the square.
constexpr double kCoarsestCell = 0.05;

/// Of one pixel and all lights.
struct LightsSeen {
  std::vector<Eigen::Vector3d> directions;  ///< picture frame
  VectorXd gains;                           ///< 0: says nothing
};

double reference_of(const NearGeometry& geometry, const PictureShape& shape) {
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

/// Brings a light's values to one power at the reference distance; colours of light are left.
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
    const double cosine = -light.axis.dot(way) / r;
    double lobe = 1.0;
    if (light.mu != 0.0) {
      lobe = cosine > 0.0 ? std::pow(cosine, light.mu) : 0.0;
    }
    seen.gains[static_cast<Index>(i)] =
        lobe > kLeastLobe ? scale_of(light, reference_mm) * r * r / lobe : 0.0;
    seen.directions.push_back(geometry.points.picture_from_world() * way / r);
  }
  return seen;
}

VectorXd ridge_diagonal(const NearFitOptions& options, std::size_t n_lights) {
  return static_cast<double>(n_lights) * options.ridge *
             ridge_shape(options.basis, options.n_terms).array() +
         1e-12;
}

/// The fit's matrix at a pixel, (n_terms, n_lights), gains left out: coefficients = matrix *
/// (gain * value). Lights that say nothing have zero columns.
MatrixXd matrix_at(const NearFitOptions& options, const LightsSeen& seen) {
  MatrixXd terms = terms_of(options.basis, options.n_terms, seen.directions);
  for (Index i = 0; i < terms.rows(); ++i) {
    if (seen.gains[i] == 0.0) {
      terms.row(i).setZero();
    }
  }
  MatrixXd normal = terms.transpose() * terms;
  normal.diagonal() += ridge_diagonal(options, seen.directions.size());
  return normal.ldlt().solve(terms.transpose());
}

void require_lights(const NearGeometry& geometry, const PictureShape& shape,
                    const NearFitOptions& options) {
  HAARLIGHT_EXPECTS(static_cast<int>(geometry.lights.size()) == shape.n_lights,
                    "one place a light");
  HAARLIGHT_EXPECTS(
      options.basis == ReflectanceBasis::ptm || options.basis == ReflectanceBasis::hsh,
      "ptm or hsh");
  HAARLIGHT_EXPECTS(options.grid > 0 && options.grid % static_cast<int>(kFitBlock) == 0,
                    "whole blocks between knots");
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
  const Eigen::Vector3d middle_point =
      geometry.points.at(0.5 * shape.width, 0.5 * shape.height);
  const double cell =
      (geometry.points.at(0.5 * shape.width + options.grid, 0.5 * shape.height) - middle_point)
          .norm();
  if (options.solve == NearSolve::interpolated && cell > kCoarsestCell * reference) {
    throw Error(fmt::format("{} pixels are {:.0f} mm, the lights {:.0f} mm away: too coarse to "
                            "interpolate between",
                            options.grid, cell, reference),
                "the picture", "fit it with --near exact", ExitCode::usage);
  }
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

/// Codes of a plane's coefficients: what the middle's matrix could give at most, with room.
std::vector<PlaneCodes> near_codes(const NearGeometry& geometry, const PictureShape& shape,
                                   const NearFitOptions& options) {
  const LightsSeen seen =
      lights_seen(geometry, reference_of(geometry, shape),
                  geometry.points.at(0.5 * shape.width, 0.5 * shape.height));
  const MatrixXd matrix = matrix_at(options, seen);
  std::vector<PlaneCodes> codes;
  for (int p = 0; p < 3 * options.n_terms; ++p) {
    const auto row = matrix.row(p % options.n_terms);
    constexpr double kRoom = 2.0;  // corrected values go beyond white, borders differ
    const double low = kRoom * row.cwiseMin(0.0).sum();
    const double high = kRoom * row.cwiseMax(0.0).sum();
    const double step = (high - low) / 65535.0;
    codes.push_back({low, step > 0.0 ? step : 1.0});
  }
  return codes;
}

/// Everything that blocks of pixels share.
class NearFitter {
 public:
  NearFitter(const NearGeometry& geometry, const PictureShape& shape,
             const NearFitOptions& options)
      : geometry_(geometry),
        options_(options),
        shape_(shape),
        reference_(reference_of(geometry, shape)),
        ridge_(ridge_diagonal(options, geometry.lights.size())),
        table_(options.transfer) {
    const Eigen::Matrix3d& turn = geometry.points.picture_from_world();
    for (const NearLight& light : geometry.lights) {
      const Eigen::Vector3f at = (turn * light.position_mm).cast<float>();
      const Eigen::Vector3f axis = (turn * light.axis).cast<float>();
      sources_.push_back({at.x(),
                          at.y(),
                          at.z(),
                          {axis.x(), axis.y(), axis.z()},
                          static_cast<float>(light.mu),
                          static_cast<float>(scale_of(light, reference_))});
    }
  }

  struct Work {
    std::vector<float> in;       ///< (n_lights, 3, 64)
    std::vector<float> columns;  ///< (kNearChunk, n_padded + 3, 64)
    std::vector<float> sums;
    std::vector<float> planes;  ///< (n_planes, 64)
    std::vector<float> gain;
    FitMatrix matrix;
  };
  [[nodiscard]] Work make_work() const {
    const std::size_t n_padded = near_terms_padded(options_.n_terms);
    const auto n_terms = static_cast<std::size_t>(options_.n_terms);
    return {std::vector<float>(sources_.size() * 3 * kFitBlock),
            std::vector<float>(kNearChunk * (n_padded + 3) * kNearBlock),
            std::vector<float>(std::max(n_padded * (n_padded + 3) * kNearBlock,
                                        fit_rows_padded(2 * n_terms) * 3 * kFitBlock)),
            std::vector<float>(3 * n_terms * kFitBlock),
            std::vector<float>(kNearBlock),
            {}};
  }

  /// @param row  (n_lights, width, 3)
  void fit_exact(const std::uint16_t* row, std::size_t y, std::size_t x0, std::size_t n,
                 Work& work) const {
    const std::size_t n_padded = near_terms_padded(options_.n_terms);
    const std::size_t n_columns = n_padded + 3;
    const NearBlock block = block_at(x0, y);
    std::fill(work.sums.begin(), work.sums.end(), 0.0F);
    const auto width = static_cast<std::size_t>(shape_.width);
    for (std::size_t first = 0; first < sources_.size(); first += kNearChunk) {
      const std::size_t n_chunk = std::min(kNearChunk, sources_.size() - first);
      for (std::size_t l = 0; l < n_chunk; ++l) {
        float* columns = work.columns.data() + l * n_columns * kNearBlock;
        near_terms(options_.basis, options_.n_terms, sources_[first + l], block, columns,
                   work.gain.data());
        float* values = columns + n_padded * kNearBlock;
        split_codes(row + ((first + l) * width + x0) * 3, n, values, values + kNearBlock,
                    values + 2 * kNearBlock);
        for (std::size_t c = 0; c < 3; ++c) {
          table_.code(values + c * kNearBlock, work.gain.data(), kNearBlock);
        }
      }
      add_near_products(work.columns.data(), n_chunk, n_padded, work.sums.data());
    }
    for (std::size_t x = 0; x < n; ++x) {
      solve_pixel(work, x);
    }
  }

  /// A knot's matrix; gains are in it where values are fitted as they are.
  [[nodiscard]] MatrixXd matrix_of_knot(int column, int row) const {
    const LightsSeen seen =
        lights_seen(geometry_, reference_,
                    geometry_.points.at(static_cast<double>(column) * options_.grid,
                                        static_cast<double>(row) * options_.grid));
    MatrixXd matrix = matrix_at(options_, seen);
    if (options_.transfer == Transfer::linear) {
      matrix = matrix * seen.gains.asDiagonal();
    }
    return matrix;
  }

  /// Between two columns of knots: `work.matrix` holds the left one's and the difference to the
  /// right one's, at this row.
  /// @param t0, t1  of the first pixel and the step, 0 at the left knots, 1 at the right ones
  void fit_interpolated(const std::uint16_t* row, std::size_t y, std::size_t x0, std::size_t n,
                        float t0, float t1, Work& work) const {
    constexpr std::size_t kValues = 3 * kFitBlock;
    const auto width = static_cast<std::size_t>(shape_.width);
    const bool is_coded = options_.transfer != Transfer::linear;
    const NearBlock block = is_coded ? block_at(x0, y) : NearBlock{};
    for (std::size_t l = 0; l < sources_.size(); ++l) {
      float* values = work.in.data() + l * kValues;
      const std::uint16_t* codes = row + (l * width + x0) * 3;
      if (!is_coded) {
        widen_codes(codes, 3 * n, values);
        continue;
      }
      near_gain(sources_[l], block, work.gain.data());
      split_codes(codes, n, values, values + kFitBlock, values + 2 * kFitBlock);
      for (std::size_t c = 0; c < 3; ++c) {
        table_.code(values + c * kFitBlock, work.gain.data(), kFitBlock);
      }
    }
    work.matrix.multiply(work.in.data(), kValues, kValues, work.sums.data(), kValues);
    const auto n_terms = static_cast<std::size_t>(options_.n_terms);
    for (std::size_t t = 0; t < n_terms; ++t) {
      const float* left = work.sums.data() + t * kValues;
      const float* difference = left + n_terms * kValues;
      for (std::size_t c = 0; c < 3; ++c) {
        float* to = work.planes.data() + (c * n_terms + t) * kFitBlock;
        for (std::size_t x = 0; x < kFitBlock; ++x) {
          const std::size_t at = is_coded ? c * kFitBlock + x : 3 * x + c;
          to[x] = left[at] + (t0 + t1 * static_cast<float>(x)) * difference[at];
        }
      }
    }
  }

 private:
  [[nodiscard]] NearBlock block_at(std::size_t x0, std::size_t y) const {
    NearBlock block;
    for (std::size_t k = 0; k < kNearBlock; ++k) {
      // Beyond the picture's last column the block repeats it.
      const std::size_t x = std::min(x0 + k, static_cast<std::size_t>(shape_.width) - 1);
      const Eigen::Vector3f at =
          (geometry_.points.picture_from_world() *
           geometry_.points.at(static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5))
              .cast<float>();
      block.x[k] = at.x();
      block.y[k] = at.y();
      block.z[k] = at.z();
    }
    return block;
  }

  /// The normal equations of one pixel, in double.
  void solve_pixel(Work& work, std::size_t x) const {
    constexpr int kMost = 16;
    const Index n = options_.n_terms;
    const std::size_t n_columns = near_terms_padded(options_.n_terms) + 3;
    const auto sum = [&](Index i, std::size_t j) {
      return static_cast<double>(
          work.sums[(static_cast<std::size_t>(i) * n_columns + j) * kNearBlock + x]);
    };
    Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kMost, kMost> normal(n, n);
    Eigen::Matrix<double, Eigen::Dynamic, 3, 0, kMost, 3> right(n, 3);
    for (Index i = 0; i < n; ++i) {
      for (Index j = i; j < n; ++j) {
        normal(j, i) = sum(i, static_cast<std::size_t>(j));
      }
      normal(i, i) += ridge_[i];
      for (std::size_t c = 0; c < 3; ++c) {
        right(i, static_cast<Index>(c)) = sum(i, n_columns - 3 + c);
      }
    }
    normal.template selfadjointView<Eigen::Lower>().ldlt().solveInPlace(right);
    for (Index c = 0; c < 3; ++c) {
      for (Index i = 0; i < n; ++i) {
        work.planes[static_cast<std::size_t>(c * n + i) * kFitBlock + x] =
            static_cast<float>(right(i, c));
      }
    }
  }

  const NearGeometry& geometry_;
  const NearFitOptions& options_;
  PictureShape shape_;
  double reference_;
  VectorXd ridge_;
  TransferTable table_;
  std::vector<NearSource> sources_;
};

/// The matrices of the cells between two rows of knots, left and difference to the right, at
/// the upper and at the lower row.
struct CellRow {
  std::vector<FitMatrix> upper;
  std::vector<FitMatrix> lower;
};

CellRow make_cells(const NearFitter& fitter, int row, std::size_t n_cells, int n_terms) {
  const std::size_t n_knots = n_cells + 1;
  std::vector<MatrixXd> knots(2 * n_knots);
  parallel_for(knots.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      knots[i] = fitter.matrix_of_knot(static_cast<int>(i % n_knots),
                                       row + static_cast<int>(i / n_knots));
    }
  });
  CellRow cells{std::vector<FitMatrix>(n_cells), std::vector<FitMatrix>(n_cells)};
  parallel_for(2 * n_cells, 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const std::size_t left = i / n_cells * n_knots + i % n_cells;
      MatrixXd pair(2 * n_terms, knots[left].cols());
      pair << knots[left], knots[left + 1] - knots[left];
      (i < n_cells ? cells.upper : cells.lower)[i % n_cells] = FitMatrix(pair);
    }
  });
  return cells;
}

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
  const PictureShape shape = rows.shape();
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
  const auto grid = static_cast<std::size_t>(options.grid);
  const std::size_t most_rows =
      std::clamp<std::size_t>(kBandBytes / (n_row * sizeof(std::uint16_t)), 1, 64);
  std::vector<std::uint16_t> band(most_rows * n_row);
  std::vector<std::uint16_t> lines(most_rows * n_planes * width);
  const std::size_t n_blocks = (width + kFitBlock - 1) / kFitBlock;
  const std::size_t n_cells = (width + grid - 1) / grid;
  CellRow cells;
  std::size_t cell_row = height;  // none yet
  Progress progress("fit", height, options.progress);
  rows.rewind();
  for (std::size_t y0 = 0; y0 < height;) {
    // Bands end where cells end.
    const std::size_t n = std::min({most_rows, height - y0, grid - y0 % grid});
    if (options.solve == NearSolve::interpolated && y0 / grid != cell_row) {
      cell_row = y0 / grid;
      cells = make_cells(fitter, static_cast<int>(cell_row), n_cells, options.n_terms);
    }
    rows.read(static_cast<int>(n), std::span(band).first(n * n_row));
    parallel_for(n * n_blocks, 4, [&](std::size_t begin, std::size_t end) {
      NearFitter::Work work = fitter.make_work();
      for (std::size_t i = begin; i < end; ++i) {
        const std::size_t y = i / n_blocks;
        const std::size_t x0 = i % n_blocks * kFitBlock;
        const std::size_t n_pixels = std::min(kFitBlock, width - x0);
        const std::uint16_t* row = &band[y * n_row];
        if (options.solve == NearSolve::exact) {
          fitter.fit_exact(row, y0 + y, x0, n_pixels, work);
        } else {
          const std::size_t cell = x0 / grid;
          const float step = 1.0F / static_cast<float>(grid);
          work.matrix.blend(cells.upper[cell], cells.lower[cell],
                            (static_cast<float>((y0 + y) % grid) + 0.5F) * step);
          fitter.fit_interpolated(row, y0 + y, x0, n_pixels,
                                  (static_cast<float>(x0 % grid) + 0.5F) * step, step, work);
        }
        for (std::size_t p = 0; p < n_planes; ++p) {
          writer.encode(p, {work.planes.data() + p * kFitBlock, n_pixels},
                        &lines[(y * n_planes + p) * width + x0]);
        }
      }
    });
    writer.append(std::span(lines).first(n * n_planes * width));
    progress.advance(n);
    y0 += n;
  }
  ReflectanceModel model;
  model.basis = options.basis;
  model.n_terms = options.n_terms;
  model.transfer = options.transfer;
  return writer.finish(std::move(model));
}

}  // namespace haarlight
