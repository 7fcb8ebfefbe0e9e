// SPDX-License-Identifier: Apache-2.0
#include "relight/calibration/near_calibration.h"

#include <algorithm>
#include <cmath>
#include <exception>
#include <limits>
#include <memory>
#include <new>
#include <utility>

#include <Eigen/Eigenvalues>
#include <fmt/format.h>
#include <lbfgs.h>

#include "core/order_statistics.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "relight/calibration/light_terms.h"
#include "relight/calibration/uniform_start.h"
#include "relight/calibration/variance_objective.h"

namespace haarlight::relight {

namespace {

constexpr const char* kWhere = "near-light calibration";
constexpr int kMaxOutlierRounds = 4;
constexpr double kGrossFraction = 0.4;
// A light that the samples constrain in no direction: all lights at one position.
constexpr double kUnknownFraction = 5.0;
constexpr double kSigmasToDiffer = 5.0;

double top_of(const TargetSamples& samples) {
  double z = -std::numeric_limits<double>::max();
  for (const Eigen::Vector3d& p : samples.points_mm) {
    z = std::max(z, p.z());
  }
  return z;
}

/// Stencil at one point, without masks: -> ln h and its derivatives.
struct CentreTerms {
  double log_h;
  Eigen::Vector3d position;
  Eigen::Vector3d axis;
  double log_cos;
};
CentreTerms centre_terms(const NearLight& light, const Eigen::Vector3d& point) {
  const Eigen::Vector3d w = light.position_mm - point;
  const double r2 = w.squaredNorm();
  const double facing = std::max(w.z(), 1e-300);
  const double off = std::max(-light.axis.dot(w), 1e-300);
  CentreTerms t;
  t.log_cos = std::log(off / std::sqrt(r2));
  t.log_h = std::log(facing) - 1.5 * std::log(r2) + light.mu * t.log_cos;
  t.position = Eigen::Vector3d::UnitZ() / facing - (3.0 + light.mu) / r2 * w -
               light.mu / off * light.axis;
  t.axis = -light.mu / off * w;
  return t;
}

/// What both problems share: lights from parameters, and the gradient by the chain rule. A
/// light's power is parameterised as its irradiance at the target's middle, which the samples
/// determine best.
class VarianceProblem {
 public:
  VarianceProblem(const TargetSamples& samples, const CalibrationOptions& options)
      : samples_(samples), options_(options), extent_(target_extent(samples)) {}
  virtual ~VarianceProblem() = default;
  VarianceProblem(const VarianceProblem&) = delete;
  VarianceProblem& operator=(const VarianceProblem&) = delete;

  [[nodiscard]] virtual std::size_t n_parameters() const = 0;

  [[nodiscard]] virtual std::vector<NearLight> lights(const double* x) const = 0;
  virtual void chain(const double* x, std::span<const NearLight> lights,
                     const VarianceGradient& gradient, double* out) const = 0;

  /// D and its gradient; infinity and zeros where lights or D are not finite.
  double evaluate(const double* x, double* gradient) const {
    constexpr double kNone = std::numeric_limits<double>::infinity();
    std::fill_n(gradient, n_parameters(), 0.0);
    const std::vector<NearLight> now = lights(x);
    for (const NearLight& light : now) {
      if (!light.position_mm.allFinite() || !light.power.allFinite() ||
          !(light.power.minCoeff() > 0.0)) {
        return kNone;
      }
    }
    const VarianceValue value = normalised_variance(samples_, now, true);
    if (!std::isfinite(value.d)) {
      return kNone;
    }
    chain(x, now, value.gradient, gradient);
    return value.d;
  }

 protected:
  [[nodiscard]] Eigen::Vector3d power_at(const NearLight& light, const double* x) const {
    const double log_h = centre_terms(light, extent_.centre).log_h;
    Eigen::Vector3d power;
    for (int c = 0; c < 3; ++c) {
      power[c] = std::exp(x[c < samples_.n_channels ? c : 0] - log_h);
    }
    return power;
  }
  [[nodiscard]] std::size_t n_channels() const {
    return static_cast<std::size_t>(samples_.n_channels);
  }
  [[nodiscard]] bool is_mu_free() const { return options_.lobe == Lobe::free; }

  const TargetSamples& samples_;
  const CalibrationOptions& options_;
  TargetExtent extent_;
};

/// Parameters of a light: a = (x - x0) / h, b = (y - y0) / h, ln(h / size) with h its height
/// over the highest point, then ln of the light at the middle per channel; last, mu.
class FreeProblem final : public VarianceProblem {
 public:
  FreeProblem(const TargetSamples& samples, const CalibrationOptions& options,
              std::span<const NearLight> start)
      : VarianceProblem(samples, options), start_(start.begin(), start.end()) {
    ground_ = top_of(samples);
    x_.resize(count());
    for (std::size_t k = 0; k < start_.size(); ++k) {
      double* x = x_.data() + k * stride();
      const double h = start_[k].position_mm.z() - ground_;
      x[0] = (start_[k].position_mm.x() - extent_.centre.x()) / h;
      x[1] = (start_[k].position_mm.y() - extent_.centre.y()) / h;
      x[2] = std::log(h / extent_.size_mm);
      const double log_h = centre_terms(start_[k], extent_.centre).log_h;
      for (std::size_t c = 0; c < n_channels(); ++c) {
        x[3 + c] = std::log(start_[k].power[static_cast<Eigen::Index>(c)]) + log_h;
      }
    }
    if (is_mu_free()) {
      x_.back() = start_.front().mu;
    }
  }
  [[nodiscard]] const std::vector<double>& parameters() const { return x_; }

  [[nodiscard]] std::size_t n_parameters() const override { return count(); }

  [[nodiscard]] std::vector<NearLight> lights(const double* x) const override {
    std::vector<NearLight> out = start_;
    for (std::size_t k = 0; k < out.size(); ++k) {
      const double* own = x + k * stride();
      const double h = extent_.size_mm * std::exp(own[2]);
      out[k].position_mm = {extent_.centre.x() + own[0] * h, extent_.centre.y() + own[1] * h,
                            ground_ + h};
      turn_to_aim(out[k]);
      if (is_mu_free()) {
        out[k].mu = x[out.size() * stride()];
      }
      out[k].power = power_at(out[k], own + 3);
    }
    return out;
  }

  void chain(const double* x, std::span<const NearLight> now, const VarianceGradient& g,
             double* out) const override {
    double mu = g.mu;
    for (std::size_t k = 0; k < now.size(); ++k) {
      const double* own = x + k * stride();
      double* d = out + k * stride();
      const CentreTerms t = centre_terms(now[k], extent_.centre);
      double power = 0.0;
      for (std::size_t c = 0; c < n_channels(); ++c) {
        d[3 + c] = g.log_power[k * n_channels() + c];
        power += d[3 + c];
      }
      const Eigen::Vector3d by_position =
          g.position[k] - power * t.position +
          axis_per_position(now[k]).transpose() * (g.axis[k] - power * t.axis);
      const double h = now[k].position_mm.z() - ground_;
      d[0] = h * by_position.x();
      d[1] = h * by_position.y();
      d[2] = h * (own[0] * by_position.x() + own[1] * by_position.y() + by_position.z());
      mu -= power * t.log_cos;
    }
    if (is_mu_free()) {
      out[now.size() * stride()] = mu;
    }
  }

 private:
  [[nodiscard]] std::size_t stride() const { return 3 + n_channels(); }
  [[nodiscard]] std::size_t count() const {
    return start_.size() * stride() + (is_mu_free() ? 1 : 0);
  }
  std::vector<NearLight> start_;
  double ground_ = 0.0;
  std::vector<double> x_;
};

/// Parameters: turn (rotation vector about the array's middle, world axes), shift over the
/// start's height (x, y) and ln of the height of the middle, then the lights' powers, mu.
class RigidProblem final : public VarianceProblem {
 public:
  RigidProblem(const TargetSamples& samples, const CalibrationOptions& options,
               const RigidArray& array, Eigen::Isometry3d start,
               std::span<const NearLight> lights)
      : VarianceProblem(samples, options),
        array_(array),
        start_(std::move(start)),
        mus_(lights.begin(), lights.end()) {
    for (const NearLight& light : lights) {
      middle_ += light.position_mm / static_cast<double>(lights.size());
    }
    ground_ = top_of(samples);
    height_ = middle_.z() - ground_;
    x_.assign(count(), 0.0);
    for (std::size_t k = 0; k < lights.size(); ++k) {
      const double log_h = centre_terms(lights[k], extent_.centre).log_h;
      for (std::size_t c = 0; c < n_channels(); ++c) {
        x_[6 + k * n_channels() + c] =
            std::log(lights[k].power[static_cast<Eigen::Index>(c)]) + log_h;
      }
    }
    if (is_mu_free()) {
      x_.back() = lights.front().mu;
    }
  }
  [[nodiscard]] const std::vector<double>& parameters() const { return x_; }

  [[nodiscard]] std::size_t n_parameters() const override { return count(); }

  [[nodiscard]] Eigen::Isometry3d pose(const double* x) const {
    Eigen::Isometry3d move = Eigen::Isometry3d::Identity();
    move.translate(middle_at(x));
    const Eigen::Vector3d turn(x[0], x[1], x[2]);
    if (turn.norm() > 0.0) {
      move.rotate(Eigen::AngleAxisd(turn.norm(), turn.normalized()));
    }
    move.translate(-middle_);
    return move * start_;
  }

  [[nodiscard]] std::vector<NearLight> lights(const double* x) const override {
    std::vector<NearLight> out = array_at(array_, pose(x), is_mu_free() ? x[count() - 1] : 0.0);
    for (std::size_t k = 0; k < out.size(); ++k) {
      if (!is_mu_free()) {
        out[k].mu = mus_[k].mu;
      }
      out[k].power = power_at(out[k], x + 6 + k * n_channels());
    }
    return out;
  }

  void chain(const double* x, std::span<const NearLight> now, const VarianceGradient& g,
             double* out) const override {
    double mu = g.mu;
    const Eigen::Vector3d middle = middle_at(x);
    Eigen::Vector3d turn = Eigen::Vector3d::Zero();
    Eigen::Vector3d shift = Eigen::Vector3d::Zero();
    for (std::size_t k = 0; k < now.size(); ++k) {
      const CentreTerms t = centre_terms(now[k], extent_.centre);
      double power = 0.0;
      for (std::size_t c = 0; c < n_channels(); ++c) {
        const double d = g.log_power[k * n_channels() + c];
        out[6 + k * n_channels() + c] = d;
        power += d;
      }
      const Eigen::Vector3d by_position = g.position[k] - power * t.position;
      const Eigen::Vector3d axis = g.axis[k] - power * t.axis;
      turn += (now[k].position_mm - middle).cross(by_position) + now[k].axis.cross(axis);
      shift += by_position;
      mu -= power * t.log_cos;
    }
    // d exp(r) = (J_l dr) x exp(r): the left Jacobian of the rotation vector.
    const Eigen::Vector3d r(x[0], x[1], x[2]);
    const double angle = r.norm();
    const double b = angle > 1e-4 ? (1.0 - std::cos(angle)) / (angle * angle) : 0.5;
    const double c = angle > 1e-4 ? (angle - std::sin(angle)) / (angle * angle * angle)
                                  : 1.0 / 6.0 - angle * angle / 120.0;
    Eigen::Matrix3d cross;
    cross << 0, -r.z(), r.y(), r.z(), 0, -r.x(), -r.y(), r.x(), 0;
    const Eigen::Matrix3d left = Eigen::Matrix3d::Identity() + b * cross + c * cross * cross;
    Eigen::Map<Eigen::Vector3d>(out, 3) = left.transpose() * turn;
    out[3] = height_ * shift.x();
    out[4] = height_ * shift.y();
    out[5] = (middle.z() - ground_) * shift.z();
    if (is_mu_free()) {
      out[count() - 1] = mu;
    }
  }

 private:
  [[nodiscard]] std::size_t count() const {
    return 6 + mus_.size() * n_channels() + (is_mu_free() ? 1 : 0);
  }
  [[nodiscard]] Eigen::Vector3d middle_at(const double* x) const {
    return {middle_.x() + height_ * x[3], middle_.y() + height_ * x[4],
            ground_ + height_ * std::exp(x[5])};
  }

  const RigidArray& array_;
  Eigen::Isometry3d start_;
  std::vector<NearLight> mus_;
  Eigen::Vector3d middle_ = Eigen::Vector3d::Zero();
  double ground_ = 0.0;
  double height_ = 1.0;
  std::vector<double> x_;
};

struct Descent {
  double d = 0.0;
  int n_iterations = 0;
  bool has_converged = false;
};

/// What libLBFGS, a C library, passes to its callbacks.
struct DescentRun {
  const VarianceProblem& problem;
  const std::function<bool()>& should_stop;
  std::exception_ptr failure;  ///< rethrown once no C frame is below us
  int n_iterations = 0;
};

double evaluate_run(void* instance, const double* x, double* gradient, int n, double /*step*/) {
  auto& run = *static_cast<DescentRun*>(instance);
  std::fill_n(gradient, n, 0.0);
  if (run.failure == nullptr) {
    try {
      return run.problem.evaluate(x, gradient);
    } catch (...) {
      run.failure = std::current_exception();
    }
  }
  return std::numeric_limits<double>::infinity();
}

/// @return  0 to continue
int follow_run(void* instance, const double* /*x*/, const double* /*gradient*/, double /*d*/,
               double /*norm_x*/, double /*norm_gradient*/, double /*step*/, int /*n*/,
               int iteration, int /*n_evaluations*/) {
  auto& run = *static_cast<DescentRun*>(instance);
  run.n_iterations = iteration;
  return run.should_stop && run.should_stop() ? LBFGSERR_CANCELED : 0;
}

/// L-BFGS; its line search backs off where D is infinite.
Descent descend(const VarianceProblem& problem, std::vector<double>& x,
                const CalibrationOptions& options) {
  lbfgs_parameter_t settings;
  lbfgs_parameter_init(&settings);
  settings.m = 40;
  settings.max_iterations = options.stage == Stage::likelihood ? options.max_first_iterations
                                                               : options.max_iterations;
  settings.max_linesearch = 40;
  settings.linesearch = LBFGS_LINESEARCH_BACKTRACKING_STRONG_WOLFE;
  settings.past = 1;
  settings.delta = 1e-9;
  settings.epsilon = 1e-14;
  // Built with vector instructions, it requires multiples of 8 numbers in memory it allocated.
  const std::size_t n = (x.size() + 7) / 8 * 8;
  const std::unique_ptr<double, decltype(&lbfgs_free)> own(lbfgs_malloc(static_cast<int>(n)),
                                                           &lbfgs_free);
  if (own == nullptr) {
    throw std::bad_alloc();
  }
  std::fill_n(own.get(), n, 0.0);
  std::copy(x.begin(), x.end(), own.get());
  DescentRun run{problem, options.should_stop, nullptr};
  const int result =
      lbfgs(static_cast<int>(n), own.get(), nullptr, evaluate_run, follow_run, &run, &settings);
  if (run.failure != nullptr) {
    std::rethrow_exception(run.failure);
  }
  if (result == LBFGSERR_OUTOFMEMORY) {
    throw std::bad_alloc();
  }
  std::copy_n(own.get(), x.size(), x.begin());
  std::vector<double> gradient(x.size());
  return {
      problem.evaluate(x.data(), gradient.data()), run.n_iterations,
      result == LBFGS_CONVERGENCE || result == LBFGS_STOP || result == LBFGS_ALREADY_MINIMIZED};
}

// ---- samples ----

int coarse_factor(const TargetSamples& samples, const CalibrationOptions& options) {
  const double fraction =
      static_cast<double>(samples.n_points()) / std::max(options.coarse_points, 16);
  int factor = std::max(1, static_cast<int>(std::lround(std::sqrt(fraction))));
  while (factor > 1 && samples.rows > 0 &&
         (samples.rows / factor < 3 || samples.cols / factor < 3)) {
    --factor;
  }
  return factor;
}

/// Masks samples that contradict the lights. The albedo is the median over the lights, robust
/// to outliers in up to half of them. @return how many
std::int64_t mask_outliers(TargetSamples& samples, std::span<const NearLight> lights,
                           const SheetValues& sheet, double outlier_fraction,
                           std::vector<SampleCounts>& counts) {
  const std::size_t n = samples.n_points();
  const TargetColumns target(samples, sheet);
  const double threshold = std::max(outlier_fraction, 6.0 * samples.noise.relative);
  std::vector<LightTerms> terms(lights.size());
  parallel_for(lights.size(), 8, [&](std::size_t begin, std::size_t end) {
    for (std::size_t k = begin; k < end; ++k) {
      terms[k] = light_terms(target, lights[k], samples.used(static_cast<int>(k)));
    }
  });
  std::vector<std::uint8_t> what(lights.size() * n, 0);
  for (int c = 0; c < samples.n_channels; ++c) {
    parallel_for(n, 64, [&](std::size_t begin, std::size_t end) {
      std::vector<double> ratio;
      for (std::size_t p = begin; p < end; ++p) {
        const auto at = static_cast<Eigen::Index>(p);
        const auto expected = [&](std::size_t k) {
          return lights[k].power[c] * terms[k].h[at];
        };
        ratio.clear();
        for (std::size_t k = 0; k < lights.size(); ++k) {
          if (samples.used(static_cast<int>(k))[p] != 0 && expected(k) > 0.0) {
            ratio.push_back(static_cast<double>(samples.values(static_cast<int>(k), c)[p]) /
                            expected(k));
          }
        }
        if (ratio.size() < 3) {
          continue;  // two lights: no telling which of them is wrong
        }
        const double albedo = upper_median(std::span(ratio));
        for (std::size_t k = 0; k < lights.size(); ++k) {
          if (samples.used(static_cast<int>(k))[p] == 0) {
            continue;
          }
          const double m = albedo * expected(k);
          const double miss =
              static_cast<double>(samples.values(static_cast<int>(k), c)[p]) - m;
          if (std::abs(miss) > threshold * m &&
              miss * miss > 36.0 * samples.noise.variance(m)) {
            what[k * n + p] = miss < 0.0 ? 1 : 2;
          }
        }
      }
    });
  }
  std::int64_t total = 0;
  for (std::size_t k = 0; k < lights.size(); ++k) {
    for (std::size_t p = 0; p < n; ++p) {
      if (what[k * n + p] == 0) {
        continue;
      }
      samples.is_used[k * n + p] = 0;
      counts[k].shadowed += what[k * n + p] == 1 ? 1 : 0;
      counts[k].outlying += what[k * n + p] == 2 ? 1 : 0;
      --counts[k].used;
      ++total;
    }
  }
  return total;
}

void require_lights(const TargetSamples& samples, std::span<const NearLight> lights) {
  if (lights.size() != static_cast<std::size_t>(samples.n_lights)) {
    throw Error(fmt::format("{} pictures, {} lights", samples.n_lights, lights.size()), kWhere,
                "give one picture for each light");
  }
  const std::vector<bool> in_use = lights_in_use(samples);
  const auto n = std::count(in_use.begin(), in_use.end(), true);
  if (n < 2) {
    throw Error(
        fmt::format("{} of {} lights have a usable sample on the target", n, lights.size()),
        kWhere,
        "at least 2 are needed: look for saturated or black pictures, and for lights in or "
        "below the target's plane");
  }
  const double top = top_of(samples);
  for (std::size_t k = 0; k < lights.size(); ++k) {
    if (!(lights[k].position_mm.z() > top)) {
      throw Error(fmt::format("light {} starts {:.4g} mm below the target's highest point", k,
                              top - lights[k].position_mm.z()),
                  kWhere, "start above the target: +z points to the lights");
    }
  }
}

/// Points lit by fewer than two lights carry no information.
void drop_lonely_points(TargetSamples& samples, std::vector<SampleCounts>& counts) {
  const std::size_t n = samples.n_points();
  for (std::size_t p = 0; p < n; ++p) {
    int used = 0;
    int last = 0;
    for (int k = 0; k < samples.n_lights; ++k) {
      if (samples.used(k)[p] != 0) {
        ++used;
        last = k;
      }
    }
    if (used == 1) {
      samples.is_used[static_cast<std::size_t>(last) * n + p] = 0;
      --counts[static_cast<std::size_t>(last)].used;
      ++counts[static_cast<std::size_t>(last)].by_caller;
    }
  }
}

/// Masks the samples that fit worst; false where none is left to mask.
/// @throws Error  a light has too few samples left
bool leave_outliers_out(TargetSamples& samples, std::span<const NearLight> lights,
                        const SheetValues& sheet, double fraction,
                        std::vector<SampleCounts>& counts) {
  if (fraction <= 0.0 || mask_outliers(samples, lights, sheet, fraction, counts) == 0) {
    return false;
  }
  drop_lonely_points(samples, counts);
  require_lights(samples, lights);
  return true;
}

void apply_lobe(const CalibrationOptions& options, std::vector<NearLight>& lights) {
  for (NearLight& light : lights) {
    light.mu = options.lobe == Lobe::paper  ? 0.0
               : options.lobe == Lobe::free ? options.mu_start
                                            : light.mu;
  }
}

LikelihoodOptions likelihood_options(const CalibrationOptions& options) {
  LikelihoodOptions out;
  out.is_mu_free = options.lobe == Lobe::free;
  out.sheet = options.sheet;
  out.aim_sigma = options.aim_sigma;
  out.should_stop = options.should_stop;
  return out;
}

/// Findings, uncertainties and counts from the last lights.
LightCalibration calibration_of(const TargetSamples& samples, std::vector<NearLight> lights,
                                std::vector<double> albedo, const LightBounds& bounds,
                                std::vector<SampleCounts> counts, double reduced_chi2,
                                const CalibrationOptions& options) {
  LightCalibration out;
  out.albedo = std::move(albedo);
  out.reduced_chi2 = reduced_chi2;
  out.mu = lights.front().mu;
  const double wider = reduced_chi2 > 1.0 ? reduced_chi2 : 1.0;
  out.mu_sigma = std::sqrt(wider) * bounds.mu;
  const double top = top_of(samples);
  const std::vector<bool> in_use = lights_in_use(samples);
  int n_unknown = 0;
  int n_used = 0;
  for (std::size_t k = 0; k < lights.size(); ++k) {
    CalibratedLight light;
    light.light = lights[k];
    light.counts = counts[k];
    light.sigma = bounds.lights[k];
    light.sigma.position_mm2 *= wider;
    light.sigma.power *= std::sqrt(wider);
    if (!in_use[k]) {
      light.finding = LightFinding::unseen;
    } else {
      ++n_used;
      const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(light.sigma.position_mm2);
      light.weak_direction = eigen.eigenvectors().col(2);
      light.weak_mm = std::sqrt(std::max(eigen.eigenvalues()[2], 0.0));
      const double distance = light.light.position_mm.z() - top;
      if (!(light.weak_mm <= options.shape_tolerance * distance)) {
        light.finding = LightFinding::weak;
      }
      n_unknown += light.weak_mm > kUnknownFraction * distance ? 1 : 0;
    }
    out.lights.push_back(light);
  }
  if (n_unknown == n_used) {
    const Eigen::Vector3d& d = out.lights.front().weak_direction;
    throw Error(
        fmt::format("the pictures do not say where the lights are: every picture could "
                    "be the albedo's own pattern (least certain direction of light 0: "
                    "{:.2f} {:.2f} {:.2f})",
                    d.x(), d.y(), d.z()),
        kWhere,
        "light the target from positions that differ; lights that coincide, or that are "
        "all very far, cannot be calibrated");
  }
  return out;
}

double freedom_of(const LikelihoodFit& fit, std::size_t n_unknowns) {
  return static_cast<double>(fit.n_samples) - static_cast<double>(n_unknowns);
}

double reduced(const LikelihoodFit& fit, std::size_t n_unknowns) {
  const double freedom = freedom_of(fit, n_unknowns);
  return freedom >= 1.0 ? fit.chi2 / freedom : std::numeric_limits<double>::quiet_NaN();
}

std::size_t count_points(const TargetSamples& samples) {
  std::size_t count = 0;
  for (std::size_t p = 0; p < samples.n_points(); ++p) {
    for (int k = 0; k < samples.n_lights; ++k) {
      if (samples.used(k)[p] != 0) {
        ++count;
        break;
      }
    }
  }
  return count;
}

/// Pictures that differ only in brightness carry no information on positions.
void require_difference(const TargetSamples& samples, std::span<const NearLight> start) {
  std::vector<NearLight> alike(start.begin(), start.end());
  for (NearLight& light : alike) {
    light = start.front();
    light.mu = 0.0;
    light.power = Eigen::Vector3d::Ones();
  }
  const PowerFit fit = fit_powers(samples, alike, 20);
  const TargetColumns target(samples);
  const std::vector<float> weights = inverse_variances(samples, target, fit.lights, fit.albedo);
  double chi2 = 0.0;
  for (int k = 0; k < samples.n_lights; ++k) {
    const NearLight& light = fit.lights[static_cast<std::size_t>(k)];
    const LightTerms terms = light_terms(target, light, samples.used(k));
    chi2 += light_residual(samples, k, terms, light.power, fit.albedo, weights).chi2;
  }
  const auto n_used = static_cast<double>(
      std::count(samples.is_used.begin(), samples.is_used.end(), std::uint8_t{1}));
  const std::vector<bool> in_use = lights_in_use(samples);
  const double unknown = static_cast<double>(std::count(in_use.begin(), in_use.end(), true)) +
                         static_cast<double>(count_points(samples)) - 1.0;
  const double freedom = (n_used - unknown) * samples.n_channels;
  if (freedom < 1.0 || chi2 < freedom + kSigmasToDiffer * std::sqrt(2.0 * freedom)) {
    throw Error(
        "the pictures do not say where the lights are: beside their brightness they "
        "differ by no more than their noise",
        kWhere,
        "light the target from positions that differ and are near; lights that coincide, "
        "or that are all very far, cannot be calibrated");
  }
}

std::vector<SampleCounts> prepare(TargetSamples& samples, std::span<const NearLight> start,
                                  const CalibrationOptions& options) {
  require_consistent(samples);
  (void)target_extent(samples);
  std::vector<SampleCounts> counts = mask_samples(samples, options.mask);
  drop_lonely_points(samples, counts);
  require_lights(samples, start);
  require_difference(coarse_samples(samples, coarse_factor(samples, options)), start);
  return counts;
}

}  // namespace

bool LightCalibration::is_usable() const {
  return has_converged && std::any_of(lights.begin(), lights.end(), [](const auto& light) {
           return light.finding == LightFinding::good;
         });
}

std::string LightCalibration::brief_report() const {
  const auto count = [this](LightFinding finding) {
    return std::count_if(lights.begin(), lights.end(),
                         [finding](const auto& light) { return light.finding == finding; });
  };
  return fmt::format(
      "{} lights: {} good, {} weak, {} unseen; mu {:.4g}{}; D {:.3g} after {} steps; "
      "chi^2 {:.4g} after {} more; {}; {}",
      lights.size(), count(LightFinding::good), count(LightFinding::weak),
      count(LightFinding::unseen), mu,
      is_model_wrong() ? std::string() : fmt::format(" +- {:.2g}", mu_sigma), variance,
      n_variance_iterations, reduced_chi2, n_likelihood_iterations,
      has_converged ? "converged" : "not converged",
      !test.is_done
          ? std::string("the model was not tested")
          : fmt::format("the model {}: {:.0f} in {} modes ({:+.1f} sigma), lobe {:+.1f}",
                        test.is_passed() ? "fits" : "IS WRONG", test.chi2, test.n, test.z,
                        test.lobe_z));
}

std::vector<NearLight> paper_start(const TargetSamples& samples, double mu) {
  const TargetExtent extent = target_extent(samples);
  NearLight light;
  light.position_mm = extent.centre + extent.size_mm * Eigen::Vector3d::UnitZ();
  light.mu = mu;
  return std::vector<NearLight>(static_cast<std::size_t>(samples.n_lights), light);
}

std::vector<NearLight> start_along_axes(const TargetSamples& samples,
                                        std::span<const Eigen::Vector3d> axes,
                                        double distance_mm, double mu) {
  const TargetExtent extent = target_extent(samples);
  std::vector<NearLight> lights;
  for (const Eigen::Vector3d& axis : axes) {
    if (!(axis.z() < 0.0)) {
      throw Error(
          fmt::format("the axis of light {} does not look down", lights.size()), kWhere,
          "axes are the way the lights shine, in the target's frame (+z to the lights)");
    }
    NearLight& light = lights.emplace_back();
    light.position_mm = extent.centre - distance_mm * axis;
    light.axis = axis;
    light.mu = mu;
  }
  return lights;
}

LightCalibration calibrate_free_lights(TargetSamples samples, std::vector<NearLight> start,
                                       const CalibrationOptions& options) {
  std::vector<SampleCounts> counts = prepare(samples, start, options);
  apply_lobe(options, start);
  std::vector<NearLight> lights = std::move(start);
  Descent descent;
  const int factor = coarse_factor(samples, options);
  LikelihoodOptions likelihood = likelihood_options(options);
  int n_likelihood = 0;
  if (options.start == Start::uniform_albedo) {
    lights = uniform_albedo_start(coarse_samples(samples, factor), std::move(lights));
    if (options.outlier_fraction > 0.0) {
      // Gross ones first: one shadowed light would bias all others in the joint fit.
      mask_outliers(samples, lights, {}, std::max(kGrossFraction, options.outlier_fraction),
                    counts);
      drop_lonely_points(samples, counts);
      require_lights(samples, lights);
    }
  }
  for (int round = 0; round < kMaxOutlierRounds; ++round) {
    const TargetSamples coarse = coarse_samples(samples, factor);
    lights = fit_powers(coarse, std::move(lights)).lights;
    const FreeProblem problem(coarse, options, lights);
    std::vector<double> x = problem.parameters();
    const Descent more = descend(problem, x, options);
    lights = problem.lights(x.data());
    descent = {more.d, descent.n_iterations + more.n_iterations, more.has_converged};
    if (options.stage == Stage::likelihood) {
      for (NearLight& light : lights) {
        light.mu = std::max(light.mu, options.lobe == Lobe::free ? 0.01 : 0.0);
      }
      LikelihoodFit fit = fit_free_lights(coarse, std::move(lights), likelihood);
      n_likelihood += fit.n_iterations;
      likelihood.sheet_start = fit.sheet;
      lights = std::move(fit.lights);
    }
    if (!leave_outliers_out(samples, lights, likelihood.sheet_start, options.outlier_fraction,
                            counts)) {
      break;
    }
  }
  std::vector<double> albedo;
  ModelTest test;
  double chi2 = std::numeric_limits<double>::quiet_NaN();
  bool has_converged = descent.has_converged;
  if (options.stage == Stage::likelihood) {
    LikelihoodFit fit = fit_free_lights(samples, std::move(lights), likelihood);
    n_likelihood += fit.n_iterations;
    has_converged = fit.has_converged;
    const std::size_t n_unknowns =
        lights_in_use(samples).size() * (3 + static_cast<std::size_t>(samples.n_channels)) +
        (count_points(samples) - 1) * static_cast<std::size_t>(samples.n_channels);
    chi2 = reduced(fit, n_unknowns);
    likelihood.sheet_start = fit.sheet;
    test = test_free_lights(samples, fit, likelihood, freedom_of(fit, n_unknowns));
    lights = std::move(fit.lights);
    albedo = std::move(fit.albedo);
  } else {
    PowerFit fit = fit_powers(samples, std::move(lights));
    lights = std::move(fit.lights);
    albedo = std::move(fit.albedo);
  }
  const LightBounds bounds = free_light_bounds(samples, lights, albedo, likelihood);
  LightCalibration out = calibration_of(samples, std::move(lights), std::move(albedo), bounds,
                                        std::move(counts), chi2, options);
  out.sheet = likelihood.sheet_start;
  out.sheet_sigma = bounds.sheet;
  out.test = test;
  out.variance = descent.d;
  out.n_variance_iterations = descent.n_iterations;
  out.n_likelihood_iterations = n_likelihood;
  out.has_converged = has_converged;
  return out;
}

LightCalibration calibrate_rigid_array(TargetSamples samples, const RigidArray& array,
                                       const Eigen::Isometry3d& start,
                                       const CalibrationOptions& options) {
  std::vector<NearLight> lights = array_at(array, start, options.mu_start);
  std::vector<SampleCounts> counts = prepare(samples, lights, options);
  apply_lobe(options, lights);
  Eigen::Isometry3d pose = start;
  Descent descent;
  const int factor = coarse_factor(samples, options);
  LikelihoodOptions likelihood = likelihood_options(options);
  int n_likelihood = 0;
  for (int round = 0; round < kMaxOutlierRounds; ++round) {
    const TargetSamples coarse = coarse_samples(samples, factor);
    lights = fit_powers(coarse, std::move(lights)).lights;
    const RigidProblem problem(coarse, options, array, pose, lights);
    std::vector<double> x = problem.parameters();
    const Descent more = descend(problem, x, options);
    lights = problem.lights(x.data());
    pose = problem.pose(x.data());
    descent = {more.d, descent.n_iterations + more.n_iterations, more.has_converged};
    if (options.stage == Stage::likelihood) {
      for (NearLight& light : lights) {
        light.mu = std::max(light.mu, options.lobe == Lobe::free ? 0.01 : 0.0);
      }
      RigidFit fit = fit_rigid_array(coarse, array, pose, std::move(lights), likelihood);
      n_likelihood += fit.fit.n_iterations;
      likelihood.sheet_start = fit.fit.sheet;
      lights = std::move(fit.fit.lights);
      pose = fit.world_from_array;
    }
    if (!leave_outliers_out(samples, lights, likelihood.sheet_start, options.outlier_fraction,
                            counts)) {
      break;
    }
  }
  std::vector<double> albedo;
  ModelTest test;
  double chi2 = std::numeric_limits<double>::quiet_NaN();
  bool has_converged = descent.has_converged;
  if (options.stage == Stage::likelihood) {
    RigidFit fit = fit_rigid_array(samples, array, pose, std::move(lights), likelihood);
    n_likelihood += fit.fit.n_iterations;
    has_converged = fit.fit.has_converged;
    const auto n_channels = static_cast<std::size_t>(samples.n_channels);
    const std::size_t n_unknowns =
        6 + (lights_in_use(samples).size() + count_points(samples) - 1) * n_channels;
    chi2 = reduced(fit.fit, n_unknowns);
    likelihood.sheet_start = fit.fit.sheet;
    test = test_rigid_array(samples, fit.fit, likelihood, freedom_of(fit.fit, n_unknowns));
    lights = std::move(fit.fit.lights);
    albedo = std::move(fit.fit.albedo);
    pose = fit.world_from_array;
  } else {
    PowerFit fit = fit_powers(samples, std::move(lights));
    lights = std::move(fit.lights);
    albedo = std::move(fit.albedo);
  }
  PoseBound bound = rigid_bound(samples, lights, albedo, likelihood);
  LightCalibration out =
      calibration_of(samples, std::move(lights), std::move(albedo), {bound.lights, bound.mu},
                     std::move(counts), chi2, options);
  if (chi2 > 1.0) {
    bound.covariance *= chi2;
    bound.mu *= std::sqrt(chi2);
  }
  bound.lights.clear();
  out.world_from_array = pose;
  out.pose_sigma = std::move(bound);
  out.sheet = likelihood.sheet_start;
  out.sheet_sigma = out.pose_sigma->sheet;
  out.test = test;
  out.variance = descent.d;
  out.n_variance_iterations = descent.n_iterations;
  out.n_likelihood_iterations = n_likelihood;
  out.has_converged = has_converged;
  return out;
}

}  // namespace haarlight::relight
