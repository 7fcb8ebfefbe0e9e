// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "capture/daemon/rig_watch.h"
#include "capture/doctor/rig_doctor.h"
#include "core/rig/rig.h"

/// @file
/// How the rig's devices stand, for the page: from what the daemon saw of them, and from what
/// can be seen without touching them. A device that a run uses is never asked anything.

namespace haarlight {

/// Controller, cameras, disk, clock and measured values: found, and the cure where something is
/// amiss. Reads files; not for the HTTP thread.
/// @param now_ns  CLOCK_MONOTONIC
[[nodiscard]] std::vector<DoctorLine> report_devices(
    const Rig& rig, const std::filesystem::path& sessions, const DeviceState& controller,
    const DeviceState& camera, std::int64_t now_ns, const DoctorOptions& options = {});

}  // namespace haarlight
