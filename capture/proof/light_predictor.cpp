// SPDX-License-Identifier: Apache-2.0
#include "capture/proof/light_predictor.h"

#include <algorithm>
#include <cmath>

#include "haarlight/core/error.h"

namespace haarlight::capture {

namespace {

// In units of s_i^2.
constexpr double kConstant = 100.0;  // c: the first frames determine the mean
constexpr double kJitter = 1e-6;     // of C's diagonal
constexpr double kLeastRho = 1e-4;   // a light seen once is known to a hundredth of s_i
constexpr double kFirstScale = 0.3;  // s_i of the first frames, relative to the signal
constexpr double kFirstWeight = 4.0;
constexpr double kScaleMemory = 0.995;  // a frame's weight halves after 140
constexpr double kScaleCap = 16.0;      // a miss beyond 4 sigma counts as 4
constexpr int kReady = 3;               // frames after which the scales are known

/// Matern 3/2 at a distance of d pitches, plus a part that jumps from light to light.
double correlation(double d, double length) {
  const double r = std::sqrt(3.0) * d / length;
  return (1.0 + r) * std::exp(-r);
}

double median(PointValues values) {
  std::nth_element(values.begin(), values.begin() + kProofPoints / 2, values.end());
  return values[kProofPoints / 2];
}

}  // namespace

LightPredictor::LightPredictor(std::span<const FaceGrid> faces) {
  for (const FaceGrid& grid : faces) {
    FaceState face;
    face.first = n_lights_;
    face.n = grid.n_lights();
    face.mean = Eigen::MatrixXd::Zero(kProofPoints, face.n);
    face.covariance.resize(face.n, face.n);
    const double length = std::max(2.0, 0.5 * std::max(grid.rows, grid.cols));
    for (int b = 0; b < face.n; ++b) {
      for (int a = 0; a < face.n; ++a) {
        const double d =
            std::hypot(a / grid.cols - b / grid.cols, a % grid.cols - b % grid.cols);
        face.covariance(a, b) = kConstant + correlation(d, length) + (a == b ? kJitter : 0.0);
      }
    }
    n_lights_ += face.n;
    faces_.push_back(std::move(face));
  }
  HAARLIGHT_EXPECTS(n_lights_ > 0, "a face with lights");
}

const LightPredictor::FaceState& LightPredictor::face_of(int light) const {
  const auto after = std::upper_bound(faces_.begin(), faces_.end(), light,
                                      [](int k, const FaceState& f) { return k < f.first; });
  return *std::prev(after);
}

LightPredictor::Gain LightPredictor::gain_of(std::span<const DrivenLight> lit) const {
  Gain gain;
  gain.h.resize(faces_.size());
  for (std::size_t f = 0; f < faces_.size(); ++f) {
    const FaceState& face = faces_[f];
    const auto is_here = [&face](const DrivenLight& light) {
      return light.first >= face.first && light.first < face.first + face.n;
    };
    if (std::none_of(lit.begin(), lit.end(), is_here)) {
      continue;
    }
    Eigen::VectorXd& h = gain.h[f];
    h.setZero(face.n);
    for (const DrivenLight& light : lit) {
      if (is_here(light)) {
        h += light.second * face.covariance.col(light.first - face.first);
        gain.mean += light.second * face.mean.col(light.first - face.first).array();
      }
    }
    for (const DrivenLight& light : lit) {
      gain.v += is_here(light) ? light.second * h[light.first - face.first] : 0.0;
    }
  }
  gain.v = std::max(gain.v, 0.0);
  return gain;
}

double LightPredictor::spread_of(int light) const {
  const FaceState& face = face_of(light);
  return face.covariance(light - face.first, light - face.first);
}

bool LightPredictor::is_ready() const noexcept { return n_learned_ >= kReady; }

LightPredictor::Prediction LightPredictor::predict(std::span<const DrivenLight> lit) const {
  Prediction out;
  if (lit.size() == 1) {
    const FaceState& face = face_of(lit[0].first);
    const int k = lit[0].first - face.first;
    const double drive = lit[0].second;
    out.mean = drive * face.mean.col(k).array();
    out.spread = drive * drive * std::max(face.covariance(k, k), 0.0);
  } else {
    const Gain gain = gain_of(lit);
    out.mean = gain.mean;
    out.spread = gain.v;
  }
  out.variance = out.spread * scale2_;
  return out;
}

void LightPredictor::learn_scale(const Gain& gain, double n_equal, const PointValues& seen,
                                 const PointValues& noise) {
  if (n_learned_ < kReady) {
    // The signal of one light, until the prediction errors tell more.
    const PointValues first =
        (kFirstScale * seen / n_equal).square() + noise / (n_equal * n_equal);
    scale_sum_ += kFirstWeight / kReady * first;
    scale_weight_ += kFirstWeight / kReady;
  } else if (gain.v > 10.0 * kLeastRho) {
    const PointValues miss = ((seen - gain.mean).square() - noise).max(0.0) / gain.v;
    scale_sum_ = kScaleMemory * scale_sum_ + miss.min(kScaleCap * scale2_);
    scale_weight_ = kScaleMemory * scale_weight_ + 1.0;
  }
  if (scale_weight_ > 0.0) {
    scale2_ = scale_sum_ / scale_weight_;
    scale2_ = scale2_.max(1e-12 + 1e-6 * scale2_.maxCoeff());
  }
}

void LightPredictor::learn(std::span<const DrivenLight> lit, const PointValues& seen,
                           const PointValues& noise) {
  const Gain gain = gain_of(lit);
  double sum = 0.0;
  double sum2 = 0.0;
  for (const auto& [light, drive] : lit) {
    sum += drive;
    sum2 += drive * drive;
  }
  HAARLIGHT_EXPECTS(sum > 0.0, "a pattern with light");
  learn_scale(gain, sum, seen, noise);
  const double rho = std::max(kLeastRho * sum2, median(noise / scale2_));
  update(gain, seen, rho);
  ++n_learned_;
}

void LightPredictor::update(const Gain& gain, const PointValues& seen, double rho) {
  const double total = gain.v + rho;
  const PointValues step = (seen - gain.mean) / total;
  for (std::size_t f = 0; f < faces_.size(); ++f) {
    const Eigen::VectorXd& h = gain.h[f];
    if (h.size() == 0) {
      continue;
    }
    faces_[f].mean.noalias() += step.matrix() * h.transpose();
    faces_[f].covariance.noalias() -= (h / total) * h.transpose();
  }
}

}  // namespace haarlight::capture
