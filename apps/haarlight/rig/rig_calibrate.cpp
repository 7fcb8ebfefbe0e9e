// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/rig/rig_calibrate.h"

#include "apps/haarlight/options/pipeline_words.h"
#include "relight/pipeline/calibrate/rig_lights_pipeline.h"

namespace haarlight::apps {

ExitCode run_calibrate_lights(const CalibrateArguments& arguments, const CommonOptions& common,
                              Report& report) {
  relight::RigLightsOptions options;
  options.rig = arguments.rig;
  options.session = arguments.session;
  if (!arguments.region.empty()) {
    options.region = relight::SheetRegion{arguments.region[0], arguments.region[1],
                                          arguments.region[2], arguments.region[3]};
  }
  options.sheet_mm = arguments.sheet_mm;
  options.bow_mm = arguments.bow_mm;
  options.lobe = arguments.lobe;
  options.page = arguments.page;
  options.settings = pipeline_settings(common);
  const relight::RigLightsSummary summary = relight::calibrate_rig_lights(options);
  relight::report_faces(summary.rig, summary.faces, report);
  report.set_bytes(summary.bytes);
  return summary.faces.is_good ? ExitCode::done : ExitCode::target_missed;
}

}  // namespace haarlight::apps
