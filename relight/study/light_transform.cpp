// SPDX-License-Identifier: Apache-2.0
#include "relight/study/light_transform.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include <Eigen/Core>

#include "core/count.h"
#include "haarlight/core/error.h"
#include "haarlight/relight/basis/haar.h"
#include "relight/study/dyadic_transform.h"

namespace haarlight::relight {

namespace {

bool is_power_of_two(int n) { return n > 0 && (n & (n - 1)) == 0; }

class DirectTransform final : public LightTransform {
 public:
  explicit DirectTransform(int n_lights) : n_lights_(n_lights) {}
  [[nodiscard]] int n_lights() const override { return n_lights_; }
  [[nodiscard]] int n_coefficients() const override { return n_lights_; }
  void analyse(std::span<const float> lights, std::span<float> coefficients) const override {
    std::copy(lights.begin(), lights.end(), coefficients.begin());
  }
  void synthesise(std::span<const float> coefficients, std::span<float> lights) const override {
    std::copy(coefficients.begin(), coefficients.end(), lights.begin());
  }

 private:
  int n_lights_;
};

/// A transform of each face separately, in place.
class FaceTransform : public LightTransform {
 public:
  explicit FaceTransform(const ArrayGrid& grid) : grid_(grid) {
    HAARLIGHT_EXPECTS(grid.rows > 0 && grid.cols > 0 && grid.n_faces > 0, "a grid of lights");
  }
  [[nodiscard]] int n_lights() const override { return grid_.n_face() * grid_.n_faces; }
  [[nodiscard]] int n_coefficients() const override { return n_lights(); }
  void analyse(std::span<const float> lights, std::span<float> coefficients) const override {
    std::copy(lights.begin(), lights.end(), coefficients.begin());
    for_faces(coefficients, [this](std::span<float> face) { forward(face); });
  }
  void synthesise(std::span<const float> coefficients, std::span<float> lights) const override {
    std::copy(coefficients.begin(), coefficients.end(), lights.begin());
    for_faces(lights, [this](std::span<float> face) { inverse(face); });
  }

 protected:
  virtual void forward(std::span<float> face) const = 0;
  virtual void inverse(std::span<float> face) const = 0;
  [[nodiscard]] const ArrayGrid& grid() const { return grid_; }

 private:
  template <class Work>
  void for_faces(std::span<float> x, Work work) const {
    HAARLIGHT_EXPECTS(x.size() % count(n_lights()) == 0, "whole pixels");
    const std::size_t n = count(grid_.n_face());
    for (std::size_t at = 0; at < x.size(); at += n) {
      work(x.subspan(at, n));
    }
  }

  ArrayGrid grid_;
};

/// haar.h of all faces of all pixels.
class NonstandardHaar final : public LightTransform {
 public:
  explicit NonstandardHaar(const ArrayGrid& grid)
      : grid_{grid.rows, grid.cols}, n_faces_(grid.n_faces) {
    HAARLIGHT_EXPECTS(grid_.is_valid() && n_faces_ > 0,
                      "a grid of lights of up to 1024 per side");
  }
  [[nodiscard]] int n_lights() const override { return grid_.size() * n_faces_; }
  [[nodiscard]] int n_coefficients() const override { return n_lights(); }
  void analyse(std::span<const float> lights, std::span<float> coefficients) const override {
    std::copy(lights.begin(), lights.end(), coefficients.begin());
    haar_forward(coefficients, grid_);
  }
  void synthesise(std::span<const float> coefficients, std::span<float> lights) const override {
    std::copy(coefficients.begin(), coefficients.end(), lights.begin());
    haar_inverse(lights, grid_);
  }

 private:
  HaarGrid grid_;
  int n_faces_;
};

constexpr auto kHalf = static_cast<float>(1.0 / std::numbers::sqrt2);

/// All levels along one line of n = 2^m points: sums first, then details.
void haar_line(float* x, std::size_t stride, int n, std::vector<float>& old) {
  for (int length = n; length > 1; length /= 2) {
    for (int i = 0; i < length; ++i) {
      old[count(i)] = x[stride * count(i)];
    }
    for (int i = 0; i < length / 2; ++i) {
      x[stride * count(i)] = kHalf * (old[count(2 * i)] + old[count(2 * i + 1)]);
      x[stride * count(length / 2 + i)] = kHalf * (old[count(2 * i)] - old[count(2 * i + 1)]);
    }
  }
}

void unhaar_line(float* x, std::size_t stride, int n, std::vector<float>& old) {
  for (int length = 2; length <= n; length *= 2) {
    for (int i = 0; i < length; ++i) {
      old[count(i)] = x[stride * count(i)];
    }
    for (int i = 0; i < length / 2; ++i) {
      x[stride * count(2 * i)] = kHalf * (old[count(i)] + old[count(length / 2 + i)]);
      x[stride * count(2 * i + 1)] = kHalf * (old[count(i)] - old[count(length / 2 + i)]);
    }
  }
}

class StandardHaar final : public FaceTransform {
 public:
  explicit StandardHaar(const ArrayGrid& grid) : FaceTransform(grid) {
    HAARLIGHT_EXPECTS(is_power_of_two(grid.rows) && is_power_of_two(grid.cols), "a Haar grid");
  }

 protected:
  void forward(std::span<float> face) const override { work(face, haar_line); }
  void inverse(std::span<float> face) const override { work(face, unhaar_line); }

 private:
  template <class LineWork>
  void work(std::span<float> face, LineWork line) const {
    const int rows = grid().rows;
    const int cols = grid().cols;
    std::vector<float> old(count(std::max(rows, cols)));
    for (int y = 0; y < rows; ++y) {
      line(face.data() + count(y) * count(cols), 1, cols, old);
    }
    for (int x = 0; x < cols; ++x) {
      line(face.data() + x, count(cols), rows, old);
    }
  }
};

using Matrix = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// C[i][k] = a_i cos(pi (2 k + 1) i / (2 n)), a_0 = sqrt(1/n), a_i = sqrt(2/n).
Matrix dct_matrix(int n) {
  Matrix c(n, n);
  for (int i = 0; i < n; ++i) {
    const double a = std::sqrt((i == 0 ? 1.0 : 2.0) / n);
    for (int k = 0; k < n; ++k) {
      c(i, k) =
          static_cast<float>(a * std::cos(std::numbers::pi * (2.0 * k + 1.0) * i / (2.0 * n)));
    }
  }
  return c;
}

class Dct final : public FaceTransform {
 public:
  explicit Dct(const ArrayGrid& grid)
      : FaceTransform(grid),
        over_rows_(dct_matrix(grid.rows)),
        over_cols_(dct_matrix(grid.cols)) {}

 protected:
  void forward(std::span<float> face) const override {
    Eigen::Map<Matrix> x(face.data(), grid().rows, grid().cols);
    const Matrix half = x * over_cols_.transpose();
    x.noalias() = over_rows_ * half;
  }
  void inverse(std::span<float> face) const override {
    Eigen::Map<Matrix> x(face.data(), grid().rows, grid().cols);
    const Matrix half = x * over_cols_;
    x.noalias() = over_rows_.transpose() * half;
  }

 private:
  Matrix over_rows_;
  Matrix over_cols_;
};

class Cdf53 final : public FaceTransform {
 public:
  explicit Cdf53(const ArrayGrid& grid)
      : FaceTransform(grid), lifting_(Wavelet::cdf53, grid.rows, grid.cols) {}
  [[nodiscard]] bool is_orthonormal() const override { return n_lights() == 1; }

 protected:
  void forward(std::span<float> face) const override { lifting_.forward(face, 1, 0, 1); }
  void inverse(std::span<float> face) const override { lifting_.inverse(face, 1, 0, 1); }

 private:
  DyadicTransform lifting_;
};

}  // namespace

std::unique_ptr<LightTransform> make_direct_transform(int n_lights) {
  HAARLIGHT_EXPECTS(n_lights > 0, "lights");
  return std::make_unique<DirectTransform>(n_lights);
}

std::unique_ptr<LightTransform> make_haar_transform(const ArrayGrid& grid, bool is_standard) {
  if (is_standard) {
    return std::make_unique<StandardHaar>(grid);
  }
  return std::make_unique<NonstandardHaar>(grid);
}

std::unique_ptr<LightTransform> make_dct_transform(const ArrayGrid& grid) {
  return std::make_unique<Dct>(grid);
}

std::unique_ptr<LightTransform> make_cdf53_transform(const ArrayGrid& grid) {
  return std::make_unique<Cdf53>(grid);
}

}  // namespace haarlight::relight
