// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/basis_check.h"

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <iostream>
#include <random>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "tests/drawn_seed.h"
#include "tests/relight/basis/made_stack.h"
#include "tests/temporary_folder.h"

/// @file
/// check_basis against everything that happens to files on their way: each kind of damage at
/// random offsets (HAARLIGHT_SEED replays them).

namespace haarlight::relight {
namespace {

using test::made_source;
using test::make_stack;

std::string make_file(const CompressOptions& options) {
  const testing::TemporaryFolder folder;
  const auto path = folder / "good.hlb";
  const MemoryStack stack = make_stack({.width = 70, .height = 66, .grid = 8});
  const MemoryStack plate =
      make_stack({.width = 70, .height = 66, .grid = 8, .has_sphere = false});
  (void)compress_stack(made_source(stack, 8, &plate), path, options);
  return read_file(path);
}

using Random = std::mt19937_64;

std::size_t below(Random& random, std::size_t n) {
  return std::uniform_int_distribution<std::size_t>(0, n - 1)(random);
}

std::uint64_t number_at(const std::string& bytes, std::size_t offset) {
  std::uint64_t value = 0;
  std::memcpy(&value, bytes.data() + offset, sizeof value);
  return value;
}

void put_number(std::string& bytes, std::size_t offset, std::uint64_t value) {
  std::memcpy(bytes.data() + offset, &value, sizeof value);
}

std::uint64_t checksum_of(std::string_view bytes) {
  return block_checksum(std::as_bytes(std::span(bytes.data(), bytes.size())));
}

/// Makes the checksums of index and preamble right again: damage by a program, not by a disk.
void sign(std::string& bytes) {
  for (const std::size_t part : {24U, 48U, 72U}) {
    const std::string_view found =
        std::string_view(bytes).substr(number_at(bytes, part), number_at(bytes, part + 8));
    put_number(bytes, part + 16, checksum_of(found));
  }
  put_number(bytes, 16, bytes.size());
  put_number(bytes, 96, checksum_of(std::string_view(bytes).substr(0, 96)));
}

/// An offset within a part of the file: 24 header, 48 index, 72 tables, 0 the blocks.
std::size_t offset_in(const std::string& bytes, std::size_t part, Random& random) {
  if (part == 0) {
    return 104 + below(random, number_at(bytes, 72) - 104);  // blocks stand before the tables
  }
  return number_at(bytes, part) + below(random, number_at(bytes, part + 8));
}

/// The offset of the index entry of a random block that has bytes.
std::size_t entry_of_block(const std::string& bytes, Random& random) {
  const std::size_t n = number_at(bytes, 56) / 24;
  for (;;) {
    const std::size_t entry = number_at(bytes, 48) + 24 * below(random, n);
    std::uint32_t size = 0;
    std::memcpy(&size, bytes.data() + entry + 16, sizeof size);
    if (size >= 16) {
      return entry;
    }
  }
}

struct Damage {
  const char* name;
  std::function<void(std::string&, Random&)> make;
};

void flip_bit(std::string& bytes, std::size_t at, Random& random) {
  bytes[at] = static_cast<char>(bytes[at] ^ (1 << below(random, 8)));
}

void fill(std::string& bytes, std::size_t at, std::size_t n, char value) {
  for (std::size_t i = at; i < std::min(bytes.size(), at + n); ++i) {
    bytes[i] = value;
  }
}

/// By a disk or a cable: bytes changed in place.
std::vector<Damage> damage_in_place() {
  return {
      {"bit of the preamble", [](auto& b, auto& r) { flip_bit(b, 8 + below(r, 96), r); }},
      {"bit of the magic", [](auto& b, auto& r) { flip_bit(b, below(r, 8), r); }},
      {"bit of the header", [](auto& b, auto& r) { flip_bit(b, offset_in(b, 24, r), r); }},
      {"bit of the index", [](auto& b, auto& r) { flip_bit(b, offset_in(b, 48, r), r); }},
      {"bit of the tables", [](auto& b, auto& r) { flip_bit(b, offset_in(b, 72, r), r); }},
      {"bit of a block", [](auto& b, auto& r) { flip_bit(b, offset_in(b, 0, r), r); }},
      {"first byte of the blocks", [](auto& b, auto& r) { flip_bit(b, 104, r); }},
      {"last byte of the blocks",
       [](auto& b, auto& r) { flip_bit(b, number_at(b, 72) - 1, r); }},
      {"last byte", [](auto& b, auto& r) { flip_bit(b, b.size() - 1, r); }},
      {"two bits of one block",
       [](auto& b, auto& r) {
         const std::size_t at = offset_in(b, 0, r);
         b[at] = static_cast<char>(b[at] ^ 0x21);
       }},
      {"512 zeros", [](auto& b, auto& r) { fill(b, offset_in(b, 0, r), 512, '\0'); }},
      {"a page of zeros",
       [](auto& b, auto& r) { fill(b, offset_in(b, 0, r) / 4096 * 4096, 4096, '\0'); }},
      {"512 bytes of ones", [](auto& b, auto& r) { fill(b, offset_in(b, 0, r), 512, '\xff'); }},
      {"all blocks zeros", [](auto& b, auto&) { fill(b, 104, number_at(b, 72) - 104, '\0'); }},
      {"the end as zeros",
       [](auto& b, auto& r) {
         fill(b, b.size() - 1 - below(r, b.size() / 2), b.size(), '\0');
       }},
  };
}

/// By a copy or a transfer: bytes lost, added, moved.
std::vector<Damage> damage_of_copies() {
  return {
      {"cut anywhere", [](auto& b, auto& r) { b.resize(below(r, b.size())); }},
      {"cut by one byte", [](auto& b, auto&) { b.resize(b.size() - 1); }},
      {"one byte more", [](auto& b, auto&) { b += '\0'; }},
      {"itself behind it", [](auto& b, auto&) { b += std::string(b); }},
      {"a byte lost", [](auto& b, auto& r) { b.erase(offset_in(b, 0, r), 1); }},
      {"a byte lost, the size right",
       [](auto& b, auto& r) {
         b.erase(offset_in(b, 0, r), 1);
         b += '\0';
       }},
      {"a byte put in", [](auto& b, auto& r) { b.insert(offset_in(b, 0, r), 1, 'x'); }},
      {"two sectors exchanged",
       [](auto& b, auto& r) {
         const std::size_t n = (b.size() - 104) / 3;
         const std::size_t at = 104 + below(r, n);
         std::swap_ranges(b.begin() + static_cast<std::ptrdiff_t>(at),
                          b.begin() + static_cast<std::ptrdiff_t>(at + n),
                          b.begin() + static_cast<std::ptrdiff_t>(at + n));
       }},
      {"a sector twice",
       [](auto& b, auto& r) {
         const std::size_t at = offset_in(b, 0, r);
         const std::size_t n = std::min<std::size_t>(300, at - 104);
         b.replace(at, n, b.substr(at - n, n));
       }},
      {"line ends as on Windows",
       [](auto& b, auto&) {
         for (std::size_t at = 0; (at = b.find('\n', at)) != std::string::npos; at += 2) {
           b.insert(at, 1, '\r');
         }
       }},
      {"seven bits per byte",
       [](auto& b, auto&) {
         for (char& c : b) {
           c = static_cast<char>(c & 0x7f);
         }
       }},
      {"random bytes",
       [](auto& b, auto& r) {
         const std::size_t at = offset_in(b, 0, r);
         for (std::size_t i = at; i < std::min(b.size(), at + 64); ++i) {
           b[i] = static_cast<char>(below(r, 256));
         }
         b[at] = static_cast<char>(b[at] ^ 1);
       }},
  };
}

/// By a program that signs what it writes.
std::vector<Damage> signed_damage() {
  return {
      {"a block's checksum, signed",
       [](auto& b, auto& r) {
         flip_bit(b, entry_of_block(b, r) + 8, r);
         sign(b);
       }},
      {"a block's offset, signed",
       [](auto& b, auto& r) {
         const std::size_t entry = entry_of_block(b, r);
         put_number(b, entry, number_at(b, entry) + 1);
         sign(b);
       }},
      {"a block's size, signed",
       [](auto& b, auto& r) {
         const std::size_t entry = entry_of_block(b, r);
         const std::uint64_t size = number_at(b, entry + 16) - 1;
         put_number(b, entry + 16, size);
         put_number(
             b, entry + 8,
             checksum_of(std::string_view(b).substr(number_at(b, entry), size & 0xffffffffU)));
         sign(b);
       }},
      {"a block's bytes, signed",
       [](auto& b, auto& r) {
         const std::size_t entry = entry_of_block(b, r);
         const std::size_t at = number_at(b, entry);
         const std::size_t size = number_at(b, entry + 16) & 0xffffffffU;
         fill(b, at, size, '\xff');
         put_number(b, entry + 8, checksum_of(std::string_view(b).substr(at, size)));
         sign(b);
       }},
      {"a block that two entries share, signed",
       [](auto& b, auto& r) {
         const std::size_t one = entry_of_block(b, r);
         std::size_t other = one;
         while (other == one) {
           other = entry_of_block(b, r);
         }
         b.replace(one, 24, b.substr(other, 24));
         sign(b);
       }},
      {"bytes that belong to nothing, signed",
       [](auto& b, auto&) {
         b += "hidden";
         sign(b);
       }},
  };
}

std::vector<Damage> kinds_of_damage() {
  std::vector<Damage> all;
  for (const std::vector<Damage>& some :
       {damage_in_place(), damage_of_copies(), signed_damage()}) {
    all.insert(all.end(), some.begin(), some.end());
  }
  return all;
}

void check(const std::string& bytes) {
  check_basis(
      BasisFile::from_bytes(std::as_bytes(std::span(bytes.data(), bytes.size())), "made.hlb"));
}

/// What opening alone finds, as `check` did before it read the blocks.
bool opens(const std::string& bytes) {
  try {
    (void)BasisFile::from_bytes(std::as_bytes(std::span(bytes.data(), bytes.size())),
                                "made.hlb");
    return true;
  } catch (const Error&) {
    return false;
  }
}

TEST(BasisCheck, FindsEveryKindOfDamage) {
  const std::uint64_t first = testing::drawn_seed();
  const std::vector<Damage> kinds = kinds_of_damage();
  ASSERT_GE(kinds.size(), 24U);
  int n_opened = 0;
  for (const CompressOptions& options :
       {CompressOptions{.worst_pixel = 0.05}, CompressOptions{.relative_l2 = 0.0}}) {
    const std::string good = make_file(options);
    ASSERT_NO_THROW(check(good));
    for (std::size_t kind = 0; kind < kinds.size(); ++kind) {
      for (std::uint64_t i = 0; i < 8; ++i) {
        Random random(first + 1000 * kind + i);
        std::string bytes = good;
        kinds[kind].make(bytes, random);
        if (bytes == good) {
          continue;  // zeros where zeros were
        }
        n_opened += opens(bytes) ? 1 : 0;
        try {
          check(bytes);
          ADD_FAILURE() << "not found: " << kinds[kind].name << ", " << i;
        } catch (const Error& error) {
          EXPECT_THAT(error.where(), ::testing::HasSubstr("made.hlb")) << kinds[kind].name;
          EXPECT_FALSE(error.hint().empty()) << kinds[kind].name;
        }
      }
    }
  }
  std::cout << n_opened << " damaged files could be opened\n";
  EXPECT_GT(n_opened, 0) << "damage that only reading the blocks can find";
}

TEST(BasisCheck, NamesTheByte) {
  std::string bytes = make_file({.worst_pixel = 0.05});
  bytes[110] = static_cast<char>(bytes[110] ^ 1);
  try {
    check(bytes);
    FAIL() << "not found";
  } catch (const Error& error) {
    EXPECT_THAT(error.where(), ::testing::HasSubstr("made.hlb, tile 0, channel 0"));
    EXPECT_THAT(error.where(), ::testing::HasSubstr("from byte 104"));
  }
}

}  // namespace
}  // namespace haarlight::relight
