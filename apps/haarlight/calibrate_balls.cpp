// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight calibrate` from mirror balls: found or masked, one far light's direction from one
/// ball, near lights' places from several.

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include <fmt/format.h>

#include "apps/haarlight/calibrate.h"
#include "core/log.h"
#include "relight/calibration/mirror_ball.h"

namespace haarlight {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kDegrees = 180.0 / std::numbers::pi;
constexpr double kRivalShare = 0.25;   // a highlight has this share of its picture's brightest
constexpr double kLeastWander = 0.01;  // of the radius: what does not move is no light
constexpr double kLeastSeen = 0.5;     // of a ball's outline: a ball before a wall shows more

/// The highlights of each light on each circle, and why there is none.
struct Highlights {
  std::vector<std::vector<std::optional<BallHighlight>>> at;  ///< (K, B)
  std::vector<std::string> why;                               ///< (K), the last ball's
};

double value_at(ImageView<const float> picture, int y, int x) {
  double sum = 0.0;
  for (int c = 0; c < picture.channels(); ++c) {
    sum += static_cast<double>(picture(y, x, c));
  }
  return sum;
}

double brightest(ImageView<const float> picture) {
  double most = 0.0;
  for (int y = 0; y < picture.height(); ++y) {
    for (int x = 0; x < picture.width(); ++x) {
      most = std::max(most, value_at(picture, y, x));
    }
  }
  return most;
}

Highlights find_highlights(const LightPictures& pictures,
                           const std::vector<MeasuredBall>& balls) {
  Highlights out;
  out.at.resize(static_cast<std::size_t>(pictures.size()));
  out.why.resize(out.at.size());
  pictures.for_each([&](int k, const Image<float>& picture, float /*clip*/) {
    const auto light = static_cast<std::size_t>(k);
    const double most = brightest(picture.view());
    for (const MeasuredBall& ball : balls) {
      std::optional<BallHighlight> found;
      try {
        found = measure_highlight(picture.view(), ball.circle);
        const int x = std::clamp(static_cast<int>(found->at.x()), 0, picture.width() - 1);
        const int y = std::clamp(static_cast<int>(found->at.y()), 0, picture.height() - 1);
        if (value_at(picture.view(), y, x) < kRivalShare * most) {
          found.reset();
          out.why[light] = "the ball's brightest spot is far below the picture's";
        }
      } catch (const Error& error) {
        out.why[light] = error.problem();
      }
      out.at[light].push_back(found);
    }
  });
  return out;
}

BallEvidence evidence_of(const Highlights& highlights, std::size_t ball) {
  BallEvidence out;
  Vector2d sum = Vector2d::Zero();
  for (const auto& of_light : highlights.at) {
    if (of_light[ball]) {
      sum += of_light[ball]->at;
      ++out.n_highlights;
    }
  }
  double squares = 0.0;
  for (const auto& of_light : highlights.at) {
    if (of_light[ball]) {
      squares += (of_light[ball]->at - sum / out.n_highlights).squaredNorm();
    }
  }
  out.wander_px = std::sqrt(squares / std::max(out.n_highlights, 1));
  return out;
}

/// The pictures' mean with the circles and the highlights drawn in.
void draw(const Image<float>& mean, const std::vector<MeasuredBall>& balls,
          const Highlights& highlights, FoundLights& found) {
  Image<float> out(mean.height(), mean.width(), 3);
  const float most = *std::max_element(mean.pixels().begin(), mean.pixels().end());
  for (int y = 0; y < out.height(); ++y) {
    for (int x = 0; x < out.width(); ++x) {
      const float v = mean(y, x) / std::max(most, 1e-12F);
      for (int c = 0; c < 3; ++c) {
        out(y, x, c) = 0.7F * std::sqrt(v);  // dark balls before dark walls are to be seen
      }
    }
  }
  const auto dot = [&](double px, double py, int colour) {
    const int x = static_cast<int>(std::floor(px));
    const int y = static_cast<int>(std::floor(py));
    if (x >= 0 && y >= 0 && x < out.width() && y < out.height()) {
      for (int c = 0; c < 3; ++c) {
        out(y, x, c) = c == colour ? 1.0F : 0.0F;
      }
    }
  };
  for (const MeasuredBall& ball : balls) {
    const int n = static_cast<int>(8.0 * ball.circle.radius) + 8;
    for (int i = 0; i < n; ++i) {
      const double a = 2.0 * std::numbers::pi * i / n;
      dot(ball.circle.x + ball.circle.radius * std::cos(a),
          ball.circle.y + ball.circle.radius * std::sin(a), 1);
    }
  }
  const int reach = std::max(2, out.width() / 256);
  for (const auto& of_light : highlights.at) {
    for (const std::optional<BallHighlight>& h : of_light) {
      for (int i = -reach; h && i <= reach; ++i) {
        dot(h->at.x() + i, h->at.y(), 0);
        dot(h->at.x(), h->at.y() + i, 0);
      }
    }
  }
  found.picture = std::move(out);
  found.picture_name = "balls.png";
}

std::string circle_text(const PictureCircle& c) {
  return fmt::format("a circle about ({:.1f}, {:.1f}) of radius {:.1f}", c.x, c.y, c.radius);
}

/// Balls of the masks, or found among the pictures' circles.
struct SeenBalls {
  std::vector<MeasuredBall> balls;
  Highlights highlights;
  Image<float> mean;
};

std::vector<MeasuredBall> masked_balls(const FindLightsArguments& arguments,
                                       const LightPictures& pictures) {
  std::vector<MeasuredBall> out;
  for (const std::string& file : arguments.masks) {
    const PictureFile mask = read_picture(file);
    if (mask.pixels.width() != pictures.width() || mask.pixels.height() != pictures.height()) {
      throw Error(fmt::format("a mask of {} x {} for pictures of {} x {}", mask.pixels.width(),
                              mask.pixels.height(), pictures.width(), pictures.height()),
                  file, "draw the mask on one of the pictures themselves");
    }
    try {
      out.push_back(ball_of_mask(mask.pixels.view()));
    } catch (const Error& error) {
      throw Error(error.problem(), file, error.cure());
    }
  }
  return out;
}

SeenBalls see_balls(const FindLightsArguments& arguments, const LightPictures& pictures) {
  SeenBalls out;
  BallPictures all;
  pictures.for_each(
      [&](int /*k*/, const Image<float>& picture, float /*clip*/) { all.add(picture.view()); });
  out.mean = all.mean();
  if (!arguments.masks.empty()) {
    out.balls = masked_balls(arguments, pictures);
    out.highlights = find_highlights(pictures, out.balls);
    return out;
  }
  const std::vector<MeasuredBall> circles = find_circles(out.mean.view());
  const Highlights highlights = find_highlights(pictures, circles);
  std::vector<BallEvidence> evidence;
  for (std::size_t i = 0; i < circles.size(); ++i) {
    evidence.push_back(evidence_of(highlights, i));
  }
  const BallChoice choice = choose_balls(circles, evidence, pictures.size());
  const std::string cure =
      "paint each ball white and the rest black on one of the pictures, and name it: --ball "
      "MASK.png, once for each ball";
  if (!choice.rivals.empty()) {
    throw Error("which is the ball? " + circle_text(circles[choice.balls.front()].circle) +
                    ", or " + circle_text(circles[choice.rivals.front()].circle),
                arguments.input, cure);
  }
  if (static_cast<int>(choice.balls.size()) != arguments.n_balls) {
    std::string text = choice.balls.empty()
                           ? fmt::format(
                                 "no mirror ball is seen ({} circles without a moving "
                                 "highlight)",
                                 circles.size())
                           : fmt::format("{} mirror balls are seen, not {}",
                                         choice.balls.size(), arguments.n_balls);
    for (const std::size_t i : choice.balls) {
      text += "; " + circle_text(circles[i].circle);
    }
    throw Error(text, arguments.input,
                choice.balls.empty() ? cure : "say how many there are: --balls N; or " + cure);
  }
  for (const std::size_t i : choice.balls) {
    out.balls.push_back(circles[i]);
  }
  out.highlights.why = highlights.why;
  for (const auto& of_light : highlights.at) {
    out.highlights.at.emplace_back();
    for (const std::size_t i : choice.balls) {
      out.highlights.at.back().push_back(of_light[i]);
    }
  }
  return out;
}

/// The camera that saw the balls, at the origin; nothing: far away, straight ahead.
std::optional<CameraModel> ball_camera(const FindLightsArguments& arguments,
                                       const LightPictures& pictures) {
  if (!arguments.rig.empty() || (pictures.session() != nullptr && pictures.session()->rig())) {
    const Rig rig =
        arguments.rig.empty() ? *pictures.session()->rig() : read_rig(arguments.rig);
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
  double focal = arguments.focal_px;
  if (!(focal > 0.0) && arguments.width_mm > 0.0 && arguments.camera_mm > 0.0) {
    focal = pictures.width() * arguments.camera_mm / arguments.width_mm;
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

void tell_balls(const SeenBalls& seen, Report& report) {
  std::vector<double> numbers;
  for (const MeasuredBall& ball : seen.balls) {
    const PictureCircle& c = ball.circle;
    fmt::print(
        "ball at ({:.2f}, {:.2f}), radius {:.2f} +- {:.2f} pixels, {:.0f} % of its "
        "outline seen\n",
        c.x, c.y, c.radius, std::sqrt(ball.covariance(2, 2)), 100.0 * ball.seen);
    if (ball.seen < kLeastSeen) {
      log_warning(
          "less than half of that outline is in the pictures: is it a ball? Look at "
          "balls.png; where it is not, say where the ball is: --ball MASK");
    }
    numbers.insert(numbers.end(), {c.x, c.y, c.radius});
  }
  report.add_reached("balls_px", numbers);
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

std::vector<double> radii_of(const FindLightsArguments& arguments, std::size_t n_balls) {
  std::vector<double> radii = arguments.radius_mm;
  if (radii.size() == 1) {
    radii.assign(n_balls, radii[0]);
  }
  if (radii.size() != n_balls) {
    throw Error(fmt::format("{} radii for {} balls", radii.size(), n_balls), "--radius-mm",
                "give one for all, or one for each in the order of --ball", ExitCode::usage);
  }
  if (arguments.masks.empty() &&
      std::any_of(radii.begin(), radii.end(), [&](double r) { return r != radii[0]; })) {
    throw Error("balls that were found have no order: whose radius is whose?", "--radius-mm",
                "balls of one radius, or a --ball mask for each", ExitCode::usage);
  }
  return radii;
}

FoundLights by_several_balls(const FindLightsArguments& arguments, const SeenBalls& seen,
                             const LightPictures& pictures, const CameraModel& camera,
                             Report& report) {
  const std::vector<double> radii = radii_of(arguments, seen.balls.size());
  const BallScene scene = ball_scene(camera, seen.balls, radii);
  const BallPlaces places = ball_places(camera, seen.balls, radii, seen.highlights.at);
  const double width_mm = camera.width * scene.camera_mm / camera.fx;
  FoundLights found;
  found.frame = fmt::format(
      "mm; x right, y up, z to the camera; origin where the camera's axis meets the plane that "
      "the balls lie on, {:.2f} mm before the camera; the picture is {:.2f} mm wide there",
      scene.camera_mm, width_mm);
  fmt::print("{}\n", found.frame);
  report.add_reached("camera_mm", scene.camera_mm);
  report.add_reached("width_mm", width_mm);
  report.add_reached("ray_chi2", places.chi2 / std::max(places.freedom, 1));
  const bool is_wrong = places.is_model_wrong();
  for (std::size_t k = 0; k < places.lights.size(); ++k) {
    const BallPlace& place = places.lights[k];
    FoundLight light;
    light.name = pictures.names()[k];
    if (place.freedom > 0) {
      light.position_mm = place.position_mm;
      light.direction = place.position_mm.normalized();
      const double wider = std::max(1.0, places.chi2 / std::max(places.freedom, 1));
      if (!is_wrong) {
        light.sigma_mm = (wider * place.covariance_mm2.diagonal()).cwiseSqrt();
        light.sigma_deg = direction_sigma_deg(place.position_mm, wider * place.covariance_mm2);
      }
    } else {
      light.finding = "unseen: fewer than two balls show it";
    }
    found.lights.push_back(std::move(light));
  }
  if (is_wrong) {
    found.is_good = false;
    fmt::print(
        stderr,
        "the balls' rays pass each other by more than their errors allow (chi^2 {:.1f} a "
        "degree of freedom): how wrong the places are is not known, no +- is given\n  "
        "cure: check --radius-mm, the camera (--focal-px, --rig), the masks; "
        "highlights of one and the same lamp\n",
        places.chi2 / places.freedom);
  }
  return found;
}

}  // namespace

FoundLights find_by_balls(const FindLightsArguments& arguments, const LightPictures& pictures,
                          const CommonOptions& /*common*/, Report& report) {
  if (!arguments.masks.empty() && arguments.masks.size() != 1 && arguments.radius_mm.empty()) {
    throw Error("several balls tell where near lights are, by how large they are", "--ball",
                "say how large: --radius-mm; or give one --ball, for directions",
                ExitCode::usage);
  }
  const std::optional<CameraModel> camera = ball_camera(arguments, pictures);
  const bool are_near = !arguments.radius_mm.empty();
  const std::size_t n_asked = arguments.masks.empty()
                                  ? static_cast<std::size_t>(arguments.n_balls)
                                  : arguments.masks.size();
  if (are_near && (n_asked < 2 || !camera)) {
    throw Error(n_asked < 2 ? "one ball tells a direction, not a place"
                            : "places need the camera's perspective",
                "--radius-mm",
                n_asked < 2
                    ? "two balls or more (--balls N, or --ball MASK for each); or leave "
                      "--radius-mm out"
                    : "give --focal-px, or --width-mm with --camera-mm, or --rig",
                ExitCode::usage);
  }
  if (!are_near && n_asked > 1) {
    throw Error("several balls tell where near lights are, by how large they are", "--balls",
                "say how large: --radius-mm", ExitCode::usage);
  }
  SeenBalls seen = see_balls(arguments, pictures);
  for (MeasuredBall& ball : seen.balls) {
    ball.covariance.diagonal().array() += arguments.edge_px * arguments.edge_px;
  }
  require_wandering(seen, arguments.input);
  tell_balls(seen, report);
  FoundLights found = are_near ? by_several_balls(arguments, seen, pictures, *camera, report)
                               : by_one_ball(seen, pictures, camera);
  if (!are_near && !camera) {
    log_warning(
        "the camera is taken as far away, straight before the ball; --focal-px lifts "
        "that");
  }
  draw(seen.mean, seen.balls, seen.highlights, found);
  return found;
}

}  // namespace haarlight
