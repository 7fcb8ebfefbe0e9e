// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight rig calibrate camera|plane RIG.toml`: from pictures of a printed chessboard.

#include "apps/haarlight/pipeline_words.h"
#include "apps/haarlight/rig_calibrate.h"
#include "relight/pipeline/board_pipeline.h"

namespace haarlight {

namespace {

BoardOptions board_options(const CalibrateArguments& arguments, const CommonOptions& common) {
  BoardOptions options;
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

void add_calibrate_options(Command verb, CalibrateArguments& arguments) {
  verb.option("--session", &arguments.session,
              "calibrate lights: the capture of the sheet, one light a picture",
              {.type = "SESSION"});
  verb.option("--picture", &arguments.pictures,
              "calibrate camera, plane: a picture of the chessboard; may be repeated",
              {.type = "PICTURE"});
  verb.option("--board", &arguments.board,
              "calibrate camera, plane: the board's inner corners (default 9,6)",
              {.type = "COLUMNS,ROWS", .delimiter = ',', .count = 2});
  verb.option("--square", &arguments.square_mm, "calibrate camera, plane: a square's side, mm",
              {.shows_default = true});
  verb.option(
      "--region", &arguments.region,
      "calibrate lights: the sheet on the plane, mm along its u and v (default: the middle "
      "four fifths)",
      {.type = "U0,U1,V0,V1", .delimiter = ',', .count = 4});
  verb.option("--sheet", &arguments.sheet_mm,
              "calibrate lights: the sheet's thickness over the plane, mm",
              {.shows_default = true});
  verb.option(
      "--bow", &arguments.bow_mm,
      "calibrate lights: how far the sheet may be bowed, mm (a standard deviation); 0: it "
      "is flat for certain",
      {.bounds = Bounds{0, 20}, .shows_default = true});
  verb.option(
      "--lobe", &arguments.lobe,
      "calibrate lights: free finds one exponent for each face; given takes the rig file's",
      {.choices = {"free", "given"}, .shows_default = true});
}

ExitCode run_calibrate_camera(const CalibrateArguments& arguments, const CommonOptions& common,
                              Report& report) {
  add_to_report(calibrate_camera(board_options(arguments, common)), report);
  return ExitCode::done;
}

ExitCode run_calibrate_plane(const CalibrateArguments& arguments, const CommonOptions& common,
                             Report& report) {
  add_to_report(calibrate_plane(board_options(arguments, common)), report);
  return ExitCode::done;
}

}  // namespace haarlight
