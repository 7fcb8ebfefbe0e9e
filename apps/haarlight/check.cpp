// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight check FILE...`: reads hand-written and other input files and reports every
/// problem.

#include <optional>

#include <fmt/format.h>

#include "apps/haarlight/file_kind.h"
#include "apps/haarlight/lighting_reader.h"
#include "apps/haarlight/verb.h"
#include "capture/plan/plan.h"
#include "core/files.h"
#include "core/rig/measured_rig.h"
#include "core/rig/rig.h"
#include "core/text_limits.h"
#include "firmware_iface/controller_profile.h"
#include "relight/basis/basis_check.h"
#include "render/light/cubemap.h"
#include "render/rig_lights.h"
#include "render/scene.h"
#include "sim/fault_script.h"

namespace haarlight {

namespace {

struct CheckArguments {
  std::vector<std::string> files;
  std::string kind = "by content";
};

std::string describe(const Rig& rig) {
  return fmt::format("{} lights on {} faces, {} planes, {} cameras", rig.n_lights(),
                     rig.faces.size(), rig.planes.size(), rig.cameras.size());
}

/// Planes that no light reaches are an error; where some lights do not, words for a warning.
std::string check_planes(const Rig& rig) {
  std::string warnings;
  for (const ShadowPlane& plane : rig.planes) {
    const std::vector<int> off = lights_off_plane(rig, plane);
    if (off.empty()) {
      continue;
    }
    const auto n_off = static_cast<int>(off.size());
    if (n_off == rig.n_lights()) {
      throw Error(fmt::format("no light reaches the plane \"{}\": all lie in or behind it, or "
                              "shine away from it",
                              plane.id),
                  rig.file.string(),
                  "correct centre and emits of the faces, or n and d of the plane");
    }
    warnings += fmt::format(
        "\n  warning: {} of {} lights (the first: {}) do not reach the plane \"{}\": they lie "
        "in or behind it, or shine away from it\n  cure: nothing, if that is meant; else "
        "correct centre and emits of their face",
        n_off, rig.n_lights(), off.front(), plane.id);
  }
  return warnings;
}

/// The profile that the rig's controller needs, read as the daemon will.
void check_profile(const Rig& rig) {
  if (rig.controller.profile == "haarlight") {
    return;
  }
  const std::filesystem::path file = find_controller_profile(rig.controller.profile, rig.file);
  if (file.empty()) {
    throw Error(fmt::format("controller profile \"{}\": no such file", rig.controller.profile),
                rig.file.string(),
                "put it beside the rig file or in profiles/, or correct profile =");
  }
  const ControllerProfile profile = read_controller_profile(file);
  if (rig.n_lights() > profile.channels) {
    throw Error(fmt::format("{} lights, but a {} has {} channels", rig.n_lights(), profile.name,
                            profile.channels),
                rig.file.string(), "correct the faces, or choose another profile");
  }
}

/// Alone a plan is held to the ranges of its keys; after a rig also to its lights and power.
std::string check_plan(const std::string& file, FileKind kind, const std::optional<Rig>& rig) {
  if (rig) {
    const Plan plan = load_plan(file, *rig, read_lighting);
    return fmt::format("{} shots, fits the rig \"{}\"", plan.shots.size(), rig->name);
  }
  if (kind == FileKind::shot_list) {
    const Plan plan = plan_from_json(read_file(file, std::uintmax_t{1} << 30U), file);
    return fmt::format("{} shots for {} lights", plan.shots.size(), plan.n_lights);
  }
  const PlanSettings settings = read_plan_file(file);
  return fmt::format("patterns {}, order {}; name the rig first to hold it to its lights",
                     to_string(settings.patterns), to_string(settings.order));
}

std::string describe(const SceneFile& file) {
  std::size_t n_triangles = 0;
  for (const Mesh& mesh : file.scene.meshes) {
    n_triangles += mesh.triangles.size();
  }
  return fmt::format("{} meshes, {} triangles, {} materials, {}", file.scene.meshes.size(),
                     n_triangles, file.scene.materials.size(),
                     file.has_camera ? "a camera" : "no camera");
}

/// Reads one file as the programs read it. @param rig  the last good rig; set by a rig file
/// @return  what is in it
std::string check_file(const std::string& file, FileKind kind, std::optional<Rig>& rig) {
  switch (kind) {
    case FileKind::rig:
      rig = read_rig(file);
      check_profile(*rig);
      return describe(*rig) + check_planes(*rig);
    case FileKind::measured: {
      const MeasuredRig measured = parse_measured(read_file(file, kMaxTomlBytes), file);
      const MeasuredGap gap = find_gap(measured);
      return fmt::format("of {}; name its rig to hold it to that{}", measured.date,
                         gap.problem.empty() ? ""
                                             : fmt::format("\n  warning: {}\n  cure: {}",
                                                           gap.problem, gap.cure));
    }
    case FileKind::profile: {
      const ControllerProfile profile = read_controller_profile(file);
      return fmt::format("{}, {} channels", profile.name, profile.channels);
    }
    case FileKind::plan:
    case FileKind::shot_list:
      return check_plan(file, kind, rig);
    case FileKind::scene:
      return describe(read_scene(file));
    case FileKind::faults: {
      const FaultScript script = read_fault_script(file);
      return fmt::format("{} faults of the bus, {} restarts", script.bus.size(),
                         script.restarts.size());
    }
    case FileKind::environment: {
      const Environment environment = Environment::read(file);
      return fmt::format("{}, {} rows of {} texels, {}", to_string(environment.layout()),
                         environment.n_rows(), environment.row_texels(),
                         environment.is_colour() ? "colour" : "grey");
    }
    case FileKind::basis: {
      const BasisFile basis = BasisFile::open(file);
      check_basis(basis);
      const StackDims& dims = basis.header().dims;
      return fmt::format("{} x {} pixels, {} lights, relative error {:.3g}", dims.width,
                         dims.height, dims.n_lights, basis.header().reached.relative_l2);
    }
  }
  throw_contract_violation("FileKind", "a known kind", __FILE__, __LINE__);
}

ExitCode run_check(const CheckArguments& arguments, Report& report) {
  std::optional<FileKind> asked;
  if (arguments.kind != "by content") {
    asked = file_kind_from_word(arguments.kind);
  }
  report.add_asked("as", arguments.kind);
  std::optional<Rig> rig;
  std::int64_t n_bad = 0;
  for (const std::string& file : arguments.files) {
    report.add_input(file);
    try {
      const FileKind kind = asked ? *asked : recognise_file(file);
      const std::string what = check_file(file, kind, rig);
      fmt::print("{}: a good {}: {}\n", file, to_string(kind), what);
      report.add_detail(file, std::string(to_string(kind)));
    } catch (const Error& error) {
      ++n_bad;
      fmt::print(stderr, "haarlight check: {}\n", error.what());
      report.add_detail(file, std::string(error.what()));
    }
  }
  if (rig) {
    report.add_reached("lights", std::int64_t{rig->n_lights()});
  }
  report.add_reached("good_files", static_cast<std::int64_t>(arguments.files.size()) - n_bad);
  report.add_reached("bad_files", n_bad);
  return n_bad == 0 ? ExitCode::done : ExitCode::bad_input;
}

}  // namespace

void add_check(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<CheckArguments>();
  Command verb = root.add_verb("check", "Check input files and list every problem in them");
  verb.option("FILE", &arguments->files,
              "Rig, measured values, controller profile, plan, plan.json, scene, fault script, "
              "environment, basis file",
              {.type = "FILE...", .is_required = true});
  verb.option("--as", &arguments->kind, "Take them for this kind of file",
              {.type = "rig|measured|profile|plan|shot-list|scene|faults|environment|basis",
               .shows_default = true});
  verb.footer(
      "A plan that stands after a rig is held to that rig's lights and power, too. A rig is "
      "read\n"
      "with its measured values and its controller's profile, a basis file whole.\n"
      "Exit code 65 when a file is bad; the others are checked all the same.\n"
      "Examples:\n"
      "  haarlight check configs/rigs/cube32.toml configs/plans/one_at_a_time.toml\n"
      "  haarlight check configs/scenes/stairs.toml configs/environments/room.hdr");
  finish_verb(verb, invocation, [arguments](const CommonOptions&, Report& report) {
    return run_check(*arguments, report);
  });
}

}  // namespace haarlight
