// SPDX-License-Identifier: Apache-2.0
#include "relight/reflectance/fit/picture_rows.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include <fmt/format.h>

#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "relight/reflectance/fit/transfer_table.h"

namespace haarlight::relight {

namespace {

constexpr float kWhite = 65535.0F;

std::uint16_t code_of(float value) {
  return static_cast<std::uint16_t>(std::lround(std::clamp(value, 0.0F, 1.0F) * kWhite));
}

/// Imported display pictures: a viewer shows exactly what is in the file.
bool is_display_coded(const session::Session& session, Transfer transfer) {
  const session::SessionInfo& info = session.info();
  const bool has_dark_or_flat = std::any_of(
      info.shots.begin(), info.shots.end(),
      [](const session::Shot& shot) { return shot.kind != session::ShotKind::light; });
  const bool has_powers = std::any_of(
      info.lights.begin(), info.lights.end(),
      [](const session::SessionLight& light) { return light.relative_power != 1.0; });
  return info.evidence == session::EvidenceKind::asserted && info.form.transfer == transfer &&
         info.form.sample != session::SampleType::f32 &&
         info.form.bayer == BayerPattern::none && info.form.gains.empty() &&
         info.frames.size() == info.lights.size() && !has_dark_or_flat && !has_powers;
}

/// Frames straight from their strips of 64 rows.
class CodedRows final : public PictureRows {
 public:
  explicit CodedRows(const session::Session& session) : session_(&session) {}
  [[nodiscard]] StackDims dims() const override {
    const session::SessionInfo& info = session_->info();
    return {info.form.width, info.form.height, 3, static_cast<int>(info.lights.size())};
  }
  [[nodiscard]] Transfer transfer() const override { return session_->info().form.transfer; }
  void rewind() override { y_ = 0; }
  void skip(int n_rows) override { y_ += n_rows; }
  void read(int n_rows, std::span<std::uint16_t> out) override {
    const session::SessionInfo& info = session_->info();
    const auto width = static_cast<std::size_t>(info.form.width);
    const auto channels = static_cast<std::size_t>(info.form.channels);
    const auto black = static_cast<float>(info.form.black_level);
    const float gain = 1.0F / (static_cast<float>(info.form.white_level) - black);
    const std::size_t n_lights = info.lights.size();
    parallel_for(n_lights, 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t k = begin; k < end; ++k) {
        const session::FrameRecord& frame = info.frames[k];
        const session::Shot& shot = info.shots[static_cast<std::size_t>(frame.shot)];
        const auto light = static_cast<std::size_t>(shot.lit.front().light);
        const Image<float> rows = session_->read_rows(frame, y_, y_ + n_rows);
        for (std::size_t y = 0; y < static_cast<std::size_t>(n_rows); ++y) {
          const float* from = rows.pixels().data() + y * width * channels;
          std::uint16_t* to = &out[(y * n_lights + light) * width * 3];
          for (std::size_t i = 0; i < width * 3; ++i) {
            to[i] = code_of((from[channels == 3 ? i : i / 3] - black) * gain);
          }
        }
      }
    });
    y_ += n_rows;
  }

 private:
  const session::Session* session_;
  int y_ = 0;
};

/// Rows through develop: dark, flat field, exposures, demosaicing.
class DevelopedRows final : public PictureRows {
 public:
  DevelopedRows(const session::Session& session, const SessionRowsOptions& options)
      : developer_(session, options.develop),
        transfer_(options.transfer),
        table_(options.transfer),
        white_(options.white > 0.0 ? options.white : choose_white()) {}
  [[nodiscard]] StackDims dims() const override {
    StackDims dims = developer_.dims();
    dims.channels = 3;
    return dims;
  }
  [[nodiscard]] Transfer transfer() const override { return transfer_; }
  void rewind() override { y_ = 0; }
  void skip(int n_rows) override { y_ += n_rows; }
  void read(int n_rows, std::span<std::uint16_t> out) override {
    const StackDims shape = developer_.dims();
    const session::Developer::Rows rows = developer_.rows(y_, y_ + n_rows);
    const auto width = static_cast<std::size_t>(shape.width);
    const auto n_lights = static_cast<std::size_t>(shape.n_lights);
    const auto height = static_cast<std::size_t>(n_rows);
    const bool is_colour = shape.channels == 3;
    const auto gain = static_cast<float>(1.0 / white_);
    parallel_for(height, 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t y = begin; y < end; ++y) {
        for (std::size_t c = 0; c < 3; ++c) {
          const float* from =
              rows.values.data() + ((is_colour ? c : 0) * height + y) * width * n_lights;
          for (std::size_t x = 0; x < width; ++x) {
            for (std::size_t k = 0; k < n_lights; ++k) {
              out[((y * n_lights + k) * width + x) * 3 + c] =
                  code_of(table_(gain * from[x * n_lights + k]));
            }
          }
        }
      }
    });
    y_ += n_rows;
  }

 private:
  /// As in `haarlight export`: nearly everything is below white.
  double choose_white() {
    const int height = developer_.dims().height;
    constexpr int kRows = 16;
    std::vector<float> sample;
    for (int i = 0; i < kRows; ++i) {
      const int y = static_cast<int>((i + 0.5) * height / kRows);
      const LineFloats values = developer_.rows(y, y + 1).values;
      for (std::size_t at = 0; at < values.size(); at += 97) {
        sample.push_back(values[at]);
      }
    }
    const auto position = sample.begin() + static_cast<std::ptrdiff_t>(
                                               0.999 * static_cast<double>(sample.size()));
    std::nth_element(sample.begin(), position, sample.end());
    if (!(*position > 0.0F)) {
      throw Error("every picture is black", "the session's values",
                  "look at the frames: no light reached the camera");
    }
    return static_cast<double>(*position);
  }

  session::Developer developer_;
  Transfer transfer_;
  TransferTable table_;
  double white_;
  int y_ = 0;
};

class ImageRows final : public PictureRows {
 public:
  ImageRows(std::vector<Image<float>> pictures, Transfer transfer)
      : pictures_(std::move(pictures)), transfer_(transfer) {
    HAARLIGHT_EXPECTS(!pictures_.empty(), "at least one picture");
  }
  [[nodiscard]] StackDims dims() const override {
    return {pictures_[0].width(), pictures_[0].height(), 3, static_cast<int>(pictures_.size())};
  }
  [[nodiscard]] Transfer transfer() const override { return transfer_; }
  void rewind() override { y_ = 0; }
  void skip(int n_rows) override { y_ += n_rows; }
  void read(int n_rows, std::span<std::uint16_t> out) override {
    std::size_t at = 0;
    for (int y = y_; y < y_ + n_rows; ++y) {
      for (const Image<float>& picture : pictures_) {
        for (int x = 0; x < picture.width(); ++x) {
          for (int c = 0; c < 3; ++c) {
            out[at++] = code_of(picture(y, x, picture.channels() == 3 ? c : 0));
          }
        }
      }
    }
    y_ += n_rows;
  }

 private:
  std::vector<Image<float>> pictures_;
  Transfer transfer_;
  int y_ = 0;
};

class SelectedRows final : public PictureRows {
 public:
  SelectedRows(PictureRows& all, std::vector<int> lights)
      : all_(&all), lights_(std::move(lights)) {}
  [[nodiscard]] StackDims dims() const override {
    StackDims shape = all_->dims();
    shape.n_lights = static_cast<int>(lights_.size());
    return shape;
  }
  [[nodiscard]] Transfer transfer() const override { return all_->transfer(); }
  void rewind() override { all_->rewind(); }
  void skip(int n_rows) override { all_->skip(n_rows); }
  void read(int n_rows, std::span<std::uint16_t> out) override {
    const StackDims shape = all_->dims();
    const std::size_t n_row = static_cast<std::size_t>(shape.width) * 3;
    const auto n_all = static_cast<std::size_t>(shape.n_lights);
    band_.resize(static_cast<std::size_t>(n_rows) * n_all * n_row);
    all_->read(n_rows, band_);
    std::uint16_t* to = out.data();
    for (std::size_t y = 0; y < static_cast<std::size_t>(n_rows); ++y) {
      for (const int k : lights_) {
        to = std::copy_n(&band_[(y * n_all + static_cast<std::size_t>(k)) * n_row], n_row, to);
      }
    }
  }

 private:
  PictureRows* all_;
  std::vector<int> lights_;
  std::vector<std::uint16_t> band_;
};

class CroppedRows final : public PictureRows {
 public:
  CroppedRows(std::unique_ptr<PictureRows> whole, const PixelRectangle& rectangle)
      : whole_(std::move(whole)), rectangle_(rectangle) {
    const StackDims shape = whole_->dims();
    HAARLIGHT_EXPECTS(rectangle.x >= 0 && rectangle.y >= 0 && rectangle.height > 0 &&
                          rectangle.x + rectangle.width <= shape.width &&
                          rectangle.y + rectangle.height <= shape.height,
                      "a rectangle of the pictures");
    CroppedRows::rewind();
  }
  [[nodiscard]] StackDims dims() const override {
    return {rectangle_.width, rectangle_.height, 3, whole_->dims().n_lights};
  }
  [[nodiscard]] Transfer transfer() const override { return whole_->transfer(); }
  void rewind() override {
    whole_->rewind();
    whole_->skip(rectangle_.y);
  }
  void skip(int n_rows) override { whole_->skip(n_rows); }
  void read(int n_rows, std::span<std::uint16_t> out) override {
    const StackDims shape = whole_->dims();
    const std::size_t n_whole = static_cast<std::size_t>(shape.width) * 3;
    const std::size_t n_row = static_cast<std::size_t>(rectangle_.width) * 3;
    const std::size_t lines =
        static_cast<std::size_t>(n_rows) * static_cast<std::size_t>(shape.n_lights);
    band_.resize(lines * n_whole);
    whole_->read(n_rows, band_);
    const std::uint16_t* from = band_.data() + static_cast<std::size_t>(rectangle_.x) * 3;
    for (std::size_t i = 0; i < lines; ++i) {
      std::copy_n(from + i * n_whole, n_row,
                  out.begin() + static_cast<std::ptrdiff_t>(i * n_row));
    }
  }

 private:
  std::unique_ptr<PictureRows> whole_;
  PixelRectangle rectangle_;
  std::vector<std::uint16_t> band_;
};

}  // namespace

std::unique_ptr<PictureRows> session_rows(const session::Session& session,
                                          const SessionRowsOptions& options) {
  if (is_display_coded(session, options.transfer) && options.white == 0.0) {
    return std::make_unique<CodedRows>(session);
  }
  return std::make_unique<DevelopedRows>(session, options);
}

std::unique_ptr<PictureRows> image_rows(std::vector<Image<float>> pictures, Transfer transfer) {
  return std::make_unique<ImageRows>(std::move(pictures), transfer);
}

std::unique_ptr<PictureRows> cropped_rows(std::unique_ptr<PictureRows> whole,
                                          const PixelRectangle& rectangle) {
  return std::make_unique<CroppedRows>(std::move(whole), rectangle);
}

std::unique_ptr<PictureRows> selected_rows(PictureRows& all, std::vector<int> lights) {
  return std::make_unique<SelectedRows>(all, std::move(lights));
}

}  // namespace haarlight::relight
