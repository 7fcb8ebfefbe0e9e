// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <string_view>

/// @file
/// Text inside HTML and SVG. Pure.

namespace haarlight {

/// The text with <, >, & and both quotes written as entities: safe between tags and within
/// quoted attributes.
[[nodiscard]] std::string escaped(std::string_view text);

}  // namespace haarlight
