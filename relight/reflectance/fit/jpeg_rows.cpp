// SPDX-License-Identifier: Apache-2.0
#include <optional>
#include <span>
#include <utility>

#include <fmt/format.h>

#include "core/parallel.h"
#include "core/picture/jpeg.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "relight/reflectance/fit/picture_rows.h"

namespace haarlight::relight {

namespace {

namespace fs = std::filesystem;

/// One picture being decoded.
class JpegLines {
 public:
  explicit JpegLines(fs::path path) : path_(std::move(path)), file_(path_) { start(); }

  [[nodiscard]] int width() const { return decoder_->width(); }
  [[nodiscard]] int height() const { return decoder_->height(); }
  [[nodiscard]] const fs::path& path() const { return path_; }

  void rewind() {
    if (decoder_->next_row() != 0) {
      start();
    }
  }

  void skip(int n_rows) {
    run([&] { decoder_->skip(n_rows); });
  }

  /// @param row  (width, 3)
  void read(std::span<std::uint8_t> row) {
    run([&] { decoder_->read(row); });
  }

  /// Releases what was already decoded: a mapped page counts as memory in use.
  void forget_past() {
    const std::size_t done = file_.bytes().size() - decoder_->n_bytes_left();
    constexpr std::size_t kStep = std::size_t{1} << 20U;
    if (done > forgotten_ + kStep) {
      drop_pages(file_.bytes().subspan(forgotten_, done - forgotten_));
      forgotten_ = done;
    }
  }

 private:
  void start() {
    forgotten_ = 0;
    try {
      decoder_.emplace(file_.bytes());
    } catch (const JpegDamage& damage) {
      refuse(fmt::format("is not a JPEG that can be read: {}", damage.what()));
    }
    if (decoder_->n_components() != 1 && decoder_->n_components() != 3) {
      refuse(fmt::format("has {} colour components", decoder_->n_components()));
    }
    if (decoder_->has_multiple_scans()) {
      refuse("is a progressive JPEG: it would have to be held in memory whole");
    }
    run([&] { decoder_->start(3); });
  }

  [[noreturn]] void refuse(const std::string& what) const {
    throw Error(what, path_.string(),
                "make a session of these pictures (haarlight import) and fit that");
  }
  template <class Call>
  void run(const Call& call) const {
    try {
      call();
    } catch (const JpegDamage& damage) {
      throw Error(fmt::format("row {}: {}", decoder_->next_row(), damage.what()),
                  path_.string(), "the file is damaged or cut short: copy it again");
    }
  }

  fs::path path_;
  MappedFile file_;
  std::optional<JpegDecoder> decoder_;
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

  [[nodiscard]] StackDims dims() const override {
    return {lines_.front()->width(), lines_.front()->height(), 3,
            static_cast<int>(lines_.size())};
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
    const std::size_t n_row = static_cast<std::size_t>(dims().width) * 3;
    const std::size_t n_lights = lines_.size();
    parallel_for(n_lights, 1, [&](std::size_t begin, std::size_t end) {
      std::vector<std::uint8_t> row(n_row);
      for (std::size_t k = begin; k < end; ++k) {
        for (std::size_t y = 0; y < static_cast<std::size_t>(n_rows); ++y) {
          lines_[k]->read(row);
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
  try {
    return !JpegDecoder(file.bytes()).has_multiple_scans();
  } catch (const JpegDamage&) {
    return true;
  }
}

std::unique_ptr<PictureRows> jpeg_rows(std::vector<fs::path> pictures) {
  return std::make_unique<JpegRows>(std::move(pictures));
}

}  // namespace haarlight::relight
