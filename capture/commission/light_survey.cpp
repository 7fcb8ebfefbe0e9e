// SPDX-License-Identifier: Apache-2.0
#include "capture/commission/light_survey.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <limits>
#include <numeric>

#include <Eigen/Core>

#include "core/linear_algebra.h"
#include "core/order_statistics.h"
#include "haarlight/core/error.h"

namespace haarlight::capture {

namespace {

constexpr int kGrid = 3 * kSurveyAcross;  // picture points across and down
constexpr double kTukey = 4.685;          // 95 % efficiency for normal errors
constexpr double kMinLogSigma = 1e-3;     // no better known from an LED's neighbours
constexpr double kSeen = 10.0;            // sigmas of a block's signal: such a block counts
// Sums of squared normalised residuals of a light's blocks: about 64 at its own position.
constexpr double kMisfit = 100.0;  // above the lights' median: not at its position
constexpr double kBetter = 60.0;   // another position fits better by this much
constexpr double kFits = 3.0;      // of the median: that position fits
// Where no position fits that well, shadows dominate the misfits and scale all of a light's
// alike. Of 12 800 lights with rendered stairs in view, 7 of 10 swapped pairs being neighbours,
// the own position's misfit was at most 0.45 of the next best position's for correctly wired
// lights, and at least 6.2 of the true position's for swapped ones
// (docs/numerics/commissioning.md).
constexpr double kClear = 3.0;      // times better: at that position
constexpr double kSettled = 1.5;    // times better than any other position: at its own
constexpr double kAlike = 200.0;    // two positions that differ less look alike
constexpr double kNotThere = 25.0;  // for a block that another position does not light
constexpr int kMinForSurface = 12;  // lights of a face to fit a quadratic surface

double median_or_0(const std::vector<double>& values) {
  return values.empty() ? 0.0 : upper_median(values);
}

/// 1, u, v, u^2, u v, v^2 of a light's position in its face, u and v in -1 .. 1.
Eigen::Matrix<double, 6, 1> position_terms(const Face& face, const LightElement& light) {
  const double u = face.cols > 1 ? 2.0 * light.col / (face.cols - 1) - 1.0 : 0.0;
  const double v = face.rows > 1 ? 2.0 * light.row / (face.rows - 1) - 1.0 : 0.0;
  Eigen::Matrix<double, 6, 1> terms;
  terms << 1.0, u, v, u * u, u * v, v * v;
  return terms;
}

/// A surface over one face, robust against outliers (Tukey's biweight, started from medians).
struct Surface {
  Eigen::Matrix<double, 6, 1> coefficients = Eigen::Matrix<double, 6, 1>::Zero();
  double spread = 0.0;  ///< robust sigma of the residuals

  [[nodiscard]] double at(const Eigen::Matrix<double, 6, 1>& terms) const {
    return coefficients.dot(terms);
  }
};

Surface fit_surface(const std::vector<Eigen::Matrix<double, 6, 1>>& terms,
                    const std::vector<double>& values, double floor) {
  Surface surface;
  if (values.empty()) {
    return surface;
  }
  const Eigen::Index n_terms = values.size() >= kMinForSurface ? 6 : 1;
  surface.coefficients[0] = median_or_0(values);
  std::vector<double> residuals(values.size());
  for (int iteration = 0; iteration < 30; ++iteration) {
    for (std::size_t i = 0; i < values.size(); ++i) {
      residuals[i] = values[i] - surface.at(terms[i]);
    }
    std::vector<double> sizes(residuals.size());
    std::transform(residuals.begin(), residuals.end(), sizes.begin(),
                   [](double r) { return std::abs(r); });
    surface.spread = std::max(kSigmaPerMad * median_or_0(sizes), floor);
    Eigen::MatrixXd normal = 1e-12 * Eigen::MatrixXd::Identity(n_terms, n_terms);
    Eigen::VectorXd right = Eigen::VectorXd::Zero(n_terms);
    for (std::size_t i = 0; i < values.size(); ++i) {
      const double z = residuals[i] / (kTukey * surface.spread);
      if (std::abs(z) >= 1.0) {
        continue;
      }
      const double w = (1.0 - z * z) * (1.0 - z * z);
      const Eigen::VectorXd t = terms[i].head(n_terms);
      normal += w * t * t.transpose();
      right += w * t * values[i];
    }
    surface.coefficients.head(n_terms) = solve_symmetric(normal, right);
  }
  return surface;
}

/// The logarithms of what a light at each position contributes to each block of the picture.
class Positions {
 public:
  Positions(const std::vector<std::array<double, kSurveyBlocks>>& geometry, std::size_t n)
      : geometry_(geometry), logs_(n), spread_(n) {}

  /// From the lit lights of one face: with geometry or without, whichever fits better (a
  /// diffuser, or a rig file whose camera is not where it says).
  void fit(const Face& face, std::size_t offset, const std::vector<LightElement>& lights,
           const std::vector<std::size_t>& shining, std::span<const LightResponse> responses) {
    Logs best;
    double least = std::numeric_limits<double>::infinity();
    for (const bool by_geometry : {true, false}) {
      Logs logs = fit_blocks(face, offset, lights, shining, responses, by_geometry);
      if (logs.roughness < least) {
        least = logs.roughness;
        best = std::move(logs);
      }
    }
    std::move(best.logs.begin(), best.logs.end(),
              logs_.begin() + static_cast<std::ptrdiff_t>(offset));
    std::fill_n(spread_.begin() + static_cast<std::ptrdiff_t>(offset), best.logs.size(),
                best.spread);
  }

  /// Sum of squared normalised residuals of a light's blocks at a position, its power free.
  [[nodiscard]] double misfit(const LightResponse& r, std::size_t position) const {
    return distance(position, [&](std::size_t b) {
      return r.blocks[b] > kSeen * r.block_sigma[b]
                 ? Block{std::log(r.blocks[b]),
                         std::hypot(r.block_sigma[b] / r.blocks[b], spread_[position][b])}
                 : Block{};
    });
  }
  /// The distance between two positions, in the same measure, for a light seen this well.
  [[nodiscard]] double apart(const LightResponse& r, std::size_t a, std::size_t b) const {
    return distance(b, [&](std::size_t i) {
      return r.blocks[i] > kSeen * r.block_sigma[i]
                 ? Block{logs_[a][i], std::hypot(r.block_sigma[i] / r.blocks[i], spread_[a][i])}
                 : Block{};
    });
  }

 private:
  struct Block {
    double log = 0.0;
    double sigma = 0.0;  // 0: does not count
  };

  struct Logs {
    std::vector<std::array<double, kSurveyBlocks>> logs;  // per position of the face
    std::array<double, kSurveyBlocks> spread{};
    double roughness = 0.0;  // sum of the spreads' logarithms
  };

  [[nodiscard]] Logs fit_blocks(const Face& face, std::size_t offset,
                                const std::vector<LightElement>& lights,
                                const std::vector<std::size_t>& shining,
                                std::span<const LightResponse> responses,
                                bool by_geometry) const {
    const auto of_face = static_cast<std::size_t>(face.n_lights());
    const auto log_factor = [&](std::size_t k, std::size_t b) {
      return by_geometry && geometry_[k][b] > 0.0 ? std::log(geometry_[k][b]) : 0.0;
    };
    Logs fitted;
    fitted.logs.resize(of_face);
    for (std::size_t b = 0; b < kSurveyBlocks; ++b) {
      std::vector<Eigen::Matrix<double, 6, 1>> terms;
      std::vector<double> logs;
      for (const std::size_t k : shining) {
        const LightResponse& r = responses[k];
        if (r.blocks[b] > kSeen * r.block_sigma[b]) {
          terms.push_back(position_terms(face, lights[k]));
          logs.push_back(std::log(r.blocks[b]) - log_factor(k, b));
        }
      }
      const Surface surface = fit_surface(terms, logs, kMinLogSigma);
      for (std::size_t i = 0; i < of_face; ++i) {
        const std::size_t k = offset + i;
        fitted.logs[i][b] =
            terms.empty() ? std::numeric_limits<double>::quiet_NaN()
                          : surface.at(position_terms(face, lights[k])) + log_factor(k, b);
      }
      fitted.spread[b] = surface.spread;
      fitted.roughness += std::log(std::max(surface.spread, kMinLogSigma));
    }
    return fitted;
  }

  template <class Of>
  [[nodiscard]] double distance(std::size_t position, Of of) const {
    double sw = 0.0;
    double sx = 0.0;
    double sxx = 0.0;
    double cost = 0.0;
    for (std::size_t b = 0; b < kSurveyBlocks; ++b) {
      const Block block = of(b);
      if (block.sigma <= 0.0) {
        continue;
      }
      const double d = block.log - logs_[position][b];
      if (!std::isfinite(d)) {
        cost += kNotThere;
        continue;
      }
      const double w = 1.0 / (block.sigma * block.sigma);
      sw += w;
      sx += w * d;
      sxx += w * d * d;
    }
    return cost + (sw > 0.0 ? std::max(0.0, sxx - sx * sx / sw) : 0.0);
  }

  const std::vector<std::array<double, kSurveyBlocks>>& geometry_;
  std::vector<std::array<double, kSurveyBlocks>> logs_;
  std::vector<std::array<double, kSurveyBlocks>> spread_;  // of one light about its face's mean
};

/// Two lights cannot be at one position: where one was found at another's, and that one fits
/// the first one's position better than its own, it is the other half of the swap, even where
/// neither position fits it well (objects in view throw shadows that no smooth surface has).
void complete_swaps(const Positions& positions, std::span<const LightResponse> responses,
                    const std::vector<double>& own, LightSurvey& survey,
                    const std::vector<double>& expected) {
  const std::size_t n_found = survey.miswired.size();
  for (std::size_t i = 0; i < n_found; ++i) {
    const int first = survey.miswired[i];
    const int second = survey.miswired_to[i];
    const auto k = static_cast<std::size_t>(second);
    const auto there = static_cast<std::size_t>(first);
    const bool is_known = std::find(survey.miswired.begin(), survey.miswired.end(), second) !=
                          survey.miswired.end();
    if (is_known || survey.power[k] <= 0.0 ||
        own[k] - positions.misfit(responses[k], there) <= kBetter) {
      continue;
    }
    const auto at = std::lower_bound(survey.miswired.begin(), survey.miswired.end(), second);
    survey.miswired_to.insert(survey.miswired_to.begin() + (at - survey.miswired.begin()),
                              first);
    survey.miswired.insert(at, second);
    if (expected[there] > 0.0) {
      survey.power[k] = responses[k].signal / expected[there];
    }
    complete_swaps(positions, responses, own, survey, expected);
    return;
  }
}

/// How well a light fits its own position, and which other one fits best.
struct PositionFit {
  double own = 0.0;
  double least = std::numeric_limits<double>::infinity();  ///< of all other positions
  std::size_t best = 0;
};

enum class PositionVerdict { own, other, nowhere };

/// @param typical  the lights' median misfit
/// @param is_free  of the other position: its own light fits it badly, too, or does not shine
PositionVerdict assess_position(const PositionFit& fit, double typical, bool is_free) {
  if (fit.own <= typical + kMisfit) {
    return PositionVerdict::own;
  }
  const bool is_better = fit.own - fit.least > kBetter;
  if (is_better && fit.least < kFits * typical) {
    return PositionVerdict::other;
  }
  if (is_better && fit.own > kClear * fit.least && is_free) {
    return PositionVerdict::other;
  }
  return fit.least > kSettled * fit.own ? PositionVerdict::own : PositionVerdict::nowhere;
}

/// @param seen  lights that shine
std::vector<PositionFit> fit_positions(const Positions& positions,
                                       std::span<const LightResponse> responses,
                                       const std::vector<std::size_t>& seen, double& typical) {
  std::vector<PositionFit> fits(responses.size());
  std::vector<double> misfits;
  for (const std::size_t k : seen) {
    fits[k].own = positions.misfit(responses[k], k);
    misfits.push_back(fits[k].own);
  }
  typical = std::max(median_or_0(misfits), 1.0);
  for (const std::size_t k : seen) {
    for (std::size_t j = 0; j < responses.size() && fits[k].own > typical + kMisfit; ++j) {
      const double there = j == k ? fits[k].least : positions.misfit(responses[k], j);
      if (there < fits[k].least) {
        fits[k].least = there;
        fits[k].best = j;
      }
    }
  }
  return fits;
}

void find_alike(const Positions& positions, std::span<const LightResponse> responses,
                const std::vector<std::size_t>& seen, LightSurvey& survey) {
  for (const std::size_t k : seen) {
    double nearest = std::numeric_limits<double>::infinity();
    for (std::size_t j = 0; j < responses.size(); ++j) {
      if (j != k) {
        nearest = std::min(nearest, positions.apart(responses[k], k, j));
      }
    }
    if (nearest < kAlike) {
      survey.alike.push_back(static_cast<int>(k));
    }
  }
}

void find_miswired(const Positions& positions, std::span<const LightResponse> responses,
                   const std::vector<double>& expected, LightSurvey& survey) {
  std::vector<std::size_t> seen;
  for (std::size_t k = 0; k < responses.size(); ++k) {
    if (survey.power[k] > 0.0) {
      seen.push_back(k);
    }
  }
  double typical = 1.0;
  const std::vector<PositionFit> fits = fit_positions(positions, responses, seen, typical);
  // Before any power is corrected below: which lights shine, and which leave their position.
  const auto leaves = [&](std::size_t k) {
    return fits[k].own > typical + kMisfit && fits[k].own > kClear * fits[k].least;
  };
  std::vector<int> unplaced;
  for (const std::size_t k : seen) {
    const std::size_t best = fits[k].best;
    const bool is_free = survey.power[best] <= 0.0 || leaves(best);
    const PositionVerdict placed = assess_position(fits[k], typical, is_free);
    if (placed == PositionVerdict::nowhere) {
      unplaced.push_back(static_cast<int>(k));
    } else if (placed == PositionVerdict::other) {
      survey.miswired.push_back(static_cast<int>(k));
      survey.miswired_to.push_back(static_cast<int>(best));
      if (expected[best] > 0.0) {
        survey.power[k] = responses[k].signal / expected[best];
      }
    }
  }
  std::vector<double> own(fits.size());
  std::transform(fits.begin(), fits.end(), own.begin(),
                 [](const PositionFit& fit) { return fit.own; });
  complete_swaps(positions, responses, own, survey, expected);
  std::copy_if(unplaced.begin(), unplaced.end(), std::back_inserter(survey.unplaced),
               [&survey](int k) {
                 return !std::binary_search(survey.miswired.begin(), survey.miswired.end(), k);
               });
  find_alike(positions, responses, seen, survey);
  survey.can_see_wiring = survey.alike.empty() && survey.unplaced.empty() && !seen.empty();
}

}  // namespace

std::vector<std::array<double, kSurveyBlocks>> expected_blocks(const Rig& rig, int camera) {
  const CameraSpec& spec = rig.cameras.at(static_cast<std::size_t>(camera));
  struct PlanePoint {
    Eigen::Vector3d at;
    Eigen::Vector3d n;
    std::size_t block;
  };
  std::vector<PlanePoint> points;
  for (int j = 0; j < kGrid; ++j) {
    for (int i = 0; i < kGrid; ++i) {
      const CameraRay ray = ray_through(spec.model, (i + 0.5) * spec.model.width / kGrid,
                                        (j + 0.5) * spec.model.height / kGrid);
      double nearest = std::numeric_limits<double>::infinity();
      const ShadowPlane* seen = nullptr;
      for (const ShadowPlane& plane : rig.planes) {
        const double towards = plane.n.dot(ray.direction_world);
        const double t = -(plane.n.dot(ray.origin_world) + plane.d) / towards;
        if (towards != 0.0 && t > 0.0 && t < nearest) {
          nearest = t;
          seen = &plane;
        }
      }
      if (seen != nullptr) {
        const int block = j * kSurveyAcross / kGrid * kSurveyAcross + i * kSurveyAcross / kGrid;
        points.push_back({ray.origin_world + nearest * ray.direction_world, seen->n,
                          static_cast<std::size_t>(block)});
      }
    }
  }
  std::vector<std::array<double, kSurveyBlocks>> expected;
  for (const LightElement& light : light_elements(rig)) {
    std::array<double, kSurveyBlocks> blocks{};
    for (const PlanePoint& point : points) {
      const Eigen::Vector3d way = light.centre - point.at;
      const double r2 = way.squaredNorm();
      const double r = std::sqrt(r2);
      const double cos_plane = std::abs(point.n.dot(way)) / r;
      const double cos_light = std::max(0.0, -light.emits.dot(way) / r);
      blocks[point.block] += cos_plane * std::pow(cos_light, light.lobe_mu) / r2;
    }
    expected.push_back(blocks);
  }
  return expected;
}

std::vector<double> expected_signals(const Rig& rig, int camera) {
  std::vector<double> expected;
  for (const auto& blocks : expected_blocks(rig, camera)) {
    expected.push_back(std::accumulate(blocks.begin(), blocks.end(), 0.0));
  }
  if (*std::max_element(expected.begin(), expected.end()) <= 0.0) {
    std::fill(expected.begin(), expected.end(), 1.0);  // no plane in view: use neighbours only
  }
  return expected;
}

LightSurvey survey_lights(const Rig& rig, int camera, std::span<const LightResponse> responses,
                          const SurveyOptions& options) {
  HAARLIGHT_EXPECTS(static_cast<int>(responses.size()) == rig.n_lights(),
                    "a response of each light");
  const auto geometry_blocks = expected_blocks(rig, camera);
  const std::vector<double> geometry = expected_signals(rig, camera);
  const std::vector<LightElement> lights = light_elements(rig);
  const std::size_t n = responses.size();
  LightSurvey survey;
  survey.power.assign(n, 0.0);
  std::vector<double> expected(n, 0.0);
  std::vector<double> sigmas;
  Positions positions(geometry_blocks, n);
  std::size_t offset = 0;
  for (const Face& face : rig.faces) {
    const auto of_face = static_cast<std::size_t>(face.n_lights());
    std::vector<Eigen::Matrix<double, 6, 1>> terms;
    std::vector<double> logs;
    std::vector<std::size_t> shining;
    std::vector<double> ratios;
    for (std::size_t k = offset; k < offset + of_face; ++k) {
      if (geometry[k] > 0.0) {
        ratios.push_back(responses[k].signal / geometry[k]);
      }
    }
    const double typical = median_or_0(ratios);
    for (std::size_t k = offset; k < offset + of_face; ++k) {
      const LightResponse& r = responses[k];
      const bool shines = geometry[k] > 0.0 && typical > 0.0 &&
                          r.signal > std::max(0.1 * typical * geometry[k], 5.0 * r.sigma);
      if (shines) {
        terms.push_back(position_terms(face, lights[k]));
        logs.push_back(std::log(r.signal / geometry[k]));
        shining.push_back(k);
      }
    }
    const Surface level = fit_surface(terms, logs, kMinLogSigma);
    positions.fit(face, offset, lights, shining, responses);
    for (std::size_t k = offset; k < offset + of_face; ++k) {
      const Eigen::Matrix<double, 6, 1> here = position_terms(face, lights[k]);
      expected[k] = terms.empty() ? 0.0 : geometry[k] * std::exp(level.at(here));
      const LightResponse& r = responses[k];
      const auto number = static_cast<int>(k);
      if (expected[k] < 10.0 * r.sigma || expected[k] <= 0.0) {
        survey.unseen.push_back(number);
        continue;
      }
      const double power = r.signal / expected[k];
      if (power < options.dead_below) {
        survey.dead.push_back(number);
        continue;
      }
      survey.power[k] = power;
      // Six coefficients from this many lights: the uncertainty of the surface itself.
      sigmas.push_back(
          std::hypot(r.sigma / expected[k],
                     level.spread * std::sqrt(6.0 / static_cast<double>(terms.size()))));
    }
    offset += of_face;
  }
  survey.power_sigma = median_or_0(sigmas);
  find_miswired(positions, responses, expected, survey);
  for (std::size_t k = 0; k < n; ++k) {
    if (survey.power[k] > 0.0 && survey.power[k] < options.dim_below) {
      survey.dim.push_back(static_cast<int>(k));
    }
  }
  return survey;
}

}  // namespace haarlight::capture
