// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight bases SESSION -o FOLDER`: compares bases on one's own capture.

#include <algorithm>
#include <optional>
#include <thread>

#include <fmt/format.h>

#include "apps/haarlight/develop_options.h"
#include "apps/haarlight/verb.h"
#include "core/files.h"
#include "core/picture/image_io.h"
#include "relight/basis/compress_session.h"
#include "relight/study/basis_study.h"
#include "relight/study/study_report.h"
#include "session/develop/develop.h"
#include "session/session.h"

namespace haarlight {

namespace {

struct BasesArguments {
  std::string input;
  std::string output;
  std::vector<std::string> bases;
  std::vector<double> errors;
  std::vector<double> sizes;
  std::string plate;
  std::string lightings;
  std::string regions;
  int n_tiles = 8;
  int sh_order = 15;
  int pca_rank = 512;
  std::string transfer;
};

/// A session or basis file opened, and what keeps alive what the study reads.
struct OpenCapture {
  std::optional<Session> session;
  std::optional<BasisFile> basis;
  std::unique_ptr<StackSource> source;
  std::optional<Rig> rig;
  OpenPlate plate;
  StudyCapture study;
};

StudyLight place_of(bool is_position, const Eigen::Vector3d& place, double power) {
  StudyLight light;
  light.is_position = is_position;
  light.place = place;
  light.strength = power;
  return light;
}

/// What a session's or a file's rig says of the lights, where it has one that speaks for them.
void take_rig(OpenCapture& capture) {
  const StackDims dims = capture.source->dims();
  if (!capture.rig || capture.rig->n_lights() != dims.n_lights) {
    capture.rig.reset();
    return;
  }
  capture.study.lights = study_lights(*capture.rig);
  capture.study.object_centre = capture.rig->object_centre;
  const int camera = camera_of_size(*capture.rig, dims.width, dims.height);
  if (camera >= 0 && !capture.rig->planes.empty()) {
    capture.study.camera = capture.rig->cameras[static_cast<std::size_t>(camera)].model;
    capture.study.plane = capture.rig->planes.front();
  }
}

ArrayGrid grid_of(const Rig& rig) {
  ArrayGrid grid;
  for (const Face& face : rig.faces) {
    if (face.rows != rig.faces.front().rows || face.cols != rig.faces.front().cols) {
      return {};
    }
    grid = {face.rows, face.cols, grid.n_faces + 1};
  }
  return grid;
}

void open_session(const BasesArguments& arguments, const CommonOptions& common,
                  OpenCapture& capture) {
  DevelopOptions options;
  options.memory_bytes = common.memory_bytes;
  options.progress = common.progress();
  options.unknown_as = transfer_asked(arguments.transfer);
  capture.session = Session::open(arguments.input);
  const SessionInfo& info = capture.session->info();
  options.plate = sharing_plate(*capture.session, PlateChoice::parse(arguments.plate));
  capture.source = std::make_unique<LightStack>(develop(*capture.session, options));
  capture.rig = capture.session->rig();
  take_rig(capture);
  if (capture.rig) {
    capture.study.grid = grid_of(*capture.rig);
  } else {
    const auto n_lights = static_cast<int>(info.lights.size());
    const int n_face = info.grid_rows * info.grid_cols;
    if (n_face > 0 && n_lights % n_face == 0) {
      capture.study.grid = {info.grid_rows, info.grid_cols, n_lights / n_face};
    }
    for (const SessionLight& light : info.lights) {
      capture.study.lights.push_back(
          place_of(light.is_position, light.place, light.relative_power));
    }
  }
}

void open_basis(const BasesArguments& arguments, OpenCapture& capture) {
  capture.basis = BasisFile::open(arguments.input);
  const BasisHeader& header = capture.basis->header();
  capture.source = std::make_unique<BasisSource>(*capture.basis);
  if (!header.rig_toml.empty()) {
    capture.rig = parse_rig(header.rig_toml, arguments.input + " (rig)");
  }
  take_rig(capture);
  if (capture.rig) {
    capture.study.grid = grid_of(*capture.rig);
    return;
  }
  if (header.n_grids() > 0) {
    capture.study.grid = {header.grid.rows, header.grid.cols, header.n_grids()};
  }
  for (const BasisLight& light : header.lights) {
    capture.study.lights.push_back(
        place_of(light.is_position, light.place, light.relative_power));
  }
  if (capture.study.lights.size() != static_cast<std::size_t>(header.dims.n_lights)) {
    throw Error("the file does not say where its lights are", arguments.input,
                "give the session that it was made from");
  }
}

OpenCapture open_capture(const BasesArguments& arguments, const CommonOptions& common,
                         Report& report) {
  report.add_input(arguments.input);
  OpenCapture capture;
  if (std::filesystem::is_regular_file(arguments.input)) {
    open_basis(arguments, capture);
  } else {
    open_session(arguments, common, capture);
  }
  PlateOptions options;
  options.memory_bytes = common.memory_bytes;
  options.progress = common.progress();
  capture.plate = open_plate(capture.rig ? &*capture.rig : nullptr, capture.source->dims(),
                             PlateChoice::parse(arguments.plate), options);
  StudyCapture& study = capture.study;
  study.stack = capture.source.get();
  study.plate = capture.plate.source.get();
  const StackDims dims = study.stack->dims();
  if (!arguments.lightings.empty()) {
    report.add_input(arguments.lightings);
    study.lightings = lightings_from_json(arguments.lightings, dims.n_lights);
  } else {
    study.lightings =
        default_lightings(light_directions_from(study.lights, study.object_centre), study.grid);
  }
  if (!arguments.regions.empty()) {
    report.add_input(arguments.regions);
    study.regions = read_region_picture(arguments.regions, dims.width, dims.height);
  }
  return capture;
}

/// The command with what changes its results, as a person would type it.
std::string command_line(const BasesArguments& arguments, const BasisStudyOptions& options) {
  std::string line = fmt::format(
      "haarlight bases {} -o {} --tiles {} --sh-order {} --pca-rank {}", arguments.input,
      arguments.output, options.n_tiles, options.sh_order, options.pca_rank);
  for (const std::string& basis : options.bases) {
    line += " --basis " + basis;
  }
  for (const double error : options.errors) {
    line += fmt::format(" --error {:g}", error);
  }
  for (const double size : options.sizes) {
    line += fmt::format(" --size {:g}", size);
  }
  for (const auto& [name, value] :
       {std::pair{"--plate", arguments.plate}, std::pair{"--lightings", arguments.lightings},
        std::pair{"--regions", arguments.regions},
        std::pair{"--transfer", arguments.transfer}}) {
    if (!value.empty()) {
      line += fmt::format(" {} {}", name, value);
    }
  }
  return line;
}

ExitCode run_bases(const BasesArguments& arguments, const CommonOptions& common,
                   Report& report) {
  require_absent(arguments.output, common.force);
  BasisStudyOptions options;
  options.bases = arguments.bases;
  options.errors = arguments.errors.empty() ? options.errors : arguments.errors;
  options.sizes = arguments.sizes.empty() ? options.sizes : arguments.sizes;
  options.n_tiles = arguments.n_tiles;
  options.sh_order = arguments.sh_order;
  options.pca_rank = arguments.pca_rank;
  options.memory_bytes = common.memory_bytes;
  options.progress = common.progress();
  report.add_asked("errors", options.errors);
  report.add_asked("sizes", options.sizes);
  const OpenCapture capture = open_capture(arguments, common, report);
  const BasisStudy study = study_bases(capture.study, options);

  const std::filesystem::path folder = arguments.output;
  std::filesystem::create_directories(folder);
  std::uint64_t bytes = 0;
  const auto write = [&](const std::string& name, const std::string& text) {
    write_file_atomically(folder / name, text);
    bytes += text.size();
  };
  const std::string summary = summary_tables(study);
  const std::string binning = binning_table(study);
  write("bases.txt", summary + region_tables(study) + binning);
  write("bases.json", study_json(study, arguments.input));
  const int n_threads = common.threads > 0
                            ? common.threads
                            : static_cast<int>(std::thread::hardware_concurrency());
  write("records.json",
        tradeoff_json(study_records(study, command_line(arguments, options), n_threads)));
  for (const StudyFigure& figure : study_figures(study)) {
    write(figure.file, figure.svg);
  }
  const Image<float> regions =
      paint_regions(study.regions, study.dims.width, study.dims.height);
  write_image(folder / "regions.png", regions.view());
  bytes += std::filesystem::file_size(folder / "regions.png");
  report.set_bytes(bytes);
  report.add_detail("plate", std::string(to_string(capture.plate.origin)));
  report.add_detail("pixels_studied", static_cast<std::int64_t>(study.n_pixels));
  report.add_detail("study_seconds", study.seconds);
  bool is_reached = true;
  for (const BasisResult& result : study.results) {
    for (const BasisPoint& point : result.points) {
      if (point.kind == PointKind::error) {
        report.add_reached(fmt::format("{} at {:g}", result.title, point.asked),
                           point.stack_error[0]);
        is_reached = is_reached && (point.is_reached || result.floor_error > 0.0);
      }
    }
  }
  fmt::print("{}{}regions apart, figures and all numbers: {}\n", summary, binning,
             arguments.output);
  return is_reached ? ExitCode::done : ExitCode::target_missed;
}

}  // namespace

void add_bases(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<BasesArguments>();
  Command verb = root.add_verb(
      "bases",
      "Compare bases over the lights on a capture: Haar, DCT, harmonics, PCA, CDF 5/3");
  verb.option("CAPTURE", &arguments->input, "Session folder, or a basis file",
              {.type = "SESSION|BASIS.hlb", .is_required = true});
  verb.option("-o,--output", &arguments->output,
              "Folder for bases.txt, bases.json, records.json, figures and regions.png",
              {.type = "FOLDER", .is_required = true});
  std::vector<std::string> names;
  for (const KnownBasis& known : known_bases()) {
    names.push_back(known.name);
  }
  verb.option("--basis", &arguments->bases, "Compare this one (again for more; default: all)",
              {.type = "NAME", .choices = names});
  verb.option("--error", &arguments->errors,
              "Relative L2 error to reach with each (again for more; default: 0.03 0.01 0.003)",
              {.type = "ERROR", .bounds = Bounds{1e-6, 1.0}});
  verb.option("--size", &arguments->sizes,
              "Numbers a pixel to spend with each (again for more; default: 4 16 64)",
              {.type = "NUMBERS", .bounds = Bounds{1e-3, 1e6}});
  verb.option("--plate", &arguments->plate,
              "Clean plate: a .hlb, a session of the empty rig, or none (default: computed "
              "from the capture's rig)",
              {.type = "FILE|SESSION|none"});
  verb.option("--lightings", &arguments->lightings,
              "JSON object of names, each with a number a light (default: one, four and nine "
              "lights, smooth, high frequency)",
              {.type = "FILE.json"});
  verb.option("--regions", &arguments->regions,
              "Picture that says what each pixel is: red specular, green diffuse, blue "
              "attached, yellow cast shadow, black none (default: judged from the capture)",
              {.type = "MASK.png"});
  verb.option("--tiles", &arguments->n_tiles,
              "Study so many tiles of 128 pixels a side, spread over the picture; 0: all",
              {.bounds = Bounds{0.0, 1e9}, .shows_default = true});
  verb.option("--sh-order", &arguments->sh_order, "Highest order of the spherical harmonics",
              {.bounds = Bounds{0.0, 40.0}, .shows_default = true});
  verb.option("--pca-rank", &arguments->pca_rank, "The most vectors of PCA that are tried",
              {.bounds = Bounds{1.0, 4096.0}, .shows_default = true});
  add_transfer_option(verb, arguments->transfer);
  verb.footer(
      "What the columns mean: docs/numerics/bases.md.\n"
      "Examples:\n"
      "  haarlight bases sessions/airplane -o airplane-bases\n"
      "  haarlight bases airplane.hlb -o quick --basis haar --basis pca --error 0.01 --tiles "
      "4");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_bases(*arguments, common, report);
  });
}

}  // namespace haarlight
