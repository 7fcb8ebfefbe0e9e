// SPDX-License-Identifier: Apache-2.0
#include "render/cell_mesh/vtu_arrays.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <vector>

#include <fmt/format.h>
#include <zlib.h>

#include "haarlight/core/error.h"
#include "render/cell_mesh/mesh_numbers.h"

namespace haarlight::render {

namespace {

/// zlib's densest code: 258 bytes for 2 bits.
constexpr std::size_t kMostInflation = 1032;

[[noreturn]] void refuse(const std::string& what, const std::string& hint) {
  throw Error(what, "", hint);
}

/// The value of a base64 character, or -1.
int base64_value(char c) {
  if (c >= 'A' && c <= 'Z') {
    return c - 'A';
  }
  if (c >= 'a' && c <= 'z') {
    return c - 'a' + 26;
  }
  if (c >= '0' && c <= '9') {
    return c - '0' + 52;
  }
  return c == '+' ? 62 : c == '/' ? 63 : -1;
}

/// Bytes one after the other. Base64 may end with = and begin anew, as it does between the sizes
/// and the blocks of a compressed array.
class ByteSource {
 public:
  ByteSource(std::string_view text, bool is_base64) : text_(text), is_base64_(is_base64) {}

  std::string take(std::size_t n) {
    if (n > most_left()) {
      refuse_short();
    }
    if (!is_base64_) {
      const std::string_view bytes = text_.substr(at_, n);
      at_ += n;
      return std::string(bytes);
    }
    std::string bytes;
    bytes.reserve(n);
    while (bytes.size() < n) {
      if (group_at_ == group_size_) {
        next_group();
      }
      const std::size_t some = std::min(n - bytes.size(), group_size_ - group_at_);
      bytes.append(group_.data() + group_at_, some);
      group_at_ += some;
    }
    return bytes;
  }

  [[nodiscard]] std::size_t most_left() const {
    const std::size_t left = text_.size() - at_;
    return is_base64_ ? left / 4 * 3 + group_size_ - group_at_ : left;
  }

 private:
  [[noreturn]] static void refuse_short() {
    refuse("the array ends too early", "the file is cut short: copy it again");
  }

  void next_group() {
    std::uint32_t bits = 0;
    int n_digits = 0;
    int n_pads = 0;
    while (n_digits + n_pads < 4) {
      if (at_ == text_.size()) {
        refuse_short();
      }
      const char c = text_[at_];
      ++at_;
      if (c == ' ' || c == '\n' || c == '\r' || c == '\t') {
        continue;
      }
      const int value = base64_value(c);
      if (c == '=' && n_digits >= 2) {
        ++n_pads;
      } else if (value >= 0 && n_pads == 0) {
        bits |= static_cast<std::uint32_t>(value)
                << (18U - 6U * static_cast<unsigned>(n_digits));
        ++n_digits;
      } else {
        refuse(fmt::format("byte {:#04x} in base64", static_cast<unsigned char>(c)),
               "the file is damaged: export the mesh again");
      }
    }
    group_ = {static_cast<char>(bits >> 16U), static_cast<char>((bits >> 8U) & 255U),
              static_cast<char>(bits & 255U)};
    group_size_ = static_cast<std::size_t>(n_digits - 1);
    group_at_ = 0;
  }

  std::string_view text_;
  bool is_base64_;
  std::size_t at_ = 0;
  std::array<char, 3> group_{};  ///< decoded: the bytes from group_at_ are not yet taken
  std::size_t group_size_ = 0;
  std::size_t group_at_ = 0;
};

class Decoder {
 public:
  Decoder(std::string_view text, bool is_base64, const ArrayCoding& coding,
          const ArraySize& size)
      : source_(text, is_base64), coding_(coding), size_(size) {}

  std::string decode() {
    if (coding_.is_compressed) {
      return inflate_blocks();
    }
    const std::size_t n = take_size();
    require_size(n);
    return source_.take(n);
  }

 private:
  std::size_t take_size() {
    const std::string bytes = source_.take(size_bytes());
    std::uint64_t size = 0;
    for (std::size_t i = 0; i < bytes.size(); ++i) {
      const std::size_t k = coding_.order == std::endian::little ? bytes.size() - 1 - i : i;
      size = size << 8U | static_cast<unsigned char>(bytes[k]);
    }
    return size;
  }

  [[nodiscard]] std::size_t size_bytes() const { return coding_.has_wide_sizes ? 8 : 4; }

  void require_size(std::size_t n) const {
    if (size_.n_bytes && n != *size_.n_bytes) {
      refuse(fmt::format("the array says {} bytes, its type and number of items make {}", n,
                         *size_.n_bytes),
             "byte_order or header_type of VTKFile may be wrong: export the mesh again");
    }
    if (n > size_.most_bytes) {
      refuse(fmt::format("the array says {} bytes, more than such a file is read for", n),
             "the file is damaged, or export its arrays less compressed");
    }
  }

  /// Number of blocks, bytes of a block, of the last one (0: a whole one), compressed bytes of
  /// each; then the blocks.
  std::string inflate_blocks() {
    const std::size_t n_blocks = take_size();
    const std::size_t block = take_size();
    const std::size_t last = take_size();
    if (n_blocks > source_.most_left() / size_bytes()) {
      refuse(fmt::format("the array says {} compressed blocks, more than the file holds",
                         n_blocks),
             "header_type of VTKFile may be wrong, or the file is cut short");
    }
    if (last > block ||
        (n_blocks > 0 && block > std::numeric_limits<std::size_t>::max() / n_blocks)) {
      refuse(fmt::format("compressed blocks of {} bytes, the last of {}", block, last),
             "the file is damaged: export the mesh again");
    }
    const auto size_of_block = [&](std::size_t i) {
      return i + 1 == n_blocks && last > 0 ? last : block;
    };
    require_size(n_blocks == 0 ? 0 : (n_blocks - 1) * block + size_of_block(n_blocks - 1));
    std::vector<std::size_t> compressed(n_blocks);
    for (std::size_t& n : compressed) {
      n = take_size();
    }
    std::string bytes;
    for (std::size_t i = 0; i < n_blocks; ++i) {
      inflate_block(compressed[i], size_of_block(i), bytes);
    }
    return bytes;
  }

  void inflate_block(std::size_t n_compressed, std::size_t n, std::string& bytes) {
    const std::string block = source_.take(n_compressed);
    if (n / kMostInflation > block.size()) {
      refuse(fmt::format("a block of {} bytes in {}: zlib packs no denser than {} to 1", n,
                         block.size(), kMostInflation),
             "the file is damaged: export the mesh again");
    }
    const std::size_t begin = bytes.size();
    bytes.resize(begin + n);
    uLongf n_inflated = n;
    const int end = uncompress(reinterpret_cast<Bytef*>(bytes.data() + begin), &n_inflated,
                               reinterpret_cast<const Bytef*>(block.data()), block.size());
    if (end != Z_OK || n_inflated != n) {
      refuse("a block that is not zlib's, or not of the size that the array says",
             "the file is damaged: export the mesh again");
    }
  }

  ByteSource source_;
  const ArrayCoding& coding_;
  const ArraySize& size_;
};

}  // namespace

std::string decode_array(std::string_view text, bool is_base64, const ArrayCoding& coding,
                         const ArraySize& size) {
  return Decoder(text, is_base64, coding, size).decode();
}

}  // namespace haarlight::render
