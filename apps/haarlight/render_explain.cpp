// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/render_explain.h"

#include <algorithm>
#include <array>
#include <ctime>
#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "render/film/film.h"
#include "render/surface/path_terms.h"
#include "render/surface/surface_layers.h"

namespace haarlight::apps {

namespace {

constexpr std::size_t kMostTiles = 12;
constexpr int kRounds = 7;
constexpr double kLeastSeconds = 0.05;  // of a round, so that the clock's steps do not show

struct TermWords {
  render::PathTerm term;
  std::string_view what;
  std::string_view why_not;
};
constexpr auto kTermWords = std::to_array<TermWords>({
    {render::PathTerm::self_rays, "rays between surfaces",
     "a single convex body: no front sees a surface"},
    {render::PathTerm::met_lights, "last directions, towards lights",
     "no direction can meet a light"},
    {render::PathTerm::light_choice, "a choice among lights", "one light, or all are asked"},
    {render::PathTerm::lobe_choice, "a choice among lobes", "every material has one"},
    {render::PathTerm::lens_points, "points of the lens", "a camera without a lens"},
    {render::PathTerm::feature_channels, "albedo, normal, depth",
     "kept in an .exr or a film alone"},
});

double cpu_seconds() { return static_cast<double>(std::clock()) / CLOCKS_PER_SEC; }

/// Some tiles of the picture, rendered again and again.
class Pilot {
 public:
  Pilot(int width, int height, bool has_features,
        std::unique_ptr<render::PathIntegrator> integrator)
      : integrator_(std::move(integrator)),
        film_(width, height, render::surface_layers(has_features)) {}

  [[nodiscard]] const render::PathIntegrator& integrator() const { return *integrator_; }

  /// CPU seconds of so many samples per pixel.
  double run(std::uint32_t samples) const {
    const std::size_t step = std::max<std::size_t>(1, film_.n_tiles() / kMostTiles);
    const double start = cpu_seconds();
    for (std::size_t i = step / 2; i < film_.n_tiles(); i += step) {
      render::FilmTile tile = film_.take(i);
      integrator_->render_tile({.first = 0, .end = samples}, tile);
    }
    return cpu_seconds() - start;
  }

 private:
  std::unique_ptr<render::PathIntegrator> integrator_;
  render::Film film_;
};

/// The median of the rounds, and half the distance of their quartiles: machines are noisy.
struct Measured {
  double median = 0.0;
  double spread = 0.0;
};
Measured measured(std::vector<double> rounds) {
  std::ranges::sort(rounds);
  const std::size_t n = rounds.size();
  return {.median = rounds[n / 2], .spread = 0.5 * (rounds[n - 1 - n / 4] - rounds[n / 4])};
}

}  // namespace

void explain_terms(const render::SceneFile& file, int width, int height,
                   const render::RayCaster& caster, const render::Environment* environment,
                   const render::PathOptions& options, Report& report) {
  const auto make_pilot = [&](const render::PathOptions& pilot_options) {
    return std::make_unique<Pilot>(
        width, height, pilot_options.has_features,
        std::make_unique<render::PathIntegrator>(file.scene, caster, environment,
                                                 render::Camera(file.camera, file.optics),
                                                 pilot_options));
  };
  const std::unique_ptr<Pilot> plain = make_pilot(options);
  const render::PathTerms needed = plain->integrator().terms();
  std::vector<std::unique_ptr<Pilot>> others;  // by kTermWords; none where the term is needed
  for (const TermWords& words : kTermWords) {
    others.emplace_back();
    if (!needed.has(words.term)) {
      render::PathOptions with = options;
      with.also.add(words.term);
      with.has_features =
          options.has_features || words.term == render::PathTerm::feature_channels;
      others.back() = make_pilot(with);
    }
  }
  std::uint32_t samples = 1;
  while (plain->run(samples) < kLeastSeconds && samples < 1024) {
    samples *= 2;
  }
  std::vector<std::vector<double>> ratios(kTermWords.size());
  for (int round = 0; round < kRounds; ++round) {
    const double without = plain->run(samples);
    for (std::size_t i = 0; i < others.size(); ++i) {
      if (others[i] != nullptr) {
        ratios[i].push_back(others[i]->run(samples) / without);
      }
    }
  }
  fmt::print("{:34} {:9} {}\n", "what this scene requires", "", "cost of what is left out");
  for (std::size_t i = 0; i < kTermWords.size(); ++i) {
    const TermWords& words = kTermWords.at(i);
    if (others[i] == nullptr) {
      fmt::print("{:34} needed\n", words.what);
      continue;
    }
    const auto [ratio, spread] = measured(ratios[i]);
    const double cost = ratio - 1.0;
    fmt::print("{:34} left out  {:+.0f} +- {:.0f} % of the time: {}\n", words.what,
               100.0 * cost, 100.0 * spread, words.why_not);
    report.add_detail(fmt::format("cost_of_{}", to_string(words.term)), cost);
  }
}

}  // namespace haarlight::apps
