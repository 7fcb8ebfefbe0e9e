// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>

#include <gtest/gtest.h>

#include "capture/camera/metadata_rows.h"
#include "capture/sequencer/sequencer.h"
#include "haarlight/core/files.h"
#include "haarlight/session/session.h"
#include "session/frame_tiff.h"

/// @file
/// What the virtual camera wrote into a finished session's frames, against what they stand for.

namespace haarlight::testing {

/// Every shot has a frame, and its metadata rows say that it saw that shot's pattern and no
/// other.
inline void expect_true_session(const std::filesystem::path& folder) {
  const session::Session session = session::Session::open(folder);
  ASSERT_EQ(session.info().frames.size(), session.info().shots.size());
  for (const session::FrameRecord& frame : session.info().frames) {
    const MappedFile file(folder / frame.file);
    const session::FrameTiffHeader header =
        session::read_frame_tiff_header(file.bytes(), frame.file);
    const int active = session.info().form.height;
    const std::vector<std::byte> rows =
        session::read_frame_tiff_rows(file.bytes(), header, active, header.height, frame.file);
    const auto tag =
        capture::decode_metadata_rows({reinterpret_cast<const std::uint16_t*>(rows.data()),
                                       header.height - active, header.width, 1});
    ASSERT_TRUE(tag.has_value()) << frame.file;
    EXPECT_FALSE(tag->is_mixed) << frame.file;
    EXPECT_EQ(tag->tag, capture::kFirstTag + static_cast<std::uint32_t>(frame.shot))
        << frame.file;
  }
}

}  // namespace haarlight::testing
