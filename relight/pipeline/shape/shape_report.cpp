// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/shape/shape_report.h"

#include <algorithm>
#include <iterator>
#include <limits>

#include <fmt/format.h>

#include "core/counted.h"
#include "relight/pipeline/shape/shape_output.h"
#include "relight/shape/height_bow.h"

namespace haarlight::relight {

namespace {

std::string name_of(const LambertOptions& fit) {
  return fit.method == LambertMethod::m_estimator
             ? fmt::format("m-estimator, {}", to_string(fit.loss))
             : std::string(to_string(fit.method));
}

const char* unit_of(const ShapeSummary& summary) {
  return summary.has_scale ? "mm" : "pixel widths";
}

void add_fit(const Shape& shape, Report& report) {
  report.add_detail("fit", name_of(shape.fit));
  std::vector<double> held_out;
  std::string names;
  for (const FitScore& score : shape.scores) {
    held_out.push_back(score.held_out);
    names += (names.empty() ? "" : "; ") + score.name;
  }
  if (!held_out.empty()) {
    report.add_detail("fits_tried", names);
    report.add_detail("held_out_residuals", held_out);
  }
}

void add_doubts(const Shape& shape, Report& report) {
  const HeightBow bow = height_bow(shape.height.view(), shape.map.is_known.view());
  report.add_detail("heights_bow", bow.bow);
  report.add_detail("heights_without_bow", bow.rest);
  report.add_detail("light_nearness", shape.nearness.inverse);  // 1 / picture widths
  report.add_detail("light_nearness_sigma", shape.nearness.sigma);
}

void add_parts(const Shape& shape, bool has_hull, Report& report) {
  std::vector<double> pixels;
  std::vector<double> heights;
  std::vector<double> low;
  std::vector<double> high;
  for (const PartHeight& part : shape.parts) {
    pixels.push_back(static_cast<double>(part.n_pixels));
    low.push_back(part.low_mm);
    high.push_back(part.high_mm);
    // Not known: null.
    heights.push_back(part.is_known ? part.mean_mm : std::numeric_limits<double>::infinity());
  }
  report.add_detail("part_pixels", pixels);
  report.add_detail("part_heights", heights);
  if (has_hull) {
    report.add_detail("part_heights_low", low);
    report.add_detail("part_heights_high", high);
  }
}

/// The sizes of the largest parts, for users.
std::string sizes_of(const std::vector<PartHeight>& parts) {
  constexpr std::size_t kNamed = 5;
  std::string text;
  for (std::size_t i = 0; i < std::min(kNamed, parts.size()); ++i) {
    text += fmt::format("{}{}", i == 0 ? "" : ", ", parts[i].n_pixels);
  }
  return parts.size() > kNamed ? text + ", ..." : text;
}

/// A line for each of the largest parts whose height is known.
std::string part_lines(const std::vector<PartHeight>& parts, const char* unit) {
  constexpr int kNamed = 8;
  std::string text;
  int n = 0;
  for (const PartHeight& part : parts) {
    if (!part.is_known || ++n > kNamed) {
      continue;
    }
    text +=
        fmt::format("  a part of {} stands about {:.3g} {} above the plane, by {}",
                    counted(part.n_pixels, "pixel"), part.mean_mm, unit,
                    part.source == HeightSource::hull ? "the hull" : "the lights' fall-off");
    if (part.low_mm < part.high_mm) {
      text += fmt::format("; the hull leaves it {:.3g} to {:.3g}", part.low_mm, part.high_mm);
    }
    text += '\n';
  }
  if (n > kNamed) {
    text += fmt::format("  and {} smaller ones (--report lists them)\n", n - kNamed);
  }
  return text;
}

/// Warns about parts that do not touch.
void add_part_warnings(const ShapeSummary& summary, std::vector<std::string>& warnings) {
  const std::vector<PartHeight>& parts = summary.shape.parts;
  const bool is_requested = std::any_of(parts.begin(), parts.end(),
                                        [](const PartHeight& part) { return part.is_known; });
  if (parts.size() > 1 && !is_requested) {
    warnings.push_back(fmt::format(
        "{} parts do not touch ({} pixels): how high one stands above another is not known, "
        "each has a mean height of 0. Measure one part at a time, or draw a --mask that joins "
        "them where the surface does",
        parts.size(), sizes_of(parts)));
    return;
  }
  std::vector<PartHeight> unknown;
  std::copy_if(parts.begin(), parts.end(), std::back_inserter(unknown),
               [](const PartHeight& part) { return !part.is_known; });
  if (is_requested && !unknown.empty()) {
    warnings.push_back(fmt::format(
        "{} of {} parts that do not touch ({} pixels) are too small or too plain to tell how "
        "high they stand: they are put at the largest one's height. Leave them out by a --mask",
        unknown.size(), parts.size(), sizes_of(unknown)));
  }
}

}  // namespace

double sigma_below(const ShapeSummary& summary, double fraction) {
  std::vector<float> values =
      known_values(summary.shape.surface.sigma_deg, summary.shape.surface.is_good());
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(
                                       fraction * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return double{*at};
}

std::string shape_text(const ShapePipelineOptions& options, const ShapeSummary& summary) {
  const Shape& shape = summary.shape;
  const SurfaceEstimate& surface = shape.surface;
  const char* unit = unit_of(summary);
  const std::int64_t n_dark = surface.n_in(PixelState::too_dark);
  std::string text =
      fmt::format("{}: {}; normals of {} ({}), heights over {:.4g} {}\n", options.out.string(),
                  summary.by, counted(surface.n_in(PixelState::good), "pixel"),
                  summary.is_measured ? fmt::format("{} too dark, {} saturated, {} ambiguous",
                                                    n_dark, surface.n_in(PixelState::saturated),
                                                    surface.n_in(PixelState::ambiguous))
                                      : fmt::format("{} have none", n_dark),
                  shape.bow_mm, unit);
  if (!summary.is_measured) {
    return text;
  }
  text += fmt::format("  mask: {}, {} of {} pixels (mask.png)\n", summary.mask_by,
                      summary.mask.n_object, surface.state.pixels().size());
  text += fmt::format("  fit: {}{}\n", name_of(shape.fit),
                      shape.scores.empty() ? "" : ", which foretells lights held out best");
  text += fmt::format(
      "  normals: +- {:.2g} degrees in the median, nine tenths within {:.2g} "
      "(sigma.png, sigma.exr)\n",
      sigma_below(summary, 0.5), sigma_below(summary, 0.9));
  if (summary.n_met_hull) {
    text +=
        fmt::format("  hull: {} of the object's pixels look at it; it tells {} parts apart\n",
                    *summary.n_met_hull, shape.map.parts.n_parts);
  }
  text += part_lines(shape.parts, unit);
  text += fmt::format(
      "  heights have no standard error{}\n",
      summary.are_near
          ? fmt::format("; the last round moved them by {:.2g} mm (rms)", shape.changes.back())
          : "");
  return text;
}

std::vector<std::string> shape_failures(const ShapeSummary& summary) {
  std::vector<std::string> failures;
  const Shape& shape = summary.shape;
  if (!shape.is_settled) {
    failures.push_back(fmt::format("the heights still move by {:.3g} mm (rms) after {}",
                                   shape.changes.back(),
                                   counted(shape.changes.size(), "round")));
  }
  if (!shape.map.is_converged) {
    failures.push_back(fmt::format("the integration stopped at a residual of {:.3g}",
                                   shape.map.solver_residual));
  }
  return failures;
}

std::vector<std::string> shape_warnings(const ShapeSummary& summary) {
  std::vector<std::string> warnings;
  const Shape& shape = summary.shape;
  if (!summary.is_measured) {
    return warnings;
  }
  add_part_warnings(summary, warnings);
  if (summary.are_near) {
    return warnings;
  }
  const char* hint =
      "to know, import the lights' positions (--places positions) and give --width-mm";
  if (shape.nearness.is_near()) {
    warnings.push_back(
        fmt::format("the lights are taken as far but look about {:.2g} picture widths away: "
                    "normals far from "
                    "the picture's middle are turned (their standard errors say how far) and "
                    "heights bow; {}",
                    1.0 / shape.nearness.inverse, hint));
  }
  const HeightBow bow = height_bow(shape.height.view(), shape.map.is_known.view());
  if (bow.bow > bow.rest) {
    warnings.push_back(fmt::format(
        "of the heights {:.3g} {} are one slow bow, {:.3g} are left without it: lights that "
        "are "
        "known by direction only bow any surface when they stand near, and the heights do not "
        "tell that bow from a real one. Trust the detail, not the bow; {}",
        bow.bow, unit_of(summary), bow.rest, hint));
  }
  return warnings;
}

void report_shape(const ShapeSummary& summary, Report& report) {
  report.add_detail("light", summary.are_near ? "near" : "far");
  const Shape& shape = summary.shape;
  const SurfaceEstimate& surface = shape.surface;
  report.add_achieved("good_pixels", surface.n_in(PixelState::good));
  report.add_detail("masked_pixels", surface.n_in(PixelState::masked));
  if (summary.is_measured) {
    report.add_detail("dark_pixels", surface.n_in(PixelState::too_dark));
    report.add_detail("saturated_pixels", surface.n_in(PixelState::saturated));
    report.add_detail("ambiguous_pixels", surface.n_in(PixelState::ambiguous));
    report.add_achieved("sigma_deg_median", sigma_below(summary, 0.5));
    report.add_achieved("sigma_deg_nine_tenths", sigma_below(summary, 0.9));
    report.add_detail("mask_by", summary.mask_by);
    report.add_detail("mask_pixels", summary.mask.n_object);
    add_fit(shape, report);
    add_doubts(shape, report);
  } else {
    report.add_detail("pixels_without_a_peak", surface.n_in(PixelState::too_dark));
  }
  report.add_achieved("heights_range", shape.bow_mm);
  report.add_achieved("is_settled", shape.is_settled);
  report.add_detail("height_changes", shape.changes);
  report.add_detail("parts", std::int64_t{shape.map.parts.n_parts});
  add_parts(shape, summary.n_met_hull.has_value(), report);
  if (summary.n_met_hull) {
    report.add_detail("hull_pixels", *summary.n_met_hull);
    report.add_detail("hull_divisions", std::int64_t{shape.n_divided});
  }
  report.add_detail("cuts", shape.map.n_cuts);
  report.add_detail("step_error", shape.map.step_error);
  report.add_detail("worst_step_error", shape.map.worst_step_error);
  report.add_detail("solver_residual", shape.map.solver_residual);
  report.add_detail("solver_iterations", std::int64_t{shape.map.iterations});
  report.add_detail("unit", summary.has_scale ? "mm" : "pixels");
  report.set_bytes(summary.bytes);
}

}  // namespace haarlight::relight
