// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <bit>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

/// @file
/// The bytes of a gmsh file from front to back: lines, and numbers as text or as they are.

namespace haarlight::render {

/// How the sections after $MeshFormat hold their numbers.
struct GmshCoding {
  bool is_binary = false;
  std::endian order = std::endian::little;
  std::size_t size_bytes = 8;  ///< of a count or a tag in binary: 4 or 8
};

/// Numbers of one item: what they take at least tells how many items the bytes can hold.
struct GmshItem {
  std::size_t n_sizes = 0;  ///< counts and tags
  std::size_t n_ints = 0;   ///< of 4 bytes
  std::size_t n_reals = 0;  ///< of 8 bytes
};

/// All that takes throws Error at the end of the bytes, and at what is not as asked for.
class GmshCursor {
 public:
  /// @param name  of the file, in errors; it must live as long as this
  GmshCursor(std::string_view bytes, const std::string& name) : bytes_(bytes), name_(name) {}

  void set_coding(const GmshCoding& coding) { coding_ = coding; }
  [[nodiscard]] std::size_t at() const { return at_; }
  /// Where the next number begins, for errors.
  std::size_t next_at();
  /// name:line in text, "name: byte offset" in binary.
  [[nodiscard]] std::string location(std::size_t at) const;
  [[noreturn]] void fail(const std::string& what, const std::string& hint,
                         std::size_t at) const;

  /// Skips white space. @return  whether there is no more
  bool is_at_end();
  /// What is left of the line, without white space around it; the line is done then.
  std::string_view take_line();
  /// Skips past the line that is `mark` alone, such as $EndEntities.
  /// @param from  of the section, in errors
  void skip_past(const std::string& mark, std::size_t from);
  /// A number of a section's head, which is text in either coding.
  std::uint64_t take_text_count();
  std::int64_t take_text_integer();
  double take_text_real();

  std::uint64_t take_size();
  std::int64_t take_int();
  double take_real();
  /// @param what    "nodes" or the like
  /// @throws Error  the bytes that are left can't hold `n` such items
  void require_room(std::uint64_t n, const GmshItem& item, std::string_view what) const;

 private:
  std::string_view take_word();
  std::string_view take_bytes(std::size_t n);

  std::string_view bytes_;
  const std::string& name_;
  std::size_t at_ = 0;
  GmshCoding coding_;
};

}  // namespace haarlight::render
