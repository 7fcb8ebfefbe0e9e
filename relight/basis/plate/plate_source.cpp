// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/basis/plate/plate_source.h"

#include "haarlight/core/error.h"
#include "haarlight/session/develop/develop.h"
#include "relight/basis/plate/planes_plate.h"

namespace haarlight::relight {

PlateChoice PlateChoice::parse(const std::string& text) {
  if (text.empty()) {
    return {};
  }
  if (text == "none") {
    return {Kind::none, {}};
  }
  if (std::filesystem::is_directory(text)) {
    return {Kind::session, text};
  }
  if (std::filesystem::is_regular_file(text)) {
    return {Kind::file, text};
  }
  throw Error("no such clean plate", text, "give a .hlb file, a session's folder, or none");
}

int camera_of_size(const Rig& rig, int width, int height) {
  for (std::size_t i = 0; i < rig.cameras.size(); ++i) {
    if (rig.cameras[i].model.width == width && rig.cameras[i].model.height == height) {
      return static_cast<int>(i);
    }
  }
  return -1;
}

OpenPlate open_plate(const Rig* rig, const StackDims& dims, const PlateChoice& choice,
                     const PlateOptions& options) {
  OpenPlate plate;
  switch (choice.kind) {
    case PlateChoice::Kind::none:
      break;
    case PlateChoice::Kind::automatic: {
      if (rig == nullptr || rig->planes.empty() || rig->n_lights() != dims.n_lights) {
        break;
      }
      const int camera = camera_of_size(*rig, dims.width, dims.height);
      if (camera >= 0) {
        plate.source = make_rig_plate(*rig, camera);
        plate.origin = PlateOrigin::computed;
        plate.hash = rig->hash;
        plate.key = plate.hash;
      }
      break;
    }
    case PlateChoice::Kind::file:
      plate.basis = std::make_unique<BasisFile>(BasisFile::open(choice.path));
      plate.source = std::make_unique<BasisSource>(*plate.basis);
      plate.origin = plate.basis->header().content == BasisContent::plate
                         ? PlateOrigin::computed
                         : PlateOrigin::captured;
      plate.hash = plate.basis->header().rig_hash;
      plate.key = plate.basis->content_key();
      break;
    case PlateChoice::Kind::session: {
      plate.session = std::make_unique<session::Session>(session::Session::open(choice.path));
      session::DevelopOptions develop_options;
      develop_options.memory_bytes = options.memory_bytes;
      develop_options.progress = options.progress;
      develop_options.unknown_as = options.unknown_as;
      plate.source =
          std::make_unique<LightStack>(session::develop(*plate.session, develop_options));
      plate.origin = PlateOrigin::captured;
      plate.hash = plate.session->info().plan_hash;
      plate.key = session::Developer(*plate.session, develop_options).key();
      break;
    }
  }
  return plate;
}

}  // namespace haarlight::relight
