// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <string>

#include <gtest/gtest.h>

#include "haarlight/core/picture/image_io.h"
#include "relight/basis/plate/planes_plate.h"
#include "relight/pipeline/hull_pipeline.h"
#include "relight/pipeline/shadow_pipeline.h"
#include "tests/relight/pipeline/captured_box.h"

/// A rig with lights on five faces and two planes, the ground and a wall behind the object.

namespace haarlight::relight {
namespace {

using testing::replaced;

const char* const kWall =
    "[[quad]]\ncorners = [[-200.0, 200.0, 0.0], [200.0, 200.0, 0.0], [200.0, 200.0, 160.0], "
    "[-200.0, 200.0, 160.0]]\nmaterial = \"wall\"\n";
const char* const kWallMaterial = "[[material]]\nname = \"wall\"\nkd = [0.8]\n";
/// The normal points away from the object: which side is which must not depend on it.
const char* const kWallPlane =
    "[[plane]]\nid = \"wall\"\nn = [0.0, 1.0, 0.0]\nd = -200.0\norigin = [0.0, 200.0, 80.0]\n"
    "u = [1.0, 0.0, 0.0]\nv = [0.0, 0.0, 1.0]\nextent = [400.0, 160.0]\ntexel = 4.0\n\n";

std::string side_face(const std::string& id, const std::string& centre, const std::string& u,
                      const std::string& emits) {
  return "[[face]]\nid = \"" + id + "\"\ncentre = " + centre + "\nu = " + u +
         "\nv = [0.0, 0.0, 1.0]\nemits = " + emits +
         "\nrows = 8\ncols = 8\npitch = 90.0\nemitter = [88.0, 88.0]\nwatts = 5.0\n"
         "lobe_mu = 1.0\nmax_watts = 320.0\n\n";
}

class Planes : public testing::CapturedBox {
 protected:
  Planes() {
    const std::string faces =
        side_face("left", "[-600.0, 0.0, 450.0]", "[0.0, -1.0, 0.0]", "[1.0, 0.0, 0.0]") +
        side_face("right", "[600.0, 0.0, 450.0]", "[0.0, 1.0, 0.0]", "[-1.0, 0.0, 0.0]") +
        side_face("front", "[0.0, -600.0, 450.0]", "[1.0, 0.0, 0.0]", "[0.0, 1.0, 0.0]") +
        side_face("back", "[0.0, 600.0, 450.0]", "[-1.0, 0.0, 0.0]", "[0.0, -1.0, 0.0]");
    all_ = replaced(replaced(rig_, "[[plane]]", faces + "[[plane]]"), "[[camera]]",
                    std::string(kWallPlane) + "[[camera]]");
    write_file_atomically(
        folder_ / "box_and_wall.toml",
        replaced(testing::kBox, "[[box]]", std::string(kWallMaterial) + kWall + "[[box]]"));
    write_file_atomically(folder_ / "wall.toml",
                          "schema = 1\nname = \"wall\"\n" + std::string(kWallMaterial) + kWall);
  }

  [[nodiscard]] MemoryStack render_scene(const std::string& name) const {
    return testing::render_capture(all_, render::read_scene(folder_ / name).scene);
  }

  std::string all_;  ///< the rig with everything
};

TEST_F(Planes, TheCleanPlateIsTheEmptyScene) {
  MemoryStack scene = render_scene("wall.toml");
  MemoryStack plate = read_all(*make_rig_plate(parse_rig(all_, "rig")));
  ASSERT_EQ(plate.dims(), scene.dims());
  constexpr double kAlbedo = 0.8;
  double error = 0.0;
  double energy = 0.0;
  int n_hidden = 0;
  for (int y = 0; y < scene.dims().height; ++y) {
    for (int x = 0; x < scene.dims().width; ++x) {
      for (int k = 0; k < scene.dims().n_lights; ++k) {
        const double seen = double{scene.at(0, y, x, k)} / (1e6 * kAlbedo);
        const double found{plate.at(0, y, x, k)};
        error += (seen - found) * (seen - found);
        energy += seen * seen;
        n_hidden += seen == 0.0 ? 1 : 0;
      }
    }
  }
  EXPECT_GT(n_hidden, 1000);  // the wall stands in some lights' way
  // Where a light is seen in part: area for irradiance, and the scene's 16 x 16 strata.
  EXPECT_LT(std::sqrt(error / energy), 2e-3);
}

TEST_F(Planes, GoThroughHullAndShadow) {
  capture("top.hlb", rig_);
  store("all.hlb", all_, render_scene("box_and_wall.toml"));
  HullPipelineOptions hull;
  hull.voxel_mm = 5.0;
  hull.settings.overwrites = true;
  hull.outputs = {folder_ / "box.vtu"};
  hull.captured.basis = folder_ / "top.hlb";
  const HullPipelineSummary top = export_hull(hull);
  hull.captured.basis = folder_ / "all.hlb";
  const HullPipelineSummary all = export_hull(hull);
  // The box is 216 cm^3; lights from the sides carve what those above it cannot.
  const double box_mm3 = 60.0 * 60.0 * 60.0;
  EXPECT_GT(all.volume_mm3, 0.8 * box_mm3);
  EXPECT_LT(all.volume_mm3, 1.4 * box_mm3);
  EXPECT_LT(all.volume_mm3 - box_mm3, 0.5 * (top.volume_mm3 - box_mm3));
  EXPECT_NEAR(all.source.hull.low_mm, 20.0, 10.0);
  EXPECT_NEAR(all.source.hull.high_mm, 80.0, 10.0);
  EXPECT_EQ(all.source.hull.n_lights, 320);

  write_file_atomically(
      folder_ / "ground.toml",
      "schema = 1\nname = \"ground\"\n[[material]]\nname = \"m\"\nkd = [0.6]\n"
      "[[box]]\nlow = [-190.0, -190.0, -9.0]\nhigh = [190.0, 190.0, 0.0]\n"
      "material = \"m\"\n[camera]\nsize = [64, 64]\neye = [0.0, -1.0, 900.0]\n"
      "target = [0.0, 0.0, 0.0]\nup = [0.0, 1.0, 0.0]\nfov_y_deg = 24\n");
  ShadowOptions shadow;
  shadow.captured.basis = folder_ / "all.hlb";
  shadow.scene = folder_ / "ground.toml";
  shadow.output = folder_ / "shadow.exr";
  shadow.light.lights = {"27"};
  shadow.truth_object = folder_ / "box.toml";
  shadow.truth = folder_ / "truth.exr";
  shadow.subpixels = 1;
  shadow.hull_voxel_mm = 5.0;
  shadow.settings.overwrites = true;
  const ShadowSummary with_all = cast_shadow(shadow);
  ASSERT_EQ(with_all.plates.size(), 2U);
  EXPECT_GT(with_all.plates[0].known_fraction, 0.5);
  EXPECT_GT(with_all.plates[1].known_fraction, 0.5);
  // One paper: the planes' scales agree.
  EXPECT_NEAR(with_all.plates[1].scale / with_all.plates[0].scale, 1.0, 0.02);
  EXPECT_FALSE(with_all.hull->is_carved);
  shadow.captured.basis = folder_ / "top.hlb";
  const ShadowSummary with_top = cast_shadow(shadow);
  EXPECT_LT(with_all.truth->shadow->wrong_fraction, with_top.truth->shadow->wrong_fraction);
}

}  // namespace
}  // namespace haarlight::relight
