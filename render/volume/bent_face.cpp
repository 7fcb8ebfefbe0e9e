// SPDX-License-Identifier: Apache-2.0
#include "render/volume/bent_face.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include <Eigen/LU>

#include "render/volume/patch_forms.h"
#include "render/volume/volume_view.h"

namespace haarlight::render {

using Eigen::Matrix2d;
using Eigen::Vector2d;
using Eigen::Vector3d;

namespace {

/// Parts of a patch: a silhouette at a distance of 1e-13 takes about 24 halvings into four.
constexpr int kMostParts = 3000;
/// Of a part, by how much its slopes differ from those in its middle, at most, for Newton's method.
constexpr double kNearlyFlat = 0.2;
/// Within this much of a patch, seen along it, crossings are not told apart.
constexpr double kTouching = 1e-7;

/// Where the Bezier points in the order of nodes belong in a net.
template <class Form>
constexpr std::array<std::size_t, Form::kPoints> places_of_nodes() {
  if constexpr (Form::kPoints == TriangleForm<2>::kPoints) {
    constexpr auto kAt = [](int j, int k) { return Form::place(2, j, k); };
    return {kAt(0, 0), kAt(2, 0), kAt(0, 2), kAt(1, 0), kAt(1, 1), kAt(0, 1)};
  } else if constexpr (Form::kPoints == TriangleForm<3>::kPoints) {
    constexpr auto kAt = [](int j, int k) { return Form::place(3, j, k); };
    return {kAt(0, 0), kAt(3, 0), kAt(0, 3), kAt(1, 0), kAt(2, 0),
            kAt(2, 1), kAt(1, 2), kAt(0, 2), kAt(0, 1), kAt(1, 1)};
  } else {
    constexpr auto kAt = [](std::size_t i, std::size_t j) { return Form::place(i, j); };
    return {kAt(0, 0), kAt(2, 0), kAt(2, 2), kAt(0, 2), kAt(1, 0),
            kAt(2, 1), kAt(1, 2), kAt(0, 1), kAt(1, 1)};
  }
}

/// A patch as one ray sees it: (x, y) across it.
template <class Form>
class SeenPatch {
 public:
  SeenPatch(const VolumeView& view, const Vector2d& p, const Vector2d& shift,
            const PatchNodes& nodes) {
    const SeenBezier bezier = bezier_of(view, nodes);
    const bool is_perspective = view.projection == Projection::perspective;
    constexpr auto kPlaces = places_of_nodes<Form>();
    double largest = 0.0;
    for (std::size_t i = 0; i < kPlaces.size(); ++i) {
      const SeenPoint& seen = bezier.points.at(i);
      const double w = is_perspective ? seen.z : 1.0;
      across_.at(kPlaces.at(i)) = {seen.x - p.x() * w - shift.x(),
                                   seen.y - p.y() * w - shift.y()};
      z_.at(kPlaces.at(i)) = seen.z;
      largest = std::max({largest, std::abs(seen.x) + std::abs(p.x() * w),
                          std::abs(seen.y) + std::abs(p.y() * w)});
    }
    // Of the Bezier points, and of the sums below: about ten roundings of a quadratic triangle, of others
    // more, as their points are made of more nodes.
    const double n_roundings = Form::kPoints == TriangleForm<2>::kPoints ? 8.0 : 24.0;
    error_ = n_roundings * std::numeric_limits<double>::epsilon() * largest;
  }

  [[nodiscard]] const typename Form::template Net<Vector2d>& net() const { return across_; }
  [[nodiscard]] double z(const typename Form::At& at) const { return Form::value(z_, at); }
  [[nodiscard]] double error() const noexcept { return error_; }

 private:
  typename Form::template Net<Vector2d> across_;
  typename Form::template Net<double> z_{};
  double error_ = 0.0;
};

template <class Form>
class Finder {
 public:
  using Part = typename Form::Part;
  using Net = typename Form::template Net<Vector2d>;

  explicit Finder(const SeenPatch<Form>& patch) : patch_(patch) {}

  /// @return  as add_bent_crossings()
  [[nodiscard]] bool find() {
    search(Form::whole(), 0);
    return is_sure_;
  }

  struct Root {
    typename Form::At at;
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
    const Net points = Form::net_of(patch_.net(), part);
    if (is_beside(points)) {
      return;
    }
    const Matrix2d slopes = Form::mean_slopes(points);
    const std::optional<Matrix2d> to_part = inverse_of(slopes);
    if (to_part) {
      const double bend = Form::bend_of(points, slopes, *to_part);
      Net seen;
      std::ranges::transform(points, seen.begin(),
                             [&](const Vector2d& point) { return *to_part * point; });
      const double error = patch_.error() * to_part->cwiseAbs().rowwise().sum().maxCoeff();
      if (is_beside_by_sides(seen, error)) {
        return;
      }
      if (bend <= kNearlyFlat) {
        add_root(part, *to_part);
        return;
      }
    }
    if (n_halvings == Form::kMostHalvings) {
      is_sure_ = false;
      return;
    }
    Form::split(part, points, [&](const Part& half) { search(half, n_halvings + 1); });
  }

  /// Whether all are on one side of a line through the ray, by more than rounding.
  [[nodiscard]] bool is_beside(const Net& points) const {
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
    for (std::size_t i = 0; i < Form::kCorners; ++i) {
      const Vector2d along = points.at(Form::kCornerPlaces.at((i + 1) % Form::kCorners)) -
                             points.at(Form::kCornerPlaces.at(i));
      if (are_on_one_side({-along.y(), along.x()})) {
        return true;
      }
    }
    return false;
  }

  /// The same, in coordinates in which the part is nearly the triangle (0, 0) (1, 0) (0, 1) or a square, by
  /// its sides.
  [[nodiscard]] static bool is_beside_by_sides(const Net& points, double error) {
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

  static std::optional<Matrix2d> inverse_of(const Matrix2d& slopes) {
    constexpr double kSingular = 1e-12;
    const double det = slopes.determinant();
    const double size = slopes.col(0).norm() * slopes.col(1).norm();
    return std::abs(det) > kSingular * size ? std::optional<Matrix2d>(slopes.inverse())
                                            : std::nullopt;
  }

  /// The one point of a nearly flat part, where it is within it: to rounding also beside it, so that none
  /// is lost between parts.
  void add_root(const Part& part, const Matrix2d& to_part) {
    constexpr int kMostSteps = 30;
    constexpr double kBeside = 0.25;
    Vector2d own = Form::middle();
    Matrix2d inverse = to_part;
    double change = 1.0;
    for (int step = 0; step < kMostSteps; ++step) {
      const typename Form::At at = Form::at_of(part, own);
      inverse = Form::slopes_at(patch_.net(), part, at).inverse();
      const Vector2d off = (step < 2 ? to_part : inverse) * Form::value(patch_.net(), at);
      own -= off;
      change = off.cwiseAbs().maxCoeff();
      if (!(change < 1e3) || own.cwiseAbs().maxCoeff() > 4.0) {
        return;  // it is not in this part
      }
      constexpr double kLastStep = 1e-9;  // its square is rounding
      if (step > 2 && change <= kLastStep) {
        break;
      }
    }
    if (Form::depth_within_part(own) < -kBeside) {
      return;
    }
    const double error =
        Form::scale_of(part) * patch_.error() * inverse.cwiseAbs().rowwise().sum().maxCoeff() +
        4.0 * std::numeric_limits<double>::epsilon();
    const typename Form::At at = Form::at_of(part, own);
    if (Form::depth_within(at) < -error) {
      return;  // beside the patch
    }
    constexpr double kRounding = 1e-7;
    if (change > kRounding || error > kTouching || Form::depth_within(at) <= error) {
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

  const SeenPatch<Form>& patch_;
  std::vector<Root> roots_;
  int n_parts_ = 0;
  bool is_sure_ = true;
};

template <class Form>
bool add_crossings(const VolumeView& view, const Vector2d& p, const Vector2d& shift,
                   const SortedPatch& sorted, std::vector<BentCrossing>& crossings) {
  const SeenPatch<Form> patch(view, p, shift, sorted.patch);
  Finder<Form> finder(patch);
  const bool is_sure = finder.find();
  for (const auto& root : finder.roots()) {
    BentCrossing crossing{.z = patch.z(root.at),
                          .is_left_by = root.is_positive != sorted.is_turned};
    const std::array<double, 4> weights = Form::weights_of(root.at);
    for (std::size_t i = 0; i < Form::kCorners; ++i) {
      crossing.weights.at(sorted.order.at(i)) = weights.at(i);
    }
    crossings.push_back(crossing);
  }
  return is_sure;
}

}  // namespace

SeenBezier bezier_of(const VolumeView& view, const PatchNodes& nodes) {
  std::array<Vector3d, 10> x;
  for (std::size_t i = 0; i < nodes.n; ++i) {
    const SeenPoint& seen = view.points[nodes.nodes.at(i)].seen;
    x.at(i) = {seen.x, seen.y, seen.z};
  }
  std::array<Vector3d, 10> b = x;
  const std::size_t n = nodes.n_corners();
  std::size_t n_points = nodes.n;
  if (nodes.form == PatchForm::cubic_triangle) {
    Vector3d edges = Vector3d::Zero();
    for (std::size_t i = 0; i < n; ++i) {
      const Vector3d& from = x.at(i);
      const Vector3d& to = x.at((i + 1) % n);
      const std::size_t k = n + 2 * i;
      b.at(k) = 3.0 * x.at(k) - 1.5 * x.at(k + 1) - (5.0 * from - 2.0 * to) / 6.0;
      b.at(k + 1) = 3.0 * x.at(k + 1) - 1.5 * x.at(k) - (5.0 * to - 2.0 * from) / 6.0;
      edges += b.at(k) + b.at(k + 1);
    }
    b[9] = 4.5 * x[9] - 0.5 * edges - (x[0] + x[1] + x[2]) / 6.0;
  } else {
    for (std::size_t i = 0; i < n; ++i) {
      b.at(n + i) = 2.0 * x.at(n + i) - 0.5 * (x.at(i) + x.at((i + 1) % n));
    }
    if (n == 4) {
      const Vector3d corners = x[0] + x[1] + x[2] + x[3];
      const Vector3d middles = x[4] + x[5] + x[6] + x[7];
      b[8] = nodes.form == PatchForm::biquadratic
                 ? Vector3d(4.0 * x[8] - middles + 0.25 * corners)
                 : Vector3d(middles - 0.75 * corners);
      n_points = 9;
    }
  }
  SeenBezier bezier{.points = {}, .n = n_points};
  for (std::size_t i = 0; i < n_points; ++i) {
    bezier.points.at(i) = {.x = b.at(i).x(), .y = b.at(i).y(), .z = b.at(i).z()};
  }
  return bezier;
}

bool add_bent_crossings(const VolumeView& view, const Vector2d& p, const Vector2d& shift,
                        const PatchNodes& nodes, std::vector<BentCrossing>& crossings) {
  const SortedPatch patch = sorted(nodes);
  switch (nodes.form) {
    case PatchForm::quadratic_triangle:
      return add_crossings<TriangleForm<2>>(view, p, shift, patch, crossings);
    case PatchForm::cubic_triangle:
      return add_crossings<TriangleForm<3>>(view, p, shift, patch, crossings);
    default:
      return add_crossings<SquareForm>(view, p, shift, patch, crossings);
  }
}

}  // namespace haarlight::render
