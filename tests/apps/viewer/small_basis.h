// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>

#include "haarlight/core/files.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/relight/basis/compress.h"
#include "tests/relight/basis/made_stack.h"
#include "tests/temporary_folder.h"

/// @file
/// Small basis files for the viewer's tests.

namespace haarlight::test {

/// The made scene under the 8 x 8 lights of configs/rigs/small8.toml.
inline relight::BasisFile small_rig_basis(const std::filesystem::path& folder) {
  const Rig rig = read_rig_as_written("configs/rigs/small8.toml");
  relight::CompressSource source =
      made_source(make_stack({.grid = 8}), 8, &make_stack({.grid = 8, .has_sphere = false}));
  source.lights.clear();
  source.rig_toml = rig.text;
  source.rig_hash = rig.hash;
  (void)relight::compress_stack(source, folder / "small.hlb", {});
  return relight::BasisFile::open(folder / "small.hlb");
}

/// The same scene as an import: 16 lights with directions, three channels.
inline relight::BasisFile small_import_basis(const std::filesystem::path& folder) {
  (void)relight::compress_stack(made_source(make_stack({.grid = 4, .channels = 3}), 0),
                                folder / "import.hlb", {.basis = relight::BasisKind::direct});
  return relight::BasisFile::open(folder / "import.hlb");
}

}  // namespace haarlight::test
