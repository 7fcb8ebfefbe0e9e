// SPDX-License-Identifier: Apache-2.0
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "capture/doctor/rig_doctor.h"
#include "tests/capture/camera/v4l2/v4l2_rig.h"

namespace haarlight::capture {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using testing::usual_camera;

class V4l2Doctor : public ::testing::Test {
 protected:
  V4l2Doctor() {
    options_.root = machine_.paths().devices.parent_path();
    options_.camera_frames = 4;
    rig_.cameras.push_back(machine_.spec(0));
  }

  DoctorLine examined() { return examine_camera(rig_, 0, options_).at(0); }

  testing::V4l2Machine machine_;
  Rig rig_;
  DoctorOptions options_;
};

TEST_F(V4l2Doctor, FindsACameraByItsSerialNumberUnderAnotherNode) {
  rig_.cameras[0].v4l2.serial = "A1";
  machine_.plug(3, usual_camera(), "A1");  // video0, as the rig file says, is not there
  const DoctorLine line = examined();
  EXPECT_NE(line.finding, Finding::wrong) << line.found;
  EXPECT_THAT(line.found, HasSubstr("serial A1"));
  EXPECT_THAT(line.expected, HasSubstr("serial number A1"));
}

TEST_F(V4l2Doctor, NamesTheOtherCamerasWhereThatOneIsMissing) {
  rig_.cameras[0].v4l2.serial = "A1";
  machine_.plug(0, usual_camera(), "B2");  // under the rig file's node, but another one
  const DoctorLine line = examined();
  EXPECT_EQ(line.finding, Finding::wrong);
  EXPECT_THAT(line.hint.text(), AllOf(HasSubstr("correct serial"), HasSubstr("serial B2")));
}

TEST_F(V4l2Doctor, OffersWhatIsThereWhereTheNodeIsNot) {
  EXPECT_THAT(examined().hint.text(), HasSubstr("no camera at all"));
  machine_.plug(5, usual_camera(), "C3");
  const DoctorLine line = examined();
  EXPECT_EQ(line.finding, Finding::wrong);
  EXPECT_THAT(line.hint.text(), AllOf(HasSubstr("video5"), HasSubstr("serial C3")));
}

}  // namespace
}  // namespace haarlight::capture
