// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight publish FILE -o DIR`: a folder that any web server shows.

#include <fmt/format.h>

#include "apps/haarlight/options/pipeline_words.h"
#include "apps/haarlight/step_before.h"
#include "apps/haarlight/verb.h"
#include "apps/page_folder.h"
#include "apps/viewer/publish_site.h"
#include "haarlight/relight/reflectance/formats/reflectance_file.h"

namespace haarlight::apps {

namespace {

ExitCode run_publish(PublishSiteOptions options, const CommonOptions& common, Report& report) {
  if (options.web.empty()) {
    options.web = find_page_folder().string();
  }
  if (options.web.empty()) {
    throw Error("the folder of the page's files is missing", "haarlight publish",
                "install the program whole, or name the folder with --web", ExitCode::io);
  }
  if (!relight::recognise_reflectance(options.file)) {
    refuse_step_before(options.file, "publish");
  }
  options.settings = pipeline_settings(common);
  const PublishSiteSummary summary = publish_site(options);
  add_to_report(options, summary, report);
  if (!common.quiet) {
    fmt::print(
        "  to look at it: python3 -m http.server --directory {}, then "
        "http://localhost:8000/\n",
        options.out);
  }
  return summary.is_error_kept ? ExitCode::done : ExitCode::target_missed;
}

}  // namespace

void add_publish(Command root, Invocation& invocation) {
  auto options = std::make_shared<PublishSiteOptions>();
  Command verb = root.add_verb(
      "publish", "Make a folder that any web server shows: relight in the browser");
  verb.option("FILE", &options->file,
              "Basis file, or a picture lit by direction: .ptm, .rti, folder with info.json",
              {.type = "BASIS.hlb", .is_required = true});
  verb.option("-o,--output", &options->out, "Folder to make",
              {.type = "DIR", .is_required = true});
  verb.option("--environment,--cubemap", &options->environments,
              "Of a basis file: a picture of a room or sky to light it with; may be repeated",
              {.type = "FILE"});
  verb.option("--terms", &options->terms,
              "Of a basis file: keep this many terms, those with most light",
              {.bounds = Bounds{1.0, 1e6}});
  verb.option("--max-error", &options->max_error,
              "Of a basis file: keep as few terms as this relative error allows",
              {.bounds = Bounds{0.0, 1.0}});
  verb.option(
      "--quality", &options->quality,
      "Of a picture lit by direction: JPEG tiles of this quality (default: PNG, nothing "
      "is lost)",
      {.bounds = Bounds{1.0, 100.0}});
  verb.option("--mm-per-pixel", &options->notes.mm_per_pixel,
              "Of a picture lit by direction: for its scale bar",
              {.bounds = Bounds{1e-9, 1e9}});
  verb.option("--title", &options->notes.title, "What the page is called");
  verb.option("--description", &options->notes.description, "A few words on the object");
  verb.option("--author", &options->notes.author, "Who made it");
  verb.option("--licence", &options->notes.licence, "What others may do with it");
  verb.option("--web", &options->web,
              "Folder of the pages (default: the one installed with the program)",
              {.type = "DIR"});
  verb.footer(
      "The page loads nothing but the folder's own files. It needs a web server: opened as a "
      "file it stays empty.\n"
      "--force replaces a folder that publish made.\n"
      "Examples:\n"
      "  haarlight publish airplane.hlb -o airplane-site --environment apartment.hdr\n"
      "  haarlight publish airplane.hlb -o airplane-small --max-error 0.1 --title 'Airplane'\n"
      "  haarlight publish coin.ptm -o coin-site --title 'Coin' --mm-per-pixel 0.02");
  finish_verb(verb, invocation, [options](const CommonOptions& common, Report& report) {
    return run_publish(*options, common, report);
  });
}

}  // namespace haarlight::apps
