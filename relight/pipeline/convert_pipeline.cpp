// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/convert_pipeline.h"

#include <array>
#include <filesystem>
#include <string_view>
#include <utility>

#include <fmt/format.h>

#include "core/counted.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/session/light_file.h"
#include "relight/pipeline/bytes_on_disk.h"

namespace haarlight::relight {

namespace {

namespace fs = std::filesystem;

constexpr int kCompared = 25;       ///< directions at which IN and OUT are compared
constexpr double kOtherTurn = 1.0;  ///< none of those used by a refit

[[noreturn]] void refuse_options(const std::string& what, const std::string& hint) {
  throw Error(what, "the options", hint, ExitCode::usage);
}

std::string name_of(const ReflectanceModel& model) {
  constexpr std::array<std::string_view, 3> kColours{"rgb", "lrgb", "pca"};
  return fmt::format("{} of {} in {}, {} x {}", to_string(model.basis),
                     counted(model.n_terms, "term"),
                     kColours[static_cast<std::size_t>(model.colour)], model.planes.width(),
                     model.planes.height());
}

/// What OUT is to hold; basis and terms as in IN unless requested otherwise or OUT cannot.
RefitTarget choose_target(const ConvertOptions& options, ReflectanceFormat format,
                          const ReflectanceModel& model) {
  RefitTarget target;
  target.rule = scale_rule(format);
  const bool has_terms = model.colour != ReflectanceColour::pca;
  target.basis = format == ReflectanceFormat::ptm                 ? ReflectanceBasis::ptm
                 : format == ReflectanceFormat::rti || !has_terms ? ReflectanceBasis::hsh
                                                                  : model.basis;
  if (options.basis) {
    const ReflectanceBasis requested = *options.basis;
    if (format != ReflectanceFormat::web && requested != target.basis) {
      refuse_options(
          fmt::format("a {} holds {} only", to_string(format), to_string(target.basis)),
          "leave --basis out, or write a folder");
    }
    target.basis = requested;
  }
  if (target.basis == ReflectanceBasis::ptm) {
    if (options.terms && *options.terms != 6) {
      refuse_options(fmt::format("a ptm has 6 terms, not {}", *options.terms),
                     "leave --terms out, or write a .rti");
    }
    target.n_terms = 6;
    return target;
  }
  const bool keeps_terms = model.basis == ReflectanceBasis::hsh &&
                           (format == ReflectanceFormat::rti || model.n_terms <= 9);
  target.n_terms = options.terms.value_or(keeps_terms ? model.n_terms : 9);
  if (target.n_terms != 4 && target.n_terms != 9 && target.n_terms != 16) {
    refuse_options(fmt::format("hsh has 4, 9 or 16 terms, not {}", target.n_terms),
                   "give --terms 9");
  }
  if (format == ReflectanceFormat::web && target.n_terms == 16) {
    refuse_options("no viewer shows 16 terms in a web folder", "give --terms 9");
  }
  return target;
}

/// True if OUT can hold IN unchanged, except for scales and JPEG.
bool keeps(const ConvertOptions& options, ReflectanceFormat format,
           const ReflectanceModel& model, const RefitTarget& target) {
  if (!can_hold(format, model)) {
    return false;
  }
  if (model.colour == ReflectanceColour::pca) {
    return !options.basis && !options.terms;
  }
  return model.basis == target.basis && model.n_terms == target.n_terms;
}

void write_relit(const ConvertOptions& options, const ReflectanceModel& model,
                 ConvertSummary& summary, PipelineNotes& notes) {
  summary.kind = ConvertedKind::picture;
  require_picture_name(options.output);
  require_absent(options.output, options.settings.overwrites);
  if (options.light->norm() == 0.0) {
    refuse_options("a light without a direction", "for example --light 0.5,0.5,0.7");
  }
  Image<float> picture = relit_srgb(model, options.light->normalized());
  for (float& value : picture.pixels()) {  // pictures are written from linear light
    value = linear_from_srgb(value);
  }
  write_image(options.output, picture.view());
  summary.bytes = fs::file_size(options.output);
  notes.add(NoteKind::result, fmt::format("{}: {} x {} under one light", options.output,
                                          picture.width(), picture.height()));
}

void warn_of_rti_viewer(const ReflectanceModel& written, PipelineNotes& notes) {
  if (written.colour == ReflectanceColour::rgb) {
    notes.add(NoteKind::warning,
              "RTIViewer does not open RGB in the JPEG form of .ptm: leave --jpeg out for it");
  } else if (written.planes.width() % 8 != 0) {
    notes.add(NoteKind::warning,
              fmt::format("RTIViewer opens the JPEG form of .ptm only in widths that are a "
                          "multiple of 8, not {}: leave --jpeg out for it",
                          written.planes.width()));
  }
}

bool is_light_list(const fs::path& path) {
  return path.extension() == ".lp" || path.extension() == ".dome";
}

void convert_lights(const ConvertOptions& options, ConvertSummary& summary,
                    PipelineNotes& notes) {
  summary.kind = ConvertedKind::lights;
  require_absent(options.output, options.settings.overwrites);
  const session::LightList list = session::read_light_file(options.input);
  for (const std::string& note : list.notes) {
    notes.add(NoteKind::warning, note);
  }
  std::string text;
  if (fs::path(options.output).extension() == ".dome") {
    text =
        session::format_dome(list.lights, {.label = fs::path(options.input).stem().string()});
  } else {
    std::vector<Eigen::Vector3d> directions;
    std::vector<std::string> names;
    for (const session::SessionLight& light : list.lights) {
      if (light.name.empty()) {
        throw Error("its lights name no pictures, and a .lp needs them", options.input,
                    "start from a .lp, or from a session: haarlight export --lp");
      }
      directions.emplace_back(light.coordinates.normalized());
      names.push_back(light.name);
    }
    text = session::format_lp(directions, names);
  }
  write_file_atomically(options.output, text);
  summary.bytes = text.size();
  summary.n_lights = list.lights.size();
  notes.add(NoteKind::result,
            fmt::format("{}: {}", options.output, counted(list.lights.size(), "light")));
}

/// What the written file holds, and the difference of its pictures from IN's.
void measure_written(const ConvertOptions& options, const ReflectanceModel& model,
                     const ReflectanceModel& written, ConvertSummary& summary,
                     PipelineNotes& notes) {
  if (options.is_jpeg) {
    warn_of_rti_viewer(written, notes);
  }
  summary.difference =
      compare_pictures(model, written, spread_over_hemisphere(kCompared, kOtherTurn));
  summary.bytes = bytes_on_disk(options.output);
  summary.basis = written.basis;
  summary.n_terms = written.n_terms;
  notes.add(
      NoteKind::result,
      fmt::format("{}: {}{}", options.output, name_of(written),
                  summary.is_refitted ? fmt::format(" (fitted to {})", name_of(model)) : ""));
  notes.add(
      NoteKind::result,
      summary.difference.is_same
          ? std::string("every picture is the same")
          : fmt::format("pictures under {} lights are {:.1f} dB apart, the worst {:.1f} dB",
                        kCompared, summary.difference.mean_db, summary.difference.worst_db));
}

void convert_model(const ConvertOptions& options, const ReflectanceReading& reading,
                   ConvertSummary& summary, PipelineNotes& notes) {
  const ReflectanceFormat format = reflectance_format_of_name(options.output);
  if (options.is_jpeg && format != ReflectanceFormat::ptm) {
    refuse_options("--jpeg is a form of .ptm", "leave it out: a folder is JPEG always");
  }
  require_absent(options.output, options.settings.overwrites);
  const ReflectanceModel model = read_reflectance(options.input, reading);
  const RefitTarget target = choose_target(options, format, model);
  const ReflectanceWriting writing{.is_jpeg = options.is_jpeg, .quality = options.quality};
  summary.is_refitted = !keeps(options, format, model, target);
  if (summary.is_refitted) {
    write_reflectance(options.output,
                      refit(model, target, refit_directions(model, target.n_terms)), writing);
  } else {
    write_reflectance(options.output, model, writing);
  }
  // From the file itself: the total loss to bytes, JPEG and the other basis.
  const HshOrder4 order4 = summary.is_refitted ? HshOrder4::exact : reading.order4;
  const ReflectanceModel written =
      read_reflectance(options.output, {.order4 = order4, .most_bytes = reading.most_bytes});
  measure_written(options, model, written, summary, notes);
}

}  // namespace

ConvertSummary convert_reflectance(const ConvertOptions& options) {
  ConvertSummary summary;
  PipelineNotes notes(options.settings.tell);
  if (is_light_list(options.output)) {
    convert_lights(options, summary, notes);
  } else {
    const ReflectanceReading reading{
        .transfer = options.transfer,
        .order4 = options.order4,
        .most_bytes = options.settings.memory_bytes / 2};  // IN's planes and OUT's
    if (options.light) {
      write_relit(options, read_reflectance(options.input, reading), summary, notes);
    } else {
      convert_model(options, reading, summary, notes);
    }
  }
  summary.notes = notes.all();
  return summary;
}

void add_to_report(const ConvertOptions& options, const ConvertSummary& summary,
                   Report& report) {
  report.add_input(options.input);
  report.set_bytes(summary.bytes);
  if (summary.kind == ConvertedKind::lights) {
    report.add_achieved("lights", static_cast<std::int64_t>(summary.n_lights));
  } else if (summary.kind == ConvertedKind::model) {
    report.add_detail("basis", std::string(to_string(summary.basis)));
    report.add_detail("terms", std::int64_t{summary.n_terms});
    report.add_detail("refitted", std::int64_t{summary.is_refitted ? 1 : 0});
    if (!summary.difference.is_same) {
      report.add_achieved("psnr_db", summary.difference.mean_db);
      report.add_detail("psnr_worst_db", summary.difference.worst_db);
    }
  }
}

}  // namespace haarlight::relight
