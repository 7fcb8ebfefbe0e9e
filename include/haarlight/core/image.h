// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <span>
#include <type_traits>
#include <vector>

#include "haarlight/core/error.h"

/// @file
/// Pixels in memory: `Image<T>` owns, `ImageView<T>` borrows. Shape (height, width, channels),
/// C order, y down, pixel centre at +0.5. Unless a comment says otherwise an `Image<float>` is
/// linear, scene-referred light with Rec. 709 primaries.

namespace haarlight {

/// A borrowed picture. The row stride is counted in elements.
template <class T>
class ImageView {
 public:
  ImageView() = default;
  ImageView(T* data, int height, int width, int channels)
      : ImageView(data, height, width, channels,
                  static_cast<std::ptrdiff_t>(width) * channels) {}
  ImageView(T* data, int height, int width, int channels, std::ptrdiff_t row_stride)
      : data_(data), height_(height), width_(width), channels_(channels), stride_(row_stride) {}

  /// ImageView<float> converts to ImageView<const float>, never back.
  template <class U>
  requires(std::is_same_v<const U, T>)
      ImageView(const ImageView<U>& other)  // NOLINT(google-explicit-constructor)
      : ImageView(other.data(), other.height(), other.width(), other.channels(),
                  other.row_stride()) {}

  [[nodiscard]] int height() const noexcept { return height_; }
  [[nodiscard]] int width() const noexcept { return width_; }
  [[nodiscard]] int channels() const noexcept { return channels_; }
  [[nodiscard]] std::ptrdiff_t row_stride() const noexcept { return stride_; }
  [[nodiscard]] T* data() const noexcept { return data_; }
  [[nodiscard]] bool is_empty() const noexcept { return height_ == 0 || width_ == 0; }

  [[nodiscard]] T& operator()(int y, int x, int c = 0) const {
    HAARLIGHT_ASSERT(y >= 0 && y < height_ && x >= 0 && x < width_ && c >= 0 && c < channels_);
    return data_[y * stride_ + static_cast<std::ptrdiff_t>(x) * channels_ + c];
  }

  /// One row: width * channels elements.
  [[nodiscard]] std::span<T> row(int y) const {
    HAARLIGHT_ASSERT(y >= 0 && y < height_);
    return {data_ + y * stride_,
            static_cast<std::size_t>(width_) * static_cast<std::size_t>(channels_)};
  }

 private:
  T* data_ = nullptr;
  int height_ = 0;
  int width_ = 0;
  int channels_ = 0;
  std::ptrdiff_t stride_ = 0;
};

/// An owned picture, rows packed, zero-initialised.
template <class T>
class Image {
 public:
  Image() = default;
  Image(int height, int width, int channels)
      : height_(height), width_(width), channels_(channels) {
    HAARLIGHT_EXPECTS(height >= 0 && width >= 0 && channels >= 1, "image shape");
    pixels_.resize(static_cast<std::size_t>(height) * static_cast<std::size_t>(width) *
                   static_cast<std::size_t>(channels));
  }

  [[nodiscard]] int height() const noexcept { return height_; }
  [[nodiscard]] int width() const noexcept { return width_; }
  [[nodiscard]] int channels() const noexcept { return channels_; }
  [[nodiscard]] bool is_empty() const noexcept { return pixels_.empty(); }
  [[nodiscard]] std::span<T> pixels() noexcept { return pixels_; }
  [[nodiscard]] std::span<const T> pixels() const noexcept { return pixels_; }

  [[nodiscard]] ImageView<T> view() noexcept {
    return {pixels_.data(), height_, width_, channels_};
  }
  [[nodiscard]] ImageView<const T> view() const noexcept {
    return {pixels_.data(), height_, width_, channels_};
  }

  [[nodiscard]] T& operator()(int y, int x, int c = 0) { return view()(y, x, c); }
  [[nodiscard]] const T& operator()(int y, int x, int c = 0) const { return view()(y, x, c); }

 private:
  int height_ = 0;
  int width_ = 0;
  int channels_ = 1;
  std::vector<T> pixels_;
};

}  // namespace haarlight
