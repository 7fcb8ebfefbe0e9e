// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/enum_words.h"

/// @file
/// The photons of a map in a kd-tree [Bentley75], and how dense they are at a point [Jensen96]: the k
/// nearest on the same side of the same surface give the radius, and a kernel weighs them.
///
/// Lengths are in units of the scene's radius, from the middle of its box: single precision is
/// the same fraction of any scene.

namespace haarlight::render {

/// How photons at distances d within the radius r are weighed. The k-th nearest is at r.
enum class PhotonKernel : std::uint8_t {
  constant,  ///< 1/(pi r^2), but the k-th only sets the radius: (k - 1)/(pi r^2) without bias
  epanechnikov,  ///< 2/(pi r^2) (1 - d^2/r^2): of its integral over the disk 1 [Epanechnikov69]
  slides,        ///< 1/(pi r^2) of all k [Jensen96]: k/(k - 1) too much
};
inline constexpr auto kPhotonKernelWords =
    std::to_array<std::string_view>({"constant", "epanechnikov", "slides"});
constexpr std::span<const std::string_view> words_of(PhotonKernel) {
  return kPhotonKernelWords;
}

/// A position on a surface.
struct PhotonSite {
  Eigen::Vector3f position = Eigen::Vector3f::Zero();
  /// Of the triangle, unit, on the side on which light arrives.
  Eigen::Vector3f normal = Eigen::Vector3f::UnitZ();
  std::uint32_t surface = 0;  ///< its number in the scene
};

/// Whether light that has arrived at one site is light of the disk about the other: the same side of
/// a surface that goes on there. Refused are normals more than 45 degrees apart, and heights above
/// the disk of more than a tenth of the distance; at another surface of a thousandth, so that sheets
/// behind each other do not light each other, but quads side by side do.
[[nodiscard]] bool is_on_same_side(const PhotonSite& photon, const PhotonSite& at);

/// A photon near a site.
struct NearPhoton {
  float squared_distance = 0.0F;
  std::uint32_t index = 0;  ///< in the tree's order
};

/// What a search finds.
struct NearPhotons {
  std::vector<NearPhoton> photons;  ///< the farthest first, else in no order
  double radius = 0.0;   ///< of the disk that they fill: of the k-th, or the most allowed
  bool has_kth = false;  ///< k were found: the first one sets the radius
};

/// Sites in a kd-tree.
class SiteTree {
 public:
  /// Keeps the sites, in an order of its own in which neighbours are near each other.
  explicit SiteTree(std::vector<PhotonSite> sites);
  ~SiteTree();
  SiteTree(SiteTree&&) noexcept;
  SiteTree& operator=(SiteTree&&) noexcept;
  SiteTree(const SiteTree&) = delete;
  SiteTree& operator=(const SiteTree&) = delete;

  /// Memory for a tree, the sites included: an estimate.
  [[nodiscard]] static std::uint64_t bytes_needed(std::size_t n_sites);

  [[nodiscard]] std::size_t size() const noexcept;
  /// In the tree's order.
  [[nodiscard]] const PhotonSite& operator[](std::size_t i) const;
  /// The number, among those that the tree was made of, of each in its order.
  [[nodiscard]] const std::vector<std::uint32_t>& order() const noexcept;

  /// The k nearest on its side, no farther than `most_radius`. @param k  1 or more
  void nearest(const PhotonSite& at, std::size_t k, double most_radius,
               NearPhotons& found) const;
  /// The nearest one, sooner. Nothing: none is so near.
  [[nodiscard]] std::optional<std::uint32_t> nearest(const PhotonSite& at,
                                                     double most_radius) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// What each of the photons found counts, per area in the tree's unit.
/// @param weights  (found.photons.size(),)
void weigh(PhotonKernel kernel, const NearPhotons& found, std::vector<double>& weights);

}  // namespace haarlight::render
