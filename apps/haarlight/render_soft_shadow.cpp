// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight render soft-shadow SCENE.toml -o PICTURE`: the fraction of each light that the points
/// of a picture see, exact where only flat surfaces are in the way.

#include "apps/haarlight/render_soft_shadow.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <memory>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "apps/haarlight/render_scene.h"
#include "core/parallel.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/render/light/rig_lights.h"
#include "render/camera/camera.h"
#include "render/soft_shadow/soft_shadow.h"

namespace haarlight::apps {

namespace {

using Clock = std::chrono::steady_clock;

struct SoftShadowArguments {
  std::string scene;
  std::string output;
  std::string map;
  std::string rig;
  std::vector<int> lights;
  std::vector<int> size;
  render::LightShape shape = render::LightShape::own;
  double max_error = 0.02;
  int grid = render::SoftShadowOptions{}.grid;
};

constexpr int kLeastStrata = 4;
constexpr int kMostStrata = 256;

/// n x n points of the light: a border through it is off by less than 2/n of its area.
int strata_for(double max_error) {
  return std::clamp(static_cast<int>(std::ceil(2.0 / max_error)), kLeastStrata, kMostStrata);
}

/// What each pixel sees, through its centre and a lens's.
struct SeenPoints {
  std::vector<Eigen::Vector3d> points;  ///< world, off their surfaces
  std::vector<std::size_t> pixels;
};
SeenPoints seen_points(const render::SceneFile& file, const render::RayCaster& caster) {
  const render::Camera camera(file.camera, file.optics);
  const auto width = static_cast<std::size_t>(camera.width());
  const auto height = static_cast<std::size_t>(camera.height());
  std::vector<Eigen::Vector3d> found(width * height);
  std::vector<std::uint8_t> is_hit(width * height);
  parallel_for(height, 1, [&](std::size_t first, std::size_t last) {
    std::vector<render::Ray> rays(width);
    std::vector<render::RawHit> raw(width);
    std::vector<render::Hit> hits(width);
    for (std::size_t y = first; y < last; ++y) {
      for (std::size_t x = 0; x < width; ++x) {
        rays[x] = camera.ray(static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5,
                             Eigen::Vector2d(0.5, 0.5));
      }
      caster.intersect(rays, render::RayOrder::coherent, raw);
      caster.surfaces_at(rays, raw, hits);
      for (std::size_t x = 0; x < width; ++x) {
        if (raw[x].is_hit()) {
          found[y * width + x] = hits[x].point + hits[x].offset_mm * hits[x].flat_normal;
          is_hit[y * width + x] = 1;
        }
      }
    }
  });
  SeenPoints seen;
  for (std::size_t i = 0; i < found.size(); ++i) {
    if (is_hit[i] != 0) {
      seen.points.push_back(found[i]);
      seen.pixels.push_back(i);
    }
  }
  return seen;
}

constexpr float kNoSurface = -1.0F;

/// Of one light: its visibility, and how each value was found.
struct ShadowPicture {
  Image<float> visibility;
  Image<float> kind;
};

ShadowPicture picture_of(const SeenPoints& seen,
                         const std::vector<render::LightShadow>& shadows, int width,
                         int height) {
  ShadowPicture picture{Image<float>(height, width, 1), Image<float>(height, width, 1)};
  std::ranges::fill(picture.kind.pixels(), kNoSurface);
  for (std::size_t i = 0; i < shadows.size(); ++i) {
    picture.visibility.pixels()[seen.pixels[i]] = shadows[i].visibility;
    picture.kind.pixels()[seen.pixels[i]] = static_cast<float>(shadows[i].kind);
  }
  return picture;
}

/// Grey, green, blue, red, orange: as render::kShadowKindWords. Of several lights the last of these.
Image<float> map_of(const std::vector<ShadowPicture>& pictures) {
  constexpr auto kColours = std::to_array<std::array<float, 3>>({{0.25F, 0.25F, 0.25F},
                                                                 {0.10F, 0.60F, 0.20F},
                                                                 {0.10F, 0.25F, 0.80F},
                                                                 {0.80F, 0.05F, 0.05F},
                                                                 {0.90F, 0.45F, 0.05F}});
  const Image<float>& first = pictures.front().kind;
  Image<float> map(first.height(), first.width(), 3);
  for (std::size_t i = 0; i < first.pixels().size(); ++i) {
    float kind = kNoSurface;
    for (const ShadowPicture& picture : pictures) {
      kind = std::max(kind, picture.kind.pixels()[i]);
    }
    if (kind >= 0.0F) {
      const std::array<float, 3>& colour = kColours.at(static_cast<std::size_t>(kind));
      std::ranges::copy(colour, map.pixels().subspan(3 * i, 3).begin());
    }
  }
  return map;
}

/// The mean over the lights.
Image<float> mean_of(const std::vector<ShadowPicture>& pictures) {
  const Image<float>& first = pictures.front().visibility;
  Image<float> mean(first.height(), first.width(), 1);
  for (std::size_t i = 0; i < first.pixels().size(); ++i) {
    double sum = 0.0;
    for (const ShadowPicture& picture : pictures) {
      sum += picture.visibility.pixels()[i];
    }
    mean.pixels()[i] = static_cast<float>(sum / static_cast<double>(pictures.size()));
  }
  return mean;
}

/// @param numbers  of the lights; empty: 0 and on
void write_pictures(const std::vector<ShadowPicture>& pictures, const std::vector<int>& numbers,
                    const SoftShadowArguments& arguments) {
  std::vector<PictureLayer> layers;
  for (std::size_t i = 0; i < pictures.size(); ++i) {
    const int number = numbers.empty() ? static_cast<int>(i) : numbers[i];
    const std::string prefix = pictures.size() == 1 ? "" : fmt::format("light{}.", number);
    if (pictures.size() > 1) {
      layers.push_back(
          {.channels = {prefix + "visibility"}, .image = pictures[i].visibility.view()});
    }
    layers.push_back({.channels = {prefix + "kind"}, .image = pictures[i].kind.view()});
  }
  const Image<float> mean = mean_of(pictures);
  write_image(arguments.output, mean.view(), 1.0, {}, layers);
  const std::string preview = preview_of(arguments.output);
  if (!preview.empty()) {
    write_image(preview, mean.view());
  }
  if (!arguments.map.empty()) {
    write_image(arguments.map, map_of(pictures).view());
  }
}

/// The scene with the LEDs of a rig as its only lights.
/// @param lights  numbers of the LEDs
render::SceneFile read_scene_under_rig(const SoftShadowArguments& arguments,
                                       std::vector<int>& lights) {
  const Rig rig = read_rig(arguments.rig);
  render::SceneFile file = render::read_scene(arguments.scene);
  if (!file.has_camera) {
    file.camera = rig.cameras.front().model;
  }
  std::vector<int> size = arguments.size;
  if (size.empty() && file.film.size) {
    size.assign(file.film.size->begin(), file.film.size->end());
  }
  if (!size.empty()) {
    file.camera = render::resized(file.camera, size[0], size[1]);
  }
  for (render::Material& material : file.scene.materials) {
    material.emits.setZero();
  }
  file.scene.point_lights.clear();
  file.scene.directional_lights.clear();
  file.scene.environment.reset();
  const std::vector<render::SquareLight> all = render::rig_lights(rig);
  lights = arguments.lights;
  if (lights.empty()) {
    for (std::size_t k = 0; k < all.size(); ++k) {
      lights.push_back(static_cast<int>(k));
    }
  }
  file.scene.lights.clear();
  for (const int k : lights) {
    if (k >= static_cast<int>(all.size())) {
      throw Error(fmt::format("no light {}: the rig has {}, from 0", k, all.size()), "--light",
                  "give numbers of the rig's lights", ExitCode::usage);
    }
    file.scene.lights.push_back(all[static_cast<std::size_t>(k)]);
  }
  return file;
}

double seconds_since(Clock::time_point begin) {
  return std::chrono::duration<double>(Clock::now() - begin).count();
}

void require_memory(const render::SceneFile& file, std::size_t n_lights,
                    const CommonOptions& common, const std::string& path) {
  std::size_t n_triangles = 0;
  for (const render::Mesh& mesh : file.scene.meshes) {
    n_triangles += mesh.triangles.size();
  }
  constexpr std::uint64_t kPerTriangle = 600;  // edges, sorted, and in a light's frame
  constexpr std::uint64_t kPerPixel = 160;
  const auto n_pixels = static_cast<std::uint64_t>(file.camera.width) *
                        static_cast<std::uint64_t>(file.camera.height);
  const std::uint64_t needed = render::RayCaster::bytes_needed(file.scene) +
                               n_triangles * kPerTriangle +
                               n_pixels * (kPerPixel + 8 * n_lights);
  if (needed > common.memory_bytes) {
    throw Error(
        fmt::format("{} triangles, {} pixels and {} lights need {} MB; --memory allows {}",
                    n_triangles, n_pixels, n_lights, needed / 1'000'000,
                    common.memory_bytes / 1'000'000),
        path, "give a smaller --size, the scene fewer triangles, or more --memory",
        ExitCode::usage);
  }
}

/// Sums over the lights.
void add(const render::ShadowCounts& light, render::ShadowCounts& all) {
  all.n_edges = light.n_edges;
  all.n_candidates += light.n_candidates;
  all.n_listed += light.n_listed;
  all.n_rays += light.n_rays;
  all.n_penumbra += light.n_penumbra;
  all.grid_seconds += light.grid_seconds;
  all.shadow_seconds += light.shadow_seconds;
  for (std::size_t kind = 0; kind < all.by_kind.size(); ++kind) {
    all.by_kind.at(kind) += light.by_kind.at(kind);
  }
}

std::int64_t of_kind(const render::ShadowCounts& counts, render::ShadowKind kind) {
  return counts.by_kind.at(static_cast<std::size_t>(kind));
}

void report_counts(const render::ShadowCounts& counts, Report& report) {
  for (std::size_t kind = 0; kind < counts.by_kind.size(); ++kind) {
    report.add_detail(fmt::format("points_{}", render::kShadowKindWords.at(kind)),
                      counts.by_kind.at(kind));
  }
  report.add_detail("points_penumbra", counts.n_penumbra);
  report.add_detail("edges", counts.n_edges);
  report.add_detail("edges_that_may_part_a_light", counts.n_candidates);
  report.add_detail("edges_in_cells", counts.n_listed);
  report.add_detail("rays", counts.n_rays);
  report.add_detail("grid_seconds", counts.grid_seconds);
  report.add_detail("shadow_seconds", counts.shadow_seconds);
}

ExitCode run_soft_shadow(const SoftShadowArguments& arguments, const CommonOptions& common,
                         Report& report) {
  report.add_input(arguments.scene);
  if (arguments.rig.empty() && !arguments.lights.empty()) {
    throw Error("--light is a number of a rig's lights", "--light", "give --rig RIG.toml too",
                ExitCode::usage);
  }
  report.add_requested("light_shape", std::string(to_string(arguments.shape)));
  report.add_requested("max_error", arguments.max_error);
  require_outputs(arguments.output, arguments.map, "--map", common.force);
  std::vector<int> led_numbers;
  if (!arguments.rig.empty()) {
    report.add_input(arguments.rig);
  }
  render::SceneFile file = arguments.rig.empty()
                               ? read_lit_scene(arguments.scene, arguments.size)
                               : read_scene_under_rig(arguments, led_numbers);
  std::vector<render::FlatLight> lights =
      render::flat_lights(file.scene, arguments.shape, arguments.scene);
  file.scene = render::with_instances_expanded(std::move(file.scene), arguments.scene);
  require_memory(file, lights.size(), common, arguments.scene);
  auto begin = Clock::now();
  const render::RayCaster caster(file.scene);
  const SeenPoints seen = seen_points(file, caster);
  report.add_detail("camera_seconds", seconds_since(begin));
  begin = Clock::now();
  const render::OccluderEdges edges = render::occluder_edges(file.scene.meshes);
  report.add_detail("edge_seconds", seconds_since(begin));
  const render::SoftShadowOptions options{.grid = arguments.grid,
                                          .traced_strata = strata_for(arguments.max_error)};
  render::ShadowCounts counts;
  std::vector<ShadowPicture> pictures;
  {
    Progress progress("lights", lights.size(), common.progress());
    for (render::FlatLight& light : lights) {
      render::SoftShadow soft(file.scene, edges, caster, std::move(light), options);
      std::vector<render::LightShadow> shadows(seen.points.size());
      soft.evaluate(seen.points, shadows);
      add(soft.counts(), counts);
      pictures.push_back(picture_of(seen, shadows, file.camera.width, file.camera.height));
      progress.advance();
    }
  }
  write_pictures(pictures, led_numbers, arguments);
  report_counts(counts, report);
  report.set_bytes(std::filesystem::file_size(arguments.output));
  const std::int64_t n = std::max<std::int64_t>(
      1, static_cast<std::int64_t>(seen.points.size() * pictures.size()));
  const std::int64_t n_exact = n - of_kind(counts, render::ShadowKind::traced) -
                               of_kind(counts, render::ShadowKind::unsure);
  report.add_achieved("exact_fraction", static_cast<double>(n_exact) / static_cast<double>(n));
  fmt::print(
      "{}: {} x {} pixels, {} light{}, {:.2f} % of the values exact, {} traced, {} unsure; "
      "{:.3f} s a light\n",
      arguments.output, file.camera.width, file.camera.height, pictures.size(),
      pictures.size() == 1 ? "" : "s",
      100.0 * static_cast<double>(n_exact) / static_cast<double>(n),
      of_kind(counts, render::ShadowKind::traced), of_kind(counts, render::ShadowKind::unsure),
      (counts.grid_seconds + counts.shadow_seconds) / static_cast<double>(pictures.size()));
  return ExitCode::done;
}

}  // namespace

void add_render_soft_shadow(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<SoftShadowArguments>();
  Command verb =
      root.add_verb("soft-shadow", "Which fraction of each light a scene's points see");
  verb.option("SCENE", &arguments->scene,
              "Scene file with a [camera] and lights that are disks or quads",
              {.type = "SCENE.toml", .is_required = true});
  verb.option("-o,--output", &arguments->output,
              "Picture to write: .exr, the visibility, 0 to 1, with how each was found as a "
              "further channel; of several lights their mean, and each of them; .tif; .png",
              {.type = "PICTURE", .is_required = true});
  verb.option(
      "--map", &arguments->map,
      "Also show how each value was found: grey whole, green one edge, blue several (all "
      "three exact), red unsure, orange traced",
      {.type = "PICTURE"});
  verb.option(
      "--rig", &arguments->rig,
      "Under this rig's lights instead of the scene's own; by its first camera where the "
      "scene has none",
      {.type = "RIG.toml"});
  verb.option("--light", &arguments->lights,
              "Only these lights of the rig, numbers from 0 on (default: all)",
              {.type = "K", .bounds = Bounds{0, 1e6}, .delimiter = ','});
  verb.option("--size", &arguments->size,
              "Picture size (default: the scene's [film], else its [camera])",
              {.type = "WxH", .bounds = Bounds{1, 1 << 16}, .delimiter = 'x', .count = 2});
  verb.option("--light-shape", &arguments->shape,
              "own: a square light is a square; disk: the disk of the same area",
              {.shows_default = true});
  verb.option("--max-error", &arguments->max_error,
              "Of values that are traced: spheres and disks in the way",
              {.type = "E", .bounds = Bounds{2.0 / kMostStrata, 0.25}, .shows_default = true});
  verb.option("--grid", &arguments->grid,
              "Cells of a light's list of edges, across and down: time and memory only",
              {.type = "N", .bounds = Bounds{1, 4096}, .shows_default = true});
  verb.footer(
      "Example:\n  haarlight render soft-shadow configs/scenes/cornell.toml -o soft.exr --map "
      "soft-map.png\n  haarlight render soft-shadow configs/scenes/airplane.toml --rig "
      "configs/rigs/small8.toml --light 3 -o under-led.exr");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_soft_shadow(*arguments, common, report);
  });
}

}  // namespace haarlight::apps
