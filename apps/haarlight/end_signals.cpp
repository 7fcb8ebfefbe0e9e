// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/end_signals.h"

#include <atomic>
#include <cerrno>
#include <csignal>
#include <cstdint>

#include <sys/eventfd.h>
#include <unistd.h>

#include "haarlight/core/error.h"

namespace haarlight::apps {

namespace {

// Where the handler writes; a handler can reach nothing but globals.
std::atomic<int> wake_descriptor{-1};
std::atomic<bool> has_come{false};

extern "C" void haarlight_wake(int /*signal*/) {
  has_come = true;
  const std::uint64_t one = 1;
  const ssize_t ignored = ::write(wake_descriptor.load(), &one, sizeof(one));
  (void)ignored;
}

}  // namespace

EndSignals::EndSignals() : wake_(::eventfd(0, EFD_CLOEXEC)) {
  if (!wake_.is_open()) {
    throw Error("no descriptor for signals", "eventfd", "close other programs", ExitCode::io);
  }
  has_come = false;
  wake_descriptor = wake_.get();
  for (const int signal : {SIGINT, SIGTERM}) {
    (void)std::signal(signal, haarlight_wake);
  }
}

EndSignals::~EndSignals() {
  for (const int signal : {SIGINT, SIGTERM}) {
    (void)std::signal(signal, SIG_DFL);
  }
  wake_descriptor = -1;
}

void EndSignals::wait() const {
  std::uint64_t n = 0;
  while (::read(wake_.get(), &n, sizeof(n)) < 0 && errno == EINTR) {
  }
}

bool EndSignals::have_come() { return has_come; }

}  // namespace haarlight::apps
