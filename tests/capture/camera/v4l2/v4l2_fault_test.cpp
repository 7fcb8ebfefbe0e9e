// SPDX-License-Identifier: Apache-2.0
#include <cerrno>
#include <cstring>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "capture/camera/v4l2_camera.h"
#include "tests/capture/camera/v4l2/v4l2_rig.h"

/// @file
/// The fault table's row of the camera: every call that a capture makes, failed at every one of
/// its occurrences, in each way a driver fails. Whatever happens ends in a value before its
/// deadline, leaks nothing, and a later start works.

namespace haarlight::capture {
namespace {

using namespace std::chrono_literals;
using testing::count_descriptors;
using testing::in;
using testing::usual_camera;

struct Outcome {
  bool is_fault = false;
  Errc code = Errc::io;
  std::string what;
  int n_frames = 0;
};

std::size_t count_system_calls() {
  std::size_t n = 0;
  for (const auto& [request, n_calls] : shim::calls()) {
    n += n_calls;
  }
  return n;
}

/// A small capture: every kind of call that the daemon makes. Ends at the first fault.
Outcome capture(V4l2Camera& camera, const CameraSpec& spec, const std::string& node,
                const V4l2Paths& paths) {
  Outcome outcome;
  const auto note = [&](const Fault& fault) {
    outcome.is_fault = true;
    outcome.code = fault.code;
    outcome.what = fault.what;
  };
  if (const auto listed = describe_v4l2_camera(node, paths); !listed) {
    note(listed.error());
    return outcome;
  }
  if (const auto setup = camera.start(spec); !setup) {
    note(setup.error());
    return outcome;
  }
  for (int i = 0; i < 8; ++i) {
    if (i == 3) {
      if (const auto set = camera.set_exposure(4000.0); !set) {
        note(set.error());
        break;
      }
    }
    if (i == 5) {  // an event that is no drift: the value is the one set
      shim::move_control(node, V4L2_CID_GAIN, 0, true);
    }
    const std::size_t n_before = count_system_calls();
    const auto frame = camera.next(std::chrono::steady_clock::now() + 500ms);
    // It does not ask a driver that refuses again and again: a restart takes 30.
    EXPECT_LT(count_system_calls() - n_before, 100U);
    if (!frame) {
      note(frame.error());
      break;
    }
    ++outcome.n_frames;
  }
  camera.stop();
  return outcome;
}

/// With a region, trigger controls and 64 bits: every call that haarlight knows.
shim::Camera full_camera() {
  shim::Camera camera = usual_camera();
  camera.sensor = shim::Region{0, 0, 640, 480};
  testing::add_trigger(camera);
  camera.controls.push_back({.id = V4L2_CID_CAMERA_CLASS_BASE + 40,
                             .name = "Exposure Auto Max",
                             .type = V4L2_CTRL_TYPE_INTEGER64,
                             .max = 10'000'000'000});
  return camera;
}

CameraSpec full_spec(CameraSpec spec) {
  spec.v4l2.crop = {16, 8};
  spec.v4l2.trigger = testing::usual_trigger();
  spec.v4l2.controls = {{"exposure_auto_max", 5'000'000'000, ""}};
  return spec;
}

class V4l2Fault : public ::testing::Test {
 protected:
  V4l2Fault() { machine_.plug(0, full_camera(), "A1"); }

  /// How often each call occurs in an undisturbed capture.
  std::map<unsigned long, std::size_t> count_calls() {
    shim::reset_calls();
    V4l2Camera camera(machine_.paths());
    const Outcome outcome = capture(camera, spec_, machine_.node(0), machine_.paths());
    EXPECT_FALSE(outcome.is_fault) << outcome.what;
    EXPECT_EQ(outcome.n_frames, 8);
    return shim::calls();
  }

  testing::V4l2Machine machine_;
  CameraSpec spec_ = full_spec(machine_.spec(0));
};

/// An errno, and whether the driver knows the calls of before 64 bits only.
class V4l2Errno : public V4l2Fault, public ::testing::WithParamInterface<std::pair<int, bool>> {
 protected:
  V4l2Errno() {
    if (GetParam().second) {
      shim::Camera camera = full_camera();
      camera.has_ext_controls = false;
      spec_.v4l2.controls.clear();
      machine_.unplug(0);
      machine_.plug(0, camera, "A1");
    }
  }
};

TEST_P(V4l2Errno, AtEveryCallEndsInAValueWithoutALeakAndALaterStartWorks) {
  const int error = GetParam().first;
  const auto counts = count_calls();
  // 22 ioctls, all that v4l2_device.cpp knows for a driver that knows 64 bits; open, mmap,
  // poll.
  // An old driver's three come after their refused successors.
  EXPECT_EQ(counts.size(), GetParam().second ? 28U : 25U);
  const std::size_t n_before = count_descriptors();
  int n_faults = 0;
  int n_survived = 0;
  for (const auto& [request, n_calls] : counts) {
    for (std::size_t n = 0; n < n_calls; ++n) {
      const std::string where =
          fmt::format("request {:#x}, call {} of {}", request, n, n_calls);
      shim::reset_calls();
      shim::fail_call(request, n, error);
      V4l2Camera camera(machine_.paths());
      const Outcome outcome = capture(camera, spec_, machine_.node(0), machine_.paths());
      EXPECT_TRUE(outcome.is_fault || outcome.n_frames == 8) << where;
      EXPECT_TRUE(!outcome.is_fault || !outcome.what.empty()) << where;
      n_faults += outcome.is_fault ? 1 : 0;
      n_survived += outcome.is_fault ? 0 : 1;
      shim::reset_calls();
      const auto again = camera.start(spec_);
      EXPECT_TRUE(again.has_value()) << where << ": " << (again ? "" : again.error().what);
      EXPECT_TRUE(camera.next(in(2s)).has_value()) << where;
      camera.stop();
      ASSERT_EQ(shim::n_open(), 0U) << where;
      ASSERT_EQ(count_descriptors(), n_before) << where;
    }
  }
  RecordProperty("faults", n_faults);
  RecordProperty("survived", n_survived);
  EXPECT_GT(n_faults, 20);
}
INSTANTIATE_TEST_SUITE_P(Errno, V4l2Errno,
                         ::testing::Values(std::pair{ENODEV, false}, std::pair{EIO, false},
                                           std::pair{EBUSY, false}, std::pair{EINVAL, false},
                                           std::pair{ENOMEM, false}, std::pair{EIO, true},
                                           std::pair{EINVAL, true}),
                         [](const auto& each) {
                           return std::string(strerrorname_np(each.param.first)) +
                                  (each.param.second ? "OldCalls" : "");
                         });

TEST_F(V4l2Fault, TheDeviceTakenAwayAtEveryCallIsGoneAndComesBackElsewhere) {
  const auto counts = count_calls();
  V4l2Camera camera(machine_.paths());  // knows whom it looks for
  ASSERT_TRUE(camera.start(spec_).has_value());
  camera.stop();
  const std::size_t n_before = count_descriptors();
  int at = 0;
  for (const auto& [request, n_calls] : counts) {
    for (std::size_t n = 0; n < n_calls; ++n) {
      const std::string where =
          fmt::format("request {:#x}, call {} of {}", request, n, n_calls);
      shim::reset_calls();
      shim::unplug_at_call(request, n);
      const Outcome outcome = capture(camera, spec_, machine_.node(at), machine_.paths());
      // Taken away in the last calls of all, nothing is lost.
      EXPECT_TRUE(outcome.n_frames == 8 || outcome.code == Errc::device_gone)
          << where << ": " << outcome.what;
      ASSERT_EQ(shim::n_open(), 0U) << where;
      machine_.unplug(at);
      at = 1 - at;  // back under the other node
      machine_.plug(at, full_camera(), "A1");
      shim::reset_calls();
      const auto again = camera.start(spec_);
      ASSERT_TRUE(again.has_value()) << where << ": " << again.error().what;
      EXPECT_TRUE(camera.next(in(2s)).has_value()) << where;
      camera.stop();
      ASSERT_EQ(count_descriptors(), n_before) << where;
    }
  }
}

TEST_F(V4l2Fault, ASignalAtAnyCallCostsNothing) {
  const auto counts = count_calls();
  for (const auto& [request, n_calls] : counts) {
    for (std::size_t n = 0; n < n_calls && request != shim::kMmap; ++n) {
      shim::reset_calls();
      shim::fail_call(request, n, EINTR);
      V4l2Camera camera(machine_.paths());
      const Outcome outcome = capture(camera, spec_, machine_.node(0), machine_.paths());
      EXPECT_FALSE(outcome.is_fault)
          << fmt::format("request {:#x}, call {}: {}", request, n, outcome.what);
    }
  }
}

TEST_F(V4l2Fault, EioForEverAtEveryKindOfCallEndsToo) {
  const auto counts = count_calls();
  for (const auto& [request, n_calls] : counts) {
    shim::reset_calls();
    shim::fail_call(request, n_calls / 2, EIO, 100'000);
    V4l2Camera camera(machine_.paths());
    (void)capture(camera, spec_, machine_.node(0), machine_.paths());
    shim::reset_calls();
    EXPECT_TRUE(camera.start(spec_).has_value()) << fmt::format("request {:#x}", request);
    camera.stop();
    ASSERT_EQ(shim::n_open(), 0U);
  }
}

}  // namespace
}  // namespace haarlight::capture
