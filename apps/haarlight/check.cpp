// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight check FILE...`: reads hand-written and other input files and reports every
/// problem.

#include <optional>

#include <fmt/format.h>

#include "apps/haarlight/check_file.h"
#include "apps/haarlight/verb.h"

namespace haarlight::apps {

namespace {

constexpr const char* kByContent = "by content";

struct CheckArguments {
  std::vector<std::string> files;
  std::string kind = kByContent;
};

ExitCode run_check(const CheckArguments& arguments, const CommonOptions& common,
                   Report& report) {
  std::optional<FileKind> requested;
  if (arguments.kind != kByContent) {
    requested = file_kind_from_word(arguments.kind);
  }
  report.add_requested("as", arguments.kind);
  std::optional<Rig> rig;
  std::int64_t n_bad = 0;
  for (const std::string& file : arguments.files) {
    report.add_input(file);
    try {
      const FileKind kind = requested ? *requested : recognise_file(file);
      const std::string what = check_file(file, kind, rig, common.memory_bytes);
      fmt::print("{}: a good {}: {}\n", file, to_string(kind), what);
      report.add_detail(file, std::string(to_string(kind)));
    } catch (const Error& error) {
      ++n_bad;
      fmt::print(stderr, "haarlight check: {}\n", error.what());
      report.add_detail(file, std::string(error.what()));
    }
  }
  if (rig) {
    report.add_achieved("lights", std::int64_t{rig->n_lights()});
  }
  report.add_achieved("good_files", static_cast<std::int64_t>(arguments.files.size()) - n_bad);
  report.add_achieved("bad_files", n_bad);
  return n_bad == 0 ? ExitCode::done : ExitCode::bad_input;
}

}  // namespace

void add_check(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<CheckArguments>();
  Command verb = root.add_verb("check", "Check input files and list every problem in them");
  verb.option(
      "FILE", &arguments->files,
      "Rig, measured values, controller profile, plan, plan.json, scene, volume's scene, "
      "fault script, file of cameras, environment, basis file, light stack",
      {.type = "FILE...", .is_required = true});
  verb.option("--as", &arguments->kind,
              "Take them for a rig, measured, profile, plan, shot-list, scene, volume, faults, "
              "cameras, environment, basis or stack",
              {.type = "KIND", .shows_default = true});
  verb.footer(
      "A plan that stands after a rig is held to that rig's lights and power, too. A\n"
      "rig is read with its measured values and its controller's profile, a scene with\n"
      "its meshes and textures, a volume's scene with its mesh, a basis file and a light\n"
      "stack whole.\n"
      "Exit code 65 when a file is bad; the others are checked all the same.\n"
      "Examples:\n"
      "  haarlight check configs/rigs/cube32.toml configs/plans/one_at_a_time.toml\n"
      "  haarlight check configs/scenes/stairs.toml configs/environments/room.hdr\n"
      "  haarlight check configs/volumes/cube.toml");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_check(*arguments, common, report);
  });
}

}  // namespace haarlight::apps
