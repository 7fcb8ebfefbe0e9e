// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/daemon_address.h"

#include "apps/token_file.h"

namespace haarlight::apps {

void add_daemon_options(Command verb, DaemonAddress& address) {
  verb.option("--daemon", &address.url, "Address of haarlightd",
              {.type = "URL", .environment = "HAARLIGHT_DAEMON", .shows_default = true});
  verb.option("--token-file", &address.token_file, "File with the daemon's token",
              {.type = "FILE"});
}

capture::DaemonClientConfig client_config(const DaemonAddress& address) {
  capture::DaemonClientConfig config{.url = address.url};
  if (!address.token_file.empty()) {
    config.token = read_token(address.token_file);
  }
  return config;
}

}  // namespace haarlight::apps
