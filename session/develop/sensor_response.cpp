// SPDX-License-Identifier: Apache-2.0
#include "session/develop/sensor_response.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "session/clip_level.h"

namespace haarlight::session {

namespace {

constexpr double kBlackSlack = 0.001;     // of the range: a black level drifts this much
constexpr double kRounding = 1.0 / 12.0;  // variance of rounding to whole numbers, DN^2

/// A black level above the whole picture would make every radiance negative.
void require_signal_above_black(const Session& session) {
  const SessionInfo& info = session.info();
  const double slack =
      std::max(1.0, kBlackSlack * (info.form.white_level - info.form.black_level));
  double brightest = -std::numeric_limits<double>::infinity();
  for (const FrameRecord& frame : info.frames) {
    if (info.shots[static_cast<std::size_t>(frame.shot)].kind == ShotKind::light) {
      brightest = std::max(brightest, frame.evidence.mean_dn);
    }
  }
  if (std::isfinite(brightest) && brightest < info.form.black_level - slack) {
    throw Error(fmt::format("the black level, {}, is above the mean of every frame (at most "
                            "{:.6g})",
                            info.form.black_level, brightest),
                (session.folder() / "session.json").string(),
                "measure the black level (haarlight rig commission), or correct noise.black of "
                "the rig file and form.black_level of the session");
  }
}

}  // namespace

double SensorResponse::electrons_per_dn_at(double frame_gain_db) const {
  return electrons_per_dn / std::pow(10.0, (frame_gain_db - gain_db) / 20.0);
}

double SensorResponse::floor_variance(double frame_gain_db) const {
  const double step = electrons_per_dn_at(frame_gain_db);
  return read_e * read_e + step * step * kRounding;
}

SensorResponse sensor_response(const Session& session) {
  const FrameForm& form = session.info().form;
  SensorResponse response;
  response.black_dn = form.black_level;
  response.white_dn = form.white_level;
  response.clip_dn = form.saturation_dn();
  if (!(form.white_level > form.black_level)) {
    throw Error(fmt::format("white level {} is not above black level {}", form.white_level,
                            form.black_level),
                (session.folder() / "session.json").string(), "write the sensor's levels");
  }
  const bool is_raw = form.transfer == Transfer::linear && form.sample == SampleType::u16;
  if (is_raw) {
    require_signal_above_black(session);
  }
  if (!session.rig() || session.rig()->cameras.empty() || !is_raw) {
    return response;
  }
  const CameraSpec& camera = session.rig()->cameras.front();
  const SensorNoise& noise = camera.noise;
  if (!(noise.gain_e_per_dn > 0.0)) {
    throw Error(fmt::format("a gain of {} electrons per step", noise.gain_e_per_dn),
                (session.folder() / "rig.toml").string(),
                "measure it: haarlight rig commission");
  }
  // A rig file without noise = { ... } leaves the full well at 0.
  if (!(noise.full_well_e > 0.0)) {
    return response;
  }
  response.is_measured = true;
  response.electrons_per_dn = noise.gain_e_per_dn;
  response.gain_db = camera.gain_db;
  response.read_e = noise.read_e;
  response.clip_dn = clip_level(noise, form.black_level, form.white_level);
  return response;
}

}  // namespace haarlight::session
