// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/light_basis.h"

#include <algorithm>
#include <array>
#include <numeric>

#include <fmt/format.h>

#include "core/count.h"
#include "haarlight/core/error.h"
#include "relight/basis/haar_blocks.h"
#include "relight/basis/separable_basis.h"

namespace haarlight::relight {

namespace {

constexpr int kLightsPerGroup = 64;

constexpr auto kKnownBases = std::to_array<KnownBasis>({
    {"haar", "Haar", GridNeed::limited_grids, BasisKind::haar, ""},
    {"haar-standard", "Haar, standard", GridNeed::powers_of_two, BasisKind::haar_standard, ""},
    {"haar-haar", "Haar x Haar of the image", GridNeed::limited_grids, std::nullopt,
     "it transforms the image too: a basis file's tiles transform each pixel's lights only"},
    {"haar-cdf53", "Haar x CDF 5/3 of the image", GridNeed::limited_grids, std::nullopt,
     "it transforms the image too: a basis file's tiles transform each pixel's lights only"},
    {"dct", "DCT", GridNeed::limited_grids, BasisKind::dct, ""},
    {"cdf53", "CDF 5/3", GridNeed::grids, std::nullopt,
     "it is not orthonormal: errors of its coefficients are not errors of the lights, on which "
     "a file's bounds rest"},
    {"sh", "spherical harmonics", GridNeed::none, std::nullopt,
     "it is a projection: what it misses of the light cannot be coded, so that a requested "
     "error may not be achievable"},
    {"pca", "PCA", GridNeed::none, std::nullopt,
     "its patterns are the capture's own: a basis file has no table for them"},
    {"direct", "the lights themselves", GridNeed::none, BasisKind::direct, ""},
});

class DirectBasis final : public FixedBasis {
 public:
  using FixedBasis::FixedBasis;
  void forward(std::span<float>) const override {}
  void forward(std::span<double>) const override {}
  void inverse(std::span<float>) const override {}
  void inverse(std::span<double>) const override {}
  void forward_integers(std::span<std::int64_t>) const override {}
  void inverse_integers(std::span<std::int64_t>) const override {}
};

/// The nonstandard Haar transform of haar.h.
class HaarBasis final : public FixedBasis {
 public:
  HaarBasis(const HaarGrid& grid, int n_lights) : FixedBasis(n_lights), grid_(grid) {}
  void forward(std::span<float> rows) const override { haar_forward_blocks(rows, grid_); }
  void forward(std::span<double> rows) const override { haar_forward_blocks(rows, grid_); }
  void inverse(std::span<float> rows) const override { haar_inverse_blocks(rows, grid_); }
  void inverse(std::span<double> rows) const override { haar_inverse_blocks(rows, grid_); }
  void inverse_at(std::span<const double> row, std::span<const int> lights,
                  std::span<double> values) const override {
    constexpr std::size_t kLevels = 16;  // that the whole inverse costs less than
    if (!grid_.is_plain() || lights.size() * kLevels > row.size()) {
      FixedBasis::inverse_at(row, lights, values);
      return;
    }
    const std::size_t size = count(grid_.size());
    for (std::size_t i = 0; i < lights.size(); ++i) {
      const int in_grid = lights[i] % grid_.size();
      values[i] = haar_inverse_at(row.subspan(count(lights[i] - in_grid), size), grid_,
                                  in_grid / grid_.cols, in_grid % grid_.cols);
    }
  }
  [[nodiscard]] std::vector<int> order() const override {
    return for_each_grid(haar_order(grid_), grid_.size(), n_lights());
  }
  [[nodiscard]] std::vector<int> group_ends() const override {
    return for_each_grid(haar_group_ends(grid_), grid_.size(), n_lights());
  }
  void forward_integers(std::span<std::int64_t> lights) const override {
    s_transform_forward(lights, grid_);
  }
  void inverse_integers(std::span<std::int64_t> coefficients) const override {
    s_transform_inverse(coefficients, grid_);
  }

 private:
  HaarGrid grid_;
};

}  // namespace

FixedBasis::FixedBasis(int n_lights) : n_lights_(n_lights) {
  HAARLIGHT_EXPECTS(n_lights > 0, "lights");
}

void FixedBasis::analyse(std::span<const float> lights, std::span<float> coefficients) const {
  std::copy(lights.begin(), lights.end(), coefficients.begin());
  forward(coefficients);
}

void FixedBasis::synthesise(std::span<const float> coefficients,
                            std::span<float> lights) const {
  std::copy(coefficients.begin(), coefficients.end(), lights.begin());
  inverse(lights);
}

void FixedBasis::inverse_at(std::span<const double> row, std::span<const int> lights,
                            std::span<double> values) const {
  std::vector<double> all(row.begin(), row.end());
  inverse(std::span(all));
  std::transform(lights.begin(), lights.end(), values.begin(),
                 [&all](int light) { return all[count(light)]; });
}

std::vector<int> FixedBasis::order() const {
  std::vector<int> order(count(n_lights_));
  std::iota(order.begin(), order.end(), 0);
  return order;
}

std::vector<int> FixedBasis::group_ends() const {
  std::vector<int> ends;
  for (int end = kLightsPerGroup; end < n_lights_; end += kLightsPerGroup) {
    ends.push_back(end);
  }
  ends.push_back(n_lights_);
  return ends;
}

void FixedBasis::forward_integers(std::span<std::int64_t>) const {
  HAARLIGHT_EXPECTS(false, "a basis with an integer form");
}
void FixedBasis::inverse_integers(std::span<std::int64_t>) const {
  HAARLIGHT_EXPECTS(false, "a basis with an integer form");
}

std::span<const KnownBasis> known_bases() { return kKnownBases; }

const KnownBasis& known_basis(BasisKind kind) {
  const auto* found = std::find_if(kKnownBases.begin(), kKnownBases.end(),
                                   [kind](const KnownBasis& b) { return b.kind == kind; });
  HAARLIGHT_EXPECTS(found != kKnownBases.end(), "a basis of the table");
  return *found;
}

std::string_view grid_words(GridNeed need) {
  switch (need) {
    case GridNeed::none:
      return "no grid";
    case GridNeed::grids:
      return "lights in grids of rows and columns";
    case GridNeed::limited_grids:
      return "lights in grids of rows and columns, at most 1024 of each";
    case GridNeed::powers_of_two:
      return "lights in grids of rows and columns, each a power of two up to 1024";
  }
  return {};
}

std::string missing_grid(GridNeed need, const HaarGrid& grid) {
  if (need == GridNeed::none) {
    return {};
  }
  if (grid.size() <= 0) {
    return "the lights form no grid";
  }
  if (need != GridNeed::grids && !grid.is_valid()) {
    return fmt::format("{} x {} lights: more than 1024 per side", grid.rows, grid.cols);
  }
  if (need == GridNeed::powers_of_two &&
      !(is_haar_size(grid.rows) && is_haar_size(grid.cols))) {
    return fmt::format("{} x {} lights: rows and columns must be powers of two", grid.rows,
                       grid.cols);
  }
  return {};
}

bool is_integer_basis(BasisKind kind) {
  return kind == BasisKind::haar || kind == BasisKind::direct;
}

std::shared_ptr<const FixedBasis> make_basis(BasisKind kind, const HaarGrid& grid,
                                             int n_lights) {
  HAARLIGHT_EXPECTS(
      kind == BasisKind::direct ||
          (missing_grid(known_basis(kind).need, grid).empty() && n_lights % grid.size() == 0),
      "lights in the grids that the basis needs");
  switch (kind) {
    case BasisKind::haar:
      return std::make_shared<HaarBasis>(grid, n_lights);
    case BasisKind::direct:
      return std::make_shared<DirectBasis>(n_lights);
    case BasisKind::haar_standard:
      return make_standard_haar_basis(grid, n_lights);
    case BasisKind::dct:
      return make_dct_basis(grid, n_lights);
  }
  HAARLIGHT_EXPECTS(false, "a basis of the table");
  return nullptr;
}

std::shared_ptr<const FixedBasis> make_basis(const BasisHeader& header) {
  return make_basis(header.basis, header.grid, header.dims.n_lights);
}

}  // namespace haarlight::relight
