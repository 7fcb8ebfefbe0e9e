// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/calibrate/calibrate_rig.h"

#include <utility>

#include <Eigen/Geometry>
#include <fmt/format.h>

#include "haarlight/relight/light/near_light.h"
#include "relight/pipeline/calibrate/sheet_parts.h"

namespace haarlight::relight {

namespace {

using Eigen::Vector3d;

RigLightsSummary calibrate_faces_of(const CalibratePipelineOptions& options,
                                    const session::Session& session, PipelineNotes& notes) {
  RigLightsOptions rig;
  rig.rig = options.rig;
  rig.session = options.input;
  rig.region = options.sheet.region;
  rig.sheet_mm = options.sheet.thickness_mm;
  rig.bow_mm = options.sheet.bow_mm;
  rig.lobe = options.sheet.lobe;
  rig.page = options.sheet.page;
  rig.settings = options.settings;
  rig.settings.tell = [&notes](const PipelineNote& note) { notes.add(note.kind, note.text); };
  if (!options.rig.empty()) {
    return calibrate_rig_lights(rig);
  }
  RigLightsSummary summary;
  summary.rig = *session.rig();
  summary.faces = fit_rig_faces(session, summary.rig, rig);
  add_face_notes(summary.rig, summary.faces, notes);
  return summary;
}

}  // namespace

FoundLights find_by_rig(const CalibratePipelineOptions& options,
                        const session::Session& session, RigLightsSummary& summary,
                        PipelineNotes& notes) {
  summary = calibrate_faces_of(options, session, notes);
  FoundLights found;
  found.frame =
      "positions: mm, the rig's world; directions: from the object's centre, x right, y up, z "
      "to "
      "the camera";
  found.has_powers = true;
  found.is_good = summary.faces.is_good;
  const Eigen::Isometry3d& world_from_sheet = summary.faces.sheet.world_from_sheet;
  const std::vector<LightElement> elements = light_elements(*session.rig());
  const Eigen::Matrix3d turn = pixel_points(session, 0.0).picture_from_world();
  std::size_t k = 0;
  for (const FaceCalibration& face : summary.faces.faces) {
    for (CalibratedLight light : face.lights.lights) {
      light.light.position_mm = world_from_sheet * light.light.position_mm;
      light.light.axis = world_from_sheet.linear() * light.light.axis;
      light.sigma.position_mm2 = world_from_sheet.linear() * light.sigma.position_mm2 *
                                 world_from_sheet.linear().transpose();
      const LightElement& element = elements[k++];
      found.lights.push_back(found_light(
          light,
          fmt::format("{}/{}/{}", session.rig()->faces[static_cast<std::size_t>(face.face)].id,
                      element.row, element.col),
          face.lights.test.is_passed()));
      FoundLight& last = found.lights.back();
      if (last.is_seen()) {
        const Vector3d away = light.light.position_mm - session.rig()->object_centre;
        last.direction = turn * away.normalized();
        if (last.sigma_deg) {
          last.sigma_deg = direction_sigma_deg(away, light.sigma.position_mm2);
        }
      }
    }
  }
  return found;
}

}  // namespace haarlight::relight
