// SPDX-License-Identifier: Apache-2.0
#include "apps/viewer/publish_site.h"

#include <filesystem>

#include <fmt/format.h>

#include "apps/viewer/publish_basis.h"
#include "apps/viewer/publish_object.h"
#include "core/counted.h"
#include "haarlight/core/error.h"
#include "haarlight/relight/reflectance/formats/reflectance_file.h"
#include "haarlight/relight/reflectance/formats/web_folder.h"

namespace haarlight::apps {

namespace {

/// Of a file or folder, also where a slash ends it.
std::string last_name(const std::filesystem::path& path) {
  return (path.has_filename() ? path : path.parent_path()).filename().string();
}

/// Options that the other kind of file takes.
void require_matching_options(const PublishSiteOptions& options, bool is_object) {
  const auto refuse = [&](bool is_given, const char* option, const char* of) {
    if (is_given) {
      throw Error(fmt::format("an option of {}", of), option, "leave it out", ExitCode::usage);
    }
  };
  if (is_object) {
    refuse(!options.environments.empty(), "--environment", "a basis file");
    refuse(options.terms.has_value(), "--terms", "a basis file");
    refuse(options.max_error.has_value(), "--max-error", "a basis file");
  } else {
    refuse(options.quality.has_value(), "--quality", "a picture lit by direction");
    refuse(options.notes.mm_per_pixel.has_value(), "--mm-per-pixel",
           "a picture lit by direction");
  }
}

std::string size_words(const PublishSiteOptions& options, const PublishFolder& folder) {
  return fmt::format("{}: {:.1f} MB in {}", options.out,
                     1e-6 * static_cast<double>(folder.bytes()),
                     counted(folder.files(), "file"));
}

void publish_basis_file(const PublishSiteOptions& options, PublishFolder& folder,
                        PublishSiteSummary& summary, relight::PipelineNotes& told) {
  const relight::BasisFile basis = relight::BasisFile::open(options.file);
  PublishBasisOptions how;
  how.terms = options.terms;
  how.max_error = options.max_error;
  how.environments = options.environments;
  how.progress = options.settings.progress;
  PublishNotes notes = options.notes;
  notes.photographed = words_of(basis.header().photographed);
  const PublishedBasis found = publish_basis(basis, folder, how, notes);
  summary.error = found.error;
  summary.terms = found.terms;
  summary.is_error_kept = !options.max_error || !(found.error > *options.max_error);
  told.add(relight::NoteKind::result,
           fmt::format("{}, {} of {}", size_words(options, folder), found.terms,
                       counted(found.terms_all, "term")));
  told.add(relight::NoteKind::result,
           fmt::format("  error over the pictures of all lights together at most {:.3g} (the "
                       "file's own: {:.3g})",
                       found.error, found.own_error));
  if (!summary.is_error_kept) {
    told.add(relight::NoteKind::failure,
             fmt::format(
                 "an error of {:.3g} cannot be promised from this file: {}", *options.max_error,
                 found.terms < found.terms_all ? "give more --terms"
                                               : "compress with a smaller --max-error"));
  }
}

void publish_object_file(const PublishSiteOptions& options, PublishFolder& folder,
                         PublishSiteSummary& summary, relight::PipelineNotes& told) {
  const std::filesystem::path file = options.file;
  PublishNotes notes = options.notes;
  if (!notes.mm_per_pixel && relight::is_web_folder(file)) {
    notes.mm_per_pixel = relight::web_mm_per_pixel(file);
  }
  // A third of the planes' memory goes to the coarser levels, and some to tiles under work.
  const relight::ReflectanceModel model =
      relight::read_reflectance(file, {.most_bytes = options.settings.memory_bytes / 3 * 2});
  notes.photographed = words_of(model.photographed);
  const PublishedObject found = publish_object(
      model, last_name(file), folder,
      {.quality = options.quality, .progress = options.settings.progress}, notes);
  summary.psnr_db = found.psnr_db;
  told.add(
      relight::NoteKind::result,
      fmt::format("{}, {} x {} pixels in {} of tiles", size_words(options, folder),
                  model.planes.width(), model.planes.height(), counted(found.levels, "level")));
  if (found.psnr_db) {
    told.add(
        relight::NoteKind::result,
        fmt::format("  pictures are {:.1f} dB from the file's: JPEG tiles", *found.psnr_db));
  } else if (!options.quality) {
    told.add(relight::NoteKind::result,
             "  nothing is lost: PNG tiles; --quality 90 makes smaller ones");
  }
  if (!found.has_info) {
    told.add(relight::NoteKind::result,
             fmt::format("  OpenLIME has no word for {} of {}: the page alone shows it",
                         to_string(model.basis), counted(model.n_terms, "term")));
  }
}

}  // namespace

PublishSiteSummary publish_site(const PublishSiteOptions& options) {
  PublishSiteSummary summary;
  relight::PipelineNotes told(options.settings.tell);
  summary.is_object = relight::recognise_reflectance(options.file).has_value();
  require_matching_options(options, summary.is_object);
  PublishFolder folder(options.out, options.web, options.settings.overwrites);
  if (summary.is_object) {
    publish_object_file(options, folder, summary, told);
  } else {
    publish_basis_file(options, folder, summary, told);
  }
  summary.bytes = folder.bytes();
  summary.files = static_cast<std::size_t>(folder.files());
  summary.notes = told.all();
  return summary;
}

void add_to_report(const PublishSiteOptions& options, const PublishSiteSummary& summary,
                   Report& report) {
  report.add_input(options.file);
  for (const std::string& environment : options.environments) {
    report.add_input(environment);
  }
  if (summary.is_object) {
    if (summary.psnr_db) {
      report.add_achieved("psnr_db", *summary.psnr_db);
    }
    report.add_detail("peak memory bytes", static_cast<std::int64_t>(peak_memory_bytes()));
  } else {
    report.add_achieved("relative_l2", summary.error);
    report.add_achieved("terms", std::int64_t{summary.terms});
    if (options.max_error) {
      report.add_requested("relative_l2", *options.max_error);
    }
  }
  report.set_bytes(summary.bytes);
  report.add_detail("files", static_cast<std::int64_t>(summary.files));
}

}  // namespace haarlight::apps
