// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "apps/haarlight/verb.h"
#include "relight/pipeline/shadow_captures.h"

/// @file
/// The captured object of `shadow`, `hull` and `view`: the same options carve the same hull.

namespace haarlight::apps {

struct CapturedArguments {
  relight::CapturedObject captured;
  std::vector<double> height;  ///< lowest and highest point, or empty
  double voxel_mm = 0.0;
};

/// BASIS, and what add_hull_options() adds.
void add_captured_options(Command verb, CapturedArguments& arguments);

/// What changes the hull: --voxel, --object-height, --plane, --also, --plate, --mask.
void add_hull_options(Command verb, CapturedArguments& arguments);

/// Those of them that are given, as words of a command line.
[[nodiscard]] std::vector<std::string> hull_words(const CapturedArguments& arguments);

/// As parsed. @throws Error(usage)  BASIS is a file of another kind
[[nodiscard]] relight::CapturedObject captured_object(const CapturedArguments& arguments,
                                                      const char* verb);

}  // namespace haarlight::apps
