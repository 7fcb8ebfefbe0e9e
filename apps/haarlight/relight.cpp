// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight relight BASIS --cubemap ENV -o OUT`: a picture under an environment, or under
/// lights named one by one; or an animation, the environment turning once.

#include "apps/haarlight/options/light_options.h"
#include "apps/haarlight/options/pipeline_words.h"
#include "apps/haarlight/step_before.h"
#include "apps/haarlight/verb.h"
#include "relight/pipeline/relight_pipeline.h"

namespace haarlight::apps {

namespace {

ExitCode run_relight(relight::RelightPictureOptions options, const CommonOptions& common,
                     Report& report) {
  options.settings = pipeline_settings(common);
  refuse_not_basis(options.basis, "relight");
  const relight::RelightSummary summary = relight::relight_picture(options);
  relight::add_to_report(options, summary, report);
  return summary.is_error_kept && summary.is_time_enough ? ExitCode::done
                                                         : ExitCode::target_missed;
}

}  // namespace

void add_relight(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<relight::RelightPictureOptions>();
  relight::RelightPictureOptions& options = *arguments;
  Command verb =
      root.add_verb("relight", "Make the picture under an environment or chosen lights");
  verb.option("BASIS", &options.basis, "Basis file",
              {.type = "BASIS.hlb", .is_required = true});
  verb.option("-o,--output", &options.output, "Picture: .exr linear, .png for display",
              {.type = "OUT", .is_required = true});
  add_light_options(verb, options.light);
  verb.option("--weights", &options.weights, "JSON list of every light's weight",
              {.type = "FILE.json"});
  verb.option("--max-error", &options.max_error,
              "The way of least predicted seconds whose relative L2 error is bounded by this",
              {.bounds = Bounds{0.0, 1.0}});
  verb.option("--terms", &options.terms, "Use this many terms (default: all)",
              {.bounds = Bounds{}, .excludes = "--max-error"});
  verb.option("--seconds", &options.seconds,
              "The least error that T seconds of summing allow a picture; exit code 1 if even "
              "the cheapest way takes longer",
              {.type = "T", .bounds = Bounds{1e-6}});
  verb.option("--order", &options.order,
              "Order of terms: transport, or light alone (poor; for comparison)",
              {.shows_default = true});
  verb.option("--exposure", &options.exposure,
              "Factor before display (default for .png: 99.5th percentile to white)");
  verb.option("--stops", &options.stops, "That factor, so many stops brighter or darker",
              {.bounds = Bounds{-60.0, 60.0}});
  verb.option("--against", &options.against,
              "Session of the same capture: measures the error instead of bounding it",
              {.type = "SESSION"});
  verb.option("--frames", &options.frames,
              "So many pictures while the environment turns once about z: OUT-0000 ...",
              {.bounds = Bounds{1.0, 9999.0}, .excludes = "--against"});
  verb.footer(
      "Examples:\n"
      "  haarlight relight airplane.hlb --cubemap apartment.hdr --rotate 90 -o room.exr\n"
      "  haarlight relight airplane.hlb --cubemap apartment.hdr --frames 3 -o turn.png\n"
      "  haarlight relight airplane.hlb --light 528 --seconds 0.5 -o fast.exr\n"
      "  haarlight relight airplane.hlb --light 528 --light 33=0.5 -o two.png");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_relight(*arguments, common, report);
  });
}

}  // namespace haarlight::apps
