// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/options/develop_options.h"

#include "apps/haarlight/options/pipeline_words.h"
#include "haarlight/core/picture/image_io.h"
#include "relight/pipeline/session_stack.h"

namespace haarlight::apps {

std::vector<std::string> known_transfers() {
  return choices_of({Transfer::srgb, Transfer::linear});
}

void add_transfer_option(Command verb, std::optional<Transfer>& transfer) {
  verb.option(
      "--transfer", &transfer,
      "What stands in for the unknown curve of a camera's YUYV or NV12 (default: refuse)",
      {.choices = known_transfers()});
}

session::DevelopOptions develop_options(const session::Session& session,
                                        const CommonOptions& common) {
  return relight::develop_options(session, pipeline_settings(common), {});
}

void add_plane_options(Command verb, PlaneArguments& plane) {
  verb.option("--width-mm", &plane.width_mm,
              "What the picture shows across, for an imported capture",
              {.type = "MM", .bounds = Bounds{0.0, 1e6}});
  verb.option("--height-mm", &plane.height_mm,
              "Mean height of the object above the rig's plane",
              {.type = "MM", .bounds = Bounds{-1e5, 1e5}});
}

}  // namespace haarlight::apps
