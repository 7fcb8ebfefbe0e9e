// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <functional>
#include <span>
#include <string>
#include <vector>

#include "capture/commission/step_response.h"

/// @file
/// Whether a camera's exposures last as long as it reports; they do not where the unit of its
/// control is misunderstood. Pure. Rule, figures: docs/numerics/commissioning.md, "Is an
/// exposure as long as the camera says?".

namespace haarlight::capture {

inline constexpr double kSureSigmas = 4.0;
inline constexpr double kDoubtSigmas = 2.0;
/// Of further steps while the question is open.
inline constexpr int kMoreExposureRounds = 8;

/// The long exposure's scale, and the conclusion from the two exposures.
struct ExposureVerdict {
  enum { as_said, open, wrong } kind = as_said;
  ExposureScale scale;
};

/// Two exposures that the camera was set to, and which camera it is.
struct ExposureQuestion {
  double long_us = 0.0;
  double short_us = 0.0;
  /// A deviation beyond this is not ignored while steps can be taken: kDoubtSigmas or
  /// kSureSigmas.
  double doubt_sigmas = kDoubtSigmas;
  std::string device;  ///< of the camera, for messages
};

/// Two exposures must agree: a slow LED stretches the shorter one more. Open: off by more than
/// 4 % and `doubt_sigmas` of the stated sigma, but not certainly, as so few steps may
/// understate it.
[[nodiscard]] ExposureVerdict assess_exposure(std::span<const StepSample> samples,
                                              const ExposureQuestion& question);

/// Returns when the exposures are as reported.
/// @param samples  all so far
/// @param more     takes further steps at both exposures; called while the question is open,
/// with 1, 2, .. kMoreExposureRounds
/// @throws Error(bad_input)  they are not, with the factor; or the question is open after the
///         last round and still beyond kSureSigmas, which the message says
void require_true_exposure(const ExposureQuestion& question,
                           const std::function<std::vector<StepSample>()>& samples,
                           const std::function<void(int)>& more);

}  // namespace haarlight::capture
