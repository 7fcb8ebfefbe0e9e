// SPDX-License-Identifier: Apache-2.0
#include "sim/virtual_rig.h"

#include <chrono>
#include <cstddef>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "tests/sim/made_transport.h"
#include "tests/sim/remote_client.h"

namespace haarlight::sim {
namespace {

using testing::flat_transport;
using testing::RemoteClient;
using testing::TemporaryFolder;

Rig small_rig() { return read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml"); }

std::vector<Transport> flat_transports(const TemporaryFolder& folder) {
  std::vector<Transport> transports;
  transports.push_back(flat_transport(folder, 64, 48, std::vector<float>(64, 1.0F)));
  return transports;
}

TEST(VirtualRig, ServesCameraAndControllerAtItsOwnAddresses) {
  const TemporaryFolder folder;
  const std::vector<Transport> transports = flat_transports(folder);
  VirtualRigOptions options;
  options.own_folder = folder.path();
  VirtualRig rig(small_rig(), transports, options);
  EXPECT_TRUE(rig.rig().controller.address.starts_with("127.0.0.1:"));
  EXPECT_EQ(rig.rig().cameras[0].device, (folder / "main.sock").string());
  RemoteClient client(rig.rig().cameras[0].device);
  client.send(capture::RemoteMessage::setup);
  ASSERT_TRUE(client.next());
  client.send(capture::RemoteMessage::start);
  const auto frame = client.next();
  ASSERT_TRUE(frame);
  const auto tag =
      capture::decode_metadata_rows({frame->words.data() + std::ptrdiff_t{48} * 64, 8, 64, 1});
  ASSERT_TRUE(tag);
  EXPECT_EQ(*tag, (capture::FrameTag{0, false}));  // dark since the start
}

TEST(VirtualRig, RestartsTheControllerByScript) {
  const TemporaryFolder folder;
  const std::vector<Transport> transports = flat_transports(folder);
  VirtualRigOptions options;
  options.own_folder = folder.path();
  options.faults = parse_fault_script(
      "[[restart]]\nat_s = 0.05\noff_ms = 10.0\n"
      "[[bus]]\nat_s = 0.01\nfor_s = 0.01\nkind = \"dead\"\n"
      "[[bus]]\nat_s = 0.02\nfor_s = 0.01\nkind = \"slow\"\ndelay_ms = 1.0\n",
      "f.toml");
  VirtualRig rig(small_rig(), transports, options);
  const std::uint32_t boot = rig.controller().boot_id();
  RemoteClient client(rig.rig().cameras[0].device);
  client.send(capture::RemoteMessage::setup);
  ASSERT_TRUE(client.next());
  client.send(capture::RemoteMessage::start);
  for (int i = 0; i < 2000 && rig.controller().boot_id() == boot; ++i) {
    ASSERT_TRUE(client.next());
  }
  EXPECT_EQ(rig.controller().boot_id(), boot + 1);
}

TEST(VirtualRig, RefusesARigItCannotPlay) {
  const TemporaryFolder folder;
  const std::vector<Transport> transports = flat_transports(folder);
  VirtualRigOptions options;
  options.own_folder = folder.path();
  Rig rig = small_rig();
  rig.controller.kind = ControllerKind::usb;
  EXPECT_THROW(VirtualRig(rig, transports, options), Error);
  rig = small_rig();
  rig.cameras[0].kind = CameraKind::v4l2;
  EXPECT_THROW(VirtualRig(rig, transports, options), Error);
  rig = small_rig();
  EXPECT_THROW(VirtualRig(rig, {}, options), Error);
}

TEST(VirtualRig, EndsWhileAFaultIsStillToCome) {
  const TemporaryFolder folder;
  const std::vector<Transport> transports = flat_transports(folder);
  VirtualRigOptions options;
  options.own_folder = folder.path();
  options.faults = parse_fault_script("[[restart]]\nat_s = 1e6\n", "f.toml");
  const VirtualRig rig(small_rig(), transports, options);  // its end does not wait 11 days
}

}  // namespace
}  // namespace haarlight::sim
