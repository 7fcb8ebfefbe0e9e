// SPDX-License-Identifier: Apache-2.0
#include "relight/light/light_methods.h"

#include <array>
#include <cmath>
#include <numbers>

#include <Eigen/Core>

#include "haarlight/relight/light/light_weights.h"
#include "haarlight/render/light/solid_angle.h"

namespace haarlight::relight {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kHeight = 900.0;

double cross(const Vector2d& a, const Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); }

/// The part of a convex polygon where `side` is not negative; `side` is linear.
template <class Side>
std::vector<Vector2d> cut(const std::vector<Vector2d>& polygon, const Side& side) {
  std::vector<Vector2d> kept;
  for (std::size_t i = 0; i < polygon.size(); ++i) {
    const Vector2d& a = polygon[i];
    const Vector2d& b = polygon[(i + 1) % polygon.size()];
    const double at_a = side(a);
    const double at_b = side(b);
    if (at_a >= 0.0) {
      kept.push_back(a);
    }
    if ((at_a < 0.0) != (at_b < 0.0)) {
      kept.emplace_back(a + at_a / (at_a - at_b) * (b - a));
    }
  }
  return kept;
}

/// A ceiling of lights under a sky that is lit between two meridians, which lie on borders of
/// its texels, but not of coarser ones.
class LitMeridians {
 public:
  using Result = Eigen::MatrixXd;  ///< EnvironmentWeights::cell_radiance

  explicit LitMeridians(MethodSize size)
      : across_(by_size(size, 64, 256, 256)),
        rig_(ceiling(by_size(size, 4, 16, 32))),
        from_(across_ / 8 + 5),
        to_(across_ / 2 - 3) {
    Image<float> sky(across_ / 2, across_, 1);
    for (int row = 0; row < sky.height(); ++row) {
      for (int col = from_; col < to_; ++col) {
        sky(row, col) = 1.0F;
      }
    }
    environments_.push_back(render::Environment::from_picture(std::move(sky), "made"));
    for (const int merged : {2, 8}) {
      environments_.insert(environments_.begin(),
                           environments_.back().reduced(across_ / merged));
    }
  }

  [[nodiscard]] Result run(std::size_t setting) const {
    return rig_weights(environments_.at(setting), rig_).cell_radiance;
  }
  /// The solid angle of each cell's part between the meridians, cut out on the ceiling.
  [[nodiscard]] Result truth() const {
    const auto meridian = [this](int col) {
      const double p = std::numbers::pi - 2.0 * std::numbers::pi * col / across_;
      return Vector2d(std::cos(p), std::sin(p));
    };
    const Face& face = rig_.faces.front();
    Result all(face.n_lights(), 1);
    for (int k = 0; k < face.n_lights(); ++k) {
      const int row = k / face.cols;
      const int col = k % face.cols;
      const Vector2d centre((col - 0.5 * (face.cols - 1)) * face.pitch_mm,
                            (row - 0.5 * (face.rows - 1)) * face.pitch_mm);
      std::vector<Vector2d> part;
      for (const auto& [x, y] :
           {std::pair{-1, -1}, std::pair{1, -1}, std::pair{1, 1}, std::pair{-1, 1}}) {
        part.emplace_back(centre + 0.5 * face.pitch_mm * Vector2d(x, y) -
                          rig_.object_centre.head<2>());
      }
      part = cut(part, [&](const Vector2d& d) { return cross(meridian(to_), d); });
      part = cut(part, [&](const Vector2d& d) { return cross(d, meridian(from_)); });
      std::vector<Vector3d> directions;
      directions.reserve(part.size());
      for (const Vector2d& d : part) {
        directions.push_back(
            Vector3d(d.x(), d.y(), kHeight - rig_.object_centre.z()).normalized());
      }
      all(k, 0) = directions.size() < 3 ? 0.0 : std::abs(render::solid_angle(directions));
    }
    return all;
  }
  [[nodiscard]] double error(const Result& found, const Result& truth) const {
    return (found - truth).norm() / truth.norm();
  }
  [[nodiscard]] MethodScale scale() const {
    return {rig_.faces.front().n_lights(), static_cast<long long>(across_) * across_ / 2};
  }

 private:
  static Rig ceiling(int side) {
    Rig rig;
    rig.name = "ceiling";
    rig.object_centre = {31.0, 17.0, 45.0};
    Face face;
    face.id = "top";
    face.centre = {0.0, 0.0, kHeight};
    face.rows = face.cols = side;
    face.pitch_mm = 960.0 / side;
    face.emitter_w_mm = face.emitter_h_mm = 0.93 * face.pitch_mm;
    rig.faces = {face};
    return rig;
  }

  int across_;
  Rig rig_;
  int from_;  ///< the lit columns of the sky
  int to_;
  std::vector<render::Environment> environments_;
};

}  // namespace

std::vector<Method> light_methods() {
  return {Method::of<LitMeridians>(
      {.module = "relight/light",
       .name = "light weights of an environment by exact clipping",
       .settings = {"8 x 8 texels merged", "2 x 2 texels merged", "every texel"},
       .error_norm = "relative L2 of the light in each cell",
       .truth = "closed form: solid angles between two meridians, cut on the lights' plane",
       .exact_error = 2e-5,
       .exact_error_from = "a texel's parallels are chords within 1e-7 rad, two of them at "
                           "least 0.012 rad apart"})};
}

}  // namespace haarlight::relight
