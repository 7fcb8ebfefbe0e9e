// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/enum_words.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/relight/light/near_light.h"
#include "haarlight/relight/shape/surface_mesh.h"
#include "relight/pipeline/pipeline_settings.h"
#include "relight/shape/near_alternation.h"
#include "relight/shape/object_mask.h"

/// @file
/// From a capture, or from a relightable picture, to its surface: normals with their standard
/// errors, albedo, heights, a mesh, as files of a folder. What `haarlight shape` does, for
/// programs that link it. Methods and errors: docs/numerics/shape.md.

namespace haarlight::relight {

enum class ShapeMethod {
  automatic,  ///< the robust fit that best predicts held-out lights; for a file what it holds
  least_squares,  ///< photometric stereo, LambertMethod
  trimmed,
  m_estimator,
  ptm,  ///< normals as in RTI viewers
  hsh,
};
inline constexpr auto kShapeMethodWords = std::to_array<std::string_view>(
    {"automatic", "least-squares", "trimmed", "m-estimator", "ptm", "hsh"});
constexpr std::span<const std::string_view> words_of(ShapeMethod) { return kShapeMethodWords; }
/// "least-squares", "m-estimator", ...

enum class ShapeLight {
  automatic,  ///< near where the lights' positions and the picture's size are known
  near,       ///< each pixel's own light directions and distances
  far,
};
inline constexpr auto kShapeLightWords =
    std::to_array<std::string_view>({"automatic", "near", "far"});
constexpr std::span<const std::string_view> words_of(ShapeLight) { return kShapeLightWords; }

enum class MaskChoice {
  found,    ///< detected in the capture, by the rig's bare plane or by darkness
  every,    ///< every pixel
  picture,  ///< given: white is the object
};
inline constexpr auto kMaskChoiceWords =
    std::to_array<std::string_view>({"found", "none", "picture"});
constexpr std::span<const std::string_view> words_of(MaskChoice) { return kMaskChoiceWords; }

struct ShapePipelineOptions {
  std::filesystem::path input;  ///< a session's folder; .ptm, .rti or web folder
  std::filesystem::path out;    ///< folder to write
  ShapeMethod method = ShapeMethod::automatic;
  /// Loss, keep and dark_fraction of the fit; method of the integration; rounds. The pipeline
  /// itself sets what it knows better (errors, clipped values, progress, method of the fit).
  ShapeOptions shape{};
  ShapeLight light = ShapeLight::automatic;
  double width_mm = 0.0;              ///< of an import: width shown by the picture; 0: unknown
  std::optional<double> height_mm{};  ///< mean height of the object above the rig's plane
  MaskChoice mask = MaskChoice::found;
  std::filesystem::path mask_picture;  ///< for MaskChoice::picture
  /// Kept shadow hull of the same object; empty: none. Tells parts of a rig's capture apart, and
  /// how high they may stand.
  std::filesystem::path hull;
  std::optional<Transfer> transfer{};  ///< used for an unknown curve
  bool writes_ply = true;
  bool writes_obj = true;
  double max_tilt_deg = SurfaceMeshOptions{}.max_tilt_deg;  ///< of the mesh's triangles
  bool is_open_at_cuts = false;  ///< the mesh, at the integration's cuts; always with a hull
  Eigen::Vector3d preview{0.5, 0.5, 1.0};  ///< to the preview's light, picture frame
  PipelineSettings settings{};
};

struct ShapeSummary {
  Shape shape;
  PixelPoints pixels;       ///< their surface points; lights' frame
  std::string method;       ///< as requested, or what the file holds
  std::string by;           ///< the origin of the normals, for users
  bool has_scale = false;   ///< heights are mm; false: pixel widths
  bool is_measured = true;  ///< albedo and errors exist: not RTI normals
  bool are_near = false;    ///< the lights
  ObjectMask mask{};        ///< the detected one, if any, and the one in use
  std::string mask_by;      ///< found by plane, found by darkness, given, every pixel
  /// Of the object's pixels, how many rays meet the hull; nothing: no hull.
  std::optional<std::int64_t> n_met_hull;
  PictureNotes photographed{};  ///< of the session, if it is one: goes into the pictures
  std::uint64_t bytes = 0;      ///< written
  std::vector<PipelineNote> notes;

  /// The rounds and the integration converged.
  [[nodiscard]] bool is_usable() const { return shape.is_settled && shape.map.is_converged; }
};

/// Recovers the surface and writes it.
/// @throws Error(usage)  a preview without direction, a method that a file does not hold, near
///                       lights for RTI normals, a hull without a rig or with far lights
/// @throws Error  a folder that exists, lights of unknown distance for ShapeLight::near, a mask
///                of another size or without a white pixel, a hull of another object, no pixel
///                that has a normal; as what opens and develops sessions
[[nodiscard]] ShapeSummary recover_capture_shape(const ShapePipelineOptions& options);

}  // namespace haarlight::relight
