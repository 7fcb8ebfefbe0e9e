// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/work_folder.h"

#include <array>
#include <cstring>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>

#include "haarlight/core/error.h"
#include "haarlight/relight/basis/coder/block_codec.h"

namespace haarlight::relight {

namespace {

namespace fs = std::filesystem;

constexpr std::size_t kHashBytes = 32;  // content_hash, as digits
constexpr std::size_t kHeadBytes = kHashBytes + sizeof(std::uint64_t);
constexpr const char* kKeyFile = "key";
constexpr const char* kLockFile = "lock";

std::string piece_hash(const std::string& job, const std::string& name,
                       const std::string& piece) {
  return content_hash(job + "\n" + name + "\n" + piece);
}

}  // namespace

WorkFolder::WorkFolder(fs::path folder, std::string key)
    : folder_(std::move(folder)), key_(std::move(key)) {
  std::error_code error;
  fs::create_directories(folder_, error);
  if (error) {
    throw Error("cannot make a folder for the work: " + error.message(), folder_.string(),
                "write to a folder that you may write to", ExitCode::io);
  }
}

void WorkFolder::own() {
  Fd lock(::open(path(kLockFile).c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644));
  if (!lock.is_open() || ::flock(lock.get(), LOCK_EX | LOCK_NB) != 0) {
    throw Error("another process is at this work", folder_.string(),
                "wait for it, or write to another file", ExitCode::interrupted);
  }
  lock_ = std::move(lock);
  std::error_code ignored;
  std::string found;
  if (fs::exists(path(kKeyFile), ignored)) {
    found = read_file(path(kKeyFile), 4096);
  }
  if (!key_.empty() && found == key_) {
    return;
  }
  for (const auto& entry : fs::directory_iterator(folder_, ignored)) {
    if (entry.path().filename() != kLockFile) {
      fs::remove_all(entry.path(), ignored);
    }
  }
  write_file_atomically(path(kKeyFile), key_);
}

fs::path WorkFolder::path(const std::string& name) const { return folder_ / name; }

std::optional<std::vector<std::byte>> WorkFolder::read(const std::string& name,
                                                       const std::string& key) const {
  std::error_code ignored;
  if (!fs::is_regular_file(path(name), ignored)) {
    return {};
  }
  const MappedFile file(path(name));
  const std::span<const std::byte> bytes = file.bytes();
  if (bytes.size() < kHeadBytes) {
    return {};
  }
  const std::string hash = piece_hash(key_, name, key);
  const std::span<const std::byte> body = bytes.subspan(kHeadBytes);
  std::uint64_t checksum = 0;
  std::memcpy(&checksum, bytes.data() + kHashBytes, sizeof(checksum));
  if (std::memcmp(bytes.data(), hash.data(), kHashBytes) != 0 ||
      checksum != block_checksum(body)) {
    return {};
  }
  return std::vector<std::byte>(body.begin(), body.end());
}

void WorkFolder::write(const std::string& name, std::span<const std::byte> bytes,
                       const std::string& key) const {
  const std::string hash = piece_hash(key_, name, key);
  HAARLIGHT_EXPECTS(hash.size() == kHashBytes, "a hash of 32 digits");
  std::array<std::byte, kHeadBytes> head{};
  std::memcpy(head.data(), hash.data(), kHashBytes);
  const std::uint64_t checksum = block_checksum(bytes);
  std::memcpy(head.data() + kHashBytes, &checksum, sizeof(checksum));
  PendingFile file(path(name));
  file.append(head);
  file.append(bytes);
  file.commit();
}

std::optional<std::vector<double>> WorkFolder::read_numbers(const std::string& name,
                                                            const std::string& key) const {
  const std::optional<std::vector<std::byte>> bytes = read(name, key);
  if (!bytes || bytes->size() % sizeof(double) != 0) {
    return {};
  }
  std::vector<double> numbers(bytes->size() / sizeof(double));
  std::memcpy(numbers.data(), bytes->data(), bytes->size());
  return numbers;
}

void WorkFolder::write_numbers(const std::string& name, std::span<const double> numbers,
                               const std::string& key) const {
  write(name, std::as_bytes(numbers), key);
}

void WorkFolder::remove() noexcept {
  std::error_code ignored;
  fs::remove_all(folder_, ignored);
}

}  // namespace haarlight::relight
