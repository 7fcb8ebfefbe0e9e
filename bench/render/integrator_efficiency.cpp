// SPDX-License-Identifier: Apache-2.0
/// @file
/// Path tracing and bidirectional path tracing of one scene: CPU seconds, error, and the efficiency
/// 1/(RMSE^2 CPU s) of each.
///
///     integrator_efficiency SCENE.toml [SIZE [SEEDS [SAMPLES_OF_PATHS SAMPLES_OF_BIDIRECTIONAL]]]
///
/// No reference is needed: neither has a bias, so that the mean squared error of a picture is what pictures
/// of other seeds differ by. Left out: pixels above 1.5, and their neighbours within two: a light and
/// its rim. One thread, rendering alone.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <ctime>
#include <memory>
#include <vector>

#include <fmt/format.h>

#include "core/parallel.h"
#include "haarlight/core/image.h"
#include "haarlight/render/rays/ray_caster.h"
#include "haarlight/render/scene/scene.h"
#include "render/surface/bidirectional_integrator.h"
#include "render/surface/path_integrator.h"
#include "render/surface/surface_layers.h"

namespace haarlight::render {
namespace {

constexpr float kMost = 1.5F;
constexpr int kRim = 2;

struct Pictures {
  std::vector<Image<float>> of_seeds;
  double cpu_seconds = 0.0;  ///< of each
};

Pictures pictures_of(const SceneFile& file, const RayCaster& caster, bool is_bidirectional,
                     int n_seeds, std::uint32_t samples) {
  const Camera camera(file.camera, file.optics);
  Pictures pictures;
  for (int i = 0; i < n_seeds; ++i) {
    const auto seed = static_cast<std::uint64_t>(i);
    std::unique_ptr<TileRenderer> integrator;
    if (is_bidirectional) {
      integrator = std::make_unique<BidirectionalIntegrator>(
          file.scene, caster, nullptr, camera,
          BidirectionalOptions{
              .seed = seed, .width = file.camera.width, .height = file.camera.height});
    } else {
      integrator = std::make_unique<PathIntegrator>(file.scene, caster, nullptr, camera,
                                                    PathOptions{.seed = seed});
    }
    Film film(file.camera.width, file.camera.height, surface_layers(false, is_bidirectional));
    const std::clock_t begun = std::clock();
    static_cast<void>(run(*integrator, {.samples = samples}, film));
    pictures.cpu_seconds +=
        static_cast<double>(std::clock() - begun) / CLOCKS_PER_SEC / n_seeds;
    pictures.of_seeds.push_back(film.mean(0));
  }
  return pictures;
}

/// By pixel, whether it counts.
std::vector<char> shown(const std::vector<Image<float>>& pictures) {
  const int width = pictures.front().width();
  const int height = pictures.front().height();
  std::vector<char> is_shown(static_cast<std::size_t>(width) * static_cast<std::size_t>(height),
                             1);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      float most = 0.0F;
      for (int c = 0; c < 3; ++c) {
        float sum = 0.0F;
        for (const Image<float>& picture : pictures) {
          sum += picture(y, x, c);
        }
        most = std::max(most, sum / static_cast<float>(pictures.size()));
      }
      if (!(most > kMost)) {
        continue;
      }
      for (int v = std::max(0, y - kRim); v <= std::min(height - 1, y + kRim); ++v) {
        for (int u = std::max(0, x - kRim); u <= std::min(width - 1, x + kRim); ++u) {
          is_shown[static_cast<std::size_t>(v * width + u)] = 0;
        }
      }
    }
  }
  return is_shown;
}

/// @return the efficiency
double tell(const char* name, const Pictures& pictures, const std::vector<char>& is_shown) {
  const auto n = static_cast<double>(pictures.of_seeds.size());
  double squared = 0.0;
  double mean = 0.0;
  double count = 0.0;
  for (std::size_t i = 0; i < 3 * is_shown.size(); ++i) {
    if (is_shown[i / 3] == 0) {
      continue;
    }
    double sum = 0.0;
    double squares = 0.0;
    for (const Image<float>& picture : pictures.of_seeds) {
      const double value = picture.pixels()[i];
      sum += value;
      squares += value * value;
    }
    squared += (squares - sum * sum / n) / (n - 1.0);
    mean += sum / n;
    count += 1.0;
  }
  squared /= count;
  const double efficiency = 1.0 / (squared * pictures.cpu_seconds);
  fmt::print("{:14} {:8.3f} CPU s  RMSE {:.5f}  mean {:.6f}  efficiency {:.4g}\n", name,
             pictures.cpu_seconds, std::sqrt(squared), mean / count, efficiency);
  return efficiency;
}

}  // namespace
}  // namespace haarlight::render

int main(int argc, char** argv) {
  using namespace haarlight::render;
  const auto number = [&](int i, int otherwise) {
    return argc > i ? std::atoi(argv[i]) : otherwise;
  };
  if (argc < 2) {
    fmt::print(stderr, "integrator_efficiency SCENE.toml [SIZE [SEEDS [SAMPLES SAMPLES]]]\n");
    return 2;
  }
  const int size = number(2, 128);
  const int n_seeds = std::max(2, number(3, 6));
  const haarlight::ThreadLimit one(1);
  SceneFile file = read_scene(argv[1]);
  file.camera = resized(file.camera, size, size);
  const RayCaster caster(file.scene);
  const Pictures path =
      pictures_of(file, caster, false, n_seeds, static_cast<std::uint32_t>(number(4, 32)));
  const Pictures both =
      pictures_of(file, caster, true, n_seeds, static_cast<std::uint32_t>(number(5, 16)));
  const std::vector<char> is_shown = shown(both.of_seeds);
  const double by_path = tell("path", path, is_shown);
  const double by_both = tell("bidirectional", both, is_shown);
  fmt::print("bidirectional / path: {:.3g}\n", by_both / by_path);
  return 0;
}
