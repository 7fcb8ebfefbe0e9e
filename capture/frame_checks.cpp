#include "capture/frame_checks.h"

#include <algorithm>
#include <memory>

#include <fmt/format.h>
#include <xxhash.h>

#include "session/frame_check.h"

namespace haarlight {

FrameGlance glance_at(ImageView<const std::uint16_t> active, std::uint16_t white) {
  struct Free {
    void operator()(XXH3_state_t* state) const noexcept { XXH3_freeState(state); }
  };
  const std::unique_ptr<XXH3_state_t, Free> state(XXH3_createState());
  XXH3_64bits_reset(state.get());
  FrameGlance glance;
  for (int y = 0; y < active.height(); ++y) {
    const auto row = active.row(y);
    XXH3_64bits_update(state.get(), row.data(), row.size_bytes());
    glance.must_differ =
        glance.must_differ || std::any_of(row.begin(), row.end(), [white](std::uint16_t word) {
          return word > 0 && word < white;
        });
  }
  glance.hash = XXH3_64bits_digest(state.get());
  return glance;
}

std::string check_pixels(ImageView<const std::uint16_t> active, const FrameForm& form,
                         FrameEvidence& evidence) {
  describe_pixels<std::uint16_t>(active, form, evidence);
  const bool is_flat = evidence.min_dn == evidence.max_dn;
  const bool is_clipped = evidence.max_dn == 0 || evidence.min_dn >= form.white_level;
  if (is_flat && !is_clipped && active.height() * active.width() > 1) {
    return fmt::format("every pixel is {}: the camera delivers no picture", evidence.min_dn);
  }
  return {};
}

}  // namespace haarlight
