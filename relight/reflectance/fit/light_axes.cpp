// SPDX-License-Identifier: Apache-2.0
#include "relight/reflectance/fit/light_axes.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Core>

#include "core/linear_algebra.h"

namespace haarlight::relight {

namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

/// Up to this many numbers per pixel, all of them are used; beyond, the subspace of that many
/// pixels.
constexpr Index kMostExact = 768;

/// S with S S' the covariance of the sample (columns: pixels minus the mean).
MatrixXd covariance_factor(const Eigen::MatrixXf& values, const VectorXd& mean) {
  const Index n = values.rows();
  const Index n_pixels = values.cols();
  if (n > kMostExact) {
    const Index m = std::min(kMostExact, n_pixels);
    MatrixXd factor(n, m);
    for (Index j = 0; j < m; ++j) {
      factor.col(j) = values.col(j * n_pixels / m).cast<double>() - mean;
    }
    return factor / std::sqrt(static_cast<double>(m));
  }
  MatrixXd covariance = MatrixXd::Zero(n, n);
  constexpr Index kChunk = 2048;
  for (Index from = 0; from < n_pixels; from += kChunk) {
    const Index m = std::min(kChunk, n_pixels - from);
    const Eigen::MatrixXf part = values.middleCols(from, m).colwise() - mean.cast<float>();
    const Eigen::MatrixXf product = part * part.transpose();
    covariance += product.cast<double>();
  }
  const SymmetricEigen found = symmetric_eigen(covariance / static_cast<double>(n_pixels));
  return found.vectors * found.values.cwiseMax(0.0).cwiseSqrt().asDiagonal();
}

/// (A x I3) s: a matrix over lights applied to each channel.
MatrixXd apply_by_channel(const MatrixXd& a, const MatrixXd& s) {
  MatrixXd out(3 * a.rows(), s.cols());
  const Index n = a.cols();
  for (Index c = 0; c < 3; ++c) {
    MatrixXd part(n, s.cols());
    for (Index k = 0; k < n; ++k) {
      part.row(k) = s.row(3 * k + c);
    }
    const MatrixXd result = a * part;
    for (Index k = 0; k < a.rows(); ++k) {
      out.row(3 * k + c) = result.row(k);
    }
  }
  return out;
}

}  // namespace

// With pixels x = mean + S z, nodes y = W x and weights q: the axes of q^(1/2) y are W S u / s
// for the eigenvectors u of H = S' W' q W S with eigenvalues s^2, and a pixel's planes are
// u' S' W' q W (x - mean) / s.
LightAxes find_light_axes(const MatrixXd& nodes, const VectorXd& weights,
                          const LightSample& sample, int n_planes) {
  const VectorXd mean = sample.values.rowwise().mean().cast<double>();
  const MatrixXd s = covariance_factor(sample.values, mean);
  const MatrixXd weighted = nodes.transpose() * weights.asDiagonal() * nodes;
  const MatrixXd towards = apply_by_channel(weighted, s);
  const SymmetricEigen eigen = symmetric_eigen(s.transpose() * towards);
  const VectorXd& energies = eigen.values;  // ascending
  const Index n_all = energies.size();
  LightAxes found;
  found.matrix.setZero(n_planes, sample.values.rows());
  found.axes.setZero(n_planes + 1, 3 * nodes.rows());
  double kept = 0.0;
  for (Index p = 0; p < std::min<Index>(n_planes, n_all); ++p) {
    const double energy = energies[n_all - 1 - p];
    if (energy <= 1e-12 * energies[n_all - 1] || energy <= 0.0) {
      break;  // rounding error: the plane stays 0
    }
    const VectorXd u = eigen.vectors.col(n_all - 1 - p) / std::sqrt(energy);
    found.matrix.row(p) = (towards * u).transpose();
    found.axes.row(p + 1) = apply_by_channel(nodes, s * u).col(0).transpose().cast<float>();
    kept += energy;
  }
  found.axes.row(0) = apply_by_channel(nodes, mean)
                          .col(0)
                          .transpose()
                          .cwiseMax(0.0)
                          .cwiseMin(1.0)
                          .cast<float>();
  found.added = -found.matrix * mean;
  found.dropped = std::max(0.0, energies.sum() - kept) / 3.0;
  return found;
}

}  // namespace haarlight::relight
