// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/options/calibrate_options.h"

#include "apps/haarlight/options/develop_options.h"

namespace haarlight::apps {

namespace {

void add_options(Command verb, FindLightsArguments& a) {
  verb.option("INPUT", &a.input,
              "Session, or folder with one picture per light, sorted by name",
              {.type = "SESSION|DIR", .is_required = true});
  verb.option("-o,--output", &a.out,
              "Folder to write; or one list: FILE.json (for import), FILE.lp, FILE.csv",
              {.type = "FOLDER|FILE", .is_required = true});
  verb.option("--target", &a.target,
              "What the pictures show (default: a rig's session shows a sheet, --ball a ball)");
  verb.option("--exclude", &a.exclude,
              "Leave out pictures whose names contain this; may be repeated", {.type = "TEXT"});
  verb.option("--transfer", &a.transfer,
              "What integer pictures hold; file: as the file says (display pictures: srgb)",
              {.choices = known_transfers(), .none = kAsFile, .shows_default = true});
  verb.option("--width-mm", &a.width_mm, "What the picture shows across, on the sheet",
              {.type = "MM", .bounds = Bounds{0.0, 1e6}});
  verb.option("--camera-mm", &a.camera_mm,
              "From the lens to the sheet, or to what the balls lie on; the camera looks "
              "straight at it",
              {.type = "MM", .bounds = Bounds{0.0, 1e6}});
  verb.option(
      "--focal-px", &a.focal_px,
      "The lens' focal length, pixels: in mm, times the picture's width over the sensor's",
      {.type = "PIXELS", .bounds = Bounds{0.0, 1e7}});
  verb.option("--rig", &a.rig,
              "The rig file: of a sheet's session, its measured values are written too; of "
              "balls, whose camera saw them",
              {.type = "RIG.toml"});
}

void add_ball_options(Command verb, FindLightsArguments& a) {
  verb.option("--ball", &a.masks,
              "ball: white on a ball, black around it; may be repeated (default: balls are "
              "looked for)",
              {.type = "MASK"});
  verb.option("--balls", &a.n_balls, "ball: how many to look for",
              {.bounds = Bounds{1, 50}, .shows_default = true});
  verb.option("--radius-mm", &a.radius_mm,
              "ball: the balls' radius, for near lights; one for all, or one for each --ball",
              {.type = "MM", .bounds = Bounds{1e-3, 1e5}, .delimiter = ','});
  verb.option(
      "--edge-px", &a.edge_px,
      "ball: how far its outline as a whole may be off, by a brush or a blur: a standard "
      "deviation of its middle and its radius",
      {.type = "PIXELS", .bounds = Bounds{0.0, 100.0}, .shows_default = true});
}

void add_sheet_options(Command verb, FindLightsArguments& a) {
  verb.option(
      "--region", &a.region,
      "sheet: what of it counts, mm right and up of the picture's middle (default: nine "
      "tenths of the picture; of a rig along its plane's u and v)",
      {.type = "U0,U1,V0,V1", .delimiter = ',', .count = 4});
  verb.option(
      "--aim", &a.aim,
      "sheet: where the lights shine: at its middle, straight down, or alike everywhere",
      {.shows_default = true});
  verb.option("--aim-deg", &a.aim_deg,
              "sheet: how far a light is off its aim (a standard deviation)",
              {.type = "DEGREES", .bounds = Bounds{0.0, 45.0}, .shows_default = true});
  verb.option("--tilt-deg", &a.tilt_deg,
              "sheet: how far the camera may be from straight above (a standard deviation)",
              {.type = "DEGREES", .bounds = Bounds{0.0, 20.0}, .shows_default = true});
  verb.option("--led-mm", &a.led_mm, "sheet: side of the lights' emitters",
              {.type = "MM", .bounds = Bounds{0.0, 1e4}, .shows_default = true});
  verb.option("--lobe", &a.lobe,
              "sheet: one exponent for all lobes is found, or given by --mu (of a rig by its "
              "file)",
              {.choices = choices_of({relight::Lobe::free, relight::Lobe::given}),
               .shows_default = true});
  verb.option("--mu", &a.mu, "sheet: the lobes' exponent, where --lobe given",
              {.bounds = Bounds{0.0, 100.0}, .shows_default = true});
  verb.option("--bow", &a.bow_mm,
              "sheet: how far it may be bowed, mm (a standard deviation); 0: it is flat for "
              "certain",
              {.bounds = Bounds{0, 20}, .shows_default = true});
  verb.option("--samples", &a.samples, "sheet: about so many blocks along its longer side",
              {.bounds = Bounds{8, 200}, .shows_default = true});
  verb.flag("--bent", &a.is_bent,
            "sheet: it is not flat; its shape and the lights are found in turn, without +-, "
            "for lights at their --aim of exponent --mu");
  verb.option("--grid", &a.grid,
              "sheet: the lights are a flat array, pictures row by row, first row at the top",
              {.type = "ROWS,COLUMNS", .delimiter = ',', .count = 2});
  verb.option("--pitch-mm", &a.pitch_mm, "sheet: from light to light in the --grid",
              {.type = "MM", .bounds = Bounds{0.0, 1e5}});
  verb.option("--sheet-mm", &a.sheet_mm, "sheet, of a rig: its thickness over the plane",
              {.type = "MM", .shows_default = true});
  verb.option("--page", &a.page,
              "sheet, with --rig: the page with figures (default: NAME.lights.html)",
              {.type = "FILE"});
}

}  // namespace

void add_calibrate_options(Command verb, FindLightsArguments& arguments) {
  add_options(verb, arguments);
  add_ball_options(verb, arguments);
  add_sheet_options(verb, arguments);
}

}  // namespace haarlight::apps
