// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/plate/plate.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <numbers>

#include <Eigen/Core>
#include <fmt/format.h>

#include "core/count.h"
#include "core/linear_algebra.h"
#include "core/random.h"
#include "haarlight/core/error.h"
#include "haarlight/render/analytic/polygon_light.h"
#include "haarlight/render/light/rig_lights.h"

namespace haarlight::relight {

namespace {

using Eigen::MatrixXd;

constexpr std::size_t kMaxSampleRows = 4096;
constexpr double kTolerance = 1e-12;  // of each value: floats keep 6e-8
constexpr int kIterations = 4;        // the plate's spectrum falls by 3-10 per vector
constexpr int kOversampling = 8;      // [Halko11] recommends 5 to 10

using RowMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// Rows of the clean plate from at most 64 spread-out tiles, normalised, one after the other;
/// rows of zeros are left out.
std::vector<double> sample_rows(const StackSource& plate) {
  constexpr int kTile = 32;
  constexpr int kMaxTiles = 64;
  constexpr int kPixelStep = 4;  // at least 64 rows per tile
  const StackDims dims = plate.dims();
  const int tiles_x = (dims.width + kTile - 1) / kTile;
  const int tiles_y = (dims.height + kTile - 1) / kTile;
  const int n_tiles = tiles_x * tiles_y;
  const int tile_step = (n_tiles + kMaxTiles - 1) / kMaxTiles;
  const std::size_t n_lights = count(dims.n_lights);
  std::vector<double> rows;
  std::vector<float> values;
  for (int t = 0; t < n_tiles; t += tile_step) {
    const int x0 = t % tiles_x * kTile;
    const int y0 = t / tiles_x * kTile;
    const TileRect rect{x0, y0, std::min(kTile, dims.width - x0),
                        std::min(kTile, dims.height - y0)};
    const bool is_whole = !plate.is_closed_form();
    values.resize(count(dims.channels) * count(is_whole ? rect.n_pixels() : 1) * n_lights);
    if (is_whole) {
      plate.read_tile(rect, values);
    }
    for (int c = 0; c < dims.channels; ++c) {
      for (int y = 0; y < rect.height; y += kPixelStep) {
        for (int x = 0; x < rect.width; x += kPixelStep) {
          std::size_t pixel = count(c) * count(rect.n_pixels()) + count(y * rect.width + x);
          if (!is_whole) {
            plate.read_tile({x0 + x, y0 + y, 1, 1}, values);
            pixel = count(c);
          }
          const float* row = values.data() + pixel * n_lights;
          double energy = 0.0;
          for (std::size_t k = 0; k < n_lights; ++k) {
            energy += double{row[k]} * double{row[k]};
          }
          if (energy > 0.0 && rows.size() < kMaxSampleRows * n_lights) {
            const double scale = 1.0 / std::sqrt(energy);
            for (std::size_t k = 0; k < n_lights; ++k) {
              rows.push_back(scale * double{row[k]});
            }
          }
        }
      }
    }
  }
  return rows;
}

}  // namespace

ComputedPlate::ComputedPlate(const Rig& rig, int i_camera, int i_plane) {
  if (rig.cameras.size() <= count(i_camera) || rig.planes.size() <= count(i_plane)) {
    throw Error("a clean plate needs a camera and a shadow plane in the rig",
                rig.file.empty() ? rig.name : rig.file.string(),
                "add [[camera]] and [[plane]] to the rig file, or use --plate none");
  }
  camera_ = rig.cameras[count(i_camera)].model;
  plane_ = rig.planes[count(i_plane)];
  squares_ = render::rig_lights(rig);
  if (render::lights_off_plane(rig, plane_).size() == squares_.size()) {
    throw Error(fmt::format("no light reaches the plane \"{}\": all lie in or behind it, or "
                            "shine away from it",
                            plane_.id),
                rig.file.empty() ? rig.name : rig.file.string(),
                "correct centre and emits of the faces, or n and d of the plane; or use "
                "--plate none");
  }
  irradiance_[0].emplace(squares_, plane_.n, plane_.d, kTolerance);
  irradiance_[1].emplace(squares_, -plane_.n, -plane_.d, kTolerance);
}

StackDims ComputedPlate::dims() const {
  return {camera_.width, camera_.height, 1, static_cast<int>(squares_.size())};
}

std::optional<PlateView> ComputedPlate::look(double x, double y) const {
  const CameraRay ray = ray_through(camera_, x, y);
  // n.x + d = 0 on the ray o + t r: t = -(n.o + d)/(n.r).
  const double height = plane_.n.dot(ray.origin_world) + plane_.d;
  const double slope = plane_.n.dot(ray.direction_world);
  const double t = -height / slope;
  if (slope == 0.0 || !(t > 0.0) || !std::isfinite(t)) {
    return std::nullopt;
  }
  return PlateView{ray.origin_world + t * ray.direction_world,
                   height > 0.0 ? plane_.n : Eigen::Vector3d(-plane_.n), slope};
}

void ComputedPlate::evaluate(double x, double y, std::span<double> out) const {
  const std::optional<PlateView> view = look(x, y);
  if (!view) {
    std::fill(out.begin(), out.end(), 0.0);
    return;
  }
  const bool is_above = view->normal.dot(plane_.n) > 0.0;
  irradiance_.at(is_above ? 0 : 1)->evaluate(view->point, out);
  for (double& value : out) {
    value /= std::numbers::pi;
  }
}

void ComputedPlate::evaluate_exactly(double x, double y, std::span<double> out) const {
  const std::optional<PlateView> view = look(x, y);
  for (std::size_t k = 0; k < squares_.size(); ++k) {
    out[k] = view ? render::light_irradiance(squares_[k], view->point, view->normal) /
                        std::numbers::pi
                  : 0.0;
  }
}

void ComputedPlate::read_tile(const TileRect& rect, std::span<float> out) const {
  HAARLIGHT_EXPECTS(out.size() == count(rect.n_pixels()) * squares_.size(),
                    "room for the tile's values");
  std::vector<double> values(squares_.size());
  for (int p = 0; p < rect.n_pixels(); ++p) {
    const int y = rect.y0 + p / rect.width;
    evaluate(rect.x0 + p % rect.width + 0.5, y + 0.5, values);
    std::transform(values.begin(), values.end(),
                   out.begin() + static_cast<std::ptrdiff_t>(count(p) * squares_.size()),
                   [](double v) { return static_cast<float>(v); });
  }
}

RowSpace fit_row_space(std::span<const double> sample, int n_lights, int n_vectors,
                       int n_iterations) {
  const Eigen::Map<const RowMatrix> rows(
      sample.data(), static_cast<Eigen::Index>(sample.size() / count(n_lights)), n_lights);
  RowSpace space;
  if (rows.rows() == 0) {
    return space;
  }
  const auto k = std::min<Eigen::Index>({n_vectors, rows.rows(), n_lights});
  // Start vectors keyed by index: the same plate gives the same basis on every machine.
  MatrixXd z(n_lights, k);
  for (Eigen::Index j = 0; j < k; ++j) {
    for (Eigen::Index i = 0; i < n_lights; ++i) {
      z(i, j) = uniform_unit(hash_key(0x706c617465, static_cast<std::uint64_t>(i),
                                      static_cast<std::uint64_t>(j))) -
                0.5;
    }
  }
  for (int i = 0; i < n_iterations; ++i) {
    z = orthonormal_columns(rows.transpose() * (rows * z));
  }
  const MatrixXd projected = rows * z;
  const SymmetricEigen eigen = symmetric_eigen(projected.transpose() * projected);
  space.vectors = z * eigen.vectors.rowwise().reverse();
  space.energies = eigen.values.reverse();
  return space;
}

PlateVectors choose_vectors(RowSpace& space, double energy, double target, int max_rank) {
  PlateVectors found;
  double missed = energy;
  while (found.rank < std::min<Eigen::Index>(max_rank, space.vectors.cols()) &&
         std::sqrt(std::max(missed, 0.0) / energy) > target) {
    missed -= space.energies[found.rank];
    // The sign that makes the sum positive, so that the sign does not depend on the solver.
    auto column = space.vectors.col(found.rank);
    column *= column.sum() < 0.0 ? -1.0 : 1.0;
    std::transform(column.begin(), column.end(), std::back_inserter(found.vectors),
                   [](double v) { return static_cast<float>(v); });
    ++found.rank;
  }
  found.missed = energy > 0.0 ? std::sqrt(std::max(missed, 0.0) / energy) : 0.0;
  return found;
}

PlateVectors fit_plate_vectors(const StackSource& plate, double target, int max_rank) {
  const int n_lights = plate.dims().n_lights;
  const std::vector<double> rows = sample_rows(plate);
  RowSpace space = fit_row_space(rows, n_lights, max_rank + kOversampling, kIterations);
  const std::size_t n_rows = rows.size() / count(n_lights);
  return choose_vectors(space, static_cast<double>(n_rows), target, max_rank);
}

}  // namespace haarlight::relight
