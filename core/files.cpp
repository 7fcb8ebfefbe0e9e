// SPDX-License-Identifier: Apache-2.0
#include "haarlight/core/files.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>
#include <xxhash.h>

#include "core/mapped_files.h"
#include "haarlight/core/error.h"

namespace haarlight {

namespace {

[[noreturn]] void throw_io(const char* step, const std::filesystem::path& path, int error) {
  throw Error(
      fmt::format("{}: {}", step, std::strerror(error)), path.string(),
      error == ENOSPC ? "free some space on this disk" : "check the folder and its rights",
      ExitCode::io);
}

void write_all(int fd, std::span<const std::byte> bytes, const std::filesystem::path& path) {
  while (!bytes.empty()) {
    const ssize_t n = ::write(fd, bytes.data(), bytes.size());
    if (n < 0 && errno == EINTR) {
      continue;
    }
    if (n <= 0) {
      throw_io("write", path, n < 0 ? errno : EIO);
    }
    bytes = bytes.subspan(static_cast<std::size_t>(n));
  }
}

struct OpenFile {
  Fd fd;
  std::size_t size = 0;
};

void require_regular(const struct stat& info, const std::filesystem::path& path) {
  if (S_ISREG(info.st_mode)) {
    return;
  }
  if (S_ISDIR(info.st_mode)) {
    throw Error("a folder, not a file", path.string(), "name a file in it");
  }
  const char* what = S_ISFIFO(info.st_mode)   ? "a pipe (FIFO)"
                     : S_ISSOCK(info.st_mode) ? "a socket"
                                              : "a device";
  throw Error(fmt::format("{}, not a file", what), path.string(),
              "write what it gives to a file first, and name that");
}

/// Never blocks: opening a pipe would, until somebody writes to it, and opening a device may
/// have side effects. So the file is checked first, and again once open.
OpenFile open_file(const std::filesystem::path& path) {
  struct stat info {};
  if (::stat(path.c_str(), &info) == 0) {
    require_regular(info, path);
  }
  Fd fd(::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
  if (!fd.is_open() || ::fstat(fd.get(), &info) != 0) {
    throw Error(fmt::format("cannot open: {}", std::strerror(errno)), path.string(),
                "check the name and its rights");
  }
  require_regular(info, path);
  return {std::move(fd), static_cast<std::size_t>(info.st_size)};
}

/// The first `n_bytes`, fewer where the file has shrunk since it was opened.
std::string read_bytes(const OpenFile& file, std::size_t n_bytes,
                       const std::filesystem::path& path) {
  std::string text(n_bytes, '\0');
  std::size_t done = 0;
  while (done < text.size()) {
    const ssize_t n = ::read(file.fd.get(), text.data() + done, text.size() - done);
    if (n < 0 && errno == EINTR) {
      continue;
    }
    if (n < 0) {
      throw_io("read", path, errno);
    }
    if (n == 0) {
      break;
    }
    done += static_cast<std::size_t>(n);
  }
  text.resize(done);
  return text;
}

std::filesystem::path folder_of(const std::filesystem::path& path) {
  return path.has_parent_path() ? path.parent_path() : std::filesystem::path(".");
}

}  // namespace

void Fd::reset(int fd) noexcept {
  if (fd_ >= 0) {
    ::close(fd_);
  }
  fd_ = fd;
}

MappedFile::MappedFile(const std::filesystem::path& path) {
  const OpenFile file = open_file(path);
  size_ = file.size;
  if (size_ == 0) {
    return;
  }
  void* mapped = ::mmap(nullptr, size_, PROT_READ, MAP_SHARED, file.fd.get(), 0);
  if (mapped == MAP_FAILED) {
    const int error = errno;
    size_ = 0;
    throw_io("mmap", path, error);
  }
  data_ = static_cast<const std::byte*>(mapped);
  note_mapping(bytes(), path);
}

MappedFile::~MappedFile() {
  if (data_ != nullptr) {
    forget_mapping(data_);
    ::munmap(const_cast<std::byte*>(data_), size_);  // munmap takes what mmap gave
  }
}

MappedFile::MappedFile(MappedFile&& other) noexcept
    : data_(std::exchange(other.data_, nullptr)), size_(std::exchange(other.size_, 0)) {}

MappedFile& MappedFile::operator=(MappedFile&& other) noexcept {
  std::swap(data_, other.data_);
  std::swap(size_, other.size_);
  return *this;
}

void drop_pages(std::span<const std::byte> mapped) noexcept {
  const auto page = static_cast<std::uintptr_t>(::sysconf(_SC_PAGESIZE));
  const auto begin = reinterpret_cast<std::uintptr_t>(mapped.data());
  const std::uintptr_t first = (begin + page - 1) / page * page;
  const std::uintptr_t last = (begin + mapped.size()) / page * page;
  if (first < last) {
    // Only advice: a failure costs memory, nothing else.
    ::madvise(const_cast<std::byte*>(mapped.data()) + (first - begin), last - first,
              MADV_DONTNEED);
  }
}

std::string read_file(const std::filesystem::path& path, std::uintmax_t max_bytes) {
  const OpenFile file = open_file(path);
  if (std::uintmax_t{file.size} > max_bytes) {
    throw Error(fmt::format("{} bytes, more than the {} expected here", file.size, max_bytes),
                path.string(), "is this the right file?");
  }
  return read_bytes(file, file.size, path);
}

std::string read_head(const std::filesystem::path& path, std::size_t n_bytes) {
  const OpenFile file = open_file(path);
  return read_bytes(file, std::min(file.size, n_bytes), path);
}

PendingFile::PendingFile(std::filesystem::path path) : path_(std::move(path)) {
  temporary_ = path_;
  temporary_ += fmt::format(".tmp{}", ::getpid());
  fd_.reset(::open(temporary_.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644));
  if (!fd_.is_open()) {
    throw_io("create", temporary_, errno);
  }
}

PendingFile::PendingFile(PendingFile&& other) noexcept
    : path_(std::move(other.path_)),
      temporary_(std::move(other.temporary_)),
      fd_(std::move(other.fd_)),
      size_(other.size_) {
  other.temporary_.clear();
}

PendingFile::~PendingFile() {
  if (!temporary_.empty()) {
    std::error_code ignored;
    std::filesystem::remove(temporary_, ignored);
  }
}

void PendingFile::append(std::span<const std::byte> bytes) {
  write_all(fd_.get(), bytes, temporary_);
  size_ += bytes.size();
}

void PendingFile::rewrite(std::uint64_t offset, std::span<const std::byte> bytes) {
  HAARLIGHT_EXPECTS(offset + bytes.size() <= size_, "bytes already written");
  while (!bytes.empty()) {
    const ssize_t n =
        ::pwrite(fd_.get(), bytes.data(), bytes.size(), static_cast<off_t>(offset));
    if (n < 0 && errno == EINTR) {
      continue;
    }
    if (n <= 0) {
      throw_io("pwrite", temporary_, n < 0 ? errno : EIO);
    }
    bytes = bytes.subspan(static_cast<std::size_t>(n));
    offset += static_cast<std::uint64_t>(n);
  }
}

void PendingFile::append_zeros(std::uint64_t n_bytes) {
  const std::uint64_t end = size_ + n_bytes;
  const int error = n_bytes == 0 ? 0
                                 : ::posix_fallocate(fd_.get(), static_cast<off_t>(size_),
                                                     static_cast<off_t>(n_bytes));
  if (error != 0) {
    throw_io("take the room", temporary_, error);
  }
  if (::lseek(fd_.get(), static_cast<off_t>(end), SEEK_SET) < 0) {
    throw_io("lseek", temporary_, errno);
  }
  size_ = end;
}

void PendingFile::commit() {
  if (::fsync(fd_.get()) != 0) {
    throw_io("fsync", temporary_, errno);
  }
  const std::filesystem::path from = std::exchange(temporary_, {});
  fd_.reset();
  rename_durably(from, path_);
}

void rename_durably(const std::filesystem::path& from, const std::filesystem::path& to) {
  if (::rename(from.c_str(), to.c_str()) != 0) {
    const int error = errno;
    std::error_code ignored;
    std::filesystem::remove(from, ignored);
    throw_io("rename", to, error);
  }
  const Fd folder(::open(folder_of(to).c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (!folder.is_open() || ::fsync(folder.get()) != 0) {
    throw_io("fsync folder", folder_of(to), errno);
  }
}

void write_file_atomically(const std::filesystem::path& path,
                           std::span<const std::byte> bytes) {
  PendingFile file(path);
  file.append(bytes);
  file.commit();
}

void write_file_atomically(const std::filesystem::path& path, std::string_view text) {
  write_file_atomically(path, std::as_bytes(std::span(text)));
}

void require_absent(const std::filesystem::path& path, bool force) {
  if (!force && std::filesystem::exists(path)) {
    throw Error("exists already", path.string(), "choose another name or give --force",
                ExitCode::usage);
  }
}

namespace {

std::string hash_text(const XXH128_hash_t& hash) {
  return fmt::format("{:016x}{:016x}", hash.high64, hash.low64);
}

}  // namespace

std::string content_hash(std::span<const std::byte> bytes) {
  return hash_text(XXH3_128bits(bytes.data(), bytes.size()));
}

std::string content_hash(std::string_view text) {
  return content_hash(std::as_bytes(std::span(text)));
}

struct ContentHash::State {
  struct Free {
    void operator()(XXH3_state_t* state) const noexcept { XXH3_freeState(state); }
  };
  std::unique_ptr<XXH3_state_t, Free> xxh{XXH3_createState()};
};

ContentHash::ContentHash() : state_(std::make_unique<State>()) {
  HAARLIGHT_EXPECTS(state_->xxh != nullptr, "memory for a hash");
  XXH3_128bits_reset(state_->xxh.get());
}
ContentHash::~ContentHash() = default;
ContentHash::ContentHash(ContentHash&&) noexcept = default;
ContentHash& ContentHash::operator=(ContentHash&&) noexcept = default;

void ContentHash::add(std::span<const std::byte> bytes) {
  XXH3_128bits_update(state_->xxh.get(), bytes.data(), bytes.size());
}

std::string ContentHash::text() const {
  return hash_text(XXH3_128bits_digest(state_->xxh.get()));
}

}  // namespace haarlight
