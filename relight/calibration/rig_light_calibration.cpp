// SPDX-License-Identifier: Apache-2.0
#include "relight/calibration/rig_light_calibration.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <type_traits>

#include <Eigen/Cholesky>
#include <fmt/format.h>

#include "core/order_statistics.h"
#include "core/rig/measured_rig.h"
#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

constexpr const char* kWhere = "calibration of the lights";

Eigen::Isometry3d frame_of(const ShadowPlane& plane, double height_mm) {
  Eigen::Isometry3d frame = Eigen::Isometry3d::Identity();
  frame.linear() << plane.u, plane.v, plane.u.cross(plane.v);
  if (frame.linear().col(2).dot(plane.n) < 0.0) {
    throw Error("plane " + plane.id + ": n is not u x v", kWhere,
                "turn n, or exchange u and v, in the rig file");
  }
  frame.translation() = plane.origin + height_mm * plane.n;
  return frame;
}

Eigen::Isometry3d frame_of(const Face& face) {
  Eigen::Isometry3d frame = Eigen::Isometry3d::Identity();
  const double hand = face.u.cross(face.v).dot(face.emits);
  // Right-handed in either case: the third axis is u x v.
  frame.linear() << face.u, face.v, (hand > 0.0 ? 1.0 : -1.0) * face.emits;
  frame.translation() = face.centre;
  return frame;
}

/// Differences of neighbouring pixels within blocks, robustly: relative noise of one pixel.
double neighbour_noise(const LightStack& stack, const std::vector<std::uint8_t>& is_sheet) {
  const StackDims shape = stack.dims();
  const StackBands& bands = stack.bands();
  std::vector<double> squares;
  for (int b = 0; b < bands.n(); ++b) {
    const std::span<const float> values = stack.band(b);
    const int y0 = bands.first_row(b);
    const int rows = bands.n_rows(b);
    for (int y = 0; y < rows; y += 3) {
      for (int x = 0; x + 2 < shape.width; x += 5) {
        const auto pixel =
            static_cast<std::size_t>(y0 + y) * static_cast<std::size_t>(shape.width) +
            static_cast<std::size_t>(x);
        if (is_sheet[pixel] == 0 || is_sheet[pixel + 2] == 0) {
          continue;
        }
        const auto at = (static_cast<std::size_t>(y) * static_cast<std::size_t>(shape.width) +
                         static_cast<std::size_t>(x)) *
                        static_cast<std::size_t>(shape.n_lights);
        const auto step = static_cast<std::size_t>(shape.n_lights);
        const std::size_t k = (pixel * 2654435761U) % step;
        const auto a = static_cast<double>(values[at + k]);
        const auto m = static_cast<double>(values[at + step + k]);
        const auto c = static_cast<double>(values[at + 2 * step + k]);
        if (m > 0.0) {
          squares.push_back(std::pow((a - 2.0 * m + c) / m, 2) / 6.0);
        }
      }
    }
  }
  if (squares.empty()) {
    return 0.01;
  }
  return std::sqrt(upper_median(squares) /
                   0.4549);  // median of chi^2 with one degree of freedom
}

/// floor^2 + shot v fitted to the pixels' variances, each weighted by the fitted line; for a
/// block's mean.
SampleNoise noise_of(const std::vector<Eigen::Vector2d>& pairs, double per_block) {
  Eigen::Matrix2d m = Eigen::Matrix2d::Zero();
  Eigen::Vector2d rhs = Eigen::Vector2d::Zero();
  for (const Eigen::Vector2d& pair : pairs) {
    const double variance = std::max(pair[1], 1e-300);
    const Eigen::Vector2d row(1.0 / variance, pair[0] / variance);
    m += row * row.transpose();
    rhs += row;
  }
  Eigen::Vector2d line = m.ldlt().solve(rhs);
  if (!(line[0] >= 0.0)) {
    line = {0.0, rhs[1] / m(1, 1)};
  } else if (!(line[1] >= 0.0)) {
    line = {rhs[0] / m(0, 0), 0.0};
  }
  return {
      .relative = 1e-5, .shot = per_block * line[1], .floor = std::sqrt(per_block * line[0])};
}

}  // namespace

SheetSamples sample_sheet(const Rig& rig, const LightStack& stack, const LightStack* error,
                          const SheetOptions& options) {
  if (rig.planes.empty() || rig.cameras.empty()) {
    throw Error("the rig has no camera or no plane", kWhere,
                "add [[camera]] and [[plane]] to the rig file");
  }
  const ShadowPlane& plane = rig.planes.front();
  const StackDims shape = stack.dims();
  const CameraModel& camera = rig.cameras.front().model;
  if (shape.width != camera.width || shape.height != camera.height ||
      shape.n_lights != rig.n_lights()) {
    throw Error(
        fmt::format("{} x {} pixels under {} lights; the rig has {} x {} and {}", shape.width,
                    shape.height, shape.n_lights, camera.width, camera.height, rig.n_lights()),
        kWhere, "develop the capture of this rig");
  }
  SheetSamples out;
  out.world_from_sheet = frame_of(plane, options.height_mm);
  const SheetRegion region =
      options.region.value_or(SheetRegion{-0.4 * plane.extent_u_mm, 0.4 * plane.extent_u_mm,
                                          -0.4 * plane.extent_v_mm, 0.4 * plane.extent_v_mm});
  const PixelPoints points =
      PixelPoints::on_plane(camera, plane.n, plane.d - options.height_mm);
  const Eigen::Isometry3d sheet_from_world = out.world_from_sheet.inverse();
  const SheetLayout layout = lay_out_sheet(points, shape.width, shape.height, sheet_from_world,
                                           region, options.samples);
  out.block = layout.block;
  out.samples = samples_without_light(layout, points, camera, sheet_from_world, shape.n_lights,
                                      shape.channels);
  TargetSamples& s = out.samples;
  const std::size_t n = layout.n_blocks();
  const auto width = static_cast<std::size_t>(shape.width);
  const auto n_lights = static_cast<std::size_t>(s.n_lights);
  const auto n_channels = static_cast<std::size_t>(s.n_channels);
  std::vector<double> sum(n_lights * n_channels * n, 0.0);
  const double per_block = 1.0 / (out.block * out.block);
  std::vector<double> relative;
  std::vector<Eigen::Vector2d> pairs;  // value, variance
  for (int y = layout.y0; y < layout.y0 + s.rows * out.block; ++y) {
    const int b = y / stack.bands().rows;
    const int rows = stack.bands().n_rows(b);
    const std::span<const float> values = stack.band(b);
    const std::span<const float> errors =
        error != nullptr ? error->band(b) : std::span<const float>{};
    for (int x = layout.x0; x < layout.x0 + s.cols * out.block; ++x) {
      const std::size_t pixel =
          static_cast<std::size_t>(y) * width + static_cast<std::size_t>(x);
      const std::size_t block = static_cast<std::size_t>((y - layout.y0) / out.block) *
                                    static_cast<std::size_t>(s.cols) +
                                static_cast<std::size_t>((x - layout.x0) / out.block);
      for (std::size_t c = 0; c < n_channels; ++c) {
        const std::size_t at = ((c * static_cast<std::size_t>(rows) +
                                 static_cast<std::size_t>(y - b * stack.bands().rows)) *
                                    width +
                                static_cast<std::size_t>(x)) *
                               n_lights;
        for (std::size_t k = 0; k < n_lights; ++k) {
          const auto value = static_cast<double>(values[at + k]);
          sum[(k * n_channels + c) * n + block] += per_block * value;
          if (errors.empty()) {
            continue;
          }
          const auto e = static_cast<double>(errors[at + k]);
          if (e < 0.0) {
            s.is_used[k * n + block] = 0;
          } else if (value > 0.0 && (pixel * 31 + k) % 97 == 0) {
            relative.push_back(e / value);
            pairs.emplace_back(value, e * e);
          }
        }
      }
    }
  }
  s.intensity.assign(sum.begin(), sum.end());
  double noise = 0.0;
  if (relative.empty()) {
    noise = neighbour_noise(stack, layout.is_sheet);
  } else {
    noise = upper_median(relative);
  }
  out.relative_noise = std::max(noise / out.block, 1e-5);
  s.noise = pairs.size() < 100 ? SampleNoise{.relative = out.relative_noise}
                               : noise_of(pairs, per_block);
  return out;
}

TargetSamples samples_of(const TargetSamples& all, int first, int n_lights) {
  HAARLIGHT_EXPECTS(first >= 0 && n_lights > 0 && first + n_lights <= all.n_lights, "lights");
  TargetSamples out = all;
  out.n_lights = n_lights;
  const std::size_t n = all.n_points();
  const auto cut = [&](auto& values, std::size_t per_light) {
    using Values = std::remove_reference_t<decltype(values)>;
    const auto begin = values.begin() +
                       static_cast<std::ptrdiff_t>(static_cast<std::size_t>(first) * per_light);
    values = Values(begin, begin + static_cast<std::ptrdiff_t>(
                                       static_cast<std::size_t>(n_lights) * per_light));
  };
  cut(out.intensity, n * static_cast<std::size_t>(all.n_channels));
  cut(out.is_used, n);
  return out;
}

SheetPriors sheet_priors(const Rig& rig, const SheetSamples& sheet) {
  SheetPriors priors = matte_paper(!sheet.samples.to_camera.empty());
  if (rig.measured == nullptr || rig.planes.empty()) {
    return priors;
  }
  const double half = 0.5 * target_extent(sheet.samples).size_mm;
  for (const MeasuredPlane& plane : rig.measured->planes) {
    if (plane.id == rig.planes.front().id) {
      const double tilt = half * std::tan(plane.tilt_sigma_deg * std::numbers::pi / 180.0);
      priors.sigma[SheetTerm::height] = plane.distance_sigma;
      priors.sigma[SheetTerm::tilt_x] = tilt;
      priors.sigma[SheetTerm::tilt_y] = tilt;
    }
  }
  return priors;
}

std::vector<FaceCalibration> calibrate_faces(const Rig& rig, const SheetSamples& sheet,
                                             const CalibrationOptions& options) {
  std::vector<FaceCalibration> out;
  const std::vector<LightElement> elements = light_elements(rig);
  const Eigen::Isometry3d sheet_from_world = sheet.world_from_sheet.inverse();
  int first = 0;
  for (std::size_t f = 0; f < rig.faces.size(); ++f) {
    const Face& face = rig.faces[f];
    const Eigen::Isometry3d as_written = frame_of(face);
    RigidArray array;
    for (int k = first; k < first + face.n_lights(); ++k) {
      const LightElement& element = elements[static_cast<std::size_t>(k)];
      array.positions_mm.push_back(as_written.inverse() * element.centre);
      array.axes.emplace_back(as_written.linear().transpose() * element.emits);
      Eigen::Matrix<double, 3, 2> edges;
      edges << element.width_mm * element.u, element.height_mm * element.v;
      array.emitters_mm.emplace_back(as_written.linear().transpose() * edges);
    }
    FaceCalibration result;
    result.face = static_cast<int>(f);
    CalibrationOptions each = options;
    each.mu_start = face.lobe_mu > 0.0 ? face.lobe_mu : 1.0;
    try {
      result.lights = calibrate_rigid_array(samples_of(sheet.samples, first, face.n_lights()),
                                            array, sheet_from_world * as_written, each);
    } catch (const Error& error) {
      throw Error("face " + face.id + ": " + error.problem(), error.where(), error.hint());
    }
    first += face.n_lights();
    result.world_from_face = sheet.world_from_sheet * *result.lights.world_from_array;
    Eigen::Matrix<double, 6, 6> turn6 = Eigen::Matrix<double, 6, 6>::Zero();
    turn6.topLeftCorner<3, 3>() = sheet.world_from_sheet.linear();
    turn6.bottomRightCorner<3, 3>() = sheet.world_from_sheet.linear();
    result.pose_world = turn6 * result.lights.pose_sigma->covariance * turn6.transpose();
    result.moved_mm = (result.world_from_face.translation() - face.centre).norm();
    const Eigen::AngleAxisd turn(result.world_from_face.linear() *
                                 as_written.linear().transpose());
    result.turned_deg = std::abs(turn.angle()) * 180.0 / std::numbers::pi;
    out.push_back(std::move(result));
  }
  // One sheet: its albedo is the same under every face, which fixes each face's scale.
  std::vector<double> scale(out.size(), 0.0);
  double mean = 0.0;
  for (std::size_t f = 0; f < out.size(); ++f) {
    double count = 0.0;
    for (const double a : out[f].lights.albedo) {
      scale[f] += a;
      count += a > 0.0 ? 1.0 : 0.0;
    }
    scale[f] /= std::max(count, 1.0);
    mean += scale[f] * rig.faces[f].n_lights() / rig.n_lights();
  }
  for (std::size_t f = 0; f < out.size(); ++f) {
    for (CalibratedLight& light : out[f].lights.lights) {
      light.light.power *= scale[f] / mean;
    }
  }
  return out;
}

}  // namespace haarlight::relight
