// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/plate/tile_plate.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <type_traits>

#include <Eigen/Core>

#include "core/count.h"
#include "core/linear_algebra.h"
#include "core/random.h"
#include "haarlight/core/error.h"
#include "relight/basis/by_kernel.h"

#if defined(__x86_64__)
#include <immintrin.h>
#endif

namespace haarlight::relight {

namespace {

using Eigen::MatrixXd;

constexpr std::size_t kPlateLanes = 8;  // pixels whose sums are held in registers at a time

/// T_0 .. T_degree at x.
std::array<double, kMaxPlateDegree + 1> chebyshev(double x, int degree) {
  std::array<double, kMaxPlateDegree + 1> t{};
  t[0] = 1.0;
  if (degree > 0) {
    t[1] = x;
  }
  for (std::size_t i = 2; i <= count(degree); ++i) {
    t[i] = 2.0 * x * t[i - 1] - t[i - 2];
  }
  return t;
}

/// Centre of pixel i of n, from -1 to 1.
double unit_position(int i, int n) { return (2.0 * i + 1.0) / n - 1.0; }

/// T_0 .. T_degree at n pixels, (degree + 1, n).
std::vector<double> chebyshev_table(int n, int degree) {
  std::vector<double> table((count(degree) + 1) * count(n));
  for (int i = 0; i < n; ++i) {
    const auto t = chebyshev(unit_position(i, n), degree);
    for (std::size_t a = 0; a <= count(degree); ++a) {
      table[a * count(n) + count(i)] = t[a];
    }
  }
  return table;
}

void terms_at(const TileRect& rect, int x, int y, int degree, double* out) {
  const auto along_x = chebyshev(unit_position(x, rect.width), degree);
  const auto along_y = chebyshev(unit_position(y, rect.height), degree);
  for (std::size_t b = 0; b <= count(degree); ++b) {
    for (std::size_t a = 0; a <= count(degree); ++a) {
      *out++ = along_x[a] * along_y[b];
    }
  }
}

struct Position {
  int x;
  int y;
};

/// Pixels of a tile at which a closed-form source is evaluated: a grid denser at the edges.
std::vector<Position> node_positions(const TileRect& rect, int degree) {
  const int n = degree + 2;
  const auto along = [n](int size) {
    std::vector<int> at;
    for (int i = 0; i < n; ++i) {
      const double node = -std::cos((2.0 * i + 1.0) / (2.0 * n) * 3.14159265358979323846);
      at.push_back(std::clamp(static_cast<int>((node + 1.0) / 2.0 * size), 0, size - 1));
    }
    at.front() = 0;
    at.back() = size - 1;
    at.erase(std::unique(at.begin(), at.end()), at.end());
    return at;
  };
  std::vector<Position> positions;
  for (const int y : along(rect.height)) {
    for (const int x : along(rect.width)) {
      positions.push_back({x, y});
    }
  }
  return positions;
}

/// V b / ||V b|| of some pixels, (positions, rank); rows of 0 where the plate is not seen.
MatrixXd directions(const StackSource& plate, int channel, const TileRect& rect,
                    const std::vector<Position>& positions, const PlateVectors& vectors) {
  const StackDims dims = plate.dims();
  const std::size_t n_lights = count(dims.n_lights);
  const Eigen::Map<const Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>>
      v(vectors.vectors.data(), vectors.rank, dims.n_lights);
  const bool is_whole = !plate.is_closed_form();
  std::vector<float> values;
  if (is_whole) {
    values.resize(count(dims.channels) * count(rect.n_pixels()) * n_lights);
    plate.read_tile(rect, values);
  }
  MatrixXd found = MatrixXd::Zero(static_cast<Eigen::Index>(positions.size()), vectors.rank);
  std::vector<float> one(count(dims.channels) * n_lights);
  for (std::size_t i = 0; i < positions.size(); ++i) {
    const float* row = nullptr;
    if (is_whole) {
      row = values.data() + (count(channel) * count(rect.n_pixels()) +
                             count(positions[i].y * rect.width + positions[i].x)) *
                                n_lights;
    } else {
      plate.read_tile({rect.x0 + positions[i].x, rect.y0 + positions[i].y, 1, 1}, one);
      row = one.data() + count(channel) * n_lights;
    }
    const Eigen::Map<const Eigen::VectorXf> b(row, dims.n_lights);
    const Eigen::VectorXd u = (v * b).cast<double>();
    const double norm = u.norm();
    if (norm > 0.0) {
      found.row(static_cast<Eigen::Index>(i)) = u.transpose() / norm;
    }
  }
  return found;
}

std::vector<Position> all_positions(const TileRect& rect) {
  std::vector<Position> positions;
  positions.reserve(count(rect.n_pixels()));
  for (int y = 0; y < rect.height; ++y) {
    for (int x = 0; x < rect.width; ++x) {
      positions.push_back({x, y});
    }
  }
  return positions;
}

/// Least squares on the rows that see the plate, (rank, (degree + 1)^2).
std::vector<float> fit(const MatrixXd& seen, const std::vector<Position>& positions,
                       const TileRect& rect, int degree) {
  const int rank = static_cast<int>(seen.cols());
  const int n_terms = (degree + 1) * (degree + 1);
  std::vector<Eigen::Index> rows;
  for (Eigen::Index i = 0; i < seen.rows(); ++i) {
    if (seen.row(i).squaredNorm() > 0.0) {
      rows.push_back(i);
    }
  }
  std::vector<float> fitted(count(rank) * count(n_terms));
  if (rows.empty()) {
    return fitted;
  }
  // As many terms as the visible pixels can support, with a margin.
  int used = degree;
  const auto fits = [&](int d) {
    return 4 * rows.size() >= 5 * count((d + 1) * (d + 1)) && d < rect.width && d < rect.height;
  };
  while (used > 0 && !fits(used)) {
    --used;
  }
  const int n_used = (used + 1) * (used + 1);
  MatrixXd a(static_cast<Eigen::Index>(rows.size()), n_used);
  MatrixXd u(static_cast<Eigen::Index>(rows.size()), rank);
  std::vector<double> terms(count(n_used));
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const Position& position = positions[static_cast<std::size_t>(rows[i])];
    terms_at(rect, position.x, position.y, used, terms.data());
    const auto row = static_cast<Eigen::Index>(i);
    a.row(row) = Eigen::Map<const Eigen::RowVectorXd>(terms.data(), n_used);
    u.row(row) = seen.row(rows[i]);
  }
  const MatrixXd solved = least_squares(a, u).solution;  // (n_used, rank)
  for (int j = 0; j < rank; ++j) {
    for (int b = 0; b <= used; ++b) {
      for (int i = 0; i <= used; ++i) {
        fitted[count(j * n_terms + b * (degree + 1) + i)] =
            static_cast<float>(solved(b * (used + 1) + i, j));
      }
    }
  }
  return fitted;
}

}  // namespace

std::vector<double> plate_terms(const TileRect& rect, int degree) {
  HAARLIGHT_EXPECTS(degree >= 0 && degree <= kMaxPlateDegree, "a degree that is stored");
  const std::size_t n_terms = count((degree + 1) * (degree + 1));
  std::vector<double> terms(count(rect.n_pixels()) * n_terms);
  for (int p = 0; p < rect.n_pixels(); ++p) {
    terms_at(rect, p % rect.width, p / rect.width, degree, terms.data() + count(p) * n_terms);
  }
  return terms;
}

std::vector<float> fit_tile_plate(const StackSource& plate, int channel, const TileRect& rect,
                                  const PlateVectors& vectors, int degree) {
  const std::vector<Position> positions =
      plate.is_closed_form() ? node_positions(rect, degree) : all_positions(rect);
  return fit(directions(plate, channel, rect, positions, vectors), positions, rect, degree);
}

namespace {

/// out = sum_j weights[j] vectors[j], a few numbers at a time: their sums stay in registers.
struct Combine {
  template <class Real>
  [[gnu::always_inline]] static inline void run(std::span<const Real> weights,
                                                const float* vectors, std::span<Real> out) {
    constexpr std::size_t kLanes = 32 / sizeof(Real) * 4;
    const std::size_t n = out.size();
    std::size_t k = 0;
    for (; k + kLanes <= n; k += kLanes) {
      std::array<Real, kLanes> sums{};
      for (std::size_t j = 0; j < weights.size(); ++j) {
        const float* vector = vectors + j * n + k;
        for (std::size_t i = 0; i < kLanes; ++i) {
          sums[i] += weights[j] * static_cast<Real>(vector[i]);
        }
      }
      std::copy(sums.begin(), sums.end(), out.begin() + static_cast<std::ptrdiff_t>(k));
    }
    for (; k < n; ++k) {
      out[k] = Real(0);
      for (std::size_t j = 0; j < weights.size(); ++j) {
        out[k] += weights[j] * static_cast<Real>(vectors[j * n + k]);
      }
    }
  }
};

#if defined(__x86_64__)
/// The float sums of two registers' lights at a time.
[[gnu::target(HAARLIGHT_AVX512)]] void combine_avx512(std::span<const float> weights,
                                                      const float* vectors,
                                                      std::span<float> out) {
  constexpr std::size_t kLanes = 16;
  const std::size_t n = out.size();
  for (std::size_t k = 0; k < n; k += 4 * kLanes) {
    __m512 first = _mm512_setzero_ps();
    __m512 second = first;
    __m512 third = first;
    __m512 fourth = first;
    const float* vector = vectors + k;
    for (const float weight : weights) {
      const __m512 w = _mm512_set1_ps(weight);
      first = _mm512_add_ps(first, _mm512_mul_ps(w, _mm512_loadu_ps(vector)));
      second = _mm512_add_ps(second, _mm512_mul_ps(w, _mm512_loadu_ps(vector + kLanes)));
      third = _mm512_add_ps(third, _mm512_mul_ps(w, _mm512_loadu_ps(vector + 2 * kLanes)));
      fourth = _mm512_add_ps(fourth, _mm512_mul_ps(w, _mm512_loadu_ps(vector + 3 * kLanes)));
      vector += n;
    }
    _mm512_storeu_ps(out.data() + k, first);
    _mm512_storeu_ps(out.data() + k + kLanes, second);
    _mm512_storeu_ps(out.data() + k + 2 * kLanes, third);
    _mm512_storeu_ps(out.data() + k + 3 * kLanes, fourth);
  }
}

#endif

template <class Real>
void combine(std::span<const Real> weights, const float* vectors, std::span<Real> out) {
#if defined(__x86_64__)
  if constexpr (std::is_same_v<Real, float>) {
    if (out.size() % 64 == 0 && has_avx512(best_kernel_code())) {
      combine_avx512(weights, vectors, out);
      return;
    }
  }
#endif
  run_by_kernel<Combine>(weights, vectors, out);
}

}  // namespace

template <class Real>
void plate_direction(std::span<const float> tile_plate, std::span<const double> terms,
                     std::span<const float> vectors, std::span<Real> out) {
  const std::size_t rank = terms.empty() ? 0 : tile_plate.size() / terms.size();
  std::array<Real, kMaxPlateRank> weights{};
  HAARLIGHT_EXPECTS(rank <= weights.size(), "as many vectors as are stored at most");
  std::array<double, kMaxPlateRank> u{};
  for (std::size_t t = 0; t < terms.size(); ++t) {  // all sums abreast: none waits for itself
    for (std::size_t j = 0; j < rank; ++j) {
      u[j] += double{tile_plate[j * terms.size() + t]} * terms[t];
    }
  }
  std::transform(u.begin(), u.begin() + static_cast<std::ptrdiff_t>(rank), weights.begin(),
                 [](double v) { return static_cast<Real>(v); });
  combine<Real>(std::span<const Real>(weights).first(rank), vectors.data(), out);
}
template void plate_direction<float>(std::span<const float>, std::span<const double>,
                                     std::span<const float>, std::span<float>);
template void plate_direction<double>(std::span<const float>, std::span<const double>,
                                      std::span<const float>, std::span<double>);

void plate_sums(const TileRect& rect, int degree, std::span<const float> tile_plate,
                std::span<const double> factors, std::span<double> out) {
  const std::size_t side = count(degree) + 1;
  const std::size_t n_terms = side * side;
  const std::size_t width = count(rect.width);
  HAARLIGHT_EXPECTS(degree >= 0 && degree <= kMaxPlateDegree &&
                        tile_plate.size() == factors.size() * n_terms &&
                        out.size() == count(rect.n_pixels()),
                    "polynomials of every vector, one sum per pixel");
  std::vector<double> polynomial(n_terms);
  for (std::size_t j = 0; j < factors.size(); ++j) {
    for (std::size_t t = 0; t < n_terms; ++t) {
      polynomial[t] += factors[j] * double{tile_plate[j * n_terms + t]};
    }
  }
  const std::vector<double> along_x = chebyshev_table(rect.width, degree);
  const std::vector<double> along_y = chebyshev_table(rect.height, degree);
  std::array<double, kMaxPlateDegree + 1> of_x{};  // of this row: factors of T_a(xi)
  for (int y = 0; y < rect.height; ++y) {
    of_x.fill(0.0);
    for (std::size_t b = 0; b < side; ++b) {
      const double t = along_y[b * count(rect.height) + count(y)];
      for (std::size_t a = 0; a < side; ++a) {
        of_x[a] += polynomial[b * side + a] * t;
      }
    }
    double* row = out.data() + count(y) * width;
    std::size_t x = 0;
    for (; x + kPlateLanes <= width; x += kPlateLanes) {  // sums stay in registers
      std::array<double, kPlateLanes> sums{};
      for (std::size_t a = 0; a < side; ++a) {
        const double* t = along_x.data() + a * width + x;
        for (std::size_t i = 0; i < kPlateLanes; ++i) {
          sums[i] += of_x[a] * t[i];
        }
      }
      std::copy(sums.begin(), sums.end(), row + x);
    }
    for (; x < width; ++x) {
      row[x] = 0.0;
      for (std::size_t a = 0; a < side; ++a) {
        row[x] += of_x[a] * along_x[a * width + x];
      }
    }
  }
}

int choose_plate_degree(const StackSource& plate, const PlateVectors& vectors, int tile,
                        double target) {
  constexpr std::array<int, 7> kDegrees = {0, 1, 2, 3, 4, 6, 8};
  constexpr int kMaxTiles = 16;
  constexpr int kChecks = 8;  // pixels per tile
  const StackDims dims = plate.dims();
  const int tiles_x = (dims.width + tile - 1) / tile;
  const int n_tiles = tiles_x * ((dims.height + tile - 1) / tile);
  const int tile_step = (n_tiles + kMaxTiles - 1) / kMaxTiles;
  std::array<double, kDegrees.size()> missed{};
  double n_checked = 0.0;
  for (int t = 0; t < n_tiles; t += tile_step) {
    const int x0 = t % tiles_x * tile;
    const int y0 = t / tiles_x * tile;
    const TileRect rect{x0, y0, std::min(tile, dims.width - x0),
                        std::min(tile, dims.height - y0)};
    std::vector<Position> checks;
    for (int i = 0; i < kChecks; ++i) {
      const auto draw = [&](std::uint64_t axis) {
        return uniform_unit(hash_key(0x646567726565, static_cast<std::uint64_t>(t),
                                     static_cast<std::uint64_t>(i), axis));
      };
      checks.push_back({std::min(rect.width - 1, static_cast<int>(draw(0) * rect.width)),
                        std::min(rect.height - 1, static_cast<int>(draw(1) * rect.height))});
    }
    const MatrixXd truth = directions(plate, 0, rect, checks, vectors);
    for (std::size_t d = 0; d < kDegrees.size(); ++d) {
      const std::vector<float> fitted = fit_tile_plate(plate, 0, rect, vectors, kDegrees[d]);
      const std::size_t n_terms = count((kDegrees[d] + 1) * (kDegrees[d] + 1));
      std::vector<double> terms(n_terms);
      for (std::size_t i = 0; i < checks.size(); ++i) {
        const auto row = static_cast<Eigen::Index>(i);
        if (truth.row(row).squaredNorm() == 0.0) {
          continue;
        }
        terms_at(rect, checks[i].x, checks[i].y, kDegrees[d], terms.data());
        Eigen::VectorXd u = Eigen::VectorXd::Zero(vectors.rank);
        for (int j = 0; j < vectors.rank; ++j) {
          for (std::size_t k = 0; k < n_terms; ++k) {
            u[j] += double{fitted[count(j) * n_terms + k]} * terms[k];
          }
        }
        // The gain absorbs the length: the error is orthogonal to the direction.
        const double along = truth.row(row).dot(u.transpose());
        missed[d] += std::max(0.0, u.squaredNorm() - along * along);
        n_checked += d == 0 ? 1.0 : 0.0;
      }
    }
  }
  double best = std::numeric_limits<double>::infinity();
  for (double& m : missed) {
    m = n_checked > 0.0 ? std::sqrt(m / n_checked) : 0.0;
    best = std::min(best, m);
  }
  for (std::size_t d = 0; d < kDegrees.size(); ++d) {
    if (missed[d] <= std::max(target, 1.05 * best)) {
      return kDegrees[d];
    }
  }
  return kDegrees.back();
}

}  // namespace haarlight::relight
