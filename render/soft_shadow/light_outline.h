// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <optional>
#include <span>
#include <vector>

#include <Eigen/Core>

/// @file
/// The part of a flat light that is hidden by the fewest layers of what is in the way: the light's
/// outline, cut by the images of occluders' edges on its plane. Every edge says how many layers
/// more are on its left than on its right; that is enough to know all cells' layers but for one
/// number common to all. Areas are closed forms of lines and arcs: docs/numerics/soft-shadow.md.

namespace haarlight::render {

/// The image of an edge on the light's plane, seen from where the light shines.
struct OutlineSegment {
  Eigen::Vector2d from;
  Eigen::Vector2d to;
  int jump = 0;  ///< layers on its left less those on its right
};

/// The cells with the fewest layers, together.
struct LeastCovered {
  double fraction = 1.0;                            ///< of the light's area
  Eigen::Vector2d point = Eigen::Vector2d::Zero();  ///< in the roomiest of the cells
  double clearance = 1.0;  ///< from there to that cell's border, at least
  int n_segments = 0;      ///< that cross the light
  bool is_chord = false;   ///< one straight line across the light is all
};

class LightOutline {
 public:
  /// @param corners  of a convex polygon, counter-clockwise; empty: the unit disk
  explicit LightOutline(std::span<const Eigen::Vector2d> corners);

  /// Working memory of one thread.
  struct Scratch {
    struct Line {
      double x0;  ///< < x1
      double x1;
      double y0;
      double slope;
      double cosine;  ///< of its angle to the x axis
      int jump;       ///< layers above it less those below
      [[nodiscard]] double at(double x) const { return y0 + slope * (x - x0); }
    };
    struct Crossing {
      double y;
      const Line* line;
    };
    struct Layers {
      int layers;
      double area;
      double clearance;
      Eigen::Vector2d point;
    };
    std::vector<OutlineSegment> clipped;
    std::vector<Line> lines;
    std::vector<double> events;
    std::vector<const Line*> active;
    std::vector<Crossing> crossings;
    std::vector<Crossing> before;
    std::vector<double> heights;
    std::vector<Layers> cells;
  };

  /// @param segments  closed where the light is, but for ends outside of it; any order
  /// @param ignored_area  cells of so small an area in all, a fraction, are left to the next layer
  /// @return  none where rounding leaves no order: two segments on one another, end to end
  [[nodiscard]] std::optional<LeastCovered> least_covered(
      std::span<const OutlineSegment> segments, double ignored_area, Scratch& scratch) const;

 private:
  /// The light's lower and upper border over [x0, x1], as means, and at the middle.
  struct Border {
    double low_mean;
    double high_mean;
    double low;
    double high;
  };

  [[nodiscard]] bool clip(OutlineSegment& segment, bool& is_chord) const;
  /// From a point within the light to its border.
  [[nodiscard]] double room_at(const Eigen::Vector2d& point) const;
  [[nodiscard]] LeastCovered chord(const OutlineSegment& segment) const;
  /// In coordinates turned by an angle of `kTurns`.
  [[nodiscard]] bool set_lines(std::size_t turn, Scratch& scratch) const;
  void set_events(std::size_t turn, Scratch& scratch) const;
  [[nodiscard]] bool sweep(std::size_t turn, Scratch& scratch) const;
  [[nodiscard]] Border border(std::size_t turn, double x0, double x1) const;

  /// inward . p > offset within.
  struct Side {
    Eigen::Vector2d inward;  ///< unit
    double offset;
  };

  std::vector<Eigen::Vector2d> corners_;
  std::vector<Side> sides_;
  /// Lower and upper chains of the turned polygon by ascending x.
  struct Chains {
    std::vector<Eigen::Vector2d> low;
    std::vector<Eigen::Vector2d> high;
  };
  static constexpr std::size_t kTurns = 3;
  std::array<Eigen::Matrix2d, kTurns> turns_;
  std::array<Chains, kTurns> chains_;
  double area_ = 0.0;
};

}  // namespace haarlight::render
