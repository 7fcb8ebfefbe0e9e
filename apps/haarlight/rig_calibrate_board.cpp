// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight rig calibrate camera|plane RIG.toml`: from pictures of a printed chessboard.

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "apps/haarlight/rig_calibrate.h"
#include "core/files.h"
#include "core/markup.h"
#include "core/picture/chessboard.h"
#include "core/picture/image_io.h"
#include "relight/pipeline/calibrate/measured_file.h"

namespace haarlight {

namespace {

const CameraSpec& camera_of(const Rig& rig, const std::string& id) {
  for (const CameraSpec& camera : rig.cameras) {
    if (id.empty() || camera.id == id) {
      return camera;
    }
  }
  throw Error("the rig has no camera \"" + id + "\"", rig.file.string(),
              "name one of its [[camera]] ids", ExitCode::usage);
}

Chessboard board_of(const CalibrateArguments& arguments) {
  Chessboard board;
  board.cols = arguments.board[0];
  board.rows = arguments.board[1];
  board.square_mm = arguments.square_mm;
  if (board.cols < 3 || board.rows < 3 || board.cols > 100 || board.rows > 100 ||
      !(board.square_mm > 0.0)) {
    throw Error(fmt::format("a board of {} x {} inner corners and squares of {} mm", board.cols,
                            board.rows, board.square_mm),
                "--board, --square", "count the corners where four squares meet",
                ExitCode::usage);
  }
  return board;
}

struct SeenBoard {
  std::string picture;
  std::vector<Eigen::Vector2d> corners;
};

/// Pictures without a whole board are named and left out.
std::vector<SeenBoard> find_boards(const CalibrateArguments& arguments,
                                   const CameraSpec& camera, const Chessboard& board) {
  if (arguments.pictures.empty()) {
    throw Error("no pictures of a chessboard", arguments.rig, "name them: --picture FILE ...",
                ExitCode::usage);
  }
  std::vector<SeenBoard> seen;
  for (const std::string& file : arguments.pictures) {
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
      fmt::print("{}: no whole board of {} x {} inner corners, left out\n", file, board.cols,
                 board.rows);
    }
  }
  return seen;
}

/// A picture's corners as dots, with their misses as lines a hundred times as long.
std::string misses_svg(const CameraModel& camera, const std::vector<Eigen::Vector2d>& corners,
                       const std::vector<Eigen::Vector2d>& misses) {
  constexpr double kLonger = 100.0;
  std::string out = fmt::format(
      "<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {0} {1}' width='420' role='img'>"
      "<rect width='{0}' height='{1}' fill='#eee'/>",
      camera.width, camera.height);
  const double dot = camera.width / 250.0;
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const Eigen::Vector2d end = corners[i] + kLonger * misses[i];
    out += fmt::format(
        "<circle cx='{0:.2f}' cy='{1:.2f}' r='{4:.2f}' fill='#06c'/><path d='M{0:.2f} {1:.2f} "
        "L{2:.2f} {3:.2f}' stroke='#c00' stroke-width='{5:.2f}'/>",
        corners[i].x(), corners[i].y(), end.x(), end.y(), dot, 0.6 * dot);
  }
  return out + "</svg>";
}

std::string page_of(const std::string& title, const std::string& summary,
                    const CameraModel& camera, const std::vector<SeenBoard>& seen,
                    const std::vector<std::vector<Eigen::Vector2d>>& misses) {
  std::string body;
  for (std::size_t i = 0; i < seen.size(); ++i) {
    double sum = 0.0;
    for (const Eigen::Vector2d& miss : misses[i]) {
      sum += miss.squaredNorm() / static_cast<double>(misses[i].size());
    }
    body += fmt::format("<figure><figcaption>{}: {:.3f} px rms</figcaption>{}</figure>",
                        escaped(seen[i].picture), std::sqrt(sum),
                        misses_svg(camera, seen[i].corners, misses[i]));
  }
  return fmt::format(
      "<!doctype html><html lang='en'><meta charset='utf-8'><title>{0}</title>"
      "<style>body{{font-family:sans-serif;max-width:60em;margin:2em auto}}"
      "figure{{display:inline-block;margin:0.5em}}</style><h1>{0}</h1><pre>{1}</pre>"
      "<p>Blue: a corner as found. Red: its miss, a hundred times as long. Lines that all "
      "point "
      "one way at one side of the picture: the lens needs another model, or the board is not "
      "flat.</p>{2}</html>\n",
      escaped(title), escaped(summary), body);
}

std::filesystem::path page_name(const CalibrateArguments& arguments, const char* ending) {
  std::filesystem::path page = arguments.page;
  if (page.empty()) {
    page = arguments.rig;
    page.replace_extension(ending);
  }
  return page;
}

}  // namespace

ExitCode run_calibrate_camera(const CalibrateArguments& arguments, const CommonOptions& common,
                              Report& report) {
  const Rig written = read_rig_as_written(arguments.rig);
  const CameraSpec& camera = camera_of(written, arguments.camera);
  const Chessboard board = board_of(arguments);
  const std::filesystem::path page = page_name(arguments, ".camera.html");
  require_absent(page, common.force);
  const std::vector<SeenBoard> seen = find_boards(arguments, camera, board);
  std::vector<std::vector<Eigen::Vector2d>> views;
  views.reserve(seen.size());
  for (const SeenBoard& each : seen) {
    views.push_back(each.corners);
  }
  const CameraFit fit = fit_camera(views, board, camera.model.width, camera.model.height);
  MeasuredLens lens;
  lens.k = {fit.camera.fx, fit.camera.fy, fit.camera.cx, fit.camera.cy};
  lens.k_sigma = fit.sigma.head<4>();
  lens.distortion = fit.camera.distortion;
  lens.distortion_sigma = fit.sigma.tail<5>();
  lens.rms_px = fit.rms_px;
  lens.n_views = static_cast<int>(views.size());
  std::string summary;
  const char* const names[] = {"fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"};
  const CameraModel& model = fit.camera;
  const double values[] = {model.fx,
                           model.fy,
                           model.cx,
                           model.cy,
                           model.distortion[0],
                           model.distortion[1],
                           model.distortion[2],
                           model.distortion[3],
                           model.distortion[4]};
  for (int i = 0; i < 9; ++i) {
    summary += fmt::format("{:<3} {:12.6g} +- {:.2g}\n", names[i], values[i], fit.sigma[i]);
    report.add_reached(names[i], values[i]);
    report.add_reached(std::string(names[i]) + "_sigma", fit.sigma[i]);
  }
  summary += fmt::format("{} pictures, {:.3f} px rms\n", views.size(), fit.rms_px);
  report.add_reached("rms_px", fit.rms_px);
  fmt::print("{}", summary);
  write_file_atomically(page, page_of("Camera " + camera.id + " of " + written.name, summary,
                                      camera.model, seen, fit.misses_px));
  fmt::print("page: {}\n", page.string());
  MeasuredFile stored(written);
  auto at = std::find_if(stored.values.cameras.begin(), stored.values.cameras.end(),
                         [&](const MeasuredCamera& c) { return c.id == camera.id; });
  if (at == stored.values.cameras.end()) {
    MeasuredCamera fresh;
    fresh.id = camera.id;
    fresh.with = describe_camera(camera);
    at = stored.values.cameras.insert(at, fresh);
  }
  at->lens = lens;
  report.set_bytes(stored.write());
  fmt::print("measured values: {}\n", stored.path().string());
  return ExitCode::done;
}

ExitCode run_calibrate_plane(const CalibrateArguments& arguments, const CommonOptions& common,
                             Report& report) {
  // The lens as calibrated, the camera's place as written.
  const Rig rig = read_rig(arguments.rig);
  const Rig written = read_rig_as_written(arguments.rig);
  const CameraSpec& camera = camera_of(rig, arguments.camera);
  if (written.planes.empty()) {
    throw Error("the rig has no plane", arguments.rig, "add [[plane]] to the rig file");
  }
  const Chessboard board = board_of(arguments);
  const std::filesystem::path page = page_name(arguments, ".plane.html");
  require_absent(page, common.force);
  const std::vector<SeenBoard> seen = find_boards(arguments, camera, board);
  if (seen.empty()) {
    throw Error("no picture shows the whole board", arguments.rig,
                "lay the board where the camera sees all of it; --board says its corners");
  }
  // Each picture's plane, weighted by its distance's certainty; their scatter is told.
  Eigen::Vector3d n = Eigen::Vector3d::Zero();
  double d = 0.0;
  double weights = 0.0;
  std::vector<PlaneFit> fits;
  std::vector<std::vector<Eigen::Vector2d>> misses;
  for (const SeenBoard& each : seen) {
    const PlaneFit fit = fit_plane(camera.model, each.corners, board);
    const double weight = 1.0 / std::max(fit.distance_sigma_mm * fit.distance_sigma_mm, 1e-18);
    n += weight * fit.n_cam;
    d += weight * fit.d_mm;
    weights += weight;
    fits.push_back(fit);
    misses.push_back(fit.misses_px);
  }
  const Eigen::Vector3d n_cam = n.normalized();
  const double d_cam = d / weights;
  MeasuredPlane m;
  m.id = written.planes.front().id;
  m.camera = camera.id;
  m.with = describe_view(camera);
  m.n = camera.model.world_from_cam.linear() * n_cam;
  m.d = d_cam - m.n.dot(camera.model.centre_world());
  for (const PlaneFit& fit : fits) {
    m.rms_px = std::max(m.rms_px, fit.rms_px);
    m.tilt_sigma_deg = std::max(m.tilt_sigma_deg, fit.tilt_sigma_deg);
  }
  m.distance_sigma = 1.0 / std::sqrt(weights);
  if (m.n.dot(written.planes.front().n) < 0.0) {
    throw Error("the camera sees the plane's back: n of the rig file points away from it",
                arguments.rig, "turn n of [[plane]], or correct world_from_cam");
  }
  const double tilted =
      std::acos(std::clamp(m.n.dot(written.planes.front().n), -1.0, 1.0)) * 57.29577951308232;
  const std::string summary = fmt::format(
      "plane {}: n = {:.6f} {:.6f} {:.6f}, d = {:.4f} mm\n{:.4f} +- {:.4f} mm from camera {}, "
      "tilt "
      "+- {:.4f} degrees, {:.3f} px rms, {} pictures\n{:.3f} degrees from the rig file's\n",
      m.id, m.n.x(), m.n.y(), m.n.z(), m.d, d_cam, m.distance_sigma, camera.id,
      m.tilt_sigma_deg, m.rms_px, fits.size(), tilted);
  fmt::print("{}", summary);
  report.add_reached("distance_mm", d_cam);
  report.add_reached("distance_sigma_mm", m.distance_sigma);
  report.add_reached("tilt_sigma_deg", m.tilt_sigma_deg);
  report.add_reached("rms_px", m.rms_px);
  write_file_atomically(page, page_of("Plane " + m.id + " of " + written.name, summary,
                                      camera.model, seen, misses));
  fmt::print("page: {}\n", page.string());
  MeasuredFile stored(written);
  std::vector<MeasuredPlane>& planes = stored.values.planes;
  planes.erase(std::remove_if(planes.begin(), planes.end(),
                              [&](const MeasuredPlane& p) { return p.id == m.id; }),
               planes.end());
  planes.push_back(m);
  report.set_bytes(stored.write());
  fmt::print("measured values: {}\n", stored.path().string());
  return ExitCode::done;
}

}  // namespace haarlight
