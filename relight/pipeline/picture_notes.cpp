// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/picture_notes.h"

#include <fmt/format.h>

namespace haarlight::relight {

namespace {

void add(PictureNotes& notes, const char* name, const std::string& text) {
  if (!text.empty()) {
    notes.texts.push_back({name, text});
  }
}

std::string words_of(const Eigen::Vector3d& v) {
  return fmt::format("{:.9g} {:.9g} {:.9g}", v.x(), v.y(), v.z());
}

}  // namespace

PictureNotes notes_of(const session::SessionInfo& info) {
  PictureNotes notes{.texts = {}, .facts = info.photographed};
  add(notes, "haarlightSession", info.id);
  add(notes, "haarlightPlan", info.plan_hash);
  add(notes, "haarlightRoot", info.root);
  return notes;
}

PictureNotes notes_of(const BasisHeader& header) {
  PictureNotes notes{.texts = {}, .facts = header.photographed};
  add(notes, "haarlightSession", header.source);
  add(notes, "haarlightPlan", header.source_hash);
  add(notes, "haarlightRoot", header.source_root);
  add(notes, "haarlightBasisErrorAsked", fmt::format("{:.9g}", header.requested_relative_l2));
  add(notes, "haarlightBasisErrorReached", fmt::format("{:.9g}", header.achieved.relative_l2));
  add(notes, "haarlightBasisClippedShare",
      header.clipped ? fmt::format("{:.9g}", header.clipped->fraction(header.dims))
                     : "not known");
  return notes;
}

void add_weights(const Eigen::MatrixXd& weights, PictureNotes& notes) {
  std::string text;
  for (Eigen::Index k = 0; k < weights.rows(); ++k) {
    for (Eigen::Index c = 0; c < weights.cols(); ++c) {
      text += fmt::format("{}{:.9g}", c > 0 ? " " : (k > 0 ? "; " : ""), weights(k, c));
    }
  }
  add(notes, "haarlightWeights", text);
}

void add_error(std::optional<double> requested, double achieved, PictureNotes& notes) {
  add(notes, "haarlightErrorAsked", requested ? fmt::format("{:.9g}", *requested) : "none");
  add(notes, "haarlightErrorReached", fmt::format("{:.9g}", achieved));
}

void add_clipped(const RelightBound& bound, PictureNotes& notes) {
  add(notes, "haarlightClippedShare",
      bound.clipped_fraction ? fmt::format("{:.9g}", *bound.clipped_fraction) : "not known");
}

void add_light(const session::SessionInfo& info, int light, PictureNotes& notes) {
  const auto k = static_cast<std::size_t>(light);
  add(notes, "haarlightLight",
      fmt::format("{} {}", light, k < info.lights.size() ? info.lights[k].name : ""));
  if (k < info.lights.size()) {
    if (info.lights[k].is_position) {
      add(notes, "haarlightLightPosition", words_of(info.lights[k].coordinates));
    } else {
      add_direction(info.lights[k].coordinates, notes);
    }
  }
}

void add_seen_light(const session::SessionInfo& info,
                    const std::vector<session::SessionLight>& seen, int light,
                    PictureNotes& notes) {
  const auto k = static_cast<std::size_t>(light);
  if (k < seen.size() && seen[k].is_position) {
    add(notes, "haarlightLightFromObject", words_of(seen[k].coordinates));
    if (seen[k].lobe) {
      add(notes, "haarlightLightLobe",
          fmt::format("{} {:.9g}", words_of(seen[k].lobe->axis), seen[k].lobe->mu));
    }
  }
  if (const std::optional<session::FrameCrop>& crop = info.form.crop) {
    add(notes, "haarlightCrop",
        fmt::format("{} {} {} {}", crop->x, crop->y, crop->whole_width, crop->whole_height));
  }
}

void add_direction(const Eigen::Vector3d& direction, PictureNotes& notes) {
  add(notes, "haarlightLightDirection", words_of(direction));
}

}  // namespace haarlight::relight
