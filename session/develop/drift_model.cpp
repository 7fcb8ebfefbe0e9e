// SPDX-License-Identifier: Apache-2.0
#include "session/develop/drift_model.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>

#include "core/order_statistics.h"
#include "haarlight/core/error.h"

namespace haarlight::session {

namespace {

/// A sentinel's light, linear steps, dark subtracted; clipped samples are marked by infinity.
Image<float> light_of(const Session& session, const FrameRecord& frame, const DarkModel& dark,
                      const Lineariser& linear) {
  const FrameForm& form = session.info().form;
  Image<float> rows = session.read_rows(frame, 0, form.height);
  const double level = dark.is_empty() ? 0.0 : dark.level_of(session, frame);
  for (std::size_t i = 0; i < rows.pixels().size(); ++i) {
    float& value = rows.pixels()[i];
    value = linear.is_clipped(value)
                ? std::numeric_limits<float>::infinity()
                : linear(value) - (dark.is_empty() ? 0.0F : dark.at(i, level));
  }
  return rows;
}

struct Ratio {
  double value = 0.0;
  double sigma = 0.0;
};

/// Sum of `light` over sum of `reference`, with its standard error under photon and read noise.
Ratio ratio_of(const Image<float>& light, const Image<float>& reference, double step,
               double floor) {
  double sum = 0.0;
  double sum_reference = 0.0;
  double n = 0.0;
  for (int y = 0; y < light.height(); ++y) {
    double row = 0.0;
    double row_reference = 0.0;
    const auto a = light.view().row(y);
    const auto b = reference.view().row(y);
    for (std::size_t x = 0; x < a.size(); ++x) {
      if (std::isfinite(a[x]) && std::isfinite(b[x])) {
        row += a[x];
        row_reference += b[x];
        n += 1.0;
      }
    }
    sum += row;
    sum_reference += row_reference;
  }
  Ratio ratio;
  if (!(sum_reference > 0.0) || !(sum > 0.0)) {
    return ratio;
  }
  ratio.value = sum / sum_reference;
  const auto relative_variance = [&](double steps) {
    const double electrons = steps * step;
    return (electrons + n * floor) / (electrons * electrons);
  };
  ratio.sigma =
      ratio.value * std::sqrt(relative_variance(sum) + relative_variance(sum_reference));
  return ratio;
}

}  // namespace

DriftModel::DriftModel(const Session& session, const std::vector<const FrameRecord*>& sentinels,
                       const DarkModel& dark, const Lineariser& linear,
                       const SensorResponse& response) {
  HAARLIGHT_EXPECTS(!sentinels.empty(), "at least one sentinel");
  const auto scale = [&](const FrameRecord& frame) {
    const double exposure_us = exposure_us_of(session, frame);
    return (exposure_us > 0.0 ? exposure_us : 1.0) *
           std::pow(10.0, frame.evidence.gain_db / 20.0);
  };
  const FrameRecord& first = *sentinels.front();
  const Image<float> reference = light_of(session, first, dark, linear);
  for (const FrameRecord* frame : sentinels) {
    const Ratio ratio = ratio_of(light_of(session, *frame, dark, linear), reference,
                                 response.electrons_per_dn_at(frame->evidence.gain_db),
                                 response.floor_variance(frame->evidence.gain_db));
    if (!(ratio.value > 0.0)) {
      throw Error("a sentinel frame without light that is not clipped",
                  (session.folder() / frame->file).string(),
                  "choose another sentinel_light, or give --without drift");
    }
    const double relative = scale(first) / scale(*frame);
    const bool is_first = frame == sentinels.front();
    points_.push_back({time_of(*frame), is_first ? 1.0 : ratio.value * relative,
                       is_first || !response.is_measured ? 0.0 : ratio.sigma * relative});
  }
  std::stable_sort(points_.begin(), points_.end(),
                   [](const Point& a, const Point& b) { return a.time < b.time; });
  std::vector<double> gains;
  for (const Point& point : points_) {
    gains.push_back(point.gain);
  }
  const double unit = upper_median(gains);
  for (Point& point : points_) {
    point.gain /= unit;
    point.sigma /= unit;
  }
}

double DriftModel::bend(std::size_t i) const {
  double bend = 0.0;
  for (std::size_t k = i == 0 ? 1 : i; k <= i + 1 && k + 1 < points_.size(); ++k) {
    bend = std::max(
        bend, std::abs(points_[k + 1].gain - 2.0 * points_[k].gain + points_[k - 1].gain));
  }
  return bend;
}

// Linear interpolation of a curve errs by at most its second difference / 8; a quarter of it
// allows for curvature that grows between the sentinels.
DriftGain DriftModel::at(std::int64_t time) const {
  if (points_.empty()) {
    return {};
  }
  const auto after =
      std::lower_bound(points_.begin(), points_.end(), time,
                       [](const Point& point, std::int64_t t) { return point.time < t; });
  if (after == points_.begin()) {
    return {after->gain, after->sigma};
  }
  if (after == points_.end()) {
    return {points_.back().gain, points_.back().sigma};
  }
  const Point& a = *std::prev(after);
  const Point& b = *after;
  const double t = static_cast<double>(time - a.time) / static_cast<double>(b.time - a.time);
  const double bent =
      0.25 * bend(static_cast<std::size_t>(std::distance(points_.begin(), after)) - 1) * 4.0 *
      t * (1.0 - t);
  const double noise = std::hypot((1.0 - t) * a.sigma, t * b.sigma);
  return {a.gain + t * (b.gain - a.gain), std::hypot(noise, bent)};
}

double DriftModel::least() const {
  double least = 1.0;
  for (const Point& point : points_) {
    least = std::min(least, point.gain);
  }
  return least;
}

double DriftModel::greatest() const {
  double greatest = 1.0;
  for (const Point& point : points_) {
    greatest = std::max(greatest, point.gain);
  }
  return greatest;
}

double DriftModel::largest_step() const {
  double step = 0.0;
  for (std::size_t i = 1; i < points_.size(); ++i) {
    step = std::max(step, std::abs(points_[i].gain - points_[i - 1].gain));
  }
  return step;
}

double DriftModel::largest_sigma() const {
  double sigma = 0.0;
  for (const Point& point : points_) {
    sigma = std::max(sigma, point.sigma);
  }
  return sigma;
}

}  // namespace haarlight::session
