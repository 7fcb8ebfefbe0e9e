// SPDX-License-Identifier: Apache-2.0
#include "render/soft_shadow/soft_shadow_methods.h"

#include <array>
#include <numbers>
#include <utility>

#include "render/soft_shadow/circle_polygon.h"
#include "render/soft_shadow/soft_shadow.h"

namespace haarlight::render {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kRadius = 30.0;
constexpr double kHeight = 300.0;  // of the lamp
constexpr double kSheet = 150.0;   // height of the sheet

/// The floor under a level sheet of 80 mm x 44 mm and a round lamp of 60 mm: past its corners two edges
/// part the lamp, across its shorter side two that are parallel.
class UnderASheet {
 public:
  using Result = std::vector<double>;

  explicit UnderASheet(MethodSize size) : scene_(sheet()), caster_(scene_) {
    const int side = by_size(size, 48, 192, 512);
    for (int row = 0; row < side; ++row) {
      for (int col = 0; col < side; ++col) {
        points_.emplace_back(((col + 0.5) / side - 0.5) * 200.0,
                             ((row + 0.5) / side - 0.5) * 200.0, 0.0);
      }
    }
  }

  [[nodiscard]] Result run(std::size_t setting) const {
    const std::array<SoftShadowOptions, 5> settings = {{
        {.method = ShadowMethod::paper},
        {.method = ShadowMethod::d_buffer},
        {.method = ShadowMethod::rays, .strata = 8},
        {.method = ShadowMethod::rays, .strata = 32},
        {},
    }};
    const OccluderEdges edges = occluder_edges(scene_.meshes);
    SoftShadow soft(scene_, edges, caster_,
                    flat_lights(scene_, LightShape::own, "methods").front(),
                    settings.at(setting), "methods");
    std::vector<LightShadow> shadows(points_.size());
    soft.evaluate(points_, shadows);
    Result found;
    for (const LightShadow& shadow : shadows) {
      found.push_back(shadow.visibility);
    }
    return found;
  }

  /// The sheet's image on the lamp, seen from the floor: moved by the point, and larger.
  [[nodiscard]] Result truth() const {
    Result found;
    for (const Vector3d& x : points_) {
      std::array<Vector2d, 4> image;
      for (std::size_t c = 0; c < 4; ++c) {
        const Vector2d corner = kCorners.at(c).head<2>();
        image.at(c) = (x.head<2>() + (corner - x.head<2>()) * (kHeight / kSheet)) / kRadius;
      }
      found.push_back(1.0 - unit_disk_intersection(image) / std::numbers::pi);
    }
    return found;
  }
  [[nodiscard]] double error(const Result& found, const Result& truth) const {
    return relative_l2(found, truth);
  }
  [[nodiscard]] MethodScale scale() const {
    return {1, static_cast<long long>(points_.size())};
  }

 private:
  inline static const std::array<Vector3d, 4> kCorners = {
      Vector3d(-40, -22, kSheet), Vector3d(40, -22, kSheet), Vector3d(40, 22, kSheet),
      Vector3d(-40, 22, kSheet)};

  [[nodiscard]] static Scene sheet() {
    Scene scene;
    scene.materials.resize(2);
    scene.materials[1].emits = Vector3d::Ones();
    scene.disks.push_back({.centre = {0, 0, kHeight},
                           .normal = -Vector3d::UnitZ(),
                           .radius_mm = kRadius,
                           .material = 1});
    scene.meshes.push_back(make_quad(kCorners[0], kCorners[1], kCorners[2], kCorners[3], 0));
    return scene;
  }

  Scene scene_;
  RayCaster caster_;
  std::vector<Vector3d> points_;
};

}  // namespace

std::vector<Method> soft_shadow_methods() {
  return {Method::of<UnderASheet>(
      {.module = "render/soft_shadow",
       .name = "soft shadow of a sheet under a round lamp",
       .settings = {"--method paper", "--method d-buffer", "--method rays --strata 8",
                    "--method rays --strata 32", "--method exact"},
       .error_norm = "relative L2 of the visibility",
       .truth = "closed form: a disk less a quadrilateral",
       .exact_error = 1e-6,
       .exact_error_from = "areas of less than 1e-7 are left out; values are floats"})};
}

}  // namespace haarlight::render
