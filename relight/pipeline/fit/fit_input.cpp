// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/fit/fit_input.h"

#include <utility>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/relight/light/near_light.h"
#include "relight/reflectance/fit/picture_files.h"

namespace haarlight::relight {

namespace {

namespace fs = std::filesystem;

void add_match(const session::LightList& list, PipelineNotes& notes) {
  for (const std::string& warning : list.disagreements) {
    notes.add(NoteKind::warning, warning);
  }
  for (const std::string& note : list.notes) {
    notes.add(NoteKind::note, note);
  }
}

FitInput open_pictures(const FitOptions& options, PipelineNotes& notes) {
  session::LightList list = session::read_light_file(options.lights, options.coordinates);
  const std::vector<session::LightPicture> pictures =
      session::match_pictures(options.capture, options.lights, list, options.match);
  (void)session::hashes_of_different(pictures, pictures.size());
  FitInput input;
  std::vector<fs::path> files;
  std::vector<PictureFacts> facts;
  std::vector<int> orientations;
  for (std::size_t k = 0; k < pictures.size(); ++k) {
    files.push_back(pictures[k].path);
    input.directions.push_back(list.lights[k].coordinates.normalized());
    facts.push_back(read_picture_facts(pictures[k].path));
    orientations.push_back(facts.back().orientation);
  }
  input.photographed = session::tell_facts(facts, list.notes, list.disagreements);
  PictureFilesOptions file_options;
  file_options.memory_bytes = options.settings.memory_bytes / 4;
  if (!options.out.empty()) {
    file_options.work_folder = fs::absolute(options.out).parent_path();
  }
  PictureFiles opened = picture_rows(files, file_options);
  if (!opened.profile.empty()) {
    list.notes.push_back(fmt::format(
        "the pictures' colour profile (\"{}\") is applied: the fit's colours are sRGB's",
        opened.profile));
  }
  add_match(list, notes);
  input.rows = std::move(opened.rows);
  if (options.crop) {
    require_same_orientation(files, orientations);
    const StackDims shape = input.rows->dims();
    input.rows = cropped_rows(std::move(input.rows),
                              stored_rectangle(*options.crop, shape.width, shape.height,
                                               orientations.front(), "--crop"));
  }
  return input;
}

FitInput open_session(const FitOptions& options) {
  if (options.crop) {
    throw Error("a session's pictures cannot be cropped", "--crop",
                "crop them when they are imported: haarlight import --crop", ExitCode::usage);
  }
  FitInput input;
  input.session = std::make_unique<session::Session>(session::Session::open(options.capture));
  SessionRowsOptions row_options;
  // Fall-off is divided out in linear light; fitted values are coded after that.
  const bool is_linear = options.transfer == Transfer::linear || options.near.has_value();
  row_options.transfer = is_linear ? Transfer::linear : Transfer::srgb;
  row_options.develop.memory_bytes = options.settings.memory_bytes;
  input.rows = session_rows(*input.session, row_options);
  input.directions = picture_directions(*input.session);
  input.photographed = input.session->info().photographed;
  return input;
}

}  // namespace

FitInput open_fit_input(const FitOptions& options, PipelineNotes& notes) {
  return options.lights.empty() ? open_session(options) : open_pictures(options, notes);
}

}  // namespace haarlight::relight
