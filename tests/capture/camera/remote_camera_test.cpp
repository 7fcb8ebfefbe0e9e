// SPDX-License-Identifier: Apache-2.0
#include "capture/camera/remote_camera.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cstring>
#include <fstream>
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

namespace haarlight::capture {
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
  /// Answers setup as requested, with 4 buffers.
  void set_up() const {
    RemoteHeader header = receive();
    header.n_buffers = 4;
    send(header);
    EXPECT_EQ(receive().message, static_cast<std::uint16_t>(RemoteMessage::start));
  }
  void send_frame(const RemoteHeader& header, std::size_t memory_bytes, bool is_sealed) const {
    const Fd memory(::memfd_create("frame", MFD_CLOEXEC | MFD_ALLOW_SEALING));
    std::vector<std::uint16_t> words((memory_bytes + 1) / 2);
    for (std::size_t i = 0; i < words.size(); ++i) {
      words[i] = static_cast<std::uint16_t>(i + 1);
    }
    (void)!::write(memory.get(), words.data(), memory_bytes);
    if (is_sealed) {
      EXPECT_EQ(::fcntl(memory.get(), F_ADD_SEALS, F_SEAL_SHRINK), 0);
    }
    send_file(header, memory);
  }
  void send_file(RemoteHeader header, const Fd& memory) const {
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
  /// False when the client is gone.
  [[nodiscard]] bool try_send(const RemoteHeader& header) const {
    return ::send(client_.get(), &header, sizeof header, MSG_NOSIGNAL) > 0;
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

// ---- memory files, and servers that don't keep to the rules ----

/// A sparse memory file: its length costs nothing until it is read.
Fd make_file(std::size_t bytes, std::uint16_t first_word, int seals = F_SEAL_SHRINK) {
  Fd memory(::memfd_create("frame", MFD_CLOEXEC | MFD_ALLOW_SEALING));
  EXPECT_EQ(::ftruncate(memory.get(), static_cast<off_t>(bytes)), 0);
  EXPECT_EQ(::pwrite(memory.get(), &first_word, sizeof first_word, 0), 2);
  EXPECT_TRUE(seals == 0 || ::fcntl(memory.get(), F_ADD_SEALS, seals) == 0);
  return memory;
}

/// Bytes of memory files that this process has mapped.
std::size_t mapped_bytes() {
  std::ifstream maps("/proc/self/maps");
  std::size_t bytes = 0;
  for (std::string line; std::getline(maps, line);) {
    if (line.find("memfd:frame") != std::string::npos) {
      const std::size_t dash = line.find('-');
      bytes += std::stoull(line.substr(dash + 1), nullptr, 16) - std::stoull(line, nullptr, 16);
    }
  }
  return bytes;
}

/// What of this process's memory is resident and shared, bytes.
std::size_t resident_shared_bytes() {
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);) {
    if (line.starts_with("RssShmem:")) {
      return std::stoull(line.substr(9)) * 1024;
    }
  }
  return 0;
}

/// A camera of 5 megapixels whose server grants four frames.
class LargeRemoteCamera : public RemoteCameraTest {
 protected:
  static constexpr int kLargeWidth = 2448;
  static constexpr int kLargeHeight = 2048;
  static constexpr std::size_t kLargeBytes = std::size_t{2} * kLargeWidth * kLargeHeight;
  static constexpr std::size_t kPage = 4096;
  static constexpr std::size_t kPageSlack = 64 * kPage;

  LargeRemoteCamera() {
    spec_.frame_width = kLargeWidth;
    spec_.frame_height = kLargeHeight;
    spec_.active_rows = kLargeHeight;
  }
  static RemoteHeader large_header(std::uint64_t sequence) {
    RemoteHeader header = frame_header(sequence);
    header.width = kLargeWidth;
    header.height = kLargeHeight;
    header.stride = 2 * kLargeWidth;
    header.bytes = static_cast<std::uint32_t>(kLargeBytes);
    return header;
  }
  /// Reads a word of every 16th page.
  static void touch(const Frame& frame) {
    std::uint32_t sum = 0;
    const std::uint16_t* words = frame.pixels().data();
    for (std::size_t i = 0; i < kLargeBytes / 2; i += 16 * kPage / 2) {
      sum += words[i];
    }
    EXPECT_EQ(sum, frame.info().sequence);  // the first word; all others are 0
  }
  /// Takes `n` frames with two of them held; the most that was mapped and resident.
  struct Peak {
    std::size_t mapped = 0;
    std::size_t resident = 0;
  };
  Peak take(int n) {
    RemoteCamera camera;
    const auto setup = camera.start(spec_);
    EXPECT_TRUE(setup.has_value());
    Peak peak;
    Frame last;
    for (int i = 0; i < n; ++i) {
      auto frame = camera.next(Clock::now() + 20s);
      if (!frame) {
        ADD_FAILURE() << "frame " << i << ": " << frame.error().what;
        break;
      }
      touch(*frame);
      peak.mapped = std::max(peak.mapped, mapped_bytes());
      peak.resident = std::max(peak.resident, resident_shared_bytes());
      last = *std::move(frame);
    }
    return peak;
  }
};

TEST_F(LargeRemoteCamera, ANewMemoryFileForEachFrameCostsNoMoreThanTheFramesHeld) {
  constexpr int kFrames = 600;
  ScriptedCamera server(spec_.device, [&](ScriptedCamera& s) {
    s.set_up();
    for (int i = 1; i <= kFrames; ++i) {
      s.send_file(large_header(static_cast<std::uint64_t>(i)),
                  make_file(kLargeBytes, static_cast<std::uint16_t>(i)));
      if (i >= 2) {  // two under way
        (void)s.receive();
      }
    }
    (void)s.receive();
  });
  const std::size_t resident_before = resident_shared_bytes();
  const Peak peak = take(kFrames);
  EXPECT_LE(peak.mapped, 2 * kLargeBytes);
  EXPECT_LE(peak.resident, resident_before + 2 * kLargeBytes + kPageSlack);
  EXPECT_EQ(mapped_bytes(), 0U);
}

TEST_F(LargeRemoteCamera, FilesThatComeTwiceAndNeverAgainStayWithinTheLimit) {
  constexpr int kFrames = 120;
  ScriptedCamera server(spec_.device, [&](ScriptedCamera& s) {
    s.set_up();
    Fd file;
    for (int i = 1; i <= kFrames; ++i) {
      const auto word = static_cast<std::uint16_t>(i);
      if (i % 2 == 1) {
        file = make_file(kLargeBytes, word);
      }
      (void)!::pwrite(file.get(), &word, sizeof word, 0);
      s.send_file(large_header(static_cast<std::uint64_t>(i)), file);
      if (i >= 2) {
        (void)s.receive();
      }
    }
    (void)s.receive();
  });
  // The sequence is checked against the first word, which the next frame of the same file may
  // overwrite: one frame at a time.
  RemoteCamera camera;
  ASSERT_TRUE(camera.start(spec_).has_value());
  for (int i = 0; i < kFrames; ++i) {
    const auto frame = camera.next(Clock::now() + 20s);
    ASSERT_TRUE(frame.has_value()) << frame.error().what;
    EXPECT_LE(mapped_bytes(), (4 + RemoteCamera::kSpareFiles) * kLargeBytes);
  }
  camera.stop();
  EXPECT_EQ(mapped_bytes(), 0U);
}

TEST_F(RemoteCameraTest, AFileThatComesAgainIsMappedOnce) {
  ScriptedCamera server(spec_.device, [&](ScriptedCamera& s) {
    s.set_up();
    std::array<Fd, 5> files;  // one more than frames granted
    for (auto& file : files) {
      file = make_file(kPixelBytes, 1);
    }
    for (std::size_t i = 0; i < 50; ++i) {
      s.send_file(frame_header(i + 1), files[i % files.size()]);
      (void)s.receive();
    }
  });
  RemoteCamera camera;
  ASSERT_TRUE(camera.start(spec_).has_value());
  std::array<const std::uint16_t*, 5> positions{};
  for (std::size_t i = 0; i < 50; ++i) {
    const auto frame = camera.next(Clock::now() + 2s);
    ASSERT_TRUE(frame.has_value()) << frame.error().what;
    if (i >= 10) {
      EXPECT_EQ(frame->pixels().data(), positions[i % 5]) << i;
    }
    positions[i % 5] = frame->pixels().data();
  }
}

TEST_F(RemoteCameraTest, FramesBeyondThoseGrantedAreGivenBackUnseen) {
  constexpr std::uint64_t kSent = 60;
  std::atomic<std::uint64_t> n_back{0};
  ScriptedCamera server(spec_.device, [&](ScriptedCamera& s) {
    s.set_up();  // four
    for (std::uint64_t i = 1; i <= kSent; ++i) {
      s.send_frame(frame_header(i), kPixelBytes, true);
    }
    while (s.receive().message == static_cast<std::uint16_t>(RemoteMessage::release)) {
      if (++n_back == kSent) {
        s.send_frame(frame_header(kSent + 1), kPixelBytes, true);
      }
    }
  });
  RemoteCamera camera;
  ASSERT_TRUE(camera.start(spec_).has_value());
  std::vector<Frame> held;
  for (std::uint64_t i = 1; i <= 4; ++i) {
    held.push_back(*camera.next(Clock::now() + 2s));
    EXPECT_EQ(held.back().info().sequence, i);
  }
  EXPECT_EQ(camera.next(Clock::now() + 500ms).error().code, Errc::timeout);
  held.clear();
  const auto frame = camera.next(Clock::now() + 5s);
  ASSERT_TRUE(frame.has_value()) << frame.error().what;
  EXPECT_EQ(frame->info().sequence, kSent + 1);
  EXPECT_EQ(n_back, kSent);
}

TEST_F(LargeRemoteCamera, AServerThatGrantsTooMuchIsTakenAtLess) {
  ScriptedCamera server(spec_.device, [&](ScriptedCamera& s) {
    RemoteHeader header = s.receive();
    header.n_buffers = 1'000'000'000;
    s.send(header);
    (void)s.receive();
  });
  RemoteCamera camera;
  const auto setup = camera.start(spec_);
  ASSERT_TRUE(setup.has_value());
  EXPECT_EQ(setup->n_buffers, (std::size_t{1} << 30U) / kLargeBytes);
}

TEST_F(RemoteCameraTest, AFileShortenedBehindItsFrameEndsNothing) {
  const int n = 2000;
  ScriptedCamera server(spec_.device, [&](ScriptedCamera& s) {
    s.set_up();
    for (int i = 0; i < n; ++i) {
      // Shortened, and sealed after that, while the client looks at it.
      const Fd file = make_file(kPixelBytes, 1, 0);
      s.send_file(frame_header(static_cast<std::uint64_t>(i) + 1), file);
      for (int spin = 0; spin < i % 50; ++spin) {
        (void)::fcntl(file.get(), F_GET_SEALS);
      }
      (void)!::ftruncate(file.get(), 0);
      (void)::fcntl(file.get(), F_ADD_SEALS, F_SEAL_SHRINK);
      (void)s.receive();
    }
  });
  RemoteCamera camera;
  ASSERT_TRUE(camera.start(spec_).has_value());
  int n_whole = 0;
  for (int i = 0; i < n; ++i) {
    const auto frame = camera.next(Clock::now() + 5s);
    ASSERT_TRUE(frame.has_value()) << frame.error().what;
    const bool is_short = (frame->info().flags & kFrameShort) != 0;
    EXPECT_EQ(frame->pixels().is_empty(), is_short);
    n_whole += is_short ? 0 : frame->pixels()(0, 0);
  }
  RecordProperty("whole", n_whole);
}

TEST_F(RemoteCameraTest, FilesThatAreNoMemoryOrOnHugePagesAreCopied) {
  const std::filesystem::path on_disk = folder_.path() / "pixels";
  const bool has_huge = Fd(::memfd_create("x", MFD_CLOEXEC | MFD_HUGETLB)).is_open();
  ScriptedCamera server(spec_.device, [&](ScriptedCamera& s) {
    s.set_up();
    const std::vector<std::uint16_t> words(kPixelBytes, 9);
    std::ofstream(on_disk).write(reinterpret_cast<const char*>(words.data()),
                                 static_cast<std::streamsize>(2 * words.size()));
    s.send_file(frame_header(1), Fd(::open(on_disk.c_str(), O_RDWR | O_CLOEXEC)));
    RemoteHeader padded = frame_header(2);
    padded.stride += 4;
    padded.bytes = padded.stride * kHeight;
    s.send_file(padded, Fd(::open(on_disk.c_str(), O_RDWR | O_CLOEXEC)));
    if (has_huge) {
      const Fd huge(::memfd_create("frame", MFD_CLOEXEC | MFD_HUGETLB | MFD_ALLOW_SEALING));
      (void)!::ftruncate(huge.get(), 1 << 30);
      (void)::fcntl(huge.get(), F_ADD_SEALS, F_SEAL_SHRINK);
      s.send_file(frame_header(3), huge);
    }
    for (int i = 0; i < 3; ++i) {
      (void)s.receive();
    }
  });
  RemoteCamera camera;
  ASSERT_TRUE(camera.start(spec_).has_value());
  for (int i = 0; i < (has_huge ? 3 : 2); ++i) {
    const auto frame = camera.next(Clock::now() + 2s);
    ASSERT_TRUE(frame.has_value()) << frame.error().what;
    ASSERT_FALSE(frame->pixels().is_empty()) << i;
    EXPECT_EQ(frame->pixels()(kHeight - 1, kWidth - 1), i < 2 ? 9 : 0);
    EXPECT_EQ(mapped_bytes(), 0U);
  }
}

TEST_F(RemoteCameraTest, AFloodOfMessagesEndsAtTheDeadlineToo) {
  ScriptedCamera server(spec_.device, [&](ScriptedCamera& s) {
    s.set_up();
    const RemoteHeader nonsense = header_of(RemoteMessage::release);
    while (s.try_send(nonsense)) {
    }
  });
  RemoteCamera camera;
  ASSERT_TRUE(camera.start(spec_).has_value());
  // The flood lasts as long as the camera does: that these end shows that they do not wait for
  // its end.
  EXPECT_EQ(camera.next(Clock::now() + 50ms).error().code, Errc::timeout);
  EXPECT_EQ(camera.set_exposure(500.0).error().code, Errc::timeout);
}

}  // namespace
}  // namespace haarlight::capture
