// SPDX-License-Identifier: Apache-2.0
#include "relight/hull/hull_file.h"

#include <bit>
#include <cmath>
#include <cstring>
#include <string_view>
#include <system_error>
#include <type_traits>
#include <vector>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"

namespace haarlight::relight {

namespace {

static_assert(std::endian::native == std::endian::little, "bytes are written as they lie");

constexpr std::string_view kMagic("HLHULL\0", 7);
constexpr std::size_t kHashDigits = 32;
constexpr std::size_t kMaxVoxels = std::size_t{1} << 32U;

class Output {
 public:
  template <class T>
  void put(const T& value) {
    static_assert(std::is_arithmetic_v<T>);
    const std::size_t at = bytes_.size();
    bytes_.resize(at + sizeof(T));
    std::memcpy(bytes_.data() + at, &value, sizeof(T));
  }
  void put_text(std::string_view text) { bytes_.append(text); }
  void put(const Eigen::Vector3d& v) {
    for (const double x : v) {
      put(x);
    }
  }
  [[nodiscard]] std::string take() {
    put_text(content_hash(std::string_view(bytes_)));
    return std::move(bytes_);
  }

 private:
  std::string bytes_;
};

/// Reads within bounds; beyond the end everything is zero and `is_good` is false.
class Input {
 public:
  explicit Input(std::string_view bytes) : bytes_(bytes) {}
  template <class T>
  [[nodiscard]] T get() {
    T value{};
    if (bytes_.size() < sizeof(T)) {
      is_good = false;
      return value;
    }
    std::memcpy(&value, bytes_.data(), sizeof(T));
    bytes_.remove_prefix(sizeof(T));
    return value;
  }
  [[nodiscard]] Eigen::Vector3d get_vector() {
    Eigen::Vector3d v;
    for (double& x : v) {
      x = get<double>();
    }
    return v;
  }
  [[nodiscard]] std::string_view get_text(std::size_t n) {
    const std::string_view text = bytes_.substr(0, n);
    is_good = is_good && text.size() == n;
    bytes_.remove_prefix(text.size());
    return text;
  }
  [[nodiscard]] std::size_t n_left() const { return bytes_.size(); }
  bool is_good = true;

 private:
  std::string_view bytes_;
};

void put_offset(const PlaneOffset& offset, Output& out) {
  out.put(offset.mm);
  out.put(offset.tilt_deg);
  out.put(offset.most_mm);
  out.put(offset.error_mm);
  out.put(static_cast<std::uint64_t>(offset.n_pixels));
  out.put(static_cast<std::uint8_t>(offset.is_noticeable));
}

PlaneOffset get_offset(Input& in) {
  PlaneOffset offset;
  offset.mm = in.get<double>();
  offset.tilt_deg = in.get<double>();
  offset.most_mm = in.get<double>();
  offset.error_mm = in.get<double>();
  offset.n_pixels = in.get<std::uint64_t>();
  offset.is_noticeable = in.get<std::uint8_t>() != 0;
  return offset;
}

constexpr std::uint8_t kShowsPlane = 1;
constexpr std::uint8_t kShowsObject = 2;

void put_plane(const FoundPlane& plane, Output& out) {
  out.put(plane.scale);
  put_offset(plane.offset, out);
  out.put(plane.shows_plane.width());
  out.put(plane.shows_plane.height());
  const auto shown = [&plane](std::size_t i) {
    return static_cast<std::uint8_t>((plane.shows_plane.pixels()[i] != 0 ? kShowsPlane : 0) |
                                     (plane.shows_object.pixels()[i] != 0 ? kShowsObject : 0));
  };
  const std::size_t n = plane.shows_plane.pixels().size();
  HAARLIGHT_EXPECTS(plane.shows_object.pixels().size() == n, "masks of one size");
  for (std::size_t i = 0; i < n;) {
    std::size_t end = i + 1;
    while (end < n && shown(end) == shown(i)) {
      ++end;
    }
    out.put(shown(i));
    out.put(static_cast<std::uint32_t>(end - i));
    i = end;
  }
}

/// Sets in.is_good to false where there is none.
FoundPlane get_plane(Input& in) {
  constexpr int kMaxSide = 1 << 15;
  constexpr std::int64_t kMaxPixels = std::int64_t{1} << 27U;
  FoundPlane plane;
  plane.scale = in.get<double>();
  plane.offset = get_offset(in);
  const int width = in.get<int>();
  const int height = in.get<int>();
  in.is_good = in.is_good && std::isfinite(plane.scale) && plane.scale > 0.0 && width > 0 &&
               height > 0 && width <= kMaxSide && height <= kMaxSide &&
               std::int64_t{width} * height <= kMaxPixels;
  if (!in.is_good) {
    return plane;
  }
  plane.shows_plane = Image<std::uint8_t>(height, width, 1);
  plane.shows_object = Image<std::uint8_t>(height, width, 1);
  const std::size_t n_all = plane.shows_plane.pixels().size();
  for (std::size_t at = 0; in.is_good && at < n_all;) {
    const auto shown = in.get<std::uint8_t>();
    const std::size_t n = in.get<std::uint32_t>();
    in.is_good = in.is_good && n > 0 && n <= n_all - at;
    for (std::size_t i = 0; in.is_good && i < n; ++i, ++at) {
      plane.shows_plane.pixels()[at] = (shown & kShowsPlane) != 0 ? 1 : 0;
      plane.shows_object.pixels()[at] = (shown & kShowsObject) != 0 ? 1 : 0;
    }
  }
  return plane;
}

void put_summary(const HullSummary& s, Output& out) {
  out.put(s.voxel_mm);
  out.put(s.n_voxels);
  out.put(s.n_empty);
  out.put(s.n_matter);
  out.put(s.n_assumed_full);
  out.put(s.n_assumed_empty);
  out.put(s.low_mm);
  out.put(s.high_mm);
  out.put(static_cast<std::uint8_t>(s.touches_border));
  out.put(static_cast<std::uint8_t>(s.leaves_camera));
  put_offset(s.offset, out);
  out.put(static_cast<std::uint32_t>(s.offset_plane.size()));
  out.put_text(s.offset_plane);
  out.put(s.n_lights);
  out.put(s.n_lookups);
}

HullSummary get_summary(Input& in) {
  HullSummary s;
  s.voxel_mm = in.get<double>();
  s.n_voxels = in.get<std::int64_t>();
  s.n_empty = in.get<std::int64_t>();
  s.n_matter = in.get<std::int64_t>();
  s.n_assumed_full = in.get<std::int64_t>();
  s.n_assumed_empty = in.get<std::int64_t>();
  s.low_mm = in.get<double>();
  s.high_mm = in.get<double>();
  s.touches_border = in.get<std::uint8_t>() != 0;
  s.leaves_camera = in.get<std::uint8_t>() != 0;
  s.offset = get_offset(in);
  s.offset_plane = in.get_text(in.get<std::uint32_t>());
  s.n_lights = in.get<int>();
  s.n_lookups = in.get<std::uint64_t>();
  return s;
}

bool is_valid(const VoxelGrid& grid) {
  return grid.nx > 0 && grid.ny > 0 && grid.nz > 0 && grid.nx <= 65535 && grid.ny <= 65535 &&
         grid.nz <= 65535 && grid.size() <= kMaxVoxels && std::isfinite(grid.voxel_mm) &&
         grid.voxel_mm > 0.0 && grid.low.allFinite() && grid.origin.allFinite();
}

}  // namespace

void write_hull(const ShadowHull& hull, const std::string& key,
                const std::filesystem::path& file) {
  HAARLIGHT_EXPECTS(key.size() == kHashDigits, "a key of 32 digits");
  std::error_code ignored;
  if (std::filesystem::exists(file, ignored) &&
      read_head(file, kMagic.size()) != std::string(kMagic)) {
    throw Error("it exists and is not a hull: it is not overwritten", file.string(),
                "move it elsewhere to have the hull kept");
  }
  Output out;
  out.put_text(kMagic);
  out.put(kHullVersion);
  out.put_text(key);
  const VoxelGrid& grid = hull.grid;
  out.put(grid.origin);
  for (const Eigen::Vector3d& axis : grid.axes) {
    out.put(axis);
  }
  out.put(grid.low);
  out.put(grid.voxel_mm);
  out.put(grid.nx);
  out.put(grid.ny);
  out.put(grid.nz);
  put_summary(hull.summary, out);
  for (std::size_t i = 0; i < hull.states.size();) {
    std::size_t end = i + 1;
    while (end < hull.states.size() && hull.states[end] == hull.states[i] &&
           end - i < 0xffffffffU) {
      ++end;
    }
    out.put(static_cast<std::uint8_t>(hull.states[i]));
    out.put(static_cast<std::uint32_t>(end - i));
    i = end;
  }
  for (const VoxelEvidence& evidence : hull.evidence) {
    out.put(evidence.lit);
    out.put(evidence.seen);
  }
  out.put(static_cast<std::uint32_t>(hull.planes.size()));
  for (const FoundPlane& plane : hull.planes) {
    put_plane(plane, out);
  }
  write_file_atomically(file, std::string_view(out.take()));
}

namespace {

/// @param key  empty: any
std::optional<ShadowHull> parse_hull(std::string_view bytes, std::string_view key) {
  if (bytes.size() < kMagic.size() + kHashDigits) {
    return std::nullopt;
  }
  const std::string_view body = bytes.substr(0, bytes.size() - kHashDigits);
  if (content_hash(body) != bytes.substr(body.size())) {
    return std::nullopt;
  }
  Input in(body);
  if (in.get_text(kMagic.size()) != kMagic || in.get<std::uint8_t>() != kHullVersion) {
    return std::nullopt;
  }
  const std::string_view made_from = in.get_text(kHashDigits);
  if (!key.empty() && made_from != key) {
    return std::nullopt;
  }
  ShadowHull hull;
  VoxelGrid& grid = hull.grid;
  grid.origin = in.get_vector();
  for (Eigen::Vector3d& axis : grid.axes) {
    axis = in.get_vector();
  }
  grid.low = in.get_vector();
  grid.voxel_mm = in.get<double>();
  grid.nx = in.get<int>();
  grid.ny = in.get<int>();
  grid.nz = in.get<int>();
  hull.summary = get_summary(in);
  if (!in.is_good || !is_valid(grid)) {
    return std::nullopt;
  }
  std::size_t n_not_empty = 0;
  while (in.is_good && hull.states.size() < grid.size()) {
    const auto state = in.get<std::uint8_t>();
    const auto n = in.get<std::uint32_t>();
    if (state > static_cast<std::uint8_t>(VoxelState::assumed_empty) || n == 0 ||
        n > grid.size() - hull.states.size()) {
      return std::nullopt;
    }
    n_not_empty += static_cast<VoxelState>(state) == VoxelState::empty ? 0 : n;
    hull.states.insert(hull.states.end(), n, static_cast<VoxelState>(state));
  }
  if (!in.is_good || in.n_left() < 2 * n_not_empty) {
    return std::nullopt;
  }
  hull.evidence.resize(n_not_empty);
  for (VoxelEvidence& evidence : hull.evidence) {
    evidence.lit = in.get<std::uint8_t>();
    evidence.seen = in.get<std::uint8_t>();
  }
  const auto n_planes = in.get<std::uint32_t>();
  for (std::uint32_t i = 0; in.is_good && i < n_planes; ++i) {
    hull.planes.push_back(get_plane(in));
  }
  if (!in.is_good || in.n_left() != 0) {
    return std::nullopt;
  }
  return hull;
}

}  // namespace

std::optional<ShadowHull> read_hull_of(const std::filesystem::path& file,
                                       const std::string& key) {
  try {
    return parse_hull(read_file(file), key);
  } catch (const Error&) {
    return std::nullopt;
  }
}

ShadowHull read_hull(const std::filesystem::path& file) {
  const char* hint = "haarlight hull OBJECT.hlb -o OBJECT.ply keeps one in OBJECT.hlb.hull";
  const std::string bytes = read_file(file);
  if (std::string_view(bytes).substr(0, kMagic.size()) != kMagic) {
    throw Error("not a shadow hull", file.string(), hint);
  }
  std::optional<ShadowHull> hull = parse_hull(bytes, {});
  if (!hull) {
    throw Error("a shadow hull that is damaged or of another version", file.string(), hint);
  }
  return *std::move(hull);
}

}  // namespace haarlight::relight
