// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <cstring>
#include <filesystem>
#include <optional>
#include <vector>

#include <poll.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "capture/camera/remote_camera_protocol.h"
#include "haarlight/core/files.h"

/// @file
/// A client of the remote camera's socket, written from the protocol's page alone.

namespace haarlight::testing {

struct ClientFrame {
  capture::RemoteHeader header;
  std::vector<std::uint16_t> words;
};

class RemoteClient {
 public:
  explicit RemoteClient(const std::filesystem::path& path)
      : fd_(::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0)) {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    std::strncpy(address.sun_path, path.c_str(), sizeof address.sun_path - 1);
    is_connected_ =
        ::connect(fd_.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0;
  }

  [[nodiscard]] bool is_connected() const { return is_connected_; }

  void send(const capture::RemoteHeader& header) const {
    [[maybe_unused]] const ssize_t n = ::send(fd_.get(), &header, sizeof header, MSG_NOSIGNAL);
  }
  void send(capture::RemoteMessage message, std::uint64_t sequence = 0,
            float exposure_us = 0.0F) const {
    capture::RemoteHeader header;
    header.message = static_cast<std::uint16_t>(message);
    header.sequence = sequence;
    header.exposure_us = exposure_us;
    send(header);
  }
  void send_bytes(const void* data, std::size_t size) const {
    [[maybe_unused]] const ssize_t n = ::send(fd_.get(), data, size, MSG_NOSIGNAL);
  }

  /// The next message; its frame is copied out and, unless `keep`, released.
  std::optional<ClientFrame> next(int timeout_ms = 3000, bool keep = false) {
    pollfd wait{fd_.get(), POLLIN, 0};
    if (::poll(&wait, 1, timeout_ms) <= 0) {
      return std::nullopt;
    }
    ClientFrame frame;
    iovec part{&frame.header, sizeof frame.header};
    alignas(cmsghdr) char control[CMSG_SPACE(sizeof(int))];
    msghdr message{};
    message.msg_iov = &part;
    message.msg_iovlen = 1;
    message.msg_control = control;
    message.msg_controllen = sizeof control;
    if (::recvmsg(fd_.get(), &message, MSG_CMSG_CLOEXEC) <= 0) {
      return std::nullopt;
    }
    if (const cmsghdr* rights = CMSG_FIRSTHDR(&message)) {
      int raw = -1;
      std::memcpy(&raw, CMSG_DATA(rights), sizeof raw);
      const Fd memory(raw);
      void* data = ::mmap(nullptr, frame.header.bytes, PROT_READ, MAP_SHARED, memory.get(), 0);
      if (data != MAP_FAILED) {
        const auto* words = static_cast<const std::uint16_t*>(data);
        frame.words.assign(words, words + frame.header.bytes / 2);
        ::munmap(data, frame.header.bytes);
      }
      is_writable_ = ::mmap(nullptr, frame.header.bytes, PROT_READ | PROT_WRITE, MAP_SHARED,
                            memory.get(), 0) != MAP_FAILED;
      if (!keep) {
        send(capture::RemoteMessage::release, frame.header.sequence);
      }
    }
    return frame;
  }

  /// Whether the last frame's memory could be mapped for writing.
  [[nodiscard]] bool is_writable() const { return is_writable_; }

 private:
  Fd fd_;
  bool is_connected_ = false;
  bool is_writable_ = false;
};

}  // namespace haarlight::testing
