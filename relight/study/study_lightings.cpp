// SPDX-License-Identifier: Apache-2.0
#include "relight/study/study_lightings.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "core/random.h"
#include "core/text_limits.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"

namespace haarlight::relight {

namespace {

constexpr std::uint64_t kSky = 0x736b79;
constexpr double kFloor = 0.3;         // of the smooth lobe
constexpr double kLobe = 16.0;         // its cosine's power: half at 17 degrees
constexpr double kSunFraction = 0.01;  // of the lights, in the high-frequency sky
constexpr double kSun = 60.0;
constexpr double kSky0 = 0.2;

std::vector<int> side_by_side(const ArrayGrid& grid, int side) {
  std::vector<int> lights;
  if (grid.rows < side || grid.cols < side) {
    return lights;
  }
  const int row = std::clamp(grid.rows * 13 / 32 - (side - 1) / 2, 0, grid.rows - side);
  const int col = std::clamp(grid.cols * 19 / 32 - (side - 1) / 2, 0, grid.cols - side);
  for (int y = row; y < row + side; ++y) {
    for (int x = col; x < col + side; ++x) {
      lights.push_back(y * grid.cols + x);
    }
  }
  return lights;
}

std::vector<int> nearest(const std::vector<Eigen::Vector3d>& directions, int light, int n) {
  if (static_cast<std::size_t>(n) > directions.size()) {
    return {};
  }
  std::vector<int> all(directions.size());
  std::iota(all.begin(), all.end(), 0);
  const Eigen::Vector3d at = directions[static_cast<std::size_t>(light)];
  std::stable_sort(all.begin(), all.end(), [&](int a, int b) {
    return (directions[static_cast<std::size_t>(a)] - at).squaredNorm() <
           (directions[static_cast<std::size_t>(b)] - at).squaredNorm();
  });
  all.resize(static_cast<std::size_t>(n));
  return all;
}

void read_numbers(const nlohmann::json& value, std::vector<double>& out) {
  if (value.is_array()) {
    for (const auto& part : value) {
      read_numbers(part, out);
    }
  } else {
    out.push_back(value.get<double>());
  }
}

}  // namespace

std::vector<StudyLighting> default_lightings(const std::vector<Eigen::Vector3d>& directions,
                                             const ArrayGrid& grid) {
  const auto n = static_cast<Eigen::Index>(directions.size());
  HAARLIGHT_EXPECTS(n > 0, "lights");
  const int one =
      grid.is_grid() ? side_by_side(grid, 1).front() : static_cast<int>(n * 13 / 32);
  std::vector<StudyLighting> all;
  const char* const names[] = {"one light", "four lights", "nine lights"};
  for (int side = 1; side <= 3; ++side) {
    const std::vector<int> lit =
        grid.is_grid() ? side_by_side(grid, side) : nearest(directions, one, side * side);
    if (lit.empty()) {
      continue;
    }
    StudyLighting lighting{names[side - 1], Eigen::VectorXd::Zero(n)};
    for (const int k : lit) {
      lighting.weights[k] = 1.0;
    }
    all.push_back(std::move(lighting));
  }
  StudyLighting smooth{"smooth", Eigen::VectorXd(n)};
  StudyLighting sky{"high frequency", Eigen::VectorXd(n)};
  const Eigen::Vector3d& axis = directions[static_cast<std::size_t>(one)];
  for (Eigen::Index k = 0; k < n; ++k) {
    const double cosine = std::max(0.0, axis.dot(directions[static_cast<std::size_t>(k)]));
    smooth.weights[k] = kFloor + (1.0 - kFloor) * std::pow(cosine, kLobe);
    const auto key = static_cast<std::uint64_t>(k);
    const bool is_sun = uniform_unit(hash_key(kSky, key, 1)) < kSunFraction;
    sky.weights[k] = is_sun ? kSun : kSky0 * std::exp(standard_normal(hash_key(kSky, key, 2)));
  }
  all.push_back(std::move(smooth));
  all.push_back(std::move(sky));
  return all;
}

std::vector<StudyLighting> lightings_from_json(const std::filesystem::path& file,
                                               int n_lights) {
  std::vector<StudyLighting> all;
  try {
    const auto root =
        parse_json<nlohmann::ordered_json>(read_file(file, kMaxJsonBytes), file.string());
    if (!root.is_object() || root.empty()) {
      throw Error("no lightings", file.string(),
                  "write {\"name\": [one number per light], ...}");
    }
    for (const auto& [name, value] : root.items()) {
      std::vector<double> numbers;
      read_numbers(value, numbers);
      if (numbers.size() != static_cast<std::size_t>(n_lights)) {
        throw Error(fmt::format("{} numbers for {} lights", numbers.size(), n_lights),
                    file.string() + ": " + name, "write one number per light");
      }
      StudyLighting lighting{name, Eigen::VectorXd(n_lights)};
      for (Eigen::Index k = 0; k < n_lights; ++k) {
        lighting.weights[k] = numbers[static_cast<std::size_t>(k)];
        if (!std::isfinite(lighting.weights[k])) {
          throw Error(fmt::format("the weight of light {} is not finite", k),
                      file.string() + ": " + name, "write finite numbers");
        }
      }
      all.push_back(std::move(lighting));
    }
  } catch (const nlohmann::json::exception& e) {
    throw Error(std::string("no list of lightings: ") + e.what(), file.string(),
                "write {\"name\": [one number per light], ...}");
  }
  return all;
}

}  // namespace haarlight::relight
