// SPDX-License-Identifier: Apache-2.0
/// @file
/// A capture of full size through compress: 4000 x 3000 pixels under 1024 lights, made row by
/// row while it is compressed, since 25 GB of pictures are not kept for a benchmark. Prints
/// time, fraction of the time that making the values took, memory, bytes, and the time in which
/// the disk could have read the pictures.

#include <algorithm>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <vector>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/resource.h>
#include <unistd.h>

#include "apps/command_line.h"
#include "apps/run_program.h"
#include "core/parallel.h"
#include "core/random.h"
#include "core/report.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/relight/basis/compress.h"
#include "haarlight/relight/basis/compress_session.h"
#include "relight/basis/plate/plate.h"

namespace haarlight {
namespace {

using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point begin) {
  return std::chrono::duration<double>(Clock::now() - begin).count();
}

struct Arguments {
  std::string rig = "configs/rigs/cube32.toml";
  std::string folder = ".";
  int width = 4000;
  int height = 3000;
  double max_error = 0.0;
  double electrons = 12000.0;
  std::uint64_t memory = std::uint64_t{4} << 30U;
};

/// The rig's plane with a texture and the shadows of balls that hang above it, as a 16-bit
/// camera with photon noise sees it. A pixel costs some nanoseconds per light.
class BallsOverThePlane final : public RowSource {
 public:
  BallsOverThePlane(const Rig& rig, const StackDims& dims, double electrons, int rows_at_once)
      : dims_(dims),
        rows_at_once_(rows_at_once),
        electrons_(electrons),
        camera_(rig.cameras.front().model),
        plane_(rig.planes.front()) {
    for (int k = 0; k < dims.n_lights; ++k) {
      const Eigen::Vector3d at = light_element(rig, k).centre;
      lights_.emplace_back(at.cast<float>());
    }
    for (std::uint64_t i = 0; i < 24; ++i) {
      const auto draw = [i](std::uint64_t axis) {
        return static_cast<float>(uniform_unit(hash_key(0x62616c6c, i, axis)));
      };
      balls_.push_back({400.0F * draw(0) - 200.0F, 300.0F * draw(1) - 150.0F,
                        30.0F + 90.0F * draw(2), 4.0F + 12.0F * draw(3)});
    }
  }

  [[nodiscard]] StackDims dims() const override { return dims_; }
  [[nodiscard]] int rows_at_once() const override { return rows_at_once_; }
  [[nodiscard]] double seconds() const noexcept { return seconds_; }

  void load_rows(int y0, int y1) override {
    if (y0 >= y0_ && y1 <= y1_) {
      return;
    }
    const auto begin = Clock::now();
    const auto width = static_cast<std::size_t>(dims_.width);
    const auto n = static_cast<std::size_t>(dims_.n_lights);
    values_.resize(static_cast<std::size_t>(y1 - y0) * width * n);
    y0_ = y0;
    y1_ = y1;
    parallel_for(static_cast<std::size_t>(y1 - y0), 1, [&](std::size_t from, std::size_t to) {
      for (std::size_t line = from; line < to; ++line) {
        for (std::size_t x = 0; x < width; ++x) {
          make_pixel(static_cast<int>(x), y0 + static_cast<int>(line),
                     values_.data() + (line * width + x) * n);
        }
      }
    });
    seconds_ += seconds_since(begin);
  }

  void read_tile(const TileRect& rect, std::span<float> out) const override {
    const auto n = static_cast<std::size_t>(dims_.n_lights);
    float* to = out.data();
    for (int y = rect.y0; y < rect.y0 + rect.height; ++y) {
      const std::size_t at =
          (static_cast<std::size_t>(y - y0_) * static_cast<std::size_t>(dims_.width) +
           static_cast<std::size_t>(rect.x0)) *
          n;
      to = std::copy_n(values_.data() + at, static_cast<std::size_t>(rect.width) * n, to);
    }
  }

 private:
  struct Ball {
    float x, y, z, radius;
  };

  void make_pixel(int px, int py, float* out) const {
    // Where the pixel's centre sees the plane z = 0 of the cube.
    const CameraRay ray = ray_through(camera_, px + 0.5, py + 0.5);
    const double t =
        -(plane_.n.dot(ray.origin_world) + plane_.d) / plane_.n.dot(ray.direction_world);
    const Eigen::Vector3f at = (ray.origin_world + t * ray.direction_world).cast<float>();
    const float x = at.x();
    const float y = at.y();
    const float albedo = 0.7F + 0.2F * std::sin(0.9F * x) * std::cos(1.1F * y);
    for (std::size_t k = 0; k < lights_.size(); ++k) {
      const float dx = lights_[k].x() - x;
      const float dy = lights_[k].y() - y;
      const float h = lights_[k].z();
      const float r2 = dx * dx + dy * dy + h * h;
      out[k] = albedo * h * h * h * h / (r2 * r2);
    }
    for (const Ball& ball : balls_) {
      // The ball's shadow can only be as far from it as its height allows.
      const float reach = ball.radius + ball.z * 0.8F;
      if (std::abs(ball.x - x) > reach || std::abs(ball.y - y) > reach) {
        continue;
      }
      for (std::size_t k = 0; k < lights_.size(); ++k) {
        const float fraction = ball.z / lights_[k].z();
        const float sx = x + fraction * (lights_[k].x() - x) - ball.x;
        const float sy = y + fraction * (lights_[k].y() - y) - ball.y;
        const float edge = (std::sqrt(sx * sx + sy * sy) - ball.radius) * 0.5F;
        out[k] *= std::clamp(edge + 0.5F, 0.0F, 1.0F);
      }
    }
    // Photon and read noise, roughly Gaussian: the sum of four bytes of a hash.
    std::uint64_t state =
        hash_key(static_cast<std::uint64_t>(py), static_cast<std::uint64_t>(px));
    for (std::size_t k = 0; k < lights_.size(); ++k) {
      state = state * 6364136223846793005ULL + 1442695040888963407ULL;
      const auto bits = static_cast<std::uint32_t>(state >> 32U);
      const float sum = static_cast<float>((bits & 0xffU) + (bits >> 8U & 0xffU) +
                                           (bits >> 16U & 0xffU) + (bits >> 24U)) -
                        510.0F;
      const float e = out[k] * static_cast<float>(electrons_);
      const float noisy = e + sum * (1.0F / 147.8F) * std::sqrt(e + 9.0F);
      out[k] = std::round(noisy) / static_cast<float>(electrons_);  // a step of the camera
    }
  }

  StackDims dims_;
  int rows_at_once_;
  double electrons_;
  CameraModel camera_;
  ShadowPlane plane_;
  std::vector<Eigen::Vector3f> lights_;
  std::vector<Ball> balls_;
  std::vector<float> values_;
  int y0_ = 0;
  int y1_ = 0;
  double seconds_ = 0.0;
};

/// Relative noise of the light transport matrix's values, of a row in the middle.
double noise_of(BallsOverThePlane& rows, double electrons) {
  const StackDims dims = rows.dims();
  const TileRect rect{0, dims.height / 2, dims.width, 1};
  rows.load_rows(rect.y0, rect.y0 + 1);
  std::vector<float> values(static_cast<std::size_t>(dims.width) *
                            static_cast<std::size_t>(dims.n_lights));
  rows.read_tile(rect, values);
  double noise = 0.0;
  double energy = 0.0;
  for (const float v : values) {
    noise += (std::max(0.0, double{v}) * electrons + 9.0) / (electrons * electrons);
    energy += double{v} * double{v};
  }
  return std::sqrt(noise / energy);
}

/// Bytes per second that a file of 1 GiB is read with, past the page cache.
double disk_rate(const std::filesystem::path& folder) {
  const auto file = folder / fmt::format("full-size-disk-{}", ::getpid());
  constexpr std::size_t kPiece = std::size_t{8} << 20U;
  constexpr int kPieces = 128;
  {
    PendingFile out(file);
    const std::vector<std::byte> piece(kPiece, std::byte{0x5a});
    for (int i = 0; i < kPieces; ++i) {
      out.append(piece);
    }
    out.commit();
  }
  const Fd in(::open(file.c_str(), O_RDONLY | O_CLOEXEC));
  ::posix_fadvise(in.get(), 0, 0, POSIX_FADV_DONTNEED);
  std::vector<std::byte> piece(kPiece);
  const auto begin = Clock::now();
  while (::read(in.get(), piece.data(), piece.size()) > 0) {
  }
  const double seconds = seconds_since(begin);
  std::filesystem::remove(file);
  return double{kPieces} * double{kPiece} / seconds;
}

int run(int argc, char** argv) {
  Arguments arguments;
  apps::CommandLine line("relight_full_size",
                         "Compress a capture of full size, made as it is read",
                         std::string(kVersion));
  apps::Command program = line.root();
  program.option("--rig", &arguments.rig, "Rig whose lights and clean plate it has",
                 {.shows_default = true});
  program.option("--folder", &arguments.folder, "Where the basis file is written",
                 {.shows_default = true});
  program.option("--width", &arguments.width, "Pixels", {.shows_default = true});
  program.option("--height", &arguments.height, "Pixels", {.shows_default = true});
  program.option("--max-error", &arguments.max_error, "Asked for; 0: 1.1 times the noise",
                 {.shows_default = true});
  program.option("--electrons", &arguments.electrons, "Of a lit pixel",
                 {.shows_default = true});
  if (const std::optional<ExitCode> end = line.parse(argc, argv)) {
    return static_cast<int>(*end);
  }
  Rig rig = read_rig(arguments.rig);
  CameraModel& camera = rig.cameras.front().model;
  const double scale = double(arguments.width) / camera.width;
  camera.fx *= scale;
  camera.fy *= scale;
  camera.cx *= scale;
  camera.cy *= scale;
  camera.width = arguments.width;
  camera.height = arguments.height;
  const StackDims dims{arguments.width, arguments.height, 1, rig.n_lights()};
  const std::uint64_t row_bytes = std::uint64_t{4} * static_cast<std::uint64_t>(dims.width) *
                                  static_cast<std::uint64_t>(dims.n_lights);
  BallsOverThePlane rows(rig, dims, arguments.electrons,
                         static_cast<int>(arguments.memory / 2 / row_bytes));
  const relight::ComputedPlate plate(rig);
  relight::CompressSource source;
  source.stack = &rows;
  source.rows = &rows;
  source.plate = &plate;
  source.plate_origin = relight::PlateOrigin::computed;
  source.grid = {rig.faces.front().rows, rig.faces.front().cols};
  source.rig_toml = rig.text;
  source.name = "balls over the plane";
  source.key = "balls";
  relight::CompressOptions options;
  options.relative_l2 = arguments.max_error > 0.0
                            ? arguments.max_error
                            : relight::kNoiseTarget * noise_of(rows, arguments.electrons);
  options.memory_bytes = arguments.memory / 2;
  options.progress = ProgressStyle::lines;
  const std::filesystem::path file = std::filesystem::path(arguments.folder) / "full_size.hlb";
  const double bytes_a_second = disk_rate(arguments.folder);
  const auto begin = Clock::now();
  const relight::CompressSummary summary = relight::compress_stack(source, file, options);
  const double seconds = seconds_since(begin);
  rusage usage{};
  ::getrusage(RUSAGE_SELF, &usage);
  const double raw = 2.0 * double(dims.n_pixels()) * dims.n_lights;
  fmt::print(
      "{} x {} pixels, {} lights: {:.2f} GB as 16-bit pictures\n"
      "compressed in {:.0f} s, {:.0f} MB/s; of these {:.0f} s made the values\n"
      "the disk reads the pictures in {:.0f} s ({:.0f} MB/s): {:.0f} % of the time\n"
      "resident at most {:.2f} GB; values looked at {:.2f} times\n"
      "error {:.4g} of {:.4g} requested, {:.1f} coefficients per pixel, {} bytes, {:.1f} times "
      "smaller\n"
      "24 MP in three channels: {:.1f} times as many values, {:.0f} min\n",
      dims.width, dims.height, dims.n_lights, raw * 1e-9, seconds, raw * 1e-6 / seconds,
      rows.seconds(), raw / bytes_a_second, bytes_a_second * 1e-6,
      100.0 * raw / bytes_a_second / seconds, double(usage.ru_maxrss) * 1024e-9,
      double(summary.bytes_moved) / (2.0 * raw), summary.header.achieved.relative_l2,
      options.relative_l2, summary.header.mean_coefficients, summary.bytes,
      raw / double(summary.bytes), 72e6 / double(dims.n_pixels()),
      (seconds - rows.seconds()) * 72e6 / double(dims.n_pixels()) / 60.0);
  std::filesystem::remove(file);
  return 0;
}

}  // namespace
}  // namespace haarlight

int main(int argc, char** argv) {
  return haarlight::apps::run_program("relight_full_size", haarlight::run, argc, argv);
}
