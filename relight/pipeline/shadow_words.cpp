// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/shadow_words.h"

#include <fmt/format.h>

#include "core/counted.h"

namespace haarlight::relight {

namespace {

std::string notes_on(const ReprojectReport& found, bool has_height, bool has_hull) {
  std::string text;
  if (has_hull) {
    if (found.has_glossy) {
      text += "  the scene's gloss is left out: only its diffuse part is drawn\n";
    }
    return text;
  }
  const auto note = [&text](double fraction, const char* words) {
    if (fraction > 0.0005) {
      text += fmt::format("  {:.1f} % {}\n", 100.0 * fraction, words);
    }
  };
  note(
      found.affected_receivers,
      "of the receivers look into the region that the object hides from the camera: the middle "
      "of the bounds is drawn (--unseen shows the rest)");
  note(found.outside_fraction,
       "of the light comes through beyond the plane picture: drawn lit");
  note(found.no_point_fraction, "of the light has no point on the plane: drawn lit");
  note(
      found.under_object_fraction,
      "of the receivers lie between the object's bottom and top: parts of it below them darken "
      "them falsely");
  note(found.above_fraction,
       "of the light falls on receivers above the plane: shadow edges there "
       "are too wide");
  if (has_height && found.worst_widening > 1.0) {
    text += fmt::format("  above the plane a shadow's edge is up to {:.2g} times too wide\n",
                        found.worst_widening);
  }
  if (!has_height && found.below_fraction > 0.0) {
    text += "  below the plane edges are up to 29 % too narrow; --object-height corrects it\n";
  }
  if (found.has_glossy) {
    text += "  the scene's gloss is left out: only its diffuse part is drawn\n";
  }
  return text;
}

std::string points_words(const PointsReport& points, std::size_t n_planes) {
  if (points.is_exact) {
    return "  every light was looked up: no error\n";
  }
  return fmt::format(
      "  relative error of the light received {:.2g} (at most {:.2g}), worst point {:.2g}, on "
      "{} checked; {:.0f} look-ups each instead of {}\n",
      points.achieved.relative_l2, points.relative_l2_limit, points.achieved.worst_pixel,
      counted(points.n_checked, "receiver"), points.lookups_a_point,
      static_cast<std::size_t>(points.n_lights) * n_planes);
}

std::string joined_words(const JoinedPlane& plane) {
  std::string each;
  for (const double known : plane.known_fractions) {
    each += fmt::format("{}{:.1f} %", each.empty() ? "" : ", ", 100.0 * known);
  }
  return fmt::format("  {} captures of one plane know {} of its picture, together {:.1f} %\n",
                     plane.known_fractions.size(), each, 100.0 * plane.known_fraction);
}

}  // namespace

std::string shadow_words(const ShadowOptions& options, const ShadowSummary& summary) {
  const ReprojectReport& found = summary.reprojected;
  std::string text =
      fmt::format("{}: {}, {}\n", options.output, counted(found.n_lights, "light"),
                  counted(found.n_receivers, "receiver"));
  if (shadow_tolerance(options).relative_l2 > 0.0) {
    text += points_words(found.points, summary.n_planes);
  }
  if (options.captured.plate == "falloff") {
    text += "  no clean plate: a fitted cos^4/r^2 replaces it\n";
  }
  for (const JoinedPlane& plane : summary.joined) {
    text += joined_words(plane);
  }
  if (summary.hull) {
    text += hull_words(*summary.hull);
    text += fmt::format(
        "  it tells {:.1f} % of the light; what was not seen can change the picture by {:.2g} "
        "of its norm\n",
        100.0 * found.occluder_fraction, found.unseen_relative);
  }
  if (!options.spread.empty()) {
    text += fmt::format(
        "  with resolution and noise the picture can be off by {:.2g} of its norm: {}\n",
        found.spread_relative, options.spread);
  }
  return text + notes_on(found, options.captured.height.has_value(), summary.hull.has_value());
}

std::string object_words(const ShadowObject& object) {
  return fmt::format("  the object covers {}{}\n", counted(object.n_drawn, "pixel"),
                     object.n_hidden > 0
                         ? fmt::format(", {} more are behind the scene", object.n_hidden)
                         : "");
}

std::string truth_words(const ShadowAgreement& truth) {
  const Achieved& found = truth.achieved;
  if (truth.object) {
    return fmt::format(
        "  against scene and object ray-traced: relative error {:.3g}, {:.1f} dB; on the "
        "object's pixels {:.3g}\n",
        found.relative_l2, found.psnr_db, truth.object->relative_l2);
  }
  const ShadowError& error = *truth.shadow;
  std::string text = fmt::format(
      "  against the ray-traced shadow: relative error {:.3g}, {:.1f} dB, {:.1f} % of the "
      "shadow wrong\n  on the {:.0f} % of the receivers that look at known points only: "
      "{:.3g}, "
      "{:.1f} %\n",
      found.relative_l2, found.psnr_db, 100.0 * error.wrong_fraction,
      100.0 * error.known_fraction, error.known_relative_l2,
      100.0 * error.known_wrong_fraction);
  if (error.spread) {
    text += fmt::format(
        "  the spread holds the truth at {:.2f} % of the values in shadow; of the unshadowed "
        "value\n  the median spread is {:.3f}, the mean error {:.3f}, rms {:.3f}\n",
        100.0 * error.spread->holding_fraction, error.spread->median, error.spread->mean_error,
        error.spread->rms_error);
  }
  return text;
}

}  // namespace haarlight::relight
