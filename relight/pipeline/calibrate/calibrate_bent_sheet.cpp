// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/calibrate/calibrate_bent_sheet.h"

#include <algorithm>
#include <limits>
#include <span>
#include <utility>

#include <fmt/format.h>

#include "core/counted.h"
#include "haarlight/relight/shape/integrate_normals.h"

namespace haarlight::relight {

namespace {

using Eigen::Vector3d;

constexpr double kMostChi2 = 2.0;  // beyond, the residual is more than noise

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

}  // namespace

double bent_range_mm(const Alternation& found) {
  double low = std::numeric_limits<double>::max();
  double high = std::numeric_limits<double>::lowest();
  for (const Vector3d& p : found.points_mm) {
    low = std::min(low, p.z());
    high = std::max(high, p.z());
  }
  return high - low;
}

FoundLights find_by_bent_sheet(const CalibratePipelineOptions& options, const ReadSheet& sheet,
                               const LightPictures& pictures, SheetFindings& findings,
                               PipelineNotes& notes) {
  // Starts from the lights found for a flat sheet.
  FreeLightOptions first = free_light_options(options);
  // A free exponent and free axes would adapt to the bend: both stay as given.
  first.aim_sigma_deg = 0.0;
  first.lights.lobe = Lobe::given;
  first.lights.sheet = {};
  first.lights.outlier_fraction = 0.0;
  const LightCalibration flat = find_free_lights(sheet.samples, first);
  std::vector<NearLight> start;
  for (const CalibratedLight& light : flat.lights) {
    start.push_back(light.light);
  }
  AlternationOptions alternation;
  alternation.lights = first.lights;
  const double block_mm = (sheet.samples.points_mm[1] - sheet.samples.points_mm[0]).norm();
  Alternation found_shape = calibrate_with_shape(
      sheet.samples, std::move(start),
      [&](const TargetSamples& samples, std::span<const Vector3d> normals) {
        return blocks_of_normals(samples, normals, block_mm);
      },
      alternation);
  notes.add(NoteKind::result,
            fmt::format(
                "the sheet's heights span {:.2f} mm; chi^2 {:.2f} of a flat one, {:.2f} "
                "so; {}{}",
                bent_range_mm(found_shape), found_shape.chi2.front(),
                found_shape.lights.reduced_chi2, counted(found_shape.moves_mm.size(), "round"),
                found_shape.has_converged ? "" : ", not settled"));
  notes.add(NoteKind::caution,
            "note: lights can hide a bend of the sheet in the noise: no +- is given");
  FoundLights found;
  found.has_powers = true;
  const double chi2 = found_shape.lights.reduced_chi2;
  found.is_good = found_shape.has_converged && chi2 < kMostChi2;
  if (!(chi2 < kMostChi2)) {
    notes.add(NoteKind::caution,
              fmt::format("lights and a bent sheet do not explain the pictures: chi^2 {:.1f} "
                          "where 1 is noise\n  hint: --mu, --aim; a more matte sheet, no stray "
                          "light",
                          chi2));
  }
  add_lights(found_shape.lights, pictures, false, found);
  add_sheet_picture(sheet.samples, found_shape.lights.albedo, found);
  findings.bent = std::move(found_shape);
  return found;
}

}  // namespace haarlight::relight
