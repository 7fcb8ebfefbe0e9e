// SPDX-License-Identifier: Apache-2.0
#include "tests/http/raw_client.h"

#include <algorithm>
#include <stdexcept>

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>

namespace haarlight::http {

using Clock = std::chrono::steady_clock;

RawClient::RawClient(int port) : fd_(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<std::uint16_t>(port));
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  if (::connect(fd_.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)) != 0) {
    throw std::runtime_error("cannot connect");
  }
}

void RawClient::send(std::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t n = ::send(fd_.get(), bytes.data(), bytes.size(), MSG_NOSIGNAL);
    if (n <= 0) {
      return;  // the server closed: the reading side tells
    }
    bytes.remove_prefix(static_cast<std::size_t>(n));
  }
}

bool RawClient::read_some(Clock::time_point deadline) {
  const auto left = std::chrono::ceil<std::chrono::milliseconds>(deadline - Clock::now());
  pollfd waiting{fd_.get(), POLLIN, 0};
  if (is_ended_ || left.count() <= 0 ||
      ::poll(&waiting, 1, static_cast<int>(left.count())) <= 0) {
    return false;
  }
  char chunk[4096];
  const ssize_t n = ::recv(fd_.get(), chunk, sizeof(chunk), 0);
  if (n <= 0) {
    is_ended_ = true;
    return false;
  }
  buffer_.append(chunk, static_cast<std::size_t>(n));
  return true;
}

std::optional<RawResponse> RawClient::read_response(std::chrono::milliseconds patience) {
  const auto deadline = Clock::now() + patience;
  std::size_t end = 0;
  while ((end = buffer_.find("\r\n\r\n")) == std::string::npos) {
    if (!read_some(deadline)) {
      return std::nullopt;
    }
  }
  RawResponse response;
  std::string head = buffer_.substr(0, end + 2);
  buffer_.erase(0, end + 4);
  response.status = std::stoi(head.substr(head.find(' ') + 1));
  std::size_t at = head.find("\r\n") + 2;
  while (at < head.size()) {
    const std::size_t line_end = head.find("\r\n", at);
    const std::size_t colon = head.find(':', at);
    std::string name = head.substr(at, colon - at);
    std::transform(name.begin(), name.end(), name.begin(),
                   [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
    response.headers[name] = head.substr(colon + 2, line_end - colon - 2);
    at = line_end + 2;
  }
  const auto length = response.headers.find("content-length");
  const std::size_t n_body = length == response.headers.end() ? 0 : std::stoul(length->second);
  while (buffer_.size() < n_body) {
    if (!read_some(deadline)) {
      return std::nullopt;
    }
  }
  response.body = buffer_.substr(0, n_body);
  buffer_.erase(0, n_body);
  return response;
}

std::string RawClient::read_until(std::string_view text, std::chrono::milliseconds patience) {
  const auto deadline = Clock::now() + patience;
  while (buffer_.find(text) == std::string::npos && read_some(deadline)) {
  }
  const std::size_t at = buffer_.find(text);
  const std::size_t n = at == std::string::npos ? buffer_.size() : at + text.size();
  std::string taken = buffer_.substr(0, n);
  buffer_.erase(0, n);
  return taken;
}

bool RawClient::is_closed_within(std::chrono::milliseconds patience) {
  const auto deadline = Clock::now() + patience;
  while (read_some(deadline)) {
  }
  return is_ended_;
}

RawResponse exchange(int port, std::string_view method, std::string_view path,
                     std::string_view headers, std::string_view body) {
  RawClient client(port);
  std::string request = std::string(method) + " " + std::string(path) + " HTTP/1.1\r\n";
  if (headers.find("Host:") == std::string_view::npos) {
    request += "Host: 127.0.0.1\r\n";
  }
  request += headers;
  if (!body.empty() || method == "POST") {
    request += "Content-Length: " + std::to_string(body.size()) + "\r\n";
  }
  request += "\r\n";
  client.send(request);
  client.send(body);
  const auto response = client.read_response();
  return response ? *response : RawResponse{};
}

}  // namespace haarlight::http
