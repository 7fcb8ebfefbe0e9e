// SPDX-License-Identifier: Apache-2.0
#include <thread>

#include <unistd.h>

/// @file
/// Preloaded into a program: a thread that is there before main, as some libraries start one.

namespace {

const bool kIsStarted = [] {
  std::thread([] {
    while (true) {
      ::pause();
    }
  }).detach();
  return true;
}();

}  // namespace
