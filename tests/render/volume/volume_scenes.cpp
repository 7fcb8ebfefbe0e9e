// SPDX-License-Identifier: Apache-2.0
#include "tests/render/volume/volume_scenes.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <map>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "render/volume/segment.h"
#include "tests/golden_file.h"

namespace haarlight::render::test {

using Eigen::Array3d;
using Eigen::Vector3d;

namespace {

void add_tetrahedron(CellMesh& mesh, std::array<std::uint32_t, 4> nodes) {
  const auto at = [&](std::size_t i) { return mesh.points[nodes.at(i)]; };
  if ((at(1) - at(0)).cross(at(2) - at(0)).dot(at(3) - at(0)) < 0.0) {
    std::swap(nodes[1], nodes[2]);
  }
  mesh.types.push_back(CellType::tetrahedron);
  mesh.begins.push_back(mesh.nodes.size());
  mesh.nodes.insert(mesh.nodes.end(), nodes.begin(), nodes.end());
}

/// Corners of a cube by three bits: x, y, z.
using CubeCorners = std::array<std::uint32_t, 8>;
void add_six(CellMesh& mesh, const CubeCorners& corners) {
  for (const std::array<unsigned, 2> way :
       {std::array{1U, 3U}, {1U, 5U}, {2U, 3U}, {2U, 6U}, {4U, 5U}, {4U, 6U}}) {
    add_tetrahedron(mesh, {corners[0], corners.at(way[0]), corners.at(way[1]), corners[7]});
  }
}
void add_five(CellMesh& mesh, const CubeCorners& corners, bool is_mirrored) {
  const unsigned flip = is_mirrored ? 1U : 0U;
  const auto at = [&](unsigned i) { return corners.at(i ^ flip); };
  add_tetrahedron(mesh, {at(0), at(3), at(5), at(6)});
  for (const std::array<unsigned, 4> cell :
       {std::array{1U, 0U, 3U, 5U}, {2U, 0U, 3U, 6U}, {4U, 0U, 5U, 6U}, {7U, 3U, 5U, 6U}}) {
    add_tetrahedron(mesh, {at(cell[0]), at(cell[1]), at(cell[2]), at(cell[3])});
  }
}

/// Calls add(corners, x + y + z) for each of n^3 cubes of a mesh that has its points.
template <class Add>
void for_each_cube(std::size_t n, CellMesh& mesh, const Add& add) {
  const auto number = [n](std::size_t x, std::size_t y, std::size_t z) {
    return static_cast<std::uint32_t>(x + (n + 1) * (y + (n + 1) * z));
  };
  for (std::size_t z = 0; z <= n; ++z) {
    for (std::size_t y = 0; y <= n; ++y) {
      for (std::size_t x = 0; x <= n; ++x) {
        mesh.points.emplace_back(
            Vector3d(static_cast<double>(x), static_cast<double>(y), static_cast<double>(z)) /
            static_cast<double>(n));
      }
    }
  }
  for (std::size_t z = 0; z < n; ++z) {
    for (std::size_t y = 0; y < n; ++y) {
      for (std::size_t x = 0; x < n; ++x) {
        CubeCorners corners{};
        for (std::size_t i = 0; i < corners.size(); ++i) {
          corners.at(i) = number(x + (i & 1U), y + ((i >> 1U) & 1U), z + (i >> 2U));
        }
        add(corners, x + y + z);
      }
    }
  }
}

void add_cell(CellMesh& mesh, CellType type, std::span<const std::uint32_t> nodes) {
  mesh.types.push_back(type);
  mesh.begins.push_back(mesh.nodes.size());
  mesh.nodes.insert(mesh.nodes.end(), nodes.begin(), nodes.end());
}

/// Each cell with the further nodes of a type of the same corners, where straight edges have them.
CellMesh with_nodes_of(CellType type, const CellMesh& linear) {
  const CellShape& shape = shape_of(type);
  CellMesh mesh;
  mesh.points = linear.points;
  // By the corners between which a node is, and how often it counts each.
  std::map<std::vector<std::pair<std::uint32_t, std::size_t>>, std::uint32_t> known;
  for (std::size_t i = 0; i < linear.n_cells(); ++i) {
    const std::span<const std::uint32_t> corners = linear.nodes_of(i);
    std::vector<std::uint32_t> nodes(shape.n_nodes);
    std::ranges::copy(corners, nodes.begin());
    const auto set_node = [&](std::size_t node,
                              std::vector<std::pair<std::uint32_t, std::size_t>> between) {
      std::ranges::sort(between);
      const auto [place, is_new] =
          known.try_emplace(between, static_cast<std::uint32_t>(mesh.points.size()));
      if (is_new) {
        Vector3d sum = Vector3d::Zero();
        double n = 0.0;
        for (const auto& [corner, times] : between) {
          sum += static_cast<double>(times) * mesh.points[corner];
          n += static_cast<double>(times);
        }
        mesh.points.emplace_back(sum / n);
      }
      nodes[node] = place->second;
    };
    for (std::size_t e = 0; e < shape.edges.size(); ++e) {
      const auto [a, b] = shape.edges[e];
      for (std::size_t k = 0; k < shape.on_edge; ++k) {
        set_node(shape.n_corners + shape.on_edge * e + k,
                 {{corners[a], shape.on_edge - k}, {corners[b], k + 1}});
      }
    }
    for (std::size_t side = 0; side < shape.in_faces.size(); ++side) {
      std::vector<std::pair<std::uint32_t, std::size_t>> between;
      for (const std::uint8_t corner : shape.faces[side]) {
        if (corner != kNone) {
          between.emplace_back(corners[corner], 1);
        }
      }
      set_node(shape.in_faces[side], between);
    }
    if (shape.centre != kNone) {
      std::vector<std::pair<std::uint32_t, std::size_t>> between;
      for (const std::uint32_t corner : corners) {
        between.emplace_back(corner, 1);
      }
      set_node(shape.centre, between);
    }
    add_cell(mesh, type, nodes);
  }
  return mesh;
}

}  // namespace

CellMesh cube_of_tetrahedra(std::size_t n, Split split) {
  CellMesh mesh;
  for_each_cube(n, mesh, [&](const CubeCorners& corners, std::size_t number) {
    if (split == Split::six) {
      add_six(mesh, corners);
    } else {
      add_five(mesh, corners, number % 2 == 1);
    }
  });
  return mesh;
}

CellMesh cube_of(CellType type, std::size_t n) {
  if (shape_of(type).may_bend()) {
    return with_nodes_of(type, cube_of(shape_of(type).linear, n));
  }
  if (type == CellType::tetrahedron) {
    return cube_of_tetrahedra(n);
  }
  CellMesh mesh;
  for_each_cube(n, mesh, [&](const CubeCorners& c, std::size_t) {
    const std::array<std::uint32_t, 8> hexahedron = {c[0], c[1], c[3], c[2],
                                                     c[4], c[5], c[7], c[6]};
    if (type == CellType::hexahedron) {
      add_cell(mesh, type, hexahedron);
    } else if (type == CellType::wedge) {
      add_cell(mesh, type, std::array{c[0], c[1], c[3], c[4], c[5], c[7]});
      add_cell(mesh, type, std::array{c[0], c[3], c[2], c[4], c[7], c[6]});
    } else {
      const auto tip = static_cast<std::uint32_t>(mesh.points.size());
      mesh.points.emplace_back(0.5 * (mesh.points[c[0]] + mesh.points[c[7]]));
      for (const std::array<std::uint8_t, 4>& face : shape_of(CellType::hexahedron).faces) {
        // Anticlockwise seen from the tip: a face's other way round.
        add_cell(mesh, type,
                 std::array{hexahedron.at(face[3]), hexahedron.at(face[2]),
                            hexahedron.at(face[1]), hexahedron.at(face[0]), tip});
      }
    }
  });
  return mesh;
}

ScalarField linear_field(const CellMesh& mesh) {
  ScalarField field{.name = "linear", .is_per_cell = false, .values = {}};
  for (const Vector3d& point : mesh.points) {
    field.values.push_back((point.x() + 2.0 * point.y() + 3.0 * point.z()) / 6.0);
  }
  return field;
}

void set_transfer(Transfer transfer, VolumeScene& scene) {
  const Array3d blue(0.1, 0.2, 0.9);
  const Array3d orange(1.0, 0.6, 0.1);
  switch (transfer) {
    case Transfer::hills:
      scene.density = {{0.0, 0.3, 0.55, 0.8, 1.0}, {0.25, 4.5, 0.5, 5.0, 1.0}};
      scene.colour = {
          {0.0, 0.3, 0.55, 0.8, 1.0},
          {blue, {0.9, 0.1, 0.2}, {0.2, 0.9, 0.3}, {1.0, 0.9, 0.1}, {0.3, 0.3, 1.0}}};
      break;
    case Transfer::spikes:
      scene.density = {{0.0, 0.25, 0.3, 0.35, 0.65, 0.7, 0.75, 1.0},
                       {0.0, 0.0, 20.0, 0.0, 0.0, 20.0, 0.0, 0.0}};
      scene.colour = {{0.0, 1.0}, {blue, orange}};
      break;
    case Transfer::nearly_constant:
      scene.density = {{0.0, 1.0}, {2.25, 2.25000675}};
      scene.colour = {{0.0, 1.0}, {blue, orange}};
      break;
  }
}

std::vector<GoldenRay> golden_rays(const std::string& field) {
  const nlohmann::json golden = haarlight::test::read_golden("volume_segments.json");
  const auto vector_of = [](const nlohmann::json& list) {
    return Vector3d(list.at(0).get<double>(), list.at(1).get<double>(),
                    list.at(2).get<double>());
  };
  const auto number = [](const nlohmann::json& text) {
    return std::strtod(text.get<std::string>().c_str(), nullptr);
  };
  const auto colour = [&](const nlohmann::json& list) {
    return Array3d(number(list.at(0)), number(list.at(1)), number(list.at(2)));
  };
  std::vector<GoldenRay> rays;
  for (const auto& item : golden.at("box_rays")) {
    if (item.at("field") != field) {
      continue;
    }
    const nlohmann::json& function =
        golden.at("transfer_functions").at(item.at("transfer_function").get<std::string>());
    std::vector<double> of_density;
    std::vector<double> extinctions;
    for (const auto& row : function.at("den")) {
      of_density.push_back(row.at(0));
      extinctions.push_back(row.at(1).get<double>() / function.at("unit").get<double>());
    }
    std::vector<double> of_colour;
    std::vector<Array3d> colours;
    for (const auto& row : function.at("col")) {
      of_colour.push_back(row.at(0));
      colours.emplace_back(vector_of(row.at(1)).array());
    }
    rays.push_back({.origin = vector_of(item.at("O")),
                    .direction = vector_of(item.at("D")),
                    .projection = item.at("projection") == "parallel" ? Projection::parallel
                                                                      : Projection::perspective,
                    .density = {of_density, extinctions},
                    .colour = {of_colour, colours},
                    .of_chromaticity = colour(item.at("rgb_wm")),
                    .of_glow = colour(item.at("rgb_wvg")),
                    .opacity = number(item.at("opacity"))});
  }
  return rays;
}

double relative_error(const GoldenRay& ray, VolumeScene& scene) {
  scene.density = ray.density;
  scene.colour = ray.colour;
  look_along(ray.origin, ray.direction, ray.projection, scene);
  double worst = 0.0;
  for (const Glow glow : {Glow::chromaticity, Glow::own}) {
    scene.glow = glow;
    const VolumeLight light = render(scene).front();
    const Array3d& truth = glow == Glow::own ? ray.of_glow : ray.of_chromaticity;
    worst = std::max({worst, (light.light / truth - 1.0).abs().maxCoeff(),
                      std::abs(light.opacity / ray.opacity - 1.0)});
  }
  return worst;
}

VolumeScene scene_of(CellMesh mesh) {
  VolumeScene scene;
  scene.mesh_file = "cube.vtu";
  scene.density_field = scene.colour_field = linear_field(mesh);
  scene.mesh = std::move(mesh);
  set_transfer(Transfer::hills, scene);
  scene.camera.width = scene.camera.height = 1;
  scene.camera.cx = scene.camera.cy = 0.5;
  return scene;
}

void look_along(const Vector3d& origin, const Vector3d& direction, Projection projection,
                VolumeScene& scene) {
  scene.camera.world_from_cam.linear() =
      Eigen::Quaterniond::FromTwoVectors(Vector3d::UnitZ(), direction).toRotationMatrix();
  scene.camera.world_from_cam.translation() = origin;
  scene.optics.pixel_mm = projection == Projection::parallel ? 1.0 : 0.0;
}

std::vector<VolumeLight> render(const VolumeScene& scene, const VolumeOptions& options) {
  const VolumeRayCaster caster(scene, options);
  std::vector<VolumeLight> picture = picture_by(caster, scene);
  caster.require_no_overlap();
  return picture;
}

std::vector<VolumeLight> picture_by(const TileRenderer& renderer, const VolumeScene& scene) {
  Film film(scene.camera.width, scene.camera.height, VolumeRayCaster::layers());
  RunOptions run_options;
  run_options.samples = 1;
  static_cast<void>(run(renderer, run_options, film));
  std::vector<VolumeLight> picture(static_cast<std::size_t>(film.width()) *
                                   static_cast<std::size_t>(film.height()));
  for (std::size_t i = 0; i < film.n_tiles(); ++i) {
    const FilmTile tile = film.take(i);
    const double* sums = tile.sums().data();
    const std::size_t per_pixel =
        tile.sums().size() / (static_cast<std::size_t>(tile.area().width()) *
                              static_cast<std::size_t>(tile.area().height()));
    for (int y = tile.area().y0; y < tile.area().y1; ++y) {
      for (int x = tile.area().x0; x < tile.area().x1; ++x, sums += per_pixel) {
        picture[static_cast<std::size_t>(y) * static_cast<std::size_t>(film.width()) +
                static_cast<std::size_t>(x)] = {
            .light = {sums[0], sums[1], sums[2]}, .opacity = sums[3], .depth = sums[4]};
      }
    }
  }
  return picture;
}

namespace {

ProjectedPicture project(const CellProjection& projection, const VolumeScene& scene) {
  ProjectedPicture picture;
  picture.pixels = picture_by(projection, scene);
  picture.counts = projection.counts();
  EXPECT_EQ(picture.counts.violations == 0, projection.violation().empty());
  return picture;
}

}  // namespace

ProjectedPicture project(const VolumeScene& scene, SmallCells small_cells) {
  return project(CellProjection(scene, small_cells), scene);
}
ProjectedPicture project(const VolumeScene& scene, const VisibilityOrder& order) {
  return project(CellProjection(scene, order), scene);
}

std::vector<VolumeLight> preview(const VolumeScene& scene, const PreviewOptions& options) {
  const PreviewMesh mesh(scene);
  return picture_by(ProjectedTetrahedra(mesh, options), scene);
}

CellMesh torn(const CellMesh& mesh) {
  CellMesh made = mesh;
  made.points.clear();
  for (std::size_t i = 0; i < mesh.nodes.size(); ++i) {
    made.points.push_back(mesh.points[mesh.nodes[i]]);
    made.nodes[i] = static_cast<std::uint32_t>(i);
  }
  return made;
}

CellMesh chosen(const CellMesh& mesh, const std::vector<std::size_t>& cells) {
  CellMesh made;
  made.points = mesh.points;
  for (const std::size_t cell : cells) {
    add_cell(made, mesh.types[cell], mesh.nodes_of(cell));
  }
  return made;
}

std::pair<double, double> within_cube(const Vector3d& origin, const Vector3d& direction) {
  double near = 0.0;
  double far = 1e300;
  for (int axis = 0; axis < 3; ++axis) {
    const double a = -origin[axis] / direction[axis];
    const double b = (1.0 - origin[axis]) / direction[axis];
    if (direction[axis] != 0.0) {
      near = std::max(near, std::min(a, b));
      far = std::min(far, std::max(a, b));
    } else if (!(origin[axis] > 0.0 && origin[axis] < 1.0)) {
      return {1.0, 0.0};
    }
  }
  return {near, far};
}

VolumeLight light_within_cube(const VolumeScene& scene, const Vector3d& origin,
                              const Vector3d& direction, double near, double far) {
  const auto [enters, leaves] = within_cube(origin, direction);
  near = std::max(near, enters);
  far = std::min(far, leaves);
  VolumeLight sum;
  if (!(far > near)) {
    return sum;
  }
  const auto field = [&](double t) {
    const Vector3d at = origin + t * direction;
    return (at.x() + 2.0 * at.y() + 3.0 * at.z()) / 6.0;
  };
  const double slope = (direction.x() + 2.0 * direction.y() + 3.0 * direction.z()) / 6.0;
  std::vector<double> ends = {near, far};
  for (const std::span<const double> breakpoints :
       {scene.density.breakpoints(), scene.colour.breakpoints()}) {
    for (const double value : breakpoints) {
      const double t = (value - field(0.0)) / slope;
      if (t > near && t < far) {
        ends.push_back(t);
      }
    }
  }
  std::ranges::sort(ends);
  double transparency = 1.0;
  for (std::size_t i = 0; i + 1 < ends.size(); ++i) {
    const double length = (ends[i + 1] - ends[i]) * direction.norm();
    const double middle = field(0.5 * (ends[i] + ends[i + 1]));
    const std::size_t density = scene.density.part_of(middle);
    const std::size_t colour = scene.colour.part_of(middle);
    const SegmentWeights weights = segment_weights(
        std::max(0.0, scene.density.in_part(density, field(ends[i]))),
        std::max(0.0, scene.density.in_part(density, field(ends[i + 1]))), length);
    const EndWeights& of_ends =
        scene.glow == Glow::own ? weights.of_glow : weights.of_chromaticity;
    const double scale = transparency * (scene.glow == Glow::own ? length : 1.0);
    sum.light += scale * (of_ends.near * scene.colour.in_part(colour, field(ends[i])) +
                          of_ends.far * scene.colour.in_part(colour, field(ends[i + 1])));
    sum.opacity += transparency * weights.opacity;
    transparency *= weights.transparency;
  }
  return sum;
}

std::pair<Vector3d, Vector3d> pixel_ray(const VolumeScene& scene, int x, int y) {
  const CameraModel& camera = scene.camera;
  const Eigen::Vector2d off_axis(x + 0.5 - camera.cx, y + 0.5 - camera.cy);
  if (scene.optics.pixel_mm > 0.0) {
    return {camera.world_from_cam * Vector3d(scene.optics.pixel_mm * off_axis.x(),
                                             scene.optics.pixel_mm * off_axis.y(), 0.0),
            camera.world_from_cam.linear().col(2)};
  }
  return {camera.centre_world(),
          camera.world_from_cam.linear() *
              Vector3d(off_axis.x() / camera.fx, off_axis.y() / camera.fy, 1.0)};
}

double difference(const std::vector<VolumeLight>& a, const std::vector<VolumeLight>& b) {
  double worst = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    worst = std::max({worst, (a[i].light - b[i].light).abs().maxCoeff(),
                      std::abs(a[i].opacity - b[i].opacity)});
  }
  return worst;
}

void look_at_cube(const Vector3d& eye, int side, VolumeScene& scene) {
  scene.camera.width = scene.camera.height = side;
  scene.camera.cx = scene.camera.cy = 0.5 * side;
  scene.camera.fx = scene.camera.fy = 1.6 * side;
  scene.camera.world_from_cam = look_at(eye, Vector3d::Constant(0.5), Vector3d(0.1, 0.2, 1.0));
}

double error_of_cube(const VolumeScene& scene, const std::vector<VolumeLight>& picture) {
  const double near = scene.optics.near_mm;
  const double far = scene.optics.far_mm > 0.0 ? scene.optics.far_mm : 1e300;
  double worst = 0.0;
  for (int y = 0; y < scene.camera.height; ++y) {
    for (int x = 0; x < scene.camera.width; ++x) {
      const auto [origin, direction] = pixel_ray(scene, x, y);
      const VolumeLight truth = light_within_cube(scene, origin, direction, near, far);
      const VolumeLight& light = pixel_of(picture, scene, x, y);
      worst = std::max({worst, (light.light - truth.light).abs().maxCoeff(),
                        std::abs(light.opacity - truth.opacity)});
    }
  }
  return worst;
}

}  // namespace haarlight::render::test
