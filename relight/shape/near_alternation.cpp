// SPDX-License-Identifier: Apache-2.0
#include "relight/shape/near_alternation.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <utility>

#include "haarlight/core/error.h"
#include "haarlight/relight/shape/normal_picture.h"
#include "haarlight/relight/shape/slope_field.h"
#include "relight/shape/light_groups.h"
#include "relight/shape/normal_unevenness.h"

namespace haarlight::relight {

namespace {

using Eigen::Vector3d;

/// The pixels' surface points, from the integrated map.
class PointMaker {
 public:
  /// @param gauge  (height, width) a part's prescribed mean height is the mean of this over it
  PointMaker(const PixelPoints& pixels, const HeightMap& map, const Image<float>& gauge)
      : pixels_(pixels), map_(map), parts_(map.parts) {
    const auto n = static_cast<std::size_t>(parts_.n_parts);
    find_means(gauge);
    if (pixels.camera() == nullptr) {
      return;
    }
    // ln D + c of each part: its mean height above the plane equals the gauge's. Heights are
    // linear in exp(c).
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
          below[static_cast<std::size_t>(part)] +=
              eye_height - mean_[static_cast<std::size_t>(part)];
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
      const double height = double{map_.height(y, x)} + mean_[static_cast<std::size_t>(part)];
      point = pixels_.at(x + 0.5, y + 0.5);
      point.z() += height;
      return height;
    }
    const double distance =
        scale_[static_cast<std::size_t>(part)] * std::exp(double{map_.height(y, x)});
    point = pixels_.camera()->centre_world() - distance * pixels_.to_camera(x + 0.5, y + 0.5);
    return pixels_.height_of(point);
  }

 private:
  void find_means(const Image<float>& gauge) {
    const auto n = static_cast<std::size_t>(parts_.n_parts);
    mean_.assign(n, 0.0);
    std::vector<double> pixels(n, 0.0);
    for (std::size_t i = 0; i < gauge.pixels().size(); ++i) {
      const int part = parts_.label.pixels()[i];
      if (part >= 0) {
        mean_[static_cast<std::size_t>(part)] += double{gauge.pixels()[i]};
        pixels[static_cast<std::size_t>(part)] += 1.0;
      }
    }
    for (std::size_t part = 0; part < n; ++part) {
      mean_[part] /= std::max(1.0, pixels[part]);
    }
  }

  const PixelPoints& pixels_;
  const HeightMap& map_;
  const Parts& parts_;
  std::vector<double> mean_;   ///< prescribed mean height of each part, mm
  std::vector<double> scale_;  ///< camera: exp of each part's constant, mm
};

/// Stores heights and points in the shape. @return  rms change of the heights, mm
double place(const PixelPoints& pixels, const Image<float>& gauge, Shape& shape) {
  const PointMaker maker(pixels, shape.map, gauge);
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
void find_heights(const PixelPoints& pixels, const IntegrateOptions& options,
                  const Image<float>& gauge, Shape& shape) {
  const ImageView<const float> normals = shape.surface.normal.view();
  const Image<std::uint8_t> good = shape.surface.is_good();
  const SlopeField slopes =
      pixels.camera() != nullptr
          ? perspective_slopes(normals, good.view(), *pixels.camera())
          : orthographic_slopes(turned_normals(normals, pixels.picture_from_world()).view(),
                                good.view(), pixels.mm_per_pixel());
  shape.map = integrate_slopes(slopes, options);
  shape.changes.push_back(place(pixels, gauge, shape));
}

/// Sizes and current mean heights of the parts, largest first.
std::vector<PartHeight> parts_as_they_are(const Shape& shape) {
  const Parts& parts = shape.map.parts;
  std::vector<PartHeight> list(static_cast<std::size_t>(parts.n_parts));
  for (std::size_t i = 0; i < shape.height.pixels().size(); ++i) {
    const int label = parts.label.pixels()[i];
    if (label >= 0) {
      PartHeight& part = list[static_cast<std::size_t>(label)];
      ++part.n_pixels;
      part.mean_mm += double{shape.height.pixels()[i]};
    }
  }
  for (PartHeight& part : list) {
    part.mean_mm /= static_cast<double>(std::max<std::int64_t>(1, part.n_pixels));
  }
  return list;
}

void sort_by_size(std::vector<PartHeight>& parts) {
  std::stable_sort(parts.begin(), parts.end(), [](const PartHeight& a, const PartHeight& b) {
    return a.n_pixels > b.n_pixels;
  });
}

/// The rounds of one recovery.
class Rounds {
 public:
  Rounds(const StackSource& stack, const StereoLights& lights, const PixelPoints& pixels,
         ImageView<const std::uint8_t> mask, const ShapeOptions& options, Shape& shape)
      : stack_(stack),
        lights_(lights),
        pixels_(pixels),
        mask_(mask),
        options_(options),
        shape_(shape),
        integrate_(options.integrate),
        gauge_(stack.dims().height, stack.dims().width, 1),
        region_(stack.dims().height, stack.dims().width, 1),
        settled_(options.tolerance * pixels.mm_per_pixel() * stack.dims().width) {}

  /// The heights found for the parts, largest first; empty: not requested.
  [[nodiscard]] const std::vector<PartHeight>& found() const noexcept { return found_; }

  /// Iterates until the heights converge. @param most  rounds
  void go(const StereoOptions& stereo, int most) {
    for (int round = 0; round < most; ++round) {
      shape_.surface = photometric_stereo(stack_, lights_, shape_.points.view(), mask_, stereo);
      find_heights(pixels_, integrate_, gauge_, shape_);
      const bool is_moved = (options_.finds_part_heights || options_.hull != nullptr) &&
                            lights_.are_near && n_searches_ < kSearches;
      if (is_moved) {
        raise_parts({.is_first = n_searches_ == 0,
                     .has_sigma = n_searches_ + 1 == kSearches || round + 1 == most});
        ++n_searches_;
      }
      shape_.is_settled =
          !lights_.are_near || (!is_moved && shape_.changes.back() <= still_mm());
      if (shape_.is_settled) {
        return;
      }
    }
  }

  /// Iterates, and again as long as the hull tells further parts apart.
  void go_within_hull(const StereoOptions& stereo, int most) {
    constexpr int kDivisions = 3;
    go(stereo, most);
    for (int i = 0; options_.hull != nullptr && i < kDivisions && divide(); ++i) {
      n_searches_ = 0;
      go(stereo, most);
    }
  }

 private:
  /// ln of the points' distances from the camera.
  [[nodiscard]] Image<float> log_depth() const {
    Image<float> depth(gauge_.height(), gauge_.width(), 1);
    const Vector3d eye = pixels_.camera()->centre_world();
    for (int y = 0; y < depth.height(); ++y) {
      for (int x = 0; x < depth.width(); ++x) {
        const Vector3d point(double{shape_.points(y, x, 0)}, double{shape_.points(y, x, 1)},
                             double{shape_.points(y, x, 2)});
        depth(y, x) = static_cast<float>(std::log((point - eye).norm()));
      }
    }
    return depth;
  }

  /// @return  whether there are more regions now
  bool divide() {
    const int n = divide_by_hull(*options_.hull, log_depth(), shape_.surface,
                                 shape_.map.is_known, region_);
    shape_.n_divided += n;
    if (n > 0) {
      integrate_.region = &region_;
    }
    return n > 0;
  }

  /// Convergence limit of the heights: the tolerance, or half the step error from pixel to
  /// pixel implied by the normals' standard errors, where known.
  [[nodiscard]] double still_mm() const {
    constexpr double kOfError = 0.5;
    double sum = 0.0;
    double n = 0.0;
    for (const float sigma_deg : shape_.surface.sigma_deg.pixels()) {
      sum += double{sigma_deg} * double{sigma_deg};
      n += sigma_deg > 0.0F ? 1.0 : 0.0;
    }
    const double sigma = std::sqrt(sum / std::max(n, 1.0)) * std::numbers::pi / 180.0;
    return std::max(settled_, kOfError * sigma * pixels_.mm_per_pixel());
  }

  /// As often as the shape needs to follow: later the gauge is frozen, so that the heights can
  /// converge.
  static constexpr int kSearches = 4;

  /// Parts that the fall-off leaves unknown, or puts where the hull says that they are not, go
  /// where the hull has room for them.
  void keep_within_hull() {
    const std::vector<PartMoves> moves =
        part_moves(*options_.hull, log_depth(), shape_.map.parts);
    const std::vector<PartHeight> now = parts_as_they_are(shape_);
    const double eye_height = pixels_.height_of(pixels_.camera()->centre_world());
    for (std::size_t i = 0; i < moves.size(); ++i) {
      if (!moves[i].is_known) {
        continue;
      }
      const auto moved = [&](double move) {
        return eye_height - (eye_height - now[i].mean_mm) * std::exp(move);
      };
      PartHeight& part = found_[i];
      part.low_mm = moved(moves[i].furthest);
      part.high_mm = moved(moves[i].nearest);
      if (!part.is_known || part.mean_mm < part.low_mm || part.mean_mm > part.high_mm) {
        part.mean_mm = moved(moves[i].best);
        part.is_known = true;
        part.source = HeightSource::hull;
      }
    }
  }

  /// Moves each part to the height found from the fall-off, and within the hull.
  void raise_parts(const PartSearch& search) {
    const Parts& parts = shape_.map.parts;
    found_ = options_.finds_part_heights ? find_part_heights(stack_, lights_, pixels_, parts,
                                                             shape_.points.view(), search)
                                         : parts_as_they_are(shape_);
    if (options_.hull != nullptr) {
      keep_within_hull();
    }
    double of_largest = 0.0;
    std::int64_t most = 0;
    for (const PartHeight& part : found_) {
      if (part.is_known && part.n_pixels > most) {
        most = part.n_pixels;
        of_largest = part.mean_mm;
      }
    }
    for (std::size_t i = 0; i < gauge_.pixels().size(); ++i) {
      const int label = parts.label.pixels()[i];
      const bool is_known = label >= 0 && found_[static_cast<std::size_t>(label)].is_known;
      gauge_.pixels()[i] = static_cast<float>(
          is_known ? found_[static_cast<std::size_t>(label)].mean_mm : of_largest);
    }
    shape_.changes.back() += place(pixels_, gauge_, shape_);
    sort_by_size(found_);
  }

  const StackSource& stack_;
  const StereoLights& lights_;
  const PixelPoints& pixels_;
  ImageView<const std::uint8_t> mask_;
  const ShapeOptions& options_;
  Shape& shape_;
  IntegrateOptions integrate_;
  Image<float> gauge_;  ///< prescribed mean of each part, mm above the plane
  Image<int> region_;   ///< as the hull divides the picture
  double settled_;
  int n_searches_ = 0;
  std::vector<PartHeight> found_;
};

/// The points in the middle of what the hull takes as matter; elsewhere as they are.
void start_on_hull(const DepthBounds& likely, const PixelPoints& pixels, Image<float>& points) {
  const Vector3d eye = pixels.camera()->centre_world();
  for (int y = 0; y < points.height(); ++y) {
    for (int x = 0; x < points.width(); ++x) {
      if (!(likely.low(y, x) < likely.high(y, x))) {
        continue;
      }
      const double distance =
          std::exp(0.5 * (double{likely.low(y, x)} + double{likely.high(y, x)}));
      const Vector3d point = eye - distance * pixels.to_camera(x + 0.5, y + 0.5);
      for (int c = 0; c < 3; ++c) {
        points(y, x, c) = static_cast<float>(point[c]);
      }
    }
  }
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
  find_heights(pixels, options, Image<float>(h, w, 1), shape);
  shape.parts = parts_as_they_are(shape);
  sort_by_size(shape.parts);
  return shape;
}

Shape recover_shape(const StackSource& stack, const StereoLights& lights,
                    const PixelPoints& pixels, ImageView<const std::uint8_t> mask,
                    const ShapeOptions& options) {
  HAARLIGHT_EXPECTS(options.max_rounds >= 1, "at least one round");
  HAARLIGHT_EXPECTS(options.hull == nullptr || (lights.are_near && pixels.camera() != nullptr),
                    "a hull for near lights and a camera");
  const StackDims dims = stack.dims();
  Shape shape;
  shape.points = plane_points(pixels, dims.width, dims.height);
  shape.height = Image<float>(dims.height, dims.width, 1);
  if (options.hull != nullptr) {
    start_on_hull(options.hull->likely, pixels, shape.points);
  }
  StereoOptions stereo = options.stereo;
  stereo.view = &pixels;
  Rounds rounds(stack, lights, pixels, mask, options, shape);
  // The fit is chosen once the points are nearly right.
  const bool is_coarse_first = options.chooses_fit || dims.n_lights > options.n_coarse_lights;
  const int n_coarse = lights.are_near && is_coarse_first ? options.max_rounds - 2 : 0;
  if (n_coarse > 0) {
    StereoOptions few = stereo;
    few.use = thinned(group_lights(middle_directions(lights, shape.points.view())),
                      options.n_coarse_lights);
    few.fit.has_sigma = false;
    rounds.go_within_hull(few, n_coarse);
  }
  if (options.chooses_fit) {
    const Image<std::uint8_t> good =
        n_coarse > 0 ? shape.surface.is_good() : Image<std::uint8_t>();
    shape.scores = score_fits(stack, lights,
                              lights.are_near ? ImageView<const float>(shape.points.view())
                                              : ImageView<const float>(),
                              n_coarse > 0 ? good.view() : mask, stereo);
    const bool has_sigma = stereo.fit.has_sigma;
    stereo.fit = shape.scores.front().fit;
    stereo.fit.has_sigma = has_sigma;
  }
  shape.fit = stereo.fit;
  rounds.go_within_hull(
      stereo, lights.are_near
                  ? std::max(1, options.max_rounds - static_cast<int>(shape.changes.size()))
                  : 1);
  if (!lights.are_near && stereo.fit.has_sigma) {
    shape.nearness = find_nearness(stack, lights, shape.surface, stereo);
    add_nearness(shape.nearness, shape.surface);
  }
  if (stereo.fit.has_sigma) {
    add_unevenness(shape.surface);
  }
  shape.parts = rounds.found().empty() ? parts_as_they_are(shape) : rounds.found();
  sort_by_size(shape.parts);
  return shape;
}

}  // namespace haarlight::relight
