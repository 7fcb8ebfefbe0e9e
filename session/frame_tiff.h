// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "haarlight/core/image.h"
#include "haarlight/session/evidence.h"
#include "haarlight/session/session.h"

/// @file
/// One raw frame as a TIFF file in memory: uncompressed, strips of 64 rows, 1 or 3 channels of
/// u8, u16 or f32, with a FrameDescription as JSON in the ImageDescription tag. The same frame
/// gives the same bytes. Any TIFF reader opens it. Only the .cpp includes libtiff. Pure;
/// thread-safe.

namespace haarlight::session {

inline constexpr int kStripRows = 64;

/// What was lit while a frame was exposed, stored with its pixels: no other file is needed to
/// know, and none can contradict it unnoticed.
struct LitStatement {
  ShotKind kind = ShotKind::light;
  std::vector<LightLevel> lit;
  double exposure_us = 0.0;  ///< as planned
  std::string setup;         ///< setup_hash(): identifies the lights and the sample format
  friend bool operator==(const LitStatement&, const LitStatement&) = default;
};

/// Identifies a frame, so that the journal can be rebuilt from the frames alone.
struct FrameDescription {
  std::string session;    ///< SessionInfo::id
  std::string plan_hash;  ///< SessionInfo::plan_hash
  int shot = 0;
  int attempt = 0;
  FrameEvidence evidence;
  std::optional<LitStatement> light = {};  ///< nothing in frames of older programs
  friend bool operator==(const FrameDescription&, const FrameDescription&) = default;
};

/// SHA-256, 64 digits, over the lights' names, positions and powers and the frames' form
/// (layout: docs/reference/session-format.md).
[[nodiscard]] std::string setup_hash(const SessionInfo& info);
/// The description stored in a frame of this shot. @param setup  setup_hash(info)
[[nodiscard]] FrameDescription describe_frame(const SessionInfo& info, const std::string& setup,
                                              int shot, int attempt,
                                              const FrameEvidence& evidence);

[[nodiscard]] std::string frame_description_to_json(const FrameDescription& description);
/// @throws Error  naming the field
[[nodiscard]] FrameDescription frame_description_from_json(const std::string& json,
                                                           const std::string& where);

/// @param pixels  (stored height, width, 1 or 3)
/// @throws Error(io)  libtiff failed (a frame above 4 GiB)
[[nodiscard]] std::vector<std::byte> encode_frame_tiff(ImageView<const std::uint8_t> pixels,
                                                       const std::string& description);
[[nodiscard]] std::vector<std::byte> encode_frame_tiff(ImageView<const std::uint16_t> pixels,
                                                       const std::string& description);
[[nodiscard]] std::vector<std::byte> encode_frame_tiff(ImageView<const float> pixels,
                                                       const std::string& description);

/// The description stored in a frame's TIFF.
struct FrameTiffHeader {
  int width = 0;
  int height = 0;  ///< stored rows
  int channels = 1;
  SampleType sample = SampleType::u16;
  std::string description;
};

/// @throws Error  not a TIFF, damaged, compressed, or not of this form
[[nodiscard]] FrameTiffHeader read_frame_tiff_header(std::span<const std::byte> file,
                                                     const std::string& where);

/// @throws Error  a header that is not of the session's form
void require_form(const FrameForm& form, const FrameTiffHeader& header,
                  const std::string& where);

/// Where in the file each strip of kStripRows rows begins.
/// @throws Error  a strip that the file does not contain
[[nodiscard]] std::vector<std::uint64_t> frame_tiff_strips(std::span<const std::byte> file,
                                                           const FrameTiffHeader& header,
                                                           const std::string& where);

/// The bytes of rows [y0, y1), packed (rows, width, channels), samples little-endian.
/// @throws Error  as above, or the file does not contain these rows
[[nodiscard]] std::vector<std::byte> read_frame_tiff_rows(std::span<const std::byte> file,
                                                          const FrameTiffHeader& header, int y0,
                                                          int y1, const std::string& where);

/// content_hash of rows' bytes, packed.
[[nodiscard]] std::string hash_pixels(ImageView<const std::uint8_t> pixels);
[[nodiscard]] std::string hash_pixels(ImageView<const std::uint16_t> pixels);
[[nodiscard]] std::string hash_pixels(ImageView<const float> pixels);

[[nodiscard]] std::size_t bytes_per_sample(SampleType sample) noexcept;

/// frames/SHOT_aATTEMPT.tif, SHOT with at least six digits.
[[nodiscard]] std::string frame_file_name(int shot, int attempt);
/// Shot and attempt of such a name (without folder); false when it is not one.
[[nodiscard]] bool parse_frame_file_name(const std::string& name, int& shot, int& attempt);

}  // namespace haarlight::session
