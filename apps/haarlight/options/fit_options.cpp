// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/options/fit_options.h"

#include <cstdio>
#include <cstdlib>
#include <vector>

#include "apps/haarlight/options/develop_options.h"
#include "apps/haarlight/options/pipeline_words.h"
#include "haarlight/core/error.h"

namespace haarlight::apps {

namespace {

relight::HoldOut parse_hold_out(const std::string& text) {
  relight::HoldOut hold_out;
  if (text.empty()) {
    return hold_out;
  }
  char rest = '\0';
  if (std::sscanf(text.c_str(), "%d:%d%c", &hold_out.every, &hold_out.rest, &rest) != 2 ||
      hold_out.every < 2 || hold_out.rest < 0 || hold_out.rest >= hold_out.every) {
    throw Error("not EVERY:REST with REST below EVERY", "--hold-out " + text,
                "for example: --hold-out 6:2 holds out the lights 2, 8, 14, ...",
                ExitCode::usage);
  }
  return hold_out;
}

/// "500k", "2M" or "2500000": bytes, the letters for 10^3, 10^6, 10^9.
std::uint64_t parse_bytes(const std::string& text, const std::string& option) {
  char* end = nullptr;
  const double number = std::strtod(text.c_str(), &end);
  const std::string unit = end;
  constexpr double kThousand = 1e3;
  const double factor = unit.empty()                 ? 1.0
                        : unit == "k" || unit == "K" ? kThousand
                        : unit == "M"                ? kThousand * kThousand
                        : unit == "G"                ? kThousand * kThousand * kThousand
                                                     : 0.0;
  constexpr double kMost = 1e15;
  if (end == text.c_str() || !(number * factor >= 1.0) || number * factor > kMost) {
    throw Error("not a number of bytes", option + " " + text, "for example: --bytes 800k",
                ExitCode::usage);
  }
  return static_cast<std::uint64_t>(number * factor);
}

}  // namespace

void add_fit_options(Command verb, FitArguments& arguments) {
  verb.option("CAPTURE", &arguments.capture,
              "Session folder, or with --lights a folder of pictures",
              {.type = "SESSION|FOLDER", .is_required = true});
  verb.option("-o,--output", &arguments.out,
              "What to write: .ptm, .rti, or a name without ending for a web folder",
              {.type = "FILE"});
  verb.option("--basis", &arguments.form,
              "The basis; auto: the one that predicts each light best from the others",
              {.none = "auto", .shows_default = true});
  verb.option("--lights", &arguments.lights, "List of lights of a folder of pictures",
              {.type = "FILE.lp"});
  add_picture_list_options(verb, arguments.list);
  verb.option("--planes", &arguments.max_planes, "The most planes of 8 bits that auto may use",
              {.bounds = Bounds{3.0, 96.0}, .shows_default = true});
  verb.option("--resolution", &arguments.resolution, "bilinear: grid points per side",
              {.bounds = Bounds{2.0, 64.0}, .shows_default = true});
  verb.option("--ridge", &arguments.ridge,
              "Smoothing (default: what predicts lights left out best)",
              {.bounds = Bounds{0.0, 1e6}});
  verb.flag("--extremes", &arguments.extremes,
            "Keep the planes' extreme values instead of the least error");
  verb.option(
      "--quality", &arguments.size.quality,
      "Of a folder's pictures (default: 97); every plane is rounded as the lit pictures "
      "need it",
      {.bounds = Bounds{1.0, 100.0}});
  verb.option("--bytes", &arguments.bytes,
              "The most bytes of a folder: the best quality that they hold",
              {.type = "BYTES|800k|2M"});
  verb.option("--psnr", &arguments.size.psnr_db,
              "The least mean PSNR of a folder's pictures, read again: the fewest bytes that "
              "reach it",
              {.type = "DB", .bounds = Bounds{1.0, 100.0}});
  verb.option("--transfer", &arguments.transfer,
              "What the fit's numbers are coded with; viewers expect srgb",
              {.choices = known_transfers(), .shows_default = true});
  verb.option("--hold-out", &arguments.hold_out,
              "Leave out every EVERY-th light from REST on and measure the PSNR there",
              {.type = "EVERY:REST"});
  verb.option("--near", &arguments.near,
              "Lights are near: every pixel in its own directions, fall-off divided out; "
              "interpolated: 3 times faster",
              {.none = "off", .shows_default = true});
  verb.option("--width-mm", &arguments.width_mm,
              "With --near, for imported pictures: how wide the target is across the picture",
              {.bounds = Bounds{1e-3, 1e6}});
  verb.flag("--compare", &arguments.compare, "Fit all bases and print a table");
  verb.option("--json", &arguments.records, "With --compare: the table as records",
              {.type = "FILE.json"});
}

relight::FitOptions fit_options(const FitArguments& arguments, const CommonOptions& common) {
  relight::FitOptions options;
  options.capture = arguments.capture;
  options.lights = arguments.lights;
  options.coordinates = arguments.list.coordinates;
  options.match = match_options(arguments.list);
  options.crop = crop_requested(arguments.list);
  options.form = arguments.form;
  options.forms.max_planes = arguments.max_planes;
  options.forms.resolution = arguments.resolution;
  options.forms.ridge = arguments.ridge;
  options.ends =
      arguments.extremes ? relight::RangeEnds::extremes : relight::RangeEnds::least_error;
  options.transfer = arguments.transfer;
  options.hold_out = parse_hold_out(arguments.hold_out);
  options.near = arguments.near;
  options.width_mm = arguments.width_mm;
  options.out = arguments.out;
  options.size = arguments.size;
  if (!arguments.bytes.empty()) {
    options.size.bytes = parse_bytes(arguments.bytes, "--bytes");
  }
  options.settings = pipeline_settings(common);
  return options;
}

}  // namespace haarlight::apps
