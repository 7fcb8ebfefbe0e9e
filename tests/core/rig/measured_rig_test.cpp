// SPDX-License-Identifier: Apache-2.0
#include "core/rig/measured_rig.h"

#include <Eigen/Geometry>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "tests/temporary_folder.h"

namespace haarlight {
namespace {

using ::testing::HasSubstr;

Rig small_rig() { return read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml"); }

MeasuredRig some_measurement(const Rig& rig) {
  MeasuredRig m;
  m.date = "2026-11-21T10:20:46Z";
  m.tool = "haarlight \"x\"";
  m.rig_hash = rig.hash;
  m.controller = MeasuredController{describe_controller(rig.controller),
                                    "haarlight-sim, serial 1",
                                    Measured{812.25, 3.5, 120},
                                    Measured{912.25, 20.0, 120},
                                    Measured{140.0, 8.0, 60},
                                    Measured{60.0, 8.0, 60},
                                    Measured{95.0, 12.0, 120}};
  m.lights =
      MeasuredLights{describe_lights(rig), {9, 41}, {}, {20, 21}, {21, 20}, {}, 0.004, 2};
  m.lights->power.assign(64, 1.0);
  MeasuredFace f;
  f.id = rig.faces[0].id;
  f.with = describe_face(rig.faces[0]);
  f.centre = rig.faces[0].centre + Eigen::Vector3d(1.5, -0.25, 3.0);
  f.centre_sigma = {0.1, 0.1, 0.2};
  const Eigen::AngleAxisd turn(0.02, Eigen::Vector3d::UnitX());
  f.u = turn * rig.faces[0].u;
  f.v = turn * rig.faces[0].v;
  f.emits = turn * rig.faces[0].emits;
  f.turn_sigma_deg = {0.01, 0.01, 0.02};
  f.lobe_mu = Measured{1.25, 0.01, 100000};
  f.power.assign(64, 1.0);
  f.power_sigma.assign(64, 0.002);
  f.reduced_chi2 = 1.02;
  m.faces.push_back(f);
  MeasuredCamera c;
  c.id = "main";
  c.with = describe_camera(rig.cameras[0]);
  c.identity = "remote camera /tmp/x";
  c.timestamp = TimestampMeaning::start_readout;
  c.evidence = "the offset follows the exposure";
  c.read_us = Measured{3100.0, 20.0, 30};
  c.exposure_delay_frames = Measured{2.0, 0.0, 24};
  c.gain_e_per_dn = Measured{0.92, 0.002, 1000};
  c.read_e = Measured{4.1, 0.02, 1000};
  c.full_well_e = Measured{14500.0, 40.0, 1000};
  c.black_dn = Measured{200.0, 0.02, 1000};
  MeasuredLens lens;
  lens.k = {88.5, 88.25, 32.5, 23.75};
  lens.k_sigma = {0.1, 0.1, 0.2, 0.2};
  lens.distortion << -0.05, 0.01, 1e-4, -2e-4, 0.0;
  lens.distortion_sigma << 0.01, 0.02, 1e-4, 1e-4, 0.0;
  lens.rms_px = 0.08;
  lens.n_views = 12;
  c.lens = lens;
  MeasuredPlane plane;
  plane.id = rig.planes[0].id;
  plane.with = describe_view(rig.cameras[0]);
  plane.camera = "main";
  plane.n = Eigen::Vector3d(0.01, 0.0, 1.0).normalized();
  plane.d = -2.5;
  plane.distance_sigma = 0.1;
  plane.tilt_sigma_deg = 0.02;
  m.planes.push_back(plane);
  m.cameras.push_back(c);
  return m;
}

TEST(MeasuredRig, GivesBackWhatWasWritten) {
  const MeasuredRig m = some_measurement(small_rig());
  const MeasuredRig back = parse_measured(to_toml(m), "x.measured.toml");
  EXPECT_EQ(to_toml(back), to_toml(m));
  EXPECT_EQ(back.controller->latch_us->value, 812.25);
  EXPECT_EQ(back.lights->miswired_to, (std::vector<int>{21, 20}));
  EXPECT_EQ(back.cameras[0].timestamp, TimestampMeaning::start_readout);
  EXPECT_EQ(back.tool, m.tool);
}

TEST(MeasuredRig, WinsOverTheRigFileBesideIt) {
  const testing::TemporaryFolder folder;
  const Rig written = small_rig();
  write_file_atomically(folder / "r.toml", written.text);
  write_file_atomically(folder / "r.measured.toml", to_toml(some_measurement(written)));
  const Rig rig = read_rig(folder / "r.toml");
  EXPECT_EQ(rig.controller.latch_us, 912.25) << "the latest light, not the mean";
  EXPECT_EQ(rig.cameras[0].timestamp, TimestampMeaning::start_readout);
  EXPECT_EQ(rig.cameras[0].noise.black_dn, 200.0);
  EXPECT_EQ(rig.cameras[0].exposure_delay_frames, 2);
  ASSERT_NE(rig.measured, nullptr);
  EXPECT_EQ(rig.measured->lights->dead, (std::vector<int>{9, 41}));
  EXPECT_EQ(read_rig_as_written(folder / "r.toml").controller.latch_us,
            written.controller.latch_us);
  EXPECT_THAT(describe_changes(written, rig),
              HasSubstr("latch 912.2 us (the rig file says 200)"));
}

TEST(MeasuredRig, AFileWithTheMeanLatchAloneIsToldOf) {
  const testing::TemporaryFolder folder;
  const Rig written = small_rig();
  MeasuredRig old = some_measurement(written);
  EXPECT_EQ(find_gap(old).problem, "");
  old.controller->latch_most_us.reset();
  write_file_atomically(folder / "r.toml", written.text);
  write_file_atomically(folder / "r.measured.toml", to_toml(old));
  ::testing::internal::CaptureStderr();
  const Rig rig = read_rig(folder / "r.toml");
  const std::string log = ::testing::internal::GetCapturedStderr();
  EXPECT_EQ(rig.controller.latch_us, 812.25);
  EXPECT_THAT(log, HasSubstr("r.measured.toml: it has no latch_most_us"));
  EXPECT_THAT(log, HasSubstr("haarlight rig commission"));
}

TEST(MeasuredRig, AFaceIsWhereItWasCalibrated) {
  const testing::TemporaryFolder folder;
  const Rig written = small_rig();
  write_file_atomically(folder / "r.toml", written.text);
  MeasuredRig m = some_measurement(written);
  write_file_atomically(folder / "r.measured.toml", to_toml(m));
  const Rig merged = read_rig(folder / "r.toml");
  EXPECT_TRUE(merged.faces[0].centre.isApprox(m.faces[0].centre, 1e-12));
  EXPECT_TRUE(merged.faces[0].emits.isApprox(m.faces[0].emits, 1e-10));
  EXPECT_EQ(merged.faces[0].lobe_mu, 1.25);
  EXPECT_THAT(describe_changes(written, merged), HasSubstr("3.36 mm and 1.15 degrees"));
  m.faces[0].with = "9 x 9, pitch 1 mm";
  write_file_atomically(folder / "r.measured.toml", to_toml(m));
  EXPECT_THROW((void)read_rig(folder / "r.toml"), Error);
  m.faces[0].with = describe_face(written.faces[0]);
  m.faces[0].power.resize(3);
  m.faces[0].power_sigma.resize(3);
  write_file_atomically(folder / "r.measured.toml", to_toml(m));
  EXPECT_THROW((void)read_rig(folder / "r.toml"), Error);
}

TEST(MeasuredRig, LensAndPlaneAreThoseOfTheCalibration) {
  const testing::TemporaryFolder folder;
  const Rig written = small_rig();
  write_file_atomically(folder / "r.toml", written.text);
  const MeasuredRig m = some_measurement(written);
  write_file_atomically(folder / "r.measured.toml", to_toml(m));
  const Rig merged = read_rig(folder / "r.toml");
  EXPECT_EQ(merged.cameras[0].model.fx, 88.5);
  EXPECT_EQ(merged.cameras[0].model.cy, 23.75);
  EXPECT_EQ(merged.cameras[0].model.distortion[3], -2e-4);
  const ShadowPlane& plane = merged.planes[0];
  EXPECT_NEAR(plane.n.dot(plane.origin) + plane.d, 0.0, 1e-9);
  EXPECT_NEAR(plane.u.dot(plane.n), 0.0, 1e-12);
  EXPECT_TRUE(plane.u.cross(plane.v).isApprox(plane.n, 1e-12));
  EXPECT_THAT(describe_changes(written, merged), HasSubstr("plane ground is 2.50 mm"));
  // The camera stands elsewhere: the plane was seen from there.
  std::string moved = written.text;
  const std::size_t at = moved.find("-560");
  ASSERT_NE(at, std::string::npos);
  moved.replace(at, 4, "-580");
  write_file_atomically(folder / "r.toml", moved);
  EXPECT_THROW((void)read_rig(folder / "r.toml"), Error);
}

TEST(MeasuredRig, StaysWithASession) {
  const testing::TemporaryFolder folder;
  const Rig written = small_rig();
  write_file_atomically(folder / "r.toml", written.text);
  write_file_atomically(folder / "r.measured.toml", to_toml(some_measurement(written)));
  const Rig rig = read_rig(folder / "r.toml");
  // What a session stores, opened from another folder where no measured file is.
  write_file_atomically(folder / "rig.toml", rig.text);
  const Rig again = read_rig(folder / "rig.toml");
  EXPECT_EQ(again.hash, rig.hash);
  EXPECT_EQ(again.hash, content_hash(again.text));
  EXPECT_EQ(again.controller.latch_us, 912.25);
  ASSERT_NE(again.measured, nullptr);
  EXPECT_EQ(to_toml(*again.measured), to_toml(*rig.measured));
  // Another measurement beside it would make two.
  write_file_atomically(folder / "rig.measured.toml", to_toml(*rig.measured));
  EXPECT_THROW((void)read_rig(folder / "rig.toml"), Error);
}

std::string stale_message(const std::string& from, const std::string& to) {
  const Rig written = small_rig();
  RigText text{written.text, to_toml(some_measurement(written))};
  const std::size_t at = text.written.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  text.written.replace(at, from.size(), to);
  try {
    (void)parse_rig(join_rig_text(text, "r.measured.toml"), "r.toml");
  } catch (const Error& error) {
    return error.what();
  }
  return "not stale";
}

TEST(MeasuredRig, IsRefusedWhenTheRigIsNoLongerTheOneMeasured) {
  EXPECT_THAT(stale_message("fps = 240.0", "fps = 120.0"), HasSubstr("stale: camera main"));
  EXPECT_THAT(stale_message("bits = 14", "bits = 12"), HasSubstr("12 bits"));
  EXPECT_THAT(stale_message("unit = 1", "unit = 2"), HasSubstr("stale: the controller"));
  EXPECT_THAT(stale_message("rows = 8", "rows = 4"), HasSubstr("stale: the array"));
  EXPECT_THAT(stale_message("id = \"main\"", "id = \"other\""), HasSubstr("the rig has none"));
  EXPECT_THAT(stale_message("rows = 8", "rows = 4"), HasSubstr("rig commission"));
  EXPECT_THAT(stale_message("rows = 8", "rows = 4"), HasSubstr("r.toml (its measured part)"));
}

TEST(MeasuredRig, OutlivesChangesThatDoNotTouchIt) {
  EXPECT_EQ(stale_message("port = 8481", "port = 8482"), "not stale");
  EXPECT_EQ(stale_message("exposure_us = 2000.0", "exposure_us = 1000.0"), "not stale");
  EXPECT_EQ(stale_message("latch = 200.0", "latch = 300.0"), "not stale");
  EXPECT_EQ(stale_message("127.0.0.1:1503", "127.0.0.1:1504"), "not stale");
}

TEST(MeasuredRig, RefusesAnotherCamera) {
  Rig rig = small_rig();
  rig.measured = std::make_shared<const MeasuredRig>(some_measurement(rig));
  EXPECT_NO_THROW(require_measured_camera(rig, "main", "remote camera /tmp/x"));
  EXPECT_NO_THROW(require_measured_camera(rig, "main", ""));
  EXPECT_NO_THROW(require_measured_camera(rig, "second", "who"));
  EXPECT_THROW(require_measured_camera(rig, "main", "remote camera /tmp/y"), Error);
}

TEST(MeasuredRig, RefusesWhatIsNoMeasuredFile) {
  EXPECT_THROW((void)join_rig_text({"a = 1\n", "b = 1\n"}, "x"), Error);
  EXPECT_THROW((void)parse_measured("a = 1\n", "x"), Error);
  MeasuredRig m = some_measurement(small_rig());
  m.cameras[0].timestamp = TimestampMeaning::end_frame;
  m.cameras[0].read_us.reset();
  EXPECT_THROW((void)parse_measured(to_toml(m), "x"), Error);
  m.cameras.clear();
  m.lights->dead = {64};
  Rig rig = small_rig();
  EXPECT_THROW(apply_measured(m, "x", rig), Error);
  m.lights->dead = {63};
  m.lights->power.resize(3);
  EXPECT_THROW(apply_measured(m, "x", rig), Error);
}

}  // namespace
}  // namespace haarlight
