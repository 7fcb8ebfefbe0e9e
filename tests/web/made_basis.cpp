// SPDX-License-Identifier: Apache-2.0
/// @file
/// Writes a small basis file for the viewer's tests and benchmarks: a sphere over a plane under
/// an array of lights, from closed forms. made_basis --help

#include <optional>
#include <string>

#include <fmt/format.h>

#include "apps/command_line.h"
#include "apps/run_program.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/relight/basis/compress.h"
#include "tests/relight/basis/made_stack.h"
#include "tests/relight/view/retiled.h"

namespace haarlight {

namespace {

struct Options {
  std::string output;
  std::string rig;
  int width = 40;
  int height = 36;
  int channels = 1;
  int grid = 8;
  int rows = 0;
  double max_error = 0.01;
  std::optional<double> worst_pixel;
  std::string basis = "haar";
  bool has_plate = false;
  double noise = 0.0;
  int tile = 0;
};

void make(const Options& options) {
  test::MadeScene scene{options.width, options.height, options.grid, options.channels};
  scene.noise = options.noise;
  scene.rows = options.rows;
  std::optional<Rig> rig;
  if (!options.rig.empty()) {
    rig = read_rig_as_written(options.rig);
    scene.grid = rig->faces.front().cols;
    scene.rows = rig->faces.front().rows;
  }
  const MemoryStack stack = test::render_stack(scene);
  if (options.tile > 0) {
    test::write_retiled(stack, options.tile, options.output);
    return;
  }
  scene.has_sphere = false;
  scene.noise = 0.0;
  std::optional<MemoryStack> plate;
  if (options.has_plate) {
    plate = test::render_stack(scene);
  }
  relight::CompressOptions how{.relative_l2 = options.max_error};
  const std::optional<relight::BasisKind> kind = value_of<relight::BasisKind>(options.basis);
  if (!kind) {
    throw Error("no basis is called " + options.basis, "--basis", "see --help");
  }
  how.basis = *kind;
  if (options.worst_pixel) {
    how.worst_pixel = *options.worst_pixel;
  }
  const relight::HaarGrid grid = *kind == relight::BasisKind::direct
                                     ? relight::HaarGrid{}
                                     : relight::HaarGrid{scene.n_rows(), scene.grid};
  relight::CompressSource source = test::made_source(stack, grid, plate ? &*plate : nullptr);
  if (rig) {
    source.lights.clear();
    source.rig_toml = rig->text;
    source.rig_hash = rig->hash;
  }
  const relight::CompressSummary summary = relight::compress_stack(source, options.output, how);
  fmt::print("{} bytes, {:.1f} coefficients per pixel\n", summary.bytes,
             summary.header.mean_coefficients);
}

int run(int argc, char** argv) {
  apps::CommandLine line("made_basis", "made_basis: a basis file of a sphere over a plane", "");
  apps::Command program = line.root();
  Options options;
  program.option("OUT", &options.output, "File to write", {.is_required = true});
  program.option("--rig", &options.rig, "Rig of one face (default: an import's lights)");
  program.option("--width", &options.width, "Pixels");
  program.option("--height", &options.height, "Pixels");
  program.option("--channels", &options.channels, "1 or 3");
  program.option("--grid", &options.grid, "Lights along a side, without a rig");
  program.option("--rows", &options.rows,
                 "Rows of lights, where there are others than columns");
  program.option("--max-error", &options.max_error, "0: lossless");
  program.option("--worst-pixel", &options.worst_pixel, "Bound on a pixel's own error");
  program.option("--basis", &options.basis, "haar, haar-standard, dct or direct");
  program.flag("--plate", &options.has_plate, "Subtract the clean plate");
  program.option("--noise", &options.noise, "Of a value, uniform");
  program.option("--tile", &options.tile, "A lossless file of an import with such tiles");
  if (const std::optional<ExitCode> end = line.parse(argc, argv)) {
    return static_cast<int>(*end);
  }
  make(options);
  return 0;
}

}  // namespace

}  // namespace haarlight

int main(int argc, char** argv) {
  return haarlight::apps::run_program("made_basis", haarlight::run, argc, argv);
}
