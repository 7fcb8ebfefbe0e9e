// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include <dlfcn.h>
#include <linux/videodev2.h>

#include "tests/capture/camera/v4l2/v4l2_shim.h"

/// @file
/// What the two halves of the shim share: v4l2_shim.cpp replaces the C library's calls and
/// knows which descriptors are cameras; v4l2_shim_driver.cpp answers as their driver.

namespace haarlight::shim {

/// A plugged camera.
struct Device {
  std::string path;
  Camera camera;
  bool is_gone = false;
  bool is_silent = false;
  std::uint32_t fourcc = 0;
  int width = 0;
  int height = 0;
  std::size_t stride = 0;
  std::size_t size = 0;
  int fps = 0;
  std::vector<std::uint32_t> set_ids;
  Region region;
  std::size_t n_fired = 0;
  int owner = -1;  ///< descriptor that has the buffers
};

struct Filled {
  std::uint32_t index = 0;
  std::uint64_t n = 0;
  std::int64_t ready_ns = 0;
};

/// An open descriptor of a camera.
struct Handle {
  std::shared_ptr<Device> device;
  int wake = -1;    ///< the descriptor itself: an eventfd
  int memory = -1;  ///< of the buffers
  std::uint32_t n_buffers = 0;
  std::size_t buffer_size = 0;
  bool is_streaming = false;
  bool is_broken = false;
  std::deque<std::uint32_t> queued;
  std::deque<Filled> filled;
  std::int64_t t0_ns = 0;
  std::uint64_t n_next = 0;
  std::deque<std::int64_t> fired;  ///< when the frames of triggers will be there
  std::vector<std::uint32_t> watched;
  std::deque<v4l2_event> events;
};

struct Fault {
  unsigned long request = 0;
  std::size_t n = 0;
  std::size_t times = 1;
  int error = 0;  ///< 0: unplug
};

struct World {
  std::mutex mutex;
  std::map<std::string, std::shared_ptr<Device>> devices;
  std::map<int, Handle> handles;
  std::map<unsigned long, std::size_t> calls;
  std::vector<Fault> faults;
};

/// The next definition of a function after ours.
template <class Function>
Function* real(const char* name) {
  return reinterpret_cast<Function*>(::dlsym(RTLD_NEXT, name));
}

[[nodiscard]] std::int64_t now_ns();
/// Ends a wait on the descriptor.
void wake(const Handle& handle);

// As the driver, under the world's lock.
[[nodiscard]] Control* control_of(Device& device, std::uint32_t id);
int set_control(World& w, int fd, Device& device, std::uint32_t id, std::int64_t value);
/// Waits for triggers instead of running freely.
[[nodiscard]] bool is_triggered(Device& device);
[[nodiscard]] short poll_bits(Handle& handle);
/// When the next frame will be there.
[[nodiscard]] std::int64_t next_frame_ns(const Handle& handle);
/// Does what the request asks; 0 or an errno.
int answer(World& w, int fd, Handle& handle, unsigned long request, void* argument);

}  // namespace haarlight::shim
