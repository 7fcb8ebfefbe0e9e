// SPDX-License-Identifier: Apache-2.0
#include "apps/viewer/volume_views.h"

#include <algorithm>
#include <chrono>
#include <utility>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "render/loop/tile_renderer.h"

namespace haarlight::apps {

namespace {

using render::VolumeRayCaster;

std::string reason_for_no_preview(const render::VolumeScene& scene) {
  if (!scene.contours.empty()) {
    return "previews draw no contours";
  }
  return scene.surfaces ? "previews do not end at surfaces" : "";
}

std::array<int, 2> shrunk(const std::array<int, 2>& size, int shrink) {
  return {std::max(1, size[0] / shrink), std::max(1, size[1] / shrink)};
}

/// The pixel of `image` in the middle of each of fewer.
Image<float> sampled(const Image<float>& image, int width, int height) {
  Image<float> fewer(height, width, image.channels());
  const auto nearest = [](int i, int n, int of) {
    return static_cast<int>((static_cast<std::int64_t>(2 * i + 1) * of) /
                            (2 * std::int64_t{n}));
  };
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      for (int c = 0; c < image.channels(); ++c) {
        fewer(y, x, c) =
            image(nearest(y, height, image.height()), nearest(x, width, image.width()), c);
      }
    }
  }
  return fewer;
}

double share_of(const render::Film& film) {
  std::size_t n = 0;
  for (std::size_t i = 0; i < film.n_tiles(); ++i) {
    n += film.samples_of(i) > 0 ? 1 : 0;
  }
  return static_cast<double>(n) / static_cast<double>(film.n_tiles());
}

}  // namespace

VolumeViews::VolumeViews(render::VolumeScene scene, VolumeSceneWords words,
                         std::uint64_t memory_bytes)
    : words_(std::move(words)),
      no_preview_(reason_for_no_preview(scene)),
      optics_(scene.optics),
      scene_(std::move(scene)),
      background_(scene_.background),
      surfaces_(scene_.surfaces) {
  constexpr int kSide = 1024;
  constexpr std::uint64_t kPixels = std::uint64_t{kSide} * kSide;
  constexpr std::uint64_t kMega = 1'000'000;
  const std::uint64_t of_mesh =
      VolumeRayCaster::bytes_needed(scene_) +
      render::ProjectedTetrahedra::bytes_needed(scene_, render::PreviewOrder::centroid);
  // Each client's two films, the one being drawn, and numbers of both to compare.
  const std::uint64_t n_films = 2 * kMostClients + 4;
  const std::uint64_t per_mega_pixel =
      n_films * render::Film::bytes_needed(kSide, kSide, VolumeRayCaster::layers());
  const std::uint64_t left = memory_bytes > of_mesh ? memory_bytes - of_mesh : 0;
  most_pixels_ =
      std::min(kMostPixels, static_cast<std::int64_t>(left / (per_mega_pixel / kPixels + 1)));
  const std::int64_t wanted = std::int64_t{words_.look.size[0]} * words_.look.size[1];
  if (wanted > most_pixels_) {
    throw Error(
        fmt::format("{} cells and {} x {} pixels: the page has room for {} pixels, with the "
                    "{} MB of --memory",
                    scene_.mesh.n_cells(), words_.look.size[0], words_.look.size[1],
                    most_pixels_, memory_bytes / kMega),
        scene_.mesh_file.string(),
        fmt::format("give the [camera] a smaller size, of at most {} pixels, or more "
                    "--memory",
                    kMostPixels),
        ExitCode::usage);
  }
}

void VolumeViews::require(const VolumeLook& look) const {
  if (std::int64_t{look.size[0]} * look.size[1] > most_pixels_) {
    throw Error(fmt::format("{} x {} pixels", look.size[0], look.size[1]), "size",
                fmt::format("ask for at most {} pixels", most_pixels_));
  }
  static_cast<void>(camera_of(look, look.size, optics_));
}

std::uint64_t VolumeViews::want(const std::string& client, VolumeLook look) {
  require(look);
  const std::lock_guard lock(mutex_);
  const auto found = std::ranges::find(clients_, client, &Client::name);
  if (found != clients_.end()) {
    clients_.splice(clients_.begin(), clients_, found);
  } else {
    clients_.emplace_front().name = client;
    if (clients_.size() > kMostClients) {
      clients_.pop_back();
    }
  }
  Client& now = clients_.front();
  now = {.name = client, .view = ++n_views_, .look = std::move(look)};
  return now.view;
}

bool VolumeViews::is_newest(const std::string& client, std::uint64_t view) {
  const std::lock_guard lock(mutex_);
  return find_view(client, view) != nullptr;
}

VolumeViews::Client* VolumeViews::find_view(const std::string& client, std::uint64_t view) {
  const auto found = std::ranges::find_if(
      clients_, [&](const Client& one) { return one.name == client && one.view == view; });
  return found == clients_.end() ? nullptr : &*found;
}

void VolumeViews::apply(const VolumeLook& look, int shrink) {
  if (applied_ == look && applied_shrink_ == shrink) {
    return;
  }
  caster_.reset();
  if (!applied_ || applied_->density != look.density || applied_->colour != look.colour) {
    mesh_.reset();
    set_functions(look, scene_);
  }
  applied_.reset();  // until all of it has succeeded
  const std::array<int, 2> size = shrunk(look.size, shrink);
  const render::CameraTable table = camera_of(look, size, optics_);
  scene_.camera = table.camera;
  scene_.optics = table.optics;
  sample_backdrop(look, size);
  applied_ = look;
  applied_shrink_ = shrink;
}

void VolumeViews::sample_backdrop(const VolumeLook& look, const std::array<int, 2>& size) {
  render::Background& background = scene_.background;
  const bool is_picture = background.kind == render::BackgroundKind::picture;
  if (!is_picture && !surfaces_) {
    return;
  }
  if (applied_size_ == size) {
    return;
  }
  const Image<float>& whole = surfaces_ ? surfaces_->light : background_.picture;
  if (whole.width() != look.size[0] || whole.height() != look.size[1]) {
    throw Error(
        fmt::format("the picture behind the medium has {} x {} pixels, and the view {} x {}",
                    whole.width(), whole.height(), look.size[0], look.size[1]),
        "size", "ask for a view of the picture's size");
  }
  if (is_picture) {
    background.picture = sampled(background_.picture, size[0], size[1]);
  }
  if (surfaces_) {
    scene_.surfaces->light = sampled(surfaces_->light, size[0], size[1]);
    scene_.surfaces->depth = sampled(surfaces_->depth, size[0], size[1]);
  }
  applied_size_ = size;
}

std::optional<DrawnVolume> VolumeViews::draw(const std::string& client, std::uint64_t view,
                                             const VolumePictureRequest& request) {
  VolumeLook look;
  {
    const std::lock_guard lock(mutex_);
    const Client* of = find_view(client, view);
    if (of == nullptr) {
      return std::nullopt;
    }
    look = of->look;
  }
  if (request.kind == VolumePictureKind::preview && !no_preview_.empty()) {
    throw Error(no_preview_, "preview",
                "ask for exact pictures, small ones while something moves");
  }
  apply(look, request.shrink);
  return request.kind == VolumePictureKind::preview ? draw_preview(client, view, request)
                                                    : draw_exact(client, view, request.shrink);
}

std::optional<DrawnVolume> VolumeViews::draw_preview(const std::string& client,
                                                     std::uint64_t view,
                                                     const VolumePictureRequest& request) {
  DrawnVolume drawn;
  if (!mesh_) {
    mesh_ = std::make_unique<const render::PreviewMesh>(scene_);
    drawn.seconds += mesh_->prepare_seconds;
  }
  const render::ProjectedTetrahedra preview(*mesh_, {.method = request.method});
  const auto film = std::make_shared<render::Film>(scene_.camera.width, scene_.camera.height,
                                                   VolumeRayCaster::layers());
  render::RunOptions run;
  run.samples = 1;
  run.is_stopped = [&] { return !is_newest(client, view); };
  const render::RunResult result = render::run(preview, run, *film);
  if (result.end == render::RunEnd::stopped) {
    return std::nullopt;
  }
  drawn.seconds += preview.view_seconds() + result.seconds;
  drawn.film = film;
  if (request.shrink == 1) {
    const std::lock_guard lock(mutex_);
    Client* const of = find_view(client, view);
    if (of == nullptr) {
      return std::nullopt;
    }
    of->preview = film;
    of->method = request.method;
    of->preview_errors.reset();
  }
  return drawn;
}

std::optional<DrawnVolume> VolumeViews::draw_exact(const std::string& client,
                                                   std::uint64_t view, int shrink) {
  std::shared_ptr<render::Film> film;
  {
    const std::lock_guard lock(mutex_);
    Client* const of = find_view(client, view);
    if (of == nullptr) {
      return std::nullopt;
    }
    if (!of->exact || of->shrink != shrink) {
      of->exact = std::make_shared<render::Film>(scene_.camera.width, scene_.camera.height,
                                                 VolumeRayCaster::layers());
      of->shrink = shrink;
      of->seconds = 0.0;
      of->preview_errors.reset();
    }
    film = of->exact;
  }
  double seconds = 0.0;
  if (share_of(*film) < 1.0) {
    if (!caster_) {
      const auto begin = std::chrono::steady_clock::now();
      if (!connected_) {
        connected_ = std::make_shared<const render::CellFaces>(
            render::connect_cells(scene_.mesh, scene_.mesh_file.string()));
      }
      caster_ = std::make_unique<const VolumeRayCaster>(
          scene_, render::VolumeOptions{.connected = connected_});
      seconds +=
          std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    }
    render::RunOptions run;
    run.samples = 1;
    run.least_samples = 0;
    run.seconds = kSliceSeconds;
    run.is_stopped = [&] { return !is_newest(client, view); };
    const render::RunResult result = render::run(*caster_, run, *film);
    caster_->require_no_overlap();
    if (result.end == render::RunEnd::stopped) {
      return std::nullopt;
    }
    seconds += result.seconds;
  }
  DrawnVolume drawn{.film = film, .share = share_of(*film)};
  std::shared_ptr<const render::Film> preview;
  {
    const std::lock_guard lock(mutex_);
    Client* const of = find_view(client, view);
    if (of == nullptr) {
      return std::nullopt;
    }
    of->seconds += seconds;
    drawn.seconds = of->seconds;
    drawn.preview_errors = of->preview_errors;
    drawn.preview = of->method;
    preview = shrink == 1 && drawn.share == 1.0 && !of->preview_errors ? of->preview : nullptr;
  }
  if (preview) {
    drawn.preview_errors =
        compare_pictures(doubles_of(*preview), doubles_of(*film), lights_behind(scene_));
    const std::lock_guard lock(mutex_);
    if (Client* const of = find_view(client, view)) {
      of->preview_errors = drawn.preview_errors;
    }
  }
  return drawn;
}

std::string VolumeViews::scene_text_of(const VolumeLook& look) const {
  require(look);
  return scene_text(words_, scene_, look);
}

}  // namespace haarlight::apps
