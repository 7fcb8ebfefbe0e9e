// SPDX-License-Identifier: Apache-2.0
#include "render/volume/tetrahedron_fan.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <span>
#include <utility>

#include "haarlight/core/error.h"
#include "render/film/no_depth.h"
#include "render/volume/projected_tetrahedra.h"
#include "render/volume/segment.h"
#include "render/volume/transfer_function.h"
#include "render/volume/volume_ray_caster.h"

namespace haarlight::render {

using Eigen::Array3d;
using Eigen::Array3f;

namespace {

/// Of a tetrahedron's extent squared: if its largest face is no larger it is seen edge-on.
constexpr double kEdgeOn = 1e-13;
constexpr float kShallow = 0.1F;  ///< depths below it by their series, error 1e-6 of them
constexpr float kOpaque = 1e-7F;  ///< transparencies that float does not tell from none

constexpr double kLargestLight = std::numeric_limits<float>::max();

/// Pixels that go together. Every operation is that of one float, so that the bits are the same.
using Four = float __attribute__((vector_size(16)));
using FourWhole = std::int32_t __attribute__((vector_size(16)));
constexpr std::int32_t kFour = 4;

/// As std::min and std::max choose.
template <class T>
inline T smaller_of(T a, T b) {
  return b < a ? b : a;
}
template <class T>
inline T larger_of(T a, T b) {
  return a < b ? b : a;
}

inline Four power_of_two(FourWhole exponent) {
  constexpr std::int32_t kBias = 127;
  constexpr std::int32_t kMantissa = 23;
  return std::bit_cast<Four>((exponent + kBias) << kMantissa);
}

/// exp(-depth) to 2e-7, depth >= 0: a power of two and a polynomial.
inline Four exp_of_minus(Four depth) {
  constexpr float kLog2e = 1.44269504F;
  constexpr float kLn2 = 0.693147181F;
  constexpr float kDeepest = 80.0F;
  const Four bounded = smaller_of(depth, Four{} + kDeepest);
  const auto power = __builtin_convertvector(bounded * kLog2e + 0.5F, FourWhole);
  const Four r = bounded - __builtin_convertvector(power, Four) * kLn2;
  const Four rest =
      1.0F -
      r * (1.0F -
           r / 2.0F *
               (1.0F - r / 3.0F * (1.0F - r / 4.0F * (1.0F - r / 5.0F * (1.0F - r / 6.0F)))));
  return rest * power_of_two(-power);
}

/// What a homogeneous stretch does.
template <class T>
struct Slab {
  T opacity;
  T mean_transparency;  ///< over the stretch: opacity over depth
};

/// Both forms, and then a choice.
inline Slab<Four> slab_of(Four depth) {
  const Four mean = 1.0F - depth / 2.0F * (1.0F - depth / 3.0F * (1.0F - depth / 4.0F));
  const Four opacity = 1.0F - exp_of_minus(depth);
  const auto is_shallow = depth < kShallow;
  return {
      .opacity = is_shallow ? depth * mean : opacity,
      .mean_transparency = is_shallow ? mean : opacity / larger_of(depth, Four{} + kShallow)};
}

inline Slab<float> slab_of(float depth) {
  const Slab<Four> slab = slab_of(Four{} + depth);
  return {.opacity = slab.opacity[0], .mean_transparency = slab.mean_transparency[0]};
}

/// Pixels next to each other, whose arrays do not overlap, and go on for three behind the last.
struct PixelRow {
  std::int32_t n;
  const float* __restrict stretch;
  float* __restrict transparency;
  float* __restrict opacity;
  float* __restrict red;
  float* __restrict green;
  float* __restrict blue;
};
using Values = std::array<float, 5>;  ///< as FanTile::Span

/// What one tetrahedron is in four pixels.
struct Layer {
  Four opacity;
  Four light;  ///< per colour
};

inline Four four_at(const float* from) {
  Four of;
  std::memcpy(&of, from, sizeof of);
  return of;
}

inline void set_four(float* at, Four to) { std::memcpy(at, &to, sizeof to); }

/// Four pixels at a time, as rows are short: nothing is added to those behind a row's end.
template <class LayerAt>
inline void composite(const PixelRow& row, const Values& values, const Values& steps,
                      const LayerAt& layer_at) {
  // Copies, which no store can change.
  const auto [v0, v1, v2, v3, v4] = values;
  const auto [s0, s1, s2, s3, s4] = steps;
  const auto [n, stretch, transparency, opacity, red, green, blue] = row;
  const FourWhole places = {0, 1, 2, 3};
  for (std::int32_t i = 0; i < n; i += kFour) {
    const FourWhole at = places + i;
    const Four s = __builtin_convertvector(smaller_of(at, FourWhole{} + (n - 1)), Four);
    // Rounding may leave the ends' range, below nothing.
    const Four first = larger_of(v0 + s * s0, Four{});
    const Four second = larger_of(v1 + s * s1, Four{});
    const Layer layer = layer_at(first, second, four_at(stretch + i));
    const Four left = four_at(transparency + i);
    const Four before = at < n ? left : Four{};
    set_four(transparency + i, at < n ? before * (1.0F - layer.opacity) : left);
    set_four(opacity + i, four_at(opacity + i) + before * layer.opacity);
    const Four weight = before * layer.light;
    set_four(red + i, four_at(red + i) + weight * (v2 + s * s2));
    set_four(green + i, four_at(green + i) + weight * (v3 + s * s3));
    set_four(blue + i, four_at(blue + i) + weight * (v4 + s * s4));
  }
}

void add_interpolated(const PixelRow& row, const Values& values, const Values& steps) {
  composite(row, values, steps, [](Four opacity, Four light, Four) {
    return Layer{.opacity = smaller_of(opacity, Four{} + 1.0F), .light = light};
  });
}

void add_chromaticity(const PixelRow& row, const Values& values, const Values& steps) {
  composite(row, values, steps, [](Four thickness, Four extinction, Four stretch) {
    const Slab<Four> slab = slab_of(thickness * stretch * extinction);
    return Layer{.opacity = slab.opacity, .light = slab.opacity};
  });
}

void add_glow(const PixelRow& row, const Values& values, const Values& steps) {
  composite(row, values, steps, [](Four thickness, Four extinction, Four stretch) {
    const Four length = thickness * stretch;
    const Slab<Four> slab = slab_of(length * extinction);
    return Layer{.opacity = slab.opacity, .light = length * slab.mean_transparency};
  });
}

double cross(const FanCorner& a, const FanCorner& b, const FanCorner& c) {
  return (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
}

/// The first pixel whose centre is not before a coordinate, within [first, end].
int first_at(double at, int first, int end) {
  const double bounded =
      std::clamp(at, static_cast<double>(first) - 1.0, static_cast<double>(end));
  const int whole = static_cast<int>(bounded);
  return std::max(whole + (bounded > whole ? 1 : 0), first);
}

}  // namespace

FanTile::FanTile(const VolumeScene& scene, Preview method, const Tile& area)
    : scene_(scene),
      method_(method),
      area_(area),
      is_perspective_(scene.optics.pixel_mm == 0.0) {
  const auto n =
      static_cast<std::size_t>(area.width()) * static_cast<std::size_t>(area.height());
  transparency_.assign(n, 1.0F);
  transparency_.resize(n + kFour, 0.0F);
  opacity_.assign(n + kFour, 0.0F);
  for (std::vector<float>& channel : light_) {
    channel.assign(n + kFour, 0.0F);
  }
}

/// Once something is drawn.
void FanTile::find_stretch() {
  stretch_.reserve(transparency_.size());
  for (int y = area_.y0; y < area_.y1; ++y) {
    for (int x = area_.x0; x < area_.x1; ++x) {
      stretch_.push_back(static_cast<float>(stretch_at(x, y)));
    }
  }
  stretch_.resize(transparency_.size(), 1.0F);
}

double FanTile::stretch_at(double x, double y) const {
  if (!is_perspective_) {
    return 1.0;
  }
  const CameraModel& camera = scene_.camera;
  const double u = (x + 0.5 - camera.cx) / camera.fx;
  const double v = (y + 0.5 - camera.cy) / camera.fy;
  return std::sqrt(1.0 + u * u + v * v);
}

bool FanTile::is_opaque() const {
  return std::ranges::all_of(transparency_, [](float left) { return left < kOpaque; });
}

/// Four points of a plane have one affine dependency: sum of w_i P_i = 0, sum of w_i = 0. Those of
/// positive and of negative weight are two sets whose hulls meet in a single point (Radon's): where
/// edges cross, a corner is before a face, or on an edge, or two corners are in one place.
void FanTile::add(const std::array<FanCorner, 4>& corners) {
  const auto& [a, b, c, d] = corners;
  const std::array<double, 4> weights = {cross(b, c, d), -cross(a, c, d), cross(a, b, d),
                                         -cross(a, b, c)};
  double largest = 0.0;
  for (const double weight : weights) {
    largest = std::max(largest, std::abs(weight));
  }
  const auto [low_x, high_x] = std::minmax({a.x, b.x, c.x, d.x});
  const auto [low_y, high_y] = std::minmax({a.y, b.y, c.y, d.y});
  const double extent = std::max(high_x - low_x, high_y - low_y);
  if (!(largest > kEdgeOn * extent * extent)) {
    return;
  }
  std::array<std::size_t, 4> front{};  // one side's corners, then the other's
  std::size_t n_positive = 0;
  std::size_t n = 0;
  for (const bool positive : {true, false}) {
    for (std::size_t i = 0; i < 4; ++i) {
      if ((weights.at(i) > 0.0) == positive) {
        front.at(n++) = i;
        n_positive += positive ? 1 : 0;
      }
    }
  }
  if (n_positive == 0 || n_positive == 4) {
    return;
  }
  if (stretch_.empty()) {
    find_stretch();
  }
  const Vertex thick = thick_vertex(corners, weights);
  if (thick.values[0] == 0.0F ||
      (scene_.glow == Glow::chromaticity && thick.values[1] == 0.0F &&
       std::ranges::all_of(
           corners, [](const FanCorner& corner) { return corner.extinction == 0.0F; }))) {
    return;
  }
  std::array<Vertex, 4> rim;
  for (std::size_t i = 0; i < 4; ++i) {
    const FanCorner& corner = corners.at(i);
    const float second = method_ == Preview::m0 ? 0.0F : corner.extinction;
    rim.at(i) = {
        .x = corner.x,
        .y = corner.y,
        .values = {0.0F, second, corner.colour[0], corner.colour[1], corner.colour[2]}};
  }
  if (n_positive == 2) {
    for (const std::size_t i : {front[0], front[1]}) {
      for (const std::size_t j : {front[2], front[3]}) {
        add_triangle(thick, rim.at(i), rim.at(j));
      }
    }
    return;
  }
  // One corner within the triangle of the others, which are the outline.
  const std::size_t begin = n_positive == 1 ? 1 : 0;
  for (std::size_t i = 0; i < 3; ++i) {
    add_triangle(thick, rim.at(front.at(begin + i)), rim.at(front.at(begin + (i + 1) % 3)));
  }
}

FanTile::Vertex FanTile::thick_vertex(const std::array<FanCorner, 4>& corners,
                                      const std::array<double, 4>& weights) const {
  struct Side {
    double weight = 0.0;
    double x = 0.0;
    double y = 0.0;
    double z = 0.0;
    double density_value = 0.0;
    double colour_value = 0.0;
    double extinction = 0.0;
    Array3d colour = Array3d::Zero();
  };
  std::array<Side, 2> sides;
  for (std::size_t i = 0; i < 4; ++i) {
    Side& side = sides.at(weights.at(i) > 0.0 ? 0 : 1);
    const FanCorner& corner = corners.at(i);
    const double weight = std::abs(weights.at(i));
    side.weight += weight;
    side.x += weight * corner.x;
    side.y += weight * corner.y;
    side.z += weight * corner.z;
    side.density_value += weight * corner.density_value;
    side.colour_value += weight * corner.colour_value;
    side.extinction += weight * static_cast<double>(corner.extinction);
    side.colour += weight * corner.colour.cast<double>();
  }
  for (Side& side : sides) {
    const double scale = 1.0 / side.weight;
    side = {.weight = 1.0,
            .x = scale * side.x,
            .y = scale * side.y,
            .z = scale * side.z,
            .density_value = scale * side.density_value,
            .colour_value = scale * side.colour_value,
            .extinction = scale * side.extinction,
            .colour = scale * side.colour};
  }
  if (sides[1].z < sides[0].z) {
    std::swap(sides[0], sides[1]);
  }
  const auto& [near, far] = sides;
  const double thickness = far.z - near.z;
  const double extinction = 0.5 * (near.extinction + far.extinction);
  const Array3f colour = (0.5 * (near.colour + far.colour)).cast<float>();
  Vertex thick{.x = near.x,
               .y = near.y,
               .values = {bounded_float(thickness), static_cast<float>(extinction), colour[0],
                          colour[1], colour[2]}};
  const double length = stretch_at(near.x, near.y) * thickness;
  if (method_ == Preview::m0) {
    const Slab<float> slab = slab_of(bounded_float(extinction * length));
    thick.values[0] = slab.opacity;
    thick.values[1] = scene_.glow == Glow::chromaticity
                          ? slab.opacity
                          : bounded_float(length) * slab.mean_transparency;
  } else if (method_ == Preview::m3 && length > 0.0) {
    set_exact(near.density_value, far.density_value, near.colour_value, far.colour_value,
              length, thick);
  }
  return thick;
}

/// What the thick point's ray gathers, with all rows of the tables: as an extinction, and a colour that
/// gives the same light.
void FanTile::set_exact(double density_near, double density_far, double colour_near,
                        double colour_far, double length, Vertex& thick) const {
  PartsAlong density(scene_.density.breakpoints(), density_near, density_far);
  PartsAlong colour(scene_.colour.breakpoints(), colour_near, colour_far);
  const auto rho_at = [&](double s) {
    return scene_.density.in_part(density.part(),
                                  density_near + s * (density_far - density_near));
  };
  const auto colour_at = [&](double s) {
    return scene_.colour.in_part(colour.part(), colour_near + s * (colour_far - colour_near));
  };
  double depth = 0.0;
  double transparency = 1.0;
  Array3d light = Array3d::Zero();
  for (double s = 0.0; s < 1.0;) {
    const double next = std::min({density.next(), colour.next(), 1.0});
    const double part = (next - s) * length;
    const double a = rho_at(s) * part;
    const double b = rho_at(next) * part;
    const SegmentWeights weights = weights_of_depths(std::max(a, 0.0), std::max(b, 0.0));
    const bool glows_itself = scene_.glow == Glow::own;
    const EndWeights& of = glows_itself ? weights.of_glow : weights.of_chromaticity;
    light += transparency * (glows_itself ? part : 1.0) *
             (of.near * colour_at(s) + of.far * colour_at(next));
    transparency *= weights.transparency;
    depth += 0.5 * (a + b);
    s = next;
    for (PartsAlong* parts : {&density, &colour}) {
      if (parts->next() <= next) {
        parts->advance();
      }
    }
  }
  thick.values[1] = bounded_float(depth / length);
  const Slab<float> slab = slab_of(bounded_float(depth));
  const double scale = scene_.glow == Glow::own
                           ? length * static_cast<double>(slab.mean_transparency)
                           : static_cast<double>(slab.opacity);
  if (scale > 0.0) {
    for (Eigen::Index k = 0; k < 3; ++k) {
      thick.values.at(static_cast<std::size_t>(k) + 2) = bounded_float(light[k] / scale);
    }
  }
}

/// By rows: values along the edges, and between these. Edges that two triangles share end at the same
/// pixels in both, and no pixel's centre is in two or in none.
void FanTile::add_triangle(const Vertex& a, const Vertex& b, const Vertex& c) {
  std::array<const Vertex*, 3> by_y = {&a, &b, &c};
  for (const auto& [i, j] : {std::pair{0U, 1U}, std::pair{1U, 2U}, std::pair{0U, 1U}}) {
    if (by_y.at(j)->y < by_y.at(i)->y) {
      std::swap(by_y.at(i), by_y.at(j));
    }
  }
  const auto& [top, middle, bottom] = by_y;
  const int end = first_at(bottom->y, area_.y0, area_.y1);
  for (int y = first_at(top->y, area_.y0, area_.y1); y < end; ++y) {
    if (static_cast<double>(y) < middle->y) {
      add_row(y, *top, *bottom, *top, *middle);
    } else {
      add_row(y, *top, *bottom, *middle, *bottom);
    }
  }
}

/// Between the edges a-b and c-d.
void FanTile::add_row(int y, const Vertex& a, const Vertex& b, const Vertex& c,
                      const Vertex& d) {
  const double along_ab = (y - a.y) / (b.y - a.y);
  const double along_cd = (y - c.y) / (d.y - c.y);
  double left = a.x + along_ab * (b.x - a.x);
  double right = c.x + along_cd * (d.x - c.x);
  const bool is_swapped = right < left;
  if (is_swapped) {
    std::swap(left, right);
  }
  const int first = first_at(left, area_.x0, area_.x1);
  const int end = first_at(right, area_.x0, area_.x1);
  if (first >= end) {
    return;
  }
  Span span{
      .first = static_cast<std::size_t>((y - area_.y0) * area_.width() + first - area_.x0),
      .n = static_cast<std::size_t>(end - first)};
  const auto begin = static_cast<float>((first - left) / (right - left));
  const auto step = static_cast<float>(1.0 / std::max(right - left, 0.5));  // one pixel: unused
  const auto f = static_cast<float>(along_ab);
  const auto g = static_cast<float>(along_cd);
  for (std::size_t k = 0; k < kQuantities; ++k) {
    float at_left = a.values[k] + f * (b.values[k] - a.values[k]);
    float at_right = c.values[k] + g * (d.values[k] - c.values[k]);
    if (is_swapped) {
      std::swap(at_left, at_right);
    }
    span.values[k] = at_left + begin * (at_right - at_left);
    span.steps[k] = step * (at_right - at_left);
  }
  add_span(span);
}

void FanTile::add_span(const Span& span) {
  const PixelRow row{.n = static_cast<std::int32_t>(span.n),
                     .stretch = stretch_.data() + span.first,
                     .transparency = transparency_.data() + span.first,
                     .opacity = opacity_.data() + span.first,
                     .red = light_[0].data() + span.first,
                     .green = light_[1].data() + span.first,
                     .blue = light_[2].data() + span.first};
  if (method_ == Preview::m0) {
    add_interpolated(row, span.values, span.steps);
  } else if (scene_.glow == Glow::chromaticity) {
    add_chromaticity(row, span.values, span.steps);
  } else {
    add_glow(row, span.values, span.steps);
  }
}

void FanTile::add_to(FilmTile& tile) const {
  // As the film has them: of each pixel light, three numbers, opacity, depth, flags.
  static_assert(VolumeRayCaster::kLight == 0 && VolumeRayCaster::kOpacity == 1 &&
                VolumeRayCaster::kDepth == 2 && VolumeRayCaster::kFlags == 3);
  constexpr std::size_t kChannels = 6;
  const std::span<double> sums = tile.sums();
  HAARLIGHT_EXPECTS(sums.size() == kChannels * (transparency_.size() - kFour),
                    "the layers of the light");
  std::size_t i = 0;
  for (int y = area_.y0; y < area_.y1; ++y) {
    for (int x = area_.x0; x < area_.x1; ++x, ++i) {
      const Array3d light =
          Array3d(light_[0][i], light_[1][i], light_[2][i]).max(0.0).min(kLargestLight) +
          static_cast<double>(transparency_[i]) * light_behind(scene_, x, y);
      double* const pixel = sums.data() + kChannels * i;
      for (std::size_t k = 0; k < 3; ++k) {
        pixel[k] += light[static_cast<Eigen::Index>(k)];
      }
      pixel[3] += std::min(static_cast<double>(opacity_[i]), 1.0);
      pixel[4] += kNoDepth;
    }
  }
}

}  // namespace haarlight::render
