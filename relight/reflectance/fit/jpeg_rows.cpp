// SPDX-License-Identifier: Apache-2.0
#include <csetjmp>
#include <cstdio>
#include <utility>

#include <fmt/format.h>
#include <jpeglib.h>

#include "core/error.h"
#include "core/files.h"
#include "core/parallel.h"
#include "relight/reflectance/fit/picture_rows.h"

namespace haarlight {

namespace {

namespace fs = std::filesystem;

/// libjpeg reports errors through a call that must not return: it jumps back to the last
/// setjmp, and the caller throws from there. No C++ object lives between setjmp and longjmp.
struct ErrorJump {
  jpeg_error_mgr manager{};  // first: libjpeg hands back a pointer to it
  std::jmp_buf back{};
};

void jump_back(j_common_ptr info) {
  std::longjmp(reinterpret_cast<ErrorJump*>(info->err)->back, 1);
}

void keep_quiet(j_common_ptr /*info*/) {}

/// One picture being decoded.
class JpegLines {
 public:
  explicit JpegLines(fs::path path) : path_(std::move(path)), file_(path_) { start(); }
  ~JpegLines() { jpeg_destroy_decompress(&info_); }
  JpegLines(const JpegLines&) = delete;
  JpegLines& operator=(const JpegLines&) = delete;

  [[nodiscard]] int width() const { return static_cast<int>(info_.image_width); }
  [[nodiscard]] int height() const { return static_cast<int>(info_.image_height); }
  [[nodiscard]] const fs::path& path() const { return path_; }

  void rewind() {
    if (info_.output_scanline == 0) {
      return;
    }
    jpeg_destroy_decompress(&info_);
    start();
  }

  void skip(int n_rows) {
    if (setjmp(jump_.back) != 0) {  // NOLINT(cert-err52-cpp): libjpeg's way
      refuse_damage();
    }
    jpeg_skip_scanlines(&info_, static_cast<JDIMENSION>(n_rows));
  }

  /// One row of width * 3 bytes.
  void read(std::uint8_t* row) {
    if (setjmp(jump_.back) != 0) {  // NOLINT(cert-err52-cpp)
      refuse_damage();
    }
    JSAMPROW rows[1] = {row};
    if (jpeg_read_scanlines(&info_, rows, 1) != 1 || info_.err->num_warnings > 0) {
      refuse_damage();
    }
  }

  /// Releases what was already decoded: a mapped page counts as memory in use.
  void forget_past() {
    const std::size_t done = file_.bytes().size() - info_.src->bytes_in_buffer;
    constexpr std::size_t kStep = std::size_t{1} << 20U;
    if (done > forgotten_ + kStep) {
      drop_pages(file_.bytes().subspan(forgotten_, done - forgotten_));
      forgotten_ = done;
    }
  }

 private:
  void start() {
    info_ = {};
    forgotten_ = 0;
    info_.err = jpeg_std_error(&jump_.manager);
    jump_.manager.error_exit = jump_back;
    jump_.manager.output_message = keep_quiet;
    if (setjmp(jump_.back) != 0) {  // NOLINT(cert-err52-cpp)
      refuse("is not a JPEG that can be read: " + message());
    }
    jpeg_create_decompress(&info_);
    const auto bytes = file_.bytes();
    jpeg_mem_src(&info_, reinterpret_cast<const unsigned char*>(bytes.data()),
                 static_cast<unsigned long>(bytes.size()));
    jpeg_read_header(&info_, TRUE);
    if (info_.num_components != 1 && info_.num_components != 3) {
      refuse(fmt::format("has {} colour components", info_.num_components));
    }
    if (jpeg_has_multiple_scans(&info_) != 0) {
      refuse("is a progressive JPEG: it would have to be held in memory whole");
    }
    info_.out_color_space = JCS_RGB;
    jpeg_start_decompress(&info_);
  }

  [[nodiscard]] std::string message() {
    char text[JMSG_LENGTH_MAX];
    info_.err->format_message(reinterpret_cast<j_common_ptr>(&info_), text);
    return text;
  }
  [[noreturn]] void refuse(const std::string& what) {
    jpeg_destroy_decompress(&info_);  // in the constructor no destructor will follow
    throw Error(what, path_.string(),
                "make a session of these pictures (haarlight import) and fit that");
  }
  [[noreturn]] void refuse_damage() {
    throw Error(fmt::format("row {}: {}", info_.output_scanline, message()), path_.string(),
                "the file is damaged or cut short: copy it again");
  }

  fs::path path_;
  MappedFile file_;
  jpeg_decompress_struct info_{};
  ErrorJump jump_;
  std::size_t forgotten_ = 0;
};

class JpegRows final : public PictureRows {
 public:
  explicit JpegRows(std::vector<fs::path> pictures) {
    for (fs::path& path : pictures) {
      lines_.push_back(std::make_unique<JpegLines>(std::move(path)));
      const JpegLines& first = *lines_.front();
      const JpegLines& last = *lines_.back();
      if (last.width() != first.width() || last.height() != first.height()) {
        throw Error(
            fmt::format("{} x {}; {} is {} x {}", last.width(), last.height(),
                        first.path().filename().string(), first.width(), first.height()),
            last.path().string(), "all pictures of a capture have one size");
      }
    }
    HAARLIGHT_EXPECTS(!lines_.empty(), "at least one picture");
  }

  [[nodiscard]] PictureShape shape() const override {
    return {lines_.front()->width(), lines_.front()->height(), static_cast<int>(lines_.size())};
  }
  [[nodiscard]] Transfer transfer() const override { return Transfer::srgb; }
  void rewind() override {
    for (const auto& picture : lines_) {
      picture->rewind();
    }
  }
  void skip(int n_rows) override {
    parallel_for(lines_.size(), 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t k = begin; k < end; ++k) {
        lines_[k]->skip(n_rows);
      }
    });
  }
  void read(int n_rows, std::span<std::uint16_t> out) override {
    const std::size_t n_row = static_cast<std::size_t>(shape().width) * 3;
    const std::size_t n_lights = lines_.size();
    parallel_for(n_lights, 1, [&](std::size_t begin, std::size_t end) {
      std::vector<std::uint8_t> row(n_row);
      for (std::size_t k = begin; k < end; ++k) {
        for (std::size_t y = 0; y < static_cast<std::size_t>(n_rows); ++y) {
          lines_[k]->read(row.data());
          std::uint16_t* to = &out[(y * n_lights + k) * n_row];
          for (std::size_t i = 0; i < n_row; ++i) {
            to[i] = static_cast<std::uint16_t>(row[i] * 257U);
          }
        }
        lines_[k]->forget_past();
      }
    });
  }

 private:
  std::vector<std::unique_ptr<JpegLines>> lines_;
};

}  // namespace

bool is_line_jpeg(const fs::path& path) {
  const MappedFile file(path);
  jpeg_decompress_struct info{};
  ErrorJump jump;
  info.err = jpeg_std_error(&jump.manager);
  jump.manager.error_exit = jump_back;
  jump.manager.output_message = keep_quiet;
  bool is_by_lines = true;
  if (setjmp(jump.back) == 0) {  // NOLINT(cert-err52-cpp): libjpeg's way
    jpeg_create_decompress(&info);
    jpeg_mem_src(&info, reinterpret_cast<const unsigned char*>(file.bytes().data()),
                 static_cast<unsigned long>(file.bytes().size()));
    jpeg_read_header(&info, TRUE);
    // A local that changes after setjmp and is read after longjmp would be lost: there is none.
    is_by_lines = jpeg_has_multiple_scans(&info) == 0;
  }
  jpeg_destroy_decompress(&info);
  return is_by_lines;
}

std::unique_ptr<PictureRows> jpeg_rows(std::vector<fs::path> pictures) {
  return std::make_unique<JpegRows>(std::move(pictures));
}

}  // namespace haarlight
