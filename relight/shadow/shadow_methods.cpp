// SPDX-License-Identifier: Apache-2.0
#include "relight/shadow/shadow_methods.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "relight/shadow/shadow_points.h"

namespace haarlight::relight {

namespace {

using Eigen::Vector3d;

constexpr double kHeight = 900.0;  // of the lights
constexpr double kPlate = 100.0;   // of what casts the shadow

/// A rectangle that hovers over hills under a ceiling of lights and a smooth sky; its shadow
/// pictures in closed form.
class PlateOverHills {
 public:
  using Result = std::vector<Vector3d>;  ///< RGB irradiance of every receiver

  explicit PlateOverHills(MethodSize size) : frame_(make_plane_frame(ground())) {
    const int side = by_size(size, 16, 32, 32);
    const double pitch = 960.0 / side;
    for (int k = 0; k < side * side; ++k) {
      const int row = k / side;
      const int col = k % side;
      render::SquareLight light;
      light.centre = {(col - 0.5 * (side - 1)) * pitch, (row - 0.5 * (side - 1)) * pitch,
                      kHeight};
      light.width_mm = light.height_mm = 0.93 * pitch;
      lights_.push_back(light);
      weights_.emplace_back(Vector3d::Constant(1.2 + std::sin(light.centre.x() / 300.0) *
                                                         std::cos(light.centre.y() / 300.0)));
      pictures_.push_back(shadow_of(light));
    }
    const int across = by_size(size, 24, 100, 316);
    for (int i = 0; i < across * across; ++i) {
      const int row = i / across;
      const int col = i % across;
      receivers_.push_back(hill((col + 0.5) / across, (row + 0.5) / across));
    }
    n_checked_ = by_size(size, 64, 512, 4096);  // of large jobs 4096
  }

  [[nodiscard]] Result run(std::size_t setting) const {
    constexpr std::array<double, 4> kTolerances{0.1, 0.01, 0.001, 0.0};
    return shadows(weights_, kTolerances.at(setting));
  }
  [[nodiscard]] Result truth() const {
    Result sum(receivers_.size(), Vector3d::Zero());
    for (std::size_t k = 0; k < lights_.size(); ++k) {
      std::vector<Vector3d> alone(lights_.size(), Vector3d::Zero());
      alone[k] = weights_[k];
      const Result one = shadows(alone, 0.0);
      for (std::size_t i = 0; i < sum.size(); ++i) {
        sum[i] += one[i];
      }
    }
    return sum;
  }
  [[nodiscard]] double error(const Result& found, const Result& truth) const {
    double square = 0.0;
    double norm = 0.0;
    for (std::size_t i = 0; i < truth.size(); ++i) {
      square += (found[i] - truth[i]).squaredNorm();
      norm += truth[i].squaredNorm();
    }
    return std::sqrt(square / norm);
  }
  [[nodiscard]] MethodScale scale() const {
    return {static_cast<int>(lights_.size()), static_cast<long long>(receivers_.size())};
  }

 private:
  static ShadowPlane ground() {
    ShadowPlane plane;
    plane.extent_u_mm = plane.extent_v_mm = 400.0;
    plane.texel_mm = 4.0;
    return plane;
  }
  /// Between 100 mm below the plane and 50 mm above it.
  static render::SurfacePoint hill(double u, double v) {
    const double x = (u - 0.5) * 300.0;
    const double y = (v - 0.5) * 300.0;
    const Vector3d normal = Vector3d(-1.5 * std::cos(x / 50.0) * std::cos(y / 50.0),
                                     1.5 * std::sin(x / 50.0) * std::sin(y / 50.0), 1.0)
                                .normalized();
    return {{x, y, -25.0 + 75.0 * std::sin(x / 50.0) * std::cos(y / 50.0)},
            normal,
            normal,
            Vector3d::UnitZ(),
            0};
  }
  /// What a rectangle hides of a light parallel to it is a product of two fractions.
  [[nodiscard]] Visibility shadow_of(const render::SquareLight& light) const {
    Visibility v{Image<float>(frame_.height, frame_.width, 1),
                 Image<std::uint8_t>(frame_.height, frame_.width, 1),
                 {}};
    const auto hidden = [](double x, double from, double to, double centre, double side) {
      const auto at = [&](double edge) { return x + (edge - x) * kHeight / kPlate; };
      const double low = std::max(at(from), centre - 0.5 * side);
      const double high = std::min(at(to), centre + 0.5 * side);
      return std::max(0.0, high - low) / side;
    };
    for (int y = 0; y < frame_.height; ++y) {
      for (int x = 0; x < frame_.width; ++x) {
        const Vector3d p = frame_.world_of(x + 0.5, y + 0.5);
        v.value(y, x) = static_cast<float>(
            1.0 - hidden(p.x(), -40.0, 25.0, light.centre.x(), light.width_mm) *
                      hidden(p.y(), -15.0, 40.0, light.centre.y(), light.height_mm));
        v.known(y, x) = 1;
      }
    }
    return v;
  }
  [[nodiscard]] Result shadows(const std::vector<Vector3d>& weights, double tolerance) const {
    const std::vector<SamplingPlane> planes{
        {frame_, [this](int k) { return pictures_[static_cast<std::size_t>(k)]; },
         HeightRange{kPlate, kPlate}}};
    PointsOptions options;
    options.tolerance.relative_l2 = tolerance;
    options.n_checked = n_checked_;
    const PointsResult found = shadow_at_points(receivers_, planes, lights_, weights, options);
    Result all;
    all.reserve(found.totals.size());
    for (const PointTotal& total : found.totals) {
      all.push_back(total.shadowed);
    }
    return all;
  }

  PlaneFrame frame_;
  std::vector<render::SquareLight> lights_;
  std::vector<Vector3d> weights_;
  std::vector<Visibility> pictures_;
  std::vector<render::SurfacePoint> receivers_;
  int n_checked_ = 0;
};

}  // namespace

std::vector<Method> shadow_methods() {
  return {Method::of<PlateOverHills>(
      {.module = "relight/shadow",
       .name = "cast shadows by blocks of lights",
       .settings = {"--max-error 0.1", "--max-error 0.01", "--max-error 0.001", "every light"},
       .error_norm = "relative L2 of the receivers' irradiance",
       .truth = "sums in double of shadows made light by light",
       .exact_error = 1e-13,
       .exact_error_from = "sums in double in another order"})};
}

}  // namespace haarlight::relight
