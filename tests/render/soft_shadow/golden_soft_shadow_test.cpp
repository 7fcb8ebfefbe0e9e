// SPDX-License-Identifier: Apache-2.0
/// @file
/// t, extrusion points and straight edges in space against tests/golden/soft_shadow.json.

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "render/soft_shadow/disk_visibility.h"
#include "render/soft_shadow/extrusion.h"
#include "tests/golden_file.h"
#include "tests/render/soft_shadow/convex_truth.h"

namespace haarlight::render {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kInfinity = std::numeric_limits<double>::infinity();

double number(const nlohmann::json& value) {
  return value.is_null() ? kInfinity : std::stod(value.get<std::string>());
}

Vector3d vector_of(const nlohmann::json& value) {
  return {number(value[0]), number(value[1]), number(value[2])};
}

/// A case in the light frame.
struct EdgeCase {
  explicit EdgeCase(const nlohmann::json& item)
      : centre(vector_of(item.at("centre"))), radius(number(item.at("r"))) {
    const Vector3d n = vector_of(item.at("normal"));
    light_from_world.row(0) = n.unitOrthogonal();
    light_from_world.row(1) = n.cross(n.unitOrthogonal());
    light_from_world.row(2) = n;
    v1 = to_light(vector_of(item.at("e0")));
    v2 = to_light(vector_of(item.at("e1")));
    occluder = to_light(vector_of(item.at("occluder_point")));
    if (v1.z() < 0.0) {  // behind the light, to which touching planes are blind: mirrored
      for (Vector3d* p : {&v1, &v2, &occluder}) {
        p->z() = -p->z();
      }
    }
  }
  [[nodiscard]] Vector3d to_light(const Vector3d& p) const {
    return light_from_world * (p - centre);
  }

  Vector3d centre;
  double radius;
  Eigen::Matrix3d light_from_world;
  Vector3d v1;
  Vector3d v2;
  Vector3d occluder;
};

/// 1e-12: positions of up to 30 radii in double are known to 1e-14 of the radius.
constexpr double kTolerance = 1e-12;

TEST(GoldenSoftShadow, TInTheRaysPlane) {
  const nlohmann::json golden = test::read_golden("soft_shadow.json");
  int n_checked = 0;
  for (const auto& item : golden.at("t")) {
    const double x = number(item["x"]);
    const double x_s = number(item["x_s"]);
    const bool is_hidden = x > number(item["x_o"]);
    EXPECT_EQ(is_hidden, item["branch"] == "shadow(uv)") << item["id"];
    const double t = is_hidden ? t_from_umbra(x, x_s, number(item["x_uv"]))
                               : t_from_penumbra(x, x_s, number(item["x_pv"]));
    EXPECT_NEAR(t, number(item["t"]), kTolerance) << item["id"];
    EXPECT_NEAR(disk_visibility(t, VisibilityForm::exact), number(item["V_exact_disk"]),
                kTolerance)
        << item["id"];
    EXPECT_NEAR(disk_visibility(t, VisibilityForm::cubic), number(item["V_poly"]), kTolerance)
        << item["id"];
    ++n_checked;
  }
  EXPECT_EQ(n_checked, 11);
}

TEST(GoldenSoftShadow, ExtrusionPoints) {
  const nlohmann::json golden = test::read_golden("soft_shadow.json");
  int n_checked = 0;
  int n_without = 0;
  for (const auto& item : golden.at("extrusion")) {
    const EdgeCase edge(item);
    const auto points = extrusion_points(edge.v1, edge.v2, edge.occluder, edge.radius);
    if (item["p_u"].is_null()) {
      ASSERT_FALSE(points.has_value()) << item["id"];
      EXPECT_EQ(points.error(), ExtrusionFault::meets_disk) << item["id"];
      ++n_without;
      continue;
    }
    ASSERT_TRUE(points.has_value()) << item["id"];
    const Vector3d umbra = edge.to_light(vector_of(item["p_u"]));
    const Vector3d penumbra = edge.to_light(vector_of(item["p_p"]));
    EXPECT_LE((points->umbra - umbra.head<2>()).norm(), kTolerance * edge.radius) << item["id"];
    EXPECT_LE((points->penumbra - penumbra.head<2>()).norm(), kTolerance * edge.radius)
        << item["id"];
    ++n_checked;
  }
  EXPECT_EQ(n_checked, 7);
  EXPECT_EQ(n_without, 1);
}

TEST(GoldenSoftShadow, StraightEdgesInSpace) {
  const nlohmann::json golden = test::read_golden("soft_shadow.json");
  int n_checked = 0;
  for (const auto& item : golden.at("visibility_3d")) {
    const EdgeCase edge(item);
    const Vector3d x = edge.to_light(vector_of(item["receiver"]));
    const bool is_to_the_left =
        (edge.v1 - x).cross(edge.v2 - edge.v1).dot(edge.occluder - x) < 0.0;
    const auto line = is_to_the_left ? line_on_disk(x, edge.v1, edge.v2, edge.radius)
                                     : line_on_disk(x, edge.v2, edge.v1, edge.radius);
    ASSERT_TRUE(line.has_value());
    const double truth = number(item["V_exact"]);
    EXPECT_NEAR(line_visibility(*line), truth, kTolerance * truth) << item["id"];
    EXPECT_NEAR(0.5 * (1.0 - line->offset), number(item["t_area"]), kTolerance) << item["id"];

    // By the shadow volumes' distances, as the D-buffer has them.
    const Vector3d direction = x.normalized();
    const auto points = extrusion_points(edge.v1, edge.v2, edge.occluder, edge.radius);
    ASSERT_TRUE(points.has_value());
    const double x_s = edge_plane_distance(direction, edge.v1, edge.v2);
    EXPECT_NEAR(x.norm(), number(item["x"]), kTolerance * x.norm()) << item["id"];
    EXPECT_NEAR(x_s, number(item["x_s"]), kTolerance * x_s) << item["id"];
    const bool is_hidden = item["branch"] == "uv";
    const Vector2d rim_point = is_hidden ? points->umbra : points->penumbra;
    const double boundary = edge.radius / touching_plane(rim_point, edge.v1).dot(direction);
    EXPECT_NEAR(boundary, number(item[is_hidden ? "x_uv" : "x_pv"]), kTolerance * x.norm())
        << item["id"];
    const double t = is_hidden ? t_from_umbra(x.norm(), x_s, boundary)
                               : t_from_penumbra(x.norm(), x_s, boundary);
    EXPECT_NEAR(t, number(item["t"]), kTolerance) << item["id"];
    const Vector3d a = point_in_disk_plane(edge.v1, edge.v2);
    const double of_line =
        t_of_tilted_edge(t, edge.radius * std::abs(a.z()) / a.head<2>().norm());
    EXPECT_NEAR(of_line, number(item["t_area"]), kTolerance) << item["id"];
    EXPECT_NEAR(disk_visibility(of_line, VisibilityForm::exact), truth, kTolerance)
        << item["id"];
    EXPECT_NEAR(disk_visibility(t, VisibilityForm::cubic), number(item["V_poly"]), kTolerance)
        << item["id"];
    ++n_checked;
  }
  EXPECT_EQ(n_checked, 7);
}

TEST(GoldenSoftShadow, AWideSheetAtTheEdgeHidesWhatTheEdgeDoes) {
  // The closed-form truth of the tests, by another way: the sheet is level from the edge on, in
  // the direction n x (a - c) that the disk's far side does not meet.
  const nlohmann::json golden = test::read_golden("soft_shadow.json");
  for (const auto& item : golden.at("visibility_3d")) {
    const EdgeCase edge(item);
    const Vector3d x = edge.to_light(vector_of(item["receiver"]));
    const Vector3d a = point_in_disk_plane(edge.v1, edge.v2);
    Vector3d across(-a.y(), a.x(), 0.0);
    const Vector3d normal = (edge.v1 - x).cross(edge.v2 - edge.v1);
    across *= (normal.dot(across) > 0.0) == (normal.dot(edge.occluder - x) > 0.0) ? 1.0 : -1.0;
    const Vector3d far = 1e3 / across.norm() * across;
    const Vector3d along = 1e3 * (edge.v2 - edge.v1).normalized();
    const test::ConvexPiece sheet{
        {edge.v1 - along, edge.v1 + along, edge.v1 + along + far, edge.v1 - along + far}};
    // Vertices a thousand radii away are known to 1e-13 of the radius.
    EXPECT_NEAR(test::true_disk_visibility(std::array{sheet}, x, edge.radius),
                number(item["V_exact"]), 1e-11)
        << item["id"];
  }
}

TEST(GoldenSoftShadow, ThePapersPlaneIsOffForATiltedEdge) {
  const nlohmann::json golden = test::read_golden("soft_shadow.json");
  double largest = 0.0;
  for (const auto& item : golden.at("visibility_3d")) {
    const EdgeCase edge(item);
    const Vector3d x = edge.to_light(vector_of(item["receiver"]));
    const double x_s = paper_edge_distance(x.normalized(), edge.v1, edge.v2);
    const double boundary = number(item[item["branch"] == "uv" ? "x_uv" : "x_pv"]);
    const double t = item["branch"] == "uv" ? t_from_umbra(x.norm(), x_s, boundary)
                                            : t_from_penumbra(x.norm(), x_s, boundary);
    if (item["id"] == "dbuf3d_13") {
      EXPECT_NEAR(x_s, 1.94781, 5e-6);  // to its digits, computed apart from this code
      EXPECT_NEAR(number(item["x_s"]), 1.95078, 5e-6);
      EXPECT_NEAR(std::abs(t - number(item["t"])), 7.8e-4, 5e-6);
    }
    if (edge.v1.z() == edge.v2.z()) {
      EXPECT_NEAR(t, number(item["t"]), kTolerance) << item["id"];
    }
    largest = std::max(largest, std::abs(t - number(item["t"])));
  }
  EXPECT_NEAR(largest, 0.0062, 5e-5);  // as docs/numerics/soft-shadow.md says
}

}  // namespace
}  // namespace haarlight::render
