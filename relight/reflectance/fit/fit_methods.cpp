// SPDX-License-Identifier: Apache-2.0
#include "relight/reflectance/fit/fit_methods.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <numbers>

#include "core/random.h"
#include "relight/reflectance/fit/far_fit.h"
#include "relight/reflectance/fit/light_interpolation.h"
#include "relight/reflectance/fit/near_fit.h"

namespace haarlight::relight {

namespace {

using Eigen::Vector3d;

constexpr int kTerms = 16;

/// A harmonic's coefficient at a pixel of a made surface, the same in all colours.
double coefficient(int x, int y, int term) {
  return term == 0
             ? 1.0
             : 0.02 * std::sin(0.11 * (term + 1) * x + 0.07 * (term + 2) * y + 1.7 * term);
}

/// `n` directions over a dome, 25 to 85 degrees up, turned by `turn` of a golden angle.
std::vector<Vector3d> dome(int n, double turn) {
  std::vector<Vector3d> directions;
  for (int k = 0; k < n; ++k) {
    const double up = (25.0 + 60.0 * k / (n - 1)) * std::numbers::pi / 180.0;
    const double round = 2.399963 * (k + turn);
    directions.emplace_back(std::cos(up) * std::cos(round), std::cos(up) * std::sin(round),
                            std::sin(up));
  }
  return directions;
}

/// Values (pixels, directions) of a surface whose pixel (x, y) has `at(x, y)`, (kTerms).
template <class At>
Eigen::MatrixXd lit(int side, const std::vector<Vector3d>& directions, int n_terms,
                    ReflectanceBasis basis, const At& at) {
  const Eigen::MatrixXd terms = terms_of(basis, n_terms, directions);
  Eigen::MatrixXd values(side * side, static_cast<Eigen::Index>(directions.size()));
  for (int p = 0; p < side * side; ++p) {
    Eigen::VectorXd own(n_terms);
    for (int t = 0; t < n_terms; ++t) {
      own[t] = at(p % side, p / side, t);
    }
    values.row(p) = (terms * own).transpose();
  }
  return values;
}

/// The first colour's plane of a term, decoded.
double plane_value(const ReflectanceModel& model, int x, int y, int term) {
  const PlaneScale& scale = model.scales[static_cast<std::size_t>(term)];
  return model.planes(y, x, term) * scale.scale + scale.offset;
}

/// A surface of 16 harmonics, fitted by fewer or by all, lit where no light was.
class FarLights {
 public:
  using Result = Eigen::MatrixXd;  ///< values (pixels, held directions)

  explicit FarLights(MethodSize size)
      : side_(by_size(size, 24, 128, 512)), lights_(dome(60, 0.0)), held_(dome(20, 0.5)) {
    const Eigen::MatrixXd values =
        lit(side_, lights_, kTerms, ReflectanceBasis::hsh, coefficient);
    std::vector<Image<float>> pictures;
    for (Eigen::Index k = 0; k < values.cols(); ++k) {
      Image<float>& picture = pictures.emplace_back(side_, side_, 3);
      for (int p = 0; p < side_ * side_; ++p) {
        for (int c = 0; c < 3; ++c) {
          picture(p / side_, p % side_, c) = static_cast<float>(values(p, k));
        }
      }
    }
    rows_ = image_rows(std::move(pictures), Transfer::linear);
  }

  [[nodiscard]] Result run(std::size_t setting) {
    constexpr std::array<int, 3> kOrders{4, 9, kTerms};
    const int n = kOrders.at(setting);
    FarFit fit;
    fit.model.basis = ReflectanceBasis::hsh;
    fit.model.transfer = Transfer::linear;
    fit.model.n_terms = n;
    fit.matrix = term_matrix({.n_terms = n}, lights_);
    fit.added = Eigen::VectorXd::Zero(n);
    FarFitOptions options;
    options.planes.ends = RangeEnds::extremes;
    const ReflectanceModel model = fit_far(*rows_, fit, options).model;
    return lit(side_, held_, n, ReflectanceBasis::hsh,
               [&](int x, int y, int t) { return plane_value(model, x, y, t); });
  }
  [[nodiscard]] Result truth() const {
    return lit(side_, held_, kTerms, ReflectanceBasis::hsh, coefficient);
  }
  [[nodiscard]] double error(const Result& found, const Result& truth) const {
    return (found - truth).norm() / truth.norm();
  }
  [[nodiscard]] MethodScale scale() const {
    return {static_cast<int>(lights_.size()), static_cast<long long>(side_) * side_};
  }
  /// 16-bit codes of every picture.
  [[nodiscard]] double bytes(std::size_t /*setting*/) const {
    return 6.0 * static_cast<double>(lights_.size()) * side_ * side_;
  }

 private:
  int side_;
  std::vector<Vector3d> lights_;
  std::vector<Vector3d> held_;  ///< directions without a light
  std::unique_ptr<PictureRows> rows_;
};

/// Lights close above the picture: every pixel has its own least-squares problem.
class NearLights {
 public:
  using Result = Eigen::MatrixXd;  ///< planes (pixels, terms) of the first colour

  explicit NearLights(MethodSize size) : side_(by_size(size, 40, 160, 512)) {
    constexpr int kAcross = 7;
    constexpr double kHeightMm = 150.0;
    for (int k = 0; k < kAcross * kAcross; ++k) {
      const int row = k / kAcross;
      const int col = k % kAcross;
      NearLight light;
      light.position_mm = {600.0 * (col + 0.5) / kAcross - 300.0,
                           600.0 * (row + 0.5) / kAcross - 300.0, kHeightMm};
      light.mu = 1.0;
      geometry_.lights.push_back(light);
    }
    // Nearly the coarsest pixels that fit_near() interpolates between: cells of 24 mm.
    geometry_.points =
        PixelPoints::orthographic(side_, side_, by_size(size, 0.44, 0.44, 0.37) * side_);
    geometry_.reference_mm = kHeightMm;
    std::vector<Image<float>> pictures(geometry_.lights.size(), Image<float>(side_, side_, 3));
    values_.resize(Eigen::Index{side_} * side_, static_cast<Eigen::Index>(pictures.size()));
    for (int p = 0; p < side_ * side_; ++p) {
      for (std::size_t k = 0; k < pictures.size(); ++k) {
        const auto value = static_cast<float>(near_value(p % side_, p / side_, k));
        for (int c = 0; c < 3; ++c) {
          pictures[k](p / side_, p % side_, c) = value;
        }
        values_(p, static_cast<Eigen::Index>(k)) = double{value};
      }
    }
    rows_ = image_rows(std::move(pictures), Transfer::linear);
  }

  [[nodiscard]] Result run(std::size_t setting) {
    constexpr std::array<int, 3> kGrids{64, 16, 0};
    NearFitOptions options = exact();
    if (kGrids.at(setting) > 0) {
      options.solve = NearSolve::interpolated;
      options.grid = kGrids.at(setting);
    }
    const ReflectanceModel model = fit_near(*rows_, geometry_, options).model;
    Result planes(side_ * side_, kNearTerms);
    for (int p = 0; p < side_ * side_; ++p) {
      for (int t = 0; t < kNearTerms; ++t) {
        planes(p, t) = plane_value(model, p % side_, p / side_, t);
      }
    }
    return planes;
  }
  [[nodiscard]] Result truth() const {
    Result planes(side_ * side_, kNearTerms);
    const auto n = static_cast<Eigen::Index>(geometry_.lights.size());
    for (int p = 0; p < side_ * side_; ++p) {
      Eigen::VectorXd values(3 * n);
      for (Eigen::Index k = 0; k < n; ++k) {
        values.segment(3 * k, 3).setConstant(values_(p, k));
      }
      const int row = p / side_;
      const int col = p % side_;
      planes.row(p) = near_planes_of(geometry_, exact(), values, col + 0.5, row + 0.5)
                          .head(kNearTerms)
                          .transpose();
    }
    return planes;
  }
  [[nodiscard]] double error(const Result& found, const Result& truth) const {
    return (found - truth).norm() / truth.norm();
  }
  [[nodiscard]] MethodScale scale() const {
    return {static_cast<int>(geometry_.lights.size()), static_cast<long long>(side_) * side_};
  }

 private:
  static constexpr int kNearTerms = kTerms;

  static NearFitOptions exact() {
    NearFitOptions options;
    options.n_terms = kNearTerms;
    options.transfer = Transfer::linear;
    options.planes.ends = RangeEnds::extremes;
    return options;
  }
  /// Of a surface that is alike everywhere, so that its planes hardly vary and their 8 bits are
  /// fine, under light k.
  [[nodiscard]] double near_value(int x, int y, std::size_t k) const {
    const NearLight& light = geometry_.lights[k];
    const Vector3d way = light.position_mm - geometry_.points.at(x + 0.5, y + 0.5);
    const Vector3d direction = way.normalized();
    const std::array<double, 16> terms = hsh_terms(direction, kTerms);
    double value = 0.0;
    for (int t = 0; t < kTerms; ++t) {
      value += terms.at(static_cast<std::size_t>(t)) * coefficient(7, 5, t);
    }
    return value * direction.z() * std::pow(geometry_.reference_mm, 2) / way.squaredNorm();
  }

  int side_;
  NearGeometry geometry_;
  Eigen::MatrixXd values_;  ///< (pixels, lights)
  std::unique_ptr<PictureRows> rows_;
};

}  // namespace

std::vector<Method> fit_methods() {
  const std::string module = "relight/reflectance/fit";
  return {
      Method::of<FarLights>(
          {.module = module,
           .name = "hemispherical harmonics (HSH) fit",
           .settings = {"4 terms", "9 terms", "16 terms"},
           .error_norm = "relative L2 of pictures lit from between the lights",
           .truth = "closed form: a surface of 16 harmonics",
           .exact_error = 2e-3,
           .exact_error_from = "planes of 8 bits: half a 255th of 0.04 for each of 16 terms, "
                               "over 0.4"}),
      Method::of<NearLights>({.module = module,
                              .name = "near-light fit, its matrix interpolated between pixels",
                              .settings = {"every 64 pixels", "every 16 pixels", "exact"},
                              .error_norm = "relative L2 of the planes of 16 harmonics",
                              .truth = "least squares in double, pixel by pixel",
                              .exact_error = 1e-3,
                              .exact_error_from = "planes of 8 bits"}),
  };
}

}  // namespace haarlight::relight
