// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <cstring>
#include <filesystem>
#include <map>
#include <span>
#include <string>
#include <vector>

#include <zlib.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/relight/light/near_light.h"

/// @file
/// Matrices of numbers from a MATLAB level-5 file, as far as one published data set needs it:
/// little-endian, compressed or not, doubles or bytes. For tests and benchmarks.

namespace haarlight::relight {

/// A matrix by columns.
struct MatMatrix {
  int rows = 0;
  int cols = 0;
  std::vector<double> values;
  [[nodiscard]] double operator()(int row, int col) const {
    const int at = col * rows + row;
    return values.at(static_cast<std::size_t>(at));
  }
};

namespace mat_detail {

inline std::uint32_t word(std::span<const unsigned char> bytes, std::size_t at) {
  if (at + 4 > bytes.size()) {
    throw Error("ends too early", "MAT file", "fetch the file again");
  }
  std::uint32_t value = 0;
  std::memcpy(&value, bytes.data() + at, 4);
  return value;
}

struct Element {
  std::uint32_t type = 0;
  std::span<const unsigned char> data;
  std::size_t next = 0;
};

inline Element element(std::span<const unsigned char> bytes, std::size_t at, bool is_padded) {
  Element e;
  e.type = word(bytes, at);
  std::size_t size = 0;
  std::size_t begin = 0;
  if (e.type >> 16U != 0) {  // small: the size stands in the type's upper half
    size = e.type >> 16U;
    e.type &= 0xffffU;
    begin = at + 4;
    e.next = at + 8;
  } else {
    size = word(bytes, at + 4);
    begin = at + 8;
    e.next = begin + (is_padded ? (size + 7) / 8 * 8 : size);
  }
  if (begin + size > bytes.size()) {
    throw Error("ends too early", "MAT file", "fetch the file again");
  }
  e.data = bytes.subspan(begin, size);
  return e;
}

}  // namespace mat_detail

/// @throws Error  not such a file
inline std::map<std::string, MatMatrix> read_mat(const std::filesystem::path& file) {
  const std::string text = read_file(file, 1U << 20U);
  const std::vector<unsigned char> bytes(text.begin(), text.end());
  std::map<std::string, MatMatrix> out;
  for (std::size_t at = 128; at < bytes.size();) {
    mat_detail::Element top = mat_detail::element(bytes, at, false);
    at = top.next;
    std::vector<unsigned char> unpacked;
    if (top.type == 15) {  // compressed
      unpacked.resize(1U << 20U);
      uLongf size = unpacked.size();
      if (uncompress(unpacked.data(), &size, top.data.data(), top.data.size()) != Z_OK) {
        throw Error("a compressed part does not unpack", file.string(), "fetch the file again");
      }
      unpacked.resize(size);
      top = mat_detail::element(unpacked, 0, false);
    }
    std::vector<mat_detail::Element> parts;
    for (std::size_t i = 0; i < top.data.size();) {
      parts.push_back(mat_detail::element(top.data, i, true));
      i = parts.back().next;
    }
    if (top.type != 14 || parts.size() < 4) {
      throw Error("not a matrix", file.string(), "give a file of plain matrices");
    }
    MatMatrix matrix;
    matrix.rows = static_cast<int>(mat_detail::word(parts[1].data, 0));
    matrix.cols = static_cast<int>(mat_detail::word(parts[1].data, 4));
    const auto n =
        static_cast<std::size_t>(matrix.rows) * static_cast<std::size_t>(matrix.cols);
    const bool is_double = parts[3].type == 9;
    if (parts[3].data.size() < n * (is_double ? 8 : 1) || (!is_double && parts[3].type > 2)) {
      throw Error("numbers of a type that is not read", file.string(), "give doubles");
    }
    for (std::size_t i = 0; i < n; ++i) {
      double value = parts[3].data[i];
      if (is_double) {
        std::memcpy(&value, parts[3].data.data() + 8 * i, 8);
      }
      matrix.values.push_back(value);
    }
    out[std::string(parts[2].data.begin(), parts[2].data.end())] = matrix;
  }
  return out;
}

/// LEDs of light.mat (positions S, powers Phi, axes Dir, exponents mu, in the camera's frame: x
/// right, y down, z away) over a target at right angles to the camera's axis at `distance_mm`,
/// in the target's frame (x right, y up, z to the camera, origin on the axis). Powers of
/// mean 1.
inline std::vector<NearLight> read_near_leds(const std::filesystem::path& file,
                                             double distance_mm) {
  const std::map<std::string, MatMatrix> all = read_mat(file);
  const MatMatrix& s = all.at("S");
  const MatMatrix& phi = all.at("Phi");
  const MatMatrix& dir = all.at("Dir");
  std::vector<NearLight> lights(static_cast<std::size_t>(s.rows));
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (int k = 0; k < s.rows; ++k) {
    NearLight& light = lights[static_cast<std::size_t>(k)];
    light.position_mm = {s(k, 0), -s(k, 1), distance_mm - s(k, 2)};
    light.axis = Eigen::Vector3d(dir(k, 0), -dir(k, 1), -dir(k, 2)).normalized();
    light.mu = all.at("mu")(k, 0);
    light.power = {phi(k, 0), phi(k, 1), phi(k, 2)};
    mean += light.power / s.rows;
  }
  for (NearLight& light : lights) {
    light.power = light.power.cwiseQuotient(mean);
  }
  return lights;
}

}  // namespace haarlight::relight
