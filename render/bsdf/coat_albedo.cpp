// SPDX-License-Identifier: Apache-2.0
#include "render/bsdf/coat_albedo.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Core>

#include "render/bsdf/fresnel.h"
#include "render/bsdf/ggx.h"

namespace haarlight::render {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

// Quadrature of the entries: within 1e-3 of one with 96 x 96 points.
constexpr int kAzimuths = 16;
constexpr int kHeights = 32;
// What interpolation is below the truth, at most 1.4 % of it (the test CoatAlbedo has more points),
// and the means' own.
constexpr double kReflectanceMargin = 1.02;
constexpr double kMeanMargin = 1.002;
constexpr int kMeanPoints = 400;

/// Where a number lies among grid nodes 0, 1, ..., n - 1: the lower one and how far on to the next.
struct Cell {
  std::size_t lower = 0;
  double part = 0.0;
};

/// @param at  in units of nodes
Cell even_cell(double at, std::size_t n) {
  const double bounded = std::clamp(at, 0.0, static_cast<double>(n - 1));
  const std::size_t lower = std::min(static_cast<std::size_t>(bounded), n - 2);
  return {.lower = lower, .part = bounded - static_cast<double>(lower)};
}

/// Nodes at (i / (n - 1))^2.
Cell square_cell(double value, std::size_t n) {
  const auto last = static_cast<double>(n - 1);
  Cell cell = even_cell(std::sqrt(std::clamp(value, 0.0, 1.0)) * last, n);
  const double low = static_cast<double>(cell.lower) / last;
  const double high = static_cast<double>(cell.lower + 1) / last;
  cell.part = std::clamp((value - low * low) / (high * high - low * low), 0.0, 1.0);
  return cell;
}

/// (n - 1)/(n + 1), in which the reflectance is smoother than in n.
double contrast(double ior) { return (ior - 1.0) / (ior + 1.0); }

constexpr double kLowestContrast =
    (CoatAlbedo::kLowestIor - 1.0) / (CoatAlbedo::kLowestIor + 1.0);
constexpr double kHighestContrast =
    (CoatAlbedo::kHighestIor - 1.0) / (CoatAlbedo::kHighestIor + 1.0);

Cell ior_cell(double ior, std::size_t n) {
  return even_cell((contrast(ior) - kLowestContrast) / (kHighestContrast - kLowestContrast) *
                       static_cast<double>(n - 1),
                   n);
}

double ior_at(std::size_t i, std::size_t n) {
  const double c = kLowestContrast + (kHighestContrast - kLowestContrast) *
                                         static_cast<double>(i) / static_cast<double>(n - 1);
  return (1.0 + c) / (1.0 - c);
}

/// Calls f(h.o, G(o, i)/G(o)) for visible normals h, which visible_normal() spreads evenly over the
/// square; its mean is an integral over them. The azimuth is symmetric.
template <class Function>
void for_visible_normals(double cosine, double alpha, int n_azimuths, int n_heights,
                         const Function& f) {
  const Ggx facets{.alpha = alpha};
  const Vector3d to_eye(std::sqrt(std::max(0.0, 1.0 - cosine * cosine)), 0.0, cosine);
  for (int i = 0; i < n_azimuths; ++i) {
    for (int j = 0; j < n_heights; ++j) {
      const Vector3d half = facets.visible_normal(
          to_eye, Vector2d(0.5 * (i + 0.5) / n_azimuths, (j + 0.5) / n_heights));
      const double towards = std::clamp(half.dot(to_eye), 0.0, 1.0);
      const double cos_light = 2.0 * towards * half.z() - cosine;
      if (cos_light > 0.0) {
        f(towards, facets.unshadowed(cosine, cos_light));
      }
    }
  }
}

}  // namespace

double coat_reflectance_by_quadrature(double cosine, double alpha, double ior, int n_azimuths,
                                      int n_heights) {
  if (!(alpha > 0.0)) {
    return fresnel_dielectric(cosine, ior);
  }
  double sum = 0.0;
  for_visible_normals(cosine, alpha, n_azimuths, n_heights, [&](double towards, double seen) {
    sum += fresnel_dielectric(towards, ior) * seen;
  });
  return sum / (static_cast<double>(n_azimuths) * n_heights);
}

CoatAlbedo::CoatAlbedo() {
  std::array<double, kIors> iors{};
  for (std::size_t n = 0; n < kIors; ++n) {
    iors.at(n) = ior_at(n, kIors);
  }
  for (std::size_t a = 0; a < kAngles; ++a) {
    const double v = static_cast<double>(a) / static_cast<double>(kAngles - 1);
    for (std::size_t l = 0; l < kLevels; ++l) {
      const double root = static_cast<double>(l) / static_cast<double>(kLevels - 1);
      const double m = std::max(1e-6, root * root);  // at 0: the limit
      const double cosine = v < 0.5 ? 2.0 * v * m : m;
      const double alpha = v < 0.5 ? m : 2.0 * (1.0 - v) * m;
      std::array<double, kIors> sums{};
      if (alpha > 0.0) {
        for_visible_normals(cosine, alpha, kAzimuths, kHeights,
                            [&](double towards, double seen) {
                              for (std::size_t n = 0; n < kIors; ++n) {
                                sums[n] += fresnel_dielectric(towards, iors[n]) * seen;
                              }
                            });
      }
      for (std::size_t n = 0; n < kIors; ++n) {
        reflectance_.at((n * kAngles + a) * kLevels + l) =
            static_cast<float>(alpha > 0.0 ? sums.at(n) / (kAzimuths * kHeights)
                                           : fresnel_dielectric(cosine, iors.at(n)));
      }
    }
  }
  for (std::size_t n = 0; n < kIors; ++n) {
    for (std::size_t i = 0; i < kAlphas; ++i) {
      const double root = static_cast<double>(i) / static_cast<double>(kAlphas - 1);
      // integral of T 2 cos dcos, with cos = s^2.
      double sum = 0.0;
      for (int j = 0; j < kMeanPoints; ++j) {
        const double s = (j + 0.5) / kMeanPoints;
        sum += transmittance(s * s, root * root, ior_at(n, kIors)) * 4.0 * s * s * s;
      }
      mean_transmittance_.at(n * kAlphas + i) = static_cast<float>(sum / kMeanPoints);
    }
  }
}

const CoatAlbedo& CoatAlbedo::table() {
  static const CoatAlbedo made;
  return made;
}

double CoatAlbedo::reflectance(double cosine, double alpha, double ior) const {
  const Cell level = square_cell(std::max(cosine, alpha), kLevels);
  const double v = cosine < alpha ? 0.5 * cosine / alpha
                   : cosine > 0.0 ? 1.0 - 0.5 * alpha / cosine
                                  : 1.0;
  const Cell angle = even_cell(v * static_cast<double>(kAngles - 1), kAngles);
  const Cell index = ior_cell(ior, kIors);
  double sum = 0.0;
  for (std::size_t i = 0; i < 4; ++i) {
    const double weight = (i % 2 == 0 ? 1.0 - angle.part : angle.part) *
                          (i / 2 == 0 ? 1.0 - index.part : index.part);
    const std::size_t row =
        ((index.lower + i / 2) * kAngles + angle.lower + i % 2) * kLevels + level.lower;
    sum += weight * ((1.0 - level.part) * static_cast<double>(reflectance_[row]) +
                     level.part * static_cast<double>(reflectance_[row + 1]));
  }
  return std::min(1.0, kReflectanceMargin * sum);
}

double CoatAlbedo::mean_transmittance(double alpha, double ior) const {
  const Cell rough = square_cell(alpha, kAlphas);
  const Cell index = ior_cell(ior, kIors);
  double sum = 0.0;
  for (std::size_t i = 0; i < 4; ++i) {
    sum += (i % 2 == 0 ? 1.0 - rough.part : rough.part) *
           (i / 2 == 0 ? 1.0 - index.part : index.part) *
           static_cast<double>(
               mean_transmittance_[(index.lower + i / 2) * kAlphas + rough.lower + i % 2]);
  }
  return kMeanMargin * sum;
}

}  // namespace haarlight::render
