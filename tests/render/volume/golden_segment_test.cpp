// SPDX-License-Identifier: Apache-2.0
/// @file
/// Linear and quadratic segments against tests/golden/volume_segments.json: 50 digits, t from the far
/// end towards the eye. Tolerances are those that the file suggests.

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <limits>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "render/volume/segment.h"
#include "tests/golden_file.h"

namespace haarlight::render {
namespace {

constexpr double kTolerance = 1e-13;

double number(const nlohmann::json& value) {
  return std::strtod(value.get<std::string>().c_str(), nullptr);
}

/// The largest error in units of the tolerance, and what it is of.
struct Worst {
  double error = 0.0;
  std::string of;
  void see(double value, double truth, double tolerance, const std::string& what) {
    // What double has no number for is 0.
    const double off =
        std::abs(value - truth) / std::max(std::abs(truth), std::numeric_limits<double>::min());
    EXPECT_LE(off, tolerance) << what;
    if (off / tolerance > error) {
      error = off / tolerance;
      of = what;
    }
  }
  void print() const {
    std::printf("largest error, of the tolerance: %.3f (%s)\n", error, of.c_str());
  }
};

TEST(GoldenSegment, LinearOnes) {
  const nlohmann::json golden = test::read_golden("volume_segments.json");
  Worst worst;
  int n_checked = 0;
  for (const auto& item : golden.at("linear")) {
    const std::string id = item.at("id");
    const double length = item.at("L");
    const SegmentWeights w =
        segment_weights(number(item.at("rho_near")), number(item.at("rho_far")), length);
    const double k_near = number(item.at("k_near"));
    const double k_far = number(item.at("k_far"));
    worst.see(k_near * w.of_chromaticity.near + k_far * w.of_chromaticity.far,
              number(item.at("radiance_wm")), kTolerance, id + " radiance_wm");
    worst.see(length * (k_near * w.of_glow.near + k_far * w.of_glow.far),
              number(item.at("radiance_wvg")), kTolerance, id + " radiance_wvg");
    worst.see(w.of_chromaticity.near, number(item.at("weight_near_wm")), kTolerance,
              id + " near_wm");
    worst.see(w.of_chromaticity.far, number(item.at("weight_far_wm")), kTolerance,
              id + " far_wm");
    worst.see(w.of_glow.near, number(item.at("weight_near_wvg")), kTolerance, id + " near_wvg");
    worst.see(w.of_glow.far, number(item.at("weight_far_wvg")), kTolerance, id + " far_wvg");
    worst.see(w.opacity, number(item.at("opacity")), kTolerance, id + " opacity");
    worst.see(w.transparency, number(item.at("transparency")),
              kTolerance * (1.0 + number(item.at("tau"))), id + " transparency");
    ++n_checked;
  }
  worst.print();
  EXPECT_EQ(n_checked, 25);
}

/// A field along a ray, and what is piecewise linear in it.
class QuadraticCase {
 public:
  explicit QuadraticCase(const nlohmann::json& item)
      : a_(item.at("A")),
        b_(item.at("B")),
        c_(item.at("C")),
        breakpoints_(item.at("breakpoints")),
        rho_(item.at("rho_at_bp")),
        k_(item.at("k_at_bp")) {
    t_.push_back(item.at("L"));
    for (const auto& crossing : item.at("crossing_params")) {
      t_.push_back(number(crossing));
    }
    t_.push_back(0.0);
    std::ranges::sort(t_, std::greater<>());
  }
  /// Ends of the pieces, from the eye.
  [[nodiscard]] const std::vector<double>& ends() const { return t_; }
  [[nodiscard]] Parabola rho(double near, double far) const { return along(near, far, rho_); }
  [[nodiscard]] Parabola k(double near, double far) const { return along(near, far, k_); }

 private:
  [[nodiscard]] double field(double t) const { return (a_ * t + b_) * t + c_; }
  /// No breakpoint lies between: one line of the transfer function serves.
  [[nodiscard]] Parabola along(double near, double far,
                               const std::vector<double>& values) const {
    const double inside = field(0.5 * (near + far));
    const auto upper = std::ranges::upper_bound(breakpoints_, inside);
    if (upper == breakpoints_.begin() || upper == breakpoints_.end()) {
      const double value = upper == breakpoints_.begin() ? values.front() : values.back();
      return {.near = value, .middle = value, .far = value};
    }
    const auto i = static_cast<std::size_t>(upper - breakpoints_.begin());
    const double f0 = breakpoints_[i - 1];
    const double f1 = breakpoints_[i];
    const auto value = [&](double f) {
      return (values[i - 1] * (f1 - f) + values[i] * (f - f0)) / (f1 - f0);
    };
    const double slope_near = 2.0 * a_ * near + b_;
    return {.near = std::max(0.0, value(field(near))),
            .middle = value(field(near) + 0.5 * slope_near * (far - near)),
            .far = std::max(0.0, value(field(far)))};
  }

  double a_, b_, c_;
  std::vector<double> breakpoints_, rho_, k_;
  std::vector<double> t_;
};

double dot(const Parabola& k, const Parabola& weights) {
  return k.near * weights.near + k.middle * weights.middle + k.far * weights.far;
}

TEST(GoldenSegment, QuadraticOnes) {
  const nlohmann::json golden = test::read_golden("volume_segments.json");
  Worst worst;
  int n_checked = 0;
  for (const auto& item : golden.at("quadratic")) {
    const std::string id = item.at("id");
    const QuadraticCase ray(item);
    double of_k = 0.0;
    double of_g = 0.0;
    double opacity = 0.0;
    double transparency = 1.0;
    for (std::size_t i = 0; i + 1 < ray.ends().size(); ++i) {
      const double near = ray.ends()[i];
      const double far = ray.ends()[i + 1];
      const QuadraticWeights w = quadratic_weights(ray.rho(near, far), near - far);
      of_k += transparency * dot(ray.k(near, far), w.of_chromaticity);
      of_g += transparency * (near - far) * dot(ray.k(near, far), w.of_glow);
      opacity += transparency * w.opacity;
      transparency *= w.transparency;
    }
    worst.see(of_k, number(item.at("radiance_wm")), kTolerance, id + " radiance_wm");
    worst.see(of_g, number(item.at("radiance_wvg")), kTolerance, id + " radiance_wvg");
    worst.see(opacity, number(item.at("opacity")), kTolerance, id + " opacity");
    worst.see(transparency, number(item.at("transparency")),
              kTolerance * (1.0 + number(item.at("tau"))), id + " transparency");
    ++n_checked;
  }
  worst.print();
  EXPECT_EQ(n_checked, 9);
}

}  // namespace
}  // namespace haarlight::render
