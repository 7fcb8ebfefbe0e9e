// SPDX-License-Identifier: Apache-2.0
#include "relight/study/cdf53.h"

#include <algorithm>

#include "core/count.h"
#include "haarlight/core/error.h"
#include "relight/study/dyadic_transform.h"

namespace haarlight::relight {

namespace {

class Cdf53Basis final : public LightBasis {
 public:
  explicit Cdf53Basis(const ArrayGrid& grid)
      : grid_(grid), lifting_(Wavelet::cdf53, grid.rows, grid.cols) {
    HAARLIGHT_EXPECTS(grid.n_faces > 0, "a grid of lights");
  }
  [[nodiscard]] int n_lights() const override { return grid_.n_face() * grid_.n_faces; }
  [[nodiscard]] int n_coefficients() const override { return n_lights(); }
  [[nodiscard]] bool is_orthonormal() const override { return n_lights() == 1; }
  void analyse(std::span<const float> lights, std::span<float> coefficients) const override {
    std::copy(lights.begin(), lights.end(), coefficients.begin());
    for_faces(coefficients, [this](std::span<float> face) { lifting_.forward(face, 1, 0, 1); });
  }
  void synthesise(std::span<const float> coefficients, std::span<float> lights) const override {
    std::copy(coefficients.begin(), coefficients.end(), lights.begin());
    for_faces(lights, [this](std::span<float> face) { lifting_.inverse(face, 1, 0, 1); });
  }

 private:
  template <class Work>
  void for_faces(std::span<float> x, const Work& work) const {
    HAARLIGHT_EXPECTS(x.size() % count(n_lights()) == 0, "whole pixels");
    const std::size_t n = count(grid_.n_face());
    for (std::size_t at = 0; at < x.size(); at += n) {
      work(x.subspan(at, n));
    }
  }

  ArrayGrid grid_;
  DyadicTransform lifting_;
};

}  // namespace

std::shared_ptr<const LightBasis> make_cdf53_basis(const ArrayGrid& grid) {
  return std::make_shared<Cdf53Basis>(grid);
}

}  // namespace haarlight::relight
