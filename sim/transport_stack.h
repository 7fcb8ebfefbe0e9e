// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>

#include "sim/transport_file.h"

/// @file
/// The transport matrix as a light stack: the truth beside which a captured stack is judged.

namespace haarlight {

/// Writes T / scale() with one channel (the sensor's mosaic, where it has one).
/// Working memory: one band, about 64 MiB.
/// @throws Error(io)
void write_light_stack(const Transport& transport, const std::filesystem::path& file);

}  // namespace haarlight
