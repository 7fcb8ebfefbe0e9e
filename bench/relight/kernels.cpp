// SPDX-License-Identifier: Apache-2.0
/// @file
/// Relighting's kernels beside the memory's own speed and third-party libraries, in one
/// process, every method in turn, medians. The data is the twin's airplane, repeated over a
/// picture that no cache holds. Every result is checked against a double reference, and its
/// error stands beside its time. docs/numerics/relight.md, "Kernels", has the table.

#include <algorithm>
#include <atomic>
#include <bit>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>

#include <cblas.h>
#include <fmt/format.h>
#include <opencv2/core.hpp>
#include <sys/mman.h>
#include <unistd.h>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include "apps/command_line.h"
#include "apps/run_program.h"
#include "core/count.h"
#include "core/parallel.h"
#include "core/random.h"
#include "core/report.h"
#include "core/tradeoff.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/tolerance.h"
#include "haarlight/relight/basis/coder/block_codec.h"
#include "haarlight/relight/basis/compress.h"
#include "haarlight/relight/basis/haar.h"
#include "relight/basis/dense_half.h"
#include "relight/basis/haar_blocks.h"
#include "relight/basis/plate/plate.h"
#include "relight/basis/prefetch.h"
#include "relight/basis/prepared_basis.h"
#include "relight/basis/weight_list.h"

#include "bench/relight/twin.h"

namespace haarlight::bench {
namespace {

constexpr std::size_t kGrain = std::size_t{1} << 20U;
constexpr int kEnvironments = 8;

using Conditions = TradeoffConditions;
using Record = TradeoffRecord;

struct Arguments {
  std::string rig = "configs/rigs/cube32.toml";
  std::string scene = "configs/scenes/airplane.toml";
  std::string json;
  std::string only;
  std::vector<int> threads = {1, 2};
  int repeats = 11;
  int copies = 32;          ///< of the twin's 16 384 pixels: 524 288
  int sparse_copies = 256;  ///< 4 194 304 pixels
  double error = 0.0122;    ///< 21 coefficients per pixel
};

/// A small stack over and over, side by side and below one another.
class RepeatedStack final : public StackSource {
 public:
  RepeatedStack(const MemoryStack& stack, int across, int down)
      : stack_(stack), across_(across), down_(down) {}
  [[nodiscard]] StackDims dims() const override {
    StackDims dims = stack_.dims();
    dims.width *= across_;
    dims.height *= down_;
    return dims;
  }
  void read_tile(const TileRect& rect, std::span<float> out) const override {
    const StackDims small = stack_.dims();
    HAARLIGHT_EXPECTS(small.width % rect.width == 0 && small.height % rect.height == 0,
                      "tiles that divide the picture");
    stack_.read_tile({rect.x0 % small.width, rect.y0 % small.height, rect.width, rect.height},
                     out);
  }

 private:
  const MemoryStack& stack_;
  int across_;
  int down_;
};

/// The same for a basis file: the same blocks again and again. Norms grow with the root of the
/// number of copies; relative errors stay.
void repeat_basis(const relight::BasisFile& small, int across, int down,
                  const std::filesystem::path& file) {
  relight::BasisHeader header = small.header();
  HAARLIGHT_EXPECTS(header.dims.width % header.tile == 0, "whole tiles");
  const int tiles_x = header.dims.width / header.tile;
  const int tiles_y = header.dims.height / header.tile;
  std::vector<relight::PackedTile> tiles;
  for (int t = 0; t < small.n_tiles(); ++t) {
    relight::PackedTile tile;
    tile.pixels.bytes = relight::encode_pixels(small.pixels(t, 0));
    for (int g = 0; g < small.n_groups(); ++g) {
      const relight::SparseBlock block = small.sparse(t, 0, g);
      tile.groups.push_back(
          {relight::encode_sparse(block), static_cast<std::uint32_t>(block.cell.size())});
    }
    tiles.push_back(std::move(tile));
  }
  relight::BasisWriter writer(file);
  for (int y = 0; y < tiles_y * down; ++y) {
    for (int x = 0; x < tiles_x * across; ++x) {
      writer.append(tiles[count(y % tiles_y * tiles_x + x % tiles_x)]);
    }
  }
  header.dims.width *= across;
  header.dims.height *= down;
  const double growth = std::sqrt(double(across) * down);
  header.stack_norm *= growth;
  relight::BasisTables tables = small.tables();
  for (std::vector<float>* table : {&tables.coefficient_norms, &tables.coefficient_errors,
                                    &tables.light_norms, &tables.light_errors}) {
    for (float& v : *table) {
      v = static_cast<float>(growth * double{v});
    }
  }
  (void)writer.finish(header, tables);
}

double relative_l2(std::span<const float> found, std::span<const float> truth) {
  return compare(found, truth).relative_l2;
}

void triad(std::span<float> a, std::span<const float> b, std::span<const float> c) {
  parallel_for(a.size() / kGrain, 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin * kGrain; i < end * kGrain; i += 4) {
#if defined(__x86_64__)
      _mm_stream_ps(&a[i], _mm_add_ps(_mm_load_ps(&b[i]),
                                      _mm_mul_ps(_mm_set1_ps(3.0F), _mm_load_ps(&c[i]))));
#else
      for (std::size_t k = i; k < i + 4; ++k) {
        a[k] = b[k] + 3.0F * c[k];
      }
#endif
    }
#if defined(__x86_64__)
    _mm_sfence();
#endif
  });
}

/// What reading alone reaches, with the kernels' prefetches: a triad's stores that pass by the
/// caches need none of a core's slots for reads, so that where cores are few a sum that only
/// reads cannot keep up with it.
float read_all(std::span<const float> values) {
  std::atomic<std::uint32_t> all{0};
  parallel_for(values.size() / kGrain, 1, [&](std::size_t begin, std::size_t end) {
    std::uint32_t bits = 0;
#if defined(__x86_64__)
    __m128i sums[4] = {};
    for (std::size_t i = begin * kGrain; i < end * kGrain; i += 16) {
      const auto* from = reinterpret_cast<const __m128i*>(&values[i]);
      relight::prefetch_ahead(from);
      for (int k = 0; k < 4; ++k) {
        sums[k] = _mm_xor_si128(sums[k], _mm_loadu_si128(from + k));
      }
    }
    bits = static_cast<std::uint32_t>(_mm_cvtsi128_si32(
        _mm_xor_si128(_mm_xor_si128(sums[0], sums[1]), _mm_xor_si128(sums[2], sums[3]))));
#else
    for (std::size_t i = begin * kGrain; i < end * kGrain; ++i) {
      bits ^= std::bit_cast<std::uint32_t>(values[i]);
    }
#endif
    all ^= bits;
  });
  return std::bit_cast<float>(all.load());
}

void copy(std::span<const float> from, std::span<float> to) {
  parallel_for(from.size() / kGrain, 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin * kGrain; i < end * kGrain; i += 4) {
#if defined(__x86_64__)
      _mm_stream_ps(&to[i], _mm_load_ps(&from[i]));
#else
      std::copy_n(&from[i], 4, &to[i]);
#endif
    }
#if defined(__x86_64__)
    _mm_sfence();
#endif
  });
}

/// Room on pages of 2 MB where the system grants them: the same for every method.
struct FreeRoom {
  void operator()(float* room) const noexcept { std::free(room); }
};
class Room {
 public:
  explicit Room(std::size_t n)
      : values_(static_cast<float*>(std::aligned_alloc(kPage, (n * 4 / kPage + 1) * kPage))),
        size_(n) {
    if (!values_) {
      throw std::bad_alloc();
    }
    (void)::madvise(values_.get(), n * 4, MADV_HUGEPAGE);
  }
  [[nodiscard]] std::span<float> values() const { return {values_.get(), size_}; }

 private:
  static constexpr std::size_t kPage = std::size_t{2} << 20U;
  std::unique_ptr<float, FreeRoom> values_;
  std::size_t size_;
};

/// One method: how it runs, what it moves, how far off its result is (measured once).
struct Method {
  Record record;
  std::function<void()> run;
  std::function<double()> error;
};

/// Two skies of a thousand different weights, and their like: 10^4 to 1.
relight::LightWeights sky(std::uint64_t seed, int n) {
  relight::LightWeights w(n, 1);
  for (int k = 0; k < n; ++k) {
    w(k, 0) = std::pow(uniform_unit(hash_key(seed, static_cast<std::uint64_t>(k))), 8.0);
  }
  return w;
}

/// Everything that is lit, and in what form.
struct Data {
  StackDims dims;
  std::optional<TwinStack> small;
  std::optional<relight::BasisFile> small_basis;
  std::optional<relight::DenseHalf> half;
  std::optional<relight::PreparedBasis> prepared;
  std::vector<relight::LightWeights> skies;
  std::vector<Image<float>> truths;  ///< of the small stack
  std::optional<Room> pixel_major;   ///< (pixels, lights)
  std::optional<Room> image_major;   ///< (lights, pixels)
  std::optional<Room> out;           ///< as large
  std::optional<Room> picture;       ///< (kEnvironments, pixels)
};

Data make_data(const Arguments& arguments, const std::filesystem::path& folder) {
  Data data;
  data.small = render_twin(arguments.rig, arguments.scene);
  const MemoryStack& stack = data.small->stack;
  const int n_lights = stack.dims().n_lights;
  const RepeatedStack repeated(stack, std::min(8, arguments.copies),
                               std::max(1, arguments.copies / 8));
  data.dims = repeated.dims();
  fmt::print("dense: {} x {} pixels, {} lights\n", data.dims.width, data.dims.height, n_lights);
  data.half.emplace(repeated, "twin");
  const std::size_t n_pixels = data.dims.n_pixels();
  const std::size_t n_small = stack.dims().n_pixels();
  data.pixel_major.emplace(n_pixels * count(n_lights));
  data.image_major.emplace(n_pixels * count(n_lights));
  data.out.emplace(n_pixels * count(n_lights));
  data.picture.emplace(n_pixels * kEnvironments);
  // Copies one after the other: the order of pixels does not matter to a sum over lights.
  parallel_for(n_pixels, n_small, [&](std::size_t begin, std::size_t) {
    std::copy_n(stack.values().data(), n_small * count(n_lights),
                data.pixel_major->values().data() + begin * count(n_lights));
  });
  parallel_for(count(n_lights), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t k = begin; k < end; ++k) {
      for (std::size_t p = 0; p < n_pixels; ++p) {
        data.image_major->values()[k * n_pixels + p] =
            stack.values()[p % n_small * count(n_lights) + k];
      }
    }
  });
  std::fill(data.out->values().begin(), data.out->values().end(), 0.0F);
  std::fill(data.picture->values().begin(), data.picture->values().end(), 0.0F);
  for (int e = 0; e < kEnvironments; ++e) {
    data.skies.push_back(sky(static_cast<std::uint64_t>(e), n_lights));
    data.truths.push_back(relight::relight_stack(stack, data.skies.back()));
  }

  const MemoryStack plate = read_all(relight::ComputedPlate(data.small->twin.rig));
  relight::CompressSource source;
  source.stack = &stack;
  source.plate = &plate;
  source.plate_origin = relight::PlateOrigin::computed;
  source.grid = {data.small->twin.rig.faces.front().rows,
                 data.small->twin.rig.faces.front().cols};
  source.name = arguments.scene;
  source.lights.resize(count(n_lights));
  relight::CompressOptions options;
  options.relative_l2 = arguments.error;
  (void)relight::compress_stack(source, folder / "small.hlb", options);
  data.small_basis = relight::BasisFile::open(folder / "small.hlb");
  repeat_basis(*data.small_basis, std::min(16, arguments.sparse_copies),
               std::max(1, arguments.sparse_copies / 16), folder / "large.hlb");
  const double seconds = seconds_of([&] {
    data.prepared.emplace(relight::BasisFile::open(folder / "large.hlb"),
                          relight::PrepareOptions{relight::PreparedForm::sparse, 0.0});
  });
  fmt::print(
      "sparse: {} x {} pixels, {:.1f} coefficients per pixel, {} plate vectors, {:.2f} GB "
      "unpacked in {:.1f} s\n",
      data.prepared->header().dims.width, data.prepared->header().dims.height,
      data.prepared->header().mean_coefficients, data.prepared->header().plate_rank,
      1e-9 * double(data.prepared->bytes()), seconds);
  return data;
}

/// The part of a repeated picture that is the small one.
double picture_error(const Image<float>& picture, const Image<float>& truth) {
  Image<float> part(truth.height(), truth.width(), 1);
  for (int y = 0; y < truth.height(); ++y) {
    for (int x = 0; x < truth.width(); ++x) {
      part(y, x) =
          picture(picture.height() - truth.height() + y, picture.width() - truth.width() + x);
    }
  }
  return relative_l2(part.pixels(), truth.pixels());
}

class Bench {
 public:
  Bench(Data& data, int threads, const Arguments& arguments, std::string command);
  /// Every method in turn, as often as requested; then the records.
  [[nodiscard]] std::vector<Record> run();

 private:
  Method& add(std::string algorithm, std::string mode, double bytes, std::function<void()> run,
              std::function<double()> error, int environments = 1);
  void add_memory();
  void add_dense();
  void add_others();
  void add_haar();
  void add_sparse();
  std::function<double()> picture_check(std::size_t e);

  Data& data_;
  const Arguments& arguments_;
  Conditions conditions_;
  std::vector<Method> methods_;
  std::vector<relight::RelitPicture> pictures_;
  float read_ = 0.0F;                       ///< so that reading is not left out
  std::vector<std::vector<float>> floats_;  ///< skies as floats, (environments, lights)
};

Bench::Bench(Data& data, int threads, const Arguments& arguments, std::string command)
    : data_(data), arguments_(arguments) {
  conditions_.threads = threads;
  conditions_.lights = data.dims.n_lights;
  conditions_.pixels = static_cast<long long>(data.dims.n_pixels());
  conditions_.repeats = arguments.repeats;
  conditions_.command = std::move(command);
  openblas_set_num_threads(threads);
  cv::setNumThreads(threads);
  for (const relight::LightWeights& w : data.skies) {
    std::vector<float> row;
    for (Eigen::Index k = 0; k < w.rows(); ++k) {
      row.push_back(static_cast<float>(w(k, 0)));
    }
    floats_.push_back(std::move(row));
  }
  add_memory();
  add_dense();
  add_others();
  add_haar();
  add_sparse();
}

Method& Bench::add(std::string algorithm, std::string mode, double bytes,
                   std::function<void()> run, std::function<double()> error, int environments) {
  Method method;
  method.record.algorithm = std::move(algorithm);
  method.record.mode = std::move(mode);
  method.record.error_norm = error ? "relative L2" : "none";
  method.record.bytes = bytes;
  method.record.conditions = conditions_;
  method.record.conditions.environments = environments;
  method.run = std::move(run);
  method.error = std::move(error);
  methods_.push_back(std::move(method));
  return methods_.back();
}

void Bench::add_memory() {
  const std::size_t third = data_.out->values().size() / 3 / kGrain * kGrain;
  add("memory", "triad, non-temporal", 12.0 * double(third),
      [this, third] {
        const std::span<float> all = data_.out->values();
        triad(all.first(third), all.subspan(third, third), all.subspan(2 * third, third));
      },
      {});
  add("memory", "read", 4.0 * double(data_.pixel_major->values().size()),
      [this] { read_ = read_all(data_.pixel_major->values()); }, {});
  add("memory", "copy, non-temporal", 8.0 * double(data_.out->values().size()),
      [this] { copy(data_.pixel_major->values(), data_.out->values()); }, {});
}

std::function<double()> Bench::picture_check(std::size_t e) {
  return [this, e] { return picture_error(pictures_[e].picture, data_.truths[e]); };
}

void Bench::add_dense() {
  const double bytes = 2.0 * double(data_.dims.n_pixels()) * data_.dims.n_lights;
  add(
      "haarlight", "dense half", bytes,
      [this] {
        pictures_ = data_.half->relight(std::span(data_.skies).first(1),
                                        relight::best_kernel_code(), std::move(pictures_));
      },
      picture_check(0));
  add(
      "haarlight", "dense half, 8 environments", bytes,
      [this] {
        pictures_ =
            data_.half->relight(data_.skies, relight::best_kernel_code(), std::move(pictures_));
      },
      picture_check(7), kEnvironments);
  add(
      "haarlight", "dense half, portable code", bytes,
      [this] {
        pictures_ = data_.half->relight(std::span(data_.skies).first(1),
                                        relight::KernelCode::portable, std::move(pictures_));
      },
      picture_check(0));
}

void Bench::add_others() {
  const auto n_lights = data_.dims.n_lights;
  const auto n_pixels = static_cast<int>(data_.dims.n_pixels());
  const double bytes = 4.0 * double(n_pixels) * n_lights;
  const auto last_copy = [this](std::size_t e) {
    const std::size_t n_small = data_.truths[e].pixels().size();
    return relative_l2(
        data_.picture->values().subspan((e + 1) * data_.dims.n_pixels() - n_small, n_small),
        data_.truths[e].pixels());
  };
  add(
      "OpenBLAS", "sgemv", bytes,
      [this, n_lights, n_pixels] {
        cblas_sgemv(CblasRowMajor, CblasNoTrans, n_pixels, n_lights, 1.0F,
                    data_.pixel_major->values().data(), n_lights, floats_[0].data(), 1, 0.0F,
                    data_.picture->values().data(), 1);
      },
      [last_copy] { return last_copy(0); });
  add(
      "OpenBLAS", "sgemm, 8 environments", bytes,
      [this, n_lights, n_pixels] {
        std::vector<float> all;
        for (const std::vector<float>& row : floats_) {
          all.insert(all.end(), row.begin(), row.end());
        }
        cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasTrans, kEnvironments, n_pixels, n_lights,
                    1.0F, all.data(), n_lights, data_.pixel_major->values().data(), n_lights,
                    0.0F, data_.picture->values().data(), n_pixels);
      },
      [last_copy] { return last_copy(7); }, kEnvironments);
  add(
      "OpenCV", "scaleAdd, image by image", bytes,
      [this, n_lights, n_pixels] {
        cv::Mat sum(1, n_pixels, CV_32F, data_.picture->values().data());
        sum.setTo(0.0F);
        for (int k = 0; k < n_lights; ++k) {
          const cv::Mat image(
              1, n_pixels, CV_32F,
              data_.image_major->values().data() + count(k) * data_.dims.n_pixels());
          cv::scaleAdd(image, static_cast<double>(floats_[0][count(k)]), sum, sum);
        }
      },
      [last_copy] { return last_copy(0); });
}

void Bench::add_haar() {
  const double bytes = 8.0 * double(data_.out->values().size());
  const auto n = data_.small->twin.rig.faces.front().rows;
  const auto bits_off = [this, n] {
    const std::size_t size = count(n) * count(n);
    const std::size_t step = 61 * size;
    double off = 0.0;
    std::vector<float> block(size);
    for (std::size_t at = 0; at + size <= data_.out->values().size(); at += step) {
      std::copy_n(data_.pixel_major->values().data() + at, size, block.data());
      relight::haar_forward(std::span(block), relight::HaarGrid{n, n});
      off += std::memcmp(block.data(), data_.out->values().data() + at, size * 4) == 0 ? 0 : 1;
    }
    return off;
  };
  add(
      "haarlight", "Haar transform, by tiles", bytes,
      [this, n] {
        const std::size_t size = count(n) * count(n);
        parallel_for(data_.dims.n_pixels(), 256, [&](std::size_t begin, std::size_t end) {
          const std::span<float> to =
              data_.out->values().subspan(begin * size, (end - begin) * size);
          std::copy_n(data_.pixel_major->values().data() + begin * size, to.size(), to.data());
          relight::haar_forward_blocks(to, {n, n});
        });
      },
      bits_off)
      .record.error_norm = "arrays whose bits differ from haar_forward";
  add(
      "haarlight", "Haar transform, pixel by pixel", bytes,
      [this, n] {
        const std::size_t size = count(n) * count(n);
        parallel_for(data_.dims.n_pixels(), 256, [&](std::size_t begin, std::size_t end) {
          for (std::size_t p = begin; p < end; ++p) {
            const std::span<float> to = data_.out->values().subspan(p * size, size);
            std::copy_n(data_.pixel_major->values().data() + p * size, size, to.data());
            relight::haar_forward(to, relight::HaarGrid{n, n});
          }
        });
      },
      bits_off)
      .record.error_norm = "arrays whose bits differ from haar_forward";
}

void Bench::add_sparse() {
  const relight::PreparedBasis& basis = *data_.prepared;
  const int n = data_.dims.n_lights;
  const std::vector<relight::LightWeights> one = {
      relight::weights_from_words({std::to_string(n / 2)}, n)};
  const auto add_method = [&](const std::string& mode,
                              std::vector<relight::LightWeights> weights,
                              relight::RelightMethod method, relight::KernelCode code) {
    const auto environments = static_cast<int>(weights.size());
    const auto relit = basis.relight(weights, {}, {method, code, {}});
    const Image<float> truth = relight::relight_stack(data_.small->stack, weights.back());
    Record& record =
        add(
            "haarlight", mode, double(relit.front().bytes_read),
            [this, &basis, weights, method, code] {
              pictures_ = basis.relight(weights, {}, {method, code, std::move(pictures_)});
            },
            [this, truth] { return picture_error(pictures_.back().picture, truth); },
            environments)
            .record;
    record.conditions.pixels = static_cast<long long>(basis.header().dims.n_pixels());
    record.conditions.coefficients_per_pixel = basis.header().mean_coefficients;
  };
  const std::vector<relight::LightWeights> first = {data_.skies.front()};
  const relight::KernelCode best = relight::best_kernel_code();
  add_method("sparse rows", first, relight::RelightMethod::sparse_rows, best);
  add_method("sparse rows, 8 environments", data_.skies, relight::RelightMethod::sparse_rows,
             best);
  for (const auto code : {relight::KernelCode::portable, relight::KernelCode::avx2_gather}) {
    if (code == relight::KernelCode::portable || best != relight::KernelCode::portable) {
      add_method(fmt::format("sparse rows, {} code", relight::word_of(code)), first,
                 relight::RelightMethod::sparse_rows, code);
    }
  }
  add_method("coefficient lists", first, relight::RelightMethod::coefficient_lists, best);
  add_method("coefficient lists, 8 environments", data_.skies,
             relight::RelightMethod::coefficient_lists, best);
  add_method("sparse rows, one light", one, relight::RelightMethod::sparse_rows, best);
  add_method("coefficient lists, one light", one, relight::RelightMethod::coefficient_lists,
             best);
}

std::vector<Record> Bench::run() {
  std::erase_if(methods_, [this](const Method& method) {
    return method.record.mode.find(arguments_.only) == std::string::npos;
  });
  for (Method& method : methods_) {  // once unmeasured: pages, and the results' errors
    method.run();
    method.record.error = method.error ? method.error() : 0.0;
  }
  std::vector<std::function<void()>> runs;
  std::vector<Record> records;
  for (const Method& method : methods_) {
    runs.push_back(method.run);
    records.push_back(method.record);
  }
  const std::vector<std::vector<double>> seconds = time_in_turn(runs, arguments_.repeats);
  for (std::size_t i = 0; i < records.size(); ++i) {
    set_times(seconds[i], records[i]);
  }
  return records;
}

const Record& record_of(const std::vector<Record>& records, std::string_view mode) {
  const auto found = std::find_if(records.begin(), records.end(),
                                  [mode](const Record& r) { return r.mode == mode; });
  HAARLIGHT_EXPECTS(found != records.end(), "a method that ran");
  return *found;
}

double rate(const Record& record) { return record.bytes / record.seconds; }

/// Of one environment's pixel.
double nanoseconds(const Record& record) {
  return 1e9 * record.seconds / double(record.conditions.pixels) /
         record.conditions.environments;
}

void print(const std::vector<Record>& records, int threads, bool is_whole) {
  const auto triad_found = std::find_if(records.begin(), records.end(), [](const Record& r) {
    return r.mode == "triad, non-temporal";
  });
  const double limit = triad_found == records.end() ? NAN : rate(*triad_found);
  fmt::print(
      "\n{} thread{}\n\n| method | ms (least to most) | GB/s | of triad | ns per pixel and "
      "environment | error |\n|---|---|---|---|---|---|\n",
      threads, threads == 1 ? "" : "s");
  for (const Record& record : records) {
    fmt::print("| {}: {} | {:.1f} ({:.1f} to {:.1f}) | {:.1f} | {:.2f} | {:.2f} | {} |\n",
               record.algorithm, record.mode, 1e3 * record.seconds, 1e3 * record.seconds_least,
               1e3 * record.seconds_most, 1e-9 * rate(record), rate(record) / limit,
               nanoseconds(record),
               record.error_norm == "none"
                   ? "-"
                   : fmt::format("{:.2g} {}", record.error, record.error_norm));
  }
  if (!is_whole) {
    return;
  }
  const auto line = [](const std::string& what, double found, double aim) {
    fmt::print("{}: {:.2f} (aim {}): {}\n", what, found, aim, found >= aim ? "yes" : "NO");
  };
  const Record& dense = record_of(records, "dense half");
  fmt::print("\n");
  line("dense half / triad, bandwidth", rate(dense) / limit, 0.85);
  fmt::print("dense half / read, bandwidth: {:.2f}\n",
             rate(dense) / rate(record_of(records, "read")));
  line("sgemv / dense half, time", record_of(records, "sgemv").seconds / dense.seconds, 1.7);
  line("Haar / copy, bandwidth",
       rate(record_of(records, "Haar transform, by tiles")) /
           rate(record_of(records, "copy, non-temporal")),
       0.75);
  line("dense half / sparse rows, time per pixel",
       nanoseconds(dense) / nanoseconds(record_of(records, "sparse rows")), 10.0);
  line("OpenCV / dense half, time",
       record_of(records, "scaleAdd, image by image").seconds / dense.seconds, 1.0);
}

int run(int argc, char** argv) {
  Arguments arguments;
  apps::CommandLine line("relight_kernels", "Relighting's kernels beside memory and libraries",
                         std::string(kVersion));
  apps::Command program = line.root();
  program.option("--only", &arguments.only, "Only methods whose name holds this");
  program.option("--rig", &arguments.rig, "Rig of the twin", {.shows_default = true});
  program.option("--scene", &arguments.scene, "Scene of the twin", {.shows_default = true});
  program.option("--threads", &arguments.threads, "Numbers of threads, separated by commas",
                 {.delimiter = ','});
  program.option("--repeats", &arguments.repeats, "Runs of each method",
                 {.shows_default = true});
  program.option("--copies", &arguments.copies,
                 "Copies of the 128 x 128 pixels for dense methods, a multiple of 8",
                 {.shows_default = true});
  program.option("--sparse-copies", &arguments.sparse_copies,
                 "The same for sparse methods, a multiple of 16", {.shows_default = true});
  program.option("--error", &arguments.error, "Relative L2 of the sparse basis",
                 {.shows_default = true});
  program.option("--json", &arguments.json, "Records, docs/reference/tradeoff.schema.json",
                 {.type = "FILE.json"});
  if (const std::optional<ExitCode> end = line.parse(argc, argv)) {
    return static_cast<int>(*end);
  }
  std::string command = "relight_kernels";
  for (int i = 1; i < argc; ++i) {
    command += std::string(" ") + argv[i];
  }
  const auto folder =
      std::filesystem::temp_directory_path() / fmt::format("kernels-{}", ::getpid());
  std::filesystem::create_directories(folder);
  Data data = make_data(arguments, folder);
  std::vector<Record> records;
  for (const int threads : arguments.threads) {
    const ThreadLimit limit(threads);
    const std::vector<Record> found = Bench(data, threads, arguments, command).run();
    print(found, threads, arguments.only.empty());
    records.insert(records.end(), found.begin(), found.end());
  }
  if (!arguments.json.empty()) {
    write_file_atomically(arguments.json, tradeoff_json(records));
  }
  std::filesystem::remove_all(folder);
  return 0;
}

}  // namespace
}  // namespace haarlight::bench

int main(int argc, char** argv) {
  return haarlight::apps::run_program("relight_kernels", haarlight::bench::run, argc, argv);
}
