// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/bases_pipeline.h"

#include <filesystem>
#include <memory>
#include <thread>
#include <utility>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/relight/basis/compress_session.h"
#include "haarlight/session/develop/develop.h"
#include "haarlight/session/session.h"
#include "relight/pipeline/result_lines.h"
#include "relight/study/study_report.h"

namespace haarlight::relight {

namespace {

/// An opened session or basis file, and the owners of what the study reads.
struct OpenCapture {
  std::optional<session::Session> session;
  std::optional<BasisFile> basis;
  std::unique_ptr<StackSource> source;
  std::optional<Rig> rig;
  OpenPlate plate;
  StudyCapture study;
};

StudyLight position_of(bool is_position, const Eigen::Vector3d& position, double power) {
  StudyLight light;
  light.is_position = is_position;
  light.coordinates = position;
  light.strength = power;
  return light;
}

/// Takes the lights from a session's or file's rig, if it has one that describes them.
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

void open_session(const BasesOptions& bases, OpenCapture& capture) {
  session::DevelopOptions options;
  options.memory_bytes = bases.settings.memory_bytes;
  options.progress = bases.settings.progress;
  options.unknown_as = bases.unknown_as;
  capture.session = session::Session::open(bases.input);
  const session::SessionInfo& info = capture.session->info();
  options.plate = sharing_plate(*capture.session, PlateChoice::parse(bases.plate));
  capture.source = std::make_unique<LightStack>(session::develop(*capture.session, options));
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
    for (const session::SessionLight& light : info.lights) {
      capture.study.lights.push_back(
          position_of(light.is_position, light.coordinates, light.relative_power));
    }
  }
}

void open_basis(const BasesOptions& bases, OpenCapture& capture) {
  capture.basis = BasisFile::open(bases.input);
  const BasisHeader& header = capture.basis->header();
  capture.source = std::make_unique<BasisSource>(*capture.basis);
  if (!header.rig_toml.empty()) {
    capture.rig = parse_rig(header.rig_toml, bases.input + " (rig)");
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
        position_of(light.is_position, light.coordinates, light.relative_power));
  }
  if (capture.study.lights.size() != static_cast<std::size_t>(header.dims.n_lights)) {
    throw Error("the file does not say where its lights are", bases.input,
                "give the session that it was made from");
  }
}

OpenCapture open_capture(const BasesOptions& bases) {
  OpenCapture capture;
  if (std::filesystem::is_regular_file(bases.input)) {
    open_basis(bases, capture);
  } else {
    open_session(bases, capture);
  }
  PlateOptions options;
  options.memory_bytes = bases.settings.memory_bytes;
  options.progress = bases.settings.progress;
  capture.plate = open_plate(capture.rig ? &*capture.rig : nullptr, capture.source->dims(),
                             PlateChoice::parse(bases.plate), options);
  StudyCapture& study = capture.study;
  study.stack = capture.source.get();
  study.plate = capture.plate.source.get();
  const StackDims dims = study.stack->dims();
  if (!bases.lightings.empty()) {
    study.lightings = lightings_from_json(bases.lightings, dims.n_lights);
  } else {
    study.lightings =
        default_lightings(light_directions_from(study.lights, study.object_centre), study.grid);
  }
  if (!bases.regions.empty()) {
    study.regions = read_region_picture(bases.regions, dims.width, dims.height);
  }
  return capture;
}

/// The command with all options that affect its results, as a user would type it.
std::string command_line(const BasesOptions& bases, const BasisStudyOptions& options) {
  std::string line = fmt::format(
      "haarlight bases {} -o {} --tiles {} --sh-order {} --pca-rank {}", bases.input,
      bases.output, options.n_tiles, options.sh_order, options.pca_rank);
  for (const std::string& basis : options.bases) {
    line += " --basis " + basis;
  }
  for (const double error : options.errors) {
    line += fmt::format(" --error {:g}", error);
  }
  for (const double size : options.sizes) {
    line += fmt::format(" --size {:g}", size);
  }
  const std::string transfer = !bases.unknown_as                     ? ""
                               : *bases.unknown_as == Transfer::srgb ? "srgb"
                                                                     : "linear";
  for (const auto& [name, value] :
       {std::pair{"--plate", bases.plate}, std::pair{"--lightings", bases.lightings},
        std::pair{"--regions", bases.regions}, std::pair{"--transfer", transfer}}) {
    if (!value.empty()) {
      line += fmt::format(" {} {}", name, value);
    }
  }
  return line;
}

/// The command that compresses the capture, without basis, clean plate and error. A basis file
/// does not tell the folder of its session.
std::string compress_command(const BasesOptions& bases) {
  const bool is_session = !std::filesystem::is_regular_file(bases.input);
  std::string line = fmt::format("haarlight compress {} -o {}.hlb",
                                 is_session ? bases.input : "SESSION", bases.output);
  if (bases.unknown_as) {
    line += *bases.unknown_as == Transfer::srgb ? " --transfer srgb" : " --transfer linear";
  }
  return line;
}

BasisStudyOptions study_options(const BasesOptions& bases) {
  BasisStudyOptions options;
  options.bases = bases.bases;
  options.errors = bases.errors.empty() ? options.errors : bases.errors;
  options.sizes = bases.sizes.empty() ? options.sizes : bases.sizes;
  options.n_tiles = bases.n_tiles;
  options.sh_order = bases.sh_order;
  options.pca_rank = bases.pca_rank;
  options.memory_bytes = bases.settings.memory_bytes;
  options.progress = bases.settings.progress;
  return options;
}

/// Tables, figures and records. @return  bytes
std::uint64_t write_study(const BasesOptions& bases, const BasisStudy& study) {
  const std::filesystem::path folder = bases.output;
  std::filesystem::create_directories(folder);
  std::uint64_t bytes = 0;
  const auto write = [&](const std::string& name, const std::string& text) {
    write_file_atomically(folder / name, text);
    bytes += text.size();
  };
  const std::string compress = compress_command(bases);
  write("bases.txt", summary_tables(study) + recommendation_text(study, compress, bases.plate) +
                         region_tables(study) + binning_table(study));
  write("bases.json", study_json(study, bases.input, compress, bases.plate));
  const int n_threads =
      bases.threads > 0 ? bases.threads : static_cast<int>(std::thread::hardware_concurrency());
  write("records.json", tradeoff_json(study_records(
                            study, command_line(bases, study_options(bases)), n_threads)));
  for (const StudyFigure& figure : study_figures(study)) {
    write(figure.file, figure.svg);
  }
  const Image<float> regions =
      paint_regions(study.regions, study.dims.width, study.dims.height);
  write_image(folder / "regions.png", regions.view());
  return bytes + std::filesystem::file_size(folder / "regions.png");
}

}  // namespace

BasesSummary compare_bases(const BasesOptions& options) {
  require_absent(options.output, options.settings.overwrites);
  const OpenCapture capture = open_capture(options);
  BasesSummary summary;
  summary.study = study_bases(capture.study, study_options(options));
  summary.plate_origin = capture.plate.origin;
  summary.bytes = write_study(options, summary.study);
  for (const BasisResult& result : summary.study.results) {
    for (const BasisPoint& point : result.points) {
      if (point.kind == PointKind::error) {
        summary.is_achieved =
            summary.is_achieved && (point.is_achieved || result.floor_error > 0.0);
      }
    }
  }
  PipelineNotes notes(options.settings.tell);
  tell_lines(
      fmt::format("{}{}{}regions apart, figures and all numbers: {}\n",
                  summary_tables(summary.study), binning_table(summary.study),
                  recommendation_text(summary.study, compress_command(options), options.plate),
                  options.output),
      notes);
  summary.notes = notes.all();
  return summary;
}

void add_to_report(const BasesOptions& options, const BasesSummary& summary, Report& report) {
  const BasisStudyOptions requested = study_options(options);
  report.add_requested("errors", requested.errors);
  report.add_requested("sizes", requested.sizes);
  for (const std::string& file : {options.input, options.lightings, options.regions}) {
    if (!file.empty()) {
      report.add_input(file);
    }
  }
  report.set_bytes(summary.bytes);
  report.add_detail("plate", std::string(to_string(summary.plate_origin)));
  report.add_detail("pixels_studied", static_cast<std::int64_t>(summary.study.n_pixels));
  report.add_detail("study_seconds", summary.study.seconds);
  for (const BasisResult& result : summary.study.results) {
    for (const BasisPoint& point : result.points) {
      if (point.kind == PointKind::error) {
        report.add_achieved(fmt::format("{} at {:g}", result.title, point.requested),
                            point.stack_error[0]);
      }
    }
  }
}

}  // namespace haarlight::relight
