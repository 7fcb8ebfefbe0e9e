// SPDX-License-Identifier: Apache-2.0
#include "core/temporary_folder.h"

#include <system_error>

#include <stdlib.h>  // NOLINT(modernize-deprecated-headers): mkdtemp is POSIX

#include "haarlight/core/error.h"

namespace haarlight {

TemporaryFolder::TemporaryFolder(const std::filesystem::path& parent) {
  std::string name = (parent / "haarlight.XXXXXX").string();
  if (::mkdtemp(name.data()) == nullptr) {
    throw Error("no folder can be made there", name, "set TMPDIR to a folder with room",
                ExitCode::io);
  }
  path_ = name;
}

TemporaryFolder::~TemporaryFolder() {
  std::error_code ignored;
  std::filesystem::permissions(path_, std::filesystem::perms::owner_all, ignored);
  std::filesystem::remove_all(path_, ignored);
}

}  // namespace haarlight
