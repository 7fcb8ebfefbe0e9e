#include "session/import.h"

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <limits>
#include <utility>

#include <fcntl.h>
#include <fmt/chrono.h>
#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <sys/stat.h>
#include <unistd.h>

#include "core/error.h"
#include "core/files.h"
#include "core/parallel.h"
#include "core/sha256.h"
#include "session/frame_check.h"
#include "session/frame_tiff.h"
#include "session/position_grid.h"
#include "session/seal.h"

namespace haarlight {

namespace {

namespace fs = std::filesystem;

constexpr std::uintmax_t kMaxSessionJson = std::uintmax_t{64} << 20U;  // 60 000 pictures

/// A folder that is removed unless it got its name.
class PendingFolder {
 public:
  explicit PendingFolder(fs::path target) : target_(std::move(target)) {
    const fs::path name = target_.filename();
    path_ = target_.parent_path() / fmt::format(".{}.import{}", name.string(), ::getpid());
    std::error_code error;
    fs::create_directories(target_.parent_path().empty() ? "." : target_.parent_path(), error);
    if (!error) {
      fs::remove_all(path_, error);  // left by a killed import with this process number
      fs::create_directories(path_ / "frames", error);
    }
    if (error) {
      throw Error("cannot make a folder: " + error.message(), path_.string(),
                  "check the folder's rights and free space", ExitCode::io);
    }
  }
  ~PendingFolder() {
    std::error_code ignored;
    fs::remove_all(path_, ignored);
  }
  PendingFolder(const PendingFolder&) = delete;
  PendingFolder& operator=(const PendingFolder&) = delete;

  [[nodiscard]] const fs::path& path() const { return path_; }

  /// Everything durable, then the name. An older session there is exchanged in one step.
  void commit(bool replace) {
    const Fd fd(::open(path_.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
    if (!fd.is_open() || ::syncfs(fd.get()) != 0) {
      fail_io("sync");
    }
    const unsigned flags = replace ? RENAME_EXCHANGE : RENAME_NOREPLACE;
    int result = ::renameat2(AT_FDCWD, path_.c_str(), AT_FDCWD, target_.c_str(), flags);
    if (result != 0 && errno == EINVAL && !replace) {  // file systems without these flags
      result = ::rename(path_.c_str(), target_.c_str());
    }
    if (result != 0) {
      fail_io("rename");
    }
    const fs::path parent = target_.has_parent_path() ? target_.parent_path() : fs::path(".");
    const Fd folder(::open(parent.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
    if (!folder.is_open() || ::fsync(folder.get()) != 0) {
      fail_io("sync the folder of");
    }
  }

 private:
  [[noreturn]] void fail_io(const char* step) const {
    throw Error(fmt::format("{}: {}", step, std::strerror(errno)), target_.string(),
                "check the folder's rights and free space", ExitCode::io);
  }

  fs::path target_;
  fs::path path_;
};

/// A frame's numbers are linear or sRGB's: those of another profile become linear floats,
/// unless the user says what they are.
PictureFile read_for_session(const fs::path& path, const ImportOptions& options) {
  PictureFile picture = read_picture(path);
  if (picture.colours == nullptr || options.transfer) {
    return picture;
  }
  PictureFile linear{.transfer = Transfer::linear,
                     .is_turned = picture.is_turned,
                     .facts = picture.facts,
                     .profile = picture.profile};
  linear.pixels = linear_light(std::move(picture), path);
  return linear;
}

FrameForm form_of(const PictureFile& picture, const ImportOptions& options) {
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
  return fmt::format("{} x {}, {}, {}, {}", form.width, form.height,
                     form.channels == 1 ? "grey" : "RGB", sample,
                     form.transfer == Transfer::srgb ? "sRGB" : "linear");
}

void check_same_form(const FrameForm& form, const FrameForm& first, const fs::path& path,
                     const fs::path& first_path) {
  if (!(form == first)) {
    throw Error(
        fmt::format("{}; {} is {}", words(form), first_path.filename().string(), words(first)),
        path.string(), "all pictures of a session have one size and kind");
  }
}

/// Floating-point values have no white of their own: those of raw developers end at 1, those of
/// renderers and merged exposures nowhere. @return  the largest of all lights' values
float largest_value(const std::vector<LightPicture>& pictures, std::size_t n_lights,
                    const ImportOptions& options) {
  std::vector<float> largest(n_lights, 0.0F);
  parallel_for(n_lights, 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const PictureFile picture = read_for_session(pictures[i].path, options);
      largest[i] =
          *std::max_element(picture.pixels.pixels().begin(), picture.pixels.pixels().end());
    }
  });
  return *std::max_element(largest.begin(), largest.end());
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

/// One picture as a frame's bytes; the evidence's pixel part is filled.
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

/// What was asked, with the sources' hashes: the session's plan.json.
std::string make_plan(const std::vector<LightPicture>& pictures, const fs::path& light_file,
                      const std::vector<std::string>& hashes) {
  nlohmann::ordered_json plan;
  plan["schema"] = 1;
  plan["kind"] = "import";
  plan["lights"] = light_file.filename().string();
  plan["pictures"] = nlohmann::ordered_json::array();
  for (std::size_t i = 0; i < pictures.size(); ++i) {
    plan["pictures"].push_back({{"name", pictures[i].name}, {"hash", hashes[i]}});
  }
  return plan.dump(1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
}

std::string now_for_people() {
  return fmt::format("{:%Y-%m-%dT%H:%M:%SZ}", fmt::gmtime(std::time(nullptr)));
}

bool is_replaceable(const fs::path& target) {
  const fs::path file = target / "session.json";
  std::error_code ignored;
  if (!fs::exists(file, ignored)) {
    return false;
  }
  const SessionInfo info =
      session_info_from_json(read_file(file, kMaxSessionJson), file.string());
  return info.evidence == EvidenceKind::asserted;
}

/// @return  whether an older import is to be replaced
bool check_target(const fs::path& target, bool force) {
  std::error_code ignored;
  if (!fs::exists(target, ignored)) {
    return false;
  }
  require_absent(target, force);
  if (!is_replaceable(target)) {
    throw Error("exists and is not an imported session", target.string(),
                "choose another name; --force replaces imports only, never a capture",
                ExitCode::usage);
  }
  return true;
}

void write_plain(const fs::path& path, std::span<const std::byte> bytes) {
  std::FILE* file = std::fopen(path.c_str(), "wb");
  const bool is_written =
      file != nullptr && std::fwrite(bytes.data(), 1, bytes.size(), file) == bytes.size();
  const int error = errno;
  const bool is_closed = file != nullptr && std::fclose(file) == 0;
  if (!is_written || !is_closed) {
    throw Error(fmt::format("write: {}", std::strerror(is_written ? errno : error)),
                path.string(), "check the disk's free space", ExitCode::io);
  }
}

void write_plain(const fs::path& path, const std::string& text) {
  write_plain(path, std::as_bytes(std::span(text)));
}

/// Into the order of the grid that the lights' positions form, if they form one.
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

}  // namespace

ImportResult import_pictures(const fs::path& folder, const fs::path& light_file,
                             const fs::path& target_path, const ImportOptions& options) {
  fs::path target = target_path;
  if (!target.has_filename()) {
    target = target.parent_path();  // "out/" means "out"
  }
  const bool is_replacing = check_target(target, options.force);
  LightList list = read_light_file(light_file, options.places);
  std::vector<LightPicture> pictures = match_pictures(folder, light_file, list, options.match);
  const std::size_t n_lights = pictures.size();
  ImportResult result;
  SessionInfo& info = result.info;
  if (options.grid) {
    take_grid(*options.grid, n_lights, info);
  } else {
    order_by_grid(light_file, list, pictures, info);
  }
  for (const fs::path& dark : options.match.dark) {
    std::error_code ignored;
    const fs::path path = fs::exists(dark, ignored) ? dark : folder / dark;
    pictures.push_back({dark.filename().string(), path});
  }
  const PictureFile first = read_for_session(pictures[0].path, options);

  info.evidence = EvidenceKind::asserted;
  info.form = form_of(first, options);
  if (first.is_floating) {
    const float most = largest_value(pictures, n_lights, options);
    if (most > 1.0F) {
      info.form.clip_level = static_cast<double>(std::numeric_limits<float>::max());
      list.notes.push_back(fmt::format(
          "floating-point values up to {:.4g}, above 1: none counts as clipped", most));
    }
  }
  info.lights = list.lights;
  for (std::size_t i = 0; i < pictures.size(); ++i) {
    Shot shot;
    shot.index = static_cast<int>(i);
    if (i < n_lights) {
      shot.lit = {{shot.index, 65535}};
    } else {
      shot.kind = ShotKind::dark;
    }
    info.shots.push_back(shot);
  }
  const std::vector<std::string> hashes = hashes_of_different(pictures, n_lights);
  const std::string plan = make_plan(pictures, light_file, hashes);
  info.plan_hash = content_hash(plan);
  info.plan_file_hash = info.plan_hash;
  constexpr std::size_t kIdLength = 16;
  info.id = content_hash(plan + session_info_to_json(info)).substr(0, kIdLength);
  info.created = now_for_people();
  info.program = program_name();
  const std::string setup = setup_hash(info);

  PendingFolder pending(target);
  info.frames.resize(pictures.size());
  std::atomic<int> n_turned = 0;
  Progress progress("import", pictures.size(), options.progress);
  parallel_for(pictures.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const PictureFile picture = read_for_session(pictures[i].path, options);
      FrameForm form = form_of(picture, options);
      form.clip_level = info.form.clip_level;
      check_same_form(form, info.form, pictures[i].path, pictures[0].path);
      check_finite(picture.pixels, pictures[i].path);
      n_turned += picture.is_turned ? 1 : 0;
      FrameEvidence evidence;
      evidence.kind = EvidenceKind::asserted;
      evidence.pattern_id = static_cast<int>(i);
      evidence.sequence = i;
      FrameDescription description =
          describe_frame(info, setup, static_cast<int>(i), 0, evidence);
      const std::vector<std::byte> bytes = encode_picture(picture, info.form, description);
      const std::string name = frame_file_name(description.shot, 0);
      write_plain(pending.path() / name, bytes);
      info.frames[i] = {description.shot,
                        0,
                        name,
                        content_hash(bytes),
                        description.evidence,
                        to_hex(leaf_hash(name, bytes))};
      progress.advance();
    }
  });
  SessionInfo start = info;
  start.frames.clear();
  write_plain(pending.path() / "plan.json", plan);
  write_plain(pending.path() / "start.json", session_info_to_json(start));
  info.made_by = MadeBy::import;
  seal_session(pending.path(), "", info);
  write_plain(pending.path() / "session.json", session_info_to_json(info));
  pending.commit(is_replacing);

  result.notes = list.notes;
  result.disagreements = list.disagreements;
  if (n_turned > 0) {
    const bool are_all = static_cast<std::size_t>(n_turned) == pictures.size();
    (are_all ? result.notes : result.disagreements)
        .push_back(fmt::format("{} of {} pictures carry an EXIF rotation: ignored, pixels are "
                               "taken as stored",
                               n_turned.load(), pictures.size()));
  }
  if (!first.profile.empty()) {
    result.notes.push_back(fmt::format("the pictures' colour profile (\"{}\") is {}",
                                       first.profile,
                                       options.transfer ? "not applied: --transfer is given"
                                                        : "applied: frames are linear light, "
                                                          "32-bit floats"));
  }
  if (info.form.transfer == Transfer::srgb) {
    result.notes.emplace_back(
        "integer pictures are taken as sRGB and linearised by develop (--transfer linear: "
        "not)");
  }
  return result;
}

}  // namespace haarlight
