// SPDX-License-Identifier: Apache-2.0
#include "render/radiosity/exchange.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include <Eigen/IterativeLinearSolvers>

#include "core/parallel.h"
#include "haarlight/core/error.h"

namespace haarlight::render {

namespace {

using Eigen::VectorXd;

constexpr std::size_t kRowsAtOnce = 64;

Eigen::Index to_index(std::size_t i) { return static_cast<Eigen::Index>(i); }

/// 1 - sqrt(rho) K sqrt(rho), for Eigen's solvers.
template <class Real>
class Absorbing;

}  // namespace

}  // namespace haarlight::render

namespace Eigen::internal {

template <class Real>
struct traits<haarlight::render::Absorbing<Real>> : traits<SparseMatrix<double>> {};

}  // namespace Eigen::internal

namespace haarlight::render {

namespace {

template <class Real>
class Absorbing : public Eigen::EigenBase<Absorbing<Real>> {
 public:
  using Scalar = double;
  using RealScalar = double;
  using StorageIndex = int;
  // NOLINTBEGIN(readability-identifier-naming): Eigen asks for these
  enum {
    ColsAtCompileTime = Eigen::Dynamic,
    MaxColsAtCompileTime = Eigen::Dynamic,
    IsRowMajor = 0
  };
  // NOLINTEND(readability-identifier-naming)

  Absorbing(const Exchange<Real>& exchange, VectorXd root_reflectance)
      : exchange_(&exchange), root_reflectance_(std::move(root_reflectance)) {}

  [[nodiscard]] Eigen::Index rows() const { return root_reflectance_.size(); }
  [[nodiscard]] Eigen::Index cols() const { return root_reflectance_.size(); }
  template <class Rhs>
  Eigen::Product<Absorbing, Rhs, Eigen::AliasFreeProduct> operator*(
      const Eigen::MatrixBase<Rhs>& x) const {
    return {*this, x.derived()};
  }
  [[nodiscard]] VectorXd times(const VectorXd& x) const {
    return x -
           root_reflectance_.cwiseProduct(exchange_->times(root_reflectance_.cwiseProduct(x)));
  }

 private:
  const Exchange<Real>* exchange_;
  VectorXd root_reflectance_;
};

}  // namespace

}  // namespace haarlight::render

namespace Eigen::internal {

template <class Real, class Rhs>
struct generic_product_impl<haarlight::render::Absorbing<Real>, Rhs, SparseShape, DenseShape,
                            GemvProduct>
    : generic_product_impl_base<haarlight::render::Absorbing<Real>, Rhs,
                                generic_product_impl<haarlight::render::Absorbing<Real>, Rhs>> {
  template <class Dest>
  // NOLINTNEXTLINE(readability-identifier-naming): the name that Eigen calls
  static void scaleAndAddTo(Dest& sum, const haarlight::render::Absorbing<Real>& matrix,
                            const Rhs& x, const double& factor) {
    sum += factor * matrix.times(x);
  }
};

}  // namespace Eigen::internal

namespace haarlight::render {

template <class Real>
VectorXd Exchange<Real>::times(const VectorXd& x) const {
  HAARLIGHT_EXPECTS(static_cast<std::size_t>(x.size()) == size(), "a value for each element");
  VectorXd product(x.size());
  parallel_for(size(), kRowsAtOnce, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      double sum = 0.0;
      for (std::size_t k = row_begin[i]; k < row_begin[i + 1]; ++k) {
        sum += double{values[k]} * x[columns[k]];
      }
      product[to_index(i)] = sum;
    }
  });
  return product;
}

template <class Real>
double Exchange<Real>::form_factor(std::size_t from, std::size_t to) const {
  const auto begin = columns.begin() + static_cast<std::ptrdiff_t>(row_begin[from]);
  const auto end = columns.begin() + static_cast<std::ptrdiff_t>(row_begin[from + 1]);
  const auto found = std::lower_bound(begin, end, static_cast<std::uint32_t>(to));
  if (found == end || *found != to) {
    return 0.0;
  }
  return double{values[static_cast<std::size_t>(found - columns.begin())]} *
         root_area[to_index(to)] / root_area[to_index(from)];
}

template <class Real>
VectorXd Exchange<Real>::row_sums() const {
  return times(root_area).cwiseQuotient(root_area);
}

template struct Exchange<float>;
template struct Exchange<double>;

namespace {

/// Counts of both ends together, row by row.
void join_ends(std::vector<std::vector<RayCount>>& counts, Exchange<float>& exchange) {
  const std::size_t n = counts.size();
  std::vector<std::size_t> ends(n + 1, 0);  // of rows with an entry for each end
  for (std::size_t i = 0; i < n; ++i) {
    ends[i + 1] += counts[i].size();
    for (const RayCount& count : counts[i]) {
      ++ends[count.element + 1];
    }
  }
  for (std::size_t i = 0; i < n; ++i) {
    ends[i + 1] += ends[i];
  }
  std::vector<RayCount> all(ends[n]);
  std::vector<std::size_t> next(ends.begin(), ends.end() - 1);
  for (std::size_t i = 0; i < n; ++i) {
    for (const RayCount& count : counts[i]) {
      all[next[i]++] = count;
      all[next[count.element]++] = {.element = static_cast<std::uint32_t>(i), .n = count.n};
    }
    std::vector<RayCount>().swap(counts[i]);
  }
  exchange.row_begin.assign(1, 0);
  for (std::size_t i = 0; i < n; ++i) {
    const auto begin = all.begin() + static_cast<std::ptrdiff_t>(ends[i]);
    const auto end = all.begin() + static_cast<std::ptrdiff_t>(ends[i + 1]);
    std::sort(begin, end,
              [](const RayCount& a, const RayCount& b) { return a.element < b.element; });
    for (auto entry = begin; entry != end; ++entry) {
      if (exchange.columns.size() > exchange.row_begin[i] &&
          exchange.columns.back() == entry->element) {
        exchange.values.back() += static_cast<float>(entry->n);
      } else {
        exchange.columns.push_back(entry->element);
        exchange.values.push_back(static_cast<float>(entry->n));
      }
    }
    exchange.row_begin.push_back(exchange.columns.size());
  }
}

/// Multiplies each value by factor(row, column, value).
template <class Factor>
void scale(Exchange<float>& exchange, const Factor& factor) {
  parallel_for(exchange.size(), kRowsAtOnce, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      for (std::size_t k = exchange.row_begin[i]; k < exchange.row_begin[i + 1]; ++k) {
        exchange.values[k] = static_cast<float>(
            exchange.values[k] * factor(to_index(i), Eigen::Index{exchange.columns[k]}));
      }
    }
  });
}

/// Makes rows sum to `wanted`, but for those that do not take part.
void balance(const VectorXd& wanted, Exchange<float>& exchange) {
  constexpr int kMostSteps = 200;
  constexpr double kNear = 1e-7;
  const VectorXd& area = exchange.root_area;
  VectorXd factors = VectorXd::Ones(area.size());
  for (int step = 0; step < kMostSteps; ++step) {
    const VectorXd sums =
        factors.cwiseProduct(exchange.times(factors.cwiseProduct(area))).cwiseQuotient(area);
    double worst = 0.0;
    for (Eigen::Index i = 0; i < sums.size(); ++i) {
      if (sums[i] > 0.0 && wanted[i] > 0.0) {
        const double ratio = wanted[i] / sums[i];
        worst = std::max(worst, std::abs(ratio - 1.0));
        factors[i] *= std::sqrt(ratio);
      }
    }
    if (worst < kNear) {
      break;
    }
  }
  scale(exchange, [&](Eigen::Index i, Eigen::Index j) { return factors[i] * factors[j]; });
  const VectorXd sums = exchange.row_sums();
  if (sums.size() > 0 && sums.maxCoeff() > 1.0) {
    scale(exchange, [&](Eigen::Index i, Eigen::Index j) {
      return 1.0 / std::max({1.0, sums[i], sums[j]});
    });
  }
}

}  // namespace

Exchange<float> exchange_of(std::vector<std::vector<RayCount>>& counts,
                            std::span<const std::uint32_t> n_rays, const VectorXd& root_area) {
  HAARLIGHT_EXPECTS(static_cast<std::size_t>(root_area.size()) == counts.size() &&
                        n_rays.size() == counts.size(),
                    "an area and rays for each element");
  VectorXd met(root_area.size());
  for (std::size_t i = 0; i < counts.size(); ++i) {
    std::uint64_t n = 0;
    for (const RayCount& count : counts[i]) {
      n += count.n;
    }
    met[to_index(i)] = static_cast<double>(n) / std::max(n_rays[i], 1U);
  }
  Exchange<float> exchange;
  exchange.root_area = root_area;
  join_ends(counts, exchange);
  scale(exchange, [&](Eigen::Index i, Eigen::Index j) {
    // 1/((n_i/A_i + n_j/A_j) sqrt(A_i A_j)): the same both ways, to the bit.
    const double a = root_area[j] / root_area[i] * n_rays[static_cast<std::size_t>(i)];
    const double b = root_area[i] / root_area[j] * n_rays[static_cast<std::size_t>(j)];
    return 1.0 / (a + b);
  });
  balance(met, exchange);
  return exchange;
}

std::uint64_t exchange_bytes(std::size_t n_elements, std::uint32_t n_rays) {
  // Of each ray at most: its count and that of its other end, twice while they are joined, and what
  // is made of both.
  const std::uint64_t in_row = std::min<std::uint64_t>(n_elements, n_rays);
  constexpr std::uint64_t kOfRay =
      3 * sizeof(RayCount) + 2 * (sizeof(std::uint32_t) + sizeof(float));
  return n_elements * (in_row * kOfRay + 256);
}

template <class Real>
RadiositySolution solve_radiosity(const Exchange<Real>& exchange, const VectorXd& emitted,
                                  const VectorXd& reflectance) {
  const VectorXd& root_area = exchange.root_area;
  RadiositySolution solution{.radiosity = emitted,
                             .irradiation = VectorXd::Zero(emitted.size())};
  const double most = emitted.size() > 0 ? emitted.maxCoeff() : 0.0;
  if (!(most > 0.0)) {
    return solution;
  }
  // Of unit size: squares of 10^+-20 stay in range.
  const VectorXd unit = emitted / most;
  const VectorXd root_reflectance = reflectance.cwiseMax(0.0).cwiseMin(1.0).cwiseSqrt();
  const Absorbing<Real> matrix(exchange, root_reflectance);
  const double largest_root = root_area.maxCoeff();
  const VectorXd weight = root_area / largest_root;
  // Of E itself what arrives first, then of the reflected part z = sqrt(A/rho) (B - E):
  // (1 - sqrt(rho) K sqrt(rho)) z = sqrt(rho) K sqrt(A) E
  const VectorXd first = exchange.times(weight.cwiseProduct(unit));
  Eigen::ConjugateGradient<Absorbing<Real>, Eigen::Lower | Eigen::Upper,
                           Eigen::IdentityPreconditioner>
      solver;
  constexpr int kMostIterations = 1000;
  constexpr double kTolerance = 1e-13;
  solver.setMaxIterations(kMostIterations);
  solver.setTolerance(kTolerance);
  solver.compute(matrix);
  const VectorXd reflected = root_reflectance.cwiseProduct(
      VectorXd(solver.solve(root_reflectance.cwiseProduct(first))));
  const VectorXd arrives = first + exchange.times(reflected);
  solution.iterations = static_cast<int>(solver.iterations());
  solution.residual = solver.error();
  // More light than this cannot be told from light that never ends by the rounding of K.
  constexpr double kMostGain = 1e4;
  const double gain = reflected.dot(weight) / std::max(1e-300, weight.cwiseAbs2().dot(unit));
  if (solver.info() != Eigen::Success || !(std::abs(gain) < kMostGain)) {
    throw Error(
        "the light between the surfaces never ends: they absorb next to nothing, and no "
        "light leaves the scene",
        "radiosity", "give the materials a lower kd, or open the room");
  }
  solution.irradiation = most * arrives.cwiseQuotient(weight);
  solution.radiosity = emitted + reflectance.cwiseProduct(solution.irradiation);
  return solution;
}

template RadiositySolution solve_radiosity(const Exchange<float>&, const VectorXd&,
                                           const VectorXd&);
template RadiositySolution solve_radiosity(const Exchange<double>&, const VectorXd&,
                                           const VectorXd&);

}  // namespace haarlight::render
