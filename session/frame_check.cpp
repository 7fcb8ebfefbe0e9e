// SPDX-License-Identifier: Apache-2.0
#include "session/frame_check.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <span>
#include <type_traits>
#include <vector>

#include <fmt/format.h>

#include "core/sha256.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "session/clean_rule.h"

namespace haarlight::session {

namespace {

template <class T>
struct RowStatistics {
  T min{};
  T max{};
  double sum = 0.0;
  std::size_t n_saturated = 0;
  std::size_t n_black = 0;
};

/// Words in integers, which the compiler vectorises 16-wide; their sums are exact, so the
/// result equals that of doubles to the last bit.
template <class T>
RowStatistics<T> measure_row(std::span<const T> row, double black_level, double white_level) {
  RowStatistics<T> result{row.front(), row.front()};
  if constexpr (std::is_integral_v<T>) {
    constexpr double kMost = std::numeric_limits<T>::max();
    // value >= white  <=>  value >= ceil(white), value <= black  <=>  value <= floor(black)
    const bool can_saturate = std::ceil(white_level) <= kMost;
    const bool can_be_black = std::floor(black_level) >= 0.0;
    const auto white = static_cast<T>(std::clamp(std::ceil(white_level), 0.0, kMost));
    const auto dark = static_cast<T>(std::clamp(std::floor(black_level), 0.0, kMost));
    std::uint32_t n_white = 0;
    std::uint32_t n_dark = 0;
    std::uint64_t sum = 0;
    for (const T value : row) {
      sum += value;
      result.min = std::min(result.min, value);
      result.max = std::max(result.max, value);
      n_white += value >= white ? 1U : 0U;
      n_dark += value <= dark ? 1U : 0U;
    }
    result.sum = static_cast<double>(sum);
    result.n_saturated = can_saturate ? n_white : 0;
    result.n_black = can_be_black ? n_dark : 0;
  } else {
    for (const T value : row) {
      result.sum += static_cast<double>(value);
      result.min = std::min(result.min, value);
      result.max = std::max(result.max, value);
      result.n_saturated += static_cast<double>(value) >= white_level ? 1U : 0U;
      result.n_black += static_cast<double>(value) <= black_level ? 1U : 0U;
    }
  }
  return result;
}

template <class T>
PixelStatistics measure(ImageView<const T> pixels, double black_level, double white_level) {
  PixelStatistics result;
  if (pixels.is_empty()) {
    return result;
  }
  double sum = 0.0;
  T min = pixels(0, 0);
  T max = pixels(0, 0);
  std::size_t saturated = 0;
  std::size_t black = 0;
  for (int y = 0; y < pixels.height(); ++y) {
    const RowStatistics<T> row = measure_row(pixels.row(y), black_level, white_level);
    sum += row.sum;
    min = std::min(min, row.min);
    max = std::max(max, row.max);
    saturated += row.n_saturated;
    black += row.n_black;
  }
  const auto n = static_cast<double>(pixels.height()) * pixels.width() * pixels.channels();
  result.min = static_cast<double>(min);
  result.max = static_cast<double>(max);
  result.mean = sum / n;
  result.saturated_fraction = static_cast<double>(saturated) / n;
  result.black_fraction = static_cast<double>(black) / n;
  return result;
}

std::uint16_t to_dn(double value) {
  return static_cast<std::uint16_t>(std::clamp(value, 0.0, 65535.0));
}

template <class T>
void describe_bytes(const std::vector<std::byte>& bytes, const FrameForm& form,
                    FrameEvidence& evidence) {
  const ImageView<const T> view(reinterpret_cast<const T*>(bytes.data()), form.height,
                                form.width, form.channels);
  describe_pixels(view, form, evidence);
}

/// Sums are formed in the same order as when they were stored; only printing may cost 1 ulp.
bool is_same(double a, double b) {
  constexpr double kSlack = 1e-12;
  return std::abs(a - b) <= kSlack * std::max({1.0, std::abs(a), std::abs(b)});
}

std::string find_pixel_problem(const std::vector<std::byte>& bytes, const FrameForm& form,
                               const FrameEvidence& evidence) {
  FrameEvidence found;
  switch (form.sample) {
    case SampleType::u8:
      describe_bytes<std::uint8_t>(bytes, form, found);
      break;
    case SampleType::u16:
      describe_bytes<std::uint16_t>(bytes, form, found);
      break;
    case SampleType::f32:
      describe_bytes<float>(bytes, form, found);
      break;
  }
  if (found.pixel_hash != evidence.pixel_hash) {
    return "the pixels are not those that were checked: their hash differs";
  }
  if (found.min_dn != evidence.min_dn || found.max_dn != evidence.max_dn ||
      !is_same(found.mean_dn, evidence.mean_dn) ||
      !is_same(found.saturated_fraction, evidence.saturated_fraction) ||
      !is_same(found.black_fraction, evidence.black_fraction)) {
    return fmt::format("pixels {} .. {}, mean {}; the evidence says {} .. {}, mean {}",
                       found.min_dn, found.max_dn, found.mean_dn, evidence.min_dn,
                       evidence.max_dn, evidence.mean_dn);
  }
  return {};
}

std::string find_form_problem(const FrameTiffHeader& header, const FrameForm& form) {
  if (header.width == form.width && header.height == form.stored_height &&
      header.channels == form.channels && header.sample == form.sample) {
    return {};
  }
  return fmt::format(
      "a frame of {} x {} x {}, {} bytes per sample; the session has {} x {} x {}, {}",
      header.width, header.height, header.channels, bytes_per_sample(header.sample), form.width,
      form.stored_height, form.channels, bytes_per_sample(form.sample));
}

std::string describe_lit(const std::vector<LightLevel>& lit, double exposure_us) {
  std::string text = fmt::format("{} lights", lit.size());
  if (lit.size() == 1) {
    text = fmt::format("light {} at level {}", lit.front().light, lit.front().level);
  }
  return fmt::format("{}, {} us", text, exposure_us);
}

std::string find_identity_problem(const FrameDescription& description,
                                  const SessionInfo& info) {
  if (description.session != info.id) {
    return fmt::format("a frame of session {}, this is {}", description.session, info.id);
  }
  if (description.plan_hash != info.plan_hash) {
    return fmt::format("a frame of plan {}, this is {}", description.plan_hash, info.plan_hash);
  }
  if (static_cast<std::size_t>(description.shot) >= info.shots.size()) {
    return fmt::format("shot {} of a plan of {}", description.shot, info.shots.size());
  }
  if (!description.light) {  // as in sessions of older programs
    return info.program.empty() ? std::string() : "it does not say what was lit";
  }
  const LitStatement& said = *description.light;
  const Shot& shot = info.shots[static_cast<std::size_t>(description.shot)];
  if (said.kind != shot.kind || said.lit != shot.lit || said.exposure_us != shot.exposure_us) {
    return fmt::format("it says {} shot, {}; the session's shot {} is {}, {}",
                       to_string(said.kind), describe_lit(said.lit, said.exposure_us),
                       description.shot, to_string(shot.kind),
                       describe_lit(shot.lit, shot.exposure_us));
  }
  if (said.setup != setup_hash(info)) {
    return "taken with other lights (names, positions, powers or lobes) or another form of "
           "frames "
           "than the session lists";
  }
  return {};
}

}  // namespace

PixelStatistics measure_pixels(ImageView<const std::uint16_t> pixels, double black_level,
                               double white_level) {
  return measure(pixels, black_level, white_level);
}
PixelStatistics measure_pixels(ImageView<const std::uint8_t> pixels, double black_level,
                               double white_level) {
  return measure(pixels, black_level, white_level);
}
PixelStatistics measure_pixels(ImageView<const float> pixels, double black_level,
                               double white_level) {
  return measure(pixels, black_level, white_level);
}

template <class T>
void describe_pixels(ImageView<const T> active, const FrameForm& form,
                     FrameEvidence& evidence) {
  const PixelStatistics statistics = measure(active, form.black_level, form.saturation_dn());
  evidence.min_dn = to_dn(statistics.min);
  evidence.max_dn = to_dn(statistics.max);
  evidence.mean_dn = statistics.mean;
  evidence.saturated_fraction = statistics.saturated_fraction;
  evidence.black_fraction = statistics.black_fraction;
  evidence.pixel_hash = hash_pixels(active);
}

template void describe_pixels(ImageView<const std::uint8_t>, const FrameForm&, FrameEvidence&);
template void describe_pixels(ImageView<const std::uint16_t>, const FrameForm&, FrameEvidence&);
template void describe_pixels(ImageView<const float>, const FrameForm&, FrameEvidence&);

FrameInspection inspect_frame(const std::filesystem::path& file, const SessionInfo& info) {
  FrameInspection inspection;
  std::error_code ignored;
  if (!std::filesystem::is_regular_file(std::filesystem::symlink_status(file, ignored))) {
    inspection.problem = "a link or no plain file: its bytes are not in the session";
    return inspection;
  }
  try {
    const MappedFile mapped(file);
    inspection.file_hash = content_hash(mapped.bytes());
    inspection.sha256 = to_hex(leaf_hash("frames/" + file.filename().string(), mapped.bytes()));
    const FrameTiffHeader header = read_frame_tiff_header(mapped.bytes(), file.string());
    inspection.description = frame_description_from_json(header.description, file.string());
    inspection.problem = find_form_problem(header, info.form);
    if (inspection.is_good()) {
      inspection.problem = find_identity_problem(inspection.description, info);
    }
    if (inspection.is_good()) {
      inspection.problem = find_pixel_problem(
          read_frame_tiff_rows(mapped.bytes(), header, 0, info.form.height, file.string()),
          info.form, inspection.description.evidence);
    }
    if (inspection.is_good()) {
      inspection.problem = find_evidence_problem(inspection.description.evidence);
    }
  } catch (const Error& error) {
    inspection.problem = error.problem();
  }
  return inspection;
}

}  // namespace haarlight::session
