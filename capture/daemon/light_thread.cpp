// SPDX-License-Identifier: Apache-2.0
#include "capture/daemon/light_thread.h"

#include <algorithm>
#include <type_traits>
#include <utility>

#include "core/log.h"

namespace haarlight::capture {

namespace {

template <class Job>
std::uint64_t number_of(const Job& job) {
  return std::visit([](const auto& j) { return j.job; }, job);
}

}  // namespace

LightThread::LightThread(std::unique_ptr<firmware_iface::LightArray> lights,
                         LightThreadConfig config)
    : lights_(std::move(lights)),
      config_(std::move(config)),
      clock_(*config_.clock),
      fed_ns_(clock_.now_ns()),
      thread_(clock_.start([this](const std::stop_token& stop) { run(stop); })) {}

LightThread::~LightThread() { clock_.stop(thread_); }

void LightThread::enqueue(const Job& job) {
  const std::uint64_t number = number_of(job);
  if (!jobs_.try_push(job)) {
    config_.send(event::LightFault{number, Errc::device_busy, "the light thread is behind"});
  }
}

void LightThread::post(const action::ConnectLight& job) { enqueue(job); }
void LightThread::post(const action::ShowShot& job) { enqueue(job); }
void LightThread::post(const action::UploadTable& job) { enqueue(job); }
void LightThread::post(const action::ArmBlock& job) { enqueue(job); }
void LightThread::post(const action::ExtendBlock& job) { enqueue(job); }

void LightThread::post(const action::LightsOff& job) {
  if (!job.confirm) {
    const std::deque<Job> overtaken = jobs_.take_if([](const Job& waiting) {
      return !std::holds_alternative<action::ConnectLight>(waiting) &&
             !std::holds_alternative<action::LightsOff>(waiting);
    });
    for (const Job& waiting : overtaken) {
      config_.send(
          event::LightFault{number_of(waiting), Errc::device_busy, "overtaken by off"});
    }
  }
  enqueue(job);
}

void LightThread::run(const std::stop_token& stop) {
  const auto slice =
      std::chrono::milliseconds(std::clamp<std::int64_t>(config_.lease.count() / 8, 10, 250));
  while (!stop.stop_requested()) {
    auto until = clock_.now() + slice;
    if (block_ != 0) {
      until = std::min(until, Clock::Time(std::chrono::nanoseconds(next_read_ns_)));
    }
    const std::optional<Job> job = jobs_.pop(until, stop);
    const ThreadPulse::Busy busy(pulse_);
    if (job) {
      do_job(*job);
    }
    keep_lease();
    if (block_ != 0 && clock_.now_ns() >= next_read_ns_) {
      read_steps();
    }
  }
  if (is_connected_) {
    (void)lights_->all_off();
  }
  lights_->disconnect();
}

void LightThread::do_job(const Job& job) {
  std::visit(
      [this](const auto& j) {
        using T = std::decay_t<decltype(j)>;
        if constexpr (std::is_same_v<T, action::ExtendBlock>) {
          extend(j);
          return;
        }
        block_ = 0;
        if constexpr (std::is_same_v<T, action::ConnectLight>) {
          connect(j);
        } else if constexpr (std::is_same_v<T, action::ShowShot>) {
          show(j);
        } else if constexpr (std::is_same_v<T, action::UploadTable>) {
          upload(j);
        } else if constexpr (std::is_same_v<T, action::ArmBlock>) {
          arm(j);
        } else if constexpr (std::is_same_v<T, action::LightsOff>) {
          darken(j);
        }
      },
      job);
}

void LightThread::connect(const action::ConnectLight& job) {
  is_connected_ = false;
  lights_->disconnect();
  const auto identity = lights_->connect();
  if (!identity) {
    config_.send(event::LightFault{job.job, identity.error().code, identity.error().what});
    return;
  }
  const auto off = lights_->all_off();
  const auto triggers = off ? lights_->set_trigger_delay(config_.trigger_delay)
                            : Result<void>(tl::unexpected<Fault>(off.error()));
  const auto status = triggers ? lights_->status() : tl::unexpected<Fault>(triggers.error());
  if (!status) {
    config_.send(event::LightFault{job.job, status.error().code, status.error().what});
    return;
  }
  for (const std::string& promise : identity->missing) {
    log_warning(identity->model + " has " + promise);
  }
  is_connected_ = true;
  is_dark_ = true;
  renewed_ns_ = clock_.now_ns();
  config_.send(event::LightConnected{job.job, status->boot_id, identity->table_depth});
}

bool LightThread::confirm(std::uint64_t job, const std::optional<ConfirmRequest>& request) {
  if (!request) {
    return true;
  }
  const std::int64_t t_request_ns = clock_.now_ns();
  const auto status = lights_->status();
  if (!status) {
    config_.send(event::LightFault{job, status.error().code, status.error().what});
    return false;
  }
  config_.send(event::LightConfirmed{request->frame, t_request_ns, status->tag, status->boot_id,
                                     status->temperature_c});
  return status->tag == request->tag;
}

void LightThread::show(const action::ShowShot& job) {
  if (!confirm(job.job, job.confirm)) {
    return;
  }
  const auto patterns = config_.patterns();
  if (patterns == nullptr || job.shot < 0 || job.shot >= static_cast<int>(patterns->size())) {
    config_.send(event::LightFault{job.job, Errc::refused, "a shot without a pattern"});
    return;
  }
  is_dark_ = false;
  const auto receipt = lights_->show((*patterns)[static_cast<std::size_t>(job.shot)], job.tag);
  if (!receipt) {
    config_.send(event::LightFault{job.job, receipt.error().code, receipt.error().what});
    return;
  }
  config_.send(event::LightShown{job.job, *receipt});
}

void LightThread::upload(const action::UploadTable& job) {
  const auto patterns = config_.patterns();
  std::vector<std::vector<firmware_iface::ElementLevel>> wanted;
  for (const int shot : job.shots) {
    if (patterns == nullptr || shot < 0 || shot >= static_cast<int>(patterns->size())) {
      config_.send(event::LightFault{job.job, Errc::refused, "a shot without a pattern"});
      return;
    }
    wanted.push_back((*patterns)[static_cast<std::size_t>(shot)]);
  }
  if (const auto done = lights_->upload_table(wanted, job.tags); !done) {
    config_.send(event::LightFault{job.job, done.error().code, done.error().what});
    return;
  }
  config_.send(event::TableUploaded{job.job});
}

void LightThread::arm(const action::ArmBlock& job) {
  is_dark_ = false;
  const auto receipt =
      lights_->arm_strobe({.first = job.first, .count = job.count, .divider = job.every});
  if (!receipt) {
    config_.send(event::LightFault{job.job, receipt.error().code, receipt.error().what});
    return;
  }
  config_.send(event::BlockArmed{job.job, *receipt});
  block_ = job.job;
  next_read_ns_ = clock_.now_ns();
}

void LightThread::extend(const action::ExtendBlock& job) {
  if (job.job != block_) {
    return;  // of a block that has ended
  }
  if (const auto done = lights_->extend_strobe(job.count); !done) {
    block_ = 0;
    config_.send(event::LightFault{job.job, done.error().code, done.error().what});
  }
}

void LightThread::read_steps() {
  const std::int64_t t_request_ns = clock_.now_ns();
  const auto status = lights_->status();
  if (!status) {
    config_.send(
        event::LightFault{std::exchange(block_, 0), status.error().code, status.error().what});
    return;
  }
  const std::int64_t t_ack_ns = clock_.now_ns();
  config_.send(event::StepRead{.job = block_,
                               .t_request_ns = t_request_ns,
                               .t_ack_ns = t_ack_ns,
                               .step_counter = status->step_counter,
                               .tag = status->tag,
                               .boot_id = status->boot_id,
                               .is_armed = status->is_armed,
                               .is_done = status->is_table_done,
                               .faults = status->faults,
                               .temperature_c = status->temperature_c});
  const std::int64_t poll_ns = std::chrono::nanoseconds(config_.poll).count();
  next_read_ns_ = std::max(t_ack_ns, t_request_ns + poll_ns);
}

void LightThread::darken(const action::LightsOff& job) {
  if (!confirm(job.job, job.confirm)) {
    return;
  }
  const auto receipt = lights_->all_off();
  if (!receipt) {
    config_.send(event::LightFault{job.job, receipt.error().code, receipt.error().what});
    return;
  }
  is_dark_ = true;
  config_.send(event::LightDark{job.job});
}

void LightThread::keep_lease() {
  if (!is_connected_) {
    return;
  }
  const std::int64_t now_ns = clock_.now_ns();
  const std::int64_t lease_ns = std::chrono::nanoseconds(config_.lease).count();
  if (now_ns - fed_ns_ > lease_ns) {
    if (!is_dark_) {
      log_error("the control thread is not heard: all lights off");
      is_dark_ = lights_->all_off().has_value();
    }
    return;
  }
  if (now_ns - renewed_ns_ < lease_ns / 4) {
    return;
  }
  renewed_ns_ = now_ns;
  const auto renewed = lights_->renew_lease();
  if (!renewed) {
    is_connected_ = false;
    config_.send(event::LightFault{0, renewed.error().code, renewed.error().what});
  }
}

}  // namespace haarlight::capture
