// SPDX-License-Identifier: Apache-2.0
#include "render/volume/passed_face.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace haarlight::render {

namespace {

/// A point on an edge of a face.
struct OnEdge {
  std::array<double, 3> weights{};
  double off = 0.0;  ///< of the ray, across the direction in which the face is seen long
  double z = 0.0;
};

double z_of(const Corner& corner) { return corner.point->seen.z; }

}  // namespace

Crossing between(const Crossing& from, const Crossing& to, double s) {
  const double rest = 1.0 - s;
  return {.z = rest * from.z + s * to.z,
          .density = rest * from.density + s * to.density,
          .colour = rest * from.colour + s * to.colour,
          .contour = rest * from.contour + s * to.contour};
}

std::array<double, 3> PassedFace::weights(Passing passing) const {
  const double sum = sides[0] + sides[1] + sides[2];
  const double size = std::max({corners[0].size, corners[1].size, corners[2].size});
  // Areas have kept their digits unless the face is seen at a slant or is thin.
  constexpr double kWide = 0.02;
  return sum > kWide * size * size ? std::array{sides[1] / sum, sides[2] / sum, sides[0] / sum}
                                   : weights_edge_on(passing);
}

/// Seen from the ray the face is nearly a line. The plane through the ray across that line cuts the
/// face from one edge to another, at points that keep their digits; between them is the ray, to what
/// rounding leaves of how far off it they are.
std::array<double, 3> PassedFace::weights_edge_on(Passing passing) const {
  std::array<std::size_t, 3> order = {0, 1, 2};  // whichever cell asks
  std::ranges::sort(order, {}, [this](std::size_t i) { return corners.at(i).node; });
  double along_x = 0.0;
  double along_y = 0.0;
  double longest = -1.0;
  for (std::size_t k = 0; k < 3; ++k) {
    const Corner& a = corners.at(order.at(k));
    const Corner& b = corners.at(order.at((k + 1) % 3));
    const double length = std::hypot(b.x - a.x, b.y - a.y);
    if (length > longest) {
      longest = length;
      along_x = b.x - a.x;
      along_y = b.y - a.y;
    }
  }
  if (!(longest > 0.0)) {  // seen as a point: any point of it is on the ray
    const auto [first, last] =
        std::ranges::minmax(order, {}, [this](std::size_t i) { return z_of(corners.at(i)); });
    std::array<double, 3> weights{};
    weights.at(passing == Passing::latest ? last : first) = 1.0;
    return weights;
  }
  along_x /= longest;
  along_y /= longest;
  std::array<OnEdge, 2> ends;
  std::size_t n = 0;
  double error = 0.0;
  for (std::size_t k = 0; k < 3; ++k) {
    const std::size_t i = order.at(k);
    const std::size_t j = order.at((k + 1) % 3);
    const Corner& a = corners.at(i);
    const Corner& b = corners.at(j);
    error = std::max(error, a.error);
    const double of_a = a.x * along_x + a.y * along_y;
    const double of_b = b.x * along_x + b.y * along_y;
    if ((of_a < 0.0) == (of_b < 0.0) || n == 2) {
      continue;
    }
    const double s = of_a / (of_a - of_b);
    OnEdge& end = ends.at(n++);
    end.weights.at(i) = 1.0 - s;
    end.weights.at(j) = s;
    end.off = (1.0 - s) * (a.y * along_x - a.x * along_y) + s * (b.y * along_x - b.x * along_y);
    end.z = (1.0 - s) * z_of(a) + s * z_of(b);
  }
  if (n < 2) {  // beside it, by rounding: the corner that is nearest
    std::size_t chosen =
        std::ranges::min(order, {}, [this](std::size_t i) { return corners.at(i).size; });
    // Along an edge it passes both its ends.
    const double nearest = corners.at(chosen).size + 4.0 * corners.at(chosen).error;
    for (const std::size_t i : order) {
      const double later = z_of(corners.at(i)) - z_of(corners.at(chosen));
      if (corners.at(i).size <= nearest && ((passing == Passing::latest && later > 0.0) ||
                                            (passing == Passing::earliest && later < 0.0))) {
        chosen = i;
      }
    }
    std::array<double, 3> weights{};
    weights.at(chosen) = 1.0;
    return weights;
  }
  if (ends[0].z > ends[1].z) {
    std::swap(ends[0], ends[1]);
  }
  const double change = ends[0].off - ends[1].off;
  constexpr double kMargin = 4.0;
  const double open =
      kMargin * error < std::abs(change) ? kMargin * error / std::abs(change) : 1.0;
  double t = change != 0.0 ? std::clamp(ends[0].off / change, 0.0, 1.0) : 0.5;
  if (passing == Passing::earliest) {
    t = std::max(0.0, t - open);
  } else if (passing == Passing::latest) {
    t = std::min(1.0, t + open);
  }
  std::array<double, 3> weights{};
  for (std::size_t i = 0; i < 3; ++i) {
    weights.at(i) = (1.0 - t) * ends[0].weights.at(i) + t * ends[1].weights.at(i);
  }
  return weights;
}

Crossing PassedFace::crossing(Passing passing) const {
  const std::array<double, 3> of_corners = weights(passing);
  const FieldPoint& first = *corners[0].point;
  // From the first corner on: exact where all corners are alike.
  Crossing at{.z = first.seen.z,
              .density = first.density,
              .colour = first.colour,
              .contour = first.contour};
  for (std::size_t i = 1; i < 3; ++i) {
    const double weight = of_corners.at(i);
    const FieldPoint& point = *corners.at(i).point;
    at.z += weight * (point.seen.z - first.seen.z);
    at.density += weight * (point.density - first.density);
    at.colour += weight * (point.colour - first.colour);
    at.contour += weight * (point.contour - first.contour);
  }
  return at;
}

}  // namespace haarlight::render
