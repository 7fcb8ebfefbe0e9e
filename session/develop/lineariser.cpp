// SPDX-License-Identifier: Apache-2.0
#include "session/develop/lineariser.h"

#include "haarlight/core/picture/image_io.h"

namespace haarlight::session {

Lineariser::Lineariser(const FrameForm& form, Transfer transfer, const SensorResponse& response)
    : black_(static_cast<float>(form.black_level)),
      clip_(static_cast<float>(response.clip_dn)),
      range_(static_cast<float>(form.white_level - form.black_level)),
      is_srgb_(transfer == Transfer::srgb) {
  if (is_srgb_ && form.sample != SampleType::f32) {
    table_.resize(form.sample == SampleType::u8 ? 256U : 65536U);
    for (std::size_t i = 0; i < table_.size(); ++i) {
      table_[i] = decode(static_cast<float>(i));
    }
  }
}

void Lineariser::apply(std::span<const float> dn, float* out) const {
  if (!is_srgb_) {
    const float black = black_;
    for (std::size_t i = 0; i < dn.size(); ++i) {
      out[i] = dn[i] - black;
    }
    return;
  }
  for (std::size_t i = 0; i < dn.size(); ++i) {
    out[i] = (*this)(dn[i]);
  }
}

float Lineariser::decode(float dn) const {
  return range_ * linear_from_srgb((dn - black_) / range_);
}

}  // namespace haarlight::session
