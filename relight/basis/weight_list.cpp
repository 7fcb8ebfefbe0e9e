// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/weight_list.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <string_view>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "core/text_limits.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"

namespace haarlight::relight {

namespace {

using nlohmann::json;

constexpr double kMost =
    1e20;  // of a weight: sums of products end in single precision at 3.4e38
constexpr std::uintmax_t kMaxWeightBytes = std::uintmax_t{64} << 20U;  // 3 * 24576 numbers

void add_word(std::string_view word, Eigen::MatrixXd& weights, const std::string& where) {
  const auto n_lights = weights.rows();
  const std::size_t equals = word.find('=');
  const std::string_view light = word.substr(0, equals);
  int k = -1;
  double w = 1.0;
  auto [end, code] = std::from_chars(light.data(), light.data() + light.size(), k);
  bool is_good = code == std::errc() && end == light.data() + light.size();
  if (is_good && equals != std::string_view::npos) {
    const std::string_view number = word.substr(equals + 1);
    const auto read = std::from_chars(number.data(), number.data() + number.size(), w);
    is_good = read.ec == std::errc() && read.ptr == number.data() + number.size() &&
              std::abs(w) <= kMost;
  }
  if (!is_good) {
    throw Error(fmt::format("'{}' is not a light and its weight", word), where,
                "write a light's number, or NUMBER=WEIGHT, for example 528 or 528=0.5",
                ExitCode::usage);
  }
  if (k < 0 || k >= n_lights) {
    throw Error(fmt::format("there is no light {}", k), where,
                fmt::format("the lights are 0 to {}", n_lights - 1), ExitCode::usage);
  }
  weights(k, 0) += w;
}

void flatten(const json& value, int depth, std::vector<double>& numbers,
             const std::string& where) {
  constexpr int kDeepest = 4;
  if (value.is_number()) {
    numbers.push_back(value.get<double>());
    return;
  }
  if (!value.is_array() || depth > kDeepest) {
    throw Error("the weights are not a list of numbers", where,
                "write a list of one number, or [r, g, b], a light");
  }
  for (const json& item : value) {
    flatten(item, depth + 1, numbers, where);
  }
}

}  // namespace

Eigen::MatrixXd weights_from_words(const std::vector<std::string>& words, int n_lights,
                                   const std::string& where) {
  Eigen::MatrixXd weights = Eigen::MatrixXd::Zero(n_lights, 1);
  for (const std::string& text : words) {
    std::size_t begin = 0;
    while (begin <= text.size()) {
      const std::size_t end = std::min(text.find(',', begin), text.size());
      add_word(std::string_view(text).substr(begin, end - begin), weights, where);
      begin = end + 1;
    }
  }
  return weights;
}

Eigen::MatrixXd weights_from_json(const std::filesystem::path& file, int n_lights) {
  return weights_from_json_text(read_file(file, kMaxWeightBytes), file.string(), n_lights);
}

Eigen::MatrixXd weights_from_json_text(std::string_view text, const std::string& where,
                                       int n_lights) {
  const json root = parse_json<json>(text, where);
  std::vector<double> numbers;
  flatten(root, 0, numbers, where);
  const auto n = static_cast<int>(numbers.size());
  if (n != n_lights && n != 3 * n_lights) {
    throw Error(fmt::format("{} numbers for {} lights", n, n_lights), where,
                "write one number, or [r, g, b], a light");
  }
  const int colours = n / n_lights;
  Eigen::MatrixXd weights(n_lights, colours);
  for (int i = 0; i < n; ++i) {
    const double w = numbers[static_cast<std::size_t>(i)];
    if (!(std::abs(w) <= kMost)) {
      throw Error(fmt::format("weight {} is {:.3g}: at most {:.0e}", i, w, kMost), where,
                  "correct the number, or scale all of them down");
    }
    weights(i / colours, i % colours) = w;
  }
  return weights;
}

}  // namespace haarlight::relight
