// SPDX-License-Identifier: Apache-2.0
/// @file
/// Any bytes as a session's journal: a Fault, or rows whose states are known. An input whose
/// first byte is even is the file; an odd one patches a good journal (offset, two bytes; value,
/// one), so that SQLite's own header need not be guessed.

#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>

#include <unistd.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "session/journal.h"

namespace {

namespace fs = std::filesystem;
using haarlight::session::Journal;

const fs::path& folder() {
  static const fs::path kFolder = [] {
    const fs::path shm = "/dev/shm";
    fs::path made = (fs::is_directory(shm) ? shm : fs::temp_directory_path()) /
                    ("haarlight-journal-fuzz-" + std::to_string(::getpid()));
    fs::create_directories(made);
    std::atexit([] {
      std::error_code ignored;
      fs::remove_all(folder(), ignored);
    });
    return made;
  }();
  return kFolder;
}

haarlight::session::Storage& disk() {
  static haarlight::session::DiskStorage storage;
  return storage;
}

void clear() {
  for (const char* name : {"j.sqlite", "j.sqlite-wal", "j.sqlite-shm", "j.sqlite-journal"}) {
    std::error_code ignored;
    fs::remove(folder() / name, ignored);
  }
}

const std::string& good_journal() {
  static const std::string kBytes = [] {
    clear();
    const fs::path file = folder() / "j.sqlite";
    auto journal = Journal::open(file, "fuzz", disk());
    HAARLIGHT_EXPECTS(journal.has_value(), "a new journal opens");
    for (int shot = 0; shot < 3; ++shot) {
      const haarlight::session::JournalRow row{
          .shot = shot,
          .attempt = 0,
          .file = "frames/" + std::to_string(shot) + ".tif",
          .file_hash = "0123456789abcdef",
          .evidence = "{}"};
      HAARLIGHT_EXPECTS(journal->insert(std::span(&row, 1)).has_value(), "a row goes in");
    }
    HAARLIGHT_EXPECTS(journal->log(haarlight::session::EventKind::state, "{}").has_value() &&
                          journal->close_for_archive().has_value(),
                      "a good journal");
    return haarlight::read_file(file);
  }();
  return kBytes;
}

void look_at(const fs::path& file) {
  (void)haarlight::session::read_journal(file, "fuzz");
  auto journal = Journal::open(file, "fuzz", disk());
  if (!journal) {
    return;
  }
  const auto rows = journal->rows();
  if (rows) {
    for (const haarlight::session::JournalRow& row : *rows) {
      HAARLIGHT_EXPECTS(row.state == haarlight::session::RowState::committed ||
                            row.state == haarlight::session::RowState::withdrawn ||
                            row.state == haarlight::session::RowState::returned,
                        "a state that is known");
    }
  }
  const auto events = journal->events_after(0, 10);
  HAARLIGHT_EXPECTS(!events || events->size() <= 10, "no more events than requested");
  (void)journal->log(haarlight::session::EventKind::state, "{}");
  (void)journal->close_for_archive();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::string bytes = good_journal();
  if (size == 0) {
    return 0;
  }
  if (data[0] % 2 == 0) {
    bytes.assign(reinterpret_cast<const char*>(data + 1), size - 1);
  } else {
    for (std::size_t i = 1; i + 2 < size; i += 3) {
      const std::size_t at = data[i] * 256U + data[i + 1];
      bytes[at % bytes.size()] = static_cast<char>(data[i + 2]);
    }
  }
  clear();
  const fs::path file = folder() / "j.sqlite";
  std::ofstream(file, std::ios::binary) << bytes;
  look_at(file);
  return 0;
}
