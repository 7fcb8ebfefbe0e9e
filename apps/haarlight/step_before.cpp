#include "apps/haarlight/step_before.h"

#include <filesystem>
#include <system_error>

#include <fmt/format.h>

#include "core/error.h"
#include "session/picture_match.h"

namespace haarlight {

void refuse_step_before(const std::string& file, const std::string& verb) {
  namespace fs = std::filesystem;
  std::error_code ignored;
  if (!fs::is_directory(file, ignored)) {
    return;
  }
  if (fs::exists(fs::path(file) / "session.json", ignored) ||
      fs::exists(fs::path(file) / "journal.sqlite", ignored)) {
    throw Error(
        "a session: what is made from it can be looked at", file,
        fmt::format("haarlight compress {0} -o NAME.hlb (its lights and shadows under any "
                    "light), or haarlight fit {0} -o NAME (lit from any direction); then "
                    "haarlight {1} of that",
                    file, verb));
  }
  if (const std::size_t n = picture_names(file).size(); n > 0) {
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

}  // namespace haarlight
