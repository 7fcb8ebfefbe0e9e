// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/reflectance/formats/reflectance.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <span>
#include <string>

#include <fmt/format.h>

#include "core/parallel.h"

namespace haarlight::relight {

int n_planes_of(ReflectanceColour colour, int n_terms) noexcept {
  switch (colour) {
    case ReflectanceColour::rgb:
      return 3 * n_terms;
    case ReflectanceColour::lrgb:
      return n_terms + 3;
    case ReflectanceColour::pca:
      return n_terms;
  }
  return 0;
}

std::array<double, 6> ptm_terms(const Eigen::Vector3d& direction) noexcept {
  const double u = direction.x();
  const double v = direction.y();
  return {u * u, v * v, u * v, u, v, 1.0};
}

std::array<double, 16> hsh_terms(const Eigen::Vector3d& direction, int n_terms,
                                 HshOrder4 order4) noexcept {
  using std::numbers::inv_pi;
  const double c = std::clamp(direction.z(), 0.0, 1.0);
  const double q = std::sqrt(c - c * c);
  const double rho = std::hypot(direction.x(), direction.y());
  // cos and sin of the azimuth and its multiples; the azimuth of the zenith does not matter,
  // since q is 0 there.
  const double cos1 = rho > 0.0 ? direction.x() / rho : 1.0;
  const double sin1 = rho > 0.0 ? direction.y() / rho : 0.0;
  const double cos2 = cos1 * cos1 - sin1 * sin1;
  const double sin2 = 2.0 * cos1 * sin1;
  const double m = 2.0 * c - 1.0;
  std::array<double, 16> h{};
  h[0] = std::sqrt(0.5 * inv_pi);
  h[1] = std::sqrt(6.0 * inv_pi) * cos1 * q;
  h[2] = std::sqrt(1.5 * inv_pi) * m;
  h[3] = std::sqrt(6.0 * inv_pi) * sin1 * q;
  if (n_terms > 4) {
    h[4] = std::sqrt(30.0 * inv_pi) * cos2 * (c * c - c);
    h[5] = std::sqrt(30.0 * inv_pi) * cos1 * m * q;
    h[6] = std::sqrt(2.5 * inv_pi) * (1.0 - 6.0 * c + 6.0 * c * c);
    h[7] = std::sqrt(30.0 * inv_pi) * sin1 * m * q;
    h[8] = std::sqrt(30.0 * inv_pi) * sin2 * (c * c - c);
  }
  if (n_terms > 9) {
    const double cos3 = cos2 * cos1 - sin2 * sin1;
    const double sin3 = sin2 * cos1 + cos2 * sin1;
    const double power = order4 == HshOrder4::exact ? q * q * q : q * q;
    const double p5 = 1.0 - 5.0 * c + 5.0 * c * c;
    h[9] = 2.0 * std::sqrt(35.0 * inv_pi) * cos3 * power;
    h[10] = std::sqrt(210.0 * inv_pi) * cos2 * m * (c * c - c);
    h[11] = 2.0 * std::sqrt(21.0 * inv_pi) * cos1 * q * p5;
    h[12] = std::sqrt(3.5 * inv_pi) * (-1.0 + c * (12.0 + c * (-30.0 + c * 20.0)));
    h[13] = 2.0 * std::sqrt(21.0 * inv_pi) * sin1 * q * p5;
    h[14] = std::sqrt(210.0 * inv_pi) * sin2 * m * (c * c - c);
    h[15] = 2.0 * std::sqrt(35.0 * inv_pi) * sin3 * power;
  }
  return h;
}

namespace {

/// The direction raised to a minimum elevation at its azimuth.
Eigen::Vector3d raised(const Eigen::Vector3d& direction, double least_elevation) {
  const double z = std::sin(least_elevation);
  if (least_elevation <= 0.0 || direction.z() >= z) {
    return direction;
  }
  const double rho = std::hypot(direction.x(), direction.y());
  if (rho == 0.0) {  // from straight below
    return {std::cos(least_elevation), 0.0, z};
  }
  const double scale = std::cos(least_elevation) / rho;
  return {scale * direction.x(), scale * direction.y(), z};
}

}  // namespace

std::vector<double> basis_terms(const ReflectanceModel& model,
                                const Eigen::Vector3d& direction) {
  if (model.basis == ReflectanceBasis::ptm) {
    const auto terms = ptm_terms(direction);
    return {terms.begin(), terms.end()};
  }
  HAARLIGHT_EXPECTS(model.basis == ReflectanceBasis::hsh, "a basis with fixed terms");
  const auto terms =
      hsh_terms(raised(direction, model.least_elevation), model.n_terms, model.order4);
  return {terms.begin(), terms.begin() + model.n_terms};
}

Image<std::uint8_t> allocate_planes(int height, int width, int n_planes,
                                    std::uint64_t most_bytes, const std::string& where) {
  const std::uint64_t bytes = static_cast<std::uint64_t>(height) *
                              static_cast<std::uint64_t>(width) *
                              static_cast<std::uint64_t>(n_planes);
  if (bytes > most_bytes) {
    throw Error(fmt::format("{} planes of {} x {} bytes are {:.1f} MiB, more than the {:.1f} "
                            "MiB that may be used",
                            n_planes, width, height, static_cast<double>(bytes) / 1048576.0,
                            static_cast<double>(most_bytes) / 1048576.0),
                where, "give more: --memory 16G");
  }
  return {height, width, n_planes};
}

void require_consistent(const ReflectanceModel& model, std::string_view where) {
  const auto refuse = [&](const std::string& what) {
    throw Error(what, std::string(where), "make the file again with the program that wrote it");
  };
  const bool has_terms = model.basis == ReflectanceBasis::ptm ? model.n_terms == 6
                         : model.basis == ReflectanceBasis::hsh
                             ? model.n_terms == 4 || model.n_terms == 9 || model.n_terms == 16
                             : model.colour == ReflectanceColour::pca;
  if (!has_terms) {
    refuse(fmt::format("{} with {} terms is not a reflectance picture", to_string(model.basis),
                       model.n_terms));
  }
  if (model.n_planes() != n_planes_of(model.colour, model.n_terms) ||
      model.planes.channels() != model.n_planes() || model.planes.is_empty()) {
    refuse(fmt::format("{} planes with {} scales do not make {} terms", model.planes.channels(),
                       model.n_planes(), model.n_terms));
  }
  if (!std::all_of(model.scales.begin(), model.scales.end(), [](const PlaneScale& s) {
        return std::isfinite(s.scale) && std::isfinite(s.offset);
      })) {
    refuse("a scale or an offset is not a finite number");
  }
  if (model.colour != ReflectanceColour::pca) {
    return;
  }
  const bool is_bilinear = model.basis == ReflectanceBasis::bilinear;
  if (!is_bilinear && model.basis != ReflectanceBasis::rbf) {
    refuse(fmt::format("{} has no axes", to_string(model.basis)));
  }
  if (is_bilinear && model.resolution < 2) {
    refuse(fmt::format("a grid of {} points per side", model.resolution));
  }
  const auto n_nodes = is_bilinear ? Eigen::Index{model.resolution} * model.resolution
                                   : static_cast<Eigen::Index>(model.lights.size());
  if (n_nodes < 1 || model.axes.rows() != model.n_terms + 1 ||
      model.axes.cols() != 3 * n_nodes) {
    refuse(fmt::format("{} x {} numbers of axes for {} planes and {} nodes", model.axes.rows(),
                       model.axes.cols(), model.n_terms, n_nodes));
  }
  if (!model.axes.allFinite() || !std::isfinite(model.rbf_sigma) || model.rbf_sigma < 0.0 ||
      !std::all_of(model.lights.begin(), model.lights.end(),
                   [](const Eigen::Vector3d& light) { return light.allFinite(); })) {
    refuse("an axis, a light or sigma is not a finite number");
  }
}

namespace {

std::vector<NodeWeight> bilinear_weights(int resolution, const Eigen::Vector3d& direction) {
  const Eigen::Vector3d d(direction.x(), direction.y(), std::max(direction.z(), 0.0));
  const double s = d.lpNorm<1>();
  const double side = resolution - 1.0;
  const double column = s > 0.0 ? ((d.x() + d.y()) / s + 1.0) / 2.0 * side : side / 2.0;
  const double row = s > 0.0 ? ((d.y() - d.x()) / s + 1.0) / 2.0 * side : side / 2.0;
  const int x = std::clamp(static_cast<int>(std::floor(column)), 0, resolution - 2);
  const int y = std::clamp(static_cast<int>(std::floor(row)), 0, resolution - 2);
  const double fx = column - x;
  const double fy = row - y;
  const int at = y * resolution + x;
  return {{at, (1.0 - fx) * (1.0 - fy)},
          {at + 1, fx * (1.0 - fy)},
          {at + resolution, (1.0 - fx) * fy},
          {at + resolution + 1, fx * fy}};
}

/// As OpenLIME 1.2.6, which ignores sigma (its AdaptiveRBF).
std::vector<NodeWeight> adaptive_weights(const ReflectanceModel& model,
                                         const Eigen::Vector3d& direction) {
  constexpr double kAlpha = 8.0;
  constexpr double kBeta = 2.0;
  double distances = 0.0;
  double weight_sum = 0.0;
  double nearest = std::numeric_limits<double>::infinity();
  for (const Eigen::Vector3d& light : model.lights) {
    const double distance = (direction - light).norm();
    const double weight = std::exp(-kBeta * distance);
    distances += weight * distance;
    weight_sum += weight;
    nearest = std::min(nearest, distance);
  }
  // A single light exactly in that direction: it alone counts, whatever the width.
  const double factor = distances > 0.0 ? kAlpha * weight_sum / distances : 0.0;
  std::vector<NodeWeight> weights;
  double sum = 0.0;
  for (std::size_t i = 0; i < model.lights.size(); ++i) {
    const double square = (direction - model.lights[i]).squaredNorm();
    weights.push_back({static_cast<int>(i), std::exp(-factor * (square - nearest * nearest))});
    sum += weights.back().weight;
  }
  for (NodeWeight& weight : weights) {
    weight.weight /= sum;
  }
  return weights;
}

std::vector<NodeWeight> rbf_weights(const ReflectanceModel& model,
                                    const Eigen::Vector3d& direction) {
  if (model.rbf_sigma <= 0.0) {
    return adaptive_weights(model, direction);
  }
  constexpr double kLeast = 0.001;  // of the sum: as in Relight
  const double sigma = model.rbf_sigma;
  std::vector<double> squares;
  for (const Eigen::Vector3d& light : model.lights) {
    squares.push_back((direction - light).squaredNorm());
  }
  // Relative to the nearest light: the same weights, and no sum that is zero far from all.
  const double nearest = *std::min_element(squares.begin(), squares.end());
  double sum = 0.0;
  for (double& square : squares) {
    square = std::exp((nearest - square) / (sigma * sigma));
    sum += square;
  }
  std::vector<NodeWeight> weights;
  double kept = 0.0;
  for (std::size_t i = 0; i < squares.size(); ++i) {
    // The nearest counts even if very many are as near.
    if (squares[i] > kLeast * sum || squares[i] == 1.0) {
      weights.push_back({static_cast<int>(i), squares[i]});
      kept += squares[i];
    }
  }
  for (NodeWeight& weight : weights) {
    weight.weight /= kept;
  }
  return weights;
}

}  // namespace

std::vector<NodeWeight> node_weights(const ReflectanceModel& model,
                                     const Eigen::Vector3d& direction) {
  HAARLIGHT_EXPECTS(model.colour == ReflectanceColour::pca, "a model with nodes");
  return model.basis == ReflectanceBasis::bilinear
             ? bilinear_weights(model.resolution, direction)
             : rbf_weights(model, direction);
}

namespace {

ColourMap map_of_axes(const ReflectanceModel& model, const Eigen::Vector3d& direction) {
  ColourMap map;
  map.factors.setZero(3, model.n_terms);
  for (const NodeWeight& weight : node_weights(model, direction)) {
    const auto colours = model.axes.middleCols(Eigen::Index{3} * weight.node, 3);
    map.added += weight.weight * colours.row(0).transpose().cast<double>();
    map.factors += weight.weight * colours.bottomRows(model.n_terms).transpose().cast<double>();
  }
  return map;
}

ColourMap map_of(const ReflectanceModel& model, const Eigen::Vector3d& direction) {
  if (model.colour == ReflectanceColour::pca) {
    return map_of_axes(model, direction);
  }
  const std::vector<double> terms = basis_terms(model, direction);
  ColourMap map;
  map.factors.setZero(3, n_planes_of(model.colour, model.n_terms));
  for (int c = 0; c < 3; ++c) {
    const int first = model.colour == ReflectanceColour::rgb ? c * model.n_terms : 0;
    for (int j = 0; j < model.n_terms; ++j) {
      map.factors(c, first + j) = terms[static_cast<std::size_t>(j)];
    }
  }
  return map;
}

/// The map for samples, from that for coefficients: value = sample * scale + offset.
ColourMap map_of_samples(ColourMap map, const std::vector<PlaneScale>& scales) {
  for (Eigen::Index p = 0; p < map.factors.cols(); ++p) {
    const PlaneScale& scale = scales[static_cast<std::size_t>(p)];
    map.added += map.factors.col(p) * scale.offset;
    map.factors.col(p) *= scale.scale;
  }
  return map;
}

/// @param colour_scales  of the three last planes of lrgb
template <class Sample>
Image<float> apply_map(const ColourMap& map, ImageView<const Sample> samples, bool is_lrgb,
                       const std::array<PlaneScale, 3>& colour_scales) {
  const Eigen::Matrix<float, 3, Eigen::Dynamic> factors = map.factors.cast<float>();
  const Eigen::Vector3f added = map.added.cast<float>();
  Image<float> picture(samples.height(), samples.width(), 3);
  const auto n_planes = static_cast<std::size_t>(samples.channels());
  const std::size_t n_mapped = is_lrgb ? n_planes - 3 : n_planes;
  parallel_for(
      static_cast<std::size_t>(picture.height()), 16, [&](std::size_t begin, std::size_t end) {
        for (std::size_t y = begin; y < end; ++y) {
          const std::span<const Sample> row = samples.row(static_cast<int>(y));
          const std::span<float> out = picture.view().row(static_cast<int>(y));
          for (std::size_t x = 0; x < static_cast<std::size_t>(picture.width()); ++x) {
            const Sample* pixel = &row[x * n_planes];
            Eigen::Vector3f colour = added;
            for (std::size_t p = 0; p < n_mapped; ++p) {
              colour +=
                  static_cast<float>(pixel[p]) * factors.col(static_cast<Eigen::Index>(p));
            }
            for (std::size_t c = 0; c < 3; ++c) {
              float value = colour[static_cast<Eigen::Index>(c)];
              if (is_lrgb) {
                value *= static_cast<float>(pixel[n_mapped + c] * colour_scales[c].scale +
                                            colour_scales[c].offset);
              }
              out[3 * x + c] = value;
            }
          }
        }
      });
  return picture;
}

}  // namespace

ColourMap colour_map(const ReflectanceModel& model, const Eigen::Vector3d& direction) {
  return map_of_samples(map_of(model, direction), model.scales);
}

Image<float> relit(const ReflectanceModel& model, const Eigen::Vector3d& direction) {
  const bool is_lrgb = model.colour == ReflectanceColour::lrgb;
  std::array<PlaneScale, 3> colour_scales;
  if (is_lrgb) {
    std::copy_n(model.scales.end() - 3, 3, colour_scales.begin());
  }
  return apply_map(colour_map(model, direction), model.planes.view(), is_lrgb, colour_scales);
}

Image<float> relit_coefficients(const ReflectanceModel& model,
                                ImageView<const float> coefficients,
                                const Eigen::Vector3d& direction) {
  HAARLIGHT_EXPECTS(coefficients.channels() == n_planes_of(model.colour, model.n_terms),
                    "one coefficient per plane");
  constexpr PlaneScale kAsItIs{1.0, 0.0};
  return apply_map(map_of(model, direction), coefficients,
                   model.colour == ReflectanceColour::lrgb, {kAsItIs, kAsItIs, kAsItIs});
}

}  // namespace haarlight::relight
