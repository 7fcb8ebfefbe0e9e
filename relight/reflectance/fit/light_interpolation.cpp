// SPDX-License-Identifier: Apache-2.0
#include "relight/reflectance/fit/light_interpolation.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include <Eigen/Core>
#include <fmt/format.h>

#include "core/linear_algebra.h"
#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

using Directions = std::vector<Eigen::Vector3d>;
using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

/// Singular values below this fraction of the largest count as zero: light lists give
/// directions to about seven digits.
constexpr double kRankTolerance = 1e-6;
constexpr int kDrift = 4;
/// Lights off a plane by less than this fraction of their spread count as in it.
constexpr double kFlat = 1e-3;

Index count(const Directions& directions) { return static_cast<Index>(directions.size()); }

double kernel_at(const LightInterpolation& interpolation, double r) {
  switch (interpolation.kernel) {
    case KrigingKernel::linear:
      return -r;
    case KrigingKernel::thin_plate:
      return r > 0.0 ? r * r * std::log(r) : 0.0;
    case KrigingKernel::cubic:
      return r * r * r;
    case KrigingKernel::matern:
      break;
  }
  const double t = std::numbers::sqrt3 * r / interpolation.width;
  return (1.0 + t) * std::exp(-t);
}

double distance(LightSpace space, const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return space == LightSpace::sphere ? (a - b).norm() : (a - b).head<2>().norm();
}

/// (n_directions, n_lights + 4): kernels, then the drift.
MatrixXd kriging_rows(const LightInterpolation& interpolation, const Directions& lights,
                      const Directions& directions) {
  const Index n = count(lights);
  MatrixXd rows(count(directions), n + kDrift);
  for (Index i = 0; i < rows.rows(); ++i) {
    const Eigen::Vector3d& at = directions[static_cast<std::size_t>(i)];
    for (Index k = 0; k < n; ++k) {
      rows(i, k) = kernel_at(interpolation, distance(interpolation.space, at,
                                                     lights[static_cast<std::size_t>(k)]));
    }
    rows.row(i).tail<kDrift>() << 1.0, at.x(), at.y(), at.z();
  }
  return rows;
}

/// First n_lights columns of the inverse of [K + ridge, P; P', 0].
MatrixXd kriging_inverse(const LightInterpolation& interpolation, const Directions& lights) {
  const Index n = count(lights);
  MatrixXd system = MatrixXd::Zero(n + kDrift, n + kDrift);
  system.topRows(n) = kriging_rows(interpolation, lights, lights);
  system.topLeftCorner(n, n).diagonal().array() += interpolation.ridge;
  system.bottomLeftCorner(kDrift, n) = system.topRightCorner(n, kDrift).transpose();
  if (column_rank(system.topRightCorner(n, kDrift), kFlat) == kDrift &&
      interpolation.ridge > 0.0) {
    return inverse_by_lu(system).leftCols(n);
  }
  // Lights in one plane leave the drift undetermined: then the minimum-norm solution.
  return pseudo_inverse(system, 1e-12).leftCols(n);
}

MatrixXd radial_rows(const Directions& lights, double sigma, const Directions& directions) {
  ReflectanceModel model;
  model.basis = ReflectanceBasis::rbf;
  model.colour = ReflectanceColour::pca;
  model.lights = lights;
  model.rbf_sigma = sigma;
  MatrixXd rows = MatrixXd::Zero(count(directions), count(lights));
  for (Index i = 0; i < rows.rows(); ++i) {
    for (const NodeWeight& weight :
         node_weights(model, directions[static_cast<std::size_t>(i)])) {
      rows(i, weight.node) += weight.weight;
    }
  }
  return rows;
}

Directions without(const Directions& lights, std::size_t i) {
  Directions others = lights;
  others.erase(others.begin() + static_cast<std::ptrdiff_t>(i));
  return others;
}

/// Where no closed form is known: the fit repeated on the other lights.
MatrixXd leave_out_each(const LightInterpolation& interpolation, const Directions& lights) {
  const Index n = count(lights);
  MatrixXd residual = MatrixXd::Identity(n, n);
  for (Index i = 0; i < n; ++i) {
    const auto at = static_cast<std::size_t>(i);
    const VectorXd weights =
        interpolation_weights(interpolation, without(lights, at), {lights[at]})
            .row(0)
            .transpose();
    residual.row(i).head(i) -= weights.head(i).transpose();
    residual.row(i).tail(n - i - 1) -= weights.tail(n - i - 1).transpose();
  }
  return residual;
}

/// From B with residuals B v of the fit on all lights: the leave-one-out residuals are B_i /
/// B_ii.
MatrixXd divide_by_diagonal(MatrixXd b) {
  for (Index i = 0; i < b.rows(); ++i) {
    const double own = b(i, i);
    if (own > 1e-9 * b.cwiseAbs().maxCoeff()) {
      b.row(i) /= own;
    } else {
      b.row(i).setConstant(std::numeric_limits<double>::quiet_NaN());
    }
  }
  return b;
}

std::string name_of(KrigingKernel kernel) {
  switch (kernel) {
    case KrigingKernel::linear:
      return "linear";
    case KrigingKernel::thin_plate:
      return "thin plate";
    case KrigingKernel::cubic:
      return "cubic";
    case KrigingKernel::matern:
      return "Matern 3/2";
  }
  return "?";
}

}  // namespace

std::string describe(const LightInterpolation& interpolation) {
  switch (interpolation.kind) {
    case InterpolationKind::terms:
      return fmt::format("{} of {} terms, ridge {:g}",
                         interpolation.basis == ReflectanceBasis::ptm ? "PTM" : "HSH",
                         interpolation.n_terms, interpolation.ridge);
    case InterpolationKind::kriging: {
      const std::string width = interpolation.kernel == KrigingKernel::matern
                                    ? fmt::format(" of width {:g}", interpolation.width)
                                    : std::string();
      return fmt::format("{} kriging{} on the {}, noise {:g}", name_of(interpolation.kernel),
                         width, interpolation.space == LightSpace::sphere ? "sphere" : "disc",
                         interpolation.ridge);
    }
    case InterpolationKind::radial:
      return fmt::format("Gaussians of width {:g}, noise {:g}", interpolation.width,
                         interpolation.ridge);
  }
  return "?";
}

MatrixXd terms_of(ReflectanceBasis basis, int n_terms, const Directions& directions) {
  MatrixXd terms(count(directions), n_terms);
  for (Index i = 0; i < terms.rows(); ++i) {
    const Eigen::Vector3d& at = directions[static_cast<std::size_t>(i)];
    if (basis == ReflectanceBasis::ptm) {
      const auto row = ptm_terms(at);
      terms.row(i) = Eigen::Map<const Eigen::RowVectorXd>(row.data(), n_terms);
    } else {
      const auto row = hsh_terms(at, n_terms);
      terms.row(i) = Eigen::Map<const Eigen::RowVectorXd>(row.data(), n_terms);
    }
  }
  return terms;
}

VectorXd ridge_shape(ReflectanceBasis basis, int n_terms) {
  VectorXd shape(n_terms);
  if (basis == ReflectanceBasis::ptm) {
    shape << 1.0, 1.0, 1.0, 0.3, 0.3, 0.0;
    return shape;
  }
  for (int i = 0; i < n_terms; ++i) {
    const double l = std::floor(std::sqrt(static_cast<double>(i)));
    shape[i] = 0.25 * l * l * (l + 1.0) * (l + 1.0);
  }
  return shape;
}

// (X'X / n + ridge R) c = X' v / n, solved as least squares on [X; sqrt(n ridge R)].
MatrixXd term_matrix(const LightInterpolation& interpolation, const Directions& lights) {
  const MatrixXd x = terms_of(interpolation.basis, interpolation.n_terms, lights);
  const Index n = x.rows();
  MatrixXd stacked = MatrixXd::Zero(n + interpolation.n_terms, interpolation.n_terms);
  stacked.topRows(n) = x;
  stacked.bottomRows(interpolation.n_terms).diagonal() =
      (static_cast<double>(n) * interpolation.ridge *
       ridge_shape(interpolation.basis, interpolation.n_terms))
          .cwiseSqrt();
  return pseudo_inverse(stacked, kRankTolerance).leftCols(n);
}

// Values c at the centres with W c = v by least squares, regularised towards v.
MatrixXd radial_centres(const LightInterpolation& interpolation, const Directions& lights) {
  const MatrixXd w = radial_rows(lights, interpolation.width, lights);
  const Index n = w.rows();
  const MatrixXd drawn = interpolation.ridge * MatrixXd::Identity(n, n);
  const MatrixXd normal = w.transpose() * w + drawn;
  const MatrixXd right = w.transpose() + drawn;
  return solve_symmetric(normal, right);
}

MatrixXd interpolation_weights(const LightInterpolation& interpolation,
                               const Directions& lights, const Directions& directions) {
  switch (interpolation.kind) {
    case InterpolationKind::terms:
      return terms_of(interpolation.basis, interpolation.n_terms, directions) *
             term_matrix(interpolation, lights);
    case InterpolationKind::kriging:
      return kriging_rows(interpolation, lights, directions) *
             kriging_inverse(interpolation, lights);
    case InterpolationKind::radial:
      return radial_rows(lights, interpolation.width, directions) *
             radial_centres(interpolation, lights);
  }
  return {};
}

MatrixXd leave_one_out(const LightInterpolation& interpolation, const Directions& lights) {
  const Index n = count(lights);
  if (n < 2) {
    return MatrixXd::Constant(n, n, std::numeric_limits<double>::quiet_NaN());
  }
  constexpr Index kEachAlone = 128;  // beyond, as if the centre were kept: an approximation
  if (interpolation.kind == InterpolationKind::radial && n <= kEachAlone) {
    return leave_out_each(interpolation, lights);
  }
  if (interpolation.kind == InterpolationKind::kriging) {
    return divide_by_diagonal(kriging_inverse(interpolation, lights).topRows(n));
  }
  return divide_by_diagonal(MatrixXd::Identity(n, n) -
                            interpolation_weights(interpolation, lights, lights));
}

TermsCondition terms_condition(ReflectanceBasis basis, int n_terms, const Directions& lights) {
  const RightSingular svd = right_singular(terms_of(basis, n_terms, lights));
  const VectorXd& s = svd.values;
  TermsCondition found;
  for (Index i = 0; i < s.size(); ++i) {
    found.rank += s[i] > kRankTolerance * s[0] ? 1 : 0;
  }
  if (found.rank < n_terms) {
    found.condition = std::numeric_limits<double>::infinity();
    found.ambiguous = svd.vectors.col(n_terms - 1);
  } else {
    found.condition = s[0] / s[n_terms - 1];
  }
  return found;
}

std::vector<std::string> light_warnings(const Directions& lights) {
  std::vector<std::string> warnings;
  std::size_t n_twins = 0;
  std::size_t n_below = 0;
  std::pair<std::size_t, std::size_t> twins{};
  for (std::size_t i = 0; i < lights.size(); ++i) {
    n_below += lights[i].z() < 0.0 ? 1 : 0;
    for (std::size_t k = 0; k < i; ++k) {
      if ((lights[i] - lights[k]).norm() < kRankTolerance) {
        ++n_twins;
        twins = {k, i};
      }
    }
  }
  if (n_twins > 0) {
    warnings.push_back(
        fmt::format("{} pairs of lights coincide (the last: {} and {}): their mean counts",
                    n_twins, twins.first, twins.second));
  }
  if (n_below > 0) {
    warnings.push_back(fmt::format(
        "{} lights are below the picture's plane: bases count them as at the horizon",
        n_below));
  }
  MatrixXd all(count(lights), 3);
  for (Index i = 0; i < all.rows(); ++i) {
    all.row(i) = lights[static_cast<std::size_t>(i)];
  }
  const RightSingular through = right_singular(all);
  const RightSingular around = right_singular(all.rowwise() - all.colwise().mean());
  const auto is_flat = [](const RightSingular& svd) {
    return svd.values.size() < 3 || svd.values[2] <= kFlat * svd.values[0];
  };
  const auto say = [&](const RightSingular& svd, const char* what) {
    const Eigen::Vector3d n = svd.vectors.col(2);
    warnings.push_back(fmt::format(
        "all lights lie {}: how the picture changes along ({:.4f}, {:.4f}, {:.4f}) was not "
        "photographed and is only continued from them",
        what, n.x(), n.y(), n.z()));
  };
  if (is_flat(through)) {
    say(through, "in one plane with the object");
  } else if (is_flat(around)) {
    say(around, "on one circle");
  }
  return warnings;
}

}  // namespace haarlight::relight
