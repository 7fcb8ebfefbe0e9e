// SPDX-License-Identifier: Apache-2.0
#include "haarlight/render/analytic/polygon_light.h"

#include <cmath>

#include <Eigen/Geometry>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <rapidcheck/gtest.h>

#include "tests/golden_file.h"
#include "tests/render/square_light.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;
using testing::square;

double number(const nlohmann::json& value) {
  return value.is_string() ? std::stod(value.get<std::string>()) : value.get<double>();
}

Vector3d vector_of(const nlohmann::json& value) {
  return {number(value[0]), number(value[1]), number(value[2])};
}

nlohmann::json golden_cases() { return test::read_golden("transport.json").at("cases"); }

TEST(PolygonIrradiance, HoldsTheGoldenPolygons) {
  int n_checked = 0;
  for (const auto& item : golden_cases()) {
    const auto& geometry = item["geometry"];
    if (!geometry.contains("emitter_vertices")) {
      continue;
    }
    std::vector<Vector3d> vertices;
    for (const auto& vertex : geometry["emitter_vertices"]) {
      vertices.push_back(vector_of(vertex));
    }
    const Vector3d normal = vector_of(geometry["receiver_normal"]);
    const Irradiance e = polygon_irradiance(vertices, vector_of(geometry["receiver"]), normal);
    const double truth = number(item["value_double"]);
    // The spec asks 1e-10, and 1e-6 in the extreme cases (light within 1e-6 of the receiver or
    // of its horizon); the suggested tolerance is 1e-12.
    const std::string note = item["note"];
    const bool is_extreme = note.find("89.999999") != std::string::npos;
    EXPECT_NEAR(e.value, truth, (is_extreme ? 1e-6 : 1e-12) * truth)
        << item["id"] << ": " << note;
    ++n_checked;
  }
  EXPECT_EQ(n_checked, 10);
}

/// Midpoint rule on n x n cells: independent of the code under test, second order.
double midpoint(const SquareLight& light, const Vector3d& p, const Vector3d& n, int cells) {
  double sum = 0.0;
  for (int j = 0; j < cells; ++j) {
    for (int i = 0; i < cells; ++i) {
      const Vector3d r = light.centre + ((i + 0.5) / cells - 0.5) * light.width_mm * light.u +
                         ((j + 0.5) / cells - 0.5) * light.height_mm * light.v - p;
      const double d = r.norm();
      const double cos_l = -light.emits.dot(r) / d;
      sum +=
          std::max(0.0, n.dot(r) / d) * std::pow(std::max(0.0, cos_l), light.lobe_mu) / (d * d);
    }
  }
  return light.radiance * sum * light.width_mm * light.height_mm / (cells * cells);
}

/// Richardson's extrapolation of the midpoint rule: fourth order for lights above the horizon.
double reference(const SquareLight& light, const Vector3d& p, const Vector3d& n) {
  return (4.0 * midpoint(light, p, n, 128) - midpoint(light, p, n, 64)) / 3.0;
}

TEST(LightIrradiance, EqualsTheGoldenSquareOfALed) {
  // square_emitter_irradiance_04: a cell of 6/32 at height 6.
  const double e = light_irradiance(square({0, 0, 6}, 0.1875), {-3, 0.5, 0}, Vector3d::UnitZ());
  EXPECT_NEAR(e, 6.180510802364534e-4, 1e-15);
}

TEST(LightIrradiance, IsContinuousOverEverySwitchOver) {
  // Walking away from the light passes closed form, 8, 6 and 4 nodes; each neighbour pair of
  // distances must agree with its own 4th-order reference to the reference's accuracy.
  for (const double mu : {1.0, 2.5}) {
    for (double distance = 1.0; distance < 200.0; distance *= 1.17) {
      const SquareLight light = square({0.3, -0.2, distance}, 1.0, mu);
      const Vector3d n = Vector3d(0.2, 0.3, 0.9).normalized();
      const double e = light_irradiance(light, Vector3d::Zero(), n);
      // Error of the extrapolated midpoint rule: below (size / distance / 64)^4.
      EXPECT_NEAR(e, reference(light, Vector3d::Zero(), n), e * 3e-8 / std::pow(distance, 2))
          << "mu " << mu << " at " << distance;
    }
  }
}

/// A strip of 20 x 1, a hair off the line of sight, varies the most along itself. Distances run
/// through every number of nodes; the eighths of the strip are far enough for all of theirs.
TEST(LightIrradiance, AStripSeenEndOnKeepsItsDigits) {
  for (const double mu : {1.0, 1.5, 4.0, 16.0, 40.0}) {
    for (double distance = 15.0; distance < 8000.0; distance *= 1.05) {
      for (const double lift : {0.05, 0.5, 1.2}) {
        SquareLight light = square({0.0, 0.0, 0.0}, 20.0);
        light.height_mm = 1.0;
        light.lobe_mu = mu;
        light.u = {std::cos(lift), 0.0, std::sin(lift)};
        light.emits = {std::sin(lift), 0.0, -std::cos(lift)};
        light.v = Vector3d::UnitY();
        light.centre = distance * Vector3d(-std::cos(0.9 * lift), 0.0, std::sin(0.9 * lift));
        light.centre.z() += 10.0 * std::sin(lift);  // the whole strip above the horizon
        light.centre.x() -= 10.0;
        double fine = 0.0;
        for (int part = 0; part < 8; ++part) {
          SquareLight eighth = light;
          eighth.width_mm /= 8.0;
          eighth.centre += (part - 3.5) * eighth.width_mm * light.u;
          fine += light_irradiance(eighth, Vector3d::Zero(), Vector3d::UnitZ());
        }
        const double whole = light_irradiance(light, Vector3d::Zero(), Vector3d::UnitZ());
        const double h = -light.emits.dot(light.centre);
        // Rounding: of h, and of the corners against the strip's width of 1.
        EXPECT_NEAR(whole / fine, 1.0, 1.2e-13 + 4e-16 * distance * (mu / h + 1.0))
            << mu << " " << distance << " " << lift;
      }
    }
  }
}

TEST(LightIrradiance, LobeOfOneEqualsTheClosedFormNearTheLight) {
  // Quadrature refined near the light against Lambert's formula, which is exact for mu = 1:
  // mu = 1 + 1e-15 takes the quadrature.
  for (const double height : {0.01, 0.1, 0.5, 1.0, 3.0}) {
    const Vector3d n = Vector3d(0.5, -0.1, 0.7).normalized();
    const double closed = light_irradiance(square({0.1, 0, height}, 1.0), Vector3d::Zero(), n);
    const double sampled =
        light_irradiance(square({0.1, 0, height}, 1.0, 1.0 + 1e-15), Vector3d::Zero(), n);
    EXPECT_NEAR(sampled, closed, 1e-10 * closed) << height;
  }
}

RC_GTEST_PROP(LightIrradiance, IsTheSumOfItsQuarters, ()) {
  const auto coordinate = [] { return *rc::gen::inRange(-1000, 1001) / 100.0; };
  SquareLight light = square({coordinate(), coordinate(), 2.0 + std::abs(coordinate())}, 2.0);
  light.lobe_mu = *rc::gen::element(1.0, 1.7, 3.0);
  const Vector3d n = Vector3d(coordinate(), coordinate(), 12.0 + coordinate()).normalized();
  double quarters = 0.0;
  for (int i = 0; i < 4; ++i) {
    SquareLight quarter = light;
    quarter.width_mm = quarter.height_mm = 1.0;
    quarter.centre += Vector3d((i & 1) != 0 ? 0.5 : -0.5, (i & 2) != 0 ? 0.5 : -0.5, 0.0);
    quarters += light_irradiance(quarter, Vector3d::Zero(), n);
  }
  const double whole = light_irradiance(light, Vector3d::Zero(), n);
  // 16 terms of 1e-13 each; a light that the horizon cuts is integrated to 1e-10.
  RC_ASSERT(std::abs(whole - quarters) <= 1e-10 * whole);
}

RC_GTEST_PROP(PolygonIrradiance, DoesNotChangeUnderRotation, ()) {
  const auto coordinate = [] { return *rc::gen::inRange(-1000, 1001) / 100.0; };
  std::vector<Vector3d> triangle;
  for (int i = 0; i < 3; ++i) {
    triangle.emplace_back(coordinate(), coordinate(), 3.0 + coordinate());
  }
  const Vector3d n = Vector3d(coordinate(), coordinate(), 10.5 + coordinate()).normalized();
  const Eigen::Quaterniond turn =
      Eigen::Quaterniond(coordinate(), coordinate(), 11, 0.3).normalized();
  const double before = polygon_irradiance(triangle, Vector3d::Zero(), n).value;
  for (Vector3d& vertex : triangle) {
    vertex = turn * vertex;
  }
  const double after = polygon_irradiance(triangle, Vector3d::Zero(), turn * n).value;
  RC_ASSERT(std::abs(before - after) <= 1e-9 * (before + 1e-9));
}

}  // namespace
}  // namespace haarlight::render
