// SPDX-License-Identifier: Apache-2.0
/// @file
/// What cast_shadow() was requested to do and achieved, for a report.

#include <fmt/format.h>

#include "relight/pipeline/shadow_pipeline.h"

namespace haarlight::relight {

namespace {

void add_requested(const ShadowOptions& options, const ShadowSummary& summary, Report& report) {
  report.add_input(options.captured.basis);
  report.add_input(options.scene);
  for (const std::string& file : options.captured.also) {
    report.add_input(file);
  }
  if (summary.missing_fraction) {
    report.add_input(options.light.cubemap);
    report.add_requested("rotate_deg", options.light.rotate_deg);
    report.add_detail("layout", summary.layout);
    report.add_achieved("missing_share", *summary.missing_fraction);
  }
  if (!options.truth_object.empty()) {
    report.add_input(options.truth_object);
  }
  if (options.captured.height) {
    report.add_requested(
        "object_height_mm",
        std::vector<double>{options.captured.height->low_mm, options.captured.height->high_mm});
  }
  if (options.worst_point) {
    report.add_requested("irradiance_worst_point", *options.worst_point);
  }
  report.add_requested("irradiance_relative_l2", shadow_tolerance(options).relative_l2);
  report.add_requested("window", std::string(to_string(options.window)));
  if (is_plate_captured(options.captured)) {
    report.add_input(options.captured.plate);
  }
  report.add_detail("plate", options.captured.plate);
}

void add_reprojected(const ReprojectReport& found, Report& report) {
  report.add_achieved("unknown_share", found.unknown_fraction);
  report.add_achieved("affected_receivers", found.affected_receivers);
  report.add_achieved("unseen_relative_l2", found.unseen_relative);
  const PointsReport& points = found.points;
  report.add_achieved("irradiance_relative_l2", points.achieved.relative_l2);
  report.add_achieved("irradiance_relative_l2_limit", points.relative_l2_limit);
  report.add_achieved("irradiance_worst_point", points.achieved.worst_pixel);
  report.add_detail("is_exact", points.is_exact);
  report.add_detail("checked_receivers", points.n_checked);
  report.add_detail("lookups_a_receiver", points.lookups_a_point);
  report.add_detail("block_side", std::int64_t{points.block_side});
  report.add_detail("table_bytes", static_cast<std::int64_t>(points.table_bytes));
  report.add_detail("receiver_bytes", static_cast<std::int64_t>(points.totals_bytes));
  report.add_detail("lights", std::int64_t{found.n_lights});
  report.add_detail("receivers", found.n_receivers);
  report.add_detail("on_plane_share", found.on_fraction);
  report.add_detail("above_plane_share", found.above_fraction);
  report.add_detail("below_plane_share", found.below_fraction);
  report.add_detail("no_point_share", found.no_point_fraction);
  report.add_detail("outside_plane_picture_share", found.outside_fraction);
  report.add_detail("receivers_over_object_bottom", found.under_object_fraction);
  report.add_detail("receivers_over_object_top", found.over_object_fraction);
  report.add_detail("worst_widening_above", found.worst_widening);
  report.add_detail("visibility_over_one", static_cast<std::int64_t>(found.count.n_excess));
  report.add_detail("worst_visibility_excess", found.count.worst_excess);
  report.add_detail("dark_plate_values", static_cast<std::int64_t>(found.count.n_no_plate));
  report.add_detail("gloss_left_out", found.has_glossy);
}

void add_truth(const ShadowAgreement& truth, Report& report) {
  report.add_achieved("relative_l2", truth.achieved.relative_l2);
  if (truth.shadow) {
    report.add_achieved("worst_pixel", truth.achieved.worst_pixel);
  }
  report.add_achieved("psnr_db", truth.achieved.psnr_db);
  if (truth.shadow) {
    const ShadowError& error = *truth.shadow;
    report.add_achieved("shadow_wrong_share", error.wrong_fraction);
    report.add_achieved("relative_l2_where_known", error.known_relative_l2);
    report.add_achieved("shadow_wrong_share_where_known", error.known_wrong_fraction);
    report.add_achieved("known_share", error.known_fraction);
    if (error.spread) {
      report.add_achieved("spread_holds_truth_share", error.spread->holding_fraction);
      report.add_achieved("spread_median", error.spread->median);
      report.add_achieved("spread_mean_error", error.spread->mean_error);
      report.add_achieved("spread_rms_error", error.spread->rms_error);
    }
  }
  if (truth.object) {
    report.add_achieved("object_relative_l2", truth.object->relative_l2);
  }
}

}  // namespace

void add_to_report(const ShadowOptions& options, const ShadowSummary& summary, Report& report) {
  add_requested(options, summary, report);
  for (std::size_t i = 0; i < summary.plates.size(); ++i) {
    const std::string suffix = i == 0 ? "" : fmt::format("_{}", i + 1);
    report.add_detail("plate_scale" + suffix, summary.plates[i].scale);
    report.add_achieved("plane_known_share" + suffix, summary.plates[i].known_fraction);
    report.add_achieved("plane_off_mm" + suffix, summary.plates[i].offset.most_mm);
  }
  for (std::size_t i = 0; i < summary.joined.size(); ++i) {
    report.add_achieved("joined_plane_known_share" + (i == 0 ? "" : fmt::format("_{}", i + 1)),
                        summary.joined[i].known_fraction);
  }
  report.add_detail("planes", static_cast<std::int64_t>(summary.n_planes));
  add_reprojected(summary.reprojected, report);
  if (summary.reprojected.spread_relative > 0.0) {
    report.add_achieved("spread_relative_l2", summary.reprojected.spread_relative);
  }
  report.add_requested("method", std::string(to_string(options.method)));
  if (summary.hull) {
    report.add_achieved("hull_fraction", summary.reprojected.occluder_fraction);
    add_to_report(*summary.hull, report);
  }
  report.add_detail("exposure", summary.exposure);
  if (summary.background_fraction) {
    report.add_detail("background_share", *summary.background_fraction);
  }
  if (summary.object) {
    report.add_requested("plane_albedo", *options.plane_albedo);
    report.add_detail("object_pixels", summary.object->n_drawn);
    report.add_detail("object_pixels_behind_scene", summary.object->n_hidden);
    report.add_detail("object_scale", summary.object->scale);
  }
  if (summary.truth) {
    add_truth(*summary.truth, report);
  }
  report.set_bytes(summary.bytes);
}

}  // namespace haarlight::relight
