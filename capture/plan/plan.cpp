// SPDX-License-Identifier: Apache-2.0
#include "haarlight/capture/plan/plan.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <numeric>
#include <span>

#include <fmt/format.h>

#include "capture/plan/plan_rounds.h"
#include "capture/plan/timing.h"
#include "core/config_table.h"
#include "core/rig/pattern_inverse.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"

namespace haarlight::capture {

namespace {

constexpr int kMaxShots = 1000000;
constexpr std::size_t kMaxLit = 20000000;  // lit entries of all shots: 160 MB in memory
constexpr double kFullLevel = 65535.0;

using PatternList = std::vector<std::vector<session::LightLevel>>;

/// A list of whole numbers in [0, max].
std::vector<int> whole_numbers(ConfigTable& table, std::string_view key, double max) {
  std::vector<int> out;
  for (const double x : table.numbers(key, 0)) {
    if (!(x >= 0.0 && x <= max) || x != std::floor(x)) {
      table.problem(key, fmt::format("{} is not a whole number from 0 to {}", x, max),
                    "write whole numbers");
      return {};
    }
    out.push_back(static_cast<int>(x));
  }
  return out;
}

std::vector<session::LightLevel> read_pattern(ConfigTable& table) {
  const std::vector<int> lights = whole_numbers(table, "lights", 1e6);
  std::vector<int> levels;
  if (table.has("levels")) {
    levels = whole_numbers(table, "levels", kFullLevel);
    if (levels.size() != lights.size()) {
      table.problem("levels",
                    fmt::format("{} levels for {} lights", levels.size(), lights.size()),
                    "write one level per light, or leave levels out for full drive");
    }
  }
  levels.resize(lights.size(), 65535);
  std::vector<session::LightLevel> lit;
  for (std::size_t i = 0; i < lights.size(); ++i) {
    lit.push_back(session::LightLevel{.light = lights[i],
                                      .level = static_cast<std::uint16_t>(levels[i])});
  }
  std::sort(lit.begin(), lit.end(),
            [](const session::LightLevel& a, const session::LightLevel& b) {
              return a.light < b.light;
            });
  for (std::size_t i = 1; i < lit.size(); ++i) {
    if (lit[i].light == lit[i - 1].light) {
      table.problem("lights", fmt::format("light {} stands twice in one pattern", lit[i].light),
                    "name each light once");
    }
  }
  return lit;
}

PlanSettings read_settings(ConfigTable& root) {
  PlanSettings plan;
  (void)root.integer("schema", {.min = 1, .max = 1});
  plan.name = root.text("name");
  plan.patterns = root.one_of<PlanPatterns>("patterns");
  plan.order = root.one_of_or("order", ShotOrder::raster);
  plan.level = static_cast<std::uint16_t>(
      root.integer_or("level", 65535, {.min = 1, .max = kFullLevel}));
  plan.bin = static_cast<int>(root.integer_or("bin", 2, {.min = 1, .max = 256}));
  plan.wavelets = static_cast<int>(root.integer_or("wavelets", 64, {.min = 1, .max = 1e6}));
  plan.environment = root.text_or("environment", "");
  const bool is_lighting = plan.patterns == PlanPatterns::lighting_haar ||
                           plan.patterns == PlanPatterns::lighting_target;
  if (is_lighting == plan.environment.empty()) {
    root.problem("environment",
                 is_lighting ? "a lighting plan needs its environment"
                             : "an environment belongs to lighting_haar and lighting_target",
                 is_lighting ? "write environment = \"room.hdr\" (relative to the plan file)"
                             : "remove it, or set patterns = \"lighting_haar\"");
  }
  if (root.has("lights")) {
    plan.lights = whole_numbers(root, "lights", 1e6);
    if (plan.patterns != PlanPatterns::one_at_a_time) {
      root.problem("lights", "lights at the top level belong to patterns = \"one_at_a_time\"",
                   "use [[pattern]] with patterns = \"list\"");
    }
  }
  if (root.has("exposures_us")) {
    plan.exposures_us = root.numbers("exposures_us", 0);
    for (const double e : plan.exposures_us) {
      if (!(e >= 1.0 && e <= 1e9)) {
        root.problem("exposures_us", fmt::format("an exposure of {} us", e),
                     "write microseconds, from 1 to 1e9");
        break;
      }
    }
  }
  plan.repeats = static_cast<int>(root.integer_or("repeats", 1, {.min = 1, .max = 10000}));
  plan.darks_every =
      static_cast<int>(root.integer_or("darks_every", 0, {.min = 0, .max = 1e6}));
  plan.sentinel_every =
      static_cast<int>(root.integer_or("sentinel_every", 0, {.min = 0, .max = 1e6}));
  plan.sentinel_light =
      static_cast<int>(root.integer_or("sentinel_light", 0, {.min = 0, .max = 1e6}));
  plan.darks_every_s = root.number_or("darks_every_s", 0.0, {.min = 0.0, .max = 1e6});
  plan.sentinel_every_s = root.number_or("sentinel_every_s", 0.0, {.min = 0.0, .max = 1e6});
  plan.darks_every_c = root.number_or("darks_every_c", 0.0, {.min = 0.0, .max = 100.0});
  plan.spare_darks =
      static_cast<int>(root.integer_or("spare_darks", 0, {.min = 0, .max = 1e4}));
  if ((plan.darks_every_c > 0.0) != (plan.spare_darks > 0)) {
    root.problem(plan.spare_darks > 0 ? "spare_darks" : "darks_every_c",
                 "darks by temperature need both darks_every_c and spare_darks",
                 "write for example darks_every_c = 2.0 and spare_darks = 8");
  } else if (plan.darks_every_c > 0.0 && plan.darks_every == 0 && plan.darks_every_s == 0.0) {
    root.problem("darks_every_c", "no first dark frame to measure the temperature from",
                 "set darks_every or darks_every_s too");
  }
  plan.flats = static_cast<int>(root.integer_or("flats", 0, {.min = 0, .max = 10000}));
  plan.flat_level = static_cast<std::uint16_t>(
      root.integer_or("flat_level", plan.level, {.min = 1, .max = kFullLevel}));
  if (root.has("flat_exposure_us")) {
    plan.flat_exposure_us = root.number("flat_exposure_us", {.min = 1.0, .max = 1e9});
  }
  plan.reserve_mb = root.number_or("reserve_mb", 0.0, {.min = 0.0, .max = 1e9});
  FrameLimits& limits = plan.limits;
  limits.max_saturated_fraction = root.number_or(
      "max_saturated_share", limits.max_saturated_fraction, {.min = 0.0, .max = 1.0});
  limits.min_signal_fraction =
      root.number_or("min_signal_share", limits.min_signal_fraction, {.min = 0.0, .max = 1.0});
  limits.level_tolerance =
      root.number_or("level_tolerance", limits.level_tolerance, {.min = 0.0, .max = 10.0});
  limits.attempts =
      static_cast<int>(root.integer_or("attempts", limits.attempts, {.min = 1, .max = 100}));
  limits.retake_wrong_light = root.flag_or("retake_wrong_light", limits.retake_wrong_light);
  if (limits.retake_wrong_light && plan.repeats < 2) {
    root.problem(
        "retake_wrong_light",
        "retake_wrong_light holds two frames of the same lights against each other, and "
        "each is taken only once",
        "add repeats = 2");
  }
  for (ConfigTable& table : root.tables("pattern")) {
    plan.list.push_back(read_pattern(table));
  }
  if (plan.patterns == PlanPatterns::list && plan.list.empty() && plan.flats == 0) {
    root.problem("patterns", "patterns = \"list\", but no [[pattern]] follows",
                 "add [[pattern]] with lights = [...]");
  }
  if (plan.patterns != PlanPatterns::list && !plan.list.empty()) {
    root.problem("patterns", "[[pattern]] is only read with patterns = \"list\"",
                 "set patterns = \"list\", or remove [[pattern]]");
  }
  root.finish();
  return plan;
}

/// The size of a plan, before any of it is created.
struct PlanSize {
  double patterns = 0.0;
  double lit = 0.0;  ///< entries of all patterns, lower bound
};

PlanSize size_of_patterns(const PlanSettings& settings, const Rig& rig) {
  const double n = rig.n_lights();
  const double n_side = rig.faces.front().rows;
  switch (settings.patterns) {
    case PlanPatterns::one_at_a_time: {
      const double n_requested =
          settings.lights.empty() ? n : static_cast<double>(settings.lights.size());
      return {n_requested, n_requested};
    }
    case PlanPatterns::list: {
      PlanSize size{static_cast<double>(settings.list.size()), 0.0};
      for (const auto& lit : settings.list) {
        size.lit += static_cast<double>(lit.size());
      }
      return size;
    }
    case PlanPatterns::bins:
      return {std::ceil(n / settings.bin / settings.bin), n};
    case PlanPatterns::s_matrix:
      return {n, n * n / 2.0};  // every other light in each of at least n patterns
    case PlanPatterns::haar:
    case PlanPatterns::lighting_haar: {
      // Every level's wavelets cover each light.
      const double levels = std::max(1.0, std::log2(std::max(1.0, n_side)));
      const double fraction =
          settings.patterns == PlanPatterns::haar ? 1.0 : std::min(1.0, settings.wavelets / n);
      return {n * fraction, fraction < 1.0 ? 0.0 : n * levels};
    }
    case PlanPatterns::lighting_target:
      return {1.0, 0.0};
  }
  return {};
}

/// Arithmetic only: a plan refused here is never created. @throws Error
void require_size(const PlanSettings& settings, const Rig& rig, const PlanSize& size) {
  const double n_exposures = std::max(1.0, static_cast<double>(settings.exposures_us.size()));
  const double rounds = n_exposures * settings.repeats;
  const double shots =
      rounds * size.patterns + settings.flats + n_exposures * settings.spare_darks;
  const double lit = rounds * size.lit + static_cast<double>(settings.flats) * rig.n_lights();
  // At most one dark and one sentinel per pattern.
  const bool is_between = settings.darks_every > 0 || settings.darks_every_s > 0.0 ||
                          settings.sentinel_every > 0 || settings.sentinel_every_s > 0.0;
  const double most = shots + (is_between ? 2.0 * rounds * (size.patterns + 1.0) : 0.0) + 1.0;
  if (most > kMaxShots || lit > static_cast<double>(kMaxLit)) {
    throw Error(
        fmt::format("{:.0f} patterns in {:.0f} rounds ({} exposures, {} repeats) and {} flats "
                    "are {:.3g} shots with {:.3g} lit lights; a plan may hold {} and {}",
                    size.patterns, rounds, n_exposures, settings.repeats, settings.flats, shots,
                    lit, kMaxShots, kMaxLit),
        settings.where, "split the plan");
  }
}

/// Every light of the parameters' shots at one level.
PatternList rows_of(const PatternParameters& parameters, std::uint16_t level) {
  PatternList list;
  for (const std::vector<int>& lights : lit_lights(parameters)) {
    std::vector<session::LightLevel> lit;
    lit.reserve(lights.size());
    for (const int light : lights) {
      lit.push_back(session::LightLevel{.light = light, .level = level});
    }
    list.push_back(std::move(lit));
  }
  return list;
}

PatternList one_light_each(const PlanSettings& settings, const Rig& rig) {
  std::vector<int> lights = settings.lights;
  if (lights.empty()) {
    lights.resize(static_cast<std::size_t>(rig.n_lights()));
    std::iota(lights.begin(), lights.end(), 0);
  }
  PatternList list;
  for (const int k : lights) {
    list.push_back({session::LightLevel{.light = k, .level = settings.level}});
  }
  return list;
}

PatternParameters parameters_of(const PlanSettings& settings, const Rig& rig,
                                PatternFamily family) {
  PatternParameters parameters;
  parameters.family = family;
  for (const Face& face : rig.faces) {
    parameters.faces.push_back({face.rows, face.cols});
  }
  parameters.bin = family == PatternFamily::bins ? settings.bin : 0;
  return parameters;
}

void require_fit(const PatternParameters& parameters, const PlanSettings& settings,
                 const Rig& rig) {
  if (fits(parameters)) {
    return;
  }
  const Face& face = rig.faces.front();
  throw Error(fmt::format("patterns \"{}\" do not fit the {} x {} lights of face \"{}\"{}",
                          to_string(settings.patterns), face.rows, face.cols, face.id,
                          rig.faces.size() > 1 ? " and the others" : ""),
              settings.where,
              parameters.family == PatternFamily::bins
                  ? "choose a bin that divides the rows and columns of every face"
                  : "haar needs equal square faces with a power of two of rows");
}

/// The wavelets of a lighting, or all.
PatternParameters haar_parameters(const PlanSettings& settings, const Rig& rig,
                                  const Lighting* lighting) {
  PatternParameters parameters = parameters_of(settings, rig, PatternFamily::haar);
  parameters.wavelets.resize(static_cast<std::size_t>(rig.n_lights()));
  std::iota(parameters.wavelets.begin(), parameters.wavelets.end(), 0);
  require_fit(parameters, settings, rig);
  if (lighting != nullptr) {
    parameters.wavelets = choose_wavelets(*lighting, rig.faces.front().rows, settings.wavelets);
  }
  return parameters;
}

/// One shot per colour: the brightest light at `level`, the others in proportion.
PatternList target_shots(const PlanSettings& settings, const Lighting& lighting) {
  PatternList list;
  for (Eigen::Index colour = 0; colour < lighting.weights.cols(); ++colour) {
    const double peak = lighting.weights.col(colour).maxCoeff();
    std::vector<session::LightLevel> lit;
    for (Eigen::Index k = 0; peak > 0.0 && k < lighting.weights.rows(); ++k) {
      const auto level = static_cast<std::uint16_t>(
          std::lround(lighting.weights(k, colour) / peak * settings.level));
      if (level > 0) {
        lit.push_back(session::LightLevel{.light = static_cast<int>(k), .level = level});
      }
    }
    // Colours whose lights have equal levels share a shot.
    if (!lit.empty() && std::find(list.begin(), list.end(), lit) == list.end()) {
      list.push_back(std::move(lit));
    }
  }
  if (list.empty()) {
    throw Error("the environment is black where the rig has lights", settings.where,
                "use another environment, or turn it");
  }
  return list;
}

PatternList patterns_of(const PlanSettings& settings, const Rig& rig, const Lighting* lighting,
                        PatternParameters& parameters) {
  const bool is_lighting = settings.patterns == PlanPatterns::lighting_haar ||
                           settings.patterns == PlanPatterns::lighting_target;
  if (is_lighting && lighting == nullptr) {
    throw Error(fmt::format("the light weights of environment \"{}\" are not known here",
                            settings.environment),
                settings.where,
                "make the shot list first (haarlight plan RIG PLAN -o plan.json) and capture "
                "that");
  }
  HAARLIGHT_EXPECTS(!is_lighting || lighting->weights.rows() == rig.n_lights(),
                    "a weight for each light");
  switch (settings.patterns) {
    case PlanPatterns::one_at_a_time:
      return one_light_each(settings, rig);
    case PlanPatterns::list:
      return settings.list;
    case PlanPatterns::bins:
      parameters = parameters_of(settings, rig, PatternFamily::bins);
      break;
    case PlanPatterns::s_matrix:
      parameters = parameters_of(settings, rig, PatternFamily::s_matrix);
      break;
    case PlanPatterns::haar:
      parameters = haar_parameters(settings, rig, nullptr);
      break;
    case PlanPatterns::lighting_haar:
      parameters = haar_parameters(settings, rig, lighting);
      break;
    case PlanPatterns::lighting_target:
      parameters.family = PatternFamily::target;
      return target_shots(settings, *lighting);
  }
  require_fit(parameters, settings, rig);
  return rows_of(parameters, settings.level);
}

Eigen::Vector3d middle_of(const std::vector<session::LightLevel>& lit,
                          const std::vector<LightElement>& lights) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (const session::LightLevel& light : lit) {
    sum += lights[static_cast<std::size_t>(light.light)].centre;
  }
  return lit.empty() ? sum : Eigen::Vector3d(sum / static_cast<double>(lit.size()));
}

std::vector<std::size_t> bit_reversed(std::size_t n) {
  const std::size_t width = std::bit_ceil(n);
  const int n_bits = std::countr_zero(width);
  std::vector<std::size_t> order;
  for (std::size_t i = 0; i < width; ++i) {
    std::size_t reversed = 0;
    for (int bit = 0; bit < n_bits; ++bit) {
      reversed |= ((i >> bit) & 1U) << (n_bits - 1 - bit);
    }
    if (reversed < n) {
      order.push_back(reversed);
    }
  }
  return order;
}

/// Greedy: the next pattern has the greatest minimum distance to the last eight; ties go to the
/// first.
std::vector<std::size_t> greatest_distance(const PatternList& list, const Rig& rig,
                                           const std::string& where) {
  constexpr std::size_t kMaxPatterns = 8192;
  constexpr std::size_t kWindow = 8;
  if (list.size() > kMaxPatterns) {
    throw Error(fmt::format("order \"greatest_distance\" of {} patterns", list.size()), where,
                "use \"bit_reversed\" for more than 8192 patterns");
  }
  const std::vector<LightElement> lights = light_elements(rig);
  std::vector<Eigen::Vector3d> positions;
  for (const auto& lit : list) {
    positions.push_back(middle_of(lit, lights));
  }
  std::vector<bool> is_used(list.size(), false);
  std::vector<std::size_t> order;
  while (order.size() < list.size()) {
    std::size_t best = list.size();
    double best_distance = -1.0;
    for (std::size_t i = 0; i < list.size(); ++i) {
      if (is_used[i]) {
        continue;
      }
      double least = std::numeric_limits<double>::max();
      for (std::size_t j = order.size() > kWindow ? order.size() - kWindow : 0;
           j < order.size(); ++j) {
        least = std::min(least, (positions[i] - positions[order[j]]).squaredNorm());
      }
      if (least > best_distance) {
        best_distance = least;
        best = i;
      }
    }
    is_used[best] = true;
    order.push_back(best);
  }
  return order;
}

PatternList in_order(PatternList list, const PlanSettings& settings, const Rig& rig) {
  if (settings.order == ShotOrder::raster) {
    return list;
  }
  const std::vector<std::size_t> order = settings.order == ShotOrder::bit_reversed
                                             ? bit_reversed(list.size())
                                             : greatest_distance(list, rig, settings.where);
  PatternList out;
  out.reserve(list.size());
  for (const std::size_t i : order) {
    out.push_back(std::move(list[i]));
  }
  return out;
}

void require_lights(const PatternList& list, const PlanSettings& settings, const Rig& rig) {
  for (const auto& lit : list) {
    for (const session::LightLevel& light : lit) {
      if (light.light < 0 || light.light >= rig.n_lights()) {
        throw Error(fmt::format("light {} does not exist: rig \"{}\" has lights 0 to {}",
                                light.light, rig.name, rig.n_lights() - 1),
                    settings.where, "name lights of this rig");
      }
    }
  }
}

}  // namespace

PlanSettings parse_plan_file(const std::string& text, const std::string& name) {
  ConfigTable root = ConfigTable::parse_text(text, name);
  PlanSettings settings = read_settings(root);
  settings.where = name;
  return settings;
}

PlanSettings read_plan_file(const std::filesystem::path& path) {
  return parse_plan_file(read_file(path, 16U << 20U), path.string());
}

std::vector<int> choose_wavelets(const Lighting& lighting, int face, int n) {
  const auto n_lights = static_cast<std::size_t>(lighting.weights.rows());
  const auto n2 = static_cast<std::size_t>(face) * static_cast<std::size_t>(face);
  HAARLIGHT_EXPECTS(n2 > 0 && n_lights % n2 == 0, "weights of square faces");
  HAARLIGHT_EXPECTS(
      lighting.norms.size() == 0 || lighting.norms.size() == lighting.weights.rows(),
      "a norm for each coefficient");
  std::vector<double> energy(n_lights, 0.0);  // (|l_i| ||T_i||)^2
  std::vector<double> l(n_lights);
  for (Eigen::Index colour = 0; colour < lighting.weights.cols(); ++colour) {
    for (std::size_t k = 0; k < n_lights; ++k) {
      l[k] = lighting.weights(static_cast<Eigen::Index>(k), colour);
    }
    for (std::size_t first = 0; first < n_lights; first += n2) {
      lights_to_wavelets(face, std::span(l).subspan(first, n2), 1);
    }
    for (std::size_t k = 0; k < n_lights; ++k) {
      energy[k] += l[k] * l[k];
    }
  }
  for (std::size_t k = 0; k < n_lights; ++k) {
    double norm = 0.0;
    if (lighting.norms.size() > 0) {
      norm = lighting.norms[static_cast<Eigen::Index>(k)];
    } else {
      // An edge crosses a square of side s with probability ~ s and then contributes ~ s.
      norm = std::pow(wavelet_at(face, static_cast<int>(k % n2)).size, 1.5);
    }
    energy[k] *= norm * norm;
    if (k % n2 == 0) {
      energy[k] = std::numeric_limits<double>::infinity();
    }
  }
  std::vector<int> order(n_lights);
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) {
    return energy[static_cast<std::size_t>(a)] > energy[static_cast<std::size_t>(b)];
  });
  const std::size_t kept = std::clamp<std::size_t>(static_cast<std::size_t>(std::max(n, 1)),
                                                   n_lights / n2, n_lights);
  order.resize(kept);
  std::sort(order.begin(), order.end());
  return order;
}

Plan expand_plan(const PlanSettings& settings, const Rig& rig, const Lighting* lighting) {
  require_size(settings, rig, size_of_patterns(settings, rig));
  PatternParameters parameters;
  PatternList list = patterns_of(settings, rig, lighting, parameters);
  require_lights(list, settings, rig);
  if ((settings.sentinel_every > 0 || settings.sentinel_every_s > 0.0) &&
      settings.sentinel_light >= rig.n_lights()) {
    throw Error(fmt::format("sentinel_light {} does not exist: rig \"{}\" has lights 0 to {}",
                            settings.sentinel_light, rig.name, rig.n_lights() - 1),
                settings.where, "name a light of this rig");
  }
  list = in_order(std::move(list), settings, rig);
  std::vector<double> exposures = settings.exposures_us;
  if (exposures.empty()) {
    exposures.push_back(rig.cameras.front().exposure_us);
  }
  std::size_t n_lit = 0;
  for (const auto& lit : list) {
    n_lit += lit.size();
  }
  require_size(settings, rig, {static_cast<double>(list.size()), static_cast<double>(n_lit)});
  Plan plan;
  plan.name = settings.name;
  plan.n_lights = rig.n_lights();
  plan.reserve_mb = settings.reserve_mb;
  plan.limits = settings.limits;
  plan.darks_every_c = settings.darks_every_c;
  plan.patterns = std::move(parameters);
  plan.shots = arrange_shots(settings, rig, list, exposures);
  // Reading it back validates settings made in code: a light listed twice, say.
  plan.hash = plan_from_json(plan_to_json(plan), settings.where).hash;
  require_limits(plan, rig, settings.where);
  return plan;
}

DryRun dry_run(const Plan& plan, const Rig& rig) {
  const CameraSpec& camera = rig.cameras.front();
  DryRun out;
  out.n_shots = static_cast<int>(plan.shots.size());
  double energy_j = 0.0;
  double last_exposure_us = plan.shots.empty() ? 0.0 : plan.shots.front().exposure_us;
  double frames = 0.0;
  std::vector<double> on_s(static_cast<std::size_t>(rig.n_lights()));
  const double frame_s = 1.0 / camera.fps;
  std::vector<double> element_watts;
  for (const Face& face : rig.faces) {
    element_watts.insert(element_watts.end(), static_cast<std::size_t>(face.n_lights()),
                         face.element_power.value());
  }
  for (const session::Shot& shot : plan.shots) {
    const double shot_s = shot_seconds(rig, shot.exposure_us, last_exposure_us);
    last_exposure_us = shot.exposure_us;
    frames += shot_s / std::max(frame_s, shot.exposure_us * 1e-6);
    out.seconds += shot_s;
    double watts = 0.0;
    for (const session::LightLevel& light : shot.lit) {
      const auto k = static_cast<std::size_t>(light.light);
      watts += light.level / kFullLevel * element_watts[k];
      on_s[k] += shot_s;
    }
    out.peak_watts = std::max(out.peak_watts, watts);
    energy_j += watts * shot_s;
    out.n_light_shots += shot.kind == session::ShotKind::light ? 1 : 0;
  }
  if (out.seconds > 0.0) {
    out.frames_a_shot = frames / out.n_shots;
    out.mean_watts = energy_j / out.seconds;
    const auto busiest = std::max_element(on_s.begin(), on_s.end());
    out.highest_duty = *busiest / out.seconds;
    out.busiest_light = static_cast<int>(busiest - on_s.begin());
    const double frame_bytes =
        2.0 * camera.frame_width * camera.frame_height + kFrameOverheadBytes;
    out.bytes = static_cast<std::uint64_t>(frame_bytes * out.n_shots);
    out.bytes_a_second = static_cast<double>(out.bytes) / out.seconds;
  }
  if (!plan.shots.empty() &&
      (rig.sync == SyncMode::free_run || rig.sync == SyncMode::camera_leads)) {
    out.dark_seconds = static_cast<double>(kFramesToLearn) *
                       std::max(frame_s, plan.shots.front().exposure_us * 1e-6);
    out.seconds += out.dark_seconds;
  }
  return out;
}

Plan load_plan(const std::filesystem::path& path, const Rig& rig,
               const LightingReader& read_lighting) {
  if (path.extension() == ".json") {
    Plan plan = plan_from_json(read_file(path, 1U << 30U), path.string());
    require_limits(plan, rig, path.string());
    return plan;
  }
  const PlanSettings settings = read_plan_file(path);
  if (settings.environment.empty() || !read_lighting) {
    return expand_plan(settings, rig);
  }
  const Lighting lighting = read_lighting(path.parent_path() / settings.environment, rig);
  return expand_plan(settings, rig, &lighting);
}

}  // namespace haarlight::capture
