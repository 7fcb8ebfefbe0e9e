// SPDX-License-Identifier: Apache-2.0
#include "render/rays/triangle_lanes.h"

#include <cmath>

#include "core/vector_clones.h"
#include "haarlight/core/error.h"
#include "render/rays/ray_offset.h"

namespace haarlight::render {

namespace {

constexpr double kGrazing = 1e-6;  // of a slope: below it the plane's point is not known well

// Sums are in the order of Eigen's: the first, and the sum of the other two.
HAARLIGHT_CLONES("arch=x86-64-v4")
void find_lanes(TriangleLanes& lanes, std::size_t n, double slack_mm, double mx, double my,
                double mz) {
  for (std::size_t i = 0; i < n; ++i) {
    const double ax = lanes.first.x[i];
    const double ay = lanes.first.y[i];
    const double az = lanes.first.z[i];
    const double bx = lanes.second.x[i] - ax;
    const double by = lanes.second.y[i] - ay;
    const double bz = lanes.second.z[i] - az;
    const double cx = lanes.third.x[i] - ax;
    const double cy = lanes.third.y[i] - ay;
    const double cz = lanes.third.z[i] - az;
    const double nx = by * cz - bz * cy;
    const double ny = bz * cx - bx * cz;
    const double nz = bx * cy - by * cx;
    const double square = nx * nx + (ny * ny + nz * nz);
    const double root = std::sqrt(square);
    const double length = square > 0.0 ? root : 1.0;
    const double front = lanes.side[i];
    const double fx = front * (nx / length);
    const double fy = front * (ny / length);
    const double fz = front * (nz / length);
    const double ox = lanes.origin.x[i];
    const double oy = lanes.origin.y[i];
    const double oz = lanes.origin.z[i];
    const double dx = lanes.direction.x[i];
    const double dy = lanes.direction.y[i];
    const double dz = lanes.direction.z[i];
    const double slope = fx * dx + (fy * dy + fz * dz);
    const double t_plane = (fx * (ax - ox) + (fy * (ay - oy) + fz * (az - oz))) / slope;
    const double t = lanes.t[i];
    const bool is_steep = std::abs(slope) > kGrazing;
    const bool is_near = std::abs(t_plane - t) <= 1e-4 * t + slack_mm;
    const bool is_exact = is_steep & is_near;
    const double u = lanes.u[i];
    const double v = lanes.v[i];
    const double w = 1.0 - u - v;
    const double gx = w * ax + u * lanes.second.x[i] + v * lanes.third.x[i];
    const double gy = w * ay + u * lanes.second.y[i] + v * lanes.third.y[i];
    const double gz = w * az + u * lanes.second.z[i] + v * lanes.third.z[i];
    const double t_grazing = (gx - ox) * dx + ((gy - oy) * dy + (gz - oz) * dz);
    const double px = ox + t_plane * dx;
    const double py = oy + t_plane * dy;
    const double pz = oz + t_plane * dz;
    const double x = is_exact ? px : gx;
    const double y = is_exact ? py : gy;
    const double z = is_exact ? pz : gz;
    lanes.point.x[i] = x;
    lanes.point.y[i] = y;
    lanes.point.z[i] = z;
    const double bcx = cx - bx;
    const double bcy = cy - by;
    const double bcz = cz - bz;
    double longest_side = 0.0;
    const double of_triangle =
        triangle_roundings(bx * bx + (by * by + bz * bz), bcx * bcx + (bcy * bcy + bcz * bcz),
                           cx * cx + (cy * cy + cz * cz), square, longest_side);
    lanes.of_triangle[i] = of_triangle;
    lanes.longest_side[i] = longest_side;
    const double from_middle =
        std::sqrt((x - mx) * (x - mx) + ((y - my) * (y - my) + (z - mz) * (z - mz)));
    lanes.offset[i] = kRounding * (kOfDistance * from_middle + of_triangle);
    lanes.distance[i] = is_exact ? t_plane : t_grazing;
    const double side = slope > 0.0 ? -1.0 : 1.0;
    lanes.flat.x[i] = side * fx;
    lanes.flat.y[i] = side * fy;
    lanes.flat.z[i] = side * fz;
    lanes.slope[i] = slope;
  }
}

}  // namespace

void TriangleLanes::find(std::size_t n, double slack_mm, const Eigen::Vector3d& middle) {
  HAARLIGHT_ASSERT(n <= kLanes);
  find_lanes(*this, n, slack_mm, middle.x(), middle.y(), middle.z());
}

}  // namespace haarlight::render
