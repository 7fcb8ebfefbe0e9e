// SPDX-License-Identifier: Apache-2.0
#include "http/static_files.h"

#include <utility>

#include <fcntl.h>
#include <sys/stat.h>

namespace haarlight::http {

std::string_view content_type_of(std::string_view name) {
  constexpr std::pair<std::string_view, std::string_view> kTypes[] = {
      {".html", "text/html; charset=utf-8"},
      {".css", "text/css; charset=utf-8"},
      {".js", "text/javascript; charset=utf-8"},
      {".mjs", "text/javascript; charset=utf-8"},
      {".json", "application/json"},
      {".svg", "image/svg+xml"},
      {".png", "image/png"},
      {".jpg", "image/jpeg"},
      {".ico", "image/x-icon"},
      {".txt", "text/plain; charset=utf-8"},
      {".wasm", "application/wasm"},
  };
  for (const auto& [ending, type] : kTypes) {
    if (name.size() > ending.size() && name.substr(name.size() - ending.size()) == ending) {
      return type;
    }
  }
  return "application/octet-stream";
}

std::optional<StaticFile> open_static_file(const std::filesystem::path& folder,
                                           const std::vector<std::string>& segments) {
  const std::vector<std::string> names =
      segments.empty() ? std::vector<std::string>{"index.html"} : segments;
  for (const std::string& name : names) {
    if (name.empty() || name[0] == '.' ||
        name.find_first_of(std::string_view("/\\\0", 3)) != std::string::npos) {
      return std::nullopt;
    }
  }
  Fd at(::open(folder.c_str(), O_PATH | O_DIRECTORY | O_CLOEXEC));
  for (std::size_t i = 0; i < names.size() && at.is_open(); ++i) {
    const bool is_last = i + 1 == names.size();
    // O_NONBLOCK: opening a FIFO must not hang the server; it is refused below.
    const int flags = is_last ? O_RDONLY | O_NONBLOCK : O_PATH | O_DIRECTORY;
    at.reset(::openat(at.get(), names[i].c_str(), flags | O_NOFOLLOW | O_CLOEXEC));
  }
  struct stat status {};
  if (!at.is_open() || ::fstat(at.get(), &status) != 0 || !S_ISREG(status.st_mode)) {
    return std::nullopt;
  }
  return StaticFile{std::move(at), static_cast<std::uint64_t>(status.st_size),
                    std::string(content_type_of(names.back()))};
}

}  // namespace haarlight::http
