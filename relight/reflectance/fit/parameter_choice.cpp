// SPDX-License-Identifier: Apache-2.0
#include "relight/reflectance/fit/parameter_choice.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "relight/reflectance/fit/light_axes.h"

namespace haarlight::relight {

namespace {

using Directions = std::vector<Eigen::Vector3d>;
using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

/// Beyond this many lights, few candidates with cubic cost in the lights are tried.
constexpr std::size_t kManyLights = 256;
constexpr double kNothing = -std::numeric_limits<double>::infinity();

int n_terms_of(FitForm form) {
  switch (form) {
    case FitForm::ptm:
    case FitForm::lptm:
      return 6;
    case FitForm::hsh4:
      return 4;
    case FitForm::hsh9:
      return 9;
    case FitForm::hsh16:
      return 16;
    case FitForm::rbf:
    case FitForm::bilinear:
      break;
  }
  return 0;
}

bool is_pca(FitForm form) { return form == FitForm::rbf || form == FitForm::bilinear; }

int n_planes_of_form(FitForm form, std::size_t n_lights, const FormOptions& options) {
  if (form == FitForm::lptm) {
    return 9;
  }
  if (!is_pca(form)) {
    return 3 * n_terms_of(form);
  }
  // Pictures of a web folder hold three planes each.
  const int all = static_cast<int>(n_lights) * 3;
  return std::max(3, std::min(options.max_planes, all) / 3 * 3);
}

void add_terms(FitForm form, const FormOptions& options,
               std::vector<LightInterpolation>& candidates) {
  LightInterpolation interpolation;
  interpolation.kind = InterpolationKind::terms;
  interpolation.basis = form == FitForm::ptm || form == FitForm::lptm ? ReflectanceBasis::ptm
                                                                      : ReflectanceBasis::hsh;
  interpolation.n_terms = n_terms_of(form);
  for (const double ridge : {0.0, 1e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1}) {
    interpolation.ridge = options.ridge.value_or(ridge);
    candidates.push_back(interpolation);
  }
}

void add_kriging(const FormOptions& options, std::vector<LightInterpolation>& candidates) {
  LightInterpolation interpolation;
  interpolation.kind = InterpolationKind::kriging;
  const auto add_noises = [&] {
    for (const LightSpace space : {LightSpace::sphere, LightSpace::disc}) {
      interpolation.space = space;
      for (const double noise : {1e-4, 1e-3, 1e-2, 3e-2, 0.1, 0.3}) {
        interpolation.ridge = options.ridge.value_or(noise);
        candidates.push_back(interpolation);
      }
    }
  };
  for (const KrigingKernel kernel :
       {KrigingKernel::thin_plate, KrigingKernel::linear, KrigingKernel::cubic}) {
    interpolation.kernel = kernel;
    add_noises();
  }
  interpolation.kernel = KrigingKernel::matern;
  for (const double width : {0.35, 0.5, 0.7, 1.0, 1.5}) {
    interpolation.width = width;
    add_noises();
  }
}

void add_radial(const FormOptions& options, std::vector<LightInterpolation>& candidates) {
  LightInterpolation interpolation;
  interpolation.kind = InterpolationKind::radial;
  for (const double width : {0.2, 0.3, 0.4, 0.55, 0.75, 1.0}) {
    for (const double noise : {1e-3, 1e-2, 0.1}) {
      interpolation.width = width;
      interpolation.ridge = options.ridge.value_or(noise);
      candidates.push_back(interpolation);
    }
  }
}

/// The mean over the lights of 10 log10(1 / mean square).
double mean_psnr(const VectorXd& squares, double dropped) {
  double sum = 0.0;
  for (const double square : squares) {
    if (!std::isfinite(square)) {
      return kNothing;
    }
    // 1e-10: 100 dB, so that exact data cause no division by zero.
    sum -= 10.0 * std::log10(std::max(square + dropped, 1e-10));
  }
  return sum / static_cast<double>(squares.size());
}

VectorXd left_out_squares(const MatrixXd& residual, const MatrixXd& products) {
  return (residual * products).cwiseProduct(residual).rowwise().sum();
}

/// Colours and luminance factors of a sample's pixels, as fit_far() finds them.
struct Luminance {
  Eigen::MatrixXf colours;  ///< (3, n_pixels)
  Eigen::MatrixXf factors;  ///< (n_lights, n_pixels)
};

Luminance luminance_of(const LightSample& sample) {
  const Index n = sample.n_lights();
  const Index n_pixels = sample.values.cols();
  Luminance found{Eigen::MatrixXf::Zero(3, n_pixels), Eigen::MatrixXf::Zero(n, n_pixels)};
  for (Index j = 0; j < n_pixels; ++j) {
    const Eigen::Map<const Eigen::MatrixXf> pixel(sample.values.col(j).data(), 3, n);
    Eigen::VectorXf colour = pixel.rowwise().sum();
    const float most = std::max({colour[0], colour[1], colour[2]});
    if (most > 0.0F) {
      colour /= most;
      found.colours.col(j) = colour;
      found.factors.col(j) = pixel.transpose() * colour / colour.squaredNorm();
    }
  }
  return found;
}

/// lrgb is no sum over lights: its residuals are taken pixel by pixel (the colour is that of
/// all lights, including the one left out: it contributes 1 / n_lights).
double left_out_psnr_lrgb(const LightInterpolation& interpolation, const Directions& lights,
                          const LightSample& sample, const Luminance& luminance) {
  const Eigen::MatrixXf residual = leave_one_out(interpolation, lights).cast<float>();
  if (!residual.allFinite()) {
    return kNothing;
  }
  const Eigen::MatrixXf predicted = luminance.factors - residual * luminance.factors;
  VectorXd squares(sample.n_lights());
  for (Index k = 0; k < squares.size(); ++k) {
    double sum = 0.0;
    for (Index c = 0; c < 3; ++c) {
      sum += static_cast<double>((sample.values.row(3 * k + c).array() -
                                  luminance.colours.row(c).array() * predicted.row(k).array())
                                     .square()
                                     .sum());
    }
    squares[k] = sum / (3.0 * static_cast<double>(sample.values.cols()));
  }
  return mean_psnr(squares, 0.0);
}

Directions octahedral_directions(int resolution) {
  Directions directions;
  directions.reserve(static_cast<std::size_t>(resolution) *
                     static_cast<std::size_t>(resolution));
  for (int row = 0; row < resolution; ++row) {
    for (int column = 0; column < resolution; ++column) {
      directions.push_back(octahedral_direction(row, column, resolution));
    }
  }
  return directions;
}

/// Interpolation from the nodes to the lights: (n_lights, n_nodes).
MatrixXd nodes_to_lights(const ReflectanceModel& model, const Directions& lights) {
  const int n_nodes = model.basis == ReflectanceBasis::rbf
                          ? static_cast<int>(model.lights.size())
                          : model.resolution * model.resolution;
  MatrixXd rows = MatrixXd::Zero(static_cast<Index>(lights.size()), n_nodes);
  for (std::size_t i = 0; i < lights.size(); ++i) {
    for (const NodeWeight& weight : node_weights(model, lights[i])) {
      rows(static_cast<Index>(i), weight.node) += weight.weight;
    }
  }
  return rows;
}

/// A pca fit and its loss from interpolation to planes, except for the 8 bits.
struct AxesFit {
  FarFit fit;
  double dropped = 0.0;
};

AxesFit make_axes_fit(FitForm form, const LightInterpolation& interpolation,
                      const Directions& lights, const LightSample& sample,
                      const FormOptions& options) {
  AxesFit made;
  ReflectanceModel& model = made.fit.model;
  model.colour = ReflectanceColour::pca;
  MatrixXd nodes;
  if (form == FitForm::rbf) {
    model.basis = ReflectanceBasis::rbf;
    model.lights = lights;
    model.rbf_sigma = interpolation.width;
    nodes = radial_centres(interpolation, lights);
  } else {
    model.basis = ReflectanceBasis::bilinear;
    model.resolution = options.resolution;
    model.lights = lights;
    nodes =
        interpolation_weights(interpolation, lights, octahedral_directions(options.resolution));
  }
  // Errors count where lights are; a tenth is spread evenly, so that no node is ignored.
  const MatrixXd spread = nodes_to_lights(model, lights);
  const VectorXd weights = 0.9 * spread.colwise().mean().transpose().array() +
                           0.1 / static_cast<double>(nodes.rows());
  model.n_terms = n_planes_of_form(form, lights.size(), options);
  LightAxes axes = find_light_axes(nodes, weights, sample, model.n_terms);
  model.axes = std::move(axes.axes);
  made.fit.matrix = std::move(axes.matrix);
  made.fit.added = std::move(axes.added);
  const MatrixXd missed = spread * nodes - interpolation_weights(interpolation, lights, lights);
  made.dropped = axes.dropped + left_out_squares(missed, sample.products()).mean();
  return made;
}

}  // namespace

// The inverse of node_weights()' map of directions: with (a, b) in -1..1, x = (a - b) / 2, y =
// (a + b) / 2, z = 1 - |x| - |y|, scaled to length 1.
Eigen::Vector3d octahedral_direction(int row, int column, int resolution) {
  HAARLIGHT_EXPECTS(resolution >= 2, "a grid of 2 x 2 points or more");
  const double a = 2.0 * column / (resolution - 1) - 1.0;
  const double b = 2.0 * row / (resolution - 1) - 1.0;
  const double x = 0.5 * (a - b);
  const double y = 0.5 * (a + b);
  return Eigen::Vector3d(x, y, std::max(0.0, 1.0 - std::abs(x) - std::abs(y))).normalized();
}

std::vector<LightInterpolation> candidates_of(FitForm form, const FormOptions& options) {
  std::vector<LightInterpolation> candidates;
  if (form == FitForm::rbf) {
    add_radial(options, candidates);
  } else if (form == FitForm::bilinear) {
    add_kriging(options, candidates);
  } else {
    add_terms(form, options, candidates);
  }
  return candidates;
}

double left_out_psnr(const LightInterpolation& interpolation, const Directions& lights,
                     const MatrixXd& products, double dropped) {
  const MatrixXd residual = leave_one_out(interpolation, lights);
  return residual.allFinite() ? mean_psnr(left_out_squares(residual, products), dropped)
                              : kNothing;
}

std::vector<FormScore> score_forms(const std::vector<FitForm>& forms, const Directions& lights,
                                   const LightSample& sample, const FormOptions& options) {
  HAARLIGHT_EXPECTS(!lights.empty() && sample.n_lights() == static_cast<Index>(lights.size()),
                    "one direction per light");
  const MatrixXd products = sample.products();
  std::vector<FormScore> scores;
  for (const FitForm form : forms) {
    FormScore score{form, {}, n_planes_of_form(form, lights.size(), options), kNothing};
    std::vector<LightInterpolation> candidates = candidates_of(form, options);
    score.interpolation =
        candidates.back();  // the smoothest, where leave-one-out is uninformative
    if (lights.size() > kManyLights && is_pca(form)) {
      // One of each kind: medium noise. The more lights, the less the choice matters.
      candidates.erase(std::remove_if(candidates.begin(), candidates.end(),
                                      [](const LightInterpolation& interpolation) {
                                        return interpolation.ridge != 1e-2 ||
                                               interpolation.space == LightSpace::disc ||
                                               interpolation.kernel !=
                                                   KrigingKernel::thin_plate;
                                      }),
                       candidates.end());
      score.interpolation = candidates.empty() ? score.interpolation : candidates.back();
    }
    const Luminance luminance = form == FitForm::lptm ? luminance_of(sample) : Luminance{};
    for (const LightInterpolation& interpolation : candidates) {
      const double psnr = form == FitForm::lptm
                              ? left_out_psnr_lrgb(interpolation, lights, sample, luminance)
                              : left_out_psnr(interpolation, lights, products);
      if (psnr > score.psnr_db) {
        score.psnr_db = psnr;
        score.interpolation = interpolation;
      }
    }
    if (is_pca(form) && std::isfinite(score.psnr_db)) {
      const double dropped =
          make_axes_fit(form, score.interpolation, lights, sample, options).dropped;
      score.psnr_db = left_out_psnr(score.interpolation, lights, products, dropped);
    }
    scores.push_back(score);
  }
  std::stable_sort(scores.begin(), scores.end(), [](const FormScore& a, const FormScore& b) {
    return a.psnr_db > b.psnr_db;
  });
  return scores;
}

FarFit make_far_fit(FitForm form, const LightInterpolation& interpolation,
                    const Directions& lights, const LightSample& sample,
                    const FormOptions& options) {
  if (is_pca(form)) {
    return make_axes_fit(form, interpolation, lights, sample, options).fit;
  }
  FarFit fit;
  fit.model.basis = interpolation.basis;
  fit.model.colour = form == FitForm::lptm ? ReflectanceColour::lrgb : ReflectanceColour::rgb;
  fit.model.n_terms = interpolation.n_terms;
  fit.matrix = term_matrix(interpolation, lights);
  fit.added = VectorXd::Zero(interpolation.n_terms);
  fit.model.lights = lights;
  return fit;
}

}  // namespace haarlight::relight
