// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <filesystem>
#include <span>
#include <vector>

/// @file
/// Arrays of doubles in NumPy's format, which no picture format holds.

namespace haarlight {

/// Version 1.0 of the format, little-endian float64, C order: numpy.load() reads it. The file
/// appears complete or not at all.
/// @param shape  whose product is the number of values
/// @throws Error(io)  it cannot be written
void write_npy(const std::filesystem::path& path, std::span<const std::size_t> shape,
               const std::vector<double>& values);

}  // namespace haarlight
