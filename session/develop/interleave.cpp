// SPDX-License-Identifier: Apache-2.0
#include "session/develop/interleave.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>

#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "haarlight/core/line_allocator.h"

#if defined(__x86_64__)
#include <immintrin.h>
#endif

namespace haarlight::session {

namespace {

constexpr std::size_t kBlock = kLightBlock;  // pixels, too

/// Some lights' values at some pixels, (lights, pixels). The pictures' rows lie whole pages
/// apart: read where they are, they would push each other out of the cache.
using Block = std::array<float, kBlock * kBlock>;

/// @param out      of the first light at the first pixel; pixels are n_lights apart
/// @param is_past  past the caches: lines of `out` that are written whole
void write_block(const Block& block, std::size_t n_pixels, std::size_t n, float* out,
                 std::size_t n_lights, bool is_past) {
#if defined(__x86_64__)
  if (n_pixels == kBlock && n == kBlock) {
    const auto put = [is_past](float* to, __m128 four) {
      if (is_past) {
        _mm_stream_ps(to, four);
      } else {
        _mm_storeu_ps(to, four);
      }
    };
    for (std::size_t x = 0; x < kBlock; x += 4) {
      for (std::size_t k = 0; k < kBlock; k += 4) {
        const float* from = block.data() + k * kBlock + x;
        __m128 a = _mm_load_ps(from);
        __m128 b = _mm_load_ps(from + kBlock);
        __m128 c = _mm_load_ps(from + 2 * kBlock);
        __m128 d = _mm_load_ps(from + 3 * kBlock);
        _MM_TRANSPOSE4_PS(a, b, c, d);
        float* to = out + x * n_lights + k;
        put(to, a);
        put(to + n_lights, b);
        put(to + 2 * n_lights, c);
        put(to + 3 * n_lights, d);
      }
    }
    return;
  }
#endif
  static_cast<void>(is_past);
  for (std::size_t x = 0; x < n_pixels; ++x) {
    for (std::size_t k = 0; k < n; ++k) {
      out[x * n_lights + k] = block[k * kBlock + x];
    }
  }
}

/// Whether rows are too many for the caches, and lights' blocks are lines of them: written past
/// the caches, these lines are not read first.
bool is_past_caches(const StackRows& to, std::size_t n_values) {
  constexpr std::size_t kLarge = std::size_t{32} << 20U;  // bytes
  return n_values * sizeof(float) >= kLarge && to.n_lights % kBlock == 0 &&
         reinterpret_cast<std::uintptr_t>(to.values) % kCacheLine == 0;
}

}  // namespace

void interleave(std::span<const Image<float>> pictures, std::size_t skip, std::size_t first,
                const StackRows& to) {
  HAARLIGHT_EXPECTS(!pictures.empty() && pictures.size() <= kLightBlock &&
                        first + pictures.size() <= to.n_lights,
                    "a block of lights");
  const auto width = static_cast<std::size_t>(pictures.front().width());
  const auto channels = static_cast<std::size_t>(pictures.front().channels());
  const bool is_past =
      first % kBlock == 0 && is_past_caches(to, to.rows * width * channels * to.n_lights);
  alignas(64) Block block{};
  for (std::size_t y = 0; y < to.rows; ++y) {
    for (std::size_t c = 0; c < channels; ++c) {
      float* line = to.values + (c * to.rows + y) * width * to.n_lights + first;
      for (std::size_t x = 0; x < width; x += kBlock) {
        const std::size_t n = std::min(kBlock, width - x);
        for (std::size_t k = 0; k < pictures.size(); ++k) {
          const float* from =
              pictures[k].pixels().data() + ((skip + y) * width + x) * channels + c;
          float* into = block.data() + k * kBlock;
          if (channels == 1) {
            std::copy_n(from, n, into);
          } else {
            for (std::size_t i = 0; i < n; ++i) {
              into[i] = from[i * channels];
            }
          }
        }
        write_block(block, n, pictures.size(), line + x * to.n_lights, to.n_lights, is_past);
      }
    }
  }
#if defined(__x86_64__)
  _mm_sfence();  // other threads find what was written past the caches
#endif
}

std::vector<std::uint8_t> interleave_marks(const std::vector<Image<std::uint8_t>>& marks,
                                           std::size_t skip, std::size_t rows,
                                           std::size_t width, std::size_t channels) {
  const std::size_t n_lights = marks.size();
  std::vector<std::uint8_t> out(channels * rows * width * n_lights);
  parallel_for(rows, 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin * n_lights; i < end * n_lights; ++i) {
      const std::size_t y = i / n_lights;
      const std::size_t k = i % n_lights;
      if (marks[k].height() == 0) {
        continue;
      }
      const auto line = marks[k].view().row(static_cast<int>(skip + y));
      if (std::memchr(line.data(), 1, line.size()) == nullptr) {
        continue;
      }
      for (std::size_t j = 0; j < line.size(); ++j) {
        const std::size_t c = j % channels;
        out[((c * rows + y) * width + j / channels) * n_lights + k] = line[j];
      }
    }
  });
  return out;
}

}  // namespace haarlight::session
