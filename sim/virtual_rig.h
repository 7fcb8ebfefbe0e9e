// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "haarlight/core/rig/rig.h"
#include "sim/camera_server.h"
#include "sim/controller_server.h"
#include "sim/fault_script.h"
#include "sim/truth.h"
#include "sim/usb_device.h"
#include "sim/usb_redir_server.h"
#include "sim/v4l2_output.h"

/// @file
/// The whole virtual rig in one object: controller server, one camera server for each remote
/// camera of the rig file, and the fault script's clock. Run by haarlight-sim, and by tests in
/// their own process.

namespace haarlight::sim {

struct VirtualRigOptions {
  std::uint64_t seed = 1;
  double lit_electrons = 0.0;  ///< see VirtualCameraOptions
  FaultScript faults;
  int n_buffers = 8;
  double doubtful_us = 2000.0;  ///< see CameraServerOptions, also for the following
  bool is_prepared = false;
  double strobe_lost_probability = 0.0;
  double strobe_false_probability = 0.0;
  /// What the rig really is, where that differs from the rig file.
  SimTruth truth;
  /// Choose a free port and sockets in this folder instead of the rig file's addresses.
  std::filesystem::path own_folder;
  /// Where a controller of kind "usb" is plugged in: see UsbRedirServer.
  std::filesystem::path usb_redir;
  /// False: only the controller; the cameras are elsewhere and no transport is needed.
  bool has_cameras = true;
  /// A V4L2 output node that the first camera writes its frames to, instead of serving them on
  /// a socket, whatever its kind in the rig file. Frame faults don't apply to it.
  std::filesystem::path v4l2_output;
  std::filesystem::path record;  ///< see V4l2OutputOptions
};

/// Runs from construction to destruction. Thread-safe. No TBB, no ray caster.
class VirtualRig {
 public:
  /// @param transports  one per camera of the rig, in order; kept by reference
  /// @throws Error  addresses in use, a camera that is not remote, a controller by USB
  ///                without `usb_redir`
  VirtualRig(const Rig& rig, std::span<const Transport> transports,
             const VirtualRigOptions& options = {});
  ~VirtualRig();
  VirtualRig(const VirtualRig&) = delete;
  VirtualRig& operator=(const VirtualRig&) = delete;

  /// The rig with the addresses that are actually served: pass it to a capture.
  [[nodiscard]] const Rig& rig() const;
  [[nodiscard]] ControllerServer& controller();
  /// Of a camera that is served on a socket.
  [[nodiscard]] CameraServer& camera(int i);
  /// Null unless the first camera writes into a V4L2 output node.
  [[nodiscard]] V4l2Output* v4l2_output();
  /// Null unless the controller is of kind "usb".
  [[nodiscard]] UsbLightDevice* usb_device();
  [[nodiscard]] UsbRedirServer* usb_server();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace haarlight::sim
