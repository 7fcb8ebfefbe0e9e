// SPDX-License-Identifier: Apache-2.0
#include "apps/viewer/publish_object.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <span>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "apps/viewer/reflectance_site.h"
#include "core/count.h"
#include "core/parallel.h"
#include "core/picture/jpeg.h"
#include "core/picture/png_tile.h"
#include "core/text_limits.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/relight/reflectance/formats/refit.h"
#include "haarlight/relight/reflectance/formats/web_folder.h"

namespace haarlight::apps {

namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

constexpr std::uint64_t kPageBytes = std::uint64_t{1} << 29U;  ///< of textures
constexpr int kMostMeasured = 16;  ///< tiles that are decoded again for the error of JPEG
constexpr int kMeasuredLights = 9;

int n_pictures(const relight::ReflectanceModel& model) { return (model.n_planes() + 2) / 3; }

/// Means of 2 x 2 pixels; at the edges of those that are there.
Image<std::uint8_t> halved(ImageView<const std::uint8_t> from) {
  Image<std::uint8_t> to((from.height() + 1) / 2, (from.width() + 1) / 2, from.channels());
  const std::size_t n = count(from.channels());
  parallel_for(count(to.height()), 16, [&](std::size_t begin, std::size_t end) {
    for (std::size_t y = begin; y < end; ++y) {
      const auto upper = from.row(static_cast<int>(2 * y));
      const auto lower = from.row(std::min(static_cast<int>(2 * y) + 1, from.height() - 1));
      const auto row = to.view().row(static_cast<int>(y));
      for (std::size_t x = 0; x < count(to.width()); ++x) {
        const std::size_t left = 2 * x * n;
        const std::size_t right = std::min(2 * x + 1, count(from.width()) - 1) * n;
        for (std::size_t p = 0; p < n; ++p) {
          const int sum =
              upper[left + p] + upper[right + p] + lower[left + p] + lower[right + p];
          row[x * n + p] = static_cast<std::uint8_t>((sum + 2) / 4);
        }
      }
    }
  });
  return to;
}

struct Tile {
  int x = 0;
  int y = 0;
  int width = 0;
  int height = 0;
};

/// Tiles of a level, row by row.
std::vector<Tile> tiles_of(int width, int height, int side) {
  std::vector<Tile> tiles;
  for (int y = 0; y < height; y += side) {
    for (int x = 0; x < width; x += side) {
      tiles.push_back({x, y, std::min(side, width - x), std::min(side, height - y)});
    }
  }
  return tiles;
}

/// Writes the levels, finest first, and notes every tile's size and checksum.
class Pyramid {
 public:
  Pyramid(const relight::ReflectanceModel& model, PublishFolder& folder,
          const PublishObjectOptions& options)
      : model_(model),
        folder_(folder),
        options_(options),
        side_(std::min(kPublishedTile, std::max(model.planes.width(), model.planes.height()))) {
    for (int longest = std::max(model.planes.width(), model.planes.height()); longest > side_;
         longest = (longest + 1) / 2) {
      ++n_levels_;
    }
  }

  void write() {
    for (int i = 0; i < n_pictures(model_); ++i) {
      folder_.add(
          fmt::format("plane_{}.dzi", i),
          fmt::format(
              "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<Image "
              "xmlns=\"http://schemas.microsoft.com/deepzoom/2008\" Format=\"{}\" "
              "Overlap=\"0\" TileSize=\"{}\"><Size Width=\"{}\" Height=\"{}\"/></Image>\n",
              ending(), side_, model_.planes.width(), model_.planes.height()));
    }
    std::vector<Json> found(count(n_levels_));
    std::size_t total = 0;
    int width = model_.planes.width();
    int height = model_.planes.height();
    for (int level = n_levels_ - 1; level >= 0; --level) {
      total += tiles_of(width, height, side_).size();
      width = (width + 1) / 2;
      height = (height + 1) / 2;
    }
    Progress progress("publish", total, options_.progress);
    found.back() = write_level(n_levels_ - 1, model_.planes.view(), progress);
    Image<std::uint8_t> smaller;
    for (int level = n_levels_ - 2; level >= 0; --level) {
      smaller = halved(smaller.is_empty() ? model_.planes.view() : smaller.view());
      found[count(level)] = write_level(level, smaller.view(), progress);
    }
    levels_ = found;
  }

  [[nodiscard]] int n_levels() const { return n_levels_; }
  [[nodiscard]] std::string ending() const { return options_.quality ? "jpg" : "png"; }
  [[nodiscard]] std::optional<double> psnr_db() const {
    return n_measured_ == 0 || squares_ == 0.0
               ? std::nullopt
               : std::optional(-10.0 * std::log10(squares_ / n_measured_));
  }

  [[nodiscard]] Json json() const {
    Json planes = Json::array();
    for (int i = 0; i < n_pictures(model_); ++i) {
      planes.push_back(relight::planes_of_picture(model_, i));
    }
    return {{"size", side_}, {"format", ending()}, {"planes", planes}, {"levels", levels_}};
  }

 private:
  [[nodiscard]] std::string encode(ImageView<const std::uint8_t> level, const Tile& tile,
                                   int picture) const {
    const std::array<int, 3> planes = relight::planes_of_picture(model_, picture);
    const std::size_t n = count(level.channels());
    const auto give = [&](int y, std::span<std::uint8_t> samples) {
      const auto row = level.row(tile.y + y);
      for (std::size_t x = 0; x < samples.size() / 3; ++x) {
        for (std::size_t c = 0; c < 3; ++c) {
          samples[3 * x + c] =
              planes[c] < 0 ? std::uint8_t{0} : row[(count(tile.x) + x) * n + count(planes[c])];
        }
      }
    };
    return options_.quality
               ? encode_jpeg({tile.height, tile.width},
                             JpegQuality{.quality = *options_.quality}, "a tile", give)
               : encode_png(tile.height, tile.width, give);
  }

  /// @return  width, height and of each picture's tiles [bytes, checksum]
  Json write_level(int level, ImageView<const std::uint8_t> planes, Progress& progress) {
    const std::vector<Tile> tiles = tiles_of(planes.width(), planes.height(), side_);
    const auto n = count(n_pictures(model_));
    std::vector<Json> files(n, Json::array());
    const std::size_t across = count((planes.width() + side_ - 1) / side_);
    for (std::size_t first = 0; first < tiles.size();
         first += across) {  // a row: bounded memory
      std::vector<std::string> bytes(across * n);
      parallel_for(bytes.size(), 1, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
          bytes[i] = encode(planes, tiles[first + i / n], static_cast<int>(i % n));
        }
      });
      for (std::size_t i = 0; i < bytes.size(); ++i) {
        const Tile& tile = tiles[first + i / n];
        folder_.add(fmt::format("plane_{}_files/{}/{}_{}.{}", i % n, level, tile.x / side_,
                                tile.y / side_, ending()),
                    bytes[i]);
        files[i % n].push_back({bytes[i].size(), crc32_of(bytes[i])});
      }
      if (options_.quality && level == n_levels_ - 1) {
        measure_row(planes, tiles, first, bytes);
      }
      progress.advance(across);
    }
    return {{"width", planes.width()}, {"height", planes.height()}, {"files", files}};
  }

  /// Decodes evenly spaced tiles again, and compares the pictures that they make.
  void measure_row(ImageView<const std::uint8_t> planes, const std::vector<Tile>& tiles,
                   std::size_t first, const std::vector<std::string>& bytes) {
    const std::size_t n = count(n_pictures(model_));
    const std::size_t stride = (tiles.size() + kMostMeasured - 1) / kMostMeasured;
    for (std::size_t t = 0; t < bytes.size() / n; ++t) {
      if ((first + t) % stride != 0) {
        continue;
      }
      const Tile& tile = tiles[first + t];
      relight::ReflectanceModel truth = without_planes();
      truth.planes = Image<std::uint8_t>(tile.height, tile.width, model_.n_planes());
      for (int y = 0; y < tile.height; ++y) {
        const auto row =
            planes.row(tile.y + y).subspan(count(tile.x) * count(model_.n_planes()));
        std::copy_n(row.begin(), truth.planes.view().row(y).size(),
                    truth.planes.view().row(y).begin());
      }
      relight::ReflectanceModel coded = truth;
      for (std::size_t i = 0; i < n; ++i) {
        const std::array<int, 3> positions =
            relight::planes_of_picture(model_, static_cast<int>(i));
        decode_jpeg(bytes[t * n + i], 3, "a tile",
                    [&](int y, std::span<const std::uint8_t> samples) {
                      for (int x = 0; x < tile.width; ++x) {
                        for (std::size_t c = 0; c < 3; ++c) {
                          if (positions[c] >= 0) {
                            coded.planes(y, x, positions[c]) = samples[3 * count(x) + c];
                          }
                        }
                      }
                    });
      }
      const relight::PictureDifference difference = relight::compare_pictures(
          truth, coded, relight::spread_over_hemisphere(kMeasuredLights, 1.0));
      squares_ += difference.is_same ? 0.0 : std::pow(10.0, -difference.mean_db / 10.0);
      ++n_measured_;
    }
  }

  [[nodiscard]] relight::ReflectanceModel without_planes() const {
    relight::ReflectanceModel model;
    model.basis = model_.basis;
    model.colour = model_.colour;
    model.transfer = model_.transfer;
    model.order4 = model_.order4;
    model.least_elevation = model_.least_elevation;
    model.n_terms = model_.n_terms;
    model.scales = model_.scales;
    model.lights = model_.lights;
    model.rbf_sigma = model_.rbf_sigma;
    model.resolution = model_.resolution;
    model.axes = model_.axes;
    return model;
  }

  const relight::ReflectanceModel& model_;
  PublishFolder& folder_;
  const PublishObjectOptions& options_;
  int side_;
  int n_levels_ = 1;
  Json levels_;
  double squares_ = 0.0;  ///< of peak 1, the sum over tiles of their means
  int n_measured_ = 0;
};

bool has_words(const relight::ReflectanceModel& model) {
  try {
    (void)relight::web_info_text(model, "", {});
    return true;
  } catch (const Error&) {
    return false;  // as 16 terms of hsh: our own page shows them, OpenLIME does not
  }
}

/// The model as the page reads it, without its planes.
Json model_json(const relight::ReflectanceModel& model) {
  Json scales = Json::array();
  for (const relight::PlaneScale& scale : model.scales) {
    scales.push_back({scale.scale, scale.offset});
  }
  Json lights = Json::array();
  for (const Eigen::Vector3d& light : model.lights) {
    lights.push_back({light.x(), light.y(), light.z()});
  }
  Json axes = Json::array();
  for (Eigen::Index row = 0; row < model.axes.rows(); ++row) {
    std::vector<double> numbers;
    for (Eigen::Index i = 0; i < model.axes.cols(); ++i) {
      numbers.push_back(static_cast<double>(model.axes(row, i)));
    }
    axes.push_back(numbers);
  }
  return {{"basis", std::string(to_string(model.basis))},
          {"colour", to_string(model.colour)},
          {"terms", model.n_terms},
          {"order4", std::string(to_string(model.order4))},
          {"least_elevation", model.least_elevation},
          {"sigma", model.rbf_sigma},
          {"resolution", model.resolution},
          {"scales", scales},
          {"lights", lights},
          {"axes", axes}};
}

/// What the page asks first, but for its tiles.
Json about_json(const relight::ReflectanceModel& model, const std::string& name) {
  const std::string hash = content_hash(std::as_bytes(model.planes.pixels()));
  auto about = parse_json<Json>(
      reflectance_description(model, hash, name, {.texture_bytes = kPageBytes}), name);
  about["model"] = model_json(model);
  return about;
}

}  // namespace

PublishedObject publish_object(const relight::ReflectanceModel& model, const std::string& name,
                               PublishFolder& folder, const PublishObjectOptions& options,
                               const PublishNotes& notes) {
  Pyramid pyramid(model, folder, options);
  pyramid.write();
  PublishedObject told{.levels = pyramid.n_levels(), .psnr_db = pyramid.psnr_db()};
  told.has_info = has_words(model);
  if (told.has_info) {
    relight::WebInfoWords words;
    words.format = pyramid.ending();
    words.quality = options.quality.value_or(100);
    words.mm_per_pixel = notes.mm_per_pixel;
    folder.add("info.json", relight::web_info_text(model, name, words));
  }
  Json about = about_json(model, name);
  about["tiles"] = pyramid.json();
  about["published"] = {
      {"words", !options.quality ? "as the file has them, nothing lost"
                : told.psnr_db   ? fmt::format("JPEG of quality {}: {:.1f} dB from the file's",
                                               *options.quality, *told.psnr_db)
                                 : fmt::format("JPEG of quality {}", *options.quality)}};
  folder.commit("reflectance.html", about.dump(), notes);
  return told;
}

bool add_page_to_web_folder(const fs::path& folder, const fs::path& web_folder) {
  std::error_code ignored;
  fs::remove(folder / "index.html", ignored);
  const auto [width, height, n_planes] = relight::web_folder_size(folder);
  constexpr int kLongestSide = 8192;  // of textures, on every graphics processor of today
  // Planes with their coarser levels, a third more, and normals.
  const double texel_bytes = 16.0 / 9.0 * n_planes + 8.0;
  if (std::max(width, height) > kLongestSide ||
      double(width) * height * texel_bytes > double(kPageBytes)) {
    return false;
  }
  // As others read it: axes are bytes there.
  const relight::ReflectanceModel written = relight::read_web_folder(folder);
  Json files = Json::array();
  Json planes = Json::array();
  for (int i = 0; i < n_pictures(written); ++i) {
    const std::string bytes = read_file(folder / fmt::format("plane_{}.jpg", i));
    files.push_back(Json::array({Json::array({bytes.size(), crc32_of(bytes)})}));
    planes.push_back(relight::planes_of_picture(written, i));
  }
  PublishNotes notes;
  notes.mm_per_pixel = relight::web_mm_per_pixel(folder);
  notes.photographed = words_of(written.photographed);
  Json about = about_json(
      written, (folder.has_filename() ? folder : folder.parent_path()).filename().string());
  about["tiles"] = {{"size", std::max(width, height)},
                    {"format", "jpg"},
                    {"isWhole", true},
                    {"planes", planes},
                    {"levels", {{{"width", width}, {"height", height}, {"files", files}}}}};
  about["published"] = Json::object();
  about["notes"] = parse_json<Json>(notes_text(notes), "the notes");
  const std::string text = about.dump();
  (void)copy_page_files(web_folder, folder);
  write_file_atomically(folder / "viewer/about.json", text);
  write_file_atomically(
      folder / "index.html",
      published_page(read_file(web_folder / "viewer/reflectance.html"),
                     fmt::format("viewer {} {}", text.size(), crc32_of(text)), notes));
  return true;
}

}  // namespace haarlight::apps
