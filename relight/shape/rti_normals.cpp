// SPDX-License-Identifier: Apache-2.0
#include "relight/shape/rti_normals.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include <Eigen/LU>

#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "haarlight/relight/shape/normal_picture.h"

namespace haarlight::relight {

namespace {

using Eigen::Vector3d;

constexpr std::size_t kRowsATask = 16;
/// Below this fraction of the largest coefficient, a curvature is rounding of 8-bit planes.
constexpr double kFlat = 1e-9;

void store(const Vector3d& n, int y, int x, RtiNormals& out) {
  for (int c = 0; c < 3; ++c) {
    out.normal(y, x, c) = static_cast<float>(n[c]);
  }
}

double plane_value(const ReflectanceModel& model, int y, int x, int plane) {
  const PlaneScale& scale = model.scales[static_cast<std::size_t>(plane)];
  return double{static_cast<float>(model.planes(y, x, plane))} * scale.scale + scale.offset;
}

void ptm_row(const ReflectanceModel& model, int y, RtiNormals& out) {
  const int n_colours = model.colour == ReflectanceColour::lrgb ? 1 : 3;
  for (int x = 0; x < model.planes.width(); ++x) {
    Eigen::Matrix<double, 6, 1> a = Eigen::Matrix<double, 6, 1>::Zero();
    for (int c = 0; c < n_colours; ++c) {
      for (int t = 0; t < 6; ++t) {
        a[t] += plane_value(model, y, x, 6 * c + t) / n_colours;
      }
    }
    const PtmPeak peak = ptm_peak(a);
    out.is_known(y, x) = peak.state == PeakState::no_peak ? 0 : 1;
    store(peak.normal, y, x, out);
  }
}

RtiNormals hsh_normals(const ReflectanceModel& model) {
  const int h = model.planes.height();
  const int w = model.planes.width();
  RtiNormals out{Image<float>(h, w, 3), Image<std::uint8_t>(h, w, 1)};
  constexpr std::array<double, 3> kAzimuths = {30.0, 150.0, 270.0};
  Eigen::Matrix3d lights;
  std::array<Image<float>, 3> pictures;
  for (std::size_t i = 0; i < 3; ++i) {
    const double azimuth = kAzimuths[i] * std::numbers::pi / 180.0;
    const double flat = std::numbers::sqrt2 / 2.0;
    const Vector3d light(flat * std::cos(azimuth), flat * std::sin(azimuth), flat);
    lights.row(static_cast<Eigen::Index>(i)) = light.transpose();
    pictures[i] = relit(model, light);
  }
  const Eigen::Matrix3d solve = lights.inverse();
  parallel_for(
      static_cast<std::size_t>(h), kRowsATask, [&](std::size_t begin, std::size_t end) {
        for (int y = static_cast<int>(begin); y < static_cast<int>(end); ++y) {
          for (int x = 0; x < w; ++x) {
            Vector3d values = Vector3d::Zero();
            for (int i = 0; i < 3; ++i) {
              for (int c = 0; c < 3; ++c) {
                const float value = pictures[static_cast<std::size_t>(i)](y, x, c);
                values[i] +=
                    double{model.transfer == Transfer::srgb ? linear_from_srgb(value) : value} /
                    3.0;
              }
            }
            const Vector3d n = solve * values;
            const double length = n.norm();
            const bool is_known = length > 0.0 && n.allFinite();
            out.is_known(y, x) = is_known ? 1 : 0;
            store(is_known ? Vector3d(n / length) : Vector3d(Vector3d::UnitZ()), y, x, out);
          }
        }
      });
  return out;
}

}  // namespace

PtmPeak ptm_peak(const Eigen::Matrix<double, 6, 1>& a) noexcept {
  const double largest = a.head<5>().cwiseAbs().maxCoeff();
  const double determinant = 4.0 * a[0] * a[1] - a[2] * a[2];
  if (!(a[0] < 0.0) || !(determinant > kFlat * largest * largest)) {
    return {};
  }
  const double u = (a[2] * a[4] - 2.0 * a[1] * a[3]) / determinant;
  const double v = (a[2] * a[3] - 2.0 * a[0] * a[4]) / determinant;
  const double r2 = u * u + v * v;
  if (r2 > 1.0) {
    const double r = std::sqrt(r2);
    return {{u / r, v / r, 0.0}, PeakState::outside};
  }
  return {{u, v, std::sqrt(1.0 - r2)}, PeakState::peak};
}

RtiNormals rti_normals(const ReflectanceModel& model) {
  require_consistent(model, "a relightable picture");
  if (model.basis == ReflectanceBasis::hsh) {
    return hsh_normals(model);
  }
  if (model.basis != ReflectanceBasis::ptm || model.colour == ReflectanceColour::pca) {
    throw Error("normals are taken from a PTM or an HSH", std::string(to_string(model.basis)),
                "fit one of these two");
  }
  RtiNormals out{Image<float>(model.planes.height(), model.planes.width(), 3),
                 Image<std::uint8_t>(model.planes.height(), model.planes.width(), 1)};
  parallel_for(static_cast<std::size_t>(model.planes.height()), kRowsATask,
               [&](std::size_t begin, std::size_t end) {
                 for (std::size_t y = begin; y < end; ++y) {
                   ptm_row(model, static_cast<int>(y), out);
                 }
               });
  return out;
}

SurfaceEstimate rti_surface(const ReflectanceModel& model, ImageView<const std::uint8_t> mask,
                            const Eigen::Matrix3d& picture_from_world) {
  const RtiNormals found = rti_normals(model);
  const int h = found.is_known.height();
  const int w = found.is_known.width();
  HAARLIGHT_EXPECTS(mask.is_empty() || (mask.height() == h && mask.width() == w),
                    "a mask of the picture's size");
  SurfaceEstimate surface{turned_normals(found.normal.view(), picture_from_world.transpose()),
                          relit(model, Vector3d::UnitZ()), Image<float>(h, w, 1),
                          Image<std::uint16_t>(h, w, 1), Image<std::uint8_t>(h, w, 1)};
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      const PixelState state = !mask.is_empty() && mask(y, x) == 0 ? PixelState::masked
                               : found.is_known(y, x) == 0         ? PixelState::too_dark
                                                                   : PixelState::good;
      surface.state(y, x) = static_cast<std::uint8_t>(state);
      for (int c = 0; c < 3; ++c) {
        float& value = surface.albedo(y, x, c);
        if (state != PixelState::good) {
          surface.normal(y, x, c) = 0.0F;
          value = 0.0F;
          continue;
        }
        value =
            std::max(0.0F, model.transfer == Transfer::srgb ? linear_from_srgb(value) : value);
      }
    }
  }
  return surface;
}

}  // namespace haarlight::relight
