// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "haarlight/core/picture/picture_facts.h"

/// @file
/// The photographs' facts as stored in sessions, basis files and web folders: an object
/// `photographed` with those of `camera`, `exposure_s`, `f_number`, `iso` and `taken` that are
/// known.

namespace haarlight {
class JsonValue;
}

namespace haarlight::session {

[[nodiscard]] std::string facts_to_json(const PictureFacts& facts);
/// @throws Error  naming the member
[[nodiscard]] PictureFacts facts_from_json(const JsonValue& value);

}  // namespace haarlight::session
