// SPDX-License-Identifier: Apache-2.0
#include "session/seal.h"

#include <algorithm>
#include <set>

#include <fmt/format.h>

#include "core/sha256.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"

namespace haarlight::session {

namespace {

namespace fs = std::filesystem;

constexpr std::size_t kDigits = 64;
constexpr std::string_view kBeforeRoot = ",\n\"root\": \"";
constexpr std::string_view kAfterRoot = "\"\n}\n";
constexpr std::string_view kEnd = "\n}\n";  // of a session.json without a root

}  // namespace

std::string program_name() { return std::string("haarlight ") + HAARLIGHT_VERSION; }

std::vector<std::string> list_sealed_names(const fs::path& folder, const SessionInfo& info) {
  std::set<std::string> frames;
  for (const FrameRecord& frame : info.frames) {
    frames.insert(frame.file);
  }
  std::set<std::string> names;
  const auto add = [&names](const std::string& name, const fs::path& path) {
    std::error_code ignored;
    if (fs::is_regular_file(fs::symlink_status(path, ignored))) {
      names.insert(name);
    }
  };
  for (const char* name : {"start.json", "plan.json", "rig.toml"}) {
    add(name, folder / name);
  }
  for (const char* const part : {"frames", "aside"}) {
    std::error_code error;
    for (fs::recursive_directory_iterator it(folder / part, error), end; !error && it != end;
         it.increment(error)) {
      const std::string name = it->path().lexically_relative(folder).generic_string();
      if (frames.count(name) == 0) {
        add(name, it->path());
      }
    }
    if (error && error != std::errc::no_such_file_or_directory) {
      throw Error("cannot be listed: " + error.message(), (folder / part).string(),
                  "check the folder's rights", ExitCode::io);
    }
  }
  return {names.begin(), names.end()};
}

void seal_session(const fs::path& folder, const std::string& journal_text, SessionInfo& info) {
  info.files.clear();
  for (const std::string& name : list_sealed_names(folder, info)) {
    info.files.push_back({name, to_hex(leaf_hash(name, MappedFile(folder / name).bytes()))});
  }
  if (!journal_text.empty()) {
    info.files.push_back({"journal.sqlite", to_hex(leaf_hash("journal.sqlite", journal_text))});
  }
  std::sort(info.files.begin(), info.files.end(),
            [](const SealedFile& a, const SealedFile& b) { return a.name < b.name; });
  info.root.clear();
  std::string_view text;
  const std::string json = session_info_to_json(info);
  text = json;
  text.remove_suffix(kEnd.size());
  info.root = root_of(text, info);
}

std::string_view sealed_part(std::string_view session_json) {
  const std::size_t n = kBeforeRoot.size() + kDigits + kAfterRoot.size();
  if (session_json.size() < n || !session_json.ends_with(kAfterRoot) ||
      !session_json.substr(session_json.size() - n).starts_with(kBeforeRoot)) {
    return {};
  }
  return session_json.substr(0, session_json.size() - n);
}

std::string root_of(std::string_view sealed_part, const SessionInfo& info) {
  std::vector<Sha256Digest> leaves;
  leaves.reserve(1 + info.frames.size() + info.files.size());
  leaves.push_back(leaf_hash("session.json", sealed_part));
  for (const FrameRecord& frame : info.frames) {
    leaves.push_back(sha256_from_hex(frame.sha256));
  }
  for (const SealedFile& file : info.files) {
    leaves.push_back(sha256_from_hex(file.sha256));
  }
  return to_hex(merkle_root(leaves));
}

}  // namespace haarlight::session
