// SPDX-License-Identifier: Apache-2.0
#include <filesystem>
#include <string>

#include <gtest/gtest.h>

#include "haarlight/session/light_file.h"
#include "relight/reflectance/fit/fit_check.h"
#include "relight/reflectance/fit/parameter_choice.h"

namespace haarlight::relight {
namespace {

namespace fs = std::filesystem;

/// Held-out PSNR of what the lights that are left choose, and of PTM's.
struct Held {
  double chosen = 0.0;
  double ptm = 0.0;
  int n_planes = 0;
};

Held held_out(const fs::path& folder) {
  const session::LightList list =
      session::read_light_file(folder / "dirs.lp", session::LightCoordinates::directions);
  std::vector<fs::path> pictures;
  std::vector<int> kept;
  std::vector<int> held;
  std::vector<Eigen::Vector3d> kept_lights;
  std::vector<Eigen::Vector3d> held_lights;
  for (std::size_t i = 0; i < list.lights.size(); ++i) {
    pictures.push_back(folder / list.lights[i].name);
    (i % 6 == 2 ? held : kept).push_back(static_cast<int>(i));
    (i % 6 == 2 ? held_lights : kept_lights).push_back(list.lights[i].coordinates.normalized());
  }
  const auto all = jpeg_rows(pictures);
  const auto kept_rows = selected_rows(*all, kept);
  const auto held_rows = selected_rows(*all, held);
  const LightSample sample = sample_lights(*kept_rows);
  const auto psnr_of = [&](const FormScore& score) {
    const FitResult result = fit_far(
        *kept_rows, make_far_fit(score.form, score.interpolation, kept_lights, sample, {}));
    return measure_fit(result.model, *held_rows, held_lights).mean_psnr_db();
  };
  Held found;
  for (const FormScore& score : score_forms(all_values<FitForm>(), kept_lights, sample, {})) {
    if (score.n_planes <= 27 && found.n_planes == 0) {
      found.n_planes = score.n_planes;
      found.chosen = psnr_of(score);
    }
    if (score.form == FitForm::ptm) {
      found.ptm = psnr_of(score);
    }
  }
  return found;
}

class RealCapture : public ::testing::TestWithParam<std::pair<const char*, double>> {};

TEST_P(RealCapture, TheChoiceReachesWhatOthersDo) {
  const auto& [item, psnr] = GetParam();
  const fs::path folder = fs::path(HAARLIGHT_SOURCE_DIR) / "../shared/data/rti_real" / item;
  if (!fs::exists(folder)) {
    GTEST_SKIP() << folder << " is not here: the capture is not part of the repository";
  }
  const Held found = held_out(folder);
  EXPECT_LE(found.n_planes, 27);
  EXPECT_GE(found.chosen, psnr);
  EXPECT_GT(found.chosen, found.ptm + 2.0);
  std::printf("%s: chosen %.2f dB, ptm %.2f dB\n", item, found.chosen, found.ptm);
}

INSTANTIATE_TEST_SUITE_P(Items, RealCapture,
                         ::testing::Values(std::pair{"item1", 37.5}, std::pair{"item2", 38.2},
                                           std::pair{"item3", 33.3}, std::pair{"item5", 34.0}),
                         [](const auto& each) { return std::string(each.param.first); });

}  // namespace
}  // namespace haarlight::relight
