// SPDX-License-Identifier: Apache-2.0
#include "core/rig/pattern_methods.h"

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "core/random.h"
#include "core/rig/pattern_inverse.h"

namespace haarlight {

namespace {

/// Pixels under a square grid of lights, shot with Haar patterns: all wavelets or the coarsest.
class HaarPatterns {
 public:
  using Result = std::vector<double>;  ///< (n_lights, pixels)

  explicit HaarPatterns(MethodSize size)
      : side_(by_size(size, 8, 16, 32)), width_(by_size<std::size_t>(size, 16, 1024, 16384)) {
    const std::size_t n = lights();
    truth_.resize(n * width_);
    for (std::size_t k = 0; k < n; ++k) {
      // A ramp over the lights with a shadow's edge, a tenth of it rough.
      const std::size_t at_row = k / static_cast<std::size_t>(side_);
      const std::size_t at_col = k % static_cast<std::size_t>(side_);
      const double row = static_cast<double>(at_row) / side_;
      const double col = static_cast<double>(at_col) / side_;
      for (std::size_t p = 0; p < width_; ++p) {
        const double edge = uniform_unit(hash_key(1, p));
        const double rough = uniform_unit(hash_key(2, p, k));
        truth_[k * width_ + p] =
            (1.0 + 0.5 * std::sin(3.0 * row + edge)) * (col < edge ? 1.0 : 0.1) + 0.1 * rough;
      }
    }
    for (const int finest : {side_ / 4, side_ / 2, side_}) {
      Shots& shots = shots_.emplace_back(Shots{inverse_of(finest), {}});
      shots.measured.resize(static_cast<std::size_t>(shots.inverse.n_shots()) * width_);
      shots.inverse.shoot(truth_, width_, shots.measured);
    }
  }

  [[nodiscard]] Result run(std::size_t setting) const {
    const Shots& shots = shots_.at(setting);
    Result found(truth_.size());
    shots.inverse.apply(shots.measured, {}, width_, found);
    return found;
  }
  [[nodiscard]] Result truth() const { return truth_; }
  [[nodiscard]] double error(const Result& found, const Result& truth) const {
    return relative_l2(found, truth);
  }
  [[nodiscard]] MethodScale scale() const {
    return {side_ * side_, static_cast<long long>(width_)};
  }
  /// Shots are read and lights written once.
  [[nodiscard]] double bytes(std::size_t setting) const {
    return static_cast<double>((shots_.at(setting).measured.size() + truth_.size()) *
                               sizeof(double));
  }

 private:
  struct Shots {
    PatternInverse inverse;
    std::vector<double> measured;  ///< (n_shots, pixels)
  };

  [[nodiscard]] std::size_t lights() const {
    return static_cast<std::size_t>(side_) * static_cast<std::size_t>(side_);
  }

  /// The wavelets of the `finest` x `finest` corner of the coefficient array.
  [[nodiscard]] PatternInverse inverse_of(int finest) const {
    PatternParameters parameters{PatternFamily::haar, {{side_, side_}}, 0, {}};
    for (int row = 0; row < finest; ++row) {
      for (int col = 0; col < finest; ++col) {
        parameters.wavelets.push_back(row * side_ + col);
      }
    }
    std::vector<std::vector<LightDriveLevel>> shots;
    for (const std::vector<int>& lit : lit_lights(parameters)) {
      shots.emplace_back();
      for (const int k : lit) {
        shots.back().push_back({k, 1.0});
      }
    }
    return {std::move(parameters), std::move(shots), side_ * side_};
  }

  int side_;
  std::size_t width_;
  std::vector<double> truth_;
  std::vector<Shots> shots_;
};

}  // namespace

std::vector<Method> pattern_methods() {
  return {Method::of<HaarPatterns>(
      {.module = "core/rig",
       .name = "demultiplexing of Haar patterns",
       .settings = {"a sixteenth of the wavelets", "a quarter of the wavelets", "all wavelets"},
       .error_norm = "relative L2 of the single lights",
       .truth = "the lights that the shots were made of",
       .exact_error = 1e-13,
       .exact_error_from = "additions in double, ten levels of wavelets"})};
}

}  // namespace haarlight
