// SPDX-License-Identifier: Apache-2.0
#include "relight/reflectance/fit/picture_files.h"

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <utility>

#include <fmt/format.h>
#include <unistd.h>

#include "core/parallel.h"
#include "core/picture/picture_tags.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "relight/reflectance/fit/plane_store.h"

namespace haarlight::relight {

namespace {

namespace fs = std::filesystem;

constexpr std::size_t kHead = 3;
bool is_jpeg(const fs::path& path) { return read_head(path, kHead) == "\xff\xd8\xff"; }

/// A picture's sRGB codes, three per pixel.
std::vector<std::uint16_t> codes_of(PictureFile picture, const fs::path& path) {
  if (picture.is_floating) {
    throw Error("has floating values: what is white is not known", path.string(),
                "make a session of these pictures (haarlight import) and fit that");
  }
  const bool is_srgb = picture.colours == nullptr && picture.transfer == Transfer::srgb;
  const Image<float> pixels =
      is_srgb ? std::move(picture.pixels) : linear_light(std::move(picture), path);
  const auto values = pixels.pixels();
  const std::size_t repeats = pixels.channels() == 1 ? 3 : 1;
  std::vector<std::uint16_t> codes;
  codes.reserve(values.size() * repeats);
  for (const float value : values) {
    const float light = std::clamp(value, 0.0F, 1.0F);
    const float code = is_srgb ? light : srgb_from_linear(light);
    constexpr float kWhite = 65535.0F;
    codes.insert(codes.end(), repeats, static_cast<std::uint16_t>(std::lround(kWhite * code)));
  }
  return codes;
}

/// Pictures of one size, kept whole, read in pieces: in memory or in an unnamed temporary file.
class CodeStore {
 public:
  CodeStore(std::size_t n_picture, std::size_t n_pictures, const PictureFilesOptions& options)
      : n_picture_(n_picture), folder_(options.work_folder) {
    if (n_picture * n_pictures * sizeof(std::uint16_t) <= options.memory_bytes) {
      values_.resize(n_picture * n_pictures);
    } else {
      file_ = nameless_file(folder_);
    }
  }
  void put(std::size_t picture, std::span<const std::uint16_t> codes) {
    if (!file_.is_open()) {
      std::copy(codes.begin(), codes.end(),
                values_.begin() + static_cast<std::ptrdiff_t>(picture * n_picture_));
      return;
    }
    auto bytes = std::as_bytes(codes);
    std::size_t at = picture * n_picture_ * sizeof(std::uint16_t);
    while (!bytes.empty()) {
      const ssize_t n =
          ::pwrite(file_.get(), bytes.data(), bytes.size(), static_cast<off_t>(at));
      bytes = bytes.subspan(advanced_by(n));
      at += static_cast<std::size_t>(std::max<ssize_t>(n, 0));
    }
  }
  void get(std::size_t picture, std::size_t first, std::span<std::uint16_t> codes) const {
    if (!file_.is_open()) {
      std::copy_n(values_.begin() + static_cast<std::ptrdiff_t>(picture * n_picture_ + first),
                  codes.size(), codes.begin());
      return;
    }
    auto bytes = std::as_writable_bytes(codes);
    std::size_t at = (picture * n_picture_ + first) * sizeof(std::uint16_t);
    while (!bytes.empty()) {
      const ssize_t n =
          ::pread(file_.get(), bytes.data(), bytes.size(), static_cast<off_t>(at));
      bytes = bytes.subspan(advanced_by(n));
      at += static_cast<std::size_t>(std::max<ssize_t>(n, 0));
    }
  }

 private:
  /// The number of bytes a call processed. @throws Error(io)
  [[nodiscard]] std::size_t advanced_by(ssize_t n) const {
    if (n < 0 && errno == EINTR) {
      return 0;
    }
    if (n <= 0) {
      throw Error(fmt::format("pictures beside the output: {}",
                              n < 0 ? std::strerror(errno) : "the work file ends"),
                  folder_.string(), "free some space there, or give more --memory",
                  ExitCode::io);
    }
    return static_cast<std::size_t>(n);
  }

  std::size_t n_picture_;
  fs::path folder_;
  std::vector<std::uint16_t> values_;
  Fd file_;
};

class KeptRows final : public PictureRows {
 public:
  KeptRows(const std::vector<fs::path>& paths, const PictureFile& first,
           const PictureFilesOptions& options)
      : shape_{.width = first.pixels.width(),
               .height = first.pixels.height(),
               .channels = 3,
               .n_lights = static_cast<int>(paths.size())},
        n_row_(static_cast<std::size_t>(shape_.width) * 3),
        store_(n_row_ * static_cast<std::size_t>(shape_.height), paths.size(), options) {
    parallel_for(paths.size(), 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t k = begin; k < end; ++k) {
        PictureFile picture = read_picture(paths[k]);
        if (picture.pixels.width() != shape_.width ||
            picture.pixels.height() != shape_.height) {
          throw Error(fmt::format("{} x {}; {} is {} x {}", picture.pixels.width(),
                                  picture.pixels.height(), paths[0].filename().string(),
                                  shape_.width, shape_.height),
                      paths[k].string(), "all pictures of a capture have one size");
        }
        store_.put(k, codes_of(std::move(picture), paths[k]));
      }
    });
  }
  [[nodiscard]] StackDims dims() const override { return shape_; }
  [[nodiscard]] Transfer transfer() const override { return Transfer::srgb; }
  void rewind() override { y_ = 0; }
  void skip(int n_rows) override { y_ += static_cast<std::size_t>(n_rows); }
  void read(int n_rows, std::span<std::uint16_t> out) override {
    const auto n_lights = static_cast<std::size_t>(shape_.n_lights);
    for (std::size_t y = 0; y < static_cast<std::size_t>(n_rows); ++y) {
      for (std::size_t k = 0; k < n_lights; ++k) {
        store_.get(k, (y_ + y) * n_row_, out.subspan((y * n_lights + k) * n_row_, n_row_));
      }
    }
    y_ += static_cast<std::size_t>(n_rows);
  }

 private:
  StackDims shape_;
  std::size_t n_row_;
  CodeStore store_;
  std::size_t y_ = 0;
};

/// Whether all files declare the same colours as the first.
bool are_alike(const std::vector<fs::path>& pictures) {
  const auto tags_of = [](const fs::path& path) {
    const MappedFile file(path);
    return jpeg_tags(file.bytes()).colour;
  };
  const ColourTags first = tags_of(pictures.front());
  return std::all_of(pictures.begin() + 1, pictures.end(), [&](const fs::path& path) {
    const ColourTags tags = tags_of(path);
    return tags.icc == first.icc && tags.is_icc_damaged == first.is_icc_damaged &&
           tags.is_adobe_rgb == first.is_adobe_rgb;
  });
}

}  // namespace

PictureFiles picture_rows(std::vector<fs::path> pictures, const PictureFilesOptions& options) {
  HAARLIGHT_EXPECTS(!pictures.empty(), "at least one picture");
  PictureFile first = read_picture(pictures.front());
  PictureFiles files{nullptr, first.colours != nullptr ? first.profile : ""};
  const bool is_plain =
      first.colours == nullptr &&
      std::all_of(pictures.begin(), pictures.end(),
                  [](const auto& p) { return is_jpeg(p) && is_line_jpeg(p); }) &&
      are_alike(pictures);
  if (is_plain) {
    files.rows = jpeg_rows(std::move(pictures));
  } else {
    files.rows = std::make_unique<KeptRows>(pictures, first, options);
  }
  return files;
}

}  // namespace haarlight::relight
