// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "relight/pipeline/shadow_pipeline.h"

/// @file
/// Messages of cast_shadow() to the user, in whole lines.

namespace haarlight::relight {

/// On the reprojection: lights, receivers, its error, and what the user should know.
[[nodiscard]] std::string shadow_words(const ShadowOptions& options,
                                       const ShadowSummary& summary);
[[nodiscard]] std::string object_words(const ShadowObject& object);
[[nodiscard]] std::string truth_words(const ShadowAgreement& truth);

}  // namespace haarlight::relight
