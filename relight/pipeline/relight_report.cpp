// SPDX-License-Identifier: Apache-2.0
/// @file
/// What relight_picture() was requested to do and achieved, for a report.

#include "relight/basis/relight_kernels.h"
#include "relight/pipeline/relight_pipeline.h"

namespace haarlight::relight {

namespace {

void add_environment(const RelightPictureOptions& options, const RelightSummary& summary,
                     Report& report) {
  report.add_input(options.light.cubemap);
  report.add_requested("rotate_deg", options.light.rotate_deg);
  report.add_detail("layout", summary.layout);
  report.add_achieved("missing_share", *summary.missing_fraction);
  report.add_achieved("energy_conservation_error", summary.conservation_error);
}

void add_terms_requested(const RelightPictureOptions& options, Report& report) {
  if (options.max_error) {
    report.add_requested("relative_l2", *options.max_error);
  }
  if (options.terms) {
    report.add_requested("terms", std::int64_t{*options.terms});
  }
  if (options.seconds) {
    report.add_requested("seconds_a_picture", *options.seconds);
  }
}

void add_choice(const RelightPictureOptions& options, const RelightSummary& summary,
                Report& report) {
  if (!summary.choice) {
    return;
  }
  const auto n = static_cast<double>(options.frames.value_or(1));
  if (options.seconds) {
    report.add_achieved("seconds_a_picture", summary.seconds / n);
    report.add_achieved("is_time_enough", summary.is_time_enough);
  }
  const RelightChoice& choice = *summary.choice;
  report.add_detail("form", std::string(to_string(choice.form)));
  report.add_detail("has_all_terms", choice.has_all);
  if (choice.is_predicted) {
    report.add_detail("predicted_seconds", choice.seconds);
    report.add_detail("predicted_seconds_of_all", choice.all_seconds);
  }
  if (options.frames) {
    report.add_detail("frame_terms", std::vector<double>(summary.picture_terms.begin(),
                                                         summary.picture_terms.end()));
  }
}

}  // namespace

void add_to_report(const RelightPictureOptions& options, const RelightSummary& summary,
                   Report& report) {
  report.add_input(options.basis);
  if (options.frames) {
    report.add_requested("frames", std::int64_t{*options.frames});
    add_terms_requested(options, report);
  }
  if (summary.missing_fraction) {
    add_environment(options, summary, report);
  } else if (!options.weights.empty()) {
    report.add_input(options.weights);
  }
  if (!options.frames) {
    add_terms_requested(options, report);
  }
  report.add_achieved("relative_l2_bound", summary.relative_l2_bound);
  report.add_achieved("channel_l2_bound", summary.channel_bounds);
  report_clipped(summary.basis, summary.clipping, report);
  report.add_achieved("terms", std::int64_t{summary.terms});
  add_choice(options, summary, report);
  if (options.frames) {
    report.add_detail("method", summary.method);
    report.add_detail("kernels", std::string(word_of(best_kernel_code())));
    report.add_detail("relight_seconds", summary.seconds);
    report.add_detail("relight_cpu_seconds", summary.cpu_seconds);
  } else {
    report.add_detail("terms_all", std::int64_t{summary.terms_all});
    report.add_detail("relight_seconds", summary.seconds);
    report.add_detail("relight_cpu_seconds", summary.cpu_seconds);
    report.add_detail("bytes_read", static_cast<std::int64_t>(summary.bytes_read));
  }
  report.add_detail("exposure", summary.exposure);
  if (summary.against) {
    report.add_input(options.against);
    report.add_achieved("relative_l2", summary.against->relative_l2);
    report.add_achieved("worst_pixel", summary.against->worst_pixel);
    report.add_achieved("psnr_db", summary.against->psnr_db);
  }
  report.set_bytes(summary.bytes);
}

}  // namespace haarlight::relight
