// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/enum_words.h"
#include "haarlight/core/image.h"
#include "haarlight/core/picture/image_io.h"

/// @file
/// A picture that can be lit from any direction, as stored by cultural-heritage software: a few
/// 8-bit planes and a basis over light directions. The fits produce it; `.ptm`, `.rti` and web
/// folders store it. Directions are unit vectors to the light: x right, y up, z out of the
/// picture. Source: Malzbender et al., "Polynomial Texture Maps" (2001), eq. 1; Gautron et al.,
/// "A Novel Hemispherical Basis" (2004); third-party file layouts:
/// docs/reference/reflectance-formats.md.

namespace haarlight::relight {

enum class ReflectanceBasis {
  ptm,       ///< u^2, v^2, uv, u, v, 1 with u = x, v = y: 6 terms
  hsh,       ///< hemispherical harmonics: 4, 9 or 16 terms
  rbf,       ///< radial basis functions around the lights, PCA over the lights
  bilinear,  ///< a grid on the octahedral map, PCA over its nodes
};
inline constexpr auto kReflectanceBasisWords =
    std::to_array<std::string_view>({"ptm", "hsh", "rbf", "bilinear"});
[[nodiscard]] constexpr std::span<const std::string_view> words_of(ReflectanceBasis) noexcept {
  return kReflectanceBasisWords;
}

/// How planes become colours.
enum class ReflectanceColour {
  rgb,   ///< terms of R, then of G, then of B
  lrgb,  ///< terms of a luminance factor, then three planes R, G, B that it multiplies
  pca,   ///< planes are weights of axes that carry colours: ReflectanceModel::axes
};
inline constexpr auto kReflectanceColourWords =
    std::to_array<std::string_view>({"rgb", "lrgb", "pca"});
[[nodiscard]] constexpr std::span<const std::string_view> words_of(ReflectanceColour) noexcept {
  return kReflectanceColourWords;
}

/// HSH beyond 9 terms: which power of sqrt(c - c^2) the terms 9 and 15 carry.
enum class HshOrder4 {
  exact,         ///< the third, as in the definition of the basis
  chi_rounding,  ///< the second: HSHFitter's code computes pow(c - c^2, 3 / 2) in integers
};
inline constexpr auto kHshOrder4Words = std::to_array<std::string_view>({"exact", "rounded"});
constexpr std::span<const std::string_view> words_of(HshOrder4) { return kHshOrder4Words; }

/// value = byte * scale + offset; for values that become colours, 1 is white.
struct PlaneScale {
  double scale = 1.0 / 255.0;
  double offset = 0.0;
  friend bool operator==(const PlaneScale&, const PlaneScale&) = default;
};

struct ReflectanceModel {
  ReflectanceBasis basis = ReflectanceBasis::ptm;
  ReflectanceColour colour = ReflectanceColour::rgb;
  /// Transfer of the resulting colours: viewers show them unchanged (srgb).
  Transfer transfer = Transfer::srgb;
  HshOrder4 order4 = HshOrder4::exact;
  int n_terms = 6;                      ///< of the basis; for pca: the planes
  Image<std::uint8_t> planes;           ///< (height, width, n_planes)
  std::vector<PlaneScale> scales;       ///< (n_planes)
  std::vector<Eigen::Vector3d> lights;  ///< rbf: the RBF centres
  double rbf_sigma = 0.0;               ///< rbf: width of a radial function; 0: node_weights()
  /// hsh: lights lower than this are raised to it, radians; kWebLeastElevation for a web
  /// folder.
  double least_elevation = 0.0;
  int resolution = 0;  ///< bilinear: grid points per side of the octahedral map
  /// pca: (n_terms + 1, n_nodes * 3), node by node R, G, B; row 0 is the mean. A node is an RBF
  /// centre, that is a light (rbf), or a grid point, row by row (bilinear).
  Eigen::MatrixXf axes;
  PictureFacts photographed;  ///< of the pictures it was fitted to; only web folders keep them

  [[nodiscard]] int n_planes() const noexcept { return static_cast<int>(scales.size()); }
};

/// Number of planes of a model of that colour.
[[nodiscard]] int n_planes_of(ReflectanceColour colour, int n_terms) noexcept;

/// u^2, v^2, uv, u, v, 1.
[[nodiscard]] std::array<double, 6> ptm_terms(const Eigen::Vector3d& direction) noexcept;

/// The first n_terms hemispherical harmonics (4, 9 or 16) at a direction with z >= 0; a
/// direction below the horizon is clamped to it.
[[nodiscard]] std::array<double, 16> hsh_terms(const Eigen::Vector3d& direction, int n_terms,
                                               HshOrder4 order4 = HshOrder4::exact) noexcept;

/// Least elevation at which OpenLIME 1.2.6 keeps the light of a hsh folder, radians.
inline constexpr double kWebLeastElevation = 0.15;

/// Weight of a node of a pca model at a direction.
struct NodeWeight {
  int node = 0;
  double weight = 0.0;
};

/// The nodes with nonzero weight at a direction; the weights sum to 1. `bilinear`: s = |x| +
/// |y| + |z|, column ((x + y) / s + 1) / 2 * (resolution - 1), row ((y - x) / s + 1) / 2 *
/// (resolution - 1), and the four nodes around it; a direction below the horizon is clamped to
/// it. `rbf` with a sigma: exp(-|d - l|^2 / sigma^2) around each light l, scaled to sum 1;
/// those under 0.001 are left out and the others scaled again, as Relight does. Without one
/// OpenLIME 1.2.6's rule: exp(-8 |d - l|^2 / m), scaled to sum 1, where m is the lights' mean
/// distance |d - l|, each counting exp(-2 |d - l|).
/// @param direction  unit vector
[[nodiscard]] std::vector<NodeWeight> node_weights(const ReflectanceModel& model,
                                                   const Eigen::Vector3d& direction);

/// The model's terms at a direction, (n_terms): ptm and hsh.
[[nodiscard]] std::vector<double> basis_terms(const ReflectanceModel& model,
                                              const Eigen::Vector3d& direction);

/// A linear map from one pixel's bytes to its colour; for lrgb to its luminance, all three rows
/// alike, which then multiplies the colour of the three last planes.
struct ColourMap {
  Eigen::Matrix<double, 3, Eigen::Dynamic> factors;  ///< (3, n_planes)
  Eigen::Vector3d added = Eigen::Vector3d::Zero();
};
[[nodiscard]] ColourMap colour_map(const ReflectanceModel& model,
                                   const Eigen::Vector3d& direction);

/// Default limit on the bytes of planes a reader accepts.
inline constexpr std::uint64_t kMostPlaneBytes = std::uint64_t{4} << 30U;

/// Allocates the planes of a file being read. @param where  the file
/// @throws Error  more than `most_bytes`
[[nodiscard]] Image<std::uint8_t> allocate_planes(int height, int width, int n_planes,
                                                  std::uint64_t most_bytes,
                                                  const std::string& where);

/// @throws Error  planes, scales and terms do not match; `where` names the model
void require_consistent(const ReflectanceModel& model, std::string_view where);

/// The picture under a light from `direction`, (height, width, 3), 0..1 of white in the model's
/// transfer, not clipped. Every pixel costs n_planes multiplications.
[[nodiscard]] Image<float> relit(const ReflectanceModel& model,
                                 const Eigen::Vector3d& direction);

/// The same from unquantised coefficients, (height, width, n_planes): the model's own planes
/// and scales are ignored.
[[nodiscard]] Image<float> relit_coefficients(const ReflectanceModel& model,
                                              ImageView<const float> coefficients,
                                              const Eigen::Vector3d& direction);

}  // namespace haarlight::relight
