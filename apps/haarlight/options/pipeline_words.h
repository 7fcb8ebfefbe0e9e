// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "apps/haarlight/verb.h"
#include "relight/pipeline/pipeline_settings.h"

/// @file
/// What the verbs that call a pipeline share: the common options as its settings, its notes as
/// words on the terminal.

namespace haarlight::apps {

/// Memory, progress and --force; notes go to the terminal as they are found: results to
/// standard output, all else to standard error, where --quiet leaves out mere notes.
[[nodiscard]] relight::PipelineSettings pipeline_settings(const CommonOptions& common);

}  // namespace haarlight::apps
