// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight rig calibrate camera|plane RIG.toml`: from pictures of a printed chessboard.

#include "apps/haarlight/options/pipeline_words.h"
#include "apps/haarlight/rig/rig_calibrate.h"
#include "relight/pipeline/calibrate/board_pipeline.h"

namespace haarlight::apps {

namespace {

relight::BoardOptions board_options(const CalibrateArguments& arguments,
                                    const CommonOptions& common) {
  relight::BoardOptions options;
  options.rig = arguments.rig;
  options.pictures = arguments.pictures;
  options.board.cols = arguments.board[0];
  options.board.rows = arguments.board[1];
  options.board.square_mm = arguments.square_mm;
  options.camera = arguments.camera;
  options.page = arguments.page;
  options.settings = pipeline_settings(common);
  return options;
}

}  // namespace

ExitCode run_calibrate_camera(const CalibrateArguments& arguments, const CommonOptions& common,
                              Report& report) {
  relight::add_to_report(relight::calibrate_camera(board_options(arguments, common)), report);
  return ExitCode::done;
}

ExitCode run_calibrate_plane(const CalibrateArguments& arguments, const CommonOptions& common,
                             Report& report) {
  relight::add_to_report(relight::calibrate_plane(board_options(arguments, common)), report);
  return ExitCode::done;
}

}  // namespace haarlight::apps
