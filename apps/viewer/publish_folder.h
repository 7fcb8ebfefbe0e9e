// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>

/// @file
/// A folder that any web server shows: the viewer's own page, and files instead of the
/// viewer's server. Layout: docs/reference/http-api.md, "A published folder".

namespace haarlight::apps {

/// What the page says of itself; empty: nothing.
struct PublishNotes {
  std::string title;
  std::string description;
  std::string author;
  std::string licence;
  std::optional<double> mm_per_pixel;
  std::string photographed = {};  ///< words_of() the photographs' facts
};

/// The notes as the page reads them, JSON.
/// @throws Error(usage)  a text that is not UTF-8
[[nodiscard]] std::string notes_text(const PublishNotes& notes);

/// The bytes as gzip, whose checksum the browser tests. The same bytes give the same file.
[[nodiscard]] std::string gzipped(std::string_view bytes);
/// The checksum of zip and PNG, as 8 lower-case hexadecimal digits.
[[nodiscard]] std::string crc32_of(std::string_view bytes);

/// Writes a file that commit() of its folder makes durable. @throws Error(io)
void write_plain_file(const std::filesystem::path& path, std::string_view bytes);

/// A folder that gets its name when it is whole; an uncommitted one is removed. Not movable.
class PublishFolder {
 public:
  /// @param web_folder  of the pages, as installed
  /// @param replaces    an older folder of ours may stand there (--force)
  /// @throws Error(usage)  something stands there; with `replaces`, something else than a
  ///                       published folder
  PublishFolder(std::filesystem::path target, std::filesystem::path web_folder, bool replaces);
  ~PublishFolder();
  PublishFolder(const PublishFolder&) = delete;
  PublishFolder& operator=(const PublishFolder&) = delete;

  /// A file below the folder; folders are made as they are needed. @throws Error(io)
  void add(const std::string& name, std::string_view bytes);
  /// A file of data, below a folder whose name its content decides: `name` + ".bin", gzip.
  /// @return  bytes it has on the disk
  std::uint64_t add_data(const std::string& name, std::string_view bytes);

  /// Adds the page and what tells it about the data, and gives the folder its name.
  /// @param page   "index.html" or "reflectance.html" of the viewer
  /// @param about  what the page asks first, JSON; `notes` and `files` are added: bytes of each
  /// add_data()
  /// @throws Error(io), Error  the pages are of another version
  void commit(const std::string& page, const std::string& about, const PublishNotes& notes);

  [[nodiscard]] std::uint64_t bytes() const noexcept { return bytes_; }
  [[nodiscard]] std::uint64_t files() const noexcept { return n_files_; }

 private:
  std::filesystem::path target_;
  std::filesystem::path web_;
  std::filesystem::path work_;
  std::string listed_;  ///< JSON members of `files`, without the braces
  std::uint64_t bytes_ = 0;
  std::uint64_t n_files_ = 0;
};

/// One of the viewer's pages as a file that stands beside its folder viewer/.
/// @param data   attribute of the page's mark: folder, bytes and checksum of about.json
/// @throws Error(internal)  not a page of this version
[[nodiscard]] std::string published_page(std::string page, const std::string& data,
                                         const PublishNotes& notes);

struct CopiedFiles {
  std::uint64_t bytes = 0;
  std::uint64_t files = 0;
};
/// Copies what a published page loads to the folder viewer/ beside it.
CopiedFiles copy_page_files(const std::filesystem::path& web_folder,
                            const std::filesystem::path& to);

}  // namespace haarlight::apps
