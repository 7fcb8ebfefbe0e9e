// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight calibrate` from a sheet: free lights, an array whose layout is known, a sheet
/// that is not flat, a rig's faces.

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>

#include <Eigen/Geometry>
#include <fmt/format.h>

#include "apps/haarlight/calibrate.h"
#include "apps/haarlight/rig_calibrate.h"
#include "relight/calibration/calibrate_with_shape.h"
#include "relight/calibration/free_lights.h"
#include "relight/calibration/rig_light_calibration.h"
#include "relight/calibration/sheet_layout.h"
#include "relight/shape/integrate_normals.h"

namespace haarlight {

namespace {

using Eigen::Vector3d;

constexpr double kMostChi2 = 2.0;     // of a bent sheet: beyond, more than noise is left
constexpr double kRegionShare = 0.9;  // of the picture, where no region is given

struct Sheet {
  TargetSamples samples;
  SheetLayout layout;
};

CameraModel camera_of(const FindLightsArguments& arguments, const LightPictures& pictures,
                      const Eigen::Vector2d& tilt = Eigen::Vector2d::Zero()) {
  double width_mm = arguments.width_mm;
  double camera_mm = arguments.camera_mm;
  if (!(width_mm > 0.0) && arguments.focal_px > 0.0) {
    width_mm = pictures.width() * camera_mm / arguments.focal_px;
  }
  if (!(camera_mm > 0.0) && arguments.focal_px > 0.0) {
    camera_mm = width_mm * arguments.focal_px / pictures.width();
  }
  if (!(width_mm > 0.0) || !(camera_mm > 0.0)) {
    throw Error("how large the sheet is, and from where the camera sees it, is not known",
                arguments.input,
                "measure two of the three: --width-mm (what the picture shows across, on the "
                "sheet), --camera-mm (from the lens to the sheet), --focal-px",
                ExitCode::usage);
  }
  return camera_over_sheet(pictures.width(), pictures.height(), width_mm, camera_mm, tilt);
}

Sheet read_sheet(const FindLightsArguments& arguments, const LightPictures& pictures) {
  const CameraModel camera = camera_of(arguments, pictures);
  const PixelPoints points = PixelPoints::on_plane(camera, Vector3d::UnitZ(), 0.0);
  const double mm_per_pixel = camera.centre_world().z() / camera.fx;
  const double half_u = 0.5 * kRegionShare * mm_per_pixel * camera.width;
  const double half_v = 0.5 * kRegionShare * mm_per_pixel * camera.height;
  SheetRegion region{-half_u, half_u, -half_v, half_v};
  if (!arguments.region.empty()) {
    region = {arguments.region[0], arguments.region[1], arguments.region[2],
              arguments.region[3]};
  }
  const Eigen::Isometry3d here = Eigen::Isometry3d::Identity();
  const SheetLayout layout =
      lay_out_sheet(points, camera.width, camera.height, here, region, arguments.samples);
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

SheetPriors priors_of(const FindLightsArguments& arguments) {
  SheetPriors priors = matte_paper(true);
  for (const SheetTerm term : {SheetTerm::bow_xx, SheetTerm::bow_xy, SheetTerm::bow_yy}) {
    priors.sigma[term] = arguments.bow_mm;
  }
  return priors;
}

CalibrationOptions options_of(const FindLightsArguments& arguments) {
  CalibrationOptions options;
  options.mask.saturation = std::numeric_limits<double>::max();  // the sampler has masked them
  options.lobe = arguments.lobe == "given" ? Lobe::given : Lobe::free;
  options.mu_start = arguments.mu;
  options.sheet = priors_of(arguments);
  return options;
}

FreeLightOptions free_options(const FindLightsArguments& arguments) {
  FreeLightOptions options;
  options.aim = arguments.aim == "down"         ? Aim::down
                : arguments.aim == "everywhere" ? Aim::everywhere
                                                : Aim::centre;
  options.aim_sigma_deg = arguments.aim_deg;
  options.led_mm = arguments.led_mm;
  options.lights = options_of(arguments);
  return options;
}

double share_used(const SampleCounts& c) {
  const auto all = static_cast<double>(c.used + c.saturated + c.dark + c.shadowed + c.outlying +
                                       c.by_caller);
  return all > 0.0 ? static_cast<double>(c.used) / all : 0.0;
}

/// What cannot be known is not said: no sigma without a test that passed.
FoundLight found_light(const CalibratedLight& light, const std::string& name, bool is_known) {
  FoundLight out;
  out.name = name;
  out.used = share_used(light.counts);
  if (light.finding == LightFinding::unseen) {
    const SampleCounts& c = light.counts;
    out.finding = fmt::format("unseen: {} dark, {} saturated, {} shadowed, {} outlying blocks",
                              c.dark, c.saturated, c.shadowed, c.outlying + c.by_caller);
    return out;
  }
  if (light.finding == LightFinding::weak) {
    const Vector3d& d = light.weak_direction;
    out.finding = is_known ? fmt::format("weak: +- {:.3g} mm along ({:.2f}, {:.2f}, {:.2f})",
                                         light.weak_mm, d.x(), d.y(), d.z())
                           : "weak";
  }
  out.position_mm = light.light.position_mm;
  out.direction = light.light.position_mm.normalized();
  out.power = light.light.power;
  out.lobe = LightLobe{light.light.axis, light.light.mu};
  if (is_known) {
    out.sigma_mm = light.sigma.position_mm2.diagonal().cwiseSqrt();
    out.sigma_deg = direction_sigma_deg(light.light.position_mm, light.sigma.position_mm2);
    out.power_sigma = light.sigma.power;
  }
  return out;
}

void report_fit(const LightCalibration& fit, Report& report) {
  report.add_reached("reduced_chi2", fit.reduced_chi2);
  report.add_reached("lobe_mu", fit.mu);
  report.add_reached("model_test_sigma", fit.test.z);
  report.add_reached("model_test_lobe_sigma", fit.test.lobe_z);
  report.add_reached("is_model_right", fit.test.is_passed());
  fmt::print("{}\nmodel: test {}\n", fit.brief_report(), test_text(fit.test));
}

/// Names are the pictures'; powers of an import's lights multiply what its session had.
void add_lights(const LightCalibration& fit, const LightPictures& pictures, bool is_known,
                FoundLights& found) {
  for (std::size_t k = 0; k < fit.lights.size(); ++k) {
    found.lights.push_back(found_light(fit.lights[k], pictures.names()[k], is_known));
    if (pictures.session() != nullptr && !pictures.session()->rig()) {
      found.lights.back().power *= pictures.session()->info().lights[k].relative_power;
    }
  }
}

Image<float> albedo_picture(const TargetSamples& samples, const std::vector<double>& albedo) {
  Image<float> out(samples.rows, samples.cols, samples.n_channels == 3 ? 3 : 1);
  const std::size_t n = samples.n_points();
  for (int y = 0; y < out.height(); ++y) {
    for (int x = 0; x < out.width(); ++x) {
      for (int c = 0; c < out.channels(); ++c) {
        out(y, x, c) = static_cast<float>(
            albedo[static_cast<std::size_t>(c) * n +
                   static_cast<std::size_t>(y) * static_cast<std::size_t>(out.width()) +
                   static_cast<std::size_t>(x)]);
      }
    }
  }
  return out;
}

void add_picture(const TargetSamples& samples, const std::vector<double>& albedo,
                 FoundLights& found) {
  found.picture = albedo_picture(samples, albedo);
  found.picture_name = "sheet.png";
  const std::span<const float> pixels = found.picture.pixels();
  const float most = *std::max_element(pixels.begin(), pixels.end());
  found.picture_exposure = most > 0.0F ? 0.95 / static_cast<double>(most) : 1.0;
}

void tell_wrong_model(const ModelTest& test) {
  fmt::print(
      stderr,
      "the pictures hold something that no unknown of the model can follow (test {}): how "
      "wrong the places are is not known, no +- is given\n  cure: a flatter and more "
      "matte sheet without dirt, no stray light, the camera straight above, the right "
      "--aim; docs/reference/calibration.md\n",
      test_text(test));
}

// ---- a sheet that is not flat ----

/// Heights of the blocks from their normals, mean 0; parallel projection.
std::vector<Vector3d> blocks_of_normals(const TargetSamples& samples,
                                        std::span<const Vector3d> normals, double block_mm) {
  Image<float> picture(samples.rows, samples.cols, 3);
  Image<std::uint8_t> is_known(samples.rows, samples.cols, 1);
  const auto index = [&](int y, int x) {
    return static_cast<std::size_t>(y) * static_cast<std::size_t>(samples.cols) +
           static_cast<std::size_t>(x);
  };
  for (int y = 0; y < samples.rows; ++y) {
    for (int x = 0; x < samples.cols; ++x) {
      for (int c = 0; c < 3; ++c) {
        picture(y, x, c) = static_cast<float>(normals[index(y, x)][c]);
      }
      is_known(y, x) = 1;
    }
  }
  const HeightMap map = integrate_slopes(
      orthographic_slopes(picture.view(), is_known.view(), block_mm), IntegrateOptions{});
  std::vector<Vector3d> points = samples.points_mm;
  for (int y = 0; y < samples.rows; ++y) {
    for (int x = 0; x < samples.cols; ++x) {
      points[index(y, x)].z() = static_cast<double>(map.height(y, x));
    }
  }
  return points;
}

FoundLights find_with_shape(const FindLightsArguments& arguments, const Sheet& sheet,
                            const LightPictures& pictures, Report& report) {
  // From where a flat sheet would have the lights.
  FreeLightOptions first = free_options(arguments);
  // A free exponent and free axes bend with the sheet: both stay as given.
  first.aim_sigma_deg = 0.0;
  first.lights.lobe = Lobe::given;
  first.lights.sheet = {};
  first.lights.outlier_share = 0.0;
  const LightCalibration flat = find_free_lights(sheet.samples, first);
  std::vector<NearLight> start;
  for (const CalibratedLight& light : flat.lights) {
    start.push_back(light.light);
  }
  AlternationOptions options;
  options.lights = first.lights;
  const double block_mm = (sheet.samples.points_mm[1] - sheet.samples.points_mm[0]).norm();
  const Alternation found_shape = calibrate_with_shape(
      sheet.samples, std::move(start),
      [&](const TargetSamples& samples, std::span<const Vector3d> normals) {
        return blocks_of_normals(samples, normals, block_mm);
      },
      options);
  double low = std::numeric_limits<double>::max();
  double high = std::numeric_limits<double>::lowest();
  for (const Vector3d& p : found_shape.points_mm) {
    low = std::min(low, p.z());
    high = std::max(high, p.z());
  }
  report.add_reached("sheet_range_mm", high - low);
  report.add_reached("rounds", static_cast<std::int64_t>(found_shape.moves_mm.size()));
  report.add_reached("chi2_flat", found_shape.chi2.front());
  report.add_reached("is_settled", found_shape.has_converged);
  report.add_reached("reduced_chi2", found_shape.lights.reduced_chi2);
  report.add_reached("lobe_mu", found_shape.lights.mu);
  fmt::print(
      "the sheet's heights span {:.2f} mm; chi^2 {:.2f} of a flat one, {:.2f} so; {} "
      "rounds{}\n",
      high - low, found_shape.chi2.front(), found_shape.lights.reduced_chi2,
      found_shape.moves_mm.size(), found_shape.has_converged ? "" : ", not settled");
  fmt::print(stderr,
             "note: lights can hide a bend of the sheet in the noise: no +- is given\n");
  FoundLights found;
  found.has_powers = true;
  const double chi2 = found_shape.lights.reduced_chi2;
  found.is_good = found_shape.has_converged && chi2 < kMostChi2;
  if (!(chi2 < kMostChi2)) {
    fmt::print(stderr,
               "lights and a bent sheet do not explain the pictures: chi^2 {:.1f} where 1 is "
               "noise\n  cure: --mu, --aim; a more matte sheet, no stray light\n",
               chi2);
  }
  add_lights(found_shape.lights, pictures, false, found);
  add_picture(sheet.samples, found_shape.lights.albedo, found);
  return found;
}

// ---- an array whose layout is known ----

RigidArray array_of(const FindLightsArguments& arguments, int n_pictures) {
  const int rows = arguments.grid[0];
  const int cols = arguments.grid[1];
  if (rows * cols != n_pictures || rows < 1 || cols < 1) {
    throw Error(fmt::format("{} x {} lights for {} pictures", rows, cols, n_pictures), "--grid",
                "one picture for each light, row by row", ExitCode::usage);
  }
  if (!(arguments.pitch_mm > 0.0)) {
    throw Error("how far apart the lights of the grid are is not known", "--grid",
                "give --pitch-mm", ExitCode::usage);
  }
  RigidArray array;
  for (int k = 0; k < n_pictures; ++k) {
    const int row = k / cols;
    const int col = k % cols;
    array.places_mm.emplace_back(arguments.pitch_mm * (col - 0.5 * (cols - 1)),
                                 arguments.pitch_mm * (0.5 * (rows - 1) - row), 0.0);
    array.axes.emplace_back(0.0, 0.0, -1.0);
    if (arguments.led_mm > 0.0) {
      Eigen::Matrix<double, 3, 2> edges;
      edges << arguments.led_mm, 0.0, 0.0, arguments.led_mm, 0.0, 0.0;
      array.emitters_mm.push_back(edges);
    }
  }
  return array;
}

/// Where free lights have the array, the better of both hands' poses: a grid may be counted as
/// seen from its back. @return  the pose, and the rms of what is left, mm
std::pair<Eigen::Isometry3d, double> place_array(const RigidArray& array,
                                                 const LightCalibration& free) {
  const auto n = static_cast<Eigen::Index>(array.places_mm.size());
  Eigen::Matrix3Xd from(3, n);
  Eigen::Matrix3Xd to(3, n);
  Eigen::Index used = 0;
  for (Eigen::Index k = 0; k < n; ++k) {
    const CalibratedLight& light = free.lights[static_cast<std::size_t>(k)];
    if (light.finding != LightFinding::unseen) {
      from.col(used) = array.places_mm[static_cast<std::size_t>(k)];
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

/// From where free lights have the array.
Eigen::Isometry3d array_start(const FindLightsArguments& arguments, const RigidArray& array,
                              const TargetSamples& samples, Report& report) {
  FreeLightOptions first = free_options(arguments);
  first.aim = Aim::down;
  first.lights.sheet = {};
  const auto [pose, rms] = place_array(array, find_free_lights(samples, first));
  if (pose.linear()(2, 2) <= 0.0) {
    throw Error("the pictures show the grid from its back", "--grid",
                "count row by row as the camera would see the lights from above: x to the "
                "right, the first row at the top; or turn the order round");
  }
  report.add_detail("array_start_rms_mm", rms);
  return pose;
}

void tell_array(const LightCalibration& found) {
  const Vector3d middle = found.world_from_array->translation();
  const Eigen::AngleAxisd turn(found.world_from_array->linear());
  fmt::print("array: middle {:.3f} {:.3f} {:.3f} mm, turned {:.3f} degrees\n", middle.x(),
             middle.y(), middle.z(), turn.angle() * 180.0 / std::numbers::pi);
}

using FitSamples = std::function<LightCalibration(const TargetSamples& samples)>;

/// The camera's tilt is not in the pictures: two fits more tell what it would do.
void add_tilt(const FindLightsArguments& arguments, const LightPictures& pictures,
              const Sheet& sheet, const FitSamples& fit, LightCalibration& found) {
  const double tilt = arguments.tilt_deg * std::numbers::pi / 180.0;
  for (int i = 0; tilt > 0.0 && i < 2; ++i) {
    const CameraModel aslant = camera_of(arguments, pictures, tilt * Eigen::Vector2d::Unit(i));
    add_deviation(found, fit(seen_from(sheet.samples, sheet.layout, aslant)));
  }
}

LightCalibration fit_flat_sheet(const FindLightsArguments& arguments,
                                const LightPictures& pictures, const Sheet& sheet,
                                Report& report) {
  FitSamples fit = [&](const TargetSamples& samples) {
    return find_free_lights(samples, free_options(arguments));
  };
  if (!arguments.grid.empty()) {
    const RigidArray array = array_of(arguments, sheet.samples.n_lights);
    const Eigen::Isometry3d start = array_start(arguments, array, sheet.samples, report);
    fit = [array, start, &arguments](const TargetSamples& samples) {
      return calibrate_rigid_array(samples, array, start, options_of(arguments));
    };
  }
  LightCalibration found = fit(sheet.samples);
  if (found.test.is_passed()) {
    add_tilt(arguments, pictures, sheet, fit, found);
  }
  if (!arguments.grid.empty()) {
    tell_array(found);
  }
  return found;
}

}  // namespace

FoundLights find_by_sheet(const FindLightsArguments& arguments, const LightPictures& pictures,
                          const CommonOptions& common, Report& report) {
  if (pictures.size() < 2) {
    throw Error("one picture tells no light from the sheet's own pattern", arguments.input,
                "two lights at least; eight or more are better", ExitCode::bad_input);
  }
  const Sheet sheet = read_sheet(arguments, pictures);
  report.add_reached("block_noise", sheet.samples.noise.relative);
  report.add_detail("blocks", std::vector<double>{static_cast<double>(sheet.samples.rows),
                                                  static_cast<double>(sheet.samples.cols)});
  FoundLights found;
  if (arguments.is_bent) {
    found = find_with_shape(arguments, sheet, pictures, report);
  } else {
    const LightCalibration fit = fit_flat_sheet(arguments, pictures, sheet, report);
    report_fit(fit, report);
    // A test that was not done proves nothing.
    const bool is_known = fit.test.is_passed();
    if (fit.is_model_wrong()) {
      tell_wrong_model(fit.test);
    } else if (!is_known && !common.quiet) {
      fmt::print(stderr, "note: too few samples to test the model: no +- is given\n");
    }
    found.has_powers = true;
    found.is_good = fit.is_usable() && is_known;
    add_lights(fit, pictures, is_known, found);
    add_picture(sheet.samples, fit.albedo, found);
  }
  found.frame =
      "mm; x right, y up, z to the camera; origin in the picture's middle on the sheet";
  return found;
}

FoundLights find_by_rig(const FindLightsArguments& arguments, const Session& session,
                        const CommonOptions& common, Report& report) {
  CalibrateArguments rig_arguments;
  rig_arguments.rig = arguments.rig;
  rig_arguments.session = arguments.input;
  rig_arguments.region = arguments.region;
  rig_arguments.sheet_mm = arguments.sheet_mm;
  rig_arguments.bow_mm = arguments.bow_mm;
  rig_arguments.lobe = arguments.lobe;
  rig_arguments.page = arguments.page;
  RigFaces fit = arguments.rig.empty()
                     ? fit_rig_faces(session, *session.rig(), rig_arguments, common)
                     : store_rig_faces(rig_arguments, common, report);
  if (arguments.rig.empty()) {
    tell_faces(*session.rig(), fit, common, report);
  }
  FoundLights found;
  found.frame =
      "places: mm, the rig's world; directions: from the object's centre, x right, y up, z to "
      "the camera";
  found.has_powers = true;
  found.is_good = fit.is_good;
  const Eigen::Isometry3d& world_from_sheet = fit.sheet.world_from_sheet;
  const std::vector<LightElement> elements = light_elements(*session.rig());
  const Eigen::Matrix3d turn = pixel_points(session, 0.0).picture_from_world();
  std::size_t k = 0;
  for (const FaceCalibration& face : fit.faces) {
    for (CalibratedLight light : face.lights.lights) {
      light.light.position_mm = world_from_sheet * light.light.position_mm;
      light.light.axis = world_from_sheet.linear() * light.light.axis;
      light.sigma.position_mm2 = world_from_sheet.linear() * light.sigma.position_mm2 *
                                 world_from_sheet.linear().transpose();
      const LightElement& element = elements[k++];
      found.lights.push_back(found_light(
          light,
          fmt::format("{}/{}/{}", session.rig()->faces[static_cast<std::size_t>(face.face)].id,
                      element.row, element.col),
          face.lights.test.is_passed()));
      FoundLight& last = found.lights.back();
      if (last.is_seen()) {
        const Vector3d away = light.light.position_mm - session.rig()->object_centre;
        last.direction = turn * away.normalized();
        if (last.sigma_deg) {
          last.sigma_deg = direction_sigma_deg(away, light.sigma.position_mm2);
        }
      }
    }
  }
  return found;
}

}  // namespace haarlight
