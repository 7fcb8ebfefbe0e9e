// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/enum_words.h"
#include "haarlight/core/image.h"
#include "haarlight/core/rig/camera_model.h"
#include "haarlight/core/rig/rig.h"

/// @file
/// Which pixels of a capture show highlights, attached shadows, cast shadows or none of them,
/// from the capture itself: a matte surface b = albedo x normal is fitted to every pixel's
/// lights, T_k ~ b . f_k, leaving out those that contradict it, and the lights that contradict
/// it tell why. The rule and its accuracy: docs/numerics/bases.md, "Regions".

namespace haarlight::relight {

enum class Region : std::uint8_t {
  none,      ///< too dark or too few lights
  specular,  ///< more light than a matte surface can reflect
  diffuse,   ///< matte under every light
  attached,  ///< turned away from some lights
  cast,      ///< hidden from some lights that it faces
};
inline constexpr auto kRegionWords = std::to_array<std::string_view>(
    {"none", "specular", "diffuse", "attached shadow", "cast shadow"});
constexpr std::span<const std::string_view> words_of(Region) { return kRegionWords; }
inline constexpr int kRegions = 5;

/// A light, from which the fit's f_k and the harmonics' directions are computed.
struct StudyLight {
  bool is_position = false;
  Eigen::Vector3d coordinates =
      Eigen::Vector3d::UnitZ();                     ///< mm in world, or unit direction to it
  Eigen::Vector3d emits = Eigen::Vector3d::Zero();  ///< unit; 0: isotropic
  double lobe_mu = 1.0;
  double strength = 1.0;
};

/// The lights of a rig: strength is the emitter's area.
[[nodiscard]] std::vector<StudyLight> study_lights(const Rig& rig);
/// Unit directions from a point to the lights.
[[nodiscard]] std::vector<Eigen::Vector3d> light_directions_from(
    const std::vector<StudyLight>& lights, const Eigen::Vector3d& point);
/// f_k at a point: irradiance on a surface facing the light, times the direction to it.
[[nodiscard]] Eigen::Matrix3Xd light_factors(const std::vector<StudyLight>& lights,
                                             const Eigen::Vector3d& point);

/// One pixel's fit and classification.
struct PixelVerdict {
  Region region = Region::none;
  Eigen::Vector3d matte = Eigen::Vector3d::Zero();  ///< b
  double excess = 0.0;                              ///< fraction of the light above matte
  double attached = 0.0;  ///< fraction of the lights behind the surface
  double cast = 0.0;      ///< fraction of the lights hidden
};

/// Thresholds of the classification, in order: dark, specular, then the larger of attached and
/// cast.
struct RegionRules {
  double dark = 0.01;      ///< norm of the pixel, relative to the capture's rms norm
  double excess = 0.03;    ///< specular from this fraction of light up
  double shadowed = 0.02;  ///< attached or cast from this fraction of lights up
};

/// @param values     (n_lights) of the pixel, mean of its channels
/// @param factors    light_factors() at its position
/// @param dark_norm  RegionRules::dark times the capture's rms norm
[[nodiscard]] PixelVerdict classify_pixel(std::span<const float> values,
                                          const Eigen::Matrix3Xd& factors, double dark_norm,
                                          const RegionRules& rules = {});

/// Regions as a colour picture: red specular, green diffuse, blue attached, yellow cast, black
/// none; (height, width, 3), values 0 or 1.
[[nodiscard]] Image<float> paint_regions(std::span<const Region> regions, int width,
                                         int height);
/// The reverse, each channel set from 0.5 up. @throws Error  another size; other colours
[[nodiscard]] std::vector<Region> read_region_picture(const std::filesystem::path& file,
                                                      int width, int height);

}  // namespace haarlight::relight
