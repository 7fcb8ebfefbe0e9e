// SPDX-License-Identifier: Apache-2.0
#include "render/volume/cell_light.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include <Eigen/LU>

#include "render/volume/zero_of.h"

namespace haarlight::render {

using Eigen::Vector3d;

namespace {

constexpr double kQuadraticNoise = 2e-15;  // of a quadratic field's values

/// Where z is between `from` and `to`.
double fraction_at(double z, double from, double to) {
  return to > from ? std::clamp((z - from) / (to - from), 0.0, 1.0) : 0.0;
}

double over(double tail, double noise) { return tail > 0.0 ? tail / noise : 0.0; }

/// Of where a ray passes a face of the tetrahedron.
Eigen::Vector4d barycentric(const CellLight::Passage& passage,
                            std::span<const std::uint32_t> nodes) {
  const PassedFace& face = passage.face;
  const std::array<double, 3> weights = face.weights(passage.passing);
  Eigen::Vector4d b = Eigen::Vector4d::Zero();
  for (std::size_t i = 0; i < 3; ++i) {
    const auto* const corner =
        std::ranges::find(nodes.first(4), face.corners.at(i).node).base();
    b[corner - nodes.data()] = weights.at(i);
  }
  return b;
}

}  // namespace

/// The part of [from, to] that is between the clipping planes, and behind what has been passed, as
/// fractions; nothing: none is.
std::optional<std::array<double, 2>> CellLight::clipped(double from, double to) const {
  const double near = std::max(view_.near, begin_z_);
  const double far = std::min(view_.far, end_z_);
  if (!(to > near && from < far && near < far)) {
    return std::nullopt;
  }
  const double thickness = to - from;
  return std::array{from < near ? (near - from) / thickness : 0.0,
                    to > far ? (far - from) / thickness : 1.0};
}

/// Adds what the ray gathers on a part of a stretch, and notes where half is hidden.
/// @param from, thickness  where the stretch begins, and its length, in z @param u, v  the part, as
/// fractions @param add  (sum, u, v): adds a part to a sum @param density_at  (s): the field there
template <class Add, class Density>
void CellLight::gather(double from, double thickness, double u, double v, const Add& add,
                       const Density& density_at) {
  const double of_ray = sum_.optical_depth();
  add(sum_, u, v);
  if (std::isfinite(hidden_->z)) {
    return;
  }
  const double before = hidden_->optical_depth;
  hidden_->optical_depth += sum_.optical_depth() - of_ray;
  if (!(hidden_->optical_depth >= kHalfDepth)) {
    return;
  }
  const auto too_deep = [&](double end) {
    probe_.begin_ray(0);
    add(probe_, u, end);
    return before + probe_.optical_depth() - kHalfDepth;
  };
  // Where the extinction is linear: the part x of the way at which the part r of the depth is reached.
  const double a = view_.scene.density.at(density_at(u));
  const double b = view_.scene.density.at(density_at(v));
  const double r = (kHalfDepth - before) / (hidden_->optical_depth - before);
  const double x = r * (a + b) / (a + std::sqrt(a * a + (b * b - a * a) * r));
  hidden_->z =
      from + thickness * zero_of(too_deep, {u, before - kHalfDepth},
                                 {v, hidden_->optical_depth - kHalfDepth}, u + x * (v - u));
}

/// What the ray gathers within a cell where its fields are linear.
void CellLight::add_linear(std::uint32_t cell, Crossing from, Crossing to) {
  const std::optional<std::array<double, 2>> part = clipped(from.z, to.z);
  set_cell_fields(cell, from);
  set_cell_fields(cell, to);
  double s = part ? (*part)[0] : 0.0;
  const auto add_part = [&](LightSum& sum, double u, double v) {
    const Crossing near = u > 0.0 ? between(from, to, u) : from;
    const Crossing far = v < 1.0 ? between(from, to, v) : to;
    sum.add({.length = stretch_ * (far.z - near.z),
             .density_near = near.density,
             .density_far = far.density,
             .colour_near = near.colour,
             .colour_far = far.colour});
  };
  const auto add_until = [&](double end) {
    gather(from.z, to.z - from.z, s, end, add_part,
           [&](double at) { return between(from, to, at).density; });
    s = end;
  };
  if (!view_.scene.contours.empty()) {
    for (const ContourTracker::Hit& hit : contours_->between(from.contour, to.contour)) {
      if (part && hit.s >= (*part)[0] && hit.s <= (*part)[1]) {
        add_until(hit.s);
        add_surface(hit.contour, slope_in_tetrahedron(cell), from.z + s * (to.z - from.z));
      }
    }
  }
  if (part) {
    add_until((*part)[1]);
  }
}

/// Of the contours' field, where a tetrahedron has it linear.
Vector3d CellLight::slope_in_tetrahedron(std::uint32_t cell) const {
  const std::span<const std::uint32_t> nodes = view_.scene.mesh.nodes_of(cell);
  Eigen::Matrix3d edges;
  Vector3d changes;
  for (int i = 0; i < 3; ++i) {
    edges.row(i) = (position_of(nodes[static_cast<std::size_t>(i) + 1]) - position_of(nodes[0]))
                       .transpose();
    changes[i] = view_.points[nodes[static_cast<std::size_t>(i) + 1]].contour -
                 view_.points[nodes[0]].contour;
  }
  return edges.inverse() * changes;
}

/// In the camera's frame.
Vector3d CellLight::position_of(std::uint32_t node) const {
  const SeenPoint& seen = view_.points[node].seen;
  return {seen.x, seen.y, seen.z};
}

/// @param slope  of the field, across the surface @param z  where it is
void CellLight::add_surface(std::size_t contour, const Vector3d& slope, double z) {
  const Vector3d along = view_.point_at(p_, 1.0) - view_.point_at(p_, 0.0);
  const double cosine = std::abs(slope.dot(along)) / (slope.norm() * along.norm());
  const double of_ray = sum_.optical_depth();
  sum_.add(seen_of(view_.scene.contours[contour], std::isfinite(cosine) ? cosine : 0.0));
  note_hidden(sum_.optical_depth() - of_ray, z);
}

/// All of it at one depth.
void CellLight::note_hidden(double optical_depth, double z) {
  if (!std::isfinite(hidden_->z)) {
    hidden_->optical_depth += optical_depth;
    if (hidden_->optical_depth >= kHalfDepth) {
      hidden_->z = z;
    }
  }
}

void CellLight::add_summed(const PixelLight& sum, double z) {
  const double of_ray = sum_.optical_depth();
  sum_.add_summed(sum);
  note_hidden(sum_.optical_depth() - of_ray, z);
}

void CellLight::set_cell_fields(std::uint32_t cell, Crossing& at) const {
  const VolumeScene& scene = view_.scene;
  if (scene.density_field.is_per_cell) {
    at.density = scene.density_field.values[cell];
  }
  if (scene.colour_field.is_per_cell) {
    at.colour = scene.colour_field.values[cell];
  }
}

/// What it gathers within a cell of any type.
/// @param end  where it leaves; of linear cells also their fields there
void CellLight::add_general(std::uint32_t cell, const Passage& in, const Passage& out,
                            const Crossing& from, const Crossing& end) {
  const CellType type = view_.scene.mesh.types[cell];
  if (type == CellType::tetrahedron) {
    const Crossing begin = in.face.crossing(in.passing);
    add_linear(cell, between(begin, end, fraction_at(from.z, begin.z, end.z)), end);
    return;
  }
  if (type == CellType::quadratic_tetrahedron) {
    add_quadratic(cell, in, out, from.z, end.z);
    return;
  }
  add_isoparametric(cell, nullptr, from, end);
}

void CellLight::add_bent(std::uint32_t cell, const BentEntry& entry, const Crossing& from,
                         const Crossing& end) {
  add_isoparametric(cell, &entry, from, end);
}

/// @param entry  as add_bent(), else null
void CellLight::add_isoparametric(std::uint32_t cell, const BentEntry* entry,
                                  const Crossing& from, const Crossing& end) {
  const VolumeScene& scene = view_.scene;
  if (scene.density_field.is_per_cell && scene.colour_field.is_per_cell &&
      scene.contours.empty()) {
    add_linear(cell, from, end);
    return;
  }
  std::array<Vector3d, kMostCellNodes> positions;
  std::array<MappedFields, kMostCellNodes> fields;
  const std::span<const std::uint32_t> nodes = scene.mesh.nodes_of(cell);
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    const FieldPoint& point = view_.points[nodes[i]];
    positions.at(i) = position_of(nodes[i]);
    fields.at(i) = {.density = point.density, .colour = point.colour, .contour = point.contour};
  }
  CellMap map(scene.mesh.types[cell], std::span(positions).first(nodes.size()),
              std::span(fields).first(nodes.size()),
              entry != nullptr ? CellMap::Shape::bent : CellMap::Shape::straight);
  if (entry != nullptr) {
    // First within the face, then along the ray.
    map.begin_at(entry->rst);
    static_cast<void>(map.find(view_.point_at(p_, entry->z)));
  }
  constexpr int kHalvings = 20;
  add_mapped(cell, map, from.z, end.z, kHalvings, std::numeric_limits<double>::infinity());
  n_lost_points_ += map.n_lost();
}

/// By polynomials of a degree that is high enough, on as many parts as it takes.
/// @param before  what the stretch of which this is a half left out, in units of rounding
void CellLight::add_mapped(std::uint32_t cell, CellMap& map, double from, double to,
                           int n_halvings, double before) {
  std::array<double, Curve::kPoints> densities{};
  std::array<double, Curve::kPoints> colours{};
  std::array<double, Curve::kPoints> contours{};
  const Vector3d first = view_.point_at(p_, from);
  const Vector3d last = view_.point_at(p_, to);
  const std::array<Vector3d, 2> ends =
      map.is_affine() ? std::array{map.find(first), map.find(last)} : std::array{first, last};
  for (std::size_t i = 0; i < Curve::kPoints; ++i) {
    const double s = Curve::points().at(i);
    const Vector3d at = (1.0 - s) * ends[0] + s * ends[1];
    const MappedFields fields = map.is_affine() ? map.fields_of(at) : map.at(at);
    densities.at(i) = fields.density;
    colours.at(i) = fields.colour;
    contours.at(i) = fields.contour;
  }
  const auto curve_of = [&](const ScalarField& field,
                            const std::array<double, Curve::kPoints>& values, double noise) {
    return field.is_per_cell ? Curve::linear(field.values[cell], field.values[cell])
                             : Curve::through(values, noise);
  };
  const MappedFields& noise = map.noise();
  const CellCurves curves = {
      .density = curve_of(view_.scene.density_field, densities, noise.density),
      .colour = curve_of(view_.scene.colour_field, colours, noise.colour),
      .contour = Curve::through(contours, noise.contour),
      .contour_noise = noise.contour};
  // What is left out, in units of what rounding makes of the fields.
  const double excess = std::max({over(curves.density.tail(), noise.density),
                                  over(curves.colour.tail(), noise.colour),
                                  over(curves.contour.tail(), noise.contour)});
  const bool is_resolved = excess <= 1.0;
  // Of a field that a polynomial can fit half the stretch leaves a two hundredth.
  constexpr double kPerhapsNoise = 1e3;
  const bool is_noise = excess < kPerhapsNoise && excess > 0.7 * before;
  if (is_resolved || is_noise || n_halvings == 0) {
    n_unresolved_ += is_resolved ? 0 : 1;
    add_curves(curves, clipped(from, to), from, to - from, [&](double s) {
      return map.contour_slope(view_.point_at(p_, from + s * (to - from)));
    });
    return;
  }
  const double middle = 0.5 * (from + to);
  add_mapped(cell, map, from, middle, n_halvings - 1, excess);
  add_mapped(cell, map, middle, to, n_halvings - 1, excess);
}

/// @param part      what is between the clipping planes
/// @param from, thickness  where the stretch begins, and its length, in z
/// @param slope_at  (s): how the contours' field changes
template <class Slope>
void CellLight::add_curves(const CellCurves& curves,
                           const std::optional<std::array<double, 2>>& part, double from,
                           double thickness, const Slope& slope_at) {
  const double length = stretch_ * thickness;
  const auto add_part = [&](LightSum& sum, double u, double v) {
    sum.add(length, curves.density, curves.colour, u, v);
  };
  double s = part ? (*part)[0] : 0.0;
  if (!view_.scene.contours.empty()) {
    for (const ContourTracker::Hit& hit :
         contours_->along(curves.contour, curves.contour_noise)) {
      if (part && hit.s >= (*part)[0] && hit.s <= (*part)[1]) {
        gather(from, thickness, s, hit.s, add_part, curves.density);
        s = hit.s;
        add_surface(hit.contour, slope_at(s), from + s * thickness);
      }
    }
  }
  if (part) {
    gather(from, thickness, s, (*part)[1], add_part, curves.density);
  }
}

/// Of a quadratic tetrahedron with straight edges: by its barycentric coordinates, which are linear
/// along the ray.
void CellLight::add_quadratic(std::uint32_t cell, const Passage& in, const Passage& out,
                              double from, double to) {
  const std::span<const std::uint32_t> nodes = view_.scene.mesh.nodes_of(cell);
  const Eigen::Vector4d entry = barycentric(in, nodes);
  const Eigen::Vector4d end = barycentric(out, nodes);
  const double skipped = fraction_at(from, in.face.crossing(in.passing).z, to);
  const Eigen::Vector4d begin = (1.0 - skipped) * entry + skipped * end;
  const auto fields_at = [&](double s) {
    const Eigen::Vector4d b = (1.0 - s) * begin + s * end;
    Crossing at;
    const auto add = [&](std::size_t node, double weight) {
      const FieldPoint& point = view_.points[nodes[node]];
      at.density += weight * point.density;
      at.colour += weight * point.colour;
      at.contour += weight * point.contour;
    };
    for (int i = 0; i < 4; ++i) {
      add(static_cast<std::size_t>(i), b[i] * (2.0 * b[i] - 1.0));
    }
    for (std::size_t e = 0; e < kQuadraticEdges.size(); ++e) {
      const auto [i, j] = kQuadraticEdges.at(e);
      add(4 + e, 4.0 * b[i] * b[j]);
    }
    set_cell_fields(cell, at);
    return at;
  };
  const Crossing near = fields_at(0.0);
  const Crossing middle = fields_at(0.5);
  const Crossing far = fields_at(1.0);
  add_curves({.density = Curve::quadratic(near.density, middle.density, far.density),
              .colour = Curve::quadratic(near.colour, middle.colour, far.colour),
              .contour = Curve::quadratic(near.contour, middle.contour, far.contour),
              .contour_noise =
                  kQuadraticNoise * std::max({std::abs(near.contour), std::abs(middle.contour),
                                              std::abs(far.contour)})},
             clipped(from, to), from, to - from,
             [&](double s) { return slope_in_quadratic(nodes, (1.0 - s) * begin + s * end); });
}

/// Of the contours' field at barycentric coordinates b.
Vector3d CellLight::slope_in_quadratic(std::span<const std::uint32_t> nodes,
                                       const Eigen::Vector4d& b) const {
  Eigen::Vector4d by_b;
  for (int i = 0; i < 4; ++i) {
    by_b[i] = (4.0 * b[i] - 1.0) * view_.points[nodes[static_cast<std::size_t>(i)]].contour;
  }
  for (std::size_t e = 0; e < kQuadraticEdges.size(); ++e) {
    const auto [i, j] = kQuadraticEdges.at(e);
    const double value = view_.points[nodes[4 + e]].contour;
    by_b[i] += 4.0 * b[j] * value;
    by_b[j] += 4.0 * b[i] * value;
  }
  Eigen::Matrix3d edges;
  for (int i = 0; i < 3; ++i) {
    edges.row(i) = (position_of(nodes[static_cast<std::size_t>(i) + 1]) - position_of(nodes[0]))
                       .transpose();
  }
  return edges.inverse() * Vector3d(by_b[1] - by_b[0], by_b[2] - by_b[0], by_b[3] - by_b[0]);
}

}  // namespace haarlight::render
