// SPDX-License-Identifier: Apache-2.0
#include "relight/study/spherical_harmonics.h"

#include <cmath>
#include <numbers>

#include "haarlight/core/error.h"
#include "relight/study/matrix_transform.h"

namespace haarlight::relight {

namespace {

constexpr double kNothingNew = 1e-8;  // half of double's digits: the fit stays well-conditioned

}  // namespace

std::vector<double> spherical_harmonics(const Eigen::Vector3d& direction, int order) {
  HAARLIGHT_EXPECTS(order >= 0 && std::abs(direction.norm() - 1.0) < 1e-6, "a unit direction");
  const auto at = [](int l, int m) {
    const int index = l * (l + 1) + m;
    return static_cast<std::size_t>(index);
  };
  std::vector<double> values(at(order, order) + 1);
  const double z = direction.z();
  // P_mm = sqrt((2 m + 1)/(4 pi (2 m)!)) (2 m - 1)!! sin^m, with sin^m in the azimuth's factors
  // Re, Im (x + i y)^m; then up in l.
  double diagonal = std::sqrt(1.0 / (4.0 * std::numbers::pi));
  double re = 1.0;
  double im = 0.0;
  for (int m = 0; m <= order; ++m) {
    double before = 0.0;
    double here = diagonal;
    for (int l = m; l <= order; ++l) {
      const double azimuth = m == 0 ? 1.0 : std::numbers::sqrt2;
      values[at(l, m)] = azimuth * here * re;
      if (m > 0) {
        values[at(l, -m)] = azimuth * here * im;
      }
      // sqrt((l+1)^2 - m^2) P_{l+1} = sqrt((2l+3)(2l+1)) z P_l
      //                               - sqrt((2l+3)/(2l-1) (l^2 - m^2)) P_{l-1}
      const double n = l;
      const double k = m;
      const double below =
          l == m ? 0.0
                 : std::sqrt((2.0 * n + 3.0) / (2.0 * n - 1.0) * (n * n - k * k)) * before;
      const double next = (std::sqrt((2.0 * n + 3.0) * (2.0 * n + 1.0)) * z * here - below) /
                          std::sqrt((n + 1.0) * (n + 1.0) - k * k);
      before = here;
      here = next;
    }
    diagonal *= std::sqrt((2.0 * m + 3.0) / (2.0 * m + 2.0));
    const double turned = re * direction.x() - im * direction.y();
    im = re * direction.y() + im * direction.x();
    re = turned;
  }
  return values;
}

std::unique_ptr<LightBasis> make_spherical_harmonics(
    const std::vector<Eigen::Vector3d>& directions, int order) {
  HAARLIGHT_EXPECTS(!directions.empty(), "lights");
  const auto n_lights = static_cast<Eigen::Index>(directions.size());
  const Eigen::Index n_functions = Eigen::Index{order + 1} * (order + 1);
  Eigen::MatrixXd sampled(n_lights, n_functions);
  for (Eigen::Index k = 0; k < n_lights; ++k) {
    const std::vector<double> row =
        spherical_harmonics(directions[static_cast<std::size_t>(k)], order);
    sampled.row(k) =
        Eigen::Map<const Eigen::RowVectorXd>(row.data(), static_cast<Eigen::Index>(row.size()));
  }
  Eigen::MatrixXd kept(n_lights, std::min(n_lights, n_functions));
  Eigen::Index n = 0;
  for (Eigen::Index i = 0; i < n_functions && n < n_lights; ++i) {
    Eigen::VectorXd v = sampled.col(i);
    const double size = v.norm();
    if (!(size > 0.0)) {
      continue;
    }
    for (int twice = 0; twice < 2; ++twice) {
      v -= kept.leftCols(n) * (kept.leftCols(n).transpose() * v);
    }
    if (v.norm() > kNothingNew * size) {
      kept.col(n++) = v.normalized();
    }
  }
  return std::make_unique<MatrixTransform>(kept.leftCols(n).transpose());
}

}  // namespace haarlight::relight
