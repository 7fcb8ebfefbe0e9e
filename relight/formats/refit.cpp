#include "relight/formats/refit.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <span>

#include <Eigen/QR>
#include <fmt/format.h>

#include "core/error.h"
#include "core/image_io.h"
#include "core/parallel.h"

namespace haarlight {

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
  const Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr(terms);
  if (qr.rank() < shape.n_terms) {
    throw Error(fmt::format("{} directions tell only {} of {} terms apart", n, qr.rank(),
                            shape.n_terms),
                "the change of basis", "choose a basis of fewer terms");
  }
  return qr.solve(Eigen::MatrixXd::Identity(n, n));
}

/// Bytes of one pixel to coefficients of the target, R, G and B apart. Exactly linear in the
/// samples where the transfer stays; else every direction's colour is coded on the way.
class PixelRefit {
 public:
  PixelRefit(const ReflectanceModel& source, const ReflectanceModel& shape,
             const std::vector<Eigen::Vector3d>& directions)
      : is_lrgb_(source.colour == ReflectanceColour::lrgb),
        is_coded_(source.transfer == Transfer::linear),
        n_planes_(source.n_planes()),
        n_terms_(shape.n_terms),
        solver_(solver_of(shape, directions)) {
    const auto n = static_cast<Eigen::Index>(directions.size());
    for (int c = 0; c < 3; ++c) {
      Eigen::MatrixXd& samples = samples_[static_cast<std::size_t>(c)];
      samples.resize(n, n_planes_ + 1);  // the last column: what is added
      for (Eigen::Index i = 0; i < n; ++i) {
        const ColourMap map = colour_map(source, directions[static_cast<std::size_t>(i)]);
        samples.row(i).head(n_planes_) = map.factors.row(c);
        samples(i, n_planes_) = map.added[c];
      }
      if (!is_coded_) {
        samples = solver_ * samples;
      }
    }
    if (is_lrgb_) {
      std::copy_n(source.scales.end() - 3, 3, colours_.begin());
    }
  }

  /// @param out  (3 * n_terms)
  void fit(std::span<const std::uint8_t> pixel, std::span<float> out) const {
    Eigen::VectorXd bytes(n_planes_ + 1);
    for (Eigen::Index p = 0; p < n_planes_; ++p) {
      bytes[p] = pixel[static_cast<std::size_t>(p)];
    }
    bytes[n_planes_] = 1.0;
    for (std::size_t c = 0; c < 3; ++c) {
      Eigen::VectorXd values = samples_[c] * bytes;
      if (is_lrgb_) {
        const auto p = static_cast<Eigen::Index>(n_planes_ - 3) + static_cast<Eigen::Index>(c);
        values *= bytes[p] * colours_[c].scale + colours_[c].offset;
      }
      if (is_coded_) {
        for (double& value : values) {
          value =
              static_cast<double>(srgb_from_linear(static_cast<float>(std::max(value, 0.0))));
        }
        values = solver_ * values;
      }
      for (Eigen::Index j = 0; j < n_terms_; ++j) {
        out[c * static_cast<std::size_t>(n_terms_) + static_cast<std::size_t>(j)] =
            static_cast<float>(values[j]);
      }
    }
  }

 private:
  bool is_lrgb_;
  bool is_coded_;
  int n_planes_;
  int n_terms_;
  Eigen::MatrixXd solver_;
  std::array<Eigen::MatrixXd, 3> samples_;
  std::array<PlaneScale, 3> colours_;
};

void fit_row(const PixelRefit& pixel_refit, const ReflectanceModel& source, int y,
             std::span<float> out) {
  const auto row = source.planes.view().row(y);
  const auto n_in = static_cast<std::size_t>(source.n_planes());
  const auto width = static_cast<std::size_t>(source.planes.width());
  const std::size_t n_out = out.size() / width;
  for (std::size_t x = 0; x < width; ++x) {
    pixel_refit.fit(row.subspan(x * n_in, n_in), out.subspan(x * n_out, n_out));
  }
}

double byte_of(float value) {
  return std::round(255.0 * std::clamp(static_cast<double>(value), 0.0, 1.0));
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
  const PixelRefit pixel_refit(source, model, directions);
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
                   fit_row(pixel_refit, source, static_cast<int>(y), row);
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
          fit_row(pixel_refit, source, static_cast<int>(y), row);
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

PictureDifference compare_pictures(const ReflectanceModel& a, const ReflectanceModel& b,
                                   const std::vector<Eigen::Vector3d>& directions) {
  HAARLIGHT_EXPECTS(a.planes.height() == b.planes.height() &&
                        a.planes.width() == b.planes.width() && !directions.empty(),
                    "pictures of one size");
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

}  // namespace haarlight
