// SPDX-License-Identifier: Apache-2.0
#include "capture/plan/advice.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>
#include <span>
#include <utility>

#include <fmt/format.h>

#include "core/count.h"
#include "haarlight/core/error.h"
#include "session/clip_level.h"

namespace haarlight::capture {

namespace {

constexpr double kFullLevel = 65535.0;
constexpr double kPeakFraction = 0.999;  // as in the simulator's published figures
constexpr std::size_t kBlock = 32;       // pixels at once
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr int kManyDarks = 16;  // default_families(): dark noise below 6 % of read noise

/// r^2 and the variance of rounding to whole counts.
double read_variance(const CameraSpec& camera) {
  const double g = camera.noise.gain_e_per_dn;
  return camera.noise.read_e * camera.noise.read_e + g * g / 12.0;
}

double saturation_e(const CameraSpec& camera) {
  return (session::clip_level(camera) - camera.noise.black_dn) * camera.noise.gain_e_per_dn;
}

/// Pixels [begin, end) as columns: (n_lights, end - begin).
std::vector<double> columns_of(const std::vector<float>& rows, std::size_t n_lights,
                               std::size_t begin, std::size_t end) {
  const std::size_t width = end - begin;
  std::vector<double> out(n_lights * width);
  for (std::size_t p = begin; p < end; ++p) {
    for (std::size_t k = 0; k < n_lights; ++k) {
      out[k * width + (p - begin)] = double{rows[p * n_lights + k]};
    }
  }
  return out;
}

double percentile(std::vector<double> values, double fraction) {
  const auto at = static_cast<std::ptrdiff_t>(std::min(
      static_cast<double>(values.size()) - 1.0, fraction * static_cast<double>(values.size())));
  std::nth_element(values.begin(), values.begin() + at, values.end());
  return values[count(static_cast<int>(at))];
}

/// Sums over pixels and colours under one lighting.
class Sums {
 public:
  Sums(const PatternInverse& inverse, const AdviceScene& scene, const CameraSpec& camera,
       double x, int n_darks, const AdviceLighting& lighting, const AdviceOptions& options)
      : inverse_(inverse),
        scene_(scene),
        lighting_(lighting),
        x_(x),
        flicker2_(options.flicker * options.flicker),
        read2_(read_variance(camera)),
        dark2_(n_darks > 0 ? read2_ / n_darks : 0.0),
        has_plate_(inverse.needs_plate() && !scene.plate.empty()),
        a_(count(inverse.n_shots())),
        c_(count(scene.n_lights)) {}

  void add_block(std::size_t begin, std::size_t end) {
    const std::size_t n_lights = count(scene_.n_lights);
    const std::size_t width = end - begin;
    const std::vector<double> t = columns_of(scene_.electrons, n_lights, begin, end);
    std::vector<double> mu(a_.size() * width);
    inverse_.shoot(t, width, mu);
    std::vector<double> plate(has_plate_ ? n_lights : 0);
    for (Eigen::Index colour = 0; colour < lighting_.weights.cols(); ++colour) {
      const std::span<const double> w(lighting_.weights.col(colour).data(), n_lights);
      for (std::size_t i = 0; i < width; ++i) {
        if (has_plate_) {
          std::copy_n(
              scene_.plate.begin() + static_cast<std::ptrdiff_t>((begin + i) * n_lights),
              n_lights, plate.begin());
        }
        if (has_plate_ || i == 0) {
          set_weights(w, plate);
        }
        add_pixel(w, t, mu, begin + i, i, width);
      }
    }
  }

  [[nodiscard]] Prediction result() const {
    Prediction out;
    out.lighting = lighting_.name;
    const auto n = static_cast<double>(truth_.size());
    const double noise2 = noise2_ / n;
    const double bias2 = std::max(0.0, bias2_ / n);
    out.peak_e = percentile(truth_, kPeakFraction);
    out.noise_e = std::sqrt(noise2);
    const bool is_known = !inverse_.needs_plate() || scene_.resolves_lights;
    out.bias_e = is_known ? std::sqrt(bias2) : kNan;
    out.bias2_sigma = std::sqrt(bias4_) / n;
    const double peak2 = out.peak_e * out.peak_e;
    out.noise_psnr_db = 10.0 * std::log10(peak2 / noise2);
    out.psnr_db = is_known ? 10.0 * std::log10(peak2 / (noise2 + bias2)) : kNan;
    return out;
  }

 private:
  /// a, and c = w - P^T a: what the relit picture lacks of each light.
  void set_weights(std::span<const double> w, const std::vector<double>& plate) {
    inverse_.shot_weights(w, plate, a_);
    a_sum_ = std::accumulate(a_.begin(), a_.end(), 0.0);
    std::copy(w.begin(), w.end(), c_.begin());
    if (!inverse_.needs_plate()) {
      std::fill(c_.begin(), c_.end(), 0.0);
      return;
    }
    for (std::size_t j = 0; j < a_.size(); ++j) {
      for (const LightDriveLevel& light : inverse_.shots()[j]) {
        c_[count(light.light)] -= a_[j] * light.drive;
      }
    }
  }

  void add_pixel(std::span<const double> w, const std::vector<double>& t,
                 const std::vector<double>& mu, std::size_t pixel, std::size_t i,
                 std::size_t width) {
    double noise2 = a_sum_ * a_sum_ * dark2_;
    for (std::size_t j = 0; j < a_.size(); ++j) {
      const double electrons = x_ * mu[j * width + i];
      const double light2 = std::max(electrons, 0.0) + flicker2_ * electrons * electrons;
      noise2 += a_[j] * a_[j] * (read2_ + light2);
    }
    noise2_ += noise2 / (x_ * x_);
    double truth = 0.0;
    double bias = 0.0;
    double own2 = 0.0;  // variance of `bias` from the pilot's noise
    for (std::size_t k = 0; k < c_.size(); ++k) {
      truth += w[k] * t[k * width + i];
      bias += c_[k] * t[k * width + i];
      if (!scene_.variance.empty()) {
        own2 += c_[k] * c_[k] * double{scene_.variance[pixel * c_.size() + k]};
      }
    }
    truth_.push_back(truth);
    bias2_ += bias * bias - own2;
    // Var((b + n)^2) = 4 b^2 v + 2 v^2, b^2 estimated.
    bias4_ += 4.0 * std::max(bias * bias - own2, 0.0) * own2 + 2.0 * own2 * own2;
  }

  const PatternInverse& inverse_;
  const AdviceScene& scene_;
  const AdviceLighting& lighting_;
  double x_;
  double flicker2_;
  double read2_;
  double dark2_;
  bool has_plate_;
  std::vector<double> a_;
  std::vector<double> c_;
  double a_sum_ = 0.0;
  double noise2_ = 0.0;
  double bias2_ = 0.0;
  double bias4_ = 0.0;
  std::vector<double> truth_;
};

void require_scene(const AdviceScene& scene) {
  const std::size_t n = count(scene.n_lights) * count(scene.n_pixels);
  HAARLIGHT_EXPECTS(n > 0 && scene.electrons.size() == n &&
                        (scene.variance.empty() || scene.variance.size() == n) &&
                        (scene.plate.empty() || scene.plate.size() == n),
                    "(pixels, lights) of electrons, variance and clean plate");
}

/// The mean of the largest x mu_j + sigmas sqrt(v) of any pixel and shot, at x = 1.
double brightest(const PatternInverse& inverse, const AdviceScene& scene) {
  const std::size_t n_lights = count(scene.n_lights);
  double most = 0.0;
  for (std::size_t begin = 0; begin < count(scene.n_pixels); begin += kBlock) {
    const std::size_t end = std::min(begin + kBlock, count(scene.n_pixels));
    std::vector<double> mu(count(inverse.n_shots()) * (end - begin));
    inverse.shoot(columns_of(scene.electrons, n_lights, begin, end), end - begin, mu);
    most = std::max(most, *std::max_element(mu.begin(), mu.end()));
  }
  return most;
}

/// Mean over pixels and lights.
double mean_signal(const AdviceScene& scene) {
  double sum = 0.0;
  for (const float value : scene.electrons) {
    sum += double{value};
  }
  return sum / static_cast<double>(scene.electrons.size());
}

/// The mean m with m + sigmas sqrt(r^2 + m) = limit.
double largest_mean(double limit, double read2, double sigmas) {
  const double half = 0.5 * sigmas;
  const double root = -half + std::sqrt(half * half + limit + read2);
  return std::max(root * root - read2, 0.0);
}

/// Exposures are whole numbers of PWM periods where a dimmed light is dimmed by PWM.
double whole_periods(double exposure_us, double pwm_hz) {
  const double periods = std::floor(exposure_us * pwm_hz * 1e-6 + 1e-9);
  return periods / pwm_hz * 1e6;
}

double pwm_of(const Rig& rig, const Plan& plan) {
  std::vector<double> pwm_hz;
  for (const Face& face : rig.faces) {
    pwm_hz.insert(pwm_hz.end(), count(face.n_lights()), face.pwm_hz);
  }
  double slowest = 0.0;
  for (const session::Shot& shot : plan.shots) {
    for (const session::LightLevel& light : shot.lit) {
      const double hz = pwm_hz[count(light.light)];
      if (light.level < kFullLevel && hz > 0.0 && (slowest == 0.0 || hz < slowest)) {
        slowest = hz;
      }
    }
  }
  return slowest;
}

class Adviser {
 public:
  Adviser(const Rig& rig, const AdviceScene& scene,
          const std::vector<AdviceLighting>& lightings, const Lighting* own,
          const AdviceOptions& options)
      : rig_(rig),
        camera_(rig.cameras.front()),
        scene_(scene),
        lightings_(lightings),
        own_(own),
        options_(options) {}

  [[nodiscard]] FamilyAdvice evaluate(PlanSettings settings) const {
    FamilyAdvice out;
    out.name = settings.name;
    out.limit_e = saturation_e(camera_);
    out.exposure_us =
        settings.exposures_us.empty() ? camera_.exposure_us : settings.exposures_us.front();
    settings.exposures_us = {out.exposure_us};
    std::optional<PatternInverse> inverse;
    try {
      // Power and duty are checked after the exposure has been chosen.
      Rig unlimited = rig_;
      unlimited.sync = SyncMode::free_run;
      for (Face& face : unlimited.faces) {
        face.max_power = Watts(1e12);
        face.string_lights = 0;
        face.max_duty = 1.0;
        face.pwm_hz = 0.0;
      }
      out.plan = expand_plan(settings, unlimited, own_);
      inverse.emplace(inverse_of(out.plan));
    } catch (const Error& error) {
      out.refusals.push_back(error.problem());
      out.plan = {};
      return out;
    }
    out.brightest_e = brightest(*inverse, scene_);
    choose_exposure(out);
    if (out.exposure_us < 1.0) {
      return out;
    }
    settings.exposures_us = {out.exposure_us};
    try {
      out.plan = expand_plan(settings, rig_, own_);
    } catch (const Error& error) {
      out.refusals.push_back(error.problem());
      for (session::Shot& shot : out.plan.shots) {
        shot.exposure_us = out.exposure_us;
      }
    }
    out.cost = dry_run(out.plan, rig_);
    const auto n_darks = static_cast<int>(std::count_if(
        out.plan.shots.begin(), out.plan.shots.end(),
        [](const session::Shot& shot) { return shot.kind == session::ShotKind::dark; }));
    for (const AdviceLighting& lighting : lightings_) {
      out.predictions.push_back(
          predict(*inverse, scene_, camera_, out.exposure_us, n_darks, lighting, options_));
    }
    for (const Prediction& p : out.predictions) {
      constexpr double kDoubt = 0.2;  // of the error's square: 0.8 dB
      const double error2 = p.noise_e * p.noise_e + p.bias_e * p.bias_e;
      if (p.bias2_sigma > kDoubt * error2) {
        out.notes.push_back(
            fmt::format("{}: the pilot is too noisy for this figure (error {:.3g} electrons "
                        "squared, known to "
                        "{:.2g}): expose it longer",
                        p.lighting, error2, p.bias2_sigma));
      }
    }
    if (out.plan.patterns.family == PatternFamily::s_matrix) {
      explain_s_matrix(out);
    }
    return out;
  }

 private:
  void choose_exposure(FamilyAdvice& out) const {
    const double x = out.exposure_us / camera_.exposure_us;
    const double mean_limit =
        largest_mean(out.limit_e, read_variance(camera_), options_.sigmas);
    const double wanted_us = out.exposure_us;
    if (x * out.brightest_e > mean_limit) {
      out.exposure_us = mean_limit / out.brightest_e * camera_.exposure_us;
      out.notes.push_back(fmt::format(
          "at {:.0f} us its brightest shot collects {:.0f} electrons, {:.0f} fit (full well or "
          "converter {:.0f}, less {:.0f} sigmas): {:.1f} us is the longest exposure",
          wanted_us, x * out.brightest_e, mean_limit, out.limit_e, options_.sigmas,
          out.exposure_us));
    }
    if (const double pwm_hz = pwm_of(rig_, out.plan); pwm_hz > 0.0) {
      const double fitted_us = whole_periods(out.exposure_us, pwm_hz);
      if (fitted_us <= 0.0) {
        out.refusals.push_back(fmt::format(
            "dimmed lights flicker at {:.0f} Hz: the exposure must be a multiple of {:.1f} us, "
            "but {:.1f} us is the longest that does not saturate",
            pwm_hz, 1e6 / pwm_hz, out.exposure_us));
        out.exposure_us = 0.0;
        return;
      }
      out.exposure_us = fitted_us;
    }
    if (out.exposure_us < 1.0) {
      out.refusals.push_back(
          fmt::format("it saturates at every exposure: {:.0f} electrons at 1 us, {:.0f} fit",
                      out.brightest_e / camera_.exposure_us, mean_limit));
    }
  }

  void explain_s_matrix(FamilyAdvice& out) const {
    const double r2 = read_variance(camera_);
    const double x = out.exposure_us / camera_.exposure_us;
    const double s = x * mean_signal(scene_);
    const int n = out.plan.patterns.faces.front().n_lights();
    const double gain2 = s_matrix_gain2(std::sqrt(r2), s, n);
    out.notes.push_back(fmt::format(
        "a light gives s = {:.3g} electrons per shot at {:.4g} us, r^2 = {:.3g}: gain^2 = (r^2 "
        "+ "
        "s)/(4 r^2/n + 2 s) = ({:.3g} + {:.3g})/({:.3g} + {:.3g}) = {:.3g} against single "
        "lights of the same exposure",
        s, out.exposure_us, r2, r2, s, 4.0 * r2 / n, 2.0 * s, gain2));
    if (gain2 <= 1.0) {
      out.refusals.push_back(fmt::format(
          "multiplexing does not help: gain^2 = {:.3g}, s = {:.3g} electrons are not below the "
          "read noise squared {:.3g}",
          gain2, s, r2));
    }
  }

  const Rig& rig_;
  const CameraSpec& camera_;
  const AdviceScene& scene_;
  const std::vector<AdviceLighting>& lightings_;
  const Lighting* own_;
  const AdviceOptions& options_;
};

double worst_psnr(const FamilyAdvice& family) {
  double worst = std::numeric_limits<double>::infinity();
  for (const Prediction& prediction : family.predictions) {
    worst = std::isnan(prediction.psnr_db) ? -std::numeric_limits<double>::infinity()
                                           : std::min(worst, prediction.psnr_db);
  }
  return family.predictions.empty() ? -std::numeric_limits<double>::infinity() : worst;
}

/// Refuses what takes as many shots as one light at a time and is not better under any
/// lighting.
void refuse_what_does_not_help(std::vector<FamilyAdvice>& families) {
  const auto single =
      std::find_if(families.begin(), families.end(), [](const FamilyAdvice& family) {
        return family.name == "one_at_a_time" && !family.predictions.empty();
      });
  if (single == families.end()) {
    return;
  }
  const FamilyAdvice reference = *single;
  for (FamilyAdvice& family : families) {
    if (family.name == reference.name || family.predictions.empty() ||
        family.cost.seconds < 0.95 * reference.cost.seconds) {
      continue;
    }
    bool helps = false;
    for (std::size_t i = 0; i < family.predictions.size(); ++i) {
      helps = helps || !(family.predictions[i].psnr_db <= reference.predictions[i].psnr_db);
    }
    if (!helps) {
      const Prediction& a = family.predictions.front();
      const Prediction& b = reference.predictions.front();
      family.refusals.push_back(fmt::format(
          "it takes {:.1f} s where one at a time takes {:.1f} s and is better under no "
          "lighting ({}: {:.1f} dB, one at a time {:.1f} dB)",
          family.cost.seconds, reference.cost.seconds, a.lighting, a.psnr_db, b.psnr_db));
    }
  }
}

}  // namespace

AdviceScene plate_scene(std::vector<float> plate, int n_lights, double lit_electrons) {
  HAARLIGHT_EXPECTS(n_lights > 0 && !plate.empty() && plate.size() % count(n_lights) == 0,
                    "(pixels, lights)");
  AdviceScene scene;
  scene.n_lights = n_lights;
  scene.n_pixels = static_cast<int>(plate.size() / count(n_lights));
  std::vector<double> means;  // of the pixels that see the plane
  for (std::size_t p = 0; p < count(scene.n_pixels); ++p) {
    double sum = 0.0;
    for (std::size_t k = 0; k < count(n_lights); ++k) {
      sum += double{plate[p * count(n_lights) + k]};
    }
    if (sum > 0.0) {
      means.push_back(sum / n_lights);
    }
  }
  HAARLIGHT_EXPECTS(!means.empty(), "a clean plate that some pixel sees");
  const double scale = lit_electrons / percentile(means, 0.5);
  scene.electrons.resize(plate.size());
  std::transform(plate.begin(), plate.end(), scene.electrons.begin(),
                 [scale](float value) { return static_cast<float>(scale * double{value}); });
  scene.plate = std::move(plate);
  scene.source = fmt::format("the empty plane, {:.4g} electrons per light", lit_electrons);
  return scene;
}

AdviceLighting single_lights(int n_lights, int n) {
  AdviceLighting lighting;
  lighting.name = "one light";
  const int n_shown = std::min(n, n_lights);
  lighting.weights = Eigen::MatrixXd::Zero(n_lights, n_shown);
  // Steps of the golden ratio sample rows and columns evenly.
  constexpr double kGolden = 0.6180339887498949;
  for (int i = 0; i < n_shown; ++i) {
    const double at = n_shown == n_lights ? static_cast<double>(i) / n_lights
                                          : std::fmod((i + 0.5) * kGolden, 1.0);
    lighting.weights(static_cast<Eigen::Index>(at * n_lights), i) = 1.0;
  }
  return lighting;
}

double s_matrix_gain2(double read_e, double signal_e, int n) {
  const double r2 = read_e * read_e;
  return (r2 + signal_e) / (4.0 * r2 / n + 2.0 * signal_e);
}

Prediction predict(const PatternInverse& inverse, const AdviceScene& scene,
                   const CameraSpec& camera, double exposure_us, int n_darks,
                   const AdviceLighting& lighting, const AdviceOptions& options) {
  require_scene(scene);
  HAARLIGHT_EXPECTS(lighting.weights.rows() == scene.n_lights && lighting.weights.cols() > 0 &&
                        inverse.n_lights() == scene.n_lights,
                    "weights and patterns of the scene's lights");
  Sums sums(inverse, scene, camera, exposure_us / camera.exposure_us, n_darks, lighting,
            options);
  for (std::size_t begin = 0; begin < count(scene.n_pixels); begin += kBlock) {
    sums.add_block(begin, std::min(begin + kBlock, count(scene.n_pixels)));
  }
  return sums.result();
}

PatternInverse inverse_of(const Plan& plan) {
  std::vector<std::vector<LightDriveLevel>> shots;
  std::vector<std::vector<int>> lights;
  for (const session::Shot& shot : plan.shots) {
    if (shot.kind != session::ShotKind::light ||
        shot.exposure_us != plan.shots.front().exposure_us) {
      continue;
    }
    std::vector<LightDriveLevel> drive_levels;
    std::vector<int> lit;
    for (const session::LightLevel& level : shot.lit) {
      if (level.level > 0) {
        drive_levels.push_back({level.light, level.level / kFullLevel});
        lit.push_back(level.light);
      }
    }
    if (std::find(lights.begin(), lights.end(), lit) == lights.end() ||
        plan.patterns.family == PatternFamily::target) {
      shots.push_back(std::move(drive_levels));
      lights.push_back(std::move(lit));
    }
  }
  PatternParameters parameters = plan.patterns;
  if (parameters.family == PatternFamily::list) {
    const bool is_single = std::all_of(lights.begin(), lights.end(),
                                       [](const auto& lit) { return lit.size() == 1; });
    if (is_single && static_cast<int>(lights.size()) == plan.n_lights) {
      parameters = {PatternFamily::one_at_a_time, {{1, plan.n_lights}}, 0, {}};
    }
  }
  if (parameters.family != PatternFamily::list && parameters.family != PatternFamily::target) {
    // The canonical order, at the plan's single level.
    const double drive = shots.front().front().drive;
    shots.clear();
    for (const std::vector<int>& lit : lit_lights(parameters)) {
      shots.emplace_back();
      for (const int light : lit) {
        shots.back().push_back({light, drive});
      }
    }
  }
  return {std::move(parameters), std::move(shots), plan.n_lights};
}

Advice advise(const Rig& rig, const AdviceScene& scene,
              const std::vector<AdviceLighting>& lightings,
              const std::vector<PlanSettings>& settings, const Lighting* own,
              const AdviceOptions& options) {
  require_scene(scene);
  const CameraSpec& camera = rig.cameras.front();
  if (!(camera.noise.full_well_e > 0.0) || !(camera.noise.gain_e_per_dn > 0.0)) {
    throw Error(fmt::format("camera \"{}\" has no noise figures", camera.id),
                rig.file.empty() ? rig.name : rig.file.string(),
                "measure them (haarlight rig commission), or write noise = { gain, read, "
                "full_well, black }");
  }
  const Adviser adviser(rig, scene, lightings, own, options);
  Advice advice;
  for (const PlanSettings& family : settings) {
    advice.families.push_back(adviser.evaluate(family));
  }
  refuse_what_does_not_help(advice.families);
  for (int i = 0; i < static_cast<int>(advice.families.size()); ++i) {
    const FamilyAdvice& family = advice.families[count(i)];
    if (!family.refusals.empty() || family.predictions.empty()) {
      continue;
    }
    if (options.target_db > 0.0) {
      const bool is_faster =
          advice.best < 0 ||
          family.cost.seconds < advice.families[count(advice.best)].cost.seconds;
      if (worst_psnr(family) >= options.target_db && is_faster) {
        advice.best = i;
      }
    } else if (std::isfinite(worst_psnr(family)) &&
               (advice.best < 0 ||
                worst_psnr(family) > worst_psnr(advice.families[count(advice.best)]))) {
      advice.best = i;
    }
  }
  return advice;
}

std::vector<PlanSettings> default_families(const Rig& rig, bool has_lighting) {
  std::vector<PlanSettings> families;
  const auto add = [&](std::string name, PlanPatterns patterns, std::size_t n_shots) {
    PlanSettings settings;
    settings.name = std::move(name);
    settings.where = settings.name;
    settings.patterns = patterns;
    settings.order = n_shots > 64 ? ShotOrder::bit_reversed : ShotOrder::raster;
    settings.darks_every = static_cast<int>(std::max<std::size_t>(1, n_shots / kManyDarks));
    families.push_back(settings);
    return &families.back();
  };
  const auto n_lights = count(rig.n_lights());
  add("one_at_a_time", PlanPatterns::one_at_a_time, n_lights);
  for (const int side : {16, 8, 4}) {  // blocks per side: 256, 64, 16 shots per face
    const bool is_fit = std::all_of(rig.faces.begin(), rig.faces.end(), [&](const Face& face) {
      return face.rows == face.cols && face.rows % side == 0 && face.rows > side;
    });
    if (is_fit) {
      const std::size_t n_shots = count(side) * count(side) * rig.faces.size();
      add(fmt::format("bins_{}", side * side), PlanPatterns::bins, n_shots)->bin =
          rig.faces.front().rows / side;
    }
  }
  add("s_matrix", PlanPatterns::s_matrix, n_lights);
  if (has_lighting) {
    const bool is_haar = std::all_of(rig.faces.begin(), rig.faces.end(), [&](const Face& face) {
      return face.is_haar_grid() && face.rows == rig.faces.front().rows;
    });
    if (is_haar) {
      PlanSettings* haar = add("lighting_haar", PlanPatterns::lighting_haar, 128);
      haar->wavelets = 64;
    }
    PlanSettings* target = add("lighting_target", PlanPatterns::lighting_target, 1);
    (void)target;
    target->repeats = 1;
    target->darks_every = 1;
  }
  return families;
}

}  // namespace haarlight::capture
