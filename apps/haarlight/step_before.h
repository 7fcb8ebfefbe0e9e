// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

/// @file
/// What to do first, for verbs that show what was made.

namespace haarlight::apps {

/// @param verb  that was requested
/// @throws Error  a folder that is nothing to look at yet: says by which command it becomes so
void refuse_step_before(const std::string& file, const std::string& verb);

/// For verbs that sum the lights of a basis file.
/// @throws Error  a folder instead: says how a basis file is made from it, or what else lights
/// it
void refuse_not_basis(const std::string& file, const std::string& verb);

}  // namespace haarlight::apps
