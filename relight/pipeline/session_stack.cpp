// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/session_stack.h"

#include "haarlight/relight/basis/compress_session.h"

namespace haarlight::relight {

session::DevelopOptions develop_options(const session::Session& session,
                                        const PipelineSettings& settings,
                                        std::optional<Transfer> unknown_as) {
  session::DevelopOptions options;
  options.memory_bytes = settings.memory_bytes;
  options.progress = settings.progress;
  options.plate = sharing_plate(session, {});
  options.unknown_as = unknown_as;
  return options;
}

std::vector<float> clip_levels(const session::Session& session) {
  const session::FrameForm& form = session.info().form;
  if (session.rig().has_value() || form.sample == session::SampleType::f32) {
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
    for (const session::SessionLight& light : session.info().lights) {
      levels.push_back(kJustBelow * top * static_cast<float>(gain / light.relative_power));
    }
  }
  return levels;
}

}  // namespace haarlight::relight
