// SPDX-License-Identifier: Apache-2.0
/// @file
/// Any bytes as a controller's profile: a profile whose addresses are addresses, or an Error.

#include <cstdint>
#include <string>

#include "haarlight/core/error.h"
#include "haarlight/firmware_iface/controller_profile.h"
#include "tests/repeating_mutator.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  try {
    const haarlight::firmware_iface::ControllerProfile profile =
        haarlight::firmware_iface::parse_controller_profile(std::string(data, data + size),
                                                            "fuzz.toml");
    HAARLIGHT_EXPECTS(profile.channels >= 1 && profile.channel.per_request >= 1 &&
                          profile.channel.first + profile.channels <= 65536,
                      "channels with addresses");
    (void)haarlight::firmware_iface::missing_promises(profile);
  } catch (const haarlight::Error&) {  // NOLINT(bugprone-empty-catch): refused
  }
  return 0;
}
