// SPDX-License-Identifier: Apache-2.0
#include "apps/viewer/publish_folder.h"

#include <array>
#include <cerrno>
#include <cstdio>
#include <span>
#include <system_error>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <unistd.h>
#include <zlib.h>

#include "core/markup.h"
#include "core/report.h"
#include "core/text_limits.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"

namespace haarlight::apps {

namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

constexpr const char* kMark = "published.json";  ///< by which a folder is known as ours
constexpr const char* kData = "data";            ///< until its content is known
constexpr std::array<const char*, 2> kShared{"style.css", "icon.svg"};

[[noreturn]] void throw_io(const std::string& what, const fs::path& path, int error) {
  throw Error(fmt::format("{}: {}", what, std::generic_category().message(error)),
              path.string(), "check the disk's room and the folder's rights", ExitCode::io);
}

bool is_ours(const fs::path& folder) {
  std::error_code ignored;
  return fs::is_regular_file(folder / kMark, ignored);
}

/// Swaps the two where the system can, so that the target is never missing.
void replace_folder(const fs::path& from, const fs::path& to) {
  if (::renameat2(AT_FDCWD, from.c_str(), AT_FDCWD, to.c_str(), RENAME_EXCHANGE) == 0) {
    std::error_code ignored;
    fs::remove_all(from, ignored);
    return;
  }
  fs::path former = to;
  former += fmt::format(".old{}", ::getpid());
  std::error_code error;
  const bool is_there = fs::exists(to, error);
  if (is_there && ::rename(to.c_str(), former.c_str()) != 0) {
    throw_io("rename", to, errno);
  }
  if (::rename(from.c_str(), to.c_str()) != 0) {
    const int failure = errno;
    if (is_there) {
      (void)::rename(former.c_str(), to.c_str());
    }
    throw_io("rename", to, failure);
  }
  fs::remove_all(former, error);
}

/// Everything below it reaches the disk. @throws Error(io)
void sync_folder(const fs::path& folder) {
  const Fd fd(::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (!fd.is_open() || ::syncfs(fd.get()) != 0) {
    throw_io("sync", folder, errno);
  }
}

void replace_all(std::string& text, std::string_view from, std::string_view to,
                 const char* where) {
  std::size_t at = text.find(from);
  if (at == std::string::npos) {
    throw Error(fmt::format("the page has no {}", from), where,
                "install the program whole: its pages are of another version",
                ExitCode::internal);
  }
  for (; at != std::string::npos; at = text.find(from, at + to.size())) {
    text.replace(at, from.size(), to);
  }
}

}  // namespace

std::string notes_text(const PublishNotes& notes) {
  const Json json = {{"title", notes.title},
                     {"description", notes.description},
                     {"author", notes.author},
                     {"licence", notes.licence},
                     {"mm_per_pixel", notes.mm_per_pixel ? Json(*notes.mm_per_pixel) : Json()},
                     {"photographed", notes.photographed}};
  try {
    return json.dump();
  } catch (const Json::exception&) {
    throw Error("a text that is not UTF-8", "--title, --description, --author, --licence",
                "set the terminal to UTF-8", ExitCode::usage);
  }
}

std::string gzipped(std::string_view bytes) {
  z_stream stream{};
  constexpr int kGzip = 15 + 16;  // the largest window, and gzip's frame
  constexpr int kLevel = 6;
  if (::deflateInit2(&stream, kLevel, Z_DEFLATED, kGzip, 8, Z_DEFAULT_STRATEGY) != Z_OK) {
    throw Error("zlib refused", "publish", "report it", ExitCode::internal);
  }
  std::string packed(::deflateBound(&stream, static_cast<uLong>(bytes.size())), '\0');
  // zlib reads only, but says so nowhere.
  stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(bytes.data()));
  stream.avail_in = static_cast<uInt>(bytes.size());
  stream.next_out = reinterpret_cast<Bytef*>(packed.data());
  stream.avail_out = static_cast<uInt>(packed.size());
  const int ended = ::deflate(&stream, Z_FINISH);
  packed.resize(stream.total_out);
  ::deflateEnd(&stream);
  if (ended != Z_STREAM_END) {
    throw Error("zlib refused", "publish", "report it", ExitCode::internal);
  }
  return packed;
}

std::string crc32_of(std::string_view bytes) {
  return fmt::format("{:08x}", ::crc32(0, reinterpret_cast<const Bytef*>(bytes.data()),
                                       static_cast<uInt>(bytes.size())));
}

void write_plain_file(const fs::path& path, std::string_view bytes) {
  const Fd fd(::open(path.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644));
  if (!fd.is_open()) {
    throw_io("create", path, errno);
  }
  for (std::size_t at = 0; at < bytes.size();) {
    const ssize_t n = ::write(fd.get(), bytes.data() + at, bytes.size() - at);
    if (n < 0 && errno == EINTR) {
      continue;
    }
    if (n <= 0) {
      throw_io("write", path, n < 0 ? errno : EIO);
    }
    at += static_cast<std::size_t>(n);
  }
}

CopiedFiles copy_page_files(const fs::path& web_folder, const fs::path& to) {
  CopiedFiles copied;
  std::error_code error;
  fs::create_directories(to / "viewer", error);
  if (error) {
    throw_io("make the folder", to / "viewer", error.value());
  }
  const auto copy = [&](const fs::path& from) {
    const std::string bytes = read_file(from);
    write_plain_file(to / "viewer" / from.filename(), bytes);
    copied.bytes += bytes.size();
    ++copied.files;
  };
  for (const char* name : kShared) {
    copy(web_folder / name);
  }
  for (const auto& entry : fs::directory_iterator(web_folder / "viewer")) {
    const std::string ending = entry.path().extension().string();
    if (ending == ".js" || ending == ".css") {
      copy(entry.path());
    }
  }
  return copied;
}

std::string published_page(std::string page, const std::string& data,
                           const PublishNotes& notes) {
  const char* const where = "the viewer's page";
  replace_all(page, "\"../", "\"viewer/", where);
  replace_all(page, "href=\"viewer.css\"", "href=\"viewer/viewer.css\"", where);
  replace_all(page, "<script type=\"module\" src=\"", "<script type=\"module\" src=\"viewer/",
              where);
  if (!notes.title.empty()) {
    replace_all(page, "<title>haarlight view</title>",
                fmt::format("<title>{}</title>", escaped(notes.title)), where);
  }
  std::string head = fmt::format(
      "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'self'; img-src "
      "'self' data: blob:; base-uri 'none'; form-action 'self'\">\n"
      "<meta name=\"haarlight-published\" content=\"{}\">\n",
      escaped(data));
  const std::array<std::pair<const char*, const std::string*>, 2> kTold{
      {{"description", &notes.description}, {"author", &notes.author}}};
  for (const auto& told : kTold) {
    if (!told.second->empty()) {
      head +=
          fmt::format("<meta name=\"{}\" content=\"{}\">\n", told.first, escaped(*told.second));
    }
  }
  replace_all(page, "</head>", head + "</head>", where);
  replace_all(
      page, "<div id=\"banners\">",
      "<div id=\"banners\"><div id=\"unserved\" class=\"banner bad\">This page has not "
      "begun. It needs a web server: opened as a file it stays empty. In its folder run "
      "<code>python3 -m http.server</code> and open http://localhost:8000/; on a server, "
      "copy the folder again, whole.</div>",
      where);
  return page;
}

PublishFolder::PublishFolder(fs::path target, fs::path web_folder, bool replaces)
    : target_(std::move(target)), web_(std::move(web_folder)) {
  if (!target_.has_filename()) {
    target_ = target_.parent_path();  // "shown/"
  }
  std::error_code ignored;
  const bool is_empty_folder =
      fs::is_directory(target_, ignored) && fs::is_empty(target_, ignored);
  if (!is_empty_folder) {
    require_absent(target_, replaces);
    if (fs::exists(target_, ignored) && !is_ours(target_)) {
      throw Error("--force replaces a published folder only, and this is none",
                  target_.string(), "name another folder, or remove this one yourself",
                  ExitCode::usage);
    }
  }
  work_ = target_;
  work_ += fmt::format(".tmp{}", ::getpid());
  fs::remove_all(work_, ignored);
  std::error_code error;
  fs::create_directories(work_ / kData, error);
  if (error) {
    throw_io("make the folder", work_, error.value());
  }
}

PublishFolder::~PublishFolder() {
  std::error_code ignored;
  fs::remove_all(work_, ignored);
}

void PublishFolder::add(const std::string& name, std::string_view bytes) {
  const fs::path path = work_ / name;
  std::error_code error;
  fs::create_directories(path.parent_path(), error);
  if (error) {
    throw_io("make the folder", path.parent_path(), error.value());
  }
  write_plain_file(path, bytes);
  bytes_ += bytes.size();
  ++n_files_;
}

std::uint64_t PublishFolder::add_data(const std::string& name, std::string_view bytes) {
  const std::string packed = gzipped(bytes);
  add(fmt::format("{}/{}.bin", kData, name), packed);
  listed_ += fmt::format("{}\"{}\":{}", listed_.empty() ? "" : ",", name, packed.size());
  return packed.size();
}

void PublishFolder::commit(const std::string& page, const std::string& about_given,
                           const PublishNotes& notes) {
  Json about = parse_json<Json>(about_given, "about.json");
  about["notes"] = parse_json<Json>(notes_text(notes), "the notes");
  about["files"] = parse_json<Json>("{" + listed_ + "}", "the files");
  const std::string text = about.dump();
  // The data's folder is named by what it says: a browser that keeps files never mixes two.
  const std::string folder = content_hash(text).substr(0, 16);
  std::error_code error;
  fs::rename(work_ / kData, work_ / folder, error);
  if (error) {
    throw_io("rename", work_ / kData, error.value());
  }
  add(folder + "/about.json", text);
  const CopiedFiles copied = copy_page_files(web_, work_);
  bytes_ += copied.bytes;
  n_files_ += copied.files;
  add("index.html",
      published_page(read_file(web_ / "viewer" / page),
                     fmt::format("{} {} {}", folder, text.size(), crc32_of(text)), notes));
  const Json mark = {{"format", "haarlight published folder"},
                     {"version", 1},
                     {"program", std::string(kVersion)},
                     {"page", page},
                     {"data", folder},
                     {"notes", about["notes"]}};
  add(kMark, mark.dump(2) + "\n");
  sync_folder(work_);
  replace_folder(work_, target_);
}

}  // namespace haarlight::apps
