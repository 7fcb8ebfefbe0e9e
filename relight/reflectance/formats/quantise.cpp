// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/reflectance/formats/quantise.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include <fmt/format.h>

#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

constexpr double kPtmDecimals = 1e6;  // "%f" prints six
constexpr double kWhite = 255.0;

/// The term a plane belongs to; -1: a colour of lrgb. Terms of pca are the planes.
int term_of(ReflectanceColour colour, int n_terms, int plane) {
  if (colour == ReflectanceColour::lrgb && plane >= n_terms) {
    return -1;
  }
  return plane % n_terms;
}

struct Range {
  double min = 0.0;
  double max = 0.0;
};

/// The numbers of a .ptm whose range contains [min, max] and 0.
PlaneScale scale_for_ptm(Range range) {
  const double min = kWhite * std::min(range.min, 0.0);
  const double max = kWhite * std::max(range.max, 0.0);
  if (min == max) {
    return {1.0 / kWhite, 0.0};
  }
  // Rounded up, and the bias to a whole number: the ends then stay within half a step of the
  // bytes 0 and 255. If the bias's rounding pushes one further, a larger step covers it.
  double step = std::max(std::ceil((max - min) / kWhite * kPtmDecimals), 1.0) / kPtmDecimals;
  double bias = std::round(-min / step);
  while (max / step + bias > kWhite + 0.5 || min / step + bias < -0.5) {
    step = (std::round(step * kPtmDecimals) + 1.0) / kPtmDecimals;
    bias = std::round(-min / step);
  }
  return {step / kWhite, -bias * step / kWhite};
}

/// Two 32-bit floats whose range contains [min, max].
PlaneScale scale_for_rti(Range range) {
  const auto offset = static_cast<float>(range.min);
  const auto span = range.max > range.min ? static_cast<float>(range.max - range.min) : 1.0F;
  return {static_cast<double>(span) / kWhite, static_cast<double>(offset)};
}

PlaneScale scale_for(ScaleRule rule, Range range) {
  switch (rule) {
    case ScaleRule::any:
      return {(range.max > range.min ? range.max - range.min : 1.0) / kWhite, range.min};
    case ScaleRule::rti:
      return scale_for_rti(range);
    case ScaleRule::ptm:
      return scale_for_ptm(range);
  }
  return {};
}

std::uint8_t nearest_byte(double value, const PlaneScale& scale) {
  if (scale.scale == 0.0) {
    return 0;
  }
  const double byte = std::round((value - scale.offset) / scale.scale);
  return static_cast<std::uint8_t>(std::clamp(byte, 0.0, kWhite));
}

double value_of(int byte, const PlaneScale& scale) { return byte * scale.scale + scale.offset; }

/// Which bytes a plane uses.
struct ByteRange {
  int min = 255;
  int max = 0;
};

std::vector<ByteRange> byte_ranges(const Image<std::uint8_t>& planes) {
  const auto n = static_cast<std::size_t>(planes.channels());
  std::vector<ByteRange> ranges(n);
  const auto bytes = planes.pixels();
  for (std::size_t i = 0; i < bytes.size(); i += n) {
    for (std::size_t p = 0; p < n; ++p) {
      const int byte = bytes[i + p];
      ranges[p].min = std::min(ranges[p].min, byte);
      ranges[p].max = std::max(ranges[p].max, byte);
    }
  }
  return ranges;
}

/// Brings the colours of lrgb into 0..1 by moving the excess to the luminance.
void rescale_colours(ReflectanceModel& model, const std::vector<ByteRange>& ranges) {
  double largest = 1.0;
  for (std::size_t c = 0; c < 3; ++c) {
    const std::size_t p = static_cast<std::size_t>(model.n_terms) + c;
    const PlaneScale& scale = model.scales[p];
    const double a = value_of(ranges[p].min, scale);
    const double b = value_of(ranges[p].max, scale);
    constexpr double kSlack = 1e-9;
    if (std::min(a, b) < -kSlack) {
      throw Error(fmt::format("a colour of {:.4g}: below 0", std::min(a, b)),
                  "the colours of lrgb", "convert to rgb instead of lrgb");
    }
    largest = std::max({largest, a, b});
  }
  for (std::size_t p = 0; p < model.scales.size(); ++p) {
    const bool is_colour = p >= static_cast<std::size_t>(model.n_terms);
    const double factor = is_colour ? 1.0 / largest : largest;
    model.scales[p].scale *= factor;
    model.scales[p].offset *= factor;
  }
}

/// New bytes by one table per plane.
void move_to_scales(ReflectanceModel& model, const std::vector<PlaneScale>& scales) {
  std::vector<std::array<std::uint8_t, 256>> tables(scales.size());
  for (std::size_t p = 0; p < scales.size(); ++p) {
    for (int byte = 0; byte < 256; ++byte) {
      tables[p][static_cast<std::size_t>(byte)] =
          nearest_byte(value_of(byte, model.scales[p]), scales[p]);
    }
  }
  const auto bytes = model.planes.pixels();
  for (std::size_t i = 0; i < bytes.size(); i += scales.size()) {
    for (std::size_t p = 0; p < scales.size(); ++p) {
      bytes[i + p] = tables[p][bytes[i + p]];
    }
  }
  model.scales = scales;
}

/// One scale per term from each plane's range.
std::vector<PlaneScale> scales_of_terms(const std::vector<Range>& planes,
                                        ReflectanceColour colour, int n_terms, ScaleRule rule) {
  std::vector<PlaneScale> scales(planes.size());
  if (rule == ScaleRule::any) {
    std::transform(planes.begin(), planes.end(), scales.begin(),
                   [](const Range& range) { return scale_for(ScaleRule::any, range); });
    return scales;
  }
  std::vector<Range> terms(
      static_cast<std::size_t>(n_terms),
      {std::numeric_limits<double>::infinity(), -std::numeric_limits<double>::infinity()});
  for (std::size_t p = 0; p < planes.size(); ++p) {
    const int term = term_of(colour, n_terms, static_cast<int>(p));
    if (term >= 0) {
      Range& range = terms[static_cast<std::size_t>(term)];
      range = {std::min(range.min, planes[p].min), std::max(range.max, planes[p].max)};
    }
  }
  for (std::size_t p = 0; p < planes.size(); ++p) {
    const int term = term_of(colour, n_terms, static_cast<int>(p));
    scales[p] =
        term < 0 ? PlaneScale{} : scale_for(rule, terms[static_cast<std::size_t>(term)]);
  }
  return scales;
}

}  // namespace

PlaneRanges::PlaneRanges(int n_planes)
    : min_(static_cast<std::size_t>(n_planes), std::numeric_limits<float>::infinity()),
      max_(static_cast<std::size_t>(n_planes), -std::numeric_limits<float>::infinity()) {
  HAARLIGHT_EXPECTS(n_planes >= 1, "at least one plane");
}

void PlaneRanges::add(std::span<const float> samples) {
  HAARLIGHT_EXPECTS(samples.size() % min_.size() == 0, "whole pixels");
  for (std::size_t i = 0; i < samples.size(); i += min_.size()) {
    for (std::size_t p = 0; p < min_.size(); ++p) {
      const float value = samples[i + p];
      if (!std::isfinite(value)) {
        throw Error("a coefficient is not a finite number", fmt::format("plane {}", p),
                    "look for pictures with broken pixels");
      }
      min_[p] = std::min(min_[p], value);
      max_[p] = std::max(max_[p], value);
    }
  }
}

void PlaneRanges::merge(const PlaneRanges& other) {
  HAARLIGHT_EXPECTS(other.min_.size() == min_.size(), "as many planes");
  for (std::size_t p = 0; p < min_.size(); ++p) {
    min_[p] = std::min(min_[p], other.min_[p]);
    max_[p] = std::max(max_[p], other.max_[p]);
  }
}

double PlaneRanges::min(int plane) const noexcept {
  const auto p = static_cast<std::size_t>(plane);
  return min_[p] <= max_[p] ? static_cast<double>(min_[p]) : 0.0;
}

double PlaneRanges::max(int plane) const noexcept {
  const auto p = static_cast<std::size_t>(plane);
  return min_[p] <= max_[p] ? static_cast<double>(max_[p]) : 0.0;
}

std::vector<PlaneScale> choose_scales(const PlaneRanges& ranges, ReflectanceColour colour,
                                      int n_terms, ScaleRule rule) {
  HAARLIGHT_EXPECTS(ranges.n_planes() == n_planes_of(colour, n_terms), "one range per plane");
  std::vector<Range> planes(static_cast<std::size_t>(ranges.n_planes()));
  for (std::size_t p = 0; p < planes.size(); ++p) {
    planes[p] = {ranges.min(static_cast<int>(p)), ranges.max(static_cast<int>(p))};
  }
  return scales_of_terms(planes, colour, n_terms, rule);
}

PtmScale ptm_scale(const PlaneScale& scale) noexcept {
  const double step = std::round(scale.scale * kWhite * kPtmDecimals) / kPtmDecimals;
  const double bias = step != 0.0 ? std::round(-scale.offset * kWhite / step) : 0.0;
  return {step, static_cast<int>(std::clamp(bias, -1e9, 1e9))};
}

bool obeys(ScaleRule rule, const ReflectanceModel& model) {
  if (rule == ScaleRule::any) {
    return std::all_of(model.scales.begin(), model.scales.end(),
                       [](const PlaneScale& scale) { return scale.scale > 0.0; });
  }
  for (int p = 0; p < model.n_planes(); ++p) {
    const PlaneScale& scale = model.scales[static_cast<std::size_t>(p)];
    const int term = term_of(model.colour, model.n_terms, p);
    if (term < 0) {
      if (scale != PlaneScale{}) {
        return false;
      }
      continue;
    }
    if (scale != model.scales[static_cast<std::size_t>(term)]) {
      return false;
    }
    if (rule == ScaleRule::rti) {
      const auto span = static_cast<float>(scale.scale * kWhite);
      const auto offset = static_cast<float>(scale.offset);
      if (scale !=
          PlaneScale{static_cast<double>(span) / kWhite, static_cast<double>(offset)}) {
        return false;
      }
      continue;
    }
    const PtmScale ptm = ptm_scale(scale);
    if (ptm.scale <= 0.0 || ptm.bias < 0 || ptm.bias > 255 ||
        scale != PlaneScale{ptm.scale / kWhite, -ptm.bias * ptm.scale / kWhite}) {
      return false;
    }
  }
  return true;
}

void quantise_row(std::span<const float> samples, std::span<const PlaneScale> scales,
                  std::span<std::uint8_t> bytes) {
  HAARLIGHT_EXPECTS(samples.size() == bytes.size() && samples.size() % scales.size() == 0,
                    "whole pixels");
  for (std::size_t i = 0; i < samples.size(); i += scales.size()) {
    for (std::size_t p = 0; p < scales.size(); ++p) {
      bytes[i + p] = nearest_byte(static_cast<double>(samples[i + p]), scales[p]);
    }
  }
}

ReflectanceModel with_scales_of(ScaleRule rule, ReflectanceModel model) {
  if (obeys(rule, model)) {
    return model;
  }
  const std::vector<ByteRange> ranges = byte_ranges(model.planes);
  if (rule == ScaleRule::ptm && model.colour == ReflectanceColour::lrgb) {
    rescale_colours(model, ranges);
  }
  std::vector<Range> values;
  for (std::size_t p = 0; p < ranges.size(); ++p) {
    const double a = value_of(ranges[p].min, model.scales[p]);
    const double b = value_of(ranges[p].max, model.scales[p]);
    values.push_back({std::min(a, b), std::max(a, b)});
  }
  move_to_scales(model, scales_of_terms(values, model.colour, model.n_terms, rule));
  return model;
}

}  // namespace haarlight::relight
