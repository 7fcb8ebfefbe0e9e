// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <string>

#include "apps/viewer/viewer_site.h"
#include "haarlight/relight/reflectance/formats/reflectance.h"
#include "http/site.h"

/// @file
/// What `haarlight view` answers for a picture that is lit by direction (.ptm, .rti, a web
/// folder): its planes for the page's graphics processor, and how bytes become colours under a
/// light. Paths: docs/reference/http-api.md, "The viewer's server".

namespace haarlight::apps {

/// JSON: what the picture is, as `/v1/reflectance` answers.
/// @param hash  of the planes
[[nodiscard]] std::string reflectance_description(const relight::ReflectanceModel& model,
                                                  const std::string& hash,
                                                  const std::string& name,
                                                  const ViewerConfig& config);

/// The site keeps the model alive.
/// @param name  the file's, as the user knows it
[[nodiscard]] http::HttpSite reflectance_site(
    const std::shared_ptr<const relight::ReflectanceModel>& model, const std::string& name,
    const ViewerConfig& config);

/// Four planes as R, G, B, A of a picture, each pixel the mean of shrink x shrink ones; planes
/// beyond the last are 0. (ceil(height / shrink), ceil(width / shrink), 4) bytes.
[[nodiscard]] std::string four_planes(const relight::ReflectanceModel& model, int layer,
                                      int shrink);

}  // namespace haarlight::apps
