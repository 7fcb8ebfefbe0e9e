// SPDX-License-Identifier: Apache-2.0
#include "capture/daemon/daemon_view.h"

#include <array>
#include <charconv>
#include <functional>
#include <map>
#include <string>
#include <utility>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "capture/camera/grey_jpeg.h"
#include "capture/daemon/daemon.h"
#include "capture/daemon/preview_png.h"
#include "core/thread_pulse.h"
#include "haarlight/core/error.h"

namespace haarlight::capture {

namespace {

using Json = nlohmann::ordered_json;

constexpr std::size_t kMaxKept = 32;  // cached answers about one frame

/// The whole frame as codes.
Image<std::uint8_t> overview(ImageView<const std::uint16_t> words, const WordScale& scale) {
  return make_preview_codes(words, scale.black_dn, scale.clip_dn,
                            preview_step(words.width(), words.height(), scale.bayer));
}

Json region_json(const PixelRectangle& region) {
  return {{"x", region.x}, {"y", region.y}, {"width", region.width}, {"height", region.height}};
}

/// The camera's newest frame. Answers about a frame are cached: ten viewers cost no more than
/// one.
class LiveView {
 public:
  explicit LiveView(Daemon& daemon)
      : daemon_(daemon), scale_(word_scale(daemon.rig().cameras.front())) {}

  using Make =
      std::function<http::HttpResponse(ImageView<const std::uint16_t>, const WordScale&)>;
  http::HttpResponse answer(const http::HttpRequest& request, const Make& make) {
    const std::shared_ptr<const TappedFrame> frame = daemon_.newest_frame();
    if (frame == nullptr && request.query.contains("after")) {
      return {.status = 204};
    }
    if (frame == nullptr) {
      return http::error_response(
          404, "no frame has come since somebody looks", request.path,
          "ask again in a moment while the camera streams; a run or POST "
          "/v1/preview makes it stream");
    }
    std::string key = request.path;
    for (const auto& [name, value] : request.query) {
      if (name == "after" && value == std::to_string(frame->number)) {
        return named({.status = 204}, *frame);
      }
      if (name != "after") {
        key += fmt::format("\n{}={}", name, value);
      }
    }
    if (number_ != frame->number || answers_.size() >= kMaxKept) {
      answers_.clear();
      number_ = frame->number;
    }
    const auto known = answers_.find(key);
    if (known != answers_.end()) {
      return named(known->second, *frame);
    }
    http::HttpResponse response = make(frame->words.view(), scale_);
    answers_.emplace(std::move(key), response);
    return named(std::move(response), *frame);
  }

 private:
  [[nodiscard]] http::HttpResponse named(http::HttpResponse response,
                                         const TappedFrame& frame) const {
    response.headers["X-Frame-Number"] = std::to_string(frame.number);
    response.headers["X-Frame-Sequence"] = std::to_string(frame.sequence);
    response.headers["X-Frame-Age-Ms"] =
        std::to_string((daemon_.clock().now_ns() - frame.arrived_ns) / 1'000'000);
    return response;
  }

  Daemon& daemon_;
  WordScale scale_;
  // Used by one lane's thread.
  std::uint64_t number_ = 0;
  std::map<std::string, http::HttpResponse> answers_;
};

}  // namespace

std::optional<PixelRectangle> region_of(const http::HttpRequest& request, int width,
                                        int height) {
  constexpr std::array<const char*, 4> kNames{"x", "y", "width", "height"};
  std::array<int, 4> values{};
  int n_given = 0;
  for (std::size_t i = 0; i < kNames.size(); ++i) {
    const auto it = request.query.find(kNames[i]);
    if (it == request.query.end()) {
      continue;
    }
    ++n_given;
    const std::string& text = it->second;
    const auto [end, error] =
        std::from_chars(text.data(), text.data() + text.size(), values[i]);
    if (error != std::errc() || end != text.data() + text.size()) {
      throw Error(fmt::format("{} = \"{}\" is no whole number", kNames[i], text), request.path,
                  "write pixels, such as ?x=100&y=80&width=400&height=300");
    }
  }
  if (n_given == 0) {
    return std::nullopt;
  }
  if (n_given < 4) {
    throw Error("a region needs x, y, width and height", request.path,
                "write all four, such as ?x=100&y=80&width=400&height=300, or none");
  }
  const PixelRectangle region{values[0], values[1], values[2], values[3]};
  if (region.x < 0 || region.y < 0 || region.width < 1 || region.height < 1 ||
      region.width > width || region.height > height || region.x > width - region.width ||
      region.y > height - region.height) {
    throw Error(fmt::format("the region {} x {} at ({}, {}) is not wholly in the frame",
                            region.width, region.height, region.x, region.y),
                request.path, fmt::format("the frame has {} x {} pixels", width, height));
  }
  return region;
}

http::HttpResponse png_response(ImageView<const std::uint16_t> words, const WordScale& scale,
                                const std::optional<PixelRectangle>& region) {
  if (region && (region->width > kMaxCrop || region->height > kMaxCrop)) {
    throw Error(fmt::format("a crop of {} x {} pixels", region->width, region->height),
                "width, height", fmt::format("ask for at most {0} x {0}", kMaxCrop));
  }
  const Image<std::uint8_t> codes =
      region ? make_crop_codes(words, scale, *region) : overview(words, scale);
  return {.content_type = "image/png",
          .body = encode_preview_png(codes.view()),
          .headers = {
              {"X-Saturated-Share", fmt::format("{:.6f}", saturated_fraction_of(codes.view()))},
              {"X-Frame-Width", std::to_string(words.width())},
              {"X-Frame-Height", std::to_string(words.height())},
              {"Cache-Control", "no-store"}}};
}

http::HttpResponse jpeg_response(ImageView<const std::uint16_t> words, const WordScale& scale) {
  Image<std::uint8_t> grey = overview(words, scale);
  const double fraction = saturated_fraction_of(std::as_const(grey).view());
  for (std::uint8_t& code : grey.pixels()) {
    code = code == kCodeSaturated ? 255
           : code == kCodeBlack   ? 0
                                  : static_cast<std::uint8_t>(code * 255 / kCodeWhitest);
  }
  return {.content_type = "image/jpeg",
          .body = encode_grey_jpeg(std::as_const(grey).view()),
          .headers = {{"X-Saturated-Share", fmt::format("{:.6f}", fraction)},
                      {"Cache-Control", "no-store"}}};
}

http::HttpResponse facts_response(ImageView<const std::uint16_t> words, const WordScale& scale,
                                  const std::optional<PixelRectangle>& region) {
  const PixelRectangle all{0, 0, words.width(), words.height()};
  const PixelRectangle& requested = region ? *region : all;
  Json colours = Json::array();
  for (const ColourCounts& counts : count_words(words, scale, requested)) {
    colours.push_back({{"colour", counts.colour},
                       {"bins", counts.bins},
                       {"pixels", counts.n},
                       {"black", counts.n_black},
                       {"saturated", counts.n_saturated},
                       {"mean_dn", counts.mean_dn}});
  }
  const Sharpness sharpness = measure_sharpness(words, scale, requested);
  const Json json = {{"frame", {{"width", words.width()}, {"height", words.height()}}},
                     {"region", region_json(requested)},
                     {"black_dn", scale.black_dn},
                     {"clip_dn", scale.clip_dn},
                     {"white_dn", scale.white_dn},
                     {"histogram", std::move(colours)},
                     {"sharpness",
                      {{"value", sharpness.value},
                       {"noise", sharpness.noise},
                       {"share_used", sharpness.fraction_used},
                       {"level_dn", sharpness.level_dn}}}};
  return {.body = json.dump() + "\n", .headers = {{"Cache-Control", "no-store"}}};
}

void add_view_routes(http::HttpSite& site, Daemon& daemon) {
  const auto live = std::make_shared<LiveView>(daemon);
  site.get("/v1/preview.png", [live](const http::HttpRequest& r) {
    return live->answer(r, [&r](auto words, const WordScale& scale) {
      return png_response(words, scale, region_of(r, words.width(), words.height()));
    });
  });
  site.get("/v1/preview.jpg",
           [live](const http::HttpRequest& r) { return live->answer(r, jpeg_response); });
  site.get("/v1/preview/facts", [live](const http::HttpRequest& r) {
    return live->answer(r, [&r](auto words, const WordScale& scale) {
      return facts_response(words, scale, region_of(r, words.width(), words.height()));
    });
  });
}

}  // namespace haarlight::capture
