// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <vector>

#include "haarlight/core/image.h"
#include "haarlight/core/rig/camera_model.h"
#include "haarlight/core/stack/stack_source.h"
#include "haarlight/relight/shadow/plane_frame.h"
#include "haarlight/relight/shadow/visibility.h"
#include "haarlight/render/scene/scene.h"
#include "relight/shadow/found_plane.h"
#include "relight/shadow/plane_offset.h"
#include "relight/shadow/rectify.h"
#include "render/analytic/sheet.h"

/// @file
/// Shadow pictures from a capture: V_k = T_k/(g B_k) with the clean plate B, at the camera's
/// pixels that show the plane, rectified to the plane. g, one number per capture, brings plate
/// and capture to one scale.

namespace haarlight::relight {

struct StackVisibilityOptions {
  /// (h, w, 1) of the camera: 1 shows the plane, 0 the object. Empty: detected from the values.
  Image<std::uint8_t> shows_plane;
  PlaneTest test;  ///< for detecting it
  /// (n_lights): of the capture, for the height of what a pixel shows; empty: told by
  /// brightness alone.
  std::vector<render::SquareLight> lights;
  /// (n_lights): coding error of each picture, relative L2, adds to the noise; empty: none.
  std::vector<double> coding_errors;
  /// (n_lights): rms error of a value of each picture, unit of the stack: where the plate's own
  /// value is so dim that this is more than the test's tolerance of it, the value does not tell
  /// whether a pixel shows the plane. Empty: none.
  std::vector<double> value_errors;
  std::uint64_t memory_bytes = std::uint64_t{1} << 30U;
  /// Of the same stack, plate and mask, if it was kept: it is not searched again.
  std::optional<FoundPlane> found;
};

enum class PlateKind {
  squares,  ///< irradiance of the LEDs' squares, relative error below 1e-6
  points,   ///< cos^4/r^2 (with the lobe) of small lamps
};

/// The clean plate of a rig, in closed form, at the plane point of every pixel's centre. Its
/// scale is fitted as for any plate. Faster than ComputedPlate, whose Lambert sums are exact to
/// rounding.
class RigPlate final : public StackSource {
 public:
  RigPlate(CameraModel camera, Plane plane, std::span<const render::SquareLight> lights,
           PlateKind kind);
  /// For one of several planes: dark at pixels that see another plane's picture in front of
  /// this one's, or nothing of this one's, and under lights that another one hides, wholly or in
  /// part: a pixel is as wide as such a penumbra. The pictures are taken as opaque sheets.
  RigPlate(CameraModel camera, std::span<const PlaneFrame> planes, std::size_t which,
           std::span<const render::SquareLight> lights, PlateKind kind);
  [[nodiscard]] StackDims dims() const override;
  void read_tile(const TileRect& rect, std::span<float> out) const override;
  void read_lights(const TileRect& rect, std::span<const int> lights,
                   std::span<float> out) const override;
  [[nodiscard]] bool is_closed_form() const override { return true; }

 private:
  void read(const TileRect& rect, std::span<const render::SquareLight> lights,
            std::span<float> out) const;
  CameraModel camera_;
  Plane plane_;
  std::vector<render::SquareLight> lights_;
  PlateKind kind_;
  std::vector<render::Sheet> sheets_;  ///< of all the rig's planes, when there are several
  std::size_t which_ = 0;
};

/// For one caller. Borrows stack and plate.
class StackVisibility {
 public:
  /// Unless `options.found` says it: reads up to 100 tiles of the stack to find g, then all of it
  /// to find the pixels that show the plane. That reading also fills the memory with the first
  /// lights' pictures.
  /// @param wanted  the lights that will be requested, in that order (visiting_order() of
  ///                shadow_points.h)
  /// @throws Error  stack, clean plate and camera of different sizes; a black plate
  StackVisibility(const StackSource& stack, const StackSource& plate, const CameraModel& camera,
                  const PlaneFrame& frame, std::vector<int> wanted,
                  StackVisibilityOptions options = {});

  /// Plane picture of light k. Reads the stack again whenever the memory is used up; not at all
  /// where all pictures fit.
  [[nodiscard]] Visibility visibility(int k);

  /// What one picture costs, in look-ups of a light at a receiver (shadow_lookup.h).
  [[nodiscard]] double lookups_a_picture() const;

  /// What was found of the plane, to be kept.
  [[nodiscard]] FoundPlane found() const {
    return {scale_, plane_offset_, shows_plane_, shows_object_};
  }
  [[nodiscard]] double scale() const noexcept { return scale_; }
  /// Where the pixels' light says that the plane is, by a sample of them.
  [[nodiscard]] const PlaneOffset& offset() const noexcept { return plane_offset_; }
  /// Fraction of the plane picture that is known.
  [[nodiscard]] double known_fraction() const { return sampler_->known_fraction(); }
  /// (frame.height, frame.width, 1): 1 where the plane picture is known.
  [[nodiscard]] const Image<std::uint8_t>& known() const noexcept { return sampler_->known(); }
  /// Camera pixels across one plane pixel.
  [[nodiscard]] double pixels_per_texel() const noexcept {
    return sampler_->pixels_per_texel();
  }
  /// (h, w, 1) of the camera; without a one-pixel rim if detected.
  [[nodiscard]] const Image<std::uint8_t>& shows_plane() const noexcept { return shows_plane_; }
  /// (h, w, 1): 1 where the clean plate is lit and the camera sees something else, without a
  /// rim.
  [[nodiscard]] const Image<std::uint8_t>& shows_object() const noexcept {
    return shows_object_;
  }

 private:
  void take_found(FoundPlane found);
  /// Sets scale_ and plane_offset_.
  void fit_plate(const CameraModel& camera, const PlaneFrame& frame);
  [[nodiscard]] double mean_light_height(const PlaneFrame& frame) const;
  /// (n_lights): falloff_slope along a pixel's ray.
  [[nodiscard]] std::vector<double> slopes_at(const PlaneFrame& frame,
                                              const CameraRay& ray) const;
  void find_plane(const CameraModel& camera, const PlaneFrame& frame);
  /// For the pictures of as many lights as fit, from `first` in wanted_ on.
  void make_room(std::size_t first);
  [[nodiscard]] std::size_t n_fitting() const;
  /// One pixel of them: V, or kDarkPlate. For different pixels from several threads.
  void keep_values(int y, int x, std::span<const float> t, std::span<const float> b);
  void keep_value(std::size_t i, int y, int x, float t, float b);
  /// Reads the lights from `first` in wanted_ on, as many as fit.
  void load(std::size_t first);
  /// Of the light at `at` in wanted_, which is loaded.
  [[nodiscard]] Visibility make_visibility(std::size_t at) const;
  /// Calls visit for the pixels of these tiles that are wanted, with the stack's and the plate's values summed
  /// over the channels, of these lights, or of all where none is named; b may be changed. From several threads.
  void for_each_pixel(std::span<const TileRect> tiles, std::span<const int> lights,
                      const std::function<bool(int y, int x)>& is_wanted,
                      const std::function<void(int y, int x, std::span<const float> t,
                                               std::span<float> b)>& visit) const;

  const StackSource& stack_;
  const StackSource& plate_;
  StackDims dims_;
  int plate_channels_ = 1;
  StackVisibilityOptions options_;
  std::vector<int> wanted_;
  std::vector<int> positions_;  ///< index of each light in wanted_; -1: not wanted
  double scale_ = 0.0;
  PlaneOffset plane_offset_;
  Image<std::uint8_t> shows_plane_;
  Image<std::uint8_t> shows_object_;
  std::optional<PlaneSampler> sampler_;

  std::size_t first_ = 0;  ///< index in wanted_ of the first one loaded
  std::size_t n_loaded_ = 0;
  std::vector<Image<float>> values_;  ///< (h, w, 1) of the camera, -1 where the plate is dark
  std::size_t ahead_first_ = 0;       ///< index in wanted_ of the first one in ahead_
  std::vector<std::optional<Visibility>> ahead_;  ///< made, not yet asked for
};

}  // namespace haarlight::relight
