// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "render/film/film.h"
#include "render/volume/volume_scene.h"

/// @file
/// A tetrahedron as a fan of triangles about its thick point, composited into a tile of pixels.

namespace haarlight::render {

enum class Preview : std::uint8_t;

/// Products of a length, an extinction and a colour stay finite in float below it.
inline constexpr double kLargestInPreview = 1e18;
[[nodiscard]] inline float bounded_float(double value) {
  return static_cast<float>(std::clamp(value, -kLargestInPreview, kLargestInPreview));
}

/// A corner of a tetrahedron on the picture, and what the medium is there.
struct FanCorner {
  double x = 0.0;  ///< pixels, centres at whole numbers
  double y = 0.0;
  double z = 0.0;              ///< mm along the camera's axis
  double density_value = 0.0;  ///< of the fields
  double colour_value = 0.0;
  float extinction = 0.0F;  ///< 1/mm
  Eigen::Array3f colour = Eigen::Array3f::Zero();
};

/// A tile's pixels, while a single thread works on them: tetrahedra from the nearest on.
class FanTile {
 public:
  /// @param area  at most Film::kTile wide and high
  FanTile(const VolumeScene& scene, Preview method, const Tile& area);

  void add(const std::array<FanCorner, 4>& corners);
  /// Whether nothing behind can show in float.
  [[nodiscard]] bool is_opaque() const;
  /// With the background, in the layers of VolumeRayCaster; its depth is kNoDepth.
  void add_to(FilmTile& tile) const;

 private:
  static constexpr std::size_t kQuantities = 5;
  /// Of a triangle: m0: opacity, light per colour; else thickness along z, extinction; then R, G, B.
  struct Vertex {
    double x = 0.0;
    double y = 0.0;
    std::array<float, kQuantities> values{};
  };
  /// Along a row of pixels: values at its first, and what they change by to the next.
  struct Span {
    std::size_t first = 0;  ///< pixel of the tile
    std::size_t n = 0;
    std::array<float, kQuantities> values{};
    std::array<float, kQuantities> steps{};
  };

  void find_stretch();
  [[nodiscard]] double stretch_at(double x, double y) const;
  [[nodiscard]] Vertex thick_vertex(const std::array<FanCorner, 4>& corners,
                                    const std::array<double, 4>& weights) const;
  void set_exact(double density_near, double density_far, double colour_near, double colour_far,
                 double length, Vertex& thick) const;
  void add_triangle(const Vertex& a, const Vertex& b, const Vertex& c);
  void add_row(int y, const Vertex& a, const Vertex& b, const Vertex& c, const Vertex& d);
  void add_span(const Span& span);

  const VolumeScene& scene_;
  Preview method_;
  Tile area_;
  bool is_perspective_;
  // Each with a vector's pixels behind the last, to which nothing is added.
  std::vector<float> stretch_;  ///< of each pixel: length over z; empty: nothing is drawn yet
  std::vector<float> transparency_;
  std::vector<float> opacity_;
  std::array<std::vector<float>, 3> light_;
};

}  // namespace haarlight::render
