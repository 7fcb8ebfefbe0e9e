// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight compress SESSION -o BASIS`: develops a session and compresses it over the lights.

#include <algorithm>
#include <exception>
#include <limits>
#include <optional>

#include <fmt/format.h>

#include "apps/haarlight/clipped_words.h"
#include "apps/haarlight/develop_options.h"
#include "apps/haarlight/verb.h"
#include "core/files.h"
#include "core/log.h"
#include "core/ranks.h"
#include "relight/basis/compress_session.h"
#include "session/session.h"

namespace haarlight {

namespace {

struct CompressArguments {
  std::string session;
  std::string output;
  std::optional<double> max_error;
  std::optional<double> worst_pixel;
  bool is_integer = false;
  std::string plate;
  std::string basis = "auto";
  std::string transfer;
};

struct ErrorAsked {
  double relative_l2 = 0.0;
  std::string reason;
};

/// --max-error, or what stands for it.
ErrorAsked choose_error(const CompressArguments& arguments, const Session& session,
                        const PlateChoice& plate, const CompressOptions& options,
                        Report& report) {
  constexpr double kWithoutNoise = 0.01;
  constexpr double kLeast = 1e-4;
  if (arguments.is_integer) {
    return {std::numeric_limits<double>::infinity(), "whole steps of the camera, exactly"};
  }
  if (arguments.max_error) {
    return {*arguments.max_error, "as asked"};
  }
  const std::optional<double> noise = measure_noise(session, plate, options);
  if (!noise) {
    return {kWithoutNoise, "the default: nobody measured the camera's noise"};
  }
  report.add_detail("noise", *noise);
  return {std::clamp(kNoiseTarget * *noise, kLeast, 1.0),
          fmt::format("{:g} times the capture's noise", kNoiseTarget)};
}

/// --basis, or the one that the lights allow. @param tells  whether this process says which
BasisKind choose_basis(const CompressArguments& arguments, const Session& session, bool tells) {
  constexpr std::string_view kNoGrid =
      "its lights form no grids of rows and columns (at most 1024 of each)";
  const bool is_grid = haar_grid(session.info()).size() > 0;
  if (arguments.basis == "direct" || (arguments.basis == "auto" && !is_grid)) {
    if (arguments.basis == "auto" && tells) {
      log_warning(fmt::format("{}: {}: the basis is direct, the lights themselves",
                              arguments.session, kNoGrid));
    }
    return BasisKind::direct;
  }
  if (!is_grid) {
    throw Error(std::string(kNoGrid), arguments.session,
                "use --basis direct, which takes any lights; an import learns of grids by "
                "--grid ROWSxCOLUMNS");
  }
  return BasisKind::haar;
}

/// One of `ranks` processes' part; the first speaks for all.
ExitCode compress_part(const CompressArguments& arguments, const CommonOptions& common,
                       const Ranks& ranks, Report& report) {
  report.add_input(arguments.session);
  CompressOptions options;
  if (arguments.worst_pixel) {
    options.worst_pixel = *arguments.worst_pixel;
  }
  options.unknown_as = transfer_asked(arguments.transfer);
  options.memory_bytes = common.memory_bytes;
  options.rank = {ranks.i(), ranks.n(), [&ranks] { ranks.wait_for_all(); }};
  options.progress = ranks.i() == 0 ? common.progress() : ProgressStyle::none;
  report.add_asked("worst_pixel", options.worst_pixel);
  report.add_asked("basis", arguments.basis);
  report.add_asked("plate", arguments.plate.empty() ? "automatic" : arguments.plate);
  require_absent(arguments.output, common.force);
  const PlateChoice plate = PlateChoice::parse(arguments.plate);
  const Session session = Session::open(arguments.session);
  options.basis = choose_basis(arguments, session, ranks.i() == 0);
  const ErrorAsked asked = choose_error(arguments, session, plate, options, report);
  options.relative_l2 = asked.relative_l2;
  options.is_integer = arguments.is_integer;
  report.add_asked("relative_l2", options.relative_l2);
  report.add_detail("relative_l2_from", asked.reason);
  const CompressSummary summary = compress_session(session, plate, arguments.output, options);
  const BasisHeader& header = summary.header;
  report.add_reached("relative_l2", header.reached.relative_l2);
  report.add_reached("worst_pixel", header.reached.worst_pixel);
  report.add_reached("worst_value", header.reached.worst_value);
  report.add_reached("worst_light", summary.worst_light);
  report_clipped(header, report);
  report.add_detail("coding", std::string(to_string(header.coding)));
  report.add_detail("plate", std::string(to_string(header.plate)));
  report.add_detail("plate_rank", std::int64_t{header.plate_rank});
  report.add_detail("coefficients_per_pixel", header.mean_coefficients);
  report.add_detail("seconds_plate", summary.seconds_plate);
  report.add_detail("seconds_looked", summary.seconds_looked);
  report.add_detail("seconds_coded", summary.seconds_coded);
  report.add_detail("seconds_written", summary.seconds_written);
  report.add_detail("bytes_moved", static_cast<std::int64_t>(summary.bytes_moved));
  report.add_detail("processes", std::int64_t{ranks.n()});
  report.add_detail("tile_rows_found", std::int64_t{summary.n_rows_found});
  report.set_bytes(summary.bytes);
  const ExitCode code = summary.is_reached() ? ExitCode::done : ExitCode::target_missed;
  if (ranks.i() != 0) {
    return code;
  }
  const double raw =
      2.0 * double(header.dims.n_pixels()) * header.dims.channels * header.dims.n_lights;
  const bool is_smaller = raw >= double(summary.bytes);
  fmt::print(
      "{}: {} x {} pixels, {} channels, {} lights; {} basis, plate: {}\n"
      "  relative error {:.3g} within {:.3g}, {} (worst pixel {:.3g}, worst light {:.3g}), "
      "{:.1f} coefficients a pixel\n"
      "  {} bytes, {:.1f} times {} than 16-bit pictures{}\n",
      arguments.output, header.dims.width, header.dims.height, header.dims.channels,
      header.dims.n_lights, to_string(header.basis), to_string(header.plate),
      header.reached.relative_l2, asked.relative_l2, asked.reason, header.reached.worst_pixel,
      summary.worst_light, header.mean_coefficients, summary.bytes,
      is_smaller ? raw / double(summary.bytes) : double(summary.bytes) / raw,
      is_smaller ? "smaller" : "larger",
      !is_smaller && header.coding == BasisCoding::lossless
          ? "; --whole-steps keeps what the camera gave, and is smaller"
          : "");
  fmt::print("{}", clipped_words(header));
  tell_next(common, {"view", arguments.output});
  return code;
}

ExitCode run_compress(const CompressArguments& arguments, const CommonOptions& common,
                      Report& report) {
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
  auto arguments = std::make_shared<CompressArguments>();
  Command verb =
      root.add_verb("compress", "Compress a session over its lights to a basis file");
  verb.option("SESSION", &arguments->session, "Session folder", {.is_required = true});
  verb.option("-o,--output", &arguments->output, "Basis file to write",
              {.type = "BASIS.hlb", .is_required = true});
  verb.option("--max-error", &arguments->max_error,
              "Relative L2 error of the whole stack; 0 is exact, bit for bit (default: the "
              "capture's own noise, or 0.01 where nobody measured it)",
              {.bounds = Bounds{0.0, 1.0}});
  verb.flag("--whole-steps", &arguments->is_integer,
            "Every value as a whole number of the camera's steps, exactly (16-bit lossless)");
  verb.option("--worst-pixel", &arguments->worst_pixel,
              "Bound on every pixel's own relative error (default: none)",
              {.bounds = Bounds{}});
  verb.option("--plate", &arguments->plate,
              "Clean plate: a .hlb, a session of the empty rig, or none (default: computed "
              "from the session's rig)",
              {.type = "FILE|SESSION|none"});
  verb.option("--basis", &arguments->basis,
              "haar: lights in grids of rows and columns; direct: the lights "
              "themselves, any of them; auto: haar where it can be had",
              {.choices = {"auto", "haar", "direct"}, .shows_default = true});
  add_transfer_option(verb, arguments->transfer);
  verb.footer(
      "Killed, it goes on where it was when the same command is given again.\n\n"
      "Examples:\n"
      "  haarlight compress sessions/airplane -o airplane.hlb --max-error 0.01\n"
      "  haarlight compress sessions/airplane -o archive.hlb --whole-steps\n"
      "  haarlight compress sessions/coin -o coin.hlb --basis direct --plate none\n"
      "  mpirun -n 4 haarlight compress sessions/airplane -o airplane.hlb");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_compress(*arguments, common, report);
  });
}

}  // namespace haarlight
