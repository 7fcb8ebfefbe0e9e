// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "capture/camera/v4l2_device.h"

/// @file
/// Which V4L2 cameras this machine has, what each offers, and which of them is the rig's.

namespace haarlight {

/// A camera as a person or `rig doctor` wants to see it.
struct V4l2Description {
  std::string node;                ///< "/dev/video0"
  std::vector<std::string> links;  ///< its names under /dev/v4l/by-id and by-path
  V4l2Identity identity;
  std::vector<V4l2Format> formats;
  std::vector<V4l2Control> controls;
  std::optional<V4l2Crop> crop;  ///< nothing: its driver takes no region of the sensor
  std::string problem;           ///< not empty: it is there but could not be asked, and why
};

/// Every node that streams pictures, in the order of their numbers; also those that could not
/// be opened, with the reason. Never waits for a frame; a camera in use is not disturbed.
[[nodiscard]] std::vector<V4l2Description> list_v4l2_cameras(const V4l2Places& places = {});

/// One node, or a link to one. Faults as V4l2Device::open.
[[nodiscard]] Result<V4l2Description> describe_v4l2_camera(const std::filesystem::path& node,
                                                           const V4l2Places& places = {});

/// For people, several lines: who it is, its formats with sizes and rates, the region
/// of the sensor, its controls.
[[nodiscard]] std::string to_text(const V4l2Description& camera);

/// "Y16  640x480 (60, 30 fps), ...; GREY ..." in one line, formats that haarlight reads only.
[[nodiscard]] std::string formats_text(const std::vector<V4l2Format>& formats);

/// "640x480 from column 320, row 240".
[[nodiscard]] std::string region_text(const V4l2Rect& region);

/// "HD Camera, serial 1234" or "HD Camera at usb-0000:00:14.0-2".
[[nodiscard]] std::string identity_text(const V4l2Identity& identity);

/// The same camera, perhaps under another node: model, node index and serial number, or the
/// place where it is plugged in when it has none.
[[nodiscard]] bool is_same_camera(const V4l2Identity& a, const V4l2Identity& b) noexcept;

/// Opens the rig's camera: `device` when it is the wanted one, else the node that is.
/// @param wanted  known from an earlier start
/// @param serial  of the rig file, or empty
/// Fault device_gone when it is not there (with what is there instead), refused when two
/// cameras answer to it.
[[nodiscard]] Result<V4l2Device> find_v4l2_camera(const std::filesystem::path& device,
                                                  const std::optional<V4l2Identity>& wanted,
                                                  const std::string& serial,
                                                  const V4l2Places& places);

}  // namespace haarlight
