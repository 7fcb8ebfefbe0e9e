// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string_view>

#include "sim/virtual_rig.h"

/// @file
/// Manual commands to a running virtual rig, one per line, for scripted tests:
///
///     unplug | replug                   the USB device or the serial cable, out and in again
///     stall|hang|gone [out|in|control] [SKIP [COUNT]]
///                                       USB transfers, from the (SKIP + 1)th of them on
///     drop [SKIP [COUNT]]               register requests that get no answer
///     late MS [SKIP [COUNT]]            ... that are answered MS milliseconds late
///     delay MS                          every answer from now on
///     restart MS                        turns the controller's power off for MS milliseconds
///     interlock open|closed
///     strobe                            one edge on the camera's strobe line
///     clear                             ends every fault
///
/// COUNT is 1 unless given; -1 = until `clear`.

namespace haarlight::sim {

/// Carries out one command.
/// @throws Error(usage)  not a command, or not possible on this rig; nothing was done
void obey_rig_command(VirtualRig& rig, std::string_view line);

}  // namespace haarlight::sim
