// SPDX-License-Identifier: Apache-2.0
#include "render/volume/bent_face.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <optional>

#include <Eigen/LU>

#include "render/volume/volume_view.h"

namespace haarlight::render {

using Eigen::Matrix2d;
using Eigen::Vector2d;
using Eigen::Vector3d;

namespace {

/// Of the corners' numbers 01 12 20.
constexpr std::array<std::array<int, 2>, 3> kEdges = {{{0, 1}, {1, 2}, {2, 0}}};

/// Parts of a part: a silhouette at a distance of 1e-13 takes about 24 halvings.
constexpr int kMostHalvings = 32;
constexpr int kMostParts = 3000;
/// Of a part, by how much its slopes differ from those in its middle, at most, for Newton's method.
constexpr double kNearlyFlat = 0.2;
/// Within this much of a patch, seen along it, crossings are not told apart.
constexpr double kTouching = 1e-7;

/// A part of a patch: the barycentric coordinates of its corners.
using Part = std::array<Vector3d, 3>;

/// A Bezier triangle as one ray sees it: (x, y) across it.
class SeenPatch {
 public:
  SeenPatch(const VolumeView& view, const Vector2d& p, const Vector2d& shift,
            const std::array<std::uint32_t, 6>& nodes) {
    const std::array<SeenPoint, 6> bezier = bezier_of(view, nodes);
    const bool is_perspective = view.projection == Projection::perspective;
    double largest = 0.0;
    for (std::size_t i = 0; i < bezier.size(); ++i) {
      const double w = is_perspective ? bezier.at(i).z : 1.0;
      across_.at(i) = {bezier.at(i).x - p.x() * w - shift.x(),
                       bezier.at(i).y - p.y() * w - shift.y()};
      z_.at(i) = bezier.at(i).z;
      largest = std::max({largest, std::abs(bezier.at(i).x) + std::abs(p.x() * w),
                          std::abs(bezier.at(i).y) + std::abs(p.y() * w)});
    }
    // Of the Bezier points, and of the sums below: about ten roundings.
    error_ = 8.0 * std::numeric_limits<double>::epsilon() * largest;
  }

  /// The polar form: of equal a and b the point there.
  [[nodiscard]] Vector2d across(const Vector3d& a, const Vector3d& b) const {
    return blend<Vector2d>(across_, a, b);
  }
  [[nodiscard]] double z(const Vector3d& at) const { return blend<double>(z_, at, at); }
  [[nodiscard]] double error() const noexcept { return error_; }

 private:
  template <class Value>
  [[nodiscard]] static Value blend(const std::array<Value, 6>& of, const Vector3d& a,
                                   const Vector3d& b) {
    // From the first on: exact where all are alike.
    Value sum = of[0];
    sum += (a[1] * b[1]) * (of[1] - of[0]);
    sum += (a[2] * b[2]) * (of[2] - of[0]);
    for (std::size_t e = 0; e < kEdges.size(); ++e) {
      const auto [i, j] = kEdges.at(e);
      sum += (a[i] * b[j] + a[j] * b[i]) * (of.at(3 + e) - of[0]);
    }
    return sum;
  }

  std::array<Vector2d, 6> across_;
  std::array<double, 6> z_{};
  double error_ = 0.0;
};

class Finder {
 public:
  explicit Finder(const SeenPatch& patch) : patch_(patch) {}

  /// @return  as add_bent_crossings()
  [[nodiscard]] bool find() {
    search({Vector3d::UnitX(), Vector3d::UnitY(), Vector3d::UnitZ()}, 0);
    return is_sure_;
  }

  struct Root {
    Vector3d at;
    double error = 0.0;  ///< of these
    bool is_positive = false;
  };
  [[nodiscard]] const std::vector<Root>& roots() const { return roots_; }

 private:
  void search(const Part& part, int n_halvings) {
    if (!is_sure_) {
      return;
    }
    if (++n_parts_ > kMostParts) {
      is_sure_ = false;
      return;
    }
    // Its Bezier points, as those of the patch.
    std::array<Vector2d, 6> points;
    for (std::size_t i = 0; i < 3; ++i) {
      points.at(i) = patch_.across(part.at(i), part.at(i));
      points.at(3 + i) = patch_.across(part.at(i), part.at((i + 1) % 3));
    }
    if (is_beside(points)) {
      return;
    }
    const Matrix2d slopes = slopes_in_middle(points);
    const std::optional<Matrix2d> to_part = inverse_of(slopes);
    if (to_part) {
      const double bend = bend_of_part(points, slopes, *to_part);
      std::array<Vector2d, 6> seen;
      std::ranges::transform(points, seen.begin(),
                             [&](const Vector2d& point) { return *to_part * point; });
      const double error = patch_.error() * to_part->cwiseAbs().rowwise().sum().maxCoeff();
      if (is_beside_triangle(seen, error)) {
        return;
      }
      if (bend <= kNearlyFlat) {
        add_root(part, *to_part);
        return;
      }
    }
    if (n_halvings == kMostHalvings) {
      is_sure_ = false;
      return;
    }
    const std::array<Vector3d, 3> middles = {
        0.5 * (part[0] + part[1]), 0.5 * (part[1] + part[2]), 0.5 * (part[2] + part[0])};
    search({part[0], middles[0], middles[2]}, n_halvings + 1);
    search({middles[0], part[1], middles[1]}, n_halvings + 1);
    search({middles[2], middles[1], part[2]}, n_halvings + 1);
    search({middles[1], middles[2], middles[0]}, n_halvings + 1);
  }

  /// Whether all are on one side of a line through the ray, by more than rounding.
  [[nodiscard]] bool is_beside(const std::array<Vector2d, 6>& points) const {
    const auto are_on_one_side = [&](const Vector2d& normal) {
      const double margin = patch_.error() * (std::abs(normal.x()) + std::abs(normal.y()));
      double least = std::numeric_limits<double>::infinity();
      double most = -least;
      for (const Vector2d& point : points) {
        const double off = normal.dot(point);
        least = std::min(least, off);
        most = std::max(most, off);
      }
      return least > margin || most < -margin;
    };
    if (are_on_one_side(Vector2d::UnitX()) || are_on_one_side(Vector2d::UnitY())) {
      return true;
    }
    return std::ranges::any_of(kEdges, [&](const std::array<int, 2>& edge) {
      const Vector2d along = points.at(static_cast<std::size_t>(edge[1])) -
                             points.at(static_cast<std::size_t>(edge[0]));
      return are_on_one_side({-along.y(), along.x()});
    });
  }

  /// The same, in coordinates in which the part is nearly the triangle (0, 0) (1, 0) (0, 1), by its sides.
  [[nodiscard]] static bool is_beside_triangle(const std::array<Vector2d, 6>& points,
                                               double error) {
    Vector2d least = points[0];
    Vector2d most = points[0];
    double least_sum = points[0].sum();
    double most_sum = least_sum;
    for (const Vector2d& point : points) {
      least = least.cwiseMin(point);
      most = most.cwiseMax(point);
      least_sum = std::min(least_sum, point.sum());
      most_sum = std::max(most_sum, point.sum());
    }
    return least.maxCoeff() > error || most.minCoeff() < -error || least_sum > 2.0 * error ||
           most_sum < -2.0 * error;
  }

  /// By the part's own coordinates (s, t): its corners are (0, 0), (1, 0) and (0, 1).
  static Matrix2d slopes_at(const std::array<Vector2d, 6>& points, std::size_t corner) {
    const std::array<Vector2d, 3> to = {// of (0, 1) (1, 2) (2, 0), and itself
                                        corner == 0   ? points[0]
                                        : corner == 1 ? points[3]
                                                      : points[5],
                                        corner == 0   ? points[3]
                                        : corner == 1 ? points[1]
                                                      : points[4],
                                        corner == 0   ? points[5]
                                        : corner == 1 ? points[4]
                                                      : points[2]};
    Matrix2d slopes;
    slopes.col(0) = 2.0 * (to[1] - to[0]);
    slopes.col(1) = 2.0 * (to[2] - to[0]);
    return slopes;
  }
  static Matrix2d slopes_in_middle(const std::array<Vector2d, 6>& points) {
    return (slopes_at(points, 0) + slopes_at(points, 1) + slopes_at(points, 2)) / 3.0;
  }

  static std::optional<Matrix2d> inverse_of(const Matrix2d& slopes) {
    constexpr double kSingular = 1e-12;
    const double det = slopes.determinant();
    const double size = slopes.col(0).norm() * slopes.col(1).norm();
    return std::abs(det) > kSingular * size ? std::optional<Matrix2d>(slopes.inverse())
                                            : std::nullopt;
  }

  /// Slopes are linear in (s, t): the largest difference is at a corner.
  static double bend_of_part(const std::array<Vector2d, 6>& points, const Matrix2d& slopes,
                             const Matrix2d& to_part) {
    double bend = 0.0;
    for (std::size_t i = 0; i < 3; ++i) {
      const Matrix2d off = to_part * (slopes_at(points, i) - slopes);
      bend = std::max(bend, off.cwiseAbs().rowwise().sum().maxCoeff());
    }
    return bend;
  }

  /// The one point of a nearly flat part, where it is within it: to rounding also beside it, so that none
  /// is lost between parts.
  void add_root(const Part& part, const Matrix2d& to_part) {
    constexpr int kMostSteps = 30;
    constexpr double kBeside = 0.25;
    const auto at_of = [&part](const Vector2d& st) -> Vector3d {
      return part[0] + st.x() * (part[1] - part[0]) + st.y() * (part[2] - part[0]);
    };
    Vector2d st = Vector2d::Constant(1.0 / 3.0);
    Matrix2d inverse = to_part;
    double change = 1.0;
    for (int step = 0; step < kMostSteps; ++step) {
      const Vector3d at = at_of(st);
      Matrix2d slopes;
      slopes.col(0) = 2.0 * (patch_.across(at, part[1]) - patch_.across(at, part[0]));
      slopes.col(1) = 2.0 * (patch_.across(at, part[2]) - patch_.across(at, part[0]));
      inverse = slopes.inverse();
      const Vector2d off = (step < 2 ? to_part : inverse) * patch_.across(at, at);
      st -= off;
      change = off.cwiseAbs().maxCoeff();
      if (!(change < 1e3) || st.cwiseAbs().maxCoeff() > 4.0) {
        return;  // it is not in this part
      }
      constexpr double kLastStep = 1e-9;  // its square is rounding
      if (step > 2 && change <= kLastStep) {
        break;
      }
    }
    if (std::min({st.x(), st.y(), 1.0 - st.sum()}) < -kBeside) {
      return;
    }
    const double size = (part[1] - part[0]).cwiseAbs().maxCoeff();
    const double error = size * patch_.error() * inverse.cwiseAbs().rowwise().sum().maxCoeff() +
                         4.0 * std::numeric_limits<double>::epsilon();
    const Vector3d at = at_of(st);
    if (at.minCoeff() < -error) {
      return;  // beside the patch
    }
    constexpr double kRounding = 1e-7;
    if (change > kRounding || error > kTouching || at.minCoeff() <= error) {
      is_sure_ = false;
      return;
    }
    const auto is_same = [&](const Root& root) {
      return (root.at - at).cwiseAbs().maxCoeff() <= 8.0 * (root.error + error);
    };
    if (std::ranges::none_of(roots_, is_same)) {
      // Parts are never turned round: their corners' order is that of the patch.
      roots_.push_back({.at = at, .error = error, .is_positive = inverse.determinant() > 0.0});
    }
  }

  const SeenPatch& patch_;
  std::vector<Root> roots_;
  int n_parts_ = 0;
  bool is_sure_ = true;
};

}  // namespace

std::array<SeenPoint, 6> bezier_of(const VolumeView& view,
                                   const std::array<std::uint32_t, 6>& nodes) {
  std::array<SeenPoint, 6> bezier;
  for (std::size_t i = 0; i < 3; ++i) {
    bezier.at(i) = view.points[nodes.at(i)].seen;
  }
  for (std::size_t i = 0; i < 3; ++i) {
    const SeenPoint& a = bezier.at(i);
    const SeenPoint& b = bezier.at((i + 1) % 3);
    const SeenPoint& middle = view.points[nodes.at(3 + i)].seen;
    bezier.at(3 + i) = {.x = 2.0 * middle.x - 0.5 * (a.x + b.x),
                        .y = 2.0 * middle.y - 0.5 * (a.y + b.y),
                        .z = 2.0 * middle.z - 0.5 * (a.z + b.z)};
  }
  return bezier;
}

bool add_bent_crossings(const VolumeView& view, const Vector2d& p, const Vector2d& shift,
                        const std::array<std::uint32_t, 6>& nodes,
                        std::vector<BentCrossing>& crossings) {
  // Whichever cell asks: corners by their numbers.
  std::array<std::size_t, 3> order = {0, 1, 2};
  std::ranges::sort(order, {}, [&nodes](std::size_t i) { return nodes.at(i); });
  const bool is_turned = (order[1] + 3 - order[0]) % 3 == 2;
  std::array<std::uint32_t, 6> sorted{};
  for (std::size_t i = 0; i < 3; ++i) {
    const std::size_t from = order.at(i);
    const std::size_t to = order.at((i + 1) % 3);
    sorted.at(i) = nodes.at(from);
    sorted.at(3 + i) = nodes.at(3 + ((from + 1) % 3 == to ? from : to));
  }
  const SeenPatch patch(view, p, shift, sorted);
  Finder finder(patch);
  const bool is_sure = finder.find();
  for (const Finder::Root& root : finder.roots()) {
    BentCrossing crossing{.z = patch.z(root.at), .is_left_by = root.is_positive != is_turned};
    for (std::size_t i = 0; i < 3; ++i) {
      crossing.weights.at(order.at(i)) = root.at[static_cast<Eigen::Index>(i)];
    }
    crossings.push_back(crossing);
  }
  return is_sure;
}

}  // namespace haarlight::render
