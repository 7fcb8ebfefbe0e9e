// SPDX-License-Identifier: Apache-2.0
#include "haarlight/render/light/rig_lights.h"

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/rig/rig.h"

namespace haarlight::render {
namespace {

TEST(RigLights, KnowsTheLightsThatReachThePlane) {
  Rig rig = read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml");
  Face& face = rig.faces.front();
  const auto n_off = [&] { return lights_off_plane(rig, rig.planes.front()).size(); };
  EXPECT_EQ(n_off(), 0U);
  const Face above = face;
  face.emits = -above.emits;
  EXPECT_EQ(n_off(), 64U) << "all shine away";
  face = above;
  face.centre.z() = 0.0;
  EXPECT_EQ(n_off(), 64U) << "all lie in the plane";
  face.centre.z() = -above.centre.z();
  face.emits = -above.emits;
  EXPECT_EQ(n_off(), 64U) << "all shine on its back";
  rig.cameras.front().model.world_from_cam.translation().z() = -500.0;
  EXPECT_EQ(n_off(), 0U) << "and the camera sees that";
  rig = read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml");
  // A wall that stands half below the plane: rows with a corner above it count.
  Face& wall = rig.faces.front();
  wall.centre = {500.0, 0.0, 0.0};
  wall.u = Eigen::Vector3d::UnitY();
  wall.v = Eigen::Vector3d::UnitZ();
  wall.emits = -Eigen::Vector3d::UnitX();
  EXPECT_EQ(n_off(), 32U);
  EXPECT_NE(require_lit_planes(rig).find("warning: 32 of 64 lights"), std::string::npos);
}

TEST(RigLights, RefuseAPlaneThatNoneReaches) {
  Rig rig = read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml");
  EXPECT_EQ(require_lit_planes(rig), "");
  rig.faces.front().emits = -rig.faces.front().emits;
  EXPECT_THROW((void)require_lit_planes(rig), Error);
}

}  // namespace
}  // namespace haarlight::render
