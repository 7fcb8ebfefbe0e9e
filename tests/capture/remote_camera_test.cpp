#include "capture/remote_camera.h"

#include <array>
#include <atomic>
#include <cstring>
#include <functional>
#include <optional>
#include <thread>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "tests/temporary_folder.h"

namespace haarlight {
namespace {

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

constexpr int kWidth = 6;
constexpr int kHeight = 4;
constexpr std::size_t kPixelBytes = std::size_t{kWidth} * kHeight * 2;

RemoteHeader header_of(RemoteMessage message) {
  RemoteHeader header;
  header.message = static_cast<std::uint16_t>(message);
  return header;
}

/// A camera's side of the wire, driven step by step by a script on a thread of its own.
class ScriptedCamera {
 public:
  using Script = std::function<void(ScriptedCamera&)>;

  ScriptedCamera(const std::filesystem::path& path, Script script) {
    listener_.reset(::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0));
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    std::strncpy(address.sun_path, path.c_str(), sizeof address.sun_path - 1);
    EXPECT_EQ(::bind(listener_.get(), reinterpret_cast<sockaddr*>(&address), sizeof address),
              0);
    EXPECT_EQ(::listen(listener_.get(), 1), 0);
    thread_ = std::jthread([this, script = std::move(script)] {
      client_.reset(::accept(listener_.get(), nullptr, nullptr));
      script(*this);
      client_.reset();
    });
  }

  [[nodiscard]] RemoteHeader receive() const {
    RemoteHeader header;
    header.magic = 0;
    (void)::recv(client_.get(), &header, sizeof header, 0);
    return header;
  }
  void send(const RemoteHeader& header) const {
    (void)::send(client_.get(), &header, sizeof header, MSG_NOSIGNAL);
  }
  void send_bytes(std::size_t n) const {
    const std::array<char, 256> junk{};
    (void)::send(client_.get(), junk.data(), n, MSG_NOSIGNAL);
  }
  /// Answers setup as asked, with 4 buffers.
  void set_up() const {
    RemoteHeader header = receive();
    header.n_buffers = 4;
    send(header);
    EXPECT_EQ(receive().message, static_cast<std::uint16_t>(RemoteMessage::start));
  }
  void send_frame(RemoteHeader header, std::size_t memory_bytes, bool is_sealed) const {
    const Fd memory(::memfd_create("frame", MFD_CLOEXEC | MFD_ALLOW_SEALING));
    std::vector<std::uint16_t> words((memory_bytes + 1) / 2);
    for (std::size_t i = 0; i < words.size(); ++i) {
      words[i] = static_cast<std::uint16_t>(i + 1);
    }
    (void)!::write(memory.get(), words.data(), memory_bytes);
    if (is_sealed) {
      EXPECT_EQ(::fcntl(memory.get(), F_ADD_SEALS, F_SEAL_SHRINK), 0);
    }
    iovec part{.iov_base = &header, .iov_len = sizeof header};
    alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof(int))> control{};
    msghdr message{};
    message.msg_iov = &part;
    message.msg_iovlen = 1;
    message.msg_control = control.data();
    message.msg_controllen = control.size();
    cmsghdr* c = CMSG_FIRSTHDR(&message);
    c->cmsg_level = SOL_SOCKET;
    c->cmsg_type = SCM_RIGHTS;
    c->cmsg_len = CMSG_LEN(sizeof(int));
    const int fd = memory.get();
    std::memcpy(CMSG_DATA(c), &fd, sizeof fd);
    (void)::sendmsg(client_.get(), &message, MSG_NOSIGNAL);
  }

 private:
  Fd listener_;
  Fd client_;
  std::jthread thread_;
};

RemoteHeader frame_header(std::uint64_t sequence) {
  RemoteHeader header = header_of(RemoteMessage::frame);
  header.sequence = sequence;
  header.timestamp_ns = 12345;
  header.flags = kFrameMonotonic;
  header.width = kWidth;
  header.height = kHeight;
  header.stride = kWidth * 2;
  header.bytes = kWidth * kHeight * 2;
  header.exposure_us = 500.0F;
  return header;
}

class RemoteCameraTest : public ::testing::Test {
 protected:
  RemoteCameraTest() {
    spec_.id = "main";
    spec_.kind = CameraKind::remote;
    spec_.device = (folder_.path() / "camera.sock").string();
    spec_.frame_width = kWidth;
    spec_.frame_height = kHeight;
    spec_.active_rows = kHeight;
    spec_.exposure_us = 500.0;
  }
  testing::TemporaryFolder folder_;
  CameraSpec spec_;
};

TEST_F(RemoteCameraTest, NobodyThereIsDeviceGone) {
  RemoteCamera camera;
  EXPECT_EQ(camera.start(spec_).error().code, Errc::device_gone);
}

TEST_F(RemoteCameraTest, AFrameArrivesWithItsPixelsAndIsGivenBack) {
  for (const bool is_sealed : {true, false}) {
    const std::filesystem::path path = folder_.path() / (is_sealed ? "a.sock" : "b.sock");
    spec_.device = path.string();
    std::atomic<std::uint64_t> released{0};
    ScriptedCamera server(path, [&](ScriptedCamera& s) {
      s.set_up();
      s.send_frame(frame_header(77), kPixelBytes, is_sealed);
      const RemoteHeader back = s.receive();
      EXPECT_EQ(back.message, static_cast<std::uint16_t>(RemoteMessage::release));
      released = back.sequence;
    });
    RemoteCamera camera;
    const std::int64_t before_ns = Clock::now().time_since_epoch() / 1ns;
    const auto setup = camera.start(spec_);
    ASSERT_TRUE(setup.has_value()) << setup.error().what;
    EXPECT_EQ(setup->n_buffers, 4);
    {
      const auto frame = camera.next(Clock::now() + 2s);
      ASSERT_TRUE(frame.has_value()) << frame.error().what;
      EXPECT_EQ(frame->info().sequence, 77U);
      EXPECT_EQ(frame->info().timestamp_ns, 12345);
      EXPECT_GT(frame->info().arrival_ns, before_ns) << "taken when it came";
      EXPECT_EQ(frame->pixels()(0, 0), 1);
      EXPECT_EQ(frame->pixels()(kHeight - 1, kWidth - 1), kWidth * kHeight);
    }
    const auto limit = Clock::now() + 2s;
    while (released == 0 && Clock::now() < limit) {
      std::this_thread::yield();
    }
    EXPECT_EQ(released, 77U);
  }
}

TEST_F(RemoteCameraTest, AFrameOutlivesTheCamera) {
  ScriptedCamera server(spec_.device, [&](ScriptedCamera& s) {
    s.set_up();
    s.send_frame(frame_header(1), kPixelBytes, true);
    (void)s.receive();
  });
  std::optional<Frame> frame;
  {
    RemoteCamera camera;
    ASSERT_TRUE(camera.start(spec_).has_value());
    auto next = camera.next(Clock::now() + 2s);
    ASSERT_TRUE(next.has_value());
    frame.emplace(*std::move(next));
  }
  EXPECT_EQ(frame->pixels()(0, 1), 2);
}

TEST_F(RemoteCameraTest, AMemoryTooSmallIsAShortFrameAndNoCrash) {
  ScriptedCamera server(spec_.device, [&](ScriptedCamera& s) {
    s.set_up();
    s.send_frame(frame_header(1), 10, false);
    s.send_frame(frame_header(2), 10, true);
    (void)s.receive();
    (void)s.receive();
  });
  RemoteCamera camera;
  ASSERT_TRUE(camera.start(spec_).has_value());
  for (int i = 0; i < 2; ++i) {
    const auto frame = camera.next(Clock::now() + 2s);
    ASSERT_TRUE(frame.has_value()) << frame.error().what;
    EXPECT_NE(frame->info().flags & kFrameShort, 0U);
    EXPECT_TRUE(frame->pixels().is_empty());
  }
}

TEST_F(RemoteCameraTest, AFrameOfAnotherShapeIsAProtocolFault) {
  ScriptedCamera server(spec_.device, [&](ScriptedCamera& s) {
    s.set_up();
    RemoteHeader header = frame_header(1);
    header.stride = 3;
    s.send_frame(header, kPixelBytes, true);
    header = frame_header(2);
    header.width = 4096;
    s.send_frame(header, kPixelBytes, true);
    s.send(frame_header(3));  // without memory
    s.send_bytes(7);
    s.send_bytes(64);
    (void)s.receive();
  });
  RemoteCamera camera;
  ASSERT_TRUE(camera.start(spec_).has_value());
  for (int i = 0; i < 5; ++i) {
    EXPECT_EQ(camera.next(Clock::now() + 2s).error().code, Errc::protocol) << "message " << i;
  }
}

TEST_F(RemoteCameraTest, SilenceIsATimeoutAtTheDeadline) {
  ScriptedCamera server(spec_.device, [&](ScriptedCamera& s) {
    s.set_up();
    (void)s.receive();
  });
  RemoteCamera camera;
  ASSERT_TRUE(camera.start(spec_).has_value());
  const auto begin = Clock::now();
  EXPECT_EQ(camera.next(begin + 50ms).error().code, Errc::timeout);
  EXPECT_GE(Clock::now() - begin, 50ms);
  EXPECT_LT(Clock::now() - begin, 1s);
}

TEST_F(RemoteCameraTest, AClosedConnectionIsDeviceGone) {
  ScriptedCamera server(spec_.device, [](ScriptedCamera& s) { s.set_up(); });
  RemoteCamera camera;
  ASSERT_TRUE(camera.start(spec_).has_value());
  EXPECT_EQ(camera.next(Clock::now() + 2s).error().code, Errc::device_gone);
}

TEST_F(RemoteCameraTest, ARefusedOrDifferentSetupIsAFault) {
  spec_.device = (folder_.path() / "refuses.sock").string();
  ScriptedCamera refuses(spec_.device, [](ScriptedCamera& s) {
    (void)s.receive();
    RemoteHeader header = header_of(RemoteMessage::error);
    header.flags = EINVAL;
    s.send(header);
  });
  RemoteCamera camera;
  EXPECT_EQ(camera.start(spec_).error().code, Errc::refused);
  spec_.device = (folder_.path() / "smaller.sock").string();
  ScriptedCamera smaller(spec_.device, [](ScriptedCamera& s) {
    RemoteHeader header = s.receive();
    header.width -= 2;
    header.n_buffers = 4;
    s.send(header);
    (void)s.receive();
  });
  EXPECT_EQ(camera.start(spec_).error().code, Errc::refused);
}

TEST_F(RemoteCameraTest, FramesBeforeTheAnswerToAnExposureAreKept) {
  ScriptedCamera server(spec_.device, [&](ScriptedCamera& s) {
    s.set_up();
    RemoteHeader ask = s.receive();
    s.send_frame(frame_header(5), kPixelBytes, true);
    ask.exposure_us = 990.0F;
    s.send(ask);
    (void)s.receive();
  });
  RemoteCamera camera;
  ASSERT_TRUE(camera.start(spec_).has_value());
  const auto value = camera.set_exposure(1000.0);
  ASSERT_TRUE(value.has_value()) << value.error().what;
  EXPECT_DOUBLE_EQ(*value, 990.0);
  const auto frame = camera.next(Clock::now());
  ASSERT_TRUE(frame.has_value());
  EXPECT_EQ(frame->info().sequence, 5U);
}

}  // namespace
}  // namespace haarlight
