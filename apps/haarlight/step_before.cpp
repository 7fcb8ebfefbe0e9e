// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/step_before.h"

#include <filesystem>
#include <system_error>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/session/import/picture_match.h"

namespace haarlight::apps {

namespace fs = std::filesystem;

namespace {

bool holds(const std::string& folder, const char* name) {
  std::error_code ignored;
  return fs::exists(fs::path(folder) / name, ignored);
}

bool is_session(const std::string& folder) {
  return holds(folder, "session.json") || holds(folder, "journal.sqlite");
}

}  // namespace

void refuse_step_before(const std::string& file, const std::string& verb) {
  std::error_code ignored;
  if (!fs::is_directory(file, ignored)) {
    return;
  }
  if (is_session(file)) {
    throw Error(
        "a session: what is made from it can be looked at", file,
        fmt::format("haarlight compress {0} -o NAME.hlb (its lights and shadows under any "
                    "light), or haarlight fit {0} -o NAME (lit from any direction); then "
                    "haarlight {1} of that",
                    file, verb));
  }
  if (const std::size_t n = session::picture_names(file).size(); n > 0) {
    throw Error(
        fmt::format("a folder of {} pictures: what is made from them can be looked at", n),
        file,
        fmt::format("haarlight fit {0} --lights LIST.lp -o NAME, then haarlight {1} NAME; "
                    "where the lights are unknown, haarlight calibrate finds them",
                    file, verb));
  }
  throw Error("a folder without info.json, session.json or pictures", file,
              "give a basis file (.hlb), a .ptm, an .rti or a fitted folder");
}

void refuse_not_basis(const std::string& file, const std::string& verb) {
  std::error_code ignored;
  if (!fs::is_directory(file, ignored)) {
    return;
  }
  if (is_session(file)) {
    throw Error("a session, not a basis file", file,
                fmt::format("haarlight compress {} -o NAME.hlb, then haarlight {} NAME.hlb",
                            file, verb));
  }
  if (holds(file, "info.json")) {
    throw Error(
        "a picture lit from one direction at a time, not a basis file", file,
        fmt::format("haarlight compress of the session that it was fitted to, then "
                    "haarlight {}; or light it from one direction: haarlight convert {} "
                    "OUT.png --light X,Y,Z",
                    verb, file));
  }
  if (session::picture_names(file).empty()) {
    throw Error("a folder, not a basis file", file,
                "name a file that haarlight compress wrote");
  }
  throw Error("a folder of pictures, not a basis file", file,
              fmt::format("haarlight import {} --lights LIST.lp -o NAME.session, haarlight "
                          "compress of that, then haarlight {}",
                          file, verb));
}

}  // namespace haarlight::apps
