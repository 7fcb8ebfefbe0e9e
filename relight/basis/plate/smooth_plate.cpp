// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/plate/smooth_plate.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>

#include <Eigen/Core>

#include "core/count.h"
#include "core/linear_algebra.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "relight/basis/plate/tile_plate.h"

namespace haarlight::relight {

namespace {

using Eigen::MatrixXd;

constexpr std::size_t kSampleRows = 1024;  // for the space over the lights
constexpr int kSampleNodes = 4;            // of a tile's nodes per axis, the outermost included
constexpr int kSpare = 16;                 // vectors beyond the file's: they span the remainder
constexpr double kLeastRho = 3.0;

int tiles_across(int size, int tile) { return (size + tile - 1) / tile; }

TileRect rect_of(const StackDims& dims, int tile, int i_tile) {
  const int across = tiles_across(dims.width, tile);
  const int x0 = i_tile % across * tile;
  const int y0 = i_tile / across * tile;
  return {x0, y0, std::min(tile, dims.width - x0), std::min(tile, dims.height - y0)};
}

/// What a tile sees at its corners, the midpoints of its sides, and its centre (4).
bool look_at(const ComputedPlate& plate, const TileRect& rect,
             std::array<PlateView, 9>& views) {
  for (std::size_t i = 0; i < views.size(); ++i) {
    const std::size_t row = i / 3;
    const auto view = plate.look(rect.x0 + 0.5 * rect.width * static_cast<double>(i % 3),
                                 rect.y0 + 0.5 * rect.height * static_cast<double>(row));
    if (!view) {
      return false;
    }
    views[i] = *view;
  }
  return true;
}

/// Lower bound on the gain per degree: for a function on a disc with its nearest singularity
/// `delta` radii from the centre, the Chebyshev coefficients fall by delta + sqrt(delta^2 - 1).
double rho_of(double delta) {
  return delta > 1.0 ? delta + std::sqrt(delta * delta - 1.0) : 1.0;
}

/// The smallest rho of a tile; 0 where it is not analytic.
double tile_rho(const ComputedPlate& plate, const TileRect& rect) {
  std::array<PlateView, 9> views;
  if (!look_at(plate, rect, views)) {
    return 0.0;
  }
  const PlateView& middle = views[4];
  double radius = 0.0;
  double slope_range = 0.0;
  for (const PlateView& view : views) {
    if (view.normal.dot(middle.normal) < 0.0) {
      return 0.0;
    }
    radius = std::max(radius, (view.point - middle.point).norm());
    slope_range = std::max(slope_range, std::abs(view.slope - middle.slope));
  }
  constexpr double kOutside =
      1.1;  // the tile's outline on the plane may bulge between the nine
  radius *= kOutside;
  slope_range *= kOutside;
  // At the plane's horizon the position on the plane goes to infinity.
  double rho = slope_range > 0.0 ? rho_of(std::abs(middle.slope) / slope_range) : 1e9;
  for (const render::SquareLight& light : plate.lights()) {
    const double ahead = light.emits.dot(middle.point - light.centre);
    double ahead_range = 0.0;
    for (const PlateView& view : views) {
      ahead_range = std::max(ahead_range, std::abs(light.emits.dot(view.point - middle.point)));
    }
    if (std::abs(ahead) <= kOutside * ahead_range) {
      return 0.0;  // the light's own plane cuts the tile: a kink
    }
    if (ahead < 0.0) {
      continue;  // no light at all
    }
    const double half = 0.5 * std::hypot(light.width_mm, light.height_mm);
    const double distance = (light.centre - middle.point).norm() - half;
    rho = std::min(rho, radius > 0.0 ? rho_of(distance / radius) : 1e9);
  }
  return rho;
}

/// C_t at the tile's Chebyshev nodes, and back: row n of the nodes, c = analysis * values.
struct Nodes {
  std::vector<double> at;  ///< in -1 .. 1
  MatrixXd analysis;       ///< (terms, nodes): of one axis
};

Nodes make_nodes(int degree) {
  const int n = degree + 1;
  Nodes nodes;
  nodes.analysis.resize(n, n);
  for (int i = 0; i < n; ++i) {
    const double angle = std::numbers::pi * (i + 0.5) / n;
    nodes.at.push_back(std::cos(angle));
    for (int t = 0; t < n; ++t) {
      nodes.analysis(t, i) = (t == 0 ? 1.0 : 2.0) / n * std::cos(t * angle);
    }
  }
  return nodes;
}

/// T_0 .. T_degree at n positions spaced like pixels, (degree + 1, n).
MatrixXd chebyshev_at_pixels(int n, int degree) {
  MatrixXd table(degree + 1, n);
  for (int i = 0; i < n; ++i) {
    const double x = (2.0 * i + 1.0) / n - 1.0;
    for (int t = 0; t <= degree; ++t) {
      table(t, i) = t == 0 ? 1.0 : t == 1 ? x : 2.0 * x * table(t - 1, i) - table(t - 2, i);
    }
  }
  return table;
}

}  // namespace

std::optional<int> smooth_degree(const ComputedPlate& plate, int tile, double target) {
  const StackDims dims = plate.dims();
  const int n_tiles = tiles_across(dims.width, tile) * tiles_across(dims.height, tile);
  double rho = std::numeric_limits<double>::infinity();
  for (int i = 0; i < n_tiles && rho >= kLeastRho; ++i) {
    rho = std::min(rho, tile_rho(plate, rect_of(dims, tile, i)));
  }
  if (rho < kLeastRho) {
    return std::nullopt;
  }
  // Poles of fourth order: coefficients of degree n fall as n^3 rho^-n.
  for (int degree = 3; degree <= kMaxSmoothDegree; ++degree) {
    if (std::pow(degree + 1.0, 3) * std::pow(rho, -(degree + 1.0)) <= target) {
      return degree;
    }
  }
  return std::nullopt;
}

SmoothPlate::SmoothPlate(const ComputedPlate& plate, int tile, int degree, double target,
                         int max_rank)
    : dims_(plate.dims()), tile_(tile), degree_(degree) {
  const int n_sampled = static_cast<int>(kSampleRows) / (kSampleNodes * kSampleNodes);
  const int tile_step = (n_tiles() + n_sampled - 1) / n_sampled;
  std::vector<MatrixXd> rows(count(n_tiles()));
  const auto is_sampled = [tile_step](std::size_t i) { return i % count(tile_step) == 0; };
  parallel_for(rows.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      if (is_sampled(i)) {
        rows[i] = node_rows(plate, static_cast<int>(i));
      }
    }
  });
  std::vector<double> sample;
  for (const MatrixXd& of_tile : rows) {
    for (int i = 0; of_tile.size() > 0 && i < kSampleNodes * kSampleNodes; ++i) {
      const int b = i / kSampleNodes * degree / (kSampleNodes - 1);
      const int a = i % kSampleNodes * degree / (kSampleNodes - 1);
      const auto row = of_tile.col(b * (degree + 1) + a);
      const double norm = row.norm();
      for (Eigen::Index k = 0; norm > 0.0 && k < row.size(); ++k) {
        sample.push_back(row[k] / norm);
      }
    }
  }
  vectors_ = fit_row_space(sample, dims_.n_lights, max_rank + kSpare, 2).vectors;
  const MatrixXd analysis = make_nodes(degree).analysis;
  series_.resize(rows.size());
  parallel_for(rows.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      if (!is_sampled(i)) {
        rows[i] = node_rows(plate, static_cast<int>(i));
      }
      const MatrixXd values = vectors_.transpose() * rows[i];  // (n_vectors, nodes)
      rows[i].resize(0, 0);
      MatrixXd& series = series_[i];
      series = MatrixXd::Zero(values.rows(), values.cols());
      // Along x, then along y: node and term number b (degree + 1) + a.
      const Eigen::Index n = degree + 1;
      MatrixXd half(values.rows(), values.cols());
      for (Eigen::Index b = 0; b < n; ++b) {
        half.middleCols(b * n, n) = values.middleCols(b * n, n) * analysis.transpose();
      }
      for (Eigen::Index t = 0; t < n; ++t) {
        for (Eigen::Index b = 0; b < n; ++b) {
          series.middleCols(t * n, n) += analysis(t, b) * half.middleCols(b * n, n);
        }
      }
    }
  });
  turn(target, max_rank);
}

/// The vectors of the space ordered by how much they carry of all pixels' directions.
void SmoothPlate::turn(double target, int max_rank) {
  std::vector<MatrixXd> sums(series_.size());
  std::vector<double> lit(series_.size());
  parallel_for(sums.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      MatrixXd y = tile_coordinates(static_cast<int>(i));
      for (Eigen::Index p = 0; p < y.cols(); ++p) {
        const double norm = y.col(p).norm();
        lit[i] += norm > 0.0 ? 1.0 : 0.0;
        y.col(p) *= norm > 0.0 ? 1.0 / norm : 0.0;
      }
      sums[i] = y * y.transpose();
    }
  });
  MatrixXd sum = MatrixXd::Zero(vectors_.cols(), vectors_.cols());
  double n_lit = 0.0;
  for (std::size_t i = 0; i < sums.size(); ++i) {
    sum += sums[i];
    n_lit += lit[i];
  }
  const SymmetricEigen eigen = symmetric_eigen(sum);
  RowSpace space{vectors_ * eigen.vectors.rowwise().reverse(), eigen.values.reverse()};
  chosen_ = choose_vectors(space, n_lit, target, max_rank);
  const MatrixXd turned = space.vectors.transpose() * vectors_;
  vectors_ = std::move(space.vectors);
  for (MatrixXd& series : series_) {
    series = turned * series;
  }
}

/// (n_lights, nodes)
MatrixXd SmoothPlate::node_rows(const ComputedPlate& plate, int i_tile) const {
  const Nodes nodes = make_nodes(degree_);
  const TileRect rect = tile_rect(i_tile);
  const int n = degree_ + 1;
  MatrixXd rows(dims_.n_lights, n * n);
  for (int b = 0; b < n; ++b) {
    for (int a = 0; a < n; ++a) {
      const double x = rect.x0 + 0.5 * (nodes.at[count(a)] + 1.0) * rect.width;
      const double y = rect.y0 + 0.5 * (nodes.at[count(b)] + 1.0) * rect.height;
      plate.evaluate(x, y, {rows.col(b * n + a).data(), count(dims_.n_lights)});
    }
  }
  return rows;
}

StackDims SmoothPlate::dims() const { return {dims_.width, dims_.height, 1, n_vectors()}; }

int SmoothPlate::n_tiles() const {
  return tiles_across(dims_.width, tile_) * tiles_across(dims_.height, tile_);
}

TileRect SmoothPlate::tile_rect(int i_tile) const { return rect_of(dims_, tile_, i_tile); }

MatrixXd SmoothPlate::tile_coordinates(int i_tile) const {
  const TileRect rect = tile_rect(i_tile);
  const Eigen::Index n = degree_ + 1;
  const MatrixXd along_x = chebyshev_at_pixels(rect.width, degree_);
  const MatrixXd along_y = chebyshev_at_pixels(rect.height, degree_);
  const MatrixXd& series = series_[count(i_tile)];
  std::vector<MatrixXd> of_b;
  of_b.reserve(count(degree_ + 1));
  for (Eigen::Index b = 0; b < n; ++b) {
    of_b.emplace_back(series.middleCols(b * n, n) * along_x);  // (n_vectors, width)
  }
  MatrixXd y = MatrixXd::Zero(series.rows(), rect.n_pixels());
  const Eigen::Index width = rect.width;
  for (Eigen::Index row = 0; row < rect.height; ++row) {
    for (Eigen::Index b = 0; b < n; ++b) {
      y.middleCols(row * width, width) += along_y(b, row) * of_b[static_cast<std::size_t>(b)];
    }
  }
  return y;
}

void SmoothPlate::read_tile(const TileRect& rect, std::span<float> out) const {
  const int across = tiles_across(dims_.width, tile_);
  const std::size_t n = count(n_vectors());
  HAARLIGHT_EXPECTS(out.size() == count(rect.n_pixels()) * n, "room for the tile's values");
  int i_last = -1;
  MatrixXd y;
  Eigen::VectorXd one;
  for (int p = 0; p < rect.n_pixels(); ++p) {
    const int px = rect.x0 + p % rect.width;
    const int py = rect.y0 + p / rect.width;
    const int i_tile = py / tile_ * across + px / tile_;
    const TileRect of = tile_rect(i_tile);
    if (rect.n_pixels() == 1) {
      const TileRect position{px - of.x0, py - of.y0, 1, 1};
      const MatrixXd tx = chebyshev_at_pixels(of.width, degree_).col(position.x0);
      const MatrixXd ty = chebyshev_at_pixels(of.height, degree_).col(position.y0);
      const Eigen::Index side = degree_ + 1;
      Eigen::VectorXd terms(side * side);
      for (Eigen::Index b = 0; b < side; ++b) {
        terms.segment(b * side, side) = ty(b, 0) * tx;
      }
      one = series_[count(i_tile)] * terms;
    } else {
      if (i_tile != i_last) {
        y = tile_coordinates(i_tile);
        i_last = i_tile;
      }
      one = y.col((py - of.y0) * of.width + px - of.x0);
    }
    for (std::size_t i = 0; i < n; ++i) {
      out[count(p) * n + i] = static_cast<float>(one[static_cast<Eigen::Index>(i)]);
    }
  }
}

PlateVectors SmoothPlate::chosen_here() const {
  PlateVectors here;
  here.rank = chosen_.rank;
  here.missed = chosen_.missed;
  here.vectors.assign(count(here.rank) * count(n_vectors()), 0.0F);
  for (int i = 0; i < here.rank; ++i) {
    here.vectors[count(i) * count(n_vectors()) + count(i)] = 1.0F;
  }
  return here;
}

}  // namespace haarlight::relight
