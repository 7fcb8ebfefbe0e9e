// SPDX-License-Identifier: Apache-2.0
#include "capture/camera/fake_camera.h"

#include <algorithm>

#include "capture/camera/metadata_rows.h"
#include "core/random.h"

namespace haarlight::capture {

namespace {

constexpr int kBuffers = 8;

std::int64_t ns(double us) { return static_cast<std::int64_t>(us * 1e3); }

}  // namespace

FakeCamera::FakeCamera(std::shared_ptr<const firmware_iface::FakeLight> light,
                       std::shared_ptr<FakeCameraHands> hands)
    : light_(std::move(light)), hands_(std::move(hands)), clock_(light_->clock()) {}

FakeCamera::~FakeCamera() = default;

Result<CameraSetup> FakeCamera::start(const CameraSpec& spec) {
  if (hands_->is_gone) {
    return fail(Errc::device_gone, "fake camera: no such device");
  }
  spec_ = spec;
  is_streaming_ = true;
  t0_ns_ = clock_.now_ns();
  sequence_ = 0;
  return CameraSetup{.width = spec.frame_width,
                     .height = spec.frame_height,
                     .n_buffers = kBuffers,
                     .fps = spec.fps,
                     .exposure_us = spec.exposure_us,
                     .gain_db = spec.gain_db,
                     .identity = "fake"};
}

Result<Frame> FakeCamera::next(std::chrono::steady_clock::time_point deadline) {
  const std::int64_t period_ns = ns(1e6 / spec_.fps);
  for (;;) {
    if (hands_->is_gone || !is_streaming_) {
      return fail(Errc::device_gone, "fake camera: unplugged");
    }
    const std::int64_t start_ns = t0_ns_ + static_cast<std::int64_t>(sequence_) * period_ns;
    const std::int64_t end_ns = start_ns + ns(spec_.exposure_us);
    const std::int64_t ready_ns = end_ns + ns(spec_.read_us);
    const std::int64_t deadline_ns =
        std::chrono::duration_cast<std::chrono::nanoseconds>(deadline.time_since_epoch())
            .count();
    const std::int64_t wake_ns =
        hands_->is_silent ? deadline_ns : std::min(ready_ns, deadline_ns);
    clock_.sleep_until(Clock::Time(std::chrono::nanoseconds(wake_ns)));
    if (hands_->is_silent || clock_.now_ns() < ready_ns) {
      if (clock_.now_ns() >= deadline_ns) {
        return fail(Errc::timeout, "fake camera: no frame yet");
      }
      continue;
    }
    const std::uint64_t sequence = sequence_++;
    if (hands_->n_held >= kBuffers) {
      continue;  // lost: all buffers are held
    }
    const auto tag = light_->tag_between(start_ns, end_ns);
    auto words =
        std::make_shared<Image<std::uint16_t>>(spec_.frame_height, spec_.frame_width, 1);
    const int active = spec_.active_rows;
    for (int y = 0; y < active; ++y) {
      for (int x = 0; x < spec_.frame_width; ++x) {
        const std::uint64_t noise =
            hash_key(tag.value_or(0), sequence, static_cast<std::uint64_t>(y),
                     static_cast<std::uint64_t>(x));
        (*words)(y, x) =
            static_cast<std::uint16_t>(256 + 40 * tag.value_or(0) % 8000 + noise % 16);
      }
    }
    if (tag.value_or(0) != 0 && tag.value_or(0) == hands_->clipped_tag) {
      for (int y = 0; y < active; ++y) {
        for (int x = 0; x < spec_.frame_width; x += 2) {
          (*words)(y, x) =
              static_cast<std::uint16_t>((1U << static_cast<unsigned>(spec_.bits)) - 1U);
        }
      }
    }
    if (spec_.frame_height > active) {
      const ImageView<std::uint16_t> rows(&(*words)(active, 0), spec_.frame_height - active,
                                          spec_.frame_width, 1);
      encode_metadata_rows(rows, {.tag = tag.value_or(0), .is_mixed = !tag.has_value()}, 256,
                           12000);
    }
    ++hands_->n_held;
    const FrameInfo info{.sequence = sequence,
                         .timestamp_ns = ready_ns,
                         .arrival_ns = clock_.now_ns(),
                         .flags = kFrameMonotonic,
                         .exposure_us = spec_.exposure_us,
                         .gain_db = spec_.gain_db};
    const ImageView<const std::uint16_t> view = std::as_const(*words).view();
    return Frame(info, view, [words, hands = hands_]() mutable {
      words.reset();
      --hands->n_held;
    });
  }
}

Result<double> FakeCamera::set_exposure(double exposure_us) {
  spec_.exposure_us = exposure_us;
  return exposure_us;
}

void FakeCamera::stop() noexcept { is_streaming_ = false; }

}  // namespace haarlight::capture
