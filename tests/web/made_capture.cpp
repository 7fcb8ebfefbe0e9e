// SPDX-License-Identifier: Apache-2.0
/// @file
/// Writes a basis file of a scene over the first plane of a rig, rendered without noise: a capture
/// whose shadows carve a hull, for the viewer's tests. made_capture --help

#include <string>

#include "apps/command_line.h"
#include "apps/run_program.h"
#include "haarlight/core/files.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/render/scene/scene.h"
#include "tests/relight/pipeline/rendered_capture.h"

namespace haarlight {

namespace {

int run(int argc, char** argv) {
  apps::CommandLine line("made_capture", "made_capture: a basis file of a rendered scene", "");
  apps::Command program = line.root();
  std::string output;
  std::string rig_file;
  std::string scene;
  program.option("OUT", &output, "File to write", {.is_required = true});
  program.option("RIG", &rig_file, "Rig of one face", {.is_required = true});
  program.option("SCENE", &scene, "Scene file of the object, without the plane",
                 {.is_required = true});
  if (const std::optional<ExitCode> end = line.parse(argc, argv)) {
    return static_cast<int>(*end);
  }
  const Rig rig = read_rig_as_written(rig_file);
  testing::store_capture(output, rig.text,
                         testing::render_capture(rig.text, render::read_scene(scene).scene),
                         {rig.faces.front().rows, rig.faces.front().cols});
  return 0;
}

}  // namespace

}  // namespace haarlight

int main(int argc, char** argv) {
  return haarlight::apps::run_program("made_capture", haarlight::run, argc, argv);
}
