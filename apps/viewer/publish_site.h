// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "apps/viewer/publish_folder.h"
#include "core/report.h"
#include "relight/pipeline/pipeline_settings.h"

/// @file
/// A basis file or a picture lit by direction as a folder that any web server shows: the terms
/// or tiles that are kept, and what that costs.

namespace haarlight::apps {

struct PublishSiteOptions {
  std::string file;                       ///< basis file, .ptm, .rti, folder with info.json
  std::string out;                        ///< folder to make
  std::string web;                        ///< folder of the pages, as installed
  std::vector<std::string> environments;  ///< of a basis file
  std::optional<int> terms;               ///< of a basis file: keep so many
  std::optional<double> max_error;        ///< of a basis file: as few terms as this allows
  std::optional<int> quality;             ///< of a picture lit by direction: JPEG; nothing: PNG
  PublishNotes notes;                     ///< mm_per_pixel: of a picture lit by direction
  relight::PipelineSettings settings;
};

struct PublishSiteSummary {
  bool is_object = false;         ///< a picture lit by direction
  double error = 0.0;             ///< basis: over the pictures of all lights together, at most
  int terms = 0;                  ///< basis: kept
  bool is_error_kept = true;      ///< basis: at most max_error
  std::optional<double> psnr_db;  ///< object: of JPEG tiles
  std::uint64_t bytes = 0;
  std::size_t files = 0;
  std::vector<relight::PipelineNote> notes;  ///< all that was told
};

/// @throws Error(usage)  options of the other kind of file; a folder that stands there
/// @throws Error  files that cannot be read
[[nodiscard]] PublishSiteSummary publish_site(const PublishSiteOptions& options);

/// What was requested and achieved.
void add_to_report(const PublishSiteOptions& options, const PublishSiteSummary& summary,
                   Report& report);

}  // namespace haarlight::apps
