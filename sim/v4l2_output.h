// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>

#include "haarlight/core/rig/rig.h"
#include "sim/camera_server.h"
#include "sim/virtual_camera.h"

/// @file
/// A virtual camera whose frames leave by a V4L2 output node. vivid (or v4l2loopback) passes
/// them on to a capture node, where any program reads them through the kernel's own video
/// layer.
///
/// The node sets the pace: a frame is exposed when the node has returned a buffer, and queued
/// when its exposure is over. It reaches the host no sooner than that, but possibly much later,
/// and the capture node's timestamp is its own: its meaning is stated in the capturing rig file
/// (docs/reference/virtual-machine.md does the calculation for vivid).

namespace haarlight::sim {

struct V4l2OutputOptions {
  VirtualCameraOptions camera{};
  /// A folder to store every frame in, with its ground truth; empty = none. frames.raw: the
  /// frames' words, little-endian, one after the other; frames.txt: a line each, in order:
  /// start and end of the exposure (CLOCK_MONOTONIC ns), tag, 1 when the light changed
  /// meanwhile.
  std::filesystem::path record;
};

struct V4l2OutputCounts {
  std::uint64_t n_written = 0;
  std::uint64_t n_mixed = 0;  ///< written while the light changed
};

/// Runs from construction to destruction, one thread of its own. Thread-safe.
class V4l2Output {
 public:
  /// Formats: "Y16 ", "Y12 ", "Y10 " (one word per pixel) and "GREY" (one byte per pixel).
  /// @throws Error  no such node, not an output node, a format or size other than the rig's
  V4l2Output(const CameraSpec& spec, const ControllerSpec& controller,
             const Transport& transport, LightSource light, const std::filesystem::path& node,
             const V4l2OutputOptions& options = {});
  ~V4l2Output();
  V4l2Output(const V4l2Output&) = delete;
  V4l2Output& operator=(const V4l2Output&) = delete;

  [[nodiscard]] V4l2OutputCounts counts() const;

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace haarlight::sim
