// SPDX-License-Identifier: Apache-2.0
#include "render/surface/irradiance_cache.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <utility>
#include <variant>

#include <fmt/format.h>

#include "core/parallel.h"
#include "core/random.h"
#include "haarlight/core/error.h"
#include "render/bsdf/bsdf.h"
#include "render/bsdf/shading_frame.h"
#include "render/surface/specular_direction.h"

namespace haarlight::render {

namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr int kFirstStep = 32;            // pixels
constexpr std::size_t kPerTask = 16;      // records whose rays are cast together
constexpr std::uint32_t kSequences = 16;  // of each, so that packets are full

// Keys of random numbers: not those of the picture.
constexpr std::uint64_t kSeenSeed = 0x15ee;
constexpr std::uint64_t kGatherSeed = 0x6a7e;
enum SeenDimension : std::uint32_t { lens, first_bounce };
constexpr std::uint32_t kPerBounce = 2;
constexpr std::uint32_t kCellDimension = 0;

/// A cube about the scene, with room for the rounding of points.
Vector3d lower_corner(const RayCaster& caster) {
  return caster.scene_middle() - Vector3d::Constant(1.01 * caster.scene_radius_mm());
}

PathOptions with_cache(PathOptions path, const IrradianceOctree* cache) {
  path.cache = cache;
  return path;
}

}  // namespace

/// A near-diffuse point that the camera sees, directly or over other surfaces.
struct IrradianceCacheIntegrator::Seen {
  int x;
  int y;
  Vector3d point;
  Vector3d normal;  ///< shading
  Vector3d flat_normal;
  double offset_mm;
};

IrradianceCacheIntegrator::IrradianceCacheIntegrator(
    const Scene& scene, const RayCaster& caster, const Environment* environment,
    const Camera& camera, const PathOptions& path, const IrradianceCacheOptions& options)
    : scene_(&scene),
      caster_(&caster),
      camera_(camera),
      path_(path),
      options_(options),
      cells_(HemisphereCells::of(options.gather_rays)),
      limits_{.least_mm = options.least_radius * caster.scene_radius_mm(),
              .most_mm = options.most_radius * caster.scene_radius_mm()},
      cache_(lower_corner(caster), 2.02 * caster.scene_radius_mm()),
      gatherer_(scene, caster, environment, camera, with_cache(path, nullptr)),
      display_(scene, caster, environment, camera, with_cache(path, &cache_)) {
  HAARLIGHT_EXPECTS(options.accuracy > 0.0 && options.least_radius > 0.0 &&
                        options.least_radius <= options.most_radius,
                    "records that may be used somewhere");
  fill();
}

/// The first near-diffuse surface on the way of a camera ray.
std::optional<IrradianceCacheIntegrator::Seen> IrradianceCacheIntegrator::seen(int x,
                                                                               int y) const {
  const PixelSamples numbers(path_.sampler, hash_key(path_.seed, kSeenSeed), x, y);
  Ray ray = camera_.ray(x + 0.5, y + 0.5,
                        camera_.has_lens() ? numbers.two(0, lens) : Vector2d(Vector2d::Zero()));
  for (int bounce = 0; bounce < path_.most_bounces; ++bounce) {
    const RawHit raw = caster_->intersect(ray);
    if (!raw.is_hit()) {
      return std::nullopt;
    }
    const Hit hit = caster_->surface_at(ray, raw);
    const Matrix3d world_from_local = shading_frame(hit, ray.direction);
    const Vector3d to_eye = -(world_from_local.transpose() * ray.direction);
    const Bsdf bsdf = bsdf_of(*scene_, hit);
    if (!near_diffuse_albedo(bsdf, to_eye).isZero(0.0)) {
      return Seen{.x = x,
                  .y = y,
                  .point = hit.point,
                  .normal = world_from_local.col(2),
                  .flat_normal = hit.flat_normal,
                  .offset_mm = hit.offset_mm};
    }
    const auto dimension = first_bounce + kPerBounce * static_cast<std::uint32_t>(bounce);
    const double which = numbers.one(0, dimension);
    const Vector2d square = numbers.two(0, dimension + 1);
    BsdfSample next = sample(bsdf, to_eye, which, square);
    Vector3d direction = world_from_local * next.to_light;
    std::visit(
        [&]<class Kind>(const Kind& kind) {
          if constexpr (kIsSpecular<Kind>) {
            mend_specular(kind, ray, hit, to_eye, which, square, next, direction);
          }
        },
        bsdf);
    if (!next.is_found || !is_on_its_side(hit, next, direction)) {
      return std::nullopt;
    }
    const double side = next.is_transmission ? -hit.offset_mm : hit.offset_mm;
    ray = {.origin = hit.point + side * hit.flat_normal, .direction = direction};
  }
  return std::nullopt;
}

void IrradianceCacheIntegrator::fill() {
  fill(kFirstStep, 0, 0);
  for (int step = kFirstStep; step > 1; step /= 2) {
    const int half = step / 2;
    fill(step, half, half);
    fill(step, half, 0);
    fill(step, 0, half);
  }
}

/// Records for the pixels (dx + i step, dy + j step), in 16 batches: of each square of 4 x 4 of them one
/// pixel in turn, far from the one before.
void IrradianceCacheIntegrator::fill(int step, int dx, int dy) {
  std::array<std::vector<Seen>, 16> batches;
  std::vector<std::vector<std::optional<Seen>>> rows;
  for (int y = dy; y < camera_.height(); y += step) {
    rows.emplace_back();
  }
  parallel_for(rows.size(), 1, [&](std::size_t first, std::size_t last) {
    for (std::size_t row = first; row < last; ++row) {
      for (int x = dx; x < camera_.width(); x += step) {
        std::optional<Seen> point = seen(x, dy + step * static_cast<int>(row));
        if (point && cache_.has_records_at(point->point, point->normal)) {
          point.reset();
        }
        rows[row].push_back(std::move(point));
      }
    }
  });
  for (std::size_t row = 0; row < rows.size(); ++row) {
    for (std::size_t column = 0; column < rows[row].size(); ++column) {
      if (const std::optional<Seen>& point = rows[row][column]) {
        // Ordered dither: the bits of x ^ y and y, the lowest first.
        const std::size_t both = row ^ column;
        batches[((both & 1U) << 3U) | ((row & 1U) << 2U) | (both & 2U) | ((row & 2U) >> 1U)]
            .push_back(*point);
      }
    }
  }
  for (std::vector<Seen>& batch : batches) {
    std::erase_if(batch, [&](const Seen& point) {
      return cache_.has_records_at(point.point, point.normal);
    });
    if (batch.empty() || (options_.is_stopped && options_.is_stopped())) {
      continue;
    }
    std::vector<IrradianceRecord> records(batch.size());
    gather(gatherer_, batch, records);
    for (const IrradianceRecord& record : records) {
      cache_.add(record);
    }
    if (cache_.bytes() > options_.memory_bytes) {
      constexpr std::uint64_t kMega = 1'000'000;
      throw Error(fmt::format("the first {} records of irradiance need {} MB; {} MB are left",
                              cache_.records().size(), cache_.bytes() / kMega,
                              options_.memory_bytes / kMega),
                  "--memory", "give a larger --accuracy, a smaller --size, or more --memory",
                  ExitCode::usage);
    }
  }
}

/// Records of points of one batch, each from paths over its hemisphere.
void IrradianceCacheIntegrator::gather(const PathIntegrator& paths,
                                       std::span<const Seen> points,
                                       std::span<IrradianceRecord> records) {
  std::atomic<std::uint64_t> n_rays = 0;
  const auto n_cells = static_cast<std::size_t>(cells_.size());
  parallel_for(points.size(), kPerTask, [&](std::size_t first, std::size_t last) {
    const std::size_t n_points = last - first;
    std::vector<PathIntegrator::Gathered> cells(n_points * n_cells);
    std::vector<Matrix3d> frames;
    std::vector<PixelSamples> sequences;
    for (const Seen& point : points.subspan(first, n_points)) {
      frames.push_back(frame_of(point.normal));
      for (std::uint64_t i = 0; i < kSequences; ++i) {
        sequences.emplace_back(path_.sampler, hash_key(path_.seed, kGatherSeed, i), point.x,
                               point.y);
      }
    }
    std::vector<Ray> rays;
    std::vector<PixelSamples> numbers;
    std::vector<std::size_t> cell_of;
    std::vector<PathIntegrator::Gathered> found;
    for (std::uint32_t sample = 0; std::size_t{sample} * kSequences < n_cells; ++sample) {
      rays.clear();
      numbers.clear();
      cell_of.clear();
      for (std::size_t i = 0; i < n_points; ++i) {
        const Seen& from = points[first + i];
        for (std::uint32_t sequence = 0; sequence < kSequences; ++sequence) {
          const std::size_t cell = std::size_t{sample} * kSequences + sequence;
          if (cell >= n_cells) {
            break;
          }
          const PixelSamples& its = sequences[i * kSequences + sequence];
          const Vector3d direction =
              frames[i] *
              cells_.direction(static_cast<int>(cell), its.two(sample, kCellDimension));
          if (from.flat_normal.dot(direction) > 0.0) {
            rays.push_back({.origin = from.point + from.offset_mm * from.flat_normal,
                            .direction = direction});
            numbers.push_back(its);
            cell_of.push_back(i * n_cells + cell);
          }
        }
      }
      found.assign(rays.size(), {});
      n_rays += paths.gather(sample, numbers, rays, found);
      for (std::size_t i = 0; i < rays.size(); ++i) {
        cells[cell_of[i]] = found[i];
      }
    }
    for (std::size_t i = 0; i < n_points; ++i) {
      IrradianceRecord& record = records[first + i];
      record =
          record_of(points[first + i].point, frames[i], cells_,
                    std::span(cells).subspan(i * n_cells, n_cells), options_.accuracy, limits_);
      if (!options_.has_gradients) {
        record.by_turn.setZero();
        record.by_shift.setZero();
      }
    }
  });
  n_rays_ += n_rays;
}

double IrradianceCacheIntegrator::leave_one_out() const {
  double squares = 0.0;
  double all = 0.0;
  const std::span<const IrradianceRecord> records = cache_.records();
  for (std::size_t i = 0; i < records.size(); ++i) {
    const RecordReach& reach = records[i].reach;
    if (const std::optional<Vector3d> foretold =
            cache_.irradiance_without(i, reach.point, reach.normal)) {
      squares += (*foretold - records[i].irradiance).squaredNorm();
      all += records[i].irradiance.squaredNorm();
    }
  }
  return all > 0.0 ? std::sqrt(squares / all) : 0.0;
}

std::uint64_t IrradianceCacheIntegrator::render_tile(SampleRange samples,
                                                     FilmTile& tile) const {
  return display_.render_tile(samples, tile);
}

}  // namespace haarlight::render
