// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "haarlight/core/enum_words.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/core/picture/picture_rectangle.h"
#include "haarlight/session/import/picture_match.h"
#include "relight/pipeline/fit/fit_output.h"
#include "relight/pipeline/pipeline_settings.h"
#include "relight/reflectance/fit/fit_check.h"
#include "relight/reflectance/fit/light_haar.h"
#include "relight/reflectance/fit/near_fit.h"
#include "relight/reflectance/fit/parameter_choice.h"
#include "relight/reflectance/fit/plane_ranges.h"

/// @file
/// From a capture to a picture that can be lit from any direction: which basis suits it
/// (parameter_choice.h), fitted to far or to near lights, written in third-party formats, read
/// back and measured. What `haarlight fit` does, for programs that link it. Method and figures:
/// docs/numerics/reflectance-fits.md.

namespace haarlight::relight {

struct FitOptions {
  std::filesystem::path capture;  ///< a session's folder; with `lights` a folder of pictures
  std::filesystem::path lights;   ///< list of the lights of a folder of pictures
  session::LightCoordinates coordinates = session::LightCoordinates::automatic;
  session::MatchOptions match{};  ///< how lights are matched to the folder's pictures
  /// Only these pixels of each picture of a folder, as it is seen upright.
  std::optional<PixelRectangle> crop{};

  std::optional<FitForm> form{};  ///< nothing: the one that best predicts lights left out
  FormOptions forms{};
  RangeEnds ends = RangeEnds::least_error;
  Transfer transfer = Transfer::srgb;  ///< transfer of the fitted values
  HoldOut hold_out{};                  ///< lights that are measured instead of fitted
  /// Lights are near: every pixel in its own directions, fall-off divided out.
  std::optional<NearSolve> near{};
  double width_mm = 0.0;  ///< near, for an import: width shown by the picture; 0: unknown

  /// .ptm, .rti, or a name without an extension for a web folder; empty: nothing is kept.
  std::filesystem::path out;
  FitSize size{};  ///< of a web folder
  PipelineSettings settings{};
};

/// What a file's pictures are compared with.
enum class FitTruth {
  held,    ///< photographs that were held out
  fitted,  ///< the photographs it was fitted to
  planes,  ///< near lights: the pictures of its planes before they were coded
};
inline constexpr auto kFitTruthWords = std::to_array<std::string_view>(
    {"photographs that were held out", "the photographs it was fitted to",
     "those of its planes before they were coded"});
constexpr std::span<const std::string_view> words_of(FitTruth) { return kFitTruthWords; }

/// One form fitted, and what it cost.
struct FormFit {
  FormScore score;
  int n_planes = 0;
  long long n_pixels = 0;
  double seconds = 0.0;           ///< of the processor, reading included
  std::optional<FitFile> file{};  ///< nothing: no file holds it
  /// PSNR of the file's pictures, or of the planes' if there is no file: one per light, or one
  /// for all (FitTruth::planes); dB, peak 255.
  std::vector<double> psnr_db;
  double quantisation_rms = 0.0;  ///< expected, of the planes' values
  double clipped_fraction = 0.0;  ///< of the planes' values

  [[nodiscard]] double mean_psnr_db() const;
};

struct FitSummary {
  std::vector<FormFit> fits;  ///< one; from compare_fits each form, best predicted first
  FitTruth truth = FitTruth::fitted;
  int n_fitted_lights = 0;
  /// The light-domain basis of basis files with as many numbers per pixel, at its own lights:
  /// from compare_fits, if a session's lights form grids and none is held out.
  std::optional<HaarSize> haar{};
  std::vector<PipelineNote> notes;
};

/// Fits the requested form, or the one that best predicts lights left out, and writes it.
/// @throws Error(usage)  nothing to do (no file, no light held out), a size for something other
///                       than a folder, a file that cannot hold the form, no form with so few
///                       planes, no light left, a session cropped
/// @throws Error  a file that exists, lights whose distance is not known for `near`; as what
///                opens sessions, pictures and lists; a size that cannot be achieved
[[nodiscard]] FitSummary fit_capture(const FitOptions& options);

/// Fits every form in turn; for each a temporary file is written, measured and removed. If
/// `out` is given, a file of that name holds the last form.
/// @param each  called with each finished form; empty: not called
/// @throws Error  as fit_capture; and `near`, whose pictures match no photograph
[[nodiscard]] FitSummary compare_fits(
    const FitOptions& options,
    const std::function<void(FitTruth truth, const FormFit& fit)>& each = {});

}  // namespace haarlight::relight
