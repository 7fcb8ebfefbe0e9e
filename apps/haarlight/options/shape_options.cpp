// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/options/shape_options.h"

#include "apps/haarlight/options/pipeline_words.h"

namespace haarlight::apps {

void add_shape_options(Command verb, ShapeArguments& arguments) {
  verb.option("INPUT", &arguments.input,
              "Session folder; or a .ptm, .rti or web folder, for the normals that RTI viewers "
              "take from it",
              {.type = "SESSION|FILE", .is_required = true});
  verb.option("-o,--output", &arguments.out, "Folder to write",
              {.type = "FOLDER", .is_required = true});
  verb.option(
      "--method", &arguments.method,
      "Fit of each pixel; trimmed and m-estimator leave shadows and highlights out; ptm "
      "and hsh: as RTI viewers take normals, for comparison (default: whichever robust fit "
      "foretells lights held out best; of a file what it holds)",
      {.choices = choices_of({relight::ShapeMethod::least_squares,
                              relight::ShapeMethod::trimmed, relight::ShapeMethod::m_estimator,
                              relight::ShapeMethod::ptm, relight::ShapeMethod::hsh})});
  verb.option("--loss", &arguments.loss, "How the m-estimator weighs what fits badly",
              {.shows_default = true});
  verb.option("--keep", &arguments.keep, "trimmed: the fraction of a pixel's lights that count",
              {.bounds = Bounds{0.05, 1.0}, .shows_default = true});
  verb.option("--dark", &arguments.dark_fraction,
              "Below this fraction of the pixel's bright level a light counts as shadowed",
              {.bounds = Bounds{0.0, 0.9}, .shows_default = true});
  verb.option("--light", &arguments.light,
              "near: each pixel's own light directions and distances (default: where the "
              "lights' positions and the picture's size are known)");
  add_plane_options(verb, arguments.plane);
  verb.option("--mask", &arguments.mask,
              "White: the object; black is left out. found: looked for in the capture, by the "
              "rig's bare plane or by darkness; none: every pixel",
              {.type = "PICTURE|found|none", .shows_default = true});
  verb.option("--integrate", &arguments.integrate,
              "From normals to heights; robust keeps edges", {.shows_default = true});
  verb.option(
      "--hull", &arguments.hull,
      "The object's shadow hull, as haarlight hull and shadow keep it next to the basis "
      "file: tells parts apart that stand at different heights; the mesh is open between them",
      {.type = "BASIS.hlb.hull"});
  verb.option("--rounds", &arguments.max_rounds,
              "near: at most so many rounds of normals and heights",
              {.bounds = Bounds{1, 1000}, .shows_default = true});
  verb.option("--mesh", &arguments.mesh, "Which mesh files to write", {.shows_default = true});
  verb.option("--max-tilt", &arguments.max_tilt_deg,
              "Leave out triangles steeper than this, degrees",
              {.bounds = Bounds{0.0, 90.0}, .shows_default = true});
  verb.flag("--open-cuts", &arguments.is_open_at_cuts,
            "Leave the mesh open where --integrate robust found cuts");
  verb.option("--preview", &arguments.preview, "Direction of the preview's light",
              {.type = "X,Y,Z", .delimiter = ',', .count = 3});
  add_transfer_option(verb, arguments.transfer);
}

relight::ShapePipelineOptions shape_options(const ShapeArguments& arguments,
                                            const CommonOptions& common) {
  relight::ShapePipelineOptions options;
  options.input = arguments.input;
  options.out = arguments.out;
  options.method = arguments.method;
  options.shape.stereo.fit.loss = arguments.loss;
  options.shape.stereo.fit.keep = arguments.keep;
  options.shape.stereo.fit.dark_fraction = arguments.dark_fraction;
  options.shape.integrate.method = arguments.integrate;
  options.shape.max_rounds = arguments.max_rounds;
  options.light = arguments.light;
  options.width_mm = arguments.plane.width_mm;
  options.height_mm = arguments.plane.height_mm;
  options.mask =
      value_of<relight::MaskChoice>(arguments.mask).value_or(relight::MaskChoice::picture);
  options.mask_picture = arguments.mask;
  options.hull = arguments.hull;
  options.transfer = arguments.transfer;
  options.writes_ply = arguments.mesh == MeshFiles::ply || arguments.mesh == MeshFiles::both;
  options.writes_obj = arguments.mesh == MeshFiles::obj || arguments.mesh == MeshFiles::both;
  options.max_tilt_deg = arguments.max_tilt_deg;
  options.is_open_at_cuts = arguments.is_open_at_cuts;
  options.preview = {arguments.preview[0], arguments.preview[1], arguments.preview[2]};
  options.settings = pipeline_settings(common);
  return options;
}

}  // namespace haarlight::apps
