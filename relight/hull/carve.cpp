// SPDX-License-Identifier: Apache-2.0
#include "relight/hull/carve.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <cmath>
#include <limits>
#include <numbers>

#include "core/parallel.h"
#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

constexpr std::uint8_t kUnknown = 255;
/// Lights between two looks at what is empty by now: most of the space is after the first few.
/// At most 16: RowCounts has a bit for each.
constexpr std::uint64_t kBatch = 16;
constexpr int kFiner = 2;  // samples per texel and side, bilinear

/// -ln Q(z), Q the upper tail of the normal distribution.
double tail_worth(double z) {
  return -std::log(std::max(1e-300, 0.5 * std::erfc(z / std::numbers::sqrt2)));
}

/// What a beam of this visibility is worth, in evidence units; 0 for V <= 1/2.
std::uint8_t beam_code(double v, const CarveOptions& options) {
  const double z = (v - 0.5) / options.visibility_sigma;
  const double worth =
      z > 0.0 ? std::min(options.beam_cap, tail_worth(z) - tail_worth(0.0)) : 0.0;
  return static_cast<std::uint8_t>(std::lround(worth * kEvidenceUnits));
}

/// One light's shadow picture as codes, kFiner times finer than the plane picture.
struct CodedPicture {
  int width = 0;
  int height = 0;
  std::vector<std::uint8_t> codes;
};

CodedPicture encode(const Visibility& picture, const std::array<std::uint8_t, 256>& code_of) {
  CodedPicture coded;
  const int w = picture.value.width();
  const int h = picture.value.height();
  coded.width = kFiner * w;
  coded.height = kFiner * h;
  coded.codes.assign(
      static_cast<std::size_t>(coded.width) * static_cast<std::size_t>(coded.height), kUnknown);
  for (int y = 0; y < coded.height; ++y) {
    const double row = (y + 0.5) / kFiner - 0.5;
    const int y0 = std::clamp(static_cast<int>(std::floor(row)), 0, h - 1);
    const int y1 = std::min(y0 + 1, h - 1);
    const double fy = std::clamp(row - y0, 0.0, 1.0);
    for (int x = 0; x < coded.width; ++x) {
      const double column = (x + 0.5) / kFiner - 0.5;
      const int x0 = std::clamp(static_cast<int>(std::floor(column)), 0, w - 1);
      const int x1 = std::min(x0 + 1, w - 1);
      const double fx = std::clamp(column - x0, 0.0, 1.0);
      if (picture.known(y0, x0) == 0 || picture.known(y0, x1) == 0 ||
          picture.known(y1, x0) == 0 || picture.known(y1, x1) == 0) {
        continue;
      }
      const double v = (1.0 - fy) * ((1.0 - fx) * double{picture.value(y0, x0)} +
                                     fx * double{picture.value(y0, x1)}) +
                       fy * ((1.0 - fx) * double{picture.value(y1, x0)} +
                             fx * double{picture.value(y1, x1)});
      coded.codes[static_cast<std::size_t>(y) * static_cast<std::size_t>(coded.width) +
                  static_cast<std::size_t>(x)] =
          v >= 0.0 ? code_of[static_cast<std::size_t>(255.999 * std::min(v, 1.0))] : kUnknown;
    }
  }
  return coded;
}

/// A light's picture on one plane, and its position relative to it.
struct Beam {
  CodedPicture picture;
  PlaneSpot light;
  std::uint16_t bit = 1;  ///< of the light in its batch
};

struct PlaneBeams {
  const PlaneFrame* frame = nullptr;
  std::vector<Beam> beams;
};

/// A row of voxels relative to a plane: heights and picture coordinates of the first voxel's
/// centre, and the step from one to the next.
struct RowOnPlane {
  PlaneSpot first;
  PlaneSpot step;
};

struct RowCounts {
  std::uint16_t* evidence;
  std::uint16_t* seen;
  /// With several planes, instead of `seen`: a bit per light of the batch, so that one whose beam
  /// ends on two planes counts once. Null with a single plane.
  std::uint16_t* seen_bits;
  std::uint16_t bit;  ///< of this light
};

void count_code(std::uint8_t code, std::size_t i, const RowCounts& row) {
  if (code == kUnknown) {
    return;
  }
  if (row.seen_bits == nullptr) {
    row.seen[i] = static_cast<std::uint16_t>(row.seen[i] + (row.seen[i] < 65535 ? 1 : 0));
  } else {
    row.seen_bits[i] = static_cast<std::uint16_t>(row.seen_bits[i] | row.bit);
  }
  row.evidence[i] = static_cast<std::uint16_t>(row.evidence[i] + code);
}

/// Adds one light's codes to voxels `from` to `to` of a row, eq. (4) in the plane picture's coordinates:
/// p = l + (x - l) a/(a - b), a and b the heights of light and voxel.
void add_row(const Beam& beam, const RowOnPlane& row, int from, int to,
             const RowCounts& counts) {
  const CodedPicture& picture = beam.picture;
  const double a = beam.light.height;
  const double lx = kFiner * beam.light.x;
  const double ly = kFiner * beam.light.y;
  const bool is_parallel = row.step.height == 0.0;
  double scale = a / (a - row.first.height);
  if (is_parallel && !(row.first.height / a >= 0.0 && row.first.height / a < 1.0)) {
    return;
  }
  if (is_parallel) {
    // The picture positions move by equal steps: those within the picture are one interval.
    const double x0 = lx + scale * (kFiner * row.first.x - lx);
    const double y0 = ly + scale * (kFiner * row.first.y - ly);
    const double dx = scale * kFiner * row.step.x;
    const double dy = scale * kFiner * row.step.y;
    double begin = from;
    double end = to;
    const auto clip = [&](double at, double step, double size) {
      if (step == 0.0) {
        if (!(at >= 0.0 && at < size)) {
          end = -1.0;
        }
        return;
      }
      const double t0 = -at / step;
      const double t1 = (size - at) / step;
      begin = std::max(begin, std::min(t0, t1));
      end = std::min(end, std::max(t0, t1));
    };
    clip(x0, dx, picture.width);
    clip(y0, dy, picture.height);
    if (!(end > begin)) {
      return;
    }
    const int first = static_cast<int>(std::ceil(begin));
    const int last = std::min(to, static_cast<int>(std::ceil(end)));
    const std::uint8_t* codes = picture.codes.data();
    const auto width = static_cast<std::ptrdiff_t>(picture.width);
    for (int i = first; i < last; ++i) {
      const int column = std::min(picture.width - 1, static_cast<int>(x0 + i * dx));
      const int line = std::min(picture.height - 1, static_cast<int>(y0 + i * dy));
      count_code(codes[line * width + column], static_cast<std::size_t>(i), counts);
    }
    return;
  }
  for (int i = from; i < to; ++i) {
    const double b = row.first.height + i * row.step.height;
    if (!(b / a >= 0.0 && b / a < 1.0)) {
      continue;
    }
    scale = a / (a - b);
    const double x = lx + scale * (kFiner * (row.first.x + i * row.step.x) - lx);
    const double y = ly + scale * (kFiner * (row.first.y + i * row.step.y) - ly);
    if (x >= 0.0 && y >= 0.0 && x < picture.width && y < picture.height) {
      count_code(
          picture.codes[static_cast<std::size_t>(y) * static_cast<std::size_t>(picture.width) +
                        static_cast<std::size_t>(x)],
          static_cast<std::size_t>(i), counts);
    }
  }
}

/// What the beams of one batch say of a row of voxels.
struct RowEvidence {
  std::vector<std::uint16_t> seen_bits;  ///< of RowCounts; empty: a single plane

  /// @return  look-ups
  std::uint64_t add(const VoxelGrid& grid, int y, int z, std::span<const PlaneBeams> planes,
                    std::uint32_t limit, CarveResult& result) {
    const std::size_t at = grid.index(0, y, z);
    // Voxels at the row's ends that are empty already need no more evidence.
    int from = 0;
    int to = grid.nx;
    const auto is_done = [&](int x) {
      return result.is_empty[at + static_cast<std::size_t>(x)] != 0;
    };
    while (from < to && is_done(from)) {
      ++from;
    }
    while (to > from && is_done(to - 1)) {
      --to;
    }
    if (from == to) {
      return 0;
    }
    std::uint64_t n = 0;
    std::fill(seen_bits.begin(), seen_bits.end(), std::uint16_t{0});
    // From the row's first voxel, whatever is skipped, so that every batch rounds alike.
    const Eigen::Vector3d start = grid.world_of(0.5, y + 0.5, z + 0.5);
    const Eigen::Vector3d next = grid.world_of(1.5, y + 0.5, z + 0.5);
    for (const PlaneBeams& plane : planes) {
      RowOnPlane row;
      row.first = locate_point(*plane.frame, start);
      const PlaneSpot second = locate_point(*plane.frame, next);
      row.step = {second.height - row.first.height, second.x - row.first.x,
                  second.y - row.first.y};
      if (std::abs(row.step.height) < 1e-9 * grid.voxel_mm) {
        row.step.height = 0.0;
      }
      for (const Beam& beam : plane.beams) {
        add_row(beam, row, from, to,
                {&result.lit_evidence[at], &result.n_seen[at],
                 seen_bits.empty() ? nullptr : seen_bits.data(), beam.bit});
      }
      n += plane.beams.size() * static_cast<std::size_t>(to - from);
    }
    for (int x = from; x < to; ++x) {
      const std::size_t i = at + static_cast<std::size_t>(x);
      if (!seen_bits.empty()) {
        const int seen =
            result.n_seen[i] + std::popcount(seen_bits[static_cast<std::size_t>(x)]);
        result.n_seen[i] = static_cast<std::uint16_t>(std::min(seen, 65535));
      }
      if (result.lit_evidence[i] >= limit) {
        result.is_empty[i] = 1;
        result.lit_evidence[i] = static_cast<std::uint16_t>(limit);
      }
    }
    return n;
  }
};

/// Whether some of the grid lies between a light and the plane.
bool shines_on_grid(const VoxelGrid& grid, const PlaneFrame& frame, const PlaneSpot& light) {
  for (int corner = 0; corner < 8; ++corner) {
    const Eigen::Vector3d at(corner % 2 == 0 ? 0.0 : grid.nx,
                             corner / 2 % 2 == 0 ? 0.0 : grid.ny,
                             corner / 4 == 0 ? 0.0 : grid.nz);
    const double height = frame.height_of(grid.world_of(at));
    if (height / light.height > 1e-9) {  // on the light's side
      return true;
    }
  }
  return false;
}

/// Lights that shine on some plane past the grid.
int count_lights(const VoxelGrid& grid, std::span<const SamplingPlane> planes,
                 std::span<const render::SquareLight> lights) {
  return static_cast<int>(
      std::count_if(lights.begin(), lights.end(), [&](const render::SquareLight& light) {
        return std::any_of(planes.begin(), planes.end(), [&](const SamplingPlane& plane) {
          return shines_on_grid(grid, plane.frame, locate_point(plane.frame, light.centre));
        });
      }));
}

/// Voxels that a camera sees through, the plane behind them: empty.
void carve_views(const VoxelGrid& grid, std::span<const CarvingView> views,
                 std::vector<std::uint8_t>& is_empty) {
  for (const CarvingView& view : views) {
    parallel_for(static_cast<std::size_t>(grid.nz), 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t z = begin; z < end; ++z) {
        for (int y = 0; y < grid.ny; ++y) {
          for (int x = 0; x < grid.nx; ++x) {
            const auto at = project(
                view.camera, grid.world_of(x + 0.5, y + 0.5, static_cast<double>(z) + 0.5));
            if (at && at->x() >= 0.0 && at->y() >= 0.0 && at->x() < view.shows_plane.width() &&
                at->y() < view.shows_plane.height() &&
                view.shows_plane(static_cast<int>(at->y()), static_cast<int>(at->x())) != 0) {
              is_empty[grid.index(x, y, static_cast<int>(z))] = 1;
            }
          }
        }
      }
    });
  }
}

}  // namespace

CarveResult carve(const VoxelGrid& grid, std::span<const SamplingPlane> planes,
                  std::span<const render::SquareLight> lights,
                  std::span<const CarvingView> views, const CarveOptions& options) {
  HAARLIGHT_EXPECTS(options.visibility_sigma > 0.0 && options.beam_cap > 0.0, "a noise, a cap");
  CarveResult result;
  result.lit_evidence.assign(grid.size(), 0);
  result.n_seen.assign(grid.size(), 0);
  result.is_empty.assign(grid.size(), 0);
  carve_views(grid, views, result.is_empty);
  std::array<std::uint8_t, 256> code_of{};
  for (std::size_t i = 0; i < code_of.size(); ++i) {
    code_of[i] = beam_code((static_cast<double>(i) + 0.5) / 256.0, options);
  }
  const auto limit =
      static_cast<std::uint32_t>(std::lround(options.evidence_limit * kEvidenceUnits));
  std::uint64_t picture_bytes = 1;
  for (const SamplingPlane& plane : planes) {
    picture_bytes += std::uint64_t{kFiner} * kFiner *
                     static_cast<std::uint64_t>(plane.frame.width) *
                     static_cast<std::uint64_t>(plane.frame.height);
  }
  const auto batch = static_cast<std::size_t>(
      std::clamp<std::uint64_t>(options.memory_bytes / picture_bytes, 1, kBatch));
  Progress progress("hull", lights.size(), options.progress);
  std::atomic<std::uint64_t> n_lookups{0};
  result.n_lights = count_lights(grid, planes, lights);
  for (std::size_t first = 0; first < lights.size(); first += batch) {
    const std::size_t last = std::min(lights.size(), first + batch);
    std::vector<PlaneBeams> beams(planes.size());
    for (std::size_t p = 0; p < planes.size(); ++p) {
      beams[p].frame = &planes[p].frame;
      for (std::size_t k = first; k < last; ++k) {
        const PlaneSpot light = locate_point(planes[p].frame, lights[k].centre);
        if (shines_on_grid(grid, planes[p].frame, light)) {
          beams[p].beams.push_back({encode(planes[p].visibility(static_cast<int>(k)), code_of),
                                    light, static_cast<std::uint16_t>(1U << (k - first))});
        }
      }
    }
    parallel_for(static_cast<std::size_t>(grid.nz), 1, [&](std::size_t begin, std::size_t end) {
      std::uint64_t n = 0;
      RowEvidence row;
      row.seen_bits.resize(planes.size() > 1 ? static_cast<std::size_t>(grid.nx) : 0);
      for (std::size_t z = begin; z < end; ++z) {
        for (int y = 0; y < grid.ny; ++y) {
          n += row.add(grid, y, static_cast<int>(z), beams, limit, result);
        }
      }
      n_lookups += n;
    });
    for (std::size_t k = first; k < last; ++k) {
      progress.advance();
    }
  }
  result.n_lookups = n_lookups;
  return result;
}

}  // namespace haarlight::relight
