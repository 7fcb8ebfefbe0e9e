// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <cstdint>
#include <span>
#include <string_view>

#include "haarlight/core/enum_words.h"
#include "haarlight/core/image.h"
#include "haarlight/relight/shape/slope_field.h"

/// @file
/// From slopes to heights, three ways. The gauge: each connected part of the known pixels has a
/// free constant; its mean is fixed at 0. Errors and costs: docs/numerics/shape.md.

namespace haarlight::relight {

enum class Integrator {
  /// Least squares over all steps, natural boundaries: by cosine transforms if every pixel is
  /// known (exact), else by multigrid.
  poisson,
  /// Least squares over slopes in the span of cosines [Frankot88]; unknown pixels count as
  /// flat, so that their edges distort the surface: for whole pictures.
  frankot_chellappa,
  /// Steps inconsistent with their neighbours lose weight, after the M-estimators of
  /// [Agrawal06]: preserves edges, at the price of ten to thirty solves.
  robust,
};
inline constexpr auto kIntegratorWords =
    std::to_array<std::string_view>({"poisson", "frankot-chellappa", "robust"});
constexpr std::span<const std::string_view> words_of(Integrator) { return kIntegratorWords; }

struct IntegrateOptions {
  Integrator method = Integrator::poisson;
  /// Borrowed, may be null: (height, width). Pixels of different regions are not joined: the
  /// surface steps between them.
  const Image<int>* region = nullptr;
  double tolerance = 1e-7;   ///< of the solver: relative, in the energy of slopes
  int max_iterations = 300;  ///< of the solver, per solve
  int max_reweightings = 30;
};

/// Labels the connected parts (by right and down neighbours) of known pixels.
struct Parts {
  Image<int> label;  ///< -1 where not known
  int n_parts = 0;
};
/// @param region  may be null: pixels of different regions do not connect
[[nodiscard]] Parts find_parts(ImageView<const std::uint8_t> is_known,
                               const Image<int>* region = nullptr);

struct HeightMap {
  Image<float> height;           ///< (height, width): mm, or ln D; 0 where not known
  Image<std::uint8_t> is_known;  ///< (height, width)
  /// (height, width, 2): 1 where robust classified the step to the right (0) or down (1) as a
  /// cut, or another region begins.
  Image<std::uint8_t> is_cut;
  double step_error = 0.0;  ///< rms of (z_b - z_a - step) over the steps that are not cuts
  double worst_step_error = 0.0;
  Parts parts;  ///< connected parts, each with a mean of 0
  std::int64_t n_cuts = 0;
  int n_solves = 0;              ///< 1 unless robust
  int iterations = 0;            ///< of the solver, all solves
  double solver_residual = 0.0;  ///< 0: solved exactly
  bool is_converged = true;
};

[[nodiscard]] HeightMap integrate_slopes(const SlopeField& slopes,
                                         const IntegrateOptions& options = {});

}  // namespace haarlight::relight
