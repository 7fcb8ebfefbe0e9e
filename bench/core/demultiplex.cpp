// SPDX-License-Identifier: Apache-2.0
/// Demultiplexing 1024 lights: the fast transform against the dense inverse, both as develop
/// runs them (float pictures in and out), beside a plain copy of memory of the same size. The
/// results are compared with exact whole numbers before anything is timed.

#include "session/develop/demultiplex.h"

#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <numeric>

#include <benchmark/benchmark.h>

#include "core/parallel.h"
#include "core/random.h"
#include "core/rig/pattern_inverse.h"

namespace haarlight {
namespace {

constexpr int kLights = 1024;
constexpr int kWidth = 256;
constexpr int kHeight = 128;

PatternInverse make_inverse(PatternFamily family, int bin = 0) {
  PatternParameters parameters{family, {{32, 32}}, bin, {}};
  if (family == PatternFamily::haar) {
    parameters.wavelets.resize(kLights);
    std::iota(parameters.wavelets.begin(), parameters.wavelets.end(), 0);
  }
  std::vector<std::vector<LightDriveLevel>> shots;
  for (const auto& lit : lit_lights(parameters)) {
    shots.emplace_back();
    for (const int k : lit) {
      shots.back().push_back({k, 1.0});
    }
  }
  return {parameters, std::move(shots), kLights};
}

std::vector<Image<float>> make_pictures(int n, int width, int height) {
  std::vector<Image<float>> pictures;
  pictures.reserve(static_cast<std::size_t>(n));
  for (int j = 0; j < n; ++j) {
    Image<float> picture(height, width, 1);
    std::size_t i = 0;
    for (float& value : picture.pixels()) {
      value = static_cast<float>(hash_key(static_cast<std::uint64_t>(j), i++) % 16384);
    }
    pictures.push_back(std::move(picture));
  }
  return pictures;
}

/// The fast S-matrix inverse against whole numbers: 1024 T_k = 2 (2 sum of lit - sum).
void require_exact(const PatternInverse& inverse) {
  const std::vector<Image<float>> shots = make_pictures(kLights, 16, 1);
  std::vector<Image<float>> lights = shots;
  session::demultiplex_rows(inverse, std::vector<double>(kLights, 1.0), {}, 0, lights);
  for (int k = 0; k < kLights - 1; ++k) {
    std::int64_t sum = 0;
    std::int64_t lit = 0;
    for (int j = 0; j < kLights - 1; ++j) {
      const auto value = static_cast<std::int64_t>(shots[static_cast<std::size_t>(j)](0, 5));
      sum += value;
      lit += s_entry(kLights - 1, j, k) ? value : 0;
    }
    const auto exact = static_cast<float>(static_cast<double>(2 * (2 * lit - sum)) / kLights);
    if (lights[static_cast<std::size_t>(k)](0, 5) != exact) {
      std::fprintf(stderr, "light %d: %.9g, exact %.9g\n", k,
                   static_cast<double>(lights[static_cast<std::size_t>(k)](0, 5)),
                   static_cast<double>(exact));
      std::abort();
    }
  }
}

void set_rates(benchmark::State& state, std::size_t n_shots, std::size_t n_pixels) {
  const auto bytes = static_cast<std::int64_t>((n_shots + kLights) * n_pixels * sizeof(float));
  state.SetBytesProcessed(state.iterations() * bytes);
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(n_pixels));
}

void run_rows(benchmark::State& state, const PatternInverse& inverse,
              const session::PlatePixels& plate) {
  const ThreadLimit limit(static_cast<int>(state.range(0)));
  const std::vector<double> power(kLights, 1.0);
  const std::vector<Image<float>> shots = make_pictures(inverse.n_shots(), kWidth, kHeight);
  for (auto _ : state) {
    state.PauseTiming();
    std::vector<Image<float>> pictures = shots;
    state.ResumeTiming();
    session::demultiplex_rows(inverse, power, plate, 0, pictures);
    benchmark::DoNotOptimize(pictures.data());
  }
  set_rates(state, static_cast<std::size_t>(inverse.n_shots()), kWidth * kHeight);
}

void fast_s_matrix(benchmark::State& state) {
  const PatternInverse inverse = make_inverse(PatternFamily::s_matrix);
  require_exact(inverse);
  run_rows(state, inverse, {});
}
BENCHMARK(fast_s_matrix)->Arg(1)->Arg(2)->Unit(benchmark::kMillisecond);

void fast_haar(benchmark::State& state) {
  run_rows(state, make_inverse(PatternFamily::haar), {});
}
BENCHMARK(fast_haar)->Arg(1)->Arg(2)->Unit(benchmark::kMillisecond);

void bins_of_256(benchmark::State& state) {
  session::PlatePixels plate;  // in memory, so that only the sharing is timed
  plate.read = [](int, int, int, std::span<float> out) {
    for (std::size_t i = 0; i < out.size(); ++i) {
      out[i] = 1.0F + 0.001F * static_cast<float>(i % kLights);
    }
  };
  run_rows(state, make_inverse(PatternFamily::bins, 2), plate);
}
BENCHMARK(bins_of_256)->Arg(1)->Arg(2)->Unit(benchmark::kMillisecond);

/// The same by the dense inverse, double, Eigen's matrix product, one thread.
void dense_s_matrix(benchmark::State& state) {
  Eigen::MatrixXd s(kLights - 1, kLights - 1);
  for (int shot = 0; shot < kLights - 1; ++shot) {
    for (int light = 0; light < kLights - 1; ++light) {
      s(shot, light) = s_entry(kLights - 1, shot, light) ? 1.0 : 0.0;
    }
  }
  const Eigen::MatrixXd inverse =
      2.0 / kLights * (2.0 * s.transpose() - Eigen::MatrixXd::Ones(kLights - 1, kLights - 1));
  constexpr Eigen::Index kPixels = 2048;
  const Eigen::MatrixXd measured = Eigen::MatrixXd::Random(kLights - 1, kPixels);
  Eigen::MatrixXd lights(kLights - 1, kPixels);
  for (auto _ : state) {
    lights.noalias() = inverse * measured;
    benchmark::DoNotOptimize(lights.data());
  }
  set_rates(state, kLights, kPixels);
}
BENCHMARK(dense_s_matrix)->Unit(benchmark::kMillisecond);

/// Reads and writes as many bytes as fast_s_matrix.
void memory_copy(benchmark::State& state) {
  const std::vector<float> from(std::size_t{kLights} * kWidth * kHeight, 1.0F);
  std::vector<float> to(from.size());
  for (auto _ : state) {
    std::memcpy(to.data(), from.data(), from.size() * sizeof(float));
    benchmark::ClobberMemory();
  }
  set_rates(state, kLights, kWidth * kHeight);
}
BENCHMARK(memory_copy)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace haarlight
