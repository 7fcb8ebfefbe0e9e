// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "capture/doctor/rig_doctor.h"
#include "core/report.h"

/// @file
/// The doctor's findings as lines for display, as JSON and in a report. Pure.

namespace haarlight::capture {

[[nodiscard]] std::string doctor_text(const std::vector<DoctorLine>& lines);
/// A list of objects: subject, finding, expected, found, and a hint under the key `cure`.
[[nodiscard]] std::string doctor_json(const std::vector<DoctorLine>& lines);
void add_to_report(const std::vector<DoctorLine>& lines, Report& report);

}  // namespace haarlight::capture
