// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "apps/haarlight/verb.h"
#include "relight/calibration/near_calibration.h"

/// @file
/// `haarlight rig calibrate camera|plane|lights RIG.toml`: the lens and the plane from pictures
/// of a chessboard, the lights from pictures of a sheet.

namespace haarlight::apps {

struct CalibrateArguments {
  std::string rig;             ///< the rig file
  std::string session;         ///< capture of a flat matte sheet
  std::vector<double> region;  ///< U0, U1, V0, V1; empty: the middle of the plane
  double sheet_mm = 0.0;       ///< its thickness
  double bow_mm = 1.0;         ///< how far the sheet may be bowed, a standard deviation
  relight::Lobe lobe = relight::Lobe::free;
  std::string page;
  std::vector<std::string> pictures;  ///< of the chessboard
  std::vector<int> board{9, 6};       ///< inner corners: columns, rows
  double square_mm = 20.0;
  std::string camera;  ///< id; empty: the first
};

/// The lens: K and dist with uncertainties, a page with every corner's miss.
ExitCode run_calibrate_camera(const CalibrateArguments& arguments, const CommonOptions& common,
                              Report& report);
/// The first plane, from one or more pictures of a board that lies on it.
ExitCode run_calibrate_plane(const CalibrateArguments& arguments, const CommonOptions& common,
                             Report& report);

/// Writes NAME.measured.toml and a page with pictures.
/// @throws Error  a session of another rig, a sheet that is not seen, lights that cannot be
/// found
ExitCode run_calibrate_lights(const CalibrateArguments& arguments, const CommonOptions& common,
                              Report& report);

}  // namespace haarlight::apps
