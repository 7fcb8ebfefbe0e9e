// SPDX-License-Identifier: Apache-2.0
/// The real daemon as a process, against the simulator's servers in this one: stopped (SIGSTOP)
/// and killed (SIGKILL) while lights are on. What the lights spend afterwards is the lease's,
/// no more; then the capture goes on and every frame shows its own light.

#include <chrono>
#include <csignal>
#include <cstdlib>
#include <functional>
#include <regex>
#include <thread>

#include <fcntl.h>
#include <fmt/format.h>
#include <gtest/gtest.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include "haarlight/capture/daemon/daemon_client.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "sim/virtual_rig.h"
#include "tests/capture/session_truth.h"
#include "tests/sim/made_transport.h"

namespace haarlight::capture {
namespace {

using namespace std::chrono_literals;
using testing::expect_true_session;
using Clock = std::chrono::steady_clock;

constexpr std::chrono::milliseconds kLease{1000};

/// Replaces the value of a key at the start of a line.
std::string with_value(std::string text, const std::string& key, const std::string& value) {
  const std::size_t at = text.find("\n" + key + " = ");
  EXPECT_NE(at, std::string::npos) << key;
  const std::size_t end = text.find('\n', at + 1);
  return text.replace(at + 1, end - at - 1, key + " = " + value);
}

class DaemonProcess : public ::testing::TestWithParam<SyncMode> {
 public:
  DaemonProcess(const DaemonProcess&) = delete;
  DaemonProcess& operator=(const DaemonProcess&) = delete;

 protected:
  DaemonProcess() {
    std::string text = read_file(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml", 1U << 20U);
    text = with_value(text, "lease_ms", std::to_string(kLease.count()));
    text =
        with_value(text, "mode",
                   GetParam() == SyncMode::camera_leads ? "\"camera-leads\"" : "\"free-run\"");
    // Long enough on for a stop to fall into a lit moment.
    text = with_value(text, "fps", "60.0");
    const Rig wanted = parse_rig(text, "rig.toml");
    const CameraSpec& camera = wanted.cameras.front();
    transports_.push_back(testing::flat_transport(
        folder_, camera.frame_width, camera.active_rows, std::vector<float>(64, 0.7F)));
    served_ = std::make_unique<sim::VirtualRig>(
        wanted, transports_,
        sim::VirtualRigOptions{.n_buffers = 16, .own_folder = folder_.path()});
    text = with_value(text, "address", "\"" + served_->rig().controller.address + "\"");
    text = with_value(text, "device", "\"" + served_->rig().cameras.front().device + "\"");
    text = with_value(text, "folder", "\"" + (folder_.path() / "sessions").string() + "\"");
    text = with_value(text, "reserve_mb", "0.0");
    write_file_atomically(folder_.path() / "rig.toml", text);
  }

  ~DaemonProcess() override {
    if (pid_ > 0) {
      ::kill(pid_, SIGCONT);
      ::kill(pid_, SIGKILL);
      ::waitpid(pid_, nullptr, 0);
    }
  }

  void start() {
    const std::string rig = folder_.path() / "rig.toml";
    const std::filesystem::path said = folder_.path() / "said.txt";
    std::filesystem::remove(said);
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_addopen(&actions, 1, said.c_str(), O_WRONLY | O_CREAT, 0644);
    std::string program = (std::filesystem::read_symlink("/proc/self/exe").parent_path() /
                           "../../apps/haarlightd/haarlightd")
                              .string();
    std::vector<char*> arguments = {program.data(), const_cast<char*>(rig.c_str()),
                                    const_cast<char*>("--port"), const_cast<char*>("0"),
                                    nullptr};
    ASSERT_EQ(
        ::posix_spawn(&pid_, program.c_str(), &actions, nullptr, arguments.data(), environ), 0);
    posix_spawn_file_actions_destroy(&actions);
    std::string text;
    ASSERT_TRUE(wait_until([&] {
      text = std::filesystem::exists(said) ? read_file(said, 4096) : std::string();
      return text.find("http://") != std::string::npos && text.back() == '\n';
    })) << "the daemon did not start";
    url_ = text.substr(text.find("http://"), text.rfind('\n') - text.find("http://"));
  }

  static bool wait_until(const std::function<bool()>& is_so) {
    const auto deadline = Clock::now() + 60s;
    while (!is_so()) {
      if (Clock::now() > deadline) {
        return false;
      }
      std::this_thread::sleep_for(2ms);
    }
    return true;
  }

  [[nodiscard]] std::string state() const {
    try {
      return DaemonClient({.url = url_}).get("/v1/state").body;
    } catch (const Error&) {
      return {};
    }
  }

  /// A capture under way, some frames committed and a light on.
  void capture_until_lit() {
    const DaemonReply begun =
        DaemonClient({.url = url_})
            .post("/v1/run?name=p.toml",
                  "schema = 1\nname = \"p\"\npatterns = \"one_at_a_time\"\n"
                  "repeats = 4\n");
    ASSERT_EQ(begun.status, 202) << begun.body;
    const std::regex id(R"re("session":\s*"([^"]+)")re");
    std::smatch match;
    ASSERT_TRUE(std::regex_search(begun.body, match, id)) << begun.body;
    session_ = folder_.path() / "sessions" / match[1].str();
    ASSERT_TRUE(wait_until([&] {
      int n = 0;
      std::error_code ignored;
      for (const auto& entry :
           std::filesystem::directory_iterator(session_ / "frames", ignored)) {
        n += entry.path().extension() == ".tif" ? 1 : 0;
      }
      return n >= 12 && !served_->controller().lit().pattern->empty();
    }));
  }

  struct OnTime {
    double seconds = 0.0;    ///< at full drive, of all lights together
    double reading_s = 0.0;  ///< how long it took to ask them one after another
  };
  OnTime on_time() {
    const auto begin = Clock::now();
    OnTime sum;
    for (int k = 0; k < 64; ++k) {
      sum.seconds += served_->controller().total_on_seconds(k);
    }
    sum.reading_s = std::chrono::duration<double>(Clock::now() - begin).count();
    return sum;
  }

  /// The lights spend no more than one light for the length of the lease, then are dark.
  void expect_dark_by_the_lease(const OnTime& before) {
    std::this_thread::sleep_for(kLease + 200ms);
    EXPECT_TRUE(served_->controller().lit().pattern->empty());
    const double spent_s = on_time().seconds - before.seconds;
    const double lease_s = 1e-3 * static_cast<double>(kLease.count());
    fmt::print("{:.3f} s at 5 W after the stop, {:.2f} J; the lease allows {:.2f} J\n", spent_s,
               5.0 * spent_s, 5.0 * lease_s);
    // Beside the lease: a renewal still in the socket, and the light that steps while it is
    // read.
    EXPECT_LE(spent_s, lease_s + 5e-3 + before.reading_s);
    std::this_thread::sleep_for(300ms);
    EXPECT_EQ(on_time().seconds - before.seconds, spent_s) << "something was lit again";
  }

  void expect_finished() {
    ASSERT_TRUE(wait_until([&] { return std::filesystem::exists(session_ / "session.json"); }))
        << state();
    expect_true_session(session_);
  }

  testing::TemporaryFolder folder_;
  std::vector<sim::Transport> transports_;
  std::unique_ptr<sim::VirtualRig> served_;
  pid_t pid_ = -1;
  std::string url_;
  std::filesystem::path session_;
};

TEST_P(DaemonProcess, StoppedItSpendsTheLeaseAndGoesOnWhenItIsContinued) {
  start();
  capture_until_lit();
  ASSERT_EQ(::kill(pid_, SIGSTOP), 0);
  expect_dark_by_the_lease(on_time());
  ASSERT_EQ(::kill(pid_, SIGCONT), 0);
  expect_finished();
}

TEST_P(DaemonProcess, KilledItSpendsTheLeaseAndGoesOnAtItsNextStart) {
  start();
  capture_until_lit();
  ASSERT_EQ(::kill(pid_, SIGKILL), 0);
  const OnTime before = on_time();
  ::waitpid(pid_, nullptr, 0);
  pid_ = -1;
  expect_dark_by_the_lease(before);
  start();
  expect_finished();
}

TEST_P(DaemonProcess, RequestedToEndItDarkensAtOnce) {
  start();
  capture_until_lit();
  ASSERT_EQ(::kill(pid_, SIGTERM), 0);
  int status = 0;
  ::waitpid(pid_, &status, 0);
  pid_ = -1;
  EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0);
  EXPECT_TRUE(served_->controller().lit().pattern->empty());
}

TEST_P(DaemonProcess, ASessionMovedByTheCommandIsShownAndTakenAgain) {
  start();
  write_file_atomically(folder_.path() / "p.toml",
                        "schema = 1\nname = \"p\"\npatterns = \"one_at_a_time\"\n");
  const std::string program = (std::filesystem::read_symlink("/proc/self/exe").parent_path() /
                               "../../apps/haarlight" / "haarlight")
                                  .string();
  const auto command = [&](const std::string& arguments) {
    return std::system(("cd " + folder_.path().string() + " && " + program + " " + arguments +
                        " --daemon " + url_ + " >said-too.txt 2>&1")
                           .c_str());
  };
  ASSERT_EQ(command("capture p.toml -o vase"), 0)
      << read_file(folder_.path() / "said-too.txt", 1U << 20U);
  const std::filesystem::path vase = folder_.path() / "vase";
  ASSERT_TRUE(std::filesystem::exists(vase / "session.json"));
  const std::string said = state();
  const std::regex id(R"re("session":\s*"([^"]+)")re");
  std::smatch match;
  ASSERT_TRUE(std::regex_search(said, match, id)) << said;
  EXPECT_EQ(DaemonClient({.url = url_}).get("/v1/sessions/" + match[1].str() + "/map").status,
            200);
  ASSERT_EQ(command("reshoot 3 5"), 0);
  ASSERT_TRUE(wait_until([&] {
    return std::filesystem::exists(vase / "frames/000003_a1.tif") &&
           state().find(R"("phase":"done")") != std::string::npos;
  })) << state();
  expect_true_session(vase);
}

INSTANTIATE_TEST_SUITE_P(Modes, DaemonProcess,
                         ::testing::Values(SyncMode::free_run, SyncMode::camera_leads),
                         [](const auto& mode) {
                           return mode.param == SyncMode::free_run ? "FreeRun" : "CameraLeads";
                         });

}  // namespace
}  // namespace haarlight::capture
