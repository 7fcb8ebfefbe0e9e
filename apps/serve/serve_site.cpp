// SPDX-License-Identifier: Apache-2.0
#include "apps/serve/serve_site.h"

#include <algorithm>
#include <array>
#include <bit>
#include <chrono>
#include <cmath>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "apps/serve/picture_request.h"
#include "core/report.h"
#include "haarlight/core/error.h"
#include "haarlight/core/picture/image_io.h"
#include "relight/basis/weight_list.h"

namespace haarlight::apps {

namespace {

using Json = nlohmann::json;

struct PictureKind {
  std::string_view name;  ///< last part of the path
  const char* type;
};
constexpr std::string_view kRaw = "picture.f32";
constexpr auto kKinds = std::to_array<PictureKind>({{"picture.png", "image/png"},
                                                    {"picture.exr", "image/x-exr"},
                                                    {"picture.tif", "image/tiff"},
                                                    {kRaw, "application/octet-stream"}});

/// JSON has no infinity.
Json or_null(double value) { return std::isfinite(value) ? Json(value) : Json(); }

Json description(const ServedBasis& basis) {
  const relight::BasisHeader& header = basis.file().header();
  return {{"name", basis.name()},
          {"hash", basis.file().content_key()},
          {"width", header.dims.width},
          {"height", header.dims.height},
          {"channels", header.dims.channels},
          {"lights", header.dims.n_lights},
          {"rows", header.grid.rows},
          {"cols", header.grid.cols},
          {"basis", to_string(header.basis)},
          {"coding", to_string(header.coding)},
          {"error", or_null(header.achieved.relative_l2)},
          {"in_memory", basis.relighter().held()},
          {"bytes", basis.bytes()}};
}

class Pictures {
 public:
  Pictures(ServedBases bases, std::shared_ptr<SkyShelf> skies)
      : bases_(std::move(bases)), skies_(std::move(skies)) {}

  [[nodiscard]] http::HttpResponse list(std::uint64_t most_sky_bytes) const {
    Json bases = Json::array();
    for (const auto& basis : bases_) {
      bases.push_back(description(*basis));
    }
    const Json json = {
        {"format", "haarlight serve"},      {"version", 1},
        {"program", std::string(kVersion)}, {"bases", bases},
        {"skies", skies_->names()},         {"most_weight_bytes", kMostWeightBytes},
        {"most_sky_bytes", most_sky_bytes}};
    return {.body = json.dump()};
  }

  [[nodiscard]] http::HttpResponse add_sky(const http::HttpRequest& request) const {
    const SkyShelf::Sky sky = skies_->add(request.body);
    const Json json = {{"sky", sky.id},
                       {"layout", to_string(sky.environment->layout())},
                       {"colours", sky.environment->is_colour() ? 3 : 1}};
    return {.status = 201, .body = json.dump()};
  }

  [[nodiscard]] http::HttpResponse picture(const http::HttpRequest& request,
                                           const PictureKind& kind) const {
    const auto start = std::chrono::steady_clock::now();
    const std::string& name = request.captures.at("basis");
    const auto found = std::find_if(bases_.begin(), bases_.end(),
                                    [&](const auto& basis) { return basis->name() == name; });
    if (found == bases_.end()) {
      return http::error_response(404, fmt::format("there is no basis \"{}\"", name),
                                  request.path, "GET /v1/bases lists them");
    }
    const ServedBasis& basis = **found;
    const PictureRequest asked = picture_request(request);
    std::optional<SkyShelf::Sky> sky;
    if (asked.sky) {
      sky = skies_->find(*asked.sky);
      if (!sky) {
        return http::error_response(
            404, fmt::format("there is no sky \"{}\"", *asked.sky), request.path,
            "send it again to /v1/skies: those used last are kept; GET /v1/bases lists those "
            "of the folder");
      }
    }
    Json told;
    const relight::LightWeights weights = weights_of(request, asked, basis, sky, told);
    const relight::RelitPicture relit =
        std::move(basis.relighter().relight({&weights, 1}, asked.terms).front());
    http::HttpResponse response = encode(kind, relit, weights, asked, basis, told);
    const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - start;
    told["seconds"] = seconds.count();
    response.headers["Haarlight-Picture"] = told.dump();
    return response;
  }

 private:
  static relight::LightWeights weights_of(const http::HttpRequest& request,
                                          const PictureRequest& asked, const ServedBasis& basis,
                                          const std::optional<SkyShelf::Sky>& sky, Json& told) {
    const bool has_list = request.method == "POST";
    if ((has_list ? 1 : 0) + (asked.lights ? 1 : 0) + (sky ? 1 : 0) != 1) {
      throw Error(
          "one light is needed: lights, a sky, or a list of weights", request.path,
          "ask for lights=528, for sky=NAME, or POST a JSON list of every light's weight");
    }
    const int n_lights = basis.file().header().dims.n_lights;
    if (has_list) {
      return relight::weights_from_json_text(request.body, "the body", n_lights);
    }
    if (asked.lights) {
      return relight::weights_from_words({*asked.lights}, n_lights, "lights");
    }
    const auto found = basis.weights(*sky, asked.rotate_deg);
    told["missing_share"] = found->missing_fraction;
    return found->weights;
  }

  static http::HttpResponse encode(const PictureKind& kind, const relight::RelitPicture& relit,
                                   const relight::LightWeights& weights,
                                   const PictureRequest& asked, const ServedBasis& basis,
                                   Json& told) {
    const Image<float>& picture = relit.picture;
    const std::string name(kind.name);
    const double exposure = relight::relit_exposure(asked.display, name, picture);
    http::HttpResponse response;
    response.content_type = kind.type;
    if (kind.name == kRaw) {
      static_assert(std::endian::native == std::endian::little);
      const std::span<const std::byte> bytes = std::as_bytes(picture.pixels());
      response.body.assign(reinterpret_cast<const char*>(bytes.data()), bytes.size());
    } else {
      const std::vector<std::byte> bytes = encode_photograph(
          name, picture.view(), exposure,
          relight::relit_notes(basis.file().header(), relit, weights, asked.terms.max_error));
      response.body.assign(reinterpret_cast<const char*>(bytes.data()), bytes.size());
    }
    told["width"] = picture.width();
    told["height"] = picture.height();
    told["channels"] = picture.channels();
    told["error_bound"] = or_null(relit.bound.relative_l2);
    if (asked.terms.max_error) {
      told["is_error_kept"] = relit.bound.relative_l2 <= *asked.terms.max_error;
    }
    told["clipped_share"] =
        relit.bound.clipped_fraction ? Json(*relit.bound.clipped_fraction) : Json();
    told["terms"] = relit.terms;
    told["terms_all"] = relit.terms_all;
    told["exposure"] = relight::is_for_display(name) ? exposure : 1.0;
    told["method"] = relit.method;
    return response;
  }

  ServedBases bases_;
  std::shared_ptr<SkyShelf> skies_;
};

}  // namespace

http::HttpSite serve_site(const ServedBases& bases, const std::shared_ptr<SkyShelf>& skies,
                          std::uint64_t most_sky_bytes) {
  using http::Access;
  using http::HttpRequest;
  using http::Lane;
  const auto pictures = std::make_shared<const Pictures>(bases, skies);
  http::HttpSite site;
  site.add({.method = "GET",
            .pattern = "/v1/healthz",
            .handler = [](const HttpRequest&) { return http::HttpResponse{.body = "{}"}; },
            .access = Access::open,
            .lane = Lane::here});
  site.add({.method = "GET",
            .pattern = "/v1/bases",
            .handler = [pictures, most_sky_bytes](
                           const HttpRequest&) { return pictures->list(most_sky_bytes); },
            .access = Access::write});
  site.add(
      {.method = "POST",
       .pattern = "/v1/skies",
       .handler = [pictures](const HttpRequest& request) { return pictures->add_sky(request); },
       .access = Access::write,
       .lane = Lane::work,
       .max_body_bytes = most_sky_bytes});
  for (const PictureKind& kind : kKinds) {
    for (const char* method : {"GET", "POST"}) {
      site.add({.method = method,
                .pattern = fmt::format("/v1/bases/{{basis}}/{}", kind.name),
                .handler =
                    [pictures, &kind](const HttpRequest& request) {
                      return pictures->picture(request, kind);
                    },
                .access = Access::write,
                .max_body_bytes = kMostWeightBytes});
    }
  }
  return site;
}

}  // namespace haarlight::apps
