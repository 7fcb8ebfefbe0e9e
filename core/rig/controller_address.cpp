// SPDX-License-Identifier: Apache-2.0
#include "core/rig/controller_address.h"

#include <charconv>

#include <fmt/format.h>

namespace haarlight {

namespace {

bool parse_number(const std::string& text, int& value) {
  const char* const end = text.data() + text.size();
  const auto [last, error] = std::from_chars(text.data(), end, value);
  return error == std::errc() && last == end;
}

}  // namespace

Result<TcpAddress> parse_tcp_address(const std::string& text) {
  const std::size_t colon = text.rfind(':');
  int port = 0;
  if (colon == std::string::npos || colon == 0 || !parse_number(text.substr(colon + 1), port) ||
      port < 1 || port > 65535) {
    return fail(
        Errc::unsupported,
        fmt::format("controller address '{}': expected host:port, port 1 to 65535", text));
  }
  std::string host = text.substr(0, colon);
  if (host.size() > 2 && host.front() == '[' && host.back() == ']') {
    host = host.substr(1, host.size() - 2);
  }
  return TcpAddress{host, std::to_string(port)};
}

Result<SerialAddress> parse_serial_address(const std::string& text) {
  const auto bad = [&text] {
    return fail(Errc::unsupported,
                fmt::format("controller address '{}': expected /dev/...:baud or "
                            "/dev/...:baud:8E1, 300 to 4000000 baud",
                            text));
  };
  SerialAddress address;
  std::string rest = text;
  std::size_t colon = rest.rfind(':');
  if (colon == std::string::npos) {
    return bad();
  }
  std::string last = rest.substr(colon + 1);
  const bool has_mode = last.size() == 3 && (last[0] == '7' || last[0] == '8') &&
                        (last[1] == 'N' || last[1] == 'E' || last[1] == 'O') &&
                        (last[2] == '1' || last[2] == '2');
  if (has_mode) {
    address.data_bits = last[0] - '0';
    address.parity = static_cast<Parity>(last[1]);
    address.stop_bits = last[2] - '0';
    rest.resize(colon);
    colon = rest.rfind(':');
    if (colon == std::string::npos) {
      return bad();
    }
    last = rest.substr(colon + 1);
  }
  if (colon == 0 || !parse_number(last, address.baud) || address.baud < 300 ||
      address.baud > 4'000'000) {
    return bad();
  }
  address.device = rest.substr(0, colon);
  return address;
}

}  // namespace haarlight
