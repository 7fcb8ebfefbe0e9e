// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "apps/haarlight/options/develop_options.h"
#include "apps/haarlight/verb.h"
#include "relight/pipeline/shape/shape_pipeline.h"

/// @file
/// The command line of `haarlight shape`.

namespace haarlight::apps {

/// Which mesh files are written.
enum class MeshFiles { ply, obj, both, none };
inline constexpr auto kMeshFilesWords =
    std::to_array<std::string_view>({"ply", "obj", "both", "none"});
constexpr std::span<const std::string_view> words_of(MeshFiles) { return kMeshFilesWords; }

struct ShapeArguments {
  std::string input;
  std::string out;
  relight::ShapeMethod method = relight::ShapeMethod::automatic;
  relight::RobustLoss loss = relight::RobustLoss::tukey;
  relight::ShapeLight light = relight::ShapeLight::automatic;
  relight::Integrator integrate = relight::Integrator::poisson;
  MeshFiles mesh = MeshFiles::both;
  std::string mask = "found";  ///< found, none, or a picture
  std::string hull;            ///< kept shadow hull, or empty
  std::optional<Transfer> transfer;
  PlaneArguments plane;
  double keep = relight::LambertOptions{}.keep;
  double dark_fraction = relight::LambertOptions{}.dark_fraction;
  double max_tilt_deg = relight::SurfaceMeshOptions{}.max_tilt_deg;
  int max_rounds = relight::ShapeOptions{}.max_rounds;
  bool is_open_at_cuts = false;
  std::vector<double> preview = {0.5, 0.5, 1.0};
};

void add_shape_options(Command verb, ShapeArguments& arguments);

[[nodiscard]] relight::ShapePipelineOptions shape_options(const ShapeArguments& arguments,
                                                          const CommonOptions& common);

}  // namespace haarlight::apps
