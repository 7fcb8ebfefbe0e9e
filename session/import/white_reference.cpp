// SPDX-License-Identifier: Apache-2.0
#include "haarlight/session/import/white_reference.h"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "core/order_statistics.h"
#include "haarlight/core/error.h"

namespace haarlight::session {

namespace {

/// Standard deviation if normally distributed, robust against a few lights.
double relative_scatter(const std::vector<double>& values, double median) {
  std::vector<double> distances;
  distances.reserve(values.size());
  for (const double value : values) {
    distances.push_back(std::abs(value - median));
  }
  return kSigmaPerMad * haarlight::median(distances) / median;
}

double least_of(const PatchSample& patch) {
  return *std::min_element(patch.mean.begin(), patch.mean.end());
}

/// The usable lights; the others are counted by reason.
std::vector<std::size_t> usable_lights(const std::vector<PatchSample>& patches,
                                       bool are_integers, WhiteReference& white) {
  double brightest = 0.0;
  for (const PatchSample& patch : patches) {
    brightest = patch.is_clipped ? brightest : std::max(brightest, least_of(patch));
  }
  const double least = kLeastPatchFraction * (are_integers ? 1.0 : brightest);
  std::vector<std::size_t> used;
  for (std::size_t k = 0; k < patches.size(); ++k) {
    if (patches[k].is_clipped) {
      ++white.n_clipped;
    } else if (least_of(patches[k]) > 0.0 && least_of(patches[k]) >= least) {
      used.push_back(k);
    } else {
      ++white.n_dark;
    }
  }
  white.n_used = static_cast<int>(used.size());
  return used;
}

void find_furthest(const std::vector<std::vector<double>>& ratios,
                   const std::vector<double>& medians, const std::vector<std::size_t>& used,
                   WhiteReference& white) {
  for (std::size_t c = 0; c < ratios.size(); ++c) {
    for (std::size_t i = 0; i < used.size(); ++i) {
      const double distance = std::abs(ratios[c][i] / medians[c] - 1.0);
      if (distance > white.distance) {
        white.distance = distance;
        white.furthest = static_cast<int>(used[i]);
      }
    }
  }
}

/// The factor on top of the gains that scales the patch to its reflectance.
void scale_to_reflectance(const std::vector<PatchSample>& patches,
                          const std::vector<SessionLight>& lights,
                          const std::vector<std::size_t>& used, const WhiteTask& task,
                          WhiteReference& white) {
  constexpr double kLeastCosine = 0.05;  // 3 degrees above the patch
  std::vector<double> factors;
  for (const std::size_t k : used) {
    const double cosine = lights[k].coordinates.normalized().z();
    double value = 0.0;
    for (std::size_t c = 0; c < white.gains.size(); ++c) {
      value += white.gains[c] * patches[k].mean[c] / static_cast<double>(white.gains.size());
    }
    if (cosine >= kLeastCosine) {
      factors.push_back(*task.reflectance * cosine * lights[k].relative_power / value);
    }
  }
  if (factors.empty()) {
    throw Error("every light that can be used stands less than 3 degrees above the patch",
                task.where,
                "leave the reflectance out: the patch then says what is neutral alone");
  }
  const double factor = median(factors);
  white.reflectance_scatter = relative_scatter(factors, factor);
  for (double& gain : white.gains) {
    gain *= factor;
  }
}

}  // namespace

PatchSample sample_patch(const Image<float>& patch, double clip_from) {
  PatchSample sample;
  sample.mean.assign(static_cast<std::size_t>(patch.channels()), 0.0);
  const std::size_t n = patch.pixels().size();
  for (std::size_t i = 0; i < n; ++i) {
    const double value = patch.pixels()[i];
    sample.mean[i % sample.mean.size()] += value;
    sample.is_clipped = sample.is_clipped || value >= clip_from;
  }
  for (double& mean : sample.mean) {
    mean /= 1.0 * patch.width() * patch.height();
  }
  return sample;
}

WhiteReference find_white_reference(const std::vector<PatchSample>& patches,
                                    const std::vector<SessionLight>& lights,
                                    const WhiteTask& task) {
  HAARLIGHT_EXPECTS(!patches.empty() && patches.size() == lights.size(), "one patch per light");
  const std::size_t n_channels = patches.front().mean.size();
  if (n_channels == 1 && !task.reflectance) {
    throw Error("the pictures are grey: nothing can be made neutral", task.where,
                "leave --white out, or give the patch's reflectance too: --white X,Y,W,H=R");
  }
  WhiteReference white;
  const std::vector<std::size_t> used = usable_lights(patches, task.are_integers, white);
  if (used.empty()) {
    throw Error(fmt::format("no light can be used: the patch is clipped under {} and dark "
                            "under {} of {}",
                            white.n_clipped, white.n_dark, patches.size()),
                task.where,
                "name a patch that is lit and nowhere at the end of the range; a white card "
                "that is clipped needs shorter exposures");
  }
  const std::size_t green = n_channels == 3 ? 1 : 0;
  std::vector<std::vector<double>> ratios(n_channels);
  for (std::size_t c = 0; c < n_channels; ++c) {
    for (const std::size_t k : used) {
      ratios[c].push_back(patches[k].mean[green] / patches[k].mean[c]);
    }
    white.gains.push_back(median(ratios[c]));
    white.scatter.push_back(relative_scatter(ratios[c], white.gains[c]));
  }
  find_furthest(ratios, white.gains, used, white);
  const double least = *std::min_element(white.gains.begin(), white.gains.end());
  for (double& gain : white.gains) {
    gain /= least;
  }
  if (task.reflectance) {
    scale_to_reflectance(patches, lights, used, task, white);
  }
  return white;
}

std::string words(const WhiteReference& white, std::size_t n_lights) {
  std::string text = white.gains.size() == 3
                         ? fmt::format("gains R {:.4f}, G {:.4f}, B {:.4f}", white.gains[0],
                                       white.gains[1], white.gains[2])
                         : fmt::format("gain {:.4f}", white.gains[0]);
  text += fmt::format(", from {} of {} lights", white.n_used, n_lights);
  if (white.n_clipped + white.n_dark > 0) {
    text += fmt::format(" (left out: {} clipped, {} dark)", white.n_clipped, white.n_dark);
  }
  if (white.gains.size() == 3) {
    text += fmt::format("; over the lights red scatters by {:.2f} %, blue by {:.2f} % of green",
                        100.0 * white.scatter[0], 100.0 * white.scatter[2]);
  }
  if (white.reflectance_scatter) {
    text += fmt::format("; its reflectance by {:.1f} %", 100.0 * *white.reflectance_scatter);
  }
  return text;
}

}  // namespace haarlight::session
