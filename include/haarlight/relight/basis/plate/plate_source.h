// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include "haarlight/core/picture/image_io.h"
#include "haarlight/core/progress.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/core/stack/stack_source.h"
#include "haarlight/relight/basis/basis_file.h"
#include "haarlight/session/session.h"

/// @file
/// Opens the clean plate chosen by the user: computed from the rig, a file, a session of the
/// empty rig, or none.

namespace haarlight::relight {

/// Which clean plate to subtract.
struct PlateChoice {
  enum class Kind {
    automatic,  ///< computed from the rig where it has a camera and a plane; else none
    none,
    file,     ///< a .hlb of `haarlight plate`, or of a compressed empty-rig session
    session,  ///< a session of the empty rig
  };
  Kind kind = Kind::automatic;
  std::filesystem::path path;

  /// "none", a session's folder, or a .hlb file. @throws Error(usage)  none of these
  [[nodiscard]] static PlateChoice parse(const std::string& text);
};

/// Index of the rig's camera whose active area has this size, -1 when there is none.
[[nodiscard]] int camera_of_size(const Rig& rig, int width, int height);

/// A clean plate, and the owners of what it is read from. Move-only.
struct OpenPlate {
  std::unique_ptr<session::Session> session;
  std::unique_ptr<BasisFile> basis;
  std::unique_ptr<StackSource> source;  ///< null: none
  PlateOrigin origin = PlateOrigin::none;
  std::string hash;
  std::string key;  ///< of its values
};

/// For developing a session of the empty rig.
struct PlateOptions {
  std::uint64_t memory_bytes = std::uint64_t{4} << 30U;
  ProgressStyle progress = ProgressStyle::none;
  std::optional<Transfer> unknown_as{};
};

/// @param rig   of the capture; null where there is none
/// @param dims  of the capture
/// @throws Error  what opening a file or developing a session throws
[[nodiscard]] OpenPlate open_plate(const Rig* rig, const StackDims& dims,
                                   const PlateChoice& choice, const PlateOptions& options = {});

}  // namespace haarlight::relight
