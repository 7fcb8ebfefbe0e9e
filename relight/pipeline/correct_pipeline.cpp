// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/correct_pipeline.h"

#include <algorithm>
#include <string>
#include <vector>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/progress.h"
#include "haarlight/relight/light/near_light.h"
#include "haarlight/session/develop/develop.h"
#include "haarlight/session/light_file.h"
#include "relight/pipeline/picture_notes.h"
#include "relight/pipeline/session_stack.h"

namespace haarlight::relight {

namespace fs = std::filesystem;

CorrectSummary correct_fall_off(const CorrectOptions& options) {
  require_absent(options.out, options.settings.overwrites);
  const session::Session session = session::Session::open(options.session);
  const CaptureLights lights = capture_lights(session);
  if (!lights.are_near) {
    throw Error("only the lights' directions are known: fall-off needs their positions",
                options.session.string(),
                "import the capture with positions (--places positions)");
  }
  const PixelPoints pixels =
      pixel_points(session, options.width_mm, options.height_mm.value_or(0.0));
  const LightStack stack =
      session::develop(session, develop_options(session, options.settings, options.transfer));
  const StackDims shape = stack.dims();
  const LightCorrection correction(lights.near, pixels, shape.width, shape.height,
                                   pixels.plane_normal(), options.fall_off);
  const fs::path& folder = options.out;
  fs::create_directories(folder / "fall-off");
  std::vector<std::string> names;
  const std::vector<Eigen::Vector3d> directions = picture_directions(session);
  CorrectSummary summary;
  summary.n_lights = shape.n_lights;
  Progress progress("correct", static_cast<std::size_t>(shape.n_lights),
                    options.settings.progress);
  const std::uint64_t memory = options.settings.memory_bytes / 2;
  for_each_light_image(stack, memory, [&](int k, const Image<float>& picture) {
    const std::string name = fmt::format("light_{:04}.exr", k);
    const Image<float> map = correction.attenuation(k);
    for (const float value : map.pixels()) {
      summary.least_fall_off = std::min(summary.least_fall_off, double{value});
    }
    PictureNotes notes = notes_of(session.info());
    add_light(session.info(), k, notes);
    write_image(folder / "fall-off" / name, map.view(), 1.0, notes);
    add_direction(directions[static_cast<std::size_t>(k)], notes);  // far, once corrected
    write_image(folder / name, correction.corrected(picture.view(), k).view(), 1.0, notes);
    summary.bytes += fs::file_size(folder / name) + fs::file_size(folder / "fall-off" / name);
    names.push_back(name);
    progress.advance();
  });
  write_file_atomically(folder / "lights.lp", session::format_lp(directions, names));
  return summary;
}

}  // namespace haarlight::relight
