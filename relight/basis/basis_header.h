// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "haarlight/relight/basis/basis_file.h"

/// @file
/// The JSON header of a basis file. Fields: docs/reference/basis-format.md.

namespace haarlight::relight {

[[nodiscard]] std::string basis_header_to_json(const BasisHeader& header);

/// Reads and checks every field: afterwards sizes are sane and consistent.
/// @throws Error  naming the field; `where` is the file's name
[[nodiscard]] BasisHeader basis_header_from_json(const std::string& json,
                                                 const std::string& where);

}  // namespace haarlight::relight
