// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/render_smooth.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "apps/haarlight/render_scene.h"
#include "haarlight/core/error.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/core/picture/picture_depth.h"
#include "relight/pipeline/display_exposure.h"
#include "render/film/smoothing.h"

namespace haarlight::apps {

namespace {

struct SmoothArguments {
  std::string picture;
  std::string output;
  std::string reference;
  render::SmoothingKind kind = render::SmoothingKind::features;
  std::optional<double> exposure;
};

/// Some of the channels of a picture.
Image<float> part_of(const Image<float>& all, int first, int n) {
  Image<float> part(all.height(), all.width(), n);
  for (int y = 0; y < all.height(); ++y) {
    for (int x = 0; x < all.width(); ++x) {
      for (int c = 0; c < n; ++c) {
        part(y, x, c) = all(y, x, first + c);
      }
    }
  }
  return part;
}

/// What haarlight render surface -o PICTURE.exr writes.
struct RenderedPicture {
  Image<float> colours;
  Image<float> error;
  Image<float> albedo;
  Image<float> normal;
  Image<float> depth;
};
RenderedPicture read_rendered(const std::string& path, bool has_features) {
  RenderedPicture picture;
  if (!has_features) {
    picture.colours = read_linear_image(path);
    return picture;
  }
  constexpr auto kChannels = std::to_array<std::string_view>(
      {"R", "G", "B", "error.R", "error.G", "error.B", "albedo.R", "albedo.G", "albedo.B",
       "normal.X", "normal.Y", "normal.Z", "Z"});
  const Image<float> all = read_picture_channels(path, kChannels);
  picture.colours = part_of(all, 0, 3);
  picture.error = part_of(all, 3, 3);
  picture.albedo = part_of(all, 6, 3);
  picture.normal = part_of(all, 9, 3);
  picture.depth = part_of(all, 12, 1);
  return picture;
}

/// Over all pixels and colours.
double rmse(const Image<float>& picture, const Image<float>& reference) {
  double sum = 0.0;
  for (std::size_t i = 0; i < picture.pixels().size(); ++i) {
    sum += std::pow(double{picture.pixels()[i]} - reference.pixels()[i], 2);
  }
  return std::sqrt(sum / static_cast<double>(picture.pixels().size()));
}

Image<float> read_reference(const std::string& path, const Image<float>& picture) {
  Image<float> reference = read_linear_image(path);
  if (reference.height() != picture.height() || reference.width() != picture.width() ||
      reference.channels() != picture.channels()) {
    throw Error(fmt::format("{} x {} pixels of {} colours, the picture has {} x {} of {}",
                            reference.width(), reference.height(), reference.channels(),
                            picture.width(), picture.height(), picture.channels()),
                path, "give a reference of the same view and size");
  }
  return reference;
}

ExitCode run_smooth(const SmoothArguments& arguments, const CommonOptions& common,
                    Report& report) {
  report.add_input(arguments.picture);
  report.add_requested("by", std::string(to_string(arguments.kind)));
  require_outputs(arguments.output, "", "-o", common.force);
  const RenderedPicture picture =
      read_rendered(arguments.picture, arguments.kind == render::SmoothingKind::features);
  const Image<float> smoothed = render::smooth(picture.colours.view(),
                                               {.albedo = picture.albedo.view(),
                                                .normal = picture.normal.view(),
                                                .depth = picture.depth.view(),
                                                .error = picture.error.view()},
                                               {.kind = arguments.kind});
  std::string told;
  if (!arguments.reference.empty()) {
    report.add_input(arguments.reference);
    const Image<float> reference = read_reference(arguments.reference, smoothed);
    const double before = rmse(picture.colours, reference);
    const double after = rmse(smoothed, reference);
    report.add_achieved("rmse_before", before);
    report.add_achieved("rmse_after", after);
    told = fmt::format(", RMSE {:.4g}, before {:.4g}", after, before);
  }
  const std::string preview = preview_of(arguments.output);
  double exposure = 1.0;
  if (has_ending(arguments.output, ".png") || !preview.empty()) {
    constexpr double kShownFraction = 0.98;  // of the values of a .png, as of other renders
    const auto values = smoothed.pixels();
    exposure = arguments.exposure.value_or(relight::display_exposure(values, kShownFraction));
  }
  std::vector<PictureLayer> layers;
  if (!picture.albedo.is_empty()) {
    layers = {
        {.channels = {"albedo.R", "albedo.G", "albedo.B"}, .image = picture.albedo.view()},
        {.channels = {"normal.X", "normal.Y", "normal.Z"}, .image = picture.normal.view()},
        {.channels = {"Z"}, .image = picture.depth.view()}};
  }
  write_image(arguments.output, smoothed.view(), exposure, {}, layers);
  if (!preview.empty()) {
    write_image(preview, smoothed.view(), exposure);
  }
  report.add_detail("exposure", exposure);
  report.set_bytes(std::filesystem::file_size(arguments.output));
  fmt::print("{}: {} x {} pixels, {}{}\n", arguments.output, smoothed.width(),
             smoothed.height(), to_string(arguments.kind), told);
  return ExitCode::done;
}

}  // namespace

void add_render_smooth(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<SmoothArguments>();
  Command verb = root.add_verb("smooth", "Filter the noise of a rendered picture, for a bias");
  verb.option("PICTURE", &arguments->picture, "Of haarlight render surface -o PICTURE.exr",
              {.type = "PICTURE.exr", .is_required = true});
  verb.option(
      "-o,--output", &arguments->output,
      "Picture to write: .exr linear, with the features as they were; .tif linear; .png "
      "for display",
      {.type = "PICTURE", .is_required = true});
  verb.option("--by", &arguments->kind,
              "features: over pixels of like normals, depths and albedos; low-pass: the mean "
              "over 3 x 3; median: of 3 x 3. All keep the sum of each colour",
              {.shows_default = true});
  verb.option("--reference", &arguments->reference,
              "Tell the RMSE from this picture of the same view, before and after",
              {.type = "PICTURE"});
  add_exposure_option(verb, arguments->exposure);
  verb.footer("Example:\n  haarlight render smooth joined.exr -o smooth.exr");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_smooth(*arguments, common, report);
  });
}

}  // namespace haarlight::apps
