/// @file
/// `haarlight relight BASIS --cubemap ENV -o OUT`: a picture under an environment, or under
/// lights named one by one.

#include "relight/basis/relight.h"

#include <chrono>
#include <optional>

#include <fmt/format.h>

#include "apps/haarlight/display_exposure.h"
#include "apps/haarlight/light_options.h"
#include "apps/haarlight/verb.h"
#include "core/files.h"
#include "core/image_io.h"
#include "core/log.h"
#include "core/rig.h"
#include "core/tolerance.h"
#include "relight/basis/compress_session.h"
#include "relight/basis/weight_list.h"
#include "relight/light/light_weights.h"
#include "session/develop.h"
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
  std::string against;
};

/// Directions of the lights of a capture without a rig.
std::vector<Eigen::Vector3d> light_directions(const BasisHeader& header) {
  std::vector<Eigen::Vector3d> directions;
  for (const BasisLight& light : header.lights) {
    directions.push_back(light.place.normalized());
  }
  return directions;
}

LightWeights environment_weights(const RelightArguments& arguments, const BasisHeader& header,
                                 Report& report) {
  const Environment environment = read_environment(arguments.light, report);
  const EnvironmentWeights found =
      header.rig_toml.empty()
          ? voronoi_weights(environment, light_directions(header))
          : rig_weights(environment, parse_rig(header.rig_toml, arguments.basis + " (rig)"));
  report.add_reached("missing_share", found.missing_share);
  report.add_reached("energy_conservation_error", found.conservation_error);
  if (found.missing_share > 1e-6) {
    fmt::print("  {:.1f} % of the environment's light comes from where the rig has no lights\n",
               100.0 * found.missing_share);
  }
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
  const Image<float> truth = relight_stack(LightStackSource(stack), weights);
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

ExitCode run_relight(const RelightArguments& arguments, const CommonOptions& common,
                     Report& report) {
  report.add_input(arguments.basis);
  require_picture_name(arguments.output);
  require_absent(arguments.output, common.force);
  const BasisFile basis = BasisFile::open(arguments.basis);
  const LightWeights weights = read_weights(arguments, basis.header(), report);
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
  const auto start = std::chrono::steady_clock::now();
  const RelitPicture relit = relight(basis, weights, options);
  const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - start;
  report.add_reached("relative_l2_bound", relit.bound.relative_l2);
  report.add_reached("terms", std::int64_t{relit.terms});
  report.add_detail("terms_all", std::int64_t{relit.terms_all});
  report.add_detail("relight_seconds", seconds.count());
  report.add_detail("bytes_read", static_cast<std::int64_t>(relit.bytes_read));
  fmt::print("{}: {} of {} terms, relative error at most {:.3g}, {:.1f} ms\n", arguments.output,
             relit.terms, relit.terms_all, relit.bound.relative_l2, 1e3 * seconds.count());
  const bool is_display = std::filesystem::path(arguments.output).extension() == ".png";
  double exposure = arguments.exposure.value_or(1.0);
  if (is_display && !arguments.exposure) {
    exposure = display_exposure({relit.picture.pixels().begin(), relit.picture.pixels().end()},
                                kDisplayShare);
    fmt::print("  exposure {:.6g} for display\n", exposure);
  }
  report.add_detail("exposure", exposure);
  if (!arguments.against.empty()) {
    compare_with_session(arguments, weights, common, relit.picture, report);
  }
  write_image(arguments.output, relit.picture.view(), exposure);
  report.set_bytes(std::filesystem::file_size(arguments.output));
  if (options.max_error && relit.bound.relative_l2 > *options.max_error) {
    log_warning(
        fmt::format("an error of {:.3g} cannot be promised from this file: its own error "
                    "allows {:.3g}; compress with a smaller --max-error",
                    *options.max_error, relit.bound.relative_l2));
    return ExitCode::target_missed;
  }
  return ExitCode::done;
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
  verb.option("--against", &arguments->against,
              "Session of the same capture: measures the error instead of bounding it",
              {.type = "SESSION"});
  verb.footer(
      "Examples:\n"
      "  haarlight relight airplane.hlb --cubemap apartment.hdr --rotate 90 -o room.exr\n"
      "  haarlight relight airplane.hlb --light 528 --light 33=0.5 -o two.png");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_relight(*arguments, common, report);
  });
}

}  // namespace haarlight
