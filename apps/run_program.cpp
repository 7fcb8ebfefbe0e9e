// SPDX-License-Identifier: Apache-2.0
#include "apps/run_program.h"

#include <cstdio>
#include <exception>

namespace haarlight::apps {

int run_program(const char* name, int (*run)(int argc, char** argv), int argc,
                char** argv) noexcept {
  try {
    return run(argc, argv);
  } catch (const std::exception& error) {
    (void)std::fprintf(stderr, "%s: %s\n", name, error.what());
    return 1;
  }
}

}  // namespace haarlight::apps
