// SPDX-License-Identifier: Apache-2.0
#include "capture/camera/replay_camera.h"

#include <algorithm>
#include <cmath>
#include <memory>

#include <fmt/format.h>

#include "haarlight/core/error.h"

namespace haarlight::capture {

Result<CameraSetup> ReplayCamera::start(const CameraSpec& spec) {
  stop();
  try {
    session_ = session::Session::open(spec.device);
  } catch (const Error& error) {
    return fail(Errc::io, error.what());
  }
  const session::SessionInfo& info = session_->info();
  const bool has_times =
      info.evidence != session::EvidenceKind::asserted &&
      std::all_of(info.frames.begin(), info.frames.end(),
                  [](const session::FrameRecord& frame) {
                    return frame.evidence.kind != session::EvidenceKind::asserted &&
                           frame.evidence.timestamp_ns > 0;
                  });
  if (!has_times || info.form.sample != session::SampleType::u16 || info.form.channels != 1) {
    session_.reset();
    return fail(
        Errc::unsupported,
        fmt::format("replay of {}: its pictures have no measured times, or are not 16-bit "
                    "sensor words; use `haarlight import` for pictures",
                    spec.device));
  }
  frames_ = info.frames;
  std::stable_sort(frames_.begin(), frames_.end(),
                   [](const session::FrameRecord& a, const session::FrameRecord& b) {
                     return a.evidence.timestamp_ns < b.evidence.timestamp_ns;
                   });
  next_ = 0;
  return CameraSetup{.width = info.form.width,
                     .height = info.form.height,
                     .n_buffers = 8,
                     .fps = spec.fps,
                     .exposure_us = frames_.empty() ? spec.exposure_us
                                                    : frames_.front().evidence.exposure_read_us,
                     .gain_db = spec.gain_db,
                     .identity = "session " + info.id};
}

const session::FrameRecord* ReplayCamera::upcoming() const {
  return next_ < frames_.size() ? &frames_[next_] : nullptr;
}

Result<Frame> ReplayCamera::next(std::chrono::steady_clock::time_point /*deadline*/) {
  if (upcoming() == nullptr) {
    return fail(Errc::device_gone, "replay: no more frames");
  }
  const session::FrameRecord& record = frames_[next_++];
  std::shared_ptr<Image<std::uint16_t>> words;
  try {
    const Image<float> rows = session_->read_rows(record, 0, session_->info().form.height);
    words = std::make_shared<Image<std::uint16_t>>(rows.height(), rows.width(), 1);
    std::transform(rows.pixels().begin(), rows.pixels().end(), words->pixels().begin(),
                   [](float x) { return static_cast<std::uint16_t>(std::lround(x)); });
  } catch (const Error& error) {
    return fail(Errc::io, error.what());
  }
  const session::FrameEvidence& e = record.evidence;
  const FrameInfo info{.sequence = e.sequence,
                       .timestamp_ns = e.timestamp_ns,
                       .arrival_ns = e.timestamp_ns,  // not recorded
                       .flags = e.flags,
                       .exposure_us = e.exposure_read_us,
                       .gain_db = e.gain_db};
  const ImageView<const std::uint16_t> view = std::as_const(*words).view();
  return Frame(info, view, [words]() mutable { words.reset(); });
}

Result<double> ReplayCamera::set_exposure(double exposure_us) {
  const session::FrameRecord* record = upcoming();
  return record == nullptr ? exposure_us : record->evidence.exposure_read_us;
}

void ReplayCamera::stop() noexcept {
  session_.reset();
  frames_.clear();
  next_ = 0;
}

}  // namespace haarlight::capture
