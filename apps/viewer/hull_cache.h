// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "haarlight/core/enum_words.h"
#include "haarlight/core/error.h"
#include "relight/hull/shadow_hull.h"
#include "relight/pipeline/captured_hull.h"
#include "relight/pipeline/pipeline_settings.h"
#include "relight/pipeline/shadow_captures.h"

/// @file
/// The shadow hull of the capture that is viewed, as the page casts shadows with it. Carving
/// takes seconds: it is done once, on request, on a thread of its own. Layouts:
/// docs/reference/http-api.md, "The viewer's server".

namespace haarlight::apps {

/// A hull in the page's layouts.
struct HullForPage {
  std::string hash;         ///< of everything below
  std::string description;  ///< JSON object: grid, plane, camera, lights, what was found
  std::string voxels;       ///< VoxelState of each voxel, 2 bits, the first one lowest
  std::string surface;      ///< vertices, normals, colours, triangles
};

/// Whose hull it is, and how it is carved.
struct HullRequest {
  relight::CapturedObject captured;
  double voxel_mm = 0.0;             ///< 0: chosen (relight/hull/shadow_hull.h)
  std::vector<std::string> options;  ///< the same as words of a command line, for the page
  relight::PipelineSettings settings;
};

/// @param rig    of the capture: its first camera, its lights
/// @param frame  the plane that the hull stands on
/// @param options  of HullRequest
[[nodiscard]] HullForPage hull_for_page(const relight::CapturedHull& found, const Rig& rig,
                                        const relight::PlaneFrame& frame,
                                        const std::vector<std::string>& options);

class HullCache {
 public:
  enum class State { refused, waiting, carving, ready };

  /// Tests whether the capture can have a hull at all; carves nothing.
  explicit HullCache(HullRequest request);
  /// Waits for carving that is under way.
  ~HullCache();
  HullCache(const HullCache&) = delete;
  HullCache& operator=(const HullCache&) = delete;

  /// Begins to carve, or to read the hull that is kept; nothing where that has begun before, or
  /// was refused. Any thread.
  void begin();

  struct Look {
    State state = State::waiting;
    std::optional<Error> problem;             ///< `refused`: why there is none
    std::shared_ptr<const HullForPage> hull;  ///< `ready`
  };
  [[nodiscard]] Look look() const;  ///< any thread

 private:
  void run();

  HullRequest request_;
  mutable std::mutex mutex_;
  Look now_;
  std::jthread worker_;
};

inline constexpr auto kHullStateWords =
    std::to_array<std::string_view>({"refused", "waiting", "carving", "ready"});
constexpr std::span<const std::string_view> words_of(HullCache::State) {
  return kHullStateWords;
}

}  // namespace haarlight::apps
