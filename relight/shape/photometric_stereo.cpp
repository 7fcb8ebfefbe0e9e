#include "relight/shape/photometric_stereo.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>

#include "core/error.h"
#include "core/parallel.h"

namespace haarlight {

namespace {

using Eigen::Vector3d;

constexpr int kSegment = 256;  // pixels read at a time: 1 MB under 1024 lights

std::size_t count(int n) { return static_cast<std::size_t>(n); }

void require_three_components(const StereoLights& lights, ImageView<const float> points,
                              int n_lights) {
  if (n_lights < 3) {
    throw Error(fmt::format("{} lights: a normal has three unknowns with its albedo", n_lights),
                "the stack", "capture at least three lights that are not in one plane");
  }
  std::vector<Vector3d> directions = lights.directions;
  if (lights.are_near) {
    const int y = points.height() / 2;
    const int x = points.width() / 2;
    const Vector3d middle(double{points(y, x, 0)}, double{points(y, x, 1)},
                          double{points(y, x, 2)});
    directions.clear();
    for (const NearLight& light : lights.near) {
      directions.push_back((light.position_mm - middle).normalized());
    }
  }
  if (const auto unknown = unknown_direction(directions)) {
    throw Error(
        fmt::format("the lights lie in one plane with the object: nothing is known of the "
                    "normals' component along ({:.3f}, {:.3f}, {:.3f})",
                    unknown->x(), unknown->y(), unknown->z()),
        "the lights' places", "add a light outside of that plane");
  }
}

/// One task's share of the work: rows of a picture.
class RowSolver {
 public:
  RowSolver(const StackSource& stack, const StereoLights& lights, ImageView<const float> points,
            ImageView<const std::uint8_t> mask, const StereoOptions& options,
            SurfaceEstimate& out)
      : stack_(stack),
        lights_(lights),
        points_(points),
        mask_(mask),
        options_(options),
        out_(out),
        dims_(stack.dims()),
        fitter_(dims_.n_lights, options.fit),
        are_lambertian_(lights.are_near &&
                        std::all_of(lights.near.begin(), lights.near.end(),
                                    [](const NearLight& light) { return light.mu == 1.0; })) {
    const int n = dims_.n_lights;
    gain_.resize(dims_.channels, n);
    for (Eigen::ArrayXd* array : {&x_, &y_, &z_, &value_, &scale_, &lobe_}) {
      array->setOnes(n);
    }
    places_.setZero(n, 3);
    axes_.setZero(n, 3);
    for (int k = 0; k < n; ++k) {
      const Vector3d power = lights.are_near         ? lights.near[count(k)].power
                             : lights.powers.empty() ? Vector3d(Vector3d::Ones())
                                                     : lights.powers[count(k)];
      for (int c = 0; c < dims_.channels; ++c) {
        gain_(c, k) = 1.0 / (dims_.channels == 3 ? power[c] : power.mean());
      }
      if (lights.are_near) {
        places_.row(k) = lights.near[count(k)].position_mm.transpose().array();
        axes_.row(k) = lights.near[count(k)].axis.transpose().array();
      } else {
        x_[k] = lights.directions[count(k)].x();
        y_[k] = lights.directions[count(k)].y();
        z_[k] = lights.directions[count(k)].z();
      }
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

  /// Sample of channel c and light k of pixel i of the segment.
  [[nodiscard]] std::size_t index(int c, int i, int k, int width) const {
    return (count(c) * count(width) + count(i)) * count(dims_.n_lights) + count(k);
  }

  [[nodiscard]] bool is_clipped(int i, int k, int width) const {
    for (int c = 0; c < dims_.channels; ++c) {
      const std::size_t at = index(c, i, k, width);
      if ((options_.errors != nullptr && errors_[at] < 0.0F) ||
          (!options_.saturation.empty() && values_[at] >= options_.saturation[count(k)])) {
        return true;
      }
    }
    return false;
  }

  void solve_pixel(int y, int x, int i, int width) {
    Vector3d point = Vector3d::Zero();
    if (lights_.are_near) {
      point = {double{points_(y, x, 0)}, double{points_(y, x, 1)}, double{points_(y, x, 2)}};
    }
    aim(point);
    value_.setZero();
    for (int c = 0; c < dims_.channels; ++c) {
      value_ +=
          Eigen::Map<const Eigen::ArrayXf>(&values_[index(c, i, 0, width)], dims_.n_lights)
              .cast<double>() *
          gain_.row(c).transpose();
    }
    value_ *= scale_ / dims_.channels;
    const bool can_clip = options_.errors != nullptr || !options_.saturation.empty();
    fitter_.clear();
    for (int k = 0; k < dims_.n_lights; ++k) {
      if (!(scale_[k] > 0.0)) {
        continue;  // behind the light: it says nothing
      }
      if (can_clip && is_clipped(i, k, width)) {
        fitter_.add_clipped();
        continue;
      }
      fitter_.add({x_[k], y_[k], z_[k]}, value_[k], k);
    }
    store(fitter_.fit(), y, x, i, width);
  }

  /// Directions to the lights, and what brings a brightness to unit irradiance (0: none).
  void aim(const Vector3d& point) {
    if (!lights_.are_near) {
      return;  // once for all, in the constructor
    }
    x_ = places_.col(0) - point.x();
    y_ = places_.col(1) - point.y();
    z_ = places_.col(2) - point.z();
    scale_ = x_.square() + y_.square() + z_.square();
    lobe_ = scale_.sqrt().inverse();
    x_ *= lobe_;
    y_ *= lobe_;
    z_ *= lobe_;
    lobe_ = -(axes_.col(0) * x_ + axes_.col(1) * y_ + axes_.col(2) * z_);
    if (are_lambertian_) {
      scale_ = (lobe_ > 0.0).select(scale_ / lobe_, 0.0);
      return;
    }
    for (int k = 0; k < dims_.n_lights; ++k) {
      const double mu = lights_.near[count(k)].mu;
      if (mu == 0.0) {
        continue;
      }
      if (!(lobe_[k] > 0.0) || !std::isfinite(x_[k])) {
        scale_[k] = 0.0;
      } else {
        scale_[k] /= mu == 1.0 ? lobe_[k] : std::pow(lobe_[k], mu);
      }
    }
  }

  void store(const LambertFit& fit, int y, int x, int i, int width) {
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
    // Each channel's albedo: least squares again, the normal given.
    for (int c = 0; c < dims_.channels; ++c) {
      double above = 0.0;
      double below = 0.0;
      for (int j = 0; j < fitter_.n_samples(); ++j) {
        const double shade = fitter_.direction(j).dot(n);
        const int k = fitter_.light(j);
        const double w = fitter_.weight(j);
        const double value = double{values_[index(c, i, k, width)]} * gain_(c, k) * scale_[k];
        above += w * shade * value;
        below += w * shade * shade;
      }
      out_.albedo(y, x, c) = below > 0.0 ? static_cast<float>(above / below) : 0.0F;
    }
  }

  const StackSource& stack_;
  const StereoLights& lights_;
  ImageView<const float> points_;
  ImageView<const std::uint8_t> mask_;
  const StereoOptions& options_;
  SurfaceEstimate& out_;
  StackDims dims_;
  LambertFitter fitter_;
  bool are_lambertian_;   ///< near lights, all of mu 1
  Eigen::ArrayXXd gain_;  ///< (channels, n_lights): 1 / power
  Eigen::ArrayX3d places_;
  Eigen::ArrayX3d axes_;
  /// (n_lights) of the present pixel: unit directions, brightness, scale_ as aim() says.
  Eigen::ArrayXd x_, y_, z_, value_, scale_, lobe_;
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
  HAARLIGHT_EXPECTS(options.saturation.empty() || options.saturation.size() == n_lights,
                    "a clip level a light");
  require_three_components(lights, points, dims.n_lights);
  SurfaceEstimate out{Image<float>(dims.height, dims.width, 3),
                      Image<float>(dims.height, dims.width, dims.channels),
                      Image<float>(dims.height, dims.width, 1),
                      Image<std::uint16_t>(dims.height, dims.width, 1),
                      Image<std::uint8_t>(dims.height, dims.width, 1)};
  Progress progress("normals", count(dims.height), options.progress);
  constexpr std::size_t kRowsATask = 4;
  parallel_for(count(dims.height), kRowsATask, [&](std::size_t begin, std::size_t end) {
    RowSolver solver(stack, lights, points, mask, options, out);
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

}  // namespace haarlight
