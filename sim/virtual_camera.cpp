// SPDX-License-Identifier: Apache-2.0
#include "sim/virtual_camera.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <utility>

#include <fmt/format.h>

#include "core/random.h"
#include "haarlight/core/error.h"

namespace haarlight::sim {

namespace {

constexpr std::size_t kNormalTable = 65536;  // one index = 16 bits of a hash
constexpr float kPoissonLimit = 30.0F;       // electrons; below this counts by inversion

std::int64_t ns_from_us(double us) { return std::llround(us * 1e3); }

/// The middle of each of n equal parts of the standard normal: Newton's method on its
/// distribution function.
std::vector<float> normal_quantiles(std::size_t n) {
  std::vector<float> quantiles(n);
  double x = -4.5;
  for (std::size_t i = 0; i < n / 2; ++i) {
    const double p = (static_cast<double>(i) + 0.5) / static_cast<double>(n);
    for (int step = 0; step < 60; ++step) {
      const double distribution = 0.5 * std::erfc(-x * std::numbers::sqrt2 / 2.0);
      const double density =
          std::exp(-0.5 * x * x) * std::numbers::inv_sqrtpi / std::numbers::sqrt2;
      const double change = std::clamp((distribution - p) / density, -0.5, 0.5);
      x -= change;
      if (std::abs(change) < 1e-12) {
        break;
      }
    }
    quantiles[i] = static_cast<float>(x);
    quantiles[n - 1 - i] = static_cast<float>(-x);
  }
  return quantiles;
}

/// A level that changes at `t_ns` (delay included) to `level`, over a ramp.
struct Step {
  double t_ns = 0.0;
  double level = 0.0;
  double rise_ns = 0.0;
  double fall_ns = 0.0;
};

/// Mean over [begin, end] of a level that starts at `initial` and follows the steps linearly,
/// each over its own ramp; a step in the middle of a ramp starts where it is.
double mean_level(double initial, const std::vector<Step>& steps, double begin_ns,
                  double end_ns) {
  double integral = 0.0;
  double level = initial;
  double at = -1e300;
  // Adds the part of [t0, t1] in the window, where the level is linear from l0 to l1.
  const auto add = [&](double t0, double t1, double l0, double l1) {
    const double a = std::max(t0, begin_ns);
    const double b = std::min(t1, end_ns);
    if (b <= a) {
      return;
    }
    const double slope = t1 > t0 ? (l1 - l0) / (t1 - t0) : 0.0;
    const double middle = l0 + slope * (0.5 * (a + b) - t0);
    integral += (b - a) * middle;
  };
  for (std::size_t i = 0; i < steps.size(); ++i) {
    const Step& step = steps[i];
    add(at, step.t_ns, level, level);
    const double next = i + 1 < steps.size() ? steps[i + 1].t_ns : 1e300;
    const double ramp = step.level > level   ? step.rise_ns
                        : step.level < level ? step.fall_ns
                                             : 0.0;
    const double ramp_end = std::min(step.t_ns + ramp, next);
    if (ramp > 0.0) {
      const double current = level + (step.level - level) * (ramp_end - step.t_ns) / ramp;
      add(step.t_ns, ramp_end, level, current);
      level = current;
    } else {
      level = step.level;
    }
    at = ramp_end;
  }
  add(at, 1e300, level, level);
  return integral / (end_ns - begin_ns);
}

}  // namespace

VirtualCamera::VirtualCamera(const CameraSpec& spec, ControllerSpec controller,
                             const Transport& transport, VirtualCameraOptions options)
    : spec_(spec),
      controller_(std::move(controller)),
      transport_(&transport),
      options_(std::move(options)) {
  if (transport.width() != spec.frame_width || transport.height() != spec.active_rows) {
    throw Error(fmt::format("transport of {} x {} for a camera of {} x {}", transport.width(),
                            transport.height(), spec.frame_width, spec.active_rows),
                "virtual camera", "make the transport from this rig file");
  }
  if (!(spec.noise.full_well_e > 0.0) || !(spec.noise.gain_e_per_dn > 0.0) ||
      !(spec.exposure_us > 0.0)) {
    throw Error("a virtual camera needs a full well, a gain and an exposure", "virtual camera",
                "set noise = { gain, read, full_well, black } and exposure_us in the rig file");
  }
  const int n_metadata_rows = spec.frame_height - spec.active_rows;
  if (n_metadata_rows > 0 && capture::tag_block_side(spec.frame_width, n_metadata_rows) == 0) {
    throw Error(fmt::format("{} rows of {} pixels cannot hold the tag", n_metadata_rows,
                            spec.frame_width),
                "virtual camera", "give 8 rows below active_area, or none");
  }
  const auto n_lights = static_cast<std::size_t>(transport.n_lights());
  HAARLIGHT_EXPECTS(options_.light_power.empty() || options_.light_power.size() == n_lights,
                    "a power for each light");
  HAARLIGHT_EXPECTS(options_.wiring.empty() || options_.wiring.size() == n_lights,
                    "a wire for each light");
  if (options_.lit_electrons == 0.0) {
    options_.lit_electrons = 0.5 * spec.noise.full_well_e;
  }
  mean_.resize(static_cast<std::size_t>(spec.frame_width) *
               static_cast<std::size_t>(spec.active_rows));
  normal_ = normal_quantiles(kNormalTable);
  make_flaws();
}

double VirtualCamera::electrons_per_unit(double exposure_us) const {
  return options_.lit_electrons * exposure_us / spec_.exposure_us;
}

std::int64_t VirtualCamera::history_begin_ns(const Exposure& exposure) const {
  const RigFlaws& flaws = options_.flaws;
  const double ramp = std::max(controller_.rise_us, controller_.fall_us) + flaws.ramp_spread_us;
  const double latch = controller_.latch_us + flaws.latch_spread_us;
  return exposure.start_ns - ns_from_us(latch + ramp) - 1;
}

VirtualCamera::Delay VirtualCamera::delay_of(
    const firmware_iface::LightTransition& state) const {
  const RigFlaws& flaws = options_.flaws;
  const auto key = static_cast<std::uint64_t>(state.t_ns);
  const auto drawn = [&](double spread_us, std::uint64_t stream) {
    return spread_us > 0.0 ? spread_us * uniform_unit(hash_key(options_.seed, stream, key))
                           : 0.0;
  };
  const double ramp = drawn(flaws.ramp_spread_us, 24);
  return {1e3 * (controller_.latch_us + drawn(flaws.latch_spread_us, 23)),
          1e3 * (controller_.rise_us + ramp), 1e3 * (controller_.fall_us + ramp)};
}

std::int64_t VirtualCamera::end_ns(const Exposure& exposure) const {
  const double skew = spec_.shutter == Shutter::rolling ? spec_.skew_us : 0.0;
  return exposure.start_ns + ns_from_us(exposure.exposure_us + skew);
}

std::int64_t VirtualCamera::read_out_ns(const Exposure& exposure) const {
  return std::max(end_ns(exposure),
                  exposure.start_ns + ns_from_us(exposure.exposure_us + spec_.read_us));
}

std::int64_t VirtualCamera::timestamp_ns(const Exposure& exposure) const {
  switch (spec_.timestamp) {
    case TimestampMeaning::start_exposure:
      return exposure.start_ns;
    case TimestampMeaning::start_readout:
      return exposure.start_ns + ns_from_us(exposure.exposure_us);
    case TimestampMeaning::end_frame:
      return exposure.start_ns + ns_from_us(exposure.exposure_us + spec_.read_us);
  }
  return exposure.start_ns;
}

LightSeen VirtualCamera::look(const firmware_iface::LightHistory& history,
                              const Exposure& exposure) const {
  LightSeen seen;
  HAARLIGHT_EXPECTS(!history.states.empty(), "a history with the state at its start");
  const std::int64_t end = end_ns(exposure);
  for (const firmware_iface::LightTransition& state : history.states) {
    const Delay delay = delay_of(state);
    const std::int64_t changes = state.t_ns + std::llround(delay.latch);
    const std::int64_t ramp = std::llround(std::max(delay.rise, delay.fall));
    if (changes >= end) {
      break;
    }
    seen.tag.tag = state.tag;
    seen.tag.is_mixed = seen.tag.is_mixed || changes + ramp > exposure.start_ns;
    seen.last_change_ns = changes + ramp;
  }
  // A history that does not reach back far enough cannot prove a frame clean.
  seen.tag.is_mixed = seen.tag.is_mixed || !history.is_complete;
  return seen;
}

std::vector<VirtualCamera::Element> VirtualCamera::mean_drive_levels(
    const firmware_iface::LightHistory& history, const Exposure& exposure) const {
  // Every element that is lit at any time, with its level in each state.
  const std::size_t n_states = history.states.size();
  std::map<int, std::vector<double>> levels;
  for (std::size_t i = 0; i < n_states; ++i) {
    for (const firmware_iface::ElementLevel& lit : *history.states[i].pattern) {
      if (lit.element < transport_->n_lights()) {
        const auto k = static_cast<std::size_t>(lit.element);
        const int led = options_.wiring.empty() ? lit.element : options_.wiring[k];
        const auto position = static_cast<std::size_t>(led);
        std::vector<double>& of_element = levels[led];
        of_element.resize(n_states, 0.0);
        of_element[i] = lit.level / 65535.0 *
                        (options_.light_power.empty() ? 1.0 : options_.light_power[position]);
      }
    }
  }
  const auto offset = [&](std::int64_t t_ns) {
    return static_cast<double>(t_ns - exposure.start_ns);
  };
  const bool is_rolling = spec_.shutter == Shutter::rolling && spec_.skew_us > 0.0;
  const int n_rows = is_rolling && n_states > 1 ? spec_.active_rows : 1;
  const double row_step_ns =
      spec_.active_rows > 1 && is_rolling ? spec_.skew_us * 1e3 / (spec_.active_rows - 1) : 0.0;
  std::vector<Element> elements;
  for (const auto& [index, of_element] : levels) {
    std::vector<Step> steps;
    for (std::size_t i = 1; i < n_states; ++i) {
      const Delay delay = delay_of(history.states[i]);
      steps.push_back({offset(history.states[i].t_ns) + delay.latch, of_element[i], delay.rise,
                       delay.fall});
    }
    Element element;
    element.index = index;
    bool is_lit = false;
    for (int row = 0; row < n_rows; ++row) {
      const double begin = row * row_step_ns;
      const double mean =
          mean_level(of_element[0], steps, begin, begin + exposure.exposure_us * 1e3);
      element.drive.push_back(static_cast<float>(mean));
      is_lit = is_lit || mean > 0.0;
    }
    if (is_lit) {
      elements.push_back(std::move(element));
    }
  }
  return elements;
}

void VirtualCamera::sum_light(const std::vector<Element>& elements, double electrons) {
  std::fill(mean_.begin(), mean_.end(), 0.0F);
  const auto width = static_cast<std::size_t>(spec_.frame_width);
  const double unit = electrons / transport_->scale();
  for (const Element& element : elements) {
    const ImageView<const float> plane = transport_->plane(element.index);
    for (int y = 0; y < spec_.active_rows; ++y) {
      const auto drive = static_cast<double>(
          element.drive[element.drive.size() == 1 ? 0 : static_cast<std::size_t>(y)]);
      if (drive == 0.0) {
        continue;
      }
      const auto factor = static_cast<float>(unit * drive);
      const float* light = plane.row(y).data();
      float* sum = mean_.data() + static_cast<std::size_t>(y) * width;
      for (std::size_t x = 0; x < width; ++x) {
        sum[x] += factor * light[x];
      }
    }
  }
}

void VirtualCamera::make_flaws() {
  const RigFlaws& flaws = options_.flaws;
  if (flaws == RigFlaws{}) {
    return;
  }
  sensitivity_.resize(mean_.size());
  dark_.resize(mean_.size());
  const double centre_x = 0.5 * spec_.frame_width;
  const double centre_y = 0.5 * spec_.active_rows;
  const double corner2 = centre_x * centre_x + centre_y * centre_y;
  std::size_t i = 0;
  for (int y = 0; y < spec_.active_rows; ++y) {
    for (int x = 0; x < spec_.frame_width; ++x, ++i) {
      const double dx = x + 0.5 - centre_x;
      const double dy = y + 0.5 - centre_y;
      const double lens = 1.0 - flaws.vignetting * (dx * dx + dy * dy) / corner2;
      const double pixel = 1.0 + flaws.prnu * standard_normal(hash_key(options_.seed, 21, i));
      const bool is_hot = uniform_unit(hash_key(options_.seed, 22, i)) < flaws.hot_fraction;
      sensitivity_[i] = static_cast<float>(std::max(0.0, lens * pixel));
      dark_[i] = static_cast<float>(is_hot ? flaws.hot_e_per_s : flaws.dark_e_per_s);
    }
  }
}

void VirtualCamera::read_out(const Exposure& exposure, std::uint64_t noise_key,
                             ImageView<std::uint16_t> words) const {
  const double gain_db = exposure.gain_db;
  const RigFlaws& flaws = options_.flaws;
  const double warm_s = static_cast<double>(exposure.start_ns - first_ns_) * 1e-9;
  const auto brightness =
      static_cast<float>(1.0 + flaws.warm_up * std::exp(-warm_s / flaws.warm_up_s));
  const auto seconds = static_cast<float>(exposure.exposure_us * 1e-6);
  const SensorNoise& noise = spec_.noise;
  const auto amplification = static_cast<float>(
      std::pow(10.0, (gain_db - spec_.gain_db) / 20.0) / noise.gain_e_per_dn);
  const auto black = static_cast<float>(noise.black_dn) + 0.5F;  // rounding included
  const auto full_well = static_cast<float>(noise.full_well_e);
  const auto read = static_cast<float>(noise.read_e);
  const float read2 = read * read;
  const auto white = static_cast<float>((1U << static_cast<unsigned>(spec_.bits)) - 1U);
  const auto width = static_cast<std::size_t>(spec_.frame_width);
  for (int y = 0; y < spec_.active_rows; ++y) {
    const float* mean = mean_.data() + static_cast<std::size_t>(y) * width;
    std::uint16_t* out = words.row(y).data();
    std::uint64_t hash = 0;
    for (std::size_t x = 0; x < width; ++x) {
      float electrons = mean[x];
      if (!dark_.empty()) {
        const std::size_t i = static_cast<std::size_t>(y) * width + x;
        electrons = electrons * brightness * sensitivity_[i] + dark_[i] * seconds;
      }
      if (options_.has_noise) {
        if (x % 4 == 0) {
          hash = hash_key(noise_key, static_cast<std::uint64_t>(y) * width + x);
        }
        const float z = normal_[(hash >> (16U * (x % 4))) & 0xffffU];
        if (electrons >= kPoissonLimit || electrons == 0.0F) {
          electrons += std::sqrt(electrons + read2) * z;
        } else {
          electrons = static_cast<float>(poisson(
                          electrons, hash_key(noise_key, ~x, static_cast<unsigned>(y) + 1U))) +
                      read * z;
        }
      }
      const float word = black + std::min(electrons, full_well) * amplification;
      out[x] = static_cast<std::uint16_t>(std::clamp(word, 0.0F, white));
    }
  }
}

void VirtualCamera::take(const firmware_iface::LightHistory& history, const Exposure& exposure,
                         const LightSeen& seen, std::uint64_t noise_key,
                         ImageView<std::uint16_t> words) {
  HAARLIGHT_EXPECTS(words.height() == spec_.frame_height && words.width() == spec_.frame_width,
                    "a frame of the camera's size");
  const auto& pattern = history.states.front().pattern;
  const bool is_steady = history.states.size() == 1;
  if (!is_steady || pattern != steady_ || exposure.exposure_us != steady_exposure_us_) {
    sum_light(mean_drive_levels(history, exposure), electrons_per_unit(exposure.exposure_us));
    steady_ = is_steady ? pattern : nullptr;
    steady_exposure_us_ = exposure.exposure_us;
  }
  first_ns_ = first_ns_ < 0 ? exposure.start_ns : first_ns_;
  read_out(exposure, hash_key(options_.seed, noise_key), words);
  write_tag(seen, words);
}

void VirtualCamera::write_tag(const LightSeen& seen, ImageView<std::uint16_t> words) const {
  const int n_metadata_rows = spec_.frame_height - spec_.active_rows;
  if (n_metadata_rows > 0) {
    const auto white = static_cast<double>((1U << static_cast<unsigned>(spec_.bits)) - 1U);
    const auto low =
        static_cast<std::uint16_t>(std::clamp(spec_.noise.black_dn, 0.0, 0.25 * white));
    capture::encode_metadata_rows({words.row(spec_.active_rows).data(), n_metadata_rows,
                                   spec_.frame_width, 1, words.row_stride()},
                                  seen.tag, low, static_cast<std::uint16_t>(0.75 * white));
  }
}

}  // namespace haarlight::sim
