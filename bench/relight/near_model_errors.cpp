// SPDX-License-Identifier: Apache-2.0
/// @file
/// Near-light calibration where the sheet, the LEDs or the lens are not ideal: errors beside
/// the stated uncertainties, for free lights and for a rigid array. Prints a table of
/// docs/numerics/near-light.md. relight_near_model_errors [SEEDS [CASE] | costs]

#include <chrono>
#include <cmath>
#include <cstdlib>
#include <string>

#include <Eigen/Cholesky>
#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "relight/calibration/near_calibration.h"
#include "tests/relight/calibration/made_sheet.h"

namespace haarlight {
namespace {

using Eigen::Vector3d;

/// What a caller would say who knows how far his plane may be off.
relight::CalibrationOptions options_for(const relight::MadeSheet& sheet) {
  relight::CalibrationOptions options;
  options.mask.saturation = 1e30;
  options.sheet = relight::matte_paper(true);
  const double tilt =
      relight::made_sheet::kHalf * std::tan(sheet.tilt_deg * std::numbers::pi / 180.0);
  options.sheet.sigma[relight::SheetTerm::tilt_x] = tilt / std::numbers::sqrt2;
  options.sheet.sigma[relight::SheetTerm::tilt_y] = tilt / std::numbers::sqrt2;
  return options;
}

struct Row {
  double normalised = 0.0;  ///< sum of e' C^-1 e over its dimensions
  double error = 0.0;       ///< sum of squares, mm
  double stated = 0.0;
  double chi2 = 0.0;
  double z = 0.0;
  int n = 0;  ///< calibrations with a stated uncertainty
  int wrong = 0;
  int refused = 0;
  void print(const char* kind) const {
    const double c = std::max(n, 1);
    fmt::print("  {:<6} {:8.3f} {:8.3f} {:6.2f}   {:6.3f} {:+7.1f}   {:3} {:3} {:3}\n", kind,
               std::sqrt(error / c), std::sqrt(stated / c), std::sqrt(normalised / c),
               chi2 / std::max(n + wrong, 1), z / std::max(n + wrong, 1), n, wrong, refused);
  }
};

void add_free(const relight::MadePictures& made, const relight::CalibrationOptions& options,
              Row& row) {
  const std::vector<relight::NearLight> start = [&] {
    std::vector<relight::NearLight> lights = relight::paper_start(made.samples, 1.0);
    for (relight::NearLight& light : lights) {
      light.emitter_mm = made.lights.front().emitter_mm;
    }
    return lights;
  }();
  const relight::LightCalibration found =
      relight::calibrate_free_lights(made.samples, start, options);
  row.chi2 += found.reduced_chi2;
  row.z += found.test.z;
  if (!found.is_usable()) {
    fmt::print("  {}\n", found.brief_report());
  }
  if (found.is_model_wrong() || !found.is_usable()) {
    ++row.wrong;
    return;
  }
  ++row.n;
  const double fraction = 1.0 / static_cast<double>(made.lights.size());
  for (std::size_t k = 0; k < made.lights.size(); ++k) {
    const Vector3d e = found.lights[k].light.position_mm - made.lights[k].position_mm;
    const Eigen::Matrix3d& c = found.lights[k].sigma.position_mm2;
    row.error += fraction * e.squaredNorm();
    row.stated += fraction * c.trace();
    row.normalised += fraction * e.dot(c.ldlt().solve(e)) / 3.0;
  }
}

void add_rigid(const relight::MadePictures& made, const relight::CalibrationOptions& options,
               Row& row) {
  Eigen::Isometry3d start = made.pose;
  start.translate(Vector3d(12.0, -9.0, 20.0));
  const relight::LightCalibration found =
      relight::calibrate_rigid_array(made.samples, made.array, start, options);
  row.chi2 += found.reduced_chi2;
  row.z += found.test.z;
  if (!found.is_usable()) {
    fmt::print("  {}\n", found.brief_report());
  }
  if (found.is_model_wrong() || !found.is_usable()) {
    ++row.wrong;
    return;
  }
  ++row.n;
  Eigen::Matrix<double, 6, 1> e;
  const Eigen::AngleAxisd turn(found.world_from_array->linear() *
                               made.pose.linear().transpose());
  e.head<3>() = turn.angle() * turn.axis();
  e.tail<3>() = found.world_from_array->translation() - made.pose.translation();
  const auto& c = found.pose_sigma->covariance;
  row.error += e.tail<3>().squaredNorm();
  row.stated += c.bottomRightCorner<3, 3>().trace();
  row.normalised += e.dot(c.ldlt().solve(e)) / 6.0;
}

/// What each unknown costs where none is needed: bounds at the truth.
int print_costs() {
  const relight::MadePictures made = relight::make_pictures({}, 1);
  const relight::PowerFit truth = relight::fit_powers(made.samples, made.lights);
  const auto show = [&](const char* name, const relight::SheetPriors& priors) {
    relight::LikelihoodOptions options;
    options.sheet = priors;
    const relight::LightBounds free =
        relight::free_light_bounds(made.samples, truth.lights, truth.albedo, options);
    const relight::PoseBound rigid =
        relight::rigid_bound(made.samples, truth.lights, truth.albedo, options);
    double sum = 0.0;
    for (const relight::LightBound& light : free.lights) {
      sum += light.position_mm2.trace() / static_cast<double>(free.lights.size());
    }
    fmt::print("{:<24} free {:.3f} mm, rigid {:.3f} mm\n", name, std::sqrt(sum),
               std::sqrt(rigid.covariance.bottomRightCorner<3, 3>().trace()));
  };
  const relight::SheetPriors all = relight::matte_paper(true);
  show("none", {});
  for (const relight::SheetTerm term :
       {relight::SheetTerm::roughness, relight::SheetTerm::sheen, relight::SheetTerm::lens}) {
    relight::SheetPriors one;
    one.sigma[term] = all.sigma[term];
    show(std::string(to_string(term)).c_str(), one);
  }
  relight::SheetPriors bow;
  for (const relight::SheetTerm term :
       {relight::SheetTerm::bow_xx, relight::SheetTerm::bow_xy, relight::SheetTerm::bow_yy}) {
    bow.sigma[term] = all.sigma[term];
  }
  show("bow", bow);
  show("all of matte_paper()", all);
  return 0;
}

int run(int n_seeds, const std::string& only) {
  fmt::print(
      "8 x 8 LEDs, 640 mm wide, 300 mm over a target of 200 mm, 24 x 24 samples, noise 0.5 %; "
      "seeds 1 to {}\n"
      "error and stated: 3-D, rms, mm (of the middle where rigid); normalised: rms of "
      "e' C^-1 e per dimension\n"
      "  {:<6} {:>8} {:>8} {:>6}   {:>6} {:>7}   ok, model wrong, refused\n",
      n_seeds, "", "error", "stated", "norm.", "chi^2", "test z");
  for (const relight::MadeSheet& sheet : relight::made_sheets()) {
    if (!only.empty() && std::string(sheet.name).find(only) == std::string::npos) {
      continue;
    }
    const auto start = std::chrono::steady_clock::now();
    Row free;
    Row rigid;
    for (int seed = 1; seed <= n_seeds; ++seed) {
      const relight::MadePictures made =
          relight::make_pictures(sheet, static_cast<std::uint64_t>(seed));
      const relight::CalibrationOptions options = options_for(sheet);
      for (Row* row : {&free, &rigid}) {
        try {
          (row == &free ? add_free : add_rigid)(made, options, *row);
        } catch (const Error& error) {
          ++row->refused;
          fmt::print("  seed {}: {}\n", seed, error.problem());
        }
      }
    }
    fmt::print("{} ({:.1f} s)\n", sheet.name,
               std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
    free.print("free");
    rigid.print("rigid");
  }
  return 0;
}

}  // namespace
}  // namespace haarlight

int main(int argc, char** argv) {
  if (argc > 1 && std::string(argv[1]) == "costs") {
    return haarlight::print_costs();
  }
  return haarlight::run(argc > 1 ? std::atoi(argv[1]) : 10, argc > 2 ? argv[2] : "");
}
