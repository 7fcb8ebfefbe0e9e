// SPDX-License-Identifier: Apache-2.0
/// @file
/// The model rig's light controller: jobs on a bus that takes time and may fail, and a pattern
/// table that the camera's strobe steps.

#include <algorithm>

#include "capture/sequencer/model_rig.h"

namespace haarlight::capture {

namespace {

constexpr std::int64_t kUs = 1000;
constexpr std::int64_t kMs = 1'000'000;
constexpr std::int64_t kNoAnswerNs = 30 * kMs;  // the bus's timeout
constexpr double kPollsAFrame = 4.0;

}  // namespace

void ModelRig::queue_job(std::function<void()> work) {
  jobs_.push_back(std::move(work));
  start_job();
}

void ModelRig::start_job() {
  if (is_job_running_ || jobs_.empty()) {
    return;
  }
  is_job_running_ = true;
  is_polling_ = false;
  std::function<void()> work = std::move(jobs_.front());
  jobs_.pop_front();
  at(now_ns_ + 20 * kUs, std::move(work));
}

void ModelRig::end_job(std::optional<EventBody> answer) {
  is_job_running_ = false;
  if (answer) {
    send(*std::move(answer));
  }
  start_job();
}

void ModelRig::change_light(std::uint32_t tag, std::int64_t delay_ns) {
  ++n_latches_;
  shown_tag_ = tag;
  // A light on its way to another level starts from where it is: it does not reach the first
  // one.
  if (light_.back().t_ns > now_ns_ + delay_ns) {
    light_.pop_back();
  }
  const std::int64_t begin_ns = std::max(now_ns_ + delay_ns, light_.back().t_ns);
  light_.push_back({begin_ns, tag, false});
  light_.push_back({begin_ns + static_cast<std::int64_t>(config_.rise_us * 1e3), tag, true});
  if (light_.size() > 400) {
    light_.erase(light_.begin(), light_.begin() + 200);
  }
}

FrameTag ModelRig::truth_between(std::int64_t t0_ns, std::int64_t t1_ns) const {
  FrameTag truth;
  bool is_first = true;
  for (std::size_t i = 0; i < light_.size(); ++i) {
    const std::int64_t end_ns = i + 1 < light_.size() ? light_[i + 1].t_ns : kNever;
    if (end_ns <= t0_ns || light_[i].t_ns >= t1_ns) {
      continue;
    }
    truth.is_mixed =
        truth.is_mixed || !light_[i].is_settled || (!is_first && truth.tag != light_[i].tag);
    truth.tag = light_[i].tag;
    is_first = false;
  }
  return truth;
}

void ModelRig::darken_by_itself() {
  ++n_darkened_;
  last_act_ns_ = now_ns_;
  disarm();
  change_light(0, 0);
}

std::int64_t ModelRig::some_lateness_ns(double fraction) {
  if (fraction <= 0.0 || !happens(fraction)) {
    return 0;
  }
  ++outcome_.n_late;
  return 5 * kMs + static_cast<std::int64_t>(55e6 * chance());
}

std::int64_t ModelRig::act_ns(std::int64_t lateness_ns) {
  last_act_ns_ = std::max(now_ns_ + lateness_ns, last_act_ns_);
  return last_act_ns_;
}

void ModelRig::reboot() {
  ++boot_id_;
  is_connected_ = false;
  table_.clear();
  darken_by_itself();
  bus_back_ns_ = now_ns_ + some_ns(800'000.0);
}

/// No answer: the fault comes after the time spent waiting.
void ModelRig::fail_job(std::uint64_t job, Errc code, const char* what) {
  at(now_ns_ + kNoAnswerNs, [this, job, code, what] {
    end_job(event::LightFault{job, code, what});
  });
}

/// Confirms, then latches; every bus exchange takes time and may fail.
void ModelRig::light_job(std::uint64_t job, std::uint32_t tag,
                         std::optional<ConfirmRequest> confirm) {
  if (now_ns_ < bus_back_ns_ || !is_connected_) {
    fail_job(job, Errc::device_gone, "connection reset");
    return;
  }
  if (!confirm) {
    show(job, tag);
    return;
  }
  if (happens(config_.faults.light_timeout)) {
    fail_job(job, Errc::timeout, "status: no answer");
    return;
  }
  const std::int64_t request_ns = now_ns_;
  const std::int64_t sample_ns = now_ns_ + some_ns(0.5 * config_.bus_us);
  const std::int64_t answer_ns = sample_ns + some_ns(0.5 * config_.bus_us);
  at(sample_ns, [=, this] {
    const std::uint32_t shown = shown_tag_;
    const std::uint32_t boot = boot_id_;
    const bool is_up = is_connected_;
    at(answer_ns, [=, this] {
      if (!is_up) {
        fail_job(job, Errc::device_gone, "status: connection reset");
        return;
      }
      send(event::LightConfirmed{confirm->frame, request_ns, shown, boot, temperature_c()});
      if (shown == confirm->tag) {
        show(job, tag);
      } else {
        end_job(std::nullopt);
      }
    });
  });
}

void ModelRig::show(std::uint64_t job, std::uint32_t tag) {
  const std::int64_t command_ns = now_ns_;
  const std::int64_t latch_ns = now_ns_ + some_ns(0.5 * config_.bus_us);
  const std::int64_t ack_ns = latch_ns + some_ns(0.5 * config_.bus_us);
  const std::int64_t answer_way_ns = some_ns(0.3 * config_.bus_us);
  const bool is_lost = happens(config_.faults.light_timeout);
  const bool is_shown = !is_lost || happens(0.5);
  const bool is_wrong_echo = happens(config_.faults.light_wrong_echo);
  at(latch_ns, [=, this] {
    const bool is_up = is_connected_;
    if (is_up && !is_lost && tag != 0 && now_ns_ < interlock_closes_ns_) {
      at(ack_ns + answer_way_ns, [this, job] {
        end_job(event::LightFault{job, Errc::device_busy, "latch refused: interlock"});
      });
      return;
    }
    std::int64_t shown_ns = ack_ns;
    if (is_up && is_shown && (tag == 0 || now_ns_ >= interlock_closes_ns_)) {
      disarm();
      const std::int64_t lies_ns = some_lateness_ns(config_.faults.light_lying);
      const std::int64_t acts_ns = act_ns(some_lateness_ns(config_.faults.light_late));
      shown_ns = std::max(shown_ns, acts_ns);
      const auto act = [this, tag, lies_ns] {
        change_light(tag, lies_ns + some_ns(config_.latch_us));
        if (tag != 0 && config_.sync == SyncMode::controller_leads) {
          at(now_ns_ + static_cast<std::int64_t>(config_.trigger_us * 1e3),
             [this] { trigger(); });
        }
      };
      if (acts_ns == now_ns_) {
        act();
      } else {
        at(acts_ns, [this, act, n = n_darkened_] {
          if (n == n_darkened_) {
            act();
          }
        });
      }
    }
    if (!is_up || is_lost) {
      at(now_ns_ + kNoAnswerNs, [this, job] {
        end_job(event::LightFault{job, Errc::timeout, "latch: no answer"});
      });
      return;
    }
    // Read back until it shows, or until it went dark by itself meanwhile.
    at(shown_ns + answer_way_ns, [=, this] {
      if (!is_connected_) {
        end_job(event::LightFault{job, Errc::device_gone, "tag: connection reset"});
      } else if (tag == 0) {
        end_job(event::LightDark{job});
      } else {
        const std::uint32_t echo = is_wrong_echo ? shown_tag_ + 1 : shown_tag_;
        end_job(event::LightShown{
            job, firmware_iface::LatchReceipt{command_ns, ack_ns, now_ns_, echo}});
      }
    });
  });
}

// ---- the pattern table

void ModelRig::disarm() {
  ++n_armings_;
  n_armed_ = 0;
  step_counter_ = 0;
}

void ModelRig::upload(const action::UploadTable& table) {
  if (now_ns_ < bus_back_ns_ || !is_connected_ || happens(config_.faults.light_timeout)) {
    at(now_ns_ + kNoAnswerNs, [this, job = table.job] {
      end_job(event::LightFault{job, Errc::timeout, "upload: no answer"});
    });
    return;
  }
  disarm();
  change_light(0, 0);
  table_ = table.tags;
  for (std::uint32_t& tag : table_) {
    if (happens(config_.faults.entry_wrong)) {
      tag = kFirstTag + (tag - kFirstTag + 1) % static_cast<std::uint32_t>(plan_->shots.size());
    }
  }
  const auto n = static_cast<std::int64_t>(table.shots.size());
  at(now_ns_ + n * some_ns(0.3 * config_.bus_us), [this, job = table.job] {
    if (is_connected_) {
      end_job(event::TableUploaded{job});
    } else {
      end_job(event::LightFault{job, Errc::device_gone, "upload: connection reset"});
    }
  });
}

void ModelRig::arm(const action::ArmBlock& block) {
  const std::uint64_t job = block.job;
  if (now_ns_ < bus_back_ns_ || !is_connected_) {
    fail_job(job, Errc::device_gone, "connection reset");
    return;
  }
  const bool is_lost = happens(config_.faults.light_timeout);
  const bool is_done = !is_lost || happens(0.5);
  const std::int64_t command_ns = now_ns_;
  const std::int64_t arm_ns = now_ns_ + some_ns(0.5 * config_.bus_us);
  const std::int64_t ack_ns = arm_ns + some_ns(0.5 * config_.bus_us);
  at(arm_ns, [=, this] {
    const std::size_t end =
        static_cast<std::size_t>(block.first) + static_cast<std::size_t>(block.count);
    if (is_connected_ && is_done && end <= table_.size()) {
      disarm();
      change_light(0, 0);
      first_armed_ = static_cast<std::uint32_t>(block.first);
      n_armed_ = static_cast<std::uint32_t>(block.count);
      every_ = static_cast<std::uint32_t>(block.every);
      step_counter_ = 0;
      n_strobes_ = 0;
    }
    if (!is_connected_ || is_lost || end > table_.size()) {
      fail_job(job, is_connected_ ? Errc::timeout : Errc::device_gone, "arming: no answer");
      return;
    }
    at(ack_ns, [=, this] {
      if (!is_connected_) {
        end_job(event::LightFault{job, Errc::device_gone, "arming: connection reset"});
        return;
      }
      send(event::BlockArmed{job, firmware_iface::LatchReceipt{command_ns, ack_ns, 0, 0}});
      is_polling_ = true;
      end_job(std::nullopt);
      poll(job);
    });
  });
}

/// Reads the status a few times per frame until another job comes.
void ModelRig::poll(std::uint64_t job) {
  if (!is_polling_) {
    return;
  }
  const std::int64_t request_ns = now_ns_;
  const bool is_slow = happens(config_.faults.poll_slow);
  const std::int64_t way_ns =
      some_ns(0.5 * config_.bus_us) + (is_slow ? some_ns(3e6 / config_.fps) : 0);
  const std::int64_t back_ns = some_ns(0.5 * config_.bus_us);
  if (now_ns_ < bus_back_ns_ || !is_connected_ ||
      happens(0.02 * config_.faults.light_timeout)) {
    is_polling_ = false;
    at(now_ns_ + kNoAnswerNs, [this, job] {
      send(event::LightFault{job, is_connected_ ? Errc::timeout : Errc::device_gone,
                             "status: no answer"});
    });
    return;
  }
  at(now_ns_ + way_ns, [=, this] {
    const event::StepRead read{.job = job,
                               .t_request_ns = request_ns,
                               .t_ack_ns = now_ns_ + back_ns,
                               .step_counter = step_counter_,
                               .tag = shown_tag_,
                               .boot_id = boot_id_,
                               .is_armed = n_armed_ > 0,
                               .is_done = n_armed_ > 0 && step_counter_ > n_armed_,
                               .faults = now_ns_ < interlock_closes_ns_
                                             ? firmware_iface::registers::kFaultInterlock
                                             : 0U,
                               .temperature_c = temperature_c()};
    const bool is_up = is_connected_;
    at(now_ns_ + back_ns, [=, this] {
      if (!is_up) {
        is_polling_ = false;
        send(event::LightFault{job, Errc::device_gone, "status: connection reset"});
        return;
      }
      if (!is_polling_) {
        return;
      }
      send(read);
      const auto pause_ns = static_cast<std::int64_t>(1e9 / (kPollsAFrame * config_.fps));
      at(request_ns + pause_ns, [this, job] { poll(job); });
    });
  });
}

void ModelRig::strobe() {
  if (n_armed_ == 0 || n_strobes_++ % every_ != 0) {
    return;
  }
  // Two late steps in a row are undetectable for the counter: see strobe_proof.h.
  const bool is_late = config_.faults.strobe_late > 0.0 &&
                       n_strobes_ > late_strobe_ + 4 * every_ &&
                       happens(config_.faults.strobe_late);
  late_strobe_ = is_late ? n_strobes_ : std::min(late_strobe_, n_strobes_);
  const std::int64_t acts_ns = act_ns(is_late ? some_ns(2e6 / config_.fps) : 0);
  outcome_.n_late += is_late ? 1 : 0;
  if (acts_ns == now_ns_) {
    step_table();
  } else {
    at(acts_ns, [this, n = n_armings_] {
      if (n == n_armings_ && n_armed_ > 0) {
        step_table();
      }
    });
  }
}

void ModelRig::step_table() {
  const std::uint32_t index = step_counter_++;
  if (index >= n_armed_) {
    if (shown_tag_ != 0) {
      change_light(0, some_ns(config_.latch_us));
    }
  } else if (now_ns_ < interlock_closes_ns_) {
    darken_by_itself();
  } else {
    change_light(table_[first_armed_ + index], some_ns(config_.latch_us));
  }
}

/// The edge at the frame's end, or none; perhaps a spurious one before it. The case that the
/// counter cannot detect, a lost edge next to a spurious one, is left out: see strobe_proof.h.
void ModelRig::schedule_strobes(std::uint64_t sequence, std::int64_t end_ns) {
  if (config_.sync != SyncMode::camera_leads) {
    return;
  }
  const std::uint64_t n = sequence + 1;
  const std::uint64_t apart = 2 * static_cast<std::uint64_t>(config_.strobe_every) + 1;
  const bool may_lose = false_frame_ == 0 || n > false_frame_ + apart;
  const bool may_add = lost_frame_ == 0 || n > lost_frame_ + apart;
  if (may_lose && happens(config_.faults.strobe_lost)) {
    lost_frame_ = n;
  } else {
    at(end_ns, [this] { strobe(); });
  }
  if (may_add && lost_frame_ != n && happens(config_.faults.strobe_false)) {
    false_frame_ = n;
    at(end_ns - some_ns(1e6 / config_.fps), [this] { strobe(); });
  }
}

}  // namespace haarlight::capture
