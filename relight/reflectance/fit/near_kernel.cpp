// SPDX-License-Identifier: Apache-2.0
#include "relight/reflectance/fit/near_kernel.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numbers>
#include <utility>

#include "relight/reflectance/fit/wide_vectors.h"

#if HAARLIGHT_FIT_X86
#include <immintrin.h>
#endif

namespace haarlight::relight {

namespace {

/// The loops for one width of vector.
struct NearLoops {
  void (*columns)(const NearForm& form, const NearSource& light, const NearBlock& block,
                  const std::uint16_t* codes, float* columns);
  void (*gains)(const NearSource& light, const NearBlock& block, float* gains);
  void (*values)(const float* gains, const std::uint16_t* codes, bool is_coded, float* values);
  void (*bent)(const float* gains, std::size_t gain_stride, const std::uint16_t* codes,
               std::size_t code_stride, std::size_t n_lights, bool is_coded, float* values);
  void (*products)(const float* columns, std::size_t n_lights, std::size_t n_padded,
                   float* sums);
  void (*solve)(const float* sums, const double* ridge, std::size_t n_terms, float* planes);
  void (*between)(const float* starts, const float* steps, std::size_t n_terms,
                  std::size_t n_lights, const float* values, float* sums);
  void (*mix)(const std::array<const float*, 4>& from, const std::array<float, 4>& weights,
              std::size_t n, float* out);
  void (*subtract)(const float* a, const float* b, std::size_t n, float* out);
};

/// Pixels' centres along a block, 1 at the end of the first step.
static_assert(kNearBlock == 2 * kNearStep);
constexpr std::array<float, kNearBlock> kStepPositions = [] {
  std::array<float, kNearBlock> positions{};
  for (std::size_t k = 0; k < kNearBlock; ++k) {
    positions[k] = (static_cast<float>(k) + 0.5F) / static_cast<float>(kNearStep);
  }
  return positions;
}();

namespace portable {
#define HAARLIGHT_LANES 4
#include "relight/reflectance/fit/near_loops.inc"
#undef HAARLIGHT_LANES
}  // namespace portable

#if HAARLIGHT_FIT_X86
namespace avx2 {
#define HAARLIGHT_LANES 8
#include "relight/reflectance/fit/near_loops.inc"
#undef HAARLIGHT_LANES
}  // namespace avx2

namespace avx512 {
#define HAARLIGHT_LANES 16
#include "relight/reflectance/fit/near_loops.inc"
#undef HAARLIGHT_LANES
}  // namespace avx512
#endif

const NearLoops& loops() {
  switch (vector_width()) {
#if HAARLIGHT_FIT_X86
    case VectorWidth::avx512:
      return avx512::kLoops;
    case VectorWidth::avx2:
      return avx2::kLoops;
#endif
    default:
      return portable::kLoops;
  }
}

}  // namespace

void near_columns(const NearForm& form, const NearSource& light, const NearBlock& block,
                  const std::uint16_t* codes, float* columns) {
  loops().columns(form, light, block, codes, columns);
}

void near_gains(const NearSource& light, const NearBlock& block, float* gains) {
  loops().gains(light, block, gains);
}

void near_values(const float* gains, const std::uint16_t* codes, bool is_coded, float* values) {
  loops().values(gains, codes, is_coded, values);
}

void bent_near_values(const float* gains, std::size_t gain_stride, const std::uint16_t* codes,
                      std::size_t code_stride, std::size_t n_lights, bool is_coded,
                      float* values) {
  loops().bent(gains, gain_stride, codes, code_stride, n_lights, is_coded, values);
}

void add_near_products(const float* columns, std::size_t n_lights, std::size_t n_padded,
                       float* sums) {
  loops().products(columns, n_lights, n_padded, sums);
}

void solve_near(const float* sums, const double* ridge, int n_terms, float* planes) {
  loops().solve(sums, ridge, static_cast<std::size_t>(n_terms), planes);
}

void add_near_between(const float* starts, const float* steps, int n_terms,
                      std::size_t n_lights, const float* values, float* planes) {
  loops().between(starts, steps, static_cast<std::size_t>(n_terms), n_lights, values, planes);
}

void mix_near(const std::array<const float*, 4>& from, const std::array<float, 4>& weights,
              std::size_t n, float* out) {
  loops().mix(from, weights, n, out);
}

void subtract_near(const float* a, const float* b, std::size_t n, float* out) {
  loops().subtract(a, b, n, out);
}

HAARLIGHT_WIDER bool has_rough_gains(const float* gains, std::size_t n_blocks) {
  int n_rough = 0;
  for (std::size_t i = 0; i < n_blocks; ++i) {
    const float a = gains[2 * i];
    const float b = gains[2 * i + 1];
    const float c = gains[2 * i + 2];
    const float least = std::min(std::min(a, b), c);
    const float most = std::max(std::max(a, b), c);
    n_rough += least > 0.0F && most < kMostBend * least ? 0 : 1;
  }
  return n_rough > 0;
}

}  // namespace haarlight::relight
