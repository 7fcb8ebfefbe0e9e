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

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/relight/basis/compress_session.h"
#include "haarlight/relight/light/light_weights.h"
#include "haarlight/session/develop/develop.h"
#include "haarlight/session/session.h"
#include "relight/basis/prepared_basis.h"
#include "relight/basis/weight_list.h"
#include "relight/pipeline/display_exposure.h"
#include "relight/pipeline/picture_notes.h"
#include "relight/pipeline/result_lines.h"

namespace haarlight::relight {

namespace {

using Clock = std::chrono::steady_clock;

/// Directions of the lights of a capture without a rig.
std::vector<Eigen::Vector3d> light_directions(const BasisHeader& header) {
  std::vector<Eigen::Vector3d> directions;
  for (const BasisLight& light : header.lights) {
    directions.push_back(light.coordinates.normalized());
  }
  return directions;
}

EnvironmentWeights integrate(const render::Environment& environment, const BasisHeader& header,
                             const std::string& basis) {
  return header.rig_toml.empty()
             ? voronoi_weights(environment, light_directions(header))
             : rig_weights(environment, parse_rig(header.rig_toml, basis + " (rig)"));
}

void note_missing(const RelightSummary& summary, PipelineNotes& notes) {
  if (*summary.missing_fraction > 1e-6) {
    notes.add(NoteKind::result,
              fmt::format("  {:.1f} % of the environment's light comes from where the rig has "
                          "no lights",
                          100.0 * *summary.missing_fraction));
  }
}

LightWeights environment_weights(const RelightPictureOptions& options, RelightSummary& summary,
                                 PipelineNotes& notes) {
  const render::Environment environment = read_environment(options.light);
  summary.layout = std::string(to_string(environment.layout()));
  const EnvironmentWeights found = integrate(environment, summary.basis, options.basis);
  summary.missing_fraction = found.missing_fraction;
  summary.conservation_error = found.conservation_error;
  note_missing(summary, notes);
  return found.weights;
}

LightWeights read_weights(const RelightPictureOptions& options, RelightSummary& summary,
                          PipelineNotes& notes) {
  const int n_sources = (options.light.cubemap.empty() ? 0 : 1) +
                        (options.light.lights.empty() ? 0 : 1) +
                        (options.weights.empty() ? 0 : 1);
  if (n_sources != 1) {
    throw Error("give one of --cubemap, --light and --weights", "command line",
                "name the light once", ExitCode::usage);
  }
  if (!options.light.cubemap.empty()) {
    return environment_weights(options, summary, notes);
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
  const bool is_display = std::filesystem::path(options.output).extension() == ".png";
  const double factor = std::exp2(options.stops);
  if (!is_display || options.exposure) {
    return factor * options.exposure.value_or(1.0);
  }
  const double exposure = factor * display_exposure(std::vector<float>(picture.pixels().begin(),
                                                                       picture.pixels().end()),
                                                    kDisplayFraction);
  notes.add(NoteKind::result, fmt::format("  exposure {:.6g} for display", exposure));
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

/// Reports if the requested error cannot be guaranteed.
void evaluate(const RelightPictureOptions& options, RelightSummary& summary,
              PipelineNotes& notes) {
  summary.is_error_kept = !options.max_error || summary.relative_l2_bound <= *options.max_error;
  if (!summary.is_error_kept) {
    notes.add(NoteKind::warning,
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
  summary.method = relit.method;
}

/// Writes one picture with its metadata.
void write_relit(const std::filesystem::path& name, const RelitPicture& relit,
                 const LightWeights& weights, const RelightPictureOptions& options,
                 RelightSummary& summary) {
  PictureNotes notes = notes_of(summary.basis);
  add_weights(weights, notes);
  add_error(options.max_error, relit.bound.relative_l2, notes);
  add_clipped(relit.bound, notes);
  write_image(name, relit.picture.view(), summary.exposure, notes);
  summary.bytes += std::filesystem::file_size(name);
}

/// OUT.exr to OUT-0007.exr.
std::filesystem::path frame_name(const std::filesystem::path& output, int frame) {
  std::filesystem::path name = output;
  name.replace_filename(
      fmt::format("{}-{:04}{}", output.stem().string(), frame, output.extension().string()));
  return name;
}

/// Sums pictures of one basis file, several in one pass over the data.
///
/// A quantised file is unpacked into memory for frames. Of an exact one all lights are read
/// whatever the terms, so that fewer save nothing: they are summed once, or, for many frames where
/// half floats may keep the requested error, held as these. A picture whose bound is above the
/// request is then summed from the file.
class Relighter {
 public:
  /// @param n_frames  0: one picture
  Relighter(const BasisFile& basis, const RelightOptions& options, int n_frames,
            std::uint64_t memory_bytes)
      : basis_(basis), options_(options) {
    // From here on half floats cost less than reading the file for each batch of frames:
    // docs/numerics/relight.md, "Exact files".
    constexpr int kFewestFrames = 8;
    // A half float's rounding. Below it only values of few bits would keep the request.
    constexpr double kHalfError = 0x1p-11;
    const BasisHeader& header = basis.header();
    if (header.coding == BasisCoding::quantised) {
      if (n_frames > 0) {
        prepared_.emplace(
            basis, PrepareOptions{.form = PreparedForm::sparse, .memory_bytes = memory_bytes});
      }
    } else if (options.max_error && options.order == TermOrder::transport) {
      max_error_ = *options.max_error;
      options_.max_error.reset();
      if (n_frames >= kFewestFrames && max_error_ >= kHalfError &&
          DenseHalf::bytes_of(header.dims) <= memory_bytes) {
        prepared_.emplace(
            basis, PrepareOptions{.form = PreparedForm::dense, .memory_bytes = memory_bytes});
      }
    }
  }

  [[nodiscard]] std::vector<RelitPicture> relight(std::span<const LightWeights> weights) const {
    if (!prepared_) {
      return haarlight::relight::relight(basis_, weights, options_);
    }
    std::vector<RelitPicture> pictures = prepared_->relight(weights, options_);
    for (std::size_t i = 0; i < pictures.size(); ++i) {
      if (prepared_->form() == PreparedForm::dense &&
          pictures[i].bound.relative_l2 > max_error_) {
        pictures[i] = haarlight::relight::relight(basis_, weights[i], options_);
      }
    }
    return pictures;
  }

 private:
  const BasisFile& basis_;
  RelightOptions options_;
  double max_error_ = 0.0;  ///< requested of an exact file
  std::optional<PreparedBasis> prepared_;
};

/// Every frame's weights; the worst frame's fractions go into the summary.
std::vector<LightWeights> frame_weights(const RelightPictureOptions& options,
                                        RelightSummary& summary, PipelineNotes& notes) {
  const render::Environment still = read_environment(options.light);
  summary.layout = std::string(to_string(still.layout()));
  std::vector<LightWeights> weights;
  double missing_fraction = 0.0;
  for (int i = 0; i < *options.frames; ++i) {
    render::Environment environment = still;
    environment.rotate(2.0 * std::numbers::pi * i / *options.frames);
    EnvironmentWeights found = integrate(environment, summary.basis, options.basis);
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
      "{} to {}: at most {} terms, relative error at most {:.3g}, {:.1f} ms per frame\n",
      frame_name(options.output, 0).string(),
      frame_name(options.output, n_frames - 1).filename().string(), summary.terms,
      summary.relative_l2_bound, 1e3 * summary.seconds / n_frames);
}

void relight_frames(const RelightPictureOptions& options, const RelightOptions& terms,
                    RelightSummary& summary, PipelineNotes& notes) {
  constexpr std::size_t kMostAtOnce = 32;
  if (options.light.cubemap.empty()) {
    throw Error("--frames turns an environment, and none is given", "command line",
                "give --cubemap", ExitCode::usage);
  }
  for (int i = 0; i < *options.frames; ++i) {
    require_absent(frame_name(options.output, i), options.settings.overwrites);
  }
  const BasisFile basis = BasisFile::open(options.basis);
  summary.basis = basis.header();
  const std::vector<LightWeights> weights = frame_weights(options, summary, notes);
  const std::uint64_t memory_bytes = options.settings.memory_bytes;
  const Relighter relighter(basis, terms, *options.frames, memory_bytes / 2);
  const std::uint64_t picture_bytes = summary.basis.dims.n_pixels() * 3 * sizeof(float);
  const std::size_t at_once = std::clamp<std::size_t>(
      memory_bytes / 4 / std::max<std::uint64_t>(picture_bytes, 1), 1, kMostAtOnce);
  std::chrono::duration<double> seconds{};
  for (std::size_t first = 0; first < weights.size(); first += at_once) {
    const auto start = Clock::now();
    const std::vector<RelitPicture> pictures = relighter.relight(
        std::span(weights).subspan(first, std::min(at_once, weights.size() - first)));
    seconds += Clock::now() - start;
    if (first == 0) {  // one exposure for all frames: no flicker
      summary.exposure = picture_exposure(options, pictures[0].picture, notes);
    }
    for (std::size_t i = 0; i < pictures.size(); ++i) {
      count_picture(pictures[i], summary);
      write_relit(frame_name(options.output, static_cast<int>(first + i)), pictures[i],
                  weights[first + i], options, summary);
    }
  }
  summary.seconds = seconds.count();
  tell_lines(frames_words(options, summary), notes);
  tell_lines(channel_words(summary.channel_bounds), notes);
  tell_lines(clipped_words(summary.basis, summary.clipping), notes);
}

void relight_once(const RelightPictureOptions& options, const RelightOptions& terms,
                  RelightSummary& summary, PipelineNotes& notes) {
  require_absent(options.output, options.settings.overwrites);
  const BasisFile basis = BasisFile::open(options.basis);
  summary.basis = basis.header();
  const LightWeights weights = read_weights(options, summary, notes);
  const auto start = Clock::now();
  const Relighter relighter(basis, terms, 0, options.settings.memory_bytes / 2);
  const RelitPicture relit = std::move(relighter.relight(std::span(&weights, 1)).front());
  summary.seconds = std::chrono::duration<double>(Clock::now() - start).count();
  count_picture(relit, summary);
  summary.terms_all = relit.terms_all;
  summary.bytes_read = relit.bytes_read;
  tell_lines(fmt::format("{}: {} of {} terms, relative error at most {:.3g}, {:.1f} ms\n",
                         options.output, summary.terms, summary.terms_all,
                         summary.relative_l2_bound, 1e3 * summary.seconds),
             notes);
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
