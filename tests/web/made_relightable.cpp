// SPDX-License-Identifier: Apache-2.0
/// @file
/// Writes web folders of every kind and the pictures that they must show, for the browser's
/// test: made_relightable OUT [IN]. IN: a picture that can be relit; without it, smooth waves.

#include <cstdio>
#include <exception>
#include <string>
#include <vector>

#include <Eigen/Eigenvalues>
#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/relight/reflectance/formats/quantise.h"
#include "haarlight/relight/reflectance/formats/refit.h"
#include "haarlight/relight/reflectance/formats/reflectance_file.h"
#include "tests/relight/reflectance/formats/quantise_model.h"
#include "tests/relight/reflectance/formats/reflectance_truth.h"

namespace haarlight {

namespace {

namespace fs = std::filesystem;

constexpr int kLights = 9;
constexpr int kResolution = 8;
constexpr int kAxes = 18;

relight::ReflectanceModel waves() {
  relight::ReflectanceModel model =
      testing::empty_model(relight::ReflectanceBasis::hsh, relight::ReflectanceColour::rgb, 9);
  relight::quantise(model, testing::smooth_coefficients(72, 96, 27).view());
  return model;
}

/// A luminance times a colour. The luminance is above 0 and mostly below 1.
relight::ReflectanceModel luminance_waves() {
  relight::ReflectanceModel model =
      testing::empty_model(relight::ReflectanceBasis::ptm, relight::ReflectanceColour::lrgb, 6);
  Image<float> coefficients = testing::smooth_coefficients(72, 96, 9);
  for (int y = 0; y < coefficients.height(); ++y) {
    for (int x = 0; x < coefficients.width(); ++x) {
      coefficients(y, x, 5) += 0.35F;
      for (int c = 6; c < 9; ++c) {
        coefficients(y, x, c) *= 2.0F;
      }
    }
  }
  relight::quantise(model, coefficients.view());
  return model;
}

/// The direction of a node of the octahedral grid.
Eigen::Vector3d node_direction(int column, int row) {
  const double a = 2.0 * column / (kResolution - 1) - 1.0;
  const double b = 2.0 * row / (kResolution - 1) - 1.0;
  const double x = (a - b) / 2.0;
  const double y = (a + b) / 2.0;
  return Eigen::Vector3d(x, y, 1.0 - std::abs(x) - std::abs(y)).normalized();
}

/// A picture's colours at the nodes, and their principal axes.
relight::ReflectanceModel bilinear_of(const relight::ReflectanceModel& source) {
  constexpr int kN = 3 * kResolution * kResolution;
  std::vector<Image<float>> pictures;
  for (int row = 0; row < kResolution; ++row) {
    for (int column = 0; column < kResolution; ++column) {
      pictures.push_back(relight::relit(source, node_direction(column, row)));
    }
  }
  const int height = source.planes.height();
  const int width = source.planes.width();
  const auto colours_of = [&](int y, int x) {
    Eigen::VectorXf colours(kN);
    for (int i = 0; i < kN; ++i) {
      colours[i] = pictures[static_cast<std::size_t>(i / 3)](y, x, i % 3);
    }
    return colours;
  };
  Eigen::VectorXf mean = Eigen::VectorXf::Zero(kN);
  Eigen::MatrixXf moments = Eigen::MatrixXf::Zero(kN, kN);
  float n = 0.0F;
  for (int y = 0; y < height; y += 4) {
    for (int x = 0; x < width; x += 4) {
      const Eigen::VectorXf colours = colours_of(y, x);
      mean += colours;
      moments.selfadjointView<Eigen::Lower>().rankUpdate(colours);
      n += 1.0F;
    }
  }
  mean /= n;
  moments /= n;
  moments.selfadjointView<Eigen::Lower>().rankUpdate(mean, -1.0F);
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXf> solver(moments);
  relight::ReflectanceModel model = testing::empty_model(
      relight::ReflectanceBasis::bilinear, relight::ReflectanceColour::pca, kAxes);
  model.resolution = kResolution;
  model.axes.resize(kAxes + 1, kN);
  model.axes.row(0) = mean.transpose();
  model.axes.bottomRows(kAxes) =
      solver.eigenvectors().rightCols(kAxes).rowwise().reverse().transpose();
  Image<float> weights(height, width, kAxes);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const Eigen::VectorXf found = model.axes.bottomRows(kAxes) * (colours_of(y, x) - mean);
      std::copy(found.begin(), found.end(), &weights(y, x));
    }
  }
  relight::quantise(model, weights.view());
  return model;
}

void make(const fs::path& out, const std::string& input) {
  const relight::ReflectanceModel source =
      input.empty() ? waves() : relight::read_reflectance(input);
  const auto fitted = [&](relight::ReflectanceBasis basis, int n_terms) {
    return relight::refit(source, {.basis = basis, .n_terms = n_terms},
                          relight::refit_directions(source, n_terms));
  };
  const std::vector<std::pair<std::string, relight::ReflectanceModel>> models{
      {"ptm", fitted(relight::ReflectanceBasis::ptm, 6)},
      {"hsh", fitted(relight::ReflectanceBasis::hsh, 9)},
      {"lptm", luminance_waves()},
      {"bilinear", bilinear_of(source)}};
  const std::vector<Eigen::Vector3d> lights = relight::spread_over_hemisphere(kLights, 0.4);
  std::string list;
  for (const Eigen::Vector3d& light : lights) {
    list += fmt::format("{}[{:.17g},{:.17g},{:.17g}]", list.empty() ? "" : ",", light.x(),
                        light.y(), light.z());
  }
  fs::create_directories(out);
  for (const auto& [name, model] : models) {
    relight::write_reflectance(out / name, model);
    for (std::size_t i = 0; i < lights.size(); ++i) {
      Image<float> picture = relight::relit(model, lights[i]);
      for (float& value : picture.pixels()) {
        value = linear_from_srgb(value);
      }
      write_image(out / fmt::format("{}_{}.png", name, i), picture.view());
    }
  }
  write_file_atomically(out / "lights.json", "[" + list + "]\n");
}

}  // namespace

}  // namespace haarlight

int main(int argc, char** argv) {
  try {
    if (argc < 2 || argc > 3) {
      std::fputs("usage: made_relightable OUT [IN]\n", stderr);
      return 2;
    }
    haarlight::make(argv[1], argc > 2 ? argv[2] : "");
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "made_relightable: %s\n", error.what());
    return 70;
  }
}
