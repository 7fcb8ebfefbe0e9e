// SPDX-License-Identifier: Apache-2.0
#include "render/volume/side_of_ray.h"

#include <array>
#include <cmath>
#include <initializer_list>

namespace haarlight::render {

namespace {

/// x y z, each a factor of its own.
struct Product {
  double x = 1.0;
  double y = 1.0;
  double z = 1.0;
};

/// A sum of doubles without rounding: parts that do not overlap, the smallest first [Shewchuk97]; four
/// at most for each product.
template <std::size_t kMost>
class ExactSum {
 public:
  void add(double value) {
    std::size_t kept = 0;
    double carry = value;
    for (std::size_t i = 0; i < n_; ++i) {
      const double sum = carry + parts_.at(i);
      const double of_part = sum - carry;
      const double error = (carry - (sum - of_part)) + (parts_.at(i) - of_part);
      if (error != 0.0) {
        parts_.at(kept++) = error;
      }
      carry = sum;
    }
    if (carry != 0.0) {
      parts_.at(kept++) = carry;
    }
    n_ = kept;
  }

  void add(const Product& product) {
    const double high = product.x * product.y;
    const double low = std::fma(product.x, product.y, -high);
    for (const double factor : {low, high}) {
      const double part = factor * product.z;
      add(std::fma(factor, product.z, -part));
      add(part);
    }
  }

  [[nodiscard]] int sign() const {
    if (n_ == 0) {
      return 0;
    }
    return parts_.at(n_ - 1) > 0.0 ? 1 : -1;
  }

 private:
  std::array<double, kMost> parts_{};
  std::size_t n_ = 0;
};

int sign_of_sum(std::initializer_list<Product> products) {
  ExactSum<24> sum;  // of six products
  for (const Product& product : products) {
    sum.add(product);
  }
  return sum.sign();
}

/// (x, y, w), and what a change of the eye moves it by.
struct Homogeneous {
  double x;
  double y;
  double w;
  double moves;
};
Homogeneous homogeneous(Projection projection, const SeenPoint& point) {
  return projection == Projection::perspective ? Homogeneous{point.x, point.y, point.z, 1.0}
                                               : Homogeneous{point.x, point.y, 1.0, point.z};
}

/// p seen from which the edge is its own shadow: the eye lies on its line. Moved towards the picture
/// by h and, by less, to the right: det[p, d, c] for d = (0, 0, 1), then (1, 0, 0), c of below.
int side_of_moved_eye(const Eigen::Vector2d& p, const Homogeneous& a, const Homogeneous& b) {
  const auto of_c = [&](double from_b, double from_a) {  // of c = a.moves b - b.moves a
    return std::array{Product{a.moves, from_b, 1.0}, Product{-b.moves, from_a, 1.0}};
  };
  const auto c_x = of_c(b.x, a.x);
  const auto c_y = of_c(b.y, a.y);
  const auto c_w = of_c(b.w, a.w);
  const auto times = [](Product product, double factor) {
    product.z = factor;
    return product;
  };
  if (const int side = sign_of_sum({times(c_x[0], p.y()), times(c_x[1], p.y()),
                                    times(c_y[0], -p.x()), times(c_y[1], -p.x())})) {
    return side;
  }
  if (const int side = -sign_of_sum({c_y[0], c_y[1]})) {  // moved by e
    return side;
  }
  if (const int side = sign_of_sum({c_x[0], c_x[1]})) {  // by e^2
    return side;
  }
  const int of_w = sign_of_sum({c_w[0], c_w[1]});
  return p.y() < 0.0 ? of_w : -of_w;
}

}  // namespace

int exact_side(Projection projection, const Eigen::Vector2d& p, const SeenPoint& a,
               const SeenPoint& b) {
  const Homogeneous from = homogeneous(projection, a);
  const Homogeneous to = homogeneous(projection, b);
  const double x = p.x();
  const double y = p.y();
  if (const int side = sign_of_sum({{x, from.y, to.w},
                                    {-x, from.w, to.y},
                                    {y, from.w, to.x},
                                    {-y, from.x, to.w},
                                    {from.x, to.y, 1.0},
                                    {-from.y, to.x, 1.0}})) {
    return side;
  }
  if (const int side = sign_of_sum({{from.y, to.w, 1.0}, {-from.w, to.y, 1.0}})) {
    return side;  // p moved by e along x
  }
  if (const int side = sign_of_sum({{from.w, to.x, 1.0}, {-from.x, to.w, 1.0}})) {
    return side;  // by e^2 along y
  }
  return side_of_moved_eye(p, from, to);
}

int exact_orientation(Projection projection, const SeenPoint& a, const SeenPoint& b,
                      const SeenPoint& c) {
  const Homogeneous p = homogeneous(projection, a);
  const Homogeneous q = homogeneous(projection, b);
  const Homogeneous r = homogeneous(projection, c);
  return sign_of_sum({{p.x, q.y, r.w},
                      {-p.x, q.w, r.y},
                      {p.y, q.w, r.x},
                      {-p.y, q.x, r.w},
                      {p.w, q.x, r.y},
                      {-p.w, q.y, r.x}});
}

int exact_side_of_plane(const SeenPoint& a, const SeenPoint& b, const SeenPoint& c,
                        const SeenPoint& d) {
  ExactSum<96> sum;  // of 24 products
  const auto add = [&sum](const SeenPoint& p, const SeenPoint& q, const SeenPoint& r,
                          double sign) {
    for (const Product& product : {Product{p.x, q.y, r.z},
                                   {-p.x, q.z, r.y},
                                   {p.y, q.z, r.x},
                                   {-p.y, q.x, r.z},
                                   {p.z, q.x, r.y},
                                   {-p.z, q.y, r.x}}) {
      sum.add(Product{sign * product.x, product.y, product.z});
    }
  };
  // det[b - a, c - a, d - a], without differences.
  add(b, c, d, 1.0);
  add(a, c, d, -1.0);
  add(a, b, d, 1.0);
  add(a, b, c, -1.0);
  return sum.sign();
}

}  // namespace haarlight::render
