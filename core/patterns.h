#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>

/// @file
/// Sets of lights shown together: used to shoot, and to recover single-light pictures
/// afterwards. A pattern is a weight a light in [0, 1]; the measured picture is the weighted
/// sum of the lights' pictures. Pure.

namespace haarlight {

/// One row a shot, one column a light.
using PatternMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

enum class PatternFamily { one_at_a_time, bins, s_matrix, haar };

/// The identity.
[[nodiscard]] PatternMatrix one_at_a_time(int n_lights);

/// Blocks of `bin` x `bin` lights of an n x n grid lit together, (n/bin)^2 shots.
/// @param bin  divides n
[[nodiscard]] PatternMatrix bins(int n, int bin);

/// The S-matrix of order n_lights [Sloane79]: rows of 0 and 1 with (n + 1)/2 ones, from the
/// quadratic residues of the prime n, n = 3 mod 4.
/// @throws ContractViolation  for any other n
[[nodiscard]] PatternMatrix s_matrix(int n_lights);
/// True when s_matrix(n) exists.
[[nodiscard]] bool has_s_matrix(int n);

/// The positive and the negative parts of the 2-D nonstandard Haar basis of an n x n grid,
/// scaled to full drive: the first shot is all lights, then two shots a wavelet.
/// @param n  a power of two
[[nodiscard]] PatternMatrix haar_signed(int n);

/// Single-light pictures from measured ones: least squares by the pseudo-inverse of the
/// patterns.
/// @param patterns  (shots, lights), full column rank
/// @param measured  (shots, pixels)
/// @return          (lights, pixels)
/// @throws ContractViolation  when the patterns cannot tell the lights apart
[[nodiscard]] Eigen::MatrixXd demultiplex(const PatternMatrix& patterns,
                                          const Eigen::MatrixXd& measured);

}  // namespace haarlight
