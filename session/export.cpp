// SPDX-License-Identifier: Apache-2.0
#include "haarlight/session/export.h"

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "session/transforms_file.h"

namespace haarlight::session {

namespace {

void require_position(const Session& session, const std::vector<SessionLight>& lights) {
  for (std::size_t k = 0; k < lights.size(); ++k) {
    if (lights[k].coordinates.norm() < 1e-9) {
      throw Error(fmt::format("light {} ({}) sits in the object's centre", k, lights[k].name),
                  (session.folder() / "session.json").string(),
                  "correct object_centre in the rig file");
    }
  }
}

}  // namespace

std::vector<SessionLight> lights_from_object(const Session& session) {
  std::vector<SessionLight> lights = session.info().lights;
  if (lights.empty()) {
    throw Error("a session without lights", session.folder().string(),
                "capture or import it again");
  }
  if (session.rig()) {
    for (SessionLight& light : lights) {
      if (light.is_position) {
        light.coordinates -= session.rig()->object_centre;
      }
    }
  }
  require_position(session, lights);
  return lights;
}

std::vector<std::string> picture_of_each_light(const Session& session,
                                               const std::filesystem::path& folder) {
  const SessionInfo& info = session.info();
  std::vector<std::string> pictures(info.lights.size());
  const std::filesystem::path from =
      std::filesystem::absolute(folder.empty() ? "." : folder).lexically_normal();
  const std::filesystem::path base = std::filesystem::absolute(session.folder());
  for (const FrameRecord& frame : info.frames) {
    const Shot& shot = info.shots[static_cast<std::size_t>(frame.shot)];
    if (shot.kind != ShotKind::light || shot.lit.size() != 1) {
      continue;
    }
    const auto k = static_cast<std::size_t>(shot.lit[0].light);
    if (!pictures[k].empty()) {
      throw Error(fmt::format("light {} ({}) has several frames: exposures or repeats", k,
                              info.lights[k].name),
                  (session.folder() / "session.json").string(),
                  "give --exr DIR or --png DIR: they are then merged to one picture per light");
    }
    pictures[k] =
        (base / frame.file).lexically_normal().lexically_relative(from).generic_string();
  }
  for (std::size_t k = 0; k < pictures.size(); ++k) {
    if (pictures[k].empty()) {
      throw Error(fmt::format("light {} ({}) has no frame of its own", k, info.lights[k].name),
                  (session.folder() / "session.json").string(),
                  "give --exr DIR or --png DIR: pictures of single lights are then developed");
    }
  }
  return pictures;
}

std::string export_lp(const Session& session, const std::vector<std::string>& pictures) {
  std::vector<Eigen::Vector3d> directions;
  for (const SessionLight& light : lights_from_object(session)) {
    directions.push_back(light.coordinates.normalized());
  }
  return format_lp(directions, pictures);
}

std::string export_dome(const Session& session, ExportedPictures pictures) {
  std::vector<SessionLight> lights = lights_from_object(session);
  if (pictures == ExportedPictures::developed) {
    for (SessionLight& light : lights) {
      light.relative_power = 1.0;
    }
  }
  return format_dome(lights, {session.info().id, "exported by haarlight; lengths in mm", 0.0});
}

std::string export_transforms(const Session& session,
                              const std::vector<std::string>& pictures) {
  const SessionInfo& info = session.info();
  const Rig* rig = session.rig() ? &*session.rig() : nullptr;
  if (rig == nullptr || rig->cameras.empty() ||
      rig->cameras.front().model.width != info.form.width ||
      rig->cameras.front().model.height != info.form.height) {
    throw Error("the camera's pose and lens are not known: no rig file",
                session.folder().string(), "give --lp or --dome, which need none");
  }
  return format_transforms(rig->cameras.front().model, rig->object_centre, info.lights,
                           pictures);
}

std::string find_lp_problem(const std::vector<std::string>& pictures) {
  constexpr std::size_t kRelightLimit = 1000;
  for (const std::string& picture : pictures) {
    if (picture.find_first_of(" \t") != std::string::npos) {
      return fmt::format("\"{}\" has a blank in its name: most readers of .lp split there",
                         picture);
    }
  }
  if (pictures.size() > kRelightLimit) {
    return fmt::format("{} lights: Relight reads at most {} from a .lp; give it --dome",
                       pictures.size(), kRelightLimit);
  }
  return {};
}

}  // namespace haarlight::session
