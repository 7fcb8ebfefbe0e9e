// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/calibrate/calibrate_pipeline.h"

#include <algorithm>
#include <array>
#include <span>
#include <string_view>
#include <utility>

#include "haarlight/core/enum_words.h"
#include "haarlight/core/error.h"
#include "relight/pipeline/calibrate/calibrate_balls.h"
#include "relight/pipeline/calibrate/calibrate_bent_sheet.h"
#include "relight/pipeline/calibrate/calibrate_rig.h"
#include "relight/pipeline/calibrate/calibrate_sheet.h"
#include "relight/pipeline/calibrate/light_pictures.h"

namespace haarlight::relight {

namespace {

enum class CalibrateMethod { ball, sheet, rig };
constexpr auto kCalibrateMethodWords =
    std::to_array<std::string_view>({"ball", "sheet", "rig"});
constexpr std::span<const std::string_view> words_of(CalibrateMethod) {
  return kCalibrateMethodWords;
}

CalibrateMethod method_of(const CalibratePipelineOptions& options,
                          const LightPictures& pictures) {
  const bool has_rig = pictures.session() != nullptr && pictures.session()->rig().has_value();
  const bool has_balls = !options.ball.masks.empty() || !options.ball.radius_mm.empty();
  std::optional<LightTarget> target = options.target;
  if (!target && (has_rig || has_balls)) {
    target = has_balls ? LightTarget::ball : LightTarget::sheet;
  }
  if (!target) {
    throw Error("what do the pictures show?", options.input.string(),
                "--target ball or --target sheet", ExitCode::usage);
  }
  if (*target == LightTarget::ball) {
    return CalibrateMethod::ball;
  }
  if (has_balls) {
    throw Error("a ball's option for a sheet", "--ball, --radius-mm", "--target ball",
                ExitCode::usage);
  }
  if (!has_rig && !options.rig.empty()) {
    throw Error("a rig's lights are found from a capture of the rig", options.input.string(),
                "give its session; or leave --rig out, for lights of which nothing is known");
  }
  if (has_rig && (options.sheet.is_bent || options.sheet.grid)) {
    throw Error("a rig's faces are rigid and its sheet is flat", "--bent, --grid",
                "leave them out", ExitCode::usage);
  }
  return has_rig ? CalibrateMethod::rig : CalibrateMethod::sheet;
}

LightPictures open_pictures(const CalibratePipelineOptions& options) {
  LightPicturesOptions pictures;
  pictures.input = options.input;
  pictures.exclude = options.exclude;
  pictures.masks = options.ball.masks;
  pictures.transfer = options.transfer;
  return LightPictures::open(pictures, options.settings);
}

/// Finds the lights by the chosen method; stores its findings in the summary.
FoundLights find_lights(CalibrateMethod method, const CalibratePipelineOptions& options,
                        const LightPictures& pictures, CalibrateSummary& summary,
                        PipelineNotes& notes) {
  switch (method) {
    case CalibrateMethod::ball:
      return find_by_balls(options, pictures, summary.balls.emplace(), notes);
    case CalibrateMethod::sheet:
      return find_by_sheet(options, pictures, summary.sheet.emplace(), notes);
    case CalibrateMethod::rig:
      break;
  }
  return find_by_rig(options, *pictures.session(), summary.rig.emplace(), notes);
}

void report_balls(const BallFindings& balls, Report& report) {
  std::vector<double> numbers;
  for (const MeasuredBall& ball : balls.balls) {
    numbers.insert(numbers.end(), {ball.circle.x, ball.circle.y, ball.circle.radius});
  }
  report.add_achieved("balls_px", numbers);
  if (balls.camera_mm) {
    report.add_achieved("camera_mm", *balls.camera_mm);
  }
  if (balls.width_mm) {
    report.add_achieved("width_mm", *balls.width_mm);
  }
  if (balls.ray_chi2) {
    report.add_achieved("ray_chi2", *balls.ray_chi2);
  }
}

void report_sheet(const SheetFindings& sheet, Report& report) {
  report.add_achieved("block_noise", sheet.block_noise);
  report.add_detail("blocks", std::vector<double>{static_cast<double>(sheet.block_rows),
                                                  static_cast<double>(sheet.block_cols)});
  if (sheet.array_start_rms_mm) {
    report.add_detail("array_start_rms_mm", *sheet.array_start_rms_mm);
  }
  if (sheet.flat) {
    report.add_achieved("reduced_chi2", sheet.flat->reduced_chi2);
    report.add_achieved("lobe_mu", sheet.flat->mu);
    report.add_achieved("model_test_sigma", sheet.flat->test.z);
    report.add_achieved("model_test_lobe_sigma", sheet.flat->test.lobe_z);
    report.add_achieved("is_model_right", sheet.flat->test.is_passed());
  }
  if (sheet.bent) {
    report.add_achieved("sheet_range_mm", bent_range_mm(*sheet.bent));
    report.add_achieved("rounds", static_cast<std::int64_t>(sheet.bent->moves_mm.size()));
    report.add_achieved("chi2_flat", sheet.bent->chi2.front());
    report.add_achieved("is_settled", sheet.bent->has_converged);
    report.add_achieved("reduced_chi2", sheet.bent->lights.reduced_chi2);
    report.add_achieved("lobe_mu", sheet.bent->lights.mu);
  }
}

}  // namespace

CalibrateSummary calibrate_capture_lights(const CalibratePipelineOptions& options) {
  require_writable(options.out, options.settings.overwrites);
  const LightPictures pictures = open_pictures(options);
  const CalibrateMethod method = method_of(options, pictures);
  if (options.sheet.is_bent && options.sheet.grid) {
    throw Error("an array on a sheet that is not flat is not fitted", "--bent",
                "leave --bent out: an array cannot follow a bend", ExitCode::usage);
  }
  PipelineNotes notes(options.settings.tell);
  CalibrateSummary summary;
  summary.method = to_string(method);
  summary.found = find_lights(method, options, pictures, summary, notes);
  const std::vector<FoundLight>& lights = summary.found.lights;
  const auto is_seen = [](const FoundLight& light) { return light.is_seen(); };
  if (std::none_of(lights.begin(), lights.end(), is_seen)) {
    throw Error("not one light was found: " + lights.front().finding, options.input.string(),
                "look at the pictures' exposure");
  }
  summary.are_all_seen = std::all_of(lights.begin(), lights.end(), is_seen);
  summary.bytes = write_found(summary.found, options.out);
  summary.notes = notes.all();
  return summary;
}

void report_calibration(const CalibrateSummary& summary, Report& report) {
  report.add_requested("target", summary.method);
  if (summary.balls) {
    report_balls(*summary.balls, report);
  }
  if (summary.sheet) {
    report_sheet(*summary.sheet, report);
  }
  if (summary.rig) {
    report_faces(summary.rig->rig, summary.rig->faces, report);
  }
  report.set_bytes(summary.bytes);
  report_found(summary.found, report);
}

}  // namespace haarlight::relight
