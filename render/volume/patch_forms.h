// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

#include <Eigen/Core>

/// @file
/// Bezier triangles of any degree and biquadratic Bezier patches, and parts of them, for bent_face.cpp.
///
/// Values at a point and points of parts are those of the polar form: f(a, b, ...), symmetric, linear in each
/// of as many arguments as the degree, and the point at a where all are a. All sums begin with the first
/// point: exact where all are alike.

namespace haarlight::render {

/// Part: the barycentric coordinates of its corners; own coordinates (0, 0), (1, 0), (0, 1) there.
template <int kDegree>
struct TriangleForm {
  static constexpr std::size_t kPoints =
      static_cast<std::size_t>((kDegree + 1) * (kDegree + 2) / 2);
  static constexpr int kMostHalvings = 32;
  static constexpr std::size_t kCorners = 3;
  template <class Value>
  using Net = std::array<Value, kPoints>;
  using At = Eigen::Vector3d;
  using Part = std::array<At, 3>;

  /// Of the point of j factors of the second coordinate and k of the third.
  static constexpr std::size_t place(int degree, int j, int k) {
    const int number = k * (degree + 1) - k * (k - 1) / 2 + j;
    return static_cast<std::size_t>(number);
  }
  static constexpr std::array<std::size_t, 3> kCornerPlaces = {
      0, static_cast<std::size_t>(kDegree), kPoints - 1};

  static Part whole() { return {At::UnitX(), At::UnitY(), At::UnitZ()}; }
  static Eigen::Vector2d middle() { return Eigen::Vector2d::Constant(1.0 / 3.0); }
  static At at_of(const Part& part, const Eigen::Vector2d& own) {
    return part[0] + own.x() * (part[1] - part[0]) + own.y() * (part[2] - part[0]);
  }
  static double depth_within(const At& at) { return at.minCoeff(); }
  static double depth_within_part(const Eigen::Vector2d& own) {
    return std::min({own.x(), own.y(), 1.0 - own.sum()});
  }
  static double scale_of(const Part& part) { return (part[1] - part[0]).cwiseAbs().maxCoeff(); }
  static std::array<double, 4> weights_of(const At& at) { return {at[0], at[1], at[2], 0.0}; }

  template <class Value>
  static Value polar(Net<Value> net, const std::array<At, kDegree>& arguments) {
    int degree = kDegree;
    for (const At& a : arguments) {
      for (int k = 0; k < degree; ++k) {
        for (int j = 0; j < degree - k; ++j) {
          const Value first = net.at(place(degree, j, k));
          Value sum = first;
          sum += a[1] * (net.at(place(degree, j + 1, k)) - first);
          sum += a[2] * (net.at(place(degree, j, k + 1)) - first);
          net.at(place(degree - 1, j, k)) = sum;
        }
      }
      --degree;
    }
    return net[0];
  }
  template <class Value>
  static Value value(const Net<Value>& net, const At& at) {
    std::array<At, kDegree> arguments;
    arguments.fill(at);
    return polar(net, arguments);
  }
  /// By the part's own coordinates.
  static Eigen::Matrix2d slopes_at(const Net<Eigen::Vector2d>& net, const Part& part,
                                   const At& at) {
    std::array<At, kDegree> arguments;
    arguments.fill(at);
    std::array<Eigen::Vector2d, 3> to;
    for (std::size_t i = 0; i < 3; ++i) {
      arguments[0] = part.at(i);
      to.at(i) = polar(net, arguments);
    }
    Eigen::Matrix2d slopes;
    slopes.col(0) = kDegree * (to[1] - to[0]);
    slopes.col(1) = kDegree * (to[2] - to[0]);
    return slopes;
  }
  static Net<Eigen::Vector2d> net_of(const Net<Eigen::Vector2d>& net, const Part& part) {
    Net<Eigen::Vector2d> made;
    for (int k = 0; k <= kDegree; ++k) {
      for (int j = 0; j <= kDegree - k; ++j) {
        std::array<At, kDegree> arguments;
        for (int n = 0; n < kDegree; ++n) {
          arguments.at(static_cast<std::size_t>(n)) = part.at(n < k ? 2 : (n < k + j ? 1 : 0));
        }
        made.at(place(kDegree, j, k)) = polar(net, arguments);
      }
    }
    return made;
  }

  /// Calls visit(slopes) for matrices between which those of all points of a part are.
  template <class Visit>
  static void for_each_slopes(const Net<Eigen::Vector2d>& of_part, const Visit& visit) {
    for (int k = 0; k < kDegree; ++k) {
      for (int j = 0; j < kDegree - k; ++j) {
        const Eigen::Vector2d& first = of_part.at(place(kDegree, j, k));
        Eigen::Matrix2d slopes;
        slopes.col(0) = kDegree * (of_part.at(place(kDegree, j + 1, k)) - first);
        slopes.col(1) = kDegree * (of_part.at(place(kDegree, j, k + 1)) - first);
        visit(slopes);
      }
    }
  }
  static Eigen::Matrix2d mean_slopes(const Net<Eigen::Vector2d>& of_part) {
    Eigen::Matrix2d sum = Eigen::Matrix2d::Zero();
    double n = 0.0;
    for_each_slopes(of_part, [&](const Eigen::Matrix2d& slopes) {
      sum += slopes;
      n += 1.0;
    });
    return sum / n;
  }
  /// By how much slopes differ from `slopes`, at most, divided by them.
  static double bend_of(const Net<Eigen::Vector2d>& of_part, const Eigen::Matrix2d& slopes,
                        const Eigen::Matrix2d& to_part) {
    double bend = 0.0;
    for_each_slopes(of_part, [&](const Eigen::Matrix2d& at) {
      const Eigen::Matrix2d off = to_part * (at - slopes);
      bend = std::max(bend, off.cwiseAbs().rowwise().sum().maxCoeff());
    });
    return bend;
  }

  /// Along its edges, into four.
  template <class Visit>
  static void split(const Part& part, const Net<Eigen::Vector2d>& /*of_part*/,
                    const Visit& visit) {
    const std::array<At, 3> middles = {0.5 * (part[0] + part[1]), 0.5 * (part[1] + part[2]),
                                       0.5 * (part[2] + part[0])};
    visit(Part{part[0], middles[0], middles[2]});
    visit(Part{middles[0], part[1], middles[1]});
    visit(Part{middles[2], middles[1], part[2]});
    visit(Part{middles[1], middles[2], middles[0]});
  }
};

/// Part: from (low) to (high), both in [0, 1]^2; own coordinates in [0, 1]^2. Points by their rows.
struct SquareForm {
  static constexpr std::size_t kPoints = 9;
  static constexpr int kMostHalvings = 64;
  static constexpr std::size_t kCorners = 4;
  template <class Value>
  using Net = std::array<Value, kPoints>;
  using At = Eigen::Vector2d;
  struct Part {
    At low;
    At high;
  };

  static constexpr std::size_t place(std::size_t i, std::size_t j) { return 3 * j + i; }
  static constexpr std::array<std::size_t, 4> kCornerPlaces = {0, 2, 8, 6};  // as of place()

  static Part whole() { return {.low = At::Zero(), .high = At::Ones()}; }
  static Eigen::Vector2d middle() { return Eigen::Vector2d::Constant(0.5); }
  static At at_of(const Part& part, const Eigen::Vector2d& own) {
    return part.low + own.cwiseProduct(part.high - part.low);
  }
  static double depth_within(const At& at) {
    return std::min(at.minCoeff(), 1.0 - at.maxCoeff());
  }
  static double depth_within_part(const Eigen::Vector2d& own) { return depth_within(own); }
  static double scale_of(const Part& part) { return (part.high - part.low).maxCoeff(); }
  static std::array<double, 4> weights_of(const At& at) {
    return {(1.0 - at.x()) * (1.0 - at.y()), at.x() * (1.0 - at.y()), at.x() * at.y(),
            (1.0 - at.x()) * at.y()};
  }

  template <class Value>
  static Value along(const Value& first, const Value& middle, const Value& last, double a,
                     double b) {
    Value sum = first;
    sum += (a + b - 2.0 * a * b) * (middle - first);
    sum += (a * b) * (last - first);
    return sum;
  }
  template <class Value>
  static Value polar(const Net<Value>& net, const std::array<double, 2>& u,
                     const std::array<double, 2>& v) {
    std::array<Value, 3> rows;
    for (std::size_t j = 0; j < 3; ++j) {
      rows.at(j) =
          along(net.at(place(0, j)), net.at(place(1, j)), net.at(place(2, j)), u[0], u[1]);
    }
    return along(rows[0], rows[1], rows[2], v[0], v[1]);
  }
  template <class Value>
  static Value value(const Net<Value>& net, const At& at) {
    return polar(net, {at.x(), at.x()}, {at.y(), at.y()});
  }
  static Eigen::Matrix2d slopes_at(const Net<Eigen::Vector2d>& net, const Part& part,
                                   const At& at) {
    const std::array<double, 2> u = {at.x(), at.x()};
    const std::array<double, 2> v = {at.y(), at.y()};
    Eigen::Matrix2d slopes;
    slopes.col(0) =
        2.0 * (polar(net, {at.x(), part.high.x()}, v) - polar(net, {at.x(), part.low.x()}, v));
    slopes.col(1) =
        2.0 * (polar(net, u, {at.y(), part.high.y()}) - polar(net, u, {at.y(), part.low.y()}));
    return slopes;
  }
  static Net<Eigen::Vector2d> net_of(const Net<Eigen::Vector2d>& net, const Part& part) {
    const auto ends = [](double low, double high, std::size_t n) {
      return std::array{n == 2 ? high : low, n == 0 ? low : high};
    };
    Net<Eigen::Vector2d> made;
    for (std::size_t j = 0; j < 3; ++j) {
      for (std::size_t i = 0; i < 3; ++i) {
        made.at(place(i, j)) = polar(net, ends(part.low.x(), part.high.x(), i),
                                     ends(part.low.y(), part.high.y(), j));
      }
    }
    return made;
  }

  /// Calls visit(axis, slope): those of all points of a part are between them.
  template <class Visit>
  static void for_each_slope(const Net<Eigen::Vector2d>& of_part, const Visit& visit) {
    for (std::size_t i = 0; i < 2; ++i) {
      for (std::size_t j = 0; j < 3; ++j) {
        visit(0,
              Eigen::Vector2d(2.0 * (of_part.at(place(i + 1, j)) - of_part.at(place(i, j)))));
        visit(1,
              Eigen::Vector2d(2.0 * (of_part.at(place(j, i + 1)) - of_part.at(place(j, i)))));
      }
    }
  }
  static Eigen::Matrix2d mean_slopes(const Net<Eigen::Vector2d>& of_part) {
    Eigen::Matrix2d sum = Eigen::Matrix2d::Zero();
    for_each_slope(of_part, [&](Eigen::Index axis, const Eigen::Vector2d& slope) {
      sum.col(axis) += slope / 6.0;
    });
    return sum;
  }
  static double bend_of(const Net<Eigen::Vector2d>& of_part, const Eigen::Matrix2d& slopes,
                        const Eigen::Matrix2d& to_part) {
    Eigen::Matrix2d off = Eigen::Matrix2d::Zero();
    for_each_slope(of_part, [&](Eigen::Index axis, const Eigen::Vector2d& slope) {
      off.col(axis) = off.col(axis).cwiseMax((to_part * (slope - slopes.col(axis))).cwiseAbs());
    });
    return off.rowwise().sum().maxCoeff();
  }

  /// Across its longer side, into two.
  template <class Visit>
  static void split(const Part& part, const Net<Eigen::Vector2d>& of_part, const Visit& visit) {
    std::array<double, 2> longest{};
    for_each_slope(of_part, [&](Eigen::Index axis, const Eigen::Vector2d& slope) {
      double& length = longest.at(static_cast<std::size_t>(axis));
      length = std::max(length, slope.squaredNorm());
    });
    const Eigen::Index axis = longest[0] >= longest[1] ? 0 : 1;
    Part first = part;
    Part second = part;
    first.high[axis] = second.low[axis] = 0.5 * (part.low[axis] + part.high[axis]);
    visit(first);
    visit(second);
  }
};

}  // namespace haarlight::render
