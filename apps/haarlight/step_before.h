#pragma once

#include <string>

/// @file
/// What to do first, for verbs that show what was made.

namespace haarlight {

/// @param verb  that was asked for
/// @throws Error  a folder that is nothing to look at yet: says by which command it becomes so
void refuse_step_before(const std::string& file, const std::string& verb);

}  // namespace haarlight
