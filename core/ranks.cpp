// SPDX-License-Identifier: Apache-2.0
#include "core/ranks.h"

#include <chrono>
#include <cstdlib>
#include <thread>

#include <mpi.h>

namespace haarlight {

Ranks::Ranks() {
  if (std::getenv("OMPI_COMM_WORLD_SIZE") == nullptr) {
    return;
  }
  int given = 0;
  MPI_Init_thread(nullptr, nullptr, MPI_THREAD_FUNNELED, &given);
  MPI_Comm_rank(MPI_COMM_WORLD, &i_);
  MPI_Comm_size(MPI_COMM_WORLD, &n_);
}

Ranks::~Ranks() {
  int is_open = 0;
  MPI_Initialized(&is_open);
  if (is_open != 0) {
    MPI_Finalize();
  }
}

void Ranks::wait_for_all() const {
  if (n_ == 1) {
    return;
  }
  // MPI_Barrier would spin on a core that the other ranks' threads could use.
  constexpr std::chrono::milliseconds kNap{2};
  MPI_Request request = MPI_REQUEST_NULL;
  MPI_Ibarrier(MPI_COMM_WORLD, &request);
  int is_done = 0;
  for (;;) {
    MPI_Test(&request, &is_done, MPI_STATUS_IGNORE);
    if (is_done != 0) {
      return;
    }
    std::this_thread::sleep_for(kNap);
  }
}

void Ranks::abort(int exit_code) const {
  if (n_ > 1) {
    MPI_Abort(MPI_COMM_WORLD, exit_code);
  }
}

}  // namespace haarlight
