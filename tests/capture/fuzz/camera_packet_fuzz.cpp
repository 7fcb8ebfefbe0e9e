// SPDX-License-Identifier: Apache-2.0
/// @file
/// Any packets as a remote camera's answers and frames: a Fault, or a frame of the rig's size
/// with finite numbers whose every pixel can be read. The input is a list of packets: one byte
/// whether memory comes along (its size in 64-byte steps), then 64 bytes; the magic number and
/// version are put in where the byte's top bit is clear, so that most packets pass the first
/// check.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <string>
#include <thread>

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "capture/camera/remote_camera.h"
#include "haarlight/core/error.h"

namespace {

constexpr int kWidth = 16;
constexpr int kHeight = 8;

std::string socket_path() {
  return "/tmp/haarlight-fuzz-" + std::to_string(::getpid()) + ".sock";
}

/// Listens from the first call to the end of the process.
int listener() {
  static const int kFd = [] {
    const int fd = ::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0);
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    const std::string path = socket_path();
    std::copy(path.begin(), path.end(), std::begin(address.sun_path));
    ::unlink(path.c_str());
    HAARLIGHT_EXPECTS(
        ::bind(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0 &&
            ::listen(fd, 4) == 0,
        "a socket to listen on");
    std::atexit([] { ::unlink(socket_path().c_str()); });
    return fd;
  }();
  return kFd;
}

void send_with(int to, const void* bytes, std::size_t size, int memory) {
  iovec part{.iov_base = const_cast<void*>(bytes), .iov_len = size};
  alignas(cmsghdr) char control[CMSG_SPACE(sizeof(int))] = {};
  msghdr message{};
  message.msg_iov = &part;
  message.msg_iovlen = 1;
  if (memory >= 0) {
    message.msg_control = control;
    message.msg_controllen = sizeof control;
    cmsghdr* c = CMSG_FIRSTHDR(&message);
    c->cmsg_level = SOL_SOCKET;
    c->cmsg_type = SCM_RIGHTS;
    c->cmsg_len = CMSG_LEN(sizeof(int));
    std::memcpy(CMSG_DATA(c), &memory, sizeof memory);
  }
  (void)::sendmsg(to, &message, MSG_NOSIGNAL | MSG_DONTWAIT);
}

void serve(const std::uint8_t* data, std::size_t size) {
  const int client = ::accept(listener(), nullptr, nullptr);
  while (size > 1) {
    const std::uint8_t kind = *data;
    haarlight::capture::RemoteHeader header;
    const std::size_t n = std::min(size - 1, sizeof header);
    std::memcpy(&header, data + 1, n);
    data += 1 + n;
    size -= 1 + n;
    if ((kind & 0x80U) == 0) {
      header.magic = haarlight::capture::kRemoteMagic;
      header.version = haarlight::capture::kRemoteVersion;
    }
    int memory = -1;
    if ((kind & 0x7fU) != 0) {
      memory = ::memfd_create("frame", MFD_CLOEXEC | MFD_ALLOW_SEALING);
      (void)::ftruncate(memory, off_t{kind & 0x7f} * 64);
      if ((kind & 1U) != 0) {
        (void)::fcntl(memory, F_ADD_SEALS, F_SEAL_SHRINK);
      }
    }
    send_with(client, &header, n, memory);
    if (memory >= 0) {
      ::close(memory);
    }
  }
  ::close(client);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size > std::size_t{66} * 64) {
    return 0;
  }
  (void)listener();
  std::jthread server([data, size] { serve(data, size); });
  haarlight::CameraSpec spec;
  spec.device = socket_path();
  spec.frame_width = kWidth;
  spec.frame_height = kHeight;
  haarlight::capture::RemoteCamera camera;
  const auto setup = camera.start(spec);
  if (!setup) {
    return 0;
  }
  HAARLIGHT_EXPECTS(
      setup->n_buffers >= 1 && std::isfinite(setup->fps) && std::isfinite(setup->exposure_us),
      "a setup of usable numbers");
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(5);
  for (;;) {
    const auto frame = camera.next(deadline);
    if (!frame) {
      if (frame.error().code == haarlight::Errc::device_gone ||
          frame.error().code == haarlight::Errc::timeout) {
        return 0;
      }
      continue;
    }
    HAARLIGHT_EXPECTS(
        std::isfinite(frame->info().exposure_us) && std::isfinite(frame->info().gain_db),
        "a frame of finite numbers");
    const auto pixels = frame->pixels();
    unsigned sum = 0;
    for (int y = 0; y < pixels.height(); ++y) {
      for (int x = 0; x < pixels.width(); ++x) {
        sum += pixels(y, x);
      }
    }
    HAARLIGHT_EXPECTS(pixels.is_empty() || (pixels.width() == kWidth &&
                                            pixels.height() == kHeight && sum < 1U << 31U),
                      "a frame of the rig's size, or none");
  }
}
