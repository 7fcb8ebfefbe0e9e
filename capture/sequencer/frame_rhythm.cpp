// SPDX-License-Identifier: Apache-2.0
#include "capture/sequencer/frame_rhythm.h"

#include <algorithm>
#include <cmath>

#include "core/order_statistics.h"

namespace haarlight::capture {

namespace {

constexpr double kLeastToleranceNs = 80e3;
constexpr double kSigmas = 4.5;
constexpr double kGuardFactor = 1.25;     // allowance for the error of the fit itself
constexpr double kMedianVariance = 1.57;  // pi / 2: of a median, relative to a mean
constexpr double kSigmaFades = 0.98;      // per frame: a small window may show too little
constexpr double kSameExposureUs = 5.0;
constexpr std::size_t kMostPairs = 32 * 31 / 2;
constexpr unsigned kFramesToPeriod = 8;  // of a full window: changes by a relative 1e-6

}  // namespace

void FrameRhythm::keep(Timestamp timestamp) {
  if (n_ == kKept) {
    std::move(timestamps_.begin() + 1, timestamps_.end(), timestamps_.begin());
    --n_;
  }
  timestamps_[n_++] = timestamp;
}

void FrameRhythm::fit() {
  const Timestamp& newest = timestamps_[n_ - 1];
  std::array<double, kKept> x{};
  std::array<double, kKept> y{};
  for (std::size_t i = 0; i < n_; ++i) {
    x[i] = -static_cast<double>(newest.sequence - timestamps_[i].sequence);
    y[i] = static_cast<double>(timestamps_[i].timestamp_ns - newest.timestamp_ns);
  }
  if (n_ >= kFirst && (n_ < kKept || ++n_since_period_ % kFramesToPeriod == 0)) {
    std::array<double, kMostPairs> slopes{};
    std::size_t n_slopes = 0;
    for (std::size_t i = 0; i < n_; ++i) {
      for (std::size_t j = i + 1; j < n_; ++j) {
        slopes[n_slopes++] = (y[j] - y[i]) / (x[j] - x[i]);
      }
    }
    period_ns_ = median(std::span(slopes.data(), n_slopes));
  }
  if (period_ns_ <= 0.0) {
    return;
  }
  std::array<double, kKept> rest{};
  for (std::size_t i = 0; i < n_; ++i) {
    rest[i] = y[i] - period_ns_ * x[i];
  }
  std::array<double, kKept> sorted = rest;
  phase_ns_ = median(std::span(sorted.data(), n_));
  if (n_ < kFirst) {
    return;
  }
  for (std::size_t i = 0; i < n_; ++i) {
    sorted[i] = std::abs(rest[i] - phase_ns_);
  }
  sigma_ns_ =
      std::max(kSigmaPerMad * median(std::span(sorted.data(), n_)), kSigmaFades * sigma_ns_);
  const double span = std::max(1.0, -x[0]);
  period_sigma_ns_ = sigma_ns_ * std::sqrt(12.0 / static_cast<double>(n_)) / span;
}

FrameRhythm::Verdict FrameRhythm::classify(std::uint64_t sequence, std::int64_t timestamp_ns,
                                           double exposure_us) {
  if (std::abs(exposure_us - exposure_us_) > kSameExposureUs) {
    is_exposure_new_ = is_known();
    n_ = is_exposure_new_ ? n_ : 0;
    n_off_ = 0;
    exposure_us_ = exposure_us;
  }
  Timestamp timestamp{sequence + slip_, timestamp_ns};
  Verdict verdict;
  if (is_known()) {
    const Timestamp& newest = timestamps_[n_ - 1];
    const auto ahead = static_cast<double>(timestamp.sequence - newest.sequence);
    const double off = static_cast<double>(timestamp_ns - newest.timestamp_ns) -
                       (phase_ns_ + period_ns_ * ahead);
    // From the middle of the window to the new frame: the lever of the period's error.
    const double reach =
        ahead + 0.5 * static_cast<double>(newest.sequence - timestamps_[0].sequence);
    // A few frames may show too little jitter: after nine to twelve, a third of it was seen.
    const double sigma =
        sigma_ns_ * (2.0 - static_cast<double>(n_) / static_cast<double>(kKept));
    const double variance = sigma * sigma * (1.0 + kMedianVariance / static_cast<double>(n_)) +
                            reach * reach * period_sigma_ns_ * period_sigma_ns_;
    const double tolerance = std::max(kLeastToleranceNs, kSigmas * std::sqrt(variance));
    verdict.off_ns = static_cast<std::int64_t>(off);
    verdict.guard_ns = static_cast<std::int64_t>(kGuardFactor * tolerance);
    verdict.position = std::abs(off) <= tolerance ? Position::on : Position::off;
    if (is_exposure_new_) {
      // A shift of all timestamps and one wrong timestamp look alike: the first frame only
      // shows whether the phase holds, and is not used.
      is_exposure_new_ = false;
      n_ = verdict.position == Position::off ? 0 : n_;
      keep(timestamp);
      fit();
      return {};
    }
    const double periods = std::round(off / period_ns_);
    if (periods >= 1.0 && std::abs(off - periods * period_ns_) <= tolerance) {
      // Lost on the way and not counted: this frame is not used; the next ones are tracked from
      // it.
      const auto lost = static_cast<std::uint64_t>(periods);
      slip_ += lost;
      timestamp.sequence += lost;
    }
  }
  keep(timestamp);
  n_off_ = verdict.position == Position::off ? n_off_ + 1 : 0;
  if (n_off_ == kOffToForget) {
    std::move(timestamps_.begin() + static_cast<std::ptrdiff_t>(n_ - kOffToForget),
              timestamps_.begin() + static_cast<std::ptrdiff_t>(n_), timestamps_.begin());
    n_ = kOffToForget;
    n_off_ = 0;
    period_ns_ = period_sigma_ns_ = sigma_ns_ = 0.0;
    verdict.is_learnt_anew = true;
  }
  fit();
  return verdict;
}

}  // namespace haarlight::capture
