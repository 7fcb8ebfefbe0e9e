// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight fit CAPTURE --basis auto -o FILE`: a picture that can be lit from any direction.

#include <algorithm>
#include <memory>

#include <fmt/format.h>

#include "apps/haarlight/fit_page.h"
#include "apps/haarlight/options/fit_options.h"
#include "haarlight/core/files.h"
#include "relight/pipeline/fit/fit_report.h"

namespace haarlight::apps {

namespace {

/// Every form, best first by the error at the lights left out.
ExitCode run_compare(const FitArguments& arguments, const relight::FitOptions& options,
                     const CommonOptions& common, Report& report) {
  bool has_head = false;
  const relight::FitSummary summary =
      relight::compare_fits(options, [&](relight::FitTruth truth, const relight::FormFit& fit) {
        fmt::print("{}{}", has_head ? "" : relight::fit_table_head(truth),
                   relight::fit_table_row(fit));
        has_head = true;
      });
  if (summary.haar) {
    fmt::print("{}", relight::fit_table_row(*summary.haar));
  }
  relight::report_fits(options, summary, report);
  if (!arguments.records.empty()) {
    const std::string command = fmt::format("haarlight fit {} --compare --hold-out {}",
                                            arguments.capture, arguments.hold_out);
    write_file_atomically(
        arguments.records,
        tradeoff_json(relight::fit_records(summary, std::max(1, common.threads), command)));
  }
  return ExitCode::done;
}

ExitCode run_fit(const FitArguments& arguments, const CommonOptions& common, Report& report) {
  const relight::FitOptions options = fit_options(arguments, common);
  if (arguments.compare) {
    return run_compare(arguments, options, common, report);
  }
  const relight::FitSummary summary = relight::fit_capture(options);
  if (!arguments.out.empty()) {
    add_page_to_fit(arguments.out, common);
  }
  fmt::print("{}{}", relight::fit_table_head(summary.truth),
             relight::fit_table_row(summary.fits.front()));
  relight::report_fit(options, summary, report);
  if (!arguments.out.empty()) {
    tell_next(common, {"view", arguments.out});
  }
  return ExitCode::done;
}

}  // namespace

void add_fit(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<FitArguments>();
  Command verb = root.add_verb("fit", "Make a picture that can be lit from any direction");
  add_fit_options(verb, *arguments);
  verb.footer(
      "What is fitted and how it is chosen: docs/numerics/reflectance-fits.md.\n"
      "Examples:\n"
      "  haarlight fit door.session -o door-web\n"
      "  haarlight fit door.session -o door-small --bytes 400k\n"
      "  haarlight fit door.session --basis hsh9 -o door.rti\n"
      "  haarlight fit door/ --lights door/dirs.lp --crop 1,1,6,6 -o door-detail\n"
      "  haarlight fit cube.session --basis ptm --near exact -o cube.ptm\n"
      "  haarlight fit door.session --compare --hold-out 6:2");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_fit(*arguments, common, report);
  });
}

}  // namespace haarlight::apps
