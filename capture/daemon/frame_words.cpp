// SPDX-License-Identifier: Apache-2.0
#include "capture/daemon/frame_words.h"

#include <cmath>

#include <fmt/format.h>

#include "capture/camera/camera.h"

namespace haarlight::capture {

namespace {

// Worth an operator's look beyond these. Highlights of one pixel in a hundred are usual;
// develop knows each of them.
constexpr double kManySaturated = 1e-2;
constexpr double kAllBlack = 0.995;
constexpr double kCloseUs = 50.0;  // half of the guard of capture/plan/timing.h is used up

/// "1.24 ms", "350 µs", "2.0 s"
std::string duration(double us) {
  const double size = std::abs(us);
  if (size >= 1e6) {
    return fmt::format("{:.2f} s", us * 1e-6);
  }
  return size >= 1e3 ? fmt::format("{:.2f} ms", us * 1e-3) : fmt::format("{:.0f} µs", us);
}

double us_between(std::int64_t from_ns, std::int64_t to_ns) {
  return static_cast<double>(to_ns - from_ns) * 1e-3;
}

std::string meaning_words(TimestampMeaning meaning) {
  switch (meaning) {
    case TimestampMeaning::start_exposure:
      return "the start of the exposure";
    case TimestampMeaning::start_readout:
      return "the start of the readout";
    case TimestampMeaning::end_frame:
      return "the end of the frame";
  }
  return "?";
}

std::string light_words(const session::FrameEvidence& e) {
  if (e.kind == session::EvidenceKind::asserted) {
    return "An import asserts that this light was lit; nothing was measured.";
  }
  if (e.tag_echo != e.tag) {
    return fmt::format("The controller echoed tag {} where {} was written.", e.tag_echo, e.tag);
  }
  if (e.step_after >= 0) {
    return fmt::format(
        "The camera's strobe stepped the pattern table: the counter stood at {} before the "
        "frame and at {} after it.",
        e.step_before, e.step_after);
  }
  if (e.is_read_back) {
    return "The controller has no tags: every channel was read back before the exposure and "
           "again after it, and held what was written.";
  }
  return fmt::format(
      "The controller confirmed this pattern (tag {}) before the exposure and again after it.",
      e.tag);
}

std::string picture_words(const session::FrameEvidence& e) {
  if (e.verdict == session::FrameVerdict::wrong_light) {
    return "The picture never agreed with another frame of the same lights.";
  }
  if (e.agrees_with >= 0) {
    return fmt::format(
        "The picture itself proves the light: a frame of the same lights ({}), before which "
        "another light was shown, is the same. At most {:.2g} % of its light can be the light "
        "before.",
        e.agrees_with == e.pattern_id ? "since taken again"
                                      : fmt::format("shot {}", e.agrees_with),
        100.0 * e.other_light_at_most.value_or(1.0));
  }
  if (!e.picture_own_sigma) {
    return "Nothing of this session predicted the picture: its light rests on the "
           "controller's word and the clock.";
  }
  if (e.picture_other < 0) {
    return "No other pattern was near enough to compare the picture with.";
  }
  return fmt::format(
      "What other lights let expect of the picture: {:.1f} sigma from its own prediction, "
      "{:.1f} from that of shot {}, the "
      "nearest other; the two lie {:.1f} apart. That is no proof.",
      *e.picture_own_sigma, e.picture_other_sigma.value_or(0.0), e.picture_other,
      e.picture_discrimination_sigma.value_or(0.0));
}

std::string time_words(const session::FrameEvidence& e) {
  if (e.t_exposure_start_ns == 0 || e.t_stable_ns == 0) {
    return "No times were recorded.";
  }
  std::string text = fmt::format("The exposure began {} after the light stood still",
                                 duration(us_between(e.t_stable_ns, e.t_exposure_start_ns)));
  if (e.t_next_change_ns > 0) {
    text += fmt::format(" and ended {} before the next change of light",
                        duration(us_between(e.t_exposure_end_ns, e.t_next_change_ns)));
  }
  return text + fmt::format("; {} to spare.", duration(e.margin_us));
}

std::string number_words(const session::FrameEvidence& e) {
  std::string text = fmt::format("Frame {} of the camera", e.sequence);
  const bool is_damaged = (e.flags & (kFrameError | kFrameShort)) != 0;
  text += is_damaged ? ", which the camera marked as damaged." : ", undamaged and in sequence.";
  if (e.discarded_before == 1) {
    text += " One frame before it was put aside: the light was still changing.";
  } else if (e.discarded_before > 1) {
    text += fmt::format(" {} frames before it were put aside: the light was still changing.",
                        e.discarded_before);
  }
  return text;
}

std::string exposure_words(const session::FrameEvidence& e) {
  const bool is_as_requested = std::abs(e.exposure_read_us - e.exposure_requested_us) <=
                               0.01 * std::max(1.0, e.exposure_requested_us);
  return fmt::format("Exposure {}{}, gain {:.1f} dB.", duration(e.exposure_read_us),
                     is_as_requested ? ", as requested"
                                     : fmt::format(" where {} was requested",
                                                   duration(e.exposure_requested_us)),
                     e.gain_db);
}

std::string pixel_words(const session::FrameEvidence& e, const session::FrameForm& form) {
  return fmt::format(
      "Pixel values from {} to {}, on average {:.0f}; saturated from {:.0f} on, "
      "black is {:.0f}. Saturated: "
      "{:.3f} %. At or below black: {:.1f} %.",
      e.min_dn, e.max_dn, e.mean_dn, form.saturation_dn(), form.black_level,
      100.0 * e.saturated_fraction, 100.0 * e.black_fraction);
}

}  // namespace

std::string doubt_of(const session::FrameEvidence& evidence, const session::FrameForm& form,
                     session::ShotKind kind) {
  if (evidence.verdict != session::FrameVerdict::good) {
    return fmt::format("it was taken as often as the plan allows and stayed \"{}\"",
                       to_string(evidence.verdict));
  }
  if (evidence.saturated_fraction > kManySaturated) {
    return fmt::format(
        "{:.2f} % of the pixels are saturated: shorten the exposure, or add a "
        "shorter bracket",
        100.0 * evidence.saturated_fraction);
  }
  if (kind != session::ShotKind::dark &&
      (evidence.black_fraction > kAllBlack || evidence.max_dn <= form.black_level)) {
    return "almost every pixel is black: is the light dead, or the lens covered?";
  }
  if (evidence.kind == session::EvidenceKind::measured && evidence.step_after < 0 &&
      evidence.margin_us < kCloseUs) {
    return fmt::format("only {:.0f} µs lie between the exposure and a change of light",
                       evidence.margin_us);
  }
  return {};
}

std::vector<std::string> describe_evidence(const session::FrameEvidence& evidence,
                                           const session::FrameForm& form) {
  std::vector<std::string> words{light_words(evidence)};
  if (evidence.kind == session::EvidenceKind::measured) {
    words.push_back(picture_words(evidence));
  }
  if (evidence.kind != session::EvidenceKind::asserted) {
    words.push_back(time_words(evidence));
    words.push_back(number_words(evidence));
    words.push_back(exposure_words(evidence));
  }
  words.push_back(pixel_words(evidence, form));
  if (evidence.temperature_c) {
    words.push_back(fmt::format("The lights were at {:.1f} °C.", *evidence.temperature_c));
  }
  if (evidence.kind != session::EvidenceKind::asserted) {
    words.push_back(fmt::format("Mode {}; the camera's timestamp means {}.",
                                to_string(evidence.sync),
                                meaning_words(evidence.timestamp_meaning)));
  }
  if (evidence.kind == session::EvidenceKind::replayed) {
    words.emplace_back("The frame was replayed from an earlier session.");
  }
  return words;
}

}  // namespace haarlight::capture
