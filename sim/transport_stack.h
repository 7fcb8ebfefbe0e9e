// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>

#include "sim/transport_file.h"

/// @file
/// The light transport matrix as a light stack: the ground truth for a captured stack.

namespace haarlight::sim {

/// Writes T / scale() with one channel (the sensor's mosaic, where it has one).
/// Working memory: one band, about 64 MiB.
/// @throws Error(io)
void write_light_stack(const Transport& transport, const std::filesystem::path& file);

}  // namespace haarlight::sim
