#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "core/image_io.h"
#include "relight/basis/basis_file.h"
#include "relight/basis/relight.h"
#include "session/session.h"

/// @file
/// What a written picture says of itself, by names that docs/picture-notes.md explains: from
/// which session and root, under which light, and how exact.

namespace haarlight {

using PictureNotes = std::vector<PictureNote>;

/// The session that a picture was developed from.
[[nodiscard]] PictureNotes notes_of(const SessionInfo& info);
/// The session of a basis, with the error that was asked for when it was made, and reached.
[[nodiscard]] PictureNotes notes_of(const BasisHeader& header);

/// The drive of each light, one row a light, one number or three (red, green, blue).
void add_weights(const Eigen::MatrixXd& weights, PictureNotes& notes);
/// Relative L2 error of this very picture. @param asked  nothing: none was asked for
void add_error(std::optional<double> asked, double reached, PictureNotes& notes);
/// What that error does not cover: the share of the values under the lights in use that were
/// clipped in every exposure.
void add_clipped(const RelightBound& bound, PictureNotes& notes);
/// One light alone: number and name.
void add_light(const SessionInfo& info, int light, PictureNotes& notes);

}  // namespace haarlight
