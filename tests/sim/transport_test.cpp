// SPDX-License-Identifier: Apache-2.0
#include "sim/transport.h"

#include <cmath>
#include <csignal>
#include <numbers>
#include <string>

#include <gtest/gtest.h>
#include <sys/resource.h>

#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "haarlight/core/stack/light_stack.h"
#include "haarlight/render/analytic/polygon_light.h"
#include "haarlight/render/light/rig_lights.h"
#include "sim/transport_stack.h"
#include "tests/temporary_folder.h"

namespace haarlight::sim {
namespace {

using Eigen::Vector3d;
using testing::TemporaryFolder;

Rig tiny_rig() {
  Rig rig = read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml");
  CameraModel& camera = rig.cameras[0].model;
  camera.width = 20;
  camera.height = 15;
  camera.fx = camera.fy = 87.9192774 * 20.0 / 64.0;
  camera.cx = 10.0;
  camera.cy = 7.5;
  rig.cameras[0].frame_width = 20;
  rig.cameras[0].active_rows = 15;
  return rig;
}

render::Scene plate(const Vector3d& kd = Vector3d::Constant(0.8)) {
  render::Scene scene;
  scene.materials.push_back({"ground", kd, 0.0, 1.0});
  scene.meshes.push_back(render::make_quad({-1000, -1000, 0}, {1000, -1000, 0}, {1000, 1000, 0},
                                           {-1000, 1000, 0}, 0));
  return scene;
}

render::Scene plate_and_ball() {
  render::Scene scene = plate();
  scene.materials.push_back({"ball", Vector3d::Constant(0.3), 0.5, 60.0});
  scene.meshes.push_back(render::make_sphere({20, 0, 60}, 45.0, 4, 1));
  return scene;
}

TransportOptions options_in(const TemporaryFolder& folder) {
  TransportOptions options;
  options.cache_folder = folder.path();
  return options;
}

TEST(Transport, OfTheEmptyRigIsTheClosedFormPlate) {
  const TemporaryFolder folder;
  const Rig rig = tiny_rig();
  TransportOptions options = options_in(folder);
  options.n_subpixels = 1;
  const Transport transport = make_transport(rig, 0, plate(), options);
  const std::vector<render::SquareLight> lights = render::rig_lights(rig);
  for (const int k : {0, 7, 27, 36, 63}) {
    for (int y = 0; y < 15; y += 7) {
      for (int x = 0; x < 20; x += 5) {
        const CameraRay ray = ray_through(rig.cameras[0].model, x + 0.5, y + 0.5);
        const double t = -ray.origin_world.z() / ray.direction_world.z();
        const Vector3d point = ray.origin_world + t * ray.direction_world;
        const double expected = 0.8 / std::numbers::pi *
                                render::light_irradiance(lights[static_cast<std::size_t>(k)],
                                                         point, Vector3d::UnitZ());
        // Float storage (6e-8) and 2 x 2 Gauss points, whose error at their switch-over is
        // 1e-5.
        EXPECT_NEAR(transport.plane(k)(y, x), expected, 1e-5 * expected)
            << k << ' ' << y << ' ' << x;
      }
    }
  }
}

TEST(Transport, IsTheSameOnOneTwoAndSevenThreads) {
  const TemporaryFolder folder;
  const Rig rig = tiny_rig();
  std::vector<std::string> bytes;
  for (const int n : {1, 2, 7}) {
    const TemporaryFolder own;
    const ThreadLimit limit(n);
    const Transport transport = make_transport(rig, 0, plate_and_ball(), options_in(own));
    const auto* data = reinterpret_cast<const char*>(transport.plane(0).data());
    bytes.emplace_back(data, sizeof(float) * 20 * 15 * 64);
  }
  EXPECT_EQ(bytes[0], bytes[1]);
  EXPECT_EQ(bytes[0], bytes[2]);
}

// The bytes at 40 are the seconds that it took.
std::string all_but_seconds(const TemporaryFolder& folder) {
  std::string bytes = read_file(std::filesystem::directory_iterator(folder.path())->path());
  return bytes.erase(40, 8);
}

TEST(Transport, StripsOfAnyHeightGiveTheSameFile) {
  constexpr std::uint64_t kSums = sizeof(double) * 20 * 15;
  constexpr std::uint64_t kRow = sizeof(float) * 20 * 64;
  std::vector<std::string> files;
  for (const std::uint64_t n_rows : {15U, 7U, 4U, 1U}) {  // 15; 7, 7, 1; 4, 4, 4, 3; 1 ...
    const TemporaryFolder own;
    TransportOptions options = options_in(own);
    options.memory_bytes = kSums + n_rows * kRow;
    (void)make_transport(tiny_rig(), 0, plate_and_ball(), options);
    files.push_back(all_but_seconds(own));
  }
  for (std::size_t i = 1; i < files.size(); ++i) {
    EXPECT_TRUE(files[i] == files[0]) << i;
  }
  const TemporaryFolder own;
  TransportOptions options = options_in(own);
  options.memory_bytes = kSums + kRow - 1;
  try {
    (void)make_transport(tiny_rig(), 0, plate_and_ball(), options);
    ADD_FAILURE() << "made within too little memory";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ExitCode::usage);
    EXPECT_NE(std::string(error.what()).find(std::to_string(kSums + kRow)), std::string::npos);
  }
  EXPECT_TRUE(std::filesystem::is_empty(own.path()));
}

/// Files may be no larger for a while.
class FileSizeLimit {
 public:
  explicit FileSizeLimit(rlim_t bytes) : handler_(std::signal(SIGXFSZ, SIG_IGN)) {
    ::getrlimit(RLIMIT_FSIZE, &before_);
    const rlimit limit{bytes, before_.rlim_max};
    ::setrlimit(RLIMIT_FSIZE, &limit);
  }
  ~FileSizeLimit() {
    ::setrlimit(RLIMIT_FSIZE, &before_);
    (void)std::signal(SIGXFSZ, handler_);
  }
  FileSizeLimit(const FileSizeLimit&) = delete;
  FileSizeLimit& operator=(const FileSizeLimit&) = delete;

 private:
  rlimit before_{};
  void (*handler_)(int);
};

TEST(Transport, ADiskWithoutRoomIsRefusedBeforeTheWorkAndKeepsNoFile) {
  const TemporaryFolder folder;
  {
    const FileSizeLimit limit(40000);  // of 80896 bytes
    try {
      (void)make_transport(tiny_rig(), 0, plate_and_ball(), options_in(folder));
      ADD_FAILURE() << "written where there is no room";
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ExitCode::io);
    }
  }
  EXPECT_TRUE(std::filesystem::is_empty(folder.path()));
}

TEST(Transport, IsReadFromTheCacheTheSecondTimeAndMadeAgainWhenDamaged) {
  const TemporaryFolder folder;
  const Rig rig = tiny_rig();
  const Transport first = make_transport(rig, 0, plate_and_ball(), options_in(folder));
  const auto file = std::filesystem::directory_iterator(folder.path())->path();
  const auto written = std::filesystem::last_write_time(file);
  const Transport second = make_transport(rig, 0, plate_and_ball(), options_in(folder));
  EXPECT_EQ(std::filesystem::last_write_time(file), written);
  EXPECT_EQ(second.seconds(), first.seconds());  // of the run that made it
  std::string bytes = read_file(file);
  bytes[bytes.size() / 2] = static_cast<char>(bytes[bytes.size() / 2] ^ 4);
  write_file_atomically(file, std::string_view(bytes));
  const Transport third = make_transport(rig, 0, plate_and_ball(), options_in(folder));
  EXPECT_EQ(third.plane(9)(5, 5), first.plane(9)(5, 5));
}

TEST(Transport, KeyFollowsEverythingThatMatters) {
  const Rig rig = tiny_rig();
  const TransportOptions options;
  const std::string key = transport_key(rig, 0, plate(), options);
  Rig other = rig;
  other.faces[0].emitter_w_mm += 1.0;
  EXPECT_NE(transport_key(other, 0, plate(), options), key);
  other = rig;
  other.cameras[0].model.cx += 0.25;
  EXPECT_NE(transport_key(other, 0, plate(), options), key);
  other = rig;
  other.cameras[0].bayer = BayerPattern::rggb;
  EXPECT_NE(transport_key(other, 0, plate(), options), key);
  EXPECT_NE(transport_key(rig, 0, plate(Vector3d(0.8, 0.8, 0.7)), options), key);
  EXPECT_NE(transport_key(rig, 0, plate_and_ball(), options), key);
  TransportOptions finer;
  finer.n_subpixels = 3;
  EXPECT_NE(transport_key(rig, 0, plate(), finer), key);
  TransportOptions at_edges;
  at_edges.subpixels_at_edges = true;
  EXPECT_NE(transport_key(rig, 0, plate(), at_edges), key);
  // And not what does not: exposure, addresses, noise.
  other = rig;
  other.cameras[0].exposure_us *= 2.0;
  other.cameras[0].device = "elsewhere";
  other.http.port = 1;
  EXPECT_EQ(transport_key(other, 0, plate(), options), key);
}

TEST(Transport, SubpixelsAtEdgesAreTakenWhereAPixelShowsTwoSurfaces) {
  const TemporaryFolder folder;
  const Rig rig = tiny_rig();
  TransportOptions options = options_in(folder);
  const Transport all = make_transport(rig, 0, plate_and_ball(), options);
  options.subpixels_at_edges = true;
  const Transport at_edges = make_transport(rig, 0, plate_and_ball(), options);
  options.n_subpixels = 1;
  const Transport one = make_transport(rig, 0, plate_and_ball(), options);
  int n_as_all = 0;
  int n_as_one = 0;
  for (int y = 0; y < 15; ++y) {
    for (int x = 0; x < 20; ++x) {
      bool is_as_all = true;
      bool is_as_one = true;
      for (int k = 0; k < 64; k += 9) {
        const float value = at_edges.plane(k)(y, x);
        is_as_all = is_as_all && value == all.plane(k)(y, x);
        is_as_one = is_as_one && value == one.plane(k)(y, x);
      }
      EXPECT_TRUE(is_as_all || is_as_one) << x << ' ' << y;
      n_as_all += is_as_all && !is_as_one ? 1 : 0;
      n_as_one += is_as_one && !is_as_all ? 1 : 0;
    }
  }
  // The ball's outline, and the rest.
  EXPECT_GT(n_as_all, 8);
  EXPECT_GT(n_as_one, 150);
  EXPECT_LT(at_edges.n_rays(), all.n_rays());
}

TEST(Transport, ABayerSensorSeesTheColourOfEachPixel) {
  const TemporaryFolder folder;
  Rig rig = tiny_rig();
  rig.cameras[0].bayer = BayerPattern::rggb;
  const Transport mosaic =
      make_transport(rig, 0, plate(Vector3d(0.2, 0.4, 0.8)), options_in(folder));
  rig.cameras[0].bayer = BayerPattern::none;
  const Transport grey = make_transport(rig, 0, plate(Vector3d::Ones()), options_in(folder));
  const auto ratio = [&](int y, int x) {
    return static_cast<double>(mosaic.plane(12)(y, x)) /
           static_cast<double>(grey.plane(12)(y, x));
  };
  EXPECT_NEAR(ratio(4, 6), 0.2, 1e-6);
  EXPECT_NEAR(ratio(4, 7), 0.4, 1e-6);
  EXPECT_NEAR(ratio(5, 6), 0.4, 1e-6);
  EXPECT_NEAR(ratio(5, 7), 0.8, 1e-6);
}

TEST(Transport, ScaleIsTheMedianOfTheMean) {
  const TemporaryFolder folder;
  const Rig rig = tiny_rig();
  const Transport transport = make_transport(rig, 0, plate(), options_in(folder));
  std::vector<double> means;
  for (int y = 0; y < 15; ++y) {
    for (int x = 0; x < 20; ++x) {
      double sum = 0.0;
      for (int k = 0; k < 64; ++k) {
        sum += transport.plane(k)(y, x);
      }
      means.push_back(sum / 64.0);
    }
  }
  std::sort(means.begin(), means.end());
  EXPECT_NEAR(transport.scale(), 0.5 * (means[149] + means[150]), 1e-9 * transport.scale());
}

TEST(Transport, BecomesALightStackInUnitsOfItsScale) {
  const TemporaryFolder folder;
  const Transport transport =
      make_transport(tiny_rig(), 0, plate_and_ball(), options_in(folder));
  write_light_stack(transport, folder / "truth.stack");
  const LightStack stack = LightStack::open(folder / "truth.stack");
  EXPECT_EQ(stack.dims().n_lights, 64);
  const Image<float> light = stack.light_images(19, 1).front();
  for (int y = 0; y < 15; ++y) {
    for (int x = 0; x < 20; ++x) {
      EXPECT_NEAR(light(y, x), transport.plane(19)(y, x) / transport.scale(),
                  1e-6 * light(y, x));
    }
  }
}

TEST(Transport, RefusesACacheFolderThatCannotBeMade) {
  const TemporaryFolder folder;
  write_file_atomically(folder / "file", std::string_view("x"));
  TransportOptions options;
  options.cache_folder = folder / "file" / "below";
  EXPECT_THROW(static_cast<void>(make_transport(tiny_rig(), 0, plate(), options)), Error);
}

}  // namespace
}  // namespace haarlight::sim
