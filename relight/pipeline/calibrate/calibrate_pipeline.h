// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/report.h"
#include "haarlight/core/enum_words.h"
#include "haarlight/core/picture/image_io.h"
#include "relight/calibration/calibrate_with_shape.h"
#include "relight/calibration/free_lights.h"
#include "relight/calibration/mirror_ball.h"
#include "relight/calibration/near_calibration.h"
#include "relight/calibration/sheet_layout.h"
#include "relight/pipeline/calibrate/found_lights.h"
#include "relight/pipeline/calibrate/rig_lights_pipeline.h"
#include "relight/pipeline/pipeline_settings.h"

/// @file
/// Positions and powers of lights, from pictures of a flat sheet or of mirror balls. What
/// `haarlight calibrate` does, for programs that link it. Which method to choose, and its
/// accuracy: docs/reference/calibration.md.

namespace haarlight::relight {

enum class LightTarget {
  ball,   ///< mirror balls: directions from one, positions from several
  sheet,  ///< a matte sheet: positions, powers of free lights, an array, or a rig's faces
};
inline constexpr auto kLightTargetWords = std::to_array<std::string_view>({"ball", "sheet"});
constexpr std::span<const std::string_view> words_of(LightTarget) { return kLightTargetWords; }

/// Options for mirror balls.
struct BallTargetOptions {
  /// White on one ball each, black around it; empty: balls are looked for.
  std::vector<std::filesystem::path> masks{};
  int n_balls = 1;                  ///< to look for
  std::vector<double> radius_mm{};  ///< one for all, or one for each mask; empty: far lights
  /// Uncertainty of an outline as a whole: standard deviation of its centre and radius.
  double edge_px = 0.5;
};

/// Rows and columns of lights in a flat array, listed row by row, the first at the top.
struct LightGrid {
  int rows = 0;
  int cols = 0;
  double pitch_mm = 0.0;  ///< from light to light
};

/// Options for a sheet.
struct SheetTargetOptions {
  /// The part used, mm right and up from the picture's middle, for a rig along its plane's u
  /// and v; nothing: nine tenths of the picture.
  std::optional<SheetRegion> region{};
  Aim aim = Aim::centre;
  double aim_deg = 3.0;   ///< aiming error of a light, a standard deviation
  double tilt_deg = 1.0;  ///< the camera's deviation from straight above, likewise
  double led_mm = 0.0;    ///< side of the lights' emitters
  Lobe lobe = Lobe::free;
  double mu = 1.0;       ///< lobe exponent: start of Lobe::free, or as given
  double bow_mm = 1.0;   ///< bow of the sheet, a standard deviation; 0: it is flat
  int samples = 32;      ///< approximate number of blocks along its longer side
  bool is_bent = false;  ///< its shape is found by alternation with the lights
  std::optional<LightGrid> grid{};
  double thickness_mm = 0.0;     ///< of a rig: over the plane
  std::filesystem::path page{};  ///< of a rig file: the page with figures; empty: next to it
};

struct CalibratePipelineOptions {
  std::filesystem::path input;  ///< a session's folder, or a folder with one picture per light
  std::filesystem::path out;    ///< folder; or one list: .json, .lp, .csv
  std::optional<LightTarget> target{};  ///< nothing: from the input and the options
  std::vector<std::string> exclude{};   ///< pictures whose names contain one of these
  std::optional<Transfer> transfer{};   ///< of integer pictures; nothing: as the file says
  // The camera: two of the three determine it; 0: not given.
  double width_mm = 0.0;   ///< what the picture shows across, on the sheet
  double camera_mm = 0.0;  ///< from the lens to the sheet, or to what the balls lie on
  double focal_px = 0.0;
  /// The rig file: of a sheet's session, its measured values are written too; of balls, whose
  /// camera saw them.
  std::filesystem::path rig{};
  BallTargetOptions ball{};
  SheetTargetOptions sheet{};
  PipelineSettings settings{};
};

/// Findings from balls besides the lights.
struct BallFindings {
  std::vector<MeasuredBall> balls;
  // For near lights.
  std::optional<double> camera_mm{};  ///< the camera over the plane that the balls lie on
  std::optional<double> width_mm{};   ///< the picture's, there
  std::optional<double> ray_chi2{};   ///< per degree of freedom: 1 if rays meet as expected
};

/// Findings from a sheet besides the lights.
struct SheetFindings {
  double block_noise = 0.0;  ///< relative, of a block
  int block_rows = 0;
  int block_cols = 0;
  std::optional<double> array_start_rms_mm{};  ///< of free lights against the array's layout
  std::optional<LightCalibration> flat{};      ///< of a sheet that is flat
  std::optional<Alternation> bent{};           ///< of one that is not
};

struct CalibrateSummary {
  std::string method;  ///< "ball", "sheet" or "rig"
  FoundLights found;
  std::optional<BallFindings> balls{};
  std::optional<SheetFindings> sheet{};
  std::optional<RigLightsSummary> rig{};
  bool are_all_seen = true;
  std::uint64_t bytes = 0;  ///< written
  std::vector<PipelineNote> notes;

  /// Every light was seen, and the pictures do not contradict the model.
  [[nodiscard]] bool is_usable() const { return found.is_good && are_all_seen; }
};

/// Finds the lights and writes their lists.
/// @throws Error(usage)  options that contradict each other or the input, or are insufficient
/// @throws Error  not one light was found; an output that exists; as what opens pictures and
///                sessions, and as the calibrations
[[nodiscard]] CalibrateSummary calibrate_capture_lights(
    const CalibratePipelineOptions& options);

/// What was found, in the order of the work.
void report_calibration(const CalibrateSummary& summary, Report& report);

}  // namespace haarlight::relight
