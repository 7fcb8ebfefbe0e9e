// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "capture/daemon/rig_watch.h"
#include "capture/doctor/rig_doctor.h"
#include "haarlight/core/rig/rig.h"

/// @file
/// The state of the rig's devices, for the page: from what the daemon observed, and from what
/// can be seen without touching them. A device in use by a run is never queried.

namespace haarlight::capture {

/// Controller, cameras, disk, clock and measured values: what was found, and a hint where
/// something is wrong. Reads files; not for the HTTP thread.
/// @param now_ns  CLOCK_MONOTONIC
[[nodiscard]] std::vector<DoctorLine> report_devices(
    const Rig& rig, const std::filesystem::path& sessions, const DeviceState& controller,
    const DeviceState& camera, std::int64_t now_ns, const DoctorOptions& options = {});

}  // namespace haarlight::capture
