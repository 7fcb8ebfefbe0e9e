// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/surface_auto.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <iterator>
#include <span>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "render/film/film_settings_file.h"
#include "render/light/scene_lights.h"
#include "render/surface/direct_scene.h"
#include "render/surface/surface_layers.h"

namespace haarlight::apps {

namespace {

constexpr std::size_t kFewLights = 16;  // of which all may be asked

/// What of a scene the choice depends on.
struct SceneFacts {
  bool has_indirect_light = true;
  bool is_cut_short = false;  ///< by --bounces
  std::size_t n_lights = 0;
  bool is_any_met = true;  ///< some light, by a direction
  bool can_splat = true;   ///< a film with splats fits into memory
};

/// What auto chooses among: an integrator with all its ways that the scene can tell apart. The
/// first that suits is the one to take in doubt.
struct AutoRow {
  IntegratorKind kind;
  bool (*suits)(const SceneFacts& facts);  ///< unbiased, or of the bias beside
  double bias;  ///< what its page states at most, relative L2; 0: unbiased but for --bounces
  bool asks_all_lights;  ///< --lights all
  bool has_sampling;     ///< --sampling mis and light
};
constexpr auto kRows = std::to_array<AutoRow>({
    {.kind = IntegratorKind::direct,
     .suits = [](const SceneFacts& f) { return !f.has_indirect_light && !f.is_cut_short; },
     .bias = 0.0,
     .asks_all_lights = true,
     .has_sampling = true},
    {.kind = IntegratorKind::path,
     .suits = [](const SceneFacts& f) { return f.has_indirect_light || f.is_cut_short; },
     .bias = 0.0,
     .asks_all_lights = true,
     .has_sampling = true},
    {.kind = IntegratorKind::bidirectional,
     .suits = [](const SceneFacts& f) { return f.has_indirect_light && f.can_splat; },
     .bias = 0.0,
     .asks_all_lights = false,
     .has_sampling = false},
});

struct Candidate {
  IntegratorArguments integrator;
  double bias = 0.0;
  std::string name;  ///< as on the command line, what the scene cannot tell apart left out
};

SceneFacts facts_of(const AutoRequest& request, const render::Scene& scene,
                    const render::RayCaster& caster, const render::Environment* environment,
                    const render::Crop& crop) {
  const render::SceneLights lights(scene, environment, caster.scene_radius_mm(),
                                   render::LightChoice::uniform);
  return {.has_indirect_light = render::has_indirect_light(scene),
          .is_cut_short = request.integrator.most_bounces.has_value(),
          .n_lights = lights.size(),
          .is_any_met = lights.is_any_met(),
          .can_splat = 2 * render::Film::bytes_needed(
                               crop.width, crop.height,
                               render::surface_layers(request.has_features, true)) <=
                       request.memory_bytes};
}

std::vector<Candidate> candidates_of(const AutoRequest& request, const SceneFacts& facts) {
  std::vector<Candidate> candidates;
  for (const AutoRow& row : kRows) {
    if (!row.suits(facts) || (!row.has_sampling && request.integrator.given_sampling) ||
        (!row.asks_all_lights && request.integrator.given_lights == render::LightChoice::all)) {
      continue;
    }
    std::vector<render::LightChoice> choices{render::LightChoice::tree};
    if (facts.n_lights > 1) {
      choices.push_back(render::LightChoice::power);
      if (row.asks_all_lights && facts.n_lights <= kFewLights) {
        choices.push_back(render::LightChoice::all);
      }
    }
    if (request.integrator.given_lights) {
      choices.assign(1, *request.integrator.given_lights);
    }
    std::vector<render::DirectSampling> samplings{render::DirectSampling::mis};
    if (facts.is_any_met && row.has_sampling) {
      samplings.push_back(render::DirectSampling::light);
    }
    if (request.integrator.given_sampling) {
      samplings.assign(1, *request.integrator.given_sampling);
    }
    for (const render::DirectSampling sampling : samplings) {
      for (const render::LightChoice choice : choices) {
        Candidate candidate{.integrator = request.integrator, .bias = row.bias, .name = {}};
        candidate.integrator.kind = row.kind;
        candidate.integrator.lights = choice;
        candidate.integrator.sampling = sampling;
        candidate.name = std::string(to_string(row.kind));
        if (facts.n_lights > 1) {
          candidate.name += fmt::format(" --lights {}", to_string(choice));
        }
        if (facts.is_any_met && row.has_sampling) {
          candidate.name += fmt::format(" --sampling {}", to_string(sampling));
        }
        candidates.push_back(std::move(candidate));
      }
    }
  }
  return candidates;
}

/// The candidate by which a film was begun.
const Candidate& begun_by(std::span<const Candidate> candidates, const std::string& path) {
  const render::RenderSettings settings = render::read_film_settings(path);
  const auto value = [&settings](std::string_view name) -> std::string {
    const auto found = std::ranges::find(settings, name, [](const auto& s) { return s.first; });
    return found == settings.end() ? std::string() : found->second;
  };
  const std::string kind = value("integrator");
  const std::string lights = value("lights");
  const std::string sampling = value("sampling");
  const auto found = std::ranges::find_if(candidates, [&](const Candidate& candidate) {
    return to_string(candidate.integrator.kind) == kind &&
           to_string(candidate.integrator.lights) == lights &&
           to_string(candidate.integrator.sampling) == sampling;
  });
  if (found == candidates.end()) {
    throw Error(kind.empty() ? "the film is of another render: it does not say its integrator"
                             : fmt::format("the film was begun by --integrator {} --lights {} "
                                           "--sampling {}, which auto does not choose here",
                                           kind, lights, sampling),
                path, "name its integrator instead of auto, or another file");
  }
  return *found;
}

/// What asks the same lights, and finds light by paths from them, too.
std::optional<std::size_t> teller_of(const Candidate& candidate,
                                     std::span<const Candidate> candidates) {
  const auto found = std::ranges::find_if(candidates, [&](const Candidate& other) {
    return has_splats(other.integrator) &&
           other.integrator.lights == candidate.integrator.lights;
  });
  return found == candidates.end()
             ? std::nullopt
             : std::optional(static_cast<std::size_t>(found - candidates.begin()));
}

std::vector<render::PilotCandidate> pilot_candidates(std::span<const Candidate> candidates,
                                                     const AutoRequest& request,
                                                     const render::SceneFile& file,
                                                     const render::RayCaster& caster,
                                                     const render::Environment* environment,
                                                     const render::Crop& crop) {
  std::vector<render::PilotCandidate> asked;
  std::ranges::transform(
      candidates, std::back_inserter(asked), [&](const Candidate& candidate) {
        const bool tells = has_splats(candidate.integrator);
        return render::PilotCandidate{
            .name = candidate.name,
            .bias = candidate.bias,
            .layers = render::surface_layers(request.has_features, tells, tells),
            .told_by = tells ? std::nullopt : teller_of(candidate, candidates),
            .make = [&request, &file, &caster, &crop, environment, candidate,
                     tells](std::uint64_t seed) {
              render::PathOptions options =
                  path_options(candidate.integrator, file.film, crop, request.has_features);
              options.seed = seed;
              return make_integrator(candidate.integrator, file, caster, environment, options,
                                     {.crop = crop, .tells_of_path_tracing = tells});
            }};
      });
  return asked;
}

/// Beside the best of the others.
std::string reason_of(std::span<const Candidate> candidates, const render::PilotResult& found) {
  if (found.is_black) {
    return "the pilot found no light";
  }
  const double unmet = found.scores.front().unmet;
  if (unmet > 0.0 && found.scores[found.chosen].unmet == 0.0) {
    return fmt::format("{:.1f} % of the light is not met by paths from the camera alone",
                       100.0 * unmet);
  }
  const double chosen = found.scores[found.chosen].efficiency;
  std::optional<std::size_t> next;
  for (std::size_t i = 0; i < candidates.size(); ++i) {
    if (i != found.chosen && found.scores[i].patches > 0 &&
        (!next || found.scores[i].efficiency > found.scores[*next].efficiency)) {
      next = i;
    }
  }
  if (!next) {
    return "the only one for this scene";
  }
  const double ratio = chosen / found.scores[*next].efficiency;
  if (ratio < 1.0) {
    return fmt::format(
        "no other is better beyond the pilot's noise: {} times the efficiency of {}",
        fmt::format("{:.2g}", ratio), candidates[*next].name);
  }
  return fmt::format(
      "{:.2g} times the efficiency of {}{}", ratio, candidates[*next].name,
      found.scores[*next].is_told ? ", whose own samples hardly met part of the light" : "");
}

/// Why the prediction may be far off.
std::string doubt_of(const render::PilotScore& chosen) {
  if (chosen.is_told) {
    return "its own samples hardly met part of the light, which bidirectional ones found";
  }
  return chosen.largest_share > 0.1
             ? fmt::format(
                   "one pixel makes {:.0f} % of the variance that the pilot found; "
                   "there may be more of its kind",
                   100.0 * chosen.largest_share)
             : "few bright pixels make most of the variance";
}

std::string prediction_of(const AutoRequest& request, const render::PilotResult& found) {
  std::string text;
  if (found.for_error) {
    const render::PilotPrediction& prediction = *found.for_error;
    text += fmt::format("{:.3g} samples predicted for an error of {:g}", prediction.samples,
                        *request.max_error);
    if (std::isfinite(prediction.factor)) {
      text += fmt::format(" ({:.3g} to {:.3g})", prediction.samples / prediction.factor,
                          prediction.samples * prediction.factor);
    }
    text += fmt::format(", looked at after {}: {:.2g} s; ", prediction.end, prediction.seconds);
  }
  if (found.error_in_time) {
    text += fmt::format("an error of {:.2g} predicted after {:g} s; ", *found.error_in_time,
                        *request.seconds);
  }
  return text;
}

void report_pilot(std::span<const Candidate> candidates, const render::PilotResult& found,
                  const std::string& reason, Report& report) {
  std::string names;
  std::vector<double> efficiencies;
  const double chosen = found.scores[found.chosen].efficiency;
  for (std::size_t i = 0; i < candidates.size(); ++i) {
    names += (i == 0 ? "" : "; ") + candidates[i].name;
    efficiencies.push_back(found.scores[i].efficiency / chosen);
  }
  report.add_detail("auto_reason", reason);
  report.add_detail("pilot_candidates", names);
  report.add_detail("pilot_efficiencies", efficiencies);
  report.add_detail("pilot_doubtful", found.is_doubtful);
  report.add_detail("pilot_largest_share", found.scores[found.chosen].largest_share);
  report.add_detail("pilot_samples", static_cast<std::int64_t>(found.samples));
  report.add_detail("pilot_seconds", found.seconds);
  report.add_detail("pilot_cpu_seconds", found.cpu_seconds);
  if (found.for_error) {
    report.add_detail("predicted_samples", found.for_error->samples);
    report.add_detail("predicted_factor", found.for_error->factor);
    report.add_detail("predicted_seconds", found.for_error->seconds);
  }
  if (found.error_in_time) {
    report.add_detail("predicted_error", *found.error_in_time);
  }
}

void report_choice(const Candidate& candidate, Report& report) {
  report.add_achieved("integrator", std::string(to_string(candidate.integrator.kind)));
  report.add_achieved("lights", std::string(to_string(candidate.integrator.lights)));
  report.add_achieved("sampling", std::string(to_string(candidate.integrator.sampling)));
}

}  // namespace

void require_auto_words(const AutoRequest& request, bool is_part, bool explains) {
  const auto refuse = [](const char* what, const char* option, const char* hint) {
    throw Error(what, option, hint, ExitCode::usage);
  };
  if (request.integrator.kind != IntegratorKind::automatic) {
    return;
  }
  if (is_part) {
    refuse(
        "parts of a picture need the same integrator: auto chooses on each computer anew",
        "--integrator",
        "render a small picture first (--size), and name what auto chose there for all parts");
  }
  if (!request.max_error && !request.seconds) {
    refuse("auto chooses for an error or a time: none is given", "--integrator",
           "give --max-error E or --seconds T, or name an integrator");
  }
  if (explains) {
    refuse("--explain tells what path tracing leaves out", "--explain",
           "give --integrator path or direct");
  }
}

AutoChoice choose_integrator(const AutoRequest& request, const render::SceneFile& file,
                             const render::RayCaster& caster,
                             const render::Environment* environment, const render::Crop& crop,
                             Report& report) {
  const SceneFacts facts = facts_of(request, file.scene, caster, environment, crop);
  const std::vector<Candidate> candidates = candidates_of(request, facts);
  if (!request.film.empty() && std::filesystem::exists(request.film)) {
    const Candidate& begun = begun_by(candidates, request.film);
    fmt::print("auto: {}, as {} was begun\n", begun.name, request.film);
    report_choice(begun, report);
    return {.integrator = begun.integrator};
  }
  const std::vector<render::PilotCandidate> asked =
      pilot_candidates(candidates, request, file, caster, environment, crop);
  render::PilotOptions options{
      .width = crop.width, .height = crop.height, .seed = request.integrator.seed};
  options.relative_l2 = request.max_error.value_or(options.relative_l2);
  options.seconds = request.seconds.value_or(options.seconds);
  const render::PilotResult found = render::run_pilot(asked, options);
  const Candidate& chosen = candidates[found.chosen];
  const std::string reason = reason_of(candidates, found);
  fmt::print("auto: {}: {}; {}pilot {:.2g} s\n", chosen.name, reason,
             prediction_of(request, found), found.seconds);
  if (found.is_doubtful) {
    fmt::print("auto: the prediction is not to be trusted: {}\n",
               doubt_of(found.scores[found.chosen]));
  }
  report_choice(chosen, report);
  report_pilot(candidates, found, reason, report);
  return {.integrator = chosen.integrator,
          .for_error = found.for_error,
          .error_in_time = found.error_in_time,
          .seconds = found.seconds};
}

void tell_outcome(const AutoRequest& request, const AutoChoice& choice,
                  const render::RunResult& result, Report& report) {
  const double error = result.error.relative_l2;
  if (choice.for_error && std::isfinite(error)) {
    const double ratio = error / *request.max_error;
    const double needed = result.samples * ratio * ratio;
    report.add_achieved("needed_samples", needed);
    fmt::print("auto: {:.3g} samples predicted, {:.3g} needed\n", choice.for_error->samples,
               needed);
  }
  if (choice.error_in_time && std::isfinite(error)) {
    fmt::print("auto: an error of {:.2g} predicted, {:.2g} reached\n", *choice.error_in_time,
               error);
  }
}

}  // namespace haarlight::apps
