// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "capture/proof/light_predictor.h"
#include "capture/proof/picture_points.h"
#include "haarlight/capture/plan/plan.h"
#include "haarlight/core/image.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/session/evidence.h"
#include "haarlight/session/session.h"

/// @file
/// Proof by light: a frame's own pixels against what the session so far predicts for its
/// pattern and for the others. Formulas, limits and measured figures:
/// docs/numerics/light-proof.md.

namespace haarlight::capture {

/// The lights' positions and the sensor's noise.
struct LightLayout {
  std::vector<FaceGrid> faces;  ///< in the lights' order; empty: no proof by light
  SensorNoise noise;
};
[[nodiscard]] LightLayout light_layout(const Rig& rig, const CameraSpec& camera);

struct PictureFinding {
  bool is_predicted = false;          ///< the distances are meaningful
  double own_sigma = 0.0;             ///< distance to its own prediction
  double other_sigma = 0.0;           ///< and to the nearest other one
  double discrimination_sigma = 0.0;  ///< between the two; 0: no other
  int other = -1;                     ///< a shot of that other pattern
  std::string problem;                ///< evidence for another light beyond 5 sigma; or empty
  std::string note;                   ///< worth a line in the log
};

/// Classifies the frames of one session in the order of their exposures. One thread.
class PictureProof {
 public:
  PictureProof(const Plan& plan, const LightLayout& layout, const session::FrameForm& form);

  /// A lit frame's samples; nothing for a dark one, which is learned as the sensor's black.
  [[nodiscard]] std::optional<PointSamples> sample(int shot,
                                                   ImageView<const std::uint16_t> active,
                                                   const session::FrameEvidence& evidence);
  /// The samples behind evidence.picture_points; nothing where there are none.
  [[nodiscard]] std::optional<PointSamples> recall(
      const session::FrameEvidence& evidence) const;

  /// Classifies a lit frame and, unless something speaks against it, learns from it.
  [[nodiscard]] PictureFinding validate(int shot, const PointSamples& samples,
                                        const session::FrameEvidence& evidence);

 private:
  struct Pattern {
    std::vector<DrivenLight> lit;
    std::vector<int> shots;
    bool is_single = false;
  };
  struct Shown {
    int shot = -1;
    PointSamples samples;
  };
  struct Other {
    int shot = -1;
    PointValues picture = PointValues::Zero();
    bool may_mix = false;  ///< was lit just before
  };
  /// Of a frame against its own prediction.
  struct Fit {
    double gain = 1.0;
    double rest = 0.0;          ///< robust mean square of z
    double towards_last = 0.0;  ///< z of the fraction from the previous frame
  };
  [[nodiscard]] PictureFinding compare(int pattern, const PointSamples& y,
                                       const LightPredictor::Prediction& own,
                                       const std::vector<Other>& others, bool is_direct,
                                       Fit& own_fit) const;
  [[nodiscard]] std::vector<Other> others_of(int shot) const;
  /// One of the last few shots, of another pattern, that this picture repeats; -1: none, or
  /// successive patterns look alike here anyway.
  [[nodiscard]] int repeated_shot(int shot, const PointSamples& y);
  void note_difference(double square);
  void start_again();
  [[nodiscard]] std::string pattern_words(int shot) const;

  LightLayout layout_;
  session::FrameForm form_;
  std::optional<LightPredictor> predictor_;  ///< from the first lit frame on
  std::vector<Pattern> patterns_;
  std::vector<int> pattern_of_;  ///< of a shot; -1: a dark one
  std::vector<int> shot_of_light_;
  std::set<int> learned_;      ///< shots
  std::vector<Shown> recent_;  ///< newest last
  bool is_after_dark_ = true;  ///< no light was seen since all were turned off
  std::int64_t last_start_ns_ = 0;
  PointValues dark_dn_;
  // Between the pictures of successive patterns: log of the square of z, mean and variance.
  double difference_log_ = 0.0;
  double difference_log_var_ = 0.0;
  int n_differences_ = 0;
  /// Factor of the variances, of smooth and of direct predictions.
  std::array<double, 2> kappa2_{16.0, 4.0};
  int n_disagreed_ = 0;  ///< consecutive frames unlike an earlier one of their pattern
};

}  // namespace haarlight::capture
