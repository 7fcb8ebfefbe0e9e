// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight cameras`: the V4L2 cameras of this machine and what each offers.

#include <fmt/format.h>

#include "apps/haarlight/verb.h"
#include "capture/camera/v4l2_list.h"

namespace haarlight::apps {

namespace {

ExitCode run_cameras(Report& report) {
  const std::vector<capture::V4l2Description> cameras = capture::list_v4l2_cameras();
  for (const capture::V4l2Description& camera : cameras) {
    fmt::print("{}", capture::to_text(camera));
  }
  if (cameras.empty()) {
    fmt::print("no V4L2 camera on this machine\n");
  }
  report.add_achieved("cameras", static_cast<std::int64_t>(cameras.size()));
  return ExitCode::done;
}

}  // namespace

void add_cameras(Command root, Invocation& invocation) {
  Command verb = root.add_verb(
      "cameras", "List this machine's V4L2 cameras: names, formats, rates, controls");
  verb.footer(
      "What it prints in quotes can be written into a rig file as it stands: "
      "docs/reference/cameras.md.\n"
      "Cameras behind a bridge (kind = \"remote\") are not listed.\n"
      "Example:\n  haarlight cameras");
  finish_verb(verb, invocation, [](const CommonOptions& /*common*/, Report& report) {
    return run_cameras(report);
  });
}

}  // namespace haarlight::apps
