// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "haarlight/core/image.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/session/session.h"
#include "relight/pipeline/pipeline_settings.h"

/// @file
/// The pictures used to find lights: from a session, or from a folder.

namespace haarlight::relight {

/// Which pictures, and the meaning of their numbers.
struct LightPicturesOptions {
  std::filesystem::path input;  ///< a session's folder, or a folder with one picture per light
  std::vector<std::string> exclude{};          ///< pictures whose names contain one of these
  std::vector<std::filesystem::path> masks{};  ///< pictures of the folder that show no light
  std::optional<Transfer> transfer{};  ///< of integer pictures; nothing: as the file says
};

/// One picture per light, read on demand.
class LightPictures {
 public:
  /// A session, or a folder of pictures in natural order of their names.
  /// @throws Error  nothing there, fewer than one picture, one picture twice, a session that
  ///                holds only part of its pictures or of which some are to be left out
  [[nodiscard]] static LightPictures open(const LightPicturesOptions& options,
                                          const PipelineSettings& settings);

  [[nodiscard]] const std::vector<std::string>& names() const { return names_; }
  [[nodiscard]] int size() const { return static_cast<int>(names_.size()); }
  /// Of the first picture.
  [[nodiscard]] int width() const { return width_; }
  [[nodiscard]] int height() const { return height_; }
  [[nodiscard]] int channels() const { return channels_; }
  [[nodiscard]] const session::Session* session() const {
    return session_ ? &*session_ : nullptr;
  }

  /// In order, each in linear light. `clip`: values from here on are saturated.
  /// @throws Error  naming the picture that cannot be read, is of another size, or contains NaN
  using Visit = std::function<void(int light, const Image<float>& picture, float clip)>;
  void for_each(const Visit& visit) const;

 private:
  void for_each_file(const Visit& visit) const;

  std::filesystem::path folder_;
  std::vector<std::string> names_;
  std::optional<Transfer> transfer_;
  std::optional<session::Session> session_;
  PipelineSettings settings_;
  int width_ = 0;
  int height_ = 0;
  int channels_ = 0;
};

}  // namespace haarlight::relight
