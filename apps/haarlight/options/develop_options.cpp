// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/options/develop_options.h"

#include "apps/haarlight/options/pipeline_words.h"
#include "haarlight/core/picture/image_io.h"
#include "relight/pipeline/session_stack.h"

namespace haarlight::apps {

void add_transfer_option(Command verb, std::string& transfer) {
  verb.option(
      "--transfer", &transfer,
      "What stands in for the unknown curve of a camera's YUYV or NV12 (default: refuse)",
      {.choices = {"srgb", "linear"}});
}

std::optional<Transfer> transfer_requested(const std::string& transfer) {
  if (transfer.empty()) {
    return {};
  }
  return transfer == "srgb" ? Transfer::srgb : Transfer::linear;
}

session::DevelopOptions develop_options(const session::Session& session,
                                        const CommonOptions& common,
                                        const std::string& transfer) {
  return relight::develop_options(session, pipeline_settings(common),
                                  transfer_requested(transfer));
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
