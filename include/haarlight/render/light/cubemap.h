// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/enum_words.h"
#include "haarlight/core/image.h"

/// @file
/// Environments: the light from every direction, as lat-long or cube maps (HDR, EXR, PNG, JPEG,
/// TIFF; display pictures are decoded from sRGB). Radiance is constant over a texel. World
/// frame: z up.
///
/// Lat-long, seen from inside: the middle is +x, u grows towards -y, v from +z down:
///   d = (sin t cos p, sin t sin p, cos t), t = pi (row + 0.5)/H, p = pi - 2 pi (col + 0.5)/W.
/// Cubes are OpenGL's, with its y-up turned to our z-up by (x, y, z)_GL -> (x, -z, y). Face
/// files and the cells of a cross or strip are named as OpenGL names them: +y is up.

namespace haarlight::render {

enum class EnvironmentLayout {
  lat_long,          ///< 2:1
  horizontal_cross,  ///< 4:3: +y over -x +z +x -z over -y
  vertical_cross,    ///< 3:4: +y over -x +z +x over -y over -z turned by 180 degrees
  strip,             ///< 6:1 (or 1:6): +x -x +y -y +z -z
  six_files,         ///< a folder with px nx py ny pz nz, or posx negx ... .hdr|.exr|.png|...
};
inline constexpr auto kEnvironmentLayoutWords = std::to_array<std::string_view>(
    {"lat-long", "horizontal cross", "vertical cross", "strip", "six files"});
constexpr std::span<const std::string_view> words_of(EnvironmentLayout) {
  return kEnvironmentLayoutWords;
}

/// A position on an environment: a texel, and where in it. Of a lat-long texel v is even in solid
/// angle, from its upper edge down; else u and v are even on the picture.
struct EnvironmentPosition {
  int row = 0;     ///< of n_rows()
  int col = 0;     ///< of row_texels()
  double u = 0.5;  ///< 0..1, to the right
  double v = 0.5;  ///< 0..1, down
};

class Environment {
 public:
  /// Negative values up to 1e-5 of the picture's peak, left by filters and lossy EXR, become 0.
  /// @throws Error  not a picture, no known shape, faces of different sizes, a missing face, a
  ///                texel that is NaN, above 1e20 or more negative than that (with its
  ///                position)
  [[nodiscard]] static Environment read(const std::filesystem::path& path);
  /// From a picture in memory; the shape determines the layout.
  /// @param name  for errors
  [[nodiscard]] static Environment from_picture(Image<float> picture, const std::string& name);
  /// From six square faces, +x -x +y -y +z -z as OpenGL names them.
  [[nodiscard]] static Environment from_faces(std::array<Image<float>, 6> faces,
                                              const std::string& name);

  [[nodiscard]] EnvironmentLayout layout() const noexcept { return layout_; }
  [[nodiscard]] bool is_colour() const noexcept;
  /// Turns the environment about z, counter-clockwise seen from above (x towards y).
  void rotate(double angle_rad);

  /// The same light on fewer texels: runs of texels become their mean, weighted by their solid
  /// angle (of a cube's texel by its centre's).
  /// @param most_across  largest number of texels all the way around, if whole numbers of
  ///                     texels allow it; else nothing is reduced
  [[nodiscard]] Environment reduced(int most_across) const;

  /// Rows of texels over all faces; EnvironmentTexels has the texels themselves.
  [[nodiscard]] int n_rows() const;
  [[nodiscard]] int row_texels() const;

  /// Radiance from a direction (of the texel it falls in). @param direction  any length but 0
  [[nodiscard]] Eigen::Vector3d radiance(const Eigen::Vector3d& direction) const;

  /// Where that direction is. @param direction  any length but 0
  [[nodiscard]] EnvironmentPosition position_of(const Eigen::Vector3d& direction) const;
  [[nodiscard]] Eigen::Vector3d radiance_at(const EnvironmentPosition& position) const;
  /// The unit vector to it.
  [[nodiscard]] Eigen::Vector3d direction(const EnvironmentPosition& position) const;
  /// d omega/(du dv) there, sr. Of a lat-long texel that is its solid angle everywhere.
  [[nodiscard]] double solid_angle_density(const EnvironmentPosition& position) const;

  /// Of its pictures and its angle: 32 hexadecimal digits.
  [[nodiscard]] std::string content_hash() const;

 private:
  friend class EnvironmentTexels;
  void check(const std::string& name);

  EnvironmentLayout layout_ = EnvironmentLayout::lat_long;
  Image<float> picture_;               ///< lat-long
  std::array<Image<float>, 6> faces_;  ///< else
  double angle_ = 0.0;
};

/// World direction of the point (s, t) of an OpenGL face, s to the right, t down, both in
/// [-1, 1]; not of length 1. @param face  0..5 = +x -x +y -y +z -z
[[nodiscard]] Eigen::Vector3d cube_direction(int face, double s, double t);

}  // namespace haarlight::render
