// SPDX-License-Identifier: Apache-2.0
#include "render/sampling/sampler.h"

#include "core/random.h"

namespace haarlight::render {

namespace {

constexpr std::uint32_t reverse_bits(std::uint32_t x) {
  x = ((x & 0x55555555U) << 1U) | ((x >> 1U) & 0x55555555U);
  x = ((x & 0x33333333U) << 2U) | ((x >> 2U) & 0x33333333U);
  x = ((x & 0x0f0f0f0fU) << 4U) | ((x >> 4U) & 0x0f0f0f0fU);
  x = ((x & 0x00ff00ffU) << 8U) | ((x >> 8U) & 0x00ff00ffU);
  return (x << 16U) | (x >> 16U);
}

/// Changes each bit by a function of the lower ones only [Laine11]; the constants are those of
/// [Vegdahl21].
constexpr std::uint32_t hash_upwards(std::uint32_t x, std::uint32_t seed) {
  x ^= x * 0x3d20adeaU;
  x += seed;
  x *= (seed >> 16U) | 1U;
  x ^= x * 0x05526c56U;
  x ^= x * 0x53a22864U;
  return x;
}

double unit(std::uint32_t fraction) { return fraction * 0x1p-32; }

}  // namespace

std::array<std::uint32_t, 2> sobol_point(std::uint32_t index) {
  std::uint32_t second = 0;
  // Column c of Pascal's triangle modulo 2, the first bit on top: the next is it xor it shifted.
  std::uint32_t column = 0x80000000U;
  for (std::uint32_t bits = index; bits != 0; bits >>= 1U) {
    second ^= (bits & 1U) != 0 ? column : 0U;
    column ^= column >> 1U;
  }
  return {reverse_bits(index), second};
}

std::uint32_t owen_scramble(std::uint32_t fraction, std::uint32_t seed) {
  return reverse_bits(hash_upwards(reverse_bits(fraction), seed));
}

PixelSamples::PixelSamples(SamplerKind kind, std::uint64_t seed, int x, int y)
    : kind_(kind),
      pixel_(hash_key(seed, static_cast<std::uint64_t>(x), static_cast<std::uint64_t>(y))) {}

double PixelSamples::one(std::uint32_t sample, std::uint32_t dimension) const {
  const std::uint64_t key = hash_key(pixel_, dimension);
  if (kind_ == SamplerKind::independent) {
    return uniform_unit(hash_key(key, sample));
  }
  // The sequence's order is scrambled too, so that dimensions do not depend on each other.
  const auto order = static_cast<std::uint32_t>(key);
  const auto seed = static_cast<std::uint32_t>(hash_key(key, 1));
  const std::uint32_t index = owen_scramble(sample, order);
  return unit(owen_scramble(reverse_bits(index), seed));
}

Eigen::Vector2d PixelSamples::two(std::uint32_t sample, std::uint32_t dimension) const {
  const std::uint64_t key = hash_key(pixel_, dimension);
  if (kind_ == SamplerKind::independent) {
    return {uniform_unit(hash_key(key, sample, 1)), uniform_unit(hash_key(key, sample, 2))};
  }
  const auto order = static_cast<std::uint32_t>(key);
  const std::uint64_t seeds = hash_key(key, 2);
  const std::array<std::uint32_t, 2> point = sobol_point(owen_scramble(sample, order));
  return {unit(owen_scramble(point[0], static_cast<std::uint32_t>(seeds))),
          unit(owen_scramble(point[1], static_cast<std::uint32_t>(seeds >> 32U)))};
}

}  // namespace haarlight::render
