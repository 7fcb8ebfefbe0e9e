// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/shape/integrate_normals.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "core/count.h"
#include "core/order_statistics.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "relight/shape/cosine_transform.h"
#include "relight/shape/grid_laplacian.h"

namespace haarlight::relight {

namespace {

/// The steps that join two known pixels.
struct Edges {
  std::vector<float> right;
  std::vector<float> down;
};

Edges edges_of(const SlopeField& slopes, const Parts& parts) {
  const int h = slopes.height();
  const int w = slopes.width();
  Edges edges{std::vector<float>(count(h) * count(w)), std::vector<float>(count(h) * count(w))};
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      if (slopes.is_known(y, x) == 0) {
        continue;
      }
      const std::size_t i = count(y) * count(w) + count(x);
      const int part = parts.label(y, x);
      edges.right[i] = x + 1 < w && parts.label(y, x + 1) == part ? 1.0F : 0.0F;
      edges.down[i] = y + 1 < h && parts.label(y + 1, x) == part ? 1.0F : 0.0F;
    }
  }
  return edges;
}

/// The cosine coefficients of a picture, transposed: (width, height).
std::vector<double> forward_cosines(std::vector<double> picture, int h, int w,
                                    RowTransform rows, RowTransform columns) {
  transform_rows(picture, h, w, rows);
  std::vector<double> turned = transposed(picture, h, w);
  transform_rows(turned, w, h, columns);
  return turned;
}

std::vector<double> inverse_cosines(std::vector<double> turned, int h, int w) {
  transform_rows(turned, w, h, RowTransform::inverse_cosine);
  std::vector<double> picture = transposed(turned, w, h);
  transform_rows(picture, h, w, RowTransform::inverse_cosine);
  return picture;
}

/// L z = f where every pixel is known: L's eigenvectors are cosines, its eigenvalues
/// 4 - 2 cos(pi m / w) - 2 cos(pi n / h).
std::vector<double> solve_by_cosines(std::vector<double> f, int h, int w) {
  std::vector<double> turned =
      forward_cosines(std::move(f), h, w, RowTransform::cosine, RowTransform::cosine);
  for (int m = 0; m < w; ++m) {
    const double along = std::sin(0.5 * std::numbers::pi * m / w);
    for (int n = 0; n < h; ++n) {
      const double across = std::sin(0.5 * std::numbers::pi * n / h);
      double& value = turned[count(m) * count(h) + count(n)];
      value = m + n == 0 ? 0.0 : value / (4.0 * (along * along + across * across));
    }
  }
  return inverse_cosines(std::move(turned), h, w);
}

/// Frankot and Chellappa's projection with z = sum c_mn cos cos: its slopes are sines in one
/// direction, so c = -(a P + b Q) / (a^2 + b^2) with a = pi m / w, b = pi n / h and P, Q the
/// slopes' sine-cosine coefficients.
std::vector<double> project_on_cosines(const SlopeField& slopes) {
  const int h = slopes.height();
  const int w = slopes.width();
  const std::span<const float> right = slopes.slope_right.pixels();
  const std::span<const float> down = slopes.slope_down.pixels();
  const std::vector<double> p = forward_cosines({right.begin(), right.end()}, h, w,
                                                RowTransform::sine, RowTransform::cosine);
  const std::vector<double> q = forward_cosines({down.begin(), down.end()}, h, w,
                                                RowTransform::cosine, RowTransform::sine);
  std::vector<double> c(p.size());
  for (int m = 0; m < w; ++m) {
    const double a = std::numbers::pi * m / w;
    for (int n = 0; n < h; ++n) {
      if (m + n == 0) {
        continue;
      }
      const double b = std::numbers::pi * n / h;
      double sum = 0.0;
      if (m > 0) {
        sum += a * p[count(m - 1) * count(h) + count(n)];
      }
      if (n > 0) {
        sum += b * q[count(m) * count(h) + count(n - 1)];
      }
      c[count(m) * count(h) + count(n)] = -sum / (a * a + b * b);
    }
  }
  return inverse_cosines(std::move(c), h, w);
}

/// z_b - z_a - step of every edge; 0 where there is none.
struct Residuals {
  std::vector<float> right;
  std::vector<float> down;
};

Residuals residuals_of(const SlopeField& slopes, const Edges& edges,
                       std::span<const double> z) {
  const std::size_t w = count(slopes.width());
  const std::span<const float> right = slopes.step_right.pixels();
  const std::span<const float> down = slopes.step_down.pixels();
  Residuals r{std::vector<float>(z.size()), std::vector<float>(z.size())};
  for (std::size_t i = 0; i < z.size(); ++i) {
    if (edges.right[i] > 0.0F) {
      r.right[i] = static_cast<float>(z[i + 1] - z[i] - double{right[i]});
    }
    if (edges.down[i] > 0.0F) {
      r.down[i] = static_cast<float>(z[i + w] - z[i] - double{down[i]});
    }
  }
  return r;
}

/// The scale of ordinary inconsistencies: 1.4826 times the median of |r|.
double scale_of(const Residuals& r, const Edges& edges) {
  std::vector<float> sizes;
  for (std::size_t i = 0; i < r.right.size(); ++i) {
    if (edges.right[i] > 0.0F) {
      sizes.push_back(std::abs(r.right[i]));
    }
    if (edges.down[i] > 0.0F) {
      sizes.push_back(std::abs(r.down[i]));
    }
  }
  if (sizes.empty()) {
    return 0.0;
  }
  return kSigmaPerMad * double{upper_median(sizes)};
}

double rms_step(const SlopeField& slopes, const Edges& edges) {
  double sum = 0.0;
  double n = 0.0;
  for (std::size_t i = 0; i < edges.right.size(); ++i) {
    const double right = slopes.step_right.pixels()[i];
    const double down = slopes.step_down.pixels()[i];
    sum += edges.right[i] * right * right + edges.down[i] * down * down;
    n += double{edges.right[i]} + double{edges.down[i]};
  }
  return n > 0.0 ? std::sqrt(sum / n) : 0.0;
}

constexpr float kLeastWeight = 1e-5F;  // keeps parts joined: retains the gauge between them
constexpr double kCutWeight = 0.1;
constexpr double kAnneal = 0.7;
constexpr double kRedescend = 4.0;
constexpr double kLeastScale = 3e-3;  // of the rms step: exact slopes have no noise scale
constexpr double kSettled = 1e-3;     // change of the heights between rounds, in rms steps

struct RobustResult {
  std::vector<double> z;
  Edges weights;
};

double rms_residual(const Residuals& r, const Edges& edges) {
  double sum = 0.0;
  double n = 0.0;
  for (std::size_t i = 0; i < r.right.size(); ++i) {
    sum += double{r.right[i]} * double{r.right[i]} + double{r.down[i]} * double{r.down[i]};
    n += double{edges.right[i]} + double{edges.down[i]};
  }
  return n > 0.0 ? std::sqrt(sum / n) : 0.0;
}

/// Reweighted least squares with Geman and McClure's weights 1 / (1 + (r / c)^2)^2, c from
/// several times the largest scale, where they are those of least squares, down to a few times
/// that of ordinary inconsistencies: large ones drop out one by one, those least supported by
/// their neighbours first (graduated non-convexity, [Blake87]).
RobustResult solve_robustly(const SlopeField& slopes, const Edges& edges, std::vector<double> z,
                            const IntegrateOptions& options, HeightMap& map) {
  const int h = slopes.height();
  const int w = slopes.width();
  const double step = rms_step(slopes, edges);
  const double least_scale = kLeastScale * step;
  RobustResult result{std::move(z), edges};
  if (step == 0.0) {
    return result;
  }
  Residuals r = residuals_of(slopes, edges, result.z);
  double scale = std::max(scale_of(r, edges), least_scale);
  double width = std::max(rms_residual(r, edges), scale);
  for (int round = 0; round < options.max_reweightings; ++round) {
    const auto weight = [&](float residual) {
      const double u = double{residual} / (kRedescend * width);
      const double one = 1.0 + u * u;
      return std::max(static_cast<float>(1.0 / (one * one)), kLeastWeight);
    };
    Edges weights = edges;
    for (std::size_t i = 0; i < r.right.size(); ++i) {
      weights.right[i] *= weight(r.right[i]);
      weights.down[i] *= weight(r.down[i]);
    }
    const GridLaplacian laplacian(h, w, weights.right, weights.down);
    const std::vector<double> f =
        laplacian.divergence(slopes.step_right.pixels(), slopes.step_down.pixels());
    const std::vector<double> before = result.z;
    const GridSolve solve =
        laplacian.solve(f, result.z, options.tolerance, options.max_iterations);
    ++map.n_solves;
    map.iterations += solve.iterations;
    map.solver_residual = solve.residual;
    map.is_converged = solve.is_converged;
    result.weights = std::move(weights);
    double change = 0.0;
    for (std::size_t i = 0; i < before.size(); ++i) {
      change = std::max(change, std::abs(result.z[i] - before[i]));
    }
    if (width <= scale && change <= kSettled * step) {
      return result;
    }
    r = residuals_of(slopes, edges, result.z);
    scale = std::clamp(scale_of(r, edges), least_scale, scale);
    width = std::max(kAnneal * width, scale);
  }
  return result;
}

void fix_gauge(std::span<double> z, const Parts& parts) {
  std::vector<double> sum(count(parts.n_parts), 0.0);
  std::vector<double> n(count(parts.n_parts), 0.0);
  const std::span<const int> label = parts.label.pixels();
  for (std::size_t i = 0; i < z.size(); ++i) {
    if (label[i] >= 0) {
      sum[count(label[i])] += z[i];
      n[count(label[i])] += 1.0;
    }
  }
  for (std::size_t i = 0; i < z.size(); ++i) {
    z[i] = label[i] >= 0 ? z[i] - sum[count(label[i])] / n[count(label[i])] : 0.0;
  }
}

void measure(const Residuals& r, const Edges& edges, const Edges& weights, HeightMap& map) {
  double sum = 0.0;
  double n = 0.0;
  const std::span<std::uint8_t> cut = map.is_cut.pixels();
  const auto add = [&](float edge, float weight, float residual, std::uint8_t& is_cut) {
    if (edge == 0.0F) {
      return;
    }
    if (weight < kCutWeight) {
      is_cut = 1;
      ++map.n_cuts;
      return;
    }
    sum += double{residual} * double{residual};
    n += 1.0;
    map.worst_step_error = std::max(map.worst_step_error, std::abs(double{residual}));
  };
  for (std::size_t i = 0; i < r.right.size(); ++i) {
    add(edges.right[i], weights.right[i], r.right[i], cut[2 * i]);
    add(edges.down[i], weights.down[i], r.down[i], cut[2 * i + 1]);
  }
  map.step_error = n > 0.0 ? std::sqrt(sum / n) : 0.0;
}

/// Known neighbours of different parts: they are of different regions.
void mark_region_borders(HeightMap& map) {
  const int h = map.is_known.height();
  const int w = map.is_known.width();
  const Image<int>& label = map.parts.label;
  const auto mark = [&](int y, int x, int y2, int x2, int way) {
    if (y2 < h && x2 < w && label(y, x) >= 0 && label(y2, x2) >= 0 &&
        label(y, x) != label(y2, x2)) {
      map.is_cut(y, x, way) = 1;
      ++map.n_cuts;
    }
  };
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      mark(y, x, y, x + 1, 0);
      mark(y, x, y + 1, x, 1);
    }
  }
}

}  // namespace

Parts find_parts(ImageView<const std::uint8_t> is_known, const Image<int>* region) {
  HAARLIGHT_EXPECTS(region == nullptr || (region->height() == is_known.height() &&
                                          region->width() == is_known.width()),
                    "regions of the same picture");
  const int h = is_known.height();
  const int w = is_known.width();
  Parts parts{Image<int>(h, w, 1), 0};
  std::fill(parts.label.pixels().begin(), parts.label.pixels().end(), -1);
  std::vector<int> open;
  const std::span<int> label = parts.label.pixels();
  for (int start = 0; start < h * w; ++start) {
    if (is_known(start / w, start % w) == 0 || label[count(start)] >= 0) {
      continue;
    }
    label[count(start)] = parts.n_parts;
    open.push_back(start);
    while (!open.empty()) {
      const int i = open.back();
      open.pop_back();
      const auto visit = [&](int y, int x) {
        if (y >= 0 && y < h && x >= 0 && x < w && is_known(y, x) != 0 &&
            label[count(y * w + x)] < 0 &&
            (region == nullptr || (*region)(y, x) == region->pixels()[count(i)])) {
          label[count(y * w + x)] = parts.n_parts;
          open.push_back(y * w + x);
        }
      };
      const int y = i / w;
      const int x = i % w;
      visit(y, x + 1);
      visit(y, x - 1);
      visit(y + 1, x);
      visit(y - 1, x);
    }
    ++parts.n_parts;
  }
  return parts;
}

HeightMap integrate_slopes(const SlopeField& slopes, const IntegrateOptions& options) {
  const int h = slopes.height();
  const int w = slopes.width();
  HAARLIGHT_EXPECTS(h > 0 && w > 0, "a picture");
  HeightMap map;
  map.height = Image<float>(h, w, 1);
  map.is_known = slopes.is_known;
  map.is_cut = Image<std::uint8_t>(h, w, 2);
  map.parts = find_parts(slopes.is_known.view(), options.region);
  const Parts& parts = map.parts;
  const Edges edges = edges_of(slopes, parts);
  Edges weights = edges;
  std::vector<double> z(count(h) * count(w));
  if (options.method == Integrator::frankot_chellappa) {
    z = project_on_cosines(slopes);
    map.n_solves = 1;
  } else {
    const GridLaplacian laplacian(h, w, edges.right, edges.down);
    std::vector<double> f =
        laplacian.divergence(slopes.step_right.pixels(), slopes.step_down.pixels());
    map.n_solves = 1;
    const std::span<const std::uint8_t> known = slopes.is_known.pixels();
    if (parts.n_parts == 1 &&
        std::find(known.begin(), known.end(), std::uint8_t{0}) == known.end()) {
      z = solve_by_cosines(std::move(f), h, w);
    } else {
      const GridSolve solve = laplacian.solve(f, z, options.tolerance, options.max_iterations);
      map.iterations = solve.iterations;
      map.solver_residual = solve.residual;
      map.is_converged = solve.is_converged;
    }
    if (options.method == Integrator::robust) {
      RobustResult robust = solve_robustly(slopes, edges, std::move(z), options, map);
      z = std::move(robust.z);
      weights = std::move(robust.weights);
    }
  }
  fix_gauge(z, parts);
  measure(residuals_of(slopes, edges, z), edges, weights, map);
  mark_region_borders(map);
  const std::span<float> height = map.height.pixels();
  for (std::size_t i = 0; i < z.size(); ++i) {
    height[i] = static_cast<float>(z[i]);
  }
  return map;
}

}  // namespace haarlight::relight
