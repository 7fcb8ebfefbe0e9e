// SPDX-License-Identifier: Apache-2.0
/// @file
/// Ranks of a build without OpenMPI (HAARLIGHT_MPI off): one process.

#include <cstdlib>

#include "core/ranks.h"
#include "haarlight/core/error.h"

namespace haarlight {

Ranks::Ranks() {
  if (std::getenv("OMPI_COMM_WORLD_SIZE") != nullptr) {
    throw Error("this build cannot share its work among the processes of mpirun", "mpirun",
                "build with -DHAARLIGHT_MPI=ON, or start it without mpirun", ExitCode::usage);
  }
}

Ranks::~Ranks() = default;

void Ranks::wait_for_all() const {}

void Ranks::abort(int /*exit_code*/) const {}

}  // namespace haarlight
