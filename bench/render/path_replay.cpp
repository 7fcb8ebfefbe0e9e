// SPDX-License-Identifier: Apache-2.0
/// @file
/// What path tracing costs beside its rays alone: the packets that one render hands to Embree are
/// recorded, and asked again of bare Embree in turns with the render. One thread, CPU seconds,
/// medians; the table of docs/numerics/rays.md.
///
///     path_replay SCENE.toml [SAMPLES] [REPEATS] [--direct]
///
/// The rays are recorded by functions of Embree's names, which the linker finds before Embree's own:
/// the renderer is the one of the product, unchanged. For the replay the packets lie ready in
/// Embree's own form, so that nothing but tracing is timed; the better of packets and single rays
/// counts.

#include <algorithm>
#include <array>
#include <cstdint>
#include <ctime>
#include <exception>
#include <optional>
#include <string>
#include <vector>

#include <dlfcn.h>
#include <embree3/rtcore.h>
#include <fmt/format.h>

#include "core/parallel.h"
#include "haarlight/render/light/cubemap.h"
#include "haarlight/render/rays/ray_caster.h"
#include "haarlight/render/scene/scene.h"
#include "render/film/film.h"
#include "render/loop/tile_renderer.h"
#include "render/scene/texture_files.h"
#include "render/surface/path_integrator.h"
#include "render/surface/surface_layers.h"

namespace {

constexpr std::size_t kPacket = 16;
using Valid = std::array<int, kPacket>;

/// One question to Embree, as it was asked.
struct Packet {
  alignas(64) RTCRay16 rays;
  alignas(64) Valid valid;
  RTCIntersectContextFlags flags;
  bool is_shadow;
};

bool is_recording = false;
std::vector<Packet> packets;
RTCScene recorded_scene = nullptr;

void record(const int* valid, RTCScene scene, const RTCIntersectContext& context,
            const RTCRay16& rays, bool is_shadow) {
  if (!is_recording) {
    return;
  }
  recorded_scene = scene;
  Packet& packet = packets.emplace_back();
  packet.rays = rays;
  std::copy_n(valid, kPacket, packet.valid.begin());
  packet.flags = context.flags;
  packet.is_shadow = is_shadow;
}

template <class Function>
Function* next_function(const char* name) {
  return reinterpret_cast<Function*>(dlsym(RTLD_NEXT, name));  // NOLINT
}

}  // namespace

extern "C" {
// NOLINTBEGIN(readability-identifier-naming): Embree's
void rtcIntersect16(const int* valid, RTCScene scene, RTCIntersectContext* context,
                    RTCRayHit16* rayhit) {
  static auto* const real = next_function<decltype(rtcIntersect16)>("rtcIntersect16");
  record(valid, scene, *context, rayhit->ray, false);
  real(valid, scene, context, rayhit);
}
void rtcOccluded16(const int* valid, RTCScene scene, RTCIntersectContext* context,
                   RTCRay16* ray) {
  static auto* const real = next_function<decltype(rtcOccluded16)>("rtcOccluded16");
  record(valid, scene, *context, *ray, true);
  real(valid, scene, context, ray);
}
// NOLINTEND(readability-identifier-naming)
}

namespace haarlight::render {
namespace {

double cpu_seconds() { return static_cast<double>(std::clock()) / CLOCKS_PER_SEC; }

RTCIntersectContext context_of(RTCIntersectContextFlags flags) {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  context.flags = flags;
  return context;
}

/// Asks the recorded packets again. @return answers, so that none is left out
std::uint64_t replay_packets() {
  std::uint64_t n = 0;
  for (const Packet& packet : packets) {
    RTCIntersectContext context = context_of(packet.flags);
    alignas(64) RTCRayHit16 asked;
    asked.ray = packet.rays;
    if (packet.is_shadow) {
      rtcOccluded16(packet.valid.data(), recorded_scene, &context, &asked.ray);
      n += asked.ray.tfar[0] < 0.0F ? 1 : 0;
    } else {
      std::fill_n(asked.hit.geomID, kPacket, RTC_INVALID_GEOMETRY_ID);
      std::fill_n(asked.hit.instID[0], kPacket, RTC_INVALID_GEOMETRY_ID);
      rtcIntersect16(packet.valid.data(), recorded_scene, &context, &asked);
      n += asked.hit.geomID[0] != RTC_INVALID_GEOMETRY_ID ? 1 : 0;
    }
  }
  return n;
}

struct Single {
  RTCRay ray;
  bool is_shadow;
};

std::vector<Single> singles() {
  std::vector<Single> all;
  for (const Packet& packet : packets) {
    for (std::size_t i = 0; i < kPacket; ++i) {
      if (packet.valid.at(i) == 0) {
        continue;
      }
      const RTCRay16& from = packet.rays;
      RTCRay ray{};
      ray.org_x = from.org_x[i];
      ray.org_y = from.org_y[i];
      ray.org_z = from.org_z[i];
      ray.dir_x = from.dir_x[i];
      ray.dir_y = from.dir_y[i];
      ray.dir_z = from.dir_z[i];
      ray.tnear = from.tnear[i];
      ray.tfar = from.tfar[i];
      ray.mask = from.mask[i];
      all.push_back({.ray = ray, .is_shadow = packet.is_shadow});
    }
  }
  return all;
}

std::uint64_t replay_singles(const std::vector<Single>& rays) {
  std::uint64_t n = 0;
  for (const Single& single : rays) {
    RTCIntersectContext context = context_of(RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT);
    RTCRayHit asked;
    asked.ray = single.ray;
    if (single.is_shadow) {
      rtcOccluded1(recorded_scene, &context, &asked.ray);
      n += asked.ray.tfar < 0.0F ? 1 : 0;
    } else {
      asked.hit.geomID = RTC_INVALID_GEOMETRY_ID;
      asked.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
      rtcIntersect1(recorded_scene, &context, &asked);
      n += asked.hit.geomID != RTC_INVALID_GEOMETRY_ID ? 1 : 0;
    }
  }
  return n;
}

double median(std::vector<double> values) {
  std::nth_element(values.begin(),
                   values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2),
                   values.end());
  return values[values.size() / 2];
}

template <class Work>
void time(std::vector<double>& seconds, const Work& work) {
  const double start = cpu_seconds();
  work();
  seconds.push_back(cpu_seconds() - start);
}

int replay(const std::string& scene_file, std::uint32_t samples, int repeats, bool is_direct) {
  const ThreadLimit one_thread(1);
  SceneFile file = read_scene(scene_file);
  if (!file.has_camera) {
    fmt::print(stderr, "{}: no [camera]\n", scene_file);
    return 2;
  }
  constexpr std::uint64_t kTextureBytes = 1U << 30U;
  load_textures(file.scene, kTextureBytes);
  const std::optional<Environment> environment = read_environment(file.scene);
  const RayCaster caster(file.scene);
  PathOptions options;
  options.most_bounces = is_direct ? 1 : options.most_bounces;
  const PathIntegrator integrator(file.scene, caster, environment ? &*environment : nullptr,
                                  {file.camera, file.optics}, options);
  RunOptions run_options;
  run_options.samples = samples;
  std::uint64_t n_rays = 0;
  const auto render_once = [&] {
    Film film(file.camera.width, file.camera.height, surface_layers(false));
    n_rays = run(integrator, run_options, film).n_rays;
  };
  is_recording = true;
  render_once();
  is_recording = false;
  const std::vector<Single> single = singles();
  std::vector<double> rendered;
  std::vector<double> by_packets;
  std::vector<double> by_singles;
  std::uint64_t answers = 0;
  for (int i = 0; i < repeats; ++i) {
    time(rendered, render_once);
    time(by_packets, [&] { answers += replay_packets(); });
    time(by_singles, [&] { answers += replay_singles(single); });
  }
  const double best = std::min(median(by_packets), median(by_singles));
  const auto rate = [&](double seconds) {
    return 1e-6 * static_cast<double>(n_rays) / seconds;
  };
  fmt::print("Embree {}: {} rays in {} packets, {:.1f} of 16 full ({} answers)\n",
             RTC_VERSION_STRING, n_rays, packets.size(),
             static_cast<double>(single.size()) / static_cast<double>(packets.size()), answers);
  fmt::print(
      "render {:.3f} s ({:.1f} Mray/s); replay: packets {:.3f} s ({:.1f}), single {:.3f} s "
      "({:.1f}); render / replay {:.2f}\n",
      median(rendered), rate(median(rendered)), median(by_packets), rate(median(by_packets)),
      median(by_singles), rate(median(by_singles)), median(rendered) / best);
  return 0;
}

}  // namespace
}  // namespace haarlight::render

int main(int argc, char** argv) {
  std::vector<std::string> words(argv + 1, argv + argc);
  const bool is_direct = std::erase(words, "--direct") > 0;
  if (words.empty() || words.size() > 3) {
    fmt::print(stderr, "usage: path_replay SCENE.toml [SAMPLES] [REPEATS] [--direct]\n");
    return 2;
  }
  try {
    const auto samples =
        static_cast<std::uint32_t>(words.size() > 1 ? std::stoul(words[1]) : 4);
    return haarlight::render::replay(words[0], samples,
                                     words.size() > 2 ? std::stoi(words[2]) : 5, is_direct);
  } catch (const std::exception& error) {
    fmt::print(stderr, "{}\n", error.what());
    return 1;
  }
}
