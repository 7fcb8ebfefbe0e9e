/// @file
/// The sequencer: the camera, there or not, and what a frame is worth by itself.

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "capture/frame_order.h"
#include "capture/stepper.h"

namespace haarlight {

using namespace sequencing;

void Stepper::on(const event::CameraStarted& e) {
  if (!s_.is_camera_starting || e.stream != s_.stream) {
    return;
  }
  s_.is_camera_starting = false;
  s_.is_camera_started = true;
  s_.is_exposure_open = false;
  s_.has_sequence = false;
  s_.is_stamp_refused = false;
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
  const bool is_usable = is_of_stream && examine(e);
  if (is_by_strobe()) {
    if (is_usable) {
      take_block_frame(e);
    } else {
      ++s_.counters.frames_unused;
      drop(e.frame);
    }
    return;
  }
  const bool has_shot = is_of_stream && s_.phase == Phase::running && s_.current >= 0 &&
                        s_.step != ShotStep::none;
  if (!has_shot || !is_usable) {
    s_.discarded += has_shot ? 1 : 0;
    ++s_.counters.frames_unused;
    drop(e.frame);
  } else if (s_.step == ShotStep::light) {
    if (s_.early.size() >= kMaxEarly) {
      drop(s_.early.front().frame);
      s_.early.erase(s_.early.begin());
      ++s_.counters.frames_unused;
    }
    s_.early.push_back(e);
  } else {
    judge(e);
  }
}

void Stepper::start_camera() {
  s_.retry_camera_ns = kNever;
  if (s_.plan == nullptr) {
    return;
  }
  const int next = s_.pending.empty() ? 0 : s_.pending.front();
  s_.exposure_asked_us = shot_of(next).exposure_us;
  s_.is_camera_starting = true;
  const SyncMode sync = s_.plan->is_preview ? SyncMode::free_run : s_.plan->sync;
  out_.emplace_back(action::StartCamera{++s_.stream, s_.exposure_asked_us, sync});
}

void Stepper::stop_camera() {
  if (s_.is_camera_started || s_.is_camera_starting) {
    out_.emplace_back(action::StopCamera{});
  }
  s_.is_camera_started = false;
  s_.is_camera_starting = false;
  s_.camera_faults = 0;
  s_.retry_camera_ns = kNever;
}

bool Stepper::check_exposure() {
  if (std::abs(s_.exposure_read_us - s_.exposure_asked_us) <=
      kExposureReadTol * s_.exposure_asked_us) {
    return true;
  }
  abort(fmt::format("camera: asked for an exposure of {} us, it set {} us",
                    s_.exposure_asked_us, s_.exposure_read_us));
  return false;
}

bool Stepper::examine(const event::FrameArrived& e) {
  const FrameInfo& info = e.info;
  const std::size_t n_known = std::min(s_.n_hashes, s_.recent_hashes.size());
  const auto* const begin = s_.recent_hashes.data();
  const bool is_known = std::find(begin, begin + n_known, e.pixel_hash) != begin + n_known;
  s_.recent_hashes[s_.n_hashes % s_.recent_hashes.size()] = e.pixel_hash;
  ++s_.n_hashes;
  const bool is_first = !s_.has_sequence;
  const bool is_forward = is_first || (info.sequence > s_.last_sequence &&
                                       info.timestamp_ns > s_.last_timestamp_ns);
  const std::int64_t ahead_ns = info.timestamp_ns - t_;
  if (!is_forward || ahead_ns > kStampAheadNs) {
    ++s_.counters.frames_out_of_order;
    if (ahead_ns > kStampAheadNs) {
      refuse_stamp(info, ahead_ns);
    }
    return false;
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
    return false;
  }
  if (is_known && e.must_differ) {
    ++s_.counters.duplicates;
    return false;
  }
  // Without the strobe's count the stamp alone decides: a lost neighbour takes nothing from it.
  return !is_gap || !is_by_strobe();
}

/// Said once a stream: nothing else would tell why no frame is clean.
void Stepper::refuse_stamp(const FrameInfo& info, std::int64_t ahead_ns) {
  if (s_.is_stamp_refused) {
    return;
  }
  s_.is_stamp_refused = true;
  log("camera",
      fmt::format(
          "frame {} is stamped {:.1f} ms after it came, {:.0f} ms are allowed: its clock "
          "is not the host's, or the stamp means a later moment; it is not used",
          info.sequence, 1e-6 * static_cast<double>(ahead_ns),
          1e-6 * static_cast<double>(kStampAheadNs)));
}

bool Stepper::is_exposed_as_asked(const FrameInfo& info) {
  const bool is_right =
      !s_.is_exposure_open &&
      std::abs(info.exposure_us - s_.exposure_read_us) <= kExposureTol * s_.exposure_read_us;
  if (!is_right) {
    ++s_.counters.wrong_exposure;
  }
  return is_right;
}

}  // namespace haarlight
