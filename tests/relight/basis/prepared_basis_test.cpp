// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/prepared_basis.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <memory>
#include <span>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/parallel.h"
#include "core/random.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/tolerance.h"
#include "haarlight/relight/basis/compress.h"
#include "tests/relight/basis/file_bytes.h"
#include "tests/relight/basis/made_stack.h"
#include "tests/session/small_session.h"

namespace haarlight::relight {
namespace {

using test::made_source;
using test::make_stack;

constexpr int kLights = 256;

class Prepared : public testing::Test {
 protected:
  static void SetUpTestSuite() { shared_folder = std::make_unique<test::TemporaryFolder>(); }
  static void TearDownTestSuite() { shared_folder.reset(); }

  static BasisFile compressed(const std::string& name, const MemoryStack& stack,
                              const CompressOptions& options = {}, int grid = 16,
                              const StackSource* plate = nullptr) {
    const auto file = file_of(name);
    if (!std::filesystem::exists(file)) {
      (void)compress_stack(made_source(stack, grid, plate), file, options);
    }
    return BasisFile::open(file);
  }
  static std::filesystem::path file_of(const std::string& name) {
    return shared_folder->path() / name;
  }
  static BasisFile with_plate() {
    return compressed("plate.hlb", make_stack({}), {.relative_l2 = 1e-3}, 16,
                      &make_stack({.has_sphere = false}));
  }

 private:
  static inline std::unique_ptr<test::TemporaryFolder> shared_folder;
};

LightWeights one_light(int k) {
  LightWeights w = LightWeights::Zero(kLights, 1);
  w(k, 0) = 1.0;
  return w;
}

LightWeights sky(std::uint64_t seed, int colours = 1) {
  LightWeights w(kLights, colours);
  for (int k = 0; k < kLights; ++k) {
    for (int c = 0; c < colours; ++c) {
      w(k, c) = std::pow(uniform_unit(hash_key(seed, static_cast<std::uint64_t>(k),
                                               static_cast<std::uint64_t>(c))),
                         8.0);
    }
  }
  return w;
}

RelitPicture relit(const PreparedBasis& basis, const LightWeights& w,
                   const RelightOptions& options = {}, PreparedRun run = {}) {
  return std::move(basis.relight(std::span(&w, 1), options, std::move(run)).front());
}

bool is_same(const Image<float>& a, const Image<float>& b) {
  return std::equal(a.pixels().begin(), a.pixels().end(), b.pixels().begin(), b.pixels().end());
}

double distance(const Image<float>& a, const Image<float>& b) {
  double energy = 0.0;
  for (std::size_t i = 0; i < a.pixels().size(); ++i) {
    const double d = double{a.pixels()[i]} - double{b.pixels()[i]};
    energy += d * d;
  }
  return std::sqrt(energy);
}

TEST_F(Prepared, IsTheFilesPictureToTheRoundingOfFloats) {
  const BasisFile file = with_plate();
  for (const PreparedForm form : {PreparedForm::sparse, PreparedForm::dense}) {
    const PreparedBasis basis(file, {.form = form});
    for (const LightWeights& w : {one_light(100), sky(1), sky(2, 3)}) {
      const RelitPicture exact = relight(file, w);
      const RelitPicture fast = relit(basis, w);
      EXPECT_EQ(fast.picture.channels(), exact.picture.channels());
      const double storage =
          form == PreparedForm::dense ? fast.bound.coded - exact.bound.coded : 0.0;
      EXPECT_LE(distance(fast.picture, exact.picture),
                fast.bound.rounding + storage + 1e-7 * exact.bound.picture_norm);
      EXPECT_LT(fast.bound.rounding, 1e-4 * exact.bound.picture_norm);
    }
  }
}

TEST_F(Prepared, RowsAndListsAloneAndInBatchesGiveTheSameBitsOnAnyThreads) {
  const BasisFile file = with_plate();
  const PreparedBasis basis(file);
  ASSERT_EQ(basis.form(), PreparedForm::sparse);
  std::vector<LightWeights> all = {one_light(3), sky(1), sky(2, 3), one_light(200)};
  for (std::uint64_t e = 0; e < 8; ++e) {
    all.push_back(sky(10 + e));
  }
  const auto first = basis.relight(all);
  for (const int threads : {1, 2, 7}) {
    const ThreadLimit limit(threads);
    for (const RelightMethod method :
         {RelightMethod::sparse_rows, RelightMethod::coefficient_lists}) {
      for (const KernelCode code : {KernelCode::portable, best_kernel_code()}) {
        const auto batch = basis.relight(all, {}, {method, code, {}});
        for (std::size_t e = 0; e < all.size(); ++e) {
          EXPECT_TRUE(is_same(batch[e].picture, first[e].picture));
          EXPECT_EQ(batch[e].method, to_string(method));
          EXPECT_TRUE(
              is_same(relit(basis, all[e], {}, {method, code, {}}).picture, first[e].picture));
        }
      }
    }
  }
}

TEST_F(Prepared, FewLightsTakeListsAndManyTakeRows) {
  const PreparedBasis basis(with_plate());
  const RelitPicture one = relit(basis, one_light(100));
  const RelitPicture many = relit(basis, sky(3));
  EXPECT_EQ(one.method, "coefficient lists");
  EXPECT_EQ(many.method, "sparse rows");
  EXPECT_LT(one.bytes_read, many.bytes_read / 2);
}

TEST_F(Prepared, KIsEverythingBetweenNothingAndAll) {
  const BasisFile file = with_plate();
  const PreparedBasis basis(file);
  const LightWeights w = sky(4);
  EXPECT_EQ(relit(basis, w, {.terms = 0}).terms, 0);
  EXPECT_LE(
      distance(relit(basis, w, {.terms = 0}).picture, relight(file, w, {.terms = 0}).picture),
      relit(basis, w, {.terms = 0}).bound.rounding * 1.01);
  const RelitPicture all = relit(basis, w);
  const RelitPicture more = relit(basis, w, {.terms = 5000});
  EXPECT_EQ(more.terms, all.terms_all);
  EXPECT_TRUE(is_same(more.picture, all.picture));
}

TEST_F(Prepared, SharperBoundHoldsForEveryKAndIsNeverTheLooserOne) {
  const BasisFile file = with_plate();
  const PreparedBasis basis(file);
  ASSERT_TRUE(basis.has_sharp_bound());
  const PreparedBasis plain(file, {.bound_products = 0.0});
  ASSERT_FALSE(plain.has_sharp_bound());
  for (const LightWeights& w : {sky(5), sky(6, 3), one_light(77)}) {
    const RelitPicture whole = relight(file, w);
    for (const int terms : {0, 1, 3, 10, 30, 100, 200}) {
      const RelitPicture sharp = relit(basis, w, {.terms = terms});
      const RelitPicture loose = relit(plain, w, {.terms = terms});
      EXPECT_LE(sharp.bound.dropped, loose.bound.dropped);
      const double off = distance(sharp.picture, whole.picture);
      EXPECT_LE(off,
                sharp.bound.dropped + sharp.bound.rounding + 1e-7 * whole.bound.picture_norm);
      // It is the norm itself but for rounding and, in colour, nothing else.
      EXPECT_GE(off * 1.02 + 1e-6 * whole.bound.picture_norm, sharp.bound.dropped);
    }
  }
}

TEST_F(Prepared, SharperBoundTakesFewerTerms) {
  const BasisFile file = with_plate();
  const PreparedBasis basis(file);
  const LightWeights w = sky(7);
  const RelitPicture sharp = relit(basis, w, {.max_error = 0.02});
  EXPECT_LE(sharp.bound.relative_l2, 0.02);
  // The same file without its bound on dropped terms: the triangle inequality is left.
  const std::string bytes =
      test::with_header(read_file(file_of("plate.hlb")), [](const std::string& header) {
        return test::replace(header, "\"term_bound\"", "\"not_known\"");
      });
  const BasisFile plain =
      BasisFile::from_bytes(std::as_bytes(std::span(bytes.data(), bytes.size())), "plain.hlb");
  const RelitPicture loose = relight(plain, w, {.max_error = 0.02});
  EXPECT_LT(2 * sharp.terms, loose.terms);
  // The file's own bound: between the two.
  const RelitPicture stored = relight(file, w, {.max_error = 0.02});
  EXPECT_LE(stored.bound.relative_l2, 0.02);
  EXPECT_LE(sharp.terms, stored.terms);
  EXPECT_LT(stored.terms, loose.terms);
}

TEST_F(Prepared, ValuesBeyondSixteenBitsAreExact) {
  // A step so small that whole numbers leave 16 bits: split in two.
  const BasisFile file = compressed("fine.hlb", make_stack({}), {.relative_l2 = 2e-7});
  ASSERT_EQ(file.header().coding, BasisCoding::quantised);
  const PreparedBasis basis(file, {.form = PreparedForm::sparse});
  for (const LightWeights& w : {one_light(9), sky(8)}) {
    const RelitPicture fast = relit(basis, w);
    const RelitPicture exact = relight(file, w);
    EXPECT_LE(distance(fast.picture, exact.picture), fast.bound.rounding);
    for (const int terms : {5, 50}) {
      const RelitPicture few = relit(basis, w, {.terms = terms});
      EXPECT_LE(distance(few.picture, exact.picture),
                few.bound.dropped + few.bound.rounding + 1e-7 * exact.bound.picture_norm);
    }
  }
}

TEST_F(Prepared, PixelsWithStepsOfTheirOwnAreRight) {
  const BasisFile file =
      compressed("dark.hlb", make_stack({}), {.relative_l2 = 0.02, .worst_pixel = 0.01});
  const PreparedBasis basis(file, {.form = PreparedForm::sparse});
  const RelitPicture fast = relit(basis, sky(9));
  EXPECT_LE(distance(fast.picture, relight(file, sky(9)).picture), fast.bound.rounding);
}

TEST_F(Prepared, FormIsChosenByTheFile) {
  EXPECT_EQ(PreparedBasis(compressed("percent.hlb", make_stack({}), {}, 16,
                                     &make_stack({.has_sphere = false})))
                .form(),
            PreparedForm::sparse);
  const BasisFile exact = compressed("exact.hlb", make_stack({}), {.relative_l2 = 0.0});
  EXPECT_EQ(PreparedBasis(exact).form(), PreparedForm::dense);
  EXPECT_THROW(PreparedBasis(exact, {.form = PreparedForm::sparse}), Error);
  EXPECT_THROW(PreparedBasis(exact, {.memory_bytes = 1000}), Error);
  EXPECT_THROW(PreparedBasis(with_plate(), {.memory_bytes = 1000}), Error);
  const PreparedBasis dense(exact);
  EXPECT_THROW((void)relit(dense, sky(1), {.terms = 4}), Error);
  // What the half floats lose is told: an exact file does not make an exact picture.
  EXPECT_GT(relit(dense, sky(1), {.max_error = 0.0}).bound.relative_l2, 0.0);
  EXPECT_LT(relit(dense, sky(1)).bound.relative_l2, 1e-3);
}

TEST_F(Prepared, UnlitFacesOfSixAreNotRead) {
  const MemoryStack& one = make_stack({.width = 33, .height = 9, .grid = 8});
  MemoryStack stack({33, 9, 1, 6 * 64});
  for (int face = 0; face < 6; ++face) {
    for (int y = 0; y < 9; ++y) {
      for (int x = 0; x < 33; ++x) {
        for (int k = 0; k < 64; ++k) {
          stack.at(0, y, x, face * 64 + k) =
              one.values()[(static_cast<std::size_t>(y * 33 + x)) * 64 +
                           static_cast<std::size_t>(k)] *
              static_cast<float>(1 + face);
        }
      }
    }
  }
  const BasisFile file = compressed("six.hlb", stack, {.relative_l2 = 1e-3}, 8);
  const PreparedBasis basis(file, {.form = PreparedForm::sparse});
  LightWeights w = LightWeights::Zero(384, 1);
  for (int k = 0; k < 64; ++k) {
    w(2 * 64 + k, 0) = uniform_unit(hash_key(1, static_cast<std::uint64_t>(k)));
  }
  const RelitPicture face = relit(basis, w);
  const RelitPicture all = relit(basis, LightWeights(LightWeights::Random(384, 1)));
  EXPECT_EQ(face.method, "coefficient lists");
  EXPECT_LT(face.bytes_read, all.bytes_read / 4);
  EXPECT_LE(distance(face.picture, relight(file, w).picture),
            face.bound.rounding + 1e-7 * face.bound.picture_norm);
  const RelitPicture few = relit(basis, w, {.max_error = 0.05});
  EXPECT_LE(few.bound.relative_l2, 0.05);
  EXPECT_LE(compare(few.picture.pixels(), relight_stack(stack, w).pixels()).relative_l2, 0.05);
}

TEST_F(Prepared, WrongWeightsAreRefused) {
  const PreparedBasis basis(with_plate());
  EXPECT_THROW((void)relit(basis, LightWeights::Zero(100, 1)), Error);
  EXPECT_THROW((void)relit(basis, LightWeights(one_light(3) * NAN)), ContractViolation);
}

}  // namespace
}  // namespace haarlight::relight
