#include "capture/light_survey.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include <Eigen/Dense>

#include "core/error.h"

namespace haarlight {

namespace {

constexpr int kGrid = 24;              // picture points across and down for the expectation
constexpr double kTukey = 4.685;       // 95 % efficiency for normal errors
constexpr double kMinLogSigma = 1e-3;  // no LED's neighbour is known better
constexpr double kFar = 0.6;           // of the distance to a neighbour: not in its place
constexpr double kNear = 0.45;         // ... and this near to another's: there it is
constexpr int kMinForSurface = 12;     // lights of a face to fit a quadratic surface

double median(std::vector<double> values) {
  if (values.empty()) {
    return 0.0;
  }
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// 1, u, v, u^2, u v, v^2 of a light's place in its face, u and v in -1 .. 1.
Eigen::Matrix<double, 6, 1> place_terms(const Face& face, const LightElement& light) {
  const double u = face.cols > 1 ? 2.0 * light.col / (face.cols - 1) - 1.0 : 0.0;
  const double v = face.rows > 1 ? 2.0 * light.row / (face.rows - 1) - 1.0 : 0.0;
  Eigen::Matrix<double, 6, 1> terms;
  terms << 1.0, u, v, u * u, u * v, v * v;
  return terms;
}

/// A surface over one face, robust against outliers (Tukey's biweight, started from medians).
struct Surface {
  Eigen::Matrix<double, 6, 1> coefficients = Eigen::Matrix<double, 6, 1>::Zero();
  double spread = 0.0;  ///< robust sigma of the residuals

  [[nodiscard]] double at(const Eigen::Matrix<double, 6, 1>& terms) const {
    return coefficients.dot(terms);
  }
};

Surface fit_surface(const std::vector<Eigen::Matrix<double, 6, 1>>& terms,
                    const std::vector<double>& values, double floor) {
  Surface surface;
  if (values.empty()) {
    return surface;
  }
  const Eigen::Index n_terms = values.size() >= kMinForSurface ? 6 : 1;
  surface.coefficients[0] = median(values);
  std::vector<double> residuals(values.size());
  for (int iteration = 0; iteration < 30; ++iteration) {
    for (std::size_t i = 0; i < values.size(); ++i) {
      residuals[i] = values[i] - surface.at(terms[i]);
    }
    std::vector<double> sizes(residuals.size());
    std::transform(residuals.begin(), residuals.end(), sizes.begin(),
                   [](double r) { return std::abs(r); });
    surface.spread = std::max(1.4826 * median(sizes), floor);
    Eigen::MatrixXd normal = 1e-12 * Eigen::MatrixXd::Identity(n_terms, n_terms);
    Eigen::VectorXd right = Eigen::VectorXd::Zero(n_terms);
    for (std::size_t i = 0; i < values.size(); ++i) {
      const double z = residuals[i] / (kTukey * surface.spread);
      if (std::abs(z) >= 1.0) {
        continue;
      }
      const double w = (1.0 - z * z) * (1.0 - z * z);
      const Eigen::VectorXd t = terms[i].head(n_terms);
      normal += w * t * t.transpose();
      right += w * t * values[i];
    }
    surface.coefficients.head(n_terms) = normal.ldlt().solve(right);
  }
  return surface;
}

}  // namespace

std::vector<double> expected_signals(const Rig& rig, int camera) {
  const CameraSpec& spec = rig.cameras.at(static_cast<std::size_t>(camera));
  struct PlanePoint {
    Eigen::Vector3d at;
    Eigen::Vector3d n;
  };
  std::vector<PlanePoint> points;
  for (int j = 0; j < kGrid; ++j) {
    for (int i = 0; i < kGrid; ++i) {
      const CameraRay ray = ray_through(spec.model, (i + 0.5) * spec.model.width / kGrid,
                                        (j + 0.5) * spec.model.height / kGrid);
      double nearest = std::numeric_limits<double>::infinity();
      const ShadowPlane* seen = nullptr;
      for (const ShadowPlane& plane : rig.planes) {
        const double towards = plane.n.dot(ray.direction_world);
        const double t = -(plane.n.dot(ray.origin_world) + plane.d) / towards;
        if (towards != 0.0 && t > 0.0 && t < nearest) {
          nearest = t;
          seen = &plane;
        }
      }
      if (seen != nullptr) {
        points.push_back({ray.origin_world + nearest * ray.direction_world, seen->n});
      }
    }
  }
  std::vector<double> expected;
  for (const LightElement& light : light_elements(rig)) {
    double sum = 0.0;
    for (const PlanePoint& point : points) {
      const Eigen::Vector3d way = light.centre - point.at;
      const double r2 = way.squaredNorm();
      const double r = std::sqrt(r2);
      const double cos_plane = std::abs(point.n.dot(way)) / r;
      const double cos_light = std::max(0.0, -light.emits.dot(way) / r);
      sum += cos_plane * std::pow(cos_light, light.lobe_mu) / r2;
    }
    expected.push_back(sum);
  }
  if (*std::max_element(expected.begin(), expected.end()) <= 0.0) {
    std::fill(expected.begin(), expected.end(), 1.0);  // no plane in view: neighbours only
  }
  return expected;
}

LightSurvey survey_lights(const Rig& rig, int camera, std::span<const LightResponse> responses,
                          const SurveyOptions& options) {
  HAARLIGHT_EXPECTS(static_cast<int>(responses.size()) == rig.n_lights(),
                    "a response of each light");
  const std::vector<double> geometry = expected_signals(rig, camera);
  const std::vector<LightElement> lights = light_elements(rig);
  const std::size_t n = responses.size();
  LightSurvey survey;
  survey.power.assign(n, 0.0);
  std::vector<double> expected(n, 0.0);
  std::vector<double> sigmas;
  std::vector<std::array<double, 2>> place(n, {0.0, 0.0});  // expected centroid
  std::vector<double> pitch(n, 0.0);  // distance to a neighbour's centroid, pixels
  bool can_see_wiring = true;
  std::size_t offset = 0;
  for (const Face& face : rig.faces) {
    const auto of_face = static_cast<std::size_t>(face.n_lights());
    std::vector<Eigen::Matrix<double, 6, 1>> terms;
    std::vector<double> logs;
    std::vector<double> xs;
    std::vector<double> ys;
    std::vector<double> ratios;
    for (std::size_t k = offset; k < offset + of_face; ++k) {
      if (geometry[k] > 0.0) {
        ratios.push_back(responses[k].signal / geometry[k]);
      }
    }
    const double typical = median(ratios);
    for (std::size_t k = offset; k < offset + of_face; ++k) {
      const LightResponse& r = responses[k];
      const bool shines = geometry[k] > 0.0 && typical > 0.0 &&
                          r.signal > std::max(0.1 * typical * geometry[k], 5.0 * r.sigma);
      if (shines) {
        terms.push_back(place_terms(face, lights[k]));
        logs.push_back(std::log(r.signal / geometry[k]));
        xs.push_back(r.x);
        ys.push_back(r.y);
      }
    }
    const Surface level = fit_surface(terms, logs, kMinLogSigma);
    const Surface x = fit_surface(terms, xs, 1e-6);
    const Surface y = fit_surface(terms, ys, 1e-6);
    std::vector<double> shifts;
    for (std::size_t k = offset; k < offset + of_face; ++k) {
      const Eigen::Matrix<double, 6, 1> here = place_terms(face, lights[k]);
      place[k] = {x.at(here), y.at(here)};
      LightElement next = lights[k];
      next.col += next.col + 1 < face.cols ? 1 : -1;
      LightElement below = lights[k];
      below.row += below.row + 1 < face.rows ? 1 : -1;
      double shift = std::numeric_limits<double>::infinity();
      for (const LightElement& other : {next, below}) {
        if (other.col >= 0 && other.row >= 0) {
          const Eigen::Matrix<double, 6, 1> there = place_terms(face, other);
          shift =
              std::min(shift, std::hypot(x.at(there) - place[k][0], y.at(there) - place[k][1]));
        }
      }
      pitch[k] = std::isfinite(shift) ? shift : 0.0;
      shifts.push_back(pitch[k]);
      expected[k] = terms.empty() ? 0.0 : geometry[k] * std::exp(level.at(here));
      const LightResponse& r = responses[k];
      const auto number = static_cast<int>(k);
      if (expected[k] < 10.0 * r.sigma || expected[k] <= 0.0) {
        survey.unseen.push_back(number);
        continue;
      }
      const double power = r.signal / expected[k];
      if (power < options.dead_below) {
        survey.dead.push_back(number);
        continue;
      }
      survey.power[k] = power;
      // Six coefficients from so many lights: what the surface itself is uncertain by.
      sigmas.push_back(
          std::hypot(r.sigma / expected[k],
                     level.spread * std::sqrt(6.0 / static_cast<double>(terms.size()))));
    }
    const double typical_shift = median(shifts);
    can_see_wiring = can_see_wiring && terms.size() >= kMinForSurface &&
                     typical_shift > 5.0 * std::max(x.spread, y.spread);
    offset += of_face;
  }
  survey.power_sigma = median(sigmas);
  survey.can_see_wiring = can_see_wiring;
  for (std::size_t k = 0; can_see_wiring && k < n; ++k) {
    const LightResponse& r = responses[k];
    if (survey.power[k] <= 0.0 || pitch[k] <= 0.0 || r.centroid_sigma > 0.15 * pitch[k]) {
      continue;
    }
    const auto distance = [&](std::size_t j) {
      return std::hypot(r.x - place[j][0], r.y - place[j][1]);
    };
    if (distance(k) < kFar * pitch[k]) {
      continue;
    }
    std::size_t nearest = k;
    for (std::size_t j = 0; j < n; ++j) {
      if (distance(j) < distance(nearest)) {
        nearest = j;
      }
    }
    if (nearest != k && distance(nearest) < kNear * pitch[nearest]) {
      survey.miswired.push_back(static_cast<int>(k));
      survey.miswired_to.push_back(static_cast<int>(nearest));
      if (expected[nearest] > 0.0) {
        survey.power[k] = r.signal / expected[nearest];
      }
    }
  }
  for (std::size_t k = 0; k < n; ++k) {
    if (survey.power[k] > 0.0 && survey.power[k] < options.dim_below) {
      survey.dim.push_back(static_cast<int>(k));
    }
  }
  return survey;
}

}  // namespace haarlight
