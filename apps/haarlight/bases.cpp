// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight bases SESSION -o FOLDER`: compares bases on one's own capture.

#include "apps/haarlight/options/develop_options.h"
#include "apps/haarlight/options/pipeline_words.h"
#include "apps/haarlight/verb.h"
#include "relight/pipeline/bases_pipeline.h"

namespace haarlight::apps {

namespace {

ExitCode run_bases(relight::BasesOptions options, const CommonOptions& common, Report& report) {
  options.threads = common.threads;
  options.settings = pipeline_settings(common);
  const relight::BasesSummary summary = relight::compare_bases(options);
  relight::add_to_report(options, summary, report);
  return summary.is_achieved ? ExitCode::done : ExitCode::target_missed;
}

}  // namespace

void add_bases(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<relight::BasesOptions>();
  relight::BasesOptions& options = *arguments;
  Command verb = root.add_verb(
      "bases",
      "Compare bases over the lights on a capture: Haar, DCT, harmonics, PCA, CDF 5/3");
  verb.option("CAPTURE", &options.input, "Session folder, or a basis file",
              {.type = "SESSION|BASIS.hlb", .is_required = true});
  verb.option("-o,--output", &options.output,
              "Folder for bases.txt, bases.json, records.json, figures and regions.png",
              {.type = "FOLDER", .is_required = true});
  std::vector<std::string> names;
  for (const relight::KnownBasis& known : relight::known_bases()) {
    names.emplace_back(known.word);
  }
  verb.option("--basis", &options.bases, "Compare this one (again for more; default: all)",
              {.type = "NAME", .choices = names});
  verb.option("--error", &options.errors,
              "Relative L2 error to reach with each (again for more; default: 0.03 0.01 0.003)",
              {.type = "ERROR", .bounds = Bounds{1e-6, 1.0}});
  verb.option("--size", &options.sizes,
              "Numbers per pixel to spend with each (again for more; default: 4 16 64)",
              {.type = "NUMBERS", .bounds = Bounds{1e-3, 1e6}});
  verb.option("--plate", &options.plate,
              "Clean plate: a .hlb, a session of the empty rig, or none (default: computed "
              "from the capture's rig)",
              {.type = "FILE|SESSION|none"});
  verb.option(
      "--lightings", &options.lightings,
      "JSON object of names, each with one number per light (default: one, four and nine "
      "lights, smooth, high frequency)",
      {.type = "FILE.json"});
  verb.option("--regions", &options.regions,
              "Picture that says what each pixel is: red specular, green diffuse, blue "
              "attached, yellow cast shadow, black none (default: classified from the capture)",
              {.type = "MASK.png"});
  verb.option("--tiles", &options.n_tiles,
              "Study so many tiles of 128 pixels per side, spread over the picture; 0: all",
              {.bounds = Bounds{0.0, 1e9}, .shows_default = true});
  verb.option("--sh-order", &options.sh_order, "Highest order of the spherical harmonics",
              {.bounds = Bounds{0.0, 40.0}, .shows_default = true});
  verb.option("--pca-rank", &options.pca_rank, "The most vectors of PCA that are tried",
              {.bounds = Bounds{1.0, 4096.0}, .shows_default = true});
  add_transfer_option(verb, options.unknown_as);
  verb.footer(
      "What the columns mean: docs/numerics/bases.md.\n"
      "Examples:\n"
      "  haarlight bases sessions/airplane -o airplane-bases\n"
      "  haarlight bases airplane.hlb -o quick --basis haar --basis pca --error 0.01 --tiles "
      "4");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_bases(*arguments, common, report);
  });
}

}  // namespace haarlight::apps
