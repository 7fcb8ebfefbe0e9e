// SPDX-License-Identifier: Apache-2.0
/// @file
/// The sequencer: the camera, present or lost, and what a frame is worth by itself.

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "capture/plan/timing.h"
#include "capture/sequencer/stepper.h"

namespace haarlight::capture {

using namespace sequencing;

void Stepper::on(const event::CameraStarted& e) {
  if (!s_.is_camera_starting || e.stream != s_.stream) {
    return;
  }
  s_.is_camera_starting = false;
  s_.is_camera_started = true;
  s_.is_exposure_open = false;
  s_.has_sequence = false;
  s_.is_timestamp_refused = false;
  s_.rhythm = FrameRhythm();
  s_.triggered_ns = kNever;
  s_.n_hashes = 0;
  s_.is_exposure_seen = false;
  s_.n_buffers = e.n_buffers;
  s_.exposure_read_us = e.exposure_us;
  s_.max_held = std::max(
      1, std::min(s_.plan != nullptr ? s_.plan->max_held : 1, e.n_buffers - kSpareBuffers));
  if (!check_exposure()) {
    return;
  }
  became_ready(kCameraLost);
}

void Stepper::on(const event::ExposureSet& e) {
  if (e.request != s_.exposure_request || !s_.is_exposure_open) {
    return;
  }
  s_.is_exposure_open = false;
  s_.exposure_read_us = e.exposure_us;
  (void)check_exposure();
}

void Stepper::on(const event::CameraFault& e) {
  const bool is_needed = s_.is_camera_started || s_.is_camera_starting;
  if (e.stream != s_.stream || !is_needed) {
    return;
  }
  ++s_.counters.camera_faults;
  ++s_.camera_faults;
  s_.is_camera_started = false;
  s_.is_camera_starting = false;
  s_.is_exposure_open = false;
  if (e.code == Errc::unsupported || e.code == Errc::refused) {
    abort("camera: " + e.what);
    return;
  }
  s_.retry_camera_ns = t_ + backoff_ns(s_.camera_faults);
  add_reason(kCameraLost, "camera: " + e.what, shot_under_way());
}

void Stepper::on(const event::FrameArrived& e) {
  ++s_.counters.frames;
  const bool is_of_stream = s_.is_camera_started && e.stream == s_.stream;
  const std::optional<std::int64_t> examined = is_of_stream ? examine(e) : std::nullopt;
  const std::int64_t guard_ns = examined.value_or(0);
  const bool has_shot = is_of_stream && s_.phase == Phase::running && s_.current >= 0 &&
                        s_.step != ShotStep::none;
  if (is_by_strobe() && examined) {
    take_block_frame(e);
  } else if (!has_shot || !examined) {
    s_.discarded += has_shot ? 1 : 0;
    ++s_.counters.frames_unused;
    drop(e.frame);
  } else if (s_.step == ShotStep::light) {
    if (s_.early.size() >= kMaxEarly) {
      drop(s_.early.front().frame.frame);
      s_.early.erase(s_.early.begin());
      ++s_.counters.frames_unused;
    }
    s_.early.push_back({e, guard_ns});
  } else {
    validate({e, guard_ns});
  }
  if (s_.phase == Phase::preflight) {
    preflight_done();  // perhaps the frame that completes its period
  }
}

void Stepper::start_camera() {
  s_.retry_camera_ns = kNever;
  if (s_.plan == nullptr) {
    return;
  }
  const int next = s_.pending.empty() ? 0 : s_.pending.front();
  s_.exposure_requested_us = shot_of(next).exposure_us;
  s_.is_camera_starting = true;
  const SyncMode sync = s_.plan->is_preview ? SyncMode::free_run : s_.plan->sync;
  out_.emplace_back(action::StartCamera{++s_.stream, s_.exposure_requested_us, sync});
}

void Stepper::stop_camera() {
  if (s_.is_camera_started || s_.is_camera_starting) {
    out_.emplace_back(action::StopCamera{});
  }
  s_.is_camera_started = false;
  s_.is_camera_starting = false;
  s_.is_exposure_open = false;  // its answer, if one still comes, is not the next stream's
  s_.camera_faults = 0;
  s_.retry_camera_ns = kNever;
}

bool Stepper::check_exposure() {
  if (std::abs(s_.exposure_read_us - s_.exposure_requested_us) <=
      kExposureReadTol * s_.exposure_requested_us) {
    return true;
  }
  abort(fmt::format("camera: requested an exposure of {} us, it set {} us",
                    s_.exposure_requested_us, s_.exposure_read_us));
  return false;
}

std::optional<std::int64_t> Stepper::examine(const event::FrameArrived& e) {
  const FrameInfo& info = e.info;
  const std::size_t n_known = std::min(s_.n_hashes, s_.recent_hashes.size());
  const auto* const begin = s_.recent_hashes.data();
  const bool is_known = std::find(begin, begin + n_known, e.pixel_hash) != begin + n_known;
  s_.recent_hashes[s_.n_hashes % s_.recent_hashes.size()] = e.pixel_hash;
  ++s_.n_hashes;
  const bool is_first = !s_.has_sequence;
  const bool is_forward = is_first || (info.sequence > s_.last_sequence &&
                                       info.timestamp_ns > s_.last_timestamp_ns);
  if (info.timestamp_ns > info.arrival_ns) {
    refuse_timestamp(info);
    return std::nullopt;
  }
  if (!is_forward) {
    ++s_.counters.frames_out_of_order;
    return std::nullopt;
  }
  const bool is_gap = !is_first && info.sequence != s_.last_sequence + 1;
  s_.has_sequence = true;
  s_.last_sequence = info.sequence;
  s_.last_timestamp_ns = info.timestamp_ns;
  s_.camera_faults = 0;
  if (is_gap) {
    ++s_.counters.sequence_gaps;
  }
  const bool is_damaged =
      (info.flags & (kFrameError | kFrameShort)) != 0 || (info.flags & kFrameMonotonic) == 0;
  if (is_damaged) {
    ++s_.counters.frames_damaged;
    if ((info.flags & kFrameSequenceRestart) != 0) {
      s_.rhythm.restart();
    }
    return std::nullopt;
  }
  const std::optional<std::int64_t> guard_ns = examine_rhythm(info);
  if (is_known && e.must_differ) {
    ++s_.counters.duplicates;
    return std::nullopt;
  }
  // Without the strobe's count the timestamp alone decides: a lost neighbour does not matter.
  return is_gap && is_by_strobe() ? std::nullopt : guard_ns;
}

bool Stepper::is_camera_free() const {
  return s_.plan != nullptr && (s_.plan->sync == SyncMode::free_run || is_by_strobe());
}

bool Stepper::is_rhythm_missing() const {
  return is_camera_free() && !s_.plan->is_preview && !s_.pending.empty() &&
         !s_.rhythm.is_known();
}

std::int64_t Stepper::rhythm_patience_ns() const {
  const double frame_us =
      std::max(s_.plan->frame_us, shot_of(s_.pending.front()).exposure_us + s_.plan->skew_us);
  return kRhythmSlackNs + static_cast<std::int64_t>(kRhythmFrames * frame_us * 1e3);
}

std::optional<std::int64_t> Stepper::examine_rhythm(const FrameInfo& info) {
  if (!is_camera_free()) {
    return kGuardNs;  // a triggered frame: the trigger replaces the period
  }
  const FrameRhythm::Verdict verdict =
      s_.rhythm.classify(info.sequence, info.timestamp_ns, info.exposure_us);
  if (verdict.is_learnt_anew) {
    log(session::EventKind::camera,
        fmt::format("the frames up to {} come in another rhythm than those before, "
                    "this one by {:.3f} ms: it is learnt anew",
                    info.sequence, 1e-6 * static_cast<double>(verdict.off_ns)));
  }
  switch (verdict.position) {
    case FrameRhythm::Position::on:
      return verdict.guard_ns;
    case FrameRhythm::Position::learning:
      ++s_.counters.rhythm_unknown;
      return std::nullopt;
    case FrameRhythm::Position::off:
      ++s_.counters.off_rhythm;
      return std::nullopt;
  }
  return std::nullopt;
}

/// Reported once per stream: nothing else would explain why no frame is clean.
void Stepper::refuse_timestamp(const FrameInfo& info) {
  ++s_.counters.timestamps_ahead;
  if (s_.is_timestamp_refused) {
    return;
  }
  s_.is_timestamp_refused = true;
  log(session::EventKind::camera,
      fmt::format("frame {} is timestamped {:.3f} ms after it came: its clock is not "
                  "the host's, or its "
                  "driver computes the timestamp; it is not used",
                  info.sequence,
                  1e-6 * static_cast<double>(info.timestamp_ns - info.arrival_ns)));
}

bool Stepper::is_exposed_as_requested(const FrameInfo& info) {
  const bool is_right =
      !s_.is_exposure_open &&
      std::abs(info.exposure_us - s_.exposure_read_us) <= kExposureTol * s_.exposure_read_us;
  if (!is_right) {
    ++s_.counters.wrong_exposure;
  }
  return is_right;
}

}  // namespace haarlight::capture
