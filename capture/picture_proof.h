#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "capture/light_predictor.h"
#include "capture/plan.h"
#include "core/image.h"
#include "core/rig.h"
#include "session/evidence.h"
#include "session/session.h"

/// @file
/// Proof by light: a frame's own pixels beside what the session so far predicts for its pattern
/// and for the others. Formulas, limits and measured figures: docs/numerics/light-proof.md.

namespace haarlight {

/// The lights' places and the sensor's noise.
struct LightLayout {
  std::vector<FaceGrid> faces;  ///< in the lights' order; empty: no proof by light
  SensorNoise noise;
};
[[nodiscard]] LightLayout light_layout(const Rig& rig, const CameraSpec& camera);

/// Means of small blocks in the middle of the 8 x 8 cells of a picture, at unit exposure.
struct PointSamples {
  PointValues mean = PointValues::Zero();       ///< counts a microsecond at 0 dB, less dark
  PointValues noise = PointValues::Zero();      ///< its variance: photons, reading, rounding
  Eigen::Array<bool, kProofPoints, 1> is_good;  ///< no clipped pixel
};
/// @param dark_dn  of each point
[[nodiscard]] PointSamples sample_points(ImageView<const std::uint16_t> active,
                                         const FrameForm& form, const SensorNoise& noise,
                                         const PointValues& dark_dn, double exposure_us,
                                         double gain_db);
/// The blocks' means in counts.
[[nodiscard]] PointValues block_means(ImageView<const std::uint16_t> active);

struct PictureFinding {
  enum class Kind {
    unpredicted,  ///< nothing to compare with yet
    unproven,     ///< a prediction that does not tell it from another pattern, or does not fit
    proved,       ///< nearer to its own than to every other by more than 5 sigma
    wrong,        ///< nearer to another, or mixed with the one before, by more than 5 sigma
  };
  Kind kind = Kind::unpredicted;
  double own_sigma = 0.0;             ///< distance to its own prediction
  double other_sigma = 0.0;           ///< and to the nearest other one
  double discrimination_sigma = 0.0;  ///< between the two; 0: no other
  int other = -1;                     ///< a shot of that other pattern
  std::string problem;                ///< for wrong, in words
  std::vector<int> doubted;           ///< earlier shots that have to be taken again
  bool is_suspect = false;  ///< taken although it came again and again like another light's
  std::string note;         ///< worth a line in the log
};

/// Judges the frames of one session in the order of their exposures. One thread.
class PictureProof {
 public:
  PictureProof(const Plan& plan, const LightLayout& layout, const FrameForm& form);

  /// Judges a lit frame and, unless it is wrong, learns it. One that comes again the same
  /// where only smoothness was against it is believed; if it looks like another light it is
  /// taken as suspect, or that light's frame is doubted instead.
  /// When the last lit shot is learned all frames are looked at once more, each beside what all
  /// others predict.
  [[nodiscard]] PictureFinding judge(int shot, ImageView<const std::uint16_t> active,
                                     const FrameEvidence& evidence);

 private:
  struct Pattern {
    std::vector<DrivenLight> lit;
    std::vector<int> shots;
    bool is_single = false;
  };
  struct Learned {
    PointValues mean;
    PointSamples samples;
    double rho = 0.0;
    PointValues before = PointValues::Zero();  ///< what the frame before it showed
    int shot_before = -1;
  };
  struct Shown {
    int shot = -1;
    PointSamples samples;
  };
  struct Refused {
    PointSamples samples;
    int n = 0;  ///< refused so far
  };
  struct Other {
    int shot = -1;
    PointValues picture = PointValues::Zero();
    bool may_mix = false;  ///< was lit just before
  };
  /// Of a frame beside its own prediction.
  struct Fit {
    double gain = 1.0;
    double rest = 0.0;          ///< robust mean square of z
    double towards_last = 0.0;  ///< z of the share of the frame before
  };
  [[nodiscard]] PictureFinding compare(int pattern, const PointSamples& y,
                                       const LightPredictor::Prediction& own,
                                       const std::vector<Other>& others, bool is_direct,
                                       Fit& own_fit) const;
  [[nodiscard]] std::vector<Other> others_of(int shot) const;
  /// A shot of the last few, of another pattern, whose picture this is; -1: none, or successive
  /// patterns look alike here anyway.
  [[nodiscard]] int repeated_shot(int shot, const PointSamples& y);
  void note_difference(double square);
  /// A refused frame that came again the same.
  void believe_again(int shot, bool is_direct, bool is_repeated, int n_refused,
                     PictureFinding& finding);
  [[nodiscard]] bool is_same_picture(const PointSamples& a, const PointSamples& b) const;
  void learn(int shot, const PointSamples& y, const LightPredictor::Prediction& own,
             double gain);
  void forget(int shot);
  [[nodiscard]] std::vector<int> doubt_pattern(int pattern, int but_shot);
  /// A learned frame beside what all others predict.
  [[nodiscard]] PictureFinding compare_without(int shot) const;
  [[nodiscard]] std::vector<int> look_again();
  void start_again();
  [[nodiscard]] std::string pattern_words(int shot) const;

  LightLayout layout_;
  FrameForm form_;
  std::optional<LightPredictor> predictor_;  ///< from the first lit frame on
  std::vector<Pattern> patterns_;
  std::vector<int> pattern_of_;  ///< of a shot; -1: a dark one
  std::vector<int> shot_of_light_;
  int n_lit_shots_ = 0;
  std::map<int, Learned> learned_;
  std::map<int, Refused> refused_;  ///< the last one of a shot
  std::vector<bool> is_looked_at_;  ///< doubted by the second look, once a shot
  std::vector<Shown> recent_;       ///< newest last
  bool is_after_dark_ = true;       ///< no light was seen since all were off
  std::int64_t last_start_ns_ = 0;
  PointValues dark_dn_;
  // Between the pictures of successive patterns: log of the square of z, mean and variance.
  double difference_log_ = 0.0;
  double difference_log_var_ = 0.0;
  int n_differences_ = 0;
  /// Factor of the variances, of smooth and of direct predictions.
  std::array<double, 2> kappa2_{16.0, 4.0};
  int n_disagreed_ = 0;  ///< frames in a row unlike an earlier one of their pattern
};

}  // namespace haarlight
