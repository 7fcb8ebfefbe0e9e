// SPDX-License-Identifier: Apache-2.0
#include "sim/camera_server.h"

#include <algorithm>
#include <chrono>
#include <map>
#include <mutex>
#include <set>
#include <thread>

#include <gtest/gtest.h>

#include "capture/camera/camera.h"
#include "haarlight/core/error.h"
#include "tests/sim/made_transport.h"
#include "tests/sim/remote_client.h"

namespace haarlight::sim {
namespace {

using namespace std::chrono_literals;
using testing::ClientFrame;
using testing::flat_transport;
using testing::RemoteClient;
using testing::TemporaryFolder;
using testing::test_camera;

std::int64_t now_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

/// A light switched by the test.
class HandLight {
 public:
  HandLight() { show(0, {}); }
  void show(std::uint32_t tag, std::vector<firmware_iface::ElementLevel> lit) {
    const std::lock_guard lock(mutex_);
    log_.add(
        {now_ns(), tag,
         std::make_shared<const std::vector<firmware_iface::ElementLevel>>(std::move(lit))});
  }
  LightSource source() {
    return {[this](std::int64_t t0, std::int64_t t1) {
              const std::lock_guard lock(mutex_);
              return log_.between(t0, t1);
            },
            {}};
  }

 private:
  std::mutex mutex_;
  firmware_iface::TransitionLog log_{1000};
};

class CameraServerTest : public ::testing::Test {
 protected:
  CameraServerTest() : transport_(flat_transport(folder_, 64, 48, {1.5F, 0.5F})) {
    controller_.latch_us = 200.0;
    controller_.rise_us = 20.0;
    controller_.fall_us = 20.0;
  }

  std::unique_ptr<CameraServer> serve(const CameraServerOptions& options = {}) {
    return std::make_unique<CameraServer>(test_camera(), controller_, transport_,
                                          light_.source(), folder_ / "camera.sock", options);
  }

  static void start(RemoteClient& client) {
    client.send(capture::RemoteMessage::setup);
    const auto answer = client.next();
    ASSERT_TRUE(answer);
    ASSERT_EQ(answer->header.message,
              static_cast<std::uint16_t>(capture::RemoteMessage::setup));
    client.send(capture::RemoteMessage::start);
  }

  static std::optional<capture::FrameTag> tag_of(const ClientFrame& frame) {
    return capture::decode_metadata_rows(
        {frame.words.data() + std::ptrdiff_t{48} * 64, 8, 64, 1});
  }

  /// The first frame that is clean and shows `tag`.
  static std::optional<ClientFrame> first_clean(RemoteClient& client, std::uint32_t tag) {
    for (int i = 0; i < 400; ++i) {
      auto frame = client.next();
      if (!frame) {
        return std::nullopt;
      }
      const auto seen = tag_of(*frame);
      if (seen && *seen == capture::FrameTag{tag, false}) {
        return frame;
      }
    }
    return std::nullopt;
  }

  TemporaryFolder folder_;
  Transport transport_;
  ControllerSpec controller_;
  HandLight light_;
};

TEST_F(CameraServerTest, AnswersSetupWithWhatItIs) {
  const auto server = serve();
  RemoteClient client(server->socket());
  ASSERT_TRUE(client.is_connected());
  client.send(capture::RemoteMessage::setup, 0, 3000.0F);
  const auto answer = client.next();
  ASSERT_TRUE(answer);
  EXPECT_EQ(answer->header.width, 64U);
  EXPECT_EQ(answer->header.height, 56U);
  EXPECT_EQ(answer->header.stride, 128U);
  EXPECT_EQ(answer->header.bytes, 64U * 56U * 2U);
  EXPECT_EQ(answer->header.fourcc, 0x20363159U);  // "Y16 "
  EXPECT_EQ(answer->header.exposure_us, 3000.0F);
  EXPECT_EQ(answer->header.fps, 240.0F);
  EXPECT_EQ(answer->header.n_buffers, 8U);
}

TEST_F(CameraServerTest, StreamsFramesAtItsRateWithoutGaps) {
  const auto server = serve({.doubtful_us = 0.0});
  RemoteClient client(server->socket());
  start(client);
  std::int64_t previous = 0;
  for (std::uint64_t i = 0; i < 60; ++i) {
    const auto frame = client.next();
    ASSERT_TRUE(frame);
    ASSERT_EQ(frame->words.size(), 64U * 56U);
    EXPECT_EQ(frame->header.flags & capture::kFrameMonotonic, capture::kFrameMonotonic);
    EXPECT_FALSE(client.is_writable());
    if (i > 0 && server->counts().n_overrun == 0) {
      EXPECT_EQ(frame->header.sequence, i);
      EXPECT_NEAR(static_cast<double>(frame->header.timestamp_ns - previous), 1e9 / 240.0, 2.0);
    }
    previous = frame->header.timestamp_ns;
    EXPECT_LT(frame->header.timestamp_ns, now_ns());
  }
}

TEST_F(CameraServerTest, FramesShowTheLightAndDifferFromEachOther) {
  const auto server = serve();
  RemoteClient client(server->socket());
  start(client);
  light_.show(42, {{0, 65535}});
  const auto lit = first_clean(client, 42);
  ASSERT_TRUE(lit);
  double sum = 0.0;
  for (int i = 0; i < 48 * 64; ++i) {
    sum += lit->words[static_cast<std::size_t>(i)];
  }
  EXPECT_NEAR(sum / (48 * 64), 256.0 + 12000.0, 4.5 * 110.0 / std::sqrt(48.0 * 64.0));
  const auto next = client.next();
  ASSERT_TRUE(next);
  EXPECT_NE(next->words, lit->words);
}

TEST_F(CameraServerTest, TheSameCaptureGivesTheSamePixels) {
  // Two servers, other phases and times: the n-th clean frame of a tag is the same.
  std::vector<std::vector<std::uint16_t>> runs[2];
  for (auto& run : runs) {
    const auto server = serve();
    RemoteClient client(server->socket());
    start(client);
    for (std::uint32_t tag = 1; tag <= 10; ++tag) {
      light_.show(tag, {{static_cast<int>(tag % 2), 65535}});
      const auto frame = first_clean(client, tag);
      ASSERT_TRUE(frame);
      run.push_back(frame->words);
    }
  }
  EXPECT_EQ(runs[0], runs[1]);
}

TEST_F(CameraServerTest, ALightThatIsLitAgainHasOtherNoise) {
  // A capture refuses pixels that it has seen: a shot that is taken again would never end.
  const auto server = serve();
  RemoteClient client(server->socket());
  start(client);
  std::set<std::vector<std::uint16_t>> seen;
  for (int i = 0; i < 3; ++i) {
    light_.show(7, {{0, 65535}});
    const auto frame = first_clean(client, 7);
    ASSERT_TRUE(frame);
    EXPECT_TRUE(seen.insert(frame->words).second) << "as one before, time " << i;
    light_.show(0, {});
    ASSERT_TRUE(first_clean(client, 0));
  }
}

TEST_F(CameraServerTest, LosesFramesWhenTheClientHoldsAllBuffers) {
  const auto server = serve({.n_buffers = 3});
  RemoteClient client(server->socket());
  start(client);
  std::vector<std::uint64_t> held;
  for (int i = 0; i < 3; ++i) {
    const auto frame = client.next(3000, true);
    ASSERT_TRUE(frame);
    held.push_back(frame->header.sequence);
  }
  EXPECT_FALSE(client.next(100));
  EXPECT_GT(server->counts().n_no_buffer, 5U);
  for (const std::uint64_t sequence : held) {
    client.send(capture::RemoteMessage::release, sequence);
  }
  const auto frame = client.next();
  ASSERT_TRUE(frame);
  EXPECT_GT(frame->header.sequence, held.back() + 5);
}

TEST_F(CameraServerTest, ExposureIsInForceWhereTheFrameSaysSo) {
  const auto server = serve({.camera = {.has_noise = false}, .doubtful_us = 0.0});
  light_.show(1, {{1, 65535}});
  RemoteClient client(server->socket());
  start(client);
  ASSERT_TRUE(first_clean(client, 1));
  client.send(capture::RemoteMessage::set_exposure, 0, 1000.0F);
  bool is_changed = false;
  for (int i = 0; i < 40 && !is_changed; ++i) {
    const auto frame = client.next();
    ASSERT_TRUE(frame);
    if (frame->words.empty()) {
      EXPECT_EQ(frame->header.message,
                static_cast<std::uint16_t>(capture::RemoteMessage::set_exposure));
      EXPECT_EQ(frame->header.exposure_us, 1000.0F);
      continue;
    }
    const int expected = frame->header.exposure_us == 1000.0F ? 256 + 2000 : 256 + 4000;
    EXPECT_EQ(frame->words[0], expected);
    is_changed = frame->header.exposure_us == 1000.0F;
  }
  EXPECT_TRUE(is_changed);
}

TEST_F(CameraServerTest, RefusesNonsenseAndStaysUp) {
  const auto server = serve();
  {
    RemoteClient client(server->socket());
    client.send_bytes("hello", 5);
    const auto answer = client.next();
    ASSERT_TRUE(answer);
    EXPECT_EQ(answer->header.message,
              static_cast<std::uint16_t>(capture::RemoteMessage::error));
    EXPECT_EQ(answer->header.flags, static_cast<std::uint32_t>(EPROTO));
  }
  {
    RemoteClient client(server->socket());
    capture::RemoteHeader header;
    header.message = 99;
    client.send(header);
    auto answer = client.next();
    ASSERT_TRUE(answer);
    EXPECT_EQ(answer->header.flags, static_cast<std::uint32_t>(EPROTO));
    client.send(capture::RemoteMessage::set_exposure, 0, -1.0F);
    answer = client.next();
    ASSERT_TRUE(answer);
    EXPECT_EQ(answer->header.flags, static_cast<std::uint32_t>(EINVAL));
    header = capture::RemoteHeader{};
    header.message = static_cast<std::uint16_t>(capture::RemoteMessage::set_exposure);
    header.exposure_us = std::numeric_limits<float>::quiet_NaN();
    client.send(header);
    answer = client.next();
    ASSERT_TRUE(answer);
    EXPECT_EQ(answer->header.flags, static_cast<std::uint32_t>(EINVAL));
    client.send(capture::RemoteMessage::release, 12345);  // never given out
    // A second client is told to wait.
    RemoteClient second(server->socket());
    const auto busy = second.next();
    ASSERT_TRUE(busy);
    EXPECT_EQ(busy->header.flags, static_cast<std::uint32_t>(EBUSY));
  }
  RemoteClient client(server->socket());
  start(client);
  EXPECT_TRUE(client.next());
}

TEST_F(CameraServerTest, SurvivesAClientThatGoesAway) {
  const auto server = serve();
  for (int i = 0; i < 3; ++i) {
    RemoteClient client(server->socket());
    start(client);
    const auto frame = client.next(3000, true);
    ASSERT_TRUE(frame);
  }
  RemoteClient client(server->socket());
  start(client);
  ASSERT_TRUE(client.next());
  server->disconnect_client();
  for (int i = 0; i < 1000 && client.next(100); ++i) {
  }
  RemoteClient again(server->socket());
  start(again);
  EXPECT_TRUE(again.next());
}

TEST_F(CameraServerTest, ReplacesADeadSocketAndRefusesALiveOne) {
  auto server = serve();
  EXPECT_THROW(serve(), Error);
  server.reset();
  EXPECT_FALSE(std::filesystem::exists(folder_ / "camera.sock"));
  write_file_atomically(folder_ / "camera.sock", std::string_view("a plain file"));
  EXPECT_THROW(serve(), Error);  // and it is not removed
  EXPECT_TRUE(std::filesystem::exists(folder_ / "camera.sock"));
  EXPECT_THROW(CameraServer(test_camera(), controller_, transport_, light_.source(),
                            folder_ / std::string(200, 'x'), {}),
               Error);
}

TEST_F(CameraServerTest, ScriptedFaultsHappenAtTheirFraction) {
  CameraServerOptions options;
  options.doubtful_us = 0.0;
  options.faults = {.late_fraction = 0.1,
                    .late_ms = 5.0,
                    .drop_fraction = 0.1,
                    .duplicate_fraction = 0.1,
                    .stale_fraction = 0.1,
                    .swap_fraction = 0.1,
                    .jitter_us = 30.0};
  options.camera.seed = 5;
  options.fault_seed = 5;
  const auto server = serve(options);
  RemoteClient client(server->socket());
  start(client);
  std::map<std::uint64_t, int> times_seen;
  int n_same_pixels = 0;
  int n_backwards = 0;
  std::vector<std::uint16_t> previous;
  std::uint64_t previous_sequence = 0;
  constexpr int kFrames = 240;
  for (int i = 0; i < kFrames; ++i) {
    const auto frame = client.next();
    ASSERT_TRUE(frame);
    const std::uint64_t sequence = frame->header.sequence;
    ++times_seen[sequence];
    n_same_pixels += sequence != previous_sequence && frame->words == previous ? 1 : 0;
    n_backwards += sequence < previous_sequence ? 1 : 0;
    previous = frame->words;
    previous_sequence = sequence;
  }
  const auto n_twice = std::count_if(times_seen.begin(), times_seen.end(),
                                     [](const auto& seen) { return seen.second == 2; });
  const auto n_missing =
      static_cast<std::int64_t>(times_seen.rbegin()->first + 1 - times_seen.size());
  // Binomial(240, 0.1): 24 +- 4.6; 4.5 sigma either side. (A swap of a swapped one does
  // nothing.)
  EXPECT_NEAR(static_cast<double>(n_twice), 22.0, 21.0);
  EXPECT_NEAR(static_cast<double>(n_missing), 24.0, 22.0);
  EXPECT_NEAR(n_same_pixels, 22.0, 21.0);
  EXPECT_NEAR(n_backwards, 20.0, 19.0);
  EXPECT_GT(server->counts().n_faults, 80U);
}

TEST_F(CameraServerTest, DoubtfulFramesAreLostAndLeaveAGap) {
  const auto server = serve({.doubtful_us = 3900.0});  // nearly a whole frame
  RemoteClient client(server->socket());
  start(client);
  std::set<std::uint64_t> sequences;
  for (std::uint32_t tag = 1; tag <= 20; ++tag) {
    light_.show(tag, {{0, 65535}});
    for (int i = 0; i < 4; ++i) {
      const auto frame = client.next();
      ASSERT_TRUE(frame);
      sequences.insert(frame->header.sequence);
    }
  }
  const CameraServerCounts counts = server->counts();
  EXPECT_GT(counts.n_doubtful, 10U);
  EXPECT_EQ(*sequences.rbegin() + 1 - sequences.size() >= counts.n_doubtful - 1, true);
}

TEST_F(CameraServerTest, StrobesOnceAFrame) {
  std::atomic<int> n_strobes{0};
  LightSource source = light_.source();
  source.strobe = [&n_strobes](std::int64_t) { ++n_strobes; };
  const CameraServer server(test_camera(), controller_, transport_, source,
                            folder_ / "strobe.sock", {});
  RemoteClient client(server.socket());
  start(client);
  std::uint64_t last = 0;
  for (int i = 0; i < 30; ++i) {
    const auto frame = client.next();
    ASSERT_TRUE(frame);
    last = frame->header.sequence;
  }
  // Frames 0 .. last have ended, and at most two more.
  EXPECT_GE(n_strobes.load(), static_cast<int>(last) + 1);
  EXPECT_LE(n_strobes.load(), static_cast<int>(last) + 4);
}

}  // namespace
}  // namespace haarlight::sim
