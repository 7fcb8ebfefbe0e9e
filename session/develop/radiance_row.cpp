// SPDX-License-Identifier: Apache-2.0
#include "session/develop/radiance_row.h"

#include "core/vector_clones.h"
#include "haarlight/core/error.h"

#define HAARLIGHT_WIDER HAARLIGHT_CLONES("arch=x86-64-v4", "avx2")

namespace haarlight::session {

namespace {

/// One sample's electrons, and those at which it is clipped.
struct Electrons {
  double seen;
  double clip;
};

[[gnu::always_inline]] inline Electrons electrons_of(const FrameScale& scale, float dn,
                                                     float linear, double dark) {
  const double clip = (scale.clip_linear - dark) * scale.electrons_per_step;
  const double seen = (double{linear} - dark) * scale.electrons_per_step;
  const double at_least = seen < clip ? clip : seen;
  return {double{dn} >= scale.clip_dn ? at_least : seen, clip};
}

/// @param dark, flat  asked only where there is one: clones are made of plain functions alone, so
/// that the four below name the cases
template <bool kHasDark, bool kHasFlat>
[[gnu::always_inline]] inline std::size_t row_of(const FrameScale& given,
                                                 const float* __restrict dn,
                                                 const float* __restrict linear,
                                                 const float* __restrict dark,
                                                 const double* __restrict flat, std::size_t n,
                                                 float* __restrict values) {
  const FrameScale scale = given;
  std::int64_t n_clipped = 0;
  for (std::size_t i = 0; i < n; ++i) {
    double dark_level = 0.0;
    if constexpr (kHasDark) {
      dark_level = double{dark[i]};
    }
    const Electrons e = electrons_of(scale, dn[i], linear[i], dark_level);
    double per_unit = scale.per_unit;
    if constexpr (kHasFlat) {
      per_unit *= flat[i];
    }
    values[i] = static_cast<float>(e.seen / per_unit);
    n_clipped += e.seen >= e.clip ? 1 : 0;
  }
  return static_cast<std::size_t>(n_clipped);
}

HAARLIGHT_WIDER std::size_t plain_row(const FrameScale& scale, const float* __restrict dn,
                                      const float* __restrict linear, std::size_t n,
                                      float* __restrict values) {
  return row_of<false, false>(scale, dn, linear, nullptr, nullptr, n, values);
}

HAARLIGHT_WIDER std::size_t dark_row(const FrameScale& scale, const float* __restrict dn,
                                     const float* __restrict linear,
                                     const float* __restrict dark, std::size_t n,
                                     float* __restrict values) {
  return row_of<true, false>(scale, dn, linear, dark, nullptr, n, values);
}

HAARLIGHT_WIDER std::size_t flat_row(const FrameScale& scale, const float* __restrict dn,
                                     const float* __restrict linear,
                                     const double* __restrict flat, std::size_t n,
                                     float* __restrict values) {
  return row_of<false, true>(scale, dn, linear, nullptr, flat, n, values);
}

HAARLIGHT_WIDER std::size_t full_row(const FrameScale& scale, const float* __restrict dn,
                                     const float* __restrict linear,
                                     const float* __restrict dark,
                                     const double* __restrict flat, std::size_t n,
                                     float* __restrict values) {
  return row_of<true, true>(scale, dn, linear, dark, flat, n, values);
}

HAARLIGHT_WIDER void widen_bytes(const std::uint8_t* __restrict samples, std::size_t n,
                                 float* __restrict to) {
  for (std::size_t i = 0; i < n; ++i) {
    to[i] = static_cast<float>(samples[i]);
  }
}
HAARLIGHT_WIDER void widen_words(const std::uint16_t* __restrict samples, std::size_t n,
                                 float* __restrict to) {
  for (std::size_t i = 0; i < n; ++i) {
    to[i] = static_cast<float>(samples[i]);
  }
}

}  // namespace

std::size_t radiance_of_row(const FrameScale& scale, const SampleRow& row, float* values) {
  const std::size_t n = row.linear.size();
  HAARLIGHT_EXPECTS(row.dn.size() == n && (row.dark.empty() || row.dark.size() == n) &&
                        (row.flat.empty() || row.flat.size() == n),
                    "one correction per sample");
  const float* dn = row.dn.data();
  const float* linear = row.linear.data();
  if (row.dark.empty()) {
    return row.flat.empty() ? plain_row(scale, dn, linear, n, values)
                            : flat_row(scale, dn, linear, row.flat.data(), n, values);
  }
  return row.flat.empty()
             ? dark_row(scale, dn, linear, row.dark.data(), n, values)
             : full_row(scale, dn, linear, row.dark.data(), row.flat.data(), n, values);
}

void mark_clipped(const FrameScale& scale, const SampleRow& row, std::uint8_t* marks) {
  for (std::size_t i = 0; i < row.linear.size(); ++i) {
    const Electrons e = electrons_of(scale, row.dn[i], row.linear[i],
                                     row.dark.empty() ? 0.0 : double{row.dark[i]});
    marks[i] = e.seen >= e.clip ? 1 : 0;
  }
}

void widen(std::span<const std::uint8_t> samples, float* to) {
  widen_bytes(samples.data(), samples.size(), to);
}
void widen(std::span<const std::uint16_t> samples, float* to) {
  widen_words(samples.data(), samples.size(), to);
}

}  // namespace haarlight::session
