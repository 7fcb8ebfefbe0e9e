// SPDX-License-Identifier: Apache-2.0
#include "haarlight/session/session.h"

#include <cstring>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "session/frame_tiff.h"

namespace haarlight::session {

namespace {

constexpr std::uintmax_t kMaxSessionJson = std::uintmax_t{1} << 30U;

template <class T>
void widen(std::span<const std::byte> bytes, std::span<float> values) {
  for (std::size_t i = 0; i < values.size(); ++i) {
    T value = 0;
    std::memcpy(&value, bytes.data() + i * sizeof(T), sizeof(T));
    values[i] = static_cast<float>(value);
  }
}

}  // namespace

Session Session::open(const std::filesystem::path& folder) {
  std::error_code ignored;
  const std::filesystem::path file = folder / "session.json";
  if (!std::filesystem::exists(file, ignored)) {
    if (!std::filesystem::is_directory(folder, ignored)) {
      throw Error("no such folder", folder.string(), "name a session's folder");
    }
    const bool is_unfinished = std::filesystem::exists(folder / "start.json", ignored) ||
                               std::filesystem::exists(folder / "journal.sqlite", ignored) ||
                               std::filesystem::exists(folder / "frames", ignored);
    if (is_unfinished) {
      throw Error("session.json is missing: the capture was not finished", folder.string(),
                  "finish it (haarlight capture), or run: haarlight rebuild " + folder.string(),
                  ExitCode::interrupted);
    }
    throw Error("session.json is missing: not a session", folder.string(),
                "name a session's folder, or make one: haarlight import");
  }
  Session session;
  session.folder_ = folder;
  session.info_ = session_info_from_json(read_file(file, kMaxSessionJson), file.string());
  for (const FrameRecord& frame : session.info_.frames) {
    if (!std::filesystem::is_regular_file(folder / frame.file, ignored)) {
      throw Error(fmt::format("the frame of shot {} is missing", frame.shot),
                  (folder / frame.file).string(),
                  "restore it from a backup, or run: haarlight rebuild " + folder.string());
    }
  }
  if (!session.info_.rig_hash.empty()) {
    const std::filesystem::path rig_file = folder / "rig.toml";
    session.rig_ = parse_rig(read_file(rig_file, 16U << 20U), rig_file.string());
  }
  return session;
}

Image<float> Session::read_rows(const FrameRecord& frame, int y0, int y1) const {
  const FrameForm& form = info_.form;
  HAARLIGHT_EXPECTS(0 <= y0 && y0 <= y1 && y1 <= form.height, "rows of the active area");
  const std::filesystem::path path = folder_ / frame.file;
  const MappedFile file(path);
  const FrameTiffHeader header = read_frame_tiff_header(file.bytes(), path.string());
  require_form(form, header, path.string());
  const std::vector<std::byte> bytes =
      read_frame_tiff_rows(file.bytes(), header, y0, y1, path.string());
  Image<float> rows(y1 - y0, form.width, form.channels);
  switch (form.sample) {
    case SampleType::u8:
      widen<std::uint8_t>(bytes, rows.pixels());
      break;
    case SampleType::u16:
      widen<std::uint16_t>(bytes, rows.pixels());
      break;
    case SampleType::f32:
      widen<float>(bytes, rows.pixels());
      break;
  }
  return rows;
}

}  // namespace haarlight::session
