// SPDX-License-Identifier: Apache-2.0
#include "render/volume/volume_hash.h"

#include <cstddef>
#include <span>
#include <type_traits>

#include "haarlight/core/files.h"

namespace haarlight::render {

namespace {

class Hasher {
 public:
  template <class Number>
  void add(Number number) {
    static_assert(std::is_arithmetic_v<Number> || std::is_enum_v<Number>);
    hash_.add(std::as_bytes(std::span<const Number, 1>(&number, 1)));
  }
  void add(const Eigen::Array3d& rgb) { hash_.add(std::as_bytes(std::span(rgb.data(), 3))); }
  /// With its length: two lists are not another two with the same bytes.
  template <class Element>
  void add_all(std::span<const Element> list) {
    add(list.size());
    hash_.add(std::as_bytes(list));
  }
  void add(const ScalarField& field) {
    add(field.is_per_cell);
    add_all(std::span(field.values));
  }
  void add(const Image<float>& picture) {
    add(picture.width());
    add(picture.height());
    add_all(picture.pixels());
  }
  [[nodiscard]] std::string text() const { return hash_.text(); }

 private:
  ContentHash hash_;
};

std::string hash_of_mesh(const VolumeScene& scene) {
  static_assert(sizeof(Eigen::Vector3d) == 3 * sizeof(double));
  Hasher hash;
  hash.add_all(std::span(scene.mesh.points));
  hash.add_all(std::span(scene.mesh.types));
  hash.add_all(std::span(scene.mesh.nodes));
  hash.add(scene.density_field);
  hash.add(scene.colour_field);
  hash.add(scene.contour_field);
  return hash.text();
}

std::string hash_of_looks(const VolumeScene& scene) {
  Hasher hash;
  hash.add_all(scene.density.breakpoints());
  hash.add_all(std::span(scene.density.values()));
  hash.add_all(scene.colour.breakpoints());
  for (const Eigen::Array3d& colour : scene.colour.values()) {
    hash.add(colour);
  }
  hash.add(scene.glow);
  hash.add(scene.contours.size());
  for (const Contour& contour : scene.contours) {
    hash.add(contour.value);
    hash.add(contour.colour);
    for (const double number : {contour.opacity, contour.ambient, contour.diffuse,
                                contour.specular, contour.exponent}) {
      hash.add(number);
    }
  }
  return hash.text();
}

std::string hash_of_behind(const VolumeScene& scene) {
  const Background& background = scene.background;
  Hasher hash;
  hash.add(background.kind);
  hash.add(background.colour);
  hash.add(background.other);
  hash.add(background.square_px);
  hash.add(background.picture);
  hash.add(scene.surfaces.has_value());
  if (scene.surfaces) {
    hash.add(scene.surfaces->light);
    hash.add(scene.surfaces->depth);
  }
  return hash.text();
}

std::string hash_of_camera(const VolumeScene& scene) {
  const CameraModel& camera = scene.camera;
  Hasher hash;
  hash.add(camera.width);
  hash.add(camera.height);
  for (const double number : {camera.fx, camera.fy, camera.cx, camera.cy, scene.optics.pixel_mm,
                              scene.optics.near_mm, scene.optics.far_mm}) {
    hash.add(number);
  }
  const Eigen::Matrix4d world_from_cam = camera.world_from_cam.matrix();
  hash.add_all(std::span<const double>(world_from_cam.data(), 16));
  return hash.text();
}

}  // namespace

VolumeHashes hashes_of(const VolumeScene& scene) {
  return {.mesh = hash_of_mesh(scene),
          .looks = hash_of_looks(scene),
          .behind = hash_of_behind(scene),
          .camera = hash_of_camera(scene)};
}

}  // namespace haarlight::render
