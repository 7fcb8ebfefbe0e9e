// SPDX-License-Identifier: Apache-2.0
#include "capture/commission/commission_bench.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <thread>

#include <fmt/format.h>

#include "capture/commission/light_survey.h"
#include "core/order_statistics.h"
#include "haarlight/core/error.h"

namespace haarlight::capture {

namespace {

constexpr int kMaxBands = 64;
constexpr int kMaxBandRows = 4;    // thin: a band's own skew must not smear a step
constexpr int kPeriodFrames = 24;  // to measure the frame period from
constexpr std::uint32_t kFirstTag = 0x43000000;
constexpr std::int64_t kQuietNs =
    2'000'000;  // before a step: waiting for frames can overrun by a ms
constexpr std::int64_t kPatience = 2'000'000'000;  // without a frame, in addition to 10 periods

std::chrono::steady_clock::time_point time_point(std::int64_t t_ns) {
  return std::chrono::steady_clock::time_point(std::chrono::nanoseconds(t_ns));
}

std::vector<RowBand> make_bands(int rows) {
  std::vector<RowBand> bands;
  const int n = std::min(rows, kMaxBands);
  const int height = std::clamp(rows / kMaxBands, 1, kMaxBandRows);
  for (int i = 0; i < n; ++i) {
    RowBand band;
    band.count = height;
    band.first =
        n > 1
            ? static_cast<int>(std::lround(static_cast<double>(i) * (rows - height) / (n - 1)))
            : 0;
    band.position =
        rows > 1 ? (band.first + 0.5 * (height - 1)) / static_cast<double>(rows - 1) : 0.0;
    bands.push_back(band);
  }
  return bands;
}

}  // namespace

CommissionClock monotonic_clock() {
  return {[] {
            return std::chrono::duration_cast<std::chrono::nanoseconds>(
                       std::chrono::steady_clock::now().time_since_epoch())
                .count();
          },
          [](std::int64_t t_ns) { std::this_thread::sleep_until(time_point(t_ns)); }};
}

CommissionBench::CommissionBench(const Rig& rig, int camera, Camera& device,
                                 firmware_iface::LightArray& lights, CommissionClock clock,
                                 std::function<bool()> should_stop)
    : rig_(rig),
      camera_index_(camera),
      spec_(rig.cameras.at(static_cast<std::size_t>(camera))),
      camera_(device),
      lights_(lights),
      clock_(std::move(clock)),
      should_stop_(std::move(should_stop)),
      bands_(make_bands(spec_.active_rows)),
      tag_(kFirstTag) {
  choose_order();
}

CommissionBench::~CommissionBench() {
  // Dark, whatever happened before. If this fails too, the controller's lease turns the lights
  // off.
  if (!lights_.all_off()) {
    static_cast<void>(lights_.all_off());
  }
  camera_.stop();
  lights_.disconnect();
}

template <class T>
T CommissionBench::demand(Result<T> result, const char* what) {
  if (!result) {
    const Fault& fault = result.error();
    const char* hint =
        fault.code == Errc::device_gone ? "is it connected, switched on and not in use? "
                                          "haarlight rig doctor tells"
        : fault.code == Errc::refused   ? "the controller's limits are below those of the rig "
                                          "file: correct max_watts"
                                        : "haarlight rig doctor tells what is wrong";
    throw Error(fmt::format("{}: {} ({})", what, fault.what, to_string(fault.code)),
                rig_.file.string(), hint, ExitCode::unavailable);
  }
  return *std::move(result);
}

void CommissionBench::demand_void(const Result<void>& result, const char* what) {
  if (!result) {
    (void)demand<int>(tl::unexpected<Fault>(result.error()), what);
  }
}

void CommissionBench::check_stop() const {
  if (should_stop_ && should_stop_()) {
    throw Error("stopped; the lights are off", rig_.file.string(), "start again when ready",
                ExitCode::interrupted);
  }
}

void CommissionBench::keep_lease() {
  const std::int64_t now = now_ns();
  const std::int64_t lease =
      std::chrono::duration_cast<std::chrono::nanoseconds>(rig_.controller.lease).count();
  if (now - lease_ns_ > lease / 4) {
    demand_void(lights_.renew_lease(), "renewing the lights' lease");
    lease_ns_ = now;
  }
}

void CommissionBench::choose_order() {
  const std::vector<double> expected = expected_signals(rig_, camera_index_);
  std::vector<int> order(expected.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) {
    return expected[static_cast<std::size_t>(a)] > expected[static_cast<std::size_t>(b)];
  });
  // As many as each face's supply carries at full drive.
  std::vector<double> left;
  left.reserve(rig_.faces.size());
  for (const Face& face : rig_.faces) {
    left.push_back(face.max_power.value());
  }
  for (const int k : order) {
    const auto face = static_cast<std::size_t>(light_element(rig_, k).face);
    const double watts = rig_.faces[face].element_power.value();
    if (watts <= left[face]) {
      left[face] -= watts;
      order_.push_back(k);
    }
  }
  n_allowed_ = static_cast<int>(order_.size());
}

LightPattern CommissionBench::brightest(int n) const {
  LightPattern pattern;
  for (int i = 0; i < std::min(n, n_allowed_); ++i) {
    pattern.push_back(
        {order_[static_cast<std::size_t>(i)], firmware_iface::registers::kMaxLevel});
  }
  std::sort(pattern.begin(), pattern.end(),
            [](const firmware_iface::ElementLevel& a, const firmware_iface::ElementLevel& b) {
              return a.element < b.element;
            });
  return pattern;
}

void CommissionBench::open(double exposure_us) {
  controller_ = demand(lights_.connect(), "connecting the light controller");
  if (controller_.n_elements != rig_.n_lights()) {
    throw Error(fmt::format("the controller has {} elements, the rig file {} lights",
                            controller_.n_elements, rig_.n_lights()),
                rig_.file.string(), "correct rows and cols of [[face]], or the address");
  }
  (void)demand(lights_.all_off(), "switching all lights off");
  lease_ns_ = now_ns();
  spec_.exposure_us = exposure_us;
  setup_ = demand(camera_.start(spec_), "starting the camera");
  if (setup_.use != PixelUse::measurement) {
    throw Error("format " + spec_.format + " is not linear in light: nothing can be measured",
                rig_.file.string(), "choose a raw format (docs/reference/cameras.md)");
  }
  exposure_us_ = setup_.exposure_us;
  period_us_ = 1e6 / (setup_.fps > 0.0 ? setup_.fps : spec_.fps);
  measure_period();
}

void CommissionBench::measure_period() {
  std::vector<double> periods;
  std::uint64_t last_sequence = 0;
  std::int64_t last_timestamp = 0;
  for (int i = 0; i < kPeriodFrames; ++i) {
    const ArrivedFrame arrived = next_frame();
    const FrameInfo& info = arrived.frame.info();
    if ((info.flags & kFrameMonotonic) == 0U) {
      throw Error(
          "the camera's timestamps are not CLOCK_MONOTONIC: nothing can be told from them",
          spec_.device, "use a driver whose timestamps are CLOCK_MONOTONIC",
          ExitCode::unavailable);
    }
    if (i > 0 && info.sequence > last_sequence) {
      periods.push_back(static_cast<double>(info.timestamp_ns - last_timestamp) / 1e3 /
                        static_cast<double>(info.sequence - last_sequence));
    }
    last_sequence = info.sequence;
    last_timestamp = info.timestamp_ns;
  }
  if (periods.empty()) {
    throw Error("the camera's sequence numbers stand still", spec_.device,
                "haarlight rig doctor tells what is wrong", ExitCode::unavailable);
  }
  period_us_ = upper_median(periods);
}

firmware_iface::LatchReceipt CommissionBench::show(const LightPattern& pattern) {
  check_stop();
  const std::int64_t called = now_ns();
  const firmware_iface::LatchReceipt receipt =
      demand(lights_.show(pattern, ++tag_), pattern.empty() ? "going dark" : "lighting");
  if (receipt.tag_echo != tag_) {
    throw Error("the controller does not echo the tag that was shown", rig_.file.string(),
                "another program controls the lights: stop it", ExitCode::unavailable);
  }
  lease_ns_ = now_ns();
  leads_.push_back((receipt.t_command_ns + receipt.t_ack_ns) / 2 - called);
  if (leads_.size() > 15) {
    leads_.erase(leads_.begin());
  }
  return receipt;
}

std::int64_t CommissionBench::lead_ns() const {
  if (leads_.empty()) {
    return 0;
  }
  std::vector<std::int64_t> leads = leads_;
  return upper_median(leads);
}

ArrivedFrame CommissionBench::next_frame() {
  const std::int64_t give_up =
      now_ns() + kPatience + static_cast<std::int64_t>(1e4 * period_us_);
  for (;;) {
    check_stop();
    keep_lease();
    const std::int64_t slice = now_ns() + 100'000'000;
    Result<Frame> frame = camera_.next(time_point(slice));
    const std::int64_t arrival = now_ns();
    if (frame) {
      if ((frame->info().flags & (kFrameError | kFrameShort)) != 0U) {
        continue;
      }
      last_timestamp_ns_ = frame->info().timestamp_ns;
      return {*std::move(frame), arrival};
    }
    if (frame.error().code != Errc::timeout || arrival > give_up) {
      (void)demand<int>(tl::unexpected<Fault>(frame.error()), "waiting for a frame");
    }
  }
}

void CommissionBench::drain_until(std::int64_t t_ns) {
  const std::int64_t last_ns = t_ns - kQuietNs;
  while (now_ns() < last_ns) {
    check_stop();
    keep_lease();
    Result<Frame> frame =
        camera_.next(time_point(std::min(last_ns, now_ns() + std::int64_t{100'000'000})));
    if (frame) {
      last_timestamp_ns_ = frame->info().timestamp_ns;
    } else if (frame.error().code != Errc::timeout) {
      (void)demand<int>(tl::unexpected<Fault>(frame.error()), "waiting for a frame");
    }
  }
  clock_.sleep_until_ns(t_ns);
}

double CommissionBench::set_exposure(double exposure_us, std::int64_t* before_ns,
                                     std::int64_t* after_ns) {
  check_stop();
  keep_lease();
  const std::int64_t before = now_ns();
  exposure_us_ = demand(camera_.set_exposure(exposure_us), "setting the exposure");
  const std::int64_t after = now_ns();
  if (before_ns != nullptr) {
    *before_ns = before;
  }
  if (after_ns != nullptr) {
    *after_ns = after;
  }
  return exposure_us_;
}

void CommissionBench::settle() {
  const auto wait =
      static_cast<std::int64_t>(1e3 * (settle_frames_ * period_us_ + exposure_us_));
  const std::int64_t until = now_ns() + wait;
  while (next_frame().frame.info().timestamp_ns < until) {
  }
}

std::vector<double> CommissionBench::band_means(const Frame& frame) const {
  const ImageView<const std::uint16_t> pixels = frame.pixels();
  std::vector<double> means;
  means.reserve(bands_.size());
  for (const RowBand& band : bands_) {
    std::uint64_t sum = 0;
    std::size_t n = 0;
    for (int y = band.first; y < band.first + band.count; ++y) {
      for (const std::uint16_t word : pixels.row(y)) {
        sum += word;
      }
      n += pixels.row(y).size();
    }
    means.push_back(static_cast<double>(sum) / static_cast<double>(n));
  }
  return means;
}

SteadyLevel CommissionBench::look_steady(const LightPattern& pattern, int n_frames) {
  (void)show(pattern);
  settle();
  SteadyLevel level;
  level.bands.assign(bands_.size(), 0.0);
  std::vector<double> squares(bands_.size(), 0.0);
  for (int i = 0; i < n_frames; ++i) {
    const ArrivedFrame arrived = next_frame();
    const std::vector<double> means = band_means(arrived.frame);
    for (std::size_t b = 0; b < means.size(); ++b) {
      level.bands[b] += means[b] / n_frames;
      squares[b] += means[b] * means[b] / n_frames;
    }
    if (i == 0) {
      const ImageView<const std::uint16_t> pixels = arrived.frame.pixels();
      std::vector<std::uint16_t> words;
      const int stride = std::max(1, spec_.active_rows * pixels.width() / 200000);
      for (int y = 0; y < spec_.active_rows; ++y) {
        const auto row = pixels.row(y);
        for (auto x = static_cast<std::size_t>(y % stride); x < row.size();
             x += static_cast<std::size_t>(stride)) {
          words.push_back(row[x]);
        }
      }
      level.low_level = quantile(words, 0.25);
      level.median = quantile(words, 0.5);
      level.high_level = quantile(words, 0.99);
    }
  }
  double pooled = 0.0;
  for (std::size_t b = 0; b < bands_.size(); ++b) {
    pooled += std::max(0.0, squares[b] - level.bands[b] * level.bands[b]);
  }
  const double unbiased = n_frames > 1 ? static_cast<double>(n_frames) / (n_frames - 1) : 1.0;
  level.frame_scatter = std::sqrt(unbiased * pooled / static_cast<double>(bands_.size()));
  return level;
}

}  // namespace haarlight::capture
