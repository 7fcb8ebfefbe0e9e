// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <list>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "apps/viewer/volume_look.h"
#include "apps/volume_numbers.h"
#include "render/film/film.h"
#include "render/volume/projected_tetrahedra.h"
#include "render/volume/volume_ray_caster.h"

/// @file
/// Pictures of a volume for the viewer's page: of each client the newest view, by previews at once or
/// exact, slice by slice.

namespace haarlight::apps {

enum class VolumePictureKind : std::uint8_t { preview, exact };
inline constexpr auto kVolumePictureKindWords =
    std::to_array<std::string_view>({"preview", "exact"});
constexpr std::span<const std::string_view> words_of(VolumePictureKind) {
  return kVolumePictureKindWords;
}

struct VolumePictureRequest {
  VolumePictureKind kind = VolumePictureKind::preview;
  render::Preview method = render::Preview::m1;
  int shrink = 1;  ///< width and height are so many times smaller
};

/// How far a picture is.
struct DrawnVolume {
  std::shared_ptr<const render::Film> film;
  double share = 1.0;    ///< of its tiles that are rendered; 1: complete
  double seconds = 0.0;  ///< that it took so far
  /// Of the exact picture, once it is complete: by what the client's last preview of the same view and
  /// size is off.
  std::optional<VolumeErrors> preview_errors;
  std::optional<render::Preview> preview;  ///< that one's method
};

class VolumeViews {
 public:
  static constexpr std::size_t kMostClients =
      4;  ///< the one that has waited longest is forgotten
  static constexpr int kMostShrink = 16;
  static constexpr std::int64_t kMostPixels = std::int64_t{1} << 22U;
  static constexpr double kSliceSeconds = 0.3;  ///< of an exact picture at a time

  /// @throws Error  the scene and its pictures take more than `memory_bytes`
  VolumeViews(render::VolumeScene scene, VolumeSceneWords words, std::uint64_t memory_bytes);

  /// Fits the limits, and has a camera. @throws Error  else, with what to do
  void require(const VolumeLook& look) const;
  /// The client's newest view: what is being drawn of its older ones ends. Thread-safe.
  /// @return  the view's number, which no other has @throws Error  as require()
  std::uint64_t want(const std::string& client, VolumeLook look);
  /// Of an exact picture a slice. From one thread at a time.
  /// @return  nothing: the client has a newer view, or four others have come since
  /// @throws Error  as VolumeRayCaster; a preview of what has none
  std::optional<DrawnVolume> draw(const std::string& client, std::uint64_t view,
                                  const VolumePictureRequest& request);

  /// Why there are no previews of the scene; empty: there are.
  [[nodiscard]] const std::string& no_preview() const { return no_preview_; }
  [[nodiscard]] std::int64_t most_pixels() const { return most_pixels_; }
  /// By the thread that draws. @throws Error  as require()
  [[nodiscard]] std::string scene_text_of(const VolumeLook& look) const;

 private:
  struct Client {
    std::string name;
    std::uint64_t view = 0;
    VolumeLook look;
    std::shared_ptr<render::Film> exact;
    int shrink = 0;  ///< of `exact`
    double seconds = 0.0;
    std::optional<VolumeErrors> preview_errors;
    std::shared_ptr<const render::Film> preview;  ///< of the whole size
    render::Preview method = render::Preview::m1;
  };

  /// The client's, if that is its view.
  [[nodiscard]] Client* find_view(const std::string& client, std::uint64_t view);
  [[nodiscard]] bool is_newest(const std::string& client, std::uint64_t view);
  void apply(const VolumeLook& look, int shrink);
  /// What is behind the medium, at the view's size or a smaller one.
  void sample_backdrop(const VolumeLook& look, const std::array<int, 2>& size);
  std::optional<DrawnVolume> draw_preview(const std::string& client, std::uint64_t view,
                                          const VolumePictureRequest& request);
  std::optional<DrawnVolume> draw_exact(const std::string& client, std::uint64_t view,
                                        int shrink);

  VolumeSceneWords words_;
  std::string no_preview_;
  std::int64_t most_pixels_ = 0;
  render::CameraOptics optics_;  ///< of the file

  std::mutex mutex_;           ///< of what follows
  std::list<Client> clients_;  ///< the last that asked first
  std::uint64_t n_views_ = 0;

  // Of the drawing thread alone.
  render::VolumeScene scene_;  ///< as `applied_` wants it
  const render::Background background_;
  const std::optional<render::SurfacesBehind> surfaces_;
  std::optional<VolumeLook> applied_;
  int applied_shrink_ = 0;
  std::array<int, 2> applied_size_{};  ///< of what is behind the medium
  std::unique_ptr<const render::PreviewMesh> mesh_;
  std::shared_ptr<const render::CellFaces> connected_;  ///< of the mesh: for all views
  std::unique_ptr<const render::VolumeRayCaster> caster_;
};

}  // namespace haarlight::apps
