// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <string>

#include "haarlight/relight/basis/relight.h"
#include "http/site.h"
#include "relight/pipeline/relit_picture.h"

/// @file
/// What a request asks of a picture besides its light, read from its query.

namespace haarlight::apps {

struct PictureRequest {
  std::optional<std::string> lights;  ///< words for weights_from_words()
  std::optional<std::string> sky;     ///< a SkyShelf's id
  double rotate_deg = 0.0;            ///< of the sky
  relight::RelightOptions terms;
  relight::RelitDisplay display;
};

/// @throws Error(bad_input)  an unknown name, no number, a number out of its range
[[nodiscard]] PictureRequest picture_request(const http::HttpRequest& request);

}  // namespace haarlight::apps
