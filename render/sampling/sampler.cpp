// SPDX-License-Identifier: Apache-2.0
#include "render/sampling/sampler.h"

#include <algorithm>
#include <utility>

#include "core/random.h"
#include "core/vector_clones.h"
#include "haarlight/core/error.h"

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

/// Owen's nested uniform scrambling of a 32-bit fraction [Owen95], by a hash [Laine11], [Burley20].
constexpr std::uint32_t owen_scramble(std::uint32_t fraction, std::uint32_t seed) {
  return reverse_bits(hash_upwards(reverse_bits(fraction), seed));
}

/// What a dimension of a pixel makes of a sample. The sequence's order is scrambled too, so that
/// dimensions do not depend on each other.
struct SobolKeys {
  /// @param key  random bits of the dimension
  constexpr SobolKeys(std::uint64_t key, std::uint32_t sample)
      : index(owen_scramble(sample, static_cast<std::uint32_t>(key))),
        first(static_cast<std::uint32_t>(key >> 32U)),
        second(static_cast<std::uint32_t>((key * kOdd) >> 32U)),
        low(((key ^ sample) * kOdd) >> 22U) {}

  static constexpr std::uint64_t kOdd = 0xd1342543de82ef95U;  ///< a multiplier of [Steele22]
  std::uint32_t index;
  std::uint32_t first;   ///< scrambles the first coordinate
  std::uint32_t second;  ///< the second
  std::uint64_t low;     ///< 42 bits, for unit()
};

/// The generating matrix of the second coordinate of Sobol's sequence [Sobol67], Pascal's triangle
/// modulo 2, times an index; the first bit below. (The first coordinate's matrix is the identity.)
/// Bit j is the sum of the bits i that have all ones of j: C(i, j) is odd for these [Lucas78]. One
/// step sums over one digit of i.
constexpr std::uint32_t times_pascal(std::uint32_t x) {
  x ^= (x & 0xaaaaaaaaU) >> 1U;
  x ^= (x & 0xccccccccU) >> 2U;
  x ^= (x & 0xf0f0f0f0U) >> 4U;
  x ^= (x & 0xff00ff00U) >> 8U;
  return x ^ (x >> 16U);
}

/// The 21 bits that follow are random: what a light or a triangle is chosen by still tells a point
/// of it. @param low  its lowest 21 bits are taken
double unit(std::uint32_t fraction, std::uint64_t low) {
  constexpr std::uint64_t kLowBits = (std::uint64_t{1} << 21U) - 1;
  return static_cast<double>((std::uint64_t{fraction} << 21U) | (low & kLowBits)) * 0x1p-53;
}

/// @param pixels  their keys @param pairs  (n, 2)
HAARLIGHT_CLONES("arch=x86-64-v4")
void sobol_pairs(const std::uint64_t* pixels, std::size_t n, std::uint32_t sample,
                 std::uint32_t dimension, double* pairs) {
  for (std::size_t i = 0; i < n; ++i) {
    const SobolKeys keys(mix_bits(pixels[i] ^ dimension), sample);
    pairs[2 * i] = unit(reverse_bits(hash_upwards(keys.index, keys.first)), keys.low);
    pairs[2 * i + 1] = unit(reverse_bits(hash_upwards(times_pascal(keys.index), keys.second)),
                            keys.low >> 21U);
  }
}

constexpr std::uint32_t kSide = 4;
constexpr std::uint32_t kStrata = kSide * kSide;

/// Which of 16 strata a sample is in: each 16 samples in turn are in another random order of them.
std::uint32_t stratum(std::uint32_t sample, std::uint64_t key) {
  const std::uint64_t block = hash_key(key, sample / kStrata);
  std::array<std::uint8_t, kStrata> order{};
  for (std::uint32_t i = 0; i < kStrata; ++i) {
    order[i] = static_cast<std::uint8_t>(i);
  }
  for (std::uint32_t i = kStrata - 1; i > 0; --i) {  // [Fisher38], as Durstenfeld has it
    const auto j = static_cast<std::uint32_t>(uniform_unit(hash_key(block, i)) * (i + 1));
    std::swap(order[i], order[j]);
  }
  return order[sample % kStrata];
}

/// The first primes; beyond the last pair dimensions use the same ones, scrambled otherwise and in
/// another order.
constexpr std::array<std::uint32_t, 32> kPrimes{
    2,  3,  5,  7,  11, 13, 17, 19, 23, 29,  31,  37,  41,  43,  47,  53,
    59, 61, 67, 71, 73, 79, 83, 89, 97, 101, 103, 107, 109, 113, 127, 131};

}  // namespace

double scrambled_radical_inverse(std::uint32_t base, std::uint64_t index, std::uint64_t seed) {
  const double inverse_base = 1.0 / base;
  double fraction = 0.0;
  double scale = inverse_base;
  std::uint64_t before = seed;  // and the digits so far
  // To the end of the double, so that the point is uniform within its cell.
  while (scale > 0x1p-56) {
    const auto digit = static_cast<std::uint32_t>(index % base);
    index /= base;
    const auto factor =
        1 + static_cast<std::uint32_t>(uniform_unit(hash_key(before, 1)) * (base - 1));
    const auto shift = static_cast<std::uint32_t>(uniform_unit(hash_key(before, 2)) * base);
    fraction += scale * ((factor * digit + shift) % base);
    before = hash_key(before, 3, digit);
    scale *= inverse_base;
  }
  return std::min(fraction, 0x1.fffffffffffffp-1);
}

/// @param which  of the dimension's pair
double halton(std::uint32_t sample, std::uint32_t dimension, std::uint64_t key,
              std::uint32_t which) {
  constexpr std::uint32_t kPairs = kPrimes.size() / 2;
  // Dimensions that share a pair of primes take its points in other orders.
  const std::uint32_t round = dimension / kPairs;
  const std::uint32_t index =
      round == 0 ? sample : owen_scramble(sample, static_cast<std::uint32_t>(hash_key(key, 3)));
  return scrambled_radical_inverse(kPrimes[2 * (dimension % kPairs) + which], index,
                                   hash_key(key, 4, which));
}

PixelSamples::PixelSamples(SamplerKind kind, std::uint64_t seed, int x, int y)
    : kind_(kind),
      pixel_(hash_key(seed, static_cast<std::uint64_t>(x), static_cast<std::uint64_t>(y))) {}

double PixelSamples::one(std::uint32_t sample, std::uint32_t dimension) const {
  const std::uint64_t key = mix_bits(pixel_ ^ dimension);
  if (kind_ == SamplerKind::independent) {
    return uniform_unit(hash_key(key, sample));
  }
  if (kind_ == SamplerKind::stratified) {
    return (stratum(sample, key) + uniform_unit(hash_key(key, sample, 1))) / kStrata;
  }
  if (kind_ == SamplerKind::halton) {
    return halton(sample, dimension, key, 0);
  }
  // The point is the radical inverse of its index, which scrambling would reverse again.
  const SobolKeys keys(key, sample);
  return unit(reverse_bits(hash_upwards(keys.index, keys.first)), keys.low);
}

Eigen::Vector2d PixelSamples::two(std::uint32_t sample, std::uint32_t dimension) const {
  const std::uint64_t key = mix_bits(pixel_ ^ dimension);
  if (kind_ == SamplerKind::independent) {
    return {uniform_unit(hash_key(key, sample, 1)), uniform_unit(hash_key(key, sample, 2))};
  }
  if (kind_ == SamplerKind::stratified) {
    const std::uint32_t at = stratum(sample, key);
    const std::uint32_t col = at % kSide;
    const std::uint32_t row = at / kSide;
    return {(col + uniform_unit(hash_key(key, sample, 1))) / kSide,
            (row + uniform_unit(hash_key(key, sample, 2))) / kSide};
  }
  if (kind_ == SamplerKind::halton) {
    return {halton(sample, dimension, key, 0), halton(sample, dimension, key, 1)};
  }
  std::array<double, 2> pair{};
  sobol_pairs(&pixel_, 1, sample, dimension, pair.data());
  return {pair[0], pair[1]};
}

void PixelSamples::two(std::span<const PixelSamples> pixels, std::uint32_t sample,
                       std::uint32_t dimension, std::span<Eigen::Vector2d> squares) {
  HAARLIGHT_EXPECTS(pixels.size() == squares.size(), "a pair for each pixel");
  if (!pixels.empty() && pixels.front().kind_ == SamplerKind::sobol) {
    static_assert(sizeof(Eigen::Vector2d) == 2 * sizeof(double));
    std::array<std::uint64_t, 256> keys{};
    for (std::size_t begin = 0; begin < pixels.size(); begin += keys.size()) {
      const std::size_t n = std::min(keys.size(), pixels.size() - begin);
      for (std::size_t i = 0; i < n; ++i) {
        keys[i] = pixels[begin + i].pixel_;
      }
      sobol_pairs(keys.data(), n, sample, dimension, squares[begin].data());
    }
    return;
  }
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    squares[i] = pixels[i].two(sample, dimension);
  }
}

}  // namespace haarlight::render
