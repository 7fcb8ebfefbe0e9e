// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/plate/plate_gain.h"

#include <algorithm>
#include <array>
#include <cstddef>
#include <numeric>

#include "haarlight/core/error.h"
#include "relight/basis/by_kernel.h"
#include "relight/basis/plate/plate.h"

namespace haarlight::relight {

namespace {

constexpr double kDarkLight = 1e-6;  // of the pixel's largest B: below it T/B is noise
// Several sums in parallel: a single one would wait for each previous addition.
constexpr std::size_t kLanes = 8;

struct Largest {
  [[gnu::always_inline]] static inline float run(std::span<const float> values) {
    std::array<float, kLanes> each{};
    each.fill(values.front());
    std::size_t k = 0;
    for (; k + kLanes <= values.size(); k += kLanes) {
      for (std::size_t i = 0; i < kLanes; ++i) {
        each[i] = each[i] < values[k + i] ? values[k + i] : each[i];
      }
    }
    for (; k < values.size(); ++k) {
      each[0] = std::max(each[0], values[k]);
    }
    return *std::max_element(each.begin(), each.end());
  }
};

/// T/B of the lights with B above `dark`, in order. @return  their number
struct DivideLit {
  [[gnu::always_inline]] static inline std::size_t run(std::span<const float> t,
                                                       std::span<const float> b, float dark,
                                                       float* __restrict ratios) {
    int n_dark = 0;
    for (std::size_t k = 0; k < t.size(); ++k) {
      ratios[k] = t[k] / b[k];
      n_dark += b[k] > dark ? 0 : 1;
    }
    if (n_dark == 0) {
      return t.size();
    }
    std::size_t n_lit = 0;
    for (std::size_t k = 0; k < t.size(); ++k) {  // without branches that would be mispredicted
      ratios[n_lit] = ratios[k];
      n_lit += b[k] > dark ? 1U : 0U;
    }
    return n_lit;
  }
};

/// ||t - gain b|| < ||t||.
struct LowersEnergy {
  [[gnu::always_inline]] static inline bool run(std::span<const float> t,
                                                std::span<const float> b, float gain) {
    std::array<double, kLanes> energy{};
    std::array<double, kLanes> residual{};
    std::size_t k = 0;
    for (; k + kLanes <= t.size(); k += kLanes) {
      for (std::size_t i = 0; i < kLanes; ++i) {
        const float rest = t[k + i] - gain * b[k + i];
        energy[i] += double{t[k + i]} * double{t[k + i]};
        residual[i] += double{rest} * double{rest};
      }
    }
    for (; k < t.size(); ++k) {
      const float rest = t[k] - gain * b[k];
      energy[0] += double{t[k]} * double{t[k]};
      residual[0] += double{rest} * double{rest};
    }
    return std::accumulate(residual.begin(), residual.end(), 0.0) <
           std::accumulate(energy.begin(), energy.end(), 0.0);
  }
};

}  // namespace

float PlateGain::operator()(std::span<const float> t, std::span<const float> b) {
  HAARLIGHT_EXPECTS(t.size() == b.size() && !t.empty(), "one plate value per light");
  const float largest = run_by_kernel<Largest>(b);
  if (!(largest > 0.0F)) {
    return 0.0F;
  }
  const auto dark = static_cast<float>(kDarkLight * double{largest});
  ratios_.resize(t.size());
  const std::size_t n_lit = run_by_kernel<DivideLit>(t, b, dark, ratios_.data());
  if (n_lit == 0) {
    return 0.0F;
  }
  const float gain = rank_.find(std::span(ratios_).first(n_lit), n_lit / 2);
  return run_by_kernel<LowersEnergy>(t, b, gain) ? gain : 0.0F;
}

float plate_gain(std::span<const float> t, std::span<const float> b) {
  return PlateGain()(t, b);
}

}  // namespace haarlight::relight
