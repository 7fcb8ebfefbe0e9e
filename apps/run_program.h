// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file
/// The main() of a program for developers: benchmarks and what makes the tests' files.

namespace haarlight::apps {

/// @param run  the program; it may throw
/// @return  what `run` returns; or 1 where it throws, after "name: what" to the standard error
[[nodiscard]] int run_program(const char* name, int (*run)(int argc, char** argv), int argc,
                              char** argv) noexcept;

}  // namespace haarlight::apps
