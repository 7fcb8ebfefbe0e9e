// SPDX-License-Identifier: Apache-2.0
#include "session/frame_reader.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "session/frame_tiff.h"

namespace haarlight::session {

namespace {

/// Reads all of `out`. @return  how many bytes there were; less at the file's end or a fault
std::size_t read_at(int fd, std::uint64_t offset, std::span<std::byte> out) {
  std::size_t done = 0;
  while (done < out.size()) {
    const ssize_t n =
        ::pread(fd, out.data() + done, out.size() - done, static_cast<off_t>(offset + done));
    if (n < 0 && errno == EINTR) {
      continue;
    }
    if (n <= 0) {
      break;
    }
    done += static_cast<std::size_t>(n);
  }
  return done;
}

}  // namespace

std::size_t FrameReader::row_bytes() const {
  const FrameForm& form = session_->info().form;
  return static_cast<std::size_t>(form.width) * static_cast<std::size_t>(form.channels) *
         bytes_per_sample(form.sample);
}

const FrameReader::Strips& FrameReader::strips_of(const FrameRecord& frame) const {
  {
    const std::lock_guard lock(mutex_);
    const auto found = strips_.find(&frame);
    if (found != strips_.end()) {
      return found->second;
    }
  }
  const std::filesystem::path path = session_->folder() / frame.file;
  const MappedFile file(path);
  const FrameTiffHeader header = read_frame_tiff_header(file.bytes(), path.string());
  require_form(session_->info().form, header, path.string());
  Strips strips = frame_tiff_strips(file.bytes(), header, path.string());
  const std::lock_guard lock(mutex_);
  return strips_.emplace(&frame, std::move(strips)).first->second;
}

void FrameReader::read(const FrameRecord& frame, int y0, int y1,
                       std::span<std::byte> out) const {
  HAARLIGHT_EXPECTS(0 <= y0 && y0 <= y1 && y1 <= session_->info().form.height,
                    "rows of the active area");
  const std::size_t row = row_bytes();
  HAARLIGHT_EXPECTS(out.size() == row * static_cast<std::size_t>(y1 - y0), "room for the rows");
  const Strips& strips = strips_of(frame);
  const std::filesystem::path path = session_->folder() / frame.file;
  const Fd fd(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  if (!fd.is_open()) {
    throw Error(fmt::format("cannot be read: {}", std::strerror(errno)), path.string(),
                "restore it from a backup", ExitCode::io);
  }
  for (int y = y0; y < y1;) {
    const int i_strip = y / kStripRows;
    const int end = std::min(y1, (i_strip + 1) * kStripRows);
    const std::size_t n = row * static_cast<std::size_t>(end - y);
    const std::uint64_t offset = strips[static_cast<std::size_t>(i_strip)] +
                                 row * static_cast<std::uint64_t>(y - i_strip * kStripRows);
    const std::span<std::byte> part = out.subspan(row * static_cast<std::size_t>(y - y0), n);
    const std::size_t found = read_at(fd.get(), offset, part);
    if (found != n) {
      throw Error(fmt::format("rows {} .. {} cannot be read: {} of {} bytes are there", y, end,
                              found, n),
                  path.string(),
                  "the file is damaged or was cut short: restore it from a backup, or take the "
                  "shot again (haarlight reshoot)",
                  ExitCode::io);
    }
    y = end;
  }
}

void FrameReader::expect(const FrameRecord& frame, int y0, int y1) const noexcept {
  try {
    const Strips* strips = nullptr;
    {
      const std::lock_guard lock(mutex_);
      const auto found = strips_.find(&frame);
      strips = found != strips_.end() ? &found->second : nullptr;
    }
    const Fd fd(strips == nullptr
                    ? -1
                    : ::open((session_->folder() / frame.file).c_str(), O_RDONLY | O_CLOEXEC));
    for (int y = y0; fd.is_open() && y < y1;) {
      const int i_strip = y / kStripRows;
      const int end = std::min(y1, (i_strip + 1) * kStripRows);
      const std::uint64_t row = row_bytes();
      (void)::posix_fadvise(
          fd.get(),
          static_cast<off_t>((*strips)[static_cast<std::size_t>(i_strip)] +
                             row * static_cast<std::uint64_t>(y - i_strip * kStripRows)),
          static_cast<off_t>(row * static_cast<std::uint64_t>(end - y)), POSIX_FADV_WILLNEED);
      y = end;
    }
  } catch (const std::exception&) {
    return;  // only advice
  }
}

}  // namespace haarlight::session
