// SPDX-License-Identifier: Apache-2.0
#include "sim/v4l2_output.h"

#include <string>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "tests/sim/made_transport.h"

// What it writes is tested against a real kernel: scripts/vm run capture.

namespace haarlight::sim {
namespace {

using testing::flat_transport;
using testing::TemporaryFolder;
using testing::test_camera;

LightSource no_light() {
  return {[](std::int64_t, std::int64_t) { return firmware_iface::LightHistory{}; }, {}};
}

/// What an output on this node is refused for.
std::string refusal_of(const CameraSpec& spec, const std::filesystem::path& node) {
  const TemporaryFolder folder;
  const Transport transport = flat_transport(folder, 64, 48, {1.0F});
  try {
    const V4l2Output output(spec, ControllerSpec{}, transport, no_light(), node);
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ExitCode::unavailable);
    EXPECT_EQ(error.where(), node.string());
    return error.problem();
  }
  return {};
}

TEST(V4l2Output, RefusesAMissingNode) {
  const std::string problem = refusal_of(test_camera(), "/dev/no-such-video");
  EXPECT_NE(problem.find("No such file"), std::string::npos) << problem;
}

TEST(V4l2Output, RefusesADeviceThatIsNoVideoNode) {
  const std::string problem = refusal_of(test_camera(), "/dev/null");
  EXPECT_NE(problem.find("VIDIOC_QUERYCAP"), std::string::npos) << problem;
}

}  // namespace
}  // namespace haarlight::sim
