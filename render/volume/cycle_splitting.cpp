// SPDX-License-Identifier: Apache-2.0
#include "render/volume/cycle_splitting.h"

#include <algorithm>
#include <array>
#include <limits>
#include <optional>
#include <utility>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "render/volume/strong_components.h"

namespace haarlight::render {

namespace {

/// Pieces of a component's cells, and which hides which.
class Splitting {
 public:
  Splitting(const VolumeView& view, std::span<const std::uint32_t> cells,
            const Successors& hidden)
      : view_(view), cells_(cells), hidden_(hidden), obstructing_(hidden.size()) {
    for (std::uint32_t i = 0; i < hidden.size(); ++i) {
      for (const std::uint32_t other : hidden[i]) {
        obstructing_[other].push_back(i);
      }
    }
    pieces_.reserve(2 * cells.size());
    for (const std::uint32_t cell : cells) {
      pieces_.push_back({.piece = {.cell = cell, .cuts = {}}, .body = body_of(view, cell)});
    }
  }

  [[nodiscard]] std::vector<CellPiece> run() {
    const std::size_t most = 1000 + 64 * cells_.size();
    while (true) {
      std::vector<std::vector<std::uint32_t>> components;
      for_each_component(
          hidden_.size(),
          [this](std::uint32_t node) { return std::span<const std::uint32_t>(hidden_[node]); },
          [&](std::span<const std::uint32_t> members) {
            components.emplace_back(members.begin(), members.end());
          });
      bool is_ordered = true;
      for (const std::vector<std::uint32_t>& component : components) {
        if (component.size() > 1) {
          is_ordered = false;
          if (pieces_.size() > most || !split_one(shortest_cycle(hidden_, component[0]))) {
            throw_unordered(component);
          }
        }
      }
      if (is_ordered) {
        std::vector<CellPiece> ordered;
        ordered.reserve(components.size());
        for (const std::vector<std::uint32_t>& component : components) {
          ordered.push_back(std::move(pieces_[component[0]].piece));
        }
        return ordered;
      }
    }
  }

 private:
  struct Piece {
    CellPiece piece;
    ConvexBody body;
  };

  [[noreturn]] void throw_unordered(const std::vector<std::uint32_t>& component) const {
    constexpr std::size_t kNamed = 8;
    std::string names;
    for (std::size_t i = 0; i < std::min(component.size(), kNamed); ++i) {
      names += (i > 0 ? ", " : "") + view_.cell_name(pieces_[component[i]].piece.cell);
    }
    throw Error(
        fmt::format("cells {}{} hide parts of each other in a ring that cuts do not open",
                    names, component.size() > kNamed ? " and others" : ""),
        view_.scene.mesh_file.string(), "render it by casting rays");
  }

  [[nodiscard]] bool hides(const Piece& a, const Piece& b) const {
    return render::hides(view_, a.body, b.body);
  }

  /// The two sides of a plane, if it leaves something on both.
  [[nodiscard]] std::optional<std::array<Piece, 2>> cut(const Piece& whole,
                                                        const HalfSpace& half) const {
    std::optional<std::array<ConvexBody, 2>> bodies = render::cut(view_, whole.body, half);
    if (!bodies) {
      return std::nullopt;
    }
    std::array<Piece, 2> sides = {Piece{.piece = whole.piece, .body = std::move((*bodies)[0])},
                                  Piece{.piece = whole.piece, .body = std::move((*bodies)[1])}};
    sides[0].piece.cuts.push_back(half);
    sides[1].piece.cuts.push_back({.normal = -half.normal, .offset = -half.offset});
    return sides;
  }

  /// Whether the way from the piece before a cut one in a cycle to that behind it is closed.
  [[nodiscard]] bool opens(const std::array<Piece, 2>& sides, const Piece& before,
                           const Piece& behind) const {
    const std::array from = {hides(before, sides[0]), hides(before, sides[1])};
    const std::array to = {hides(sides[0], behind), hides(sides[1], behind)};
    return !(from[0] && to[0]) && !(from[1] && to[1]) &&
           !(from[0] && to[1] && hides(sides[0], sides[1])) &&
           !(from[1] && to[0] && hides(sides[1], sides[0]));
  }

  /// Cuts one piece of a cycle by a plane of another: so that it opens, else by any.
  /// @return  whether there is one to cut by
  [[nodiscard]] bool split_one(const std::vector<std::uint32_t>& cycle) {
    std::optional<std::array<Piece, 2>> any;
    std::uint32_t any_number = 0;
    for (std::size_t i = 0; i < cycle.size(); ++i) {
      const Piece& before = pieces_[cycle[i == 0 ? cycle.size() - 1 : i - 1]];
      const Piece& behind = pieces_[cycle[i + 1 == cycle.size() ? 0 : i + 1]];
      for (std::size_t k = 1; k < cycle.size(); ++k) {  // from the next one on
        for (const HalfSpace& plane : pieces_[cycle[(i + k) % cycle.size()]].body.planes) {
          std::optional<std::array<Piece, 2>> sides = cut(pieces_[cycle[i]], plane);
          if (sides && opens(*sides, before, behind)) {
            replace(cycle[i], std::move(*sides));
            return true;
          }
          if (sides && !any) {
            any = std::move(sides);
            any_number = cycle[i];
          }
        }
      }
    }
    if (any) {
      replace(any_number, std::move(*any));
    }
    return any.has_value();
  }

  /// The piece by its two sides. A ray goes on from one of them to where it went on from the whole, or
  /// to the other.
  void replace(std::uint32_t number, std::array<Piece, 2> sides) {
    const auto added = static_cast<std::uint32_t>(pieces_.size());
    const std::vector<std::uint32_t> hidden = std::exchange(hidden_[number], {});
    const std::vector<std::uint32_t> obstructing = std::exchange(obstructing_[number], {});
    for (const std::uint32_t other : hidden) {
      std::erase(obstructing_[other], number);
    }
    for (const std::uint32_t other : obstructing) {
      std::erase(hidden_[other], number);
    }
    hidden_.emplace_back();
    obstructing_.emplace_back();
    pieces_[number] = std::move(sides[0]);
    pieces_.push_back(std::move(sides[1]));
    for (const std::uint32_t piece : {number, added}) {
      for (const std::uint32_t other : hidden) {
        connect_if_hidden(piece, other);
      }
      for (const std::uint32_t other : obstructing) {
        connect_if_hidden(other, piece);
      }
    }
    connect_if_hidden(number, added);
    connect_if_hidden(added, number);
  }

  void connect_if_hidden(std::uint32_t nearer, std::uint32_t farther) {
    if (hides(pieces_[nearer], pieces_[farther])) {
      hidden_[nearer].push_back(farther);
      obstructing_[farther].push_back(nearer);
    }
  }

  const VolumeView& view_;
  std::span<const std::uint32_t> cells_;
  std::vector<Piece> pieces_;
  Successors hidden_;
  Successors obstructing_;
};

}  // namespace

std::vector<std::uint32_t> shortest_cycle(const Successors& graph, std::uint32_t node) {
  constexpr std::uint32_t kNew = std::numeric_limits<std::uint32_t>::max();
  std::vector<std::uint32_t> from(graph.size(), kNew);
  std::vector<std::uint32_t> queue = {node};
  for (std::size_t i = 0; i < queue.size(); ++i) {
    for (const std::uint32_t next : graph[queue[i]]) {
      if (next == node) {
        std::vector<std::uint32_t> cycle;
        for (std::uint32_t at = queue[i]; at != node; at = from[at]) {
          cycle.push_back(at);
        }
        cycle.push_back(node);
        std::ranges::reverse(cycle);
        return cycle;
      }
      if (from[next] == kNew) {
        from[next] = queue[i];
        queue.push_back(next);
      }
    }
  }
  return {};
}

std::vector<CellPiece> split_cycles(const VolumeView& view,
                                    std::span<const std::uint32_t> cells,
                                    const Successors& hidden) {
  return Splitting(view, cells, hidden).run();
}

}  // namespace haarlight::render
