#include "relight/formats/reflectance.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>

#include <fmt/format.h>

#include "core/parallel.h"

namespace haarlight {

std::string_view to_string(ReflectanceBasis basis) noexcept {
  switch (basis) {
    case ReflectanceBasis::ptm:
      return "ptm";
    case ReflectanceBasis::hsh:
      return "hsh";
    case ReflectanceBasis::rbf:
      return "rbf";
    case ReflectanceBasis::bilinear:
      return "bilinear";
  }
  return "?";
}

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

std::vector<double> basis_terms(const ReflectanceModel& model,
                                const Eigen::Vector3d& direction) {
  if (model.basis == ReflectanceBasis::ptm) {
    const auto terms = ptm_terms(direction);
    return {terms.begin(), terms.end()};
  }
  HAARLIGHT_EXPECTS(model.basis == ReflectanceBasis::hsh, "a basis with fixed terms");
  const auto terms = hsh_terms(direction, model.n_terms, model.order4);
  return {terms.begin(), terms.begin() + model.n_terms};
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
}

namespace {

/// A linear map from a pixel's bytes to its colour: (3, n_planes) and what is added.
struct ByteMap {
  Eigen::Matrix<float, 3, Eigen::Dynamic> factors;
  Eigen::Vector3f added = Eigen::Vector3f::Zero();
};

/// rgb and, with all three rows alike, the luminance of lrgb.
ByteMap map_of(const ReflectanceModel& model, const std::vector<double>& terms) {
  const int n = model.n_terms;
  ByteMap map;
  map.factors.setZero(3, model.n_planes());
  Eigen::Vector3d added = Eigen::Vector3d::Zero();
  for (int c = 0; c < 3; ++c) {
    const int first = model.colour == ReflectanceColour::rgb ? c * n : 0;
    for (int j = 0; j < n; ++j) {
      const PlaneScale& scale = model.scales[static_cast<std::size_t>(first + j)];
      const double term = terms[static_cast<std::size_t>(j)];
      map.factors(c, first + j) = static_cast<float>(scale.scale * term);
      added[c] += scale.offset * term;
    }
  }
  map.added = added.cast<float>();
  return map;
}

}  // namespace

Image<float> relit(const ReflectanceModel& model, const Eigen::Vector3d& direction) {
  HAARLIGHT_EXPECTS(model.colour != ReflectanceColour::pca, "rgb or lrgb");
  const ByteMap map = map_of(model, basis_terms(model, direction));
  Image<float> picture(model.planes.height(), model.planes.width(), 3);
  const auto n_planes = static_cast<std::size_t>(model.n_planes());
  const bool is_lrgb = model.colour == ReflectanceColour::lrgb;
  const auto n_terms = static_cast<std::size_t>(model.n_terms);
  parallel_for(
      static_cast<std::size_t>(picture.height()), 16, [&](std::size_t begin, std::size_t end) {
        for (std::size_t y = begin; y < end; ++y) {
          const auto bytes = model.planes.view().row(static_cast<int>(y));
          const auto out = picture.view().row(static_cast<int>(y));
          for (std::size_t x = 0; x < static_cast<std::size_t>(picture.width()); ++x) {
            const std::uint8_t* pixel = &bytes[x * n_planes];
            Eigen::Vector3f colour = map.added;
            for (std::size_t p = 0; p < (is_lrgb ? n_terms : n_planes); ++p) {
              colour +=
                  static_cast<float>(pixel[p]) * map.factors.col(static_cast<Eigen::Index>(p));
            }
            for (std::size_t c = 0; c < 3; ++c) {
              float value = colour[static_cast<Eigen::Index>(c)];
              if (is_lrgb) {
                const PlaneScale& scale = model.scales[n_terms + c];
                value *= static_cast<float>(pixel[n_terms + c] * scale.scale + scale.offset);
              }
              out[3 * x + c] = value;
            }
          }
        }
      });
  return picture;
}

}  // namespace haarlight
