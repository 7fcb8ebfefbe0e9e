#include "relight/fit/near_kernel.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numbers>

#if defined(__x86_64__)
#define HAARLIGHT_FIT_X86 1
#else
#define HAARLIGHT_FIT_X86 0
#endif

// Without contraction every width gives the same bits.
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define HAARLIGHT_WIDER [[gnu::target_clones("arch=skylake-avx512", "avx2", "default")]]
#else
#define HAARLIGHT_WIDER
#endif

namespace haarlight {

namespace {

/// Directions to the light, and r^2.
HAARLIGHT_WIDER void point_at(const NearSource& light, const NearBlock& block,
                              float* __restrict dx, float* __restrict dy, float* __restrict dz,
                              float* __restrict r2) {
  for (std::size_t k = 0; k < kNearBlock; ++k) {
    const float x = light.x - block.x[k];
    const float y = light.y - block.y[k];
    const float z = light.z - block.z[k];
    const float square = x * x + y * y + z * z;
    const float inverse = 1.0F / std::sqrt(square);
    dx[k] = x * inverse;
    dy[k] = y * inverse;
    dz[k] = z * inverse;
    r2[k] = square;
  }
}

HAARLIGHT_WIDER void ptm_columns(const float* u, const float* v, float* terms) {
  constexpr std::size_t n = kNearBlock;
  for (std::size_t k = 0; k < n; ++k) {
    terms[k] = u[k] * u[k];
    terms[n + k] = v[k] * v[k];
    terms[2 * n + k] = u[k] * v[k];
    terms[3 * n + k] = u[k];
    terms[4 * n + k] = v[k];
    terms[5 * n + k] = 1.0F;
  }
}

// With s^2 = c / (1 + c): q / rho = s, since q^2 = c (1 - c) and rho^2 = (1 - c)(1 + c); so
// q cos(phi) = s x, (c^2 - c) cos(2 phi) = -s^2 (x^2 - y^2), and no angle is needed.
HAARLIGHT_WIDER void hsh9_columns(const float* __restrict x, const float* __restrict y,
                                  const float* __restrict z, int n_terms,
                                  float* __restrict terms) {
  using std::numbers::inv_pi_v;
  constexpr std::size_t n = kNearBlock;
  const float k0 = std::sqrt(0.5F * inv_pi_v<float>);
  const float k1 = std::sqrt(6.0F * inv_pi_v<float>);
  const float k2 = std::sqrt(1.5F * inv_pi_v<float>);
  const float k4 = std::sqrt(30.0F * inv_pi_v<float>);
  const float k6 = std::sqrt(2.5F * inv_pi_v<float>);
  if (n_terms == 4) {
    for (std::size_t k = 0; k < n; ++k) {
      const float c = std::min(std::max(z[k], 0.0F), 1.0F);
      const float s = k1 * std::sqrt(c / (1.0F + c));
      terms[k] = k0;
      terms[n + k] = s * x[k];
      terms[2 * n + k] = k2 * (2.0F * c - 1.0F);
      terms[3 * n + k] = s * y[k];
    }
    return;
  }
  for (std::size_t k = 0; k < n; ++k) {
    const float c = std::min(std::max(z[k], 0.0F), 1.0F);
    const float s2 = c / (1.0F + c);
    const float s = std::sqrt(s2);
    const float m = 2.0F * c - 1.0F;
    const float sx = s * x[k];
    const float sy = s * y[k];
    terms[k] = k0;
    terms[n + k] = k1 * sx;
    terms[2 * n + k] = k2 * m;
    terms[3 * n + k] = k1 * sy;
    terms[4 * n + k] = k4 * (sy * sy - sx * sx);
    terms[5 * n + k] = k4 * m * sx;
    terms[6 * n + k] = k6 * (1.0F - 6.0F * c + 6.0F * c * c);
    terms[7 * n + k] = k4 * m * sy;
    terms[8 * n + k] = -2.0F * k4 * sx * sy;
  }
}

HAARLIGHT_WIDER void gain_columns(const NearSource& light, const float* __restrict dx,
                                  const float* __restrict dy, const float* __restrict dz,
                                  const float* __restrict r2, float* __restrict gain) {
  if (light.mu == 0.0F) {
    for (std::size_t k = 0; k < kNearBlock; ++k) {
      gain[k] = light.scale * r2[k];
    }
    return;
  }
  std::array<float, kNearBlock> cosine{};
  for (std::size_t k = 0; k < kNearBlock; ++k) {
    cosine[k] = -(light.axis[0] * dx[k] + light.axis[1] * dy[k] + light.axis[2] * dz[k]);
  }
  if (light.mu != 1.0F) {
    for (std::size_t k = 0; k < kNearBlock; ++k) {
      cosine[k] = cosine[k] > 0.0F ? std::pow(cosine[k], light.mu) : 0.0F;
    }
  }
  constexpr float kLeast = 1e-3F;  // a light that gives a thousandth says nothing
  for (std::size_t k = 0; k < kNearBlock; ++k) {
    gain[k] = cosine[k] > kLeast ? light.scale * r2[k] / cosine[k] : 0.0F;
  }
}

/// The chunk's sums are made first and then added, in every version alike.
void add_products_portable(const float* columns, std::size_t n_lights, std::size_t n_padded,
                           float* sums) {
  const std::size_t n_columns = n_padded + 3;
  for (std::size_t i = 0; i < n_padded; ++i) {
    for (std::size_t j = i / 3 * 3; j < n_columns; ++j) {
      for (std::size_t x = 0; x < kNearBlock; ++x) {
        float sum = 0.0F;
        for (std::size_t l = 0; l < n_lights; ++l) {
          const float* row = columns + l * n_columns * kNearBlock + x;
          sum += row[i * kNearBlock] * row[j * kNearBlock];
        }
        sums[(i * n_columns + j) * kNearBlock + x] += sum;
      }
    }
  }
}

#if HAARLIGHT_FIT_X86
/// The same over vectors of 8 pixels, nine sums in registers.
[[gnu::target("avx2")]] void add_products_avx2(const float* columns, std::size_t n_lights,
                                               std::size_t n_padded, float* sums) {
  using Lanes = float __attribute__((vector_size(8 * sizeof(float))));
  const std::size_t n_columns = n_padded + 3;
  const std::size_t down = n_columns * kNearBlock;
  for (std::size_t x = 0; x < kNearBlock; x += 8) {
    for (std::size_t i = 0; i < n_padded; i += 3) {
      for (std::size_t j = i; j < n_columns; j += 3) {
        Lanes s00{};
        Lanes s01{};
        Lanes s02{};
        Lanes s10{};
        Lanes s11{};
        Lanes s12{};
        Lanes s20{};
        Lanes s21{};
        Lanes s22{};
        const float* p = columns + i * kNearBlock + x;
        const float* q = columns + j * kNearBlock + x;
        for (std::size_t l = 0; l < n_lights; ++l, p += down, q += down) {
          Lanes u0;
          Lanes u1;
          Lanes u2;
          Lanes v;
          std::memcpy(&u0, p, sizeof u0);
          std::memcpy(&u1, p + kNearBlock, sizeof u1);
          std::memcpy(&u2, p + 2 * kNearBlock, sizeof u2);
          std::memcpy(&v, q, sizeof v);
          s00 += u0 * v;
          s10 += u1 * v;
          s20 += u2 * v;
          std::memcpy(&v, q + kNearBlock, sizeof v);
          s01 += u0 * v;
          s11 += u1 * v;
          s21 += u2 * v;
          std::memcpy(&v, q + 2 * kNearBlock, sizeof v);
          s02 += u0 * v;
          s12 += u1 * v;
          s22 += u2 * v;
        }
        const Lanes parts[9] = {s00, s01, s02, s10, s11, s12, s20, s21, s22};
        for (std::size_t a = 0; a < 9; ++a) {
          float* to = sums + ((i + a / 3) * n_columns + j + a % 3) * kNearBlock + x;
          Lanes sum;
          std::memcpy(&sum, to, sizeof sum);
          sum += parts[a];
          std::memcpy(to, &sum, sizeof sum);
        }
      }
    }
  }
}
#endif

#if HAARLIGHT_FIT_X86
/// The same over vectors of 16 pixels, nine sums in registers.
[[gnu::target("avx512f")]] void add_products_avx512(const float* columns, std::size_t n_lights,
                                                    std::size_t n_padded, float* sums) {
  using Lanes = float __attribute__((vector_size(16 * sizeof(float))));
  const std::size_t n_columns = n_padded + 3;
  const std::size_t down = n_columns * kNearBlock;
  for (std::size_t x = 0; x < kNearBlock; x += 16) {
    for (std::size_t i = 0; i < n_padded; i += 3) {
      for (std::size_t j = i; j < n_columns; j += 3) {
        Lanes s00{};
        Lanes s01{};
        Lanes s02{};
        Lanes s10{};
        Lanes s11{};
        Lanes s12{};
        Lanes s20{};
        Lanes s21{};
        Lanes s22{};
        const float* p = columns + i * kNearBlock + x;
        const float* q = columns + j * kNearBlock + x;
        for (std::size_t l = 0; l < n_lights; ++l, p += down, q += down) {
          Lanes u0;
          Lanes u1;
          Lanes u2;
          Lanes v;
          std::memcpy(&u0, p, sizeof u0);
          std::memcpy(&u1, p + kNearBlock, sizeof u1);
          std::memcpy(&u2, p + 2 * kNearBlock, sizeof u2);
          std::memcpy(&v, q, sizeof v);
          s00 += u0 * v;
          s10 += u1 * v;
          s20 += u2 * v;
          std::memcpy(&v, q + kNearBlock, sizeof v);
          s01 += u0 * v;
          s11 += u1 * v;
          s21 += u2 * v;
          std::memcpy(&v, q + 2 * kNearBlock, sizeof v);
          s02 += u0 * v;
          s12 += u1 * v;
          s22 += u2 * v;
        }
        const Lanes parts[9] = {s00, s01, s02, s10, s11, s12, s20, s21, s22};
        for (std::size_t a = 0; a < 9; ++a) {
          float* to = sums + ((i + a / 3) * n_columns + j + a % 3) * kNearBlock + x;
          Lanes sum;
          std::memcpy(&sum, to, sizeof sum);
          sum += parts[a];
          std::memcpy(to, &sum, sizeof sum);
        }
      }
    }
  }
}
#endif

using AddProducts = void (*)(const float* columns, std::size_t n_lights, std::size_t n_padded,
                             float* sums);

AddProducts choose_add_products() {
#if HAARLIGHT_FIT_X86
  if (__builtin_cpu_supports("avx512f")) {
    return add_products_avx512;
  }
  if (__builtin_cpu_supports("avx2")) {
    return add_products_avx2;
  }
#endif
  return add_products_portable;
}

/// The harmonics beyond nine, as the basis defines them, pixel by pixel: slow.
void hsh16_columns(const float* x, const float* y, const float* z, float* terms) {
  for (std::size_t k = 0; k < kNearBlock; ++k) {
    const auto all = hsh_terms(Eigen::Vector3d(x[k], y[k], z[k]), 16);
    for (std::size_t t = 0; t < 16; ++t) {
      terms[t * kNearBlock + k] = static_cast<float>(all[t]);
    }
  }
}

}  // namespace

void near_terms(ReflectanceBasis basis, int n_terms, const NearSource& light,
                const NearBlock& block, float* terms, float* gain) {
  alignas(64) std::array<float, kNearBlock> dx{};
  alignas(64) std::array<float, kNearBlock> dy{};
  alignas(64) std::array<float, kNearBlock> dz{};
  alignas(64) std::array<float, kNearBlock> r2{};
  point_at(light, block, dx.data(), dy.data(), dz.data(), r2.data());
  if (basis == ReflectanceBasis::ptm) {
    ptm_columns(dx.data(), dy.data(), terms);
  } else if (n_terms <= 9) {
    hsh9_columns(dx.data(), dy.data(), dz.data(), n_terms, terms);
  } else {
    hsh16_columns(dx.data(), dy.data(), dz.data(), terms);
  }
  std::fill(terms + static_cast<std::size_t>(n_terms) * kNearBlock,
            terms + near_terms_padded(n_terms) * kNearBlock, 0.0F);
  gain_columns(light, dx.data(), dy.data(), dz.data(), r2.data(), gain);
  // Where the light says nothing its row is left out of the problem.
  const bool has_gap =
      std::any_of(gain, gain + kNearBlock, [](float g) { return !(g > 0.0F); });
  for (std::size_t t = 0; t < static_cast<std::size_t>(n_terms) && has_gap; ++t) {
    for (std::size_t k = 0; k < kNearBlock; ++k) {
      terms[t * kNearBlock + k] = gain[k] > 0.0F ? terms[t * kNearBlock + k] : 0.0F;
    }
  }
}

void near_gain(const NearSource& light, const NearBlock& block, float* gain) {
  alignas(64) std::array<float, kNearBlock> dx{};
  alignas(64) std::array<float, kNearBlock> dy{};
  alignas(64) std::array<float, kNearBlock> dz{};
  alignas(64) std::array<float, kNearBlock> r2{};
  point_at(light, block, dx.data(), dy.data(), dz.data(), r2.data());
  gain_columns(light, dx.data(), dy.data(), dz.data(), r2.data(), gain);
}

void add_near_products(const float* columns, std::size_t n_lights, std::size_t n_padded,
                       float* sums) {
  static const AddProducts kAdd = choose_add_products();
  kAdd(columns, n_lights, n_padded, sums);
}

}  // namespace haarlight
