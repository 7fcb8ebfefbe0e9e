// SPDX-License-Identifier: Apache-2.0
#include "capture/commission/step_response.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <set>
#include <utility>

#include <Eigen/Core>

#include "core/linear_algebra.h"
#include "core/order_statistics.h"
#include "haarlight/core/error.h"

namespace haarlight::capture {

namespace {

constexpr double kHuber = 2.0;    // in sigmas: 95 % of clean samples stay quadratic
constexpr double kMinRamp = 1.0;  // us: below it a ramp is indistinguishable from a jump
constexpr double kMaxRamp = 1e6;  // us
constexpr int kGroups = 20;       // of the jackknife
constexpr int kMaxIterations = 60;
constexpr double kConverged = 1e-4;   // us, of every parameter
constexpr double kPartialLow = 0.15;  // levels taken as the linear part when starting
constexpr double kPartialHigh = 0.85;

double ramp_integral(double u, double ramp) {
  if (u <= 0.0) {
    return 0.0;
  }
  return u < ramp ? u * u / (2.0 * ramp) : u - 0.5 * ramp;
}

double ramp_level(double u, double ramp) {
  if (u <= 0.0) {
    return 0.0;
  }
  return u < ramp ? u / ramp : 1.0;
}

/// d/dT of ramp_integral.
double ramp_integral_slope(double u, double ramp) {
  if (u <= 0.0) {
    return 0.0;
  }
  return u < ramp ? -u * u / (2.0 * ramp * ramp) : -0.5;
}

/// Layout of the parameter vector: offsets first, then skew, rise, fall.
struct Layout {
  std::vector<double> exposures;
  std::optional<double> slope;

  [[nodiscard]] Eigen::Index n_offsets() const {
    return slope ? 1 : static_cast<Eigen::Index>(exposures.size());
  }
  [[nodiscard]] Eigen::Index size() const { return n_offsets() + 3; }
  [[nodiscard]] Eigen::Index offset_index(std::size_t exposure) const {
    return slope ? 0 : static_cast<Eigen::Index>(exposure);
  }
  [[nodiscard]] double offset(const Eigen::VectorXd& p, std::size_t exposure) const {
    return p[offset_index(exposure)] + (slope ? *slope * exposures[exposure] : 0.0);
  }
  [[nodiscard]] std::size_t exposure_index(double exposure_us) const {
    return static_cast<std::size_t>(
        std::lower_bound(exposures.begin(), exposures.end(), exposure_us) - exposures.begin());
  }
};

struct Point {
  StepSample sample;
  std::size_t exposure = 0;
  std::size_t step = 0;  ///< of Fitted::late
};

/// The variables of the minimisation.
struct Fitted {
  Eigen::VectorXd p;
  std::vector<double> late;  ///< each step's own delay, us; empty: steps have none
};

/// Samples, and how far each step's own delay may deviate.
struct Problem {
  Layout layout;
  std::vector<Point> points;
  std::vector<double> delay_sigma;  ///< us, of each step; empty: steps have no own delay
};

/// Residual (level - model) and its derivatives at one sample.
struct Linear {
  double residual = 0.0;
  double slope_x = 0.0;     // of the model
  double slope_ramp = 0.0;  // of the model
  double sigma = 1.0;
};

/// @param late_us  the step's own delay; nothing: its jitter counts as the sample's noise
Linear linearise(const Layout& layout, const Eigen::VectorXd& p, const Point& point,
                 std::optional<double> late_us = std::nullopt) {
  const StepSample& s = point.sample;
  const Eigen::Index m = layout.n_offsets();
  const double e = s.exposure_us;
  const double ramp = s.rises ? p[m + 1] : p[m + 2];
  const double x =
      s.after_us + s.row * p[m] + e - layout.offset(p, point.exposure) - late_us.value_or(0.0);
  const double sign = s.rises ? 1.0 : -1.0;
  const double fraction = (ramp_integral(x, ramp) - ramp_integral(x - e, ramp)) / e;
  Linear out;
  out.residual = s.level - (s.rises ? fraction : 1.0 - fraction);
  out.slope_x = sign * (ramp_level(x, ramp) - ramp_level(x - e, ramp)) / e;
  out.slope_ramp = sign * (ramp_integral_slope(x, ramp) - ramp_integral_slope(x - e, ramp)) / e;
  out.sigma = late_us ? s.sigma : std::hypot(s.sigma, out.slope_x * s.jitter_us);
  return out;
}

Linear linearise(const Problem& problem, const Fitted& at, const Point& point) {
  return linearise(problem.layout, at.p, point,
                   at.late.empty() ? std::nullopt : std::optional(at.late[point.step]));
}

double huber_cost(double z) {
  const double a = std::abs(z);
  return a <= kHuber ? 0.5 * z * z : kHuber * (a - 0.5 * kHuber);
}

bool is_skipped(const Point& point, int skip_group) {
  return skip_group >= 0 && point.sample.step % kGroups == skip_group;
}

/// Per step that has a delay of its own; else of all samples together.
std::vector<double> costs(const Problem& problem, const Fitted& at, int skip_group) {
  std::vector<double> cost(std::max<std::size_t>(at.late.size(), 1), 0.0);
  for (const Point& point : problem.points) {
    if (is_skipped(point, skip_group)) {
      continue;
    }
    // The sigma depends on the parameters, so its logarithm belongs to the cost.
    const Linear l = linearise(problem, at, point);
    cost[at.late.empty() ? 0 : point.step] +=
        huber_cost(l.residual / l.sigma) + std::log(l.sigma);
  }
  for (std::size_t i = 0; i < at.late.size(); ++i) {
    const double z = at.late[i] / problem.delay_sigma[i];
    cost[i] += 0.5 * z * z;
  }
  return cost;
}

double sum_of(const std::vector<double>& values) {
  return std::accumulate(values.begin(), values.end(), 0.0);
}

/// Cost of `next`. A step whose delay, moved as the linear model says, fits worse than moved by
/// half or not at all keeps the better one: its nonlinearity must not stall the common
/// parameters.
double settle_delays(const Problem& problem, const Fitted& before, Fitted& next,
                     int skip_group) {
  std::vector<double> best = costs(problem, next, skip_group);
  const std::vector<double> whole = next.late;
  for (const double fraction : {0.5, 0.0}) {
    if (whole.empty()) {
      break;
    }
    Fitted other = next;
    for (std::size_t i = 0; i < whole.size(); ++i) {
      other.late[i] = before.late[i] + fraction * (whole[i] - before.late[i]);
    }
    const std::vector<double> cost = costs(problem, other, skip_group);
    for (std::size_t i = 0; i < whole.size(); ++i) {
      if (!(best[i] <= cost[i])) {
        best[i] = cost[i];
        next.late[i] = other.late[i];
      }
    }
  }
  return sum_of(best);
}

void clamp_ramps(Eigen::VectorXd& p) {
  const Eigen::Index n = p.size();
  p[n - 2] = std::clamp(p[n - 2], kMinRamp, kMaxRamp);
  p[n - 1] = std::clamp(p[n - 1], kMinRamp, kMaxRamp);
}

/// What the samples say about one step's own delay, given the common parameters.
struct OwnDelay {
  double normal = 0.0;
  double gradient = 0.0;
  Eigen::VectorXd cross;
};

/// The step of the common parameters; `delays` are eliminated from it, and updated with it.
Eigen::VectorXd solve(Eigen::MatrixXd normal, Eigen::VectorXd gradient,
                      const std::vector<OwnDelay>& delays, double damping,
                      std::vector<double>& late) {
  normal.diagonal() *= 1.0 + damping;
  for (const OwnDelay& d : delays) {
    const double pivot = d.normal * (1.0 + damping);
    normal.noalias() -= d.cross * d.cross.transpose() / pivot;
    gradient.noalias() -= d.cross * (d.gradient / pivot);
  }
  Eigen::VectorXd step = solve_symmetric(normal, gradient);
  for (std::size_t i = 0; i < delays.size(); ++i) {
    const OwnDelay& d = delays[i];
    late[i] += (d.gradient - d.cross.dot(step)) / (d.normal * (1.0 + damping));
  }
  return step;
}

Fitted minimise(const Problem& problem, Fitted at, int skip_group) {
  const Layout& layout = problem.layout;
  const Eigen::Index m = layout.n_offsets();
  const Eigen::Index n = layout.size();
  double damping = 1e-3;
  double cost = sum_of(costs(problem, at, skip_group));
  Eigen::VectorXd row = Eigen::VectorXd::Zero(n);
  for (int iteration = 0; iteration < kMaxIterations; ++iteration) {
    Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(n, n);
    Eigen::VectorXd gradient = Eigen::VectorXd::Zero(n);
    std::vector<OwnDelay> delays(at.late.size());
    for (std::size_t i = 0; i < delays.size(); ++i) {
      const double weight = 1.0 / (problem.delay_sigma[i] * problem.delay_sigma[i]);
      delays[i] = {weight, -weight * at.late[i], Eigen::VectorXd::Zero(n)};
    }
    for (const Point& point : problem.points) {
      if (is_skipped(point, skip_group)) {
        continue;
      }
      const Linear l = linearise(problem, at, point);
      if (l.slope_x == 0.0 && l.slope_ramp == 0.0) {
        continue;  // far from the step
      }
      row.setZero();
      row[layout.offset_index(point.exposure)] = -l.slope_x;
      row[m] = l.slope_x * point.sample.row;
      row[point.sample.rises ? m + 1 : m + 2] = l.slope_ramp;
      const double z = std::abs(l.residual / l.sigma);
      const double weight = (z <= kHuber ? 1.0 : kHuber / z) / (l.sigma * l.sigma);
      normal.noalias() += weight * row * row.transpose();
      gradient.noalias() += weight * l.residual * row;
      if (!delays.empty()) {
        OwnDelay& d = delays[point.step];
        d.normal += weight * l.slope_x * l.slope_x;
        d.gradient -= weight * l.slope_x * l.residual;
        d.cross.noalias() -= weight * l.slope_x * row;
      }
    }
    // A parameter that no sample depends on stays where it is.
    for (Eigen::Index i = 0; i < n; ++i) {
      if (normal(i, i) <= 0.0) {
        normal(i, i) = 1.0;
      }
    }
    bool is_better = false;
    double moved = 0.0;
    for (int attempt = 0; attempt < 12 && !is_better; ++attempt) {
      Fitted next = at;
      next.p += solve(normal, gradient, delays, damping, next.late);
      if (!next.p.allFinite()) {
        damping *= 10.0;
        continue;
      }
      clamp_ramps(next.p);
      const double next_cost = settle_delays(problem, at, next, skip_group);
      if (next_cost <= cost) {
        moved = (next.p - at.p).cwiseAbs().maxCoeff();
        for (std::size_t i = 0; i < at.late.size(); ++i) {
          moved = std::max(moved, std::abs(next.late[i] - at.late[i]));
        }
        at = std::move(next);
        cost = next_cost;
        damping = std::max(damping * 0.2, 1e-9);
        is_better = true;
      } else {
        damping *= 10.0;
      }
    }
    if (!is_better || moved < kConverged) {
      break;
    }
  }
  return at;
}

/// Initial guess: in the linear part D = (ts - t_l) + E - x + row skew with x = E times the
/// fraction seen. The median over samples of each exposure; the skew from pairs of rows of one
/// frame.
std::optional<Eigen::VectorXd> guess(const Layout& layout, const std::vector<Point>& points) {
  struct Seen {
    double row;
    double z;  // D - row skew
  };
  std::vector<std::vector<Seen>> of_exposure(layout.exposures.size());
  std::map<std::pair<int, double>, std::vector<Seen>> of_frame;
  for (const Point& point : points) {
    const StepSample& s = point.sample;
    if (s.level <= kPartialLow || s.level >= kPartialHigh) {
      continue;
    }
    const double x = s.exposure_us * (s.rises ? s.level : 1.0 - s.level);
    const Seen seen{s.row, s.after_us + s.exposure_us - x};
    of_exposure[point.exposure].push_back(seen);
    of_frame[{s.step, s.after_us}].push_back(seen);
  }
  std::vector<double> skews;
  for (const auto& [frame, seen] : of_frame) {
    const auto [low, high] = std::minmax_element(
        seen.begin(), seen.end(), [](const Seen& a, const Seen& b) { return a.row < b.row; });
    if (high->row > low->row) {
      skews.push_back(-(high->z - low->z) / (high->row - low->row));
    }
  }
  const double skew = skews.empty() ? 0.0 : upper_median(skews);
  Eigen::VectorXd p = Eigen::VectorXd::Zero(layout.size());
  std::vector<double> tied;
  for (std::size_t j = 0; j < of_exposure.size(); ++j) {
    std::vector<double> offsets;
    for (const Seen& seen : of_exposure[j]) {
      offsets.push_back(seen.z + seen.row * skew);
    }
    if (offsets.empty()) {
      return std::nullopt;
    }
    const double offset = upper_median(offsets);
    if (layout.slope) {
      tied.push_back(offset - *layout.slope * layout.exposures[j]);
    } else {
      p[static_cast<Eigen::Index>(j)] = offset;
    }
  }
  if (layout.slope) {
    p[0] = upper_median(tied);
  }
  p[layout.n_offsets()] = skew;
  p[layout.n_offsets() + 1] = p[layout.n_offsets() + 2] = 0.02 * layout.exposures.front();
  return p;
}

StepModel model_of(const Layout& layout, const Eigen::VectorXd& p) {
  StepModel model;
  model.exposures_us = layout.exposures;
  for (std::size_t j = 0; j < layout.exposures.size(); ++j) {
    model.offset_us.push_back(layout.offset(p, j));
  }
  const Eigen::Index m = layout.n_offsets();
  model.skew_us = p[m];
  model.rise_us = p[m + 1];
  model.fall_us = p[m + 2];
  return model;
}

Eigen::VectorXd vector_of(const Layout& layout, const StepModel& model) {
  Eigen::VectorXd p = Eigen::VectorXd::Zero(layout.size());
  for (std::size_t j = 0; j < layout.exposures.size(); ++j) {
    const std::size_t i =
        std::min(layout.exposure_index(layout.exposures[j]), model.offset_us.size() - 1);
    p[layout.offset_index(j)] =
        model.offset_us[i] - (layout.slope ? *layout.slope * layout.exposures[j] : 0.0);
  }
  const Eigen::Index m = layout.n_offsets();
  p[m] = model.skew_us;
  p[m + 1] = model.rise_us;
  p[m + 2] = model.fall_us;
  clamp_ramps(p);
  return p;
}

/// Jitter of the steps rounds the corners like a longer ramp, and shifts their middle.
void add_jitter(std::span<const Point> points, double scatter_us, StepFit& fit) {
  std::vector<double> jitters;
  jitters.reserve(points.size());
  for (const Point& point : points) {
    jitters.push_back(point.sample.jitter_us);
  }
  const double jitter = std::max(upper_median(jitters), scatter_us);
  const auto blur = [jitter](double ramp) {
    const double rounding = 12.0 * jitter * jitter;
    return std::max(std::sqrt(ramp * ramp + rounding) - ramp,
                    ramp - std::sqrt(std::max(0.0, ramp * ramp - rounding)));
  };
  const double rise_blur = blur(fit.model.rise_us);
  const double fall_blur = blur(fit.model.fall_us);
  fit.rise_sigma_us = std::hypot(fit.rise_sigma_us, rise_blur);
  fit.fall_sigma_us = std::hypot(fit.fall_sigma_us, fall_blur);
  for (double& sigma : fit.offset_sigma_us) {
    sigma = std::hypot(sigma, 0.25 * (rise_blur + fall_blur));
  }
}

}  // namespace

double lit_fraction(double x_us, double exposure_us, double ramp_us) {
  HAARLIGHT_EXPECTS(exposure_us > 0.0 && ramp_us >= 0.0, "a positive exposure, a ramp >= 0");
  return (ramp_integral(x_us, ramp_us) - ramp_integral(x_us - exposure_us, ramp_us)) /
         exposure_us;
}

std::optional<StepFit> fit_steps(std::span<const StepSample> samples,
                                 const StepFitOptions& options) {
  Problem problem;
  Layout& layout = problem.layout;
  layout.slope = options.slope;
  for (const StepSample& s : samples) {
    HAARLIGHT_EXPECTS(s.exposure_us > 0.0 && s.sigma > 0.0 && s.step >= 0,
                      "samples with an exposure, a sigma and a step");
    layout.exposures.push_back(s.exposure_us);
  }
  std::sort(layout.exposures.begin(), layout.exposures.end());
  layout.exposures.erase(std::unique(layout.exposures.begin(), layout.exposures.end()),
                         layout.exposures.end());
  std::vector<Point>& points = problem.points;
  points.reserve(samples.size());
  std::map<int, std::size_t> index_of_step;
  std::vector<int> steps_seen;
  StepFit fit;
  for (const StepSample& s : samples) {
    const auto [step, is_new] = index_of_step.try_emplace(s.step, index_of_step.size());
    points.push_back({s, layout.exposure_index(s.exposure_us), step->second});
    if (is_new && options.has_own_delays) {
      problem.delay_sigma.push_back(
          std::max(std::hypot(options.scatter_us, s.jitter_us), 1e-3));
    }
    if (s.level > 0.02 && s.level < 0.98) {
      ++fit.n_partial;
      steps_seen.push_back(s.step);
    }
  }
  std::sort(steps_seen.begin(), steps_seen.end());
  fit.n_steps =
      static_cast<int>(std::unique(steps_seen.begin(), steps_seen.end()) - steps_seen.begin());
  if (fit.n_steps < 4) {
    return std::nullopt;
  }
  std::optional<Eigen::VectorXd> start =
      options.start ? std::optional(vector_of(layout, *options.start)) : guess(layout, points);
  if (!start) {
    return std::nullopt;
  }
  const Fitted best =
      minimise(problem, {*start, std::vector<double>(problem.delay_sigma.size(), 0.0)}, -1);
  fit.model = model_of(layout, best.p);
  std::vector<double> normalised;
  for (const Point& point : points) {
    const Linear l = linearise(problem, best, point);
    if (l.slope_x != 0.0) {
      normalised.push_back(std::abs(l.residual / l.sigma));
    }
  }
  fit.scatter = normalised.empty() ? 0.0 : kSigmaPerMad * upper_median(normalised);
  // Delete-a-group jackknife: var = (g - 1) / g  sum (p_i - mean)^2 over the groups that exist.
  std::vector<StepModel> parts;
  for (int group = 0; group < kGroups; ++group) {
    if (std::any_of(steps_seen.begin(), steps_seen.begin() + fit.n_steps,
                    [&](int step) { return step % kGroups == group; })) {
      parts.push_back(model_of(layout, minimise(problem, best, group).p));
    }
  }
  const auto spread = [&](auto value) {
    double mean = 0.0;
    for (const StepModel& part : parts) {
      mean += value(part) / static_cast<double>(parts.size());
    }
    double sum = 0.0;
    for (const StepModel& part : parts) {
      sum += (value(part) - mean) * (value(part) - mean);
    }
    const auto g = static_cast<double>(parts.size());
    return std::sqrt(sum * (g - 1.0) / g);
  };
  for (std::size_t j = 0; j < layout.exposures.size(); ++j) {
    fit.offset_sigma_us.push_back(spread([j](const StepModel& m) { return m.offset_us[j]; }));
  }
  fit.offset_jackknife_us = fit.offset_sigma_us;
  fit.skew_sigma_us = spread([](const StepModel& m) { return m.skew_us; });
  fit.rise_sigma_us = spread([](const StepModel& m) { return m.rise_us; });
  fit.fall_sigma_us = spread([](const StepModel& m) { return m.fall_us; });
  fit.settle_sigma_us = spread(
      [](const StepModel& m) { return m.offset_us[0] + std::max(m.rise_us, m.fall_us); });
  add_jitter(points, options.scatter_us, fit);
  return fit;
}

std::vector<StepDelay> step_delays(std::span<const StepSample> samples,
                                   const StepModel& model) {
  constexpr double kKnown = 50.0;  // us
  Layout layout;
  layout.exposures = model.exposures_us;
  const Eigen::VectorXd p = vector_of(layout, model);
  struct Sums {
    double weight = 0.0;
    double weighted = 0.0;
  };
  std::map<int, Sums> of_step;
  for (const StepSample& s : samples) {
    const std::size_t exposure = layout.exposure_index(s.exposure_us);
    if (exposure >= layout.exposures.size()) {
      continue;
    }
    // A change that is late by t shows as the model at x - t.
    const Linear l = linearise(layout, p, {s, exposure, 0});
    const double w = l.slope_x / (s.sigma * s.sigma);
    of_step[s.step].weight += w * l.slope_x;
    of_step[s.step].weighted -= w * l.residual;
  }
  std::vector<StepDelay> delays;
  for (const auto& [step, sums] : of_step) {
    if (sums.weight > 1.0 / (kKnown * kKnown)) {
      delays.push_back({step, sums.weighted / sums.weight, 1.0 / std::sqrt(sums.weight)});
    }
  }
  return delays;
}

double delay_scatter(std::span<const StepDelay> delays) {
  if (delays.size() < 4) {
    return 0.0;
  }
  const auto n = static_cast<double>(delays.size());
  double mean = 0.0;
  for (const StepDelay& d : delays) {
    mean += d.late_us / n;
  }
  double variance = 0.0;
  for (const StepDelay& d : delays) {
    variance += ((d.late_us - mean) * (d.late_us - mean) - d.sigma_us * d.sigma_us) / (n - 1.0);
  }
  return std::sqrt(std::max(0.0, variance));
}

namespace {

/// E_true / E by the pooled slope, without one step (-1: with all). 0: no slope. Time over
/// fraction, not fraction over time: samples are selected by their fraction, which contains the
/// light's own jitter; over time it would make the slope too flat.
double pooled_scale(std::span<const StepSample> partial, int without) {
  struct Sums {
    double n = 0.0;
    double x = 0.0;
    double y = 0.0;
    double yy = 0.0;
    double xy = 0.0;
    double noise = 0.0;
  };
  std::map<std::pair<double, bool>, Sums> groups;
  for (const StepSample& s : partial) {
    if (s.step != without) {
      Sums& g = groups[{s.row, s.rises}];
      const double x = s.after_us / s.exposure_us;
      const double y = s.rises ? s.level : 1.0 - s.level;
      g.n += 1.0;
      g.x += x;
      g.y += y;
      g.yy += y * y;
      g.xy += x * y;
      g.noise += s.sigma * s.sigma;
    }
  }
  double yy = 0.0;
  double xy = 0.0;
  for (const auto& [which, g] : groups) {
    yy += g.yy - g.y * g.y / g.n - g.noise * (g.n - 1.0) / g.n;
    xy += g.xy - g.x * g.y / g.n;
  }
  return xy > 0.0 && yy > 0.0 ? xy / yy : 0.0;
}

}  // namespace

std::optional<ExposureScale> exposure_scale(std::span<const StepSample> samples,
                                            double exposure_us) {
  constexpr int kLeastSteps = 4;
  std::vector<StepSample> partial;
  std::set<int> steps;
  for (const StepSample& s : samples) {
    if (s.exposure_us == exposure_us && s.level > kPartialLow && s.level < kPartialHigh) {
      partial.push_back(s);
      steps.insert(s.step);
    }
  }
  ExposureScale scale{pooled_scale(partial, -1), 0.0, static_cast<int>(steps.size())};
  if (scale.n_steps < kLeastSteps || !(scale.value > 0.0)) {
    return std::nullopt;
  }
  const auto n = static_cast<double>(steps.size());
  double mean = 0.0;
  double square = 0.0;
  for (const int step : steps) {
    const double part = pooled_scale(partial, step);
    mean += part / n;
    square += part * part;
  }
  scale.sigma = std::sqrt(std::max(0.0, square - n * mean * mean) * (n - 1.0) / n);
  return scale;
}

OffsetLine offset_line(const StepFit& fit) {
  const std::vector<double>& e = fit.model.exposures_us;
  HAARLIGHT_EXPECTS(e.size() >= 2, "two exposures or more");
  // Weighted least squares; a floor of 1 us keeps a lucky sigma from dominating.
  double sw = 0.0;
  double sx = 0.0;
  double sy = 0.0;
  double sxx = 0.0;
  double sxy = 0.0;
  for (std::size_t j = 0; j < e.size(); ++j) {
    const double s = std::max(fit.offset_jackknife_us[j], 1.0);
    const double w = 1.0 / (s * s);
    sw += w;
    sx += w * e[j];
    sy += w * fit.model.offset_us[j];
    sxx += w * e[j] * e[j];
    sxy += w * e[j] * fit.model.offset_us[j];
  }
  const double det = sw * sxx - sx * sx;
  return {(sw * sxy - sx * sy) / det, std::sqrt(sw / det)};
}

}  // namespace haarlight::capture
