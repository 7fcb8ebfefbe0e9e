// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

/// @file
/// V4L2 devices without a driver: a shared library that stands between a program and the C
/// library's open, close, ioctl, mmap and poll. A plain file becomes a camera while it is
/// plugged; every other call passes. The client's code is the production one, its descriptor is
/// a real one (an eventfd), its buffers are real mappings (of a memfd).
///
/// It proves our code against our idea of V4L2; the virtual machine's test has a real driver.
/// Limits: poll of a device is answered alone (not in one call with other descriptors), select
/// and epoll see the eventfd only, dup and fork are not followed.

namespace haarlight::shim {

struct Control {
  std::uint32_t id = 0;
  std::string name;        ///< as a driver writes it: "Exposure Time, Absolute"
  std::uint32_t type = 1;  ///< V4L2_CTRL_TYPE_INTEGER
  std::int64_t min = 0;
  std::int64_t max = 255;
  std::int64_t step = 1;
  std::int64_t value = 0;
  std::vector<std::string> entries{};  ///< of a menu; an empty one is left out
  bool keeps = true;                   ///< false: takes a value and stays as it is
  std::uint32_t flags = 0;             ///< V4L2_CTRL_FLAG_...; HAS_PAYLOAD: an array
};

struct Offer {
  std::string fourcc;
  std::vector<std::pair<int, int>> sizes;
  std::vector<int> fps;
};

/// Of the sensor.
struct Region {
  int left = 0;
  int top = 0;
  int width = 0;
  int height = 0;
};

/// A buffer about to be filled.
struct Filling {
  std::span<std::byte> bytes;
  int width = 0;
  int height = 0;
  std::size_t stride = 0;
  std::uint64_t n = 0;  ///< frames since the stream began
  std::int64_t start_ns = 0;
  std::int64_t end_ns = 0;
  // What the client is told; to be changed at will.
  std::uint32_t sequence = 0;
  std::int64_t timestamp_ns = 0;
  std::uint32_t flags = 0;
  std::size_t bytes_used = 0;
};

struct Camera {
  std::string card = "Shim Camera";
  std::string bus_info = "usb-shim-1";
  bool is_multiplanar = false;
  bool is_capture = true;  ///< false: a node for something else
  std::vector<Offer> offers;
  std::vector<Control> controls;
  std::size_t row_padding = 0;   ///< bytes per row beyond the samples
  int bits_per_sample = 16;      ///< that a row's length is computed with
  bool sets_other_size = false;  ///< S_FMT answers with a size of its own
  std::uint32_t least_buffers = 2;
  std::uint32_t most_buffers = 32;
  std::uint32_t first_sequence = 0;
  bool has_events = true;
  bool has_ext_controls = true;        ///< false: the calls of before 64 bits only
  std::optional<Region> sensor{};      ///< regions can be set; frames have the region's size
  int region_step = 1;                 ///< a region's position is rounded to it
  bool format_forgets_region = false;  ///< S_FMT: a region at 0, 0 of the size requested
  /// Ids of a control that makes it wait for a trigger, when not 0, and of the one that fires.
  std::uint32_t trigger_mode = 0;
  std::uint32_t trigger_button = 0;
  std::int64_t trigger_delay_ns = 0;
  bool has_sequence_of_its_own = true;
  /// 0: a frame is there whenever it is requested; else one per so many nanoseconds.
  std::int64_t period_ns = 0;
  std::int64_t exposure_ns = 0;
  std::int64_t read_ns = 0;
  std::function<void(Filling&)> fill{};
  /// Controls that a beginning stream sets anew.
  std::map<std::uint32_t, int> set_at_stream_on{};
};

/// Makes the plain file `path` a camera. Thread-safe, as all here.
void plug(const std::string& path, Camera camera);
/// The camera is gone for those who have it open; the file is a plain one again.
void unplug(const std::string& path);
void unplug_all();

/// The current value, and a change of it that nobody requested; `is_told`: by an event.
[[nodiscard]] std::int64_t control_value(const std::string& path, std::uint32_t id);
void move_control(const std::string& path, std::uint32_t id, std::int64_t value, bool is_told);
/// Ids in the order in which they were set since the camera was plugged.
[[nodiscard]] std::vector<std::uint32_t> controls_set(const std::string& path);
/// Triggers that started an exposure since the camera was plugged.
[[nodiscard]] std::size_t n_fired(const std::string& path);
/// The region now; as another program sets it.
[[nodiscard]] Region region(const std::string& path);
void set_region(const std::string& path, const Region& region);
/// The stream breaks until it is left: poll says so, DQBUF answers EIO.
void break_stream(const std::string& path);
/// No frame comes while it is silent.
void set_silent(const std::string& path, bool is_silent);

// Faults: every ioctl is a call named by its request; these are calls too.
inline constexpr unsigned long kOpen = 1;
inline constexpr unsigned long kMmap = 2;
inline constexpr unsigned long kPoll = 3;

/// The n-th call (from 0, counted from now) of a kind fails with this errno, `times` times in a
/// row. kPoll: it answers POLLERR, EINTR excepted.
void fail_call(unsigned long request, std::size_t n, int error, std::size_t times = 1);
/// At the n-th call of a kind the camera is unplugged.
void unplug_at_call(unsigned long request, std::size_t n);
/// Forgets faults and counts.
void reset_calls();
/// Calls of each kind to plugged devices since reset_calls().
[[nodiscard]] std::map<unsigned long, std::size_t> calls();
/// Descriptors of devices that are open.
[[nodiscard]] std::size_t n_open();

}  // namespace haarlight::shim
