// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/basis_header.h"

#include <charconv>
#include <cmath>
#include <limits>
#include <optional>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "core/json_value.h"
#include "core/text_limits.h"
#include "haarlight/core/error.h"
#include "haarlight/relight/basis/haar.h"
#include "relight/basis/light_basis.h"
#include "relight/basis/plate/tile_plate.h"
#include "session/photographed.h"

namespace haarlight::relight {

namespace {

using nlohmann::json;

constexpr int kMaxSide = 1 << 16;
constexpr int kMaxLights = 1 << 16;
constexpr int kMaxChannels = 16;

json from_number(double v) { return std::isfinite(v) ? json(v) : json(nullptr); }

[[noreturn]] void throw_bad(const std::string& what, const std::string& where) {
  throw Error(what, where, "the file is damaged: make it again with haarlight compress");
}

/// Reads fields and checks ranges; every failure names the field.
class Fields {
 public:
  Fields(const json& object, std::string prefix, const std::string& where)
      : object_(object), prefix_(std::move(prefix)), where_(where) {
    if (!object.is_object()) {
      throw_bad(fmt::format("header field '{}' is not an object", prefix_), where_);
    }
  }

  [[nodiscard]] bool has(const char* key) const { return object_.contains(key); }

  [[nodiscard]] const json& at(const char* key) const {
    const auto it = object_.find(key);
    if (it == object_.end()) {
      throw_bad(fmt::format("header field '{}{}' is missing", prefix_, key), where_);
    }
    return *it;
  }

  [[nodiscard]] int integer(const char* key, int low, int high) const {
    const json& value = at(key);
    if (!value.is_number_integer()) {
      throw_bad(fmt::format("header field '{}{}' is not an integer", prefix_, key), where_);
    }
    const auto v = value.get<std::int64_t>();
    if (v < low || v > high) {
      throw_bad(
          fmt::format("header field '{}{}' = {} is outside {}..{}", prefix_, key, v, low, high),
          where_);
    }
    return static_cast<int>(v);
  }

  /// A finite number; null means infinity.
  [[nodiscard]] double number(const char* key, double low = 0.0) const {
    const json& value = at(key);
    if (value.is_null()) {
      return std::numeric_limits<double>::infinity();
    }
    if (!value.is_number() || !(value.get<double>() >= low)) {
      throw_bad(
          fmt::format("header field '{}{}' is not a number of at least {}", prefix_, key, low),
          where_);
    }
    return value.get<double>();
  }

  [[nodiscard]] std::uint64_t whole(const char* key) const {
    const json& value = at(key);
    if (!value.is_number_unsigned()) {
      throw_bad(fmt::format("header field '{}{}' is not a whole number", prefix_, key), where_);
    }
    return value.get<std::uint64_t>();
  }

  [[nodiscard]] std::string text(const char* key) const {
    const json& value = at(key);
    if (!value.is_string()) {
      throw_bad(fmt::format("header field '{}{}' is not a text", prefix_, key), where_);
    }
    return value.get<std::string>();
  }

  [[nodiscard]] Fields object(const char* key) const {
    return {at(key), prefix_ + key + ".", where_};
  }

 private:
  const json& object_;
  std::string prefix_;
  const std::string& where_;
};

std::vector<BasisLight> lights_from_json(const json& list, const std::string& where) {
  std::vector<BasisLight> lights;
  if (!list.is_array()) {
    throw_bad("header field 'lights.list' is not a list", where);
  }
  for (const json& item : list) {
    const Fields fields(item, "lights.list[].", where);
    BasisLight light;
    light.name = fields.text("name");
    light.relative_power = fields.number("power");
    const json& position = fields.at("place");
    const json& is_position = fields.at("is_position");
    if (!position.is_array() || position.size() != 3 || !is_position.is_boolean()) {
      throw_bad("a light of the header has no position", where);
    }
    light.is_position = is_position.get<bool>();
    for (std::size_t i = 0; i < 3; ++i) {
      if (!position[i].is_number()) {
        throw_bad("a light's position is not three numbers", where);
      }
      light.coordinates[static_cast<Eigen::Index>(i)] = position[i].get<double>();
    }
    lights.push_back(std::move(light));
  }
  return lights;
}

void read_groups(BasisHeader& header, const json& list, const std::string& where) {
  if (!list.is_array()) {
    throw_bad("header field 'group_ends' is not a list", where);
  }
  int before = 0;
  for (const json& item : list) {
    const int end = item.is_number_integer() ? item.get<int>() : -1;
    if (end <= before || end > header.dims.n_lights) {
      throw_bad("header field 'group_ends' does not increase to the number of lights", where);
    }
    header.group_ends.push_back(end);
    before = end;
  }
  if (before != header.dims.n_lights) {
    throw_bad("header field 'group_ends' does not cover the lights", where);
  }
}

void read_units(BasisHeader& header, const json& list, const std::string& where) {
  if (!list.is_array() || list.size() != static_cast<std::size_t>(header.dims.n_lights)) {
    throw_bad("header field 'units' is not a list of one number per light", where);
  }
  for (const json& item : list) {
    const double unit = item.is_number() ? item.get<double>() : 0.0;
    if (!(unit > 0.0) || !std::isfinite(unit)) {
      throw_bad("a light's unit in the header is not above 0", where);
    }
    header.units.push_back(unit);
  }
}

std::vector<BasisSection> sections_from_json(const json& list, const std::string& where) {
  std::vector<BasisSection> sections;
  if (!list.is_array()) {
    throw_bad("header field 'sections' is not a list", where);
  }
  for (const json& item : list) {
    const Fields fields(item, "sections[].", where);
    BasisSection section;
    section.name = fields.text("name");
    section.offset = fields.whole("offset");
    section.bytes = fields.whole("bytes");
    section.n_values = fields.whole("values");
    const std::string digits = fields.text("checksum");
    const char* end = digits.data() + digits.size();
    const auto read = std::from_chars(digits.data(), end, section.checksum, 16);
    if (read.ec != std::errc() || read.ptr != end) {
      throw_bad(fmt::format("the checksum '{}' of section '{}' is no hexadecimal number",
                            digits, section.name),
                where);
    }
    sections.push_back(std::move(section));
  }
  return sections;
}

std::optional<ClippedValues> clipped_from_json(const Fields& fields, const StackDims& dims,
                                               const std::string& where) {
  ClippedValues clipped;
  clipped.n_values = fields.number("values");
  clipped.least_norm = fields.number("least_norm");
  if (!(clipped.fraction(dims) <= 1.0) || !(clipped.least_norm <= 1.0 + 1e-6)) {
    throw_bad("more values are clipped than there are", where);
  }
  return clipped;
}

/// n x n with n = 2^m in `grid`, all others in `rows` and `cols`: only one form per grid.
HaarGrid grid_from_json(const Fields& lights, const std::string& where) {
  const int side = lights.integer("grid", 0, 1024);
  if (!lights.has("rows") && !lights.has("cols")) {
    return {side, side};
  }
  const HaarGrid grid{lights.integer("rows", 1, 1024), lights.integer("cols", 1, 1024)};
  if (side != 0 || grid.is_plain()) {
    throw_bad(fmt::format("header field 'lights.grid' = {} beside 'lights.rows' = {} and "
                          "'lights.cols' = {}",
                          side, grid.rows, grid.cols),
              where);
  }
  return grid;
}

constexpr std::string_view kUnbalancedHaar = "unbalanced haar";

/// Older programs must not mistake the unbalanced transform for the plain one.
std::string basis_name(const BasisHeader& header) {
  const bool is_unbalanced = header.basis == BasisKind::haar && !header.grid.is_plain();
  return std::string(is_unbalanced ? kUnbalancedHaar : to_string(header.basis));
}

void check_basis(const BasisHeader& header, const std::string& word, const std::string& where) {
  const HaarGrid& grid = header.grid;
  if (grid.size() > 0 && (!grid.is_valid() || header.dims.n_lights % grid.size() != 0)) {
    throw_bad(fmt::format("{} lights are no grids of {} x {}", header.dims.n_lights, grid.rows,
                          grid.cols),
              where);
  }
  const GridNeed need = known_basis(header.basis).need;
  if (need != GridNeed::none && grid.size() == 0) {
    throw_bad(fmt::format("basis '{}' without a grid", word), where);
  }
  if (!missing_grid(need, grid).empty() || word != basis_name(header)) {
    throw_bad(fmt::format("basis '{}' over a grid of {} x {}", word, grid.rows, grid.cols),
              where);
  }
  if (!std::isfinite(header.step) || !std::isfinite(header.gain_step)) {
    throw_bad("the quantiser's step is not finite", where);
  }
  if (header.rig_toml.empty() &&
      header.lights.size() != static_cast<std::size_t>(header.dims.n_lights)) {
    throw_bad("the header tells neither the rig nor every light's position", where);
  }
}

template <EnumWithWords Enum>
Enum known(const Fields& fields, const char* key, const std::string& where) {
  const std::string word = fields.text(key);
  if (const std::optional<Enum> value = value_of<Enum>(word)) {
    return *value;
  }
  throw Error(fmt::format("{} '{}' is not known here", key, word), where,
              "read it with a newer haarlight");
}

}  // namespace

std::string basis_header_to_json(const BasisHeader& header) {
  json lights = json::array();
  for (const BasisLight& light : header.lights) {
    lights.push_back(
        {{"name", light.name},
         {"is_position", light.is_position},
         {"place", {light.coordinates.x(), light.coordinates.y(), light.coordinates.z()}},
         {"power", light.relative_power}});
  }
  json root = {
      {"format", "haarlight basis"},
      {"version", kBasisVersion},
      {"program", header.program},
      {"kind", to_string(header.content)},
      {"picture",
       {{"width", header.dims.width},
        {"height", header.dims.height},
        {"channels", header.dims.channels}}},
      {"tile", header.tile},
      {"basis", basis_name(header)},
      {"coding", to_string(header.coding)},
      {"group_ends", header.group_ends},
      {"step", header.step},
      {"dead_zone", header.dead_zone},
      {"dark_norm", header.dark_norm},
      {"plate",
       {{"kind", to_string(header.plate)},
        {"source", header.plate_source},
        {"rank", header.plate_rank},
        {"degree", header.plate_degree},
        {"gain_step", header.gain_step}}},
      {"lights",
       {{"count", header.dims.n_lights},
        {"grid", header.grid.is_plain() ? header.grid.rows : 0},
        {"rig_toml", header.rig_toml},
        {"rig_hash", header.rig_hash},
        {"list", lights}}},
      {"asked",
       {{"relative_l2", from_number(header.requested_relative_l2)},
        {"worst_pixel", from_number(header.requested_worst_pixel)}}},
      {"reached",
       {{"relative_l2", from_number(header.achieved.relative_l2)},
        {"worst_pixel", from_number(header.achieved.worst_pixel)},
        {"worst_value", from_number(header.achieved.worst_value)}}},
      {"stack", {{"norm", header.stack_norm}, {"peak", header.peak}}},
      {"mean_coefficients", header.mean_coefficients},
      {"source", {{"name", header.source}, {"hash", header.source_hash}}},
  };
  if (header.grid.size() > 0 && !header.grid.is_plain()) {
    root["lights"]["rows"] = header.grid.rows;
    root["lights"]["cols"] = header.grid.cols;
  }
  if (header.coding == BasisCoding::integers) {
    root["units"] = header.units;
  }
  if (!header.source_root.empty()) {
    root["source"]["root"] = header.source_root;
  }
  if (has_facts(header.photographed)) {
    root["photographed"] =
        parse_json<json>(session::facts_to_json(header.photographed), "photographed");
  }
  if (header.clipped) {
    root["clipped"] = {{"values", header.clipped->n_values},
                       {"least_norm", header.clipped->least_norm}};
  }
  json sections = json::array();
  for (const BasisSection& section : header.sections) {
    sections.push_back({{"name", section.name},
                        {"offset", section.offset},
                        {"bytes", section.bytes},
                        {"values", section.n_values},
                        {"checksum", fmt::format("{:016x}", section.checksum)}});
  }
  root["sections"] = std::move(sections);
  return root.dump(-1, ' ', false, json::error_handler_t::replace);
}

BasisHeader basis_header_from_json(const std::string& text, const std::string& where) {
  const json root = parse_json<json>(text, where + ", header");
  const Fields top(root, "", where);
  BasisHeader header;
  header.program = top.text("program");
  header.content = known<BasisContent>(top, "kind", where);
  const Fields picture = top.object("picture");
  header.dims.width = picture.integer("width", 1, kMaxSide);
  header.dims.height = picture.integer("height", 1, kMaxSide);
  header.dims.channels = picture.integer("channels", 1, kMaxChannels);
  header.tile = top.integer("tile", 1, 256);
  const Fields lights = top.object("lights");
  header.dims.n_lights = lights.integer("count", 1, kMaxLights);
  header.grid = grid_from_json(lights, where);
  header.rig_toml = lights.text("rig_toml");
  header.rig_hash = lights.text("rig_hash");
  header.lights = lights_from_json(lights.at("list"), where);
  const std::string basis = top.text("basis");
  const std::string coding = top.text("coding");
  const std::optional<BasisKind> known_kind =
      basis == kUnbalancedHaar ? BasisKind::haar : value_of<BasisKind>(basis);
  const std::optional<BasisCoding> known_coding = value_of<BasisCoding>(coding);
  if (!known_kind || !known_coding ||
      (known_coding == BasisCoding::integers && !is_integer_basis(*known_kind))) {
    throw Error(fmt::format("basis '{}' with coding '{}' is not known here", basis, coding),
                where, "read it with a newer haarlight");
  }
  header.basis = *known_kind;
  header.coding = *known_coding;
  if (header.coding == BasisCoding::integers) {
    read_units(header, top.at("units"), where);
  }
  header.step = top.number("step");
  header.dead_zone = top.number("dead_zone");
  header.dark_norm = top.number("dark_norm");
  const Fields plate = top.object("plate");
  header.plate = known<PlateOrigin>(plate, "kind", where);
  header.plate_source = plate.text("source");
  header.plate_rank = plate.integer("rank", 0, kMaxPlateRank);
  header.plate_degree = plate.integer("degree", 0, kMaxPlateDegree);
  header.gain_step = plate.number("gain_step");
  read_groups(header, top.at("group_ends"), where);
  const Fields requested = top.object("asked");
  header.requested_relative_l2 = requested.number("relative_l2");
  header.requested_worst_pixel = requested.number("worst_pixel");
  const Fields achieved = top.object("reached");
  header.achieved.relative_l2 = achieved.number("relative_l2");
  header.achieved.worst_pixel = achieved.number("worst_pixel");
  header.achieved.worst_value = achieved.number("worst_value");
  const Fields stack = top.object("stack");
  header.stack_norm = stack.number("norm");
  header.peak = stack.number("peak");
  header.mean_coefficients = top.number("mean_coefficients");
  const Fields source = top.object("source");
  header.source = source.text("name");
  header.source_hash = source.text("hash");
  if (source.has("root")) {  // a computed plate or an older session has none
    header.source_root = source.text("root");
  }
  if (top.has("photographed")) {
    header.photographed =
        session::facts_from_json(JsonValue::parse(text, where + ", header")["photographed"]);
  }
  if (top.has("clipped")) {
    header.clipped = clipped_from_json(top.object("clipped"), header.dims, where);
  }
  if (top.has("sections")) {  // not in version 2
    header.sections = sections_from_json(top.at("sections"), where);
  }
  check_basis(header, basis, where);
  return header;
}

}  // namespace haarlight::relight
