// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/develop_pipeline.h"

#include <filesystem>

#include <fmt/format.h>

#include "core/counted.h"
#include "haarlight/core/files.h"
#include "haarlight/core/progress.h"
#include "haarlight/relight/basis/compress_session.h"
#include "haarlight/relight/light/near_light.h"
#include "haarlight/session/session.h"
#include "relight/pipeline/picture_notes.h"

namespace haarlight::relight {

namespace {

namespace fs = std::filesystem;

constexpr double kMuchMoved = 1e-3;  // of the values: noise alone gives 1e-8

/// One EXR per light; with standard errors light_0000.error.exr next to it.
std::uint64_t write_pictures(const session::Session& session, const LightStack& stack,
                             const std::string& ending, const fs::path& folder,
                             const PipelineSettings& settings) {
  fs::create_directories(folder);
  Progress progress("write EXR", static_cast<std::size_t>(stack.dims().n_lights),
                    settings.progress);
  std::uint64_t bytes = 0;
  const std::vector<session::SessionLight> seen = lights_in_picture(session);
  for_each_light_image(
      stack, settings.memory_bytes / 2, [&](int k, const Image<float>& picture) {
        const fs::path file = folder / fmt::format("light_{:04}{}.exr", k, ending);
        PictureNotes notes = notes_of(session.info());
        add_light(session.info(), k, notes);
        if (ending.empty()) {  // standard errors are not a light's picture
          add_seen_light(session.info(), seen, k, notes);
        }
        write_image(file, picture.view(), 1.0, notes);
        bytes += fs::file_size(file);
        progress.advance();
      });
  return bytes;
}

session::DevelopOptions develop_options(const DevelopSessionOptions& options,
                                        const session::Session& session) {
  session::DevelopOptions how;
  how.memory_bytes = options.settings.memory_bytes;
  how.progress = options.settings.progress;
  how.use_cache = !options.settings.overwrites;
  how.cache_folder = options.cache;
  how.unknown_as = options.unknown_as;
  how.demosaic = options.demosaic;
  how.radiometry = options.radiometry;
  how.has_standard_error = options.has_standard_error;
  how.distribute_evenly = options.plate == "even";
  if (!how.distribute_evenly) {
    how.plate = sharing_plate(session, PlateChoice::parse(options.plate));
  }
  return how;
}

void tell_developed(const DevelopSessionOptions& options, const DevelopSummary& summary,
                    PipelineNotes& notes) {
  const StackDims& shape = summary.dims;
  notes.add(NoteKind::result,
            fmt::format("{}: {} x {} x {} under {}, {}", options.session, shape.width,
                        shape.height, shape.channels, counted(shape.n_lights, "light"),
                        counted(summary.n_bands, "band")));
  notes.add(NoteKind::result,
            fmt::format("  kept in {} for compress, relight and the others{}", summary.cache,
                        options.exr.empty() ? "; --exr DIR writes pictures" : ""));
  if (summary.n_saturated > 0) {
    notes.add(NoteKind::result,
              fmt::format("{} values are clipped in every exposure: lower bounds, not "
                          "measurements",
                          summary.n_saturated));
  }
  if (summary.moved_fraction > kMuchMoved) {
    notes.add(NoteKind::result,
              fmt::format("{:.2g} of the compared values contradict each other between "
                          "exposures: did something move?",
                          summary.moved_fraction));
  }
}

}  // namespace

DevelopSummary develop_session(const DevelopSessionOptions& options) {
  const session::Session session = session::Session::open(options.session);
  const session::Developed developed =
      session::develop_all(session, develop_options(options, session));
  DevelopSummary summary;
  summary.dims = developed.stack.dims();
  summary.n_bands = developed.stack.bands().n();
  summary.n_saturated = static_cast<std::uint64_t>(developed.n_saturated);
  summary.moved_fraction = developed.moved_fraction;
  summary.record = developed.record;
  summary.cache = options.cache.empty() ? (session.folder() / "cache").string() : options.cache;
  summary.bytes = sizeof(float) * static_cast<std::uint64_t>(summary.dims.width) *
                  static_cast<std::uint64_t>(summary.dims.height) *
                  static_cast<std::uint64_t>(summary.dims.channels) *
                  static_cast<std::uint64_t>(summary.dims.n_lights);
  if (!options.exr.empty()) {
    require_absent(options.exr, options.settings.overwrites);
    summary.bytes +=
        write_pictures(session, developed.stack, "", options.exr, options.settings);
    if (developed.standard_error) {
      summary.bytes += write_pictures(session, *developed.standard_error, ".error", options.exr,
                                      options.settings);
    }
  }
  PipelineNotes notes(options.settings.tell);
  tell_developed(options, summary, notes);
  summary.notes = notes.all();
  return summary;
}

void add_to_report(const DevelopSessionOptions& options, const DevelopSummary& summary,
                   Report& report) {
  report.add_input(options.session);
  report.add_requested("demosaic", std::string(to_string(options.demosaic)));
  report.add_requested("memory_bytes",
                       static_cast<std::int64_t>(options.settings.memory_bytes));
  report.add_achieved("lights", std::int64_t{summary.dims.n_lights});
  report.add_achieved("bands", std::int64_t{summary.n_bands});
  report.add_achieved("saturated_in_all", static_cast<std::int64_t>(summary.n_saturated));
  report.add_achieved("moved_share", summary.moved_fraction);
  report.add_detail("steps", summary.record);
  report.set_bytes(summary.bytes);
}

}  // namespace haarlight::relight
