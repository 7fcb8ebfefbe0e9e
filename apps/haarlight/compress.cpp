// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight compress SESSION -o BASIS`: develops a session and compresses it over the lights.

#include <exception>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <malloc.h>

#include "apps/haarlight/options/develop_options.h"
#include "apps/haarlight/options/pipeline_words.h"
#include "apps/haarlight/verb.h"
#include "core/ranks.h"
#include "relight/basis/light_basis.h"
#include "relight/pipeline/compress_pipeline.h"

namespace haarlight::apps {

namespace {

/// All that compress can write.
std::vector<std::string> writable_bases() {
  std::vector<std::string> words;
  for (const relight::KnownBasis& known : relight::known_bases()) {
    if (known.kind) {
      words.emplace_back(known.word);
    }
  }
  return words;
}

/// One of `ranks` processes' part; the first speaks for all.
ExitCode compress_part(relight::CompressCaptureOptions options, const CommonOptions& common,
                       const Ranks& ranks, Report& report) {
  options.rank = {ranks.i(), ranks.n(), [&ranks] { ranks.wait_for_all(); }};
  options.settings = pipeline_settings(common);
  if (ranks.i() != 0) {
    options.settings.progress = ProgressStyle::none;
    options.settings.tell = {};
  }
  const relight::CompressCaptureSummary summary = relight::compress_capture(options);
  relight::add_to_report(options, summary, report);
  if (ranks.i() == 0) {
    tell_next(common, {"view", options.output});
  }
  return summary.compressed.is_achieved() ? ExitCode::done : ExitCode::target_missed;
}

/// Rows and tiles come and go: what one frees serves the next, instead of going back to the
/// system, which would clear it again page by page.
void keep_freed_memory() {
  constexpr int kAtMost = 1 << 30;  // at the end of the heap
  (void)::mallopt(M_MMAP_MAX, 0);   // pieces of any size come from the heap
  (void)::mallopt(M_TRIM_THRESHOLD, kAtMost);
}

ExitCode run_compress(const relight::CompressCaptureOptions& arguments,
                      const CommonOptions& common, Report& report) {
  keep_freed_memory();
  const Ranks ranks;
  if (ranks.i() != 0) {
    report.leave_to_others();
  }
  try {
    return compress_part(arguments, common, ranks, report);
  } catch (const std::exception& error) {
    if (ranks.n() > 1) {  // the others would wait for this one
      fmt::print(stderr, "haarlight compress, process {} of {}: {}\n", ranks.i() + 1, ranks.n(),
                 error.what());
      const auto* ours = dynamic_cast<const Error*>(&error);
      ranks.abort(static_cast<int>(ours != nullptr ? ours->code() : ExitCode::internal));
    }
    throw;
  }
}

}  // namespace

void add_compress(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<relight::CompressCaptureOptions>();
  relight::CompressCaptureOptions& options = *arguments;
  Command verb =
      root.add_verb("compress", "Compress a session over its lights to a basis file");
  verb.option("SESSION", &options.session, "Session folder", {.is_required = true});
  verb.option("-o,--output", &options.output, "Basis file to write",
              {.type = "BASIS.hlb", .is_required = true});
  verb.option("--max-error", &options.max_error,
              "Relative L2 error of the whole stack; 0 is exact, bit for bit (default: the "
              "capture's own noise, or 0.01 where nobody measured it)",
              {.bounds = Bounds{0.0, 1.0}});
  verb.flag("--whole-steps", &options.is_integer,
            "Every value as a whole number of the camera's steps, exactly (16-bit lossless)");
  verb.option("--worst-pixel", &options.worst_pixel,
              "Bound on every pixel's own relative error (default: none)",
              {.bounds = Bounds{}});
  verb.option("--plate", &options.plate,
              "Clean plate: a .hlb, a session of the empty rig, or none (default: computed "
              "from the session's rig)",
              {.type = "FILE|SESSION|none"});
  verb.option("--basis", &options.basis,
              "haar, haar-standard (powers of two), dct: lights in grids of rows and columns; "
              "direct: the lights themselves, any of them; auto: haar where it can be had",
              {.choices = writable_bases(), .none = "auto", .shows_default = true});
  add_transfer_option(verb, options.unknown_as);
  verb.footer(
      "Killed, it goes on where it was when the same command is given again.\n\n"
      "Examples:\n"
      "  haarlight compress sessions/airplane -o airplane.hlb --max-error 0.01\n"
      "  haarlight compress sessions/airplane -o archive.hlb --whole-steps\n"
      "  haarlight compress sessions/coin -o coin.hlb --basis direct --plate none\n"
      "  haarlight compress sessions/airplane -o dct.hlb --basis dct --max-error 0.01\n"
      "  mpirun -n 4 haarlight compress sessions/airplane -o airplane.hlb");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_compress(*arguments, common, report);
  });
}

}  // namespace haarlight::apps
