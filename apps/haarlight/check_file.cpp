// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/check_file.h"

#include <fmt/format.h>

#include "apps/haarlight/options/lighting_reader.h"
#include "core/counted.h"
#include "core/rig/measured_rig.h"
#include "core/text_limits.h"
#include "haarlight/capture/plan/plan.h"
#include "haarlight/core/files.h"
#include "haarlight/core/stack/light_stack.h"
#include "haarlight/firmware_iface/controller_profile.h"
#include "haarlight/render/light/cubemap.h"
#include "haarlight/render/light/rig_lights.h"
#include "haarlight/render/scene/scene.h"
#include "relight/basis/basis_check.h"
#include "render/light/environment_light.h"
#include "render/scene/camera_table.h"
#include "render/scene/texture_files.h"
#include "render/volume/volume_ray_caster.h"
#include "sim/fault_script.h"

namespace haarlight::apps {

namespace {

std::string describe(const Rig& rig) {
  return fmt::format("{} on {}, {}, {}", counted(rig.n_lights(), "light"),
                     counted(rig.faces.size(), "face"), counted(rig.planes.size(), "plane"),
                     counted(rig.cameras.size(), "camera"));
}

/// Alone a plan is held to the ranges of its keys; after a rig also to its lights and power.
std::string check_plan(const std::string& file, FileKind kind, const std::optional<Rig>& rig) {
  if (rig) {
    const capture::Plan plan = capture::load_plan(file, *rig, read_lighting);
    return fmt::format("{}, fits the rig \"{}\"", counted(plan.shots.size(), "shot"),
                       rig->name);
  }
  if (kind == FileKind::shot_list) {
    const capture::Plan plan =
        capture::plan_from_json(read_file(file, std::uintmax_t{1} << 30U), file);
    return fmt::format("{} for {}", counted(plan.shots.size(), "shot"),
                       counted(plan.n_lights, "light"));
  }
  const capture::PlanSettings settings = capture::read_plan_file(file);
  return fmt::format("patterns {}, order {}; name the rig first to hold it to its lights",
                     to_string(settings.patterns), to_string(settings.order));
}

std::string check_scene(const std::string& path, std::uint64_t memory_bytes) {
  render::SceneFile file = render::read_scene(path);
  const std::size_t n_textures = render::load_textures(file.scene, memory_bytes).n_pictures;
  const render::Scene& scene = file.scene;
  std::size_t n_triangles = 0;
  for (const render::Mesh& mesh : scene.meshes) {
    n_triangles += mesh.triangles.size();
  }
  std::string words =
      counted(scene.meshes.size(), "mesh", "meshes") + ", " + counted(n_triangles, "triangle");
  const auto add = [&words](std::size_t n, std::string_view what) {
    words += n > 0 ? ", " + counted(n, what) : "";
  };
  add(scene.spheres.size(), "exact sphere");
  add(scene.disks.size(), "disk");
  add(scene.instances.size(), "instance");
  words += ", " + counted(scene.materials.size(), "material");
  add(n_textures, "texture");
  add(scene.point_lights.size() + scene.directional_lights.size(), "light");
  words += render::read_environment(scene) ? ", an environment" : "";
  return words + (file.has_camera ? ", a camera" : ", no camera");
}

std::string described(const render::ScalarField& field) {
  return fmt::format("'{}' on {}", field.name, field.is_per_cell ? "cells" : "points");
}

/// With its mesh, as far as a picture of it comes before its first ray.
std::string check_volume(const std::string& path, std::uint64_t memory_bytes) {
  const render::VolumeScene scene = render::read_volume_scene(path);
  require_sizes(scene);
  const std::uint64_t bytes = render::VolumeRayCaster::bytes_needed(scene);
  if (bytes > memory_bytes) {
    constexpr std::uint64_t kMega = 1'000'000;
    throw Error(fmt::format("{} cells need {} MB; --memory allows {}", scene.mesh.n_cells(),
                            bytes / kMega, memory_bytes / kMega),
                path, "give more --memory", ExitCode::usage);
  }
  const render::VolumeRayCaster caster(scene, {});
  return fmt::format("{}, extinction of {}, colour of {}, a camera",
                     counted(scene.mesh.n_cells(), "cell"), described(scene.density_field),
                     described(scene.colour_field));
}

}  // namespace

std::string check_file(const std::string& file, FileKind kind, std::optional<Rig>& rig,
                       std::uint64_t memory_bytes) {
  switch (kind) {
    case FileKind::rig:
      rig = read_rig(file);
      firmware_iface::require_profile(*rig);
      return describe(*rig) + render::require_lit_planes(*rig);
    case FileKind::measured: {
      const MeasuredRig measured = parse_measured(read_file(file, kMaxTomlBytes), file);
      const MeasuredGap gap = find_gap(measured);
      return fmt::format("of {}; name its rig to hold it to that{}", measured.date,
                         gap.problem.empty() ? ""
                                             : fmt::format("\n  warning: {}\n  hint: {}",
                                                           gap.problem, gap.hint));
    }
    case FileKind::profile: {
      const firmware_iface::ControllerProfile profile =
          firmware_iface::read_controller_profile(file);
      return fmt::format("{}, {}", profile.name, counted(profile.channels, "channel"));
    }
    case FileKind::plan:
    case FileKind::shot_list:
      return check_plan(file, kind, rig);
    case FileKind::scene:
      return check_scene(file, memory_bytes);
    case FileKind::volume:
      return check_volume(file, memory_bytes);
    case FileKind::cameras:
      return counted(render::read_cameras(file).size(), "camera");
    case FileKind::faults: {
      const sim::FaultScript script = sim::read_fault_script(file);
      return fmt::format("{} of the bus, {}", counted(script.bus.size(), "fault"),
                         counted(script.restarts.size(), "restart"));
    }
    case FileKind::environment: {
      const render::Environment environment = render::Environment::read(file);
      return fmt::format("{}, {} of {}, {}", to_string(environment.layout()),
                         counted(environment.n_rows(), "row"),
                         counted(environment.row_texels(), "texel"),
                         environment.is_colour() ? "colour" : "grey");
    }
    case FileKind::basis: {
      const relight::BasisFile basis = relight::BasisFile::open(file);
      relight::check_basis(basis);
      const StackDims& dims = basis.header().dims;
      return fmt::format("{} x {} pixels, {}, relative error {:.3g}", dims.width, dims.height,
                         counted(dims.n_lights, "light"), basis.header().achieved.relative_l2);
    }
    case FileKind::stack: {
      const LightStack stack = LightStack::open(file);
      stack.check();
      const StackDims dims = stack.dims();
      return fmt::format("{} x {} pixels, {}, {}", dims.width, dims.height,
                         counted(dims.channels, "channel"), counted(dims.n_lights, "light"));
    }
  }
  throw_contract_violation("FileKind", "a known kind", __FILE__, __LINE__);
}

}  // namespace haarlight::apps
