// SPDX-License-Identifier: Apache-2.0
#include "capture/proof/picture_agreement.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>

#include "haarlight/core/error.h"

namespace haarlight::capture {

namespace {

constexpr double kSigmas = 5.0;
constexpr double kFits = 4.0;            // robust mean square of z up to which two are the same
constexpr double kLeastFraction = 0.02;  // of another light that makes a frame wrong
constexpr double kMostFraction =
    0.5;                             // beyond this, two pictures do not distinguish two lights
constexpr double kTellsApart = 0.1;  // fraction up to which like pictures are suspect
constexpr int kWindow = 12;          // pictures that a controller may lag by
constexpr int kLeastPoints = 8;
constexpr int kMostDoubts = 16;        // of one shot
constexpr int kFewTakes = 8;           // before a dark picture counts as evidence
constexpr std::size_t kMostTakes = 8;  // of one pattern to compare with a new one
constexpr int kMostBack = 256;         // takes searched for what was shown before
constexpr double kLeastLogSigma = 0.003;
constexpr double kMostLogSigma = 0.2;
constexpr std::size_t kRests = 64;     // pairs from which the noise is learned
constexpr std::size_t kFewRests = 24;  // for it: if a quarter are good, one is by 99.9 %
constexpr double kEven = 8.0;          // between the best of the pairs and three of four
constexpr double kLeastRest = 0.5;     // of 24 to 64 pairs whose noise is as stated
constexpr double kMostKappa2 = 400.0;
constexpr double kForget = 0.95;  // of the knowledge of the gain, per pair

using Vector = Eigen::Array<double, kProofPoints, 1>;

/// a = g (b + alpha u - beta v) by weighted least squares, g with a prior; linear in g, g alpha
/// and g beta. `v` may be absent.
struct Fractions {
  double alpha = 0.0;
  double alpha_sigma = std::numeric_limits<double>::infinity();
  double beta = 0.0;
  double beta_sigma = std::numeric_limits<double>::infinity();
};
Fractions fit_fractions(const Vector& a, const Vector& b, const Vector& u, const Vector* v,
                        const Vector& weight, double gain, double gain_sigma) {
  const int n = v == nullptr ? 2 : 3;
  Eigen::Matrix3d m = Eigen::Matrix3d::Identity();
  Eigen::Vector3d r = Eigen::Vector3d::Zero();
  const double prior = 1.0 / (gain_sigma * gain_sigma);
  const Vector none = Vector::Zero();
  const std::array<const Vector*, 3> columns = {&b, &u, v == nullptr ? &none : v};
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) {
      m(i, j) = (weight * *columns[static_cast<std::size_t>(i)] *
                 *columns[static_cast<std::size_t>(j)])
                    .sum();
    }
    r[i] = (weight * *columns[static_cast<std::size_t>(i)] * a).sum();
  }
  m(0, 0) += prior;
  r[0] += prior * gain;
  // Scaled, so that nearly parallel directions are detected.
  const Eigen::Vector3d scale = m.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  const Eigen::Matrix3d scaled = scale.asDiagonal() * m * scale.asDiagonal();
  Fractions out;
  if (!(scaled.determinant() > 1e-12)) {
    return out;
  }
  const Eigen::Matrix3d inverse = scale.asDiagonal() * scaled.inverse() * scale.asDiagonal();
  const Eigen::Vector3d x = inverse * r;
  const double g = std::max(x[0], 1e-3);
  out.alpha = x[1] / g;
  out.alpha_sigma = std::sqrt(inverse(1, 1)) / g;
  if (v != nullptr) {
    out.beta = -x[2] / g;
    out.beta_sigma = std::sqrt(inverse(2, 2)) / g;
  }
  return out;
}

template <typename Points>
Vector weights(const Points& sigma_a, const Points& sigma_b) {
  const Vector variance =
      (sigma_a.template cast<double>().square() + sigma_b.template cast<double>().square())
          .max(1e-300);
  return variance.isFinite().select(1.0 / variance, Vector::Zero());
}

}  // namespace

PictureAgreement::PictureAgreement(const Plan& plan) : pattern_of_(same_lights(plan.shots)) {
  const auto last = std::max_element(pattern_of_.begin(), pattern_of_.end());
  by_pattern_.resize(last == pattern_of_.end() ? 0 : static_cast<std::size_t>(*last + 1));
}

void PictureAgreement::push(Take take) {
  const bool is_new_visit = takes_.empty() || takes_.back().pattern != take.pattern;
  take.visit = takes_.empty() ? 0 : takes_.back().visit + (is_new_visit ? 1 : 0);
  if (take.pattern >= 0) {
    by_pattern_[static_cast<std::size_t>(take.pattern)].push_back(
        static_cast<int>(takes_.size()));
  }
  takes_.push_back(std::move(take));
}

void PictureAgreement::take_dark(std::int64_t start_ns) {
  Take dark;
  dark.start_ns = start_ns;
  push(dark);
}

std::vector<int> PictureAgreement::pictures_before(int take) const {
  const Take& own = at(take);
  std::vector<int> before;
  int visit = own.visit;
  const int last = std::max(0, take - kMostBack);
  for (int i = take - 1; i >= last && static_cast<int>(before.size()) < kWindow; --i) {
    const Take& t = at(i);
    if (t.visit != visit) {
      visit = t.visit;
      if (t.pattern != own.pattern) {
        before.push_back(i);
      }
    }
  }
  return before;
}

std::pair<double, double> PictureAgreement::expected_gain(const Take& a, const Take& b) const {
  const double seconds = 1e-9 * static_cast<double>(b.start_ns - a.start_ns);
  const double rate = rate_den_ > 0.0 ? rate_num_ / rate_den_ : 0.0;
  const double log_gain = std::clamp(rate * seconds, -1.0, 1.0);
  return {std::exp(log_gain), std::exp(log_gain) * log_sigma_};
}

void PictureAgreement::learn_gain(int a, int b) {
  const Take& x = at(a);
  const Take& y = at(b);
  const Vector weight = weights(x.sigma, y.sigma);
  const Vector xm = x.mean.cast<double>();
  const Vector ym = y.mean.cast<double>();
  const double gain = (weight * xm * ym).sum() / std::max((weight * xm * xm).sum(), 1e-300);
  const double seconds = 1e-9 * static_cast<double>(y.start_ns - x.start_ns);
  if (!(gain > 0.0) || !(seconds > 0.0)) {
    return;
  }
  const double log_gain = std::log(gain);
  const double rest = log_gain - (rate_den_ > 0.0 ? rate_num_ / rate_den_ : 0.0) * seconds;
  const double capped = std::min(rest * rest, 9.0 * log_sigma_ * log_sigma_);
  const double weight_new = std::max(1.0 - kForget, 1.0 / (2.0 + n_gains_++));
  log_sigma_ =
      std::clamp(std::sqrt((1.0 - weight_new) * log_sigma_ * log_sigma_ + weight_new * capped),
                 kLeastLogSigma, kMostLogSigma);
  const double bounded = std::clamp(rest, -3.0 * log_sigma_, 3.0 * log_sigma_);
  rate_num_ = kForget * rate_num_ + (log_gain - rest + bounded) * seconds;
  rate_den_ = kForget * rate_den_ + seconds * seconds;
}

void PictureAgreement::learn_noise(double rest) {
  if (!std::isfinite(rest)) {
    return;
  }
  rests_.push_back(rest);
  if (rests_.size() > kRests) {
    rests_.pop_front();
  }
  if (rests_.size() >= kFewRests) {
    // If the noise were as stated, the best of this many pairs would be far below 1. If the
    // lights differed, the pairs would vary much more.
    std::vector<double> sorted(rests_.begin(), rests_.end());
    std::sort(sorted.begin(), sorted.end());
    const bool is_noise = sorted[3 * sorted.size() / 4] <= kEven * sorted.front();
    kappa2_ = is_noise ? std::clamp(sorted.front() / kLeastRest, 1.0, kMostKappa2) : 1.0;
  }
}

PictureAgreement::Pair PictureAgreement::compare(int a, int b) const {
  const Take& x = at(a);
  const Take& y = at(b);
  Pair pair;
  if (x.visit == y.visit) {
    return pair;
  }
  const Vector weight = weights(x.sigma, y.sigma) / kappa2_;
  const Vector xm = x.mean.cast<double>();
  const Vector ym = y.mean.cast<double>();
  const auto n_points = (weight > 0.0).count();
  if (n_points < kLeastPoints || (weight * xm * xm).sum() < kLitSquare ||
      (weight * ym * ym).sum() < kLitSquare) {
    // One of them shows nothing. Dark and lit disagree nevertheless.
    const double difference = (weight * (xm - ym).square()).sum();
    pair.is_comparable = n_points >= kLeastPoints && difference > kLitSquare;
    return pair;
  }
  const std::pair<double, double> expected = expected_gain(x, y);
  const double gain = expected.first;
  const double gain_sigma = expected.second;
  const std::vector<int> before_x = pictures_before(a);
  const std::vector<int> before_y = pictures_before(b);
  const double own_gain = (weight * xm * ym).sum() / (weight * xm * xm).sum();
  const double rest = robust_square(
      (ym - own_gain * xm).square() * weight / (0.5 * (1.0 + own_gain * own_gain)),
      weight > 0.0);
  pair.rest = rest * kappa2_;
  pair.agrees = rest <= kFits && std::abs(own_gain - gain) <= kSigmas * gain_sigma;
  double fraction = 0.0;
  const auto seen_in = [this](int i, const Vector& of) -> Vector {
    return at(i).sigma.isFinite().select(of, Vector::Zero());  // a clipped point has no value
  };
  const auto look_at = [&](const Vector& later, const Vector& earlier, double g, double g_sigma,
                           const std::vector<int>& before) {
    for (const int i : before) {
      const Take& other = at(i);
      const Vector c = other.mean.cast<double>();
      const Vector u = c - earlier;
      const Fractions fit =
          fit_fractions(later, earlier, u, nullptr, seen_in(i, weight), g, g_sigma);
      const bool is_wrong = std::isfinite(fit.alpha_sigma) && fit.alpha > kLeastFraction &&
                            fit.alpha > kSigmas * fit.alpha_sigma;
      pair.agrees = pair.agrees && !is_wrong;
    }
  };
  look_at(ym, xm, gain, gain_sigma, before_y);
  look_at(xm, ym, 1.0 / gain, gain_sigma / (gain * gain), before_x);
  // How much of the preceding picture may hide in both: alpha of y's, beta of x's.
  const auto direction = [&](const std::vector<int>& before) -> Vector {
    if (before.empty()) {
      return Vector::Zero();
    }
    return at(before.front()).mean.cast<double>() - xm;
  };
  const Vector u = direction(before_y);
  const Vector v = direction(before_x);
  Vector seen = weight;
  for (const std::vector<int>* before : {&before_x, &before_y}) {
    seen = before->empty() ? seen : seen_in(before->front(), seen);
  }
  const auto bound = [](double value, double sigma) {
    return std::isfinite(sigma) ? std::max(value, 0.0) + kSigmas * sigma : 1.0;
  };
  const auto one = [&](const Vector& d, double sign) {
    const Fractions fit = fit_fractions(ym, xm, d, nullptr, seen, gain, gain_sigma);
    return bound(sign * fit.alpha, fit.alpha_sigma);
  };
  if (!before_y.empty()) {
    fraction = std::max(fraction, one(u, 1.0));
  }
  if (!before_x.empty()) {
    fraction = std::max(fraction, one(v, -1.0));
  }
  if (!before_x.empty() && !before_y.empty() &&
      (seen * u * v).sum() > 0.0) {  // otherwise neither can compensate for the other
    const Fractions fit = fit_fractions(ym, xm, u, &v, seen, gain, gain_sigma);
    fraction = std::max(
        {fraction, bound(fit.alpha, fit.alpha_sigma), bound(fit.beta, fit.beta_sigma)});
  }
  // The light may have changed more than once in between: then what was on is neither u nor v,
  // but as far from S as they are. Its direction is unknown; chi square of n points bounds it.
  const auto n = static_cast<double>(n_points);
  const double chi2 = ((ym - own_gain * xm).square() * weight).min(16.0).sum();
  const double hidden2 = std::max(chi2 - n, 0.0) + kSigmas * std::sqrt(2.0 * n);
  for (const Vector* d : {&u, &v}) {
    const double length2 = (seen * d->square()).sum();
    fraction = std::max(fraction, length2 > 0.0 ? std::sqrt(hidden2 / length2) : 0.0);
  }
  pair.fraction = std::min(fraction, 1.0);
  pair.is_comparable = !pair.agrees || pair.fraction <= kMostFraction;
  return pair;
}

void PictureAgreement::doubt(int take, AgreementFinding& finding) {
  Take& t = at(take);
  if (!t.is_kept) {
    return;
  }
  int& n = n_doubted_[t.shot];
  if (n >= kMostDoubts) {
    finding.is_given_up = true;
    return;
  }
  ++n;
  t.is_kept = false;
  t.is_agreed = false;
  take_of_shot_.erase(t.shot);
  finding.doubted.push_back(t.shot);
}

void PictureAgreement::doubt_pattern(int pattern, AgreementFinding& finding) {
  disputed_.insert(pattern);
  std::vector<int>& takes = by_pattern_[static_cast<std::size_t>(pattern)];
  for (const int i : takes) {
    at(i).is_agreed = false;
    doubt(i, finding);
  }
  takes.clear();
}

std::vector<int> PictureAgreement::newest(int pattern, int own) const {
  const std::vector<int>& takes = by_pattern_[static_cast<std::size_t>(pattern)];
  std::vector<int> found;
  for (const bool is_kept : {true, false}) {
    std::size_t n = 0;
    for (auto it = takes.rbegin(); it != takes.rend() && n < kMostTakes; ++it) {
      if (*it != own && at(*it).is_kept == is_kept) {
        found.push_back(*it);
        ++n;
      }
    }
  }
  return found;
}

std::vector<int> PictureAgreement::look_alikes(int take, bool only_agreed) const {
  const Take& own = at(take);
  std::set<int> patterns;
  for (const int i : newest(own.pattern, -1)) {
    const int end = std::min(i + kWindow + 1, static_cast<int>(takes_.size()));
    for (int k = std::max(0, i - kWindow); k < end; ++k) {
      patterns.insert(at(k).pattern);
    }
  }
  patterns.erase(-1);
  patterns.erase(own.pattern);
  std::vector<int> alike;
  for (const int pattern : patterns) {
    for (const int i : newest(pattern, -1)) {
      if (only_agreed && !at(i).is_agreed) {
        continue;
      }
      const Vector weight = weights(own.sigma, at(i).sigma) / kappa2_;
      const Vector z = own.mean.cast<double>() - at(i).mean.cast<double>();
      if (robust_square(z.square() * weight, weight > 0.0) <= kFits) {
        alike.push_back(i);
        break;
      }
    }
  }
  return alike;
}

AgreementFinding PictureAgreement::take(int shot, const PointSamples& samples,
                                        std::int64_t start_ns) {
  HAARLIGHT_EXPECTS(shot >= 0 && static_cast<std::size_t>(shot) < pattern_of_.size() &&
                        pattern_of_[static_cast<std::size_t>(shot)] >= 0,
                    "a lit shot of the plan");
  if (!takes_.empty() && takes_.back().pattern >= 0 &&
      start_ns - takes_.back().start_ns > kDarkPauseNs) {
    take_dark(start_ns);  // paused or suspended in between
  }
  Take taken;
  taken.shot = shot;
  taken.pattern = pattern_of_[static_cast<std::size_t>(shot)];
  taken.start_ns = start_ns;
  taken.is_kept = true;
  const Vector tolerance = kPointModelTol * samples.mean.abs();
  taken.mean = samples.mean.cast<float>();
  taken.sigma = samples.is_good
                    .select((samples.noise + tolerance.square()).sqrt(),
                            Vector::Constant(std::numeric_limits<double>::infinity()))
                    .cast<float>();
  const auto before = take_of_shot_.find(shot);
  if (before != take_of_shot_.end()) {
    at(before->second).is_kept = false;
  }
  const int own = static_cast<int>(takes_.size());
  push(std::move(taken));
  take_of_shot_[shot] = own;

  AgreementFinding finding;
  if (is_dark(own)) {
    doubt_dark(own, finding);
    return finding;
  }
  std::vector<int> disagreeing;
  double least_rest = std::numeric_limits<double>::infinity();
  int best = -1;
  for (const int i : newest(at(own).pattern, own)) {
    const Pair pair = compare(i, own);
    least_rest = std::min(least_rest, pair.rest);
    if (!pair.is_comparable) {
      continue;
    }
    if (!pair.agrees) {
      disagreeing.push_back(i);
    } else if (best < 0 || pair.fraction < finding.other_fraction) {
      best = i;
      finding.other_fraction = pair.fraction;
    }
  }
  learn_noise(least_rest);
  if (best >= 0) {
    settle(own, best, disagreeing, finding);
  } else if (!disagreeing.empty()) {
    dispute(own, disagreeing, finding);
  } else if (disputed_.count(at(own).pattern) > 0) {
    separate(own, finding);
  }
  return finding;
}

bool PictureAgreement::is_dark(int take) {
  Take& own = at(take);
  const Vector weight = weights(own.sigma, Points::Zero().eval());
  own.is_lit = (weight * own.mean.cast<double>().square()).sum() >= kLitSquare;
  const bool is_odd = n_lit_ >= kFewTakes && n_lit_ > 4 * n_unlit_;
  ++(own.is_lit ? n_lit_ : n_unlit_);
  return !own.is_lit && is_odd;
}

void PictureAgreement::doubt_dark(int own, AgreementFinding& finding) {
  const int shot = at(own).shot;
  // Of a dead LED nothing else is known; one seen before is only late.
  const std::vector<int> others = newest(at(own).pattern, own);
  const bool was_seen =
      std::any_of(others.begin(), others.end(), [this](int i) { return at(i).is_lit; });
  finding.is_given_up = !dark_shots_.insert(shot).second && !was_seen;
  finding.note = fmt::format("shot {} is as dark as without its light: {}", shot,
                             finding.is_given_up ? "taken all the same" : "taken again");
  if (!finding.is_given_up) {
    doubt(own, finding);
  }
}

void PictureAgreement::settle(int own, int best, const std::vector<int>& disagreeing,
                              AgreementFinding& finding) {
  learn_gain(best, own);
  at(best).is_agreed = at(own).is_agreed = true;
  finding.agrees_with = at(best).is_kept ? at(best).shot : at(own).shot;
  const int pattern = at(own).pattern;
  const bool was_disputed = disputed_.erase(pattern) > 0 || !disagreeing.empty();
  for (const int i : newest(pattern, own)) {
    if (!at(i).is_kept || at(i).is_agreed) {
      continue;
    }
    const Pair pair = compare(std::min(i, best), std::max(i, best));
    if (pair.is_comparable && pair.agrees) {
      at(i).is_agreed = true;
    } else if (was_disputed) {
      doubt(i, finding);
    }
  }
  for (const int i : disagreeing) {  // including those that agreed with each other
    doubt(i, finding);
  }
  const double rate = std::max(1.0 - kForget, 1.0 / (1.0 + n_settled_++));
  typical_log_fraction_ +=
      rate * (std::log(std::max(finding.other_fraction, 1e-6)) - typical_log_fraction_);
  const bool tells_lights_apart =
      finding.other_fraction <= kTellsApart ||
      (n_settled_ >= kFewTakes && typical_log_fraction_ <= std::log(2.0 * kTellsApart));
  for (const int i : look_alikes(own, tells_lights_apart)) {
    // One of the two, or both, showed the other's light.
    const int other = at(i).pattern;
    const bool is_new = tells_lights_apart && alike_.insert(std::minmax(pattern, other)).second;
    finding.note = fmt::format(
        "shots {} and {} have different lights and the same picture{}", at(own).shot,
        at(i).shot, is_new ? ": both are taken again" : "; neither proves its light");
    finding.agrees_with = -1;
    finding.other_fraction = 1.0;
    if (is_new) {
      doubt_pattern(pattern, finding);
      doubt_pattern(other, finding);
      return;
    }
  }
}

void PictureAgreement::dispute(int own, const std::vector<int>& disagreeing,
                               AgreementFinding& finding) {
  disputed_.insert(at(own).pattern);
  // Which of them is wrong is unknown. One that agreed with another is kept; otherwise the
  // newest is, until the others are retaken.
  const bool has_agreed = std::any_of(disagreeing.begin(), disagreeing.end(), [this](int i) {
    return at(i).is_agreed && at(i).is_kept;
  });
  if (has_agreed) {
    doubt(own, finding);
  } else {
    for (const int i : disagreeing) {
      doubt(i, finding);
    }
  }
  if (finding.doubted.empty() && !finding.is_given_up) {
    separate(own, finding);
  }
  finding.note = fmt::format("shots {} and {} have the same lights and other pictures: {}",
                             at(own).shot, at(disagreeing.front()).shot,
                             finding.is_given_up ? "taken all the same, after too many attempts"
                             : finding.doubted.empty() ? "one of them is wrong"
                                                       : "taken again");
}

void PictureAgreement::separate(int own, AgreementFinding& finding) {
  const int pattern = at(own).pattern;
  const std::vector<int> takes = newest(pattern, own);
  const auto partner =
      std::find_if(takes.begin(), takes.end(), [this](int i) { return at(i).is_kept; });
  if (partner == takes.end()) {
    return;
  }
  doubt(at(*partner).is_agreed ? own : *partner, finding);
  // Another light must be shown between the two.
  for (int k = own - 1; k >= 0 && !finding.is_given_up; --k) {
    if (at(k).pattern >= 0 && at(k).pattern != pattern && at(k).is_kept) {
      finding.doubted.insert(finding.doubted.begin(), at(k).shot);
      at(k).is_kept = false;
      take_of_shot_.erase(at(k).shot);
      disputed_.insert(at(k).pattern);
      return;
    }
  }
}

}  // namespace haarlight::capture
