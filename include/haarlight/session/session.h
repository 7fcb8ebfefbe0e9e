// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/enum_words.h"
#include "haarlight/core/image.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/core/rig/patterns.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/session/evidence.h"

/// @file
/// A capture on disk, as every reader sees it: `session.json` and the frames it lists. Schema:
/// docs/reference/session-format.md.

namespace haarlight::session {

enum class ShotKind { light, dark, flat, sentinel };
inline constexpr auto kShotKindWords =
    std::to_array<std::string_view>({"light", "dark", "flat", "sentinel"});
[[nodiscard]] constexpr std::span<const std::string_view> words_of(ShotKind) noexcept {
  return kShotKindWords;
}

/// One light of a pattern at a level, 65535 = drive 1.
struct LightLevel {
  int light = 0;
  std::uint16_t level = 65535;
  friend bool operator==(const LightLevel&, const LightLevel&) = default;
};

/// What to photograph.
struct Shot {
  int index = 0;  ///< index in the plan, from 0
  ShotKind kind = ShotKind::light;
  std::vector<LightLevel> lit;  ///< empty for dark
  double exposure_us = 0.0;
  friend bool operator==(const Shot&, const Shot&) = default;
};

/// How a light radiates: intensity cos^mu of the angle to its axis.
struct LightLobe {
  Eigen::Vector3d axis;  ///< unit, the direction it shines in
  double mu = 0.0;
  friend bool operator==(const LightLobe&, const LightLobe&) = default;
};

/// A light of the session: a position (rig, or `.lp` positions) or only a direction.
struct SessionLight {
  std::string name;  ///< picture name as imported, or "face/row/col"
  bool is_position = false;
  Eigen::Vector3d coordinates;  ///< mm in world, or a unit direction to the light
  double relative_power = 1.0;
  /// Of an imported position, if its list gave it; a rig's lobes are in rig.toml.
  std::optional<LightLobe> lobe = {};
};

enum class SampleType { u8, u16, f32 };
inline constexpr auto kSampleTypeWords = std::to_array<std::string_view>({"u8", "u16", "f32"});
[[nodiscard]] constexpr std::span<const std::string_view> words_of(SampleType) noexcept {
  return kSampleTypeWords;
}

/// The position of the frames in the pictures that they were cropped from, along the frames'
/// own axes.
struct FrameCrop {
  int x = 0;  ///< of the whole picture: its pixel (x, y) is the frames' (0, 0)
  int y = 0;
  int whole_width = 0;
  int whole_height = 0;
  friend bool operator==(const FrameCrop&, const FrameCrop&) = default;
};

/// The frames' common form.
struct FrameForm {
  int width = 0;
  int height = 0;         ///< active rows
  int stored_height = 0;  ///< rows in the file, with the embedded metadata rows (kept as proof)
  int channels = 1;       ///< 1 (grey or Bayer) or 3
  SampleType sample = SampleType::u16;
  Transfer transfer = Transfer::linear;  ///< srgb: develop decodes it
  BayerPattern bayer = BayerPattern::none;
  double black_level = 0.0;  ///< in samples' units
  double white_level = 65535.0;
  /// Samples from here on count as saturated (session/clip_level.h); nothing: white_level.
  std::optional<double> clip_level = {};
  /// (channels): develop multiplies linear values by these (an import's white reference); the
  /// frames exclude them. Empty: none.
  std::vector<double> gains = {};
  /// For frames cropped from their pictures; nothing: they are whole.
  std::optional<FrameCrop> crop = {};
  [[nodiscard]] double saturation_dn() const { return clip_level.value_or(white_level); }
  friend bool operator==(const FrameForm&, const FrameForm&) = default;
};

/// One committed frame.
struct FrameRecord {
  int shot = 0;
  int attempt = 0;
  std::string file;       ///< relative to the session folder: frames/SHOT_aATTEMPT.tif
  std::string file_hash;  ///< content_hash of the file's bytes
  FrameEvidence evidence;
  std::string sha256 = {};  ///< leaf_hash of the file; empty in sessions without a root
};

/// Another file that must not change: the plan, the rig, what is in aside/ ...
struct SealedFile {
  std::string name;    ///< relative to the session folder
  std::string sha256;  ///< leaf_hash of its bytes, or of the content of journal.sqlite
  friend bool operator==(const SealedFile&, const SealedFile&) = default;
};

/// What wrote session.json.
enum class MadeBy { capture, import, rebuild };
inline constexpr auto kMadeByWords =
    std::to_array<std::string_view>({"capture", "import", "rebuild"});
[[nodiscard]] constexpr std::span<const std::string_view> words_of(MadeBy) noexcept {
  return kMadeByWords;
}

/// All of session.json.
struct SessionInfo {
  int schema = 1;
  std::string id;
  std::string created;  ///< ISO 8601, for display only
  /// The program that began it, "haarlight 0.9.0". Where there is one, every frame says what
  /// was lit; empty in older sessions.
  std::string program = {};
  std::string plan_hash;       ///< of the shot list, as the plan computes it
  std::string plan_file_hash;  ///< content_hash of plan.json's bytes; filled in when written
  std::string rig_hash;        ///< empty for an import without a rig
  EvidenceKind evidence = EvidenceKind::measured;
  FrameForm form;
  PictureFacts photographed = {};  ///< of an import: what all its pictures' cameras recorded
                                   ///< alike
  std::vector<SessionLight> lights;
  int grid_rows = 0;  ///< > 0: the lights form grids of rows x cols, faces in order
  int grid_cols = 0;
  PatternParameters patterns;  ///< how the shots become single lights; list: by least squares
  std::vector<Shot> shots;
  std::vector<FrameRecord> frames;     ///< the newest committed attempt of each shot, by shot
  MadeBy made_by = MadeBy::capture;    ///< meaningful only where there is a root
  std::vector<SealedFile> files = {};  ///< under the root besides the frames, by name
  std::string root = {};  ///< session/seal.h; empty: start.json, and sessions of older programs
};

/// A finished session opened for reading. Safe to share between threads (const calls).
class Session {
 public:
  /// @throws Error  no session.json (suggests `haarlight rebuild` when a journal or frames are
  ///                there), broken JSON, a listed frame that is missing
  [[nodiscard]] static Session open(const std::filesystem::path& folder);

  [[nodiscard]] const std::filesystem::path& folder() const noexcept { return folder_; }
  [[nodiscard]] const SessionInfo& info() const noexcept { return info_; }
  /// The rig stored with the session; nothing for an import without one.
  [[nodiscard]] const std::optional<Rig>& rig() const noexcept { return rig_; }

  /// Rows [y0, y1) of a frame's active area in samples' units, (y1 - y0, width, channels), as
  /// stored: not linearised, black not subtracted.
  /// @throws Error  naming the frame's file
  [[nodiscard]] Image<float> read_rows(const FrameRecord& frame, int y0, int y1) const;

 private:
  std::filesystem::path folder_;
  SessionInfo info_;
  std::optional<Rig> rig_;
};

[[nodiscard]] std::string session_info_to_json(const SessionInfo& info);
/// @throws Error  naming the field; `where` is the file's name
[[nodiscard]] SessionInfo session_info_from_json(const std::string& json,
                                                 const std::string& where);

}  // namespace haarlight::session
