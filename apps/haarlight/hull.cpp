// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight hull BASIS -o hull.ply`: the captured object, as its shadows know it.

#include "apps/haarlight/options/captured_options.h"
#include "apps/haarlight/options/pipeline_words.h"
#include "apps/haarlight/verb.h"
#include "relight/pipeline/hull_pipeline.h"

namespace haarlight::apps {

namespace {

struct HullArguments {
  CapturedArguments object;
  relight::HullPipelineOptions options;
};

ExitCode run_hull(const HullArguments& arguments, const CommonOptions& common, Report& report) {
  relight::HullPipelineOptions options = arguments.options;
  options.captured = captured_object(arguments.object, "hull");
  options.voxel_mm = arguments.object.voxel_mm;
  options.settings = pipeline_settings(common);
  const relight::HullPipelineSummary summary = relight::export_hull(options);
  relight::add_to_report(options, summary, report);
  return ExitCode::done;
}

}  // namespace

void add_hull(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<HullArguments>();
  relight::HullPipelineOptions& options = arguments->options;
  Command verb = root.add_verb("hull", "Carve the captured object out of its shadows");
  verb.option("-o,--output", &options.outputs,
              "What to write, up to one of each: .ply surface, .vtu cells with their evidence, "
              ".png preview",
              {.type = "OUT", .is_required = true});
  add_captured_options(verb, arguments->object);
  verb.option("--smooth", &options.n_smoothings,
              "Rounds of smoothing of the surface, within half a voxel; 0: the voxels' faces",
              {.bounds = Bounds{0, 1000}, .shows_default = true});
  verb.option("--frames", &options.n_frames,
              "In the .png so many views from all around, one below the other (default: by the "
              "camera, from the front, the right and above)",
              {.bounds = Bounds{1, 360}});
  verb.footer(
      "Examples:\n"
      "  haarlight hull airplane.hlb -o airplane.ply -o airplane.png\n"
      "  haarlight hull airplane.hlb --voxel 4 -o airplane.vtu\n"
      "  haarlight hull airplane.hlb --frames 24 -o turning.png");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_hull(*arguments, common, report);
  });
}

}  // namespace haarlight::apps
