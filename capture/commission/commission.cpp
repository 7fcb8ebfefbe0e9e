// SPDX-License-Identifier: Apache-2.0
#include "capture/commission/commission.h"

#include <cmath>

#include <fmt/format.h>

#include "core/report.h"
#include "haarlight/core/error.h"

namespace haarlight::capture {

namespace {

/// A skew below this, or below 8 sigma, counts as none: 1 % of a slow readout.
constexpr double kNoSkewUs = 100.0;

std::int64_t steps_of(const TimingResult& timing) { return timing.fit.n_steps; }

MeasuredController controller_values(const Rig& rig,
                                     const firmware_iface::ControllerIdentity& identity,
                                     const TimingResult& timing) {
  MeasuredController m;
  m.with = describe_controller(rig.controller);
  m.identity = fmt::format("{}, serial {}", identity.model, identity.serial);
  m.latch_us = timing.verdict.latch_us;
  m.latch_us->n = steps_of(timing);
  m.latch_most_us = timing.latch_most_us;
  m.rise_us = Measured{timing.fit.model.rise_us, timing.fit.rise_sigma_us, steps_of(timing)};
  m.fall_us = Measured{timing.fit.model.fall_us, timing.fit.fall_sigma_us, steps_of(timing)};
  m.ack_us = timing.ack_us;
  return m;
}

MeasuredCamera camera_values(const CameraSpec& spec, const CameraSetup& setup,
                             const TimingResult& timing,
                             const std::optional<NoiseResult>& noise) {
  MeasuredCamera m;
  m.id = spec.id;
  m.with = describe_camera(spec);
  m.identity = setup.identity;
  m.timestamp = timing.verdict.meaning;
  m.evidence = timing.verdict.evidence;
  m.read_us = timing.verdict.read_us;
  if (spec.shutter == Shutter::rolling) {
    m.skew_us = Measured{std::max(0.0, timing.fit.model.skew_us), timing.fit.skew_sigma_us,
                         steps_of(timing)};
  }
  m.ready_us = timing.verdict.ready_us;
  m.exposure_delay_frames = timing.verdict.exposure_delay_frames;
  if (noise) {
    m.gain_e_per_dn = noise->sensor.gain_e_per_dn;
    m.read_e = noise->sensor.read_e;
    m.full_well_e = noise->sensor.full_well_e;
    m.black_dn = noise->sensor.black_dn;
    m.linearity_percent = noise->sensor.linearity_percent;
  }
  return m;
}

MeasuredLights light_values(const Rig& rig, const LightSurvey& survey) {
  MeasuredLights m;
  m.with = describe_lights(rig);
  m.dead = survey.dead;
  m.unseen = survey.unseen;
  m.miswired = survey.miswired;
  m.miswired_to = survey.miswired_to;
  m.power = survey.power;
  m.power_sigma = survey.power_sigma;
  m.n = 1;
  return m;
}

/// Numbers in ascending order: "3, 8 to 15".
std::string in_runs(const std::vector<int>& numbers) {
  std::string text;
  for (std::size_t i = 0; i < numbers.size();) {
    std::size_t j = i;
    while (j + 1 < numbers.size() && numbers[j + 1] == numbers[j] + 1) {
      ++j;
    }
    text += fmt::format("{}{}", text.empty() ? "" : ", ", numbers[i]);
    if (j > i) {
      text += fmt::format("{}{}", j == i + 1 ? ", " : " to ", numbers[j]);
    }
    i = j + 1;
  }
  return text;
}

/// Lights whose cables could be swapped unnoticed.
void add_open_wiring(const LightSurvey& survey, int n_lights, std::vector<std::string>& notes) {
  if (!survey.alike.empty()) {
    notes.push_back(fmt::format(
        "the pictures of {} of {} lights do not differ enough from their neighbours' to tell "
        "two that are swapped: whether the cables of lights {} are right stays open",
        survey.alike.size(), n_lights, in_runs(survey.alike)));
  }
  if (!survey.unplaced.empty()) {
    notes.push_back(fmt::format(
        "the pictures of {} of {} lights fit neither their own position nor another one's: "
        "whether the cables of lights {} are right stays open. Take out of view what stands on "
        "the plane and commission again",
        survey.unplaced.size(), n_lights, in_runs(survey.unplaced)));
  }
}

void find_contradictions(const CameraSpec& spec, CommissionResult& result) {
  const StepFit& fit = result.timing.fit;
  const double skew = fit.model.skew_us;
  const bool rolls = std::abs(skew) > std::max(kNoSkewUs, 8.0 * fit.skew_sigma_us);
  if (rolls && spec.shutter == Shutter::global) {
    result.contradictions.push_back(fmt::format(
        "camera {}: the rig file says shutter = \"global\", but rows begin one after another "
        "over {:.0f} us: write shutter = \"rolling\"",
        spec.id, skew));
  }
  if (skew < 0.0 && rolls) {
    result.contradictions.push_back(fmt::format(
        "camera {}: rows are read from the bottom ({:.0f} us): turn the picture, or its "
        "readout direction",
        spec.id, -skew));
  }
  if (!rolls && spec.shutter == Shutter::rolling) {
    result.notes.push_back(fmt::format(
        "camera {}: no skew between rows was found ({:.0f} us): its shutter looks global",
        spec.id, skew));
  }
}

}  // namespace

CommissionResult commission(const Rig& rig, Camera& camera, firmware_iface::LightArray& lights,
                            const CommissionOptions& options, CommissionClock clock) {
  CommissionBench bench(rig, options.camera, camera, lights, std::move(clock),
                        options.should_stop);
  const CameraSpec& spec = rig.cameras.at(static_cast<std::size_t>(options.camera));
  bench.open(spec.exposure_us);
  CommissionResult result;
  result.timing = measure_timing(bench, options);
  find_contradictions(spec, result);
  if (!result.timing.verdict.is_divided) {
    result.notes.emplace_back(
        "only latch + read_us is measured; their division is the rig file's. Captures need "
        "only the sum");
  }
  if (options.measures_noise) {
    result.noise = measure_noise(bench, result.timing, options);
    const SensorMeasurement& s = result.noise->sensor;
    if (!s.full_well_e) {
      result.notes.emplace_back(
          "the light is too weak to saturate the camera: full well not measured");
    } else if (s.is_converter_limited) {
      result.notes.emplace_back(
          "white comes before the sensor is full: full_well is what white stands for");
    }
    if (s.is_read_from_curve) {
      result.notes.emplace_back(
          "dark pixels clip at 0: raise the camera's black level; read noise is from the "
          "transfer curve");
    }
  }
  if (options.measures_lights) {
    const double gain =
        result.noise ? result.noise->sensor.gain_e_per_dn.value : spec.noise.gain_e_per_dn;
    result.survey = measure_lights(bench, result.timing, gain, options);
    const LightSurvey& survey = *result.survey;
    add_open_wiring(survey, rig.n_lights(), result.notes);
    for (std::size_t i = 0; i < survey.miswired.size(); ++i) {
      result.faults.push_back(
          fmt::format("light {} shines from the position of light {}: two cables are swapped",
                      survey.miswired[i], survey.miswired_to[i]));
    }
    for (const int k : survey.dead) {
      result.faults.push_back(fmt::format("light {} is dead", k));
    }
    for (const int k : survey.dim) {
      result.faults.push_back(fmt::format("light {} gives {:.0f} % of what it should", k,
                                          100.0 * survey.power[static_cast<std::size_t>(k)]));
    }
  }
  MeasuredRig& m = result.measured;
  m.date = options.date;
  m.tool = fmt::format("haarlight {}", kVersion);
  m.rig_hash = options.written_hash;
  m.controller = controller_values(rig, bench.controller(), result.timing);
  if (result.survey) {
    m.lights = light_values(rig, *result.survey);
  }
  m.cameras.push_back(camera_values(spec, bench.setup(), result.timing, result.noise));
  return result;
}

}  // namespace haarlight::capture
