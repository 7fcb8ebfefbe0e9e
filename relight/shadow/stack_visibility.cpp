// SPDX-License-Identifier: Apache-2.0
#include "relight/shadow/stack_visibility.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <mutex>
#include <optional>
#include <utility>

#include <fmt/format.h>

#include "core/parallel.h"
#include "core/random.h"
#include "haarlight/core/error.h"
#include "haarlight/relight/shadow/receiver_light.h"

namespace haarlight::relight {
namespace {

constexpr int kTile = 32;                // pixels per side: 4 MB of values for 1024 lights
constexpr float kDarkPlate = -1.0F;      // marker in values_: visibility undefined
constexpr double kStandardErrors = 3.0;  // of a height that is none
constexpr std::size_t kFitValues = std::size_t{1} << 22U;  // in the fit of g: about 50 MB
constexpr std::size_t kFitTiles = 100;                     // that they come from

std::vector<TileRect> tiles_of(const StackDims& dims) {
  std::vector<TileRect> tiles;
  for (int y = 0; y < dims.height; y += kTile) {
    for (int x = 0; x < dims.width; x += kTile) {
      tiles.push_back(
          {x, y, std::min(kTile, dims.width - x), std::min(kTile, dims.height - y)});
    }
  }
  return tiles;
}

/// Sum over channels of one pixel's row over the lights.
void sum_channels(std::span<const float> values, int channels, std::size_t n_pixels,
                  std::size_t pixel, std::span<float> out) {
  std::fill(out.begin(), out.end(), 0.0F);
  const std::size_t n = out.size();
  for (int c = 0; c < channels; ++c) {
    const float* row = &values[(static_cast<std::size_t>(c) * n_pixels + pixel) * n];
    for (std::size_t k = 0; k < n; ++k) {
      out[k] += row[k];
    }
  }
}

bool all_pixels(int, int) { return true; }

Eigen::Vector3d on_plane(const PlaneFrame& frame, const CameraRay& ray) {
  return ray.origin_world - frame.height_of(ray.origin_world) /
                                frame.plane.n.dot(ray.direction_world) * ray.direction_world;
}

}  // namespace

RigPlate::RigPlate(CameraModel camera, Plane plane, std::span<const render::SquareLight> lights,
                   PlateKind kind)
    : camera_(std::move(camera)),
      plane_(std::move(plane)),
      lights_(lights.begin(), lights.end()),
      kind_(kind) {}

RigPlate::RigPlate(CameraModel camera, std::span<const PlaneFrame> planes, std::size_t which,
                   std::span<const render::SquareLight> lights, PlateKind kind)
    : RigPlate(std::move(camera), planes[which].plane, lights, kind) {
  if (planes.size() > 1) {
    for (const PlaneFrame& frame : planes) {
      const Eigen::Vector3d corner = frame.world_of(0.0, frame.height);
      sheets_.push_back({corner, frame.world_of(frame.width, frame.height) - corner,
                         frame.world_of(0.0, 0.0) - corner});
    }
    which_ = which;
  }
}

namespace {

/// Whether this plane's picture is the first that a ray meets.
bool is_first(std::span<const render::Sheet> sheets, std::size_t which, const CameraRay& ray) {
  const auto distance = [&ray](const render::Sheet& sheet) {
    return render::distance_to(sheet, ray.origin_world, ray.direction_world);
  };
  const double own = distance(sheets[which]);
  return own < std::numeric_limits<double>::infinity() &&
         std::all_of(sheets.begin(), sheets.end(),
                     [&](const render::Sheet& sheet) { return distance(sheet) >= own; });
}

}  // namespace

StackDims RigPlate::dims() const {
  return {camera_.width, camera_.height, 1, static_cast<int>(lights_.size())};
}

void RigPlate::read_tile(const TileRect& rect, std::span<float> out) const {
  read(rect, lights_, out);
}

void RigPlate::read_lights(const TileRect& rect, std::span<const int> lights,
                           std::span<float> out) const {
  std::vector<render::SquareLight> some;
  some.reserve(lights.size());
  for (const int k : lights) {
    some.push_back(lights_[static_cast<std::size_t>(k)]);
  }
  read(rect, some, out);
}

void RigPlate::read(const TileRect& rect, std::span<const render::SquareLight> lights,
                    std::span<float> out) const {
  std::size_t at = 0;
  const double first_area = lights_.empty() ? 1.0 : lights_[0].width_mm * lights_[0].height_mm;
  for (int y = rect.y0; y < rect.y0 + rect.height; ++y) {
    for (int x = rect.x0; x < rect.x0 + rect.width; ++x) {
      const CameraRay ray = ray_through(camera_, x + 0.5, y + 0.5);
      const double towards = plane_.n.dot(ray.direction_world);
      const double t = -(plane_.n.dot(ray.origin_world) + plane_.d) / towards;
      const bool is_seen =
          towards != 0.0 && t > 0.0 && (sheets_.empty() || is_first(sheets_, which_, ray));
      const Eigen::Vector3d point = ray.origin_world + t * ray.direction_world;
      const Eigen::Vector3d normal = towards < 0.0 ? plane_.n : Eigen::Vector3d(-plane_.n);
      for (const render::SquareLight& light : lights) {
        double value = 0.0;
        if (is_seen) {
          // Per square millimetre of the first light, times 1e6: near 1, whatever the rig; larger
          // lights give more.
          value = kind_ == PlateKind::points
                      ? plate_falloff(light, point, normal) *
                            (light.width_mm * light.height_mm / first_area)
                      : receiver_irradiance(light, point, normal) / first_area;
          if (value > 0.0 && !sheets_.empty() &&
              render::visible_fraction(sheets_, which_, light, point) < 1.0) {
            value = 0.0;
          }
        }
        out[at++] = static_cast<float>(1e6 * value);
      }
    }
  }
}

StackVisibility::StackVisibility(const StackSource& stack, const StackSource& plate,
                                 const CameraModel& camera, const PlaneFrame& frame,
                                 std::vector<int> wanted, StackVisibilityOptions options)
    : stack_(stack),
      plate_(plate),
      dims_(stack.dims()),
      plate_channels_(plate.dims().channels),
      options_(std::move(options)),
      wanted_(std::move(wanted)) {
  const StackDims b = plate.dims();
  HAARLIGHT_EXPECTS(options_.lights.empty() ||
                        options_.lights.size() == static_cast<std::size_t>(dims_.n_lights),
                    "one light per picture");
  HAARLIGHT_EXPECTS(
      options_.value_errors.empty() ||
          options_.value_errors.size() == static_cast<std::size_t>(dims_.n_lights),
      "one error per picture");
  if (b.width != dims_.width || b.height != dims_.height || b.n_lights != dims_.n_lights ||
      (b.channels != 1 && b.channels != dims_.channels)) {
    throw Error(
        fmt::format("the clean plate is {} x {} with {} lights, the capture {} x {} with {}",
                    b.width, b.height, b.n_lights, dims_.width, dims_.height, dims_.n_lights),
        "plate", "use a clean plate of the same rig and camera");
  }
  if (camera.width != dims_.width || camera.height != dims_.height) {
    throw Error(fmt::format("the rig's camera is {} x {}, the capture {} x {}", camera.width,
                            camera.height, dims_.width, dims_.height),
                "rig", "use the rig file that the capture was made with");
  }
  positions_.assign(static_cast<std::size_t>(dims_.n_lights), -1);
  for (std::size_t i = 0; i < wanted_.size(); ++i) {
    HAARLIGHT_EXPECTS(wanted_[i] >= 0 && wanted_[i] < dims_.n_lights, "a light of the capture");
    positions_[static_cast<std::size_t>(wanted_[i])] = static_cast<int>(i);
  }
  if (options_.found) {
    take_found(*std::exchange(options_.found, std::nullopt));
    sampler_.emplace(camera, frame, shows_plane_.view());
    return;
  }
  fit_plate(camera, frame);
  if (options_.shows_plane.is_empty()) {
    find_plane(camera, frame);
  } else {
    HAARLIGHT_EXPECTS(options_.shows_plane.width() == dims_.width &&
                          options_.shows_plane.height() == dims_.height,
                      "a mask of the capture's size");
    shows_plane_ = options_.shows_plane;
    shows_object_ = Image<std::uint8_t>(dims_.height, dims_.width, 1);
    for (std::size_t i = 0; i < shows_plane_.pixels().size(); ++i) {
      shows_object_.pixels()[i] = shows_plane_.pixels()[i] == 0 ? 1 : 0;
    }
  }
  sampler_.emplace(camera, frame, shows_plane_.view());
}

void StackVisibility::take_found(FoundPlane found) {
  for (const Image<std::uint8_t>* mask : {&found.shows_plane, &found.shows_object}) {
    HAARLIGHT_EXPECTS(mask->width() == dims_.width && mask->height() == dims_.height,
                      "masks of the capture's size");
  }
  scale_ = found.scale;
  plane_offset_ = found.offset;
  shows_plane_ = std::move(found.shows_plane);
  shows_object_ = std::move(found.shows_object);
}

void StackVisibility::for_each_pixel(
    std::span<const TileRect> tiles, std::span<const int> lights,
    const std::function<bool(int y, int x)>& is_wanted,
    const std::function<void(int y, int x, std::span<const float> t, std::span<float> b)>&
        visit) const {
  const std::size_t n_lights =
      lights.empty() ? static_cast<std::size_t>(dims_.n_lights) : lights.size();
  const auto read = [&lights](const StackSource& from, const TileRect& rect,
                              std::span<float> out) {
    lights.empty() ? from.read_tile(rect, out) : from.read_lights(rect, lights, out);
  };
  // A closed form is evaluated where it is wanted; of some lights once a tile, as each call
  // looks them up.
  const bool is_whole = !plate_.is_closed_form() || !lights.empty();
  parallel_for(tiles.size(), 1, [&](std::size_t begin, std::size_t end) {
    std::vector<float> t_row(n_lights);
    std::vector<float> b_row(n_lights);
    for (std::size_t i = begin; i < end; ++i) {
      const TileRect& rect = tiles[i];
      const auto n_pixels = static_cast<std::size_t>(rect.n_pixels());
      const std::size_t n = n_pixels * t_row.size();
      std::vector<float> t(n * static_cast<std::size_t>(dims_.channels));
      std::vector<float> b((is_whole ? n : b_row.size()) *
                           static_cast<std::size_t>(plate_channels_));
      read(stack_, rect, t);
      if (is_whole) {
        read(plate_, rect, b);
      }
      for (std::size_t p = 0; p < n_pixels; ++p) {
        const int x = rect.x0 + static_cast<int>(p) % rect.width;
        const int y = rect.y0 + static_cast<int>(p) / rect.width;
        if (is_wanted(y, x)) {
          sum_channels(t, dims_.channels, n_pixels, p, t_row);
          if (!is_whole) {
            read(plate_, {x, y, 1, 1}, b);
          }
          sum_channels(b, plate_channels_, is_whole ? n_pixels : 1, is_whole ? p : 0, b_row);
          visit(y, x, t_row, b_row);
        }
      }
    }
  });
}

double StackVisibility::mean_light_height(const PlaneFrame& frame) const {
  double sum = 0.0;
  for (const render::SquareLight& light : options_.lights) {
    sum += std::abs(frame.height_of(light.centre));
  }
  return options_.lights.empty() ? 0.0 : sum / static_cast<double>(options_.lights.size());
}

std::vector<double> StackVisibility::slopes_at(const PlaneFrame& frame,
                                               const CameraRay& ray) const {
  const double side = frame.height_of(ray.origin_world) > 0.0 ? 1.0 : -1.0;
  const double towards = frame.plane.n.dot(ray.direction_world);
  const Eigen::Vector3d point = on_plane(frame, ray);
  std::vector<double> slopes(options_.lights.size());
  std::transform(options_.lights.begin(), options_.lights.end(), slopes.begin(),
                 [&](const render::SquareLight& light) {
                   return falloff_slope(light, point, side * frame.plane.n,
                                        side / towards * ray.direction_world);
                 });
  return slopes;
}

void StackVisibility::fit_plate(const CameraModel& camera, const PlaneFrame& frame) {
  // Tiles and pixels are drawn by hashes, so that no pattern of the scene aliases with the
  // sample's.
  std::vector<TileRect> tiles = tiles_of(dims_);
  if (tiles.size() > kFitTiles) {
    std::ranges::sort(tiles, {}, [](const TileRect& tile) {
      return hash_key(static_cast<std::uint64_t>(tile.y0), static_cast<std::uint64_t>(tile.x0));
    });
    tiles.resize(kFitTiles);
  }
  std::size_t n_pixels = 0;
  for (const TileRect& tile : tiles) {
    n_pixels += static_cast<std::size_t>(tile.n_pixels());
  }
  const std::uint64_t fraction =
      1 + n_pixels * static_cast<std::size_t>(dims_.n_lights) / kFitValues;
  std::mutex mutex;
  std::vector<float> values;
  std::vector<double> plate;
  const Eigen::Vector3d middle = frame.world_of(0.5 * frame.width, 0.5 * frame.height);
  std::vector<PlanePoint> points;
  for_each_pixel(
      tiles, {},
      [&](int y, int x) {
        return hash_key(static_cast<std::uint64_t>(y), static_cast<std::uint64_t>(x)) %
                   fraction ==
               0;
      },
      [&](int y, int x, std::span<const float> t, std::span<float> b) {
        const CameraRay ray = ray_through(camera, x + 0.5, y + 0.5);
        std::optional<SurfaceHeight> height;
        if (!options_.lights.empty()) {
          height = height_of_lit(t, b, slopes_at(frame, ray));
        }
        const std::lock_guard lock(mutex);
        values.insert(values.end(), t.begin(), t.end());
        plate.insert(plate.end(), b.begin(), b.end());
        if (height) {
          const Eigen::Vector3d out = on_plane(frame, ray) - middle;
          points.push_back({{out.dot(frame.u), out.dot(frame.v)}, *height});
        }
      });
  // Medians do not depend on the order of the tiles.
  scale_ = fit_plate_scale(values, plate);
  if (!(scale_ > 0.0)) {
    throw Error("the clean plate or the capture is black: there is nothing to divide by",
                "plate", "check the plane in the rig file, or give a captured clean plate");
  }
  plane_offset_ = plane_offset(std::move(points), frame, mean_light_height(frame));
}

void StackVisibility::find_plane(const CameraModel& camera, const PlaneFrame& frame) {
  const std::vector<render::SquareLight>& lights = options_.lights;
  const double mean_height = mean_light_height(frame);
  const auto is_above = [&](int y, int x, std::span<const float> t, std::span<const float> b) {
    const SurfaceHeight height = height_from_falloff(
        t, b, slopes_at(frame, ray_through(camera, x + 0.5, y + 0.5)), options_.test.tolerance);
    return height.mm - kStandardErrors * height.error_mm >
           options_.test.max_height * mean_height;
  };
  Image<std::uint8_t> found(dims_.height, dims_.width, 1);
  shows_object_ = Image<std::uint8_t>(dims_.height, dims_.width, 1);
  make_room(0);
  for_each_pixel(tiles_of(dims_), {}, all_pixels,
                 [&](int y, int x, std::span<const float> t, std::span<float> b) {
                   keep_values(y, x, t, b);
                   for (float& value : b) {
                     value *= static_cast<float>(scale_);
                   }
                   const bool is_lit = std::any_of(b.begin(), b.end(),
                                                   [](float value) { return value > 0.0F; });
                   for (std::size_t k = 0; k < options_.value_errors.size(); ++k) {
                     b[k] = options_.test.tolerance * double{b[k]} < options_.value_errors[k]
                                ? 0.0F
                                : b[k];
                   }
                   const bool is_plane = haarlight::relight::shows_plane(t, b, options_.test) &&
                                         (lights.empty() || !is_above(y, x, t, b));
                   found(y, x) = is_plane ? 1 : 0;
                   shows_object_(y, x) = is_lit && found(y, x) == 0 ? 1 : 0;
                 });
  shows_plane_ = grow_hidden(found.view());
}

std::size_t StackVisibility::n_fitting() const {
  const std::uint64_t bytes = sizeof(float) * dims_.n_pixels();
  return static_cast<std::size_t>(
      std::max<std::uint64_t>(1, options_.memory_bytes / std::max<std::uint64_t>(1, bytes)));
}

double StackVisibility::lookups_a_picture() const {
  // Measured: 60 ns per pixel for making a picture, as much for each time that the stack is read
  // again, divided by its lights; a look-up takes as long as four pixels.
  constexpr double kLookupsAPixel = 0.25;
  const std::size_t fits = n_fitting();
  const std::size_t n_readings = wanted_.size() > fits ? (wanted_.size() + fits - 1) / fits : 0;
  return kLookupsAPixel * static_cast<double>(dims_.n_pixels()) *
         (1.0 + static_cast<double>(n_readings));
}

void StackVisibility::make_room(std::size_t first) {
  first_ = first;
  n_loaded_ = std::min(n_fitting(), wanted_.size() - first);
  values_.assign(n_loaded_, Image<float>(dims_.height, dims_.width, 1));
}

void StackVisibility::keep_value(std::size_t i, int y, int x, float t, float b) {
  const double plate = scale_ * static_cast<double>(b);
  values_[i](y, x) = plate > 0.0
                         ? static_cast<float>(std::max(0.0, static_cast<double>(t) / plate))
                         : kDarkPlate;
}

void StackVisibility::keep_values(int y, int x, std::span<const float> t,
                                  std::span<const float> b) {
  for (std::size_t i = 0; i < n_loaded_; ++i) {
    const auto k = static_cast<std::size_t>(wanted_[first_ + i]);
    keep_value(i, y, x, t[k], b[k]);
  }
}

void StackVisibility::load(std::size_t first) {
  make_room(first);
  const std::span<const int> lights = std::span(wanted_).subspan(first_, n_loaded_);
  for_each_pixel(tiles_of(dims_), lights, all_pixels,
                 [&](int y, int x, std::span<const float> t, std::span<float> b) {
                   for (std::size_t k = 0; k < lights.size(); ++k) {
                     keep_value(k, y, x, t[k], b[k]);
                   }
                 });
}

Visibility StackVisibility::visibility(int k) {
  HAARLIGHT_EXPECTS(
      k >= 0 && k < dims_.n_lights && positions_[static_cast<std::size_t>(k)] >= 0,
      "a light that was announced");
  constexpr std::size_t kAhead = 8;
  const auto at = static_cast<std::size_t>(positions_[static_cast<std::size_t>(k)]);
  if (at < first_ || at >= first_ + n_loaded_) {
    load(at);
  }
  if (at < ahead_first_ || at >= ahead_first_ + ahead_.size() || !ahead_[at - ahead_first_]) {
    // Who asks in the announced order gets the next ones made at the same time.
    const bool is_in_order = at == first_ || at == ahead_first_ + ahead_.size();
    ahead_first_ = at;
    ahead_.assign(is_in_order ? std::min(kAhead, first_ + n_loaded_ - at) : 1, std::nullopt);
    parallel_for(ahead_.size(), 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        ahead_[i] = make_visibility(at + i);
      }
    });
  }
  return *std::exchange(ahead_[at - ahead_first_], std::nullopt);
}

Visibility StackVisibility::make_visibility(std::size_t at) const {
  // Already divided; what remains is to count, to clamp and to rectify to the plane.
  Image<float> value = values_[at - first_];
  Image<float> dark(value.height(), value.width(), 1);
  Image<std::uint8_t> usable = shows_plane_;
  VisibilityCount count;
  bool has_dark = false;
  for (std::size_t i = 0; i < value.pixels().size(); ++i) {
    float& v = value.pixels()[i];
    if (usable.pixels()[i] == 0) {
      v = 0.0F;
    } else if (v == kDarkPlate) {
      v = 0.0F;
      usable.pixels()[i] = 0;
      dark.pixels()[i] = 1.0F;
      has_dark = true;
      ++count.n_no_plate;
    } else {
      count.add_value(static_cast<double>(v));
    }
  }
  const double noise = settle_lit(value, usable.view(), options_.test.tolerance);
  const double coding = options_.coding_errors.empty()
                            ? 0.0
                            : options_.coding_errors[static_cast<std::size_t>(wanted_[at])];
  for (float& v : value.pixels()) {
    v = std::min(v, 1.0F);
  }
  Visibility out{sampler_->rectify(value.view()), sampler_->known(), count,
                 std::hypot(noise, coding)};
  if (has_dark) {
    const Image<float> touched = sampler_->rectify(dark.view());
    for (std::size_t i = 0; i < touched.pixels().size(); ++i) {
      if (touched.pixels()[i] > 0.0F) {
        out.known.pixels()[i] = 0;
        out.value.pixels()[i] = 0.0F;
      }
    }
  }
  for (float& v : out.value.pixels()) {
    v = std::clamp(v, 0.0F, 1.0F);
  }
  return out;
}

}  // namespace haarlight::relight
