// SPDX-License-Identifier: Apache-2.0
#include "capture/plan/advice_pilot.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <span>

#include <fmt/format.h>

#include "core/count.h"
#include "haarlight/core/error.h"

namespace haarlight::capture {

namespace {

/// Frames of one pattern: how many, and the sum of their exposures in seconds.
struct Exposed {
  double n_frames = 0.0;
  double seconds = 0.0;
};

/// The exposures of the pilot's patterns; equal for all, or the mean.
Exposed exposure_of(const session::Session& session) {
  const session::SessionInfo& info = session.info();
  std::map<std::vector<int>, Exposed> by_pattern;
  for (const session::FrameRecord& frame : info.frames) {
    const session::Shot& shot = info.shots[count(frame.shot)];
    if (shot.kind != session::ShotKind::light) {
      continue;
    }
    std::vector<int> key;
    for (const session::LightLevel& level : shot.lit) {
      key.push_back(level.light);
    }
    Exposed& exposed = by_pattern[key];
    const double us = frame.evidence.exposure_read_us > 0.0 ? frame.evidence.exposure_read_us
                                                            : shot.exposure_us;
    exposed.n_frames += 1.0;
    exposed.seconds += us * 1e-6;
  }
  Exposed mean;
  for (const auto& [key, exposed] : by_pattern) {
    mean.n_frames += exposed.n_frames / static_cast<double>(by_pattern.size());
    mean.seconds += exposed.seconds / static_cast<double>(by_pattern.size());
  }
  if (!(mean.seconds > 0.0)) {
    throw Error("the pilot does not say its exposures", session.folder().string(),
                "use a session that haarlight captured");
  }
  return mean;
}

}  // namespace

AdviceScene pilot_scene(const session::Session& session, const LightStack& stack,
                        const CameraSpec& camera, const session::PlatePixels& plate,
                        int max_pixels) {
  const StackDims shape = stack.dims();
  const StackBands& bands = stack.bands();
  const session::FrameForm& form = session.info().form;
  const Exposed exposed = exposure_of(session);
  // Stack values are fractions of the range per second at gain 1; electrons per count are at
  // the rig file's gain.
  const double seconds = camera.exposure_us * 1e-6;
  const double e_per_value = seconds * std::pow(10.0, camera.gain_db / 20.0) *
                             (form.white_level - form.black_level) * camera.noise.gain_e_per_dn;
  const double x = exposed.seconds / seconds;
  const double g = camera.noise.gain_e_per_dn;
  const double r2 =
      exposed.n_frames * (camera.noise.read_e * camera.noise.read_e + g * g / 12.0);
  const PatternParameters& parameters = session.info().patterns;
  const bool is_s_matrix = parameters.family == PatternFamily::s_matrix;

  AdviceScene scene;
  scene.n_lights = shape.n_lights;
  scene.resolves_lights = parameters.family == PatternFamily::list ||
                          parameters.family == PatternFamily::one_at_a_time || is_s_matrix ||
                          (parameters.family == PatternFamily::bins && parameters.bin == 1) ||
                          (parameters.family == PatternFamily::haar &&
                           parameters.wavelets.size() == count(shape.n_lights));
  scene.source = session.folder().string();
  const auto n_pixels = count(shape.width) * count(shape.height);
  const std::size_t n_kept = std::min(n_pixels, count(std::max(max_pixels, 1)));
  const std::size_t n = count(shape.n_lights);
  std::vector<float> plate_row(n);
  for (std::size_t i = 0; i < n_kept; ++i) {
    const std::size_t pixel = i * n_pixels / n_kept;
    const auto y = static_cast<int>(pixel / count(shape.width));
    const auto at_x = static_cast<int>(pixel % count(shape.width));
    const int i_band = y / bands.rows;
    const std::span<const float> band = stack.band(i_band);
    const int rows = bands.n_rows(i_band);
    if (!plate.is_empty()) {
      plate.read(y, at_x, at_x + 1, plate_row);
    }
    for (int c = 0; c < shape.channels; ++c) {
      const std::size_t line = count(c) * count(rows) + count(y - bands.first_row(i_band));
      const float* values = band.data() + (line * count(shape.width) + count(at_x)) * n;
      double mean = 0.0;
      for (std::size_t k = 0; k < n; ++k) {
        mean += double{values[k]} * e_per_value / static_cast<double>(n);
      }
      for (std::size_t k = 0; k < n; ++k) {
        const double electrons = double{values[k]} * e_per_value;
        scene.electrons.push_back(static_cast<float>(electrons));
        // S-matrix: 4 r^2/n + 2 s, s the mean over the lights.
        const double variance =
            is_s_matrix ? 4.0 * r2 / static_cast<double>(n) + 2.0 * x * std::max(mean, 0.0)
                        : r2 + x * std::max(electrons, 0.0);
        scene.variance.push_back(static_cast<float>(variance / (x * x)));
      }
      if (!plate.is_empty()) {
        scene.plate.insert(scene.plate.end(), plate_row.begin(), plate_row.end());
      }
      ++scene.n_pixels;
    }
  }
  return scene;
}

}  // namespace haarlight::capture
