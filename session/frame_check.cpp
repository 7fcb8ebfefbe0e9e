#include "session/frame_check.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <vector>

#include <fmt/format.h>

#include "core/error.h"
#include "core/files.h"
#include "session/clean_rule.h"

namespace haarlight {

namespace {

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
    double row_sum = 0.0;
    for (const T value : pixels.row(y)) {
      row_sum += static_cast<double>(value);
      min = std::min(min, value);
      max = std::max(max, value);
      saturated += static_cast<double>(value) >= white_level ? 1U : 0U;
      black += static_cast<double>(value) <= black_level ? 1U : 0U;
    }
    sum += row_sum;
  }
  const auto n = static_cast<double>(pixels.height()) * pixels.width() * pixels.channels();
  result.min = static_cast<double>(min);
  result.max = static_cast<double>(max);
  result.mean = sum / n;
  result.saturated_share = static_cast<double>(saturated) / n;
  result.black_share = static_cast<double>(black) / n;
  return result;
}

std::uint16_t to_dn(double value) {
  return static_cast<std::uint16_t>(std::clamp(value, 0.0, 65535.0));
}

/// The hash of the active rows, or of whatever rows the file has when it is shorter.
std::string hash_active(std::span<const std::byte> file, const FrameTiffHeader& header,
                        int rows, const std::string& where) {
  return content_hash(read_frame_tiff_rows(file, header, 0, rows, where));
}

std::string find_form_problem(const FrameTiffHeader& header, const FrameForm& form) {
  if (header.width == form.width && header.height == form.stored_height &&
      header.channels == form.channels && header.sample == form.sample) {
    return {};
  }
  return fmt::format(
      "a frame of {} x {} x {}, {} bytes a sample; the session has {} x {} x {}, {}",
      header.width, header.height, header.channels, bytes_per_sample(header.sample), form.width,
      form.stored_height, form.channels, bytes_per_sample(form.sample));
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
  const PixelStatistics statistics = measure(active, form.black_level, form.white_level);
  evidence.min_dn = to_dn(statistics.min);
  evidence.max_dn = to_dn(statistics.max);
  evidence.mean_dn = statistics.mean;
  evidence.saturated_share = statistics.saturated_share;
  evidence.black_share = statistics.black_share;
  evidence.pixel_hash = hash_pixels(active);
}

template void describe_pixels(ImageView<const std::uint8_t>, const FrameForm&, FrameEvidence&);
template void describe_pixels(ImageView<const std::uint16_t>, const FrameForm&, FrameEvidence&);
template void describe_pixels(ImageView<const float>, const FrameForm&, FrameEvidence&);

FrameInspection inspect_frame(const std::filesystem::path& file, const SessionInfo& info) {
  FrameInspection inspection;
  try {
    const MappedFile mapped(file);
    inspection.file_hash = content_hash(mapped.bytes());
    const FrameTiffHeader header = read_frame_tiff_header(mapped.bytes(), file.string());
    inspection.description = frame_description_from_json(header.description, file.string());
    inspection.problem = find_form_problem(header, info.form);
    if (inspection.is_good()) {
      inspection.problem = find_identity_problem(inspection.description, info);
    }
    if (inspection.is_good() &&
        hash_active(mapped.bytes(), header, info.form.height, file.string()) !=
            inspection.description.evidence.pixel_hash) {
      inspection.problem = "the pixels are not those that were checked: their hash differs";
    }
    if (inspection.is_good()) {
      inspection.problem = find_evidence_problem(inspection.description.evidence);
    }
  } catch (const Error& error) {
    inspection.problem = error.problem();
  }
  return inspection;
}

}  // namespace haarlight
