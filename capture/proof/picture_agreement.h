// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <limits>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "capture/proof/picture_points.h"
#include "haarlight/capture/plan/plan.h"

/// @file
/// Two pictures of the same lights must be the same picture. A frame that shows, wholly or in
/// part, the light before its own differs from a frame of the same lights that followed another
/// light. Frames that agree, although different lights preceded them, show their own; and how
/// much of another could still hide in them is a number. Needs no model of the scene, only a
/// plan that shows each pattern twice, in different orders (`repeats`, see plan_rounds.h).
/// Method and measured figures: docs/numerics/light-proof.md.

namespace haarlight::capture {

struct AgreementFinding {
  /// A shot with the same picture; the frame's own shot: an earlier take, since replaced; -1:
  /// none so far.
  int agrees_with = -1;
  /// Upper bound, at 5 sigma, of the fraction of the frame's light that comes from the lights
  /// shown before, 0 .. 1; valid where agrees_with is set.
  double other_fraction = 1.0;
  std::vector<int> doubted;  ///< shots, possibly this one, to be retaken
  bool is_given_up = false;  ///< accepted although it never agreed with another
  std::string note;          ///< for the log
};

/// Follows the frames of one session in the order of their exposures. One thread.
/// Memory: 600 bytes per frame.
class PictureAgreement {
 public:
  explicit PictureAgreement(const Plan& plan);

  /// A lit frame of the plan's shot.
  /// @param start_ns  start of the exposure, CLOCK_MONOTONIC
  [[nodiscard]] AgreementFinding take(int shot, const PointSamples& samples,
                                      std::int64_t start_ns);
  /// A dark frame, or all lights off for another reason.
  void take_dark(std::int64_t start_ns);

 private:
  using Points = Eigen::Array<float, kProofPoints, 1>;
  struct Take {
    int shot = -1;
    int pattern = -1;  ///< -1: dark
    int visit = 0;     ///< incremented whenever other lights are shown
    bool is_kept = false;
    bool is_agreed = false;
    bool is_lit = false;  ///< some light is visible
    std::int64_t start_ns = 0;
    Points mean = Points::Zero();
    Points sigma = Points::Zero();  ///< infinite: does not count
  };
  struct Pair {
    bool is_comparable = false;
    bool agrees = false;
    double fraction = 1.0;                                  ///< at most, from the previous
                                                            ///< light
    double rest = std::numeric_limits<double>::infinity();  ///< robust mean square of z
  };
  [[nodiscard]] Pair compare(int a, int b) const;
  /// Gain of `b` over `a`: mean and sigma of its prior.
  [[nodiscard]] std::pair<double, double> expected_gain(const Take& a, const Take& b) const;
  void learn_gain(int a, int b);
  /// @param rest  the least of a new take compared with the others
  void learn_noise(double rest);
  [[nodiscard]] std::vector<int> pictures_before(int take) const;
  /// Takes of other patterns, shown at nearly the same time, with the same picture.
  [[nodiscard]] std::vector<int> look_alikes(int take, bool only_agreed) const;
  /// No visible light, where most frames have some.
  [[nodiscard]] bool is_dark(int take);
  void doubt_dark(int own, AgreementFinding& finding);
  void settle(int own, int best, const std::vector<int>& disagreeing,
              AgreementFinding& finding);
  void dispute(int own, const std::vector<int>& disagreeing, AgreementFinding& finding);
  void doubt_pattern(int pattern, AgreementFinding& finding);
  /// A kept take against its only partner in a dispute: the two say nothing of each other.
  void separate(int own, AgreementFinding& finding);
  void doubt(int take, AgreementFinding& finding);
  [[nodiscard]] Take& at(int take) { return takes_[static_cast<std::size_t>(take)]; }
  [[nodiscard]] const Take& at(int take) const {
    return takes_[static_cast<std::size_t>(take)];
  }
  /// Takes of a pattern except `own`: the newest kept ones, and the newest others.
  [[nodiscard]] std::vector<int> newest(int pattern, int own) const;
  void push(Take take);

  std::vector<int> pattern_of_;               ///< of a shot; -1: dark
  std::vector<Take> takes_;                   ///< in the order of their exposures
  std::vector<std::vector<int>> by_pattern_;  ///< indices into takes_
  std::map<int, int> take_of_shot_;           ///< the kept one
  std::map<int, int> n_doubted_;              ///< of a shot
  std::set<std::pair<int, int>> alike_;       ///< patterns found to look alike once
  std::set<int> dark_shots_;                  ///< retaken once for being dark
  int n_lit_ = 0;
  int n_unlit_ = 0;
  std::set<int> disputed_;  ///< patterns whose takes contradict each other
  // log gain = rate * seconds between the two, and its scatter.
  double rate_num_ = 0.0;
  double rate_den_ = 0.0;
  double log_sigma_ = 0.05;
  int n_gains_ = 0;
  std::deque<double> rests_;
  double kappa2_ = 1.0;  ///< factor of the variances: the rig file's noise may be too small
  double typical_log_fraction_ = 0.0;  ///< from what pairs say of other lights
  int n_settled_ = 0;
};

}  // namespace haarlight::capture
