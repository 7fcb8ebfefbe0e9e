// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight plate RIG -o P.hlb`: the clean plate of a rig, computed in closed form.

#include <fmt/format.h>

#include "apps/haarlight/verb.h"
#include "core/counted.h"
#include "core/log.h"
#include "haarlight/core/files.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/relight/basis/compress_session.h"

namespace haarlight::apps {

namespace {

struct PlateArguments {
  std::string rig;
  std::string output;
  double max_error = 1e-4;
};

ExitCode run_plate(const PlateArguments& arguments, const CommonOptions& common,
                   Report& report) {
  report.add_input(arguments.rig);
  report.add_requested("relative_l2", arguments.max_error);
  require_absent(arguments.output, common.force);
  const Rig rig = read_rig(arguments.rig);
  relight::CompressOptions options;
  options.relative_l2 = arguments.max_error;
  options.memory_bytes = common.memory_bytes;
  options.progress = common.progress();
  const relight::CompressSummary summary =
      relight::compress_plate(rig, arguments.output, options);
  const relight::BasisHeader& header = summary.header;
  report.add_achieved("relative_l2", header.achieved.relative_l2);
  report.add_achieved("worst_pixel", header.achieved.worst_pixel);
  report.add_detail("rank", std::int64_t{header.plate_rank});
  report.add_detail("degree", std::int64_t{header.plate_degree});
  report.add_detail("checked_pixels", std::int64_t{summary.n_checked});
  report.add_detail("checked_error", summary.checked_error);
  report.set_bytes(summary.bytes);
  fmt::print("{}: {} x {} pixels, {}, {}, relative error {:.2g}, {} bytes\n", arguments.output,
             header.dims.width, header.dims.height, counted(header.dims.n_lights, "light"),
             counted(header.plate_rank, "vector"), header.achieved.relative_l2, summary.bytes);
  if (!summary.is_achieved()) {
    log_error(
        fmt::format("an error of {:.3g} was requested and is not kept", arguments.max_error));
    return ExitCode::target_missed;
  }
  return ExitCode::done;
}

}  // namespace

void add_plate(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<PlateArguments>();
  Command verb =
      root.add_verb("plate", "Compute the clean plate: the empty plane under every light");
  verb.option("RIG", &arguments->rig, "Rig file", {.type = "RIG.toml", .is_required = true});
  verb.option("-o,--output", &arguments->output, "Basis file to write",
              {.type = "P.hlb", .is_required = true});
  verb.option("--max-error", &arguments->max_error, "Relative L2 error; 0 is exact",
              {.bounds = Bounds{0.0, 1.0}, .shows_default = true});
  verb.footer("Example:\n  haarlight plate configs/rigs/cube32.toml -o cube32.hlb");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_plate(*arguments, common, report);
  });
}

}  // namespace haarlight::apps
