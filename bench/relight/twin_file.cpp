// SPDX-License-Identifier: Apache-2.0
/// @file
/// The twin's stack as an exact basis file, rig inside: what commands that read captures are
/// measured on. relight_twin_file --scene SCENE.toml -o FILE.hlb

#include <regex>

#include <fmt/format.h>

#include "apps/command_line.h"
#include "apps/run_program.h"
#include "core/report.h"
#include "haarlight/core/error.h"
#include "haarlight/relight/basis/compress.h"

#include "bench/relight/twin.h"

namespace haarlight {
namespace {

/// The rig file's text with the twin's camera in it, so that the file speaks for itself.
std::string twin_rig_text(const Rig& rig) {
  const CameraSpec& spec = rig.cameras.front();
  const CameraModel& camera = spec.model;
  const int metadata_rows = spec.frame_height - spec.active_rows;
  std::string text = rig.text;
  const auto put = [&](const char* key, const std::string& value) {
    text = std::regex_replace(text, std::regex(fmt::format("(^|\\n){} = [^\\n]*", key)),
                              fmt::format("$1{} = {}", key, value));
  };
  put("size", fmt::format("[{}, {}]", camera.width, camera.height + metadata_rows));
  put("active_area", fmt::format("{}", camera.height));
  put("K",
      fmt::format("[[{0:.17g}, 0.0, {1:.17g}], [0.0, {2:.17g}, {3:.17g}], [0.0, 0.0, 1.0]]",
                  camera.fx, camera.cx, camera.fy, camera.cy));
  return text;
}

int run(int argc, char** argv) {
  std::string rig_file = "configs/rigs/cube32.toml";
  std::string scene_file;
  std::string output;
  apps::CommandLine line("relight_twin_file", "the twin's stack as an exact basis file",
                         std::string(kVersion));
  line.root().option("--rig", &rig_file, "Rig file", {.shows_default = true});
  line.root().option("--scene", &scene_file, "Scene", {.is_required = true});
  line.root().option("-o,--output", &output, "Basis file to write", {.is_required = true});
  if (const auto end = line.parse(argc, argv)) {
    return static_cast<int>(*end);
  }
  const bench::TwinStack made = bench::render_twin(rig_file, scene_file);
  relight::CompressSource source;
  source.stack = &made.stack;
  source.grid = {made.twin.rig.faces.front().rows, made.twin.rig.faces.front().cols};
  source.rig_toml = twin_rig_text(made.twin.rig);
  source.name = scene_file;
  const relight::CompressSummary summary =
      relight::compress_stack(source, output, {.relative_l2 = 0.0});
  fmt::print("{}: {} bytes\n", output, summary.bytes);
  return 0;
}

}  // namespace
}  // namespace haarlight

int main(int argc, char** argv) {
  return haarlight::apps::run_program("relight_twin_file", haarlight::run, argc, argv);
}
