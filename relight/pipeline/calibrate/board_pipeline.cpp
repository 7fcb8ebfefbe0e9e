// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/calibrate/board_pipeline.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <numbers>
#include <utility>

#include <fmt/format.h>

#include "core/counted.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/core/rig/rig.h"
#include "relight/pipeline/calibrate/board_page.h"
#include "relight/pipeline/calibrate/measured_file.h"
#include "relight/pipeline/result_lines.h"

namespace haarlight::relight {

namespace {

constexpr double kDegrees = 180.0 / std::numbers::pi;

const CameraSpec& camera_of(const Rig& rig, const std::string& id) {
  for (const CameraSpec& camera : rig.cameras) {
    if (id.empty() || camera.id == id) {
      return camera;
    }
  }
  throw Error("the rig has no camera \"" + id + "\"", rig.file.string(),
              "name one of its [[camera]] ids", ExitCode::usage);
}

void require_board(const Chessboard& board) {
  if (board.cols < 3 || board.rows < 3 || board.cols > 100 || board.rows > 100 ||
      !(board.square_mm > 0.0)) {
    throw Error(fmt::format("a board of {} x {} inner corners and squares of {} mm", board.cols,
                            board.rows, board.square_mm),
                "--board, --square", "count the corners where four squares meet",
                ExitCode::usage);
  }
}

/// Pictures without a whole board are named and left out.
std::vector<SeenBoard> find_boards(const BoardOptions& options, const CameraSpec& camera,
                                   PipelineNotes& notes) {
  const Chessboard& board = options.board;
  if (options.pictures.empty()) {
    throw Error("no pictures of a chessboard", options.rig, "name them: --picture FILE ...",
                ExitCode::usage);
  }
  std::vector<SeenBoard> seen;
  for (const std::string& file : options.pictures) {
    const PictureFile picture = read_picture(file);
    if (picture.pixels.width() != camera.model.width ||
        picture.pixels.height() != camera.model.height) {
      throw Error(fmt::format("{} x {} pixels, camera {} has {} x {}", picture.pixels.width(),
                              picture.pixels.height(), camera.id, camera.model.width,
                              camera.model.height),
                  file, "give pictures of that camera, neither cut nor scaled");
    }
    auto corners = find_chessboard(picture.pixels.view(), board);
    if (corners) {
      seen.push_back({file, std::move(*corners)});
    } else {
      notes.add(NoteKind::result,
                fmt::format("{}: no whole board of {} x {} inner corners, left out", file,
                            board.cols, board.rows));
    }
  }
  return seen;
}

/// @throws Error  it exists
std::string page_name(const BoardOptions& options, const char* ending) {
  std::filesystem::path page = options.page;
  if (page.empty()) {
    page = options.rig;
    page.replace_extension(ending);
  }
  require_absent(page, options.settings.overwrites);
  return page.string();
}

void tell_files(const std::string& page, const MeasuredFile& stored, PipelineNotes& notes) {
  notes.add(NoteKind::result, fmt::format("page: {}", page));
  notes.add(NoteKind::result, fmt::format("measured values: {}", stored.path().string()));
}

struct LensValue {
  const char* name;
  double value;
};

/// In the order of CameraFit::sigma.
std::array<LensValue, 9> lens_values(const CameraModel& model) {
  const auto& d = model.distortion;
  return {{{"fx", model.fx},
           {"fy", model.fy},
           {"cx", model.cx},
           {"cy", model.cy},
           {"k1", d[0]},
           {"k2", d[1]},
           {"p1", d[2]},
           {"p2", d[3]},
           {"k3", d[4]}}};
}

std::string lens_words(const CameraBoardSummary& summary) {
  std::string words;
  const std::array<LensValue, 9> values = lens_values(summary.fit.camera);
  for (std::size_t i = 0; i < values.size(); ++i) {
    words += fmt::format("{:<3} {:12.6g} +- {:.2g}\n", values[i].name, values[i].value,
                         summary.fit.sigma[static_cast<Eigen::Index>(i)]);
  }
  return words + fmt::format("{}, {:.3f} px rms\n", counted(summary.n_views, "picture"),
                             summary.fit.rms_px);
}

MeasuredLens measured_lens(const CameraBoardSummary& summary) {
  const CameraFit& fit = summary.fit;
  MeasuredLens lens;
  lens.k = {fit.camera.fx, fit.camera.fy, fit.camera.cx, fit.camera.cy};
  lens.k_sigma = fit.sigma.head<4>();
  lens.distortion = fit.camera.distortion;
  lens.distortion_sigma = fit.sigma.tail<5>();
  lens.rms_px = fit.rms_px;
  lens.n_views = summary.n_views;
  return lens;
}

/// Puts a lens into the measured values of its camera.
void store_lens(const CameraSpec& camera, const MeasuredLens& lens, MeasuredRig& measured) {
  auto at = std::find_if(measured.cameras.begin(), measured.cameras.end(),
                         [&](const MeasuredCamera& c) { return c.id == camera.id; });
  if (at == measured.cameras.end()) {
    MeasuredCamera fresh;
    fresh.id = camera.id;
    fresh.with = describe_camera(camera);
    at = measured.cameras.insert(at, fresh);
  }
  at->lens = lens;
}

/// Each picture's plane, weighted by its distance's certainty. @return  in the camera's frame
struct BoardPlane {
  Eigen::Vector3d n_cam = Eigen::Vector3d::Zero();
  double d_cam = 0.0;
  double distance_sigma = 0.0;
  double rms_px = 0.0;  ///< the worst picture's, as tilt_sigma_deg
  double tilt_sigma_deg = 0.0;
  std::vector<std::vector<Eigen::Vector2d>> misses;
};

BoardPlane fit_board_plane(const CameraModel& camera, const std::vector<SeenBoard>& seen,
                           const Chessboard& board) {
  BoardPlane out;
  Eigen::Vector3d n = Eigen::Vector3d::Zero();
  double d = 0.0;
  double weights = 0.0;
  for (const SeenBoard& each : seen) {
    const PlaneFit fit = fit_plane(camera, each.corners, board);
    const double weight = 1.0 / std::max(fit.distance_sigma_mm * fit.distance_sigma_mm, 1e-18);
    n += weight * fit.n_cam;
    d += weight * fit.d_mm;
    weights += weight;
    out.rms_px = std::max(out.rms_px, fit.rms_px);
    out.tilt_sigma_deg = std::max(out.tilt_sigma_deg, fit.tilt_sigma_deg);
    out.misses.push_back(fit.misses_px);
  }
  out.n_cam = n.normalized();
  out.d_cam = d / weights;
  out.distance_sigma = 1.0 / std::sqrt(weights);
  return out;
}

/// The plane in the world of the camera's pose.
MeasuredPlane measured_plane(const ShadowPlane& written, const CameraSpec& camera,
                             const BoardPlane& found) {
  MeasuredPlane m;
  m.id = written.id;
  m.camera = camera.id;
  m.with = describe_view(camera);
  m.n = camera.model.world_from_cam.linear() * found.n_cam;
  m.d = found.d_cam - m.n.dot(camera.model.centre_world());
  m.rms_px = found.rms_px;
  m.tilt_sigma_deg = found.tilt_sigma_deg;
  m.distance_sigma = found.distance_sigma;
  return m;
}

std::string plane_words(const PlaneBoardSummary& summary) {
  const MeasuredPlane& m = summary.plane;
  return fmt::format(
      "plane {}: n = {:.6f} {:.6f} {:.6f}, d = {:.4f} mm\n{:.4f} +- {:.4f} mm from camera {}, "
      "tilt "
      "+- {:.4f} degrees, {:.3f} px rms, {}\n{:.3f} degrees from the rig file's\n",
      m.id, m.n.x(), m.n.y(), m.n.z(), m.d, summary.distance_mm, m.distance_sigma, m.camera,
      m.tilt_sigma_deg, m.rms_px, counted(summary.n_views, "picture"), summary.moved_deg);
}

}  // namespace

CameraBoardSummary calibrate_camera(const BoardOptions& options) {
  const Rig written = read_rig_as_written(options.rig);
  const CameraSpec& camera = camera_of(written, options.camera);
  require_board(options.board);
  CameraBoardSummary summary;
  PipelineNotes notes(options.settings.tell);
  summary.page = page_name(options, ".camera.html");
  const std::vector<SeenBoard> seen = find_boards(options, camera, notes);
  std::vector<std::vector<Eigen::Vector2d>> views;
  views.reserve(seen.size());
  for (const SeenBoard& each : seen) {
    views.push_back(each.corners);
  }
  summary.fit = fit_camera(views, options.board, camera.model.width, camera.model.height);
  summary.n_views = static_cast<int>(views.size());
  const std::string words = lens_words(summary);
  tell_lines(words, notes);
  write_file_atomically(summary.page,
                        board_page("Camera " + camera.id + " of " + written.name, words,
                                   camera.model, seen, summary.fit.misses_px));
  MeasuredFile stored(written);
  store_lens(camera, measured_lens(summary), stored.values);
  summary.bytes = stored.write();
  tell_files(summary.page, stored, notes);
  summary.notes = notes.all();
  return summary;
}

PlaneBoardSummary calibrate_plane(const BoardOptions& options) {
  // The lens as calibrated, the camera's pose as written.
  const Rig rig = read_rig(options.rig);
  const Rig written = read_rig_as_written(options.rig);
  const CameraSpec& camera = camera_of(rig, options.camera);
  if (written.planes.empty()) {
    throw Error("the rig has no plane", options.rig, "add [[plane]] to the rig file");
  }
  require_board(options.board);
  PlaneBoardSummary summary;
  PipelineNotes notes(options.settings.tell);
  summary.page = page_name(options, ".plane.html");
  const std::vector<SeenBoard> seen = find_boards(options, camera, notes);
  if (seen.empty()) {
    throw Error("no picture shows the whole board", options.rig,
                "lay the board where the camera sees all of it; --board says its corners");
  }
  const BoardPlane found = fit_board_plane(camera.model, seen, options.board);
  summary.plane = measured_plane(written.planes.front(), camera, found);
  summary.distance_mm = found.d_cam;
  summary.n_views = static_cast<int>(seen.size());
  const MeasuredPlane& m = summary.plane;
  const double cosine = m.n.dot(written.planes.front().n);
  if (cosine < 0.0) {
    throw Error("the camera sees the plane's back: n of the rig file points away from it",
                options.rig, "turn n of [[plane]], or correct world_from_cam");
  }
  summary.moved_deg = kDegrees * std::acos(std::clamp(cosine, -1.0, 1.0));
  const std::string words = plane_words(summary);
  tell_lines(words, notes);
  write_file_atomically(summary.page, board_page("Plane " + m.id + " of " + written.name, words,
                                                 camera.model, seen, found.misses));
  MeasuredFile stored(written);
  std::vector<MeasuredPlane>& planes = stored.values.planes;
  std::erase_if(planes, [&](const MeasuredPlane& p) { return p.id == m.id; });
  planes.push_back(m);
  summary.bytes = stored.write();
  tell_files(summary.page, stored, notes);
  summary.notes = notes.all();
  return summary;
}

void add_to_report(const CameraBoardSummary& summary, Report& report) {
  const std::array<LensValue, 9> values = lens_values(summary.fit.camera);
  for (std::size_t i = 0; i < values.size(); ++i) {
    report.add_achieved(values[i].name, values[i].value);
    report.add_achieved(std::string(values[i].name) + "_sigma",
                        summary.fit.sigma[static_cast<Eigen::Index>(i)]);
  }
  report.add_achieved("rms_px", summary.fit.rms_px);
  report.set_bytes(summary.bytes);
}

void add_to_report(const PlaneBoardSummary& summary, Report& report) {
  report.add_achieved("distance_mm", summary.distance_mm);
  report.add_achieved("distance_sigma_mm", summary.plane.distance_sigma);
  report.add_achieved("tilt_sigma_deg", summary.plane.tilt_sigma_deg);
  report.add_achieved("rms_px", summary.plane.rms_px);
  report.set_bytes(summary.bytes);
}

}  // namespace haarlight::relight
