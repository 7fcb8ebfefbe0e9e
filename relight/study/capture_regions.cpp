// SPDX-License-Identifier: Apache-2.0
#include "relight/study/capture_regions.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Cholesky>
#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/core/picture/image_io.h"

namespace haarlight::relight {

namespace {

constexpr int kRounds = 8;             // the set of agreeing lights is stable after 3 to 6
constexpr double kAgrees = 0.25;       // of the fit: penumbrae and highlights deviate more
constexpr double kLitFraction = 0.05;  // of the brightest light: what may start the fit
constexpr double kHidden = 0.5;        // of the fit: the middle of a penumbra
constexpr double kAbove = 1.15;   // of the fit: the near-light error of a wrong depth is less
constexpr double kFacing = 0.02;  // of the largest fit: grazing lights are uninformative

std::array<float, 3> colour(Region region) {
  switch (region) {
    case Region::specular:
      return {1.0F, 0.0F, 0.0F};
    case Region::diffuse:
      return {0.0F, 1.0F, 0.0F};
    case Region::attached:
      return {0.0F, 0.0F, 1.0F};
    case Region::cast:
      return {1.0F, 1.0F, 0.0F};
    case Region::none:
      break;
  }
  return {0.0F, 0.0F, 0.0F};
}

/// Least squares over the chosen lights; false if they do not determine a normal.
bool fit_matte(std::span<const float> values, const Eigen::Matrix3Xd& factors,
               const std::vector<bool>& is_used, Eigen::Vector3d& matte) {
  Eigen::Matrix3d a = Eigen::Matrix3d::Zero();
  Eigen::Vector3d b = Eigen::Vector3d::Zero();
  int n = 0;
  for (std::size_t k = 0; k < values.size(); ++k) {
    if (is_used[k]) {
      const Eigen::Vector3d f = factors.col(static_cast<Eigen::Index>(k));
      a += f * f.transpose();
      b += f * double{values[k]};
      ++n;
    }
  }
  if (n < 4) {  // three unknowns and one redundant equation
    return false;
  }
  const Eigen::LDLT<Eigen::Matrix3d> ldlt(a);
  if (ldlt.rcond() < 1e-9) {
    return false;
  }
  matte = ldlt.solve(b);
  return true;
}

}  // namespace

std::vector<StudyLight> study_lights(const Rig& rig) {
  std::vector<StudyLight> lights;
  for (const LightElement& element : light_elements(rig)) {
    StudyLight light;
    light.is_position = true;
    light.coordinates = element.centre;
    light.emits = element.emits;
    light.lobe_mu = element.lobe_mu;
    light.strength = element.width_mm * element.height_mm;
    lights.push_back(light);
  }
  return lights;
}

std::vector<Eigen::Vector3d> light_directions_from(const std::vector<StudyLight>& lights,
                                                   const Eigen::Vector3d& point) {
  std::vector<Eigen::Vector3d> directions;
  for (const StudyLight& light : lights) {
    const Eigen::Vector3d to =
        light.is_position ? light.coordinates - point : light.coordinates;
    const double length = to.norm();
    directions.push_back(length > 0.0 ? Eigen::Vector3d(to / length)
                                      : Eigen::Vector3d(Eigen::Vector3d::UnitZ()));
  }
  return directions;
}

Eigen::Matrix3Xd light_factors(const std::vector<StudyLight>& lights,
                               const Eigen::Vector3d& point) {
  const std::vector<Eigen::Vector3d> directions = light_directions_from(lights, point);
  Eigen::Matrix3Xd factors(3, static_cast<Eigen::Index>(lights.size()));
  for (std::size_t k = 0; k < lights.size(); ++k) {
    const StudyLight& light = lights[k];
    double strength = light.strength;
    if (light.is_position) {
      strength /= std::max((light.coordinates - point).squaredNorm(), 1e-12);
    }
    if (!light.emits.isZero()) {
      const double cosine = std::max(0.0, -light.emits.dot(directions[k]));
      strength *= std::pow(cosine, light.lobe_mu);  // radiance ~ cos^(mu - 1), area ~ cos
    }
    factors.col(static_cast<Eigen::Index>(k)) = strength * directions[k];
  }
  return factors;
}

PixelVerdict classify_pixel(std::span<const float> values, const Eigen::Matrix3Xd& factors,
                            double dark_norm, const RegionRules& rules) {
  HAARLIGHT_EXPECTS(factors.cols() == static_cast<Eigen::Index>(values.size()),
                    "one factor per light");
  PixelVerdict verdict;
  double energy = 0.0;
  double sum = 0.0;
  float brightest = 0.0F;
  for (const float v : values) {
    energy += double{v} * double{v};
    sum += std::max(double{v}, 0.0);
    brightest = std::max(brightest, v);
  }
  if (!(energy > 0.0) || std::sqrt(energy) < dark_norm) {
    return verdict;
  }
  std::vector<bool> is_used(values.size());
  for (std::size_t k = 0; k < values.size(); ++k) {
    is_used[k] = double{values[k]} > kLitFraction * double{brightest};
  }
  for (int round = 0; round < kRounds; ++round) {
    if (!fit_matte(values, factors, is_used, verdict.matte)) {
      if (round == 0) {
        return verdict;
      }
      break;  // keep the last fit: too few lights agree with it
    }
    bool has_changed = false;
    for (std::size_t k = 0; k < values.size(); ++k) {
      const double model = verdict.matte.dot(factors.col(static_cast<Eigen::Index>(k)));
      const bool agrees = model > 0.0 && std::abs(double{values[k]} - model) < kAgrees * model;
      has_changed = has_changed || agrees != is_used[k];
      is_used[k] = agrees;
    }
    if (!has_changed) {
      break;
    }
  }
  const Eigen::VectorXd model = factors.transpose() * verdict.matte;
  const double facing = kFacing * model.maxCoeff();
  double above = 0.0;
  int n_attached = 0;
  int n_cast = 0;
  for (std::size_t k = 0; k < values.size(); ++k) {
    const double m = std::max(0.0, model[static_cast<Eigen::Index>(k)]);
    const auto value = double{values[k]};
    above += std::max(0.0, value - kAbove * m);
    if (model[static_cast<Eigen::Index>(k)] <= 0.0) {
      ++n_attached;
    } else if (m > facing && value < kHidden * m) {
      ++n_cast;
    }
  }
  const auto n = static_cast<double>(values.size());
  verdict.excess = sum > 0.0 ? above / sum : 0.0;
  verdict.attached = n_attached / n;
  verdict.cast = n_cast / n;
  if (verdict.excess >= rules.excess) {
    verdict.region = Region::specular;
  } else if (std::max(verdict.attached, verdict.cast) < rules.shadowed) {
    verdict.region = Region::diffuse;
  } else {
    verdict.region = verdict.attached > verdict.cast ? Region::attached : Region::cast;
  }
  return verdict;
}

Image<float> paint_regions(std::span<const Region> regions, int width, int height) {
  Image<float> picture(height, width, 3);
  HAARLIGHT_EXPECTS(picture.pixels().size() == 3 * regions.size(), "one region per pixel");
  for (std::size_t i = 0; i < regions.size(); ++i) {
    const std::array<float, 3> painted = colour(regions[i]);
    std::copy(painted.begin(), painted.end(),
              picture.pixels().begin() + static_cast<std::ptrdiff_t>(3 * i));
  }
  return picture;
}

std::vector<Region> read_region_picture(const std::filesystem::path& file, int width,
                                        int height) {
  const Image<float> picture = read_linear_image(file);
  if (picture.width() != width || picture.height() != height || picture.channels() < 3) {
    throw Error(
        fmt::format("regions of {} x {} with {} channels for a capture of {} x {}",
                    picture.width(), picture.height(), picture.channels(), width, height),
        file.string(), "paint over the regions.png that the command writes");
  }
  std::vector<Region> regions;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      Region found = Region::none;
      bool is_known = false;
      for (const Region region :
           {Region::none, Region::specular, Region::diffuse, Region::attached, Region::cast}) {
        const std::array<float, 3> painted = colour(region);
        bool is_same = true;
        for (int c = 0; c < 3; ++c) {
          is_same = is_same && (picture(y, x, c) >= 0.5F) ==
                                   (painted[static_cast<std::size_t>(c)] >= 0.5F);
        }
        if (is_same) {
          found = region;
          is_known = true;
        }
      }
      if (!is_known) {
        throw Error(fmt::format("no region has the colour of pixel ({}, {})", x, y),
                    file.string(),
                    "red specular, green diffuse, blue attached, yellow cast, black none");
      }
      regions.push_back(found);
    }
  }
  return regions;
}

}  // namespace haarlight::relight
