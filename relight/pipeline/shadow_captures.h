// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <list>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "haarlight/core/image.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/core/stack/stack_source.h"
#include "haarlight/relight/basis/basis_file.h"
#include "haarlight/relight/shadow/plane_frame.h"
#include "haarlight/render/scene/scene.h"
#include "relight/pipeline/pipeline_settings.h"
#include "relight/shadow/shadow_lookup.h"
#include "relight/shadow/stack_visibility.h"

/// @file
/// The captures of one object from which a shadow is computed: basis files, their rigs, and the
/// shadow pictures of their planes.

namespace haarlight::relight {

/// An object on the shadow plane, and what captured it.
struct CapturedObject {
  std::string basis;  ///< with its rig
  /// Further captures of the object: the plane moved, or another camera's view of it.
  std::vector<std::string> also;
  std::vector<std::string> planes;  ///< ids of the rig's; empty: all
  std::string plate = "computed";   ///< clean plate; or falloff, or a .hlb file
  std::string mask;                 ///< picture, white where the plane is seen; empty: detected
  std::optional<HeightRange> height;  ///< of the object over the first plane
};

/// @throws Error(usage)  its lowest point is above its highest
void require_heights(const CapturedObject& captured);

/// True if the clean plate is a file, not computed from the rig.
[[nodiscard]] bool is_plate_captured(const CapturedObject& captured);

/// One capture's clean plate of one plane.
struct ShadowPlate {
  double scale = 0.0;           ///< g of T = g B: light transport matrix, clean plate
  double known_fraction = 0.0;  ///< of the plane picture
  std::string plane;            ///< file and id, for messages
  PlaneOffset offset;           ///< where the plane is, by the capture itself
};

/// A plane that several captures show: fractions of its picture.
struct JoinedPlane {
  std::vector<double> known_fractions;  ///< known by each capture
  double known_fraction = 0.0;          ///< by any of them
};

/// One capture of the object. Not movable: its parts refer to one another.
struct ShadowCapture {
  /// @throws Error  no basis file, no rig in it, a rig without plane or camera
  explicit ShadowCapture(const std::string& file);
  ~ShadowCapture() = default;
  ShadowCapture(const ShadowCapture&) = delete;
  ShadowCapture& operator=(const ShadowCapture&) = delete;
  ShadowCapture(ShadowCapture&&) = delete;
  ShadowCapture& operator=(ShadowCapture&&) = delete;

  BasisFile basis;
  Rig rig;
  BasisSource stack;
  std::vector<PlaneFrame> frames;  ///< of all the rig's planes
  std::vector<std::size_t> chosen;
  std::vector<std::unique_ptr<StackSource>> plates;       ///< of the chosen ones
  std::vector<std::unique_ptr<StackVisibility>> shadows;  ///< the same
};

/// All captures; the first one's lights apply to all.
class ShadowCaptures {
 public:
  /// Opens the basis files.
  /// @param captured      outlives this
  /// @param memory_bytes  for pictures
  /// @throws Error  lights that moved between them, no such plane, more than 8 planes, a further
  ///                capture's plane that is one of the first's but reaches beyond its picture
  ShadowCaptures(const CapturedObject& captured, std::uint64_t memory_bytes);

  [[nodiscard]] const ShadowCapture& first() const { return *captures_[0]; }
  [[nodiscard]] const std::vector<std::unique_ptr<ShadowCapture>>& all() const {
    return captures_;
  }
  [[nodiscard]] const Rig& rig() const { return first().rig; }
  /// The plane over which heights are given.
  [[nodiscard]] const PlaneFrame& frame() const { return first().frames[first().chosen[0]]; }

  /// Opens a captured clean plate and the mask.
  /// @throws Error  one that does not fit
  void read_plate_and_mask();
  /// Prepares the shadow pictures of these lights. The planes refer to this object. Where
  /// several captures show one plane it is one of these, known where any of them knows it.
  /// @param found  what found() returned for the same captures; empty: the planes are searched
  [[nodiscard]] std::vector<SamplingPlane> sample(const std::vector<int>& wanted,
                                                  std::vector<ShadowPlate>& plates,
                                                  std::vector<FoundPlane> found = {});
  /// Of each view, in the order in which they were sampled.
  [[nodiscard]] std::vector<FoundPlane> found() const;
  /// Whether these may be what found() returned for the same captures: as many, of their sizes.
  [[nodiscard]] bool fits(std::span<const FoundPlane> found) const;
  /// The planes that several captures show, once sampled.
  [[nodiscard]] const std::vector<JoinedPlane>& joined() const noexcept { return joined_; }

 private:
  /// One capture's picture of a plane.
  struct View {
    std::size_t capture = 0;
    std::size_t plane = 0;  ///< of its rig
  };
  void find_views();
  [[nodiscard]] StackVisibility* open_view(const View& view, const PlaneFrame& frame,
                                           const std::vector<int>& wanted,
                                           std::optional<FoundPlane> found,
                                           std::vector<ShadowPlate>& plates);

  const CapturedObject& captured_;
  std::uint64_t memory_bytes_;
  std::vector<std::unique_ptr<ShadowCapture>> captures_;
  std::vector<std::vector<View>> planes_;  ///< each distinct plane's views, its own frame first
  std::size_t n_views_ = 0;
  std::list<std::vector<StackVisibility*>> opened_;  ///< each plane's views; addresses stay
  std::vector<JoinedPlane> joined_;
  std::optional<BasisFile> plate_file_;
  Image<std::uint8_t> mask_;
};

/// Warns of a plane whose light does not fall off as the rig file says.
void tell_offset(const std::string& plane, const PlaneOffset& offset, PipelineNotes& told);

/// Where the camera sees the object: pixels that show any of the planes are not the object;
/// those that one plane does not see may be. (h, w, 1), without a rim.
[[nodiscard]] Image<std::uint8_t> object_pixels(const ShadowCapture& capture);

}  // namespace haarlight::relight
