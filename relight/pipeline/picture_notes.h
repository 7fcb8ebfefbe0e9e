// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/picture/image_io.h"
#include "haarlight/relight/basis/basis_file.h"
#include "haarlight/relight/basis/relight.h"
#include "haarlight/session/session.h"

/// @file
/// Metadata of a written picture, with names explained in docs/reference/picture-notes.md: its
/// session and root, its lighting, and its accuracy.

namespace haarlight::relight {

/// The session that a picture was developed from, and the camera's metadata of its photographs.
[[nodiscard]] PictureNotes notes_of(const session::SessionInfo& info);
/// The session of a basis and its photographs' facts, with the error requested and achieved
/// when it was made.
[[nodiscard]] PictureNotes notes_of(const BasisHeader& header);

/// The weight of each light, one row per light, one number or three (red, green, blue).
void add_weights(const Eigen::MatrixXd& weights, PictureNotes& notes);
/// Relative L2 error of this very picture. @param requested  nothing: none was requested
void add_error(std::optional<double> requested, double achieved, PictureNotes& notes);
/// What that error does not cover: the fraction of the values under the lights in use that were
/// clipped in every exposure.
void add_clipped(const RelightBound& bound, PictureNotes& notes);
/// Number, name and position of a single light.
void add_light(const session::SessionInfo& info, int light, PictureNotes& notes);
/// The same light in the picture's frame, so that `haarlight import` needs no list.
/// @param seen  lights_in_picture(); empty: not known, nothing is added
void add_seen_light(const session::SessionInfo& info,
                    const std::vector<session::SessionLight>& seen, int light,
                    PictureNotes& notes);
/// The unit vector to a light, in the picture's frame.
void add_direction(const Eigen::Vector3d& direction, PictureNotes& notes);

}  // namespace haarlight::relight
