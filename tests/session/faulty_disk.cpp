// SPDX-License-Identifier: Apache-2.0
#include "tests/session/faulty_disk.h"

#include <atomic>
#include <cerrno>
#include <cstring>

#include <fmt/format.h>
#include <sqlite3.h>

#include "core/random.h"
#include "tests/session/small_session.h"

namespace haarlight::test {

namespace fs = std::filesystem;

namespace {

std::string folder_of(const std::string& path) { return fs::path(path).parent_path().string(); }

/// An SQLite file: the real one behind it in memory.
struct ShimFile {
  sqlite3_file base;
  FaultyDisk* disk;
  std::string* path;
  bool is_name_new;  ///< a WAL or rollback journal just made: its first sync syncs the folder

  sqlite3_file* real() { return reinterpret_cast<sqlite3_file*>(this + 1); }
};

ShimFile& shim(sqlite3_file* file) { return *reinterpret_cast<ShimFile*>(file); }
sqlite3_file* real(sqlite3_file* file) { return shim(file).real(); }

int failure(const FaultyDisk& disk, int io_error) {
  return disk.error() == ENOSPC ? SQLITE_FULL : io_error;
}

int shim_close(sqlite3_file* file) {
  const int result = real(file)->pMethods->xClose(real(file));
  delete shim(file).path;
  return result;
}
int shim_read(sqlite3_file* file, void* buffer, int n, sqlite3_int64 offset) {
  return real(file)->pMethods->xRead(real(file), buffer, n, offset);
}
int shim_write(sqlite3_file* file, const void* bytes, int n, sqlite3_int64 offset) {
  FaultyDisk& disk = *shim(file).disk;
  const FaultyDisk::Verdict verdict = disk.next_operation();
  if (verdict == FaultyDisk::Verdict::stopped) {
    return SQLITE_IOERR_WRITE;
  }
  const bool is_whole = verdict == FaultyDisk::Verdict::go;
  const int done = is_whole ? n : n / 2;
  if (done > 0) {
    real(file)->pMethods->xWrite(real(file), bytes, done, offset);
    disk.note_write(
        *shim(file).path, static_cast<std::uint64_t>(offset),
        std::string(static_cast<const char*>(bytes), static_cast<std::size_t>(done)));
  }
  return is_whole ? SQLITE_OK : failure(disk, SQLITE_IOERR_WRITE);
}
int shim_truncate(sqlite3_file* file, sqlite3_int64 size) {
  FaultyDisk& disk = *shim(file).disk;
  if (disk.next_operation() != FaultyDisk::Verdict::go) {
    return SQLITE_IOERR_TRUNCATE;
  }
  disk.note_truncate(*shim(file).path, static_cast<std::uint64_t>(size));
  return real(file)->pMethods->xTruncate(real(file), size);
}
int shim_sync(sqlite3_file* file, int /*flags*/) {
  FaultyDisk& disk = *shim(file).disk;
  const FaultyDisk::Verdict verdict = disk.next_operation();
  if (verdict == FaultyDisk::Verdict::go) {
    disk.note_sync(*shim(file).path, true);
    if (shim(file).is_name_new) {
      disk.note_name_synced(*shim(file).path);
      shim(file).is_name_new = false;
    }
    return SQLITE_OK;
  }
  if (verdict == FaultyDisk::Verdict::fail) {
    disk.note_sync(*shim(file).path, false);
  }
  return SQLITE_IOERR_FSYNC;
}
int shim_size(sqlite3_file* file, sqlite3_int64* size) {
  return real(file)->pMethods->xFileSize(real(file), size);
}
int shim_lock(sqlite3_file* file, int level) {
  return real(file)->pMethods->xLock(real(file), level);
}
int shim_unlock(sqlite3_file* file, int level) {
  return real(file)->pMethods->xUnlock(real(file), level);
}
int shim_check_lock(sqlite3_file* file, int* result) {
  return real(file)->pMethods->xCheckReservedLock(real(file), result);
}
int shim_control(sqlite3_file* /*file*/, int /*operation*/, void* /*argument*/) {
  return SQLITE_NOTFOUND;
}
int shim_sector(sqlite3_file* file) { return real(file)->pMethods->xSectorSize(real(file)); }
int shim_traits(sqlite3_file* /*file*/) { return 0; }  // no promise of atomic or ordered writes

const sqlite3_io_methods kMethods = {
    1,           shim_close, shim_read,   shim_write,      shim_truncate, shim_sync,
    shim_size,   shim_lock,  shim_unlock, shim_check_lock, shim_control,  shim_sector,
    shim_traits, nullptr,    nullptr,     nullptr,         nullptr,       nullptr,
    nullptr};

sqlite3_vfs* system_vfs() { return sqlite3_vfs_find("unix"); }

int shim_open(sqlite3_vfs* vfs, const char* name, sqlite3_file* file, int flags, int* out) {
  auto& disk = *static_cast<FaultyDisk*>(vfs->pAppData);
  auto* opened = reinterpret_cast<ShimFile*>(file);
  opened->base.pMethods = nullptr;
  int exists = 0;
  if (name != nullptr) {
    system_vfs()->xAccess(system_vfs(), name, SQLITE_ACCESS_EXISTS, &exists);
    if (exists == 0 && disk.is_stopped()) {
      return SQLITE_CANTOPEN;
    }
  }
  const int result = system_vfs()->xOpen(system_vfs(), name, opened->real(), flags, out);
  if (result != SQLITE_OK) {
    return result;
  }
  opened->disk = &disk;
  opened->path = new std::string(name != nullptr ? name : "");
  const bool is_log = (flags & (SQLITE_OPEN_WAL | SQLITE_OPEN_MAIN_JOURNAL)) != 0;
  opened->is_name_new = exists == 0 && is_log;
  disk.note_opened(*opened->path);
  opened->base.pMethods = &kMethods;
  return SQLITE_OK;
}

int shim_delete(sqlite3_vfs* vfs, const char* name, int sync_folder) {
  auto& disk = *static_cast<FaultyDisk*>(vfs->pAppData);
  if (disk.next_operation() != FaultyDisk::Verdict::go) {
    return SQLITE_IOERR_DELETE;
  }
  const int result = system_vfs()->xDelete(system_vfs(), name, 0);
  if (result == SQLITE_OK) {
    disk.note_removed(name, sync_folder != 0);
  }
  return result;
}

}  // namespace

struct FaultyDisk::Vfs {
  std::string name;
  sqlite3_vfs vfs{};
};

FaultyDisk::FaultyDisk(Script script) : script_(script), vfs_(std::make_unique<Vfs>()) {
  static std::atomic<int> count = 0;
  sqlite3_initialize();
  vfs_->name = fmt::format("faulty{}", ++count);
  vfs_->vfs = *system_vfs();
  vfs_->vfs.zName = vfs_->name.c_str();
  vfs_->vfs.pNext = nullptr;
  vfs_->vfs.szOsFile = static_cast<int>(sizeof(ShimFile)) + system_vfs()->szOsFile;
  vfs_->vfs.pAppData = this;
  vfs_->vfs.xOpen = shim_open;
  vfs_->vfs.xDelete = shim_delete;
  sqlite3_vfs_register(&vfs_->vfs, 0);
}

FaultyDisk::~FaultyDisk() { sqlite3_vfs_unregister(&vfs_->vfs); }

std::string FaultyDisk::journal_vfs() const { return vfs_->name; }

FaultyDisk::Verdict FaultyDisk::next_operation() {
  if (is_stopped_) {
    return Verdict::stopped;
  }
  const int index = n_operations_++;
  if (index == script_.stop_at) {
    is_stopped_ = true;
    return Verdict::half;
  }
  return index == script_.fail_at ? Verdict::fail : Verdict::go;
}

Result<void> FaultyDisk::before(const char* operation, const fs::path& path) {
  switch (next_operation()) {
    case Verdict::go:
      return {};
    case Verdict::fail:
      return fail(
          script_.error == ENOSPC ? Errc::no_space : Errc::io,
          fmt::format("{} {}: {}", operation, path.string(), std::strerror(script_.error)),
          script_.error);
    case Verdict::half:
    case Verdict::stopped:
      break;
  }
  throw Stopped(operation);
}

int FaultyDisk::id_of(const std::string& path) {
  const auto [it, is_new] = names_.emplace(path, static_cast<int>(files_.size()));
  if (is_new) {
    files_.emplace_back();
  }
  return it->second;
}

Result<void> FaultyDisk::write(const fs::path& path, std::span<const std::byte> bytes) {
  const Verdict verdict = next_operation();
  if (verdict == Verdict::stopped) {
    throw Stopped("write");
  }
  const std::size_t n = verdict == Verdict::go ? bytes.size() : bytes.size() / 2;
  const auto part = bytes.first(n);
  if (auto done = disk_.write(path, part); !done) {
    return done;
  }
  note_opened(path.string());
  note_truncate(path.string(), 0);
  note_write(path.string(), 0, std::string(reinterpret_cast<const char*>(part.data()), n));
  if (verdict == Verdict::half) {
    throw Stopped("write");
  }
  if (verdict == Verdict::fail) {
    return fail(script_.error == ENOSPC ? Errc::no_space : Errc::io, "write " + path.string(),
                script_.error);
  }
  return {};
}

Result<void> FaultyDisk::sync_file(const fs::path& path) {
  auto done = before("fsync", path);
  note_sync(path.string(), done.has_value());
  return done;
}

Result<void> FaultyDisk::rename(const fs::path& from, const fs::path& to) {
  if (auto done = before("rename", to); !done) {
    return done;
  }
  const int id = id_of(from.string());
  names_.erase(from.string());
  names_[to.string()] = id;
  return disk_.rename(from, to);
}

Result<void> FaultyDisk::sync_folder(const fs::path& folder) {
  if (auto done = before("fsync folder", folder); !done) {
    return done;
  }
  for (auto it = durable_names_.begin(); it != durable_names_.end();) {
    it = folder_of(it->first) == folder.string() ? durable_names_.erase(it) : std::next(it);
  }
  for (const auto& [path, id] : names_) {
    if (folder_of(path) == folder.string()) {
      durable_names_[path] = id;
    }
  }
  return {};
}

Result<std::uint64_t> FaultyDisk::free_bytes(const fs::path& folder) {
  return disk_.free_bytes(folder);
}

Result<void> FaultyDisk::remove(const fs::path& path) {
  if (auto done = before("unlink", path); !done) {
    return done;
  }
  names_.erase(path.string());
  return disk_.remove(path);
}

Result<void> FaultyDisk::reserve(const fs::path& path, std::uint64_t bytes) {
  if (auto done = before("fallocate", path); !done) {
    return done;
  }
  note_opened(path.string());
  return disk_.reserve(path, bytes);
}

Result<void> FaultyDisk::journal_step() { return before("journal", "journal.sqlite"); }

void FaultyDisk::note_opened(const std::string& path) { (void)id_of(path); }

void FaultyDisk::note_write(const std::string& path, std::uint64_t offset, std::string bytes) {
  files_[static_cast<std::size_t>(id_of(path))].pending.push_back({offset, std::move(bytes)});
}

void FaultyDisk::note_truncate(const std::string& path, std::uint64_t size) {
  files_[static_cast<std::size_t>(id_of(path))].pending.push_back({size, std::nullopt});
}

void FaultyDisk::apply(std::string& image, const Pending& pending) {
  if (!pending.bytes) {
    image.resize(static_cast<std::size_t>(pending.offset));
    return;
  }
  const std::size_t end = static_cast<std::size_t>(pending.offset) + pending.bytes->size();
  if (image.size() < end) {
    image.resize(end);
  }
  image.replace(static_cast<std::size_t>(pending.offset), pending.bytes->size(),
                *pending.bytes);
}

void FaultyDisk::note_sync(const std::string& path, bool is_good) {
  File& file = files_[static_cast<std::size_t>(id_of(path))];
  if (is_good) {
    for (const Pending& pending : file.pending) {
      apply(file.durable, pending);
    }
  }
  file.pending.clear();  // after a failed sync the pages count as clean: they never get written
}

void FaultyDisk::note_name_synced(const std::string& path) {
  durable_names_[path] = id_of(path);
}

void FaultyDisk::note_removed(const std::string& path, bool is_folder_synced) {
  names_.erase(path);
  if (is_folder_synced) {
    durable_names_.erase(path);
  }
}

void FaultyDisk::crash(const fs::path& folder, Survives survives, std::uint64_t seed) {
  if (survives == Survives::everything) {
    return;
  }
  const auto coin = [seed](std::uint64_t a, std::uint64_t b) {
    return (hash_key(seed, a, b) >> 40U) % 2U == 0;
  };
  // Unsynced names of a folder survive together or not at all.
  std::map<std::string, int> names;
  const auto keeps_names = [&](const std::string& path) {
    return survives == Survives::some && coin(1, std::hash<std::string>()(folder_of(path)));
  };
  for (const auto& [path, id] : durable_names_) {
    if (!keeps_names(path)) {
      names[path] = id;
    }
  }
  for (const auto& [path, id] : names_) {
    if (keeps_names(path)) {
      names[path] = id;
    }
  }
  std::vector<fs::path> old;
  for (const fs::directory_entry& entry : fs::recursive_directory_iterator(folder)) {
    if (entry.is_regular_file()) {
      old.push_back(entry.path());
    }
  }
  for (const fs::path& path : old) {
    fs::remove(path);
  }
  for (const auto& [path, id] : names) {
    const File& file = files_[static_cast<std::size_t>(id)];
    std::string image = file.durable;
    for (std::size_t i = 0; i < file.pending.size(); ++i) {
      if (survives == Survives::some && coin(static_cast<std::uint64_t>(id) + 2, i)) {
        apply(image, file.pending[i]);
      }
    }
    write_text(path, image);
  }
}

}  // namespace haarlight::test
