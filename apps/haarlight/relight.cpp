// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight relight BASIS --cubemap ENV -o OUT`: a picture under an environment, or under
/// lights named one by one; or an animation, the environment turning once.

#include "relight/basis/relight.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <numbers>
#include <optional>

#include <fmt/format.h>

#include "apps/haarlight/clipped_words.h"
#include "apps/haarlight/display_exposure.h"
#include "apps/haarlight/light_options.h"
#include "apps/haarlight/picture_notes.h"
#include "apps/haarlight/step_before.h"
#include "apps/haarlight/verb.h"
#include "core/files.h"
#include "core/log.h"
#include "core/picture/image_io.h"
#include "core/rig/rig.h"
#include "core/tolerance.h"
#include "relight/basis/compress_session.h"
#include "relight/basis/prepared_basis.h"
#include "relight/basis/weight_list.h"
#include "relight/light/light_weights.h"
#include "session/develop/develop.h"
#include "session/session.h"

namespace haarlight {

namespace {

struct RelightArguments {
  std::string basis;
  std::string output;
  LightOptions light;
  std::string weights;
  std::optional<double> max_error;
  std::optional<int> terms;
  std::string order = "transport";
  std::optional<double> exposure;
  double stops = 0.0;
  std::string against;
  std::optional<int> frames;
};

/// Directions of the lights of a capture without a rig.
std::vector<Eigen::Vector3d> light_directions(const BasisHeader& header) {
  std::vector<Eigen::Vector3d> directions;
  for (const BasisLight& light : header.lights) {
    directions.push_back(light.place.normalized());
  }
  return directions;
}

EnvironmentWeights integrate(const Environment& environment, const BasisHeader& header,
                             const std::string& basis) {
  return header.rig_toml.empty()
             ? voronoi_weights(environment, light_directions(header))
             : rig_weights(environment, parse_rig(header.rig_toml, basis + " (rig)"));
}

void report_missing(double missing_share, double conservation_error, Report& report) {
  report.add_reached("missing_share", missing_share);
  report.add_reached("energy_conservation_error", conservation_error);
  if (missing_share > 1e-6) {
    fmt::print("  {:.1f} % of the environment's light comes from where the rig has no lights\n",
               100.0 * missing_share);
  }
}

LightWeights environment_weights(const RelightArguments& arguments, const BasisHeader& header,
                                 Report& report) {
  const Environment environment = read_environment(arguments.light, report);
  const EnvironmentWeights found = integrate(environment, header, arguments.basis);
  report_missing(found.missing_share, found.conservation_error, report);
  return found.weights;
}

LightWeights read_weights(const RelightArguments& arguments, const BasisHeader& header,
                          Report& report) {
  const int n_sources = (arguments.light.cubemap.empty() ? 0 : 1) +
                        (arguments.light.lights.empty() ? 0 : 1) +
                        (arguments.weights.empty() ? 0 : 1);
  if (n_sources != 1) {
    throw Error("give one of --cubemap, --light and --weights", "command line",
                "name the light once", ExitCode::usage);
  }
  if (!arguments.light.cubemap.empty()) {
    return environment_weights(arguments, header, report);
  }
  if (!arguments.weights.empty()) {
    report.add_input(arguments.weights);
    return weights_from_json(arguments.weights, header.dims.n_lights);
  }
  return weights_from_words(arguments.light.lights, header.dims.n_lights);
}

void compare_with_session(const RelightArguments& arguments, const LightWeights& weights,
                          const CommonOptions& common, const Image<float>& picture,
                          Report& report) {
  report.add_input(arguments.against);
  DevelopOptions options;
  options.memory_bytes = common.memory_bytes;
  options.progress = common.progress();
  const Session session = Session::open(arguments.against);
  options.plate = sharing_plate(session, {});
  const LightStack stack = develop(session, options);
  const Image<float> truth = relight_stack(stack, weights);
  if (truth.height() != picture.height() || truth.width() != picture.width()) {
    throw Error("the session's frames have another size than the basis file", arguments.against,
                "give the session that was compressed");
  }
  const Achieved found = compare(picture.pixels(), truth.pixels());
  report.add_reached("relative_l2", found.relative_l2);
  report.add_reached("worst_pixel", found.worst_pixel);
  report.add_reached("psnr_db", found.psnr_db);
  fmt::print("  against the session: relative error {:.3g}, worst pixel {:.3g}, {:.1f} dB\n",
             found.relative_l2, found.worst_pixel, found.psnr_db);
}

RelightOptions relight_options(const RelightArguments& arguments, Report& report) {
  RelightOptions options;
  options.terms = arguments.terms;
  options.max_error = arguments.max_error;
  options.order = arguments.order == "light" ? TermOrder::light : TermOrder::transport;
  if (options.max_error) {
    report.add_asked("relative_l2", *options.max_error);
  }
  if (options.terms) {
    report.add_asked("terms", std::int64_t{*options.terms});
  }
  return options;
}

double picture_exposure(const RelightArguments& arguments, const Image<float>& picture) {
  const bool is_display = std::filesystem::path(arguments.output).extension() == ".png";
  const double factor = std::exp2(arguments.stops);
  if (!is_display || arguments.exposure) {
    return factor * arguments.exposure.value_or(1.0);
  }
  const double exposure = factor * display_exposure(std::vector<float>(picture.pixels().begin(),
                                                                       picture.pixels().end()),
                                                    kDisplayShare);
  fmt::print("  exposure {:.6g} for display\n", exposure);
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

/// Says so when the error that was asked for cannot be promised.
ExitCode judge(const RelightOptions& options, double bound) {
  if (!options.max_error || bound <= *options.max_error) {
    return ExitCode::done;
  }
  log_warning(
      fmt::format("an error of {:.3g} cannot be promised from this file: its own error "
                  "allows {:.3g}; compress with a smaller --max-error",
                  *options.max_error, bound));
  return ExitCode::target_missed;
}

/// OUT.exr to OUT-0007.exr.
std::filesystem::path frame_name(const std::filesystem::path& output, int frame) {
  std::filesystem::path name = output;
  name.replace_filename(
      fmt::format("{}-{:04}{}", output.stem().string(), frame, output.extension().string()));
  return name;
}

/// Pictures of several turns in one reading of the data. A quantised file is unpacked into
/// memory once; an exact one is read for each batch, so that nothing is lost.
class FrameRelighter {
 public:
  FrameRelighter(const BasisFile& basis, std::uint64_t memory_bytes) : basis_(basis) {
    if (basis.header().coding == BasisCoding::quantised) {
      prepared_.emplace(
          basis, PrepareOptions{.form = PreparedForm::sparse, .memory_bytes = memory_bytes});
    }
  }
  [[nodiscard]] std::vector<RelitPicture> relight(std::span<const LightWeights> weights,
                                                  const RelightOptions& options) const {
    return prepared_ ? prepared_->relight(weights, options)
                     : haarlight::relight(basis_, weights, options);
  }

 private:
  const BasisFile& basis_;
  std::optional<PreparedBasis> prepared_;
};

/// Every frame's weights; the worst frame's shares go into the report.
std::vector<LightWeights> frame_weights(const RelightArguments& arguments,
                                        const BasisHeader& header, Report& report) {
  const Environment still = read_environment(arguments.light, report);
  std::vector<LightWeights> weights;
  double missing_share = 0.0;
  double conservation_error = 0.0;
  for (int i = 0; i < *arguments.frames; ++i) {
    Environment environment = still;
    environment.rotate(2.0 * std::numbers::pi * i / *arguments.frames);
    EnvironmentWeights found = integrate(environment, header, arguments.basis);
    missing_share = std::max(missing_share, found.missing_share);
    conservation_error = std::max(conservation_error, found.conservation_error);
    weights.push_back(std::move(found.weights));
  }
  report_missing(missing_share, conservation_error, report);
  return weights;
}

ExitCode run_frames(const RelightArguments& arguments, const CommonOptions& common,
                    Report& report) {
  constexpr std::size_t kMostAtOnce = 32;
  if (arguments.light.cubemap.empty()) {
    throw Error("--frames turns an environment, and none is given", "command line",
                "give --cubemap", ExitCode::usage);
  }
  const int n_frames = *arguments.frames;
  for (int i = 0; i < n_frames; ++i) {
    require_absent(frame_name(arguments.output, i), common.force);
  }
  report.add_asked("frames", std::int64_t{n_frames});
  const BasisFile basis = BasisFile::open(arguments.basis);
  const RelightOptions options = relight_options(arguments, report);
  const std::vector<LightWeights> weights = frame_weights(arguments, basis.header(), report);
  const FrameRelighter relighter(basis, common.memory_bytes / 2);
  const std::uint64_t picture_bytes = basis.header().dims.n_pixels() * 3 * sizeof(float);
  const std::size_t at_once = std::clamp<std::size_t>(
      common.memory_bytes / 4 / std::max<std::uint64_t>(picture_bytes, 1), 1, kMostAtOnce);
  std::optional<double> exposure;
  std::chrono::duration<double> seconds{};
  std::uint64_t bytes = 0;
  double worst = 0.0;
  int terms = 0;
  std::string method;
  PictureClipping clipping;
  std::vector<double> channels;
  for (std::size_t first = 0; first < weights.size(); first += at_once) {
    const auto start = std::chrono::steady_clock::now();
    const std::vector<RelitPicture> pictures = relighter.relight(
        std::span(weights).subspan(first, std::min(at_once, weights.size() - first)), options);
    seconds += std::chrono::steady_clock::now() - start;
    for (std::size_t i = 0; i < pictures.size(); ++i) {
      const RelitPicture& relit = pictures[i];
      if (!exposure) {  // one for all frames: no flicker
        exposure = picture_exposure(arguments, relit.picture);
      }
      const std::filesystem::path name =
          frame_name(arguments.output, static_cast<int>(first + i));
      PictureNotes notes = notes_of(basis.header());
      add_weights(weights[first + i], notes);
      add_error(options.max_error, relit.bound.relative_l2, notes);
      const PictureClipping of_frame = picture_clipping(relit.bound);
      clipping.share = std::max(clipping.share, of_frame.share);
      clipping.relative = std::max(clipping.relative, of_frame.relative);
      add_clipped(relit.bound, notes);
      add_worst_channels(relit.bound, channels);
      write_image(name, relit.picture.view(), *exposure, notes);
      bytes += std::filesystem::file_size(name);
      worst = std::max(worst, relit.bound.relative_l2);
      terms = std::max(terms, relit.terms);
      method = relit.method;
    }
  }
  report.add_reached("relative_l2_bound", worst);
  report.add_reached("channel_l2_bound", channels);
  report_clipped(basis.header(), clipping, report);
  report.add_reached("terms", std::int64_t{terms});
  report.add_detail("method", method);
  report.add_detail("relight_seconds", seconds.count());
  report.add_detail("exposure", exposure.value_or(1.0));
  report.set_bytes(bytes);
  fmt::print("{} to {}: at most {} terms, relative error at most {:.3g}, {:.1f} ms a frame\n",
             frame_name(arguments.output, 0).string(),
             frame_name(arguments.output, n_frames - 1).filename().string(), terms, worst,
             1e3 * seconds.count() / n_frames);
  fmt::print("{}{}", channel_words(channels), clipped_words(basis.header(), clipping));
  return judge(options, worst);
}

ExitCode run_relight(const RelightArguments& arguments, const CommonOptions& common,
                     Report& report) {
  refuse_not_basis(arguments.basis, "relight");
  report.add_input(arguments.basis);
  require_picture_name(arguments.output);
  if (arguments.frames) {
    return run_frames(arguments, common, report);
  }
  require_absent(arguments.output, common.force);
  const BasisFile basis = BasisFile::open(arguments.basis);
  const LightWeights weights = read_weights(arguments, basis.header(), report);
  const RelightOptions options = relight_options(arguments, report);
  const auto start = std::chrono::steady_clock::now();
  const RelitPicture relit = relight(basis, weights, options);
  const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - start;
  report.add_reached("relative_l2_bound", relit.bound.relative_l2);
  std::vector<double> channels;
  add_worst_channels(relit.bound, channels);
  report.add_reached("channel_l2_bound", channels);
  const PictureClipping clipping = picture_clipping(relit.bound);
  report_clipped(basis.header(), clipping, report);
  report.add_reached("terms", std::int64_t{relit.terms});
  report.add_detail("terms_all", std::int64_t{relit.terms_all});
  report.add_detail("relight_seconds", seconds.count());
  report.add_detail("bytes_read", static_cast<std::int64_t>(relit.bytes_read));
  fmt::print("{}: {} of {} terms, relative error at most {:.3g}, {:.1f} ms\n", arguments.output,
             relit.terms, relit.terms_all, relit.bound.relative_l2, 1e3 * seconds.count());
  fmt::print("{}{}", channel_words(channels), clipped_words(basis.header(), clipping));
  const double exposure = picture_exposure(arguments, relit.picture);
  report.add_detail("exposure", exposure);
  if (!arguments.against.empty()) {
    compare_with_session(arguments, weights, common, relit.picture, report);
  }
  PictureNotes notes = notes_of(basis.header());
  add_weights(weights, notes);
  add_error(options.max_error, relit.bound.relative_l2, notes);
  add_clipped(relit.bound, notes);
  write_image(arguments.output, relit.picture.view(), exposure, notes);
  report.set_bytes(std::filesystem::file_size(arguments.output));
  return judge(options, relit.bound.relative_l2);
}

}  // namespace

void add_relight(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<RelightArguments>();
  Command verb =
      root.add_verb("relight", "Make the picture under an environment or chosen lights");
  verb.option("BASIS", &arguments->basis, "Basis file",
              {.type = "BASIS.hlb", .is_required = true});
  verb.option("-o,--output", &arguments->output, "Picture: .exr linear, .png for display",
              {.type = "OUT", .is_required = true});
  add_light_options(verb, arguments->light);
  verb.option("--weights", &arguments->weights, "JSON list of every light's drive",
              {.type = "FILE.json"});
  verb.option("--max-error", &arguments->max_error,
              "Fewest terms whose relative L2 error is bounded by this",
              {.bounds = Bounds{0.0, 1.0}});
  verb.option("--terms", &arguments->terms, "Use this many terms (default: all)",
              {.bounds = Bounds{}, .excludes = "--max-error"});
  verb.option("--order", &arguments->order,
              "Order of terms: transport, or light alone (poor; for comparison)",
              {.choices = {"transport", "light"}, .shows_default = true});
  verb.option("--exposure", &arguments->exposure,
              "Factor before display (default for .png: 99.5th percentile to white)");
  verb.option("--stops", &arguments->stops, "That factor, so many stops brighter or darker",
              {.bounds = Bounds{-60.0, 60.0}});
  verb.option("--against", &arguments->against,
              "Session of the same capture: measures the error instead of bounding it",
              {.type = "SESSION"});
  verb.option("--frames", &arguments->frames,
              "So many pictures while the environment turns once about z: OUT-0000 ...",
              {.bounds = Bounds{1.0, 9999.0}, .excludes = "--against"});
  verb.footer(
      "Examples:\n"
      "  haarlight relight airplane.hlb --cubemap apartment.hdr --rotate 90 -o room.exr\n"
      "  haarlight relight airplane.hlb --cubemap apartment.hdr --frames 3 -o turn.png\n"
      "  haarlight relight airplane.hlb --light 528 --light 33=0.5 -o two.png");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_relight(*arguments, common, report);
  });
}

}  // namespace haarlight
