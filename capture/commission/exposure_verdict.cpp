// SPDX-License-Identifier: Apache-2.0
#include "capture/commission/exposure_verdict.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include <fmt/format.h>

#include "haarlight/core/error.h"

namespace haarlight::capture {

namespace {

constexpr double kExposureTol = 0.04;  // of an exposure: a wrong unit is off by more
constexpr double kLargeFactor = 1.5;   // of an exposure: no lucky jackknife reaches this

/// The equivalent, for an estimate whose sigma comes from `n` steps, of kSureSigmas at known
/// sigma (Student's t with n - 3 degrees of freedom, a slope and two offsets; Gaver & Kafadar
/// 1984). 18 at 7 steps, 6.6 at 13, 4.3 at 60.
double sure_sigmas(int n) {
  const double dof = std::max(2.0, n - 3.0);
  const double z2 = kSureSigmas * kSureSigmas * (dof - 1.5) / ((dof - 1.0) * (dof - 1.0));
  return std::sqrt(dof * std::expm1(z2));
}

}  // namespace

ExposureVerdict assess_exposure(std::span<const StepSample> samples,
                                const ExposureQuestion& question) {
  const std::optional<ExposureScale> one = exposure_scale(samples, question.long_us);
  const std::optional<ExposureScale> two = exposure_scale(samples, question.short_us);
  if (!one || !two) {
    return {};
  }
  const bool is_large = std::abs(std::log(one->value)) > std::log(kLargeFactor);
  const auto sure = [is_large](const ExposureScale& scale) {
    return (is_large ? kSureSigmas : sure_sigmas(scale.n_steps)) * scale.sigma;
  };
  const double off = std::abs(one->value - 1.0);
  const double apart = std::abs(two->value - one->value);
  const double tol = kExposureTol * one->value;
  const double known = kSureSigmas * std::hypot(one->sigma, two->sigma);
  if (off <= std::max(kExposureTol, question.doubt_sigmas * one->sigma) ||
      apart > std::max(tol, std::hypot(sure(*one), sure(*two)))) {
    return {ExposureVerdict::as_said, *one};
  }
  const bool is_sure = off > sure(*one) && apart <= std::max(tol, known);
  return {is_sure ? ExposureVerdict::wrong : ExposureVerdict::open, *one};
}

void require_true_exposure(const ExposureQuestion& question,
                           const std::function<std::vector<StepSample>()>& samples,
                           const std::function<void(int)>& more) {
  ExposureQuestion requested = question;
  for (int round = 1;; ++round) {
    if (round > kMoreExposureRounds) {
      requested.doubt_sigmas = kSureSigmas;
    }
    const ExposureVerdict verdict = assess_exposure(samples(), requested);
    const ExposureScale& scale = verdict.scale;
    if (verdict.kind == ExposureVerdict::as_said) {
      return;
    }
    const std::string found = fmt::format(
        "an exposure of {:.0f} us lasts {:.3f} +- {:.3f} times as long as the camera says",
        question.long_us, scale.value, scale.sigma);
    const std::string hint = fmt::format(
        "set exposure_unit_us to {:.3g} times what it is now (docs/reference/cameras.md)",
        scale.value);
    if (verdict.kind == ExposureVerdict::wrong) {
      throw Error(found, question.device, hint + ", then begin again");
    }
    if (round > kMoreExposureRounds) {
      throw Error(
          fmt::format("it may be that {}: {} steps leave it open", found, scale.n_steps),
          question.device, "commission again; if this comes again, " + hint);
    }
    more(round);
  }
}

}  // namespace haarlight::capture
