// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "haarlight/core/files.h"

/// @file
/// SIGINT and SIGTERM for a verb that ends in good order.

namespace haarlight::apps {

/// Takes both signals while it lives; one at a time. A handler, not a mask and a descriptor:
/// libraries have threads from before main() which would take the signal and end the process.
class EndSignals {
 public:
  EndSignals();
  ~EndSignals();
  EndSignals(const EndSignals&) = delete;
  EndSignals& operator=(const EndSignals&) = delete;

  /// Until a signal has come.
  void wait() const;
  /// Whether one has come; from any thread.
  [[nodiscard]] static bool have_come();

 private:
  Fd wake_;
};

}  // namespace haarlight::apps
