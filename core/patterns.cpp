#include "core/patterns.h"

#include <bit>

#include <Eigen/QR>

#include "core/error.h"

namespace haarlight {

PatternMatrix one_at_a_time(int n_lights) {
  HAARLIGHT_EXPECTS(n_lights >= 1, "at least one light");
  return PatternMatrix::Identity(n_lights, n_lights);
}

PatternMatrix bins(int n, int bin) {
  HAARLIGHT_EXPECTS(n >= 1 && bin >= 1 && n % bin == 0, "a bin that divides the grid");
  const int m = n / bin;
  PatternMatrix patterns = PatternMatrix::Zero(Eigen::Index{m} * m, Eigen::Index{n} * n);
  for (int row = 0; row < n; ++row) {
    for (int col = 0; col < n; ++col) {
      patterns((row / bin) * m + col / bin, row * n + col) = 1.0;
    }
  }
  return patterns;
}

bool has_s_matrix(int n) {
  if (n < 3 || n % 4 != 3) {
    return false;
  }
  for (int divisor = 2; divisor * divisor <= n; ++divisor) {
    if (n % divisor == 0) {
      return false;
    }
  }
  return true;
}

PatternMatrix s_matrix(int n_lights) {
  HAARLIGHT_EXPECTS(has_s_matrix(n_lights), "a prime number of lights, 3 mod 4");
  const int n = n_lights;
  // First row: 1 at 0 and at the quadratic residues; the others are its left shifts [Sloane79].
  std::vector<bool> is_lit(static_cast<std::size_t>(n), false);
  for (std::int64_t i = 0; i < n; ++i) {
    is_lit[static_cast<std::size_t>(i * i % n)] = true;
  }
  PatternMatrix patterns(n, n);
  for (int shot = 0; shot < n; ++shot) {
    for (int light = 0; light < n; ++light) {
      patterns(shot, light) = is_lit[static_cast<std::size_t>((shot + light) % n)] ? 1.0 : 0.0;
    }
  }
  return patterns;
}

PatternMatrix haar_signed(int n) {
  HAARLIGHT_EXPECTS(n >= 1 && std::has_single_bit(static_cast<unsigned>(n)), "a power of two");
  PatternMatrix patterns =
      PatternMatrix::Zero(2 * (Eigen::Index{n} * n) - 1, Eigen::Index{n} * n);
  patterns.row(0).setOnes();
  int shot = 1;
  for (int size = n; size >= 2; size /= 2) {
    for (int y0 = 0; y0 < n; y0 += size) {
      for (int x0 = 0; x0 < n; x0 += size) {
        // x-detail, y-detail, diagonal: the signs of one quad of the nonstandard transform.
        for (int kind = 1; kind <= 3; ++kind) {
          for (int y = 0; y < size; ++y) {
            for (int x = 0; x < size; ++x) {
              const int right = x >= size / 2 ? 1 : 0;
              const int low = y >= size / 2 ? 1 : 0;
              const int flips = ((kind & 1) != 0 ? right : 0) + ((kind & 2) != 0 ? low : 0);
              patterns(shot + flips % 2, (y0 + y) * n + x0 + x) = 1.0;
            }
          }
          shot += 2;
        }
      }
    }
  }
  return patterns;
}

Eigen::MatrixXd demultiplex(const PatternMatrix& patterns, const Eigen::MatrixXd& measured) {
  HAARLIGHT_EXPECTS(patterns.rows() == measured.rows(), "one measured row a shot");
  const Eigen::ColPivHouseholderQR<Eigen::MatrixXd> solver(patterns);
  HAARLIGHT_EXPECTS(solver.rank() == patterns.cols(), "patterns that tell the lights apart");
  return solver.solve(measured);
}

}  // namespace haarlight
