// SPDX-License-Identifier: Apache-2.0
#include "session/import/picture_lights.h"

#include <algorithm>
#include <charconv>
#include <cmath>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/core/picture/image_io.h"

namespace haarlight::session {

namespace {

namespace fs = std::filesystem;

constexpr const char* kAnotherWay =
    "give the list of lights: --lights FILE; or leave the picture out: --exclude NAME";

const std::string* find_note(const std::vector<PictureNote>& notes, std::string_view name) {
  for (const PictureNote& note : notes) {
    if (note.name == name) {
      return &note.text;
    }
  }
  return nullptr;
}

/// All numbers of the text, finite and separated by blanks.
std::vector<double> numbers_of(const std::string& text) {
  std::vector<double> numbers;
  const char* at = text.data();
  const char* const end = at + text.size();
  while (at != end) {
    double number = 0.0;
    const auto [next, error] = std::from_chars(at, end, number);
    if (error != std::errc() || !std::isfinite(number)) {
      return {};
    }
    numbers.push_back(number);
    at = next;
    if (at != end && (*at++ != ' ' || at == end)) {
      return {};
    }
  }
  return numbers;
}

std::vector<double> read_numbers(const std::string& text, std::size_t n, const char* name,
                                 const fs::path& path) {
  std::vector<double> numbers = numbers_of(text);
  if (numbers.size() != n) {
    throw Error(fmt::format("{} is \"{}\", not {} numbers", name, text.substr(0, 60), n),
                path.string(), kAnotherWay);
  }
  return numbers;
}

void read_position(const std::string& text, const char* name, const fs::path& path,
                   SessionLight& light) {
  const std::vector<double> position = read_numbers(text, 3, name, path);
  light.coordinates = {position[0], position[1], position[2]};
  const double length = light.coordinates.norm();
  constexpr double kLeastMm = 1e-9;
  constexpr double kUnitSlack = 1e-6;  // written with nine digits
  if (light.is_position ? length < kLeastMm : std::abs(length - 1.0) > kUnitSlack) {
    throw Error(fmt::format("{} is of length {:.9g}", name, length), path.string(),
                kAnotherWay);
  }
}

SessionLight light_of(const fs::path& path) {
  const std::vector<PictureNote> notes = read_picture_notes(path);
  SessionLight light;
  light.name = path.filename().string();
  if (const std::string* seen = find_note(notes, "haarlightLightFromObject")) {
    light.is_position = true;
    read_position(*seen, "haarlightLightFromObject", path, light);
    if (const std::string* lobe = find_note(notes, "haarlightLightLobe")) {
      const std::vector<double> n = read_numbers(*lobe, 4, "haarlightLightLobe", path);
      const Eigen::Vector3d axis(n[0], n[1], n[2]);
      constexpr double kUnitSlack = 1e-6;
      constexpr double kMostMu = 1e4;
      if (std::abs(axis.norm() - 1.0) > kUnitSlack || n[3] < 0.0 || n[3] > kMostMu) {
        throw Error("haarlightLightLobe is no unit axis and exponent", path.string(),
                    kAnotherWay);
      }
      light.lobe = LightLobe{axis, n[3]};
    }
    return light;
  }
  if (const std::string* direction = find_note(notes, "haarlightLightDirection")) {
    read_position(*direction, "haarlightLightDirection", path, light);
    return light;
  }
  if (find_note(notes, "haarlightLightPosition") != nullptr) {
    throw Error("its light's position is in its rig's frame, not as the picture sees it",
                path.string(),
                "export it again with this program (haarlight export --exr), or give the "
                "list of lights: --lights FILE");
  }
  throw Error("does not say where its light is, and no list of lights is given", path.string(),
              kAnotherWay);
}

}  // namespace

LightList lights_of_pictures(const fs::path& folder, const std::vector<std::string>& names) {
  if (names.empty()) {
    throw Error("no pictures", folder.string(),
                "name the folder with one picture per light, and the list of lights: --lights");
  }
  LightList list;
  for (const std::string& name : names) {
    list.lights.push_back(light_of(folder / name));
    if (list.lights.back().is_position != list.lights.front().is_position) {
      throw Error(fmt::format("names a {}, {} a {}",
                              list.lights.back().is_position ? "position" : "direction",
                              list.lights.front().name,
                              list.lights.front().is_position ? "position" : "direction"),
                  (folder / name).string(),
                  "keep the pictures of one set together: --exclude leaves others out");
    }
  }
  return list;
}

std::optional<FrameCrop> crop_of_picture(const fs::path& path, int width, int height) {
  const std::vector<PictureNote> notes = read_picture_notes(path);
  const std::string* text = find_note(notes, "haarlightCrop");
  if (text == nullptr) {
    return {};
  }
  const std::vector<double> n = read_numbers(*text, 4, "haarlightCrop", path);
  constexpr double kMaxSide = 1 << 20;
  const bool does_fit =
      std::all_of(n.begin(), n.end(),
                  [](double value) {
                    return value >= 0.0 && value <= kMaxSide && value == std::floor(value);
                  }) &&
      n[0] + width <= n[2] && n[1] + height <= n[3];
  if (!does_fit) {
    throw Error(fmt::format("haarlightCrop is \"{}\", which {} x {} pixels do not fit",
                            text->substr(0, 60), width, height),
                path.string(), "export the picture again");
  }
  return FrameCrop{static_cast<int>(n[0]), static_cast<int>(n[1]), static_cast<int>(n[2]),
                   static_cast<int>(n[3])};
}

}  // namespace haarlight::session
