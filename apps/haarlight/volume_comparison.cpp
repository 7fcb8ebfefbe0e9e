// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/volume_comparison.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include <fmt/format.h>

#include "haarlight/core/picture/image_io.h"
#include "render/loop/tile_renderer.h"
#include "render/volume/volume_ray_caster.h"

namespace haarlight::apps {

Image<float> difference_of(std::span<const double> picture, std::span<const double> exact,
                           int width, int height) {
  Image<float> difference(height, width, 3);
  const std::span<float> values = difference.pixels();
  for (std::size_t i = 0; i < values.size(); ++i) {
    const std::size_t from = i / 3 * kVolumeChannels + i % 3;
    values[i] = static_cast<float>(std::abs(picture[from] - exact[from]));
  }
  return difference;
}

void compare_with_exact(const render::VolumeScene& scene, const render::Film& film,
                        const std::string& picture, ProgressStyle progress, double seconds,
                        Report& report) {
  const render::VolumeRayCaster caster(scene, {});
  render::Film exact(scene.camera.width, scene.camera.height,
                     render::VolumeRayCaster::layers());
  render::RunOptions run;
  run.samples = 1;
  run.progress = progress;
  const double exact_seconds = render::run(caster, run, exact).seconds;
  const std::vector<double> values = doubles_of(film);
  const std::vector<double> truth = doubles_of(exact);
  const VolumeErrors errors = compare_pictures(values, truth, lights_behind(scene));
  const Image<float> off = difference_of(values, truth, film.width(), film.height());
  const float largest = *std::ranges::max_element(off.pixels());
  write_image(picture, off.view(), largest > 0.0F ? 1.0 / largest : 1.0);
  report.add_detail("pixels_compared", errors.n_compared);
  report.add_detail("exact_seconds", exact_seconds);
  for (std::size_t k = 0; k < errors.channels.size(); ++k) {
    const ChannelErrors& of = errors.channels.at(k);
    const std::string_view name = VolumeErrors::kNames.at(k);
    report.add_achieved(fmt::format("mean_error_{}", name), of.mean);
    report.add_achieved(fmt::format("error_at_99_percent_{}", name), of.at_99);
    report.add_achieved(fmt::format("worst_error_{}", name), of.worst);
    fmt::print(
        "beside the exact picture, {}: off by {:.2g} in the mean, {:.2g} at 99 %, {:.2g} at "
        "worst\n",
        name, of.mean, of.at_99, of.worst);
  }
  fmt::print("it took {:.3f} s, the exact one {:.3f} s\n", seconds, exact_seconds);
}

}  // namespace haarlight::apps
