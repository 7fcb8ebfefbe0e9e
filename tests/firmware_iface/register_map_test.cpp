// SPDX-License-Identifier: Apache-2.0
#include "haarlight/firmware_iface/register_map.h"

#include <algorithm>
#include <string>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "firmware_iface/register_codec.h"
#include "haarlight/core/files.h"
#include "tests/firmware_iface/controller_fixture.h"

namespace haarlight::firmware_iface {
namespace {

using registers::RegisterRow;
using registers::Space;

std::string table_of(Space space) {
  std::string text = "| address | count | name | unit | meaning |\n|---|---|---|---|---|\n";
  for (const RegisterRow& row : registers::kRegisterMap) {
    if (row.space == space) {
      text += fmt::format("| {:#06x} | {} | `{}` | {} | {} |\n", row.address,
                          row.count == 0 ? "elements" : std::to_string(row.count), row.name,
                          row.unit, row.meaning);
    }
  }
  return text;
}

TEST(RegisterMap, DocumentationHasTheTablesOfTheHeader) {
  const std::string page = read_file(HAARLIGHT_SOURCE_DIR "/docs/reference/register-map.md");
  for (const Space space :
       {Space::coil, Space::discrete_input, Space::input_register, Space::holding_register}) {
    const std::string table = table_of(space);
    EXPECT_NE(page.find(table), std::string::npos)
        << "docs/reference/register-map.md should contain:\n"
        << table;
  }
}

TEST(RegisterMap, RowsDoNotOverlap) {
  for (const RegisterRow& a : registers::kRegisterMap) {
    for (const RegisterRow& b : registers::kRegisterMap) {
      if (&a != &b && a.space == b.space) {
        EXPECT_TRUE(a.address + a.count <= b.address || b.address + b.count <= a.address)
            << a.name << " and " << b.name;
      }
    }
  }
  EXPECT_LE(registers::holding::kLevels + registers::kMaxElements, 65536);
}

TEST(RegisterMap, EveryRowCanBeReadFromAController) {
  LightController c(wide_config(1024), 1, 0);
  for (const RegisterRow& row : registers::kRegisterMap) {
    std::vector<std::uint16_t> words(static_cast<std::size_t>(std::max(row.count, 1)));
    std::array<bool, 1> bit{};
    auto answer = registers::Exception::illegal_function;
    switch (row.space) {
      case Space::coil:
        answer = c.read_coils(row.address, bit, 0);
        break;
      case Space::discrete_input:
        answer = c.read_discrete(row.address, bit, 0);
        break;
      case Space::input_register:
        answer = c.read_input(row.address, words, 0);
        break;
      case Space::holding_register:
        answer = c.read_holding(row.address, words, 0);
        break;
    }
    EXPECT_EQ(answer, registers::Exception::none) << row.name;
  }
}

TEST(RegisterCodec, IdentityOfSomethingElseIsAFault) {
  std::array<std::uint16_t, registers::input::kIdentityCount> words{};
  EXPECT_FALSE(decode_identity(words));  // no magic
  words[registers::input::kMagic] = registers::kMagic;
  words[registers::input::kMapVersion] = 2;
  EXPECT_FALSE(decode_identity(words));  // another map
  words[registers::input::kMapVersion] = registers::kMapVersion;
  EXPECT_FALSE(decode_identity(words));  // no elements
  words[registers::input::kElements] = 1024;
  EXPECT_TRUE(decode_identity(words));
  EXPECT_FALSE(decode_identity(std::span(words).first(5)));
  words[registers::input::kElements] = 65535;
  EXPECT_FALSE(decode_identity(words));
}

TEST(RegisterCodec, StatusThatContradictsItselfIsAFault) {
  std::array<std::uint16_t, registers::input::kStatusCount> words{};
  words[registers::input::kStatusBits - registers::input::kStatusFirst] =
      registers::kStatusDark;
  EXPECT_TRUE(decode_status(words));
  words[registers::input::kShownSum - registers::input::kStatusFirst] = 1;
  EXPECT_FALSE(decode_status(words));
  EXPECT_FALSE(decode_status({}));
}

TEST(RegisterCodec, StatusKeepsItsSigns) {
  LightController c(wide_config(4), 0xDEADBEEF, 0);
  c.set_temperature(-12.5, 0);
  const StatusBlock block = status_of(c, 0);
  EXPECT_DOUBLE_EQ(block.status.temperature_c, -12.5);
  EXPECT_EQ(block.status.boot_id, 0xDEADBEEFU);
}

// Pinned for authors of firmware: docs/reference/register-map.md prints the same numbers.
TEST(BankSum, HasItsPublishedValues) {
  EXPECT_EQ(bank_sum_term(0, 0), 0U);
  const std::string page = read_file(HAARLIGHT_SOURCE_DIR "/docs/reference/register-map.md");
  for (const auto& [element, level] :
       {std::pair{0, 1}, {0, 65535}, {1, 65535}, {1023, 32768}}) {
    const std::string row =
        fmt::format("| {} | {} | {:#010x} |", element, level,
                    bank_sum_term(element, static_cast<std::uint16_t>(level)));
    EXPECT_NE(page.find(row), std::string::npos) << row;
  }
}

}  // namespace
}  // namespace haarlight::firmware_iface
