// SPDX-License-Identifier: Apache-2.0
#include "relight/calibration/sheet_layout.h"

#include <algorithm>
#include <array>
#include <cmath>

#include <Eigen/Cholesky>
#include <fmt/format.h>

#include "core/order_statistics.h"
#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

constexpr const char* kWhere = "calibration of the lights";
constexpr std::size_t kLeastRuns = 100;
constexpr std::size_t kNoiseBins = 8;

/// How the point seen moves with more radial distortion: one unit is, at the picture's corner,
/// the distance from the middle itself.
Eigen::Vector3d lens_shift(const CameraModel& camera, const PixelPoints& points, double x,
                           double y) {
  constexpr double kSmall = 1e-3;
  const double corner2 = std::pow(std::max(camera.cx, camera.width - camera.cx), 2) +
                         std::pow(std::max(camera.cy, camera.height - camera.cy), 2);
  const double dx = x - camera.cx;
  const double dy = y - camera.cy;
  const double fraction = kSmall * (dx * dx + dy * dy) / corner2;
  return (points.at(x + fraction * dx, y + fraction * dy) - points.at(x, y)) / kSmall;
}

/// A fourth difference of ln(I_k / I_j): its square, and the mean of 1 / I.
struct Run {
  double per_intensity = 0.0;
  double square = 0.0;
};

/// (1, -4, 6, -4, 1) of both lights: variance of the sum of ten independent logarithms.
constexpr std::array<double, 5> kFourth{1.0, -4.0, 6.0, -4.0, 1.0};
constexpr double kFourthSquares = 70.0;

void add_run(const TargetSamples& s, int k, int j, int channel, std::size_t first,
             std::size_t step, std::vector<Run>& runs) {
  double difference = 0.0;
  double per_intensity = 0.0;
  for (std::size_t i = 0; i < kFourth.size(); ++i) {
    const std::size_t p = first + i * step;
    const auto a = static_cast<double>(s.values(k, channel)[p]);
    const auto b = static_cast<double>(s.values(j, channel)[p]);
    if (s.used(k)[p] == 0 || s.used(j)[p] == 0 || !(a > 0.0) || !(b > 0.0)) {
      return;
    }
    difference += kFourth[i] * std::log(a / b);
    per_intensity += kFourth[i] * kFourth[i] * (1.0 / a + 1.0 / b) / (2.0 * kFourthSquares);
  }
  runs.push_back({per_intensity, difference * difference / (2.0 * kFourthSquares)});
}

}  // namespace

SheetLayout lay_out_sheet(const PixelPoints& points, int width, int height,
                          const Eigen::Isometry3d& sheet_from_world, const SheetRegion& region,
                          int samples) {
  SheetLayout out;
  out.width = width;
  out.height = height;
  const auto n = static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
  out.is_sheet.assign(n, 0);
  out.position.resize(n);
  out.x0 = width;
  out.y0 = height;
  int x1 = -1;
  int y1 = -1;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const Eigen::Vector3d p = sheet_from_world * points.at(x + 0.5, y + 0.5);
      const std::size_t at = static_cast<std::size_t>(y) * static_cast<std::size_t>(width) +
                             static_cast<std::size_t>(x);
      out.position[at] = p.head<2>();
      if (p.x() >= region.u0 && p.x() <= region.u1 && p.y() >= region.v0 &&
          p.y() <= region.v1) {
        out.is_sheet[at] = 1;
        out.x0 = std::min(out.x0, x);
        x1 = std::max(x1, x);
        out.y0 = std::min(out.y0, y);
        y1 = std::max(y1, y);
      }
    }
  }
  const int longer = std::max(x1 - out.x0 + 1, y1 - out.y0 + 1);
  out.block = std::max(1, longer / std::max(samples, 6));
  out.cols = x1 >= out.x0 ? (x1 - out.x0 + 1) / out.block : 0;
  out.rows = y1 >= out.y0 ? (y1 - out.y0 + 1) / out.block : 0;
  if (out.rows < 6 || out.cols < 6) {
    throw Error(
        fmt::format("the sheet fills {} x {} blocks of the picture", out.cols, out.rows),
        kWhere, "name a region of the plane that the camera sees: --region U0,U1,V0,V1");
  }
  return out;
}

TargetSamples samples_without_light(const SheetLayout& layout, const PixelPoints& points,
                                    const CameraModel& camera,
                                    const Eigen::Isometry3d& sheet_from_world, int n_lights,
                                    int n_channels) {
  TargetSamples s;
  s.n_lights = n_lights;
  s.n_channels = n_channels;
  s.rows = layout.rows;
  s.cols = layout.cols;
  const std::size_t n = layout.n_blocks();
  s.points_mm.assign(n, Eigen::Vector3d::Zero());
  s.normals.assign(n, Eigen::Vector3d::UnitZ());
  std::vector<std::uint8_t> is_whole(n, 1);
  const double per_block = 1.0 / (layout.block * layout.block);
  const auto width = static_cast<std::size_t>(layout.width);
  for (int y = layout.y0; y < layout.y0 + layout.rows * layout.block; ++y) {
    for (int x = layout.x0; x < layout.x0 + layout.cols * layout.block; ++x) {
      const std::size_t pixel =
          static_cast<std::size_t>(y) * width + static_cast<std::size_t>(x);
      const std::size_t block = static_cast<std::size_t>((y - layout.y0) / layout.block) *
                                    static_cast<std::size_t>(layout.cols) +
                                static_cast<std::size_t>((x - layout.x0) / layout.block);
      is_whole[block] = is_whole[block] != 0 && layout.is_sheet[pixel] != 0 ? 1 : 0;
      s.points_mm[block].head<2>() += per_block * layout.position[pixel];
    }
  }
  s.is_used.assign(static_cast<std::size_t>(n_lights) * n, 1);
  for (std::size_t block = 0; block < n; ++block) {
    const auto cols = static_cast<std::size_t>(layout.cols);
    const double x = layout.x0 + layout.block * (static_cast<double>(block % cols) + 0.5);
    const std::size_t row = block / cols;
    const double y = layout.y0 + layout.block * (static_cast<double>(row) + 0.5);
    s.to_camera.emplace_back((sheet_from_world.linear() * points.to_camera(x, y)).normalized());
    s.lens_mm.emplace_back(sheet_from_world.linear() * lens_shift(camera, points, x, y));
    for (std::size_t k = 0; is_whole[block] == 0 && k < static_cast<std::size_t>(n_lights);
         ++k) {
      s.is_used[k * n + block] = 0;
    }
  }
  return s;
}

CameraModel camera_over_sheet(int width, int height, double width_mm, double camera_mm,
                              const Eigen::Vector2d& tilt) {
  HAARLIGHT_EXPECTS(width > 0 && height > 0 && width_mm > 0.0 && camera_mm > 0.0, "sizes");
  CameraModel camera;
  camera.width = width;
  camera.height = height;
  camera.fx = camera.fy = width * camera_mm / width_mm;
  camera.cx = 0.5 * width;
  camera.cy = 0.5 * height;
  camera.world_from_cam =
      look_at(camera_mm * Eigen::Vector3d(tilt.x(), tilt.y(), 1.0).normalized(),
              Eigen::Vector3d::Zero(), Eigen::Vector3d::UnitY());
  return camera;
}

TargetSamples seen_from(TargetSamples samples, const SheetLayout& layout,
                        const CameraModel& camera) {
  HAARLIGHT_EXPECTS(samples.n_points() == layout.n_blocks(), "samples of this layout");
  const PixelPoints points = PixelPoints::on_plane(camera, Eigen::Vector3d::UnitZ(), 0.0);
  const auto cols = static_cast<std::size_t>(layout.cols);
  for (std::size_t block = 0; block < samples.n_points(); ++block) {
    const double x = layout.x0 + layout.block * (static_cast<double>(block % cols) + 0.5);
    const std::size_t row = block / cols;
    const double y = layout.y0 + layout.block * (static_cast<double>(row) + 0.5);
    samples.points_mm[block] = points.at(x, y);
    samples.to_camera[block] = points.to_camera(x, y);
    samples.lens_mm[block] = lens_shift(camera, points, x, y);
  }
  return samples;
}

SheetSampler::SheetSampler(SheetLayout layout, TargetSamples empty)
    : layout_(std::move(layout)), samples_(std::move(empty)) {
  HAARLIGHT_EXPECTS(samples_.n_points() == layout_.n_blocks(), "samples of this layout");
  samples_.intensity.assign(static_cast<std::size_t>(samples_.n_lights) *
                                static_cast<std::size_t>(samples_.n_channels) *
                                samples_.n_points(),
                            0.0F);
}

void SheetSampler::add(int light, ImageView<const float> picture, float clip) {
  HAARLIGHT_EXPECTS(
      light >= 0 && light < samples_.n_lights && picture.width() == layout_.width &&
          picture.height() == layout_.height && picture.channels() == samples_.n_channels,
      "a picture of this layout");
  const std::size_t n = layout_.n_blocks();
  const auto n_channels = static_cast<std::size_t>(samples_.n_channels);
  const double per_block = 1.0 / (layout_.block * layout_.block);
  std::vector<double> sum(n_channels * n, 0.0);
  std::uint8_t* used = samples_.is_used.data() + static_cast<std::size_t>(light) * n;
  for (int y = layout_.y0; y < layout_.y0 + layout_.rows * layout_.block; ++y) {
    for (int x = layout_.x0; x < layout_.x0 + layout_.cols * layout_.block; ++x) {
      const std::size_t block = static_cast<std::size_t>((y - layout_.y0) / layout_.block) *
                                    static_cast<std::size_t>(layout_.cols) +
                                static_cast<std::size_t>((x - layout_.x0) / layout_.block);
      for (std::size_t c = 0; c < n_channels; ++c) {
        const float value = picture(y, x, static_cast<int>(c));
        if (value >= clip) {
          used[block] = 0;
        }
        sum[c * n + block] += per_block * static_cast<double>(value);
      }
    }
  }
  std::copy(sum.begin(), sum.end(),
            samples_.intensity.begin() +
                static_cast<std::ptrdiff_t>(static_cast<std::size_t>(light) * sum.size()));
}

TargetSamples SheetSampler::finish() const {
  TargetSamples out = samples_;
  out.noise = noise_between_lights(out);
  return out;
}

SampleNoise noise_between_lights(const TargetSamples& s) {
  HAARLIGHT_EXPECTS(s.rows > 0 && s.cols > 0, "samples that lie as a picture");
  std::vector<Run> runs;
  const auto cols = static_cast<std::size_t>(s.cols);
  for (int k = 0; k < s.n_lights; ++k) {
    const int j = (k + 1) % s.n_lights;
    for (int c = 0; c < s.n_channels; ++c) {
      for (std::size_t y = 0; y < static_cast<std::size_t>(s.rows); ++y) {
        for (std::size_t x = 0; x < cols; ++x) {
          if (x + 4 < cols) {
            add_run(s, k, j, c, y * cols + x, 1, runs);
          }
          if (y + 4 < static_cast<std::size_t>(s.rows)) {
            add_run(s, k, j, c, y * cols + x, cols, runs);
          }
        }
      }
    }
  }
  if (runs.size() < kLeastRuns) {
    throw Error(fmt::format("{} runs of five blocks are lit by two lights", runs.size()),
                kWhere,
                "look for saturated or black pictures, and for a sheet that fills too little "
                "of them");
  }
  std::sort(runs.begin(), runs.end(),
            [](const Run& a, const Run& b) { return a.per_intensity < b.per_intensity; });
  // relative^2 + shot / I fitted to each bin's median, weighted by its own square.
  Eigen::Matrix2d m = Eigen::Matrix2d::Zero();
  Eigen::Vector2d rhs = Eigen::Vector2d::Zero();
  for (std::size_t b = 0; b < kNoiseBins; ++b) {
    const std::size_t begin = b * runs.size() / kNoiseBins;
    const std::size_t end = (b + 1) * runs.size() / kNoiseBins;
    std::vector<double> squares;
    double per_intensity = 0.0;
    for (std::size_t i = begin; i < end; ++i) {
      squares.push_back(runs[i].square);
      per_intensity += runs[i].per_intensity / static_cast<double>(end - begin);
    }
    constexpr double kMedianOfChi2 = 0.4549;  // one degree of freedom
    const double variance = std::max(upper_median(squares) / kMedianOfChi2, 1e-12);
    const Eigen::Vector2d row(1.0 / variance, per_intensity / variance);
    m += row * row.transpose();
    rhs += row;
  }
  Eigen::Vector2d line = m.ldlt().solve(rhs);
  if (!(line[0] >= 0.0) || !line.allFinite()) {
    line = {0.0, rhs[1] / m(1, 1)};
  } else if (!(line[1] >= 0.0)) {
    line = {rhs[0] / m(0, 0), 0.0};
  }
  return {.relative = std::max(std::sqrt(line[0]), 1e-5), .shot = line[1], .floor = 0.0};
}

}  // namespace haarlight::relight
