// SPDX-License-Identifier: Apache-2.0
#include "core/npy.h"

#include <array>
#include <bit>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "tests/temporary_folder.h"

namespace haarlight {
namespace {

using testing::TemporaryFolder;

/// The header of a file, and the values behind it, by the format's description.
struct NpyFile {
  std::string header;
  std::vector<double> values;
};

NpyFile read_npy(const std::filesystem::path& path) {
  const std::string bytes = read_file(path);
  EXPECT_EQ(bytes.substr(0, 8), std::string("\x93NUMPY\x01\x00", 8));
  const std::size_t length =
      static_cast<unsigned char>(bytes.at(8)) + 256U * static_cast<unsigned char>(bytes.at(9));
  const std::size_t begin = 10 + length;
  EXPECT_EQ(begin % 64, 0U);
  NpyFile file;
  file.header = bytes.substr(10, length);
  EXPECT_EQ(file.header.back(), '\n');
  EXPECT_EQ((bytes.size() - begin) % 8, 0U);
  for (std::size_t at = begin; at + 8 <= bytes.size(); at += 8) {
    std::uint64_t bits = 0;
    for (std::size_t i = 8; i-- > 0;) {
      bits = bits << 8U | static_cast<unsigned char>(bytes[at + i]);
    }
    file.values.push_back(std::bit_cast<double>(bits));
  }
  return file;
}

TEST(Npy, IsLittleEndianInRowsToTheBit) {
  const TemporaryFolder folder;
  const std::vector<double> values = {0.0,
                                      -0.0,
                                      1.0 / 3.0,
                                      -1e300,
                                      std::numeric_limits<double>::denorm_min(),
                                      std::numeric_limits<double>::infinity()};
  write_npy(folder / "a.npy", std::array<std::size_t, 2>{2, 3}, values);
  const NpyFile file = read_npy(folder / "a.npy");
  EXPECT_EQ(file.header.substr(0, file.header.find('}') + 1),
            "{'descr': '<f8', 'fortran_order': False, 'shape': (2, 3, ), }");
  ASSERT_EQ(file.values.size(), values.size());
  for (std::size_t i = 0; i < values.size(); ++i) {
    EXPECT_EQ(std::bit_cast<std::uint64_t>(file.values[i]),
              std::bit_cast<std::uint64_t>(values[i]));
  }
}

TEST(Npy, TakesAnyNumberOfDimensions) {
  const TemporaryFolder folder;
  const auto shape_of = [&](const std::vector<std::size_t>& shape, std::size_t n) {
    write_npy(folder / "b.npy", shape, std::vector<double>(n, 0.5));
    const NpyFile file = read_npy(folder / "b.npy");
    EXPECT_EQ(file.values.size(), n);
    const std::size_t begin = file.header.find('(');
    return file.header.substr(begin, file.header.find(')') - begin + 1);
  };
  EXPECT_EQ(shape_of({}, 1), "()");
  EXPECT_EQ(shape_of({5}, 5), "(5, )");
  EXPECT_EQ(shape_of({0, 4}, 0), "(0, 4, )");
  EXPECT_EQ(shape_of(std::vector<std::size_t>(20, 1), 1).size(), 62U);
}

TEST(Npy, RefusesAShapeOfAnotherSizeAndAFolderThatIsMissing) {
  const TemporaryFolder folder;
  EXPECT_THROW(
      write_npy(folder / "c.npy", std::array<std::size_t, 2>{2, 3}, std::vector<double>(5)),
      ContractViolation);
  EXPECT_FALSE(std::filesystem::exists(folder / "c.npy"));
  try {
    write_npy(folder / "absent/c.npy", std::array<std::size_t, 1>{1}, {1.0});
    FAIL() << "it was written";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ExitCode::io);
    EXPECT_NE(error.where().find("absent/c.npy"), std::string::npos);
  }
}

}  // namespace
}  // namespace haarlight
