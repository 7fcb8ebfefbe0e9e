// SPDX-License-Identifier: Apache-2.0
#include "render/soft_shadow/light_outline.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "render/soft_shadow/circular_segment.h"

namespace haarlight::render {

namespace {

using Eigen::Vector2d;

/// Widths of slabs of that size and less are nothing but rounding.
constexpr double kNothing = 1e-13;
/// A segment that long and narrower than kUpright cannot be ordered by height: another turn can.
constexpr double kLong = 1e-9;
constexpr double kUpright = 1e-12;
/// Radians, with no common measure: no edge is upright in all of them.
constexpr std::array<double, 3> kAngles = {0.7390851332151607, 1.7320508075688772,
                                           2.6651441426902251};

double cross(const Vector2d& a, const Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); }

/// Integral of sqrt(1 - x^2) from 0.
double arc_integral(double x) {
  return 0.5 *
         (x * std::sqrt(std::max(0.0, 1.0 - x * x)) + std::asin(std::clamp(x, -1.0, 1.0)));
}

double chain_at(std::span<const Vector2d> chain, double x) {
  std::size_t i = 1;
  while (i + 1 < chain.size() && chain[i].x() < x) {
    ++i;
  }
  const Vector2d& a = chain[i - 1];
  const Vector2d& b = chain[i];
  return a.y() + (b.y() - a.y()) * std::clamp((x - a.x()) / (b.x() - a.x()), 0.0, 1.0);
}

}  // namespace

LightOutline::LightOutline(std::span<const Vector2d> corners)
    : corners_(corners.begin(), corners.end()) {
  area_ = std::numbers::pi;
  for (std::size_t turn = 0; turn < kTurns; ++turn) {
    const double c = std::cos(kAngles.at(turn));
    const double s = std::sin(kAngles.at(turn));
    turns_.at(turn) << c, -s, s, c;
  }
  if (corners_.empty()) {
    return;
  }
  area_ = 0.0;
  for (std::size_t i = 0; i < corners_.size(); ++i) {
    const Vector2d way = (corners_[(i + 1) % corners_.size()] - corners_[i]).normalized();
    const Vector2d inward(-way.y(), way.x());
    sides_.push_back({.inward = inward, .offset = inward.dot(corners_[i])});
  }
  for (std::size_t i = 2; i < corners_.size(); ++i) {
    area_ += 0.5 * cross(corners_[i - 1] - corners_[0], corners_[i] - corners_[0]);
  }
  for (std::size_t turn = 0; turn < kTurns; ++turn) {
    std::vector<Vector2d> turned;
    for (const Vector2d& corner : corners_) {
      turned.emplace_back(turns_.at(turn) * corner);
    }
    const auto by_x = [](const Vector2d& a, const Vector2d& b) { return a.x() < b.x(); };
    std::rotate(turned.begin(), std::ranges::min_element(turned, by_x), turned.end());
    const auto right = std::ranges::max_element(turned, by_x);
    Chains& chains = chains_.at(turn);
    chains.low.assign(turned.begin(), right + 1);
    chains.high.assign(right, turned.end());
    chains.high.push_back(turned.front());
    std::ranges::reverse(chains.high);
  }
}

/// Cuts off what is outside of the light. @param is_chord  both of its ends were
bool LightOutline::clip(OutlineSegment& segment, bool& is_chord) const {
  const Vector2d way = segment.to - segment.from;
  const double length = way.norm();
  if (!(length > 0.0)) {
    return false;
  }
  const Vector2d e = way / length;
  // The nearer end has the fewer digits before the point.
  const bool is_from_nearer = segment.from.squaredNorm() <= segment.to.squaredNorm();
  const Vector2d base = is_from_nearer ? segment.from : segment.to;
  const double first = is_from_nearer ? 0.0 : -length;
  double low = first;
  double high = first + length;
  if (corners_.empty()) {
    const double along = base.dot(e);
    const double off = cross(base, e);
    if (!(std::abs(off) < 1.0)) {
      return false;
    }
    const double half = std::sqrt((1.0 - off) * (1.0 + off));
    low = std::max(low, -half - along);
    high = std::min(high, half - along);
  } else {
    for (const Side& side : sides_) {
      const double inside = side.inward.dot(base) - side.offset;
      const double rate = side.inward.dot(e);
      if (rate > 0.0) {
        low = std::max(low, -inside / rate);
      } else if (rate < 0.0) {
        high = std::min(high, -inside / rate);
      } else if (inside < 0.0) {
        return false;
      }
    }
  }
  if (!(low < high)) {
    return false;
  }
  const bool is_begun = low > first;
  const bool is_ended = high < first + length;
  is_chord = is_begun && is_ended;
  if (is_begun) {
    segment.from = base + low * e;
  }
  if (is_ended) {
    segment.to = base + high * e;
  }
  return true;
}

double LightOutline::room_at(const Vector2d& point) const {
  if (corners_.empty()) {
    return 1.0 - point.norm();
  }
  double room = std::numeric_limits<double>::infinity();
  for (const Side& side : sides_) {
    room = std::min(room, side.inward.dot(point) - side.offset);
  }
  return room;
}

/// Of the disk, one line across.
LeastCovered LightOutline::chord(const OutlineSegment& segment) const {
  const Vector2d e = (segment.to - segment.from).normalized();
  Vector2d visible(-e.y(), e.x());  // to its left
  if (segment.jump > 0) {
    visible = -visible;
  }
  const Vector2d middle = 0.5 * (segment.from + segment.to);
  const double s = std::clamp(middle.dot(visible), -1.0, 1.0);
  LeastCovered least;
  least.fraction = segment_fraction_of_height(0.5 * (1.0 - s));
  least.point = (0.5 * (1.0 + s)) * visible;
  least.clearance = 0.5 * (1.0 - s);
  least.n_segments = 1;
  least.is_chord = true;
  return least;
}

bool LightOutline::set_lines(std::size_t turn, Scratch& scratch) const {
  scratch.lines.clear();
  const Eigen::Matrix2d& turned = turns_.at(turn);
  for (const OutlineSegment& segment : scratch.clipped) {
    Vector2d a = turned * segment.from;
    Vector2d b = turned * segment.to;
    int jump = segment.jump;
    if (a.x() > b.x()) {
      std::swap(a, b);
      jump = -jump;
    }
    const double width = b.x() - a.x();
    const double height = b.y() - a.y();
    if (width <= kUpright) {
      if (std::abs(height) > kLong) {
        return false;
      }
      continue;
    }
    const double slope = height / width;
    scratch.lines.push_back({.x0 = a.x(),
                             .x1 = b.x(),
                             .y0 = a.y(),
                             .slope = slope,
                             .cosine = 1.0 / std::sqrt(1.0 + slope * slope),
                             .jump = jump});
  }
  std::ranges::sort(scratch.lines, {}, &Scratch::Line::x0);
  return true;
}

/// Where the order of lines, or the border's formula, may change.
void LightOutline::set_events(std::size_t turn, Scratch& scratch) const {
  std::vector<double>& events = scratch.events;
  events.clear();
  if (corners_.empty()) {
    events.assign({-1.0, 1.0});
  } else {
    for (const auto* chain : {&chains_.at(turn).low, &chains_.at(turn).high}) {
      for (const Vector2d& corner : *chain) {
        events.push_back(corner.x());
      }
    }
  }
  const std::vector<Scratch::Line>& lines = scratch.lines;
  for (std::size_t i = 0; i < lines.size(); ++i) {
    const Scratch::Line& p = lines[i];
    events.push_back(p.x0);
    events.push_back(p.x1);
    for (std::size_t j = i + 1; j < lines.size(); ++j) {
      const Scratch::Line& q = lines[j];
      const double x0 = q.x0;  // lines are sorted by it
      const double x1 = std::min(p.x1, q.x1);
      if (!(x0 < p.x1)) {
        break;
      }
      const double before = p.at(x0) - q.at(x0);
      const double after = p.at(x1) - q.at(x1);
      if ((before < 0.0) != (after < 0.0)) {
        events.push_back(x0 + (x1 - x0) * (before / (before - after)));
      }
    }
  }
  std::ranges::sort(events);
}

LightOutline::Border LightOutline::border(std::size_t turn, double x0, double x1) const {
  const double middle = 0.5 * (x0 + x1);
  if (corners_.empty()) {
    const double mean = (arc_integral(x1) - arc_integral(x0)) / (x1 - x0);
    const double high = std::sqrt(std::max(0.0, 1.0 - middle * middle));
    return {.low_mean = -mean, .high_mean = mean, .low = -high, .high = high};
  }
  const double low = chain_at(chains_.at(turn).low, middle);
  const double high = chain_at(chains_.at(turn).high, middle);
  return {.low_mean = low, .high_mean = high, .low = low, .high = high};
}

namespace {

using Scratch = LightOutline::Scratch;

Scratch::Layers& cell_of(std::vector<Scratch::Layers>& cells, int layers) {
  const auto found = std::ranges::find(cells, layers, &Scratch::Layers::layers);
  if (found != cells.end()) {
    return *found;
  }
  cells.push_back(
      {.layers = layers, .area = 0.0, .clearance = -1.0, .point = Vector2d::Zero()});
  return cells.back();
}

/// Layers above the lines below `y` at `x`, less those below all.
int layers_below(const std::vector<Scratch::Crossing>& crossings, double x, double y) {
  int layers = 0;
  for (const Scratch::Crossing& crossing : crossings) {
    layers += crossing.line->at(x) < y ? crossing.line->jump : 0;
  }
  return layers;
}

/// The middle of the widest gap that the lines on both sides leave at `x`: there, no line parts the
/// one side from the other.
double widest_gap(double x, double low, double high, Scratch& scratch) {
  std::vector<double>& heights = scratch.heights;
  heights.assign({low, high});
  for (const auto* crossings : {&scratch.before, &scratch.crossings}) {
    for (const Scratch::Crossing& crossing : *crossings) {
      heights.push_back(std::clamp(crossing.line->at(x), low, high));
    }
  }
  std::ranges::sort(heights);
  double widest = -1.0;
  double middle = 0.0;
  for (std::size_t i = 1; i < heights.size(); ++i) {
    if (heights[i] - heights[i - 1] > widest) {
      widest = heights[i] - heights[i - 1];
      middle = 0.5 * (heights[i] + heights[i - 1]);
    }
  }
  return middle;
}

}  // namespace

/// Slab by slab from left to right; in each the lines do not cross.
bool LightOutline::sweep(std::size_t turn, Scratch& scratch) const {
  scratch.cells.clear();
  scratch.before.clear();
  scratch.active.clear();
  std::size_t next = 0;  // line
  const std::vector<double>& events = scratch.events;
  int lowest_layers = 0;  // below all lines of the slab
  bool is_first = true;
  std::size_t begin = 0;
  for (std::size_t i = 1; i < events.size(); ++i) {
    const double x0 = events[begin];
    const double x1 = events[i];
    if (!(x1 - x0 > kNothing)) {
      continue;
    }
    begin = i;
    const double width = x1 - x0;
    const double middle = 0.5 * (x0 + x1);
    while (next < scratch.lines.size() && scratch.lines[next].x0 < middle) {
      scratch.active.push_back(&scratch.lines[next++]);
    }
    std::erase_if(scratch.active,
                  [middle](const Scratch::Line* line) { return line->x1 <= middle; });
    scratch.crossings.clear();
    for (const Scratch::Line* line : scratch.active) {
      scratch.crossings.push_back({.y = line->at(middle), .line = line});
    }
    std::ranges::sort(scratch.crossings, {}, &Scratch::Crossing::y);
    const Border edge = border(turn, x0, x1);
    if (!is_first) {
      const Border at = border(turn, x0 - 0.5 * kNothing, x0 + 0.5 * kNothing);
      const double y = widest_gap(x0, at.low, at.high, scratch);
      lowest_layers +=
          layers_below(scratch.before, x0, y) - layers_below(scratch.crossings, x0, y);
    }
    is_first = false;
    int layers = lowest_layers;
    for (std::size_t k = 0; k <= scratch.crossings.size(); ++k) {
      const Scratch::Line* below = k > 0 ? scratch.crossings[k - 1].line : nullptr;
      const Scratch::Line* above =
          k < scratch.crossings.size() ? scratch.crossings[k].line : nullptr;
      layers += below != nullptr ? below->jump : 0;
      const double low_mean = below != nullptr ? scratch.crossings[k - 1].y : edge.low_mean;
      const double high_mean = above != nullptr ? scratch.crossings[k].y : edge.high_mean;
      const double low = below != nullptr ? low_mean : edge.low;
      const double high = above != nullptr ? high_mean : edge.high;
      Scratch::Layers& cell = cell_of(scratch.cells, layers);
      cell.area += width * (high_mean - low_mean);
      const double steepest = std::min(below != nullptr ? below->cosine : 1.0,
                                       above != nullptr ? above->cosine : 1.0);
      double clearance = 0.5 * std::min(width, steepest * (high - low));
      const Vector2d point(middle, 0.5 * (low + high));
      if (clearance > cell.clearance) {
        clearance = std::min(clearance, room_at(turns_.at(turn).transpose() * point));
      }
      if (clearance > cell.clearance) {
        cell.clearance = clearance;
        cell.point = point;
      }
    }
    std::swap(scratch.before, scratch.crossings);
  }
  return !scratch.cells.empty();
}

std::optional<LeastCovered> LightOutline::least_covered(
    std::span<const OutlineSegment> segments, double ignored_area, Scratch& scratch) const {
  scratch.clipped.clear();
  bool is_chord = false;
  for (OutlineSegment segment : segments) {
    if (segment.jump != 0 && clip(segment, is_chord)) {
      scratch.clipped.push_back(segment);
    }
  }
  LeastCovered least;
  if (scratch.clipped.empty()) {
    least.clearance = room_at(least.point);
    return least;
  }
  if (scratch.clipped.size() == 1 && is_chord && corners_.empty()) {
    return chord(scratch.clipped.front());
  }
  least.n_segments = static_cast<int>(scratch.clipped.size());
  for (std::size_t turn = 0; turn < kTurns; ++turn) {
    if (!set_lines(turn, scratch)) {
      continue;
    }
    set_events(turn, scratch);
    if (!sweep(turn, scratch)) {
      continue;
    }
    const Scratch::Layers* fewest = nullptr;
    for (const Scratch::Layers& cell : scratch.cells) {
      if (cell.area > ignored_area * area_ &&
          (fewest == nullptr || cell.layers < fewest->layers)) {
        fewest = &cell;
      }
    }
    if (fewest == nullptr) {
      continue;
    }
    least.fraction = std::clamp(fewest->area / area_, 0.0, 1.0);
    least.point = turns_.at(turn).transpose() * fewest->point;
    least.clearance = std::max(0.0, fewest->clearance);
    return least;
  }
  return std::nullopt;
}

}  // namespace haarlight::render
