// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <map>
#include <string>
#include <vector>

/// @file
/// What a scene shows otherwise than its glTF file has it: one warning for each kind, which says where.

namespace haarlight::render {

class GltfWarnings {
 public:
  /// @param what   a sentence without its end @param where  "materials[2]"
  void add(const std::string& what, const std::string& where) {
    places_[what].push_back(where);
  }
  /// One line each in the log. @param name  of the file
  void log(const std::string& name) const;

 private:
  std::map<std::string, std::vector<std::string>> places_;
};

}  // namespace haarlight::render
