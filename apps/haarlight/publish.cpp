// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight publish FILE -o DIR`: a folder that any web server shows.

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <fmt/format.h>

#include "apps/haarlight/step_before.h"
#include "apps/haarlight/verb.h"
#include "apps/page_folder.h"
#include "apps/viewer/publish_basis.h"
#include "apps/viewer/publish_folder.h"
#include "apps/viewer/publish_object.h"
#include "core/log.h"
#include "relight/reflectance/formats/reflectance_file.h"
#include "relight/reflectance/formats/web_folder.h"

namespace haarlight {

namespace {

struct PublishArguments {
  std::string file;
  std::string out;
  std::string web;
  std::vector<std::string> environments;
  std::optional<int> terms;
  std::optional<double> max_error;
  std::optional<int> quality;
  PublishNotes notes;
};

/// Of a file or folder, also where a slash ends it.
std::string last_name(const std::filesystem::path& path) {
  return (path.has_filename() ? path : path.parent_path()).filename().string();
}

ExitCode publish_basis_file(const PublishArguments& arguments, const CommonOptions& common,
                            PublishFolder& folder, Report& report) {
  const BasisFile basis = BasisFile::open(arguments.file);
  PublishBasisOptions options;
  options.terms = arguments.terms;
  options.max_error = arguments.max_error;
  options.environments = arguments.environments;
  options.progress = common.progress();
  PublishNotes notes = arguments.notes;
  notes.photographed = words_of(basis.header().photographed);
  const PublishedBasis found = publish_basis(basis, folder, options, notes);
  fmt::print("{}: {:.1f} MB in {} files, {} of {} terms\n", arguments.out,
             1e-6 * static_cast<double>(folder.bytes()), folder.files(), found.terms,
             found.terms_all);
  fmt::print(
      "  error over the pictures of all lights together at most {:.3g} (the file's own: "
      "{:.3g})\n",
      found.error, found.own_error);
  report.add_reached("relative_l2", found.error);
  report.add_reached("terms", std::int64_t{found.terms});
  if (arguments.max_error) {
    report.add_asked("relative_l2", *arguments.max_error);
    if (found.error > *arguments.max_error) {
      log_warning(fmt::format(
          "an error of {:.3g} cannot be promised from this file: {}", *arguments.max_error,
          found.terms < found.terms_all ? "give more --terms"
                                        : "compress with a smaller --max-error"));
      return ExitCode::target_missed;
    }
  }
  return ExitCode::done;
}

ExitCode publish_object_file(const PublishArguments& arguments, const CommonOptions& common,
                             PublishFolder& folder, Report& report) {
  const std::filesystem::path file = arguments.file;
  PublishNotes notes = arguments.notes;
  if (!notes.mm_per_pixel && is_web_folder(file)) {
    notes.mm_per_pixel = web_mm_per_pixel(file);
  }
  // A third of the planes' memory goes to the coarser levels, and some to tiles under work.
  const ReflectanceModel model =
      read_reflectance(file, {.most_bytes = common.memory_bytes / 3 * 2});
  notes.photographed = words_of(model.photographed);
  const PublishedObject found =
      publish_object(model, last_name(file), folder,
                     {.quality = arguments.quality, .progress = common.progress()}, notes);
  fmt::print("{}: {:.1f} MB in {} files, {} x {} pixels in {} level{} of tiles\n",
             arguments.out, 1e-6 * static_cast<double>(folder.bytes()), folder.files(),
             model.planes.width(), model.planes.height(), found.levels,
             found.levels == 1 ? "" : "s");
  if (found.psnr_db) {
    fmt::print("  pictures are {:.1f} dB from the file's: JPEG tiles\n", *found.psnr_db);
    report.add_reached("psnr_db", *found.psnr_db);
  } else if (!arguments.quality) {
    fmt::print("  nothing is lost: PNG tiles; --quality 90 makes smaller ones\n");
  }
  if (!found.has_info) {
    fmt::print("  OpenLIME has no word for {} of {} terms: the page alone shows it\n",
               to_string(model.basis), model.n_terms);
  }
  report.add_detail("peak memory bytes", static_cast<std::int64_t>(peak_memory_bytes()));
  return ExitCode::done;
}

/// Options that the other kind of file takes.
void require_matching_options(const PublishArguments& arguments, bool is_object) {
  const auto refuse = [&](bool is_given, const char* option, const char* of) {
    if (is_given) {
      throw Error(fmt::format("an option of {}", of), option, "leave it out", ExitCode::usage);
    }
  };
  if (is_object) {
    refuse(!arguments.environments.empty(), "--environment", "a basis file");
    refuse(arguments.terms.has_value(), "--terms", "a basis file");
    refuse(arguments.max_error.has_value(), "--max-error", "a basis file");
  } else {
    refuse(arguments.quality.has_value(), "--quality", "a picture lit by direction");
    refuse(arguments.notes.mm_per_pixel.has_value(), "--mm-per-pixel",
           "a picture lit by direction");
  }
}

ExitCode run_publish(const PublishArguments& arguments, const CommonOptions& common,
                     Report& report) {
  report.add_input(arguments.file);
  for (const std::string& environment : arguments.environments) {
    report.add_input(environment);
  }
  const std::filesystem::path web =
      arguments.web.empty() ? find_page_folder() : std::filesystem::path(arguments.web);
  if (web.empty()) {
    throw Error("the folder of the page's files is missing", "haarlight publish",
                "install the program whole, or name the folder with --web", ExitCode::io);
  }
  const bool is_object = recognise_reflectance(arguments.file).has_value();
  if (!is_object) {
    refuse_step_before(arguments.file, "publish");
  }
  require_matching_options(arguments, is_object);
  PublishFolder folder(arguments.out, web, common.force);
  const ExitCode code = is_object ? publish_object_file(arguments, common, folder, report)
                                  : publish_basis_file(arguments, common, folder, report);
  report.set_bytes(folder.bytes());
  report.add_detail("files", static_cast<std::int64_t>(folder.files()));
  if (!common.quiet) {
    fmt::print(
        "  to look at it: python3 -m http.server --directory {}, then "
        "http://localhost:8000/\n",
        arguments.out);
  }
  return code;
}

}  // namespace

void add_publish(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<PublishArguments>();
  Command verb = root.add_verb(
      "publish", "Make a folder that any web server shows: relight in the browser");
  verb.option("FILE", &arguments->file,
              "Basis file, or a picture lit by direction: .ptm, .rti, folder with info.json",
              {.type = "BASIS.hlb", .is_required = true});
  verb.option("-o,--output", &arguments->out, "Folder to make",
              {.type = "DIR", .is_required = true});
  verb.option("--environment,--cubemap", &arguments->environments,
              "Of a basis file: a picture of a room or sky to light it with; may be repeated",
              {.type = "FILE"});
  verb.option("--terms", &arguments->terms,
              "Of a basis file: keep this many terms, those with most light",
              {.bounds = Bounds{1.0, 1e6}});
  verb.option("--max-error", &arguments->max_error,
              "Of a basis file: keep as few terms as this relative error allows",
              {.bounds = Bounds{0.0, 1.0}});
  verb.option(
      "--quality", &arguments->quality,
      "Of a picture lit by direction: JPEG tiles of this quality (default: PNG, nothing "
      "is lost)",
      {.bounds = Bounds{1.0, 100.0}});
  verb.option("--mm-per-pixel", &arguments->notes.mm_per_pixel,
              "Of a picture lit by direction: for its scale bar",
              {.bounds = Bounds{1e-9, 1e9}});
  verb.option("--title", &arguments->notes.title, "What the page is called");
  verb.option("--description", &arguments->notes.description, "A few words on the object");
  verb.option("--author", &arguments->notes.author, "Who made it");
  verb.option("--licence", &arguments->notes.licence, "What others may do with it");
  verb.option("--web", &arguments->web,
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
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_publish(*arguments, common, report);
  });
}

}  // namespace haarlight
