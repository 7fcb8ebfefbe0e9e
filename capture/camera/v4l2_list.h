// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "capture/camera/v4l2_device.h"

/// @file
/// Which V4L2 cameras this machine has, what each offers, and which of them is the rig's.

namespace haarlight::capture {

/// A camera as shown to the operator or by `rig doctor`.
struct V4l2Description {
  std::string node;                ///< "/dev/video0"
  std::vector<std::string> links;  ///< its names under /dev/v4l/by-id and by-path
  V4l2Identity identity;
  std::vector<V4l2Format> formats;
  std::vector<V4l2Control> controls;
  std::optional<V4l2Crop> crop;  ///< nothing: the driver cannot crop the sensor
  std::string problem;           ///< not empty: why a device present could not be queried
};

/// Every node that streams pictures, by number; also those that could not be opened, with the
/// reason. Never waits for a frame; does not disturb a camera in use.
[[nodiscard]] std::vector<V4l2Description> list_v4l2_cameras(const V4l2Paths& paths = {});

/// One node, or a link to one. Faults as V4l2Device::open.
[[nodiscard]] Result<V4l2Description> describe_v4l2_camera(const std::filesystem::path& node,
                                                           const V4l2Paths& paths = {});

/// As text for display, several lines: identity, formats with sizes and rates, sensor region,
/// controls.
[[nodiscard]] std::string to_text(const V4l2Description& camera);

/// "Y16  640x480 (60, 30 fps), ...; GREY ..." on one line, only formats that haarlight reads.
[[nodiscard]] std::string formats_text(const std::vector<V4l2Format>& formats);

/// "640x480 from column 320, row 240".
[[nodiscard]] std::string region_text(const V4l2Rect& region);

/// "HD Camera, serial 1234" or "HD Camera at usb-0000:00:14.0-2".
[[nodiscard]] std::string identity_text(const V4l2Identity& identity);

/// The same camera, perhaps under another node: model, node index and serial number, or the
/// port it is plugged in to when it has none.
[[nodiscard]] bool is_same_camera(const V4l2Identity& a, const V4l2Identity& b) noexcept;

/// Opens the rig's camera: `device` when that is the right one, else the node that is.
/// @param wanted  known from an earlier start
/// @param serial  from the rig file, or empty
/// Fault device_gone when it is absent (with what is present instead), refused when two cameras
/// match.
[[nodiscard]] Result<V4l2Device> find_v4l2_camera(const std::filesystem::path& device,
                                                  const std::optional<V4l2Identity>& wanted,
                                                  const std::string& serial,
                                                  const V4l2Paths& paths);

}  // namespace haarlight::capture
