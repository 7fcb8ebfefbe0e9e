// SPDX-License-Identifier: Apache-2.0
#include "sim/truth.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include <fmt/format.h>

#include "core/config_table.h"
#include "haarlight/core/files.h"

namespace haarlight::sim {

namespace {

constexpr Range kTime{.min = 0.0, .max = 1e7};

std::optional<double> time_or_none(ConfigTable& t, std::string_view key) {
  return t.has(key) ? std::optional(t.number(key, kTime)) : std::nullopt;
}

/// A number that must be a light of the rig; -1 and a problem when it is not.
int as_light(ConfigTable& t, std::string_view key, double x, int n_lights) {
  if (!(x >= 0.0 && x < n_lights) || x != std::floor(x)) {
    t.problem(key, fmt::format("{} is not a light of the rig", x),
              fmt::format("lights are 0 to {}", n_lights - 1));
    return -1;
  }
  return static_cast<int>(x);
}

/// Rows of two numbers, one after the other; nothing when the key is missing.
std::vector<double> pairs_or_none(ConfigTable& t, std::string_view key) {
  return t.has(key) ? t.matrix(key, 0, 2) : std::vector<double>{};
}

CameraTruth read_camera(ConfigTable& t, const Rig& rig) {
  CameraTruth c;
  c.id = t.text("id");
  if (std::none_of(rig.cameras.begin(), rig.cameras.end(),
                   [&](const CameraSpec& spec) { return spec.id == c.id; })) {
    t.problem("id", "the rig has no camera \"" + c.id + "\"", "name one of the rig file's");
  }
  if (t.has("timestamp")) {
    c.timestamp = static_cast<TimestampMeaning>(t.choice(
        "timestamp",
        {to_string(TimestampMeaning::start_exposure),
         to_string(TimestampMeaning::start_readout), to_string(TimestampMeaning::end_frame)}));
  }
  if (t.has("shutter")) {
    c.shutter = static_cast<Shutter>(
        t.choice("shutter", {to_string(Shutter::rolling), to_string(Shutter::global)}));
  }
  c.skew_us = time_or_none(t, "skew_us");
  c.read_us = time_or_none(t, "read_us");
  if (t.has("exposure_delay_frames")) {
    c.exposure_delay_frames =
        static_cast<int>(t.integer("exposure_delay_frames", {.min = 0, .max = 100}));
  }
  if (auto noise = t.table("noise")) {
    SensorNoise n;
    n.gain_e_per_dn = noise->number("gain", {.min = 1e-9, .max = 1e9});
    n.read_e = noise->number("read", {.min = 0.0, .max = 1e9});
    n.full_well_e = noise->number("full_well", {.min = 1.0, .max = 1e12});
    n.black_dn = noise->number("black", {.min = 0.0, .max = 65535.0});
    c.noise = n;
  }
  c.flaws.dark_e_per_s = t.number_or("dark_e_per_s", 0.0, {.min = 0.0, .max = 1e9});
  c.flaws.hot_fraction = t.number_or("hot_share", 0.0, {.min = 0.0, .max = 1.0});
  c.flaws.hot_e_per_s = t.number_or("hot_e_per_s", 0.0, {.min = 0.0, .max = 1e12});
  c.flaws.prnu = t.number_or("prnu", 0.0, {.min = 0.0, .max = 0.3});
  c.flaws.vignetting = t.number_or("vignetting", 0.0, {.min = 0.0, .max = 0.95});
  return c;
}

}  // namespace

SimTruth parse_truth(const std::string& text, const std::string& name, const Rig& rig) {
  ConfigTable root = ConfigTable::parse_text(text, name);
  SimTruth truth;
  if (auto controller = root.table("controller")) {
    truth.latch_us = time_or_none(*controller, "latch_us");
    truth.rise_us = time_or_none(*controller, "rise_us");
    truth.fall_us = time_or_none(*controller, "fall_us");
    truth.latch_spread_us = controller->number_or("latch_spread_us", 0.0, kTime);
    truth.ramp_spread_us = controller->number_or("ramp_spread_us", 0.0, kTime);
  }
  for (ConfigTable& table : root.tables("camera")) {
    truth.cameras.push_back(read_camera(table, rig));
  }
  if (auto lights = root.table("lights")) {
    const int n = rig.n_lights();
    for (const double k : lights->numbers_or("dead", {})) {
      truth.dead.push_back(as_light(*lights, "dead", k, n));
    }
    truth.warm_up = lights->number_or("warm_up", 0.0, {.min = -0.9, .max = 10.0});
    truth.warm_up_s = lights->number_or("warm_up_s", 60.0, {.min = 1e-3, .max = 1e6});
    const std::vector<double> dim = pairs_or_none(*lights, "dim");
    for (std::size_t i = 0; i + 1 < dim.size(); i += 2) {
      if (!(dim[i + 1] > 0.0 && dim[i + 1] <= 100.0)) {
        lights->problem("dim", fmt::format("a relative power of {}", dim[i + 1]),
                        "give one above 0, or name the light in dead");
      }
      truth.dim.emplace_back(as_light(*lights, "dim", dim[i], n), dim[i + 1]);
    }
    const std::vector<double> swapped = pairs_or_none(*lights, "swapped");
    for (std::size_t i = 0; i + 1 < swapped.size(); i += 2) {
      truth.swapped.emplace_back(as_light(*lights, "swapped", swapped[i], n),
                                 as_light(*lights, "swapped", swapped[i + 1], n));
    }
  }
  root.finish();
  return truth;
}

SimTruth read_truth(const std::filesystem::path& path, const Rig& rig) {
  return parse_truth(read_file(path, 1U << 20U), path.string(), rig);
}

Rig apply_truth(const SimTruth& truth, Rig rig) {
  rig.controller.latch_us = truth.latch_us.value_or(rig.controller.latch_us);
  rig.controller.rise_us = truth.rise_us.value_or(rig.controller.rise_us);
  rig.controller.fall_us = truth.fall_us.value_or(rig.controller.fall_us);
  for (const CameraTruth& t : truth.cameras) {
    for (CameraSpec& c : rig.cameras) {
      if (c.id == t.id) {
        c.timestamp = t.timestamp.value_or(c.timestamp);
        c.shutter = t.shutter.value_or(c.shutter);
        c.skew_us = t.skew_us.value_or(c.skew_us);
        c.read_us = t.read_us.value_or(c.read_us);
        c.exposure_delay_frames = t.exposure_delay_frames.value_or(c.exposure_delay_frames);
        c.noise = t.noise.value_or(c.noise);
      }
    }
  }
  return rig;
}

RigFlaws true_flaws(const SimTruth& truth, const std::string& camera_id) {
  RigFlaws flaws;
  for (const CameraTruth& camera : truth.cameras) {
    if (camera.id == camera_id) {
      flaws = camera.flaws;
    }
  }
  flaws.latch_spread_us = truth.latch_spread_us;
  flaws.ramp_spread_us = truth.ramp_spread_us;
  flaws.warm_up = truth.warm_up;
  flaws.warm_up_s = truth.warm_up_s;
  return flaws;
}

std::vector<double> true_light_power(const SimTruth& truth, int n_lights) {
  if (truth.dead.empty() && truth.dim.empty()) {
    return {};
  }
  std::vector<double> power(static_cast<std::size_t>(n_lights), 1.0);
  for (const auto& [k, relative] : truth.dim) {
    power.at(static_cast<std::size_t>(k)) = relative;
  }
  for (const int k : truth.dead) {
    power.at(static_cast<std::size_t>(k)) = 0.0;
  }
  return power;
}

std::vector<int> true_wiring(const SimTruth& truth, int n_lights) {
  if (truth.swapped.empty()) {
    return {};
  }
  std::vector<int> wiring(static_cast<std::size_t>(n_lights));
  std::iota(wiring.begin(), wiring.end(), 0);
  for (const auto& [a, b] : truth.swapped) {
    std::swap(wiring.at(static_cast<std::size_t>(a)), wiring.at(static_cast<std::size_t>(b)));
  }
  return wiring;
}

}  // namespace haarlight::sim
