// SPDX-License-Identifier: Apache-2.0
#include "apps/viewer/reflectance_site.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <filesystem>
#include <string>

#include <Eigen/Core>
#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "core/report.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"

namespace haarlight::apps {

namespace {

using Json = nlohmann::json;

constexpr int kMostShrink = 64;

Json columns_of(const relight::ColourMap& map) {
  Json rows = Json::array();
  for (Eigen::Index c = 0; c < 3; ++c) {
    std::vector<double> row(static_cast<std::size_t>(map.factors.cols()));
    Eigen::RowVectorXd::Map(row.data(), map.factors.cols()) = map.factors.row(c);
    rows.push_back(row);
  }
  return {{"factors", rows}, {"added", {map.added.x(), map.added.y(), map.added.z()}}};
}

/// What multiplies an lrgb picture's luminance, in the form of a ColourMap.
relight::ColourMap tint_of(const relight::ReflectanceModel& model) {
  relight::ColourMap tint;
  tint.factors.setZero(3, model.n_planes());
  for (int c = 0; c < 3; ++c) {
    const relight::PlaneScale& scale =
        model.scales[static_cast<std::size_t>(model.n_terms) + static_cast<std::size_t>(c)];
    tint.factors(c, model.n_terms + c) = scale.scale;
    tint.added[c] = scale.offset;
  }
  return tint;
}

template <class Number>
Number parse_number(const http::HttpRequest& request, std::string_view text) {
  Number value{};
  const auto parsed = std::from_chars(text.data(), text.data() + text.size(), value);
  if (text.empty() || parsed.ec != std::errc() || parsed.ptr != text.data() + text.size()) {
    throw Error(fmt::format("\"{}\" is no number", text), request.path,
                "docs/reference/http-api.md tells the paths of the viewer");
  }
  return value;
}

http::HttpResponse light_response(const relight::ReflectanceModel& model,
                                  const http::HttpRequest& request) {
  Eigen::Vector3d light;
  constexpr std::array<const char*, 3> kNames{"x", "y", "z"};
  for (std::size_t i = 0; i < kNames.size(); ++i) {
    light[static_cast<Eigen::Index>(i)] =
        parse_number<double>(request, request.query_or(kNames[i], ""));
  }
  const double length = light.norm();
  if (!(length > 1e-9 && length < 1e9)) {
    throw Error("a light without a direction", request.path, "give x, y, z, not all 0");
  }
  return {.body = columns_of(relight::colour_map(model, light / length)).dump()};
}

}  // namespace

std::string reflectance_description(const relight::ReflectanceModel& model,
                                    const std::string& hash, const std::string& name,
                                    const ViewerConfig& config) {
  const Json json = {
      {"format", "haarlight view by direction"},
      {"version", 1},
      {"program", std::string(kVersion)},
      {"hash", hash},
      {"file", name},
      {"picture", {{"width", model.planes.width()}, {"height", model.planes.height()}}},
      {"basis", std::string(to_string(model.basis))},
      {"terms", model.n_terms},
      {"planes", model.n_planes()},
      {"tint", model.colour == relight::ReflectanceColour::lrgb ? columns_of(tint_of(model))
                                                                : Json(nullptr)},
      {"transfer", to_string(model.transfer)},
      {"texture_bytes", config.texture_bytes},
      {"most_shrink", kMostShrink}};
  return json.dump();
}

std::string four_planes(const relight::ReflectanceModel& model, int layer, int shrink) {
  const ImageView<const std::uint8_t> planes = model.planes.view();
  const int width = (planes.width() + shrink - 1) / shrink;
  const int height = (planes.height() + shrink - 1) / shrink;
  const int first = 4 * layer;
  const int n = std::min(4, planes.channels() - first);
  std::string bytes(
      std::size_t{4} * static_cast<std::size_t>(width) * static_cast<std::size_t>(height),
      '\0');
  std::size_t at = 0;
  for (int y = 0; y < height; ++y) {
    const int y1 = std::min(planes.height(), (y + 1) * shrink);
    for (int x = 0; x < width; ++x, at += 4) {
      const int x1 = std::min(planes.width(), (x + 1) * shrink);
      std::array<int, 4> sum{};
      for (int v = y * shrink; v < y1; ++v) {
        for (int u = x * shrink; u < x1; ++u) {
          for (int p = 0; p < n; ++p) {
            sum[static_cast<std::size_t>(p)] += planes(v, u, first + p);
          }
        }
      }
      const int count = (y1 - y * shrink) * (x1 - x * shrink);
      for (std::size_t p = 0; p < static_cast<std::size_t>(n); ++p) {
        bytes[at + p] = static_cast<char>((sum[p] + count / 2) / count);
      }
    }
  }
  return bytes;
}

http::HttpSite reflectance_site(const std::shared_ptr<const relight::ReflectanceModel>& model,
                                const std::string& name, const ViewerConfig& config) {
  http::HttpSite site;
  const std::string hash = content_hash(std::as_bytes(model->planes.pixels()));
  site.get("/v1/reflectance",
           [description = reflectance_description(*model, hash, name, config)](
               const http::HttpRequest&) { return http::HttpResponse{.body = description}; });
  site.get("/v1/reflectance/light", [model](const http::HttpRequest& request) {
    return light_response(*model, request);
  });
  site.get("/v1/reflectance/{hash}/planes/{layer}/{shrink}",
           [model, hash](const http::HttpRequest& request) {
             if (request.captures.at("hash") != hash) {
               throw Error("this server shows another picture now", request.path,
                           "load the page again");
             }
             const int layer = parse_number<int>(request, request.captures.at("layer"));
             const int shrink = parse_number<int>(request, request.captures.at("shrink"));
             if (layer < 0 || layer >= (model->n_planes() + 3) / 4 || shrink < 1 ||
                 shrink > kMostShrink) {
               throw Error("no such planes", request.path,
                           "docs/reference/http-api.md tells the paths of the viewer");
             }
             return immutable_bytes(four_planes(*model, layer, shrink));
           });
  serve_pages(site, config, "/viewer/reflectance.html");
  return site;
}

}  // namespace haarlight::apps
