// SPDX-License-Identifier: Apache-2.0
#include "bench/methods/all_methods.h"

#include "core/rig/pattern_methods.h"
#include "relight/basis/basis_methods.h"
#include "relight/light/light_methods.h"
#include "relight/reflectance/fit/fit_methods.h"
#include "relight/shadow/shadow_methods.h"
#include "relight/shape/shape_methods.h"
#include "render/direct/render_methods.h"
#include "render/soft_shadow/soft_shadow_methods.h"
#include "render/surface/surface_methods.h"

namespace haarlight::bench {

std::vector<Method> all_methods() {
  std::vector<Method> all;
  for (std::vector<Method> (*table)() :
       {pattern_methods, render::render_methods, render::soft_shadow_methods,
        render::surface_methods, relight::light_methods, relight::basis_methods,
        relight::shadow_methods, relight::shape_methods, relight::fit_methods}) {
    const std::vector<Method> methods = table();
    all.insert(all.end(), methods.begin(), methods.end());
  }
  return all;
}

}  // namespace haarlight::bench
