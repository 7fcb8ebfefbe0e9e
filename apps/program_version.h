// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <string_view>

/// @file
/// Which haarlight a program is, for --version and bug reports. What files and reports store is
/// `kVersion` (core/report.h), which is alike for every build of a version.

namespace haarlight::apps {

/// The commit that was built, "592dfa4", or "592dfa4-dirty" when tracked files had been changed;
/// empty: not built from a git checkout. Defined in a source that the build writes.
[[nodiscard]] std::string_view built_commit();

/// "0.1.0 (592dfa4)"; without a commit "0.1.0".
[[nodiscard]] std::string program_version();

}  // namespace haarlight::apps
