// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/develop_options.h"

#include "core/picture/image_io.h"
#include "relight/basis/compress_session.h"

namespace haarlight {

void add_transfer_option(Command verb, std::string& transfer) {
  verb.option(
      "--transfer", &transfer,
      "What stands in for the unknown curve of a camera's YUYV or NV12 (default: refuse)",
      {.choices = {"srgb", "linear"}});
}

std::optional<Transfer> transfer_asked(const std::string& transfer) {
  if (transfer.empty()) {
    return {};
  }
  return transfer == "srgb" ? Transfer::srgb : Transfer::linear;
}

DevelopOptions develop_options(const Session& session, const CommonOptions& common,
                               const std::string& transfer) {
  DevelopOptions options;
  options.memory_bytes = common.memory_bytes;
  options.progress = common.progress();
  options.plate = sharing_plate(session, {});
  options.unknown_as = transfer_asked(transfer);
  return options;
}

std::vector<float> clip_levels(const Session& session) {
  const FrameForm& form = session.info().form;
  if (session.rig().has_value() || form.sample == SampleType::f32) {
    return {};
  }
  constexpr float kJustBelow = 0.9995F;  // rounding of the decoded value
  const double coded =
      (form.saturation_dn() - form.black_level) / (form.white_level - form.black_level);
  const float top = form.transfer == Transfer::srgb
                        ? linear_from_srgb(static_cast<float>(coded))
                        : static_cast<float>(coded);
  const std::vector<double> gains = form.gains.empty() ? std::vector<double>{1.0} : form.gains;
  std::vector<float> levels;
  for (const double gain : gains) {
    for (const SessionLight& light : session.info().lights) {
      levels.push_back(kJustBelow * top * static_cast<float>(gain / light.relative_power));
    }
  }
  return levels;
}

void add_plane_options(Command verb, PlaneArguments& plane) {
  verb.option("--width-mm", &plane.width_mm,
              "What the picture shows across, for an imported capture",
              {.type = "MM", .bounds = Bounds{0.0, 1e6}});
  verb.option("--height-mm", &plane.height_mm,
              "Mean height of the object above the rig's plane",
              {.type = "MM", .bounds = Bounds{-1e5, 1e5}});
}

}  // namespace haarlight
