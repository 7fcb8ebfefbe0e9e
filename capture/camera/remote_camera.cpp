// SPDX-License-Identifier: Apache-2.0
#include "capture/camera/remote_camera.h"

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <vector>

#include <fcntl.h>
#include <fmt/format.h>
#include <linux/magic.h>
#include <poll.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <sys/vfs.h>
#include <unistd.h>

namespace haarlight::capture {

namespace {

using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;

constexpr milliseconds kAnswerTime{2000};
constexpr std::size_t kMaxHeldBytes = std::size_t{1} << 30U;
constexpr std::size_t kMinHeld = 4;
constexpr std::uint32_t kMaxBuffers = 1024;

std::string describe(const CameraSpec& spec) { return "remote camera " + spec.device; }

Errc errc_of(int error) {
  switch (error) {
    case ENOENT:
    case ECONNREFUSED:
    case ECONNRESET:
    case EPIPE:
    case ENOTCONN:
      return Errc::device_gone;
    case EAGAIN:
    case EBUSY:
      return Errc::device_busy;
    default:
      return Errc::io;
  }
}

/// Sends without waiting; the peer's buffer holds hundreds of headers.
int send_packet(int fd, const RemoteHeader& header) {
  const ssize_t n = ::send(fd, &header, sizeof header, MSG_NOSIGNAL | MSG_DONTWAIT);
  return n == static_cast<ssize_t>(sizeof header) ? 0 : errno;
}

}  // namespace

namespace {

RemoteHeader release_of(std::uint64_t sequence) {
  RemoteHeader header;
  header.message = static_cast<std::uint16_t>(RemoteMessage::release);
  header.sequence = sequence;
  return header;
}

/// A memory file that can never become shorter than it is now: a mapping of it cannot fault.
/// (Files on disk, on huge pages or served by another program can.)
bool is_safe_to_map(const Fd& fd) {
  const int seals = ::fcntl(fd.get(), F_GET_SEALS);
  struct statfs where {};
  return seals >= 0 && (seals & F_SEAL_SHRINK) != 0 && ::fstatfs(fd.get(), &where) == 0 &&
         where.f_type == TMPFS_MAGIC;
}

}  // namespace

/// Rows of words mapped read-only, or copied; freed when the last frame that uses them is
/// released.
class RemoteFrameMemory {
 public:
  RemoteFrameMemory(const RemoteFrameMemory&) = delete;
  RemoteFrameMemory& operator=(const RemoteFrameMemory&) = delete;
  ~RemoteFrameMemory() {
    if (mapping_ != nullptr) {
      ::munmap(mapping_, size_);
    }
  }

  /// Null when the file holds fewer than `height` rows of `stride` bytes.
  static std::shared_ptr<RemoteFrameMemory> open(const Fd& fd, std::size_t stride, int height,
                                                 int width) {
    // Check the seal before the length: a file sealed in between could have been shortened
    // first.
    const bool is_mappable = is_safe_to_map(fd);
    const std::size_t bytes = stride * static_cast<std::size_t>(height);
    struct stat info {};
    if (::fstat(fd.get(), &info) != 0 || info.st_size < static_cast<off_t>(bytes)) {
      return nullptr;
    }
    std::shared_ptr<RemoteFrameMemory> memory(new RemoteFrameMemory);
    if (is_mappable) {
      void* mapping = ::mmap(nullptr, bytes, PROT_READ, MAP_SHARED, fd.get(), 0);
      if (mapping == MAP_FAILED) {
        return nullptr;
      }
      memory->mapping_ = mapping;
      memory->size_ = bytes;
      return memory;
    }
    // Without the padding: the size of a copy depends on the frame, not on what the server
    // claims.
    const std::size_t row_bytes = 2 * static_cast<std::size_t>(width);
    memory->copy_.resize(static_cast<std::size_t>(height) * static_cast<std::size_t>(width));
    auto* to = reinterpret_cast<char*>(memory->copy_.data());
    if (stride == row_bytes) {
      return read_all(fd, 0, to, bytes) ? memory : nullptr;
    }
    for (std::size_t y = 0; y < static_cast<std::size_t>(height); ++y) {
      if (!read_all(fd, y * stride, to + y * row_bytes, row_bytes)) {
        return nullptr;
      }
    }
    return memory;
  }

  [[nodiscard]] bool is_mapped() const { return mapping_ != nullptr; }
  [[nodiscard]] std::size_t size() const { return size_; }
  [[nodiscard]] ImageView<const std::uint16_t> view(std::size_t stride, int height,
                                                    int width) const {
    return is_mapped() ? ImageView<const std::uint16_t>(
                             static_cast<const std::uint16_t*>(mapping_), height, width, 1,
                             static_cast<std::ptrdiff_t>(stride / 2))
                       : ImageView<const std::uint16_t>(copy_.data(), height, width, 1, width);
  }

 private:
  RemoteFrameMemory() = default;
  static bool read_all(const Fd& fd, std::size_t from, char* to, std::size_t bytes) {
    std::size_t done = 0;
    while (done < bytes) {
      const ssize_t n =
          ::pread(fd.get(), to + done, bytes - done, static_cast<off_t>(from + done));
      if (n < 0 && errno == EINTR) {
        continue;
      }
      if (n <= 0) {
        return false;
      }
      done += static_cast<std::size_t>(n);
    }
    return true;
  }

  void* mapping_ = nullptr;
  std::size_t size_ = 0;  ///< bytes mapped
  std::vector<std::uint16_t> copy_;
};

RemoteCamera::~RemoteCamera() { stop(); }

Result<CameraSetup> RemoteCamera::start(const CameraSpec& spec) {
  stop();
  spec_ = spec;
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  if (spec.device.size() >= sizeof address.sun_path) {
    return fail(Errc::unsupported, describe(spec) + ": the socket's path is too long");
  }
  std::copy(spec.device.begin(), spec.device.end(), std::begin(address.sun_path));
  auto fd =
      std::make_shared<Fd>(::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  if (!fd->is_open()) {
    return fail(Errc::io, describe(spec) + ": socket: " + std::strerror(errno), errno);
  }
  if (::connect(fd->get(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) {
    const int error = errno;
    return fail(errc_of(error),
                fmt::format("{}: connect: {}", describe(spec), std::strerror(error)), error);
  }
  socket_ = std::move(fd);
  RemoteHeader ask;
  ask.message = static_cast<std::uint16_t>(RemoteMessage::setup);
  ask.width = static_cast<std::uint32_t>(spec.frame_width);
  ask.height = static_cast<std::uint32_t>(spec.frame_height);
  ask.exposure_us = static_cast<float>(spec.exposure_us);
  ask.gain_db = static_cast<float>(spec.gain_db);
  ask.fps = static_cast<float>(spec.fps);
  ask.sequence = static_cast<std::uint64_t>(trigger_);
  if (auto sent = send(ask); !sent) {
    stop();
    return tl::unexpected<Fault>(sent.error());
  }
  auto set = answer_to(RemoteMessage::setup);
  if (!set) {
    stop();
    return tl::unexpected<Fault>(set.error());
  }
  if (set->sequence != ask.sequence) {
    stop();
    return fail(
        Errc::unsupported,
        fmt::format("{}: it cannot be triggered {}", describe(spec),
                    trigger_ == TriggerSource::software ? "by the host" : "by its line"));
  }
  if (set->width != ask.width || set->height != ask.height || set->n_buffers < 1) {
    const std::string what =
        fmt::format("{}: requested {} x {}, it set {} x {} with {} buffers", describe(spec),
                    ask.width, ask.height, set->width, set->height, set->n_buffers);
    stop();
    return fail(Errc::refused, what);
  }
  const std::size_t frame_bytes = std::size_t{2} * ask.width * ask.height;
  max_held_ = std::min<std::size_t>(std::min(set->n_buffers, kMaxBuffers),
                                    std::max(kMinHeld, kMaxHeldBytes / frame_bytes));
  n_held_ = std::make_shared<std::atomic<std::size_t>>(0);
  RemoteHeader go;
  go.message = static_cast<std::uint16_t>(RemoteMessage::start);
  if (auto sent = send(go); !sent) {
    stop();
    return tl::unexpected<Fault>(sent.error());
  }
  return CameraSetup{.width = static_cast<int>(set->width),
                     .height = static_cast<int>(set->height),
                     .n_buffers = static_cast<int>(max_held_),
                     .fps = set->fps,
                     .exposure_us = set->exposure_us,
                     .gain_db = set->gain_db,
                     .identity = describe(spec)};
}

Result<Frame> RemoteCamera::next(Clock::time_point deadline) {
  for (;;) {
    if (!queued_.empty()) {
      Packet packet = std::move(queued_.front());
      queued_.pop_front();
      return make_frame(std::move(packet));
    }
    auto packet = receive(deadline);
    if (!packet) {
      return tl::unexpected<Fault>(packet.error());
    }
    const auto message = static_cast<RemoteMessage>(packet->header.message);
    if (message == RemoteMessage::frame && take_or_return(packet->header)) {
      return make_frame(*std::move(packet));
    }
    if (message == RemoteMessage::error) {
      return fail(Errc::io, fmt::format("{}: it reports errno {}", describe(spec_),
                                        packet->header.flags));
    }
    if (Clock::now() >= deadline) {
      return fail(Errc::timeout, describe(spec_) + ": no frame before the deadline");
    }
  }
}

Result<double> RemoteCamera::set_exposure(double exposure_us) {
  RemoteHeader ask;
  ask.message = static_cast<std::uint16_t>(RemoteMessage::set_exposure);
  ask.exposure_us = static_cast<float>(exposure_us);
  if (auto sent = send(ask); !sent) {
    return tl::unexpected<Fault>(sent.error());
  }
  return answer_to(RemoteMessage::set_exposure).map([](const RemoteHeader& header) {
    return static_cast<double>(header.exposure_us);
  });
}

Result<void> RemoteCamera::set_trigger(TriggerSource source) {
  trigger_ = source;
  return {};
}

Result<void> RemoteCamera::trigger() {
  RemoteHeader header;
  header.message = static_cast<std::uint16_t>(RemoteMessage::trigger);
  return send(header);
}

bool RemoteCamera::take_or_return(const RemoteHeader& header) {
  if (n_held_->load() < max_held_) {
    ++*n_held_;
    return true;
  }
  (void)send_packet(socket_->get(), release_of(header.sequence));
  return false;
}

std::shared_ptr<RemoteFrameMemory> RemoteCamera::memory_of(const Fd& fd, std::size_t stride) {
  struct stat info {};
  if (::fstat(fd.get(), &info) != 0) {
    return nullptr;
  }
  const auto found = std::find_if(files_.begin(), files_.end(), [&](const KnownFile& file) {
    return file.device == info.st_dev && file.inode == info.st_ino;
  });
  const bool is_known = found != files_.end();
  std::shared_ptr<RemoteFrameMemory> memory = is_known ? found->memory.lock() : nullptr;
  if (memory == nullptr ||
      memory->size() < stride * static_cast<std::size_t>(spec_.frame_height)) {
    memory = RemoteFrameMemory::open(fd, stride, spec_.frame_height, spec_.frame_width);
  }
  if (is_known) {
    files_.erase(found);
  }
  if (memory != nullptr && memory->is_mapped()) {
    files_.push_front({info.st_dev, info.st_ino, memory, is_known ? memory : nullptr});
    if (files_.size() > max_held_ + kSpareFiles) {
      files_.pop_back();
    }
  }
  return memory;
}

void RemoteCamera::stop() noexcept {
  if (socket_ != nullptr) {
    RemoteHeader header;
    header.message = static_cast<std::uint16_t>(RemoteMessage::stop);
    (void)send_packet(socket_->get(), header);
    // Frames still held keep their memory; releasing them later finds the connection closed.
    ::shutdown(socket_->get(), SHUT_RDWR);
  }
  socket_.reset();
  queued_.clear();
  files_.clear();
  n_held_.reset();
}

Result<void> RemoteCamera::send(const RemoteHeader& header) {
  if (socket_ == nullptr) {
    return fail(Errc::device_gone, describe(spec_) + ": not connected");
  }
  if (const int error = send_packet(socket_->get(), header); error != 0) {
    return fail(errc_of(error),
                fmt::format("{}: send: {}", describe(spec_), std::strerror(error)), error);
  }
  return {};
}

Result<RemoteCamera::Packet> RemoteCamera::receive(Clock::time_point deadline) {
  if (socket_ == nullptr) {
    return fail(Errc::device_gone, describe(spec_) + ": not connected");
  }
  for (;;) {
    Packet packet;
    iovec part{.iov_base = &packet.header, .iov_len = sizeof packet.header};
    alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof(int) * 4)> control{};
    msghdr message{};
    message.msg_iov = &part;
    message.msg_iovlen = 1;
    message.msg_control = control.data();
    message.msg_controllen = control.size();
    const ssize_t n = ::recvmsg(socket_->get(), &message, MSG_DONTWAIT | MSG_CMSG_CLOEXEC);
    const int error = errno;
    if (n < 0 && error == EINTR) {
      continue;
    }
    if (n < 0 && error == EAGAIN) {
      const auto left = std::chrono::ceil<milliseconds>(deadline - Clock::now());
      if (left.count() <= 0) {
        return fail(Errc::timeout, describe(spec_) + ": no message before the deadline");
      }
      pollfd wait{.fd = socket_->get(), .events = POLLIN, .revents = 0};
      (void)::poll(&wait, 1, static_cast<int>(std::min<long long>(left.count(), 60000)));
      continue;
    }
    if (n < 0) {
      return fail(errc_of(error),
                  fmt::format("{}: receive: {}", describe(spec_), std::strerror(error)), error);
    }
    packet.arrival_ns =
        std::chrono::duration_cast<std::chrono::nanoseconds>(Clock::now().time_since_epoch())
            .count();
    // Take ownership of every descriptor received, whatever else is wrong with the message.
    for (cmsghdr* c = CMSG_FIRSTHDR(&message); c != nullptr; c = CMSG_NXTHDR(&message, c)) {
      if (c->cmsg_level != SOL_SOCKET || c->cmsg_type != SCM_RIGHTS) {
        continue;
      }
      const std::size_t count = (c->cmsg_len - CMSG_LEN(0)) / sizeof(int);
      for (std::size_t i = 0; i < count; ++i) {
        int fd = -1;
        std::memcpy(&fd, CMSG_DATA(c) + i * sizeof(int), sizeof(int));
        packet.memory.reset(fd);
      }
    }
    if (n == 0) {
      return fail(Errc::device_gone, describe(spec_) + ": it closed the connection");
    }
    if (n != static_cast<ssize_t>(sizeof packet.header) ||
        packet.header.magic != kRemoteMagic || packet.header.version != kRemoteVersion) {
      return fail(Errc::protocol, fmt::format("{}: {} bytes that are no header of version {}",
                                              describe(spec_), n, kRemoteVersion));
    }
    const RemoteHeader& h = packet.header;
    if (!std::isfinite(h.exposure_us) || !std::isfinite(h.gain_db) || !std::isfinite(h.fps)) {
      return fail(Errc::protocol,
                  describe(spec_) + ": a header whose exposure, gain or rate is no number");
    }
    return packet;
  }
}

Result<RemoteHeader> RemoteCamera::answer_to(RemoteMessage message) {
  const Clock::time_point deadline = Clock::now() + kAnswerTime;
  for (;;) {
    auto packet = receive(deadline);
    if (!packet) {
      return tl::unexpected<Fault>(packet.error());
    }
    const auto kind = static_cast<RemoteMessage>(packet->header.message);
    if (kind == message) {
      return packet->header;
    }
    if (kind == RemoteMessage::error) {
      const auto error = static_cast<int>(packet->header.flags);
      return fail(error == EBUSY ? Errc::device_busy : Errc::refused,
                  fmt::format("{}: it refused: {}", describe(spec_), std::strerror(error)),
                  error);
    }
    if (kind == RemoteMessage::frame && n_held_ != nullptr && take_or_return(packet->header)) {
      queued_.push_back(*std::move(packet));
    }
    if (Clock::now() >= deadline) {
      return fail(Errc::timeout, describe(spec_) + ": no answer before the deadline");
    }
  }
}

Result<Frame> RemoteCamera::make_frame(Packet packet) {
  const RemoteHeader& h = packet.header;
  FrameInfo info{.sequence = h.sequence,
                 .timestamp_ns = h.timestamp_ns,
                 .arrival_ns = packet.arrival_ns,
                 .flags = h.flags,
                 .exposure_us = h.exposure_us,
                 .gain_db = h.gain_db};
  const auto width = static_cast<std::size_t>(spec_.frame_width);
  const auto height = static_cast<std::size_t>(spec_.frame_height);
  const std::size_t stride = h.stride;
  const bool is_shaped = h.width == width && h.height == height && stride >= 2 * width &&
                         stride % 2 == 0 && stride <= 64 * width + 4096;
  if (!packet.memory.is_open() || !is_shaped) {
    --*n_held_;
    return fail(Errc::protocol,
                fmt::format("{}: frame {} of {} x {}, stride {}, {} memory; expected {} x {}",
                            describe(spec_), h.sequence, h.width, h.height, h.stride,
                            packet.memory.is_open() ? "with" : "without", width, height));
  }
  std::shared_ptr<RemoteFrameMemory> memory =
      h.bytes >= stride * height ? memory_of(packet.memory, stride) : nullptr;
  ImageView<const std::uint16_t> pixels;
  if (memory == nullptr) {
    info.flags |= kFrameShort;
  } else {
    pixels = memory->view(stride, spec_.frame_height, spec_.frame_width);
  }
  return Frame(info, pixels,
               [memory, n_held = n_held_, socket = socket_, sequence = h.sequence]() mutable {
                 memory.reset();
                 --*n_held;  // first: the server may send the next frame at once
                 (void)send_packet(socket->get(), release_of(sequence));
               });
}

}  // namespace haarlight::capture
