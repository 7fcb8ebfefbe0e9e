// SPDX-License-Identifier: Apache-2.0
#include "capture/daemon/rig_watch.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <variant>

namespace haarlight::capture {

namespace {

constexpr std::int64_t kSecondNs = 1'000'000'000;
constexpr int kSecondsAMinute = 60;
constexpr std::size_t kMaxSeconds = 600;
constexpr std::size_t kMaxMinutes = 720;
constexpr double kFullLevel = 65535.0;
constexpr double kLeastTauS = 1e-3;

double seconds(std::int64_t ns) { return 1e-9 * static_cast<double>(ns); }

}  // namespace

RigWatch::RigWatch(const Rig& rig, std::int64_t now_ns)
    : reckoned_ns_(now_ns), second_ns_(now_ns) {
  for (std::size_t f = 0; f < rig.faces.size(); ++f) {
    const Face& face = rig.faces[f];
    watts_of_face_.push_back(face.element_power.value());
    tau_s_of_face_.push_back(std::max(kLeastTauS, face.heat_tau_s));
    face_of_.insert(face_of_.end(), static_cast<std::size_t>(face.n_lights()),
                    static_cast<int>(f));
  }
  heat_.assign(face_of_.size(), 0.0);
  heat_ns_.assign(face_of_.size(), now_ns);
  peak_of_face_.assign(rig.faces.size(), 0.0);
}

void RigWatch::begin(Patterns patterns) {
  const std::lock_guard lock(mutex_);
  patterns_ = std::move(patterns);
}

void RigWatch::set_link(DeviceState& device, DeviceState::Link link, std::int64_t now_ns) {
  if (device.link != link) {
    device.link = link;
    device.since_ns = now_ns;
  }
}

void RigWatch::see(std::int64_t now_ns, const EventBody& event) {
  const std::lock_guard lock(mutex_);
  advance(now_ns);
  if (std::holds_alternative<event::LightConnected>(event)) {
    set_link(controller_, DeviceState::Link::good, now_ns);
    controller_.problem.clear();
    show(now_ns, -1);
  } else if (const auto* shown = std::get_if<event::LightShown>(&event)) {
    controller_.problem.clear();
    if (shown->job == show_job_) {
      show(now_ns, show_shot_);
    }
  } else if (std::holds_alternative<event::LightDark>(event)) {
    show(now_ns, -1);
  } else if (const auto* fault = std::get_if<event::LightFault>(&event)) {
    if (fault->code != Errc::device_busy) {  // busy: the order of our own jobs
      controller_.problem = fault->what;
      controller_.code = fault->code;
    }
    if (fault->code != Errc::device_busy && fault->code != Errc::refused) {
      set_link(controller_, DeviceState::Link::lost, now_ns);
      show(now_ns, -1);
    }
  } else if (const auto* confirmed = std::get_if<event::LightConfirmed>(&event)) {
    take_temperature(confirmed->temperature_c);
  } else if (const auto* step = std::get_if<event::StepRead>(&event)) {
    take_temperature(step->temperature_c);
    show(now_ns, step->tag == 0 ? -1 : static_cast<int>(step->tag - kFirstTag));
  } else if (std::holds_alternative<event::CameraStarted>(event)) {
    set_link(camera_, DeviceState::Link::good, now_ns);
    camera_.problem.clear();
  } else if (const auto* failed = std::get_if<event::CameraFault>(&event)) {
    set_link(camera_, DeviceState::Link::lost, now_ns);
    camera_.problem = failed->what;
    camera_.code = failed->code;
  } else if (std::holds_alternative<event::FrameArrived>(event)) {
    second_.frames += 1.0;
  }
}

void RigWatch::see(std::int64_t now_ns, const Action& action) {
  if (const auto* shown = std::get_if<action::ShowShot>(&action)) {
    const std::lock_guard lock(mutex_);
    show_job_ = shown->job;
    show_shot_ = shown->shot;
  } else if (std::holds_alternative<action::StopCamera>(action)) {
    const std::lock_guard lock(mutex_);
    if (camera_.link == DeviceState::Link::good) {
      set_link(camera_, DeviceState::Link::unused, now_ns);
    }
  }
}

void RigWatch::take_temperature(const std::optional<double>& temperature_c) {
  if (temperature_c) {
    second_.temperature_sum += *temperature_c;
    ++second_.n_temperatures;
  }
}

void RigWatch::heat_to(std::int64_t now_ns, const firmware_iface::ElementLevel& lit,
                       double drive) {
  const auto k = static_cast<std::size_t>(lit.element);
  if (k < heat_.size()) {
    const double tau_s = tau_s_of_face_[static_cast<std::size_t>(face_of_[k])];
    heat_[k] = drive + (heat_[k] - drive) * std::exp(-seconds(now_ns - heat_ns_[k]) / tau_s);
    heat_ns_[k] = now_ns;
  }
}

void RigWatch::show(std::int64_t now_ns, int shot) {
  if (shot == lit_shot_) {
    return;
  }
  for (const firmware_iface::ElementLevel& lit : lit_) {
    heat_to(now_ns, lit, lit.level / kFullLevel);
  }
  add_energy(now_ns);
  lit_shot_ = shot;
  lit_.clear();
  if (patterns_ != nullptr && shot >= 0 && shot < static_cast<int>(patterns_->size())) {
    lit_ = (*patterns_)[static_cast<std::size_t>(shot)];
  }
  lit_watts_ = 0.0;
  for (const firmware_iface::ElementLevel& lit : lit_) {
    heat_to(now_ns, lit, 0.0);  // cooling since it was last lit
    const auto k = static_cast<std::size_t>(lit.element);
    if (k < face_of_.size()) {
      lit_watts_ +=
          lit.level / kFullLevel * watts_of_face_[static_cast<std::size_t>(face_of_[k])];
    }
  }
  was_lit_ = was_lit_ || !lit_.empty();
}

void RigWatch::add_energy(std::int64_t until_ns) {
  second_.watts += lit_watts_ * seconds(until_ns - reckoned_ns_);
  reckoned_ns_ = until_ns;
}

void RigWatch::advance(std::int64_t now_ns) {
  const std::int64_t behind = (now_ns - second_ns_) / kSecondNs;
  if (behind > static_cast<std::int64_t>(kMaxSeconds)) {
    // Nothing happened for longer than the seconds buffer covers: all its entries are alike.
    close_second();
    const std::int64_t n_alike = behind - 1;
    const int capped = static_cast<int>(
        std::min<std::int64_t>(n_alike, std::int64_t{kMaxMinutes} * kSecondsAMinute));
    for (std::size_t f = 0; f < peak_of_face_.size(); ++f) {
      peak_of_face_[f] *= std::exp(-static_cast<double>(n_alike) / tau_s_of_face_[f]);
    }
    for (int i = 0; i < capped; ++i) {
      add_second(Point{.watts = lit_watts_});
    }
    second_ns_ += n_alike * kSecondNs;
    reckoned_ns_ = second_ns_;
  }
  while (now_ns - second_ns_ >= kSecondNs) {
    close_second();
  }
}

void RigWatch::close_second() {
  const std::int64_t end_ns = second_ns_ + kSecondNs;
  add_energy(end_ns);
  if (was_lit_) {
    for (const firmware_iface::ElementLevel& lit : lit_) {
      heat_to(end_ns, lit, lit.level / kFullLevel);
    }
    std::fill(peak_of_face_.begin(), peak_of_face_.end(), 0.0);
    for (std::size_t k = 0; k < heat_.size(); ++k) {
      const auto f = static_cast<std::size_t>(face_of_[k]);
      const double heat =
          heat_[k] * std::exp(-seconds(end_ns - heat_ns_[k]) / tau_s_of_face_[f]);
      peak_of_face_[f] = std::max(peak_of_face_[f], heat);
    }
  } else {  // all cool alike
    for (std::size_t f = 0; f < peak_of_face_.size(); ++f) {
      peak_of_face_[f] *= std::exp(-1.0 / tau_s_of_face_[f]);
    }
  }
  was_lit_ = !lit_.empty();
  second_.duty = *std::max_element(peak_of_face_.begin(), peak_of_face_.end());
  add_second(std::exchange(second_, Point{}));
  second_ns_ = end_ns;
}

void RigWatch::add_second(const Point& point) {
  seconds_.push_back(point);
  if (seconds_.size() > kMaxSeconds) {
    seconds_.pop_front();
  }
  minute_.temperature_sum += point.temperature_sum;
  minute_.n_temperatures += point.n_temperatures;
  minute_.watts += point.watts / kSecondsAMinute;
  minute_.duty = std::max(minute_.duty, point.duty);
  minute_.frames += point.frames / kSecondsAMinute;
  ++n_seconds_;
  if (n_seconds_ >= kSecondsAMinute) {
    minutes_.push_back(std::exchange(minute_, Point{}));
    n_seconds_ = 0;
    if (minutes_.size() > kMaxMinutes) {
      minutes_.pop_front();
    }
  }
}

RigHistory RigWatch::history(std::int64_t now_ns, HistorySpan span) {
  const std::lock_guard lock(mutex_);
  advance(now_ns);
  RigHistory history;
  history.step_s = span == HistorySpan::minutes ? 1.0 : kSecondsAMinute;
  for (const Point& point : span == HistorySpan::minutes ? seconds_ : minutes_) {
    history.temperature_c.push_back(
        point.n_temperatures == 0
            ? std::optional<double>()
            : std::optional<double>(point.temperature_sum / point.n_temperatures));
    history.watts.push_back(point.watts);
    history.duty.push_back(point.duty);
    history.frames.push_back(point.frames);
  }
  return history;
}

DeviceState RigWatch::controller() const {
  const std::lock_guard lock(mutex_);
  return controller_;
}

DeviceState RigWatch::camera() const {
  const std::lock_guard lock(mutex_);
  return camera_;
}

}  // namespace haarlight::capture
