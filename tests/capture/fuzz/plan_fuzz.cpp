// SPDX-License-Identifier: Apache-2.0
/// Any bytes as a plan file or a plan.json: a plan that the rig can bear, or an Error.

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>

#include "haarlight/capture/plan/plan.h"
#include "haarlight/core/error.h"
#include "haarlight/core/rig/rig.h"
#include "tests/repeating_mutator.h"

namespace {

/// A rig without a file: 4 x 4 lights, 20 W.
haarlight::Rig small_rig() {
  haarlight::Rig rig;
  haarlight::Face face;
  face.id = "top";
  face.rows = face.cols = 4;
  face.pitch_mm = 10.0;
  face.max_power = haarlight::Watts(20.0);
  rig.faces.push_back(face);
  haarlight::CameraSpec camera;
  camera.exposure_us = 1000.0;
  rig.cameras.push_back(camera);
  return rig;
}

/// A plan file's settings. Ten bytes can ask for a million shots, which take their time and
/// show nothing more.
haarlight::capture::PlanSettings small_settings(const std::string& text) {
  haarlight::capture::PlanSettings settings = haarlight::capture::parse_plan_file(text, "fuzz");
  settings.repeats = std::min(settings.repeats, 16);
  settings.flats = std::min(settings.flats, 16);
  settings.spare_darks = std::min(settings.spare_darks, 16);
  return settings;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const haarlight::Rig kRig = small_rig();
  const std::string text(reinterpret_cast<const char*>(data), size);
  try {
    const bool is_json = !text.empty() && text.front() == '{';
    const haarlight::capture::Plan plan =
        is_json ? haarlight::capture::plan_from_json(text, "fuzz")
                : haarlight::capture::expand_plan(small_settings(text), kRig);
    haarlight::capture::require_power(plan, kRig, "fuzz");
    const haarlight::capture::Plan again =
        haarlight::capture::plan_from_json(haarlight::capture::plan_to_json(plan), "fuzz");
    HAARLIGHT_EXPECTS(again.shots == plan.shots && again.hash == plan.hash,
                      "a plan that comes back from its JSON");
    (void)haarlight::capture::dry_run(plan, kRig);
  } catch (const haarlight::Error&) {
    return 0;  // refused, as it should be
  }
  return 0;
}
