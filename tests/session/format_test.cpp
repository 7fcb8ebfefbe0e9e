// SPDX-License-Identifier: Apache-2.0
/// @file
/// docs/reference/session-format.md lists exactly the fields that the code writes.

#include <algorithm>
#include <set>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <sqlite3.h>

#include "haarlight/session/session.h"
#include "session/frame_tiff.h"
#include "tests/session/small_session.h"

namespace haarlight::session {
namespace {

using Json = nlohmann::json;
using Names = std::set<std::string>;

/// The first columns `like.this` of all tables of the page.
Names documented_fields() {
  const std::string page = test::read_text(std::filesystem::path(HAARLIGHT_SOURCE_DIR) /
                                           "docs/reference/session-format.md");
  Names names;
  for (std::size_t at = page.find("\n| `"); at != std::string::npos;
       at = page.find("\n| `", at + 1)) {
    const std::size_t begin = at + 4;
    names.insert(page.substr(begin, page.find('`', begin) - begin));
  }
  return names;
}

void add_keys(const Json& object, const std::string& prefix, Names& names) {
  for (const auto& [key, value] : object.items()) {
    const std::string name = prefix + key;
    const bool is_table = value.is_array() && !value.empty() && value[0].is_object();
    if (key == "evidence" && value.is_object()) {
      names.insert(name);
      add_keys(value, "evidence.", names);
    } else if (value.is_object()) {
      add_keys(value, name + ".", names);
    } else if (is_table) {
      for (const Json& item : value) {
        add_keys(item, name + "[].", names);
      }
    } else {
      names.insert(name);
    }
  }
}

void add_columns(const std::filesystem::path& file, Names& names) {
  sqlite3* database = nullptr;
  ASSERT_EQ(sqlite3_open_v2(file.c_str(), &database, SQLITE_OPEN_READONLY, nullptr), SQLITE_OK);
  const auto add = [](void* user, int, char** values, char**) {
    static_cast<Names*>(user)->insert(std::string(values[0]) + "." + values[1]);
    return 0;
  };
  const int result = sqlite3_exec(
      database,
      "SELECT m.name, c.name FROM sqlite_master m JOIN pragma_table_info(m.name) c "
      "WHERE m.type = 'table' AND m.name NOT LIKE 'sqlite_%'",
      add, &names, nullptr);
  sqlite3_close(database);
  ASSERT_EQ(result, SQLITE_OK);
}

TEST(SessionFormat, DocumentsEveryFieldAndNoOther) {
  test::TemporaryFolder folder;
  const std::filesystem::path s = folder.path() / "s";
  test::make_small_session(s, 2);
  SessionInfo info = Session::open(s).info();
  info.lights[1].is_position = false;  // so that both spellings of a position occur
  info.lights[1].coordinates = Eigen::Vector3d::UnitZ();
  info.lights[0].lobe = LightLobe{-Eigen::Vector3d::UnitZ(), 1.0};  // else left out
  info.form.clip_level = 4000.0;  // else left out, as "patterns" is
  info.form.gains = {1.5};
  info.form.crop = FrameCrop{1, 2, 40, 30};
  info.photographed = {.orientation = 1,
                       .exposure_s = 0.5,
                       .f_number = 8.0,
                       .iso = 100.0,
                       .model = "m",
                       .taken = "2026"};
  info.patterns = {PatternFamily::s_matrix, {{1, 2}}, 0, {}};  // else "patterns" is left out
  Names written;
  add_keys(Json::parse(session_info_to_json(info)), "", written);
  FrameDescription description;
  description.light.emplace();
  add_keys(Json::parse(frame_description_to_json(description)), "description.", written);
  add_columns(s / "journal.sqlite", written);

  Names documented = documented_fields();
  for (const char* method : {"bilinear", "edge-aware", "none"}) {
    documented.erase(method);  // the demosaic table
  }
  Names missing;
  Names extra;
  std::set_difference(written.begin(), written.end(), documented.begin(), documented.end(),
                      std::inserter(missing, missing.end()));
  std::set_difference(documented.begin(), documented.end(), written.begin(), written.end(),
                      std::inserter(extra, extra.end()));
  EXPECT_EQ(missing, Names());
  EXPECT_EQ(extra, Names());
}

}  // namespace
}  // namespace haarlight::session
