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
#include <numeric>
#include <optional>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "apps/haarlight/render_scene.h"
#include "apps/haarlight/soft_shadow_comparison.h"
#include "core/counted.h"
#include "core/parallel.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/render/light/rig_lights.h"
#include "render/camera/camera.h"
#include "render/scene/camera_table.h"
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
  std::string cameras;
  std::string comparison;
  render::LightShape shape = render::LightShape::own;
  render::SoftShadowOptions options;
};

/// One picture: what looks, and the names of its files.
struct View {
  CameraModel camera;
  render::CameraOptics optics;
  std::string output;
  std::string map;  ///< empty: none
};

/// What each pixel sees, through its centre and a lens's.
struct SeenPoints {
  std::vector<Eigen::Vector3d> points;  ///< world, off their surfaces
  std::vector<std::size_t> pixels;
};
SeenPoints seen_points(const View& view, const render::RayCaster& caster) {
  const render::Camera camera(view.camera, view.optics);
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

/// Of one light: its visibility, how each value was found, and what it is off by.
struct ShadowPicture {
  Image<float> visibility;
  Image<float> kind;
  Image<float> error;  ///< empty: not compared
};

ShadowPicture picture_of(const SeenPoints& seen,
                         const std::vector<render::LightShadow>& shadows, int width,
                         int height) {
  ShadowPicture picture{.visibility = Image<float>(height, width, 1),
                        .kind = Image<float>(height, width, 1),
                        .error = {}};
  std::ranges::fill(picture.kind.pixels(), kNoSurface);
  for (std::size_t i = 0; i < shadows.size(); ++i) {
    picture.visibility.pixels()[seen.pixels[i]] = shadows[i].visibility;
    picture.kind.pixels()[seen.pixels[i]] = static_cast<float>(shadows[i].kind);
  }
  return picture;
}

/// Grey, green, blue, violet, red, orange: as render::kShadowKindWords. Of several lights the last of
/// these.
Image<float> map_of(const std::vector<ShadowPicture>& pictures) {
  constexpr auto kColours = std::to_array<std::array<float, 3>>({{0.25F, 0.25F, 0.25F},
                                                                 {0.10F, 0.60F, 0.20F},
                                                                 {0.10F, 0.25F, 0.80F},
                                                                 {0.35F, 0.10F, 0.55F},
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

/// The largest error of the lights: red too light, blue too dark, full from a quarter on; else white.
Image<float> error_map_of(const std::vector<ShadowPicture>& pictures) {
  constexpr float kFull = 0.25F;
  const Image<float>& first = pictures.front().error;
  Image<float> map(first.height(), first.width(), 3);
  for (std::size_t i = 0; i < first.pixels().size(); ++i) {
    float error = 0.0F;
    for (const ShadowPicture& picture : pictures) {
      const float other = picture.error.pixels()[i];
      error = std::abs(other) > std::abs(error) ? other : error;
    }
    const float pale = 1.0F - std::min(1.0F, std::abs(error) / kFull);
    const std::array<float, 3> colour = {error > 0.0F ? 1.0F : pale, pale,
                                         error < 0.0F ? 1.0F : pale};
    std::ranges::copy(colour, map.pixels().subspan(3 * i, 3).begin());
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

/// @param numbers     of the lights; empty: 0 and on
/// @param comparison  where to draw errors; empty: none
void write_pictures(const std::vector<ShadowPicture>& pictures, const std::vector<int>& numbers,
                    const View& view, const std::string& comparison) {
  std::vector<PictureLayer> layers;
  for (std::size_t i = 0; i < pictures.size(); ++i) {
    const int number = numbers.empty() ? static_cast<int>(i) : numbers[i];
    const std::string prefix = pictures.size() == 1 ? "" : fmt::format("light{}.", number);
    if (pictures.size() > 1) {
      layers.push_back(
          {.channels = {prefix + "visibility"}, .image = pictures[i].visibility.view()});
    }
    layers.push_back({.channels = {prefix + "kind"}, .image = pictures[i].kind.view()});
    if (!comparison.empty()) {
      layers.push_back({.channels = {prefix + "error"}, .image = pictures[i].error.view()});
    }
  }
  const Image<float> mean = mean_of(pictures);
  write_image(view.output, mean.view(), 1.0, {}, layers);
  const std::string preview = preview_of(view.output);
  if (!preview.empty()) {
    write_image(preview, mean.view());
  }
  if (!view.map.empty()) {
    write_image(view.map, map_of(pictures).view());
  }
  if (!comparison.empty()) {
    write_image(comparison, error_map_of(pictures).view());
  }
}

/// A scene file; or an object's mesh over the shadow sampling planes of the rig.
render::SceneFile read_object(const std::string& path, const Rig& rig) {
  const bool is_obj = has_ending(path, ".obj");
  if (!is_obj && !has_ending(path, ".ply")) {
    return render::read_scene(path);
  }
  render::SceneFile file;
  file.scene = is_obj ? render::read_obj(path) : render::read_ply(path);
  const int grey = static_cast<int>(file.scene.materials.size());
  file.scene.materials.emplace_back();
  for (const ShadowPlane& plane : rig.planes) {
    const auto corner = [&plane](double s, double t) -> Eigen::Vector3d {
      return plane.origin +
             0.5 * (s * plane.extent_u_mm * plane.u + t * plane.extent_v_mm * plane.v);
    };
    file.scene.meshes.push_back(
        render::make_quad(corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1), grey));
  }
  return file;
}

/// The scene with the LEDs of a rig as its only lights.
/// @param lights  numbers of the LEDs
render::SceneFile read_scene_under_rig(const SoftShadowArguments& arguments,
                                       std::vector<int>& lights) {
  const Rig rig = read_rig(arguments.rig);
  render::SceneFile file = read_object(arguments.scene, rig);
  if (!file.has_camera) {
    file.camera = rig.cameras.front().model;
  }
  set_picture_size(file, arguments.size);
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

void require_memory(const render::SceneFile& file, const CameraModel& camera,
                    std::size_t n_lights, const SoftShadowArguments& arguments,
                    const CommonOptions& common) {
  const std::string& path = arguments.scene;
  std::size_t n_triangles = 0;
  for (const render::Mesh& mesh : file.scene.meshes) {
    n_triangles += mesh.triangles.size();
  }
  constexpr std::uint64_t kPerTriangle = 600;  // edges, sorted, and in a light's frame
  constexpr std::uint64_t kKept = 300;         // in a light's frame, where all are kept
  constexpr std::uint64_t kPerPixel = 160;
  const auto n_pixels =
      static_cast<std::uint64_t>(camera.width) * static_cast<std::uint64_t>(camera.height);
  constexpr std::uint64_t kPerTexel = 160;  // of a D-buffer, three surfaces on its ray
  const auto texels = static_cast<std::uint64_t>(arguments.options.texels);
  const std::uint64_t n_kept = arguments.cameras.empty() ? 1 : n_lights;
  const std::uint64_t needed =
      render::RayCaster::bytes_needed(file.scene) + n_triangles * kPerTriangle +
      (n_kept - 1) * n_triangles * kKept + n_pixels * (kPerPixel + 12 * n_lights) +
      (is_buffered(arguments.options.method) ? n_kept * texels * texels * kPerTexel : 0);
  if (needed > common.memory_bytes) {
    throw Error(
        fmt::format("{} triangles, {} pixels and {} lights need {} MB; --memory allows {}",
                    n_triangles, n_pixels, n_lights, needed / 1'000'000,
                    common.memory_bytes / 1'000'000),
        path, "give a smaller --size, the scene fewer triangles, or more --memory",
        ExitCode::usage);
  }
}

/// Sums over the lights; of the traced points' errors the largest.
void add(const render::ShadowCounts& light, render::ShadowCounts& all) {
  all.n_edges = light.n_edges;
  all.n_candidates += light.n_candidates;
  all.n_listed += light.n_listed;
  all.n_rays += light.n_rays;
  all.n_double_rays += light.n_double_rays;
  all.n_penumbra += light.n_penumbra;
  all.n_clamped += light.n_clamped;
  all.n_without_extrusion += light.n_without_extrusion;
  if (light.traced.strata > 0) {
    all.traced.strata = std::max(all.traced.strata, light.traced.strata);
    all.traced.mean = std::max(all.traced.mean, light.traced.mean);
    all.traced.at_99 = std::max(all.traced.at_99, light.traced.at_99);
    all.traced.n_pilot += light.traced.n_pilot;
  }
  all.grid_seconds += light.grid_seconds;
  all.shadow_seconds += light.shadow_seconds;
  for (std::size_t kind = 0; kind < all.by_kind.size(); ++kind) {
    all.by_kind.at(kind) += light.by_kind.at(kind);
  }
}

std::int64_t of_kind(const render::ShadowCounts& counts, render::ShadowKind kind) {
  return counts.by_kind.at(static_cast<std::size_t>(kind));
}

/// Whether traced values are off by more than --max-error with the most rays.
bool is_error_missed(const render::ShadowCounts& counts,
                     const render::SoftShadowOptions& options) {
  return options.strata == 0 &&
         std::max(counts.traced.mean, counts.traced.at_99) > options.max_error;
}

void report_counts(const render::ShadowCounts& counts, const render::SoftShadowOptions& options,
                   Report& report) {
  for (std::size_t kind = 0; kind < counts.by_kind.size(); ++kind) {
    report.add_detail(fmt::format("points_{}", render::kShadowKindWords.at(kind)),
                      counts.by_kind.at(kind));
  }
  report.add_detail("points_penumbra", counts.n_penumbra);
  report.add_detail("edges", counts.n_edges);
  report.add_detail("edges_that_may_part_a_light", counts.n_candidates);
  report.add_detail("edges_in_cells", counts.n_listed);
  report.add_detail("rays", counts.n_rays);
  report.add_detail("rays_in_double_precision", counts.n_double_rays);
  report.add_detail("t_clamped", counts.n_clamped);
  report.add_detail("edges_without_extrusion", counts.n_without_extrusion);
  if (counts.traced.n_pilot > 0) {
    report.add_detail("traced_strata", counts.traced.strata);
    report.add_detail("traced_pilot_points", counts.traced.n_pilot);
    report.add_achieved("traced_mean_error", counts.traced.mean);
    report.add_achieved("traced_error_at_99_percent", counts.traced.at_99);
    if (options.strata == 0) {
      report.add_achieved("max_error_reached", !is_error_missed(counts, options));
    }
  }
}

void report_errors(const ShadowErrors& errors, double exact_seconds, Report& report) {
  report.add_detail("values_compared", errors.n_compared);
  report.add_detail("values_compared_in_penumbra", errors.n_penumbra);
  report.add_achieved("mean_error", errors.mean);
  report.add_achieved("error_at_99_percent", errors.at_99);
  report.add_achieved("worst_error", errors.worst);
  report.add_achieved("mean_signed_error", errors.mean_error);
  report.add_achieved("umbra_border_pixels", errors.umbra_border_pixels);
  report.add_achieved("penumbra_border_pixels", errors.penumbra_border_pixels);
  report.add_detail("exact_seconds", exact_seconds);
}

void check_arguments(const SoftShadowArguments& arguments) {
  if (arguments.rig.empty() && !arguments.lights.empty()) {
    throw Error("--light is a number of a rig's lights", "--light", "give --rig RIG.toml too",
                ExitCode::usage);
  }
  const render::ShadowMethod method = arguments.options.method;
  if (arguments.options.form != render::VisibilityForm::exact && !is_buffered(method)) {
    throw Error("--visibility is a form of the D-buffer's", "--visibility",
                "give --method d-buffer or paper, or leave it out", ExitCode::usage);
  }
  if (!arguments.comparison.empty() && method == render::ShadowMethod::exact &&
      arguments.shape == render::LightShape::own) {
    throw Error("--compare tells what an approximation is off by; this is the exact way",
                "--compare", "give --method, or --light-shape disk", ExitCode::usage);
  }
}

void require_disks(const std::vector<render::FlatLight>& lights,
                   const SoftShadowArguments& arguments) {
  for (const render::FlatLight& light : lights) {
    if (is_buffered(arguments.options.method) && !light.is_disk()) {
      throw Error(fmt::format("a D-buffer is a disk's, and {} is none", light.name),
                  arguments.scene, "give --light-shape disk: the disk of the same area");
    }
  }
}

void require_soft_outputs(const SoftShadowArguments& arguments, bool is_forced) {
  require_outputs(arguments.output, arguments.map, "--map", is_forced);
  if (!arguments.comparison.empty()) {
    require_outputs(arguments.output, arguments.comparison, "--compare", is_forced);
    if (arguments.comparison == arguments.map) {
      throw Error("--map and --compare name the same file", arguments.map,
                  "give each a file of its own", ExitCode::usage);
    }
  }
}

/// OUT.exr to OUT-0007.exr.
std::string numbered(const std::string& output, std::size_t number) {
  std::filesystem::path name = output;
  name.replace_filename(
      fmt::format("{}-{:04}{}", name.stem().string(), number, name.extension().string()));
  return name.string();
}

/// The scene's own; or those of --cameras, in the picture's size that the scene's would have.
std::vector<View> views_of(const render::SceneFile& file, const SoftShadowArguments& arguments,
                           bool is_forced) {
  std::vector<View> views;
  if (arguments.cameras.empty()) {
    require_soft_outputs(arguments, is_forced);
    views.push_back({.camera = file.camera,
                     .optics = file.optics,
                     .output = arguments.output,
                     .map = arguments.map});
    return views;
  }
  for (const render::CameraTable& table : render::read_cameras(arguments.cameras)) {
    render::SceneFile seen{.camera = table.camera, .optics = table.optics, .film = file.film};
    set_picture_size(seen, arguments.size);
    SoftShadowArguments own = arguments;
    own.output = numbered(arguments.output, views.size());
    own.map = arguments.map.empty() ? "" : numbered(arguments.map, views.size());
    require_soft_outputs(own, is_forced);
    views.push_back(
        {.camera = seen.camera, .optics = seen.optics, .output = own.output, .map = own.map});
  }
  return views;
}

/// What all lights gave of one view.
struct AllShadows {
  std::vector<ShadowPicture> pictures;
  render::ShadowCounts counts;
  std::optional<ShadowErrors> errors;
  double exact_seconds = 0.0;  ///< of what it was compared with
};

/// A scene and what is made of it once, whoever looks.
struct LitScene {
  render::SceneFile file;
  std::vector<render::FlatLight> lights;
  std::vector<int> led_numbers;  ///< of the lights, of a rig; empty: 0 and on
  std::optional<render::RayCaster> caster;
  render::OccluderEdges edges;
  std::vector<std::optional<render::SoftShadow>> shadows;  ///< of each light
};

/// @param is_last  what is kept of a light for further views may go
AllShadows shadows_of(LitScene& lit, const SoftShadowArguments& arguments, const View& view,
                      const SeenPoints& seen, bool is_last, Progress& progress) {
  const int width = view.camera.width;
  const int height = view.camera.height;
  const render::Scene& scene = lit.file.scene;
  AllShadows all;
  std::vector<render::FlatLight> exact_lights;
  std::optional<ShadowComparison> comparison;
  if (!arguments.comparison.empty()) {
    exact_lights = render::flat_lights(scene, render::LightShape::own, arguments.scene);
    comparison.emplace(seen.pixels, width, height);
  }
  const auto evaluate = [&seen](render::SoftShadow& soft, render::ShadowCounts& counts) {
    std::vector<render::LightShadow> shadows(seen.points.size());
    soft.evaluate(seen.points, shadows);
    add(soft.counts(), counts);
    return shadows;
  };
  for (std::size_t i = 0; i < lit.lights.size(); ++i) {
    std::optional<render::SoftShadow>& soft = lit.shadows[i];
    if (!soft) {
      soft.emplace(scene, lit.edges, *lit.caster, lit.lights[i], arguments.options,
                   arguments.scene);
    }
    const std::vector<render::LightShadow> shadows = evaluate(*soft, all.counts);
    if (is_last) {
      soft.reset();
    }
    all.pictures.push_back(picture_of(seen, shadows, width, height));
    if (comparison) {
      render::SoftShadow exact_soft(scene, lit.edges, *lit.caster, std::move(exact_lights[i]),
                                    {}, arguments.scene);
      render::ShadowCounts counts;
      const std::vector<render::LightShadow> exact = evaluate(exact_soft, counts);
      all.exact_seconds += counts.grid_seconds + counts.shadow_seconds;
      all.pictures.back().error = comparison->add(shadows, exact);
    }
    progress.advance();
  }
  if (comparison) {
    all.errors = comparison->errors();
  }
  return all;
}

void print_result(const SoftShadowArguments& arguments, const View& view, const AllShadows& all,
                  double exact_percent) {
  const render::ShadowCounts& counts = all.counts;
  const std::size_t n_lights = all.pictures.size();
  const std::string head = fmt::format("{}: {} x {} pixels, {}", view.output, view.camera.width,
                                       view.camera.height, counted(n_lights, "light"));
  const double seconds =
      (counts.grid_seconds + counts.shadow_seconds) / static_cast<double>(n_lights);
  if (arguments.options.method == render::ShadowMethod::exact) {
    fmt::print("{}, {:.2f} % of the values exact, {} traced, {} unsure; {:.3f} s a light\n",
               head, exact_percent, of_kind(counts, render::ShadowKind::traced),
               of_kind(counts, render::ShadowKind::unsure), seconds);
  } else {
    fmt::print("{} by {}; {:.3f} s a light\n", head, to_string(arguments.options.method),
               seconds);
  }
  if (counts.traced.n_pilot > 0) {
    fmt::print(
        "traced: {} rays per value; {} of them with four times as many differ by {:.4f} in the "
        "mean, 99 % by less than {:.4f}{}\n",
        counts.traced.strata * counts.traced.strata, counts.traced.n_pilot, counts.traced.mean,
        counts.traced.at_99,
        is_error_missed(counts, arguments.options)
            ? fmt::format(": --max-error {} is not reached, by the most rays that are traced",
                          arguments.options.max_error)
            : "");
  }
  if (all.errors) {
    const ShadowErrors& errors = *all.errors;
    fmt::print(
        "beside the exact values, {} in the penumbra: off by {:.2g} in the mean, "
        "{:.2g} at 99 %, {:.2g} at worst; borders by {} (umbra) and {} (penumbra) pixels; "
        "in {:.2f} of their time\n",
        errors.n_penumbra, errors.mean, errors.at_99, errors.worst, errors.umbra_border_pixels,
        errors.penumbra_border_pixels,
        (counts.grid_seconds + counts.shadow_seconds) / std::max(all.exact_seconds, 1e-9));
  }
}

LitScene read_lit(const SoftShadowArguments& arguments, Report& report) {
  LitScene lit;
  if (arguments.rig.empty()) {
    lit.file = read_lit_scene(arguments.scene, arguments.size);
  } else {
    report.add_input(arguments.rig);
    lit.file = read_scene_under_rig(arguments, lit.led_numbers);
  }
  // Expanded first: surfaces then have their last numbers.
  lit.file.scene = render::with_instances_expanded(std::move(lit.file.scene), arguments.scene);
  lit.lights = render::flat_lights(lit.file.scene, arguments.shape, arguments.scene);
  lit.shadows.resize(lit.lights.size());
  require_disks(lit.lights, arguments);
  return lit;
}

/// Seconds of each picture; of the first with what is made once.
struct PhaseSeconds {
  std::vector<double> camera;
  std::vector<double> grid;
  std::vector<double> shadow;
  std::vector<double> picture;
};

/// Of several pictures also those of each.
void report_seconds(const PhaseSeconds& seconds, Report& report) {
  const auto add_phase = [&report](const std::string& name, const std::vector<double>& each) {
    report.add_detail(name, std::accumulate(each.begin(), each.end(), 0.0));
    if (each.size() > 1) {
      report.add_detail(name + "_each", each);
    }
  };
  add_phase("camera_seconds", seconds.camera);
  add_phase("grid_seconds", seconds.grid);
  add_phase("shadow_seconds", seconds.shadow);
  add_phase("picture_seconds", seconds.picture);
}

/// What the grids hold is that of the last; all else is summed.
void add_view(const render::ShadowCounts& view, render::ShadowCounts& all) {
  add(view, all);
  all.n_candidates = view.n_candidates;
  all.n_listed = view.n_listed;
  all.n_without_extrusion = view.n_without_extrusion;
}

double exact_fraction_of(const render::ShadowCounts& counts) {
  using render::ShadowKind;
  const std::int64_t n_exact = of_kind(counts, ShadowKind::whole) +
                               of_kind(counts, ShadowKind::edge) +
                               of_kind(counts, ShadowKind::outline);
  const std::int64_t n =
      std::accumulate(counts.by_kind.begin(), counts.by_kind.end(), std::int64_t{0});
  return static_cast<double>(n_exact) / static_cast<double>(std::max<std::int64_t>(1, n));
}

ExitCode run_soft_shadow(const SoftShadowArguments& arguments, const CommonOptions& common,
                         Report& report) {
  report.add_input(arguments.scene);
  check_arguments(arguments);
  report.add_requested("method", std::string(to_string(arguments.options.method)));
  report.add_requested("light_shape", std::string(to_string(arguments.shape)));
  report.add_requested("max_error", arguments.options.max_error);
  auto begin = Clock::now();
  LitScene lit = read_lit(arguments, report);
  report.add_detail("read_seconds", seconds_since(begin));
  if (!arguments.cameras.empty()) {
    report.add_input(arguments.cameras);
  }
  const std::vector<View> views = views_of(lit.file, arguments, common.force);
  for (const View& view : views) {
    require_memory(lit.file, view.camera, lit.lights.size(), arguments, common);
  }
  begin = Clock::now();
  lit.caster.emplace(lit.file.scene);
  report.add_detail("tree_seconds", seconds_since(begin));
  begin = Clock::now();
  lit.edges = render::occluder_edges(lit.file.scene.meshes);
  report.add_detail("edge_seconds", seconds_since(begin));
  Progress progress("lights", lit.lights.size() * views.size(), common.progress());
  PhaseSeconds seconds;
  render::ShadowCounts counts;
  std::uint64_t bytes = 0;
  bool is_missed = false;
  for (const View& view : views) {
    begin = Clock::now();
    const SeenPoints seen = seen_points(view, *lit.caster);
    seconds.camera.push_back(seconds_since(begin));
    const AllShadows all =
        shadows_of(lit, arguments, view, seen, &view == &views.back(), progress);
    begin = Clock::now();
    write_pictures(all.pictures, lit.led_numbers, view, arguments.comparison);
    seconds.picture.push_back(seconds_since(begin));
    seconds.grid.push_back(all.counts.grid_seconds);
    seconds.shadow.push_back(all.counts.shadow_seconds);
    bytes += std::filesystem::file_size(view.output);
    is_missed = is_missed || is_error_missed(all.counts, arguments.options);
    add_view(all.counts, counts);
    if (all.errors) {
      report_errors(*all.errors, all.exact_seconds, report);
    }
    print_result(arguments, view, all, 100.0 * exact_fraction_of(all.counts));
  }
  report_counts(counts, arguments.options, report);
  report_seconds(seconds, report);
  report.set_bytes(bytes);
  if (arguments.options.method == render::ShadowMethod::exact) {
    report.add_achieved("exact_fraction", exact_fraction_of(counts));
  }
  return is_missed ? ExitCode::target_missed : ExitCode::done;
}

}  // namespace

void add_render_soft_shadow(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<SoftShadowArguments>();
  Command verb =
      root.add_verb("soft-shadow", "Which fraction of each light a scene's points see");
  verb.option(
      "SCENE", &arguments->scene,
      "Scene file with a [camera] and lights that are disks or quads; with --rig also an "
      "object's mesh, .obj or .ply, over the rig's planes",
      {.type = "SCENE.toml", .is_required = true});
  verb.option("-o,--output", &arguments->output,
              "Picture to write: .exr, the visibility, 0 to 1, with how each was found as a "
              "further channel; of several lights their mean, and each of them; .tif; .png",
              {.type = "PICTURE", .is_required = true});
  verb.option(
      "--map", &arguments->map,
      "Also show how each value was found: grey whole, green one edge, blue several (all "
      "three exact), violet by the method's assumption, red unsure, orange traced",
      {.type = "PICTURE"});
  verb.option(
      "--method", &arguments->options.method,
      "exact; or, to be compared with it: rays, shadow rays at every point; "
      "point-silhouette, edges as the light's centre sees them; d-buffer, one edge per texel; "
      "paper, that as first published",
      {.shows_default = true});
  verb.option(
      "--cameras", &arguments->cameras,
      "A picture for each [[camera]] of this file, instead of the scene's own: OUT-0000 ...; "
      "what does not depend on the camera is made once",
      {.type = "CAMERAS.toml"});
  verb.option(
      "--compare", &arguments->comparison,
      "Also compute the exact values; tell the errors and draw them: red too light, blue too "
      "dark",
      {.type = "PICTURE", .excludes = "--cameras"});
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
  verb.option(
      "--max-error", &arguments->options.max_error,
      "Of values that are traced, in the mean and for 99 % of those in the penumbra: a sample "
      "of them finds the rays that it takes. Exit code 1 where 256x256, the most, do not reach "
      "it; the picture is written all the same",
      {.type = "E", .bounds = Bounds{5e-4, 0.25}, .shows_default = true});
  verb.option(
      "--strata", &arguments->options.strata,
      "NxN rays to each value that is traced, whatever their error (default: by --max-error)",
      {.type = "N", .bounds = Bounds{1, 256}});
  verb.option("--d-buffer", &arguments->options.texels, "Texels of a D-buffer, across and down",
              {.type = "N", .bounds = Bounds{1, 4096}, .shows_default = true});
  verb.option("--visibility", &arguments->options.form,
              "A D-buffer's V(t): exact, a segment of the disk; cubic, 3t^2 - 2t^3; linear, t",
              {.shows_default = true});
  verb.option("--grid", &arguments->options.grid,
              "Cells of a light's list of edges, across and down: time and memory only",
              {.type = "N", .bounds = Bounds{1, 4096}, .shows_default = true});
  verb.footer(
      "Example:\n  haarlight render soft-shadow configs/scenes/cornell.toml -o soft.exr --map "
      "soft-map.png\n  haarlight render soft-shadow configs/scenes/airplane.toml --rig "
      "configs/rigs/small8.toml --light 3 -o under-led.exr\n  haarlight render soft-shadow "
      "configs/scenes/soft_shadow_two.toml --method paper --compare paper-errors.png -o "
      "paper.exr\n  haarlight render soft-shadow configs/scenes/soft_shadow_two.toml --cameras "
      "configs/scenes/two_cameras.toml -o seen.exr");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_soft_shadow(*arguments, common, report);
  });
}

}  // namespace haarlight::apps
