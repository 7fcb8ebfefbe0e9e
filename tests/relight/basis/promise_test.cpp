// SPDX-License-Identifier: Apache-2.0
/// The promise of --max-error over random captures, lights and ways of summing: what is said to
/// be kept is kept, and no picture is further off than its bound.

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <optional>

#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/core/tolerance.h"
#include "haarlight/relight/basis/compress.h"
#include "haarlight/relight/light/light_weights.h"
#include "haarlight/render/light/cubemap.h"
#include "relight/basis/dense_half.h"
#include "relight/basis/prepared_basis.h"
#include "relight/pipeline/relight_choice.h"
#include "relight/pipeline/relight_costs.h"
#include "relight/pipeline/relit_picture.h"
#include "tests/relight/basis/made_stack.h"
#include "tests/session/small_session.h"

namespace haarlight::relight {
namespace {

using test::made_source;
using test::make_stack;

/// Random numbers of one case, in the order in which they are requested.
class Dice {
 public:
  explicit Dice(std::uint64_t seed) : seed_(seed) {}
  double unit() { return uniform_unit(hash_key(seed_, n_++)); }
  double normal() { return standard_normal(hash_key(seed_, n_++)); }
  int below(int n) {
    return static_cast<int>(hash_key(seed_, n_++) % static_cast<unsigned>(n));
  }
  template <class T>
  T one_of(std::initializer_list<T> choices) {
    return *(choices.begin() + below(static_cast<int>(choices.size())));
  }

 private:
  std::uint64_t seed_;
  std::uint64_t n_ = 0;
};

struct Capture {
  MemoryStack stack;
  std::optional<MemoryStack> plate;
  int grid = 0;
};

/// Random captures: a ball over a plane, noise, few bright pixels in the dark, 10^6 to 1,
/// nothing at all; one to six faces, one light to 256.
Capture random_capture(Dice& dice) {
  const int grid = dice.one_of({1, 2, 4, 8, 16});
  const int faces = grid == 16 ? 1 : dice.one_of({1, 1, 2, 6});
  const int n_lights = faces * grid * grid;
  const int width = 1 + dice.below(40);
  const int height = 1 + dice.below(12);
  const int channels = dice.one_of({1, 1, 3});
  const int kind = dice.below(6);
  const double scale = std::pow(10.0, 12.0 * dice.unit() - 6.0);
  const test::MadeScene ground{
      .width = width, .height = height, .grid = grid, .has_sphere = false};
  test::MadeScene ball = ground;
  ball.has_sphere = true;
  Capture capture{MemoryStack({width, height, channels, n_lights}), {}, grid};
  const bool has_plate = kind < 3 && dice.below(2) == 0;
  if (has_plate) {
    capture.plate.emplace(StackDims{width, height, 1, n_lights});
  }
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const double range = std::pow(10.0, -6.0 * dice.unit());
      const bool is_bright = dice.below(20) == 0;
      for (int k = 0; k < n_lights; ++k) {
        if (capture.plate) {
          capture.plate->at(0, y, x, k) =
              static_cast<float>(test::made_value(ground, x, y, k % (grid * grid)));
        }
        for (int c = 0; c < channels; ++c) {
          double value = 0.0;
          if (kind <= 2) {
            value = test::made_value(ball, x, y, k % (grid * grid)) * (1.0 - 0.3 * c);
            value += kind == 2 ? 0.02 * dice.normal() : 0.0;
            value *= kind == 1 ? range : 1.0;
          } else if (kind == 3) {
            value = range * dice.normal();
          } else if (kind == 4) {
            value = is_bright ? dice.unit() : 1e-6 * dice.unit();
          }
          capture.stack.at(c, y, x, k) = static_cast<float>(scale * value);
        }
      }
    }
  }
  return capture;
}

/// Random lights: one, nine, a sky, 10^6 to 1, of both signs, a face, nothing.
LightWeights random_lights(Dice& dice, int n, int channels) {
  const int colours = channels == 3 ? dice.one_of({1, 3}) : dice.one_of({1, 1, 3});
  LightWeights w = LightWeights::Zero(n, colours);
  const int kind = dice.below(8);
  const double scale = std::pow(10.0, 8.0 * dice.unit() - 4.0);
  for (int c = 0; c < colours; ++c) {
    for (int i = 0; i < (kind == 0 ? 1 : kind == 1 ? 9 : 0); ++i) {
      w(dice.below(n), c) = scale;
    }
    for (int k = 0; k < n; ++k) {
      if (kind == 2) {
        w(k, c) = scale * dice.unit();
      } else if (kind == 3) {
        w(k, c) = scale * std::pow(10.0, -6.0 * dice.unit());
      } else if (kind == 4) {
        w(k, c) = scale * dice.normal();
      } else if (kind == 5) {
        w(k, c) = scale * std::pow(dice.unit(), 16.0);
      } else if (kind == 6 && k < n / 2) {
        w(k, c) = scale;
      }
    }
  }
  return w;
}

/// Sums in double, rounded nowhere.
std::vector<double> true_picture(const MemoryStack& stack, const LightWeights& w) {
  const StackDims dims = stack.dims();
  const int channels = std::max(static_cast<int>(w.cols()), dims.channels);
  std::vector<double> picture;
  for (std::size_t p = 0; p < dims.n_pixels(); ++p) {
    for (int c = 0; c < channels; ++c) {
      const std::size_t from = dims.channels == 1 ? 0 : static_cast<std::size_t>(c);
      const float* row = stack.values().data() +
                         (from * dims.n_pixels() + p) * static_cast<std::size_t>(dims.n_lights);
      double sum = 0.0;
      for (int k = 0; k < dims.n_lights; ++k) {
        sum += w(k, w.cols() == 1 ? 0 : c) * double{row[k]};
      }
      picture.push_back(sum);
    }
  }
  return picture;
}

double norm_of(const std::vector<double>& values) {
  double energy = 0.0;
  for (const double v : values) {
    energy += v * v;
  }
  return std::sqrt(energy);
}

/// How often a promise was given, by way of summing.
using Counts = std::map<std::string, int>;

void check(const RelitPicture& relit, const std::vector<double>& truth, double requested,
           const std::string& way, Counts& kept) {
  const double norm = norm_of(truth);
  ASSERT_EQ(relit.picture.pixels().size(), truth.size());
  double energy = 0.0;
  for (std::size_t i = 0; i < truth.size(); ++i) {
    const double off = double{relit.picture.pixels()[i]} - truth[i];
    energy += off * off;
  }
  const double error = std::sqrt(energy);
  // The file's sums are double; their bound leaves out the rounding of the picture to float.
  const double own = relit.method == "file" ? 6.1e-8 * norm : 0.0;
  const RelightBound& bound = relit.bound;
  // 1e-12: this test's own sums.
  EXPECT_LE(error, bound.dropped + bound.coded + bound.rounding + own + 1e-12 * norm) << way;
  if (norm == 0.0) {
    EXPECT_LE(error, bound.dropped + bound.coded + bound.rounding) << way;
    return;
  }
  EXPECT_LE(error / norm, bound.relative_l2 + 6.1e-8) << way;
  if (bound.relative_l2 <= requested) {
    EXPECT_LE(error / norm, requested + own / norm + 1e-12) << way;
    ++kept[way];
  }
}

/// As `haarlight relight --max-error`: one picture after the other from the file, or an animation.
std::vector<RelitPicture> relight_chosen(const BasisFile& basis,
                                         const std::vector<LightWeights>& lights,
                                         double max_error, bool is_in_passing) {
  std::vector<RelitPicture> pictures;
  const std::size_t n = is_in_passing ? 1 : lights.size();
  for (std::size_t first = 0; first < lights.size(); first += n) {
    const auto some = std::span(lights).subspan(first, n);
    const RelightChoice choice =
        choose_within_error(predict_costs(basis, some,
                                          {.is_in_passing = is_in_passing,
                                           .may_be_halved = max_error >= kHalfError,
                                           .at_once = n}),
                            max_error);
    const Relighter relighter(basis, {.use = RelighterPlan::Use::frames,
                                      .n_frames = static_cast<int>(n),
                                      .max_error = max_error,
                                      .form = choice.form});
    for (RelitPicture& picture :
         relighter.relight(some, {.max_error = max_error, .terms_each = choice.terms})) {
      pictures.push_back(std::move(picture));
    }
  }
  return pictures;
}

/// As `haarlight relight --frames N --seconds T`.
std::vector<RelitPicture> relight_in_seconds(const BasisFile& basis,
                                             const std::vector<LightWeights>& lights,
                                             double seconds) {
  const RelightChoice choice = choose_within_seconds(
      predict_costs(basis, lights, {.is_in_passing = false, .at_once = lights.size()}),
      seconds);
  const Relighter relighter(basis, {.use = RelighterPlan::Use::frames,
                                    .n_frames = static_cast<int>(lights.size()),
                                    .form = choice.form});
  return relighter.relight(lights, {.terms_each = choice.terms});
}

TEST(Promise, HoldsOnTwoHundredRandomCapturesLightsAndWays) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "case.hlb";
  Counts kept;
  std::map<BasisKind, int> kinds;
  for (std::uint64_t i_case = 0; i_case < 200; ++i_case) {
    SCOPED_TRACE(testing::Message() << "case " << i_case);
    Dice dice(hash_key(20, i_case));
    const Capture capture = random_capture(dice);
    const StackDims dims = capture.stack.dims();
    CompressOptions options;
    options.relative_l2 = dice.one_of({0.05, 0.01, 1e-3, 1e-4, 1e-6, 0.0});
    options.worst_pixel = dice.one_of<double>({INFINITY, INFINITY, 0.1});
    const bool is_direct = dice.below(5) == 0;
    options.basis = is_direct         ? BasisKind::direct
                    : i_case % 4 == 1 ? BasisKind::dct
                    : i_case % 4 == 3 ? BasisKind::haar_standard
                                      : BasisKind::haar;
    ++kinds[options.basis];
    (void)compress_stack(made_source(capture.stack, is_direct ? 0 : capture.grid,
                                     capture.plate ? &*capture.plate : nullptr),
                         file, options);
    const BasisFile basis = BasisFile::open(file);
    std::vector<LightWeights> lights;
    std::vector<std::vector<double>> truths;
    for (int e = 0; e < 3; ++e) {
      lights.push_back(random_lights(dice, dims.n_lights, dims.channels));
      truths.push_back(true_picture(capture.stack, lights.back()));
    }
    const double requested = dice.one_of({0.1, 0.02, 0.01, 2e-3, 1e-4, 0.0});
    std::vector<RelightOptions> modes = {{}, {.max_error = requested}};
    const int terms = dice.one_of({0, 1, 16, 100});
    const auto run = [&](const std::string& way, const auto& relight_all) {
      const auto pictures = relight_all();
      for (std::size_t e = 0; e < lights.size(); ++e) {
        check(pictures[e], truths[e], requested, way, kept);
      }
    };
    for (const RelightOptions& mode : modes) {
      run("file", [&] { return relight(basis, lights, mode); });
      const PreparedBasis dense(basis, {.form = PreparedForm::dense});
      run("prepared, dense", [&] { return dense.relight(lights, mode); });
    }
    for (const bool is_in_passing : {true, false}) {
      run(is_in_passing ? "chosen, file" : "chosen, any",
          [&] { return relight_chosen(basis, lights, requested, is_in_passing); });
    }
    run("chosen, seconds",
        [&] { return relight_in_seconds(basis, lights, 1e-4 * dice.unit()); });
    run("file, K terms", [&] { return relight(basis, lights, {.terms = terms}); });
    const DenseHalf half(capture.stack, "case");
    run("dense half", [&] { return half.relight(lights); });
    if (basis.header().coding != BasisCoding::quantised) {
      continue;
    }
    for (const double bound_products : {4e9, 0.0}) {
      const PreparedBasis sparse(
          basis, {.form = PreparedForm::sparse, .bound_products = bound_products});
      modes.push_back({.terms = terms});
      modes.push_back({.terms = terms, .order = TermOrder::light});
      for (const RelightOptions& mode : modes) {
        run("rows", [&] {
          return sparse.relight(lights, mode, {.method = RelightMethod::sparse_rows});
        });
        run("lists", [&] {
          return sparse.relight(lights, mode, {.method = RelightMethod::coefficient_lists});
        });
        run("portable",
            [&] { return sparse.relight(lights, mode, {.code = KernelCode::portable}); });
      }
    }
  }
  // A promise that is never given is never broken: most must be.
  for (const auto& [way, n] : kept) {
    EXPECT_GT(n, 60) << way;
  }
  EXPECT_EQ(kept.size(), 10U);
  for (const BasisKind kind :
       {BasisKind::haar, BasisKind::direct, BasisKind::haar_standard, BasisKind::dct}) {
    EXPECT_GT(kinds[kind], 20);
  }
}

/// The nine lights of the published trap: by |l| alone the finest details, which carry little,
/// come before the mean.
TEST(Promise, NineLightsDoNotTrapAnyDefault) {
  constexpr int kLights = 1024;
  const MemoryStack& stack = make_stack({.width = 24, .height = 20, .grid = 32});
  const MemoryStack& plate =
      make_stack({.width = 24, .height = 20, .grid = 32, .has_sphere = false});
  LightWeights w = LightWeights::Zero(kLights, 1);
  for (const int k : {165, 176, 186, 517, 528, 538, 837, 848, 858}) {
    w(k, 0) = 1.0;
  }
  const Image<float> truth = relight_stack(stack, w);
  const auto error = [&](const RelitPicture& relit) {
    return compare(relit.picture.pixels(), truth.pixels()).relative_l2;
  };
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "nine.hlb";
  // The trap is there: 79 % with 16 terms.
  (void)compress_stack(made_source(stack, 32), file, {.relative_l2 = 1e-3});
  const BasisFile bare = BasisFile::open(file);
  EXPECT_GT(error(relight(bare, w, {.terms = 16, .order = TermOrder::light})), 0.7);
  for (const StackSource* used :
       {static_cast<const StackSource*>(nullptr), static_cast<const StackSource*>(&plate)}) {
    for (const double coded : {CompressOptions{}.relative_l2, 1e-3, 0.0}) {
      (void)compress_stack(made_source(stack, 32, used), file, {.relative_l2 = coded});
      const BasisFile basis = BasisFile::open(file);
      const PreparedBasis prepared(basis);
      const std::vector<LightWeights> all = {w};
      EXPECT_LE(error(relight(basis, w)), 1.01 * CompressOptions{}.relative_l2);
      EXPECT_LE(error(prepared.relight(all).front()), 1.01 * CompressOptions{}.relative_l2);
      // Sixteen terms in the default order.
      EXPECT_LT(error(relight(basis, w, {.terms = 16})), 0.1);
      if (prepared.form() == PreparedForm::sparse) {
        EXPECT_LT(error(prepared.relight(all, {.terms = 16}).front()), 0.1);
      }
      for (const double requested : {0.1, 0.02}) {
        EXPECT_LE(error(relight(basis, w, {.max_error = requested})), requested);
        EXPECT_LE(error(prepared.relight(all, {.max_error = requested}).front()), requested);
      }
    }
  }
}

TEST(Promise, HoldsForSkiesOfOneTexelAndOfNone) {
  const Rig rig = read_rig("configs/rigs/cube32.toml");
  const MemoryStack& stack = make_stack({.width = 24, .height = 20, .grid = 32});
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "texel.hlb";
  (void)compress_stack(made_source(stack, 32), file, {.relative_l2 = 1e-3});
  const BasisFile basis = BasisFile::open(file);
  const PreparedBasis prepared(basis);
  const DenseHalf half(stack, "made");
  int n_lit = 0;
  Counts kept;
  for (int row = 0; row < 8; ++row) {
    Image<float> sky(64, 128, 1);
    if (row > 0) {
      sky(row, 17 * row) = 1e6F;
    }
    const LightWeights w =
        rig_weights(render::Environment::from_picture(std::move(sky), "sky"), rig).weights;
    n_lit += w.cwiseAbs().maxCoeff() > 0.0 ? 1 : 0;
    const std::vector<double> truth = true_picture(stack, w);
    const std::vector<LightWeights> all = {w};
    check(relight(basis, w, {.max_error = 0.01}), truth, 0.01, "file", kept);
    check(prepared.relight(all, {.max_error = 0.01}).front(), truth, 0.01, "prepared", kept);
    check(half.relight(all).front(), truth, 0.01, "dense half", kept);
  }
  EXPECT_GE(n_lit, 5);
  for (const auto& [way, n] : kept) {
    EXPECT_EQ(n, n_lit) << way;
  }
}

}  // namespace
}  // namespace haarlight::relight
