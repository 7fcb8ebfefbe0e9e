// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/fit/fit_pipeline.h"

#include <algorithm>
#include <ctime>
#include <memory>
#include <utility>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/relight/basis/haar.h"
#include "haarlight/relight/light/near_light.h"
#include "haarlight/relight/reflectance/formats/refit.h"
#include "haarlight/relight/reflectance/formats/reflectance_file.h"
#include "relight/pipeline/fit/fit_input.h"

namespace haarlight::relight {

namespace {

namespace fs = std::filesystem;

/// The lights that are fitted, and those held out.
struct FitLights {
  std::vector<int> kept;
  std::vector<int> held;
  std::vector<Eigen::Vector3d> kept_directions;
  std::vector<Eigen::Vector3d> held_directions;
};

FitLights split_lights(const std::vector<Eigen::Vector3d>& directions,
                       const HoldOut& hold_out) {
  FitLights lights;
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

/// The kind of file a name implies; nothing: none requested.
Format format_of(const fs::path& out) {
  return out.empty() ? Format() : reflectance_format_of_name(out);
}

/// Whether a file of that format, or near lights, cannot have the form.
bool is_left_out(FitForm form, const Format& format, bool is_near) {
  const bool is_ptm = form == FitForm::ptm || form == FitForm::lptm;
  const bool is_hsh = form == FitForm::hsh4 || form == FitForm::hsh9 || form == FitForm::hsh16;
  const bool has_own_terms = form == FitForm::ptm || is_hsh;
  return (format == ReflectanceFormat::ptm && !is_ptm) ||
         (format == ReflectanceFormat::rti && !is_hsh) ||
         (format == ReflectanceFormat::web &&
          (form == FitForm::rbf || form == FitForm::hsh16)) ||
         (is_near && !has_own_terms);
}

std::vector<FitForm> forms_of(const FitOptions& options, const Format& format) {
  std::vector<FitForm> forms =
      options.form ? std::vector<FitForm>{*options.form} : all_values<FitForm>();
  forms.erase(std::remove_if(forms.begin(), forms.end(),
                             [&](FitForm form) {
                               return is_left_out(form, format, options.near.has_value());
                             }),
              forms.end());
  if (forms.empty()) {
    throw Error(
        fmt::format("{} cannot be written there",
                    options.form ? to_string(*options.form) : std::string_view("auto")),
        options.out.string(),
        ".ptm holds ptm and lptm, .rti holds hsh4, hsh9 and hsh16, a folder all but "
        "hsh16 and rbf (which viewers light by rules of their own: --basis bilinear); near "
        "lights are fitted by ptm and hsh",
        ExitCode::usage);
  }
  return forms;
}

/// Lights sampled once, forms scored, and any of them fitted, written and measured.
class CaptureFitter {
 public:
  CaptureFitter(const FitOptions& options, FitInput& input, PipelineNotes& notes)
      : options_(options),
        input_(input),
        lights_(split_lights(input.directions, options.hold_out)),
        kept_(selected_rows(*input.rows, lights_.kept)),
        held_(selected_rows(*input.rows, lights_.held)) {
    const Format format = format_of(options.out);
    far_.planes.rule = format ? scale_rule(*format) : ScaleRule::any;
    far_.planes.ends = options.ends;
    far_.planes.memory_bytes = options.settings.memory_bytes / 4;
    if (!options.out.empty()) {
      far_.planes.work_folder = fs::absolute(options.out).parent_path();
    }
    far_.progress = options.settings.progress;
    for (const std::string& warning : light_warnings(lights_.kept_directions)) {
      notes.add(NoteKind::warning, warning);
    }
  }

  [[nodiscard]] int n_fitted_lights() const { return static_cast<int>(lights_.kept.size()); }

  [[nodiscard]] FitTruth truth() const {
    return options_.near          ? FitTruth::planes
           : lights_.held.empty() ? FitTruth::fitted
                                  : FitTruth::held;
  }

  [[nodiscard]] std::vector<FormScore> scores(const std::vector<FitForm>& forms) {
    if (sample_.values.size() == 0) {
      sample_ = sample_lights(*kept_);
    }
    return score_forms(forms, lights_.kept_directions, sample_, options_.forms);
  }

  [[nodiscard]] std::optional<HaarSize> haar() const {
    if (!input_.session || !lights_.held.empty()) {
      return {};
    }
    const session::Session& session = *input_.session;
    HaarGrid grid{session.info().grid_rows, session.info().grid_cols};
    if (session.rig() && !session.rig()->faces.empty()) {
      grid = {session.rig()->faces.front().rows, session.rig()->faces.front().cols};
    }
    if (!grid.is_valid() || sample_.n_lights() % grid.size() != 0) {
      return {};
    }
    return measure_light_haar(sample_, grid, options_.forms.max_planes);
  }

  /// Fits a form, writes it to the requested file, else to a temporary one, and measures it.
  [[nodiscard]] FormFit fit(const FormScore& score) {
    const double start = processor_seconds();
    FitResult result = fit_planes(score);
    FormFit out;
    out.score = score;
    out.seconds = processor_seconds() - start;
    result.model.photographed = input_.photographed;
    const StackDims shape = kept_->dims();
    out.n_pixels = static_cast<long long>(shape.width) * shape.height;
    out.n_planes = result.model.n_planes();
    out.quantisation_rms = result.quantisation_rms;
    out.clipped_fraction = result.clipped;
    write_and_measure(result.model, out);
    return out;
  }

 private:
  [[nodiscard]] FitResult fit_planes(const FormScore& score) {
    const FarFit far = make_far_fit(score.form, score.interpolation, lights_.kept_directions,
                                    sample_, options_.forms);
    return options_.near ? fit_nearby(far, score.interpolation.ridge)
                         : fit_far(*kept_, far, far_);
  }

  /// The same basis and ridge, each pixel in its own directions.
  [[nodiscard]] FitResult fit_nearby(const FarFit& far, double ridge) {
    constexpr double kLeastRidge = 1e-5;
    const CaptureLights lights = capture_lights(*input_.session);
    NearGeometry geometry;
    for (const int light : lights_.kept) {
      geometry.lights.push_back(lights.near[static_cast<std::size_t>(light)]);
    }
    geometry.points = pixel_points(*input_.session, options_.width_mm);
    NearFitOptions near;
    near.basis = far.model.basis;
    near.n_terms = far.model.n_terms;
    near.ridge = std::max(kLeastRidge, ridge);
    near.solve = *options_.near;
    near.transfer = options_.transfer;
    near.planes = far_.planes;
    near.progress = far_.progress;
    return fit_near(*kept_, geometry, near);
  }

  /// The planes are freed when nothing needs them any more.
  void write_and_measure(ReflectanceModel& planes, FormFit& fit) {
    const bool keeps_planes = truth() == FitTruth::planes;
    const auto measured = [&](const ReflectanceModel& decoded) {
      fit.psnr_db = measure(decoded, planes);
      return fit.mean_psnr_db();
    };
    fit.file = options_.out.empty()
                   ? try_fit_file(planes, measured, keeps_planes)
                   : write_fit(options_.out, planes, options_.size, measured, keeps_planes);
    if (!fit.file) {
      (void)measured(planes);
    }
  }

  /// PSNR of a decoded file's pictures, per light. Large captures are compared on bands of
  /// rows.
  [[nodiscard]] std::vector<double> measure(const ReflectanceModel& decoded,
                                            const ReflectanceModel& planes) {
    constexpr std::uint64_t kMost = 200'000'000;  // pixels times lights
    switch (truth()) {
      case FitTruth::held:
        return measure_fit(decoded, *held_, lights_.held_directions, kMost).psnr_db;
      case FitTruth::fitted:
        return measure_fit(decoded, *kept_, lights_.kept_directions, kMost).psnr_db;
      case FitTruth::planes:
        break;
    }
    constexpr int kCompared = 25;
    const PictureDifference found =
        compare_pictures(planes, decoded, spread_over_hemisphere(kCompared));
    constexpr double kSame = 100.0;  // no byte differs
    return {found.is_same ? kSame : found.mean_db};
  }

  const FitOptions& options_;
  FitInput& input_;
  FitLights lights_;
  std::unique_ptr<PictureRows> kept_;
  std::unique_ptr<PictureRows> held_;
  FarFitOptions far_;
  LightSample sample_;
};

enum class FitTask { one, all };

void require_near_makes_sense(const FitOptions& options, FitTask task, const FitInput& input) {
  if (!options.near) {
    return;
  }
  if (task == FitTask::all || options.hold_out.every > 0) {
    throw Error("pictures at the lights' own distances are not what a near fit gives", "--near",
                "leave out --compare and --hold-out: a near fit's pictures have no fall-off",
                ExitCode::usage);
  }
  if (!input.session || !capture_lights(*input.session).are_near) {
    throw Error("the capture's lights are directions: how near they are is not known",
                options.capture.string(),
                "import it with positions (haarlight import --places positions), or fit it "
                "without --near");
  }
}

/// The first steps of every fit. @throws Error  what could not be written
FitInput open_checked(const FitOptions& options, FitTask task, PipelineNotes& notes) {
  const Format format = format_of(options.out);
  require_one_size(options.size, format);
  if (format) {
    require_absent(options.out, options.settings.overwrites);
  }
  FitInput input = open_fit_input(options, notes);
  require_near_makes_sense(options, task, input);
  return input;
}

FormScore best_form(const FitOptions& options, CaptureFitter& fitter) {
  std::vector<FormScore> scores = fitter.scores(forms_of(options, format_of(options.out)));
  if (!options.form) {
    scores.erase(std::remove_if(scores.begin(), scores.end(),
                                [&](const FormScore& score) {
                                  return score.n_planes > options.forms.max_planes;
                                }),
                 scores.end());
  }
  if (scores.empty()) {
    throw Error("no basis fits so few planes", "--planes",
                "9 planes hold lptm, 12 hsh4, and 3 or more bilinear", ExitCode::usage);
  }
  return scores.front();
}

}  // namespace

double FormFit::mean_psnr_db() const { return FitError{psnr_db}.mean_psnr_db(); }

FitSummary fit_capture(const FitOptions& options) {
  if (options.out.empty() && options.hold_out.every == 0) {
    throw Error("nothing to do", "", "name a file: -o FILE, or ask for --compare",
                ExitCode::usage);
  }
  PipelineNotes notes(options.settings.tell);
  FitInput input = open_checked(options, FitTask::one, notes);
  CaptureFitter fitter(options, input, notes);
  FitSummary summary;
  summary.truth = fitter.truth();
  summary.n_fitted_lights = fitter.n_fitted_lights();
  summary.fits.push_back(fitter.fit(best_form(options, fitter)));
  summary.notes = notes.all();
  return summary;
}

FitSummary compare_fits(const FitOptions& options,
                        const std::function<void(FitTruth truth, const FormFit& fit)>& each) {
  PipelineNotes notes(options.settings.tell);
  FitInput input = open_checked(options, FitTask::all, notes);
  CaptureFitter fitter(options, input, notes);
  FitSummary summary;
  summary.truth = fitter.truth();
  summary.n_fitted_lights = fitter.n_fitted_lights();
  for (const FormScore& score : fitter.scores(all_values<FitForm>())) {
    summary.fits.push_back(fitter.fit(score));
    if (each) {
      each(summary.truth, summary.fits.back());
    }
  }
  summary.haar = fitter.haar();
  summary.notes = notes.all();
  return summary;
}

}  // namespace haarlight::relight
