// SPDX-License-Identifier: Apache-2.0
#include "session/develop/dark_model.h"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "haarlight/core/error.h"

namespace haarlight::session {

namespace {

constexpr double kLeastSpread = 0.5;    // steps rms: below it slopes are mere noise
constexpr double kSameExposure = 1e-3;  // relative: read-back exposures differ by a line
constexpr double kSameGainDb = 0.01;
constexpr double kLeastSpanC = 0.5;  // of the darks: below it temperature is ignored

/// Linear between the neighbours of x, constant beyond the ends.
template <class Point, class Abscissa>
double interpolate(const std::vector<Point>& points, double x, Abscissa abscissa) {
  std::size_t after = 0;
  while (after < points.size() && abscissa(points[after]) < x) {
    ++after;
  }
  if (after == 0) {
    return points.front().level;
  }
  if (after == points.size()) {
    return points.back().level;
  }
  const double x0 = abscissa(points[after - 1]);
  const double x1 = abscissa(points[after]);
  const double t = x1 > x0 ? (x - x0) / (x1 - x0) : 0.0;
  return points[after - 1].level + t * (points[after].level - points[after - 1].level);
}

bool is_same_exposure(double a, double b) {
  return std::abs(a - b) <= kSameExposure * std::max(a, b);
}

double mean_of(const Image<float>& rows, const Lineariser& linear) {
  double sum = 0.0;
  for (int y = 0; y < rows.height(); ++y) {
    double row = 0.0;
    for (const float dn : rows.view().row(y)) {
      row += linear(dn);
    }
    sum += row;
  }
  return sum / static_cast<double>(rows.pixels().size());
}

}  // namespace

std::int64_t time_of(const FrameRecord& frame) {
  return frame.evidence.kind == EvidenceKind::asserted ? frame.shot
                                                       : frame.evidence.t_exposure_start_ns;
}

double exposure_us_of(const Session& session, const FrameRecord& frame) {
  return frame.evidence.exposure_read_us > 0.0
             ? frame.evidence.exposure_read_us
             : session.info().shots[static_cast<std::size_t>(frame.shot)].exposure_us;
}

DarkModel::DarkModel(const Session& session, const std::vector<const FrameRecord*>& darks,
                     const Lineariser& linear, const SensorResponse& response) {
  HAARLIGHT_EXPECTS(!darks.empty(), "at least one dark frame");
  const FrameForm& form = session.info().form;
  gain_db_ = darks.front()->evidence.gain_db;
  is_black_known_ = response.is_measured;
  for (const FrameRecord* frame : darks) {
    if (std::abs(frame->evidence.gain_db - gain_db_) > kSameGainDb) {
      throw Error(
          fmt::format("dark frames of {} and {} dB gain", gain_db_, frame->evidence.gain_db),
          (session.folder() / frame->file).string(), "take light and dark frames at one gain");
    }
    points_.push_back({exposure_us_of(session, *frame), time_of(*frame),
                       frame->evidence.temperature_c,
                       mean_of(session.read_rows(*frame, 0, form.height), linear)});
    mean_level_ += points_.back().level / static_cast<double>(darks.size());
  }
  for (const Point& point : points_) {
    sum_squares_ += (point.level - mean_level_) * (point.level - mean_level_);
  }
  const auto n = static_cast<double>(darks.size());
  base_ = Image<float>(form.height, form.width, form.channels);
  if (sum_squares_ >= n * kLeastSpread * kLeastSpread) {
    slope_ = Image<float>(form.height, form.width, form.channels);
  }
  for (std::size_t k = 0; k < darks.size(); ++k) {
    const Image<float> rows = session.read_rows(*darks[k], 0, form.height);
    const auto fraction = static_cast<float>(1.0 / n);
    const auto lever = static_cast<float>(
        slope_.is_empty() ? 0.0 : (points_[k].level - mean_level_) / sum_squares_);
    for (std::size_t i = 0; i < rows.pixels().size(); ++i) {
      const float value = linear(rows.pixels()[i]);
      base_.pixels()[i] += fraction * value;
      if (!slope_.is_empty()) {
        slope_.pixels()[i] += lever * value;
      }
    }
  }
  const double step = response.electrons_per_dn_at(gain_db_);
  pixel_variance_ =
      response.is_measured
          ? (response.floor_variance(gain_db_) + std::max(mean_level_, 0.0) * step) /
                (step * step)
          : 0.0;
  std::sort(points_.begin(), points_.end(), [](const Point& a, const Point& b) {
    return a.exposure_us < b.exposure_us || (a.exposure_us == b.exposure_us && a.time < b.time);
  });
}

double DarkModel::variance(double level) const {
  const double moved = level - mean_level_;
  const double lever = slope_.is_empty() ? 0.0 : moved * moved / sum_squares_;
  return pixel_variance_ * (1.0 / static_cast<double>(points_.size()) + lever);
}

double DarkModel::least_level() const {
  double least = points_.front().level;
  for (const Point& point : points_) {
    least = std::min(least, point.level);
  }
  return least;
}

double DarkModel::greatest_level() const {
  double greatest = points_.front().level;
  for (const Point& point : points_) {
    greatest = std::max(greatest, point.level);
  }
  return greatest;
}

int DarkModel::n_exposures() const {
  int n = points_.empty() ? 0 : 1;
  for (std::size_t i = 1; i < points_.size(); ++i) {
    n += is_same_exposure(points_[i].exposure_us, points_[i - 1].exposure_us) ? 0 : 1;
  }
  return n;
}

Image<float> DarkModel::brightest() const {
  Image<float> picture(base_.height(), base_.width(), base_.channels());
  const double level = greatest_level();
  for (std::size_t i = 0; i < picture.pixels().size(); ++i) {
    picture.pixels()[i] = at(i, level);
  }
  return picture;
}

double DarkModel::level_of_series(const std::vector<Point>& series, std::int64_t time,
                                  std::optional<double> temperature_c) const {
  std::int64_t first = series.front().time;
  std::int64_t last = first;
  double coldest = 1e300;
  double warmest = -1e300;
  bool has_temperatures = temperature_c.has_value();
  for (const Point& point : series) {
    first = std::min(first, point.time);
    last = std::max(last, point.time);
    has_temperatures = has_temperatures && point.temperature_c.has_value();
    coldest = std::min(coldest, point.temperature_c.value_or(coldest));
    warmest = std::max(warmest, point.temperature_c.value_or(warmest));
  }
  const bool is_between = first <= time && time <= last;
  std::vector<Point> sorted = series;
  if (!is_between && has_temperatures && warmest - coldest >= kLeastSpanC) {
    std::sort(sorted.begin(), sorted.end(), [](const Point& a, const Point& b) {
      return *a.temperature_c < *b.temperature_c;
    });
    return interpolate(sorted, *temperature_c,
                       [](const Point& point) { return *point.temperature_c; });
  }
  std::sort(sorted.begin(), sorted.end(),
            [](const Point& a, const Point& b) { return a.time < b.time; });
  // Differences of nanoseconds are exact in double; times themselves may not be.
  return interpolate(sorted, static_cast<double>(time - first), [first](const Point& point) {
    return static_cast<double>(point.time - first);
  });
}

double DarkModel::level_of(const Session& session, const FrameRecord& frame) const {
  if (std::abs(frame.evidence.gain_db - gain_db_) > kSameGainDb) {
    throw Error(fmt::format("a frame of {} dB gain beside dark frames of {} dB",
                            frame.evidence.gain_db, gain_db_),
                (session.folder() / frame.file).string(),
                "take light and dark frames at one gain");
  }
  const double exposure_us = exposure_us_of(session, frame);
  // One point per exposure: its level at this frame's time and temperature.
  std::vector<Point> by_exposure;
  for (std::size_t begin = 0; begin < points_.size();) {
    std::size_t end = begin + 1;
    while (end < points_.size() &&
           is_same_exposure(points_[begin].exposure_us, points_[end].exposure_us)) {
      ++end;
    }
    const std::vector<Point> series(points_.begin() + static_cast<std::ptrdiff_t>(begin),
                                    points_.begin() + static_cast<std::ptrdiff_t>(end));
    const double level = level_of_series(series, time_of(frame), frame.evidence.temperature_c);
    if (is_same_exposure(exposure_us, points_[begin].exposure_us)) {
      return level;
    }
    by_exposure.push_back({points_[begin].exposure_us, 0, {}, level});
    begin = end;
  }
  if (by_exposure.size() == 1) {
    const Point& only = by_exposure.front();
    // Without a measured black level the part that grows with the exposure is unknown.
    return is_black_known_ && only.exposure_us > 0.0
               ? only.level * exposure_us / only.exposure_us
               : only.level;
  }
  const Point* a = &by_exposure[0];
  const Point* b = &by_exposure[1];
  for (std::size_t i = 1; i + 1 < by_exposure.size(); ++i) {
    if (by_exposure[i].exposure_us < exposure_us) {
      a = &by_exposure[i];
      b = &by_exposure[i + 1];
    }
  }
  return a->level + (b->level - a->level) * (exposure_us - a->exposure_us) /
                        (b->exposure_us - a->exposure_us);
}

}  // namespace haarlight::session
