// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/basis_methods.h"

#include <array>
#include <cmath>
#include <filesystem>
#include <optional>

#include "core/random.h"
#include "core/temporary_folder.h"
#include "haarlight/core/error.h"
#include "haarlight/core/tolerance.h"
#include "haarlight/relight/basis/relight.h"
#include "relight/basis/made_stack.h"
#include "relight/basis/prepared_basis.h"

namespace haarlight::relight {

namespace {

MadeScene scene_of(MethodSize size) {
  MadeScene scene;
  scene.width = by_size(size, 24, 96, 192);
  scene.height = by_size(size, 20, 80, 160);
  scene.grid = by_size(size, 8, 16, 32);
  return scene;
}

/// A sphere over a plane under a square array, and a sky of different light weights, 10^4 to 1.
struct MadeCapture {
  explicit MadeCapture(MethodSize size)
      : grid(scene_of(size).grid), stack(render_stack(scene_of(size))), sky(grid * grid, 1) {
    for (int k = 0; k < grid * grid; ++k) {
      sky(k, 0) = std::pow(uniform_unit(hash_key(7, static_cast<std::uint64_t>(k))), 8.0);
    }
  }
  [[nodiscard]] CompressSummary compress(double error, const std::filesystem::path& to) const {
    CompressOptions options;
    options.relative_l2 = error;
    return compress_stack(made_source(stack, grid), to, options);
  }
  [[nodiscard]] BasisFile compressed(double error, const std::filesystem::path& to) const {
    (void)compress(error, to);
    return BasisFile::open(to);
  }
  [[nodiscard]] MethodScale scale() const {
    return {stack.dims().n_lights, static_cast<long long>(stack.dims().n_pixels())};
  }

  int grid;
  MemoryStack stack;
  LightWeights sky;
};

/// Pictures of a capture; how one is made is the derived class's.
class RelightInput {
 public:
  using Result = RelitPicture;
  [[nodiscard]] double error(const Result& found, const Result& truth) const {
    return compare(found.picture.pixels(), truth.picture.pixels()).relative_l2;
  }
  [[nodiscard]] MethodScale scale() const { return capture_.scale(); }
  [[nodiscard]] double bytes(std::size_t setting) const { return bytes_.at(setting); }

 protected:
  RelightInput(MethodSize size, double error)
      : capture_(size), file_(capture_.compressed(error, folder_ / "made.hlb")) {}
  Result kept(std::size_t setting, Result result) {
    bytes_.at(setting) = static_cast<double>(result.bytes_read);
    return result;
  }
  [[nodiscard]] Result sum_of(const StackSource& stack) const {
    Result truth;
    truth.picture = relight_stack(stack, capture_.sky);
    return truth;
  }
  [[nodiscard]] Result from_file(std::size_t setting, const RelightOptions& options) {
    return kept(setting, relight(file_, capture_.sky, options));
  }
  [[nodiscard]] Result from_memory(std::size_t setting, const PreparedBasis& basis) {
    return kept(setting, std::move(basis.relight({&capture_.sky, 1}).front()));
  }

  TemporaryFolder folder_;
  MadeCapture capture_;
  BasisFile file_;
  std::array<double, 8> bytes_{};  ///< by setting
};

/// From a lossless file.
class TermsInput : public RelightInput {
 public:
  explicit TermsInput(MethodSize size) : RelightInput(size, 0.0) {}
  [[nodiscard]] Result truth() const { return sum_of(capture_.stack); }
  Result run(std::size_t setting) {
    constexpr std::array<std::optional<int>, 4> kTerms{4, 16, 64, std::nullopt};
    return from_file(setting, {.terms = kTerms.at(setting), .max_error = {}});
  }
};

/// From a quantised file, whose terms the promise may leave out: of a lossless one all are taken.
class PromisedInput : public RelightInput {
 public:
  explicit PromisedInput(MethodSize size) : RelightInput(size, 1e-4) {}
  [[nodiscard]] Result truth() const { return sum_of(read_all(BasisSource(file_))); }
  Result run(std::size_t setting) {
    constexpr std::array<std::optional<double>, 4> kErrors{0.1, 0.01, 0.001, std::nullopt};
    return from_file(setting, {.terms = {}, .max_error = kErrors.at(setting)});
  }
};

/// A quantised file: the truth is the stack that it holds.
class SparseInput : public RelightInput {
 public:
  explicit SparseInput(MethodSize size)
      : RelightInput(size, 0.01), prepared_(file_, {.form = PreparedForm::sparse}) {}
  [[nodiscard]] Result truth() const { return sum_of(read_all(BasisSource(file_))); }
  Result run(std::size_t setting) {
    return setting == 0 ? from_memory(setting, prepared_) : from_file(setting, {});
  }

 private:
  PreparedBasis prepared_;
};

/// A lossless file.
class DenseInput : public RelightInput {
 public:
  explicit DenseInput(MethodSize size)
      : RelightInput(size, 0.0), prepared_(file_, {.form = PreparedForm::dense}) {}
  [[nodiscard]] Result truth() const { return sum_of(capture_.stack); }
  Result run(std::size_t setting) {
    return setting == 0 ? from_memory(setting, prepared_) : from_file(setting, {});
  }

 private:
  PreparedBasis prepared_;
};

class CompressInput {
 public:
  using Result = MemoryStack;
  explicit CompressInput(MethodSize size) : capture_(size) {}
  Result run(std::size_t setting) {
    constexpr std::array<double, 4> kErrors{0.1, 0.01, 0.001, 0.0};
    const std::filesystem::path file = folder_ / "made.hlb";
    const CompressSummary summary = capture_.compress(kErrors.at(setting), file);
    bytes_.at(setting) = static_cast<double>(summary.bytes_moved) * sizeof(float);
    return read_all(BasisSource(BasisFile::open(file)));
  }
  [[nodiscard]] Result truth() const { return capture_.stack; }
  [[nodiscard]] double error(const Result& found, const Result& truth) const {
    return compare(found.values(), truth.values()).relative_l2;
  }
  [[nodiscard]] MethodScale scale() const { return capture_.scale(); }
  [[nodiscard]] double bytes(std::size_t setting) const { return bytes_.at(setting); }

 private:
  TemporaryFolder folder_;
  MadeCapture capture_;
  std::array<double, 4> bytes_{};  ///< by setting
};

/// Each side's picture is rounded to float: 2^-24 of a value, twice.
constexpr double kTwoRoundings = 0x1p-23;

}  // namespace

std::vector<Method> basis_methods() {
  const std::string module = "relight/basis";
  const std::string norm = "relative L2 of the picture";
  const std::string sums = "sums in double over the lights of the stack";
  const std::string rounded = "both pictures are floats";
  const std::string decoded_sums = "sums in double over the lights of the decoded stack";
  const std::string decoded_rounded = "both pictures and the decoded stack are floats";
  return {
      Method::of<CompressInput>({.module = module,
                                 .name = "Haar compression of the light transport matrix",
                                 .settings = {"--max-error 0.1", "--max-error 0.01",
                                              "--max-error 0.001", "--max-error 0"},
                                 .error_norm = "relative L2 of the stack",
                                 .truth = "the stack that was compressed",
                                 .exact_error = 0.0,
                                 .exact_error_from = "bit for bit"}),
      Method::of<TermsInput>(
          {.module = module,
           .name = "relighting by the largest transport-weighted terms",
           .settings = {"--terms 4", "--terms 16", "--terms 64", "all terms"},
           .error_norm = norm,
           .truth = sums,
           .exact_error = kTwoRoundings,
           .exact_error_from = rounded}),
      Method::of<PromisedInput>({.module = module,
                                 .name = "relighting within a promised error",
                                 .settings = {"--max-error 0.1", "--max-error 0.01",
                                              "--max-error 0.001", "all terms"},
                                 .error_norm = norm,
                                 .truth = decoded_sums,
                                 .exact_error = 2.0 * kTwoRoundings,
                                 .exact_error_from = decoded_rounded}),
      Method::of<SparseInput>(
          {.module = module,
           .name = "relighting a quantised basis",
           .settings = {"float sums from memory", "double sums from the file"},
           .error_norm = norm,
           .truth = decoded_sums,
           .exact_error = 2.0 * kTwoRoundings,
           .exact_error_from = decoded_rounded}),
      Method::of<DenseInput>(
          {.module = module,
           .name = "relighting a lossless basis",
           .settings = {"half floats in memory", "double sums from the file"},
           .error_norm = norm,
           .truth = sums,
           .exact_error = kTwoRoundings,
           .exact_error_from = rounded}),
  };
}

}  // namespace haarlight::relight
