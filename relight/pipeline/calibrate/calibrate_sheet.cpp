// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/calibrate/calibrate_sheet.h"

#include <cmath>
#include <functional>
#include <numbers>
#include <utility>

#include <Eigen/Geometry>
#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "relight/pipeline/calibrate/calibrate_bent_sheet.h"
#include "relight/pipeline/calibrate/sheet_parts.h"

namespace haarlight::relight {

namespace {

using Eigen::Vector3d;

constexpr double kRegionFraction = 0.9;  // of the picture, where no region is given

CameraModel camera_of(const CalibratePipelineOptions& options, const LightPictures& pictures,
                      const Eigen::Vector2d& tilt = Eigen::Vector2d::Zero()) {
  double width_mm = options.width_mm;
  double camera_mm = options.camera_mm;
  if (!(width_mm > 0.0) && options.focal_px > 0.0) {
    width_mm = pictures.width() * camera_mm / options.focal_px;
  }
  if (!(camera_mm > 0.0) && options.focal_px > 0.0) {
    camera_mm = width_mm * options.focal_px / pictures.width();
  }
  if (!(width_mm > 0.0) || !(camera_mm > 0.0)) {
    throw Error("how large the sheet is, and from where the camera sees it, is not known",
                options.input.string(),
                "measure two of the three: --width-mm (what the picture shows across, on the "
                "sheet), --camera-mm (from the lens to the sheet), --focal-px",
                ExitCode::usage);
  }
  return camera_over_sheet(pictures.width(), pictures.height(), width_mm, camera_mm, tilt);
}

ReadSheet read_sheet(const CalibratePipelineOptions& options, const LightPictures& pictures) {
  const CameraModel camera = camera_of(options, pictures);
  const PixelPoints points = PixelPoints::on_plane(camera, Vector3d::UnitZ(), 0.0);
  const double mm_per_pixel = camera.centre_world().z() / camera.fx;
  const double half_u = 0.5 * kRegionFraction * mm_per_pixel * camera.width;
  const double half_v = 0.5 * kRegionFraction * mm_per_pixel * camera.height;
  const SheetRegion region =
      options.sheet.region.value_or(SheetRegion{-half_u, half_u, -half_v, half_v});
  const Eigen::Isometry3d here = Eigen::Isometry3d::Identity();
  const SheetLayout layout =
      lay_out_sheet(points, camera.width, camera.height, here, region, options.sheet.samples);
  std::optional<SheetSampler> sampler;
  pictures.for_each([&](int k, const Image<float>& picture, float clip) {
    if (!sampler) {
      sampler.emplace(layout, samples_without_light(layout, points, camera, here,
                                                    pictures.size(), picture.channels()));
    }
    sampler->add(k, picture.view(), clip);
  });
  return {sampler->finish(), layout};
}

RigidArray array_of(const CalibratePipelineOptions& options, int n_pictures) {
  const LightGrid& grid = *options.sheet.grid;
  const int rows = grid.rows;
  const int cols = grid.cols;
  if (rows * cols != n_pictures || rows < 1 || cols < 1) {
    throw Error(fmt::format("{} x {} lights for {} pictures", rows, cols, n_pictures), "--grid",
                "one picture for each light, row by row", ExitCode::usage);
  }
  if (!(grid.pitch_mm > 0.0)) {
    throw Error("how far apart the lights of the grid are is not known", "--grid",
                "give --pitch-mm", ExitCode::usage);
  }
  RigidArray array;
  for (int k = 0; k < n_pictures; ++k) {
    const int row = k / cols;
    const int col = k % cols;
    array.positions_mm.emplace_back(grid.pitch_mm * (col - 0.5 * (cols - 1)),
                                    grid.pitch_mm * (0.5 * (rows - 1) - row), 0.0);
    array.axes.emplace_back(0.0, 0.0, -1.0);
    if (options.sheet.led_mm > 0.0) {
      Eigen::Matrix<double, 3, 2> edges;
      edges << options.sheet.led_mm, 0.0, 0.0, options.sheet.led_mm, 0.0, 0.0;
      array.emitters_mm.push_back(edges);
    }
  }
  return array;
}

/// The array's pose from free lights, the better of both handednesses: a grid may be numbered
/// as seen from its back. @return  the pose, and the rms residual, mm
std::pair<Eigen::Isometry3d, double> fit_array_pose(const RigidArray& array,
                                                    const LightCalibration& free) {
  const auto n = static_cast<Eigen::Index>(array.positions_mm.size());
  Eigen::Matrix3Xd from(3, n);
  Eigen::Matrix3Xd to(3, n);
  Eigen::Index used = 0;
  for (Eigen::Index k = 0; k < n; ++k) {
    const CalibratedLight& light = free.lights[static_cast<std::size_t>(k)];
    if (light.finding != LightFinding::unseen) {
      from.col(used) = array.positions_mm[static_cast<std::size_t>(k)];
      to.col(used++) = light.light.position_mm;
    }
  }
  from.conservativeResize(3, used);
  to.conservativeResize(3, used);
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.matrix() = Eigen::umeyama(from, to, false);
  const double rms = std::sqrt((pose * from - to).squaredNorm() / static_cast<double>(used));
  return {pose, rms};
}

/// The array's start from free lights.
Eigen::Isometry3d array_start(const CalibratePipelineOptions& options, const RigidArray& array,
                              const TargetSamples& samples, SheetFindings& findings) {
  FreeLightOptions first = free_light_options(options);
  first.aim = Aim::down;
  first.lights.sheet = {};
  const auto [pose, rms] = fit_array_pose(array, find_free_lights(samples, first));
  if (pose.linear()(2, 2) <= 0.0) {
    throw Error("the pictures show the grid from its back", "--grid",
                "count row by row as the camera would see the lights from above: x to the "
                "right, the first row at the top; or turn the order round");
  }
  findings.array_start_rms_mm = rms;
  return pose;
}

std::string array_text(const LightCalibration& found) {
  const Vector3d middle = found.world_from_array->translation();
  const Eigen::AngleAxisd turn(found.world_from_array->linear());
  return fmt::format("array: middle {:.3f} {:.3f} {:.3f} mm, turned {:.3f} degrees", middle.x(),
                     middle.y(), middle.z(), turn.angle() * 180.0 / std::numbers::pi);
}

using FitSamples = std::function<LightCalibration(const TargetSamples& samples)>;

/// The pictures do not determine the camera's tilt: two more fits yield its effect.
void add_tilt(const CalibratePipelineOptions& options, const LightPictures& pictures,
              const ReadSheet& sheet, const FitSamples& fit, LightCalibration& found) {
  const double tilt = options.sheet.tilt_deg * std::numbers::pi / 180.0;
  for (int i = 0; tilt > 0.0 && i < 2; ++i) {
    const CameraModel aslant = camera_of(options, pictures, tilt * Eigen::Vector2d::Unit(i));
    add_deviation(found, fit(seen_from(sheet.samples, sheet.layout, aslant)));
  }
}

LightCalibration fit_flat_sheet(const CalibratePipelineOptions& options,
                                const LightPictures& pictures, const ReadSheet& sheet,
                                SheetFindings& findings, PipelineNotes& notes) {
  FitSamples fit = [&](const TargetSamples& samples) {
    return find_free_lights(samples, free_light_options(options));
  };
  if (options.sheet.grid) {
    const RigidArray array = array_of(options, sheet.samples.n_lights);
    const Eigen::Isometry3d start = array_start(options, array, sheet.samples, findings);
    fit = [array, start, &options](const TargetSamples& samples) {
      return calibrate_rigid_array(samples, array, start, sheet_calibration_options(options));
    };
  }
  LightCalibration found = fit(sheet.samples);
  if (found.test.is_passed()) {
    add_tilt(options, pictures, sheet, fit, found);
  }
  if (options.sheet.grid) {
    notes.add(NoteKind::result, array_text(found));
  }
  return found;
}

FoundLights find_by_flat_sheet(const CalibratePipelineOptions& options, const ReadSheet& sheet,
                               const LightPictures& pictures, SheetFindings& findings,
                               PipelineNotes& notes) {
  LightCalibration fit = fit_flat_sheet(options, pictures, sheet, findings, notes);
  notes.add(NoteKind::result,
            fmt::format("{}\nmodel: test {}", fit.brief_report(), test_text(fit.test)));
  // A test that was not done proves nothing.
  const bool is_known = fit.test.is_passed();
  if (fit.is_model_wrong()) {
    notes.add(
        NoteKind::caution,
        fmt::format(
            "the pictures hold something that no unknown of the model can follow (test {}): "
            "how "
            "wrong the positions are is not known, no +- is given\n  hint: a flatter and more "
            "matte sheet without dirt, no stray light, the camera straight above, the right "
            "--aim; docs/reference/calibration.md",
            test_text(fit.test)));
  } else if (!is_known) {
    notes.add(NoteKind::note, "too few samples to test the model: no +- is given");
  }
  FoundLights found;
  found.has_powers = true;
  found.is_good = fit.is_usable() && is_known;
  add_lights(fit, pictures, is_known, found);
  add_sheet_picture(sheet.samples, fit.albedo, found);
  findings.flat = std::move(fit);
  return found;
}

}  // namespace

FoundLights find_by_sheet(const CalibratePipelineOptions& options,
                          const LightPictures& pictures, SheetFindings& findings,
                          PipelineNotes& notes) {
  if (pictures.size() < 2) {
    throw Error("one picture tells no light from the sheet's own pattern",
                options.input.string(), "two lights at least; eight or more are better",
                ExitCode::bad_input);
  }
  const ReadSheet sheet = read_sheet(options, pictures);
  findings.block_noise = sheet.samples.noise.relative;
  findings.block_rows = sheet.samples.rows;
  findings.block_cols = sheet.samples.cols;
  FoundLights found = options.sheet.is_bent
                          ? find_by_bent_sheet(options, sheet, pictures, findings, notes)
                          : find_by_flat_sheet(options, sheet, pictures, findings, notes);
  found.frame =
      "mm; x right, y up, z to the camera; origin in the picture's middle on the sheet";
  return found;
}

}  // namespace haarlight::relight
