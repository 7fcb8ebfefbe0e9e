// SPDX-License-Identifier: Apache-2.0
/// @file
/// What viewers cost, in processor time: nothing while there are none, a copy of a frame
/// five times per second while there are, and what is computed from the copy for each answer.
///
///     build/release/bench/capture/frame_looks [WIDTH HEIGHT]

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <ctime>
#include <thread>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "capture/daemon/frame_tap.h"
#include "capture/daemon/frame_view.h"
#include "capture/daemon/preview_png.h"
#include "core/clock.h"

namespace haarlight {
namespace {

constexpr int kRounds = 21;

/// Of all threads of this process, s.
double processor_seconds() {
  timespec now{};
  ::clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

/// The median processor time of a call, ms.
template <class Work>
double median_ms(Work work) {
  std::vector<double> times;
  for (int i = 0; i < kRounds; ++i) {
    const double begin = processor_seconds();
    work();
    times.push_back(1e3 * (processor_seconds() - begin));
  }
  std::nth_element(times.begin(), times.begin() + kRounds / 2, times.end());
  return times[kRounds / 2];
}

int run(int width, int height) {
  Image<std::uint16_t> words(height, width, 1);
  std::uint64_t i = 0;
  for (std::uint16_t& word : words.pixels()) {
    word = static_cast<std::uint16_t>(static_cast<std::uint64_t>(0x9E3779B97F4A7C15U * ++i) >>
                                      52U);
  }
  const ImageView<const std::uint16_t> pixels = std::as_const(words).view();
  std::size_t sink = 0;

  capture::FrameTap tap;
  constexpr int kFrames = 10'000'000;
  const double idle_ms = median_ms([&] {
    for (int frame = 0; frame < kFrames / kRounds; ++frame) {
      sink += tap.is_wanted(frame) ? 1U : 0U;
    }
  });
  (void)tap.newest();
  const double copy_ms = median_ms([&] {
    const std::uint64_t before = tap.n_copied();
    tap.offer(std::make_shared<const capture::Frame>(capture::FrameInfo{}, pixels, [] {}),
              height, real_clock().now_ns());
    while (tap.n_copied() == before) {
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
  });
  fmt::print("{} x {}\n", width, height);
  fmt::print("nobody looks    {:8.1f} ns per frame\n", 1e6 * idle_ms / (kFrames / kRounds));
  fmt::print("copy            {:8.2f} ms, 5 per second: {:.1f} % of a processor\n", copy_ms,
             0.5 * copy_ms);
  for (const BayerPattern bayer : {BayerPattern::none, BayerPattern::rggb}) {
    const capture::WordScale scale{.clip_dn = 4095.0, .white_dn = 4095.0, .bayer = bayer};
    const PixelRectangle crop{0, 0, std::min(width, 800), std::min(height, 600)};
    const PixelRectangle all{0, 0, width, height};
    fmt::print("{}\n", bayer == BayerPattern::none ? "grey" : "Bayer");
    fmt::print("  overview      {:8.2f} ms\n", median_ms([&] {
                 sink +=
                     capture::encode_preview_png(
                         capture::make_preview_codes(
                             pixels, 0.0, 4095.0, capture::preview_step(width, height, bayer))
                             .view())
                         .size();
               }));
    fmt::print("  crop          {:8.2f} ms\n", median_ms([&] {
                 sink += capture::encode_preview_png(
                             capture::make_crop_codes(pixels, scale, crop).view())
                             .size();
               }));
    for (const PixelRectangle& region : {crop, all}) {
      fmt::print("  facts of {} x {} {:8.2f} ms\n", region.width, region.height, median_ms([&] {
                   sink += capture::count_words(pixels, scale, region)[0].n;
                   sink +=
                       capture::measure_sharpness(pixels, scale, region).value > 1.0 ? 1U : 0U;
                 }));
    }
  }
  return sink == 1 ? 1 : 0;  // the work is not left out
}

}  // namespace
}  // namespace haarlight

int main(int argc, char** argv) {
  const bool has_size = argc == 3;
  return haarlight::run(has_size ? std::atoi(argv[1]) : 2448,
                        has_size ? std::atoi(argv[2]) : 2048);
}
