// SPDX-License-Identifier: Apache-2.0
#include "relight/hull/shadow_hull.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>

#include "core/counted.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "relight/hull/enclosed.h"
#include "relight/hull/kept_pictures.h"

namespace haarlight::relight {

namespace {

constexpr std::int64_t kCoarseVoxels = std::int64_t{1} << 18U;
constexpr std::uint64_t kBytesPerVoxel = 12;  // evidence, counts, states, distances, chances
constexpr double kBelowLights = 0.98;         // of the highest; above, shadows have no end

/// Where the object may be: over the plane's picture, up to the lights or as high as is known.
PlaneBox widest_box(const PlaneFrame& frame, std::span<const render::SquareLight> lights,
                    double side, const std::optional<double>& highest_mm) {
  double top = 0.0;
  for (const render::SquareLight& light : lights) {
    top = std::max(top, side * frame.height_of(light.centre));
  }
  if (!(top > 0.0)) {
    throw Error("no light shines on the shadow plane", "rig",
                "check the plane in the rig file");
  }
  top *= kBelowLights;
  if (highest_mm) {
    top = std::min(top, *highest_mm);
  }
  if (!(top > 0.0)) {
    throw Error("there is no room for an object between the plane and its highest point",
                "--object-height", "give heights over the plane, in mm");
  }
  PlaneBox box;
  box.low = {frame.x0_mm, frame.y0_mm - frame.height * frame.texel_mm, 0.0};
  box.high = {frame.x0_mm + frame.width * frame.texel_mm, frame.y0_mm, top};
  return box;
}

double voxel_for(const PlaneBox& box, std::int64_t n_voxels) {
  const Eigen::Vector3d extent = box.high - box.low;
  return std::cbrt(extent.prod() / static_cast<double>(n_voxels));
}

void require_memory(const VoxelGrid& grid, double usual_mm, std::uint64_t memory_bytes) {
  if (grid.size() > memory_bytes / kBytesPerVoxel) {
    throw Error(
        fmt::format("voxels of {:g} mm are {} x {} x {}: {:.0f} MiB of memory", grid.voxel_mm,
                    grid.nx, grid.ny, grid.nz,
                    static_cast<double>(grid.size()) * kBytesPerVoxel * 0x1p-20),
        "--voxel",
        fmt::format("take larger ones ({:.2g} mm is usual here), give --object-height, or "
                    "more --memory",
                    usual_mm),
        ExitCode::usage);
  }
}

/// Whether a camera sees the object, or nothing it knows, where the voxel is.
bool is_in_silhouette(const CarvingView& view, const Eigen::Vector3d& world) {
  const auto at = project(view.camera, world);
  return at && at->x() >= 0.0 && at->y() >= 0.0 && at->x() < view.shows_plane.width() &&
         at->y() < view.shows_plane.height() &&
         view.shows_plane(static_cast<int>(at->y()), static_cast<int>(at->x())) == 0;
}

/// Whether the picture's border cuts the object.
bool is_cut(const CarvingView& view) {
  const Image<std::uint8_t>& shows = view.shows_object;
  for (int x = 0; x < shows.width(); ++x) {
    if (shows(0, x) != 0 || shows(shows.height() - 1, x) != 0) {
      return true;
    }
  }
  for (int y = 0; y < shows.height(); ++y) {
    if (shows(y, 0) != 0 || shows(y, shows.width() - 1) != 0) {
      return true;
    }
  }
  return false;
}

void classify(const VoxelGrid& grid, const CarveResult& found,
              std::span<const CarvingView> views, const HullOptions& options,
              std::vector<VoxelState>& states) {
  states.assign(grid.size(), VoxelState::empty);
  const double least = options.least_seen * found.n_lights;
  parallel_for(static_cast<std::size_t>(grid.nz), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t z = begin; z < end; ++z) {
      for (int y = 0; y < grid.ny; ++y) {
        for (int x = 0; x < grid.nx; ++x) {
          const std::size_t i = grid.index(x, y, static_cast<int>(z));
          if (found.is_empty[i] != 0) {
            continue;
          }
          const Eigen::Vector3d centre =
              grid.world_of(x + 0.5, y + 0.5, static_cast<double>(z) + 0.5);
          const bool is_seen =
              views.empty() || std::any_of(views.begin(), views.end(), [&](const auto& view) {
                return is_in_silhouette(view, centre);
              });
          if (!is_seen) {
            continue;  // no camera has it in its picture: nothing is known, nothing is assumed
          }
          states[i] = found.n_seen[i] >= least ? VoxelState::matter : VoxelState::assumed_empty;
        }
      }
    }
  });
}

/// What is taken as matter without proof: seen by too few, or by nobody.
void assume_matter(const CarveResult& found, std::span<const CarvingView> views,
                   const HullOptions& options, ShadowHull& hull) {
  const std::vector<float> chance = chance_of_matter(hull.grid, hull.states);
  for (std::size_t i = 0; i < chance.size(); ++i) {
    if (hull.states[i] == VoxelState::assumed_empty &&
        static_cast<double>(chance[i]) >= options.least_enclosed) {
      hull.states[i] = VoxelState::assumed_full;
    }
  }
  hull.summary.explained = explain_camera_rays(hull.grid, views, chance, hull.states);
  const double surely = options.surely_seen * found.n_lights;
  for (std::size_t i = 0; i < hull.states.size(); ++i) {
    if (hull.states[i] == VoxelState::matter && found.n_seen[i] < surely) {
      hull.states[i] = VoxelState::assumed_full;
    }
  }
}

/// Of the voxels that are not empty.
std::vector<VoxelEvidence> evidence_of(const std::vector<VoxelState>& states,
                                       const CarveResult& found, const CarveOptions& options) {
  const auto as_byte = [](double fraction) {
    return static_cast<std::uint8_t>(std::lround(255.0 * std::clamp(fraction, 0.0, 1.0)));
  };
  const double limit = options.evidence_limit * kEvidenceUnits;
  const double n_lights = std::max(1, found.n_lights);
  std::vector<VoxelEvidence> evidence;
  for (std::size_t i = 0; i < states.size(); ++i) {
    if (states[i] != VoxelState::empty) {
      evidence.push_back(
          {as_byte(found.lit_evidence[i] / limit), as_byte(found.n_seen[i] / n_lights)});
    }
  }
  return evidence;
}

void count_states(ShadowHull& hull) {
  HullSummary& summary = hull.summary;
  const VoxelGrid& grid = hull.grid;
  summary.voxel_mm = grid.voxel_mm;
  summary.n_voxels = static_cast<std::int64_t>(grid.size());
  summary.low_mm = std::numeric_limits<double>::infinity();
  summary.high_mm = -std::numeric_limits<double>::infinity();
  for (int z = 0; z < grid.nz; ++z) {
    for (int y = 0; y < grid.ny; ++y) {
      for (int x = 0; x < grid.nx; ++x) {
        const VoxelState state = hull.states[grid.index(x, y, z)];
        if (is_taken_as_matter(state)) {
          summary.touches_border = summary.touches_border || x == 0 || y == 0 ||
                                   x + 1 == grid.nx || y + 1 == grid.ny;
          summary.low_mm = std::min(summary.low_mm, grid.height_of(z));
          summary.high_mm = std::max(summary.high_mm, grid.height_of(z + 1));
        }
        switch (state) {
          case VoxelState::empty:
            ++summary.n_empty;
            break;
          case VoxelState::matter:
            ++summary.n_matter;
            break;
          case VoxelState::assumed_full:
            ++summary.n_assumed_full;
            break;
          case VoxelState::assumed_empty:
            ++summary.n_assumed_empty;
            break;
        }
      }
    }
  }
  if (summary.n_matter + summary.n_assumed_full == 0) {
    summary.low_mm = 0.0;
    summary.high_mm = 0.0;
  }
}

/// 1 or -1: the side of the plane that most of the lights are on.
double side_of_lights(const PlaneFrame& frame, std::span<const render::SquareLight> lights) {
  const auto over = static_cast<double>(std::count_if(
      lights.begin(), lights.end(),
      [&](const render::SquareLight& light) { return frame.height_of(light.centre) > 0.0; }));
  return over * 2.0 >= static_cast<double>(lights.size()) ? 1.0 : -1.0;
}

/// The box around all voxels that may be matter, one voxel wider; nothing without any.
std::optional<PlaneBox> box_around(const ShadowHull& hull, const PlaneBox& within) {
  const VoxelGrid& grid = hull.grid;
  Eigen::Vector3d low = Eigen::Vector3d::Constant(std::numeric_limits<double>::infinity());
  Eigen::Vector3d high = -low;
  for (int z = 0; z < grid.nz; ++z) {
    for (int y = 0; y < grid.ny; ++y) {
      for (int x = 0; x < grid.nx; ++x) {
        if (hull.states[grid.index(x, y, z)] != VoxelState::empty) {
          low = low.cwiseMin(Eigen::Vector3d(x - 1, y - 1, z - 1));
          high = high.cwiseMax(Eigen::Vector3d(x + 2, y + 2, z + 2));
        }
      }
    }
  }
  if (!(low.x() < high.x())) {
    return std::nullopt;
  }
  return PlaneBox{(grid.low + grid.voxel_mm * low).cwiseMax(within.low),
                  (grid.low + grid.voxel_mm * high).cwiseMin(within.high)};
}

}  // namespace

void require_lights(const PlaneFrame& frame, std::span<const render::SquareLight> lights,
                    const CarveOptions& options) {
  const double side = side_of_lights(frame, lights);
  const auto n =
      std::count_if(lights.begin(), lights.end(), [&](const render::SquareLight& light) {
        return side * frame.height_of(light.centre) > 0.0;
      });
  if (static_cast<double>(n) * options.beam_cap < options.evidence_limit) {
    throw Error(
        fmt::format("{} on the shadow plane: too few to carve an object",
                    counted(n, "light shines", "lights shine")),
        "rig",
        fmt::format("a capture of at least {:.0f} lights is needed; haarlight shadow --method "
                    "plane does without a hull",
                    std::ceil(options.evidence_limit / options.beam_cap)));
  }
}

void require_object(const ShadowHull& hull, const std::string& basis) {
  if (hull.summary.n_matter + hull.summary.n_assumed_full == 0) {
    throw Error(
        fmt::format("the captures show no object: every one of {} voxels is empty",
                    hull.summary.n_voxels),
        basis,
        "does it cast a shadow on the plane? is it within the plane's picture? compare with "
        "--voxel half as large, where it is very thin");
  }
}

ShadowHull build_hull(std::span<const SamplingPlane> planes,
                      std::span<const render::SquareLight> lights,
                      std::span<const CarvingView> views, const HullOptions& options) {
  HAARLIGHT_EXPECTS(!planes.empty() && options.max_voxels > 0, "a plane, and voxels");
  const std::vector<SamplingPlane> kept = keep_pictures(planes, options.carve.memory_bytes / 2);
  const PlaneFrame& frame = planes[0].frame;
  const double side = side_of_lights(frame, lights);
  const PlaneBox widest = widest_box(frame, lights, side, options.highest_mm);
  require_lights(frame, lights, options.carve);
  ShadowHull hull;
  hull.grid = make_voxel_grid(frame, side, widest, voxel_for(widest, kCoarseVoxels));
  CarveResult found = carve(hull.grid, kept, lights, views, options.carve);
  classify(hull.grid, found, views, options, hull.states);
  std::uint64_t n_lookups = found.n_lookups;
  if (const std::optional<PlaneBox> box = box_around(hull, widest)) {
    const double finest = 0.5 * frame.texel_mm;
    const double voxel = options.voxel_mm > 0.0
                             ? options.voxel_mm
                             : std::max(finest, voxel_for(*box, options.max_voxels));
    hull.grid = make_voxel_grid(frame, side, *box, voxel);
    require_memory(hull.grid, voxel_for(*box, options.max_voxels), options.carve.memory_bytes);
    found = carve(hull.grid, kept, lights, views, options.carve);
    classify(hull.grid, found, views, options, hull.states);
    assume_matter(found, views, options, hull);
    n_lookups += found.n_lookups;
  }
  hull.evidence = evidence_of(hull.states, found, options.carve);
  count_states(hull);
  hull.summary.leaves_camera =
      std::any_of(views.begin(), views.end(), [](const auto& view) { return is_cut(view); });
  hull.summary.n_lights = found.n_lights;
  hull.summary.n_lookups = n_lookups;
  return hull;
}

}  // namespace haarlight::relight
