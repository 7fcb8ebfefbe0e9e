// SPDX-License-Identifier: Apache-2.0
#include "http/listen_address.h"

#include <cstdint>
#include <cstring>

#include <arpa/inet.h>
#include <fmt/format.h>
#include <netinet/in.h>

#include "haarlight/core/error.h"

namespace haarlight::http {

BindAddress parse_bind_address(const std::string& text, int port) {
  BindAddress address;
  sockaddr_in v4{};
  sockaddr_in6 v6{};
  if (port < 0 || port > 65535) {
    throw Error(fmt::format("port {} is not between 0 and 65535", port), "http.port",
                "give another port");
  }
  if (inet_pton(AF_INET, text.c_str(), &v4.sin_addr) == 1) {
    v4.sin_family = AF_INET;
    v4.sin_port = htons(static_cast<std::uint16_t>(port));
    address.is_loopback = (ntohl(v4.sin_addr.s_addr) >> 24U) == 127U;
    std::memcpy(&address.storage, &v4, sizeof(v4));
  } else if (inet_pton(AF_INET6, text.c_str(), &v6.sin6_addr) == 1) {
    v6.sin6_family = AF_INET6;
    v6.sin6_port = htons(static_cast<std::uint16_t>(port));
    address.is_v6 = true;
    address.is_loopback = IN6_IS_ADDR_LOOPBACK(&v6.sin6_addr) != 0;
    std::memcpy(&address.storage, &v6, sizeof(v6));
  } else {
    throw Error(fmt::format("\"{}\" is no numeric address", text), "http.address",
                "write an IPv4 or IPv6 address such as 127.0.0.1");
  }
  return address;
}

std::string address_of(const sockaddr* address) {
  char text[INET6_ADDRSTRLEN] = "";
  if (address != nullptr && address->sa_family == AF_INET) {
    inet_ntop(AF_INET, &reinterpret_cast<const sockaddr_in*>(address)->sin_addr, text,
              sizeof(text));
  } else if (address != nullptr && address->sa_family == AF_INET6) {
    inet_ntop(AF_INET6, &reinterpret_cast<const sockaddr_in6*>(address)->sin6_addr, text,
              sizeof(text));
  }
  return text;
}

}  // namespace haarlight::http
