// SPDX-License-Identifier: Apache-2.0
#include "capture/camera/v4l2_camera.h"

#include <algorithm>
#include <cmath>
#include <mutex>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "capture/camera/grey_jpeg.h"
#include "capture/camera/pixel_unpack.h"

namespace haarlight::capture {

namespace {

using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;

// Polling interval for drivers without control events: a drifting control may go unnoticed for
// this long.
constexpr milliseconds kControlPeriod{250};
constexpr int kMaxRestarts = 3;       // without a good frame in between
constexpr int kMaxEvents = 64;        // taken per call
constexpr double kFpsTol = 0.01;      // 59.94 counts as 60
constexpr double kPatienceNs = 10e9;  // older on arrival: a wrong timestamp
constexpr std::size_t kWordsBytes = std::size_t{256} << 20U;  // for frames held by callers
constexpr std::size_t kMinFrames = 6;
constexpr std::size_t kMaxFrames = 32;

std::int64_t now_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(Clock::now().time_since_epoch())
      .count();
}

}  // namespace

/// Pool of frame memory held by callers; allocated on first need. Thread-safe.
class V4l2Camera::Words {
 public:
  Words(int height, int width)
      : height_(height),
        width_(width),
        max_(std::clamp(kWordsBytes / (sizeof(std::uint16_t) * static_cast<std::size_t>(width) *
                                       static_cast<std::size_t>(height)),
                        kMinFrames, kMaxFrames)) {}

  [[nodiscard]] std::size_t max() const { return max_; }

  /// Null when the pool is exhausted.
  std::unique_ptr<Image<std::uint16_t>> take() {
    const std::lock_guard lock(mutex_);
    if (!free_.empty()) {
      auto words = std::move(free_.back());
      free_.pop_back();
      return words;
    }
    if (n_made_ >= max_) {
      return nullptr;
    }
    ++n_made_;
    return std::make_unique<Image<std::uint16_t>>(height_, width_, 1);
  }
  void give(std::unique_ptr<Image<std::uint16_t>> words) {
    const std::lock_guard lock(mutex_);
    free_.push_back(std::move(words));
  }

 private:
  const int height_;
  const int width_;
  const std::size_t max_;
  std::mutex mutex_;
  std::vector<std::unique_ptr<Image<std::uint16_t>>> free_;
  std::size_t n_made_ = 0;
};

/// Everything that lives from a start to its stop.
struct V4l2Camera::Stream {
  CameraSpec spec;
  const PixelFormat* format = nullptr;
  V4l2Device device;
  V4l2StreamFormat set;
  double fps = 0.0;
  V4l2Controls controls;
  std::shared_ptr<Words> words;
  FrameOrder order;
  Clock::time_point next_check;
  int restarts_in_a_row = 0;
  int n_unknown = 0;                  ///< frames whose exposure is unknown
  std::int64_t exposed_after_ns = 0;  ///< of the last change of exposure
};

namespace {

/// What is wrong with the format as set, and what the device offers instead.
Fault not_offered(const CameraSpec& spec, const V4l2Device& device, const std::string& found) {
  const auto formats = device.formats();
  return {Errc::unsupported,
          fmt::format("camera \"{}\", {} ({}): \"{}\" {}x{} at {:.4g} fps is not offered{}; it "
                      "offers {}",
                      spec.id, device.node(), device.identity().card, spec.format,
                      spec.frame_width, spec.frame_height, spec.fps, found,
                      formats ? formats_text(*formats) : formats.error().what),
          0, __FILE__, __LINE__};
}

Result<V4l2StreamFormat> choose_format(V4l2Device& device, const CameraSpec& spec,
                                       const PixelFormat& format) {
  auto set = device.set_format(spec.format, spec.frame_width, spec.frame_height);
  if (!set && set.error().code == Errc::unsupported) {
    return tl::unexpected<Fault>(not_offered(spec, device, ""));
  }
  if (!set) {
    return set;
  }
  if (find_pixel_format(set->fourcc) != &format || set->width != spec.frame_width ||
      set->height != spec.frame_height || !set->is_progressive) {
    return tl::unexpected<Fault>(
        not_offered(spec, device,
                    fmt::format(" (it would set \"{}\" {}x{}{})", set->fourcc, set->width,
                                set->height, set->is_progressive ? "" : ", interlaced")));
  }
  const std::size_t row = packed_row_bytes(format.packing, set->width);
  if (format.packing != PixelPacking::motion_jpeg && set->stride < row) {
    return fail(
        Errc::protocol,
        fmt::format("VIDIOC_S_FMT {}: rows of {} bytes, \"{}\" {}x{} needs {}", device.node(),
                    set->stride, set->fourcc, set->width, set->height, row));
  }
  return set;
}

/// Region and format. Which of the two survives setting the other depends on the driver: both
/// orders are tried, and the final values are read back.
Result<V4l2StreamFormat> choose_region(V4l2Device& device, const CameraSpec& spec,
                                       const PixelFormat& format) {
  const auto offered = device.crop();
  if (!offered) {
    return tl::unexpected<Fault>(offered.error());
  }
  if (!spec.v4l2.crop) {
    // An earlier program's region would persist. A driver whose region is read-only has had no
    // other.
    if (*offered && (*offered)->now != (*offered)->usual) {
      const auto reset = device.set_crop((*offered)->usual);
      if (!reset && reset.error().code != Errc::unsupported) {
        return tl::unexpected<Fault>(reset.error());
      }
    }
    return choose_format(device, spec, format);
  }
  if (!*offered) {
    return fail(Errc::unsupported,
                fmt::format("camera \"{}\", {}: its driver takes no region of the sensor; "
                            "leave crop out",
                            spec.id, device.node()));
  }
  const V4l2Rect wanted{(*spec.v4l2.crop)[0], (*spec.v4l2.crop)[1], spec.frame_width,
                        spec.frame_height};
  const V4l2Rect& whole = (*offered)->whole;
  if (wanted.left < whole.left || wanted.top < whole.top ||
      wanted.left + wanted.width > std::int64_t{whole.left} + whole.width ||
      wanted.top + wanted.height > std::int64_t{whole.top} + whole.height) {
    return fail(Errc::unsupported,
                fmt::format("camera \"{}\", {}: the region {} lies outside of the sensor, {}",
                            spec.id, device.node(), region_text(wanted), region_text(whole)));
  }
  V4l2Rect found = wanted;
  for (const bool is_region_first : {true, false}) {
    if (is_region_first) {
      // What took effect is checked below; a refusal may depend on the previous format.
      if (auto set = device.set_crop(wanted); !set && set.error().code == Errc::device_gone) {
        return tl::unexpected<Fault>(set.error());
      }
    }
    auto set = choose_format(device, spec, format);
    if (!set && (!is_region_first || set.error().code != Errc::unsupported)) {
      return set;
    }
    if (!is_region_first) {
      if (auto region = device.set_crop(wanted); !region) {
        return tl::unexpected<Fault>(region.error());
      }
    }
    const auto now = device.crop();
    auto kept =
        now ? device.format() : Result<V4l2StreamFormat>(tl::unexpected<Fault>(now.error()));
    if (!kept) {
      return kept;
    }
    found = *now ? (*now)->now : whole;
    if (set && found == wanted && *kept == *set) {
      return set;
    }
  }
  return fail(Errc::refused,
              fmt::format("camera \"{}\", {}: requested the region {}, it set {}; write a crop "
                          "and a size that it has",
                          spec.id, device.node(), region_text(wanted), region_text(found)));
}

Result<double> choose_fps(V4l2Device& device, const CameraSpec& spec) {
  auto fps = device.set_fps(spec.fps);
  if (!fps && fps.error().code != Errc::unsupported) {
    return fps;
  }
  if (!fps || (*fps > 0.0 && std::abs(*fps - spec.fps) > kFpsTol * spec.fps)) {
    return tl::unexpected<Fault>(
        not_offered(spec, device, fps ? fmt::format(" (it would give {:.4g} fps)", *fps) : ""));
  }
  return fps;
}

}  // namespace

V4l2Camera::V4l2Camera(V4l2Paths paths) : paths_(std::move(paths)) {}

V4l2Camera::~V4l2Camera() { stop(); }

Result<V4l2Camera::Stream> V4l2Camera::open_stream(const CameraSpec& spec) {
  const PixelFormat* format = find_pixel_format(spec.format);
  if (format == nullptr) {
    return fail(Errc::unsupported,
                fmt::format("camera \"{}\": no pixel format \"{}\"", spec.id, spec.format));
  }
  auto device = find_v4l2_camera(spec.device, identity_, spec.v4l2.serial, paths_);
  if (!device) {
    return tl::unexpected<Fault>(device.error());
  }
  auto set = choose_region(*device, spec, *format);
  if (!set) {
    return tl::unexpected<Fault>(set.error());
  }
  const auto fps = choose_fps(*device, spec);
  if (!fps) {
    return tl::unexpected<Fault>(fps.error());
  }
  const auto offered = device->controls();
  if (!offered) {
    return tl::unexpected<Fault>(offered.error());
  }
  auto controls = V4l2Controls::choose(*offered, spec, trigger_);
  if (!controls) {
    return tl::unexpected<Fault>(controls.error());
  }
  if (auto done = controls->apply(*device); !done) {
    return tl::unexpected<Fault>(done.error());
  }
  if (const auto watched = device->watch_source(); !watched) {
    return tl::unexpected<Fault>(watched.error());
  }
  if (const auto made = device->make_buffers(spec.v4l2.n_buffers); !made) {
    return tl::unexpected<Fault>(made.error());
  }
  const bool has_rows = format->packing != PixelPacking::motion_jpeg;
  const std::size_t needed =
      has_rows ? packed_frame_bytes(format->packing, set->width, set->height, set->stride) : 1;
  if (device->buffer_bytes() < needed) {
    return fail(Errc::protocol, fmt::format("{}: buffers of {} bytes, a frame has {}",
                                            device->node(), device->buffer_bytes(), needed));
  }
  if (auto on = device->stream_on(); !on) {
    return tl::unexpected<Fault>(on.error());
  }
  // Some cameras reset their controls when streaming starts.
  if (auto kept = controls->verify(*device); !kept) {
    auto again = kept.error().code == Errc::io ? controls->apply(*device) : kept;
    again = again ? controls->verify(*device) : again;
    if (!again) {
      return tl::unexpected<Fault>(again.error());
    }
  }
  const double frame_us = std::max(1e6 / spec.fps, controls->exposure_us());
  const double patience_ns = std::max(kPatienceNs, 4e3 * frame_us);
  Stream stream{.spec = spec,
                .format = format,
                .device = *std::move(device),
                .set = *std::move(set),
                .fps = *fps > 0.0 ? *fps : spec.fps,
                .controls = *std::move(controls),
                .words = std::make_shared<Words>(spec.frame_height, spec.frame_width),
                .order = FrameOrder(static_cast<std::int64_t>(patience_ns)),
                .next_check = Clock::now() + kControlPeriod,
                .exposed_after_ns = now_ns()};
  stream.n_unknown = stream.controls.can_set_exposure() ? spec.exposure_delay_frames + 1 : 0;
  return stream;
}

Result<CameraSetup> V4l2Camera::start(const CameraSpec& spec) {
  stop();
  auto opened = open_stream(spec);
  if (!opened) {
    return tl::unexpected<Fault>(opened.error());
  }
  counters_.reopenings += identity_ ? 1 : 0;
  identity_ = opened->device.identity();
  stream_ = std::make_unique<Stream>(*std::move(opened));
  return CameraSetup{.width = stream_->set.width,
                     .height = stream_->set.height,
                     .n_buffers = static_cast<int>(stream_->words->max()),
                     .fps = stream_->fps,
                     .exposure_us = stream_->controls.exposure_us(),
                     .gain_db = stream_->controls.gain_db(),
                     .use = stream_->format->use,
                     .identity = identity_text(*identity_)};
}

Result<void> V4l2Camera::set_trigger(TriggerSource source) {
  trigger_ = source;
  return {};
}

Result<void> V4l2Camera::trigger() {
  if (stream_ == nullptr) {
    return fail(Errc::device_gone, "V4L2 camera: not started");
  }
  auto fired = stream_->controls.fire(stream_->device);
  if (!fired && fired.error().code != Errc::device_busy) {  // busy: with the previous frame
    return give_up(fired.error());
  }
  return {};
}

void V4l2Camera::stop() noexcept {
  if (stream_ != nullptr) {
    (void)stream_->device.stream_off();
  }
  stream_.reset();
}

tl::unexpected<Fault> V4l2Camera::give_up(Fault fault) {
  if (fault.code == Errc::device_gone) {
    stop();
  }
  return tl::unexpected<Fault>(std::move(fault));
}

Result<Frame> V4l2Camera::next(Clock::time_point deadline) {
  if (stream_ == nullptr) {
    return fail(Errc::device_gone, "V4L2 camera: not started");
  }
  do {
    if (auto good = check_controls(); !good) {
      return give_up(good.error());
    }
    const auto ready = stream_->device.wait(deadline);
    if (!ready) {
      return give_up(ready.error());
    }
    if (ready->has_event) {  // before the frames: those after the change are not used
      if (auto good = take_events(); !good) {
        return give_up(good.error());
      }
    }
    if (ready->has_frame) {
      auto frame = take_frame();
      if (!frame) {
        return give_up(frame.error());
      }
      if (*frame) {
        ++counters_.frames;
        return **std::move(frame);
      }
    } else if (ready->has_error) {
      const auto present = stream_->device.check_presence();
      auto again =
          restart(present ? Fault{Errc::io, "poll: the stream broke"} : present.error());
      if (!again) {
        return give_up(again.error());
      }
    }
  } while (Clock::now() < deadline);
  return fail(Errc::timeout,
              fmt::format("{}: no frame before the deadline", stream_->device.node()));
}

Result<void> V4l2Camera::check_controls() {
  if (Clock::now() < stream_->next_check) {
    return {};
  }
  stream_->next_check = Clock::now() + kControlPeriod;
  return stream_->controls.verify(stream_->device);
}

Result<void> V4l2Camera::take_events() {
  for (int i = 0; i < kMaxEvents; ++i) {
    const auto event = stream_->device.take_event();
    if (!event) {
      Fault fault = event.error();
      fault.code = fault.code == Errc::device_gone ? fault.code : Errc::io;
      return tl::unexpected<Fault>(std::move(fault));
    }
    if (event->kind == V4l2Event::Kind::none) {
      return {};
    }
    if (auto good = stream_->controls.validate(*event); !good) {
      return good;
    }
  }
  return {};
}

Result<std::optional<Frame>> V4l2Camera::take_frame() {
  const auto filled = stream_->device.dequeue();
  if (!filled && filled.error().code == Errc::timeout) {
    return std::optional<Frame>();
  }
  if (!filled) {
    return restart(filled.error()).map([] { return std::optional<Frame>(); });
  }
  auto frame = copy_out(*filled);
  if (auto given = stream_->device.queue(filled->index); !given) {
    return restart(given.error()).map([] { return std::optional<Frame>(); });
  }
  return frame;
}

Result<std::optional<Frame>> V4l2Camera::copy_out(const V4l2Filled& filled) {
  FrameInfo info = describe(filled);
  auto words = stream_->words->take();
  if (words == nullptr) {
    ++counters_.pool_exhausted;  // the next frame's number reveals the gap
    return std::optional<Frame>();
  }
  const ImageView<std::uint16_t> view = words->view();
  const PixelPacking packing = stream_->format->packing;
  bool has_pixels = false;
  if (packing == PixelPacking::motion_jpeg) {
    has_pixels = decode_grey_jpeg(filled.bytes, view);
  } else if (filled.bytes.size() >=
             packed_frame_bytes(packing, view.width(), view.height(), stream_->set.stride)) {
    const std::uint16_t all = unpack_pixels(packing, filled.bytes, stream_->set.stride, view);
    const unsigned white = (1U << static_cast<unsigned>(stream_->spec.bits)) - 1U;
    if (all > white && is_depth_proven_) {
      info.flags |= kFrameError;  // not a wrong setting then, but an invalid frame
    } else if (all > white) {
      stream_->words->give(std::move(words));
      return fail(Errc::unsupported,
                  fmt::format("{}: samples up to {}, but {} bits end at {}: the driver puts "
                              "them into the high bits; write bits = 16, or another format",
                              stream_->device.node(), all, stream_->spec.bits, white));
    }
    // Bits in the high part of a word would be lost here.
    const unsigned low_bits = (1U << static_cast<unsigned>(16 - stream_->spec.bits)) - 1U;
    is_depth_proven_ = is_depth_proven_ || (all <= white && (all & low_bits) != 0);
    has_pixels = true;
  }
  std::shared_ptr<Image<std::uint16_t>> shared(
      words.release(), [pool = stream_->words](Image<std::uint16_t>* image) {
        pool->give(std::unique_ptr<Image<std::uint16_t>>(image));
      });
  if (!has_pixels) {
    info.flags |= kFrameShort;
    return std::optional<Frame>(Frame(info, {}, {}));
  }
  if ((info.flags & kFrameError) == 0) {
    stream_->restarts_in_a_row = 0;
  }
  const ImageView<const std::uint16_t> pixels = std::as_const(*shared).view();
  return std::optional<Frame>(Frame(info, pixels, [shared]() mutable { shared.reset(); }));
}

FrameInfo V4l2Camera::describe(const V4l2Filled& filled) {
  const FrameOrder::Verdict verdict =
      stream_->order.classify(filled.sequence, filled.timestamp_ns, filled.arrival_ns);
  FrameInfo info{.sequence = verdict.sequence,
                 .timestamp_ns = filled.timestamp_ns,
                 .arrival_ns = filled.arrival_ns,
                 .flags = 0,
                 .exposure_us = stream_->controls.exposure_us(),
                 .gain_db = stream_->controls.gain_db()};
  const auto flag = [&](bool is_set, std::uint32_t bits) { info.flags |= is_set ? bits : 0U; };
  flag(filled.is_error, kFrameError);
  flag(filled.is_monotonic, kFrameMonotonic);
  flag(filled.is_timestamped_at_start, kFrameTimestampedAtStart);
  flag(verdict.is_timestamp_jump, kFrameTimestampJump | kFrameError);
  flag(verdict.is_restart, kFrameSequenceRestart | kFrameError);
  const bool is_before = filled.timestamp_ns <= stream_->exposed_after_ns;
  if (stream_->n_unknown > 0) {
    info.exposure_us = 0.0;
    stream_->n_unknown -= is_before ? 0 : 1;
  }
  return info;
}

Result<void> V4l2Camera::restart(const Fault& why) {
  if (why.code == Errc::device_gone) {
    return tl::unexpected<Fault>(why);
  }
  ++counters_.io_errors;
  if (++stream_->restarts_in_a_row > kMaxRestarts) {
    return fail(Errc::io,
                fmt::format("{}; streaming anew {} times did not help", why.what, kMaxRestarts),
                why.sys_errno);
  }
  ++counters_.restarts;
  V4l2Device& device = stream_->device;
  auto done = device.stream_off();
  done = done ? device.queue_all() : done;
  done = done ? device.stream_on() : done;
  if (!done) {
    Fault fault = done.error();
    fault.code = fault.code == Errc::device_gone ? fault.code : Errc::io;
    return tl::unexpected<Fault>(std::move(fault));
  }
  stream_->order.restart();
  return {};
}

Result<double> V4l2Camera::set_exposure(double exposure_us) {
  if (stream_ == nullptr) {
    return fail(Errc::device_gone, "V4L2 camera: not started");
  }
  auto set = stream_->controls.set_exposure(stream_->device, exposure_us);
  if (!set) {
    return give_up(set.error());
  }
  if (stream_->controls.can_set_exposure()) {
    stream_->exposed_after_ns = now_ns();
    // The frame being exposed, and those that still have the old value.
    stream_->n_unknown = stream_->spec.exposure_delay_frames + 1;
  }
  return set;
}

}  // namespace haarlight::capture
