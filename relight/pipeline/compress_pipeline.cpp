// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/compress_pipeline.h"

#include <algorithm>
#include <limits>

#include <fmt/format.h>

#include "core/counted.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/relight/basis/compress_session.h"
#include "haarlight/session/session.h"
#include "relight/basis/light_basis.h"
#include "relight/basis/relight_kernels.h"
#include "relight/pipeline/clipped_words.h"
#include "relight/pipeline/result_lines.h"

namespace haarlight::relight {

namespace {

/// The requested error, or its default.
void choose_error(const CompressCaptureOptions& options, const session::Session& session,
                  const PlateChoice& plate, const CompressOptions& how,
                  CompressCaptureSummary& summary) {
  constexpr double kWithoutNoise = 0.01;
  constexpr double kLeast = 1e-4;
  if (options.is_integer) {
    summary.relative_l2_requested = std::numeric_limits<double>::infinity();
    summary.request_reason = "whole steps of the camera, exactly";
    return;
  }
  if (options.max_error) {
    summary.relative_l2_requested = *options.max_error;
    summary.request_reason = "as requested";
    return;
  }
  summary.noise = measure_noise(session, plate, how);
  if (!summary.noise) {
    summary.relative_l2_requested = kWithoutNoise;
    summary.request_reason = "the default: nobody measured the camera's noise";
    return;
  }
  summary.relative_l2_requested = std::clamp(kNoiseTarget * *summary.noise, kLeast, 1.0);
  summary.request_reason = fmt::format("{:g} times the capture's noise", kNoiseTarget);
}

/// The requested basis, or the one that the lights allow.
BasisKind choose_basis(const CompressCaptureOptions& options, const session::Session& session,
                       PipelineNotes& notes) {
  constexpr std::string_view kNoGrid =
      "its lights form no grids of rows and columns (at most 1024 of each)";
  const HaarGrid grid = haar_grid(session.info());
  const BasisKind wanted = options.basis.value_or(BasisKind::haar);
  const GridNeed need = known_basis(wanted).need;
  const std::string missing = missing_grid(need, grid);
  if (missing.empty()) {
    return wanted;
  }
  if (!options.basis) {
    notes.add(NoteKind::warning,
              fmt::format("{}: {}: the basis is direct, the lights themselves", options.session,
                          kNoGrid));
    return BasisKind::direct;
  }
  throw Error(grid.size() == 0 ? std::string(kNoGrid)
                               : fmt::format("--basis {}: {}", to_string(wanted), missing),
              options.session,
              "use --basis direct, which takes any lights; an import learns of grids by "
              "--grid ROWSxCOLUMNS");
}

std::string compress_words(const CompressCaptureOptions& options,
                           const CompressCaptureSummary& summary) {
  const CompressSummary& found = summary.compressed;
  const BasisHeader& header = found.header;
  const double raw =
      2.0 * double(header.dims.n_pixels()) * header.dims.channels * header.dims.n_lights;
  const bool is_smaller = raw >= double(found.bytes);
  return fmt::format(
      "{}: {} x {} pixels, {}, {}; {} basis, clean plate: {}\n"
      "  relative error {:.3g} within {:.3g}, {} (worst pixel {:.3g}, worst light {:.3g}), "
      "{:.1f} coefficients per pixel\n"
      "  {} bytes, {:.1f} times {} than 16-bit pictures{}\n",
      options.output, header.dims.width, header.dims.height,
      counted(header.dims.channels, "channel"), counted(header.dims.n_lights, "light"),
      to_string(header.basis), to_string(header.plate), header.achieved.relative_l2,
      summary.relative_l2_requested, summary.request_reason, header.achieved.worst_pixel,
      found.worst_light, header.mean_coefficients, found.bytes,
      is_smaller ? raw / double(found.bytes) : double(found.bytes) / raw,
      is_smaller ? "smaller" : "larger",
      !is_smaller && header.coding == BasisCoding::lossless
          ? "; --whole-steps keeps what the camera gave, and is smaller"
          : "");
}

}  // namespace

CompressCaptureSummary compress_capture(const CompressCaptureOptions& options) {
  CompressOptions how;
  how.worst_pixel = options.worst_pixel.value_or(how.worst_pixel);
  how.unknown_as = options.unknown_as;
  how.memory_bytes = options.settings.memory_bytes;
  how.rank = options.rank;
  how.progress = options.settings.progress;
  require_absent(options.output, options.settings.overwrites);
  CompressCaptureSummary summary;
  PipelineNotes notes(options.settings.tell);
  const PlateChoice plate = PlateChoice::parse(options.plate);
  const session::Session session = session::Session::open(options.session);
  how.basis = choose_basis(options, session, notes);
  choose_error(options, session, plate, how, summary);
  how.relative_l2 = summary.relative_l2_requested;
  how.is_integer = options.is_integer;
  summary.compressed = compress_session(session, plate, options.output, how);
  tell_lines(compress_words(options, summary), notes);
  tell_lines(clipped_words(summary.compressed.header), notes);
  summary.notes = notes.all();
  return summary;
}

void add_to_report(const CompressCaptureOptions& options, const CompressCaptureSummary& summary,
                   Report& report) {
  const CompressSummary& found = summary.compressed;
  const BasisHeader& header = found.header;
  report.add_input(options.session);
  report.add_requested("worst_pixel",
                       options.worst_pixel.value_or(std::numeric_limits<double>::infinity()));
  report.add_requested("basis",
                       options.basis ? std::string(to_string(*options.basis)) : "auto");
  report.add_requested("plate", options.plate.empty() ? "automatic" : options.plate);
  if (summary.noise) {
    report.add_detail("noise", *summary.noise);
  }
  report.add_requested("relative_l2", summary.relative_l2_requested);
  report.add_detail("relative_l2_from", summary.request_reason);
  report.add_achieved("relative_l2", header.achieved.relative_l2);
  report.add_achieved("worst_pixel", header.achieved.worst_pixel);
  report.add_achieved("worst_value", header.achieved.worst_value);
  report.add_achieved("worst_light", found.worst_light);
  report_clipped(header, report);
  report.add_detail("coding", std::string(to_string(header.coding)));
  report.add_detail("plate", std::string(to_string(header.plate)));
  report.add_detail("plate_rank", std::int64_t{header.plate_rank});
  report.add_detail("coefficients_per_pixel", header.mean_coefficients);
  report.add_detail("kernels", std::string(word_of(best_kernel_code())));
  report.add_detail("seconds_plate", found.seconds_plate);
  report.add_detail("seconds_looked", found.seconds_looked);
  report.add_detail("seconds_coded", found.seconds_coded);
  report.add_detail("seconds_written", found.seconds_written);
  report.add_detail("bytes_moved", static_cast<std::int64_t>(found.bytes_moved));
  report.add_detail("processes", std::int64_t{options.rank.n});
  report.add_detail("tile_rows_found", std::int64_t{found.n_rows_found});
  report.set_bytes(found.bytes);
}

}  // namespace haarlight::relight
