// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>

#include <Eigen/Core>

#include "haarlight/render/rays/ray_caster.h"
#include "render/light/light.h"
#include "render/rays/lanes.h"

/// @file
/// What every vertex of a path needs, whatever it scatters, of several vertices at once: their frames,
/// and a direction each that is drawn from the cosine law. Plain loops over doubles, so that they
/// become vectors; the bits are those of shading_frame.h and cosine_direction().

namespace haarlight::render {

struct VertexLanes {
  // Given: those of lanes without a vertex may be anything.
  VectorLanes normal;     ///< unit, world: of the shading frame
  VectorLanes direction;  ///< unit, world: of the ray that has met the vertex
  Lanes u;                ///< of the number for the next direction, in [0, 1)
  Lanes v;
  // Found:
  VectorLanes first;  ///< tangents of the shading frame, world
  VectorLanes second;
  VectorLanes to_eye;        ///< unit, local
  VectorLanes cosine_local;  ///< drawn from cos/pi
  VectorLanes cosine_world;

  void put(std::size_t lane, const Eigen::Vector3d& unit_normal,
           const Eigen::Vector3d& ray_direction, const Eigen::Vector2d& square) {
    normal.put(lane, unit_normal);
    direction.put(lane, ray_direction);
    u[lane] = square.x();
    v[lane] = square.y();
  }
  /// Of the first `n` lanes.
  void find(std::size_t n);
};

/// A point each of lights that are drawn by area, as vertices see it.
struct LightLanes {
  // Given:
  VectorLanes from;         ///< the vertex's point, world, mm
  VectorLanes flat_normal;  ///< unit, of its side
  VectorLanes point;        ///< AreaPoint's
  VectorLanes normal;
  Lanes density_per_mm2;
  Lanes probability;      ///< of the light
  Lanes is_weighted;      ///< 1: a direction of the vertex's BSDF may find it too; else 0
  Lanes offset_mm;        ///< of the vertex
  Lanes light_offset_mm;  ///< RayCaster::most_offset_mm() of the light's surface; of none 0
  Lanes may_hide;         ///< 1: the light's surface could hide itself; else 0
  // Found: nothing arrives unless `towards` and `height` are above 0.
  VectorLanes direction;  ///< unit, world, to the light
  VectorLanes local;      ///< the same in the vertex's frame
  Lanes distance;         ///< mm
  Lanes towards;          ///< mm: cosine at the light, times the distance
  Lanes height;           ///< cosine at the vertex's side
  Lanes density;          ///< per sr
  /// Of a Lambertian vertex: its cosine over probability times density, times the power heuristic's
  /// weight where it is weighted.
  Lanes cosine_scale;
  VectorLanes ray_origin;     ///< light_ray()'s, mm
  VectorLanes ray_direction;  ///< to its end, mm

  void put(std::size_t lane, const Hit& vertex, const AreaPoint& light,
           double light_probability, bool has_weight, double light_offset, bool is_met) {
    from.put(lane, vertex.point);
    flat_normal.put(lane, vertex.flat_normal);
    point.put(lane, light.point);
    normal.put(lane, light.normal);
    density_per_mm2[lane] = light.density_per_mm2;
    probability[lane] = light_probability;
    is_weighted[lane] = has_weight ? 1.0 : 0.0;
    offset_mm[lane] = vertex.offset_mm;
    light_offset_mm[lane] = light_offset;
    may_hide[lane] = is_met ? 1.0 : 0.0;
  }
  /// Of the first `n` lanes.
  void find(std::size_t n, const VertexLanes& vertices);
};

}  // namespace haarlight::render
