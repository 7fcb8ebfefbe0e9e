// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "apps/viewer/publish_folder.h"
#include "haarlight/core/progress.h"
#include "haarlight/relight/basis/basis_file.h"

/// @file
/// A basis file as a folder of files: what the viewer's server answers, computed ahead.

namespace haarlight::apps {

struct PublishBasisOptions {
  std::optional<int> terms;               ///< keep this many, those that carry most light
  std::optional<double> max_error;        ///< relative L2 over the whole capture, at most
  std::vector<std::string> environments;  ///< picture files
  ProgressStyle progress = ProgressStyle::none;
};

/// What was kept, and how far the pictures may be from the capture.
struct PublishedBasis {
  int terms = 0;
  int terms_all = 0;
  /// Relative L2 error over the pictures of all lights together, at most: the file's own error
  /// as it states it, and the norm of what was left out.
  double own_error = 0.0;
  double error = 0.0;
};

/// Turns of an environment whose weights are written: every 2 degrees.
inline constexpr int kPublishedTurns = 180;

/// @throws Error  as BasisFile's and Environment's readers; unwritable
[[nodiscard]] PublishedBasis publish_basis(const relight::BasisFile& basis,
                                           PublishFolder& folder,
                                           const PublishBasisOptions& options,
                                           const PublishNotes& notes);

}  // namespace haarlight::apps
