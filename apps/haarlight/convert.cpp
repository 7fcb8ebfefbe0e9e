// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight convert IN OUT`: pictures that can be relit, from one program's format to
/// another's, or one picture of them under a light; and lists of lights.

#include <array>
#include <optional>
#include <string>
#include <vector>

#include <fmt/format.h>

#include "apps/haarlight/verb.h"
#include "core/error.h"
#include "core/files.h"
#include "core/log.h"
#include "core/picture/image_io.h"
#include "relight/reflectance/formats/refit.h"
#include "relight/reflectance/formats/reflectance_file.h"
#include "session/light_file.h"

namespace haarlight {

namespace {

namespace fs = std::filesystem;

constexpr int kCompared = 25;       ///< directions at which IN and OUT are compared
constexpr double kOtherTurn = 1.0;  ///< none of those that a refit took

struct ConvertArguments {
  std::string input;
  std::string output;
  std::string transfer = "srgb";
  std::string order4 = "exact";
  std::string basis;  ///< empty: as IN
  std::optional<int> terms;
  std::vector<double> light;
  bool is_jpeg = false;
  std::optional<double> quality;
};

[[noreturn]] void refuse_options(const std::string& what, const std::string& cure) {
  throw Error(what, "the options", cure, ExitCode::usage);
}

std::string name_of(const ReflectanceModel& model) {
  return fmt::format("{} of {} terms in {}, {} x {}", to_string(model.basis), model.n_terms,
                     to_string(model.colour), model.planes.width(), model.planes.height());
}

/// What OUT shall hold; basis and terms as IN where nothing else was asked and OUT can.
RefitTarget choose_target(const ConvertArguments& arguments, ReflectanceFormat format,
                          const ReflectanceModel& model) {
  RefitTarget target;
  target.rule = scale_rule(format);
  const bool has_terms = model.colour != ReflectanceColour::pca;
  target.basis = format == ReflectanceFormat::ptm                 ? ReflectanceBasis::ptm
                 : format == ReflectanceFormat::rti || !has_terms ? ReflectanceBasis::hsh
                                                                  : model.basis;
  if (!arguments.basis.empty()) {
    const ReflectanceBasis asked =
        arguments.basis == "ptm" ? ReflectanceBasis::ptm : ReflectanceBasis::hsh;
    if (format != ReflectanceFormat::web && asked != target.basis) {
      refuse_options(
          fmt::format("a {} holds {} only", to_string(format), to_string(target.basis)),
          "leave --basis out, or write a folder");
    }
    target.basis = asked;
  }
  if (target.basis == ReflectanceBasis::ptm) {
    if (arguments.terms && *arguments.terms != 6) {
      refuse_options(fmt::format("a ptm has 6 terms, not {}", *arguments.terms),
                     "leave --terms out, or write a .rti");
    }
    target.n_terms = 6;
    return target;
  }
  const bool keeps_terms = model.basis == ReflectanceBasis::hsh &&
                           (format == ReflectanceFormat::rti || model.n_terms <= 9);
  target.n_terms = arguments.terms.value_or(keeps_terms ? model.n_terms : 9);
  if (target.n_terms != 4 && target.n_terms != 9 && target.n_terms != 16) {
    refuse_options(fmt::format("hsh has 4, 9 or 16 terms, not {}", target.n_terms),
                   "give --terms 9");
  }
  if (format == ReflectanceFormat::web && target.n_terms == 16) {
    refuse_options("no viewer shows 16 terms in a web folder", "give --terms 9");
  }
  return target;
}

/// True where OUT can hold IN as it is, but for scales and JPEG.
bool keeps(const ConvertArguments& arguments, ReflectanceFormat format,
           const ReflectanceModel& model, const RefitTarget& target) {
  if (!can_hold(format, model)) {
    return false;
  }
  if (model.colour == ReflectanceColour::pca) {
    return arguments.basis.empty() && !arguments.terms;
  }
  return model.basis == target.basis && model.n_terms == target.n_terms;
}

ExitCode write_relit(const ConvertArguments& arguments, const ReflectanceModel& model,
                     const CommonOptions& common, Report& report) {
  require_picture_name(arguments.output);
  require_absent(arguments.output, common.force);
  const Eigen::Vector3d light(arguments.light[0], arguments.light[1], arguments.light[2]);
  if (light.norm() == 0.0) {
    refuse_options("a light without a direction", "for example --light 0.5,0.5,0.7");
  }
  Image<float> picture = relit_srgb(model, light.normalized());
  for (float& value : picture.pixels()) {  // pictures are written from linear light
    value = linear_from_srgb(value);
  }
  write_image(arguments.output, picture.view());
  report.set_bytes(fs::file_size(arguments.output));
  fmt::print("{}: {} x {} under one light\n", arguments.output, picture.width(),
             picture.height());
  return ExitCode::done;
}

void warn_of_rti_viewer(const ReflectanceModel& written) {
  if (written.colour == ReflectanceColour::rgb) {
    log_warning(
        "RTIViewer does not open RGB in the JPEG form of .ptm: leave --jpeg out for it");
  } else if (written.planes.width() % 8 != 0) {
    log_warning(
        fmt::format("RTIViewer opens the JPEG form of .ptm only in widths that are a "
                    "multiple of 8, not {}: leave --jpeg out for it",
                    written.planes.width()));
  }
}

bool is_light_list(const fs::path& path) {
  return path.extension() == ".lp" || path.extension() == ".dome";
}

ExitCode convert_lights(const ConvertArguments& arguments, const CommonOptions& common,
                        Report& report) {
  require_absent(arguments.output, common.force);
  const LightList list = read_light_file(arguments.input);
  for (const std::string& note : list.notes) {
    log_warning(note);
  }
  std::string text;
  if (fs::path(arguments.output).extension() == ".dome") {
    text = format_dome(list.lights, {.label = fs::path(arguments.input).stem().string()});
  } else {
    std::vector<Eigen::Vector3d> directions;
    std::vector<std::string> names;
    for (const SessionLight& light : list.lights) {
      if (light.name.empty()) {
        throw Error("its lights name no pictures, and a .lp needs them", arguments.input,
                    "start from a .lp, or from a session: haarlight export --lp");
      }
      directions.emplace_back(light.place.normalized());
      names.push_back(light.name);
    }
    text = format_lp(directions, names);
  }
  write_file_atomically(arguments.output, text);
  report.set_bytes(text.size());
  report.add_reached("lights", static_cast<std::int64_t>(list.lights.size()));
  fmt::print("{}: {} lights\n", arguments.output, list.lights.size());
  return ExitCode::done;
}

ExitCode run_convert(const ConvertArguments& arguments, const CommonOptions& common,
                     Report& report) {
  report.add_input(arguments.input);
  if (is_light_list(arguments.output)) {
    return convert_lights(arguments, common, report);
  }
  const ReflectanceReading reading{
      .transfer = arguments.transfer == "linear" ? Transfer::linear : Transfer::srgb,
      .order4 = arguments.order4 == "rounded" ? HshOrder4::chi_rounding : HshOrder4::exact,
      .most_bytes = common.memory_bytes / 2};  // IN's planes and OUT's
  if (!arguments.light.empty()) {
    return write_relit(arguments, read_reflectance(arguments.input, reading), common, report);
  }
  const ReflectanceFormat format = reflectance_format_of_name(arguments.output);
  if (arguments.is_jpeg && format != ReflectanceFormat::ptm) {
    refuse_options("--jpeg is a form of .ptm", "leave it out: a folder is JPEG always");
  }
  require_absent(arguments.output, common.force);
  const ReflectanceModel model = read_reflectance(arguments.input, reading);
  const RefitTarget target = choose_target(arguments, format, model);
  const ReflectanceWriting writing{.is_jpeg = arguments.is_jpeg, .quality = arguments.quality};
  const bool is_kept = keeps(arguments, format, model, target);
  if (is_kept) {
    write_reflectance(arguments.output, model, writing);
  } else {
    write_reflectance(arguments.output,
                      refit(model, target, refit_directions(model, target.n_terms)), writing);
  }
  // From the file itself: what was lost to bytes, JPEG and the other basis together.
  const ReflectanceModel written =
      read_reflectance(arguments.output, {.order4 = is_kept ? reading.order4 : HshOrder4::exact,
                                          .most_bytes = reading.most_bytes});
  if (arguments.is_jpeg) {
    warn_of_rti_viewer(written);
  }
  const PictureDifference difference =
      compare_pictures(model, written, spread_over_hemisphere(kCompared, kOtherTurn));
  report.set_bytes(bytes_on_disk(arguments.output));
  report.add_detail("basis", std::string(to_string(written.basis)));
  report.add_detail("terms", std::int64_t{written.n_terms});
  report.add_detail("refitted", std::int64_t{is_kept ? 0 : 1});
  fmt::print("{}: {}{}\n", arguments.output, name_of(written),
             is_kept ? "" : fmt::format(" (fitted to {})", name_of(model)));
  if (difference.is_same) {
    fmt::print("every picture is the same\n");
    tell_next(common, {"view", arguments.output});
    return ExitCode::done;
  }
  report.add_reached("psnr_db", difference.mean_db);
  report.add_detail("psnr_worst_db", difference.worst_db);
  fmt::print("pictures under {} lights are {:.1f} dB apart, the worst {:.1f} dB\n", kCompared,
             difference.mean_db, difference.worst_db);
  tell_next(common, {"view", arguments.output});
  return ExitCode::done;
}

}  // namespace

void add_convert(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<ConvertArguments>();
  Command verb = root.add_verb(
      "convert", "Turn others' relightable pictures and light lists into one another");
  verb.option("IN", &arguments->input,
              ".ptm, .rti, folder with Relight's info.json; .lp, .dome", {.is_required = true});
  verb.option("OUT", &arguments->output,
              "By its name: .ptm, .rti, no ending for a web folder; .lp, .dome; a picture with "
              "--light",
              {.is_required = true});
  verb.option("--light", &arguments->light,
              "Write one picture (.png, .exr), lit from here: x right, y up, z to the camera",
              {.type = "X,Y,Z", .delimiter = ',', .count = 3});
  verb.flag("--jpeg", &arguments->is_jpeg, "Write the .ptm with JPEG pictures");
  verb.option("--quality", &arguments->quality,
              "Of JPEG pictures (default: 95, of a folder 97)", {.bounds = Bounds{1.0, 100.0}});
  verb.option("--basis", &arguments->basis, "Basis of a web folder (default: as IN)",
              {.choices = {"ptm", "hsh"}});
  verb.option("--terms", &arguments->terms, "Terms of hsh: 4, 9 or 16 (default: as IN, else 9)",
              {.bounds = Bounds{4.0, 16.0}});
  verb.option("--transfer", &arguments->transfer,
              "What IN's colours are coded with, which files do not say; OUT is srgb",
              {.choices = {"srgb", "linear"}, .shows_default = true});
  verb.option("--hsh-order4", &arguments->order4,
              "How IN's 16 terms are meant; rounded: as HSHFitter computes them",
              {.choices = {"exact", "rounded"}, .shows_default = true});
  verb.footer(
      "Another basis is fitted by least squares over directions; how far the pictures of IN "
      "and "
      "OUT are apart is measured and printed.\n"
      "Examples:\n"
      "  haarlight convert coin.ptm coin.rti\n"
      "  haarlight convert coin.ptm coin_web\n"
      "  haarlight convert coin.ptm coin.png --light -0.5,0.5,0.7\n"
      "  haarlight convert dome.lp dome.dome");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_convert(*arguments, common, report);
  });
}

}  // namespace haarlight
