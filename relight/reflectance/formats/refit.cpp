// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/reflectance/formats/refit.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <span>

#include <Eigen/Core>
#include <fmt/format.h>

#include "core/linear_algebra.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "haarlight/core/picture/image_io.h"

namespace haarlight::relight {

namespace {

constexpr int kSpread = 200;
constexpr double kLowest = 0.17;  // sine of ten degrees: lights are seldom lower
constexpr std::size_t kRowsAPiece = 8;

/// (n_terms, n_directions): samples at the directions to coefficients.
Eigen::MatrixXd solver_of(const ReflectanceModel& shape,
                          const std::vector<Eigen::Vector3d>& directions) {
  const auto n = static_cast<Eigen::Index>(directions.size());
  Eigen::MatrixXd terms(n, shape.n_terms);
  for (Eigen::Index i = 0; i < n; ++i) {
    const std::vector<double> row = basis_terms(shape, directions[static_cast<std::size_t>(i)]);
    terms.row(i) = Eigen::Map<const Eigen::RowVectorXd>(row.data(), shape.n_terms);
  }
  LeastSquares qr = least_squares(terms, Eigen::MatrixXd::Identity(n, n));
  if (qr.rank < shape.n_terms) {
    throw Error(
        fmt::format("{} directions tell only {} of {} terms apart", n, qr.rank, shape.n_terms),
        "the change of basis", "choose a basis of fewer terms");
  }
  return std::move(qr.solution);
}

/// A row's bytes to coefficients of the target, R, G and B separately. Exactly linear in the
/// samples if the transfer is unchanged; else every direction's colour is recoded on the way.
class RowRefit {
 public:
  RowRefit(const ReflectanceModel& source, const ReflectanceModel& shape,
           const std::vector<Eigen::Vector3d>& directions)
      : source_(source),
        is_lrgb_(source.colour == ReflectanceColour::lrgb),
        is_coded_(source.transfer == Transfer::linear),
        n_terms_(shape.n_terms),
        solver_(solver_of(shape, directions)) {
    const auto n = static_cast<Eigen::Index>(directions.size());
    const Eigen::Index n_planes = source.n_planes();
    for (Eigen::Index c = 0; c < 3; ++c) {
      Eigen::MatrixXd& samples = samples_[static_cast<std::size_t>(c)];
      samples.resize(n, n_planes + 1);  // the last column: the offset
      for (Eigen::Index i = 0; i < n; ++i) {
        const ColourMap map = colour_map(source, directions[static_cast<std::size_t>(i)]);
        samples.row(i).head(n_planes) = map.factors.row(c);
        samples(i, n_planes) = map.added[c];
      }
      if (!is_coded_) {
        samples = solver_ * samples;
      }
    }
  }

  /// @param out  (width * 3 * n_terms), pixel by pixel
  void fit(int y, std::span<float> out) const {
    const auto row = source_.planes.view().row(y);
    const Eigen::Index n_planes = source_.n_planes();
    const Eigen::Index width = source_.planes.width();
    Eigen::MatrixXd bytes(n_planes + 1, width);
    bytes.topRows(n_planes) =
        Eigen::Map<const Eigen::Matrix<std::uint8_t, Eigen::Dynamic, Eigen::Dynamic>>(
            row.data(), n_planes, width)
            .cast<double>();
    bytes.row(n_planes).setOnes();
    Eigen::Map<Eigen::MatrixXf> fitted(out.data(), Eigen::Index{3} * n_terms_, width);
    for (Eigen::Index c = 0; c < 3; ++c) {
      Eigen::MatrixXd values = samples_[static_cast<std::size_t>(c)] * bytes;
      if (is_lrgb_) {
        const Eigen::Index p = n_planes - 3 + c;
        const PlaneScale& colour = source_.scales[static_cast<std::size_t>(p)];
        values.array().rowwise() *= bytes.row(p).array() * colour.scale + colour.offset;
      }
      if (is_coded_) {
        values = solver_ * values.unaryExpr([](double value) {
          return static_cast<double>(
              srgb_from_linear(static_cast<float>(std::max(value, 0.0))));
        });
      }
      fitted.middleRows(c * n_terms_, n_terms_) = values.cast<float>();
    }
  }

 private:
  const ReflectanceModel& source_;
  bool is_lrgb_;
  bool is_coded_;
  Eigen::Index n_terms_;
  Eigen::MatrixXd solver_;
  std::array<Eigen::MatrixXd, 3> samples_;
};

/// Every `step`-th row of a picture.
ReflectanceModel thin_rows(const ReflectanceModel& model, int step) {
  const int height = (model.planes.height() + step - 1) / step;
  ReflectanceModel thin{
      .basis = model.basis,
      .colour = model.colour,
      .transfer = model.transfer,
      .order4 = model.order4,
      .n_terms = model.n_terms,
      .planes = Image<std::uint8_t>(height, model.planes.width(), model.planes.channels()),
      .scales = model.scales,
      .lights = model.lights,
      .rbf_sigma = model.rbf_sigma,
      .least_elevation = model.least_elevation,
      .resolution = model.resolution,
      .axes = model.axes};
  for (int y = 0; y < height; ++y) {
    const auto row = model.planes.view().row(y * step);
    std::copy(row.begin(), row.end(), thin.planes.view().row(y).begin());
  }
  return thin;
}

double byte_of(float value) {
  return std::round(255.0 * std::clamp(static_cast<double>(value), 0.0, 1.0));
}

PictureDifference compare_all(const ReflectanceModel& a, const ReflectanceModel& b,
                              const std::vector<Eigen::Vector3d>& directions) {
  const auto decibels = [](double mean_square) {
    return 10.0 * std::log10(255.0 * 255.0 / mean_square);
  };
  double sum = 0.0;
  double worst = 0.0;
  for (const Eigen::Vector3d& direction : directions) {
    const Image<float> from_a = relit_srgb(a, direction);
    const Image<float> from_b = relit_srgb(b, direction);
    double squares = 0.0;
    for (std::size_t i = 0; i < from_a.pixels().size(); ++i) {
      const double difference = byte_of(from_a.pixels()[i]) - byte_of(from_b.pixels()[i]);
      squares += difference * difference;
    }
    squares /= static_cast<double>(from_a.pixels().size());
    sum += squares;
    worst = std::max(worst, squares);
  }
  PictureDifference difference;
  difference.is_same = sum == 0.0;
  if (!difference.is_same) {
    difference.mean_db = decibels(sum / static_cast<double>(directions.size()));
    difference.worst_db = decibels(worst);
  }
  return difference;
}

}  // namespace

std::vector<Eigen::Vector3d> spread_over_hemisphere(int n, double turn) {
  std::vector<Eigen::Vector3d> directions;
  constexpr double kGoldenAngle = std::numbers::pi * (3.0 - 2.23606797749978969);
  for (int i = 0; i < n; ++i) {
    const double z = kLowest + (1.0 - kLowest) * (i + 0.5) / n;
    const double azimuth = i * kGoldenAngle + turn;
    const double rho = std::sqrt(1.0 - z * z);
    directions.emplace_back(rho * std::cos(azimuth), rho * std::sin(azimuth), z);
  }
  return directions;
}

std::vector<Eigen::Vector3d> refit_directions(const ReflectanceModel& model, int n_terms) {
  const bool has_lights = model.lights.size() >= 2 * static_cast<std::size_t>(n_terms);
  return has_lights ? model.lights : spread_over_hemisphere(kSpread);
}

ReflectanceModel refit(const ReflectanceModel& source, const RefitTarget& target,
                       const std::vector<Eigen::Vector3d>& directions) {
  HAARLIGHT_EXPECTS(
      target.basis == ReflectanceBasis::ptm || target.basis == ReflectanceBasis::hsh,
      "a basis with fixed terms");
  ReflectanceModel model;
  model.basis = target.basis;
  model.colour = ReflectanceColour::rgb;
  model.transfer = Transfer::srgb;
  model.n_terms = target.n_terms;
  model.lights = source.lights;
  model.photographed = source.photographed;
  const RowRefit row_refit(source, model, directions);
  const int height = source.planes.height();
  const int width = source.planes.width();
  const int n_planes = 3 * target.n_terms;
  const auto n_row = static_cast<std::size_t>(width) * static_cast<std::size_t>(n_planes);
  const auto n_pieces = (static_cast<std::size_t>(height) + kRowsAPiece - 1) / kRowsAPiece;
  std::vector<PlaneRanges> pieces(n_pieces, PlaneRanges(n_planes));
  parallel_for(static_cast<std::size_t>(height), kRowsAPiece,
               [&](std::size_t begin, std::size_t end) {
                 std::vector<float> row(n_row);
                 for (std::size_t y = begin; y < end; ++y) {
                   row_refit.fit(static_cast<int>(y), row);
                   pieces[begin / kRowsAPiece].add(row);
                 }
               });
  PlaneRanges ranges(n_planes);
  for (const PlaneRanges& piece : pieces) {
    ranges.merge(piece);
  }
  model.scales = choose_scales(ranges, model.colour, model.n_terms, target.rule);
  model.planes = Image<std::uint8_t>(height, width, n_planes);
  parallel_for(
      static_cast<std::size_t>(height), kRowsAPiece, [&](std::size_t begin, std::size_t end) {
        std::vector<float> row(n_row);
        for (std::size_t y = begin; y < end; ++y) {
          row_refit.fit(static_cast<int>(y), row);
          quantise_row(row, model.scales, model.planes.view().row(static_cast<int>(y)));
        }
      });
  return model;
}

Image<float> relit_srgb(const ReflectanceModel& model, const Eigen::Vector3d& direction) {
  Image<float> picture = relit(model, direction);
  if (model.transfer == Transfer::linear) {
    for (float& value : picture.pixels()) {
      value = srgb_from_linear(std::max(value, 0.0F));
    }
  }
  return picture;
}

PictureDifference compare_pictures(const ReflectanceModel& first,
                                   const ReflectanceModel& second,
                                   const std::vector<Eigen::Vector3d>& directions) {
  HAARLIGHT_EXPECTS(first.planes.height() == second.planes.height() &&
                        first.planes.width() == second.planes.width() && !directions.empty(),
                    "pictures of one size");
  constexpr std::int64_t kMost = 4'000'000;
  const std::int64_t n_pixels = std::int64_t{first.planes.height()} * first.planes.width();
  if (n_pixels > kMost && first.planes.height() > 1) {
    const auto step = static_cast<int>(
        std::min<std::int64_t>((n_pixels + kMost - 1) / kMost, first.planes.height()));
    return compare_all(thin_rows(first, step), thin_rows(second, step), directions);
  }
  return compare_all(first, second, directions);
}

}  // namespace haarlight::relight
