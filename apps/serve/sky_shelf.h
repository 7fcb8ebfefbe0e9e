// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <list>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "haarlight/render/light/cubemap.h"

/// @file
/// Environments of a server: pictures of a folder, by their names, and those that clients send,
/// by the hash of their bytes. Both are kept in memory, the ones used last.

namespace haarlight::apps {

/// Thread-safe.
class SkyShelf {
 public:
  /// @param folder        of pictures, and of folders of six faces; empty: none. Listed once
  /// @param memory_bytes  of all environments kept; the one used longest ago goes
  /// @throws Error  no folder
  SkyShelf(const std::filesystem::path& folder, std::uint64_t memory_bytes);

  /// Those of the folder, in order.
  [[nodiscard]] std::vector<std::string> names() const;

  struct Sky {
    std::string id;  ///< its name in the folder, or its hash
    std::shared_ptr<const render::Environment> environment;
  };
  /// Keeps a picture that a client has sent.
  /// @throws Error  as Environment::from_picture; larger than the shelf
  [[nodiscard]] Sky add(std::string_view picture);
  /// Reads one of the folder where it is not kept; nothing where none has this name.
  /// @throws Error  as Environment::read
  [[nodiscard]] std::optional<Sky> find(const std::string& id);

 private:
  struct Kept {
    Sky sky;
    std::uint64_t bytes = 0;
  };
  Sky keep(std::string id, render::Environment environment);

  std::map<std::string, std::filesystem::path> paths_;  ///< of the folder's, by name
  std::uint64_t memory_bytes_;
  std::mutex mutex_;
  std::list<Kept> kept_;  ///< used last first
  std::uint64_t n_bytes_ = 0;
};

}  // namespace haarlight::apps
