// SPDX-License-Identifier: Apache-2.0
#include "capture/camera/v4l2_list.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include <fmt/format.h>

#include "core/rig/pixel_format.h"

namespace haarlight::capture {

namespace {

namespace fs = std::filesystem;

/// The videoN nodes of the device folder, by N.
std::vector<fs::path> video_nodes(const V4l2Paths& paths) {
  std::vector<std::pair<int, fs::path>> found;
  std::error_code ec;
  for (fs::directory_iterator it(paths.devices, ec), end; !ec && it != end; it.increment(ec)) {
    const std::string name = it->path().filename().string();
    if (name.size() > 5 && name.size() < 12 && name.starts_with("video") &&
        std::all_of(name.begin() + 5, name.end(),
                    [](char c) { return c >= '0' && c <= '9'; })) {
      found.emplace_back(std::atoi(name.c_str() + 5), it->path());
    }
  }
  std::sort(found.begin(), found.end());
  std::vector<fs::path> nodes;
  nodes.reserve(found.size());
  for (auto& [number, path] : found) {
    nodes.push_back(std::move(path));
  }
  return nodes;
}

std::vector<std::string> links_to(const fs::path& node, const V4l2Paths& paths) {
  std::vector<std::string> links;
  std::error_code ec;
  for (const char* folder : {"v4l/by-id", "v4l/by-path"}) {
    std::error_code end_of_folder;
    for (fs::directory_iterator it(paths.devices / folder, end_of_folder), end;
         !end_of_folder && it != end; it.increment(end_of_folder)) {
      if (fs::equivalent(it->path(), node, ec) && !ec) {
        links.push_back(it->path().string());
      }
    }
  }
  std::sort(links.begin(), links.end());
  return links;
}

std::string rates_text(const V4l2Size& size) {
  if (size.fps.empty()) {
    return {};
  }
  std::string text;
  for (const double fps : size.fps) {
    text += fmt::format("{}{:.4g}", text.empty() ? "" : size.is_fps_range ? " to " : ", ", fps);
  }
  return fmt::format(" ({} fps)", text);
}

std::string size_text(const V4l2Size& size) {
  const bool is_range = size.max_width > size.width || size.max_height > size.height;
  return is_range ? fmt::format("{}x{} to {}x{}{}", size.width, size.height, size.max_width,
                                size.max_height, rates_text(size))
                  : fmt::format("{}x{}{}", size.width, size.height, rates_text(size));
}

std::string sizes_text(const V4l2Format& format) {
  std::string text;
  for (const V4l2Size& size : format.sizes) {
    text += (text.empty() ? "" : ", ") + size_text(size);
  }
  return text.empty() ? "sizes not listed" : text;
}

}  // namespace

std::string identity_text(const V4l2Identity& identity) {
  const std::string where =
      identity.serial.empty() ? " at " + identity.bus_info : ", serial " + identity.serial;
  return identity.card + where +
         (identity.index == 0 ? "" : fmt::format(", its node {}", identity.index));
}

std::string region_text(const V4l2Rect& region) {
  return fmt::format("{}x{} from column {}, row {}", region.width, region.height, region.left,
                     region.top);
}

bool is_same_camera(const V4l2Identity& a, const V4l2Identity& b) noexcept {
  const bool is_named = !a.serial.empty() || !b.serial.empty();
  return a.card == b.card && a.index == b.index &&
         (is_named ? a.serial == b.serial : a.bus_info == b.bus_info);
}

std::string formats_text(const std::vector<V4l2Format>& formats) {
  std::string text;
  for (const V4l2Format& format : formats) {
    if (find_pixel_format(format.fourcc) != nullptr) {
      text += fmt::format("{}\"{}\" {}", text.empty() ? "" : "; ", format.fourcc,
                          sizes_text(format));
    }
  }
  return text.empty() ? "no format that haarlight reads" : text;
}

std::string to_text(const V4l2Description& camera) {
  if (!camera.problem.empty()) {
    return fmt::format("{}: {}\n", camera.node, camera.problem);
  }
  std::string text =
      fmt::format("{}: {} (driver {}, {})\n", camera.node, identity_text(camera.identity),
                  camera.identity.driver, camera.identity.bus_info);
  for (const std::string& link : camera.links) {
    text += fmt::format("  also {}\n", link);
  }
  for (const V4l2Format& format : camera.formats) {
    const PixelFormat* known = find_pixel_format(format.fourcc);
    const std::string_view use = known == nullptr                      ? "not read"
                                 : known->use == PixelUse::measurement ? "linear"
                                 : known->use == PixelUse::display     ? "not linear"
                                                                       : "preview only";
    text += fmt::format("  format \"{}\" {}: {}; {}\n", format.fourcc, format.description, use,
                        sizes_text(format));
  }
  if (camera.crop) {
    text += fmt::format("  region {} of {}; crop takes another one\n",
                        region_text(camera.crop->now), region_text(camera.crop->whole));
  }
  for (const V4l2Control& control : camera.controls) {
    if (control.kind == V4l2ControlKind::button || control.kind == V4l2ControlKind::other) {
      text += fmt::format("  control {}: {}\n", control.name,
                          control.kind == V4l2ControlKind::button
                              ? "a button; trigger.fire takes it"
                              : "an array or a text, which haarlight does not set");
      continue;
    }
    text += fmt::format("  control {} = {}", control.name, control.value);
    if (control.kind == V4l2ControlKind::menu) {
      for (const V4l2MenuEntry& entry : control.entries) {
        text += fmt::format("{}{} \"{}\"", &entry == &control.entries.front() ? ": " : ", ",
                            entry.value, entry.name);
      }
    } else {
      text += fmt::format(": {} to {}", control.min, control.max);
      text += control.step > 1 ? fmt::format(" in steps of {}", control.step) : "";
    }
    text += control.is_settable ? "\n" : ", cannot be set\n";
  }
  return text;
}

Result<V4l2Description> describe_v4l2_camera(const fs::path& node, const V4l2Paths& paths) {
  auto device = V4l2Device::open(node, paths);
  if (!device) {
    return tl::unexpected<Fault>(device.error());
  }
  V4l2Description camera;
  std::error_code ec;
  const fs::path real = fs::canonical(node, ec);
  camera.node = ec ? node.string() : real.string();
  camera.links = links_to(node, paths);
  camera.identity = device->identity();
  auto formats = device->formats();
  if (!formats) {
    return tl::unexpected<Fault>(formats.error());
  }
  camera.formats = *std::move(formats);
  auto controls = device->controls();
  if (!controls) {
    return tl::unexpected<Fault>(controls.error());
  }
  camera.controls = *std::move(controls);
  auto crop = device->crop();
  if (!crop) {
    return tl::unexpected<Fault>(crop.error());
  }
  camera.crop = *crop;
  return camera;
}

std::vector<V4l2Description> list_v4l2_cameras(const V4l2Paths& paths) {
  std::vector<V4l2Description> cameras;
  for (const fs::path& node : video_nodes(paths)) {
    auto camera = describe_v4l2_camera(node, paths);
    if (camera) {
      cameras.push_back(*std::move(camera));
    } else if (camera.error().code != Errc::unsupported) {  // metadata, output: not a camera
      V4l2Description broken;
      broken.node = node.string();
      broken.problem = camera.error().what;
      cameras.push_back(std::move(broken));
    }
  }
  return cameras;
}

Result<V4l2Device> find_v4l2_camera(const fs::path& device,
                                    const std::optional<V4l2Identity>& wanted,
                                    const std::string& serial, const V4l2Paths& paths) {
  const auto is_wanted = [&](const V4l2Identity& found) {
    return wanted ? is_same_camera(*wanted, found) : serial.empty() || found.serial == serial;
  };
  auto at_name = V4l2Device::open(device, paths);
  if (at_name && is_wanted(at_name->identity())) {
    return at_name;
  }
  if (!at_name && !wanted && serial.empty() && at_name.error().code != Errc::device_gone) {
    return at_name;
  }
  std::string others;
  std::optional<V4l2Device> found;
  for (const fs::path& node : video_nodes(paths)) {
    auto other = V4l2Device::open(node, paths);
    if (!other) {
      continue;
    }
    others += fmt::format("{}{} is {}", others.empty() ? "" : ", ", node.string(),
                          identity_text(other->identity()));
    if ((wanted || !serial.empty()) && is_wanted(other->identity())) {
      if (found) {
        return fail(Errc::refused,
                    fmt::format("{} and {} both are {}: unplug one", found->node(),
                                other->node(), identity_text(found->identity())));
      }
      found.emplace(*std::move(other));
    }
  }
  if (found) {
    return *std::move(found);
  }
  if (!at_name && at_name.error().code != Errc::device_gone) {
    return at_name;
  }
  const std::string expected = wanted ? ": " + identity_text(*wanted) + " is not there"
                               : !serial.empty() ? ": no camera has the serial number " + serial
                                                 : ": no such camera";
  return fail(Errc::device_gone,
              fmt::format("{}{}; {}", device.string(), expected,
                          others.empty() ? "this machine has no camera" : "here " + others));
}

}  // namespace haarlight::capture
