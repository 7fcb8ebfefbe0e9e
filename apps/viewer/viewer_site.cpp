// SPDX-License-Identifier: Apache-2.0
#include "apps/viewer/viewer_site.h"

#include <bit>
#include <charconv>
#include <cmath>
#include <cstring>
#include <optional>
#include <string>
#include <utility>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "core/report.h"
#include "haarlight/core/error.h"
#include "haarlight/core/rig/rig.h"
#include "relight/basis/error_gram.h"
#include "relight/view/gpu_pages.h"

namespace haarlight::apps {

namespace {

using Json = nlohmann::json;

constexpr const char* kBytes = "application/octet-stream";

int number(const http::HttpRequest& request, std::string_view text) {
  int value = 0;
  const auto parsed = std::from_chars(text.data(), text.data() + text.size(), value);
  if (text.empty() || parsed.ec != std::errc() || parsed.ptr != text.data() + text.size()) {
    throw Error(fmt::format("\"{}\" is no whole number", text), request.path,
                "docs/reference/http-api.md tells the paths of the viewer");
  }
  return value;
}

/// "3-17"
relight::TileRun tile_run(const http::HttpRequest& request) {
  const std::string& text = request.captures.at("tiles");
  const std::size_t dash = text.find('-');
  if (dash == std::string::npos) {
    throw Error(fmt::format("\"{}\" is no run of tiles", text), request.path,
                "write FIRST-LAST");
  }
  return {number(request, std::string_view(text).substr(0, dash)),
          number(request, std::string_view(text).substr(dash + 1))};
}

/// Faces of a rig, or where on the hemisphere's map each light of an import stands: azimuthal,
/// equidistant, +y up, the zenith at (0, 0), the horizon at distance 1.
void add_lights(Json& json, const relight::BasisFile& basis) {
  const relight::BasisHeader& header = basis.header();
  if (!header.rig_toml.empty()) {
    Json faces = Json::array();
    int first = 0;
    for (const Face& face : parse_rig(header.rig_toml, basis.name() + " (rig)").faces) {
      faces.push_back(
          {{"id", face.id}, {"first", first}, {"rows", face.rows}, {"cols", face.cols}});
      first += face.n_lights();
    }
    json["faces"] = faces;
    return;
  }
  Json positions = Json::array();
  Json names = Json::array();
  for (const relight::BasisLight& light : header.lights) {
    const Eigen::Vector3d d = light.coordinates.normalized();
    const double planar = std::hypot(d.x(), d.y());
    const double angle = std::atan2(planar, d.z()) / std::asin(1.0);
    positions.push_back(planar > 0.0 ? Json{angle * d.x() / planar, angle * d.y() / planar}
                                     : Json{0.0, 0.0});
    names.push_back(light.name);
  }
  json["places"] = positions;
  json["names"] = names;
}

/// JSON has no infinity.
Json or_null(double value) { return std::isfinite(value) ? Json(value) : Json(); }

http::HttpResponse weights_response(EnvironmentCache& cache, const http::HttpRequest& request) {
  const std::string text = request.query_or("rotate", "0");
  double angle = 0.0;
  const auto parsed = std::from_chars(text.data(), text.data() + text.size(), angle);
  if (parsed.ec != std::errc() || parsed.ptr != text.data() + text.size() ||
      !std::isfinite(angle)) {
    throw Error(fmt::format("\"{}\" is no angle", text), request.path,
                "rotate is a number of degrees");
  }
  const std::string word = request.query_or("quality", "exact");
  const auto quality = value_of<EnvironmentCache::Quality>(word);
  if (!quality) {
    throw Error(fmt::format("no quality \"{}\"", word), request.path, "write exact or quick");
  }
  const std::string& id = request.captures.at("id");
  const auto found = cache.weights(id, angle, *quality);
  if (!found) {
    return {202, "application/json", R"({"is_ready": false})", {}};
  }
  const Eigen::MatrixXd& w = found->weights;
  Json columns = Json::array();
  for (Eigen::Index c = 0; c < w.cols(); ++c) {
    columns.push_back(std::vector<double>(w.col(c).data(), w.col(c).data() + w.rows()));
  }
  const Json json = {
      {"is_ready", true}, {"layout", cache.layout(id).value_or("")},  {"rotate", angle},
      {"quality", word},  {"missing_share", found->missing_fraction}, {"weights", columns}};
  return {200, "application/json", json.dump(), {}};
}

}  // namespace

std::string basis_description(const relight::BasisFile& basis, const ViewerConfig& config) {
  const relight::BasisHeader& header = basis.header();
  Json groups = Json::array();
  for (int g = 0; g < basis.n_groups(); ++g) {
    groups.push_back({basis.group_begin(g), basis.group_end(g)});
  }
  Json json = {
      {"format", "haarlight view"},
      {"version", 1},
      {"program", std::string(kVersion)},
      {"hash", basis.content_key()},
      {"file", std::filesystem::path(basis.name()).filename().string()},
      {"bytes", basis.n_bytes()},
      {"picture",
       {{"width", header.dims.width},
        {"height", header.dims.height},
        {"channels", header.dims.channels}}},
      {"tile", header.tile},
      {"side", relight::page_side(header)},
      {"n_tiles", basis.n_tiles()},
      {"lights",
       {{"count", header.dims.n_lights},
        {"rows", header.grid.rows},
        {"cols", header.grid.cols}}},
      {"basis", std::string(to_string(header.basis))},
      {"coding", header.coding == relight::BasisCoding::quantised ? "quantised" : "lossless"},
      {"order", basis.order()},
      {"groups", groups},
      {"step", header.step},
      {"half_scale", relight::half_scale(header)},
      {"plate",
       {{"kind", to_string(header.plate)},
        {"rank", header.plate_rank},
        {"degree", header.plate_degree},
        {"gain_step", header.gain_step}}},
      {"stack", {{"norm", header.stack_norm}, {"peak", header.peak}}},
      {"asked", {{"relative_l2", or_null(header.requested_relative_l2)}}},
      {"reached", {{"relative_l2", or_null(header.achieved.relative_l2)}}},
      {"source", header.source},
      {"texture_bytes", config.texture_bytes},
      {"answer_bytes", relight::kMostPageBytes},
      {"environment_bytes", kMostEnvironmentBytes},
  };
  const relight::BasisTables& tables = basis.tables();
  if (!tables.coded_bound.is_empty()) {
    json["coded_bound"] = {{"vectors", tables.coded_bound.n_vectors},
                           {"block", relight::kGramBlock}};
  }
  if (!tables.term_bound.is_empty()) {
    json["term_bound"] = {{"vectors", tables.term_bound.n_vectors},
                          {"block", relight::kGramBlock}};
  }
  if (header.clipped) {
    json["clipped"] = {{"share", header.clipped->fraction(header.dims)},
                       {"least_norm", header.clipped->least_norm}};
  }
  add_lights(json, basis);
  return json.dump();
}

std::string basis_table_bytes(const relight::BasisFile& basis) {
  static_assert(std::endian::native == std::endian::little);
  const relight::BasisTables& tables = basis.tables();
  std::string bytes;
  for (const auto* part :
       {&tables.plate_vectors, &tables.coefficient_norms, &tables.coefficient_errors,
        &tables.light_norms, &tables.light_errors, &tables.coded_bound.fractions,
        &tables.coded_bound.rests, &tables.coded_bound.vectors, &tables.term_bound.fractions,
        &tables.term_bound.rests, &tables.term_bound.vectors}) {
    bytes.append(reinterpret_cast<const char*>(part->data()), part->size() * sizeof(float));
  }
  return bytes;
}

http::HttpResponse immutable_bytes(std::string body) {
  return {200,
          kBytes,
          std::move(body),
          {{"Cache-Control", "private, max-age=31536000, immutable"}}};
}

void serve_pages(http::HttpSite& site, const ViewerConfig& config, const std::string& first) {
  if (config.web_folder.empty()) {
    return;
  }
  site.get("/", [first](const http::HttpRequest&) {
    return http::HttpResponse{
        .status = 303, .content_type = "text/plain", .headers = {{"Location", first}}};
  });
  site.set_static_files("/", config.web_folder);
}

namespace {

http::HttpResponse hull_state(const HullCache& cache) {
  const HullCache::Look now = cache.look();
  if (now.hull) {
    return {.body = now.hull->description};
  }
  Json json = {{"state", to_string(now.state)}};
  if (now.problem) {
    json["problem"] = {{"what", now.problem->problem()},
                       {"where", now.problem->where()},
                       {"cure", now.problem->hint()}};
  }
  return {.status = now.state == HullCache::State::carving ? 202 : 200, .body = json.dump()};
}

void add_hull(http::HttpSite& site, const std::shared_ptr<HullCache>& cache) {
  site.get("/v1/hull", [cache](const http::HttpRequest&) { return hull_state(*cache); });
  site.post("/v1/hull", [cache](const http::HttpRequest&) {
    cache->begin();
    return hull_state(*cache);
  });
  const auto get_part = [&](const char* name, std::string HullForPage::*part) {
    site.get(fmt::format("/v1/hull/{{hash}}/{}", name), [cache, part](
                                                            const http::HttpRequest& request) {
      const std::shared_ptr<const HullForPage> hull = cache->look().hull;
      if (!hull || request.captures.at("hash") != hull->hash) {
        throw Error("this server shows another hull now", request.path, "load the page again");
      }
      return immutable_bytes((*hull).*part);
    });
  };
  get_part("voxels", &HullForPage::voxels);
  get_part("surface", &HullForPage::surface);
}

}  // namespace

http::HttpSite viewer_site(const std::shared_ptr<const relight::BasisFile>& basis,
                           const std::shared_ptr<EnvironmentCache>& cache,
                           const std::shared_ptr<HullCache>& hull, const ViewerConfig& config) {
  http::HttpSite site;
  const std::string hash = basis->content_key();
  const auto get_data = [&site, hash](const std::string& path, auto answer) {
    site.get("/v1/basis/{hash}/" + path, [hash, answer](const http::HttpRequest& request) {
      if (request.captures.at("hash") != hash) {
        throw Error("this server shows another basis file now", request.path,
                    "load the page again");
      }
      return immutable_bytes(answer(request));
    });
  };
  site.get("/v1/basis",
           [description = basis_description(*basis, config)](const http::HttpRequest&) {
             return http::HttpResponse{.body = description};
           });
  get_data("tables", [basis](const http::HttpRequest&) { return basis_table_bytes(*basis); });
  get_data("pages/{channel}/{group}/{tiles}", [basis](const http::HttpRequest& request) {
    return relight::coefficient_pages(*basis, number(request, request.captures.at("channel")),
                                      number(request, request.captures.at("group")),
                                      tile_run(request));
  });
  get_data("gains/{channel}/{tiles}", [basis](const http::HttpRequest& request) {
    return relight::gain_pages(*basis, number(request, request.captures.at("channel")),
                               tile_run(request));
  });
  get_data("polynomials/{channel}/{tiles}", [basis](const http::HttpRequest& request) {
    return relight::plate_polynomials(*basis, number(request, request.captures.at("channel")),
                                      tile_run(request));
  });
  get_data("shifts/{channel}/{tiles}", [basis](const http::HttpRequest& request) {
    return relight::shift_pages(*basis, number(request, request.captures.at("channel")),
                                tile_run(request));
  });
  site.post("/v1/environments", [cache](const http::HttpRequest& request) {
    const std::string id =
        cache->add(request.body, request.query_or("name", "the picture that was sent"));
    return http::HttpResponse{.status = 202, .body = Json{{"id", id}}.dump()};
  });
  site.get("/v1/environments/{id}/weights", [cache](const http::HttpRequest& request) {
    return weights_response(*cache, request);
  });
  add_hull(site, hull);
  serve_pages(site, config, "/viewer/index.html");
  return site;
}

}  // namespace haarlight::apps
