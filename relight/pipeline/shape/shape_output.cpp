// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/shape/shape_output.h"

#include <algorithm>

#include "haarlight/relight/shape/normal_picture.h"
#include "relight/pipeline/display_exposure.h"

namespace haarlight::relight {

namespace {

namespace fs = std::filesystem;

constexpr double kWhiteSigmaDeg = 20.0;  // sigma.png: white is this or more
constexpr double kShownFraction = 0.99;  // of the known values, not clipped in a .png

Image<float> as_picture(const Image<std::uint8_t>& mask) {
  Image<float> picture(mask.height(), mask.width(), 1);
  std::transform(mask.pixels().begin(), mask.pixels().end(), picture.pixels().begin(),
                 [](std::uint8_t value) { return value != 0 ? 1.0F : 0.0F; });
  return picture;
}

/// Outputs that only a measured shape has.
void write_measured(const ShapeSummary& summary, const fs::path& folder) {
  const SurfaceEstimate& surface = summary.shape.surface;
  const PictureNotes& notes = summary.photographed;
  write_image(folder / "albedo.exr", surface.albedo.view(), 1.0, notes);
  write_image(folder / "error.exr", surface.error.view(), 1.0, notes);
  write_image(folder / "error.png", surface.error.view(),
              display_exposure(known_values(surface.error, surface.is_good()), kShownFraction),
              notes);
  write_image(folder / "sigma.exr", surface.sigma_deg.view(), 1.0, notes);
  write_image(folder / "sigma.png", surface.sigma_deg.view(), 1.0 / kWhiteSigmaDeg, notes);
  write_image(folder / "mask.png", as_picture(summary.mask.mask).view(), 1.0, notes);
}

/// @param exposure  of the albedo, as in `picture` next to the mesh
void write_meshes(const ShapePipelineOptions& options, const ShapeSummary& summary,
                  double exposure, const char* picture) {
  const Shape& shape = summary.shape;
  SurfaceMeshOptions mesh_options;
  mesh_options.max_tilt_deg = options.max_tilt_deg;
  mesh_options.towards =
      summary.pixels.picture_from_world().transpose() * Eigen::Vector3d::UnitZ();
  Image<float> colour = shape.surface.albedo;
  for (float& value : colour.pixels()) {
    value *= static_cast<float>(exposure);
  }
  const ImageView<const std::uint8_t> cuts = options.is_open_at_cuts || !options.hull.empty()
                                                 ? shape.map.is_cut.view()
                                                 : ImageView<const std::uint8_t>();
  const render::SurfaceMesh mesh =
      make_surface_mesh(shape.points.view(), shape.map.is_known.view(), cuts,
                        shape.surface.normal.view(), colour.view(), mesh_options);
  if (options.writes_ply) {
    render::write_ply(mesh, options.out / "mesh.ply");
  }
  if (options.writes_obj) {
    render::write_obj(mesh, options.out / "mesh.obj", picture);
  }
}

}  // namespace

std::vector<float> known_values(const Image<float>& picture, const Image<std::uint8_t>& known) {
  std::vector<float> values;
  for (int y = 0; y < picture.height(); ++y) {
    for (int x = 0; x < picture.width(); ++x) {
      for (int c = 0; known(y, x) != 0 && c < picture.channels(); ++c) {
        values.push_back(picture(y, x, c));
      }
    }
  }
  return values;
}

std::uint64_t write_shape(const ShapePipelineOptions& options, const ShapeSummary& summary) {
  const fs::path& folder = options.out;
  fs::create_directories(folder);
  const PictureNotes& notes = summary.photographed;
  const SurfaceEstimate& surface = summary.shape.surface;
  const char* picture = summary.is_measured ? "albedo.png" : "front.png";
  const Image<float> normals =
      turned_normals(surface.normal.view(), summary.pixels.picture_from_world());
  write_image(folder / "normals.png", normal_map(normals.view()).view(), 1.0, notes);
  write_image(folder / "normals.exr", normals.view(), 1.0, notes);
  const double exposure =
      display_exposure(known_values(surface.albedo, surface.is_good()), kShownFraction);
  write_image(folder / picture, surface.albedo.view(), exposure, notes);
  if (summary.is_measured) {
    write_measured(summary, folder);
  }
  write_image(folder / "height.tif", summary.shape.height.view());
  write_image(folder / "height.exr", summary.shape.height.view(), 1.0, notes);
  EnhancedLook look;
  look.light = options.preview;
  write_image(folder / "preview.png",
              enhanced_picture(normals.view(), surface.albedo.view(), look).view(), 1.0, notes);
  if (options.writes_ply || options.writes_obj) {
    write_meshes(options, summary, exposure, picture);
  }
  std::uint64_t bytes = 0;
  for (const fs::directory_entry& file : fs::directory_iterator(folder)) {
    bytes += file.file_size();
  }
  return bytes;
}

}  // namespace haarlight::relight
