// SPDX-License-Identifier: Apache-2.0
#include "session/rig_session.h"

#include <algorithm>

#include <fmt/format.h>

#include "core/rig/pixel_format.h"
#include "session/clip_level.h"

namespace haarlight::session {

FrameForm frame_form_of(const Rig& rig) {
  const CameraSpec& camera = rig.cameras.front();
  return {.width = camera.frame_width,
          .height = camera.active_rows,
          .stored_height = camera.frame_height,
          .channels = 1,
          .sample = SampleType::u16,
          .transfer =
              pixel_use(camera) == PixelUse::measurement ? Transfer::linear : Transfer::unknown,
          .bayer = camera.bayer,
          .black_level = camera.noise.black_dn,
          .white_level = static_cast<double>((1U << static_cast<unsigned>(camera.bits)) - 1U),
          .clip_level = clip_level(camera)};
}

void describe_rig(const Rig& rig, SessionInfo& info) {
  info.form = frame_form_of(rig);
  for (const LightElement& light : light_elements(rig)) {
    SessionLight entry;
    entry.name = fmt::format("{}/{}/{}", rig.faces[static_cast<std::size_t>(light.face)].id,
                             light.row, light.col);
    entry.is_position = true;
    entry.coordinates = light.centre;
    info.lights.push_back(std::move(entry));
  }
  const Face& first = rig.faces.front();
  const bool is_grid = std::all_of(rig.faces.begin(), rig.faces.end(), [&](const Face& face) {
    return face.rows == first.rows && face.cols == first.cols;
  });
  info.grid_rows = is_grid ? first.rows : 0;
  info.grid_cols = is_grid ? first.cols : 0;
}

}  // namespace haarlight::session
