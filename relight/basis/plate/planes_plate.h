// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <vector>

#include "haarlight/core/rig/rig.h"
#include "haarlight/core/stack/stack_source.h"
#include "relight/basis/plate/plate.h"
#include "render/analytic/sheet.h"

/// @file
/// The clean plate of a rig with several planes.

namespace haarlight::relight {

/// What each pixel's centre sees first: the picture of one of the planes, or the first plane beyond
/// its picture. The pictures are opaque sheets: one plane stands in the light of another. Values
/// as ComputedPlate's, times the visible fraction of each light (render/analytic/sheet.h).
class PlanesPlate final : public StackSource {
 public:
  /// @throws Error  as ComputedPlate, for any of the planes
  PlanesPlate(const Rig& rig, int i_camera);
  [[nodiscard]] StackDims dims() const override { return planes_[0].dims(); }
  void read_tile(const TileRect& rect, std::span<float> out) const override;

 private:
  /// Of the picture that is seen first; the first plane where none is.
  [[nodiscard]] std::size_t plane_at(const CameraRay& ray, double x, double y) const;

  CameraModel camera_;
  std::vector<ComputedPlate> planes_;
  std::vector<render::Sheet> sheets_;
};

/// The clean plate of a rig: ComputedPlate of its plane, PlanesPlate of several.
/// @throws Error  as ComputedPlate
[[nodiscard]] std::unique_ptr<StackSource> make_rig_plate(const Rig& rig, int i_camera = 0);

}  // namespace haarlight::relight
