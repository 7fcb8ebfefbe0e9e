#include "relight/fit/plane_store.h"

#include <algorithm>
#include <cerrno>
#include <cstring>

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include "core/error.h"

namespace haarlight {

namespace {

[[noreturn]] void fail_io(const char* step, const std::filesystem::path& folder) {
  throw Error(fmt::format("{}: {}", step, std::strerror(errno)), folder.string(),
              "free some space there, or give more --memory", ExitCode::io);
}

}  // namespace

PlaneStore::PlaneStore(std::uint64_t n_values, std::uint64_t memory_bytes,
                       const std::filesystem::path& folder)
    : folder_(folder.empty() ? std::filesystem::path(".") : folder) {
  if (n_values * sizeof(std::uint16_t) <= memory_bytes) {
    values_.resize(n_values);
    return;
  }
  file_.reset(::open(folder_.c_str(), O_TMPFILE | O_RDWR | O_CLOEXEC, 0600));
  if (!file_.is_open()) {  // file systems without nameless files
    std::string name = (folder_ / ".haarlight-planes.XXXXXX").string();
    file_.reset(::mkostemp(name.data(), O_CLOEXEC));
    if (!file_.is_open()) {
      fail_io("cannot make a work file", folder_);
    }
    ::unlink(name.c_str());
  }
}

void PlaneStore::append(std::span<const std::uint16_t> values) {
  if (!file_.is_open()) {
    HAARLIGHT_EXPECTS(written_ + values.size() <= values_.size(), "no more than announced");
    std::copy(values.begin(), values.end(),
              values_.begin() + static_cast<std::ptrdiff_t>(written_));
    written_ += values.size();
    return;
  }
  const auto bytes = std::as_bytes(values);
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
  written_ += values.size();
}

void PlaneStore::read(std::span<std::uint16_t> values) {
  HAARLIGHT_EXPECTS(read_ + values.size() <= written_, "no more than was written");
  if (!file_.is_open()) {
    std::copy_n(values_.begin() + static_cast<std::ptrdiff_t>(read_), values.size(),
                values.begin());
    read_ += values.size();
    return;
  }
  const auto bytes = std::as_writable_bytes(values);
  const std::uint64_t from = read_ * sizeof(std::uint16_t);
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
  read_ += values.size();
}

}  // namespace haarlight
