// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight convert IN OUT`: pictures that can be relit, from one program's format to
/// another's, or one picture of them under a light; and lists of lights.

#include "apps/haarlight/options/develop_options.h"
#include "apps/haarlight/options/pipeline_words.h"
#include "apps/haarlight/verb.h"
#include "relight/pipeline/convert_pipeline.h"

namespace haarlight::apps {

namespace {

struct ConvertArguments {
  relight::ConvertOptions options;
  std::vector<double> light;
};

ExitCode run_convert(const ConvertArguments& arguments, const CommonOptions& common,
                     Report& report) {
  relight::ConvertOptions options = arguments.options;
  if (!arguments.light.empty()) {
    options.light = Eigen::Vector3d(arguments.light.data());
  }
  options.settings = pipeline_settings(common);
  const relight::ConvertSummary summary = relight::convert_reflectance(options);
  relight::add_to_report(options, summary, report);
  if (summary.kind == relight::ConvertedKind::model) {
    tell_next(common, {"view", options.output});
  }
  return ExitCode::done;
}

}  // namespace

void add_convert(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<ConvertArguments>();
  relight::ConvertOptions& options = arguments->options;
  Command verb = root.add_verb(
      "convert", "Turn others' relightable pictures and light lists into one another");
  verb.option("IN", &options.input, ".ptm, .rti, folder with Relight's info.json; .lp, .dome",
              {.is_required = true});
  verb.option("OUT", &options.output,
              "By its name: .ptm, .rti, no ending for a web folder; .lp, .dome; a picture with "
              "--light",
              {.is_required = true});
  verb.option("--light", &arguments->light,
              "Write one picture (.png, .exr), lit from here: x right, y up, z to the camera",
              {.type = "X,Y,Z", .delimiter = ',', .count = 3});
  verb.flag("--jpeg", &options.is_jpeg, "Write the .ptm with JPEG pictures");
  verb.option("--quality", &options.quality, "Of JPEG pictures (default: 95, of a folder 97)",
              {.bounds = Bounds{1.0, 100.0}});
  verb.option("--basis", &options.basis, "Basis of a web folder (default: as IN)",
              {.choices = choices_of(
                   {relight::ReflectanceBasis::ptm, relight::ReflectanceBasis::hsh})});
  verb.option("--terms", &options.terms, "Terms of hsh: 4, 9 or 16 (default: as IN, else 9)",
              {.bounds = Bounds{4.0, 16.0}});
  verb.option("--transfer", &options.transfer,
              "What IN's colours are coded with, which files do not say; OUT is srgb",
              {.choices = known_transfers(), .shows_default = true});
  verb.option("--hsh-order4", &options.order4,
              "How IN's 16 terms are meant; rounded: as HSHFitter computes them",
              {.shows_default = true});
  verb.footer(
      "Another basis is fitted by least squares over directions; how far the pictures of IN "
      "and "
      "OUT are apart is measured and printed.\n"
      "Examples:\n"
      "  haarlight convert coin.ptm coin.rti\n"
      "  haarlight convert coin.ptm coin_web\n"
      "  haarlight convert coin.ptm coin.png --light -0.5,0.5,0.7\n"
      "  haarlight convert dome.lp dome.dome");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_convert(*arguments, common, report);
  });
}

}  // namespace haarlight::apps
