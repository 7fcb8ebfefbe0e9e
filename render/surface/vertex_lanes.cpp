// SPDX-License-Identifier: Apache-2.0
#include "render/surface/vertex_lanes.h"

#include <cmath>
#include <numbers>

#include "core/vector_clones.h"
#include "haarlight/core/error.h"
#include "render/bsdf/bsdf_sample.h"
#include "render/bsdf/shading_frame.h"
#include "render/rays/ray_offset.h"
#include "render/surface/power_heuristic.h"

namespace haarlight::render {

namespace {

HAARLIGHT_CLONES("arch=x86-64-v4")
void find_lanes(VertexLanes& lanes, std::size_t n) {
  for (std::size_t i = 0; i < n; ++i) {
    const double nx = lanes.normal.x[i];
    const double ny = lanes.normal.y[i];
    const double nz = lanes.normal.z[i];
    double first[3];
    double second[3];
    tangents_of(nx, ny, nz, first, second);
    const double dx = lanes.direction.x[i];
    const double dy = lanes.direction.y[i];
    const double dz = lanes.direction.z[i];
    lanes.to_eye.x[i] = -(first[0] * dx + first[1] * dy + first[2] * dz);
    lanes.to_eye.y[i] = -(second[0] * dx + second[1] * dy + second[2] * dz);
    lanes.to_eye.z[i] = -(nx * dx + ny * dy + nz * dz);
    double x = 0.0;
    double y = 0.0;
    double z = 0.0;
    cosine_direction(lanes.u[i], lanes.v[i], x, y, z);
    lanes.cosine_local.x[i] = x;
    lanes.cosine_local.y[i] = y;
    lanes.cosine_local.z[i] = z;
    lanes.cosine_world.x[i] = first[0] * x + second[0] * y + nx * z;
    lanes.cosine_world.y[i] = first[1] * x + second[1] * y + ny * z;
    lanes.cosine_world.z[i] = first[2] * x + second[2] * y + nz * z;
    lanes.first.x[i] = first[0];
    lanes.first.y[i] = first[1];
    lanes.first.z[i] = first[2];
    lanes.second.x[i] = second[0];
    lanes.second.y[i] = second[1];
    lanes.second.z[i] = second[2];
  }
}

HAARLIGHT_CLONES("arch=x86-64-v4")
void find_light_lanes(LightLanes& lanes, std::size_t n, const VertexLanes& vertices) {
  for (std::size_t i = 0; i < n; ++i) {
    const double x = lanes.point.x[i] - lanes.from.x[i];
    const double y = lanes.point.y[i] - lanes.from.y[i];
    const double z = lanes.point.z[i] - lanes.from.z[i];
    const double distance = std::sqrt(x * x + (y * y + z * z));
    const double towards =
        -(lanes.normal.x[i] * x + (lanes.normal.y[i] * y + lanes.normal.z[i] * z));
    const double inverse = 1.0 / distance;
    const double dx = inverse * x;
    const double dy = inverse * y;
    const double dz = inverse * z;
    lanes.distance[i] = distance;
    lanes.towards[i] = towards;
    const double density = lanes.density_per_mm2[i] * distance * distance * distance / towards;
    lanes.density[i] = density;
    lanes.height[i] = lanes.flat_normal.x[i] * dx +
                      (lanes.flat_normal.y[i] * dy + lanes.flat_normal.z[i] * dz);
    lanes.direction.x[i] = dx;
    lanes.direction.y[i] = dy;
    lanes.direction.z[i] = dz;
    lanes.local.x[i] =
        vertices.first.x[i] * dx + (vertices.first.y[i] * dy + vertices.first.z[i] * dz);
    lanes.local.y[i] =
        vertices.second.x[i] * dx + (vertices.second.y[i] * dy + vertices.second.z[i] * dz);
    const double cosine =
        vertices.normal.x[i] * dx + (vertices.normal.y[i] * dy + vertices.normal.z[i] * dz);
    lanes.local.z[i] = cosine;
    const double asked = lanes.probability[i] * density;
    const double followed = lanes.is_weighted[i] * (cosine * std::numbers::inv_pi);
    lanes.cosine_scale[i] = power_heuristic(asked, followed) * cosine / asked;
    const double off =
        lanes.may_hide[i] * (lanes.light_offset_mm[i] + kRounding * kOfWay * distance);
    const VectorLanes& side = lanes.flat_normal;
    const double from_x = lanes.from.x[i] + lanes.offset_mm[i] * side.x[i];
    const double from_y = lanes.from.y[i] + lanes.offset_mm[i] * side.y[i];
    const double from_z = lanes.from.z[i] + lanes.offset_mm[i] * side.z[i];
    lanes.ray_origin.x[i] = from_x;
    lanes.ray_origin.y[i] = from_y;
    lanes.ray_origin.z[i] = from_z;
    lanes.ray_direction.x[i] =
        lanes.from.x[i] + distance * dx + off * lanes.normal.x[i] - from_x;
    lanes.ray_direction.y[i] =
        lanes.from.y[i] + distance * dy + off * lanes.normal.y[i] - from_y;
    lanes.ray_direction.z[i] =
        lanes.from.z[i] + distance * dz + off * lanes.normal.z[i] - from_z;
  }
}

}  // namespace

void VertexLanes::find(std::size_t n) {
  HAARLIGHT_ASSERT(n <= kLanes);
  find_lanes(*this, n);
}

void LightLanes::find(std::size_t n, const VertexLanes& vertices) {
  HAARLIGHT_ASSERT(n <= kLanes);
  find_light_lanes(*this, n, vertices);
}

}  // namespace haarlight::render
