#include "session/import.h"

#include <algorithm>
#include <atomic>
#include <cctype>
#include <cerrno>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <utility>

#include <fcntl.h>
#include <fmt/chrono.h>
#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <sys/stat.h>
#include <unistd.h>

#include "core/config_table.h"
#include "core/error.h"
#include "core/files.h"
#include "core/parallel.h"
#include "core/sha256.h"
#include "session/frame_check.h"
#include "session/frame_tiff.h"
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

/// "a2" before "a10": runs of digits compare as numbers.
bool is_before_naturally(const std::string& a, const std::string& b) {
  const auto is_digit = [](char c) { return std::isdigit(static_cast<unsigned char>(c)) != 0; };
  std::size_t i = 0;
  std::size_t j = 0;
  while (i < a.size() && j < b.size()) {
    if (is_digit(a[i]) && is_digit(b[j])) {
      std::size_t i_end = i;
      std::size_t j_end = j;
      while (i_end < a.size() && is_digit(a[i_end])) {
        ++i_end;
      }
      while (j_end < b.size() && is_digit(b[j_end])) {
        ++j_end;
      }
      while (i + 1 < i_end && a[i] == '0') {
        ++i;
      }
      while (j + 1 < j_end && b[j] == '0') {
        ++j;
      }
      if (i_end - i != j_end - j) {
        return i_end - i < j_end - j;
      }
      const int order = a.compare(i, i_end - i, b, j, j_end - j);
      if (order != 0) {
        return order < 0;
      }
      i = i_end;
      j = j_end;
    } else if (a[i] != b[j]) {
      return a[i] < b[j];
    } else {
      ++i;
      ++j;
    }
  }
  return a.size() - i < b.size() - j;
}

bool has_picture_ending(const fs::path& path) {
  std::string ending = path.extension().string();
  std::transform(ending.begin(), ending.end(), ending.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  static const std::vector<std::string> kEndings = {".jpg",  ".jpeg", ".png", ".tif",
                                                    ".tiff", ".exr",  ".tga", ".hdr"};
  return std::find(kEndings.begin(), kEndings.end(), ending) != kEndings.end();
}

/// The picture a list names: as written from the folder or from the list's own folder, else by
/// its bare name (lists often carry another machine's paths).
fs::path find_picture(const std::string& name, const fs::path& folder,
                      const fs::path& light_file, const std::vector<std::string>& present,
                      std::vector<std::string>& notes) {
  std::error_code ignored;
  for (const fs::path& base : {folder, light_file.parent_path()}) {
    if (fs::is_regular_file(base / name, ignored)) {
      return base / name;
    }
  }
  const std::size_t slash = name.find_last_of("/\\");
  if (slash != std::string::npos) {
    const std::string bare = name.substr(slash + 1);
    if (!bare.empty() && fs::is_regular_file(folder / bare, ignored)) {
      notes.push_back(fmt::format("{}: taken from {}", name, folder.string()));
      return folder / bare;
    }
  }
  const std::string nearest = nearest_word(name, present);
  throw Error(fmt::format("the picture \"{}\" is missing", name), folder.string(),
              nearest.empty()
                  ? "put it there, or take its line out of the list of lights"
                  : fmt::format("is it \"{}\"? correct the name in the list", nearest));
}

struct Picture {
  std::string name;
  fs::path path;
};

std::vector<Picture> choose_pictures(const fs::path& folder, const fs::path& light_file,
                                     LightList& list, const ImportOptions& options) {
  std::vector<std::string> present = picture_names(folder);
  std::vector<Picture> pictures;
  if (!list.lights[0].name.empty()) {
    for (const SessionLight& light : list.lights) {
      pictures.push_back(
          {light.name, find_picture(light.name, folder, light_file, present, list.notes)});
    }
    return pictures;
  }
  const auto is_left_out = [&](const std::string& name) {
    const auto contains = [&name](const std::string& part) {
      return name.find(part) != std::string::npos;
    };
    const auto is_name = [&name](const fs::path& dark) { return dark.filename() == name; };
    return std::any_of(options.exclude.begin(), options.exclude.end(), contains) ||
           std::any_of(options.dark.begin(), options.dark.end(), is_name);
  };
  present.erase(std::remove_if(present.begin(), present.end(), is_left_out), present.end());
  if (present.size() != list.lights.size()) {
    throw Error(fmt::format("{} pictures for {} lights", present.size(), list.lights.size()),
                folder.string(),
                fmt::format("{} names no pictures, so there must be one a light: leave others "
                            "out with --exclude",
                            light_file.string()));
  }
  for (std::size_t k = 0; k < present.size(); ++k) {
    pictures.push_back({present[k], folder / present[k]});
    list.lights[k].name = present[k];
  }
  list.notes.push_back(fmt::format("{} names no pictures: lights follow {} .. {}",
                                   light_file.filename().string(), present.front(),
                                   present.back()));
  return pictures;
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
std::string make_plan(const std::vector<Picture>& pictures, const fs::path& light_file,
                      std::vector<std::string>& hashes) {
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

}  // namespace

std::vector<std::string> picture_names(const fs::path& folder) {
  std::vector<std::string> names;
  std::error_code error;
  for (fs::directory_iterator it(folder, error), end; !error && it != end;
       it.increment(error)) {
    if (it->is_regular_file(error) && has_picture_ending(it->path())) {
      names.push_back(it->path().filename().string());
    }
  }
  if (error) {
    throw Error("cannot be listed: " + error.message(), folder.string(),
                "name the folder with the pictures");
  }
  std::sort(names.begin(), names.end(), is_before_naturally);
  return names;
}

ImportResult import_pictures(const fs::path& folder, const fs::path& light_file,
                             const fs::path& target_path, const ImportOptions& options) {
  fs::path target = target_path;
  if (!target.has_filename()) {
    target = target.parent_path();  // "out/" means "out"
  }
  const bool is_replacing = check_target(target, options.force);
  LightList list = read_light_file(light_file, options.places);
  std::vector<Picture> pictures = choose_pictures(folder, light_file, list, options);
  const std::size_t n_lights = pictures.size();
  for (const fs::path& dark : options.dark) {
    std::error_code ignored;
    const fs::path path = fs::exists(dark, ignored) ? dark : folder / dark;
    pictures.push_back({dark.filename().string(), path});
  }
  const PictureFile first = read_picture(pictures[0].path);

  ImportResult result;
  SessionInfo& info = result.info;
  info.evidence = EvidenceKind::asserted;
  info.form = form_of(first, options);
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
  std::vector<std::string> hashes(pictures.size());
  parallel_for(pictures.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      hashes[i] = content_hash(MappedFile(pictures[i].path).bytes());
    }
  });
  for (std::size_t i = 0; i < n_lights; ++i) {
    for (std::size_t j = 0; j < i; ++j) {
      if (hashes[i] == hashes[j]) {
        throw Error(fmt::format("the same bytes as {}", pictures[j].path.filename().string()),
                    pictures[i].path.string(),
                    "two lights cannot give the same picture: one was saved twice");
      }
    }
  }
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
      const PictureFile picture = read_picture(pictures[i].path);
      check_same_form(form_of(picture, options), info.form, pictures[i].path, pictures[0].path);
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
  if (n_turned > 0) {
    result.notes.push_back(
        fmt::format("{} pictures carry an EXIF rotation: ignored, pixels are taken as stored",
                    n_turned.load()));
  }
  if (info.form.transfer == Transfer::srgb) {
    result.notes.emplace_back(
        "integer pictures are taken as sRGB and linearised by develop (--transfer linear: "
        "not)");
  }
  return result;
}

}  // namespace haarlight
