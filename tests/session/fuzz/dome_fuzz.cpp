// SPDX-License-Identifier: Apache-2.0
/// @file
/// Any bytes as a `.dome` and as our own list of lights: lights or an Error.

#include <cstdint>
#include <string_view>

#include "haarlight/core/error.h"
#include "haarlight/session/light_file.h"
#include "tests/repeating_mutator.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  for (const auto parse :
       {haarlight::session::parse_dome, haarlight::session::parse_light_json}) {
    try {
      const haarlight::session::LightList list = parse(text, "a.dome");
      for (const haarlight::session::SessionLight& light : list.lights) {
        HAARLIGHT_EXPECTS(light.coordinates.allFinite(), "finite positions");
      }
    } catch (const haarlight::Error&) {
    }
  }
  return 0;
}
