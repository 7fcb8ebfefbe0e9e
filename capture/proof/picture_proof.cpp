// SPDX-License-Identifier: Apache-2.0
#include "capture/proof/picture_proof.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include <fmt/format.h>

#include "haarlight/core/error.h"

namespace haarlight::capture {

namespace {

constexpr double kNearer = 5.0;      // sigma
constexpr double kRepeatTol = 1e-3;  // repeatability from one frame to the next
constexpr double kRepeats =
    3.0;  // mean square of z up to which two frames are the same picture
// Successive pictures whose difference must be known before one without a difference is
// suspect; sums of many lights differ less evenly.
constexpr int kFewDifferences = 3;
constexpr int kManyDifferences = 32;
constexpr double kLeastFraction = 0.03;  // of another pattern in a mixture
constexpr double kMostFraction = 1.5;    // no mixture contains more than all of a light
constexpr double kFits = 4.0;            // mean square of z up to which a prediction fits
constexpr double kDisagrees = 9.0;       // beyond this: not the picture of the earlier frame
constexpr int kMoved = 4;                // such frames in a row: the scene has changed
constexpr double kHuber = 2.0;
constexpr double kKnown = 0.5;        // v of a light beyond which nothing is concluded about it
constexpr double kDark = 0.1;         // of the predicted light: none
constexpr double kDarkBefore = 0.75;  // the same after a dark frame
constexpr std::size_t kRecent = 12;   // patterns that a controller may lag by
constexpr int kLeastPoints = 8;
constexpr double kMostKappa2 = 400.0;
constexpr double kKappaRate = 0.02;  // of its square, per frame

/// y = b_1 mu + b_2 c by least squares with Huber's weights.
struct FractionFit {
  double fraction = 0.0;  ///< of c
  double sigma = 1.0;     ///< of the fraction; infinite when mu and c are alike
  double gain = 1.0;
  double rest = 0.0;  ///< robust mean square of the remainder, 1: noise
};

PointValues huber_weights(const PointValues& r, const PointValues& inverse_variance) {
  const PointValues z = (r.square() * inverse_variance).sqrt();
  return inverse_variance * (kHuber / z.max(kHuber));
}

FractionFit fit_fraction(const PointValues& y, const PointValues& mu, const PointValues& c,
                         const PointValues& inverse_variance, const PointMask& counts,
                         int n_iterations) {
  FractionFit fit;
  PointValues w = inverse_variance;
  double b1 = 1.0;
  double b2 = 0.0;
  double s2 = 0.0;
  for (int i = 0; i < n_iterations; ++i) {
    const double mm = (w * mu * mu).sum();
    const double mc = (w * mu * c).sum();
    const double cc = (w * c * c).sum();
    const double my = (w * mu * y).sum();
    const double cy = (w * c * y).sum();
    const double det = mm * cc - mc * mc;
    if (!(det > 1e-9 * mm * cc)) {
      fit.sigma = std::numeric_limits<double>::infinity();
      return fit;
    }
    b1 = (cc * my - mc * cy) / det;
    b2 = (mm * cy - mc * my) / det;
    s2 = mm / det;
    w = huber_weights(y - b1 * mu - b2 * c, inverse_variance);
  }
  fit.gain = b1 + b2;
  fit.fraction = b2 / std::max(b1 + b2, 1e-3);
  fit.sigma = std::sqrt(s2);
  fit.rest = robust_square((y - b1 * mu - b2 * c).square() * inverse_variance, counts);
  return fit;
}

/// y = g mu.
double fit_gain(const PointValues& y, const PointValues& mu,
                const PointValues& inverse_variance) {
  PointValues w = inverse_variance;
  double g = 1.0;
  for (int i = 0; i < 4; ++i) {
    g = (w * mu * y).sum() / std::max((w * mu * mu).sum(), 1e-300);
    w = huber_weights(y - g * mu, inverse_variance);
  }
  return g;
}

/// With the points' drift added to their noise.
PointValues variance_of(const PointSamples& y, double tolerance) {
  return y.noise + (tolerance * y.mean).square();
}

/// Distance with each point's contribution capped at 4 sigma.
double distance(const PointValues& r, const PointValues& inverse_variance) {
  return std::sqrt((r.square() * inverse_variance).min(16.0).sum());
}

}  // namespace

LightLayout light_layout(const Rig& rig, const CameraSpec& camera) {
  LightLayout layout;
  for (const Face& face : rig.faces) {
    layout.faces.push_back({face.rows, face.cols});
  }
  layout.noise = camera.noise;
  return layout;
}

PictureProof::PictureProof(const Plan& plan, const LightLayout& layout,
                           const session::FrameForm& form)
    : layout_(layout), form_(form), dark_dn_(PointValues::Constant(form.black_level)) {
  int n_lights = 0;
  for (const FaceGrid& face : layout.faces) {
    n_lights += face.n_lights();
  }
  HAARLIGHT_EXPECTS(n_lights >= plan.n_lights, "a position for each light of the plan");
  shot_of_light_.assign(static_cast<std::size_t>(n_lights), -1);
  pattern_of_ = same_lights(plan.shots);
  for (const session::Shot& shot : plan.shots) {
    const int number = pattern_of_[static_cast<std::size_t>(shot.index)];
    if (number < 0) {
      continue;
    }
    if (static_cast<std::size_t>(number) == patterns_.size()) {
      Pattern pattern;
      for (const session::LightLevel& light : shot.lit) {
        if (light.level > 0) {
          pattern.lit.emplace_back(light.light, light.level / 65535.0);
        }
      }
      pattern.is_single = pattern.lit.size() == 1;
      if (pattern.is_single) {
        shot_of_light_[static_cast<std::size_t>(pattern.lit[0].first)] = shot.index;
      }
      patterns_.push_back(std::move(pattern));
    }
    patterns_[static_cast<std::size_t>(number)].shots.push_back(shot.index);
  }
}

std::string PictureProof::pattern_words(int shot) const {
  const int p = pattern_of_[static_cast<std::size_t>(shot)];
  if (p < 0) {
    return "darkness";
  }
  const Pattern& pattern = patterns_[static_cast<std::size_t>(p)];
  return pattern.is_single ? fmt::format("light {}", pattern.lit[0].first)
                           : fmt::format("the pattern of shot {}", shot);
}

std::vector<PictureProof::Other> PictureProof::others_of(int shot) const {
  const int own = pattern_of_[static_cast<std::size_t>(shot)];
  std::vector<Other> others;
  for (const Shown& shown : recent_) {
    if (pattern_of_[static_cast<std::size_t>(shown.shot)] != own) {
      others.push_back({shown.shot, shown.samples.mean, true});
    }
  }
  for (int next = shot + 1; next <= shot + 2; ++next) {
    if (next >= static_cast<int>(pattern_of_.size())) {
      break;
    }
    const int p = pattern_of_[static_cast<std::size_t>(next)];
    if (p < 0 || p == own || patterns_[static_cast<std::size_t>(p)].is_single) {
      continue;  // single lights are all examined as well
    }
    const auto next_one = predictor_->predict(patterns_[static_cast<std::size_t>(p)].lit);
    if (next_one.spread <
        kKnown * static_cast<double>(patterns_[static_cast<std::size_t>(p)].lit.size())) {
      others.push_back({next, next_one.mean, false});
    }
  }
  return others;
}

PictureFinding PictureProof::compare(int pattern, const PointSamples& y,
                                     const LightPredictor::Prediction& own,
                                     const std::vector<Other>& others, bool is_direct,
                                     Fit& own_fit) const {
  const double kappa2 = kappa2_[is_direct ? 1 : 0];
  PictureFinding finding;
  double& rest = own_fit.rest;
  double& gain = own_fit.gain;
  finding.is_predicted = true;
  const PointValues inverse_variance = y.is_good.select(
      1.0 / (kappa2 * (own.variance + variance_of(y, kPointModelTol))), PointValues::Zero());
  gain = fit_gain(y.mean, own.mean, inverse_variance);
  const PointValues r = y.mean - gain * own.mean;
  rest = robust_square(r.square() * inverse_variance, y.is_good);
  finding.own_sigma = distance(r, inverse_variance);
  if (y.is_good.count() < kLeastPoints) {
    return finding;
  }
  double least = std::numeric_limits<double>::infinity();  // sigma nearer to its own
  const auto take = [&](int shot, const PointValues& c, const FractionFit& fit, double nearer) {
    least = nearer;
    finding.other = shot;
    finding.discrimination_sigma = 1.0 / fit.sigma;
    finding.other_sigma =
        distance(y.mean - fit_gain(y.mean, c, inverse_variance) * c, inverse_variance);
  };
  bool is_wrong = false;
  const auto look_at = [&](int shot, const PointValues& c, bool may_mix) {
    const FractionFit fit = fit_fraction(y.mean, own.mean, c, inverse_variance, y.is_good, 5);
    if (!std::isfinite(fit.sigma)) {
      return;
    }
    const double nearer = (0.5 - fit.fraction) / fit.sigma;
    if (may_mix) {
      own_fit.towards_last = fit.fraction / fit.sigma * std::sqrt(kappa2);  // of the newest
    }
    // What smoothness predicts is trusted only where the whole picture is off.
    const bool fits = fit.fraction < kMostFraction && fit.rest <= kFits &&
                      fit.rest < 0.8 * rest && (is_direct || rest > kFits);
    const bool is_mixed =
        may_mix && fit.fraction > kLeastFraction && fit.fraction > kNearer * fit.sigma && fits;
    const bool is_other = nearer < -kNearer && fits;
    if ((is_mixed || is_other) && (!is_wrong || nearer < least)) {
      is_wrong = true;
      take(shot, c, fit, nearer);
      finding.problem =
          fmt::format("the picture is {:.0f} % {}, {:.1f} sigma from its own",
                      100.0 * fit.fraction, pattern_words(shot), fit.fraction / fit.sigma);
    } else if (!is_wrong && nearer < least) {
      take(shot, c, fit, nearer);
    }
  };
  for (const Other& other : others) {
    look_at(other.shot, other.picture, other.may_mix);
  }
  const Pattern& p = patterns_[static_cast<std::size_t>(pattern)];
  if (p.is_single) {
    // All other lights; the plain one-step fit selects those worth the robust one.
    int nearest = -1;
    double nearest_by = std::numeric_limits<double>::infinity();
    for (int k = 0; k < predictor_->n_lights(); ++k) {
      const int shot = shot_of_light_[static_cast<std::size_t>(k)];
      if (k == p.lit[0].first || shot < 0 || predictor_->spread_of(k) > kKnown) {
        continue;
      }
      const PointValues c =
          predictor_->predict(std::vector<DrivenLight>{{k, p.lit[0].second}}).mean;
      const FractionFit fit = fit_fraction(y.mean, own.mean, c, inverse_variance, y.is_good, 1);
      const double nearer = (0.5 - fit.fraction) / fit.sigma;
      if (std::isfinite(fit.sigma) && nearer < nearest_by) {
        nearest_by = nearer;
        nearest = k;
      }
    }
    if (nearest >= 0) {
      look_at(shot_of_light_[static_cast<std::size_t>(nearest)],
              predictor_->predict(std::vector<DrivenLight>{{nearest, p.lit[0].second}}).mean,
              false);
    }
  }
  return finding;
}

int PictureProof::repeated_shot(int shot, const PointSamples& y) {
  const int own = pattern_of_[static_cast<std::size_t>(shot)];
  int repeated = -1;
  for (std::size_t i = 0; i < recent_.size(); ++i) {
    const Shown& shown = recent_[i];
    if (pattern_of_[static_cast<std::size_t>(shown.shot)] == own) {
      continue;
    }
    const PointMask counts = y.is_good && shown.samples.is_good;
    const PointValues inverse_variance = counts.select(
        1.0 / (variance_of(y, kRepeatTol) + variance_of(shown.samples, kRepeatTol)),
        PointValues::Zero());
    const double square =
        robust_square((y.mean - shown.samples.mean).square() * inverse_variance, counts, true);
    const bool is_lit = (y.mean.square() * inverse_variance).sum() > kLitSquare;
    if (!is_lit) {
      continue;
    }
    if (counts.count() >= kLeastPoints && square < kRepeats) {
      repeated = shown.shot;
    } else if (i + 1 == recent_.size()) {
      note_difference(square);
    }
  }
  const bool is_single = patterns_[static_cast<std::size_t>(own)].is_single;
  const bool is_told_apart =
      n_differences_ >= (is_single ? kFewDifferences : kManyDifferences) &&
      difference_log_ - 3.0 * std::sqrt(difference_log_var_) > std::log(kRepeats);
  return is_told_apart ? repeated : -1;
}

void PictureProof::note_difference(double square) {
  const double log = std::log(std::max(square, 0.1));
  const double rate = std::max(0.1, 1.0 / (1.0 + n_differences_));
  const double step = log - difference_log_;
  difference_log_ += rate * step;
  difference_log_var_ = (1.0 - rate) * (difference_log_var_ + rate * step * step);
  ++n_differences_;
}

std::optional<PointSamples> PictureProof::sample(int shot,
                                                 ImageView<const std::uint16_t> active,
                                                 const session::FrameEvidence& evidence) {
  if (pattern_of_[static_cast<std::size_t>(shot)] < 0) {
    dark_dn_ = block_means(active);
    is_after_dark_ = true;
    return std::nullopt;
  }
  return sample_points(active, form_, layout_.noise, dark_dn_, evidence.exposure_read_us,
                       evidence.gain_db);
}

std::optional<PointSamples> PictureProof::recall(const session::FrameEvidence& evidence) const {
  if (evidence.picture_points.size() != kProofPoints) {
    return std::nullopt;
  }
  const PointValues mean = Eigen::Map<const PointValues>(evidence.picture_points.data());
  return samples_of(mean, mean != kClippedPoint, form_, layout_.noise,
                    evidence.exposure_read_us, evidence.gain_db);
}

PictureFinding PictureProof::validate(int shot, const PointSamples& y,
                                      const session::FrameEvidence& evidence) {
  const int pattern = pattern_of_[static_cast<std::size_t>(shot)];
  if (evidence.t_exposure_start_ns - last_start_ns_ > kDarkPauseNs) {
    is_after_dark_ = true;  // paused or suspended in between
  }
  last_start_ns_ = evidence.t_exposure_start_ns;
  if (!predictor_) {
    predictor_.emplace(
        layout_.faces);  // here: 15 ms for 1024 lights, not on the control thread
  }
  const Pattern& p = patterns_[static_cast<std::size_t>(pattern)];
  const LightPredictor::Prediction own = predictor_->predict(p.lit);
  const bool is_direct = std::any_of(p.shots.begin(), p.shots.end(),
                                     [this](int s) { return learned_.count(s) > 0; });
  double& kappa2 = kappa2_[is_direct ? 1 : 0];
  PictureFinding finding;
  Fit fit;
  if (predictor_->is_ready()) {
    finding = compare(pattern, y, own, others_of(shot), is_direct, fit);
    const bool is_seen =
        (own.mean.square() / variance_of(y, kPointModelTol)).sum() > kLitSquare;
    if (finding.problem.empty() && is_seen &&
        fit.gain < (is_after_dark_ ? kDarkBefore : kDark)) {
      finding.problem =
          fmt::format("only {:.0f} % of the light that is predicted", 100.0 * fit.gain);
    }
    const bool disagrees = is_direct && fit.rest > kDisagrees;
    n_disagreed_ = disagrees ? n_disagreed_ + 1 : 0;
    if (n_disagreed_ >= kMoved) {
      start_again();
      finding = {};
      finding.note =
          "the pictures are no longer those of earlier frames of the same lights: the scene "
          "has changed; its pictures are predicted anew";
    } else if (disagrees && finding.problem.empty()) {
      finding.problem = "not the picture of an earlier frame of the same pattern";
    }
  }
  const int repeated = repeated_shot(shot, y);
  const bool is_lit = (y.mean.square() / variance_of(y, kPointModelTol)).sum() > kLitSquare;
  if (is_after_dark_ && !is_lit && finding.problem.empty()) {
    finding.problem = "as dark as before this light";
  }
  if (repeated >= 0 && finding.problem.empty()) {
    finding.other = repeated;
    finding.problem =
        fmt::format("the same picture as {}, which was shown before", pattern_words(repeated));
  }
  recent_.push_back({shot, y});
  if (recent_.size() > kRecent) {
    recent_.erase(recent_.begin());
  }
  is_after_dark_ = is_after_dark_ && !is_lit;
  if (!finding.problem.empty()) {
    return finding;  // nothing is learned of it
  }
  if (fit.towards_last != 0.0) {
    // What a good frame seems to contain of the one before is z of unit variance, if the
    // prediction errors were independent from point to point: three of four lie within 1.15
    // kappa.
    const bool is_beyond = std::abs(fit.towards_last) > 1.15 * std::sqrt(kappa2);
    kappa2 = std::clamp(kappa2 * std::exp(is_beyond ? 3.0 * kKappaRate : -kKappaRate), 1.0,
                        kMostKappa2);
  }
  const PointValues mean =
      y.is_good.select(y.mean / std::clamp(is_direct ? fit.gain : 1.0, 0.8, 1.25), own.mean);
  predictor_->learn(p.lit, mean, variance_of(y, kPointModelTol));
  learned_.insert(shot);
  return finding;
}

void PictureProof::start_again() {
  predictor_.emplace(layout_.faces);
  learned_.clear();
  recent_.clear();
  n_disagreed_ = 0;
}

}  // namespace haarlight::capture
