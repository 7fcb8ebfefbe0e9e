// SPDX-License-Identifier: Apache-2.0
#include "haarlight/session/import/import.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <ctime>
#include <limits>
#include <map>
#include <utility>

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "core/parallel.h"
#include "core/sha256.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "session/frame_check.h"
#include "session/frame_tiff.h"
#include "session/import/import_folder.h"
#include "session/import/picture_lights.h"
#include "session/import/position_grid.h"
#include "session/seal.h"

namespace haarlight::session {

namespace {

namespace fs = std::filesystem;

void check_finite(const Image<float>& pixels, const fs::path& path) {
  for (std::size_t i = 0; i < pixels.pixels().size(); ++i) {
    if (!std::isfinite(pixels.pixels()[i])) {
      const std::size_t pixel = i / static_cast<std::size_t>(pixels.channels());
      const auto width = static_cast<std::size_t>(pixels.width());
      throw Error(fmt::format("pixel (x {}, y {}) is not a finite number", pixel % width,
                              pixel / width),
                  path.string(), "repair or replace the picture");
    }
  }
}

/// A frame's numbers are linear or sRGB: those with another profile become linear floats,
/// unless the user says what they are. Finite.
PictureFile read_for_session(const fs::path& path, const ImportOptions& options) {
  PictureFile picture = read_picture(path);
  if (picture.colours != nullptr && !options.transfer) {
    PictureFile linear{
        .transfer = Transfer::linear, .facts = picture.facts, .profile = picture.profile};
    linear.pixels = linear_light(std::move(picture), path);
    picture = std::move(linear);
  }
  check_finite(picture.pixels, path);
  return picture;
}

/// For the whole picture in the file.
FrameForm form_of(const PictureFile& picture, const fs::path& path,
                  const ImportOptions& options) {
  FrameForm form;
  form.width = picture.pixels.width();
  form.height = picture.pixels.height();
  form.stored_height = form.height;
  form.channels = picture.pixels.channels();
  form.black_level = 0.0;
  if (picture.is_floating) {
    form.sample = SampleType::f32;
    form.white_level = 1.0;
    form.transfer = Transfer::linear;
    form.crop = crop_of_picture(path, form.width, form.height);  // of an earlier session
  } else {
    form.sample = picture.bits_per_sample == 8 ? SampleType::u8 : SampleType::u16;
    form.white_level = picture.bits_per_sample == 8 ? 255.0 : 65535.0;
    form.transfer = options.transfer.value_or(picture.transfer);
  }
  return form;
}

std::string words(const FrameForm& form) {
  const char* sample = form.sample == SampleType::u8
                           ? "8 bit"
                           : (form.sample == SampleType::u16 ? "16 bit" : "floating");
  std::string text = fmt::format("{} x {}, {}, {}, {}", form.width, form.height,
                                 form.channels == 1 ? "grey" : "RGB", sample,
                                 form.transfer == Transfer::srgb ? "sRGB" : "linear");
  if (form.crop) {
    text += fmt::format(", cut out of {} x {} at ({}, {})", form.crop->whole_width,
                        form.crop->whole_height, form.crop->x, form.crop->y);
  }
  return text;
}

void check_same_form(const FrameForm& form, const FrameForm& first, const fs::path& path,
                     const fs::path& first_path) {
  if (!(form == first)) {
    throw Error(
        fmt::format("{}; {} is {}", words(form), first_path.filename().string(), words(first)),
        path.string(), "all pictures of a session have one size and kind");
  }
}

/// What all pictures have in common: the first one's form, and the rectangles in it.
struct Frame {
  fs::path first;
  std::string profile;
  FrameForm whole;
  int orientation = 1;                  ///< from EXIF; matters only for rectangles
  std::optional<PixelRectangle> crop;   ///< of the stored pixels
  std::optional<PixelRectangle> white;  ///< of the stored pixels
};

Frame frame_of(const fs::path& first, const ImportOptions& options) {
  const PictureFile picture = read_for_session(first, options);
  Frame frame{
      first, picture.profile, form_of(picture, first, options), picture.facts.orientation, {},
      {}};
  const auto stored = [&](const PixelRectangle& rectangle, const char* option) {
    return stored_rectangle(rectangle, frame.whole.width, frame.whole.height, frame.orientation,
                            option);
  };
  if (options.crop) {
    frame.crop = stored(*options.crop, "--crop");
  }
  if (options.white) {
    frame.white = stored(options.white->patch, "--white");
  }
  return frame;
}

PictureFile read_in_frame(const fs::path& path, const Frame& frame,
                          const ImportOptions& options) {
  PictureFile picture = read_for_session(path, options);
  check_same_form(form_of(picture, path, options), frame.whole, path, frame.first);
  if (frame.crop || frame.white) {
    const std::array<fs::path, 2> paths = {frame.first, path};
    const std::array<int, 2> orientations = {frame.orientation, picture.facts.orientation};
    require_same_orientation(paths, orientations);
  }
  return picture;
}

/// What is learnt from the pictures before the first is written.
struct Survey {
  float largest = 0.0F;  ///< of all lights' values
  std::vector<PatchSample> patches;
};

PatchSample patch_of(const PictureFile& picture, const Frame& frame) {
  Image<float> patch = cut(picture.pixels, *frame.white);
  for (float& value : patch.pixels()) {
    value = frame.whole.transfer == Transfer::srgb ? linear_from_srgb(value) : value;
  }
  constexpr double kWhite = 1.0;
  return sample_patch(patch, kWhite);
}

Survey survey(const std::vector<LightPicture>& pictures, std::size_t n_lights,
              const Frame& frame, const ImportOptions& options) {
  std::vector<float> largest(pictures.size(), 0.0F);
  Survey seen;
  seen.patches.resize(frame.white ? pictures.size() : 0);
  parallel_for(pictures.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const PictureFile picture = read_in_frame(pictures[i].path, frame, options);
      if (i < n_lights) {
        largest[i] =
            *std::max_element(picture.pixels.pixels().begin(), picture.pixels.pixels().end());
      }
      if (frame.white) {
        seen.patches[i] = patch_of(picture, frame);
      }
    }
  });
  seen.largest = *std::max_element(largest.begin(), largest.end());
  return seen;
}

/// The dark pictures' mean patch is subtracted from the lights'.
std::vector<PatchSample> lit_patches(const Survey& seen, std::size_t n_lights) {
  std::vector<PatchSample> lit(seen.patches.begin(),
                               seen.patches.begin() + static_cast<std::ptrdiff_t>(n_lights));
  const auto n_dark = static_cast<double>(seen.patches.size() - n_lights);
  for (std::size_t i = n_lights; i < seen.patches.size(); ++i) {
    for (PatchSample& patch : lit) {
      for (std::size_t c = 0; c < patch.mean.size(); ++c) {
        patch.mean[c] -= seen.patches[i].mean[c] / n_dark;
      }
    }
  }
  return lit;
}

template <class T>
Image<T> to_integers(const Image<float>& pixels, float white) {
  Image<T> result(pixels.height(), pixels.width(), pixels.channels());
  for (std::size_t i = 0; i < pixels.pixels().size(); ++i) {
    result.pixels()[i] =
        static_cast<T>(std::lround(std::clamp(pixels.pixels()[i], 0.0F, 1.0F) * white));
  }
  return result;
}

/// Encodes one picture as a frame; fills in the pixel part of its evidence.
template <class T>
std::vector<std::byte> encode(const Image<T>& pixels, const FrameForm& form,
                              FrameDescription& description) {
  describe_pixels<T>(pixels.view(), form, description.evidence);
  return encode_frame_tiff(pixels.view(), frame_description_to_json(description));
}

std::vector<std::byte> encode_picture(const PictureFile& picture, const FrameForm& form,
                                      FrameDescription& description) {
  switch (form.sample) {
    case SampleType::u8:
      return encode(to_integers<std::uint8_t>(picture.pixels, 255.0F), form, description);
    case SampleType::u16:
      return encode(to_integers<std::uint16_t>(picture.pixels, 65535.0F), form, description);
    case SampleType::f32:
      break;
  }
  return encode(picture.pixels, form, description);
}

nlohmann::ordered_json to_json(const PixelRectangle& r) {
  return {r.x, r.y, r.width, r.height};
}

/// The request, with the sources' hashes: the session's plan.json.
std::string make_plan(const std::vector<LightPicture>& pictures, const std::string& lights,
                      const std::vector<std::string>& hashes, const ImportOptions& options,
                      const std::optional<WhiteReference>& white) {
  nlohmann::ordered_json plan;
  plan["schema"] = 1;
  plan["kind"] = "import";
  plan["lights"] = lights;
  if (options.crop) {
    plan["crop"] = to_json(*options.crop);
  }
  if (white) {
    nlohmann::ordered_json json = {{"patch", to_json(options.white->patch)}};
    if (options.white->reflectance) {
      json["reflectance"] = *options.white->reflectance;
    }
    json["gains"] = white->gains;
    json["scatter"] = white->scatter;
    json["lights_used"] = white->n_used;
    json["lights_clipped"] = white->n_clipped;
    json["lights_dark"] = white->n_dark;
    plan["white"] = json;
  }
  plan["pictures"] = nlohmann::ordered_json::array();
  for (std::size_t i = 0; i < pictures.size(); ++i) {
    plan["pictures"].push_back({{"name", pictures[i].name}, {"hash", hashes[i]}});
  }
  return plan.dump(1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
}

std::string now_text() {
  return fmt::format("{:%Y-%m-%dT%H:%M:%SZ}", fmt::gmtime(std::time(nullptr)));
}

/// Sorts into the order of the grid that the lights' positions form, if they form one.
void order_by_grid(const fs::path& light_file, LightList& list,
                   std::vector<LightPicture>& pictures, SessionInfo& info) {
  const std::optional<PositionGrid> grid = find_position_grid(list.lights);
  if (!grid) {
    return;
  }
  info.grid_rows = grid->rows;
  info.grid_cols = grid->cols;
  const bool is_as_listed = std::is_sorted(grid->order.begin(), grid->order.end());
  if (!is_as_listed) {
    const std::vector<SessionLight> lights = list.lights;
    const std::vector<LightPicture> listed = pictures;
    for (std::size_t k = 0; k < lights.size(); ++k) {
      const auto from = static_cast<std::size_t>(grid->order[k]);
      list.lights[k] = lights[from];
      pictures[k] = listed[from];
    }
  }
  list.notes.push_back(fmt::format("{}: the lights are a grid of {} x {}{}",
                                   light_file.filename().string(), grid->rows, grid->cols,
                                   is_as_listed ? "" : ", and are put in its order"));
}

void take_grid(const std::array<int, 2>& grid, std::size_t n_lights, SessionInfo& info) {
  const auto each = static_cast<std::size_t>(grid[0]) * static_cast<std::size_t>(grid[1]);
  if (grid[0] < 1 || grid[1] < 1 || n_lights % each != 0) {
    throw Error(fmt::format("{} lights are no grids of {} x {}", n_lights, grid[0], grid[1]),
                "--grid", "rows x columns of one face; leave it out where there is no grid",
                ExitCode::usage);
  }
  info.grid_rows = grid[0];
  info.grid_cols = grid[1];
}

/// Everything known before a picture is written.
struct Job {
  fs::path lights_from;  ///< for display: the list, or the folder of the pictures
  LightList list;
  std::vector<LightPicture> pictures;  ///< the lights', then the dark ones
  std::size_t n_lights = 0;
  Frame frame;
  SessionInfo info;
  std::optional<WhiteReference> white;
};

void find_pictures(const fs::path& folder, const fs::path& light_file,
                   const ImportOptions& options, Job& job) {
  const bool is_listed = !light_file.empty();
  const fs::path own = folder.has_filename() ? folder : folder.parent_path();  // not "in/"
  job.lights_from = is_listed ? light_file : own;
  job.list = is_listed ? read_light_file(light_file, options.coordinates)
                       : lights_of_pictures(folder, light_picture_names(folder, options.match));
  job.pictures = match_pictures(folder, job.lights_from, job.list, options.match);
  job.n_lights = job.pictures.size();
  if (options.grid) {
    take_grid(*options.grid, job.n_lights, job.info);
  } else {
    order_by_grid(job.lights_from, job.list, job.pictures, job.info);
  }
  if (!is_listed) {
    job.list.notes.push_back(
        fmt::format("{}: each picture says where its light is ({})", folder.string(),
                    job.list.lights.front().is_position ? "positions" : "directions"));
  }
  for (const fs::path& dark : options.match.dark) {
    std::error_code ignored;
    const fs::path path = fs::exists(dark, ignored) ? dark : folder / dark;
    job.pictures.push_back({dark.filename().string(), path});
  }
}

void take_white(const Survey& seen, const fs::path& folder, const ImportOptions& options,
                Job& job) {
  std::vector<PatchSample> patches = lit_patches(seen, job.n_lights);
  if (job.info.form.clip_level) {  // floating-point values have no upper limit
    for (PatchSample& patch : patches) {
      patch.is_clipped = false;
    }
  }
  const PixelRectangle& r = options.white->patch;
  WhiteReference& white = job.white.emplace(find_white_reference(
      patches, job.list.lights,
      {options.white->reflectance, job.info.form.sample != SampleType::f32,
       fmt::format("{}, --white {},{},{},{}", folder.string(), r.x, r.y, r.width, r.height)}));
  job.info.form.gains = white.gains;
  job.list.notes.push_back("white: " + words(white, job.n_lights));
  constexpr double kFarOff = 0.1;  // a warning, not a limit
  if (white.distance > kFarOff) {
    job.list.disagreements.push_back(fmt::format(
        "under light {} the white patch's colour is {:.0f} % off the gains of the whole set: "
        "its lamp has another colour, or something lies on the patch",
        job.pictures[static_cast<std::size_t>(white.furthest)].name, 100.0 * white.distance));
  }
}

/// Chooses the frames' form, and notes how.
void choose_form(const fs::path& folder, const ImportOptions& options, Job& job) {
  job.frame = frame_of(job.pictures[0].path, options);
  const FrameForm& whole = job.frame.whole;
  FrameForm& form = job.info.form;
  form = whole;
  const bool is_floating = whole.sample == SampleType::f32;
  Survey seen;
  if (is_floating || job.frame.white) {
    seen = survey(job.pictures, job.n_lights, job.frame, options);
  }
  if (seen.largest > 1.0F && is_floating) {
    form.clip_level = static_cast<double>(std::numeric_limits<float>::max());
    job.list.notes.push_back(fmt::format(
        "floating-point values up to {:.4g}, above 1: none counts as clipped", seen.largest));
  }
  if (job.frame.white) {
    take_white(seen, folder, options, job);
  }
  if (const std::optional<PixelRectangle>& cut_out = job.frame.crop) {
    const FrameCrop before = whole.crop.value_or(FrameCrop{0, 0, whole.width, whole.height});
    form.crop = FrameCrop{before.x + cut_out->x, before.y + cut_out->y, before.whole_width,
                          before.whole_height};
    form.width = cut_out->width;
    form.height = cut_out->height;
    form.stored_height = cut_out->height;
    job.list.notes.push_back(fmt::format(
        "crop: {} x {} of {} x {} pixels", options.crop->width, options.crop->height,
        job.frame.orientation >= 5 ? whole.height : whole.width,
        job.frame.orientation >= 5 ? whole.width : whole.height));
  }
}

/// Describes the session without its frames. @return  plan.json
std::string describe_session(const ImportOptions& options, Job& job) {
  SessionInfo& info = job.info;
  info.evidence = EvidenceKind::asserted;
  info.lights = job.list.lights;
  for (std::size_t i = 0; i < job.pictures.size(); ++i) {
    Shot shot;
    shot.index = static_cast<int>(i);
    if (i < job.n_lights) {
      shot.lit = {{shot.index, 65535}};
    } else {
      shot.kind = ShotKind::dark;
    }
    info.shots.push_back(shot);
  }
  const std::vector<std::string> hashes = hashes_of_different(job.pictures, job.n_lights);
  std::string plan =
      make_plan(job.pictures, job.lights_from.filename().string(), hashes, options, job.white);
  info.plan_hash = content_hash(plan);
  info.plan_file_hash = info.plan_hash;
  constexpr std::size_t kIdLength = 16;
  info.id = content_hash(plan + session_info_to_json(info)).substr(0, kIdLength);
  info.created = now_text();
  info.program = program_name();
  return plan;
}

/// @return  what the cameras wrote, picture by picture
std::vector<PictureFacts> write_frames(const fs::path& folder, const ImportOptions& options,
                                       Job& job) {
  SessionInfo& info = job.info;
  const std::string setup = setup_hash(info);
  info.frames.resize(job.pictures.size());
  std::vector<PictureFacts> facts(job.pictures.size());
  Progress progress("import", job.pictures.size(), options.progress);
  parallel_for(job.pictures.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      PictureFile picture = read_in_frame(job.pictures[i].path, job.frame, options);
      facts[i] = picture.facts;
      if (job.frame.crop) {
        picture.pixels = cut(picture.pixels, *job.frame.crop);
      }
      FrameEvidence evidence;
      evidence.kind = EvidenceKind::asserted;
      evidence.pattern_id = static_cast<int>(i);
      evidence.sequence = i;
      FrameDescription description =
          describe_frame(info, setup, static_cast<int>(i), 0, evidence);
      const std::vector<std::byte> bytes = encode_picture(picture, info.form, description);
      const std::string name = frame_file_name(description.shot, 0);
      write_plain(folder / name, bytes);
      info.frames[i] = {description.shot,
                        0,
                        name,
                        content_hash(bytes),
                        description.evidence,
                        to_hex(leaf_hash(name, bytes))};
      progress.advance();
    }
  });
  return facts;
}

/// Files may differ where the imported pixels do not; `verify` would reject that.
void check_different_pixels(const Job& job) {
  std::map<std::string, std::size_t> seen;
  for (std::size_t i = 0; i < job.n_lights; ++i) {
    const FrameEvidence& e = job.info.frames[i].evidence;
    if (!(1.0 - e.saturated_fraction - e.black_fraction > 0.0)) {
      continue;  // nothing but black or white: naturally alike
    }
    const auto [at, is_new] = seen.emplace(e.pixel_hash, i);
    if (!is_new) {
      throw Error(fmt::format("the same pixels{} as {}", job.frame.crop ? " in the crop" : "",
                              job.pictures[at->second].path.filename().string()),
                  job.pictures[i].path.string(),
                  "two lights cannot give the same picture: one was saved twice, or --crop "
                  "leaves too little");
    }
  }
}

void tell_pictures(const ImportOptions& options, const Job& job, ImportResult& result) {
  if (!job.frame.profile.empty()) {
    result.notes.push_back(fmt::format("the pictures' colour profile (\"{}\") is {}",
                                       job.frame.profile,
                                       options.transfer ? "not applied: --transfer is given"
                                                        : "applied: frames are linear light, "
                                                          "32-bit floats"));
  }
  if (job.info.form.transfer == Transfer::srgb) {
    result.notes.emplace_back(
        "integer pictures are taken as sRGB and linearised by develop (--transfer linear: "
        "not)");
  }
}

}  // namespace

ImportResult import_pictures(const fs::path& folder, const fs::path& light_file,
                             const fs::path& target_path, const ImportOptions& options) {
  fs::path target = target_path;
  if (!target.has_filename()) {
    target = target.parent_path();  // "out/" means "out"
  }
  const bool is_replacing = check_import_target(target, options.force);
  Job job;
  find_pictures(folder, light_file, options, job);
  choose_form(folder, options, job);
  const std::string plan = describe_session(options, job);

  PendingFolder pending(target);
  const std::vector<PictureFacts> facts = write_frames(pending.path(), options, job);
  check_different_pixels(job);
  job.info.photographed = tell_facts(facts, job.list.notes, job.list.disagreements);
  SessionInfo start = job.info;
  start.frames.clear();
  write_plain(pending.path() / "plan.json", plan);
  write_plain(pending.path() / "start.json", session_info_to_json(start));
  job.info.made_by = MadeBy::import;
  seal_session(pending.path(), "", job.info);
  write_plain(pending.path() / "session.json", session_info_to_json(job.info));
  pending.commit(is_replacing);

  ImportResult result{job.info, job.list.notes, job.list.disagreements, job.white};
  tell_pictures(options, job, result);
  return result;
}

}  // namespace haarlight::session
