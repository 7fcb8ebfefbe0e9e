/// @file
/// `haarlight plate RIG -o P.hlb`: the clean plate of a rig, computed in closed form.

#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include "apps/haarlight/verb.h"
#include "core/files.h"
#include "core/rig.h"
#include "relight/basis/compress_session.h"

namespace haarlight {

namespace {

struct PlateArguments {
  std::string rig;
  std::string output;
  double max_error = 1e-4;
};

}  // namespace

void add_plate(CLI::App& root, Invocation& invocation) {
  auto arguments = std::make_shared<PlateArguments>();
  CLI::App* verb = root.add_subcommand(
      "plate", "Compute the clean plate: the empty plane under every light");
  verb->add_option("RIG", arguments->rig, "Rig file")->required()->type_name("RIG.toml");
  verb->add_option("-o,--output", arguments->output, "Basis file to write")
      ->required()
      ->type_name("P.hlb");
  verb->add_option("--max-error", arguments->max_error, "Relative L2 error; 0 is exact")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  verb->footer("Example:\n  haarlight plate configs/rigs/cube32.toml -o cube32.hlb");
  add_common_options(*verb, invocation);
  verb->callback([arguments, &invocation] {
    invocation.command = "plate";
    invocation.run = [arguments, &invocation](Report& report) {
      report.add_input(arguments->rig);
      report.add_asked("relative_l2", arguments->max_error);
      require_absent(arguments->output, invocation.common.force);
      const Rig rig = read_rig(arguments->rig);
      CompressOptions options;
      options.relative_l2 = arguments->max_error;
      options.memory_bytes = invocation.common.memory_bytes;
      options.progress = invocation.common.progress();
      const CompressSummary summary = compress_plate(rig, arguments->output, options);
      report.add_reached("relative_l2", summary.header.reached.relative_l2);
      report.add_reached("worst_pixel", summary.header.reached.worst_pixel);
      report.add_detail("rank", std::int64_t{summary.header.plate_rank});
      report.set_bytes(summary.bytes);
      fmt::print("{}: {} x {} pixels, {} lights, {} vectors, relative error {:.2g}, {} bytes\n",
                 arguments->output, summary.header.dims.width, summary.header.dims.height,
                 summary.header.dims.n_lights, summary.header.plate_rank,
                 summary.header.reached.relative_l2, summary.bytes);
      return summary.is_reached() ? ExitCode::done : ExitCode::target_missed;
    };
  });
}

}  // namespace haarlight
