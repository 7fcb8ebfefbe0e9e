// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/reflectance/formats/rti_file.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <span>
#include <vector>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/relight/reflectance/formats/quantise.h"
#include "relight/reflectance/formats/header_reader.h"

namespace haarlight::relight {

namespace {

static_assert(std::endian::native == std::endian::little, "floats are stored as they are");

constexpr double kWhite = 255.0;
constexpr std::int64_t kLongestSide = 1 << 20;

struct RtiHeader {
  int width = 0;
  int height = 0;
  int n_terms = 0;
};

RtiHeader read_header(HeaderReader& reader) {
  if (!reader.line().starts_with("#HSH1.")) {
    reader.refuse_at(0, "not a .rti of harmonics: its first line is not #HSH1.2",
                     "give a .rti that HSHFitter, RTIBuilder or Relight wrote");
  }
  while (reader.peek() == '#') {
    (void)reader.line();
  }
  const auto type = reader.integer(-1000, 1000, "file type");
  if (type != 3) {
    reader.refuse(fmt::format("file type {}: only 3, hemispherical harmonics, is read", type));
  }
  RtiHeader header;
  header.width = static_cast<int>(reader.integer(1, kLongestSide, "width"));
  header.height = static_cast<int>(reader.integer(1, kLongestSide, "height"));
  (void)reader.integer(3, 3, "number of colours");
  header.n_terms = static_cast<int>(reader.integer(1, 1000, "number of terms"));
  if (header.n_terms != 4 && header.n_terms != 9 && header.n_terms != 16) {
    reader.refuse(fmt::format("{} terms: harmonics have 4, 9 or 16", header.n_terms));
  }
  const auto basis_type = reader.integer(-1000, 1000, "basis type");
  if (basis_type != 2) {
    reader.refuse(
        fmt::format("basis type {}: only 2, R, G and B coded apart, is read", basis_type));
  }
  const auto element = reader.integer(-1000, 1000, "element size");
  if (element != 1) {
    reader.refuse(
        fmt::format("elements of {} bytes: only 1 is read (4 is HSHFitter's "
                    "intermediate file)",
                    element));
  }
  reader.end_of_header();
  return header;
}

std::vector<float> read_floats(std::string_view bytes, std::size_t n) {
  std::vector<float> values(n);
  std::memcpy(values.data(), bytes.data(), n * sizeof(float));
  return values;
}

std::span<const std::byte> bytes_of(std::string_view text) {
  return std::as_bytes(std::span(text.data(), text.size()));
}

}  // namespace

bool is_rti(std::string_view head) noexcept { return head.substr(0, 4) == "#HSH"; }

ReflectanceModel parse_rti(std::string_view bytes, const std::string& where, HshOrder4 order4,
                           std::uint64_t most_bytes) {
  HeaderReader reader(bytes, where);
  const RtiHeader header = read_header(reader);
  const auto n_terms = static_cast<std::size_t>(header.n_terms);
  const std::string_view payload = reader.rest();
  const std::size_t n_scales = 2 * n_terms * sizeof(float);
  const std::uint64_t expected = n_scales + std::uint64_t{3} * n_terms *
                                                static_cast<std::uint64_t>(header.width) *
                                                static_cast<std::uint64_t>(header.height);
  if (payload.size() != expected) {
    reader.refuse_at(
        reader.offset() + std::min<std::uint64_t>(payload.size(), expected),
        fmt::format("{} bytes behind the header, where scales and {} x {} pixels of {} terms "
                    "are {}",
                    payload.size(), header.width, header.height, n_terms, expected),
        "copy the file again from its source");
  }
  ReflectanceModel model;
  model.basis = ReflectanceBasis::hsh;
  model.colour = ReflectanceColour::rgb;
  model.order4 = order4;
  model.n_terms = header.n_terms;
  const std::vector<float> scales = read_floats(payload, 2 * n_terms);
  for (std::size_t i = 0; i < 2 * n_terms; ++i) {
    if (!std::isfinite(scales[i])) {
      reader.refuse_at(reader.offset() + i * sizeof(float),
                       fmt::format("the {} of term {} is not a finite number",
                                   i < n_terms ? "scale" : "bias", i % n_terms),
                       "make the file again with its program");
    }
  }
  for (std::size_t p = 0; p < 3 * n_terms; ++p) {
    const std::size_t j = p % n_terms;
    model.scales.push_back(
        {static_cast<double>(scales[j]) / kWhite, static_cast<double>(scales[n_terms + j])});
  }
  model.planes =
      allocate_planes(header.height, header.width, 3 * header.n_terms, most_bytes, where);
  std::memcpy(model.planes.pixels().data(), payload.data() + n_scales,
              model.planes.pixels().size());
  return model;
}

ReflectanceModel read_rti(const std::filesystem::path& path, HshOrder4 order4,
                          std::uint64_t most_bytes) {
  const MappedFile file(path);
  const auto bytes = file.bytes();
  return parse_rti({reinterpret_cast<const char*>(bytes.data()), bytes.size()}, path.string(),
                   order4, most_bytes);
}

void write_rti(const std::filesystem::path& path, const ReflectanceModel& model) {
  const std::string where = path.string();
  require_consistent(model, where);
  if (model.basis != ReflectanceBasis::hsh || model.colour != ReflectanceColour::rgb) {
    throw Error(fmt::format("a .rti cannot hold {}{}", to_string(model.basis),
                            model.colour == ReflectanceColour::lrgb ? " with a luminance" : ""),
                where, "fit it as hsh in rgb first: haarlight convert does");
  }
  if (model.transfer != Transfer::srgb) {
    throw Error("viewers show a .rti as sRGB, and these colours are not", where,
                "fit it to sRGB first: haarlight convert does");
  }
  HAARLIGHT_EXPECTS(obeys(ScaleRule::rti, model), "scales that a .rti can say");
  const auto n_terms = static_cast<std::size_t>(model.n_terms);
  std::vector<float> scales(2 * n_terms);
  for (std::size_t j = 0; j < n_terms; ++j) {
    scales[j] = static_cast<float>(model.scales[j].scale * kWhite);
    scales[n_terms + j] = static_cast<float>(model.scales[j].offset);
  }
  PendingFile file(path);
  file.append(bytes_of(fmt::format("#HSH1.2\n3\n{} {} 3\n{} 2 1\n", model.planes.width(),
                                   model.planes.height(), model.n_terms)));
  file.append(std::as_bytes(std::span(scales)));
  file.append(std::as_bytes(model.planes.pixels()));
  file.commit();
}

}  // namespace haarlight::relight
