// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/relight_pipeline.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <numbers>
#include <span>
#include <utility>

#include <fmt/format.h>

#include "core/counted.h"
#include "core/cpu_time.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/relight/basis/compress_session.h"
#include "haarlight/relight/light/light_weights.h"
#include "haarlight/session/develop/develop.h"
#include "haarlight/session/session.h"
#include "relight/basis/weight_list.h"
#include "relight/pipeline/captured_lights.h"
#include "relight/pipeline/relight_costs.h"
#include "relight/pipeline/relit_picture.h"
#include "relight/pipeline/result_lines.h"

namespace haarlight::relight {

namespace {

/// Adds what its lifetime takes to the summary.
class WorkClock {
 public:
  explicit WorkClock(RelightSummary& summary) : summary_(summary) {}
  ~WorkClock() {
    summary_.seconds += seconds();
    summary_.cpu_seconds += cpu_seconds();
  }
  WorkClock(const WorkClock&) = delete;
  WorkClock& operator=(const WorkClock&) = delete;
  [[nodiscard]] double seconds() const {
    return std::chrono::duration<double>(Clock::now() - start_).count();
  }
  [[nodiscard]] double cpu_seconds() const { return process_cpu_seconds() - cpu_start_; }

 private:
  using Clock = std::chrono::steady_clock;
  RelightSummary& summary_;
  Clock::time_point start_ = Clock::now();
  double cpu_start_ = process_cpu_seconds();
};

void note_missing(const RelightSummary& summary, PipelineNotes& notes) {
  if (*summary.missing_fraction > 1e-6) {
    notes.add(NoteKind::result,
              fmt::format("  {:.1f} % of the environment's light comes from where the rig has "
                          "no lights",
                          100.0 * *summary.missing_fraction));
  }
}

LightWeights environment_weights(const RelightPictureOptions& options, const BasisFile& basis,
                                 RelightSummary& summary, PipelineNotes& notes) {
  const render::Environment environment = read_environment(options.light);
  summary.layout = std::string(to_string(environment.layout()));
  const EnvironmentWeights found = CapturedLights(basis).weights(environment);
  summary.missing_fraction = found.missing_fraction;
  summary.conservation_error = found.conservation_error;
  note_missing(summary, notes);
  return found.weights;
}

LightWeights read_weights(const RelightPictureOptions& options, const BasisFile& basis,
                          RelightSummary& summary, PipelineNotes& notes) {
  const int n_sources = (options.light.cubemap.empty() ? 0 : 1) +
                        (options.light.lights.empty() ? 0 : 1) +
                        (options.weights.empty() ? 0 : 1);
  if (n_sources != 1) {
    throw Error("give one of --cubemap, --light and --weights", "command line",
                "name the light once", ExitCode::usage);
  }
  if (!options.light.cubemap.empty()) {
    return environment_weights(options, basis, summary, notes);
  }
  if (!options.weights.empty()) {
    return weights_from_json(options.weights, summary.basis.dims.n_lights);
  }
  return weights_from_words(options.light.lights, summary.basis.dims.n_lights);
}

/// The picture's error against the stack itself.
Achieved compare_with_session(const RelightPictureOptions& options, const LightWeights& weights,
                              const Image<float>& picture) {
  session::DevelopOptions develop_options;
  develop_options.memory_bytes = options.settings.memory_bytes;
  develop_options.progress = options.settings.progress;
  const session::Session session = session::Session::open(options.against);
  develop_options.plate = sharing_plate(session, {});
  const LightStack stack = session::develop(session, develop_options);
  const Image<float> truth = relight_stack(stack, weights);
  if (truth.height() != picture.height() || truth.width() != picture.width()) {
    throw Error("the session's frames have another size than the basis file", options.against,
                "give the session that was compressed");
  }
  return compare(picture.pixels(), truth.pixels());
}

double picture_exposure(const RelightPictureOptions& options, const Image<float>& picture,
                        PipelineNotes& notes) {
  const double exposure = relit_exposure({.exposure = options.exposure, .stops = options.stops},
                                         options.output, picture);
  if (is_for_display(options.output) && !options.exposure) {
    notes.add(NoteKind::result, fmt::format("  exposure {:.6g} for display", exposure));
  }
  return exposure;
}

/// Each channel's bound, the largest of several pictures'.
void add_worst_channels(const RelightBound& bound, std::vector<double>& worst) {
  worst.resize(std::max(worst.size(), bound.channels.size()));
  for (std::size_t c = 0; c < bound.channels.size(); ++c) {
    worst[c] = std::max(worst[c], bound.channels[c].relative_l2);
  }
}

std::string channel_words(const std::vector<double>& bounds) {
  return bounds.size() < 2
             ? std::string()
             : fmt::format("  of each channel alone at most {:.3g}\n", fmt::join(bounds, ", "));
}

/// How many pictures share a pass over the data.
std::size_t pictures_at_once(const RelightPictureOptions& options, const BasisHeader& header) {
  constexpr std::size_t kMostAtOnce = 32;
  const std::uint64_t picture_bytes = header.dims.n_pixels() * 3 * sizeof(float);
  return std::clamp<std::size_t>(
      options.settings.memory_bytes / 4 / std::max<std::uint64_t>(picture_bytes, 1), 1,
      kMostAtOnce);
}

/// By predicted seconds, where an error or a time was requested. Light alone as the order of terms
/// is for comparison: as many as it takes.
void choose(const RelightPictureOptions& options, const BasisFile& basis,
            std::span<const LightWeights> weights, const WorkClock& clock,
            RelightSummary& summary) {
  if (!options.seconds && (!options.max_error || options.order == TermOrder::light)) {
    return;
  }
  if (options.max_error && !options.frames && !options.form &&
      costs_less_than_prediction(basis)) {
    summary.choice = choose_all(basis.header().dims.n_lights);
    return;
  }
  std::vector<FormCost> forms =
      predict_costs(basis, weights,
                    {.is_in_passing = !options.frames,
                     .may_be_halved = !options.max_error || *options.max_error >= kHalfError,
                     .at_once = pictures_at_once(options, basis.header()),
                     .order = options.order,
                     .memory_bytes = options.settings.memory_bytes / 2});
  if (options.form) {
    std::erase_if(forms, [&](const FormCost& cost) { return cost.form != *options.form; });
  }
  if (forms.empty()) {
    throw Error("this file does not have the form", "form", "leave the choice to the program",
                ExitCode::usage);
  }
  const double spent = clock.cpu_seconds();  // predictions are those of cores of one's own
  RelightChoice choice =
      options.max_error
          ? choose_within_error(forms, *options.max_error)
          : choose_within_seconds(forms,
                                  *options.seconds - clock.seconds() / double(weights.size()));
  choice.seconds += spent;
  choice.all_seconds += spent;
  choice.fewest_seconds += spent;
  summary.is_time_enough = options.max_error || choice.is_within;
  summary.choice = std::move(choice);
}

/// What was chosen and why; a time that is too short.
void tell_choice(const RelightPictureOptions& options, int terms_all,
                 const RelightSummary& summary, PipelineNotes& notes) {
  if (!summary.choice) {
    return;
  }
  notes.add(NoteKind::result, words_of(*summary.choice, {.max_error = options.max_error,
                                                         .seconds = options.seconds,
                                                         .terms_all = terms_all,
                                                         .is_exact = summary.basis.coding !=
                                                                     BasisCoding::quantised}));
  if (!summary.is_time_enough) {
    notes.add(
        NoteKind::failure,
        fmt::format("{:.3g} s are too short: the cheapest way takes {:.3g} s a picture here",
                    *options.seconds,
                    summary.choice->seconds / double(summary.choice->terms.size())));
  }
}

/// Reports if the requested error cannot be guaranteed.
void evaluate(const RelightPictureOptions& options, RelightSummary& summary,
              PipelineNotes& notes) {
  summary.is_error_kept = !options.max_error || summary.relative_l2_bound <= *options.max_error;
  if (!summary.is_error_kept) {
    notes.add(NoteKind::failure,
              fmt::format("an error of {:.3g} cannot be promised from this file: its own error "
                          "allows {:.3g}; compress with a smaller --max-error",
                          *options.max_error, summary.relative_l2_bound));
  }
}

/// Adds one picture's bounds and terms; the worst count.
void count_picture(const RelitPicture& relit, RelightSummary& summary) {
  summary.relative_l2_bound = std::max(summary.relative_l2_bound, relit.bound.relative_l2);
  add_worst_channels(relit.bound, summary.channel_bounds);
  const PictureClipping clipping = picture_clipping(relit.bound);
  summary.clipping.fraction = std::max(summary.clipping.fraction, clipping.fraction);
  summary.clipping.relative = std::max(summary.clipping.relative, clipping.relative);
  summary.terms = std::max(summary.terms, relit.terms);
  summary.picture_terms.push_back(relit.terms);
  summary.method = relit.method;
}

/// Writes one picture with its metadata.
void write_relit(const std::filesystem::path& name, const RelitPicture& relit,
                 const LightWeights& weights, const RelightPictureOptions& options,
                 RelightSummary& summary) {
  write_file_atomically(
      name, encode_photograph(name, relit.picture.view(), summary.exposure,
                              relit_notes(summary.basis, relit, weights, options.max_error)));
  summary.bytes += std::filesystem::file_size(name);
}

/// OUT.exr to OUT-0007.exr.
std::filesystem::path frame_name(const std::filesystem::path& output, int frame) {
  std::filesystem::path name = output;
  name.replace_filename(
      fmt::format("{}-{:04}{}", output.stem().string(), frame, output.extension().string()));
  return name;
}

/// Every frame's weights; the worst frame's fractions go into the summary.
std::vector<LightWeights> frame_weights(const RelightPictureOptions& options,
                                        const BasisFile& basis, RelightSummary& summary,
                                        PipelineNotes& notes) {
  const CapturedLights lights(basis);
  const render::Environment still = read_environment(options.light);
  summary.layout = std::string(to_string(still.layout()));
  std::vector<LightWeights> weights;
  double missing_fraction = 0.0;
  for (int i = 0; i < *options.frames; ++i) {
    EnvironmentWeights found =
        lights.weights(still, 2.0 * std::numbers::pi * i / *options.frames);
    missing_fraction = std::max(missing_fraction, found.missing_fraction);
    summary.conservation_error = std::max(summary.conservation_error, found.conservation_error);
    weights.push_back(std::move(found.weights));
  }
  summary.missing_fraction = missing_fraction;
  note_missing(summary, notes);
  return weights;
}

std::string frames_words(const RelightPictureOptions& options, const RelightSummary& summary) {
  const int n_frames = *options.frames;
  return fmt::format(
      "{} to {}: at most {}, relative error at most {:.3g}, {:.1f} ms per frame\n",
      frame_name(options.output, 0).string(),
      frame_name(options.output, n_frames - 1).filename().string(),
      counted(summary.terms, "term"), summary.relative_l2_bound,
      1e3 * summary.seconds / n_frames);
}

/// The terms chosen for some of the pictures.
RelightOptions with_terms_of(const std::optional<RelightChoice>& choice, std::size_t first,
                             std::size_t n, RelightOptions terms) {
  if (choice) {
    const auto from = choice->terms.begin() + static_cast<std::ptrdiff_t>(first);
    terms.terms_each.assign(from, from + static_cast<std::ptrdiff_t>(n));
  }
  return terms;
}

void relight_frames(const RelightPictureOptions& options, const RelightOptions& terms,
                    RelightSummary& summary, PipelineNotes& notes) {
  if (options.light.cubemap.empty()) {
    throw Error("--frames turns an environment, and none is given", "command line",
                "give --cubemap", ExitCode::usage);
  }
  for (int i = 0; i < *options.frames; ++i) {
    require_absent(frame_name(options.output, i), options.settings.overwrites);
  }
  const BasisFile basis = BasisFile::open(options.basis);
  summary.basis = basis.header();
  const std::vector<LightWeights> weights = frame_weights(options, basis, summary, notes);
  std::optional<WorkClock> clock(std::in_place, summary);
  choose(options, basis, weights, *clock, summary);
  const Relighter relighter(
      basis, {.use = RelighterPlan::Use::frames,
              .n_frames = *options.frames,
              .max_error = terms.max_error,
              .has_terms = terms.terms.has_value(),
              .form = summary.choice ? std::optional(summary.choice->form) : std::nullopt,
              .memory_bytes = options.settings.memory_bytes / 2});
  const std::size_t at_once = pictures_at_once(options, summary.basis);
  clock.reset();
  for (std::size_t first = 0; first < weights.size(); first += at_once) {
    const std::size_t n = std::min(at_once, weights.size() - first);
    clock.emplace(summary);
    const std::vector<RelitPicture> pictures = relighter.relight(
        std::span(weights).subspan(first, n), with_terms_of(summary.choice, first, n, terms));
    clock.reset();
    if (first == 0) {  // one exposure for all frames: no flicker
      summary.exposure = picture_exposure(options, pictures[0].picture, notes);
    }
    for (std::size_t i = 0; i < pictures.size(); ++i) {
      count_picture(pictures[i], summary);
      summary.terms_all = std::max(summary.terms_all, pictures[i].terms_all);
      write_relit(frame_name(options.output, static_cast<int>(first + i)), pictures[i],
                  weights[first + i], options, summary);
    }
  }
  tell_lines(frames_words(options, summary), notes);
  tell_choice(options, summary.terms_all, summary, notes);
  tell_lines(channel_words(summary.channel_bounds), notes);
  tell_lines(clipped_words(summary.basis, summary.clipping), notes);
}

void relight_once(const RelightPictureOptions& options, const RelightOptions& terms,
                  RelightSummary& summary, PipelineNotes& notes) {
  require_absent(options.output, options.settings.overwrites);
  const BasisFile basis = BasisFile::open(options.basis);
  summary.basis = basis.header();
  const LightWeights weights = read_weights(options, basis, summary, notes);
  std::optional<WorkClock> clock(std::in_place, summary);
  choose(options, basis, std::span(&weights, 1), *clock, summary);
  const RelitPicture relit =
      std::move(Relighter(basis, {})
                    .relight(std::span(&weights, 1), with_terms_of(summary.choice, 0, 1, terms))
                    .front());
  clock.reset();
  count_picture(relit, summary);
  summary.terms_all = relit.terms_all;
  summary.bytes_read = relit.bytes_read;
  tell_lines(fmt::format("{}: {} of {}, relative error at most {:.3g}, {:.1f} ms\n",
                         options.output, summary.terms, counted(summary.terms_all, "term"),
                         summary.relative_l2_bound, 1e3 * summary.seconds),
             notes);
  tell_choice(options, summary.terms_all, summary, notes);
  tell_lines(channel_words(summary.channel_bounds), notes);
  tell_lines(clipped_words(summary.basis, summary.clipping), notes);
  summary.exposure = picture_exposure(options, relit.picture, notes);
  if (!options.against.empty()) {
    summary.against = compare_with_session(options, weights, relit.picture);
    const Achieved& found = *summary.against;
    notes.add(NoteKind::result,
              fmt::format("  against the session: relative error {:.3g}, worst pixel {:.3g}, "
                          "{:.1f} dB",
                          found.relative_l2, found.worst_pixel, found.psnr_db));
  }
  write_relit(options.output, relit, weights, options, summary);
}

}  // namespace

RelightSummary relight_picture(const RelightPictureOptions& options) {
  require_picture_name(options.output);
  if ((options.seconds && (options.max_error || options.terms)) ||
      (options.max_error && options.terms)) {
    throw Error("give one of --max-error, --terms and --seconds", "command line",
                "leave out all but one", ExitCode::usage);
  }
  RelightOptions terms;
  terms.terms = options.terms;
  terms.max_error = options.max_error;
  terms.order = options.order;
  RelightSummary summary;
  PipelineNotes notes(options.settings.tell);
  if (options.frames) {
    relight_frames(options, terms, summary, notes);
  } else {
    relight_once(options, terms, summary, notes);
  }
  evaluate(options, summary, notes);
  summary.notes = notes.all();
  return summary;
}

}  // namespace haarlight::relight
