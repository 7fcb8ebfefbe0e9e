// SPDX-License-Identifier: Apache-2.0
/// @file
/// The speed-for-accuracy table: one capture compressed to several errors, then relit; bytes,
/// milliseconds (medians of interleaved runs), error against the uncompressed stack. From a
/// session, or from a scene rendered as the twin's figures were defined; a scene is also
/// rendered anew under each lighting of few lights, all lights at once: a truth that no stack
/// has a part in.

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <functional>
#include <memory>
#include <numbers>
#include <optional>

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

#include "apps/command_line.h"
#include "apps/run_program.h"
#include "core/order_statistics.h"
#include "core/random.h"
#include "core/report.h"
#include "core/tradeoff.h"
#include "haarlight/core/error.h"
#include "haarlight/core/tolerance.h"
#include "haarlight/relight/basis/compress_session.h"
#include "haarlight/relight/basis/relight.h"
#include "haarlight/render/direct/picture.h"
#include "haarlight/render/light/rig_lights.h"
#include "haarlight/render/scene/scene.h"
#include "haarlight/session/develop/develop.h"
#include "relight/basis/plate/plate.h"
#include "relight/basis/weight_list.h"

#include "bench/relight/twin.h"

namespace haarlight {
namespace {

struct Arguments {
  std::string session;
  std::string rig = "configs/rigs/cube32.toml";
  std::string scene;
  std::string lightings;
  bool has_no_plate = false;
  int repeats = 9;
  double electrons = 0.0;
  double electrons_a_step = 0.0;
  std::vector<double> errors = {0.01, 0.001, 0.0};
};

/// One lighting of one file.
struct Row {
  std::string mode;
  std::string lighting;
  double error = 0.0;
  double worst_pixel = 0.0;
  double psnr_db = 0.0;
  double bound = 0.0;
  int terms = 0;
  double milliseconds = 0.0;
  std::uint64_t bytes = 0;
  std::optional<Achieved> direct;  ///< against the scene rendered under these lights
};

/// Shot and read noise as the twin's README has it: `electrons` for a lit pixel, 3 to read.
void add_noise(MemoryStack& stack, double electrons) {
  const StackDims dims = stack.dims();
  for (int y = 0; y < dims.height; ++y) {
    for (int x = 0; x < dims.width; ++x) {
      for (int k = 0; k < dims.n_lights; ++k) {
        float& value = stack.at(0, y, x, k);
        const double signal = std::max(0.0, double{value}) * electrons;
        const double sigma = std::sqrt(signal + 9.0);
        value = static_cast<float>(
            (signal +
             sigma * standard_normal(hash_key(1,
                                              static_cast<std::uint64_t>(y) *
                                                      static_cast<std::uint64_t>(dims.width) +
                                                  static_cast<std::uint64_t>(x),
                                              static_cast<std::uint64_t>(k)))) /
            electrons);
      }
    }
  }
}

std::vector<std::pair<std::string, relight::LightWeights>> lightings(const Arguments& arguments,
                                                                     int n) {
  std::vector<std::pair<std::string, relight::LightWeights>> all;
  if (n == 1024) {
    all.emplace_back("nine lights",
                     relight::weights_from_words({"165,176,186,517,528,538,837,848,858"}, n));
  } else {
    all.emplace_back("one light", relight::weights_from_words({std::to_string(n / 2)}, n));
  }
  if (!arguments.lightings.empty()) {
    const auto root = nlohmann::json::parse(std::ifstream(arguments.lightings));
    for (const auto& [name, rows] : root.items()) {
      relight::LightWeights w(n, 1);
      Eigen::Index k = 0;
      for (const auto& row : rows) {
        for (const auto& value : row) {
          w(k++, 0) = value.get<double>();
        }
      }
      all.emplace_back("twin " + name, std::move(w));
    }
  }
  return all;
}

/// The scene under all lights of a lighting at once: 64 x 64 strata per light and random
/// numbers of its own, so that only the definition is shared with the stack. Mono: mean of the
/// colours.
Image<float> render_directly(const bench::Twin& twin, const relight::LightWeights& weights) {
  std::vector<Eigen::Vector3d> radiances;
  for (Eigen::Index k = 0; k < weights.rows(); ++k) {
    radiances.emplace_back(Eigen::Vector3d::Constant(weights(k, 0)));
  }
  render::LitOptions options;
  options.direct.seed = 9;
  options.direct.mixed_grid = 64;
  const render::LitPicture lit =
      render::render_lit(twin.scene, twin.rig.cameras.front().model,
                         render::rig_lights(twin.rig), radiances, options);
  Image<float> picture(lit.radiance.height(), lit.radiance.width(), 1);
  for (int y = 0; y < picture.height(); ++y) {
    for (int x = 0; x < picture.width(); ++x) {
      const double sum =
          double{lit.radiance(y, x, 0)} + double{lit.radiance(y, x, 1)} + lit.radiance(y, x, 2);
      picture(y, x) = static_cast<float>(sum / (3.0 * twin.scale));
    }
  }
  return picture;
}

/// A capture, what to take off it, and what speaks for its lights.
struct Capture {
  std::optional<bench::Twin> twin;
  std::optional<MemoryStack> memory;
  std::optional<MemoryStack> clean;  ///< before noise was added
  std::unique_ptr<StackSource> file_source;
  std::unique_ptr<StackSource> plate;
  relight::CompressSource source;
};

Capture open_capture(const Arguments& arguments) {
  Capture capture;
  if (!arguments.session.empty()) {
    const session::Session session = session::Session::open(arguments.session);
    session::DevelopOptions options;
    options.plate = relight::sharing_plate(session, {});
    capture.file_source = std::make_unique<LightStack>(session::develop(session, options));
    capture.source.stack = capture.file_source.get();
    capture.source.grid = relight::haar_grid(session.info());
    if (!arguments.has_no_plate && session.rig()) {
      const StackDims dims = capture.source.stack->dims();
      const int camera = relight::camera_of_size(*session.rig(), dims.width, dims.height);
      if (camera >= 0) {
        capture.plate = std::make_unique<relight::ComputedPlate>(*session.rig(), camera);
      }
    }
    capture.source.name = arguments.session;
  } else {
    bench::TwinStack made = bench::render_twin(arguments.rig, arguments.scene);
    capture.memory = std::move(made.stack);
    capture.twin = std::move(made.twin);
    const Rig& rig = capture.twin->rig;
    if (arguments.electrons > 0.0) {
      capture.clean = capture.memory;
      add_noise(*capture.memory, arguments.electrons);
    }
    capture.source.stack = &*capture.memory;
    capture.source.grid = {rig.faces.front().rows, rig.faces.front().cols};
    if (!arguments.has_no_plate) {
      capture.plate = std::make_unique<MemoryStack>(read_all(relight::ComputedPlate(rig)));
    }
    capture.source.name = arguments.scene;
  }
  capture.source.plate = capture.plate.get();
  capture.source.plate_origin =
      capture.plate ? relight::PlateOrigin::computed : relight::PlateOrigin::none;
  capture.source.lights.resize(static_cast<std::size_t>(capture.source.stack->dims().n_lights));
  return capture;
}

/// ||stack - clean|| / ||clean||.
double distance(const StackSource& stack, const MemoryStack& clean) {
  const MemoryStack all = read_all(stack);
  return compare(all.values(), clean.values()).relative_l2;
}

/// The noisy stack as a camera's whole steps, exactly; beside it what its noise alone takes:
/// the entropy of a rounded normal distribution, log2(sigma sqrt(2 pi e)) bits per value.
void print_whole_steps(const Capture& capture, const Arguments& arguments,
                       const std::filesystem::path& folder) {
  const StackDims dims = capture.memory->dims();
  std::vector<float> values(capture.memory->values().begin(), capture.memory->values().end());
  const double unit = arguments.electrons_a_step / arguments.electrons;
  double bits = 0.0;
  for (std::size_t i = 0; i < values.size(); ++i) {
    const double clean = std::max(0.0, double{capture.clean->values()[i]});
    const double sigma =
        std::sqrt(clean * arguments.electrons + 9.0) / arguments.electrons_a_step;
    bits += std::log2(sigma * std::sqrt(2.0 * std::numbers::pi * std::numbers::e));
    values[i] = static_cast<float>(std::round(double{values[i]} / unit) * unit);
  }
  const MemoryStack whole(dims, std::move(values));
  relight::CompressSource source = capture.source;
  source.stack = &whole;
  source.units.assign(static_cast<std::size_t>(dims.n_lights), unit);
  relight::CompressOptions options;
  options.is_integer = true;
  const relight::CompressSummary summary =
      relight::compress_stack(source, folder / "whole.hlb", options);
  const double raw = 2.0 * static_cast<double>(whole.values().size());
  fmt::print(
      "whole steps of {:g} electrons: {} bytes, {:.3f} times smaller than 16 bits; the noise "
      "alone allows {:.3f}; worst value {:.2g}\n",
      arguments.electrons_a_step, summary.bytes, raw / double(summary.bytes), 8.0 * raw / bits,
      summary.header.achieved.worst_value);
}

std::vector<Row> measure(const Capture& capture, const Arguments& arguments,
                         const std::filesystem::path& folder) {
  struct File {
    std::string mode;
    relight::BasisFile basis;
    relight::RelightOptions options;
  };
  std::vector<File> files;
  fmt::print(
      "| mode | bytes | times smaller than 16 bits | coefficients per pixel | plate vectors | "
      "achieved: stack | worst pixel | worst light | seconds to compress |\n"
      "|---|---|---|---|---|---|---|---|---|\n");
  const StackDims dims = capture.source.stack->dims();
  const double raw = 2.0 * double(dims.n_pixels()) * dims.channels * dims.n_lights;
  std::vector<double> errors = arguments.errors;
  if (capture.clean) {
    const double noise = distance(*capture.source.stack, *capture.clean);
    fmt::print("noise: {:.4g} of the stack's norm\n", noise);
    errors.insert(errors.begin(), noise);
    if (arguments.electrons_a_step > 0.0) {
      print_whole_steps(capture, arguments, folder);
    }
  }
  for (const double error : errors) {
    const std::string mode = error == 0.0 ? "exact" : fmt::format("{:g} %", 100.0 * error);
    const auto path = folder / (mode.substr(0, mode.find(' ')) + ".hlb");
    relight::CompressOptions options;
    options.relative_l2 = error;
    std::optional<relight::CompressSummary> summary;
    const double seconds =
        seconds_of([&] { summary = relight::compress_stack(capture.source, path, options); });
    const relight::BasisHeader& header = summary->header;
    fmt::print("| {} | {} | {:.1f} | {:.1f} | {} | {:.3g} | {:.3g} | {:.3g} | {:.2f} |\n", mode,
               summary->bytes, raw / double(summary->bytes), header.mean_coefficients,
               header.plate_rank, header.achieved.relative_l2, header.achieved.worst_pixel,
               summary->worst_light, seconds);
    files.push_back({mode, relight::BasisFile::open(path), {}});
    if (capture.clean) {
      const double left = distance(relight::BasisSource(files.back().basis), *capture.clean);
      fmt::print("  from the noise-free stack: {:.4g}\n", left);
    }
    if (error == 0.0) {
      for (const double fast : {0.01, 0.001}) {
        relight::RelightOptions fast_options;
        fast_options.max_error = fast;
        files.push_back({fmt::format("{}, fast {:g} %", mode, 100.0 * fast),
                         relight::BasisFile::open(path), fast_options});
      }
    } else if (error < 0.01) {
      relight::RelightOptions fast_options;
      fast_options.max_error = 0.02;
      files.push_back({mode + ", fast 2 %", relight::BasisFile::open(path), fast_options});
    }
  }
  std::vector<Row> rows;
  for (const auto& lighting : lightings(arguments, dims.n_lights)) {
    const std::string& name = lighting.first;
    const relight::LightWeights& weights = lighting.second;
    const Image<float> truth = relight::relight_stack(*capture.source.stack, weights);
    constexpr Eigen::Index kFewLights = 16;
    std::optional<Image<float>> direct;
    if (capture.twin && (weights.array() != 0.0).count() <= kFewLights) {
      direct = render_directly(*capture.twin, weights);
    }
    const auto against_direct = [&](const Image<float>& picture) {
      return direct ? std::optional(compare(picture.pixels(), direct->pixels())) : std::nullopt;
    };
    std::vector<relight::RelitPicture> pictures(files.size());
    std::vector<std::function<void()>> runs;
    for (std::size_t i = 0; i < files.size(); ++i) {
      runs.emplace_back([&, i] {
        pictures[i] = relight::relight(files[i].basis, weights, files[i].options);
      });
    }
    runs.emplace_back([&] { (void)relight::relight_stack(*capture.source.stack, weights); });
    const std::vector<std::vector<double>> times = time_in_turn(runs, arguments.repeats);
    for (std::size_t i = 0; i < files.size(); ++i) {
      const Achieved found = compare(pictures[i].picture.pixels(), truth.pixels());
      rows.push_back({files[i].mode, name, found.relative_l2, found.worst_pixel, found.psnr_db,
                      pictures[i].bound.relative_l2, pictures[i].terms,
                      1e3 * upper_median(times[i]), files[i].basis.n_bytes(),
                      against_direct(pictures[i].picture)});
    }
    rows.push_back({"whole stack", name, 0.0, 0.0, INFINITY, 0.0, dims.n_lights,
                    1e3 * upper_median(times.back()), static_cast<std::uint64_t>(2.0 * raw),
                    against_direct(truth)});
  }
  return rows;
}

void print_rows(const std::vector<Row>& rows) {
  fmt::print(
      "\n| lighting | mode | bytes | terms | ms | relative L2 | promised | worst pixel | PSNR "
      "dB "
      "| from direct rendering: relative L2 | PSNR dB |\n"
      "|---|---|---|---|---|---|---|---|---|---|---|\n");
  for (const Row& row : rows) {
    fmt::print("| {} | {} | {} | {} | {:.1f} | {:.2g} | {:.2g} | {:.2g} | {:.1f} | {} | {} |\n",
               row.lighting, row.mode, row.bytes, row.terms, row.milliseconds, row.error,
               row.bound, row.worst_pixel, row.psnr_db,
               row.direct ? fmt::format("{:.2g}", row.direct->relative_l2) : "",
               row.direct ? fmt::format("{:.1f}", row.direct->psnr_db) : "");
  }
}

int run(int argc, char** argv) {
  Arguments arguments;
  apps::CommandLine line("relight_accuracy",
                         "Speed for accuracy: compress a capture and relight it",
                         std::string(kVersion));
  apps::Command program = line.root();
  program.option("SESSION", &arguments.session, "Session folder");
  program.option("--rig", &arguments.rig, "Rig of the twin", {.shows_default = true});
  program.option("--scene", &arguments.scene,
                 "Scene file: rendered as the twin was, 128 x 128");
  program.option("--lightings", &arguments.lightings, "lightings.json of the twin");
  program.option("--repeats", &arguments.repeats, "Runs of each mode", {.shows_default = true});
  program.option("--electrons", &arguments.electrons,
                 "Noise: electrons of a lit pixel, 0 = none");
  program.option("--electrons-a-step", &arguments.electrons_a_step,
                 "Of the camera: compress the noisy stack as its whole steps too");
  program.option("--errors", &arguments.errors, "Errors to compress to, separated by commas",
                 {.delimiter = ','});
  program.flag("--no-plate", &arguments.has_no_plate, "Without the clean plate");
  if (const std::optional<ExitCode> end = line.parse(argc, argv)) {
    return static_cast<int>(*end);
  }
  const auto folder =
      std::filesystem::temp_directory_path() / fmt::format("accuracy-{}", ::getpid());
  std::filesystem::create_directories(folder);
  const Capture capture = open_capture(arguments);
  print_rows(measure(capture, arguments, folder));
  std::filesystem::remove_all(folder);
  return 0;
}

}  // namespace
}  // namespace haarlight

int main(int argc, char** argv) {
  return haarlight::apps::run_program("relight_accuracy", haarlight::run, argc, argv);
}
