// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <map>

#include "relight/basis/made_stack.h"

/// @file
/// Light stacks made from closed forms (relight/basis/made_stack.h), kept between tests.

namespace haarlight::test {

using relight::is_blocked;
using relight::made_lights;
using relight::made_source;
using relight::made_value;
using relight::MadeScene;
using relight::render_stack;

/// Each scene is rendered once: sanitizer builds are slow.
inline const MemoryStack& make_stack(const MadeScene& scene) {
  static std::map<MadeScene, MemoryStack> made;
  const auto found = made.find(scene);
  return found != made.end() ? found->second
                             : made.emplace(scene, render_stack(scene)).first->second;
}

}  // namespace haarlight::test
