// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/shape/photometric_stereo.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <utility>

#include <Eigen/LU>
#include <fmt/format.h>

#include "core/count.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "relight/shape/light_groups.h"

namespace haarlight::relight {

namespace {

using Eigen::Vector3d;

/// No normal is known better than this, degrees, because lights, camera and powers are not.
/// Captures of the digital twin, whose rig file is exact, are up to 0.8 off where everything
/// else is right.
constexpr double kLeastSigmaDeg = 0.5;
constexpr int kSegment = 256;  // pixels read at a time: 1 MB under 1024 lights

void keep_only(const std::vector<int>& use, LightGroups& groups) {
  std::vector<char> counts(groups.order.size(), 0);
  for (const int k : use) {
    counts[count(k)] = 1;
  }
  groups.order.erase(std::remove_if(groups.order.begin(), groups.order.end(),
                                    [&](int k) { return counts[count(k)] == 0; }),
                     groups.order.end());
}

void require_three_components(const StereoLights& lights, ImageView<const float> points,
                              int n_lights) {
  if (n_lights < 3) {
    throw Error(fmt::format("{} lights: a normal has three unknowns with its albedo", n_lights),
                "the stack", "capture at least three lights that are not in one plane");
  }
  const std::vector<Vector3d> directions = middle_directions(lights, points);
  if (const auto unknown = unknown_direction(directions)) {
    throw Error(
        fmt::format("the lights lie in one plane with the object: nothing is known of the "
                    "normals' component along ({:.3f}, {:.3f}, {:.3f})",
                    unknown->x(), unknown->y(), unknown->z()),
        "the lights' positions", "add a light outside of that plane");
  }
}

/// One task's part of the work: rows of a picture.
class RowSolver {
 public:
  RowSolver(const StackSource& stack, const StereoLights& lights, ImageView<const float> points,
            ImageView<const std::uint8_t> mask, const StereoOptions& options,
            const LightGroups& groups, SurfaceEstimate& out)
      : stack_(stack),
        lights_(lights),
        points_(points),
        mask_(mask),
        options_(options),
        out_(out),
        dims_(stack.dims()),
        samples_(dims_, lights, options.fit.has_sigma ? groups.order : options.use,
                 options.saturation),
        moved_(dims_, lights, options.fit.has_sigma ? groups.order : options.use),
        fitter_(samples_.n(), options.fit) {
    if (options.fit.has_sigma) {
      std::vector<int> group;
      group.reserve(count(samples_.n()));
      for (int j = 0; j < samples_.n(); ++j) {
        group.push_back(groups.group[count(samples_.light(j))]);
      }
      fitter_.set_groups(std::move(group));
    }
  }

  void solve_row(int y) {
    for (int x0 = 0; x0 < dims_.width; x0 += kSegment) {
      int first = x0;
      int last = std::min(x0 + kSegment, dims_.width);
      while (first < last && is_masked(y, first)) {
        ++first;
      }
      while (last > first && is_masked(y, last - 1)) {
        --last;
      }
      if (first < last) {
        solve_segment(y, first, last);
      }
    }
  }

 private:
  [[nodiscard]] bool is_masked(int y, int x) const {
    return !mask_.is_empty() && mask_(y, x) == 0;
  }

  void solve_segment(int y, int x0, int x1) {
    const TileRect rect{x0, y, x1 - x0, 1};
    const std::size_t n = count(rect.width) * count(dims_.channels) * count(dims_.n_lights);
    values_.resize(n);
    stack_.read_tile(rect, values_);
    if (options_.errors != nullptr) {
      errors_.resize(n);
      options_.errors->read_tile(rect, errors_);
    }
    for (int x = x0; x < x1; ++x) {
      if (!is_masked(y, x)) {
        solve_pixel(y, x, x - x0, rect.width);
      }
    }
  }

  void solve_pixel(int y, int x, int i, int width) {
    Vector3d point = Vector3d::Zero();
    if (lights_.are_near) {
      point = {double{points_(y, x, 0)}, double{points_(y, x, 1)}, double{points_(y, x, 2)}};
    }
    samples_.aim(point);
    samples_.take(values_, i, width, errors_);
    samples_.give(fitter_);
    LambertFit fit = fitter_.fit();
    if (fit.state == PixelState::good && lights_.are_near && options_.fit.has_sigma &&
        options_.view != nullptr) {
      const double turned = misplaced(fit, point, options_.view->to_camera(x + 0.5, y + 0.5));
      fit.sigma_deg = std::min(90.0, std::hypot(fit.sigma_deg, turned));
    }
    store(fit, y, x);
  }

  /// A point that lies e mm too near is detectable: to first order each sample is off by e q,
  /// with q the change of the fit's prediction when the point moves. No normal explains a part
  /// of q, which yields e; the rest has turned the normal. @return  by how much, degrees
  double misplaced(const LambertFit& fit, const Vector3d& point, const Vector3d& to_camera) {
    constexpr double kStep = 1.0;  // mm, of several hundred
    moved_.aim(point + kStep * to_camera);
    const int n = fitter_.n_samples();
    q_.resize(n);
    Eigen::Matrix3d matrix = Eigen::Matrix3d::Zero();
    Vector3d right = Vector3d::Zero();
    for (int i = 0; i < n; ++i) {
      const int j = fitter_.light(i);
      const Vector3d s = fitter_.direction(i);
      const double w = fitter_.weight(i);
      const double away = moved_.scale(j);
      q_[i] = away > 0.0
                  ? samples_.scale(j) / away * fit.b.dot(moved_.direction(j)) - fit.b.dot(s)
                  : 0.0;
      matrix += w * s * s.transpose();
      right += w * q_[i] * s;
    }
    Eigen::Matrix3d inverse;
    bool is_invertible = false;
    matrix.computeInverseWithCheck(inverse, is_invertible, 0.0);
    if (!is_invertible) {
      return 90.0;
    }
    const Vector3d absorbed = inverse * right;
    double above = 0.0;
    double below = 0.0;
    for (int i = 0; i < n; ++i) {
      const Vector3d s = fitter_.direction(i);
      const double left = q_[i] - absorbed.dot(s);
      above += fitter_.weight(i) * left * (samples_.value(fitter_.light(i)) - fit.b.dot(s));
      below += fitter_.weight(i) * left * left;
    }
    if (!(below > 0.0)) {
      return 90.0;
    }
    const double turn = fit.b.cross(absorbed).norm() / fit.b.squaredNorm();
    return std::abs(above / below) * turn * 180.0 / std::numbers::pi;
  }

  void store(const LambertFit& fit, int y, int x) {
    out_.state(y, x) = static_cast<std::uint8_t>(fit.state);
    out_.n_used(y, x) = static_cast<std::uint16_t>(
        std::min(fit.n_used, int{std::numeric_limits<std::uint16_t>::max()}));
    if (fit.state != PixelState::good) {
      return;
    }
    const Vector3d n = fit.b.normalized();
    for (int c = 0; c < 3; ++c) {
      out_.normal(y, x, c) = static_cast<float>(n[c]);
    }
    out_.error(y, x) = static_cast<float>(fit.error);
    if (options_.fit.has_sigma) {
      out_.sigma_deg(y, x) =
          static_cast<float>(std::min(90.0, std::hypot(fit.sigma_deg, kLeastSigmaDeg)));
    }
    for (int c = 0; c < dims_.channels;) {
      if (c + 3 <= dims_.channels) {
        store_albedo<3>(n, y, x, c);
        c += 3;
      } else {
        store_albedo<1>(n, y, x, c);
        ++c;
      }
    }
  }

  /// The albedo of channels `first`, first + 1, ...: least squares again, the normal given.
  template <int n_channels>
  void store_albedo(const Vector3d& n, int y, int x, int first) {
    std::array<double, n_channels> above{};
    double below = 0.0;
    const int n_samples = fitter_.n_samples();
    for (int s = 0; s < n_samples; ++s) {
      const double shade = fitter_.direction(s).dot(n);
      const int j = fitter_.light(s);
      const double weighted = fitter_.weight(s) * shade;
      const double scale = samples_.scale(j);
      for (int c = 0; c < n_channels; ++c) {
        const double value =
            double{samples_.raw(first + c, j)} * samples_.gain(first + c, j) * scale;
        above[count(c)] += weighted * value;
      }
      below += weighted * shade;
    }
    for (int c = 0; c < n_channels; ++c) {
      out_.albedo(y, x, first + c) =
          below > 0.0 ? static_cast<float>(above[count(c)] / below) : 0.0F;
    }
  }

  const StackSource& stack_;
  const StereoLights& lights_;
  ImageView<const float> points_;
  ImageView<const std::uint8_t> mask_;
  const StereoOptions& options_;
  SurfaceEstimate& out_;
  StackDims dims_;
  PixelSamples samples_;
  PixelSamples moved_;  ///< corrected for a displaced point
  Eigen::ArrayXd q_;
  LambertFitter fitter_;
  std::vector<float> values_;
  std::vector<float> errors_;
};

}  // namespace

std::int64_t SurfaceEstimate::n_in(PixelState wanted) const {
  return std::count(state.pixels().begin(), state.pixels().end(),
                    static_cast<std::uint8_t>(wanted));
}

Image<std::uint8_t> SurfaceEstimate::is_good() const {
  Image<std::uint8_t> good(state.height(), state.width(), 1);
  std::transform(state.pixels().begin(), state.pixels().end(), good.pixels().begin(),
                 [](std::uint8_t s) {
                   return s == static_cast<std::uint8_t>(PixelState::good) ? std::uint8_t{1}
                                                                           : std::uint8_t{0};
                 });
  return good;
}

std::vector<Vector3d> middle_directions(const StereoLights& lights,
                                        ImageView<const float> points) {
  if (!lights.are_near) {
    return lights.directions;
  }
  const int y = points.height() / 2;
  const int x = points.width() / 2;
  return directions_from(
      lights, {double{points(y, x, 0)}, double{points(y, x, 1)}, double{points(y, x, 2)}});
}

SurfaceEstimate photometric_stereo(const StackSource& stack, const StereoLights& lights,
                                   ImageView<const float> points,
                                   ImageView<const std::uint8_t> mask,
                                   const StereoOptions& options) {
  const StackDims dims = stack.dims();
  const std::size_t n_lights = lights.are_near ? lights.near.size() : lights.directions.size();
  if (n_lights != count(dims.n_lights)) {
    throw Error(fmt::format("{} lights for a stack of {}", n_lights, dims.n_lights),
                "the list of lights", "use the lights of this capture");
  }
  HAARLIGHT_EXPECTS(
      !lights.are_near || (points.height() == dims.height && points.width() == dims.width &&
                           points.channels() == 3),
      "near lights need every pixel's point");
  HAARLIGHT_EXPECTS(
      mask.is_empty() || (mask.height() == dims.height && mask.width() == dims.width),
      "a mask of the picture's size");
  HAARLIGHT_EXPECTS(
      options.saturation.empty() || options.saturation.size() == n_lights ||
          options.saturation.size() == n_lights * static_cast<std::size_t>(dims.channels),
      "one clip level per light, or one for each of its channels");
  require_three_components(lights, points, dims.n_lights);
  SurfaceEstimate out{Image<float>(dims.height, dims.width, 3),
                      Image<float>(dims.height, dims.width, dims.channels),
                      Image<float>(dims.height, dims.width, 1),
                      Image<std::uint16_t>(dims.height, dims.width, 1),
                      Image<std::uint8_t>(dims.height, dims.width, 1)};
  LightGroups groups;
  if (options.fit.has_sigma) {
    groups = group_lights(middle_directions(lights, points));
    if (!options.use.empty()) {
      keep_only(options.use, groups);
    }
    out.sigma_deg = Image<float>(dims.height, dims.width, 1);
  }
  Progress progress("normals", count(dims.height), options.progress);
  constexpr std::size_t kRowsATask = 4;
  parallel_for(count(dims.height), kRowsATask, [&](std::size_t begin, std::size_t end) {
    RowSolver solver(stack, lights, points, mask, options, groups, out);
    for (std::size_t y = begin; y < end; ++y) {
      solver.solve_row(static_cast<int>(y));
      progress.advance();
    }
  });
  return out;
}

Image<float> plane_points(const PixelPoints& pixels, int width, int height) {
  Image<float> points(height, width, 3);
  constexpr std::size_t kRowsATask = 16;
  parallel_for(count(height), kRowsATask, [&](std::size_t begin, std::size_t end) {
    for (int y = static_cast<int>(begin); y < static_cast<int>(end); ++y) {
      for (int x = 0; x < width; ++x) {
        const Vector3d point = pixels.at(x + 0.5, y + 0.5);
        for (int c = 0; c < 3; ++c) {
          points(y, x, c) = static_cast<float>(point[c]);
        }
      }
    }
  });
  return points;
}

}  // namespace haarlight::relight
