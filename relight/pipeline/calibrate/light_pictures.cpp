// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/calibrate/light_pictures.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/session/import/picture_match.h"
#include "relight/pipeline/session_stack.h"

namespace haarlight::relight {

namespace {

namespace fs = std::filesystem;

constexpr float kAny = std::numeric_limits<float>::infinity();

bool is_mask(const fs::path& picture, const std::vector<fs::path>& masks) {
  return std::any_of(masks.begin(), masks.end(), [&](const fs::path& mask) {
    std::error_code ignored;
    return fs::equivalent(picture, mask, ignored) && !ignored;
  });
}

void require_finite(const Image<float>& picture, const fs::path& file) {
  const std::span<const float> pixels = picture.pixels();
  const auto bad =
      std::find_if(pixels.begin(), pixels.end(), [](float v) { return !std::isfinite(v); });
  if (bad == pixels.end()) {
    return;
  }
  const auto pixel = static_cast<std::size_t>(bad - pixels.begin()) /
                     static_cast<std::size_t>(picture.channels());
  const auto width = static_cast<std::size_t>(picture.width());
  throw Error(
      fmt::format("pixel (x {}, y {}) is not a finite number", pixel % width, pixel / width),
      file.string(), "repair or replace the picture");
}

}  // namespace

LightPictures LightPictures::open(const LightPicturesOptions& options,
                                  const PipelineSettings& settings) {
  LightPictures out;
  out.settings_ = settings;
  out.folder_ = options.input;
  out.transfer_ = options.transfer;
  const std::string input = options.input.string();
  std::error_code ignored;
  if (!fs::exists(out.folder_, ignored)) {
    throw Error("not found", input, "name a session, or a folder of pictures");
  }
  if (fs::exists(out.folder_ / "session.json", ignored)) {
    if (!options.exclude.empty()) {
      throw Error("pictures of a session cannot be left out", "--exclude",
                  "leave the option out", ExitCode::usage);
    }
    out.session_ = session::Session::open(options.input);
    const session::SessionInfo& info = out.session_->info();
    if (info.form.crop) {
      throw Error(
          "holds a part of its pictures: lights are found from the middle of whole ones", input,
          "import them without --crop and calibrate on that");
    }
    for (std::size_t k = 0; k < info.lights.size(); ++k) {
      const std::string& name = info.lights[k].name;
      out.names_.push_back(name.empty() ? fmt::format("light{}", k) : name);
    }
    out.width_ = info.form.width;
    out.height_ = info.form.height;
    return out;
  }
  for (const std::string& name : session::picture_names(out.folder_)) {
    const bool is_excluded = std::any_of(
        options.exclude.begin(), options.exclude.end(),
        [&](const std::string& part) { return name.find(part) != std::string::npos; });
    if (!is_excluded && !is_mask(out.folder_ / name, options.masks)) {
      out.names_.push_back(name);
    }
  }
  if (out.names_.empty()) {
    throw Error("no pictures", input,
                "one picture for each light: .jpg, .png, .tif, .exr, .tga or .hdr");
  }
  std::vector<session::LightPicture> pictures;
  for (const std::string& name : out.names_) {
    pictures.push_back({name, out.folder_ / name});
  }
  (void)session::hashes_of_different(pictures, pictures.size());
  const PictureFile first = read_picture(out.folder_ / out.names_.front());
  out.width_ = first.pixels.width();
  out.height_ = first.pixels.height();
  out.channels_ = first.pixels.channels();
  return out;
}

void LightPictures::for_each(const Visit& visit) const {
  if (!session_) {
    for_each_file(visit);
    return;
  }
  const session::Developed developed =
      session::develop_all(*session_, develop_options(*session_, settings_, transfer_));
  const std::vector<float> clip = clip_levels(*session_);
  for_each_light_image(
      developed.stack, settings_.memory_bytes, [&](int k, const Image<float>& picture) {
        float most = kAny;
        // For channels with separate gains the least: conservative.
        for (auto i = static_cast<std::size_t>(k); i < clip.size(); i += names_.size()) {
          most = std::min(most, clip[i]);
        }
        visit(k, picture, most);
      });
}

void LightPictures::for_each_file(const Visit& visit) const {
  Progress progress("pictures", names_.size(), settings_.progress);
  for (std::size_t k = 0; k < names_.size(); ++k) {
    const fs::path file = folder_ / names_[k];
    PictureFile picture = read_picture(file);
    Image<float>& pixels = picture.pixels;
    if (pixels.width() != width_ || pixels.height() != height_ ||
        pixels.channels() != channels_) {
      throw Error(
          fmt::format("{} x {} x {}; {} has {} x {} x {}", pixels.width(), pixels.height(),
                      pixels.channels(), names_.front(), width_, height_, channels_),
          file.string(),
          "all pictures have one size and kind: leave others out with --exclude");
    }
    require_finite(pixels, file);
    const Transfer transfer = transfer_.value_or(picture.transfer);
    if (!picture.is_floating && transfer == Transfer::srgb) {
      for (float& value : pixels.pixels()) {
        value = linear_from_srgb(value);
      }
    }
    // Integers end at 1; just below because of rounding.
    visit(static_cast<int>(k), pixels, picture.is_floating ? kAny : 0.9995F);
    progress.advance();
  }
}

}  // namespace haarlight::relight
