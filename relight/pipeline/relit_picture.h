// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <vector>

#include "haarlight/core/picture/image_io.h"
#include "haarlight/relight/basis/basis_file.h"
#include "haarlight/relight/basis/relight.h"
#include "relight/basis/prepared_basis.h"
#include "relight/basis/resident_basis.h"
#include "relight/pipeline/relight_choice.h"

/// @file
/// One relit picture, from light weights to what is shown or kept: the same for a command and for
/// a server.

namespace haarlight::relight {

/// A half float's rounding. Below it only values of few bits would keep a requested error.
inline constexpr double kHalfError = 0x1p-11;

/// What a Relighter will be asked for.
struct RelighterPlan {
  enum class Use {
    once,    ///< one picture: the file is read for it
    frames,  ///< many at once: unpacked, quantised files with sums in float
    served,  ///< many, one by one, each with the bits that `once` would give
  };
  Use use = Use::once;
  int n_frames = 0;                 ///< of `frames`
  std::optional<double> max_error;  ///< of every one of the `frames`
  bool has_terms = false;           ///< some of the `frames` drop terms, or look for how many
  std::optional<RelightForm>
      form;  ///< of `frames`, as chosen by predicted seconds (relight_choice.h)
  std::uint64_t memory_bytes = std::uint64_t{2} << 30U;
};

/// Sums pictures of one basis file, several in one pass over the data.
///
/// A quantised file is unpacked into memory for many pictures. Of an exact one all lights are
/// read whatever the terms, so that fewer save nothing: they are summed once. Many pictures of it
/// come from memory where it fits: for a server its floats; else, where half floats may keep the
/// requested error, these, and a picture whose bound is above the request is summed from the file.
class Relighter {
 public:
  /// Borrows the file.
  Relighter(const BasisFile& basis, const RelighterPlan& plan);

  /// Const and thread-safe. @throws Error  as relight::relight()
  [[nodiscard]] std::vector<RelitPicture> relight(std::span<const LightWeights> weights,
                                                  RelightOptions options) const;
  /// What is held in memory.
  [[nodiscard]] std::uint64_t bytes() const noexcept;
  /// What that is, in words: "coefficients", "floats", "half floats" or "nothing".
  [[nodiscard]] const char* held() const noexcept;

 private:
  const BasisFile& basis_;
  bool is_half_chosen_ = false;
  std::optional<PreparedBasis> prepared_;
  std::optional<ResidentBasis> resident_;
};

/// How a picture is to be shown.
struct RelitDisplay {
  std::optional<double> exposure;  ///< none: 99.5th percentile white for display
  double stops = 0.0;              ///< that factor, brighter or darker
};

/// Whether pictures of this name are for display, and so need an exposure.
[[nodiscard]] bool is_for_display(const std::filesystem::path& name);

/// The factor before display; 2^stops for a picture that is not for display.
[[nodiscard]] double relit_exposure(const RelitDisplay& display,
                                    const std::filesystem::path& name,
                                    const Image<float>& picture);

/// What is written with it (picture_notes.h).
[[nodiscard]] PictureNotes relit_notes(const BasisHeader& header, const RelitPicture& relit,
                                       const LightWeights& weights,
                                       std::optional<double> max_error);

}  // namespace haarlight::relight
