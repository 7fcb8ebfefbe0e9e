// SPDX-License-Identifier: Apache-2.0
/// @file
/// How fast packed samples become words, beside a plain copy of the words: first the result is
/// held against memcpy's where the layouts agree, then each packing is timed.
///
///     build/release/bench/capture/pixel_unpack_bench [WIDTH HEIGHT]

#include "capture/camera/pixel_unpack.h"

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <vector>

#include <fmt/format.h>

#include "core/random.h"

namespace haarlight {
namespace {

using Clock = std::chrono::steady_clock;
constexpr int kRounds = 15;

/// The median time of a call, s.
template <class Work>
double median_seconds(Work work) {
  std::vector<double> times;
  for (int i = 0; i < kRounds; ++i) {
    const auto begin = Clock::now();
    work();
    times.push_back(std::chrono::duration<double>(Clock::now() - begin).count());
  }
  std::nth_element(times.begin(), times.begin() + kRounds / 2, times.end());
  return times[kRounds / 2];
}

int run(int width, int height) {
  Image<std::uint16_t> words(height, width, 1);
  const std::size_t n = words.pixels().size();
  std::vector<std::byte> source(n * 4);
  for (std::size_t i = 0; i < source.size(); ++i) {
    source[i] = static_cast<std::byte>(hash_key(1, i));
  }
  (void)capture::unpack_pixels(PixelPacking::words_le, source,
                               static_cast<std::size_t>(width) * 2, words.view());
  if (std::memcmp(words.pixels().data(), source.data(), n * 2) != 0) {
    fmt::print(stderr, "words_le differs from memcpy\n");
    return 1;
  }
  fmt::print("{} x {}, median of {}\n{:<10} {:>8} {:>12} {:>10}\n", width, height, kRounds, "",
             "ms", "Msamples/s", "frames/s");
  const auto print = [&](std::string_view name, double seconds) {
    fmt::print("{:<10} {:>8.3f} {:>12.0f} {:>10.0f}\n", name, seconds * 1e3,
               static_cast<double>(n) / seconds * 1e-6, 1.0 / seconds);
  };
  print("memcpy",
        median_seconds([&] { std::memcpy(words.pixels().data(), source.data(), n * 2); }));
  struct Row {
    std::string_view name;
    PixelPacking packing;
  };
  for (const Row& row :
       {Row{"8 bit", PixelPacking::bytes}, Row{"16 bit", PixelPacking::words_le},
        Row{"16 bit BE", PixelPacking::words_be}, Row{"MIPI 10", PixelPacking::mipi10},
        Row{"MIPI 12", PixelPacking::mipi12}, Row{"MIPI 14", PixelPacking::mipi14},
        Row{"Y10B", PixelPacking::bits10}, Row{"IPU3", PixelPacking::ipu3},
        Row{"YUYV", PixelPacking::luma_even}}) {
    const std::size_t stride = capture::packed_row_bytes(row.packing, width);
    print(row.name, median_seconds([&] {
            (void)capture::unpack_pixels(row.packing, source, stride, words.view());
          }));
  }
  return 0;
}

}  // namespace
}  // namespace haarlight

int main(int argc, char** argv) {
  const int width = argc > 2 ? std::atoi(argv[1]) : 1280;
  const int height = argc > 2 ? std::atoi(argv[2]) : 960;
  return haarlight::run(std::clamp(width, 1, 16384), std::clamp(height, 1, 16384));
}
