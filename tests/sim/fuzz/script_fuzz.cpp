// SPDX-License-Identifier: Apache-2.0
/// @file
/// Any bytes as a fault script and as the truth about a rig of 4 lights: read or refused.

#include <cstdint>
#include <string>

#include "haarlight/core/error.h"
#include "sim/fault_script.h"
#include "sim/truth.h"
#include "tests/repeating_mutator.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const haarlight::Rig kRig = [] {
    haarlight::Rig rig;
    haarlight::Face face;
    face.id = "top";
    face.rows = face.cols = 2;
    rig.faces.push_back(face);
    rig.cameras.emplace_back().id = "main";
    return rig;
  }();
  const std::string text(data, data + size);
  try {
    (void)haarlight::sim::parse_fault_script(text, "faults.toml");
  } catch (const haarlight::Error&) {  // NOLINT(bugprone-empty-catch): refused
  }
  try {
    const haarlight::sim::SimTruth truth =
        haarlight::sim::parse_truth(text, "truth.toml", kRig);
    (void)haarlight::sim::apply_truth(truth, kRig);
    (void)haarlight::sim::true_light_power(truth, 4);
    (void)haarlight::sim::true_wiring(truth, 4);
  } catch (const haarlight::Error&) {  // NOLINT(bugprone-empty-catch): refused
  }
  return 0;
}
