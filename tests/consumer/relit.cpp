// SPDX-License-Identifier: Apache-2.0
// relit BASIS.hlb ENVIRONMENT OUT.png: a captured object under an environment map.
#include <cstdio>
#include <exception>

#include <haarlight/core/picture/image_io.h>
#include <haarlight/core/rig/rig.h>
#include <haarlight/relight/basis/relight.h>
#include <haarlight/relight/light/light_weights.h>
#include <haarlight/render/light/cubemap.h>

int main(int argc, char** argv) try {
  if (argc != 4) {
    return 2;
  }
  namespace relight = haarlight::relight;
  const auto basis = relight::BasisFile::open(argv[1]);
  const auto rig = haarlight::parse_rig(basis.header().rig_toml, argv[1]);
  const auto sky = relight::rig_weights(haarlight::render::Environment::read(argv[2]), rig);
  const auto relit = relight::relight(basis, sky.weights);
  haarlight::write_image(argv[3], relit.picture.view(), 1.0);
  return 0;
} catch (const std::exception& error) {
  std::fprintf(stderr, "relit: %s\n", error.what());
  return 1;
}
