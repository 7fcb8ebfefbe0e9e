// SPDX-License-Identifier: Apache-2.0
#include "relight/shape/fit_choice.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/count.h"
#include "core/order_statistics.h"
#include "core/parallel.h"
#include "relight/shape/light_groups.h"

namespace haarlight::relight {

namespace {

using Eigen::Vector3d;

constexpr int kPixels = 256;
constexpr int kLights = 256;
constexpr int kFolds = 4;
constexpr double kBrightFraction =
    0.1;  // of the samples exceed the bright level, as in the fit

std::vector<FitScore> candidates(const LambertOptions& base) {
  std::vector<FitScore> all;
  FitScore trimmed{base, "trimmed"};
  trimmed.fit.method = LambertMethod::trimmed;
  all.push_back(trimmed);
  for (const auto& [loss, name] : {std::pair(RobustLoss::tukey, "m-estimator, tukey"),
                                   std::pair(RobustLoss::cauchy, "m-estimator, cauchy"),
                                   std::pair(RobustLoss::huber, "m-estimator, huber")}) {
    FitScore score{base, name};
    score.fit.method = LambertMethod::m_estimator;
    score.fit.loss = loss;
    score.fit.loss_scales = 0.0;
    all.push_back(score);
  }
  for (FitScore& score : all) {
    score.fit.has_sigma = false;
  }
  return all;
}

struct Position {
  int y = 0;
  int x = 0;
};

std::vector<Position> spread_pixels(const StackDims& dims, ImageView<const std::uint8_t> good) {
  std::vector<Position> all;
  for (int y = 0; y < dims.height; ++y) {
    for (int x = 0; x < dims.width; ++x) {
      if (good.is_empty() || good(y, x) != 0) {
        all.push_back({y, x});
      }
    }
  }
  if (all.size() <= count(kPixels)) {
    return all;
  }
  std::vector<Position> some;
  for (std::size_t i = 0; i < count(kPixels); ++i) {
    some.push_back(all[i * all.size() / count(kPixels)]);
  }
  return some;
}

/// Held-out residuals of one pixel under every candidate.
class PixelScorer {
 public:
  PixelScorer(const StackSource& stack, const StereoLights& lights,
              ImageView<const float> points, const StereoOptions& options,
              const LightGroups& groups, const std::vector<FitScore>& scores)
      : stack_(stack),
        points_(points),
        options_(options),
        samples_(stack.dims(), lights, thinned(groups, kLights), options.saturation) {
    for (int j = 0; j < samples_.n(); ++j) {
      fold_.push_back(groups.group[count(samples_.light(j))] % kFolds);
    }
    for (const FitScore& score : scores) {
      fitters_.emplace_back(samples_.n(), score.fit);
    }
    values_.resize(count(stack.dims().channels) * count(stack.dims().n_lights));
    if (options.errors != nullptr) {
      errors_.resize(values_.size());
    }
  }

  /// @return  of each candidate: the median residual, at most 1; empty: too few lights
  [[nodiscard]] std::vector<double> errors_at(const Position& at) {
    read(at);
    std::vector<double> medians;
    for (LambertFitter& fitter : fitters_) {
      std::vector<double> residuals;
      for (int fold = 0; fold < kFolds; ++fold) {
        leave_out(fold, fitter, residuals);
      }
      if (residuals.empty()) {
        return {};
      }
      medians.push_back(std::min(1.0, upper_median(std::span(residuals))));
    }
    return medians;
  }

 private:
  void read(const Position& at) {
    const TileRect rect{at.x, at.y, 1, 1};
    stack_.read_tile(rect, values_);
    if (options_.errors != nullptr) {
      options_.errors->read_tile(rect, errors_);
    }
    if (!points_.is_empty()) {
      samples_.aim({double{points_(at.y, at.x, 0)}, double{points_(at.y, at.x, 1)},
                    double{points_(at.y, at.x, 2)}});
    }
    samples_.take(values_, 0, 1, errors_);
    counts_.clear();
    std::vector<double> bright;
    for (int j = 0; j < samples_.n(); ++j) {
      if (samples_.scale(j) > 0.0 && !samples_.is_clipped(j)) {
        counts_.push_back(j);
        bright.push_back(samples_.value(j));
      }
    }
    least_ = 0.0;
    if (!bright.empty()) {
      least_ = std::max(
          options_.fit.dark_level,
          options_.fit.dark_fraction * quantile(std::span(bright), 1.0 - kBrightFraction));
    }
  }

  void leave_out(int fold, LambertFitter& fitter, std::vector<double>& residuals) {
    fitter.clear();
    for (const int j : counts_) {
      if (fold_[count(j)] != fold) {
        fitter.add(samples_.direction(j), samples_.value(j), j);
      }
    }
    const LambertFit fit = fitter.fit();
    for (const int j : counts_) {
      if (fold_[count(j)] != fold || !(samples_.value(j) > least_)) {
        continue;
      }
      residuals.push_back(fit.state == PixelState::good
                              ? std::abs(samples_.value(j) - fit.b.dot(samples_.direction(j))) /
                                    fit.b.norm()
                              : 1.0);
    }
  }

  const StackSource& stack_;
  ImageView<const float> points_;
  const StereoOptions& options_;
  PixelSamples samples_;
  std::vector<int> fold_;  ///< of each sample
  std::vector<LambertFitter> fitters_;
  std::vector<float> values_, errors_;
  std::vector<int> counts_;  ///< samples that are not clipped
  double least_ = 0.0;       ///< of a lit sample
};

}  // namespace

std::vector<FitScore> score_fits(const StackSource& stack, const StereoLights& lights,
                                 ImageView<const float> points,
                                 ImageView<const std::uint8_t> good,
                                 const StereoOptions& options) {
  std::vector<FitScore> scores = candidates(options.fit);
  const std::vector<Position> positions = spread_pixels(stack.dims(), good);
  const LightGroups groups = group_lights(middle_directions(lights, points));
  std::vector<std::vector<double>> found(positions.size());
  constexpr std::size_t kPixelsATask = 16;
  parallel_for(positions.size(), kPixelsATask, [&](std::size_t begin, std::size_t end) {
    PixelScorer scorer(stack, lights, points, options, groups, scores);
    for (std::size_t i = begin; i < end; ++i) {
      found[i] = scorer.errors_at(positions[i]);
    }
  });
  double n = 0.0;
  std::vector<double> sums(scores.size(), 0.0);
  for (const std::vector<double>& medians : found) {
    for (std::size_t i = 0; i < medians.size(); ++i) {
      sums[i] += medians[i];
    }
    n += medians.empty() ? 0.0 : 1.0;
  }
  for (std::size_t i = 0; n > 0.0 && i < scores.size(); ++i) {
    scores[i].held_out = sums[i] / n;
  }
  std::stable_sort(scores.begin(), scores.end(), [](const FitScore& a, const FitScore& b) {
    return a.held_out < b.held_out;
  });
  return scores;
}

}  // namespace haarlight::relight
