// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <vector>

#include <Eigen/Core>

#include "core/picture/image_io.h"
#include "relight/basis/basis_file.h"
#include "relight/basis/relight.h"
#include "session/session.h"

/// @file
/// What a written picture says of itself, by names that docs/reference/picture-notes.md
/// explains: from which session and root, under which light, and how exact.

namespace haarlight {

/// The session that a picture was developed from, and what its photographs' camera wrote.
[[nodiscard]] PictureNotes notes_of(const SessionInfo& info);
/// The session of a basis and its photographs' facts, with the error that was asked for when it
/// was made, and reached.
[[nodiscard]] PictureNotes notes_of(const BasisHeader& header);

/// The drive of each light, one row a light, one number or three (red, green, blue).
void add_weights(const Eigen::MatrixXd& weights, PictureNotes& notes);
/// Relative L2 error of this very picture. @param asked  nothing: none was asked for
void add_error(std::optional<double> asked, double reached, PictureNotes& notes);
/// What that error does not cover: the share of the values under the lights in use that were
/// clipped in every exposure.
void add_clipped(const RelightBound& bound, PictureNotes& notes);
/// Number, name and place of one light, alone.
void add_light(const SessionInfo& info, int light, PictureNotes& notes);
/// The same light as the picture sees it, by which `haarlight import` needs no list.
/// @param seen  lights_in_picture(); empty: not known, nothing is added
void add_seen_light(const SessionInfo& info, const std::vector<SessionLight>& seen, int light,
                    PictureNotes& notes);
/// The unit vector to a light, in the picture's frame.
void add_direction(const Eigen::Vector3d& direction, PictureNotes& notes);

}  // namespace haarlight
