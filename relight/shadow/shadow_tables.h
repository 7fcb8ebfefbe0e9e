// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "haarlight/core/progress.h"
#include "haarlight/relight/shadow/area_mean.h"
#include "haarlight/relight/shadow/visibility.h"
#include "haarlight/render/light/light_tree.h"
#include "relight/shadow/shadow_lookup.h"

/// @file
/// Summed-area tables of the shadow pictures of lights and of blocks of lights. A picture is
/// expensive to make, so the tables of whole trees are kept while the memory lasts: who goes
/// through the trees twice requests each picture once, if all fit.

namespace haarlight::relight {

/// For one caller.
class ShadowTables {
 public:
  using Tables = std::vector<WindowSums>;  ///< [node * n_planes + plane], or of leaves

  /// @param planes  outlive this; their pictures are requested from the caller's thread
  explicit ShadowTables(std::span<const SamplingPlane> planes);

  /// At most, of all planes. Most tables need half of it (the unknown is shared).
  [[nodiscard]] std::uint64_t bytes_a_light() const noexcept { return bytes_a_light_; }

  /// Tables of leaves first .. last of a root, one after another.
  [[nodiscard]] Tables load_leaves(const render::LightRoot& root, std::size_t first,
                                   std::size_t last, Progress* progress);

  /// Decides which trees are kept: the first ones, as many as fit together with the largest of
  /// the others.
  /// @param roots  outlive the calls below; the largest tree fits
  void plan(std::span<const render::LightRoot> roots, std::uint64_t memory_bytes);
  /// The lights whose trees are not kept: pictures that are made again each time.
  [[nodiscard]] std::size_t n_lights_not_kept() const noexcept { return n_lights_not_kept_; }
  /// Tables of every node of roots[at], from memory or made; valid until the next call.
  [[nodiscard]] const Tables& tree(std::size_t at, Progress* progress);
  /// True if tree() has these at hand.
  [[nodiscard]] bool has_tree(std::size_t at) const {
    return at < kept_.size() && kept_[at].has_value();
  }
  /// Frees what tree() returned.
  void release(std::size_t at);

  /// Of the pictures, each light's once.
  [[nodiscard]] const VisibilityCount& count() const noexcept { return count_; }
  [[nodiscard]] std::uint64_t peak_bytes() const noexcept { return peak_bytes_; }

 private:
  [[nodiscard]] Tables load_tree(const render::LightRoot& root, Progress* progress);
  void count_picture(int light, std::size_t plane, const VisibilityCount& count);
  void hold(std::size_t n_tables);

  std::span<const SamplingPlane> planes_;
  std::span<const render::LightRoot> roots_;
  std::uint64_t bytes_a_light_ = 0;
  std::vector<std::optional<Tables>> kept_;  ///< of the roots that are kept
  std::optional<Tables> passing_;            ///< of the last one that is not
  std::size_t n_lights_not_kept_ = 0;
  std::uint64_t kept_bytes_ = 0;
  std::uint64_t peak_bytes_ = 0;
  std::vector<bool> is_counted_;  ///< [light * n_planes + plane]
  VisibilityCount count_;
};

/// The leaves' tables among all nodes'.
[[nodiscard]] std::vector<const WindowSums*> leaf_tables(const render::LightRoot& root,
                                                         const ShadowTables::Tables& tables,
                                                         std::size_t n_planes);

}  // namespace haarlight::relight
