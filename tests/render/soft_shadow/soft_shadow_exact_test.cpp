// SPDX-License-Identifier: Apache-2.0
/// @file
/// Values that are called exact, held to closed forms: the shadows of up to four convex pieces on
/// the light's plane, united. HAARLIGHT_SOFT_SHADOW_SCENES: how many scenes; HAARLIGHT_SEED: which.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <vector>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "core/random.h"
#include "tests/drawn_seed.h"
#include "tests/render/soft_shadow/shadow_scenes.h"

namespace haarlight::render {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using test::LightKind;
using test::ShadowScene;

/// What exact stands for: rounding of areas and what is ignored, 1e-7, with a tenfold margin.
constexpr double kExact = 1e-6;

class Random {
 public:
  explicit Random(std::uint64_t seed) : seed_(seed) {}
  double unit() { return uniform_unit(hash_key(seed_, n_++)); }
  double between(double low, double high) { return low + (high - low) * unit(); }
  double log_between(double low, double high) { return low * std::pow(high / low, unit()); }
  Vector3d in_box(const Vector3d& low, const Vector3d& high) {
    return {between(low.x(), high.x()), between(low.y(), high.y()), between(low.z(), high.z())};
  }
  Matrix3d rotation() {
    const Vector3d axis(standard_normal(hash_key(seed_, n_ + 1)),
                        standard_normal(hash_key(seed_, n_ + 2)),
                        standard_normal(hash_key(seed_, n_ + 3)));
    n_ += 4;
    return Eigen::AngleAxisd(between(0.0, 2.0 * std::numbers::pi), axis.normalized())
        .toRotationMatrix();
  }
  int below(int n) { return static_cast<int>(n * unit()); }

 private:
  std::uint64_t seed_;
  std::uint64_t n_ = 0;
};

/// A closed convex mesh about the origin, inside the unit sphere.
Mesh random_piece(Random& random) {
  const int kind = random.below(4);
  if (kind == 0) {  // box
    const Vector3d half = random.in_box({0.1, 0.1, 0.1}, {0.57, 0.57, 0.57});
    return make_box(-half, half, test::kDark);
  }
  if (kind == 1) {  // plate
    Vector3d half = random.in_box({0.2, 0.2, 0.0}, {0.7, 0.7, 0.0});
    half.z() = random.log_between(1e-3, 3e-2);
    return make_box(-half, half, test::kDark);
  }
  std::vector<Vector3d> points;
  const int n = kind == 2 ? 4 : 5 + random.below(6);
  for (int i = 0; i < n; ++i) {
    Vector3d point = random.in_box({-1, -1, -1}, {1, 1, 1});
    while (point.norm() > 1.0 || point.norm() < 0.3) {
      point = random.in_box({-1, -1, -1}, {1, 1, 1});
    }
    points.push_back(point);
  }
  return test::hull_of(points);
}

/// A light at a height of about 2 over the floor z = 0, tilted in half of the scenes.
ShadowScene random_scene(Random& random) {
  const auto light = static_cast<LightKind>(random.below(3));
  Matrix3d frame = Vector3d(1.0, -1.0, -1.0).asDiagonal().toDenseMatrix();
  if (random.unit() < 0.5) {
    const double angle = random.between(-0.7, 0.7);
    const Vector3d axis = random.in_box({-1, -1, -1}, {1, 1, 1}).normalized();
    frame = frame * Eigen::AngleAxisd(angle, axis).toRotationMatrix();
  }
  const Vector3d centre = random.in_box({-0.3, -0.3, 1.7}, {0.3, 0.3, 2.3});
  const double radius = random.log_between(0.02, 0.8);
  ShadowScene made = test::scene_under_light(light, centre, frame, radius);
  const int n_pieces = 1 + random.below(4);
  for (int i = 0; i < n_pieces; ++i) {
    Mesh mesh = random_piece(random);
    const double size = random.log_between(0.05, 0.6);
    const Matrix3d turn = random.rotation();
    const double where = random.unit();
    const double z = where < 0.2   ? random.between(0.0, size)           // at the floor
                     : where < 0.3 ? made.centre.z() - 0.1 - 1.2 * size  // near the light
                                   : random.between(0.3, 1.4);
    const Vector3d middle = random.in_box({-0.6, -0.6, z}, {0.6, 0.6, z});
    for (Vector3d& vertex : mesh.vertices) {
      vertex = middle + size * (turn * vertex);
    }
    made.add(mesh);
  }
  return made;
}

bool is_inside(const Mesh& mesh, const Vector3d& point) {
  return std::ranges::all_of(mesh.triangles, [&](const Eigen::Vector3i& t) {
    const Vector3d& a = mesh.vertices[static_cast<std::size_t>(t[0])];
    const Vector3d& b = mesh.vertices[static_cast<std::size_t>(t[1])];
    const Vector3d& c = mesh.vertices[static_cast<std::size_t>(t[2])];
    return (b - a).cross(c - a).dot(point - a) < 0.0;
  });
}

/// On the floor: half of them anywhere, half where lines from the light past edges end.
std::vector<Vector3d> random_points(const ShadowScene& made, Random& random, int n) {
  std::vector<Vector3d> points;
  int n_tries = 0;
  while (static_cast<int>(points.size()) < n) {
    Vector3d point = random.in_box({-2, -2, 0}, {2, 2, 0});
    if (points.size() % 2 == 0 && ++n_tries < 20 * n) {
      const Mesh& mesh = made.scene.meshes[made.scene.meshes.size() - 1 -
                                           static_cast<std::size_t>(random.below(
                                               static_cast<int>(made.pieces.size())))];
      const Eigen::Vector3i& t = mesh.triangles[static_cast<std::size_t>(
          random.below(static_cast<int>(mesh.triangles.size())))];
      const double s = random.unit();
      const Vector3d on_edge = (1.0 - s) * mesh.vertices[static_cast<std::size_t>(t[0])] +
                               s * mesh.vertices[static_cast<std::size_t>(t[1])];
      const double angle = random.between(0.0, 2.0 * std::numbers::pi);
      const double radius = made.radius * std::sqrt(random.unit());
      const Vector3d from =
          made.centre + made.light_from_world.transpose() *
                            Vector3d(radius * std::cos(angle), radius * std::sin(angle), 0.0);
      if (!(on_edge.z() > 0.0 && from.z() > on_edge.z() + 1e-3)) {
        continue;
      }
      point = from + from.z() / (from.z() - on_edge.z()) * (on_edge - from);
      if (point.norm() > 6.0) {
        continue;
      }
    }
    point.z() = 0.0;
    if (std::ranges::none_of(made.scene.meshes, [&](const Mesh& mesh) {
          return mesh.material == test::kDark && is_inside(mesh, point);
        })) {
      points.push_back(point);
    }
  }
  return points;
}

struct Tally {
  std::int64_t n_values = 0;
  std::array<std::int64_t, kShadowKindWords.size()> by_kind = {};
  std::int64_t n_traced = 0;
  std::int64_t n_penumbra = 0;  ///< that are not traced
  std::int64_t n_exact_penumbra = 0;
  std::int64_t n_doubted = 0;  ///< unsure or traced
  std::int64_t n_doubted_right = 0;
  double worst = 0.0;  ///< of those called exact

  void add(const LightShadow& shadow, double truth) {
    const double error = std::abs(static_cast<double>(shadow.visibility) - truth);
    const bool is_exact = test::is_exact(shadow.kind);
    ++n_values;
    ++by_kind.at(static_cast<std::size_t>(shadow.kind));
    n_traced += shadow.kind == ShadowKind::traced ? 1 : 0;
    if (truth > 0.0 && truth < 1.0 && shadow.kind != ShadowKind::traced) {
      ++n_penumbra;
      n_exact_penumbra += is_exact ? 1 : 0;
    }
    if (is_exact) {
      worst = std::max(worst, error);
    } else {
      ++n_doubted;
      n_doubted_right += error <= kExact ? 1 : 0;
    }
  }
  void print() const {
    std::printf("%lld values:", static_cast<long long>(n_values));
    for (std::size_t kind = 0; kind < by_kind.size(); ++kind) {
      std::printf(" %lld %s", static_cast<long long>(by_kind.at(kind)),
                  std::string(kShadowKindWords.at(kind)).c_str());
    }
    std::printf(
        "\npenumbra: %lld, exact %.5f; largest error of exact ones %.3g; of %lld unsure or "
        "traced, %lld within 1e-6\n",
        static_cast<long long>(n_penumbra), exact_fraction(), worst,
        static_cast<long long>(n_doubted), static_cast<long long>(n_doubted_right));
  }
  [[nodiscard]] double exact_fraction() const {
    return static_cast<double>(n_exact_penumbra) / static_cast<double>(n_penumbra);
  }
};

TEST(SoftShadowExact, ConvexPiecesInClosedForm) {
  const std::uint64_t seed = testing::number_from("HAARLIGHT_SEED", 1);
  const std::uint64_t n_scenes = testing::number_from("HAARLIGHT_SOFT_SHADOW_SCENES", 150);
  constexpr int kPoints = 48;
  Tally tally;
  for (std::uint64_t i = 0; i < n_scenes; ++i) {
    Random random(hash_key(seed, i));
    const ShadowScene made = random_scene(random);
    const std::vector<Vector3d> points = random_points(made, random, kPoints);
    const test::ShadowValues values =
        test::shadow_values(made.scene, points, {.grid = 1 << random.below(7)});
    for (std::size_t p = 0; p < points.size(); ++p) {
      const LightShadow& shadow = values.shadows[p];
      const double truth = made.truth(points[p]);
      tally.add(shadow, truth);
      if (test::is_exact(shadow.kind)) {
        EXPECT_NEAR(shadow.visibility, truth, kExact)
            << "HAARLIGHT_SEED=" << seed << ", scene " << i << ", point " << p << ": "
            << points[p].transpose() << ", "
            << kShadowKindWords.at(static_cast<std::size_t>(shadow.kind));
      }
      EXPECT_TRUE(shadow.visibility >= 0.0F && shadow.visibility <= 1.0F);
    }
  }
  tally.print();
  EXPECT_GT(tally.n_penumbra, tally.n_values / 4);
  // Where a piece passes through the light, 48 values in one of 900 scenes, all is traced.
  EXPECT_LT(tally.n_traced, tally.n_values / 50);
  EXPECT_GT(tally.exact_fraction(), 0.999);  // 0.9999 in 60 000 scenes
}

/// A light must not hide itself from rays whose rounding across its plane, over their slope, lets them
/// end in it: before rays ended short by that, values of these scenes were 0 where 0.49 to 1 is seen.
TEST(SoftShadowExact, ALightDoesNotHideItselfFromGrazingPoints) {
  constexpr auto kScenes =
      std::to_array<std::pair<std::uint64_t, std::uint64_t>>({{2, 5365}, {5, 3297}});
  for (const auto& [seed, i] : kScenes) {
    Random random(hash_key(seed, i));
    const ShadowScene made = random_scene(random);
    const std::vector<Vector3d> points = random_points(made, random, 48);
    const test::ShadowValues values = test::shadow_values(made.scene, points);
    for (std::size_t p = 0; p < points.size(); ++p) {
      EXPECT_TRUE(test::is_exact(values.shadows[p].kind));
      EXPECT_NEAR(values.shadows[p].visibility, made.truth(points[p]), kExact) << p;
    }
  }
}

/// Along lines over the floor, a texel being a 1024th of a line's 4 mm: V is 0, or 1, where the truth is
/// so a texel farther to one side.
TEST(SoftShadowExact, BordersOfUmbraAndPenumbraWithinATexel) {
  constexpr int kTexels = 1024;
  const std::uint64_t seed = testing::number_from("HAARLIGHT_SEED", 1);
  int n_borders = 0;
  for (std::uint64_t i = 0; i < 40; ++i) {
    Random random(hash_key(seed, 77, i));
    const ShadowScene made = random_scene(random);
    const double angle = random.between(0.0, std::numbers::pi);
    const Vector3d way(std::cos(angle), std::sin(angle), 0.0);
    const Vector3d middle = random.in_box({-0.5, -0.5, 0}, {0.5, 0.5, 0});
    std::vector<Vector3d> points;
    std::vector<double> truth;
    for (int t = 0; t < kTexels; ++t) {
      points.emplace_back(middle + (4.0 * (t + 0.5) / kTexels - 2.0) * way);
      truth.push_back(made.truth(points.back()));
    }
    const test::ShadowValues values = test::shadow_values(made.scene, points);
    for (std::size_t t = 1; t + 1 < points.size(); ++t) {
      if (!test::is_exact(values.shadows[t].kind)) {
        continue;
      }
      const double v = values.shadows[t].visibility;
      for (const double end : {0.0, 1.0}) {
        // 1e-7 of the light is ignored, and single precision rounds 6e-8 more.
        const bool is_there = std::abs(v - end) <= 1e-7;
        const auto is_so = [&](std::size_t at) {
          const double off = std::abs(truth[at] - end);
          return is_there ? off <= 3e-7 : off > 0.0;
        };
        EXPECT_TRUE(is_so(t - 1) || is_so(t) || is_so(t + 1))
            << "HAARLIGHT_SEED=" << seed << ", scene " << i << ", texel " << t << ": V " << v
            << ", truth " << truth[t];
        n_borders +=
            (v == end) != (values.shadows[t - 1].visibility == static_cast<float>(end));
      }
    }
  }
  EXPECT_GT(n_borders, 50);  // 65 with seed 1
}

/// The paper's figure 1: what a silhouette from the light's centre cannot tell.
TEST(SoftShadowExact, TwoPlatesTogetherHideWhatNeitherDoes) {
  const auto plate = [](double low, double high, double z) {
    return make_box({low, -2.0, z - 0.01}, {high, 2.0, z + 0.01}, test::kDark);
  };
  const std::vector<Vector3d> origin = {Vector3d::Zero()};
  for (const LightKind light : {LightKind::disk, LightKind::square_mesh, LightKind::led}) {
    // From the origin, half of the light and more is behind each plate, one on each side.
    const std::array plates = {plate(-2.0, 0.02, 0.5), plate(-0.02, 2.0, 1.2)};
    const auto value = [&](std::initializer_list<std::size_t> which) {
      ShadowScene made = test::scene_under_light(light, 2.0, 0.5);
      for (const std::size_t i : which) {
        made.add(plates.at(i));
      }
      const LightShadow shadow = test::shadow_values(made.scene, origin).shadows[0];
      EXPECT_NEAR(shadow.visibility, made.truth(origin[0]), kExact);
      EXPECT_TRUE(test::is_exact(shadow.kind));
      return shadow.visibility;
    };
    EXPECT_EQ(value({0, 1}), 0.0F);
    EXPECT_GT(value({0}), 0.1F);
    EXPECT_GT(value({1}), 0.1F);
  }
}

/// The reverse: both plates overlap as seen from the centre, but the light shows between them.
TEST(SoftShadowExact, AGapThatTheCentreDoesNotSee) {
  for (const LightKind light : {LightKind::disk, LightKind::square_mesh, LightKind::led}) {
    ShadowScene made = test::scene_under_light(light, 2.0, 0.5);
    made.add(make_box({-2.0, -2.0, 0.49}, {-0.1, 2.0, 0.51}, test::kDark));
    made.add(make_box({-0.02, -2.0, 1.19}, {2.0, 2.0, 1.21}, test::kDark));
    // From the centre the plates' images, x / (2 - z), end at -0.067 and begin at -0.025; from the
    // point the gap is on the light at -0.12 to -0.05.
    const std::vector<Vector3d> points = {{0.0, 0.0, 0.0}, {-0.05, 0.0, 0.0}};
    const test::ShadowValues values = test::shadow_values(made.scene, points);
    for (std::size_t i = 0; i < points.size(); ++i) {
      EXPECT_NEAR(values.shadows[i].visibility, made.truth(points[i]), kExact);
      EXPECT_GT(values.shadows[i].visibility, 0.0F);
      EXPECT_LT(values.shadows[i].visibility, 0.5F);
    }
  }
}

}  // namespace
}  // namespace haarlight::render
