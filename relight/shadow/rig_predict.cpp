// SPDX-License-Identifier: Apache-2.0
#include "relight/shadow/rig_predict.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/relight/shadow/area_mean.h"
#include "haarlight/relight/shadow/predict.h"

namespace haarlight::relight {
namespace {

constexpr int kPositions = 9;  // per side, spread over a plane's picture
constexpr double kDegree = std::numbers::pi / 180.0;

/// Positions on a grid over the plane's picture, including the middle.
std::vector<Eigen::Vector3d> positions_on(const PlaneFrame& frame) {
  std::vector<Eigen::Vector3d> positions;
  for (int row = 0; row < kPositions; ++row) {
    for (int col = 0; col < kPositions; ++col) {
      positions.push_back(frame.world_of(frame.width * col / (kPositions - 1.0),
                                         frame.height * row / (kPositions - 1.0)));
    }
  }
  return positions;
}

Span span_of(std::vector<double> values, double middle) {
  const auto [least, most] = std::minmax_element(values.begin(), values.end());
  return {*least, middle, *most};
}

/// Neighbouring lights of a face, and a light's opposite sides, along one of its axes.
struct Pair {
  Eigen::Vector3d from;
  Eigen::Vector3d to;
};

/// At the face's middle and its four corners: in between everything is monotone.
std::vector<Pair> pairs_of(const Face& face, double length) {
  std::vector<Pair> pairs;
  for (const double row : {0.0, -0.5, 0.5}) {
    for (const double col : {0.0, -0.5, 0.5}) {
      if ((row == 0.0) != (col == 0.0)) {
        continue;  // middle and corners
      }
      const Eigen::Vector3d at = face.centre + col * (face.cols - 1) * face.pitch_mm * face.u +
                                 row * (face.rows - 1) * face.pitch_mm * face.v;
      for (const Eigen::Vector3d& axis : {face.u, face.v}) {
        // Into the face, so that no pair extends past its border.
        const double sign = axis.dot(face.centre - at) < 0.0 ? -1.0 : 1.0;
        const bool is_middle = row == 0.0;
        const Eigen::Vector3d from = is_middle ? at - 0.5 * length * axis : at;
        pairs.push_back({from, from + sign * length * axis});
      }
    }
  }
  return pairs;
}

/// Distances of the two shadows of a point h above every position, under every pair.
std::optional<Span> distances(const PlaneFrame& frame, const std::vector<Pair>& pairs,
                              double h) {
  std::vector<double> found;
  for (const Eigen::Vector3d& position : positions_on(frame)) {
    for (const Pair& pair : pairs) {
      const std::optional<double> distance =
          shadow_distance(frame.plane, position + h * frame.plane.n, pair.from, pair.to);
      if (!distance) {
        return std::nullopt;
      }
      found.push_back(*distance);
    }
  }
  const Eigen::Vector3d middle =
      frame.world_of(0.5 * frame.width, 0.5 * frame.height) + h * frame.plane.n;
  // Under the middle: the mean of the two axes' at the face's middle.
  const double u = *shadow_distance(frame.plane, middle, pairs[0].from, pairs[0].to);
  const double v = *shadow_distance(frame.plane, middle, pairs[1].from, pairs[1].to);
  return span_of(std::move(found), 0.5 * (u + v));
}

EdgePrediction predict_edge(const PlaneFrame& frame, const Face& face, double H, double h,
                            const PredictOptions& options) {
  EdgePrediction edge;
  edge.height_mm = h;
  const double side = 0.5 * (face.emitter_w_mm + face.emitter_h_mm);
  const std::optional<Span> spacing = distances(frame, pairs_of(face, face.pitch_mm), h);
  const std::optional<Span> penumbra = distances(frame, pairs_of(face, side), h);
  HAARLIGHT_ASSERT(spacing && penumbra);  // predict_rig checked the lowest light
  edge.spacing_mm = *spacing;
  edge.penumbra_mm = *penumbra;
  const double W = edge.penumbra_mm.middle;
  edge.ripple =
      side <= face.pitch_mm ? gap_ripple(side, face.pitch_mm, options.strip_mm, h, H) : 0.0;
  edge.sun_penumbra_mm = 2.0 * std::tan(0.5 * options.sun_deg * kDegree) * h;
  if (W > 0.0 && edge.sun_penumbra_mm <= W) {
    edge.hard_sun_error_mm = hard_sun_error(W, edge.sun_penumbra_mm);
  }
  edge.off_grid_error_mm = W > 0.0 ? off_grid_error(W, edge.spacing_mm.middle) : 0.0;
  edge.largest_pixel_mm = largest_pixel(edge.penumbra_mm.least);
  for (const double at : options.receivers) {
    ReceiverPrediction receiver{at, penumbra_width_at(side, h, H, at), 0.0};
    const double fraction = std::min(h / H, 0.999);
    if (at >= h) {
      receiver.drawn_mm = 0.0;  // above the object: drawn lit
    } else {
      // The picture's own penumbra, as seen through the light's middle, and the window on top.
      const double own = penumbra_width(side, h, H) * (H - at) / H;
      const double ratio = at / H;
      const double window = window_side(side, at, H);
      const double scale = at < 0.0 && h > 0.0 ? corrected_window_scale(ratio, fraction) : 1.0;
      receiver.drawn_mm = at < 0.0 ? std::hypot(own, scale * window * (H - at) / H) : own;
    }
    edge.receivers.push_back(receiver);
  }
  return edge;
}

void check_options(const PredictOptions& options) {
  const auto refuse = [](const std::string& what, const char* where, const char* hint) {
    throw Error(what, where, hint, ExitCode::usage);
  };
  if (!(options.low_mm >= 0.0)) {
    refuse(fmt::format("the object's lowest point is {:g} mm under the plane", -options.low_mm),
           "--object-height", "heights count from the shadow plane upwards");
  }
  if (!(options.high_mm >= options.low_mm) || !(options.high_mm > 0.0)) {
    refuse("the object's highest point is not above its lowest and the plane",
           "--object-height", "write LOW,HIGH in mm over the plane, for example 76,128");
  }
  if (!(options.strip_mm > 0.0)) {
    refuse("a strip has a width", "--strip", "give it in mm");
  }
  if (!(options.sun_deg >= 0.0 && options.sun_deg < 90.0)) {
    refuse("a sun is 0 to 90 degrees wide", "--sun", "the real one has 0.53");
  }
}

PixelPrediction predict_pixel(const CameraSpec& camera, const PlaneFrame& frame) {
  PixelPrediction pixel;
  pixel.camera = camera.id;
  const auto foot = [&](double x, double y) {
    const CameraRay ray = ray_through(camera.model, x, y);
    const double towards = frame.plane.n.dot(ray.direction_world);
    const double t = -frame.height_of(ray.origin_world) / towards;
    return Eigen::Vector3d(ray.origin_world + t * ray.direction_world);
  };
  std::vector<double> sizes;
  double middle = 0.0;
  double n_positions = 0.0;
  for (const Eigen::Vector3d& position : positions_on(frame)) {
    n_positions += 1.0;
    const std::optional<Eigen::Vector2d> at = project(camera.model, position);
    if (!at || at->x() < 0.5 || at->y() < 0.5 || at->x() > camera.model.width - 0.5 ||
        at->y() > camera.model.height - 0.5) {
      continue;
    }
    const double across = (foot(at->x() + 0.5, at->y()) - foot(at->x() - 0.5, at->y())).norm();
    const double along = (foot(at->x(), at->y() + 0.5) - foot(at->x(), at->y() - 0.5)).norm();
    sizes.push_back(std::max(across, along));
    if (sizes.size() == 1 ||
        (position - frame.origin).norm() < 1e-6 * (1.0 + frame.origin.norm())) {
      middle = sizes.back();
    }
  }
  pixel.seen_fraction = static_cast<double>(sizes.size()) / n_positions;
  if (!sizes.empty()) {
    pixel.pixel_mm = span_of(std::move(sizes), middle);
  }
  return pixel;
}

}  // namespace

std::optional<double> shadow_distance(const Plane& plane, const Eigen::Vector3d& point,
                                      const Eigen::Vector3d& light_a,
                                      const Eigen::Vector3d& light_b) {
  const PlaneProjection a = project_to_plane(plane, light_a, point);
  const PlaneProjection b = project_to_plane(plane, light_b, point);
  if (!is_valid(a.status) || !is_valid(b.status)) {
    return std::nullopt;
  }
  return (a.point - b.point).norm();
}

RigPrediction predict_rig(const Rig& rig, const PredictOptions& options) {
  check_options(options);
  const std::string where = rig.file.empty() ? rig.name : rig.file.string();
  if (rig.planes.empty()) {
    throw Error("the rig has no [[plane]]: there is nothing for a shadow to fall on", where,
                "add the shadow plane to the rig file");
  }
  RigPrediction prediction;
  double lowest_usable = 0.0;
  for (const ShadowPlane& plane : rig.planes) {
    const PlaneFrame as_written = make_plane_frame(plane);
    for (const Face& face : rig.faces) {
      PlaneFrame frame = as_written;
      if (frame.height_of(face.centre) < 0.0) {
        frame.plane.n = -frame.plane.n;  // heights count towards the lights
        frame.plane.d = -frame.plane.d;
      }
      PlanePrediction found;
      found.face = face.id;
      found.plane = plane.id;
      found.light_height_mm = frame.height_of(face.centre);
      const double reach = 0.5 * face.pitch_mm *
                           (std::abs(frame.plane.n.dot(face.u)) * face.cols +
                            std::abs(frame.plane.n.dot(face.v)) * face.rows);
      found.lowest_light_mm = found.light_height_mm - reach;
      const double cosine = -frame.plane.n.dot(face.emits);
      found.tilt_deg = std::acos(std::clamp(cosine, -1.0, 1.0)) / kDegree;
      lowest_usable =
          cosine > 0.0 ? std::max(lowest_usable, found.lowest_light_mm) : lowest_usable;
      if (cosine <= 0.0 || found.lowest_light_mm <= 0.0) {
        prediction.notes.push_back(fmt::format(
            "face \"{}\" does not light all of plane \"{}\" from above: nothing is predicted",
            face.id, plane.id));
        continue;
      }
      if (options.high_mm >= found.lowest_light_mm) {
        prediction.notes.push_back(
            fmt::format("face \"{}\" has lights {:.0f} mm over plane \"{}\", not above the "
                        "object: nothing is predicted",
                        face.id, found.lowest_light_mm, plane.id));
        continue;
      }
      for (const double h : {options.low_mm, options.high_mm}) {
        if (found.edges.empty() || h > options.low_mm) {
          found.edges.push_back(predict_edge(frame, face, found.light_height_mm, h, options));
        }
      }
      prediction.planes.push_back(std::move(found));
    }
    for (const CameraSpec& camera : rig.cameras) {
      PixelPrediction pixel = predict_pixel(camera, as_written);
      pixel.plane = plane.id;
      if (pixel.seen_fraction == 0.0) {
        prediction.notes.push_back(
            fmt::format("camera \"{}\" does not see plane \"{}\"", camera.id, plane.id));
      } else {
        prediction.pixels.push_back(std::move(pixel));
      }
    }
  }
  if (prediction.planes.empty()) {
    throw Error(lowest_usable > 0.0
                    ? fmt::format("no face is above an object of {:g} mm: the lowest lights "
                                  "are {:g} mm over the plane",
                                  options.high_mm, lowest_usable)
                    : "no face of the rig lights its shadow plane from above",
                where, "check --object-height, and [[face]] and [[plane]] in the rig file");
  }
  for (const double at : options.receivers) {
    for (const PlanePrediction& plane : prediction.planes) {
      if (at >= plane.lowest_light_mm) {
        throw Error(fmt::format("a surface at {:g} mm is not below the lights", at),
                    "--receiver", "give heights in mm over the plane, negative below it",
                    ExitCode::usage);
      }
    }
  }
  return prediction;
}

}  // namespace haarlight::relight
