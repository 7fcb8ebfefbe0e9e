// SPDX-License-Identifier: Apache-2.0
#include "haarlight/core/picture/picture_facts.h"

#include <array>
#include <cmath>
#include <cstdint>
#include <limits>

#include <fmt/format.h>

namespace haarlight {

namespace {

/// numerator / denominator, both as EXIF stores them.
using Ratio = std::array<std::uint32_t, 2>;

/// The last convergent of the number's continued fraction that fits EXIF's 32 bits with a
/// denominator of at most 10^6: 1/125 s stays exact.
std::optional<Ratio> ratio_of(std::optional<double> number) {
  constexpr double kMostDenominator = 1e6;
  constexpr auto kMost = static_cast<double>(std::numeric_limits<std::uint32_t>::max());
  if (!number || !(*number > 0.0) || !(*number <= kMost)) {
    return {};
  }
  std::array<double, 2> before = {0.0, 1.0};
  std::array<double, 2> now = {1.0, 0.0};
  double rest = *number;
  constexpr int kMostSteps = 40;
  for (int step = 0; step < kMostSteps; ++step) {
    const double whole = std::floor(rest);
    const std::array<double, 2> next = {whole * now[0] + before[0], whole * now[1] + before[1]};
    if (next[0] > kMost || next[1] > kMostDenominator) {
      break;
    }
    before = now;
    now = next;
    constexpr double kRounding = 1e-12;
    if (std::abs(now[0] / now[1] - *number) <= kRounding * *number) {
      break;
    }
    rest = 1.0 / (rest - whole);
  }
  if (!(now[0] > 0.0)) {
    return {};  // smaller than 10^-6
  }
  return Ratio{static_cast<std::uint32_t>(now[0]), static_cast<std::uint32_t>(now[1])};
}

/// Little-endian bytes.
class ExifWriter {
 public:
  void add(std::uint32_t value, int n_bytes) {
    for (int i = 0; i < n_bytes; ++i) {
      bytes_.push_back(static_cast<std::byte>(value >> (8 * i) & 0xffU));
    }
  }
  void add(const std::string& text) {
    for (const char c : text) {
      bytes_.push_back(static_cast<std::byte>(c));
    }
    bytes_.push_back(std::byte{0});
    if (bytes_.size() % 2 != 0) {  // values start at even offsets
      bytes_.push_back(std::byte{0});
    }
  }
  std::vector<std::byte> take() { return std::move(bytes_); }

 private:
  std::vector<std::byte> bytes_;
};

/// One entry of a directory; its value is a number, a text or a ratio.
struct ExifEntry {
  std::uint32_t tag = 0;
  std::uint32_t number = 0;
  std::uint32_t type = 0;
  std::string text;
  Ratio ratio{};
};

constexpr std::uint32_t kAscii = 2;
constexpr std::uint32_t kShort = 3;
constexpr std::uint32_t kLong = 4;
constexpr std::uint32_t kRational = 5;
constexpr std::uint32_t kUndefined = 7;

/// Values of up to four bytes are stored in the entry itself.
bool is_inline(const ExifEntry& entry) {
  return entry.type != kRational && (entry.type != kAscii || entry.text.size() < 4);
}

std::uint32_t count_of(const ExifEntry& entry) {
  switch (entry.type) {
    case kAscii:
      return static_cast<std::uint32_t>(entry.text.size()) + 1;
    case kUndefined:
      return 4;
    default:
      return 1;
  }
}

std::uint32_t bytes_behind(const ExifEntry& entry) {
  const std::uint32_t n = count_of(entry);
  return is_inline(entry) ? 0 : (entry.type == kRational ? 8 : n + n % 2);
}

std::uint32_t size_of(const std::vector<ExifEntry>& directory) {
  std::uint32_t size = 2 + 12 * static_cast<std::uint32_t>(directory.size()) + 4;
  for (const ExifEntry& entry : directory) {
    size += bytes_behind(entry);
  }
  return size;
}

/// @param at  where it begins, from the block's first byte
void write_directory(const std::vector<ExifEntry>& directory, std::uint32_t at,
                     ExifWriter& out) {
  out.add(static_cast<std::uint32_t>(directory.size()), 2);
  std::uint32_t behind = at + 2 + 12 * static_cast<std::uint32_t>(directory.size()) + 4;
  for (const ExifEntry& entry : directory) {
    out.add(entry.tag, 2);
    out.add(entry.type, 2);
    out.add(count_of(entry), 4);
    if (entry.type == kAscii && is_inline(entry)) {
      for (std::size_t i = 0; i < 4; ++i) {
        out.add(i < entry.text.size() ? static_cast<unsigned char>(entry.text[i]) : 0U, 1);
      }
    } else {
      out.add(is_inline(entry) ? entry.number : behind, 4);
    }
    behind += bytes_behind(entry);
  }
  out.add(0, 4);  // no further directory
  for (const ExifEntry& entry : directory) {
    if (entry.type == kAscii && !is_inline(entry)) {
      out.add(entry.text);
    } else if (entry.type == kRational) {
      out.add(entry.ratio[0], 4);
      out.add(entry.ratio[1], 4);
    }
  }
}

template <class T>
void keep_common(T& common, const T& other) {
  if (common != other) {
    common = T();
  }
}

}  // namespace

std::optional<double> camera_number(double number) noexcept {
  const bool is_one = number >= kLeastCameraNumber && number <= kMostCameraNumber;
  return is_one ? std::optional(number) : std::nullopt;
}

bool has_facts(const PictureFacts& facts) noexcept {
  return facts.exposure_s || facts.f_number || facts.iso || !facts.model.empty() ||
         !facts.taken.empty();
}

PictureFacts common_facts(std::span<const PictureFacts> pictures) {
  PictureFacts common = pictures.empty() ? PictureFacts() : pictures.front();
  common.orientation = 1;
  for (const PictureFacts& facts : pictures) {
    keep_common(common.exposure_s, facts.exposure_s);
    keep_common(common.f_number, facts.f_number);
    keep_common(common.iso, facts.iso);
    keep_common(common.model, facts.model);
    if (common.taken.empty() || (!facts.taken.empty() && facts.taken < common.taken)) {
      common.taken = facts.taken;
    }
  }
  return common;
}

std::string words_of(const PictureFacts& facts) {
  std::string words;
  const auto add = [&words](const std::string& word) {
    words += (words.empty() ? "" : ", ") + word;
  };
  if (!facts.model.empty()) {
    add(facts.model);
  }
  if (const std::optional<Ratio> time = ratio_of(facts.exposure_s)) {
    add((*time)[0] == 1 && (*time)[1] > 1 ? fmt::format("1/{} s", (*time)[1])
                                          : fmt::format("{:.3g} s", *facts.exposure_s));
  }
  if (facts.f_number) {
    add(fmt::format("f/{:.3g}", *facts.f_number));
  }
  if (facts.iso) {
    add(fmt::format("ISO {:.6g}", *facts.iso));
  }
  if (!facts.taken.empty()) {
    std::string taken = facts.taken;
    for (const std::size_t colon : {std::size_t{4}, std::size_t{7}}) {
      if (colon < taken.size() && taken[colon] == ':') {
        taken[colon] = '-';
      }
    }
    add(taken);
  }
  return words;
}

std::vector<std::byte> exif_block(const PictureFacts& facts) {
  if (!has_facts(facts)) {
    return {};
  }
  // Entries are sorted by tag.
  std::vector<ExifEntry> detail;
  if (const std::optional<Ratio> time = ratio_of(facts.exposure_s)) {
    detail.push_back({.tag = 0x829a, .type = kRational, .text = {}, .ratio = *time});
  }
  if (const std::optional<Ratio> aperture = ratio_of(facts.f_number)) {
    detail.push_back({.tag = 0x829d, .type = kRational, .text = {}, .ratio = *aperture});
  }
  constexpr double kMostIso = 65534.0;  // 65535: "larger"
  if (facts.iso && *facts.iso >= 1.0 && *facts.iso <= kMostIso) {
    detail.push_back({.tag = 0x8827,
                      .number = static_cast<std::uint32_t>(*facts.iso),
                      .type = kShort,
                      .text = {}});
  }
  constexpr std::uint32_t kVersion = 0x32333230;  // "0232"
  detail.push_back({.tag = 0x9000, .number = kVersion, .type = kUndefined, .text = {}});
  if (!facts.taken.empty()) {
    detail.push_back({.tag = 0x9003, .type = kAscii, .text = facts.taken});
  }
  std::vector<ExifEntry> first;
  if (!facts.model.empty()) {
    first.push_back({.tag = 0x110, .type = kAscii, .text = facts.model});
  }
  first.push_back({.tag = 0x8769, .type = kLong, .text = {}});
  constexpr std::uint32_t kHead = 8;
  first.back().number = kHead + size_of(first);

  ExifWriter out;
  constexpr std::uint32_t kLittleEndian = 0x4949;
  constexpr std::uint32_t kTiff = 42;
  out.add(kLittleEndian, 2);
  out.add(kTiff, 2);
  out.add(kHead, 4);
  write_directory(first, kHead, out);
  write_directory(detail, first.back().number, out);
  return out.take();
}

}  // namespace haarlight
