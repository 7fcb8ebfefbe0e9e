# SPDX-License-Identifier: Apache-2.0
# cmake -DSOURCE=FOLDER -DFILE=commit.cpp -P write_commit.cmake
#   Writes the source that says which commit FOLDER is at, "592dfa4" or "592dfa4-dirty", where it is
#   a git checkout of its own; "" where it is not (a released archive, also inside another checkout).
#   FILE is left alone when it says so already: what depends on it is not built again.
set(commit "")
find_program(GIT git)
if(GIT)
  execute_process(COMMAND ${GIT} -C ${SOURCE} rev-parse --show-toplevel
                  OUTPUT_VARIABLE top OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET)
  file(REAL_PATH ${SOURCE} source)
  if(top STREQUAL source)
    execute_process(COMMAND ${GIT} -C ${SOURCE} --no-optional-locks describe --always --dirty
                            --exclude=* --abbrev=7
                    OUTPUT_VARIABLE commit OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET)
  endif()
endif()
file(CONFIGURE OUTPUT ${FILE} @ONLY CONTENT [[
// SPDX-License-Identifier: Apache-2.0
#include "apps/program_version.h"

namespace haarlight::apps {

std::string_view built_commit() { return "@commit@"; }

}  // namespace haarlight::apps
]])
