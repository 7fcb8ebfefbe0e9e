// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <list>
#include <memory>
#include <mutex>
#include <string>

#include "apps/serve/sky_shelf.h"
#include "haarlight/relight/basis/basis_file.h"
#include "haarlight/relight/light/light_weights.h"
#include "relight/pipeline/captured_lights.h"
#include "relight/pipeline/relit_picture.h"

/// @file
/// A basis file held in memory for a server: what becomes of the file afterwards does not matter.

namespace haarlight::apps {

/// Const calls are thread-safe. Not movable.
class ServedBasis {
 public:
  /// Reads and checks the whole file.
  /// @param memory_bytes  for the file and what is unpacked of it
  /// @throws Error  not a basis file, damaged (names the block), more than the memory
  ServedBasis(const std::filesystem::path& file, std::uint64_t memory_bytes);

  /// The file's name without its ending.
  [[nodiscard]] const std::string& name() const noexcept { return name_; }
  [[nodiscard]] const relight::BasisFile& file() const noexcept { return basis_; }
  [[nodiscard]] const relight::Relighter& relighter() const noexcept { return relighter_; }
  [[nodiscard]] std::uint64_t bytes() const noexcept {
    return bytes_.size() + relighter_.bytes();
  }

  /// The lights' weights for a sky turned about z; those asked for last are kept.
  [[nodiscard]] std::shared_ptr<const relight::EnvironmentWeights> weights(
      const SkyShelf::Sky& sky, double rotate_deg) const;

 private:
  struct Found {
    std::weak_ptr<const render::Environment> environment;
    double rotate_deg = 0.0;
    std::shared_ptr<const relight::EnvironmentWeights> weights;
  };

  std::string name_;
  std::string bytes_;  ///< of the file
  relight::BasisFile basis_;
  relight::CapturedLights lights_;
  relight::Relighter relighter_;
  std::size_t most_found_;
  mutable std::mutex mutex_;
  mutable std::list<Found> found_;  ///< used last first
};

}  // namespace haarlight::apps
