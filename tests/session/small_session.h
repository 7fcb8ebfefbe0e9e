// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "core/temporary_folder.h"
#include "haarlight/core/image.h"
#include "session/session_writer.h"

/// @file
/// A small session for tests: n lights, tiny 16-bit frames whose noise is keyed by the pattern.

namespace haarlight::test {

/// On /dev/shm where there is one.
class TemporaryFolder : public haarlight::TemporaryFolder {
 public:
  TemporaryFolder();
};

inline constexpr int kSmallWidth = 12;
inline constexpr int kSmallHeight = 6;
inline constexpr int kSmallStored = 8;

[[nodiscard]] session::SessionInfo small_info(int n_lights);
inline const std::string kSmallPlan = R"({"plan": "one at a time"})";

/// The stored rows of shot `shot`: depend on the shot only, never on the attempt.
[[nodiscard]] Image<std::uint16_t> small_pixels(int shot);
/// Evidence that holds for these pixels; the times depend on the attempt.
[[nodiscard]] session::FrameEvidence small_evidence(const session::SessionInfo& info, int shot,
                                                    int attempt,
                                                    ImageView<const std::uint16_t> stored);

/// Commits every shot that is pending, `group` at a time, then finishes.
[[nodiscard]] Result<void> capture_all(session::SessionWriter& writer, int group);

/// A whole session in `folder`.
void make_small_session(const std::filesystem::path& folder, int n_lights);

/// A finished session of the given shots with asserted evidence; `pixels` gives a shot's stored
/// rows. A rig's text goes with info.rig_hash.
void make_session(const std::filesystem::path& folder, const session::SessionInfo& info,
                  const std::function<Image<std::uint16_t>(int shot)>& pixels,
                  const std::string& rig_toml = "");

/// What must be equal between a disturbed and an undisturbed session: for every shot pattern,
/// tag and pixel hash, with the plan's hash in front. Times, sequence numbers and attempts are
/// out.
[[nodiscard]] std::vector<std::string> committed_set(const std::filesystem::path& folder);

[[nodiscard]] std::string read_text(const std::filesystem::path& file);
void write_text(const std::filesystem::path& file, const std::string& text);

}  // namespace haarlight::test
