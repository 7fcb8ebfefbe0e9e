// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file
/// The processes of one job that OpenMPI's `mpirun` started, on one machine or many. They share
/// files, not memory.

namespace haarlight {

/// Opened once, by a program that can distribute its work. Started without mpirun it is rank 0
/// of 1 and MPI is not used. One thread.
class Ranks {
 public:
  Ranks();
  /// Leaves the job; the others may continue.
  ~Ranks();  // NOLINT(performance-trivially-destructible): with MPI it is not
  Ranks(const Ranks&) = delete;
  Ranks& operator=(const Ranks&) = delete;

  [[nodiscard]] int i() const noexcept { return i_; }
  [[nodiscard]] int n() const noexcept { return n_; }
  /// Returns when every process has arrived here; sleeps meanwhile. When one is lost, mpirun
  /// ends the others.
  void wait_for_all() const;
  /// For a process that cannot do its part: ends all of them. Returns when alone.
  void abort(int exit_code) const;

 private:
  int i_ = 0;
  int n_ = 1;
};

}  // namespace haarlight
