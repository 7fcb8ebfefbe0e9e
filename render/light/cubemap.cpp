// SPDX-License-Identifier: Apache-2.0
#include "haarlight/render/light/cubemap.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <span>

#include <Eigen/Geometry>
#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/picture/image_io.h"

namespace haarlight::render {

namespace {

constexpr double kPi = std::numbers::pi;

constexpr std::array<const char*, 6> kFaceNames = {"+x", "-x", "+y", "-y", "+z", "-z"};
constexpr std::array<std::array<const char*, 2>, 6> kFaceFiles = {{{"px", "posx"},
                                                                   {"nx", "negx"},
                                                                   {"py", "posy"},
                                                                   {"ny", "negy"},
                                                                   {"pz", "posz"},
                                                                   {"nz", "negz"}}};
constexpr std::array<const char*, 7> kEndings = {".hdr",  ".exr", ".png", ".jpg",
                                                 ".jpeg", ".tif", ".tga"};

/// Cell (column, row) of each face in a cross.
constexpr std::array<std::array<int, 2>, 6> kHorizontalCells = {
    {{2, 1}, {0, 1}, {1, 0}, {1, 2}, {1, 1}, {3, 1}}};
constexpr std::array<std::array<int, 2>, 6> kVerticalCells = {
    {{2, 1}, {0, 1}, {1, 0}, {1, 2}, {1, 1}, {1, 3}}};

/// sin^2 of half the polar angle at the upper and the lower edge of a lat-long row: the fraction
/// of the sphere above each.
std::array<double, 2> heights(int row, int n_rows) {
  const double above = std::sin(0.5 * kPi * row / n_rows);
  const double below = std::sin(0.5 * kPi * (row + 1) / n_rows);
  return {above * above, below * below};
}

Eigen::Vector3d texel_radiance(const Image<float>& image, int y, int x) {
  if (image.channels() == 1) {
    return Eigen::Vector3d::Constant(double{image(y, x)});
  }
  return {double{image(y, x, 0)}, double{image(y, x, 1)}, double{image(y, x, 2)}};
}

Image<float> cut_square(const Image<float>& picture, int x0, int y0, int n, bool is_turned) {
  Image<float> face(n, n, picture.channels());
  for (int y = 0; y < n; ++y) {
    for (int x = 0; x < n; ++x) {
      for (int c = 0; c < picture.channels(); ++c) {
        face(y, x, c) =
            is_turned ? picture(y0 + n - 1 - y, x0 + n - 1 - x, c) : picture(y0 + y, x0 + x, c);
      }
    }
  }
  return face;
}

std::filesystem::path find_face(const std::filesystem::path& folder, std::size_t face) {
  for (const char* stem : kFaceFiles[face]) {
    for (const char* ending : kEndings) {
      std::filesystem::path file = folder / (std::string(stem) + ending);
      if (std::filesystem::exists(file)) {
        return file;
      }
    }
  }
  throw Error(fmt::format("the environment has no face {}", kFaceNames[face]), folder.string(),
              fmt::format("put {}.hdr (or posx-style names, .exr, .png) beside the other faces",
                          kFaceFiles[face][0]));
}

}  // namespace

Eigen::Vector3d cube_direction(int face, double s, double t) {
  // OpenGL's table of major axes; t = -1 is the picture's top row.
  Eigen::Vector3d gl;
  switch (face) {
    case 0:
      gl = {1.0, -t, -s};
      break;
    case 1:
      gl = {-1.0, -t, s};
      break;
    case 2:
      gl = {s, 1.0, t};
      break;
    case 3:
      gl = {s, -1.0, -t};
      break;
    case 4:
      gl = {s, -t, 1.0};
      break;
    default:
      gl = {-s, -t, -1.0};
      break;
  }
  return {gl.x(), -gl.z(), gl.y()};
}

Environment Environment::read(const std::filesystem::path& path) {
  if (std::filesystem::is_directory(path)) {
    std::array<Image<float>, 6> faces;
    for (std::size_t f = 0; f < faces.size(); ++f) {
      faces[f] = read_linear_image(find_face(path, f));
    }
    return from_faces(std::move(faces), path.string());
  }
  return from_picture(read_linear_image(path), path.string());
}

Environment Environment::from_picture(Image<float> picture, const std::string& name) {
  const int w = picture.width();
  const int h = picture.height();
  if (w < 1 || h < 1 || (picture.channels() != 1 && picture.channels() != 3)) {
    throw Error(fmt::format("an environment of {} channels", picture.channels()), name,
                "give a grey or RGB picture");
  }
  Environment environment;
  if (w == 2 * h) {
    environment.picture_ = std::move(picture);
    environment.layout_ = EnvironmentLayout::lat_long;
    environment.check(name);
    return environment;
  }
  const bool is_horizontal = w % 4 == 0 && w / 4 * 3 == h;
  const bool is_vertical = h % 4 == 0 && h / 4 * 3 == w;
  if (is_horizontal || is_vertical) {
    const int n = is_horizontal ? w / 4 : w / 3;
    const auto& cells = is_horizontal ? kHorizontalCells : kVerticalCells;
    for (std::size_t f = 0; f < 6; ++f) {
      environment.faces_[f] =
          cut_square(picture, cells[f][0] * n, cells[f][1] * n, n, is_vertical && f == 5);
    }
    environment.layout_ =
        is_horizontal ? EnvironmentLayout::horizontal_cross : EnvironmentLayout::vertical_cross;
  } else if (w == 6 * h || h == 6 * w) {
    const int n = std::min(w, h);
    for (int f = 0; f < 6; ++f) {
      environment.faces_[static_cast<std::size_t>(f)] =
          cut_square(picture, w > h ? f * n : 0, w > h ? 0 : f * n, n, false);
    }
    environment.layout_ = EnvironmentLayout::strip;
  } else {
    throw Error(
        fmt::format("an environment of {} x {} pixels has no shape known here", w, h), name,
        "give a lat-long picture (2:1), a cross (4:3 or 3:4), a strip (6:1) or a folder "
        "of six faces");
  }
  environment.check(name);
  return environment;
}

Environment Environment::from_faces(std::array<Image<float>, 6> faces,
                                    const std::string& name) {
  Environment environment;
  const int n = faces[0].width();
  for (std::size_t f = 0; f < faces.size(); ++f) {
    if (faces[f].width() != n || faces[f].height() != n || n < 1 ||
        faces[f].channels() != faces[0].channels() ||
        (faces[f].channels() != 1 && faces[f].channels() != 3)) {
      throw Error(fmt::format("face {} is {} x {} pixels with {} channels, face +x is {} x {} "
                              "with {}",
                              kFaceNames[f], faces[f].width(), faces[f].height(),
                              faces[f].channels(), n, faces[0].height(), faces[0].channels()),
                  name, "give six square grey or RGB faces of one size");
    }
  }
  environment.faces_ = std::move(faces);
  environment.layout_ = EnvironmentLayout::six_files;
  environment.check(name);
  return environment;
}

void Environment::check(const std::string& name) {
  constexpr float kRinging = 1e-5F;  // of the peak: below the resolution of any capture
  constexpr float kMost = 1e20F;     // sums of products end in single precision at 3.4e38
  const bool is_lat_long = layout_ == EnvironmentLayout::lat_long;
  const std::span<Image<float>> pictures =
      is_lat_long ? std::span<Image<float>>(&picture_, 1) : std::span<Image<float>>(faces_);
  float peak = 0.0F;
  for (const Image<float>& picture : pictures) {
    for (const float v : picture.pixels()) {
      peak = std::isfinite(v) ? std::max(peak, v) : peak;
    }
  }
  for (std::size_t f = 0; f < pictures.size(); ++f) {
    Image<float>& picture = pictures[f];
    for (int y = 0; y < picture.height(); ++y) {
      for (int x = 0; x < picture.width(); ++x) {
        for (int c = 0; c < picture.channels(); ++c) {
          float& v = picture(y, x, c);
          if (!std::isfinite(v) || v < -kRinging * peak) {
            throw Error(
                fmt::format("radiance {} at column {}, row {}{}", v, x, y,
                            is_lat_long ? "" : fmt::format(" of face {}", kFaceNames[f])),
                name, "light is finite and not negative: clip or repair the picture");
          }
          if (v > kMost) {
            throw Error(
                fmt::format("radiance {:.3g} at column {}, row {}{}: at most {:.0e}", v, x, y,
                            is_lat_long ? "" : fmt::format(" of face {}", kFaceNames[f]),
                            kMost),
                name, "scale the picture down, or repair the texel");
          }
          v = std::max(v, 0.0F);
        }
      }
    }
  }
}

bool Environment::is_colour() const noexcept {
  return (layout_ == EnvironmentLayout::lat_long ? picture_ : faces_[0]).channels() == 3;
}

void Environment::rotate(double angle_rad) {
  HAARLIGHT_EXPECTS(std::isfinite(angle_rad), "a finite angle");
  angle_ += angle_rad;
}

namespace {

/// Means over `step` x `step` texels; a row's weight is `weight(row)`.
Image<float> shrink(const Image<float>& from, int step,
                    const std::function<double(int row, int col)>& weight) {
  Image<float> to((from.height() + step - 1) / step, (from.width() + step - 1) / step,
                  from.channels());
  for (int y = 0; y < to.height(); ++y) {
    for (int x = 0; x < to.width(); ++x) {
      double weights = 0.0;
      std::array<double, 3> sums{};
      for (int row = y * step; row < std::min((y + 1) * step, from.height()); ++row) {
        for (int col = x * step; col < std::min((x + 1) * step, from.width()); ++col) {
          const double w = weight(row, col);
          weights += w;
          for (int c = 0; c < from.channels(); ++c) {
            sums[static_cast<std::size_t>(c)] += w * double{from(row, col, c)};
          }
        }
      }
      for (int c = 0; c < from.channels(); ++c) {
        to(y, x, c) = static_cast<float>(sums[static_cast<std::size_t>(c)] / weights);
      }
    }
  }
  return to;
}

/// The smallest divisor of both sizes that brings `across` down to `most`; 1 when none does.
int shrink_step(int across, int most, int width, int height) {
  for (int step = 1; step <= std::min(width, height); ++step) {
    if (across <= most * step && width % step == 0 && height % step == 0) {
      return step;
    }
  }
  return 1;
}

}  // namespace

Environment Environment::reduced(int most_across) const {
  HAARLIGHT_EXPECTS(most_across > 0, "a number of texels");
  Environment small = *this;
  if (layout_ == EnvironmentLayout::lat_long) {
    const int height = picture_.height();
    const int step =
        shrink_step(picture_.width(), most_across, picture_.width(), picture_.height());
    small.picture_ = shrink(picture_, step, [height](int row, int /*col*/) {
      return std::cos(kPi * row / height) - std::cos(kPi * (row + 1) / height);
    });
    return small;
  }
  for (std::size_t f = 0; f < faces_.size(); ++f) {
    const int n = faces_[f].width();
    const int step = shrink_step(4 * n, most_across, n, n);
    small.faces_[f] = shrink(faces_[f], step, [n](int row, int col) {
      const double s = (2.0 * col + 1.0) / n - 1.0;
      const double t = (2.0 * row + 1.0) / n - 1.0;
      return std::pow(1.0 + s * s + t * t, -1.5);
    });
  }
  return small;
}

int Environment::n_rows() const {
  return layout_ == EnvironmentLayout::lat_long ? picture_.height() : 6 * faces_[0].height();
}

int Environment::row_texels() const {
  return layout_ == EnvironmentLayout::lat_long ? picture_.width() : faces_[0].width();
}

EnvironmentPosition Environment::position_of(const Eigen::Vector3d& direction) const {
  const Eigen::Vector3d d =
      (Eigen::AngleAxisd(-angle_, Eigen::Vector3d::UnitZ()) * direction).normalized();
  EnvironmentPosition position;
  if (layout_ == EnvironmentLayout::lat_long) {
    const double theta = std::acos(std::clamp(d.z(), -1.0, 1.0));
    const double phi = std::atan2(d.y(), d.x());
    const double across = (kPi - phi) / (2.0 * kPi) * picture_.width();
    position.row =
        std::clamp(static_cast<int>(theta / kPi * picture_.height()), 0, picture_.height() - 1);
    position.col = std::clamp(static_cast<int>(across), 0, picture_.width() - 1);
    const auto [above, below] = heights(position.row, picture_.height());
    const double half = std::sin(0.5 * theta);
    position.u = std::clamp(across - position.col, 0.0, 1.0);
    position.v = std::clamp((half * half - above) / (below - above), 0.0, 1.0);
    return position;
  }
  const Eigen::Vector3d gl(d.x(), d.z(), -d.y());
  Eigen::Index axis = 0;
  const double major = gl.cwiseAbs().maxCoeff(&axis);
  const int face = static_cast<int>(2 * axis) + (gl[axis] < 0.0 ? 1 : 0);
  double s = 0.0;
  double t = -gl.y();
  switch (face) {
    case 0:
      s = -gl.z();
      break;
    case 1:
      s = gl.z();
      break;
    case 2:
      s = gl.x();
      t = gl.z();
      break;
    case 3:
      s = gl.x();
      t = -gl.z();
      break;
    case 4:
      s = gl.x();
      break;
    default:
      s = -gl.x();
      break;
  }
  const int n = faces_[0].width();
  const double across = 0.5 * (s / major + 1.0) * n;
  const double down = 0.5 * (t / major + 1.0) * n;
  const int y = std::clamp(static_cast<int>(down), 0, n - 1);
  position.row = face * n + y;
  position.col = std::clamp(static_cast<int>(across), 0, n - 1);
  position.u = std::clamp(across - position.col, 0.0, 1.0);
  position.v = std::clamp(down - y, 0.0, 1.0);
  return position;
}

Eigen::Vector3d Environment::radiance_at(const EnvironmentPosition& position) const {
  if (layout_ == EnvironmentLayout::lat_long) {
    return texel_radiance(picture_, position.row, position.col);
  }
  const int n = faces_[0].width();
  return texel_radiance(faces_[static_cast<std::size_t>(position.row / n)], position.row % n,
                        position.col);
}

Eigen::Vector3d Environment::radiance(const Eigen::Vector3d& direction) const {
  return radiance_at(position_of(direction));
}

Eigen::Vector3d Environment::direction(const EnvironmentPosition& position) const {
  if (layout_ == EnvironmentLayout::lat_long) {
    const auto [above, below] = heights(position.row, picture_.height());
    const double h = above + position.v * (below - above);
    const double across = 2.0 * std::sqrt(h * (1.0 - h));  // sin of the polar angle
    const double phi =
        kPi - 2.0 * kPi * (position.col + position.u) / picture_.width() + angle_;
    return {across * std::cos(phi), across * std::sin(phi), 1.0 - 2.0 * h};
  }
  const int n = faces_[0].width();
  const Eigen::AngleAxisd turn(angle_, Eigen::Vector3d::UnitZ());
  return turn * cube_direction(position.row / n, 2.0 * (position.col + position.u) / n - 1.0,
                               2.0 * (position.row % n + position.v) / n - 1.0)
                    .normalized();
}

double Environment::solid_angle_density(const EnvironmentPosition& position) const {
  if (layout_ == EnvironmentLayout::lat_long) {
    // Omega = dphi (cos t0 - cos t1), and cos t = 1 - 2 sin^2 t/2.
    const auto [above, below] = heights(position.row, picture_.height());
    return 4.0 * kPi / picture_.width() * (below - above);
  }
  const int n = faces_[0].width();
  const double s = 2.0 * (position.col + position.u) / n - 1.0;
  const double t = 2.0 * (position.row % n + position.v) / n - 1.0;
  const double squared = 1.0 + s * s + t * t;
  return 4.0 / (double(n) * n * squared * std::sqrt(squared));
}

std::string Environment::content_hash() const {
  ContentHash hash;
  const auto add = [&hash](const Image<float>& picture) {
    const std::array<int, 3> shape{picture.height(), picture.width(), picture.channels()};
    hash.add(std::as_bytes(std::span(shape)));
    hash.add(std::as_bytes(picture.pixels()));
  };
  add(picture_);
  for (const Image<float>& face : faces_) {
    add(face);
  }
  hash.add(std::as_bytes(std::span(&angle_, 1)));
  return hash.text();
}

}  // namespace haarlight::render
