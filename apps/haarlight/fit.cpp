// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight fit CAPTURE --basis auto -o FILE`: a picture that can be lit from any direction.

#include <algorithm>
#include <cmath>
#include <ctime>
#include <memory>
#include <optional>
#include <utility>

#include <fmt/format.h>

#include "apps/haarlight/fit_output.h"
#include "apps/haarlight/fit_page.h"
#include "apps/haarlight/picture_options.h"
#include "core/error.h"
#include "core/files.h"
#include "core/log.h"
#include "core/tradeoff.h"
#include "relight/basis/haar.h"
#include "relight/light/near_light.h"
#include "relight/reflectance/fit/fit_check.h"
#include "relight/reflectance/fit/light_haar.h"
#include "relight/reflectance/fit/near_fit.h"
#include "relight/reflectance/fit/picture_files.h"
#include "relight/reflectance/fit/recipe_choice.h"
#include "relight/reflectance/formats/refit.h"
#include "relight/reflectance/formats/reflectance_file.h"
#include "session/session.h"

namespace haarlight {

namespace {

namespace fs = std::filesystem;

struct FitArguments {
  std::string capture;
  std::string lights;
  PictureListArguments list;
  std::string basis = "auto";
  std::string out;
  std::string hold_out;
  std::string transfer = "srgb";
  std::string records;
  std::string near = "off";
  double width_mm = 0.0;
  bool compare = false;
  bool extremes = false;
  int max_planes = 27;
  int resolution = 24;
  std::optional<double> ridge;
  FitSize size;
  std::string bytes;
};

/// A capture opened: its rows and where its lights are.
struct OpenCapture {
  std::optional<Session> session;
  std::unique_ptr<PictureRows> rows;
  std::vector<Eigen::Vector3d> directions;
  PictureFacts photographed;
};

OpenCapture open_pictures(const FitArguments& arguments, const CommonOptions& common) {
  LightList list = read_light_file(arguments.lights, light_places(arguments.list));
  const std::vector<LightPicture> pictures =
      match_pictures(arguments.capture, arguments.lights, list, match_options(arguments.list));
  (void)hashes_of_different(pictures, pictures.size());
  OpenCapture capture;
  std::vector<fs::path> files;
  std::vector<PictureFacts> facts;
  std::vector<int> orientations;
  for (std::size_t k = 0; k < pictures.size(); ++k) {
    files.push_back(pictures[k].path);
    capture.directions.push_back(list.lights[k].place.normalized());
    facts.push_back(read_picture_facts(pictures[k].path));
    orientations.push_back(facts.back().orientation);
  }
  capture.photographed = tell_facts(facts, list.notes, list.disagreements);
  PictureFilesOptions options;
  options.memory_bytes = common.memory_bytes / 4;
  if (!arguments.out.empty()) {
    options.work_folder = fs::absolute(arguments.out).parent_path();
  }
  PictureFiles opened = picture_rows(files, options);
  if (!opened.profile.empty()) {
    list.notes.push_back(fmt::format(
        "the pictures' colour profile (\"{}\") is applied: the fit's colours are sRGB's",
        opened.profile));
  }
  tell_match(list.notes, list.disagreements, common);
  capture.rows = std::move(opened.rows);
  if (const std::optional<PixelRectangle> crop = crop_asked(arguments.list)) {
    require_same_orientation(files, orientations);
    const StackDims shape = capture.rows->dims();
    capture.rows = cropped_rows(
        std::move(capture.rows),
        stored_rectangle(*crop, shape.width, shape.height, orientations.front(), "--crop"));
  }
  return capture;
}

OpenCapture open_session(const FitArguments& arguments, const CommonOptions& common) {
  if (!arguments.list.crop.empty()) {
    throw Error("a session's pictures cannot be cropped", "--crop",
                "crop them when they are imported: haarlight import --crop", ExitCode::usage);
  }
  OpenCapture capture;
  capture.session = Session::open(arguments.capture);
  SessionRowsOptions options;
  // Fall-off is divided out in linear light; what is fitted is coded after that.
  const bool is_linear = arguments.transfer == "linear" || arguments.near != "off";
  options.transfer = is_linear ? Transfer::linear : Transfer::srgb;
  options.develop.memory_bytes = common.memory_bytes;
  capture.rows = session_rows(*capture.session, options);
  capture.directions = picture_directions(*capture.session);
  capture.photographed = capture.session->info().photographed;
  return capture;
}

HoldOut parse_hold_out(const std::string& text) {
  HoldOut hold_out;
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

/// The lights that are fitted, and those that are not.
struct Lights {
  std::vector<int> kept;
  std::vector<int> held;
  std::vector<Eigen::Vector3d> kept_directions;
  std::vector<Eigen::Vector3d> held_directions;
};

Lights split_lights(const std::vector<Eigen::Vector3d>& directions, const HoldOut& hold_out) {
  Lights lights;
  for (std::size_t i = 0; i < directions.size(); ++i) {
    const int light = static_cast<int>(i);
    const bool is_held = hold_out.has(light);
    (is_held ? lights.held : lights.kept).push_back(light);
    (is_held ? lights.held_directions : lights.kept_directions).push_back(directions[i]);
  }
  if (lights.kept.empty()) {
    throw Error("no light is left to fit", "--hold-out", "hold out fewer", ExitCode::usage);
  }
  return lights;
}

double processor_seconds() {
  return static_cast<double>(std::clock()) / static_cast<double>(CLOCKS_PER_SEC);
}

using Format = std::optional<ReflectanceFormat>;

/// Which kind of file a name asks for; nothing: none is asked for.
Format format_of(const std::string& out) {
  return out.empty() ? Format() : reflectance_format_of_name(out);
}

std::vector<FitForm> forms_of(const FitArguments& arguments, const Format& format) {
  std::vector<FitForm> forms;
  if (arguments.basis != "auto") {
    forms = {*fit_form_of(arguments.basis)};
  } else {
    forms = all_fit_forms();
  }
  const bool is_near = arguments.near != "off";
  const auto is_left_out = [&](FitForm form) {
    const bool is_ptm = form == FitForm::ptm || form == FitForm::lptm;
    const bool is_hsh =
        form == FitForm::hsh4 || form == FitForm::hsh9 || form == FitForm::hsh16;
    const bool has_own_terms = form == FitForm::ptm || is_hsh;
    return (format == ReflectanceFormat::ptm && !is_ptm) ||
           (format == ReflectanceFormat::rti && !is_hsh) ||
           (format == ReflectanceFormat::web &&
            (form == FitForm::rbf || form == FitForm::hsh16)) ||
           (is_near && !has_own_terms);
  };
  forms.erase(std::remove_if(forms.begin(), forms.end(), is_left_out), forms.end());
  if (forms.empty()) {
    throw Error(
        fmt::format("{} cannot be written there", arguments.basis), arguments.out,
        ".ptm holds ptm and lptm, .rti holds hsh4, hsh9 and hsh16, a folder all but "
        "hsh16 and rbf (which viewers light by rules of their own: --basis bilinear); near "
        "lights are fitted by ptm and hsh",
        ExitCode::usage);
  }
  return forms;
}

/// One form fitted, and what it cost.
struct Fitted {
  FormScore score;
  FitResult result;
  double seconds = 0.0;  ///< of the processor, reading included
  long long n_pixels = 0;
  std::optional<FitFile> file;
  std::vector<double> psnr_db;  ///< of the file, or of the planes: a light, or one for all
};

/// What a file's pictures are held against.
enum class Against { held, fitted, planes };
const char* words_of(Against against) {
  switch (against) {
    case Against::held:
      return "photographs that were held out";
    case Against::fitted:
      return "the photographs it was fitted to";
    case Against::planes:
      break;
  }
  return "those of its planes before they were coded";
}

double mean_of(const std::vector<double>& values) { return FitError{values}.mean_psnr_db(); }

class Fitter {
 public:
  Fitter(const FitArguments& arguments, const CommonOptions& common, OpenCapture& capture)
      : arguments_(arguments),
        capture_(capture),
        lights_(split_lights(capture.directions, parse_hold_out(arguments.hold_out))),
        kept_(selected_rows(*capture.rows, lights_.kept)),
        held_(selected_rows(*capture.rows, lights_.held)) {
    form_.max_planes = arguments.max_planes;
    form_.resolution = arguments.resolution;
    form_.ridge = arguments.ridge;
    const Format format = format_of(arguments.out);
    far_.planes.rule = format ? scale_rule(*format) : ScaleRule::any;
    far_.planes.ends = arguments.extremes ? RangeEnds::extremes : RangeEnds::least_error;
    far_.planes.memory_bytes = common.memory_bytes / 4;
    if (!arguments.out.empty()) {
      far_.planes.work_folder = fs::absolute(arguments.out).parent_path();
    }
    far_.progress = common.progress();
    for (const std::string& warning : light_warnings(lights_.kept_directions)) {
      log_warning(warning);
    }
  }

  [[nodiscard]] const Lights& lights() const { return lights_; }

  [[nodiscard]] std::vector<FormScore> scores(const std::vector<FitForm>& forms) {
    if (sample_.values.size() == 0) {
      sample_ = sample_lights(*kept_);
    }
    return score_forms(forms, lights_.kept_directions, sample_, form_);
  }

  /// The light-domain basis of basis files with as many numbers a pixel, where lights form
  /// grids and all are there.
  [[nodiscard]] std::optional<HaarSize> haar() const {
    if (!capture_.session || !lights_.held.empty()) {
      return {};
    }
    const Session& session = *capture_.session;
    HaarGrid grid{session.info().grid_rows, session.info().grid_cols};
    if (session.rig() && !session.rig()->faces.empty()) {
      grid = {session.rig()->faces.front().rows, session.rig()->faces.front().cols};
    }
    if (!grid.is_valid() || sample_.n_lights() % grid.size() != 0) {
      return {};
    }
    return measure_light_haar(sample_, grid, arguments_.max_planes);
  }

  [[nodiscard]] Fitted fit(const FormScore& score) {
    const double start = processor_seconds();
    ridge_ = score.recipe.ridge;
    const FarFit fit =
        make_far_fit(score.form, score.recipe, lights_.kept_directions, sample_, form_);
    Fitted fitted{
        score, arguments_.near == "off" ? fit_far(*kept_, fit, far_) : fit_nearby(fit),
        0.0,   0,
        {},    {}};
    fitted.seconds = processor_seconds() - start;
    fitted.result.model.photographed = capture_.photographed;
    const StackDims shape = kept_->dims();
    fitted.n_pixels = static_cast<long long>(shape.width) * shape.height;
    return fitted;
  }

  [[nodiscard]] Against against() const {
    return arguments_.near != "off" ? Against::planes
           : lights_.held.empty()   ? Against::fitted
                                    : Against::held;
  }

  /// PSNR of a decoded file's pictures, a light. Large captures are compared on bands of rows.
  [[nodiscard]] std::vector<double> measure(const ReflectanceModel& decoded,
                                            const ReflectanceModel& planes) {
    constexpr std::uint64_t kMost = 200'000'000;  // pixels times lights
    switch (against()) {
      case Against::held:
        return measure_fit(decoded, *held_, lights_.held_directions, kMost).psnr_db;
      case Against::fitted:
        return measure_fit(decoded, *kept_, lights_.kept_directions, kMost).psnr_db;
      case Against::planes:
        break;
    }
    constexpr int kCompared = 25;
    const PictureDifference found =
        compare_pictures(planes, decoded, spread_over_hemisphere(kCompared));
    constexpr double kSame = 100.0;  // no byte differs
    return {found.is_same ? kSame : found.mean_db};
  }

 private:
  /// The same basis and ridge, each pixel in its own directions.
  [[nodiscard]] FitResult fit_nearby(const FarFit& far) {
    const CaptureLights lights = capture_lights(*capture_.session);
    NearGeometry geometry;
    for (const int light : lights_.kept) {
      geometry.lights.push_back(lights.near[static_cast<std::size_t>(light)]);
    }
    geometry.points = pixel_points(*capture_.session, arguments_.width_mm);
    NearFitOptions options;
    options.basis = far.model.basis;
    options.n_terms = far.model.n_terms;
    options.ridge = std::max(1e-5, ridge_);
    options.solve = arguments_.near == "exact" ? NearSolve::exact : NearSolve::interpolated;
    options.transfer = arguments_.transfer == "linear" ? Transfer::linear : Transfer::srgb;
    options.planes = far_.planes;
    options.progress = far_.progress;
    return fit_near(*kept_, geometry, options);
  }

  const FitArguments& arguments_;
  OpenCapture& capture_;
  double ridge_ = 0.0;
  Lights lights_;
  std::unique_ptr<PictureRows> kept_;
  std::unique_ptr<PictureRows> held_;
  FormOptions form_;
  FarFitOptions far_;
  LightSample sample_;
};

/// Writes the fit where it is asked for, else where it is removed again, and measures it. Its
/// planes are let go where nothing needs them any more.
void write_and_measure(Fitter& fitter, const FitArguments& arguments, Fitted& fitted) {
  ReflectanceModel& planes = fitted.result.model;
  const bool keeps_planes = fitter.against() == Against::planes;
  const auto measure = [&](const ReflectanceModel& decoded) {
    fitted.psnr_db = fitter.measure(decoded, planes);
    return mean_of(fitted.psnr_db);
  };
  fitted.file = arguments.out.empty()
                    ? try_fit_file(planes, measure, keeps_planes)
                    : write_fit(arguments.out, planes, arguments.size, measure, keeps_planes);
  if (!fitted.file) {
    (void)measure(planes);
  }
}

void print_head(Against against) {
  fmt::print(
      "file dB: the file's pictures, read again, against {}; left dB: of lights left out "
      "in turn\n",
      words_of(against));
  fmt::print("{:<9} {:>6} {:>10} {:>9} {:>9} {:>8} {:>8}  {}\n", "basis", "planes", "bytes",
             "bit/pixel", "CPU s/MP", "file dB", "left dB", "recipe");
}

std::string words_of(const std::optional<FitFile>& file) {
  if (!file) {
    return "; no file holds it: dB of the planes";
  }
  return file->quality ? fmt::format("; folder, quality {:.4g}", *file->quality)
                       : "; " + file->name;
}

void print_row(const Fitted& fitted) {
  const ReflectanceModel& model = fitted.result.model;
  const auto n_pixels = static_cast<double>(fitted.n_pixels);
  const auto bytes = fitted.file ? static_cast<double>(fitted.file->bytes) : 0.0;
  fmt::print("{:<9} {:>6} {:>10} {:>9} {:>9.3f} {:>8.2f} {:>8.2f}  {}{}\n",
             to_string(fitted.score.form), model.n_planes(),
             fitted.file ? fmt::format("{}", fitted.file->bytes) : "-",
             fitted.file ? fmt::format("{:.2f}", 8.0 * bytes / n_pixels) : "-",
             1e6 * fitted.seconds / n_pixels, mean_of(fitted.psnr_db), fitted.score.psnr_db,
             to_string(fitted.score.recipe), words_of(fitted.file));
}

TradeoffRecord record_of(const Fitted& fitted, const FitArguments& arguments,
                         const CommonOptions& common, std::size_t n_lights, Against against) {
  TradeoffRecord record;
  const ReflectanceModel& model = fitted.result.model;
  record.algorithm = "haarlight";
  record.mode =
      fmt::format("fit {}: {}", to_string(fitted.score.form), to_string(fitted.score.recipe));
  record.error_norm =
      fmt::format("mean PSNR of the file's pictures against {}, dB", words_of(against));
  record.error = mean_of(fitted.psnr_db);
  record.seconds = fitted.seconds;
  record.seconds_least = fitted.seconds;
  record.seconds_most = fitted.seconds;
  record.bytes = fitted.file ? static_cast<double>(fitted.file->bytes)
                             : static_cast<double>(fitted.n_pixels * model.n_planes());
  record.conditions.threads = std::max(1, common.threads);
  record.conditions.lights = static_cast<int>(n_lights);
  record.conditions.pixels = fitted.n_pixels;
  record.conditions.repeats = 1;
  record.conditions.command = fmt::format("haarlight fit {} --compare --hold-out {}",
                                          arguments.capture, arguments.hold_out);
  record.conditions.more = {
      {"bytes_are", fitted.file ? "on disk: " + fitted.file->name : "the planes, 8 bits each"},
      {"seconds_are", std::string("of the processor, reading included")}};
  return record;
}

/// Every form, best first as the lights left out judge it.
ExitCode compare(Fitter& fitter, const FitArguments& arguments, const CommonOptions& common,
                 Report& report) {
  std::vector<TradeoffRecord> records;
  print_head(fitter.against());
  for (const FormScore& score : fitter.scores(all_fit_forms())) {
    Fitted fitted = fitter.fit(score);
    write_and_measure(fitter, arguments, fitted);
    print_row(fitted);
    report.add_reached(fmt::format("{} dB", to_string(score.form)), mean_of(fitted.psnr_db));
    if (fitted.file) {
      report.add_reached(fmt::format("{} bytes", to_string(score.form)),
                         static_cast<std::int64_t>(fitted.file->bytes));
    }
    records.push_back(
        record_of(fitted, arguments, common, fitter.lights().kept.size(), fitter.against()));
  }
  if (const std::optional<HaarSize> haar = fitter.haar()) {
    fmt::print(
        "{:<9} {:>6} {:>10} {:>9.2f} {:>9} {:>8.2f} {:>8}  at its own lights (none between)\n",
        "haar", "-", "-", 8.0 * haar->bytes_a_pixel, "-", haar->psnr_db, "-");
    report.add_reached("haar dB at its own lights", haar->psnr_db);
  }
  if (!arguments.records.empty()) {
    write_file_atomically(arguments.records, tradeoff_json(records));
  }
  return ExitCode::done;
}

void require_near_makes_sense(const FitArguments& arguments, const OpenCapture& capture) {
  if (arguments.near == "off") {
    return;
  }
  if (arguments.compare || !arguments.hold_out.empty()) {
    throw Error("pictures at the lights' own distances are not what a near fit gives", "--near",
                "leave out --compare and --hold-out: a near fit's pictures have no fall-off",
                ExitCode::usage);
  }
  if (!capture.session || !capture_lights(*capture.session).are_near) {
    throw Error("the capture's lights are directions: how near they are is not known",
                arguments.capture,
                "import it with positions (haarlight import --places positions), or fit it "
                "without --near");
  }
}

ExitCode run_fit(const FitArguments& arguments, const CommonOptions& common, Report& report) {
  report.add_input(arguments.capture);
  if (arguments.size.quality) {
    report.add_asked("quality", *arguments.size.quality);
  }
  if (arguments.size.bytes) {
    report.add_asked("bytes", static_cast<std::int64_t>(*arguments.size.bytes));
  }
  if (arguments.size.psnr_db) {
    report.add_asked("file dB", *arguments.size.psnr_db);
  }
  if (arguments.out.empty() && !arguments.compare && arguments.hold_out.empty()) {
    throw Error("nothing to do", "", "name a file: -o FILE, or ask for --compare",
                ExitCode::usage);
  }
  const Format format = format_of(arguments.out);
  require_one_size(arguments.size, format);
  if (format) {
    require_absent(arguments.out, common.force);
  }
  OpenCapture capture = arguments.lights.empty() ? open_session(arguments, common)
                                                 : open_pictures(arguments, common);
  require_near_makes_sense(arguments, capture);
  Fitter fitter(arguments, common, capture);
  if (arguments.compare) {
    return compare(fitter, arguments, common, report);
  }
  std::vector<FormScore> scores = fitter.scores(forms_of(arguments, format));
  if (arguments.basis == "auto") {
    scores.erase(std::remove_if(scores.begin(), scores.end(),
                                [&](const FormScore& score) {
                                  return score.n_planes > arguments.max_planes;
                                }),
                 scores.end());
  }
  if (scores.empty()) {
    throw Error("no basis fits so few planes", "--planes",
                "9 planes hold lptm, 12 hsh4, and 3 or more bilinear", ExitCode::usage);
  }
  Fitted fitted = fitter.fit(scores.front());
  write_and_measure(fitter, arguments, fitted);
  if (format) {
    add_page_to_fit(arguments.out, common);
    report.set_bytes(fitted.file ? fitted.file->bytes : bytes_on_disk(arguments.out));
  }
  print_head(fitter.against());
  print_row(fitted);
  report.add_detail("basis", std::string(to_string(fitted.score.form)));
  report.add_detail("recipe", to_string(fitted.score.recipe));
  report.add_reached("left out dB", fitted.score.psnr_db);
  const double psnr_db = mean_of(fitted.psnr_db);
  report.add_reached("file dB", psnr_db);
  report.add_detail("file dB against", std::string(words_of(fitter.against())));
  report.add_detail("file dB each", fitted.psnr_db);
  if (fitter.against() == Against::held) {
    report.add_reached("held out dB", psnr_db);
  }
  if (fitted.file && fitted.file->quality) {
    report.add_reached("quality", *fitted.file->quality);
  }
  report.add_detail("quantisation rms", fitted.result.quantisation_rms);
  report.add_detail("clipped share", fitted.result.clipped);
  report.add_detail("peak memory bytes", static_cast<std::int64_t>(peak_memory_bytes()));
  if (format) {
    tell_next(common, {"view", arguments.out});
  }
  return ExitCode::done;
}

}  // namespace

void add_fit(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<FitArguments>();
  Command verb = root.add_verb("fit", "Make a picture that can be lit from any direction");
  verb.option("CAPTURE", &arguments->capture,
              "Session folder, or with --lights a folder of pictures",
              {.type = "SESSION|FOLDER", .is_required = true});
  verb.option("-o,--output", &arguments->out,
              "What to write: .ptm, .rti, or a name without ending for a web folder",
              {.type = "FILE"});
  std::vector<std::string> names = {"auto"};
  for (const FitForm form : all_fit_forms()) {
    names.emplace_back(to_string(form));
  }
  verb.option("--basis", &arguments->basis,
              "The basis; auto: the one that predicts each light best from the others",
              {.choices = names, .shows_default = true});
  verb.option("--lights", &arguments->lights, "List of lights of a folder of pictures",
              {.type = "FILE.lp"});
  add_picture_list_options(verb, arguments->list);
  verb.option("--planes", &arguments->max_planes, "The most planes of 8 bits that auto may use",
              {.bounds = Bounds{3.0, 96.0}, .shows_default = true});
  verb.option("--resolution", &arguments->resolution, "bilinear: knots a side",
              {.bounds = Bounds{2.0, 64.0}, .shows_default = true});
  verb.option("--ridge", &arguments->ridge,
              "Smoothing (default: what predicts lights left out best)",
              {.bounds = Bounds{0.0, 1e6}});
  verb.flag("--extremes", &arguments->extremes,
            "Keep the planes' extreme values instead of the least error");
  verb.option(
      "--quality", &arguments->size.quality,
      "Of a folder's pictures (default: 97); every plane is rounded as the lit pictures "
      "need it",
      {.bounds = Bounds{1.0, 100.0}});
  verb.option("--bytes", &arguments->bytes,
              "The most bytes of a folder: the best quality that they hold",
              {.type = "BYTES|800k|2M"});
  verb.option("--psnr", &arguments->size.psnr_db,
              "The least mean PSNR of a folder's pictures, read again: the fewest bytes that "
              "reach it",
              {.type = "DB", .bounds = Bounds{1.0, 100.0}});
  verb.option("--transfer", &arguments->transfer,
              "What the fit's numbers are coded with; viewers expect srgb",
              {.choices = {"srgb", "linear"}, .shows_default = true});
  verb.option("--hold-out", &arguments->hold_out,
              "Leave out every EVERY-th light from REST on and measure the PSNR there",
              {.type = "EVERY:REST"});
  verb.option("--near", &arguments->near,
              "Lights are near: every pixel in its own directions, fall-off divided out; "
              "interpolated: 3 times faster",
              {.choices = {"off", "exact", "interpolated"}, .shows_default = true});
  verb.option("--width-mm", &arguments->width_mm,
              "With --near, for imported pictures: how wide the target is across the picture",
              {.bounds = Bounds{1e-3, 1e6}});
  verb.flag("--compare", &arguments->compare, "Fit all bases and print a table");
  verb.option("--json", &arguments->records, "With --compare: the table as records",
              {.type = "FILE.json"});
  verb.footer(
      "What is fitted and how it is chosen: docs/numerics/reflectance-fits.md.\n"
      "Examples:\n"
      "  haarlight fit door.session -o door-web\n"
      "  haarlight fit door.session -o door-small --bytes 400k\n"
      "  haarlight fit door.session --basis hsh9 -o door.rti\n"
      "  haarlight fit door/ --lights door/dirs.lp --crop 1,1,6,6 -o door-detail\n"
      "  haarlight fit cube.session --basis ptm --near exact -o cube.ptm\n"
      "  haarlight fit door.session --compare --hold-out 6:2");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    if (!arguments->bytes.empty()) {
      arguments->size.bytes = parse_bytes(arguments->bytes, "--bytes");
    }
    return run_fit(*arguments, common, report);
  });
}

}  // namespace haarlight
