// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "core/report.h"
#include "core/rig/measured_rig.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/session/session.h"
#include "relight/calibration/near_calibration.h"
#include "relight/calibration/rig_light_calibration.h"
#include "relight/pipeline/pipeline_settings.h"

/// @file
/// Poses of a rig's faces and powers of their lights, from its own capture of a flat matte
/// sheet on its plane: each face as a rigid array. What `haarlight rig calibrate lights` does,
/// for programs that link it. Method: docs/numerics/near-light.md.

namespace haarlight::relight {

struct RigLightsOptions {
  std::filesystem::path rig;      ///< the rig file
  std::filesystem::path session;  ///< capture of the sheet, one light per picture
  /// Of the sheet, mm along the plane's u and v; nothing: the middle of the plane.
  std::optional<SheetRegion> region{};
  double sheet_mm = 0.0;         ///< its thickness over the plane
  double bow_mm = 1.0;           ///< its bow, a standard deviation
  Lobe lobe = Lobe::free;        ///< one exponent for each face; given: the rig file's
  std::filesystem::path page{};  ///< with figures; empty: NAME.lights.html next to the rig file
  PipelineSettings settings{};
};

/// The faces of a rig as found from a capture of a sheet.
struct RigFaces {
  SheetSamples sheet;
  std::vector<FaceCalibration> faces;
  bool is_good = true;  ///< every fit converged and its model was not rejected
  bool is_plane_measured = false;
  bool is_noise_known = false;
};

struct RigLightsSummary {
  Rig rig;  ///< the rig as written
  RigFaces faces;
  std::filesystem::path page{};  ///< written; empty: none
  /// The file next to the rig file that holds the results, and its bytes; empty: a fit did not
  /// converge, or it was not requested.
  std::filesystem::path measured{};
  std::uint64_t bytes = 0;
  std::vector<PipelineNote> notes{};
};

/// @param rig  the session's, or as currently known
[[nodiscard]] RigFaces fit_rig_faces(const session::Session& session, const Rig& rig,
                                     const RigLightsOptions& options);

/// Fits, reports, writes the page and, if all is good, NAME.measured.toml.
/// @throws Error  a session of another rig, a sheet that is not visible, lights that cannot be
///                found
[[nodiscard]] RigLightsSummary calibrate_rig_lights(const RigLightsOptions& options);

/// The result of the model test, for the user.
[[nodiscard]] std::string test_text(const ModelTest& test);
/// Roughness, sheen and the other fitted terms of the sheet, for the user.
[[nodiscard]] std::string sheet_text(const LightCalibration& found);
/// The findings for each face, and their limitations.
void add_face_notes(const Rig& rig, const RigFaces& fit, PipelineNotes& notes);
void report_faces(const Rig& rig, const RigFaces& fit, Report& report);

/// A face as stored in NAME.measured.toml.
[[nodiscard]] MeasuredFace measured_face(const Face& face, const FaceCalibration& found);

}  // namespace haarlight::relight
