// SPDX-License-Identifier: Apache-2.0
#include "relight/shape/cosine_transform.h"

#include <algorithm>
#include <cmath>
#include <complex>
#include <numbers>

#include <unsupported/Eigen/FFT>

#include "core/parallel.h"
#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

using Complex = std::complex<double>;

constexpr int kLargestFactor = 31;  // a larger prime p costs n p in the direct form
constexpr std::size_t kRowsATask = 32;

bool has_large_factor(int n) {
  for (int p = 2; p <= kLargestFactor; ++p) {
    while (n % p == 0) {
      n /= p;
    }
  }
  return n > 1;
}

/// exp(-i pi q / n) with q taken modulo 2 n first, so that large q lose nothing.
Complex root_of_unity(long long q, int n) {
  const double angle = -std::numbers::pi * static_cast<double>(q % (2LL * n)) / n;
  return std::polar(1.0, angle);
}

/// The Fourier transform of one length. One thread.
class Fourier {
 public:
  explicit Fourier(int n) : n_(n) {
    if (!has_large_factor(n)) {
      out_.resize(static_cast<std::size_t>(n));
      return;
    }
    // Bluestein: j k = (j^2 + k^2 - (k - j)^2) / 2 turns the sum into a convolution.
    int m = 1;
    while (m < 2 * n - 1) {
      m *= 2;
    }
    const auto padded = static_cast<std::size_t>(m);
    for (long long j = 0; j < n; ++j) {
      chirp_.push_back(root_of_unity(j * j, n));
    }
    std::vector<Complex> kernel(padded);
    kernel[0] = std::conj(chirp_[0]);
    for (std::size_t j = 1; j < chirp_.size(); ++j) {
      kernel[j] = kernel[padded - j] = std::conj(chirp_[j]);
    }
    kernel_.resize(padded);
    fft_.fwd(kernel_.data(), kernel.data(), m);
    work_.resize(padded);
    out_.resize(padded);
  }

  /// In place; unscaled.
  void forward(std::vector<Complex>& values) {
    if (n_ == 1) {
      return;
    }
    if (chirp_.empty()) {
      fft_.fwd(out_.data(), values.data(), n_);
      values.swap(out_);
      return;
    }
    std::fill(work_.begin(), work_.end(), Complex{});
    for (std::size_t j = 0; j < chirp_.size(); ++j) {
      work_[j] = values[j] * chirp_[j];
    }
    const auto m = static_cast<Eigen::Index>(work_.size());
    fft_.fwd(out_.data(), work_.data(), m);
    for (std::size_t k = 0; k < out_.size(); ++k) {
      out_[k] = std::conj(out_[k] * kernel_[k]);  // conjugated: inverse by forward
    }
    fft_.fwd(work_.data(), out_.data(), m);
    for (std::size_t j = 0; j < chirp_.size(); ++j) {
      values[j] = std::conj(work_[j]) / static_cast<double>(m) * chirp_[j];
    }
  }

  /// In place; scaled by 1 / n.
  void inverse(std::vector<Complex>& values) {
    for (Complex& value : values) {
      value = std::conj(value);
    }
    forward(values);
    for (Complex& value : values) {
      value = std::conj(value) / static_cast<double>(n_);
    }
  }

 private:
  int n_;
  Eigen::FFT<double> fft_;
  std::vector<Complex> chirp_;   ///< empty: the length has small factors only
  std::vector<Complex> kernel_;  ///< transformed
  std::vector<Complex> work_;
  std::vector<Complex> out_;
};

/// Two rows at a time, as real and imaginary part.
class RowPair {
 public:
  explicit RowPair(int n) : fourier_(n), v_(static_cast<std::size_t>(n)) {
    for (int k = 0; k < n; ++k) {
      turn_.push_back(root_of_unity(k, 2 * n));
    }
  }

  void cosine(std::span<double> a, std::span<double> b) {
    const std::size_t n = v_.size();
    for (std::size_t j = 0; 2 * j < n; ++j) {
      v_[j] = {a[2 * j], b[2 * j]};
    }
    for (std::size_t j = 0; 2 * j + 1 < n; ++j) {
      v_[n - 1 - j] = {a[2 * j + 1], b[2 * j + 1]};
    }
    fourier_.forward(v_);
    for (std::size_t k = 0; k < n; ++k) {
      const Complex there = v_[k];
      const Complex back = std::conj(v_[k == 0 ? 0 : n - k]);
      const Complex of_a = 0.5 * (there + back);
      const Complex of_b = Complex(0.0, -0.5) * (there - back);
      a[k] = (of_a * turn_[k]).real();
      b[k] = (of_b * turn_[k]).real();
    }
  }

  void inverse_cosine(std::span<double> a, std::span<double> b) {
    const std::size_t n = v_.size();
    v_[0] = {a[0], b[0]};
    for (std::size_t k = 1; k < n; ++k) {
      const Complex of_a(a[k], -a[n - k]);
      const Complex of_b(b[k], -b[n - k]);
      v_[k] = std::conj(turn_[k]) * (of_a + Complex(0.0, 1.0) * of_b);
    }
    fourier_.inverse(v_);
    for (std::size_t j = 0; 2 * j < n; ++j) {
      a[2 * j] = v_[j].real();
      b[2 * j] = v_[j].imag();
    }
    for (std::size_t j = 0; 2 * j + 1 < n; ++j) {
      a[2 * j + 1] = v_[n - 1 - j].real();
      b[2 * j + 1] = v_[n - 1 - j].imag();
    }
  }

  /// sin(pi (k + 1) (j + 1/2) / n) = (-1)^j cos(pi (n - 1 - k) (j + 1/2) / n)
  void sine(std::span<double> a, std::span<double> b) {
    for (std::size_t j = 1; j < v_.size(); j += 2) {
      a[j] = -a[j];
      b[j] = -b[j];
    }
    cosine(a, b);
    std::reverse(a.begin(), a.end());
    std::reverse(b.begin(), b.end());
  }

 private:
  Fourier fourier_;
  std::vector<Complex> v_;
  std::vector<Complex> turn_;  ///< exp(-i pi k / 2 n)
};

}  // namespace

void transform_rows(std::span<double> values, int height, int width, RowTransform transform) {
  const auto n = static_cast<std::size_t>(width);
  HAARLIGHT_EXPECTS(width > 0 && values.size() == static_cast<std::size_t>(height) * n,
                    "(height, width) values");
  const auto n_pairs = (static_cast<std::size_t>(height) + 1) / 2;
  parallel_for(n_pairs, kRowsATask / 2, [&](std::size_t begin, std::size_t end) {
    RowPair pair(width);
    std::vector<double> spare(n);
    for (std::size_t i = begin; i < end; ++i) {
      const std::span<double> a = values.subspan(2 * i * n, n);
      const bool is_alone = 2 * i + 1 == static_cast<std::size_t>(height);
      std::fill(spare.begin(), spare.end(), 0.0);
      const std::span<double> b =
          is_alone ? std::span<double>(spare) : values.subspan((2 * i + 1) * n, n);
      switch (transform) {
        case RowTransform::cosine:
          pair.cosine(a, b);
          break;
        case RowTransform::inverse_cosine:
          pair.inverse_cosine(a, b);
          break;
        case RowTransform::sine:
          pair.sine(a, b);
          break;
      }
    }
  });
}

std::vector<double> transposed(std::span<const double> values, int height, int width) {
  constexpr std::size_t kBlock = 32;  // 8 kB per block: both sides stay in the L1 cache
  const auto h = static_cast<std::size_t>(height);
  const auto w = static_cast<std::size_t>(width);
  std::vector<double> out(h * w);
  parallel_for(w, kBlock, [&](std::size_t begin, std::size_t end) {
    for (std::size_t y0 = 0; y0 < h; y0 += kBlock) {
      for (std::size_t x = begin; x < end; ++x) {
        for (std::size_t y = y0; y < std::min(y0 + kBlock, h); ++y) {
          out[x * h + y] = values[y * w + x];
        }
      }
    }
  });
  return out;
}

}  // namespace haarlight::relight
