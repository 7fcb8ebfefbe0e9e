// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/light/near_light.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Geometry>

#include "core/rig/measured_rig.h"
#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

double point_stencil(const NearLight& light, const Eigen::Vector3d& position,
                     const Eigen::Vector3d& point, const Eigen::Vector3d& normal) noexcept {
  const Eigen::Vector3d way = position - point;
  const double facing = normal.dot(way);
  if (!(facing > 0.0)) {
    return 0.0;
  }
  const double r2 = way.squaredNorm();
  const double r = std::sqrt(r2);
  const double value = facing / (r2 * r);
  if (light.mu == 0.0) {
    return value;
  }
  const double off_axis = -light.axis.dot(way) / r;
  return off_axis > 0.0 ? value * std::pow(off_axis, light.mu) : 0.0;
}

}  // namespace

void turn_to_aim(NearLight& light) {
  if (!light.aim_mm) {
    return;
  }
  const Eigen::Vector3d axis =
      ((*light.aim_mm - light.position_mm).normalized() + light.aim_off).normalized();
  light.emitter_mm = Eigen::Quaterniond::FromTwoVectors(light.axis, axis).toRotationMatrix() *
                     light.emitter_mm;
  light.axis = axis;
}

namespace {

/// d axis / d (direction to the aim + aim_off): the derivative of a vector's direction by the
/// vector.
Eigen::Matrix3d axis_per_sum(const NearLight& light, const Eigen::Vector3d& way) {
  return (Eigen::Matrix3d::Identity() - light.axis * light.axis.transpose()) /
         (way + light.aim_off).norm();
}

}  // namespace

Eigen::Matrix3d axis_per_position(const NearLight& light) {
  if (!light.aim_mm) {
    return Eigen::Matrix3d::Zero();
  }
  const Eigen::Vector3d to_aim = *light.aim_mm - light.position_mm;
  const double distance = to_aim.norm();
  const Eigen::Vector3d way = to_aim / distance;
  return axis_per_sum(light, way) * (way * way.transpose() - Eigen::Matrix3d::Identity()) /
         distance;
}

Eigen::Matrix<double, 3, 2> across_aim(const NearLight& light) {
  Eigen::Matrix<double, 3, 2> out = Eigen::Matrix<double, 3, 2>::Zero();
  if (light.aim_mm) {
    const Eigen::Vector3d way = (*light.aim_mm - light.position_mm).normalized();
    const Eigen::Vector3d u = way.unitOrthogonal();
    out << u, way.cross(u);
  }
  return out;
}

Eigen::Matrix<double, 3, 2> axis_per_aim(const NearLight& light) {
  if (!light.aim_mm) {
    return Eigen::Matrix<double, 3, 2>::Zero();
  }
  return axis_per_sum(light, (*light.aim_mm - light.position_mm).normalized()) *
         across_aim(light);
}

EmitterPoints emitter_points(const NearLight& light) noexcept {
  EmitterPoints points;
  points.at.fill(light.position_mm);
  if (light.emitter_mm.isZero(0.0)) {
    return points;
  }
  constexpr double kNode = 0.28867513459481287;  // 1 / (2 sqrt 3) of an edge from the middle
  points.n = 4;
  for (int i = 0; i < 4; ++i) {
    const Eigen::Vector2d s((i & 1) != 0 ? kNode : -kNode, (i & 2) != 0 ? kNode : -kNode);
    points.at[static_cast<std::size_t>(i)] += light.emitter_mm * s;
  }
  return points;
}

double light_stencil(const NearLight& light, const Eigen::Vector3d& point,
                     const Eigen::Vector3d& normal) noexcept {
  const EmitterPoints from = emitter_points(light);
  double sum = 0.0;
  for (int i = 0; i < from.n; ++i) {
    sum += point_stencil(light, from.at[static_cast<std::size_t>(i)], point, normal);
  }
  return sum / from.n;
}

namespace {

/// From the world to x right, y up, z to the camera.
Eigen::Matrix3d turn_of(const CameraModel& camera) {
  const Eigen::Matrix3d world_from_cam = camera.world_from_cam.linear();
  return Eigen::Vector3d(1.0, -1.0, -1.0).asDiagonal() * world_from_cam.transpose();
}

/// Measured by `rig calibrate lights`; 1 where that was not done, and for lights it did not
/// see.
double calibrated_power(const Rig& rig, const LightElement& element) {
  if (rig.measured == nullptr) {
    return 1.0;
  }
  const Face& face = rig.faces[static_cast<std::size_t>(element.face)];
  for (const MeasuredFace& measured : rig.measured->faces) {
    const int index = element.row * face.cols + element.col;
    const auto at = static_cast<std::size_t>(index);
    if (measured.id == face.id && at < measured.power.size() && measured.power[at] > 0.0) {
      return measured.power[at];
    }
  }
  return 1.0;
}

}  // namespace

CaptureLights capture_lights(const session::Session& session) {
  CaptureLights lights;
  const auto n = session.info().lights.size();
  lights.directions.reserve(n);
  if (session.rig().has_value()) {
    lights.are_near = true;
    for (const LightElement& element : light_elements(*session.rig())) {
      lights.near.push_back({element.centre, element.emits, element.lobe_mu});
      lights.near.back().power.setConstant(calibrated_power(*session.rig(), element));
      lights.directions.push_back((element.centre - session.rig()->object_centre).normalized());
    }
    return lights;
  }
  lights.are_near =
      std::all_of(session.info().lights.begin(), session.info().lights.end(),
                  [](const session::SessionLight& light) { return light.is_position; });
  for (const session::SessionLight& light : session.info().lights) {
    if (lights.are_near) {
      lights.near.push_back(
          {light.coordinates,
           light.lobe ? light.lobe->axis : Eigen::Vector3d(-light.coordinates.normalized()),
           light.lobe ? light.lobe->mu : 0.0});
    }
    lights.directions.push_back(light.coordinates.normalized());
  }
  return lights;
}

std::vector<Eigen::Vector3d> picture_directions(const Rig& rig) {
  if (rig.cameras.empty()) {
    throw Error("the rig has no camera", rig.name, "add [[camera]] to the rig file");
  }
  const Eigen::Matrix3d turn = turn_of(rig.cameras.front().model);
  std::vector<Eigen::Vector3d> directions;
  for (const LightElement& element : light_elements(rig)) {
    directions.emplace_back(turn * (element.centre - rig.object_centre).normalized());
  }
  return directions;
}

std::vector<Eigen::Vector3d> picture_directions(const session::Session& session) {
  return session.rig().has_value() ? picture_directions(*session.rig())
                                   : capture_lights(session).directions;
}

std::vector<session::SessionLight> lights_in_picture(
    const Rig& rig, std::vector<session::SessionLight> lights) {
  if (rig.cameras.empty()) {
    return {};
  }
  const std::vector<LightElement> elements = light_elements(rig);
  HAARLIGHT_EXPECTS(elements.size() == lights.size(), "the rig's lights");
  const Eigen::Matrix3d turn = turn_of(rig.cameras.front().model);
  for (std::size_t k = 0; k < lights.size(); ++k) {
    lights[k].coordinates = turn * (lights[k].coordinates - rig.object_centre);
    if (elements[k].lobe_mu > 0.0) {
      lights[k].lobe = session::LightLobe{turn * elements[k].emits, elements[k].lobe_mu};
    }
  }
  return lights;
}

std::vector<session::SessionLight> lights_in_picture(const session::Session& session) {
  return session.rig().has_value() ? lights_in_picture(*session.rig(), session.info().lights)
                                   : session.info().lights;
}

PixelPoints PixelPoints::orthographic(int width, int height, double width_mm) {
  HAARLIGHT_EXPECTS(width > 0 && height > 0 && width_mm > 0.0, "a picture with a width");
  PixelPoints points;
  points.camera_.width = width;
  points.camera_.height = height;
  points.mm_per_pixel_ = width_mm / width;
  points.middle_ = {0.5 * width, 0.5 * height};
  return points;
}

PixelPoints PixelPoints::orthographic(int width, int height, double width_mm,
                                      const session::FrameCrop& crop) {
  PixelPoints points = orthographic(width, height, width_mm);
  points.middle_ = {0.5 * crop.whole_width - crop.x, 0.5 * crop.whole_height - crop.y};
  return points;
}

PixelPoints PixelPoints::on_plane(const CameraModel& camera, const Eigen::Vector3d& n,
                                  double d) {
  const CameraRay middle = ray_through(camera, 0.5 * camera.width, 0.5 * camera.height);
  const double facing = n.dot(middle.direction_world);
  if (!(-(n.dot(middle.origin_world) + d) / facing > 0.0)) {
    throw Error("the camera does not look at the plane", "camera pose and plane",
                "mend [[camera]] or [[plane]] in the rig file");
  }
  PixelPoints points;
  points.is_camera_ = true;
  points.camera_ = camera;
  points.n_ = n;
  points.d_ = d;
  points.turn_ = turn_of(camera);
  return points;
}

Eigen::Vector3d PixelPoints::at(double x, double y) const {
  if (!is_camera_) {
    return {mm_per_pixel_ * (x - middle_.x()), mm_per_pixel_ * (middle_.y() - y), 0.0};
  }
  const CameraRay ray = ray_through(camera_, x, y);
  const double t = -(n_.dot(ray.origin_world) + d_) / n_.dot(ray.direction_world);
  return ray.origin_world + t * ray.direction_world;
}

Eigen::Vector3d PixelPoints::to_camera(double x, double y) const {
  return is_camera_ ? Eigen::Vector3d(-ray_through(camera_, x, y).direction_world)
                    : Eigen::Vector3d::UnitZ();
}

Eigen::Vector3d PixelPoints::plane_normal() const {
  if (!is_camera_) {
    return n_;
  }
  const double side = n_.dot(camera_.centre_world()) + d_;
  return side < 0.0 ? Eigen::Vector3d(-n_ / n_.norm()) : Eigen::Vector3d(n_ / n_.norm());
}

double PixelPoints::height_of(const Eigen::Vector3d& point) const {
  const double side = is_camera_ && n_.dot(camera_.centre_world()) + d_ < 0.0 ? -1.0 : 1.0;
  return side * (n_.dot(point) + d_) / n_.norm();
}

double PixelPoints::mm_per_pixel() const {
  if (!is_camera_) {
    return mm_per_pixel_;
  }
  const Eigen::Vector3d middle = at(0.5 * camera_.width, 0.5 * camera_.height);
  return (middle - camera_.centre_world()).norm() / camera_.fx;
}

PixelPoints pixel_points(const session::Session& session, double width_mm, double height_mm) {
  const session::FrameForm& form = session.info().form;
  if (session.rig().has_value()) {
    const Rig& rig = *session.rig();
    if (rig.cameras.empty() || rig.planes.empty()) {
      throw Error("the rig has no camera or no plane", session.folder().string(),
                  "add [[camera]] and [[plane]] to the rig file");
    }
    const ShadowPlane& plane = rig.planes.front();
    return PixelPoints::on_plane(rig.cameras.front().model, plane.n, plane.d - height_mm);
  }
  if (!(width_mm > 0.0)) {
    throw Error("near lights need the picture's width in mm", session.folder().string(),
                "say how wide the target is across the whole picture: --width-mm");
  }
  return form.crop ? PixelPoints::orthographic(form.width, form.height, width_mm, *form.crop)
                   : PixelPoints::orthographic(form.width, form.height, width_mm);
}

}  // namespace haarlight::relight
