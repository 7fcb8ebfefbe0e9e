// SPDX-License-Identifier: Apache-2.0
#include "relight/reflectance/fit/plane_store.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

[[noreturn]] void fail_io(const char* step, const std::filesystem::path& folder) {
  throw Error(fmt::format("{}: {}", step, std::strerror(errno)), folder.string(),
              "free some space there, or give more --memory", ExitCode::io);
}

}  // namespace

Fd nameless_file(const std::filesystem::path& where) {
  const std::filesystem::path folder = where.empty() ? std::filesystem::path(".") : where;
  Fd file(::open(folder.c_str(), O_TMPFILE | O_RDWR | O_CLOEXEC, 0600));
  if (!file.is_open()) {  // file systems without O_TMPFILE
    std::string name = (folder / ".haarlight-planes.XXXXXX").string();
    file.reset(::mkostemp(name.data(), O_CLOEXEC));
    if (!file.is_open()) {
      fail_io("cannot make a work file", folder);
    }
    ::unlink(name.c_str());
  }
  return file;
}

PlaneStore::PlaneStore(std::uint64_t n_values, std::uint64_t memory_bytes,
                       const std::filesystem::path& folder)
    : folder_(folder.empty() ? std::filesystem::path(".") : folder), n_values_(n_values) {
  if (n_values * sizeof(std::uint16_t) <= memory_bytes) {
    values_ = std::make_unique_for_overwrite<std::uint16_t[]>(n_values);
    return;
  }
  file_ = nameless_file(folder_);
}

std::span<std::uint16_t> PlaneStore::room(std::size_t n_values) {
  HAARLIGHT_EXPECTS(written_ + n_values <= n_values_, "no more than announced");
  given_ = n_values;
  if (!file_.is_open()) {
    return {values_.get() + written_, n_values};
  }
  buffer_.resize(n_values);
  return buffer_;
}

void PlaneStore::keep() {
  if (!file_.is_open()) {
    written_ += std::exchange(given_, 0);
    return;
  }
  const auto bytes = std::as_bytes(std::span(buffer_).first(given_));
  std::size_t done = 0;
  while (done < bytes.size()) {
    const ssize_t n = ::write(file_.get(), bytes.data() + done, bytes.size() - done);
    if (n < 0 && errno == EINTR) {
      continue;
    }
    if (n <= 0) {
      fail_io("writing 16-bit planes", folder_);
    }
    done += static_cast<std::size_t>(n);
  }
  written_ += std::exchange(given_, 0);
}

std::span<const std::uint16_t> PlaneStore::next(std::size_t n_values) {
  HAARLIGHT_EXPECTS(read_ + n_values <= written_, "no more than was written");
  const std::uint64_t first = std::exchange(read_, read_ + n_values);
  if (!file_.is_open()) {
    return {values_.get() + first, n_values};
  }
  buffer_.resize(n_values);
  const auto bytes = std::as_writable_bytes(std::span(buffer_));
  const std::uint64_t from = first * sizeof(std::uint16_t);
  std::size_t done = 0;
  while (done < bytes.size()) {
    const ssize_t n = ::pread(file_.get(), bytes.data() + done, bytes.size() - done,
                              static_cast<off_t>(from + done));
    if (n < 0 && errno == EINTR) {
      continue;
    }
    if (n <= 0) {
      fail_io("reading 16-bit planes back", folder_);
    }
    done += static_cast<std::size_t>(n);
  }
  return buffer_;
}

}  // namespace haarlight::relight
