// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <fstream>
#include <stdexcept>
#include <string>

#include <nlohmann/json.hpp>

/// @file
/// The files of tests/golden.

namespace haarlight::test {

/// A golden file, by value: hold it in a variable before a range-for walks a part of it.
/// Comments are allowed in it: its provenance stands at the head.
/// @throws std::runtime_error  missing; nlohmann::json::exception  damaged
[[nodiscard]] inline nlohmann::json read_golden(const std::string& name) {
  const std::string path = HAARLIGHT_SOURCE_DIR "/tests/golden/" + name;
  std::ifstream in(path);
  if (!in) {
    throw std::runtime_error("cannot read " + path);
  }
  return nlohmann::json::parse(in, nullptr, true, /*ignore_comments=*/true);
}

}  // namespace haarlight::test
