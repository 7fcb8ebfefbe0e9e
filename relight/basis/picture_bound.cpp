// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/picture_bound.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/count.h"
#include "relight/basis/error_gram.h"

namespace haarlight::relight {

namespace {

// For the bound on the coding error: vectors per block, and the fraction of the file they may
// take at about 1.5 bytes per number.
constexpr int kLightsPerVector = 32;
constexpr double kVectorFraction = 0.125;
constexpr double kVectorBytes = 1.5;

}  // namespace

float round_up(double v) {
  const auto f = static_cast<float>(v);
  return double{f} < v ? std::nextafter(f, std::numeric_limits<float>::infinity()) : f;
}

PictureBound fit_picture_bound(const BasisHeader& header, std::span<const double> products,
                               std::span<const float> all_norms, std::span<const double> rests,
                               double block_bytes) {
  PictureBound bound;
  const int n_lights = header.dims.n_lights;
  const double room = kVectorFraction * block_bytes / kVectorBytes;
  const int fit = static_cast<int>(room / (double(header.dims.channels) * n_lights));
  bound.n_vectors = std::clamp(std::min(n_lights, kGramBlock) / kLightsPerVector, 0, fit);
  const std::vector<int> order = coefficient_order(header);
  bound.vectors.resize(count(header.dims.channels) * count(bound.n_vectors) * count(n_lights));
  std::size_t from = 0;
  for (int c = 0; c < header.dims.channels; ++c) {
    for (int begin = 0; begin < n_lights; begin += kGramBlock) {
      const std::size_t n = count(std::min(kGramBlock, n_lights - begin));
      std::vector<float> norms(n);
      for (std::size_t i = 0; i < n; ++i) {
        norms[i] = all_norms[count(c) * count(n_lights) + count(order[count(begin) + i])];
      }
      const std::size_t n_products = n * (n + 1) / 2;
      const ProductBound part =
          fit_product_bound(products.subspan(from, n_products), norms,
                            std::min(bound.n_vectors, static_cast<int>(n)));
      from += n_products;
      bound.fractions.push_back(part.fraction);
      bound.rests.push_back(static_cast<float>(round_up(rests[count(c)])));
      for (std::size_t j = 0; j * n < part.vectors.size(); ++j) {
        std::copy_n(
            part.vectors.begin() + static_cast<std::ptrdiff_t>(j * n), n,
            bound.vectors.begin() +
                static_cast<std::ptrdiff_t>(
                    (count(c) * count(bound.n_vectors) + j) * count(n_lights) + count(begin)));
      }
    }
  }
  return bound;
}

}  // namespace haarlight::relight
