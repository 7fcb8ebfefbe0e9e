// SPDX-License-Identifier: Apache-2.0
#include "haarlight/session/light_file.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <optional>
#include <set>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "core/json_value.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "session/transforms_file.h"

namespace haarlight::session {

namespace {

constexpr std::uintmax_t kMaxFile = std::uintmax_t{64} << 20U;
constexpr double kUnitSlack =
    0.1;  // lists are printed with 3 to 6 digits; positions differ far more
constexpr double kMostMu = 1e3;  // as in a rig file

std::string_view trim(std::string_view text) {
  constexpr std::string_view kSpace = " \t\r\v\f";
  const std::size_t begin = text.find_first_not_of(kSpace);
  if (begin == std::string_view::npos) {
    return {};
  }
  return text.substr(begin, text.find_last_not_of(kSpace) - begin + 1);
}

/// Cuts off a line's last word.
std::string_view take_last_word(std::string_view& line) {
  line = trim(line);
  const std::size_t space = line.find_last_of(" \t");
  const std::size_t begin = space == std::string_view::npos ? 0 : space + 1;
  const std::string_view word = line.substr(begin);
  line = trim(line.substr(0, begin));
  return word;
}

std::optional<double> parse_number(std::string_view word) {
  if (word.size() > 1 && word.front() == '+') {
    word.remove_prefix(1);
  }
  double value = 0.0;
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
  if (error != std::errc() || end != word.data() + word.size() || word.empty()) {
    return std::nullopt;
  }
  return value;
}

[[noreturn]] void refuse(const std::string& what, const std::string& where, std::size_t line,
                         const std::string& hint) {
  throw Error(what, fmt::format("{}:{}", where, line), hint);
}

/// Positions one light: as a unit direction or a position.
void set_light(SessionLight& light, const Eigen::Vector3d& numbers, bool is_position,
               const std::string& where) {
  if (!numbers.allFinite() || numbers.norm() > 1e9) {
    throw Error("a light's position is not three finite numbers", where, "write x y z");
  }
  const double length = numbers.norm();
  if (!is_position && length < 1e-12) {
    throw Error("a zero direction", where, "write the direction to the light as x y z");
  }
  light.is_position = is_position;
  light.coordinates = numbers;
  if (!is_position) {
    light.coordinates /= length;
  }
}

struct Line {
  std::size_t number = 0;
  std::string_view text;
};

std::vector<Line> lines_of(std::string_view text) {
  constexpr std::string_view kByteOrderMark = "\xef\xbb\xbf";
  if (text.substr(0, kByteOrderMark.size()) == kByteOrderMark) {
    text.remove_prefix(kByteOrderMark.size());
  }
  std::vector<Line> lines;
  std::size_t number = 0;
  while (!text.empty()) {
    ++number;
    const std::size_t end = text.find('\n');
    const std::string_view line = trim(text.substr(0, end));
    if (!line.empty() && line.front() != '#') {
      lines.push_back({number, line});
    }
    text = end == std::string_view::npos ? std::string_view() : text.substr(end + 1);
  }
  return lines;
}

struct LpLine {
  std::string name;
  Eigen::Vector3d numbers;
  std::size_t line = 0;
};

LpLine parse_lp_line(const Line& line, const std::string& where) {
  LpLine result;
  result.line = line.number;
  std::string_view rest = line.text;
  for (int axis = 2; axis >= 0; --axis) {
    const std::string_view word = take_last_word(rest);
    const std::optional<double> number = parse_number(word);
    if (!number || !std::isfinite(*number)) {
      refuse(fmt::format("\"{}\" is not a number", std::string(word.substr(0, 40))), where,
             line.number, "write: picture's name, then x y z of the light");
    }
    result.numbers[axis] = *number;
  }
  result.name = std::string(rest);
  if (result.name.size() >= 2 && result.name.front() == '"' && result.name.back() == '"') {
    result.name = result.name.substr(1, result.name.size() - 2);
  }
  if (result.name.find('\0') != std::string::npos) {
    refuse("a picture's name with a zero byte", where, line.number, "the file is damaged");
  }
  return result;
}

/// Whether the numbers are positions; refuses what could be either. Published lists have
/// directions from mirror balls that are short by a fifth, and single typing errors: those are
/// noted.
bool decide_positions(const std::vector<LpLine>& lines, LightCoordinates coordinates,
                      const std::string& where, LightList& list) {
  if (coordinates != LightCoordinates::automatic) {
    return coordinates == LightCoordinates::positions;
  }
  constexpr double kLongest = 2.0;          // no lights are this near, in mm
  constexpr std::size_t kFewestOthers = 9;  // per line that may be longer or shorter
  std::vector<const LpLine*> off;
  const LpLine* far = nullptr;
  std::size_t n_far = 0;
  for (const LpLine& line : lines) {
    const double length = line.numbers.norm();
    if (length >= 1e-12 && std::abs(length - 1.0) > kUnitSlack) {
      off.push_back(&line);
      if (length > kLongest || length < 1.0 / kLongest) {
        far = far == nullptr ? &line : far;
        ++n_far;
      }
    }
  }
  const auto numbers_of = [](const LpLine& line) {
    return fmt::format("({}, {}, {}) has length {:.3g}", line.numbers.x(), line.numbers.y(),
                       line.numbers.z(), line.numbers.norm());
  };
  if (n_far * (kFewestOthers + 1) > lines.size()) {
    refuse(numbers_of(*far) + ": a position, or a direction not of length 1?", where, far->line,
           "say which: --places positions (in mm) or --places directions");
  }
  if (!off.empty()) {
    list.disagreements.push_back(fmt::format(
        "{}:{}: {}, as {} of {} are not of length 1: taken as directions; mistyped?", where,
        off.front()->line, numbers_of(*off.front()), off.size(), lines.size()));
  }
  return false;
}

std::vector<Eigen::Vector3d> read_vectors(const JsonValue& list) {
  std::vector<Eigen::Vector3d> vectors;
  for (const JsonValue& item : list.elements()) {
    vectors.emplace_back(item["x"].number(), item["y"].number(), item["z"].number());
  }
  return vectors;
}

nlohmann::ordered_json vector_json(const Eigen::Vector3d& v) {
  return {{"x", v.x()}, {"y", v.y()}, {"z", v.z()}};
}

void check_count(std::size_t n, const std::string& where) {
  if (n == 0) {
    throw Error("no lights", where, "list a light for each picture");
  }
  constexpr std::size_t kMaxLights = std::size_t{1} << 20U;
  if (n > kMaxLights) {
    throw Error(fmt::format("{} lights", n), where, "at most 2^20 are read");
  }
}

}  // namespace

LightList parse_lp(std::string_view text, const std::string& where,
                   LightCoordinates coordinates) {
  const std::vector<Line> lines = lines_of(text);
  if (lines.empty()) {
    throw Error("an empty list of lights", where,
                "first the number of lights, then one line per light");
  }
  const std::optional<double> count = parse_number(lines[0].text);
  if (!count || *count < 1.0 || *count > 1e6 || *count != std::floor(*count)) {
    refuse(fmt::format("\"{}\" is not a number of lights",
                       std::string(lines[0].text.substr(0, 40))),
           where, lines[0].number, "write the number of lights on the first line");
  }
  check_count(lines.size() - 1, where);
  std::vector<LpLine> parsed;
  parsed.reserve(lines.size() - 1);
  std::set<std::string> names;
  for (std::size_t i = 1; i < lines.size(); ++i) {
    parsed.push_back(parse_lp_line(lines[i], where));
    const LpLine& line = parsed.back();
    if (line.name.empty() != parsed.front().name.empty()) {
      refuse("some lines name a picture and some do not", where, line.line,
             "name a picture on every line, or on none");
    }
    if (!line.name.empty() && !names.insert(line.name).second) {
      refuse(fmt::format("the picture \"{}\" is listed twice", line.name), where, line.line,
             "list each picture once");
    }
  }
  LightList list;
  list.announced = static_cast<std::size_t>(*count);
  const bool is_position = decide_positions(parsed, coordinates, where, list);
  if (static_cast<double>(lines.size() - 1) != *count) {
    list.disagreements.push_back(fmt::format("{}:{}: {} lights announced, {} lines follow",
                                             where, lines[0].number, *count, lines.size() - 1));
  }
  for (const LpLine& line : parsed) {
    SessionLight light;
    light.name = line.name;
    set_light(light, line.numbers, is_position, fmt::format("{}:{}", where, line.line));
    list.lights.push_back(std::move(light));
  }
  return list;
}

LightList parse_dome(std::string_view text, const std::string& where) {
  const JsonValue root = JsonValue::parse(text, where);
  const std::vector<std::string_view> kinds = {"directional", "spherical", "lights3d"};
  const std::size_t kind =
      root.has("lightConfiguration") ? root["lightConfiguration"].choice(kinds) : 0;
  LightList list;
  std::vector<Eigen::Vector3d> coordinates;
  JsonValue source = root;
  const bool has_positions =
      root.has("positionsSphere") && !root["positionsSphere"].elements().empty();
  if (kind == 2) {
    source = root["positions3d"];
    coordinates = read_vectors(source);
  } else if (kind == 1 && has_positions) {
    source = root["positionsSphere"];
    coordinates = read_vectors(source);
  } else {
    source = root["directions"];
    coordinates = read_vectors(source);
    if (kind == 1) {  // a sphere: direction * radius, raised by the offset
      const double radius = 0.5 * root["domeDiameter"].number(1e-9);
      const double offset = root.has("verticalOffset") ? root["verticalOffset"].number() : 0.0;
      for (std::size_t i = 0; i < coordinates.size(); ++i) {
        SessionLight unit;
        set_light(unit, coordinates[i], false, fmt::format("{}[{}]", source.location(), i));
        coordinates[i] = radius * unit.coordinates + offset * Eigen::Vector3d::UnitZ();
      }
    }
  }
  check_count(coordinates.size(), source.location());
  for (std::size_t i = 0; i < coordinates.size(); ++i) {
    SessionLight light;
    set_light(light, coordinates[i], kind != 0, fmt::format("{}[{}]", source.location(), i));
    list.lights.push_back(std::move(light));
  }
  if (!root.has("ledAdjust") || root["ledAdjust"].elements().empty()) {
    return list;
  }
  const std::vector<JsonValue> adjust = root["ledAdjust"].elements();
  if (adjust.size() != coordinates.size()) {
    root["ledAdjust"].refuse(
        fmt::format("{} factors for {} lights", adjust.size(), coordinates.size()),
        "give one per light, or none");
  }
  bool is_coloured = false;
  for (std::size_t i = 0; i < adjust.size(); ++i) {
    const double r = adjust[i]["r"].number(1e-6, 1e6);
    const double g = adjust[i]["g"].number(1e-6, 1e6);
    const double b = adjust[i]["b"].number(1e-6, 1e6);
    constexpr double kColourSlack = 0.01;
    is_coloured = is_coloured || std::max({r, g, b}) - std::min({r, g, b}) >
                                     kColourSlack * std::max({r, g, b});
    list.lights[i].relative_power = 3.0 / (r + g + b);
  }
  if (is_coloured) {
    list.notes.emplace_back("ledAdjust differs between colours: only its mean is used");
  }
  return list;
}

std::optional<LightLobe> lobe_of_json(const JsonValue& light) {
  if (!light.has("axis") && !light.has("lobe_mu")) {
    return std::nullopt;
  }
  const JsonValue axis = light["axis"];
  const std::vector<JsonValue> numbers = axis.elements();
  if (numbers.size() != 3) {
    axis.refuse(fmt::format("{} numbers", numbers.size()), "write [x, y, z]");
  }
  const Eigen::Vector3d read(numbers[0].number(), numbers[1].number(), numbers[2].number());
  if (!(std::abs(read.norm() - 1.0) < 1e-6)) {
    axis.refuse(fmt::format("an axis of length {}", read.norm()),
                "write a unit vector, the way the light shines");
  }
  if (!light.has("position_mm")) {
    axis.refuse("a lobe needs the light's position", "write position_mm");
  }
  return LightLobe{read, light["lobe_mu"].number(0.0, kMostMu)};
}

LightList parse_light_json(std::string_view text, const std::string& where) {
  const JsonValue root = JsonValue::parse(text, where);
  LightList list;
  for (const JsonValue& item : root["lights"].elements()) {
    SessionLight light;
    light.name = item.has("name") ? item["name"].text() : std::string();
    const bool is_position = item.has("position_mm");
    const JsonValue position = item[is_position ? "position_mm" : "direction"];
    const std::vector<JsonValue> numbers = position.elements();
    if (numbers.size() != 3) {
      position.refuse(fmt::format("{} numbers", numbers.size()), "write [x, y, z]");
    }
    set_light(light, {numbers[0].number(), numbers[1].number(), numbers[2].number()},
              is_position, position.location());
    if (item.has("relative_power")) {
      light.relative_power = item["relative_power"].number(1e-6, 1e6);
    }
    light.lobe = lobe_of_json(item);
    if (!list.lights.empty() && (light.name.empty() != list.lights[0].name.empty() ||
                                 light.is_position != list.lights[0].is_position)) {
      item.refuse("not given in the same way as the first light",
                  "name all pictures or none; give all directions or all positions");
    }
    list.lights.push_back(std::move(light));
  }
  check_count(list.lights.size(), root["lights"].location());
  return list;
}

LightList read_light_file(const std::filesystem::path& path, LightCoordinates coordinates) {
  const std::string text = read_file(path, kMaxFile);
  const std::size_t first = text.find_first_not_of(" \t\r\n\xef\xbb\xbf");
  if (first == std::string::npos || text[first] != '{') {
    return parse_lp(text, path.string(), coordinates);
  }
  const JsonValue root = JsonValue::parse(std::string_view(text).substr(first), path.string());
  if (root.has("frames") && !root.has("lights")) {
    return parse_transforms(root, coordinates);
  }
  return root.has("lights")
             ? parse_light_json(std::string_view(text).substr(first), path.string())
             : parse_dome(std::string_view(text).substr(first), path.string());
}

std::string format_lp(const std::vector<Eigen::Vector3d>& directions,
                      const std::vector<std::string>& names) {
  HAARLIGHT_EXPECTS(directions.size() == names.size(), "one name per light");
  std::string text = fmt::format("{}\n", directions.size());
  for (std::size_t i = 0; i < directions.size(); ++i) {
    text += fmt::format("{} {:.17g} {:.17g} {:.17g}\n", names[i], directions[i].x(),
                        directions[i].y(), directions[i].z());
  }
  return text;
}

std::string format_dome(const std::vector<SessionLight>& lights, const DomeLabel& label) {
  HAARLIGHT_EXPECTS(!lights.empty(), "at least one light");
  using Json = nlohmann::ordered_json;
  const bool is_position = lights[0].is_position;
  Json directions = Json::array();
  Json positions = Json::array();
  Json adjust = Json::array();
  double reach = 0.0;
  for (const SessionLight& light : lights) {
    directions.push_back(vector_json(light.coordinates.normalized()));
    if (is_position) {
      positions.push_back(vector_json(light.coordinates));
      reach = std::max(reach, light.coordinates.norm());
    }
    const double factor = 1.0 / light.relative_power;
    adjust.push_back({{"r", factor}, {"g", factor}, {"b", factor}});
  }
  Json dome;
  dome["label"] = label.label;
  dome["notes"] = label.notes;
  dome["imageWidth"] = label.image_width_mm;
  dome["domeDiameter"] = 2.0 * reach;
  dome["verticalOffset"] = 0.0;
  dome["lightConfiguration"] = is_position ? "lights3d" : "directional";
  dome["directions"] = std::move(directions);
  dome["positionsSphere"] = positions;
  dome["positions3d"] = std::move(positions);
  dome["ledAdjust"] = std::move(adjust);
  return dome.dump(1, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace haarlight::session
