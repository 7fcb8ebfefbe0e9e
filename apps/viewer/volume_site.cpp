// SPDX-License-Identifier: Apache-2.0
#include "apps/viewer/volume_site.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "apps/viewer/volume_look.h"
#include "apps/viewer/volume_views.h"
#include "apps/volume_numbers.h"
#include "core/json_value.h"
#include "core/picture/png_tile.h"
#include "core/picture/srgb_codes.h"
#include "core/report.h"
#include "core/temporary_folder.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/picture/image_io.h"

namespace haarlight::apps {

namespace {

using Json = nlohmann::json;

constexpr const char* kPaths = "docs/reference/http-api.md tells the paths of the viewer";
constexpr std::size_t kBins = 128;  ///< of a histogram

Json range_of(std::span<const double> values) {
  const auto [low, high] = std::ranges::minmax_element(values);
  return {*low, *high};
}

Json histogram_of(std::span<const double> values) {
  const auto [low, high] = std::ranges::minmax_element(values);
  const double width = *high - *low;
  std::array<std::int64_t, kBins> counts{};
  for (const double value : values) {
    const double at = width > 0.0 ? (value - *low) / width * kBins : 0.0;
    ++counts.at(std::min(static_cast<std::size_t>(at), kBins - 1));
  }
  return counts;
}

Json field_json(const render::ScalarField& field) {
  return {{"name", field.name},
          {"on", field.is_per_cell ? "cells" : "points"},
          {"range", range_of(field.values)},
          {"histogram", histogram_of(field.values)}};
}

Json look_json(const VolumeLook& look) {
  return {{"size", look.size},
          {"camera",
           {{"eye", look.eye},
            {"target", look.target},
            {"up", look.up},
            {look.is_orthographic ? "width_mm" : "fov_y_deg", look.opening}}},
          {"density", look.density},
          {"colour", look.colour}};
}

/// JSON: what the page needs to know of the scene.
std::string description_of(const render::VolumeScene& scene, const VolumeSceneWords& words,
                           const std::filesystem::path& file) {
  Eigen::AlignedBox3d box;
  for (const Eigen::Vector3d& point : scene.mesh.points) {
    box.extend(point);
  }
  const Json json = {
      {"format", "haarlight view of a volume"},
      {"version", 1},
      {"program", std::string(kVersion)},
      {"file", file.filename().string()},
      {"path", file.string()},
      {"name", words.name},
      {"cells", scene.mesh.n_cells()},
      {"box",
       {{box.min().x(), box.min().y(), box.min().z()},
        {box.max().x(), box.max().y(), box.max().z()}}},
      {"fields",
       {{"density", field_json(scene.density_field)},
        {"colour", field_json(scene.colour_field)}}},
      {"glow", std::string(to_string(scene.glow))},
      {"has_fixed_size",
       scene.surfaces.has_value() || scene.background.kind == render::BackgroundKind::picture},
      {"look", look_json(words.look)}};
  return json.dump();
}

template <class Number>
Number number_of(const http::HttpRequest& request, const std::string& name,
                 std::string_view text, Number least, Number most) {
  Number value{};
  const auto parsed = std::from_chars(text.data(), text.data() + text.size(), value);
  if (text.empty() || parsed.ec != std::errc() || parsed.ptr != text.data() + text.size() ||
      !(value >= least && value <= most)) {
    throw Error(fmt::format("{} = \"{}\" is no number from {} to {}", name, text, least, most),
                request.path, kPaths);
  }
  return value;
}

/// Letters and digits, so that it may stand in anything.
std::string client_of(const http::HttpRequest& request) {
  constexpr std::size_t kMost = 32;
  std::string name = request.query_or("client", "");
  if (name.empty() || name.size() > kMost || !std::ranges::all_of(name, [](char c) {
        return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'z');
      })) {
    throw Error("a view of nobody", request.path,
                "give ?client=NAME, of 1 to 32 small letters and digits");
  }
  return name;
}

VolumeLook look_of(const http::HttpRequest& request) {
  return read_look(JsonValue::parse(request.body, "the view"));
}

template <EnumWithWords Enum>
Enum word_of(const http::HttpRequest& request, const char* name, const std::string& word) {
  const auto value = value_of<Enum>(word);
  if (!value) {
    throw Error(fmt::format("no {} \"{}\"", name, word), request.path, kPaths);
  }
  return *value;
}

/// As write_image() writes a .png.
std::string png_of(const Image<float>& light, double exposure) {
  return encode_png(light.height(), light.width(), [&](int y, std::span<std::uint8_t> samples) {
    const std::span<const float> row = light.view().row(y);
    for (std::size_t i = 0; i < row.size(); ++i) {
      samples[i] = SrgbCodes::table().code(row[i] * static_cast<float>(exposure));
    }
  });
}

Json errors_json(const DrawnVolume& drawn) {
  if (!drawn.preview_errors) {
    return nullptr;
  }
  const VolumeErrors& errors = *drawn.preview_errors;
  double mean = 0.0;
  double at_99 = 0.0;
  double worst = 0.0;
  for (std::size_t c = 0; c < 3; ++c) {
    mean = std::max(mean, errors.channels.at(c).mean);
    at_99 = std::max(at_99, errors.channels.at(c).at_99);
    worst = std::max(worst, errors.channels.at(c).worst);
  }
  return {{"preview", std::string(to_string(*drawn.preview))},
          {"pixels", errors.n_compared},
          {"mean", mean},
          {"at_99", at_99},
          {"worst", worst}};
}

http::HttpResponse picture_response(const DrawnVolume& drawn, const VolumePictureRequest& asked,
                                    std::optional<double> exposure, double stops) {
  const Image<float> light = layer_of(*drawn.film, render::VolumeRayCaster::kLight);
  const double factor = exposure.value_or(shown_exposure(light.pixels())) * std::exp2(stops);
  const Json facts = {{"kind", std::string(to_string(asked.kind))},
                      {"width", light.width()},
                      {"height", light.height()},
                      {"shrink", asked.shrink},
                      {"seconds", drawn.seconds},
                      {"exposure", factor},
                      {"stops", stops},
                      {"preview_errors", errors_json(drawn)}};
  return {200, "image/png", png_of(light, factor), {{"Haarlight-Picture", facts.dump()}}};
}

http::HttpResponse draw(VolumeViews& views, const http::HttpRequest& request, bool is_exr) {
  const VolumePictureRequest asked{
      .kind = is_exr
                  ? VolumePictureKind::exact
                  : word_of<VolumePictureKind>(request, "picture", request.captures.at("kind")),
      .method = word_of<render::Preview>(request, "preview", request.query_or("preview", "m1")),
      .shrink = number_of(request, "shrink", request.query_or("shrink", "1"), 1,
                          VolumeViews::kMostShrink)};
  std::optional<double> exposure;
  if (const std::string text = request.query_or("exposure", ""); !text.empty()) {
    exposure = number_of(request, "exposure", text, 1e-30, 1e30);
  }
  constexpr double kMostStops = 100.0;
  const double stops =
      number_of(request, "stops", request.query_or("stops", "0"), -kMostStops, kMostStops);
  const std::uint64_t view = number_of(request, "view", request.captures.at("view"),
                                       std::uint64_t{1}, ~std::uint64_t{0});
  const std::optional<DrawnVolume> newest = views.draw(client_of(request), view, asked);
  if (!newest) {
    return {202, "application/json", Json{{"is_replaced", true}}.dump(), {}};
  }
  const DrawnVolume& drawn = *newest;
  if (drawn.share < 1.0) {
    return {
        202,
        "application/json",
        Json{{"is_replaced", false}, {"share", drawn.share}, {"seconds", drawn.seconds}}.dump(),
        {}};
  }
  if (!is_exr) {
    return picture_response(drawn, asked, exposure, stops);
  }
  const TemporaryFolder folder;
  write_linear_picture(*drawn.film, folder / "picture.exr");
  return {200, "image/x-exr", read_file(folder / "picture.exr"), {}};
}

}  // namespace

http::HttpSite volume_site(const std::filesystem::path& file, std::uint64_t memory_bytes,
                           const ViewerConfig& config) {
  render::VolumeScene scene = render::read_volume_scene(file);
  VolumeSceneWords words = read_scene_words(file, scene);
  std::string description = description_of(scene, words, file);
  const auto views =
      std::make_shared<VolumeViews>(std::move(scene), std::move(words), memory_bytes);
  description.pop_back();
  description += "," + Json{{"most_pixels", views->most_pixels()},
                            {"no_preview", views->no_preview()},
                            {"most_rows", kMostRows},
                            {"most_shrink", VolumeViews::kMostShrink}}
                           .dump()
                           .substr(1);
  http::HttpSite site;
  site.get("/v1/volume", [description](const http::HttpRequest&) {
    return http::HttpResponse{.body = description};
  });
  site.post("/v1/volume/views", [views](const http::HttpRequest& request) {
    const std::uint64_t view = views->want(client_of(request), look_of(request));
    return http::HttpResponse{.body = Json{{"view", view}}.dump()};
  });
  site.get(
      "/v1/volume/views/{view}/{kind}",
      [views](const http::HttpRequest& request) { return draw(*views, request, false); },
      http::Lane::work);
  site.get(
      "/v1/volume/views/{view}/exact.exr",
      [views](const http::HttpRequest& request) { return draw(*views, request, true); },
      http::Lane::work);
  site.post(
      "/v1/volume/scene",
      [views](const http::HttpRequest& request) {
        return http::HttpResponse{.content_type = "application/toml",
                                  .body = views->scene_text_of(look_of(request))};
      },
      http::Lane::work);
  serve_pages(site, config, "/viewer/volume.html");
  return site;
}

}  // namespace haarlight::apps
