// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/shape/surface_mesh.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include <Eigen/Geometry>

#include "haarlight/core/error.h"
#include "haarlight/core/picture/image_io.h"

namespace haarlight::relight {

namespace {

using Eigen::Vector3d;

constexpr std::uint32_t kNoVertex = std::numeric_limits<std::uint32_t>::max();

Vector3d at(ImageView<const float> picture, int y, int x) {
  return {double{picture(y, x, 0)}, double{picture(y, x, 1)}, double{picture(y, x, 2)}};
}

std::array<float, 3> to_floats(const Vector3d& v) {
  return {static_cast<float>(v.x()), static_cast<float>(v.y()), static_cast<float>(v.z())};
}

struct Corner {
  int y = 0;
  int x = 0;
};

class MeshMaker {
 public:
  MeshMaker(ImageView<const float> points, ImageView<const std::uint8_t> is_known,
            ImageView<const std::uint8_t> is_cut, ImageView<const float> normals,
            ImageView<const float> albedo, const SurfaceMeshOptions& options)
      : points_(points),
        known_(is_known),
        cut_(is_cut),
        normals_(normals),
        albedo_(albedo),
        towards_(options.towards),
        least_facing_(std::cos(options.max_tilt_deg * std::numbers::pi / 180.0)),
        index_(static_cast<std::size_t>(points.height()) *
                   static_cast<std::size_t>(points.width()),
               kNoVertex) {}

  render::SurfaceMesh make() {
    for (int y = 0; y + 1 < points_.height(); ++y) {
      for (int x = 0; x + 1 < points_.width(); ++x) {
        add_square(y, x);
      }
    }
    return std::move(mesh_);
  }

 private:
  /// The shorter diagonal: across the smaller bend.
  void add_square(int y, int x) {
    const Corner a{y, x};
    const Corner b{y, x + 1};
    const Corner c{y + 1, x};
    const Corner d{y + 1, x + 1};
    const bool has_a = is_known(a);
    const bool has_b = is_known(b);
    const bool has_c = is_known(c);
    const bool has_d = is_known(d);
    if (has_a && has_b && has_c && has_d) {
      const double ad = (at(points_, y, x) - at(points_, y + 1, x + 1)).squaredNorm();
      const double bc = (at(points_, y, x + 1) - at(points_, y + 1, x)).squaredNorm();
      if (ad < bc) {
        add(a, c, d);
        add(a, d, b);
      } else {
        add(a, c, b);
        add(b, c, d);
      }
      return;
    }
    if (has_a && has_b && has_c) {
      add(a, c, b);
    } else if (has_a && has_b && has_d) {
      add(a, d, b);
    } else if (has_a && has_c && has_d) {
      add(a, c, d);
    } else if (has_b && has_c && has_d) {
      add(b, c, d);
    }
  }

  [[nodiscard]] bool is_known(const Corner& p) const {
    return known_(p.y, p.x) != 0 && at(points_, p.y, p.x).allFinite();
  }

  [[nodiscard]] bool is_cut(int y, int x, int way) const {
    return !cut_.is_empty() && cut_(y, x, way) != 0;
  }

  /// Whether a cut lies between two corners of one square; diagonals check all four sides.
  [[nodiscard]] bool are_parted(const Corner& p, const Corner& q) const {
    const int y = std::min(p.y, q.y);
    const int x = std::min(p.x, q.x);
    if (p.y == q.y) {
      return is_cut(y, x, 0);
    }
    if (p.x == q.x) {
      return is_cut(y, x, 1);
    }
    return is_cut(y, x, 0) || is_cut(y + 1, x, 0) || is_cut(y, x, 1) || is_cut(y, x + 1, 1);
  }

  void add(const Corner& p, const Corner& q, const Corner& r) {
    if (are_parted(p, q) || are_parted(q, r) || are_parted(r, p)) {
      return;
    }
    const Vector3d a = at(points_, p.y, p.x);
    const Vector3d across = (at(points_, q.y, q.x) - a).cross(at(points_, r.y, r.x) - a);
    const double area = across.norm();
    if (!(area > 0.0) || across.dot(towards_) < least_facing_ * area) {
      return;
    }
    mesh_.triangles.push_back({vertex(p), vertex(q), vertex(r)});
  }

  std::uint32_t vertex(const Corner& p) {
    std::uint32_t& index =
        index_[static_cast<std::size_t>(p.y) * static_cast<std::size_t>(points_.width()) +
               static_cast<std::size_t>(p.x)];
    if (index != kNoVertex) {
      return index;
    }
    index = static_cast<std::uint32_t>(mesh_.vertices.size());
    mesh_.vertices.push_back(to_floats(at(points_, p.y, p.x)));
    mesh_.normals.push_back(to_floats(at(normals_, p.y, p.x)));
    mesh_.uv.push_back({static_cast<float>((p.x + 0.5) / points_.width()),
                        static_cast<float>(1.0 - (p.y + 0.5) / points_.height())});
    std::array<std::uint8_t, 3> colour{};
    for (std::size_t c = 0; c < 3; ++c) {
      const int channel = albedo_.channels() == 3 ? static_cast<int>(c) : 0;
      const float value = std::clamp(albedo_(p.y, p.x, channel), 0.0F, 1.0F);
      colour[c] = static_cast<std::uint8_t>(std::lround(255.0F * srgb_from_linear(value)));
    }
    mesh_.colours.push_back(colour);
    return index;
  }

  ImageView<const float> points_;
  ImageView<const std::uint8_t> known_;
  ImageView<const std::uint8_t> cut_;
  ImageView<const float> normals_;
  ImageView<const float> albedo_;
  Vector3d towards_;
  double least_facing_;
  std::vector<std::uint32_t> index_;
  render::SurfaceMesh mesh_;
};

}  // namespace

render::SurfaceMesh make_surface_mesh(ImageView<const float> points,
                                      ImageView<const std::uint8_t> is_known,
                                      ImageView<const std::uint8_t> is_cut,
                                      ImageView<const float> normals,
                                      ImageView<const float> albedo,
                                      const SurfaceMeshOptions& options) {
  const auto fits = [&](int height, int width) {
    return height == points.height() && width == points.width();
  };
  HAARLIGHT_EXPECTS(fits(is_known.height(), is_known.width()) &&
                        fits(normals.height(), normals.width()) &&
                        fits(albedo.height(), albedo.width()) && points.channels() == 3 &&
                        normals.channels() == 3,
                    "pictures of one size");
  HAARLIGHT_EXPECTS(
      is_cut.is_empty() || (fits(is_cut.height(), is_cut.width()) && is_cut.channels() == 2),
      "cuts to the right and down");
  return MeshMaker(points, is_known, is_cut, normals, albedo, options).make();
}

}  // namespace haarlight::relight
