// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/calibrate/calibrate_balls.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/core/rig/rig.h"
#include "relight/pipeline/calibrate/seen_balls.h"

namespace haarlight::relight {

namespace {

constexpr double kDegrees = 180.0 / std::numbers::pi;
constexpr double kLeastWander = 0.01;  // of the radius: what does not move is not a light
constexpr double kLeastSeen = 0.5;     // of a ball's outline: a ball before a wall shows more

/// The camera that saw the balls, at the origin; nothing: far away, straight ahead.
std::optional<CameraModel> ball_camera(const CalibratePipelineOptions& options,
                                       const LightPictures& pictures) {
  if (!options.rig.empty() || (pictures.session() != nullptr && pictures.session()->rig())) {
    const Rig rig = options.rig.empty() ? *pictures.session()->rig() : read_rig(options.rig);
    if (rig.cameras.empty()) {
      throw Error("the rig has no camera", rig.name, "add [[camera]] to the rig file");
    }
    const CameraModel& camera = rig.cameras.front().model;
    if (camera.width != pictures.width() || camera.height != pictures.height()) {
      throw Error(fmt::format("a camera of {} x {} for pictures of {} x {}", camera.width,
                              camera.height, pictures.width(), pictures.height()),
                  rig.name, "give the rig file of the camera that took them");
    }
    return camera;
  }
  double focal = options.focal_px;
  if (!(focal > 0.0) && options.width_mm > 0.0 && options.camera_mm > 0.0) {
    focal = pictures.width() * options.camera_mm / options.width_mm;
  }
  if (!(focal > 0.0)) {
    return std::nullopt;
  }
  CameraModel camera;
  camera.width = pictures.width();
  camera.height = pictures.height();
  camera.fx = camera.fy = focal;
  camera.cx = 0.5 * camera.width;
  camera.cy = 0.5 * camera.height;
  return camera;
}

void add_ball_notes(const std::vector<MeasuredBall>& balls, PipelineNotes& notes) {
  for (const MeasuredBall& ball : balls) {
    const PictureCircle& c = ball.circle;
    notes.add(
        NoteKind::result,
        fmt::format("ball at ({:.2f}, {:.2f}), radius {:.2f} +- {:.2f} pixels, {:.0f} % of "
                    "its outline seen",
                    c.x, c.y, c.radius, std::sqrt(ball.covariance(2, 2)), 100.0 * ball.seen));
    if (ball.seen < kLeastSeen) {
      notes.add(NoteKind::warning,
                "less than half of that outline is in the pictures: is it a ball? Look at "
                "balls.png; where it is not, say where the ball is: --ball MASK");
    }
  }
}

void require_wandering(const SeenBalls& seen, const std::string& input) {
  for (std::size_t b = 0; b < seen.balls.size(); ++b) {
    const BallEvidence evidence = evidence_of(seen.highlights, b);
    if (evidence.n_highlights == 0) {
      throw Error("no picture shows a highlight on " + circle_text(seen.balls[b].circle), input,
                  "look at the mask, the exposure, and whether the ball mirrors: " +
                      seen.highlights.why.front());
    }
    if (seen.highlights.at.size() > 2 &&
        evidence.wander_px < kLeastWander * seen.balls[b].circle.radius) {
      throw Error("the highlight on " + circle_text(seen.balls[b].circle) +
                      " stays where it is in all pictures",
                  input, "another lamp or a window outshines the lights: darken the room");
    }
  }
}

FoundLights by_one_ball(const SeenBalls& seen, const LightPictures& pictures,
                        const std::optional<CameraModel>& camera) {
  FoundLights found;
  found.frame = "x right, y up, z to the camera";
  for (std::size_t k = 0; k < seen.highlights.at.size(); ++k) {
    FoundLight light;
    light.name = pictures.names()[k];
    if (const std::optional<BallHighlight>& at = seen.highlights.at[k][0]) {
      const BallDirection d = ball_direction(seen.balls[0], *at, camera ? &*camera : nullptr);
      light.direction = d.direction;
      light.sigma_deg = d.sigma_rad * kDegrees;
    } else {
      light.finding = "unseen: " + seen.highlights.why[k];
    }
    found.lights.push_back(std::move(light));
  }
  return found;
}

std::vector<double> radii_of(const CalibratePipelineOptions& options, std::size_t n_balls) {
  std::vector<double> radii = options.ball.radius_mm;
  if (radii.size() == 1) {
    radii.assign(n_balls, radii[0]);
  }
  if (radii.size() != n_balls) {
    throw Error(fmt::format("{} radii for {} balls", radii.size(), n_balls), "--radius-mm",
                "give one for all, or one for each in the order of --ball", ExitCode::usage);
  }
  if (options.ball.masks.empty() &&
      std::any_of(radii.begin(), radii.end(), [&](double r) { return r != radii[0]; })) {
    throw Error("balls that were found have no order: whose radius is whose?", "--radius-mm",
                "balls of one radius, or a --ball mask for each", ExitCode::usage);
  }
  return radii;
}

FoundLights by_several_balls(const CalibratePipelineOptions& options, const SeenBalls& seen,
                             const LightPictures& pictures, const CameraModel& camera,
                             BallFindings& findings, PipelineNotes& notes) {
  const std::vector<double> radii = radii_of(options, seen.balls.size());
  const BallScene scene = ball_scene(camera, seen.balls, radii);
  const BallPositions positions = ball_positions(camera, seen.balls, radii, seen.highlights.at);
  const double width_mm = camera.width * scene.camera_mm / camera.fx;
  FoundLights found;
  found.frame = fmt::format(
      "mm; x right, y up, z to the camera; origin where the camera's axis meets the plane that "
      "the balls lie on, {:.2f} mm before the camera; the picture is {:.2f} mm wide there",
      scene.camera_mm, width_mm);
  notes.add(NoteKind::result, found.frame);
  findings.camera_mm = scene.camera_mm;
  findings.width_mm = width_mm;
  findings.ray_chi2 = positions.chi2 / std::max(positions.freedom, 1);
  const bool is_wrong = positions.is_model_wrong();
  for (std::size_t k = 0; k < positions.lights.size(); ++k) {
    const BallPosition& position = positions.lights[k];
    FoundLight light;
    light.name = pictures.names()[k];
    if (position.freedom > 0) {
      light.position_mm = position.position_mm;
      light.direction = position.position_mm.normalized();
      const double wider = std::max(1.0, positions.chi2 / std::max(positions.freedom, 1));
      if (!is_wrong) {
        light.sigma_mm = (wider * position.covariance_mm2.diagonal()).cwiseSqrt();
        light.sigma_deg =
            direction_sigma_deg(position.position_mm, wider * position.covariance_mm2);
      }
    } else {
      light.finding = "unseen: fewer than two balls show it";
    }
    found.lights.push_back(std::move(light));
  }
  if (is_wrong) {
    found.is_good = false;
    notes.add(
        NoteKind::caution,
        fmt::format(
            "the balls' rays pass each other by more than their errors allow (chi^2 {:.1f} per "
            "degree of freedom): how wrong the positions are is not known, no +- is given\n  "
            "hint: check --radius-mm, the camera (--focal-px, --rig), the masks; "
            "highlights of one and the same lamp",
            positions.chi2 / positions.freedom));
  }
  return found;
}

}  // namespace

FoundLights find_by_balls(const CalibratePipelineOptions& options,
                          const LightPictures& pictures, BallFindings& findings,
                          PipelineNotes& notes) {
  if (!options.ball.masks.empty() && options.ball.masks.size() != 1 &&
      options.ball.radius_mm.empty()) {
    throw Error("several balls tell where near lights are, by how large they are", "--ball",
                "say how large: --radius-mm; or give one --ball, for directions",
                ExitCode::usage);
  }
  const std::optional<CameraModel> camera = ball_camera(options, pictures);
  const bool are_near = !options.ball.radius_mm.empty();
  const std::size_t n_requested = options.ball.masks.empty()
                                      ? static_cast<std::size_t>(options.ball.n_balls)
                                      : options.ball.masks.size();
  if (are_near && (n_requested < 2 || !camera)) {
    throw Error(n_requested < 2 ? "one ball tells a direction, not a position"
                                : "positions need the camera's perspective",
                "--radius-mm",
                n_requested < 2
                    ? "two balls or more (--balls N, or --ball MASK for each); or leave "
                      "--radius-mm out"
                    : "give --focal-px, or --width-mm with --camera-mm, or --rig",
                ExitCode::usage);
  }
  if (!are_near && n_requested > 1) {
    throw Error("several balls tell where near lights are, by how large they are", "--balls",
                "say how large: --radius-mm", ExitCode::usage);
  }
  SeenBalls seen = see_balls(options, pictures);
  for (MeasuredBall& ball : seen.balls) {
    ball.covariance.diagonal().array() += options.ball.edge_px * options.ball.edge_px;
  }
  require_wandering(seen, options.input.string());
  findings.balls = seen.balls;
  add_ball_notes(seen.balls, notes);
  FoundLights found = are_near
                          ? by_several_balls(options, seen, pictures, *camera, findings, notes)
                          : by_one_ball(seen, pictures, camera);
  if (!are_near && !camera) {
    notes.add(NoteKind::warning,
              "the camera is taken as far away, straight before the ball; --focal-px lifts "
              "that");
  }
  found.picture = drawn_balls(seen);
  found.picture_name = "balls.png";
  return found;
}

}  // namespace haarlight::relight
