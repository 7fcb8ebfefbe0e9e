// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "capture/proof/picture_agreement.h"
#include "capture/proof/picture_proof.h"
#include "haarlight/capture/plan/plan.h"
#include "haarlight/core/image.h"
#include "haarlight/session/evidence.h"
#include "haarlight/session/session.h"

/// @file
/// What a frame's pixels reveal by themselves, and against other frames of the same lights.

namespace haarlight::capture {

/// Cheap enough for every frame that a camera delivers: one pass.
struct FrameGlance {
  std::uint64_t hash = 0;    ///< XXH3-64 of the active rows
  bool must_differ = false;  ///< some pixel is neither 0 nor clipped: it shows noise
};
/// @param clip_dn  words at or above it are clipped
[[nodiscard]] FrameGlance glance_at(ImageView<const std::uint16_t> active, double clip_dn);

/// What the checks found.
struct FrameFinding {
  session::FrameVerdict verdict = session::FrameVerdict::good;
  std::string problem;       ///< in words; empty: the frame is accepted
  std::vector<int> doubted;  ///< earlier shots that it contradicts: to be retaken
  std::string note;          ///< for the log
  [[nodiscard]] bool is_taken() const { return problem.empty(); }
};

/// Validates the pixels of a session's frames, one after another. One thread.
///
/// The level check: of a pattern that the plan shows more than once (exposures, repeats,
/// sentinels) a grid of samples is kept. A later frame must rise by the ratio of the exposures:
///
///     | sum(v - d) / sum(k (v0 - d0)) - 1 | <= level_tolerance,   k = E g / (E0 g0)
///
/// over the samples unclipped in v0 whose neighbour of the same colour predicts, in both
/// frames, at least 1 % of the range and less than 0.9 of the clip level (selected by their own
/// value, samples near 1 % would be those whose noise was high in v0); d the last dark frame's
/// mean, or the black level. Fewer than 64 such samples prove nothing and pass.
///
/// A frame that passes is compared with the session's other frames of the same lights
/// (capture/proof/picture_agreement.h) and with what all its frames predict
/// (capture/proof/picture_proof.h). A plan with retake_wrong_light acts on the first where it
/// shows a pattern more than once, then also instead of the level check, and otherwise on the
/// second; without it, both only report.
class FrameChecker {
 public:
  /// @param layout  of the rig; without faces: no proof by light
  FrameChecker(const Plan& plan, const session::FrameForm& form,
               const LightLayout& layout = {});

  /// Completes the evidence (least, greatest and mean word, saturated and black fractions,
  /// hash, verdict) and classifies the frame. The last attempt that the plan allows is accepted
  /// whatever its verdict, except one without a picture and one of another light.
  /// @param shot  of the plan
  [[nodiscard]] FrameFinding check(int shot, ImageView<const std::uint16_t> active,
                                   session::FrameEvidence& evidence);

  /// A frame committed before this run began, in the order of the exposures.
  /// @return  shots that have to be retaken
  [[nodiscard]] std::vector<int> remember(int shot, const session::FrameEvidence& evidence);

 private:
  struct Reference {
    double scale = 0.0;  ///< exposure * gain; 0: none yet
    double dark_dn = 0.0;
    int shot = 0;
    std::vector<std::uint16_t> samples;  ///< value, neighbour's value, ...
  };
  [[nodiscard]] std::vector<std::uint16_t> sample(ImageView<const std::uint16_t> active) const;
  [[nodiscard]] FrameFinding validate(int shot, ImageView<const std::uint16_t> active,
                                      const session::FrameEvidence& evidence) const;
  [[nodiscard]] FrameFinding check_level(const Reference& reference,
                                         const std::vector<std::uint16_t>& samples,
                                         const session::FrameEvidence& evidence) const;
  /// Checks by the picture what has passed everything else.
  void check_light(int shot, ImageView<const std::uint16_t> active,
                   session::FrameEvidence& evidence, FrameFinding& finding);
  void check_agreement(int shot, const PointSamples& samples, session::FrameEvidence& evidence,
                       FrameFinding& finding);
  [[nodiscard]] bool acts_on_agreement() const {
    return agreement_ && limits_.retake_wrong_light;
  }
  void learn(int shot, ImageView<const std::uint16_t> active,
             const session::FrameEvidence& evidence);

  session::FrameForm form_;
  FrameLimits limits_;
  std::vector<session::Shot> shots_;  ///< without their lights
  std::vector<int> pattern_of_;       ///< a shot's index in references_, -1: shown only once
  std::vector<Reference> references_;
  std::map<int, int> refused_;  ///< attempts of a shot
  double shortest_us_ = 0.0;
  double longest_us_ = 0.0;
  double dark_dn_ = 0.0;
  std::size_t n_samples_ = 0;
  std::optional<PictureProof> proof_;
  std::optional<PictureAgreement> agreement_;  ///< if the plan shows a pattern twice
};

}  // namespace haarlight::capture
