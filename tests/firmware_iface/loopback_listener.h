// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cerrno>
#include <string>
#include <system_error>

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>

#include "haarlight/core/files.h"

/// @file
/// The listening side of a peer that a test plays.

namespace haarlight::testing {

/// True when bytes or a caller wait; looks for 5 ms.
inline bool is_readable(int fd) {
  pollfd line{fd, POLLIN, 0};
  return ::poll(&line, 1, 5) > 0;
}

class LoopbackListener {
 public:
  LoopbackListener() : fd_(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof address;
    auto* const generic = reinterpret_cast<sockaddr*>(&address);
    if (::bind(fd_.get(), generic, size) != 0 || ::listen(fd_.get(), 4) != 0 ||
        ::getsockname(fd_.get(), generic, &size) != 0) {
      throw std::system_error(errno, std::generic_category(), "listening on loopback");
    }
    port_ = std::to_string(ntohs(address.sin_port));
  }

  [[nodiscard]] const std::string& port() const noexcept { return port_; }
  [[nodiscard]] bool is_called() const { return is_readable(fd_.get()); }
  [[nodiscard]] Fd accept() const { return Fd(::accept(fd_.get(), nullptr, nullptr)); }

 private:
  Fd fd_;
  std::string port_;
};

}  // namespace haarlight::testing
