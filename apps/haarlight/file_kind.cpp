// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/file_kind.h"

#include <algorithm>
#include <string>
#include <vector>

#include <fmt/format.h>

#include "core/config_table.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/render/scene/scene_io.h"

namespace haarlight::apps {

namespace {

namespace fs = std::filesystem;

constexpr std::size_t kHead = 4096;  // bytes in which a file says what it is

struct KindKeys {
  FileKind kind;
  std::vector<std::string_view> keys;  ///< at the top level, and of few other kinds
};

const std::vector<KindKeys>& kinds_of_toml() {
  static const std::vector<KindKeys> kKinds{
      {FileKind::rig,
       {"face", "plane", "controller", "sync", "storage", "http", "object_centre"}},
      {FileKind::measured, {"measured"}},
      {FileKind::profile,
       {"source", "channels", "channel", "connect", "before", "latch", "identity"}},
      {FileKind::plan,
       {"patterns", "pattern", "order", "level", "lights", "bin", "exposures_us", "repeats",
        "darks_every", "darks_every_c", "sentinel_every", "sentinel_light", "reserve_mb",
        "environment", "wavelets"}},
      {FileKind::scene,
       {"material", "mesh", "instance", "sphere", "box", "quad", "disk", "film"}},
      {FileKind::volume, {"mesh", "density", "colour", "contour", "background"}},
      {FileKind::faults, {"frames", "bus", "restart"}},
      {FileKind::cameras, {"camera"}},  // last: rigs, scenes and volumes have cameras, too
  };
  return kKinds;
}

FileKind recognise_toml(const fs::path& path) {
  const ConfigTable root = ConfigTable::parse_file(path);
  FileKind best = FileKind::rig;
  std::ptrdiff_t most = 0;
  for (const KindKeys& candidate : kinds_of_toml()) {
    const auto n = std::count_if(candidate.keys.begin(), candidate.keys.end(),
                                 [&](std::string_view key) { return root.has(key); });
    if (n > most) {
      most = n;
      best = candidate.kind;
    }
  }
  if (most == 0) {
    throw Error(
        "its keys are those of no kind of file", path.string(),
        "a rig has [[face]], a profile [channel], a plan patterns = ..., a scene "
        "[[mesh]] or [[box]], a volume [density], a fault "
        "script [frames] or [[bus]], a file of cameras [[camera]]; say which with --as");
  }
  return best;
}

}  // namespace

FileKind file_kind_from_word(std::string_view word) {
  if (const auto kind = value_of<FileKind>(word)) {
    return *kind;
  }
  throw Error(fmt::format("\"{}\" is no kind of file", word), "--as",
              fmt::format("write one of {}", fmt::join(all_words<FileKind>(), ", ")),
              ExitCode::usage);
}

FileKind recognise_file(const fs::path& path) {
  if (fs::is_directory(path)) {
    if (fs::exists(path / "session.json") || fs::exists(path / "journal.sqlite")) {
      throw Error("this is a session", path.string(),
                  fmt::format("haarlight verify {}", path.string()));
    }
    return FileKind::environment;  // six faces
  }
  if (render::is_gltf(path)) {
    return FileKind::scene;
  }
  const std::string head = read_head(path, kHead);
  if (head.starts_with("\x89HLB")) {
    return FileKind::basis;
  }
  if (head.starts_with("HLSTACK")) {
    return FileKind::stack;
  }
  if (head.find('\0') != std::string::npos || head.starts_with("#?")) {  // "#?": Radiance
    return FileKind::environment;
  }
  const std::size_t first = head.find_first_not_of(" \t\r\n");
  if (first != std::string::npos && head[first] == '{') {
    return FileKind::shot_list;
  }
  return recognise_toml(path);
}

}  // namespace haarlight::apps
