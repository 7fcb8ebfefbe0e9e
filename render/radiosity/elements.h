// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

/// @file
/// What radiosity solves for. An element is a side of a patch, side 2 p its front and 2 p + 1 its back.
/// A side that lies partly within a body (the floor under a block's edge) is two: what is within gets
/// no light of the room, and would darken what is not. Which of both a line ends on is told by its
/// other end, as no surface is seen from within and from without. So nothing has to be known of where
/// on the patch the body's surface runs, of which way its triangles face, and light within is light,
/// too.

namespace haarlight::render {

/// One side of a surface, twice its number and 1 for its back.
using Seen = std::uint32_t;

class Elements {
 public:
  explicit Elements(std::size_t n_sides) : within_(n_sides, 0) {}

  /// Makes a side two elements. Once for each.
  /// @param seen  from the part within, and not from the other; ascending
  void split(std::size_t side, std::vector<Seen> seen);

  [[nodiscard]] std::size_t size() const noexcept { return within_.size() + split_.size(); }
  [[nodiscard]] std::size_t n_sides() const noexcept { return within_.size(); }
  /// The part of a side within; nothing: the side is one element.
  [[nodiscard]] std::optional<std::size_t> within(std::size_t side) const {
    return within_[side] != 0 ? std::optional<std::size_t>(within_[side]) : std::nullopt;
  }
  [[nodiscard]] std::size_t side_of(std::size_t element) const {
    return element < n_sides() ? element : split_[element - n_sides()].side;
  }
  /// @param other_end  of the line; nothing: it leaves the scene
  [[nodiscard]] std::size_t of(std::size_t side, std::optional<Seen> other_end) const;

 private:
  struct Split {
    std::size_t side;
    std::vector<Seen> seen;
  };
  std::vector<std::uint32_t> within_;  ///< by side: its element within, 0: none is
  std::vector<Split> split_;
};

/// What one point sees, each once; nothing: out of the scene.
using SeenFromPoint = std::vector<std::optional<Seen>>;

/// Groups that points fall into, where two points that see something in common are of one.
[[nodiscard]] std::size_t n_groups(std::span<const SeenFromPoint> points);

/// Whether points of a side fall into groups of two and more that see nothing in common: then what is
/// seen from those within, ascending. That are all but the one that sees out of the scene, or else sees
/// most.
[[nodiscard]] std::optional<std::vector<Seen>> seen_within(
    std::span<const SeenFromPoint> points);

}  // namespace haarlight::render
