// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <condition_variable>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <thread>

#include "haarlight/core/enum_words.h"
#include "haarlight/relight/basis/basis_file.h"
#include "haarlight/relight/light/light_weights.h"
#include "haarlight/render/light/cubemap.h"
#include "relight/pipeline/captured_lights.h"

/// @file
/// Environments that users bring to the viewer, and what each light must give for them. Reads
/// and integrates on a thread of its own, so that the server's thread never waits.

namespace haarlight::apps {

class EnvironmentCache {
 public:
  /// How the weights are found. The page turns an environment by `quick` ones and shows the
  /// `exact` ones when it rests.
  enum class Quality {
    exact,  ///< every texel: what `haarlight relight --cubemap` uses
    quick,  ///< the environment reduced to kQuickAcross texels all the way round
  };
  static constexpr int kQuickAcross = 128;
  static constexpr std::size_t kMostKept = 2;  ///< environments; the oldest one goes

  /// @throws Error  the basis file's rig is no rig
  explicit EnvironmentCache(const relight::BasisFile& basis);
  ~EnvironmentCache();
  EnvironmentCache(const EnvironmentCache&) = delete;
  EnvironmentCache& operator=(const EnvironmentCache&) = delete;

  /// Takes a picture file's bytes; it is read later. Any thread.
  /// @param name  as the user knows it, for errors
  /// @return  its number for weights()
  [[nodiscard]] std::string add(std::string bytes, std::string name);

  /// What it knows of an environment at an angle; nothing while it is still at work. Asking
  /// for exact weights at another angle takes back the wish for the last. Any thread.
  /// @throws Error  unknown id; what was wrong with the picture
  [[nodiscard]] std::optional<relight::EnvironmentWeights> weights(const std::string& id,
                                                                   double rotate_deg,
                                                                   Quality quality);
  /// Its layout, size and colours in words; nothing while it is being read.
  [[nodiscard]] std::optional<std::string> layout(const std::string& id);

 private:
  struct Entry {
    std::string id;
    std::string name;
    std::string bytes;  ///< until it is read
    std::shared_ptr<const render::Environment> full;
    std::shared_ptr<const render::Environment> quick;
    std::optional<Error> problem;
    std::optional<double> wanted_deg;
    double found_deg = 0.0;
    std::optional<relight::EnvironmentWeights> found;
  };

  void run(const std::stop_token& stop);
  void read(const std::shared_ptr<Entry>& entry);
  void integrate(const std::shared_ptr<Entry>& entry);
  [[nodiscard]] std::shared_ptr<Entry> find_locked(const std::string& id) const;
  [[nodiscard]] relight::EnvironmentWeights weights_of(const render::Environment& environment,
                                                       double rotate_deg) const;

  relight::CapturedLights lights_;

  mutable std::mutex mutex_;
  std::condition_variable_any work_;
  std::deque<std::shared_ptr<Entry>> entries_;  ///< newest first
  std::uint64_t n_added_ = 0;
  std::jthread worker_;
};

inline constexpr auto kQualityWords = std::to_array<std::string_view>({"exact", "quick"});
constexpr std::span<const std::string_view> words_of(EnvironmentCache::Quality) {
  return kQualityWords;
}

}  // namespace haarlight::apps
