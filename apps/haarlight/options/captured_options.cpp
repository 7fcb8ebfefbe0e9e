// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/options/captured_options.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "apps/haarlight/step_before.h"

namespace haarlight::apps {

void add_captured_options(Command verb, CapturedArguments& arguments) {
  verb.option("BASIS", &arguments.captured.basis, "Basis file",
              {.type = "BASIS.hlb", .is_required = true});
  add_hull_options(verb, arguments);
}

void add_hull_options(Command verb, CapturedArguments& arguments) {
  relight::CapturedObject& captured = arguments.captured;
  verb.option("--voxel", &arguments.voxel_mm,
              "Size of the hull's voxels, mm (default: as fine as the capture allows)",
              {.bounds = Bounds{0.01, 1000.0}});
  verb.option("--object-height", &arguments.height,
              "Lowest and highest point of the object over the plane, mm",
              {.type = "LOW,HIGH", .delimiter = ',', .count = 2});
  verb.option("--plane", &captured.planes,
              "The rig's planes to use (default: all); between planes it interpolates",
              {.type = "ID"});
  verb.option(
      "--also", &captured.also,
      "Further captures of the object under the same lights: the plane moved, or another "
      "camera's view of the same plane, which then is known where any of them sees it",
      {.type = "BASIS.hlb"});
  verb.option("--plate", &captured.plate,
              "Clean plate: a captured one, computed from the rig, or falloff (cos^4/r^2)",
              {.type = "FILE.hlb|computed|falloff", .shows_default = true});
  verb.option("--mask", &captured.mask,
              "Camera picture that is white where the plane is seen, black on the object",
              {.type = "FILE"});
}

std::vector<std::string> hull_words(const CapturedArguments& arguments) {
  const relight::CapturedObject& captured = arguments.captured;
  std::vector<std::string> words;
  const auto add = [&words](const char* name, const std::string& value) {
    words.emplace_back(name);
    words.push_back(value);
  };
  if (arguments.voxel_mm > 0.0) {
    add("--voxel", fmt::format("{}", arguments.voxel_mm));
  }
  if (!arguments.height.empty()) {
    add("--object-height", fmt::format("{}", fmt::join(arguments.height, ",")));
  }
  for (const std::string& plane : captured.planes) {
    add("--plane", plane);
  }
  for (const std::string& file : captured.also) {
    add("--also", file);
  }
  if (captured.plate != relight::CapturedObject{}.plate) {
    add("--plate", captured.plate);
  }
  if (!captured.mask.empty()) {
    add("--mask", captured.mask);
  }
  return words;
}

relight::CapturedObject captured_object(const CapturedArguments& arguments, const char* verb) {
  relight::CapturedObject captured = arguments.captured;
  if (!arguments.height.empty()) {
    captured.height = relight::HeightRange{arguments.height[0], arguments.height[1]};
  }
  refuse_not_basis(captured.basis, verb);
  return captured;
}

}  // namespace haarlight::apps
