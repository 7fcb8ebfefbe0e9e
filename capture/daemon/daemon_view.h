// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <optional>

#include "capture/daemon/frame_view.h"
#include "haarlight/core/image.h"
#include "http/site.h"

/// @file
/// Pictures of frames for display, and measurements in them: the camera's newest frame here,
/// stored ones by the same functions from capture/daemon/daemon_page.cpp.
/// docs/reference/http-api.md documents the routes.

namespace haarlight::capture {

class Daemon;

/// The longest side of a crop, pixels.
inline constexpr int kMaxCrop = 1024;

/// The region requested by ?x=&y=&width=&height=; nothing when none of them is given.
/// @param width, height  of the frame
/// @throws Error  one of them is missing or not a whole number; not entirely within the frame
[[nodiscard]] std::optional<PixelRectangle> region_of(const http::HttpRequest& request,
                                                      int width, int height);

/// The region pixel by pixel, or the whole frame at most 640 pixels long, as an indexed PNG
/// (capture/daemon/preview_png.h). X-Frame-Width and X-Frame-Height give the frame's own size.
/// @throws Error  a region of more than kMaxCrop pixels per side
[[nodiscard]] http::HttpResponse png_response(ImageView<const std::uint16_t> words,
                                              const WordScale& scale,
                                              const std::optional<PixelRectangle>& region);
/// The whole frame, at most 640 pixels long, as a grey JPEG.
[[nodiscard]] http::HttpResponse jpeg_response(ImageView<const std::uint16_t> words,
                                               const WordScale& scale);
/// Histogram and sharpness of the region, or of the whole frame, as JSON.
[[nodiscard]] http::HttpResponse facts_response(ImageView<const std::uint16_t> words,
                                                const WordScale& scale,
                                                const std::optional<PixelRectangle>& region);

/// The camera's newest frame: /v1/preview.png, .jpg, /v1/preview/facts.
/// @param daemon  outlives the site
void add_view_routes(http::HttpSite& site, Daemon& daemon);

}  // namespace haarlight::capture
