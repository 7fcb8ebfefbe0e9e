// SPDX-License-Identifier: Apache-2.0
/// @file
/// Any bytes as a `.lp`: lights or an Error, in all three readings.

#include <cstdint>
#include <string_view>

#include "haarlight/core/error.h"
#include "haarlight/session/light_file.h"
#include "tests/repeating_mutator.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using haarlight::session::LightCoordinates;
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  for (const LightCoordinates coordinates :
       {LightCoordinates::automatic, LightCoordinates::directions,
        LightCoordinates::positions}) {
    try {
      const haarlight::session::LightList list =
          haarlight::session::parse_lp(text, "a.lp", coordinates);
      for (const haarlight::session::SessionLight& light : list.lights) {
        HAARLIGHT_EXPECTS(light.coordinates.allFinite(), "finite positions");
      }
    } catch (const haarlight::Error&) {
    }
  }
  return 0;
}
