// SPDX-License-Identifier: Apache-2.0
/// @file
/// A build without the daemon (HAARLIGHT_DAEMON off): what its verbs say when they are named.

#include "apps/haarlight/rig/rig.h"
#include "apps/haarlight/verb.h"

namespace haarlight::apps {

namespace {

constexpr const char* kOption = "HAARLIGHT_DAEMON";

}  // namespace

void add_capture(Command root, Invocation& /*invocation*/) {
  root.leave_out("capture", kOption);
}

void add_status(Command root, Invocation& /*invocation*/) { root.leave_out("status", kOption); }

void add_pause(Command root, Invocation& /*invocation*/) { root.leave_out("pause", kOption); }

void add_resume(Command root, Invocation& /*invocation*/) { root.leave_out("resume", kOption); }

void add_abort(Command root, Invocation& /*invocation*/) { root.leave_out("abort", kOption); }

void add_all_off(Command root, Invocation& /*invocation*/) {
  root.leave_out("all-off", kOption);
}

void add_reshoot(Command root, Invocation& /*invocation*/) {
  root.leave_out("reshoot", kOption);
}

void add_preview(Command root, Invocation& /*invocation*/) {
  root.leave_out("preview", kOption);
}

void add_shot(Command root, Invocation& /*invocation*/) { root.leave_out("shot", kOption); }

void add_sessions(Command root, Invocation& /*invocation*/) {
  root.leave_out("sessions", kOption);
}

void add_rig_doctor(Command rig, Invocation& /*invocation*/) {
  rig.leave_out("doctor", kOption);
}

void add_rig_commission(Command rig, Invocation& /*invocation*/) {
  rig.leave_out("commission", kOption);
}

}  // namespace haarlight::apps
