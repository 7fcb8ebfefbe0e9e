// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include <sys/socket.h>

/// @file
/// Numeric addresses of sockets, IPv4 or IPv6. Pure.

namespace haarlight::http {

/// A numeric address in the kernel's form.
struct BindAddress {
  sockaddr_storage storage{};
  bool is_v6 = false;
  bool is_loopback = false;
};

/// @throws Error(bad_input)  no numeric address; no port
[[nodiscard]] BindAddress parse_bind_address(const std::string& text, int port);

/// In numbers, without the port; empty for another kind. @param address  or null
[[nodiscard]] std::string address_of(const sockaddr* address);

}  // namespace haarlight::http
