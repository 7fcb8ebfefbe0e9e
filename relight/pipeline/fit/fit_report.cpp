// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/fit/fit_report.h"

#include <fmt/format.h>

namespace haarlight::relight {

namespace {

std::string words_of(const std::optional<FitFile>& file) {
  if (!file) {
    return "; no file holds it: dB of the planes";
  }
  return file->quality ? fmt::format("; folder, quality {:.4g}", *file->quality)
                       : "; " + file->name;
}

void report_requested(const FitOptions& options, Report& report) {
  report.add_input(options.capture);
  if (options.size.quality) {
    report.add_requested("quality", *options.size.quality);
  }
  if (options.size.bytes) {
    report.add_requested("bytes", static_cast<std::int64_t>(*options.size.bytes));
  }
  if (options.size.psnr_db) {
    report.add_requested("file dB", *options.size.psnr_db);
  }
}

TradeoffRecord record_of(const FormFit& fit, const FitSummary& summary) {
  TradeoffRecord record;
  record.algorithm = "haarlight";
  record.mode =
      fmt::format("fit {}: {}", to_string(fit.score.form), describe(fit.score.interpolation));
  record.error_norm =
      fmt::format("mean PSNR of the file's pictures against {}, dB", to_string(summary.truth));
  record.error = fit.mean_psnr_db();
  set_times({fit.seconds}, record);
  record.bytes = fit.file ? static_cast<double>(fit.file->bytes)
                          : static_cast<double>(fit.n_pixels * fit.n_planes);
  record.conditions.lights = summary.n_fitted_lights;
  record.conditions.pixels = fit.n_pixels;
  record.conditions.repeats = 1;
  record.conditions.more = {
      {"bytes_are", fit.file ? "on disk: " + fit.file->name : "the planes, 8 bits each"},
      {"seconds_are", std::string("of the processor, reading included")}};
  return record;
}

}  // namespace

std::string fit_table_head(FitTruth truth) {
  return fmt::format(
             "file dB: the file's pictures, read again, against {}; left dB: of lights left "
             "out in turn\n",
             to_string(truth)) +
         fmt::format("{:<9} {:>6} {:>10} {:>9} {:>9} {:>8} {:>8}  {}\n", "basis", "planes",
                     "bytes", "bit/pixel", "CPU s/MP", "file dB", "left dB", "parameters");
}

std::string fit_table_row(const FormFit& fit) {
  const auto n_pixels = static_cast<double>(fit.n_pixels);
  const auto bytes = fit.file ? static_cast<double>(fit.file->bytes) : 0.0;
  return fmt::format("{:<9} {:>6} {:>10} {:>9} {:>9.3f} {:>8.2f} {:>8.2f}  {}{}\n",
                     to_string(fit.score.form), fit.n_planes,
                     fit.file ? fmt::format("{}", fit.file->bytes) : "-",
                     fit.file ? fmt::format("{:.2f}", 8.0 * bytes / n_pixels) : "-",
                     1e6 * fit.seconds / n_pixels, fit.mean_psnr_db(), fit.score.psnr_db,
                     describe(fit.score.interpolation), words_of(fit.file));
}

std::string fit_table_row(const HaarSize& haar) {
  return fmt::format(
      "{:<9} {:>6} {:>10} {:>9.2f} {:>9} {:>8.2f} {:>8}  at its own lights (none between)\n",
      "haar", "-", "-", 8.0 * haar.bytes_per_pixel, "-", haar.psnr_db, "-");
}

void report_fit(const FitOptions& options, const FitSummary& summary, Report& report) {
  report_requested(options, report);
  const FormFit& fit = summary.fits.front();
  if (fit.file && !options.out.empty()) {
    report.set_bytes(fit.file->bytes);
  }
  report.add_detail("basis", std::string(to_string(fit.score.form)));
  report.add_detail("recipe", describe(fit.score.interpolation));
  report.add_achieved("left out dB", fit.score.psnr_db);
  report.add_achieved("file dB", fit.mean_psnr_db());
  report.add_detail("file dB against", std::string(to_string(summary.truth)));
  report.add_detail("file dB each", fit.psnr_db);
  if (summary.truth == FitTruth::held) {
    report.add_achieved("held out dB", fit.mean_psnr_db());
  }
  if (fit.file && fit.file->quality) {
    report.add_achieved("quality", *fit.file->quality);
  }
  report.add_detail("quantisation rms", fit.quantisation_rms);
  report.add_detail("clipped share", fit.clipped_fraction);
  report.add_detail("peak memory bytes", static_cast<std::int64_t>(peak_memory_bytes()));
}

void report_fits(const FitOptions& options, const FitSummary& summary, Report& report) {
  report_requested(options, report);
  for (const FormFit& fit : summary.fits) {
    report.add_achieved(fmt::format("{} dB", to_string(fit.score.form)), fit.mean_psnr_db());
    if (fit.file) {
      report.add_achieved(fmt::format("{} bytes", to_string(fit.score.form)),
                          static_cast<std::int64_t>(fit.file->bytes));
    }
  }
  if (summary.haar) {
    report.add_achieved("haar dB at its own lights", summary.haar->psnr_db);
  }
}

std::vector<TradeoffRecord> fit_records(const FitSummary& summary, int threads,
                                        const std::string& command) {
  std::vector<TradeoffRecord> records;
  for (const FormFit& fit : summary.fits) {
    records.push_back(record_of(fit, summary));
    records.back().conditions.threads = threads;
    records.back().conditions.command = command;
  }
  return records;
}

}  // namespace haarlight::relight
