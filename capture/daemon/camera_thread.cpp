// SPDX-License-Identifier: Apache-2.0
#include "capture/daemon/camera_thread.h"

#include <algorithm>
#include <type_traits>
#include <utility>

#include <fmt/format.h>

#include "capture/proof/frame_checks.h"
#include "session/clip_level.h"

namespace haarlight::capture {

namespace {

using std::chrono::milliseconds;

constexpr milliseconds kSlice{20};                // longest a command waits for a silent camera
constexpr std::int64_t kSilenceNs = 500'000'000;  // beyond exposure and frames: it is lost

TriggerSource trigger_source(SyncMode sync) {
  switch (sync) {
    case SyncMode::free_run:
    case SyncMode::camera_leads:
      return TriggerSource::free;
    case SyncMode::light_leads:
      return TriggerSource::software;
    case SyncMode::controller_leads:
      return TriggerSource::line;
  }
  return TriggerSource::free;
}

}  // namespace

std::uint64_t FrameStore::put(Frame frame) {
  auto shared = std::make_shared<const Frame>(std::move(frame));
  const std::lock_guard lock(mutex_);
  frames_.emplace(next_id_, std::move(shared));
  return next_id_++;
}

std::shared_ptr<const Frame> FrameStore::get(std::uint64_t id) const {
  const std::lock_guard lock(mutex_);
  const auto it = frames_.find(id);
  return it == frames_.end() ? nullptr : it->second;
}

void FrameStore::drop(std::uint64_t id) {
  std::shared_ptr<const Frame> dropped;  // released outside the lock
  const std::lock_guard lock(mutex_);
  const auto it = frames_.find(id);
  if (it != frames_.end()) {
    dropped = std::move(it->second);
    frames_.erase(it);
  }
}

std::size_t FrameStore::size() const {
  const std::lock_guard lock(mutex_);
  return frames_.size();
}

CameraThread::CameraThread(std::unique_ptr<Camera> camera, CameraSpec spec, FrameStore& store,
                           std::function<void(EventBody)> send, Clock& clock)
    : camera_(std::move(camera)),
      spec_(std::move(spec)),
      clip_dn_(session::clip_level(spec_)),
      store_(store),
      send_(std::move(send)),
      clock_(clock),
      thread_(clock_.start([this](const std::stop_token& stop) { run(stop); })) {}

CameraThread::~CameraThread() { clock_.stop(thread_); }

void CameraThread::post(const action::StartCamera& command) {
  if (!commands_.try_push(command)) {
    send_(event::CameraFault{command.stream, Errc::device_busy, "the camera thread is behind"});
  }
}
void CameraThread::post(const action::StopCamera& command) {
  (void)commands_.try_push(command);
}
void CameraThread::post(const action::SetExposure& command) {
  (void)commands_.try_push(command);  // unanswered: no frame is accepted, the shot times out
}

void CameraThread::post(const action::TriggerCamera& command) {
  (void)commands_.try_push(command);  // lost: the shot times out and is shown again
}

void CameraThread::run(const std::stop_token& stop) {
  while (!stop.stop_requested()) {
    const auto wait = !is_streaming_ ? milliseconds(250) : is_idle() ? kSlice : milliseconds(0);
    const std::optional<Command> command = commands_.pop(clock_.now() + wait, stop);
    const ThreadPulse::Busy busy(pulse_);
    if (command) {
      do_command(*command);
    } else if (is_streaming_) {
      take_frame();
    }
  }
  camera_->stop();
}

void CameraThread::do_command(const Command& command) {
  if (const auto* start = std::get_if<action::StartCamera>(&command)) {
    stream_ = start->stream;
    spec_.exposure_us = start->exposure_us;
    sync_ = start->sync;
    const auto triggered = camera_->set_trigger(trigger_source(sync_));
    const auto setup = triggered
                           ? camera_->start(spec_)
                           : Result<CameraSetup>(tl::unexpected<Fault>(triggered.error()));
    is_frame_due_ = trigger_source(sync_) == TriggerSource::free;
    is_streaming_ = setup.has_value();
    if (!setup) {
      fault(setup.error());
      return;
    }
    last_frame_ns_ = clock_.now_ns();
    tap_.forget();
    send_(event::CameraStarted{stream_, setup->exposure_us, setup->n_buffers});
  } else if (const auto* set = std::get_if<action::SetExposure>(&command)) {
    if (!is_streaming_) {
      return;
    }
    const auto value = camera_->set_exposure(set->exposure_us);
    if (!value) {
      fault(value.error());
      return;
    }
    spec_.exposure_us = *value;
    send_(event::ExposureSet{set->request, *value});
  } else if (std::get_if<action::TriggerCamera>(&command) != nullptr) {
    if (!is_streaming_) {
      return;
    }
    if (!is_frame_due_) {
      last_frame_ns_ = clock_.now_ns();  // silence is counted from here
    }
    is_frame_due_ = true;
    if (const auto done = camera_->trigger(); !done) {
      fault(done.error());
    }
  } else {
    is_streaming_ = false;
    tap_.forget();
    camera_->stop();
  }
}

bool CameraThread::is_idle() const {
  return trigger_source(sync_) == TriggerSource::software && !is_frame_due_;
}

void CameraThread::fault(const Fault& fault) {
  is_streaming_ = false;
  tap_.forget();
  camera_->stop();
  send_(event::CameraFault{stream_, fault.code, fault.what});
}

void CameraThread::take_frame() {
  auto frame = camera_->next(clock_.now() + (is_idle() ? milliseconds(0) : kSlice));
  if (!frame && frame.error().code == Errc::timeout) {
    const double patience_us = spec_.exposure_us + spec_.skew_us + 3e6 / spec_.fps;
    if (is_frame_due_ && clock_.now_ns() - last_frame_ns_ >
                             kSilenceNs + static_cast<std::int64_t>(patience_us * 1e3)) {
      fault(Fault{Errc::timeout,
                  fmt::format("no frame for {:.1f} s",
                              1e-9 * static_cast<double>(clock_.now_ns() - last_frame_ns_))});
    }
    return;
  }
  if (!frame) {
    fault(frame.error());
    return;
  }
  last_frame_ns_ = clock_.now_ns();
  is_frame_due_ = trigger_source(sync_) == TriggerSource::free;
  const FrameInfo info = frame->info();
  FrameGlance glance;
  const ImageView<const std::uint16_t> pixels = frame->pixels();
  if (!pixels.is_empty()) {
    const ImageView<const std::uint16_t> active(pixels.data(), spec_.active_rows,
                                                pixels.width(), 1, pixels.row_stride());
    glance = glance_at(active, clip_dn_);
  }
  const bool is_looked_at = !pixels.is_empty() && tap_.is_wanted(last_frame_ns_);
  const std::uint64_t id = store_.put(*std::move(frame));
  if (is_looked_at) {
    tap_.offer(store_.get(id), spec_.active_rows, last_frame_ns_);
  }
  send_(event::FrameArrived{id, stream_, info, glance.hash, glance.must_differ});
}

}  // namespace haarlight::capture
