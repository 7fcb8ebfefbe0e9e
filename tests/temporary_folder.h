// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "core/temporary_folder.h"

namespace haarlight::testing {

using haarlight::TemporaryFolder;

}  // namespace haarlight::testing
