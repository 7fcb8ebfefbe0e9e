// SPDX-License-Identifier: Apache-2.0
#include "http/static_files.h"

#include <filesystem>
#include <fstream>

#include <gtest/gtest.h>
#include <sys/stat.h>

#include "tests/temporary_folder.h"

namespace haarlight::http {
namespace {

class StaticFiles : public ::testing::Test {
 protected:
  StaticFiles() {
    std::filesystem::create_directories(folder_ / "sub");
    std::ofstream(base_ / "secret.txt") << "secret";
    std::ofstream(folder_ / "index.html") << "<p>";
    std::ofstream(folder_ / ".hidden") << "x";
    std::ofstream(folder_ / "sub" / "a.js") << "1";
    std::filesystem::create_symlink(base_ / "secret.txt", folder_ / "link.txt");
    std::filesystem::create_directory_symlink(base_, folder_ / "up");
    (void)::mkfifo((folder_ / "pipe").c_str(), 0600);
  }

  testing::TemporaryFolder temporary_;
  std::filesystem::path base_ = temporary_.path();
  std::filesystem::path folder_ = base_ / "www";
};

TEST_F(StaticFiles, OpensWhatIsInTheFolder) {
  const auto index = open_static_file(folder_, {});
  ASSERT_TRUE(index);
  EXPECT_EQ(index->size, 3U);
  EXPECT_EQ(index->content_type, "text/html; charset=utf-8");
  EXPECT_TRUE(open_static_file(folder_, {"sub", "a.js"}));
}

TEST_F(StaticFiles, OpensNothingElse) {
  EXPECT_FALSE(open_static_file(folder_, {"..", "secret.txt"}));
  EXPECT_FALSE(open_static_file(folder_, {"sub", "..", "index.html"}));
  EXPECT_FALSE(open_static_file(folder_, {"../secret.txt"}));
  EXPECT_FALSE(open_static_file(folder_, {"link.txt"}));
  EXPECT_FALSE(open_static_file(folder_, {"up", "secret.txt"}));
  EXPECT_FALSE(open_static_file(folder_, {".hidden"}));
  EXPECT_FALSE(open_static_file(folder_, {"sub"}));
  EXPECT_FALSE(open_static_file(folder_, {"pipe"}));
  EXPECT_FALSE(open_static_file(folder_, {"index.html", "x"}));
  EXPECT_FALSE(open_static_file(folder_, {std::string("a\0b", 3)}));
  EXPECT_FALSE(open_static_file(folder_ / "none", {}));
}

}  // namespace
}  // namespace haarlight::http
