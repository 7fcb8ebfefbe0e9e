// SPDX-License-Identifier: Apache-2.0
/// @file
/// Does a choice of parameters per pixel pay? Their error at lights left out, summed over a
/// window around each pixel, chooses there; held against one choice for all pixels and against
/// the choice that knows the held-out pictures. Parameters as they are, before planes and
/// bytes: the most that a choice per pixel could gain. A table of
/// docs/numerics/reflectance-fits.md.

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <string>
#include <vector>

#include <fmt/format.h>

#include "haarlight/session/light_file.h"
#include "relight/reflectance/fit/fit_check.h"
#include "relight/reflectance/fit/light_interpolation.h"
#include "relight/reflectance/fit/parameter_choice.h"
#include "relight/reflectance/fit/picture_rows.h"

namespace haarlight {
namespace {

namespace fs = std::filesystem;
using Eigen::ArrayXf;
using Eigen::Index;
using Eigen::MatrixXf;

/// (n_lights, 3 * n_pixels), 0..1.
MatrixXf values_of(relight::PictureRows& rows) {
  const StackDims shape = rows.dims();
  const Index n_row = Index{3} * shape.width;
  MatrixXf values(shape.n_lights, n_row * shape.height);
  std::vector<std::uint16_t> line(static_cast<std::size_t>(n_row * shape.n_lights));
  rows.rewind();
  for (Index y = 0; y < shape.height; ++y) {
    rows.read(1, line);
    for (Index k = 0; k < shape.n_lights; ++k) {
      for (Index i = 0; i < n_row; ++i) {
        values(k, y * n_row + i) =
            static_cast<float>(line[static_cast<std::size_t>(k * n_row + i)]) / 65535.0F;
      }
    }
  }
  return values;
}

/// A pixel's sum of squares over channels and rows of `errors`.
ArrayXf squares_of(const MatrixXf& errors) {
  const ArrayXf channels = errors.colwise().squaredNorm().transpose().array();
  ArrayXf out(channels.size() / 3);
  for (Index p = 0; p < out.size(); ++p) {
    out[p] = channels[3 * p] + channels[3 * p + 1] + channels[3 * p + 2];
  }
  return out;
}

/// Sums over windows of (2 * radius + 1)^2 pixels, cut at the border.
ArrayXf window_sums(const ArrayXf& values, const StackDims& shape, int radius) {
  if (radius == 0) {
    return values;
  }
  const Index w = shape.width;
  const Index h = shape.height;
  Eigen::ArrayXXd sums = Eigen::ArrayXXd::Zero(w + 1, h + 1);
  for (Index y = 0; y < h; ++y) {
    double row = 0.0;
    for (Index x = 0; x < w; ++x) {
      row += static_cast<double>(values[y * w + x]);
      sums(x + 1, y + 1) = sums(x + 1, y) + row;
    }
  }
  ArrayXf out(values.size());
  for (Index y = 0; y < h; ++y) {
    const Index top = std::max<Index>(0, y - radius);
    const Index bottom = std::min<Index>(h, y + radius + 1);
    for (Index x = 0; x < w; ++x) {
      const Index left = std::max<Index>(0, x - radius);
      const Index right = std::min<Index>(w, x + radius + 1);
      out[y * w + x] = static_cast<float>(sums(right, bottom) - sums(left, bottom) -
                                          sums(right, top) + sums(left, top));
    }
  }
  return out;
}

/// Mean over the held-out pictures of their PSNR, dB.
double psnr_db(const MatrixXf& errors) {
  double sum = 0.0;
  for (Index k = 0; k < errors.rows(); ++k) {
    sum -= 10.0 * std::log10(static_cast<double>(errors.row(k).squaredNorm()) /
                             static_cast<double>(errors.cols()));
  }
  return sum / static_cast<double>(errors.rows());
}

/// What was chosen so far by one rule.
struct Choice {
  std::string name;
  int radius = 0;
  bool is_told = false;  ///< knows the held-out pictures
  ArrayXf best{};
  MatrixXf errors{};

  void look(const ArrayXf& score, const MatrixXf& at_held) {
    if (best.size() == 0) {
      best = score;
      errors = at_held;
      return;
    }
    for (Index p = 0; p < score.size(); ++p) {
      if (score[p] < best[p]) {
        best[p] = score[p];
        errors.middleCols<3>(3 * p) = at_held.middleCols<3>(3 * p);
      }
    }
  }
};

int run(const std::string& folder) {
  const fs::path lp = fs::path(folder) / "dirs.lp";
  const session::LightList list =
      session::read_light_file(lp, session::LightCoordinates::directions);
  std::vector<fs::path> kept_files;
  std::vector<fs::path> held_files;
  std::vector<Eigen::Vector3d> kept;
  std::vector<Eigen::Vector3d> held;
  const relight::HoldOut hold_out{6, 2};
  for (std::size_t k = 0; k < list.lights.size(); ++k) {
    const bool is_held = hold_out.has(static_cast<int>(k));
    (is_held ? held : kept).push_back(list.lights[k].coordinates.normalized());
    (is_held ? held_files : kept_files).push_back(lp.parent_path() / list.lights[k].name);
  }
  const auto kept_rows = relight::jpeg_rows(kept_files);
  const StackDims shape = kept_rows->dims();
  const MatrixXf seen = values_of(*kept_rows);
  const MatrixXf unseen = values_of(*relight::jpeg_rows(held_files));

  double best_psnr = -1e300;
  double set_db = 0.0;
  std::string set_name;
  std::vector<Choice> choices{{"a pixel", 0},
                              {"5 x 5 pixels", 2},
                              {"61 x 61 pixels", 30},
                              {"a pixel, told the held-out pictures", 0, true}};
  int n_candidates = 0;
  for (const relight::FitForm form : {relight::FitForm::ptm, relight::FitForm::hsh9,
                                      relight::FitForm::hsh16, relight::FitForm::bilinear}) {
    for (const relight::LightInterpolation& interpolation : relight::candidates_of(form, {})) {
      const Eigen::MatrixXd residual = relight::leave_one_out(interpolation, kept);
      if (!residual.allFinite()) {
        continue;
      }
      ++n_candidates;
      const MatrixXf left_out = residual.cast<float>() * seen;
      const MatrixXf shown =
          (relight::interpolation_weights(interpolation, kept, held).cast<float>() * seen)
              .cwiseMax(0.0F)
              .cwiseMin(1.0F);
      const MatrixXf at_held = shown - unseen;
      const double psnr = psnr_db(left_out);
      if (psnr > best_psnr) {
        best_psnr = psnr;
        set_db = psnr_db(at_held);
        set_name = describe(interpolation);
      }
      const ArrayXf squares = squares_of(left_out);
      for (Choice& choice : choices) {
        choice.look(
            choice.is_told ? squares_of(at_held) : window_sums(squares, shape, choice.radius),
            at_held);
      }
    }
  }
  fmt::print("{}: {} lights and {} held out, {} candidates\n", folder, kept.size(), held.size(),
             n_candidates);
  fmt::print("  {:38} {:6.2f} dB  ({})\n", "one choice for all pixels", set_db, set_name);
  for (const Choice& choice : choices) {
    const double db = psnr_db(choice.errors);
    fmt::print("  {:38} {:6.2f} dB  {:+.2f}\n", choice.name, db, db - set_db);
  }
  return 0;
}

}  // namespace
}  // namespace haarlight

int main(int argc, char** argv) {
  if (argc != 2) {
    fmt::print(stderr, "usage: relight_pixel_choice FOLDER   (pictures and dirs.lp)\n");
    return 2;
  }
  try {
    return haarlight::run(argv[1]);
  } catch (const std::exception& error) {
    fmt::print(stderr, "relight_pixel_choice: {}\n", error.what());
    return 1;
  }
}
