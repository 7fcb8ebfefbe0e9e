#include "relight/shape/near_alternation.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "core/error.h"
#include "relight/shape/normal_picture.h"
#include "relight/shape/slope_field.h"

namespace haarlight {

namespace {

using Eigen::Vector3d;

/// Where the pixels' surface lies, from what was integrated.
class PointMaker {
 public:
  PointMaker(const PixelPoints& pixels, const HeightMap& map)
      : pixels_(pixels), map_(map), parts_(find_parts(map.is_known.view())) {
    if (pixels.camera() == nullptr) {
      return;
    }
    // ln D + c of each part: its mean height above the plane is 0. Heights are linear in
    // exp(c).
    const auto n = static_cast<std::size_t>(parts_.n_parts);
    std::vector<double> facing(n, 0.0);
    std::vector<double> below(n, 0.0);
    scale_.assign(n, 1.0);
    const Vector3d eye = pixels.camera()->centre_world();
    const double eye_height = pixels.height_of(eye);
    for (int y = 0; y < map.height.height(); ++y) {
      for (int x = 0; x < map.height.width(); ++x) {
        const int part = parts_.label(y, x);
        if (part >= 0) {
          const double down = pixels.to_camera(x + 0.5, y + 0.5).dot(pixels.plane_normal());
          facing[static_cast<std::size_t>(part)] += down * std::exp(double{map.height(y, x)});
          below[static_cast<std::size_t>(part)] += eye_height;
        }
      }
    }
    for (std::size_t i = 0; i < n; ++i) {
      scale_[i] = below[i] / facing[i];
    }
  }

  /// @return  height above the reference plane
  double make(int y, int x, Vector3d& point) const {
    const int part = parts_.label(y, x);
    if (part < 0) {
      point = pixels_.at(x + 0.5, y + 0.5);
      return 0.0;
    }
    if (pixels_.camera() == nullptr) {
      point = pixels_.at(x + 0.5, y + 0.5);
      point.z() += double{map_.height(y, x)};
      return double{map_.height(y, x)};
    }
    const double distance =
        scale_[static_cast<std::size_t>(part)] * std::exp(double{map_.height(y, x)});
    point = pixels_.camera()->centre_world() - distance * pixels_.to_camera(x + 0.5, y + 0.5);
    return pixels_.height_of(point);
  }

 private:
  const PixelPoints& pixels_;
  const HeightMap& map_;
  Parts parts_;
  std::vector<double> scale_;  ///< camera: exp of each part's constant, mm
};

/// Puts heights and points into the shape. @return  rms change of the heights, mm
double place(const PixelPoints& pixels, Shape& shape) {
  const PointMaker maker(pixels, shape.map);
  double sum = 0.0;
  double n = 0.0;
  double low = std::numeric_limits<double>::infinity();
  double high = -low;
  for (int y = 0; y < shape.height.height(); ++y) {
    for (int x = 0; x < shape.height.width(); ++x) {
      Vector3d point;
      const double height = maker.make(y, x, point);
      if (shape.map.is_known(y, x) != 0) {
        const double change = height - double{shape.height(y, x)};
        sum += change * change;
        n += 1.0;
        low = std::min(low, height);
        high = std::max(high, height);
      }
      shape.height(y, x) = static_cast<float>(height);
      for (int c = 0; c < 3; ++c) {
        shape.points(y, x, c) = static_cast<float>(point[c]);
      }
    }
  }
  shape.bow_mm = n > 0.0 ? high - low : 0.0;
  return n > 0.0 ? std::sqrt(sum / n) : 0.0;
}

/// Heights and points from the present normals.
void find_heights(const PixelPoints& pixels, const IntegrateOptions& options, Shape& shape) {
  const ImageView<const float> normals = shape.surface.normal.view();
  const Image<std::uint8_t> good = shape.surface.is_good();
  const SlopeField slopes =
      pixels.camera() != nullptr
          ? perspective_slopes(normals, good.view(), *pixels.camera())
          : orthographic_slopes(turned_normals(normals, pixels.picture_from_world()).view(),
                                good.view(), pixels.mm_per_pixel());
  shape.map = integrate_slopes(slopes, options);
  shape.changes.push_back(place(pixels, shape));
}

}  // namespace

Shape shape_of(SurfaceEstimate surface, const PixelPoints& pixels,
               const IntegrateOptions& options) {
  Shape shape;
  shape.surface = std::move(surface);
  const int h = shape.surface.normal.height();
  const int w = shape.surface.normal.width();
  shape.points = Image<float>(h, w, 3);
  shape.height = Image<float>(h, w, 1);
  find_heights(pixels, options, shape);
  return shape;
}

Shape recover_shape(const StackSource& stack, const StereoLights& lights,
                    const PixelPoints& pixels, ImageView<const std::uint8_t> mask,
                    const ShapeOptions& options) {
  HAARLIGHT_EXPECTS(options.max_rounds >= 1, "at least one round");
  const StackDims dims = stack.dims();
  Shape shape;
  shape.points = plane_points(pixels, dims.width, dims.height);
  shape.height = Image<float>(dims.height, dims.width, 1);
  const double settled = options.tolerance * pixels.mm_per_pixel() * dims.width;
  const int n_rounds = lights.are_near ? options.max_rounds : 1;
  for (int round = 0; round < n_rounds; ++round) {
    shape.surface =
        photometric_stereo(stack, lights, shape.points.view(), mask, options.stereo);
    find_heights(pixels, options.integrate, shape);
    shape.is_settled = n_rounds == 1 || shape.changes.back() <= settled;
    if (shape.is_settled) {
      break;
    }
  }
  return shape;
}

}  // namespace haarlight
