// SPDX-License-Identifier: Apache-2.0
#include "capture/camera/v4l2_controls.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include <fmt/format.h>

#include "core/config_table.h"

namespace haarlight::capture {

namespace {

/// Old and new Linux names of a control, so that a rig file outlives a kernel version.
struct Alias {
  std::string_view name;
  std::uint32_t id;
};
constexpr std::array kAliases{
    Alias{"exposure_auto", control_id::kExposureAuto},
    Alias{"auto_exposure", control_id::kExposureAuto},
    Alias{"exposure_absolute", control_id::kExposureAbsolute},
    Alias{"exposure_time_absolute", control_id::kExposureAbsolute},
    Alias{"exposure_auto_priority", control_id::kExposurePriority},
    Alias{"exposure_dynamic_framerate", control_id::kExposurePriority},
    Alias{"white_balance_temperature_auto", control_id::kAutoWhiteBalance},
    Alias{"white_balance_automatic", control_id::kAutoWhiteBalance},
    Alias{"gain_automatic", control_id::kAutoGain},
    Alias{"autogain", control_id::kAutoGain},
    Alias{"focus_auto", control_id::kFocusAuto},
    Alias{"focus_automatic_continuous", control_id::kFocusAuto},
    Alias{"analog_gain", control_id::kAnalogueGain},
};

/// Modes in the order of setting, with the value that means manual.
struct Mode {
  std::uint32_t id;
  std::int64_t manual;
};
constexpr std::int64_t kExposureManual = 1;  // V4L2_EXPOSURE_MANUAL
constexpr std::array kModes{
    Mode{control_id::kExposureAuto, kExposureManual},
    Mode{control_id::kExposurePriority, 0},
    Mode{control_id::kAutoWhiteBalance, 0},
    Mode{control_id::kAutoGain, 0},
    Mode{control_id::kFocusAuto, 0},
    Mode{control_id::kPowerLineFrequency, 0},
};

constexpr std::int64_t kFired = 1;             // a button accepts any value
constexpr double kExposureAbsoluteUs = 100.0;  // V4L2's unit of exposure_time_absolute

bool is_entry(const V4l2Control& control, std::int64_t value) {
  return std::any_of(control.entries.begin(), control.entries.end(),
                     [value](const V4l2MenuEntry& entry) { return entry.value == value; });
}

bool is_in_range(const V4l2Control& control, std::int64_t value) {
  return control.kind != V4l2ControlKind::button && value >= control.min &&
         value <= control.max &&
         (control.kind != V4l2ControlKind::menu || is_entry(control, value));
}

std::string range_text(const V4l2Control& control) {
  if (control.kind == V4l2ControlKind::button) {
    return "nothing: a button, for trigger.fire";
  }
  if (control.kind != V4l2ControlKind::menu) {
    return fmt::format("{} to {}{}", control.min, control.max,
                       control.step > 1 ? fmt::format(" in steps of {}", control.step) : "");
  }
  std::string text;
  for (const V4l2MenuEntry& entry : control.entries) {
    text += fmt::format("{}{} \"{}\"", text.empty() ? "" : ", ", entry.value, entry.name);
  }
  return text;
}

}  // namespace

/// Builds the list of one camera.
class V4l2Controls::Chooser {
 public:
  Chooser(const std::vector<V4l2Control>& offered, const CameraSpec& spec,
          TriggerSource trigger)
      : offered_(offered), spec_(spec), trigger_(trigger) {}

  Result<V4l2Controls> run() {
    chosen_.fixed_exposure_us_ = spec_.exposure_us;
    chosen_.noted_gain_db_ = spec_.gain_db;
    // In two passes, so that "modes first" holds for the rig file's own modes too.
    if (auto done = read_settings(spec_.v4l2.controls); !done) {
      return tl::unexpected<Fault>(done.error());
    }
    if (auto done = read_trigger(); !done) {
      return tl::unexpected<Fault>(done.error());
    }
    for (const Mode& mode : kModes) {
      if (auto done = add_mode(mode); !done) {
        return tl::unexpected<Fault>(done.error());
      }
    }
    if (auto done = add_exposure(); !done) {
      return tl::unexpected<Fault>(done.error());
    }
    if (auto done = add_gain(); !done) {
      return tl::unexpected<Fault>(done.error());
    }
    for (const SetControl& set : requested_) {
      if (!has(set.control.id)) {
        chosen_.controls_.push_back(set);
      }
    }
    return std::move(chosen_);
  }

 private:
  [[nodiscard]] const V4l2Control* by_id(std::uint32_t id) const {
    const auto found = std::find_if(offered_.begin(), offered_.end(),
                                    [id](const V4l2Control& c) { return c.id == id; });
    return found == offered_.end() ? nullptr : &*found;
  }

  [[nodiscard]] const V4l2Control* by_name(const std::string& name) const {
    const std::string key = control_key(name);
    const auto found = std::find_if(offered_.begin(), offered_.end(),
                                    [&](const V4l2Control& c) { return c.name == key; });
    if (found != offered_.end()) {
      return &*found;
    }
    const auto* const alias = std::find_if(kAliases.begin(), kAliases.end(),
                                           [&](const Alias& a) { return a.name == key; });
    return alias == kAliases.end() ? nullptr : by_id(alias->id);
  }

  [[nodiscard]] auto unknown(const std::string& name) const {
    std::vector<std::string> names;
    std::string list;
    for (const V4l2Control& control : offered_) {
      names.push_back(control.name);
      list += (list.empty() ? "" : ", ") + control.name;
    }
    const std::string near = nearest_word(control_key(name), names);
    return fail(Errc::unsupported,
                fmt::format("camera \"{}\" has no control \"{}\"{}; it has {}", spec_.id, name,
                            near.empty() ? "" : fmt::format(" (did you mean {}?)", near),
                            list.empty() ? "none" : list));
  }

  [[nodiscard]] Result<void> require_settable(const V4l2Control& control,
                                              std::int64_t value) const {
    if (!control.is_settable) {
      return fail(Errc::unsupported, fmt::format("camera \"{}\": control {} cannot be set",
                                                 spec_.id, control.name));
    }
    if (!is_in_range(control, value)) {
      return fail(Errc::unsupported,
                  fmt::format("camera \"{}\": control {} = {} is not offered; it takes {}",
                              spec_.id, control.name, value, range_text(control)));
    }
    return {};
  }

  Result<void> read_settings(const std::vector<ControlSetting>& settings) {
    for (const ControlSetting& setting : settings) {
      const V4l2Control* control = by_name(setting.name);
      if (control == nullptr) {
        return unknown(setting.name);
      }
      if (requested(control->id) != nullptr) {
        return fail(Errc::unsupported,
                    fmt::format("camera \"{}\": control {} is set twice under controls and "
                                "trigger; remove one",
                                spec_.id, control->name));
      }
      std::int64_t value = setting.value;
      if (!setting.entry.empty()) {
        const auto entry = std::find_if(
            control->entries.begin(), control->entries.end(), [&](const V4l2MenuEntry& e) {
              return control_key(e.name) == control_key(setting.entry);
            });
        if (entry == control->entries.end()) {
          return fail(
              Errc::unsupported,
              fmt::format("camera \"{}\": control {} has no entry \"{}\"; it takes {}",
                          spec_.id, control->name, setting.entry, range_text(*control)));
        }
        value = entry->value;
      }
      if (auto good = require_settable(*control, value); !good) {
        return good;
      }
      requested_.push_back({*control, value});
    }
    return {};
  }

  Result<void> read_trigger() {
    const V4l2Trigger& trigger = spec_.v4l2.trigger;
    if (trigger_ == TriggerSource::free) {
      return read_settings(trigger.off);
    }
    const bool is_software = trigger_ == TriggerSource::software;
    const std::vector<ControlSetting>& settings = is_software ? trigger.software : trigger.line;
    if (settings.empty() || (is_software && trigger.fire.empty())) {
      return fail(Errc::unsupported,
                  fmt::format("camera \"{}\" runs freely: the rig file has no trigger.{}",
                              spec_.id, is_software ? "software with trigger.fire" : "line"));
    }
    if (is_software) {
      const V4l2Control* control = by_name(trigger.fire);
      if (control == nullptr) {
        return unknown(trigger.fire);
      }
      if (!control->is_settable ||
          (control->kind != V4l2ControlKind::button && !is_in_range(*control, kFired))) {
        return fail(Errc::unsupported,
                    fmt::format("camera \"{}\": trigger.fire = \"{}\" is no button, nor a "
                                "control that can be set to {}",
                                spec_.id, control->name, kFired));
      }
      chosen_.fire_ = *control;
    }
    return read_settings(settings);
  }

  [[nodiscard]] const SetControl* requested(std::uint32_t id) const {
    const auto found =
        std::find_if(requested_.begin(), requested_.end(),
                     [id](const SetControl& set) { return set.control.id == id; });
    return found == requested_.end() ? nullptr : &*found;
  }

  [[nodiscard]] bool has(std::uint32_t id) const {
    return std::any_of(chosen_.controls_.begin(), chosen_.controls_.end(),
                       [id](const SetControl& set) { return set.control.id == id; });
  }

  Result<void> add_mode(const Mode& mode) {
    if (const SetControl* set = requested(mode.id)) {
      chosen_.controls_.push_back(*set);
      return {};
    }
    const V4l2Control* control = by_id(mode.id);
    if (control == nullptr || !control->is_settable) {
      return {};
    }
    if (is_in_range(*control, mode.manual)) {
      chosen_.controls_.push_back({*control, mode.manual});
      return {};
    }
    if (mode.id == control_id::kExposureAuto && spec_.v4l2.exposure_control != "none") {
      return fail(Errc::unsupported,
                  fmt::format("camera \"{}\" cannot expose by hand ({} takes {}): it is of no "
                              "use for measuring",
                              spec_.id, control->name, range_text(*control)));
    }
    return {};
  }

  Result<void> add_exposure() {
    const std::string& name = spec_.v4l2.exposure_control;
    if (name == "none") {
      return {};
    }
    const V4l2Control* control = nullptr;
    if (!name.empty()) {
      control = by_name(name);
      if (control == nullptr) {
        return unknown(name);
      }
    } else {
      control = by_id(control_id::kExposureAbsolute);
      control = control != nullptr ? control : by_id(control_id::kExposure);
      // Some drivers have a control of their own by that name (Tegra: 64 bits, microseconds).
      control = control != nullptr ? control : by_name("exposure");
    }
    if (control == nullptr) {
      return fail(Errc::unsupported,
                  fmt::format("camera \"{}\" has no control for the exposure time; if its "
                              "exposure is fixed, write exposure_control = \"none\" and the "
                              "true exposure_us",
                              spec_.id));
    }
    chosen_.exposure_unit_us_ = spec_.v4l2.exposure_unit_us;
    if (chosen_.exposure_unit_us_ == 0.0 && control->id == control_id::kExposureAbsolute) {
      chosen_.exposure_unit_us_ = kExposureAbsoluteUs;
    }
    if (chosen_.exposure_unit_us_ == 0.0) {
      return fail(Errc::unsupported,
                  fmt::format("camera \"{}\": control {} counts in steps of its own; write "
                              "exposure_unit_us, the microseconds of a step (for a sensor that "
                              "counts rows: frame time / rows of a frame, blanking included)",
                              spec_.id, control->name));
    }
    if (requested(control->id) != nullptr) {
      return fail(Errc::unsupported,
                  fmt::format("camera \"{}\": controls.{} and exposure_us set the same; remove "
                              "the first",
                              spec_.id, control->name));
    }
    chosen_.exposure_ = chosen_.controls_.size();
    chosen_.controls_.push_back({*control, 0});
    const std::int64_t value = chosen_.exposure_steps(spec_.exposure_us);
    chosen_.controls_.back().value = value;
    if (!is_in_range(*control, value)) {
      return fail(Errc::unsupported,
                  fmt::format("camera \"{}\": an exposure of {} us is not offered; {} us to {} "
                              "us are",
                              spec_.id, spec_.exposure_us,
                              static_cast<double>(control->min) * chosen_.exposure_unit_us_,
                              static_cast<double>(control->max) * chosen_.exposure_unit_us_));
    }
    return {};
  }

  Result<void> add_gain() {
    const V4l2Control* control = by_id(control_id::kAnalogueGain);
    control = control != nullptr ? control : by_id(control_id::kGain);
    control = control != nullptr ? control : by_name("gain");
    if (requested(control_id::kGain) != nullptr ||
        (control != nullptr && requested(control->id) != nullptr)) {
      return {};  // in the device's own units; gain_db is informational
    }
    const double unit = spec_.v4l2.gain_unit_db;
    if (unit == 0.0 && spec_.gain_db != 0.0) {
      return fail(Errc::unsupported,
                  fmt::format("camera \"{}\": gain_db = {} cannot be said to the device; write "
                              "gain_unit_db (decibels of a step of its gain control), or the "
                              "control's own value under [camera.controls]",
                              spec_.id, spec_.gain_db));
    }
    if (control == nullptr || !control->is_settable) {
      return unit == 0.0 ? Result<void>{}
                         : Result<void>(fail(Errc::unsupported,
                                             fmt::format("camera \"{}\" has no gain control "
                                                         "for gain_unit_db",
                                                         spec_.id)));
    }
    const std::int64_t value = unit == 0.0 ? control->min : std::llround(spec_.gain_db / unit);
    if (auto good = require_settable(*control, value); !good) {
      return good;
    }
    if (unit > 0.0) {
      chosen_.gain_ = chosen_.controls_.size();
      chosen_.gain_unit_db_ = unit;
    }
    chosen_.controls_.push_back({*control, value});
    return {};
  }

  const std::vector<V4l2Control>& offered_;
  const CameraSpec& spec_;
  const TriggerSource trigger_;
  std::vector<SetControl> requested_;  ///< by the rig file, in its order
  V4l2Controls chosen_;
};

Result<V4l2Controls> V4l2Controls::choose(const std::vector<V4l2Control>& offered,
                                          const CameraSpec& spec, TriggerSource trigger) {
  return Chooser(offered, spec, trigger).run();
}

std::int64_t V4l2Controls::exposure_steps(double exposure_us) const {
  const V4l2Control& control = controls_[*exposure_].control;
  const auto steps = static_cast<std::int64_t>(std::llround(exposure_us / exposure_unit_us_));
  if (!is_in_range(control, steps)) {
    return steps;  // refused by its caller or by the device
  }
  // Unsigned: the difference of two 64-bit numbers may not fit in a signed one.
  const std::uint64_t above =
      static_cast<std::uint64_t>(steps) - static_cast<std::uint64_t>(control.min);
  return steps - static_cast<std::int64_t>(above % static_cast<std::uint64_t>(control.step));
}

Result<void> V4l2Controls::set_one(V4l2Device& device, SetControl& set, bool is_exact) const {
  if (auto done = device.set_control(set.control, set.value); !done) {
    Fault fault = done.error();
    fault.what = fmt::format("control {} = {} (it takes {}): {}", set.control.name, set.value,
                             range_text(set.control), fault.what);
    return tl::unexpected<Fault>(std::move(fault));
  }
  const auto value = device.control(set.control);
  if (!value) {
    return tl::unexpected<Fault>(value.error());
  }
  if (is_exact && *value != set.value) {
    return fail(Errc::refused, fmt::format("{}: control {}: requested {}, it set {}",
                                           device.node(), set.control.name, set.value, *value));
  }
  set.value = *value;
  return {};
}

Result<void> V4l2Controls::apply(V4l2Device& device) {
  for (std::size_t i = 0; i < controls_.size(); ++i) {
    if (auto done = set_one(device, controls_[i], exposure_ != i); !done) {
      return done;
    }
  }
  for (const SetControl& set : controls_) {
    if (const auto watched = device.watch_control(set.control.id); !watched) {
      return tl::unexpected<Fault>(watched.error());
    }
  }
  return {};
}

Result<void> V4l2Controls::verify(const V4l2Device& device) const {
  for (const SetControl& set : controls_) {
    const auto value = device.control(set.control);
    if (!value) {
      Fault fault = value.error();
      fault.code = fault.code == Errc::device_gone ? fault.code : Errc::io;
      return tl::unexpected<Fault>(std::move(fault));
    }
    if (auto valid = validate({V4l2Event::Kind::control, set.control.id, *value}); !valid) {
      return valid;
    }
  }
  return {};
}

Result<void> V4l2Controls::validate(const V4l2Event& event) const {
  if (event.kind == V4l2Event::Kind::source) {
    return fail(Errc::io, "the camera's signal changed (another source, size or rate)");
  }
  if (event.kind != V4l2Event::Kind::control) {
    return {};
  }
  const auto set =
      std::find_if(controls_.begin(), controls_.end(),
                   [&](const SetControl& each) { return each.control.id == event.control; });
  if (set == controls_.end() || set->value == event.value) {
    return {};
  }
  return fail(Errc::io,
              fmt::format("control {} changed by itself from {} to {}: an automatic is still "
                          "on, or another program uses the camera",
                          set->control.name, set->value, event.value));
}

Result<double> V4l2Controls::set_exposure(V4l2Device& device, double exposure_us) {
  if (!exposure_) {
    if (std::abs(exposure_us - fixed_exposure_us_) <= 1e-9 * fixed_exposure_us_) {
      return fixed_exposure_us_;
    }
    return fail(Errc::unsupported,
                fmt::format("{}: its exposure is fixed at {} us (exposure_control = \"none\"), "
                            "the plan asks for {} us",
                            device.node(), fixed_exposure_us_, exposure_us));
  }
  SetControl& set = controls_[*exposure_];
  set.value = exposure_steps(exposure_us);
  if (auto done = set_one(device, set, false); !done) {
    return tl::unexpected<Fault>(done.error());
  }
  return this->exposure_us();
}

Result<void> V4l2Controls::fire(V4l2Device& device) const {
  if (!fire_) {
    return fail(Errc::unsupported, device.node() + ": it was not set to wait for a trigger");
  }
  return device.set_control(*fire_, kFired);
}

double V4l2Controls::exposure_us() const {
  return exposure_ ? static_cast<double>(controls_[*exposure_].value) * exposure_unit_us_
                   : fixed_exposure_us_;
}

double V4l2Controls::gain_db() const {
  return gain_ ? static_cast<double>(controls_[*gain_].value) * gain_unit_db_ : noted_gain_db_;
}

}  // namespace haarlight::capture
