// SPDX-License-Identifier: Apache-2.0
#include "capture/proof/frame_checks.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <utility>

#include <fmt/format.h>
#include <xxhash.h>

#include "haarlight/core/error.h"
#include "session/frame_check.h"

namespace haarlight::capture {

FrameGlance glance_at(ImageView<const std::uint16_t> active, double clip_dn) {
  struct Free {
    void operator()(XXH3_state_t* state) const noexcept { XXH3_freeState(state); }
  };
  const std::unique_ptr<XXH3_state_t, Free> state(XXH3_createState());
  XXH3_64bits_reset(state.get());
  FrameGlance glance;
  for (int y = 0; y < active.height(); ++y) {
    const auto row = active.row(y);
    XXH3_64bits_update(state.get(), row.data(), row.size_bytes());
    glance.must_differ = glance.must_differ ||
                         std::any_of(row.begin(), row.end(), [clip_dn](std::uint16_t word) {
                           return word > 0 && word < clip_dn;
                         });
  }
  glance.hash = XXH3_64bits_digest(state.get());
  return glance;
}

namespace {

constexpr std::size_t kMaxSamples = 4096;                   // of one picture
constexpr std::size_t kAllSamples = std::size_t{1} << 21U;  // of all patterns: 8 MB
constexpr int kLeastSamples = 64;
constexpr double kLeastSignal = 0.01;  // fraction of the range, above rounding and read noise
constexpr double kClippedFraction = 0.9;  // of the clip level: predictions above may clip

double scale_of(const session::FrameEvidence& evidence) {
  return evidence.exposure_read_us * std::pow(10.0, evidence.gain_db / 20.0);
}

/// Rounds to six digits, a thousandth of the noise, to keep the evidence short.
double rounded(double value) {
  const double step =
      std::pow(10.0, std::floor(std::log10(std::max(std::abs(value), 1e-30))) - 5.0);
  return std::round(value / step) * step;
}

bool is_lit(session::ShotKind kind) { return kind != session::ShotKind::dark; }

}  // namespace

FrameChecker::FrameChecker(const Plan& plan, const session::FrameForm& form,
                           const LightLayout& layout)
    : form_(form), limits_(plan.limits), dark_dn_(form.black_level) {
  const std::vector<int> numbers = same_lights(plan.shots);
  std::vector<int> n_shots(plan.shots.size(), 0);
  for (const int number : numbers) {
    n_shots[static_cast<std::size_t>(std::max(number, 0))] += number >= 0 ? 1 : 0;
  }
  std::map<int, int> reference_of;
  for (const session::Shot& shot : plan.shots) {
    shots_.push_back(session::Shot{shot.index, shot.kind, {}, shot.exposure_us});
    pattern_of_.push_back(-1);
    const int number = numbers[static_cast<std::size_t>(shot.index)];
    if (number >= 0 && n_shots[static_cast<std::size_t>(number)] > 1) {
      const auto found = reference_of.emplace(number, static_cast<int>(references_.size()));
      pattern_of_.back() = found.first->second;
      if (found.second) {
        references_.emplace_back();
      }
    }
    if (shot.kind == session::ShotKind::light) {
      shortest_us_ =
          shortest_us_ > 0.0 ? std::min(shortest_us_, shot.exposure_us) : shot.exposure_us;
      longest_us_ = std::max(longest_us_, shot.exposure_us);
    }
  }
  const std::size_t fraction = references_.empty() ? 0 : kAllSamples / references_.size();
  n_samples_ = std::clamp<std::size_t>(fraction, kLeastSamples, kMaxSamples);
  if (!layout.faces.empty()) {
    proof_.emplace(plan, layout, form);
    if (!references_.empty()) {
      agreement_.emplace(plan);
    }
  }
}

FrameFinding FrameChecker::check(int shot, ImageView<const std::uint16_t> active,
                                 session::FrameEvidence& evidence) {
  HAARLIGHT_EXPECTS(shot >= 0 && static_cast<std::size_t>(shot) < shots_.size(),
                    "a shot of the plan");
  session::describe_pixels<std::uint16_t>(active, form_, evidence);
  FrameFinding finding = validate(shot, active, evidence);
  int& n_refused = refused_[shot];
  if (n_refused + 1 >= limits_.attempts &&
      finding.verdict != session::FrameVerdict::no_picture) {
    finding.problem.clear();
  }
  if (proof_ && finding.is_taken()) {
    check_light(shot, active, evidence, finding);
  }
  evidence.verdict = finding.verdict;
  if (finding.verdict == session::FrameVerdict::good) {
    learn(shot, active, evidence);
  }
  n_refused = finding.is_taken() ? 0 : n_refused + 1;
  return finding;
}

void FrameChecker::check_light(int shot, ImageView<const std::uint16_t> active,
                               session::FrameEvidence& evidence, FrameFinding& finding) {
  const std::optional<PointSamples> samples = proof_->sample(shot, active, evidence);
  if (!samples) {
    if (agreement_) {
      agreement_->take_dark(evidence.t_exposure_start_ns);
    }
    return;
  }
  PictureFinding picture = proof_->validate(shot, *samples, evidence);
  if (picture.is_predicted) {
    evidence.picture_own_sigma = picture.own_sigma;
  }
  if (picture.other >= 0) {
    evidence.picture_other = picture.other;
    evidence.picture_other_sigma = picture.other_sigma;
    evidence.picture_discrimination_sigma = picture.discrimination_sigma;
  }
  finding.note = std::move(picture.note);
  if (!picture.problem.empty() && !acts_on_agreement()) {
    finding.note = fmt::format(
        "shot {}: {}. Is it that light? Taken all the same; repeats = 2 and "
        "retake_wrong_light = true in the plan have such frames taken again",
        shot, picture.problem);
  }
  if (agreement_) {
    check_agreement(shot, *samples, evidence, finding);
  }
}

void FrameChecker::check_agreement(int shot, const PointSamples& samples,
                                   session::FrameEvidence& evidence, FrameFinding& finding) {
  AgreementFinding found = agreement_->take(shot, samples, evidence.t_exposure_start_ns);
  evidence.agrees_with = found.agrees_with;
  if (found.agrees_with >= 0) {
    evidence.other_light_at_most = found.other_fraction;
  }
  if (!found.note.empty()) {
    finding.note = std::move(found.note);
  }
  evidence.is_picture_proved = found.agrees_with >= 0;
  if (!limits_.retake_wrong_light) {
    return;
  }
  for (int i = 0; i < kProofPoints; ++i) {
    evidence.picture_points.push_back(samples.is_good[i] ? rounded(samples.mean[i])
                                                         : kClippedPoint);
  }
  finding.doubted = std::move(found.doubted);
  if (found.is_given_up) {
    finding.verdict = session::FrameVerdict::wrong_light;
  }
}

std::vector<int> FrameChecker::remember(int shot, const session::FrameEvidence& evidence) {
  HAARLIGHT_EXPECTS(shot >= 0 && static_cast<std::size_t>(shot) < shots_.size(),
                    "a shot of the plan");
  if (!acts_on_agreement()) {
    return {};
  }
  if (!is_lit(shots_[static_cast<std::size_t>(shot)].kind)) {
    agreement_->take_dark(evidence.t_exposure_start_ns);
  } else if (const auto samples = proof_->recall(evidence)) {
    return agreement_->take(shot, *samples, evidence.t_exposure_start_ns).doubted;
  }
  return {};
}

FrameFinding FrameChecker::validate(int shot, ImageView<const std::uint16_t> active,
                                    const session::FrameEvidence& evidence) const {
  const bool is_flat = evidence.min_dn == evidence.max_dn;
  const bool is_clipped = evidence.max_dn == 0 || evidence.min_dn >= form_.saturation_dn();
  if (is_flat && !is_clipped && active.height() * active.width() > 1) {
    return {session::FrameVerdict::no_picture,
            fmt::format("every pixel is {}: the camera delivers no picture", evidence.min_dn)};
  }
  const session::Shot& requested = shots_[static_cast<std::size_t>(shot)];
  if (!is_lit(requested.kind)) {
    return {};
  }
  const bool is_flat_field = requested.kind == session::ShotKind::flat;
  if ((is_flat_field || requested.exposure_us <= shortest_us_) &&
      evidence.saturated_fraction > limits_.max_saturated_fraction) {
    return {session::FrameVerdict::saturated,
            fmt::format("{:.3g} of the pixels are clipped in the shortest exposure, "
                        "max_saturated_share is {:.3g}: shorten the exposure",
                        evidence.saturated_fraction, limits_.max_saturated_fraction)};
  }
  const double signal = (evidence.mean_dn - dark_dn_) / (form_.white_level - form_.black_level);
  if (limits_.min_signal_fraction > 0.0 &&
      (is_flat_field || requested.exposure_us >= longest_us_) &&
      signal < limits_.min_signal_fraction) {
    return {session::FrameVerdict::too_dark,
            fmt::format("a mean signal of {:.3g} of the range in the longest exposure, "
                        "min_signal_share is {:.3g}: is the light on, the cap off?",
                        signal, limits_.min_signal_fraction)};
  }
  const int pattern = pattern_of_[static_cast<std::size_t>(shot)];
  if (pattern < 0 || limits_.level_tolerance <= 0.0 || acts_on_agreement()) {
    return {};
  }
  const Reference& reference = references_[static_cast<std::size_t>(pattern)];
  return reference.scale > 0.0 ? check_level(reference, sample(active), evidence)
                               : FrameFinding{};
}

FrameFinding FrameChecker::check_level(const Reference& reference,
                                       const std::vector<std::uint16_t>& samples,
                                       const session::FrameEvidence& evidence) const {
  const double range = form_.white_level - form_.black_level;
  const double unclipped = form_.saturation_dn() - form_.black_level;
  const double ratio = scale_of(evidence) / reference.scale;
  double seen = 0.0;
  double predicted = 0.0;
  int n = 0;
  for (std::size_t i = 0; i + 1 < samples.size(); i += 2) {
    const double before = reference.samples[i + 1] - reference.dark_dn;
    const double now = ratio * before;
    const double own = ratio * (reference.samples[i] - reference.dark_dn);
    const bool counts = reference.samples[i] < form_.saturation_dn() && own <= unclipped &&
                        std::min(before, now) >= kLeastSignal * range &&
                        now <= kClippedFraction * unclipped;
    if (counts) {
      seen += samples[i] - dark_dn_;
      predicted += own;
      ++n;
    }
  }
  if (n < kLeastSamples || std::abs(seen / predicted - 1.0) <= limits_.level_tolerance) {
    return {};
  }
  return {session::FrameVerdict::wrong_level,
          fmt::format("{:.3g} of the level that shot {} predicts: the exposure of {} us did "
                      "not act, the light is not as bright, or the rig file's black level is "
                      "wrong",
                      seen / predicted, reference.shot, evidence.exposure_read_us)};
}

std::vector<std::uint16_t> FrameChecker::sample(ImageView<const std::uint16_t> active) const {
  const auto n =
      static_cast<std::size_t>(active.height()) * static_cast<std::size_t>(active.width());
  const std::size_t step = std::max<std::size_t>(1, n / n_samples_) | 1U;  // odd: no mosaic
  std::vector<std::uint16_t> samples;
  samples.reserve(2 * (n / step + 1));
  const auto width = static_cast<std::size_t>(active.width());
  for (std::size_t i = 0; i < n; i += step) {
    const auto row = active.row(static_cast<int>(i / width));
    const std::size_t x = i % width;
    samples.push_back(row[x]);
    samples.push_back(row[x + 2 < width ? x + 2 : x >= 2 ? x - 2 : x]);  // of the same colour
  }
  return samples;
}

void FrameChecker::learn(int shot, ImageView<const std::uint16_t> active,
                         const session::FrameEvidence& evidence) {
  const auto i = static_cast<std::size_t>(shot);
  if (!is_lit(shots_[i].kind)) {
    dark_dn_ = evidence.mean_dn;
  } else if (pattern_of_[i] >= 0) {
    references_[static_cast<std::size_t>(pattern_of_[i])] =
        Reference{scale_of(evidence), dark_dn_, shot, sample(active)};
  }
}

}  // namespace haarlight::capture
