// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "relight/pipeline/shadow_pipeline.h"

/// @file
/// What cast_shadow() tells a person, in whole lines.

namespace haarlight {

/// Of the reprojection: lights, receivers, its error, and what its reader should know.
[[nodiscard]] std::string shadow_words(const ShadowOptions& options,
                                       const ShadowSummary& summary);
[[nodiscard]] std::string object_words(const ShadowObject& object);
[[nodiscard]] std::string truth_words(const ShadowAgreement& truth);

}  // namespace haarlight
