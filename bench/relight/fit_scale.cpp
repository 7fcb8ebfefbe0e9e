// SPDX-License-Identifier: Apache-2.0
/// @file
/// Fits at full size: pictures made row by row in memory, or JPEGs written for the run and
/// removed after it. Prints processor seconds a megapixel (reading apart where it can be told
/// apart), wall clock and memory: the tables of docs/numerics/reflectance-fits.md.

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <numbers>
#include <numeric>
#include <vector>

#include <fmt/format.h>
#include <jpeglib.h>
#include <sys/resource.h>

#include "apps/command_line.h"
#include "core/parallel.h"
#include "core/report.h"
#include "haarlight/core/error.h"
#include "relight/reflectance/fit/light_interpolation.h"
#include "relight/reflectance/fit/near_fit.h"
#include "relight/reflectance/fit/parameter_choice.h"

namespace haarlight {
namespace {

namespace fs = std::filesystem;

struct Arguments {
  std::string basis = "hsh9";
  std::string from = "memory";
  std::string near = "off";
  std::string transfer = "srgb";
  std::string folder = ".";
  double megapixels = 1.0;
  int n_lights = 50;
  int threads = 0;
  bool is_checked = false;
  double memory_mb = 512.0;
};

double processor_seconds() {
  rusage usage{};
  ::getrusage(RUSAGE_SELF, &usage);
  const auto seconds = [](const timeval& time) {
    return static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_usec);
  };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

/// Lights over the hemisphere, or a square array 300 mm above a picture 300 mm wide.
std::vector<Eigen::Vector3d> positions_of(int n, bool is_near) {
  std::vector<Eigen::Vector3d> positions;
  const int side = static_cast<int>(std::ceil(std::sqrt(n)));
  for (int i = 0; i < n; ++i) {
    if (is_near) {
      positions.emplace_back(930.0 * ((i % side + 0.5) / side - 0.5),
                             930.0 * ((i / side + 0.5) / side - 0.5), 300.0);
      continue;
    }
    const double z = 0.15 + 0.85 * (i + 0.5) / n;
    const double phi = i * std::numbers::pi * (3.0 - std::sqrt(5.0));
    positions.emplace_back(std::sqrt(1.0 - z * z) * std::cos(phi),
                           std::sqrt(1.0 - z * z) * std::sin(phi), z);
  }
  return positions;
}

/// A matte relief with a little noise, one period of rows: what is read is copied from here.
class PeriodicRows final : public relight::PictureRows {
 public:
  PeriodicRows(int width, int height, const std::vector<Eigen::Vector3d>& positions,
               Transfer transfer)
      : shape_{width, height, 3, static_cast<int>(positions.size())}, transfer_(transfer) {
    const auto n_row = static_cast<std::size_t>(width) * 3;
    rows_.resize(kPeriod * positions.size() * n_row);
    parallel_for(kPeriod, 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t y = begin; y < end; ++y) {
        for (std::size_t k = 0; k < positions.size(); ++k) {
          const Eigen::Vector3d light = positions[k].normalized();
          std::uint16_t* row = &rows_[(y * positions.size() + k) * n_row];
          for (std::size_t x = 0; x < static_cast<std::size_t>(width); ++x) {
            const double u = 0.05 * static_cast<double>(x);
            const double v = 2.0 * std::numbers::pi * static_cast<double>(y) / kPeriod;
            const Eigen::Vector3d n =
                Eigen::Vector3d(0.6 * std::sin(u + v), 0.5 * std::cos(0.7 * u), 1.0)
                    .normalized();
            const double shade = std::max(0.0, n.dot(light));
            for (std::size_t c = 0; c < 3; ++c) {
              const double noise =
                  0.004 * std::sin(static_cast<double>((x * 131 + y * 71 + k * 37 + c) % 997));
              const auto value =
                  static_cast<float>((0.5 + 0.15 * static_cast<double>(c)) * shade + noise);
              const float coded = transfer == Transfer::srgb ? srgb_from_linear(value) : value;
              row[3 * x + c] =
                  static_cast<std::uint16_t>(std::clamp(coded, 0.0F, 1.0F) * 65535.0F);
            }
          }
        }
      }
    });
  }
  [[nodiscard]] StackDims dims() const override { return shape_; }
  [[nodiscard]] Transfer transfer() const override { return transfer_; }
  void rewind() override { y_ = 0; }
  void skip(int n_rows) override { y_ += static_cast<std::size_t>(n_rows); }
  void read(int n_rows, std::span<std::uint16_t> out) override {
    const double start = processor_seconds();
    const std::size_t n = rows_.size() / kPeriod;
    for (std::size_t i = 0; i < static_cast<std::size_t>(n_rows); ++i) {
      std::copy_n(&rows_[(y_ + i) % kPeriod * n], n, &out[i * n]);
    }
    y_ += static_cast<std::size_t>(n_rows);
    seconds_ += processor_seconds() - start;
  }
  [[nodiscard]] double seconds() const { return seconds_; }

 private:
  static constexpr std::size_t kPeriod = 8;
  StackDims shape_;
  Transfer transfer_;
  std::vector<std::uint16_t> rows_;
  std::size_t y_ = 0;
  double seconds_ = 0.0;
};

/// Rows as a JPEG of quality 92, 4:2:0, as cameras write them.
void write_jpeg(const fs::path& path, PeriodicRows& rows) {
  const StackDims shape = rows.dims();
  jpeg_compress_struct info{};
  jpeg_error_mgr errors{};
  info.err = jpeg_std_error(&errors);
  jpeg_create_compress(&info);
  std::FILE* file = std::fopen(path.c_str(), "wb");
  if (file == nullptr) {
    throw Error("cannot be written", path.string(), "name another --folder", ExitCode::io);
  }
  jpeg_stdio_dest(&info, file);
  info.image_width = static_cast<JDIMENSION>(shape.width);
  info.image_height = static_cast<JDIMENSION>(shape.height);
  info.input_components = 3;
  info.in_color_space = JCS_RGB;
  jpeg_set_defaults(&info);
  jpeg_set_quality(&info, 92, TRUE);
  jpeg_start_compress(&info, TRUE);
  std::vector<std::uint16_t> codes(static_cast<std::size_t>(shape.width) * 3);
  std::vector<JSAMPLE> bytes(codes.size());
  rows.rewind();
  for (int y = 0; y < shape.height; ++y) {
    rows.read(1, codes);
    std::transform(codes.begin(), codes.end(), bytes.begin(),
                   [](std::uint16_t code) { return static_cast<JSAMPLE>(code / 257); });
    JSAMPROW lines[1] = {bytes.data()};
    jpeg_write_scanlines(&info, lines, 1);
  }
  jpeg_finish_compress(&info);
  jpeg_destroy_compress(&info);
  std::fclose(file);
}

/// Pictures of a run, removed with it.
class JpegFolder {
 public:
  JpegFolder(const Arguments& arguments, int width, int height,
             const std::vector<Eigen::Vector3d>& positions)
      : folder_(fs::path(arguments.folder) / "fit_scale_jpegs") {
    fs::create_directories(folder_);
    for (std::size_t k = 0; k < positions.size(); ++k) {
      pictures_.push_back(folder_ / fmt::format("{:04}.jpg", k));
    }
    parallel_for(positions.size(), 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t k = begin; k < end; ++k) {
        PeriodicRows rows(width, height, {positions[k]}, Transfer::srgb);
        write_jpeg(pictures_[k], rows);
      }
    });
  }
  ~JpegFolder() {
    std::error_code ignored;
    fs::remove_all(folder_, ignored);
  }
  JpegFolder(const JpegFolder&) = delete;
  JpegFolder& operator=(const JpegFolder&) = delete;
  [[nodiscard]] const std::vector<fs::path>& pictures() const { return pictures_; }
  [[nodiscard]] std::uintmax_t bytes() const {
    std::uintmax_t sum = 0;
    for (const fs::path& path : pictures_) {
      sum += fs::file_size(path);
    }
    return sum;
  }

 private:
  fs::path folder_;
  std::vector<fs::path> pictures_;
};

/// Mean square of a near fit's pictures against those of the solution in double, over nine
/// directions and some pixels, of white.
double mean_square(const relight::ReflectanceModel& model, relight::PictureRows& rows,
                   const relight::NearGeometry& geometry,
                   const relight::NearFitOptions& options) {
  const StackDims shape = rows.dims();
  const auto n_lights = static_cast<std::size_t>(shape.n_lights);
  const Eigen::MatrixXd terms =
      relight::terms_of(options.basis, options.n_terms, positions_of(9, false));
  const int n = options.n_terms;
  constexpr int kRows = 23;
  constexpr int kColumns = 41;
  std::vector<std::uint16_t> row(n_lights * static_cast<std::size_t>(shape.width) * 3);
  std::vector<double> sums(kColumns);
  rows.rewind();
  int next = 0;
  for (int i = 0; i < kRows; ++i) {
    const int y = (2 * i + 1) * shape.height / (2 * kRows);
    rows.skip(y - next);
    rows.read(1, row);
    next = y + 1;
    parallel_for(kColumns, 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t k = begin; k < end; ++k) {
        const int x = (2 * static_cast<int>(k) + 1) * shape.width / (2 * kColumns);
        Eigen::VectorXd values(3 * shape.n_lights);
        for (int l = 0; l < shape.n_lights; ++l) {
          for (int c = 0; c < 3; ++c) {
            values[3 * l + c] =
                row[(static_cast<std::size_t>(l) * static_cast<std::size_t>(shape.width) +
                     static_cast<std::size_t>(x)) *
                        3 +
                    static_cast<std::size_t>(c)] /
                65535.0;
          }
        }
        Eigen::VectorXd planes =
            relight::near_planes_of(geometry, options, values, x + 0.5, y + 0.5);
        for (int p = 0; p < 3 * n; ++p) {
          const relight::PlaneScale& scale = model.scales[static_cast<std::size_t>(p)];
          planes[p] -= model.planes(y, x, p) * scale.scale + scale.offset;
        }
        for (int c = 0; c < 3; ++c) {
          sums[k] += (terms * planes.segment(Eigen::Index{c} * n, n)).squaredNorm();
        }
      }
    });
  }
  return std::accumulate(sums.begin(), sums.end(), 0.0) / (kRows * kColumns * 9.0 * 3.0);
}

double decibels(double mean_square) { return -10.0 * std::log10(std::max(mean_square, 1e-12)); }

/// What interpolating costs: beside the exact fit, and beside the solution in double, from
/// which the exact fit's bytes are some way off too.
void print_check(const relight::FitResult& result, relight::PictureRows& rows,
                 const relight::NearGeometry& geometry, relight::NearFitOptions options) {
  options.solve = relight::NearSolve::exact;
  const relight::FitResult exact = relight::fit_near(rows, geometry, options);
  const double of_exact = mean_square(exact.model, rows, geometry, options);
  const double of_result = mean_square(result.model, rows, geometry, options);
  const double more = std::max(0.0, of_result - of_exact);
  const double picture = std::pow(10.0, -3.7);
  fmt::print(
      "from the solution in double: exact fit {:.2f} dB, this fit {:.2f} dB, {:.2f} dB "
      "beyond the bytes'; a picture 37 dB from the truth loses {:.4f} dB\n",
      decibels(of_exact), decibels(of_result), decibels(more),
      10.0 * std::log10(1.0 + more / picture));
}

int run(const Arguments& arguments) {
  std::optional<ThreadLimit> limit;
  if (arguments.threads > 0) {
    limit.emplace(arguments.threads);
  }
  const int width = static_cast<int>(std::lround(std::sqrt(1.5e6 * arguments.megapixels)));
  const int height =
      static_cast<int>(std::lround(1e6 * arguments.megapixels / static_cast<double>(width)));
  const bool is_near = arguments.near != "off";
  const std::vector<Eigen::Vector3d> positions = positions_of(arguments.n_lights, is_near);
  std::unique_ptr<JpegFolder> jpegs;
  std::unique_ptr<relight::PictureRows> rows;
  PeriodicRows* made = nullptr;
  if (arguments.from == "jpeg") {
    jpegs = std::make_unique<JpegFolder>(arguments, width, height, positions);
    rows = relight::jpeg_rows(jpegs->pictures());
    fmt::print("{:.2f} GB of JPEG\n", 1e-9 * static_cast<double>(jpegs->bytes()));
  } else {
    auto periodic = std::make_unique<PeriodicRows>(width, height, positions,
                                                   is_near ? Transfer::linear : Transfer::srgb);
    made = periodic.get();
    rows = std::move(periodic);
  }
  std::vector<Eigen::Vector3d> directions;
  for (const Eigen::Vector3d& position : positions) {
    directions.push_back(position.normalized());
  }
  relight::PlaneOptions planes;
  planes.memory_bytes = static_cast<std::uint64_t>(arguments.memory_mb * 1e6);
  planes.work_folder = arguments.folder;
  const double start = processor_seconds();
  const auto wall = std::chrono::steady_clock::now();
  relight::FitResult result;
  double choosing = 0.0;
  if (is_near) {
    relight::NearGeometry geometry;
    for (const Eigen::Vector3d& position : positions) {
      relight::NearLight light;
      light.position_mm = position;
      light.mu = 1.0;
      geometry.lights.push_back(light);
    }
    geometry.points = relight::PixelPoints::orthographic(width, height, 300.0);
    geometry.reference_mm = 475.0;  // the lights' mean
    relight::NearFitOptions options;
    options.basis = arguments.basis == "ptm" ? relight::ReflectanceBasis::ptm
                                             : relight::ReflectanceBasis::hsh;
    options.n_terms = arguments.basis == "ptm" ? 6 : (arguments.basis == "hsh4" ? 4 : 9);
    options.solve = arguments.near == "exact" ? relight::NearSolve::exact
                                              : relight::NearSolve::interpolated;
    options.transfer = arguments.transfer == "linear" ? Transfer::linear : Transfer::srgb;
    options.planes = planes;
    result = relight::fit_near(*rows, geometry, options);
    if (arguments.is_checked) {
      print_check(result, *rows, geometry, options);
      return 0;
    }
  } else {
    const relight::FitForm form = *value_of<relight::FitForm>(arguments.basis);
    relight::FormOptions options;
    relight::LightSample sample;
    relight::LightInterpolation interpolation;
    if (form == relight::FitForm::rbf || form == relight::FitForm::bilinear) {
      sample = relight::sample_lights(*rows);
      interpolation =
          relight::score_forms({form}, directions, sample, options).front().interpolation;
      choosing = processor_seconds() - start;
    } else {
      interpolation = relight::candidates_of(form, options)[4];
    }
    relight::FarFitOptions far;
    far.planes = planes;
    result = relight::fit_far(
        *rows, relight::make_far_fit(form, interpolation, directions, sample, options), far);
  }
  const double seconds = processor_seconds() - start;
  const double reading = made != nullptr ? made->seconds() : 0.0;
  const double mp = 1e-6 * width * static_cast<double>(height);
  fmt::print(
      "{} x {} under {} lights, {} near {} {} from {}: {:.3f} CPU s/MP ({:.3f} choosing, "
      "{:.3f} "
      "copying rows, {:.3f} without), {:.1f} s wall, peak {:.2f} GB, {} planes\n",
      width, height, arguments.n_lights, arguments.basis, arguments.near, arguments.transfer,
      arguments.from, seconds / mp, choosing / mp, reading / mp,
      (seconds - reading - choosing) / mp,
      std::chrono::duration<double>(std::chrono::steady_clock::now() - wall).count(),
      1e-9 * static_cast<double>(peak_memory_bytes()), result.model.n_planes());
  return 0;
}

}  // namespace
}  // namespace haarlight

int main(int argc, char** argv) {
  using namespace haarlight;
  Arguments arguments;
  apps::CommandLine line("relight_fit_scale", "What fits cost at full size",
                         std::string(kVersion));
  apps::Command root = line.root();
  root.option("--basis", &arguments.basis, "ptm, lptm, hsh4, hsh9, hsh16, rbf or bilinear");
  root.option("--near", &arguments.near, "Near lights",
              {.choices = {"off", "exact", "interpolated"}});
  root.option("--transfer", &arguments.transfer, "Near: what is fitted",
              {.choices = {"srgb", "linear"}});
  root.flag("--check", &arguments.is_checked, "Near: compare with the exact solution instead");
  root.option("--from", &arguments.from, "Where pictures are", {.choices = {"memory", "jpeg"}});
  root.option("--folder", &arguments.folder, "For JPEGs and 16-bit planes", {.type = "FOLDER"});
  root.option("--megapixels", &arguments.megapixels, "Size",
              {.bounds = apps::Bounds{0.001, 1000.0}});
  root.option("--lights", &arguments.n_lights, "Lights",
              {.bounds = apps::Bounds{1.0, 100000.0}});
  root.option("--threads", &arguments.threads, "Threads",
              {.bounds = apps::Bounds{1.0, 1024.0}});
  root.option("--memory-mb", &arguments.memory_mb, "For 16-bit planes; beyond it a file",
              {.bounds = apps::Bounds{0.0, 1e6}});
  if (const std::optional<ExitCode> end = line.parse(argc, argv)) {
    return static_cast<int>(*end);
  }
  try {
    return run(arguments);
  } catch (const std::exception& error) {
    fmt::print(stderr, "{}\n", error.what());
    return 1;
  }
}
