// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"

/// @file
/// A V4L2 node as typed calls: the only file that includes linux/videodev2.h. Policy is in
/// v4l2_camera. Every call is one ioctl (repeated on EINTR) on a non-blocking descriptor; its
/// fault names the ioctl and the node.

namespace haarlight::capture {

/// Where nodes and their properties are found; a test has its own.
struct V4l2Paths {
  std::filesystem::path devices = "/dev";
  std::filesystem::path sysfs = "/sys";
};

/// Identifies a device. Two nodes of one device differ by index.
struct V4l2Identity {
  std::string card;  ///< model, as the driver reports it
  std::string driver;
  std::string bus_info;  ///< the port it is plugged in to
  std::string serial;    ///< of the USB device; empty where it has none
  int index = 0;         ///< of the node among those of its device
  friend bool operator==(const V4l2Identity&, const V4l2Identity&) = default;
};

struct V4l2Size {
  int width = 0;  ///< the smallest where max_width is larger
  int height = 0;
  int max_width = 0;
  int max_height = 0;
  int step_width = 1;
  int step_height = 1;
  std::vector<double> fps;    ///< as offered; empty: the driver does not say
  bool is_fps_range = false;  ///< any rate between the two in `fps`
  [[nodiscard]] bool holds(int w, int h) const;
};

struct V4l2Format {
  std::string fourcc;
  std::string description;
  std::vector<V4l2Size> sizes;  ///< empty: the driver does not say
};

/// `other`: an array, a string or a compound, which haarlight lists and does not set.
enum class V4l2ControlKind { integer, boolean, menu, button, other };

struct V4l2MenuEntry {
  std::int64_t value = 0;
  std::string name;
};

struct V4l2Control {
  std::uint32_t id = 0;
  std::string name;  ///< as `v4l2-ctl -L` spells it: lower case, underscores
  V4l2ControlKind kind = V4l2ControlKind::other;
  std::int64_t min = 0;
  std::int64_t max = 0;
  std::int64_t step = 1;
  std::int64_t default_value = 0;
  std::int64_t value = 0;   ///< at the time of listing
  bool is_settable = true;  ///< and readable, except for buttons
  bool is_inactive = false;
  bool is_wide = false;  ///< 64-bit
  std::vector<V4l2MenuEntry> entries;
};

/// Of the sensor, in pixels.
struct V4l2Rect {
  int left = 0;
  int top = 0;
  int width = 0;
  int height = 0;
  friend bool operator==(const V4l2Rect&, const V4l2Rect&) = default;
};

/// The region of the sensor that frames are taken from.
struct V4l2Crop {
  V4l2Rect now;
  V4l2Rect usual;  ///< the driver's default
  V4l2Rect whole;  ///< the bounds of all regions
};

/// What the driver set for S_FMT.
struct V4l2StreamFormat {
  std::string fourcc;
  int width = 0;
  int height = 0;
  std::size_t stride = 0;  ///< bytes per row, including padding
  std::size_t size = 0;    ///< bytes per buffer
  bool is_progressive = true;
  friend bool operator==(const V4l2StreamFormat&, const V4l2StreamFormat&) = default;
};

/// A filled buffer.
struct V4l2Filled {
  int index = 0;
  std::span<const std::byte> bytes;  ///< the bytes the driver reports as filled
  std::uint32_t sequence = 0;
  std::int64_t timestamp_ns = 0;
  std::int64_t arrival_ns = 0;  ///< DQBUF delivered it, CLOCK_MONOTONIC
  bool is_error = false;
  bool is_monotonic = false;             ///< the timestamp is CLOCK_MONOTONIC
  bool is_timestamped_at_start = false;  ///< else at the end of the frame
};

/// A change reported by the driver.
struct V4l2Event {
  enum class Kind { none, control, source, other };
  Kind kind = Kind::none;
  std::uint32_t control = 0;  ///< id
  std::int64_t value = 0;
};

/// What a wait returned.
struct V4l2Ready {
  bool has_frame = false;
  bool has_event = false;
  bool has_error = false;  ///< no longer streaming, broken, or gone
};

/// An open capture node. Move-only; closing unmaps. One thread.
class V4l2Device {
 public:
  /// Faults: device_gone (no such node), device_busy, refused (no permission to open it),
  /// unsupported (no memory-mapped streaming capture).
  [[nodiscard]] static Result<V4l2Device> open(const std::filesystem::path& node,
                                               const V4l2Paths& paths);
  ~V4l2Device();
  V4l2Device(V4l2Device&& other) noexcept;
  V4l2Device& operator=(V4l2Device&& other) noexcept;
  V4l2Device(const V4l2Device&) = delete;
  V4l2Device& operator=(const V4l2Device&) = delete;

  [[nodiscard]] const std::string& node() const noexcept { return node_; }
  [[nodiscard]] const V4l2Identity& identity() const noexcept { return identity_; }

  /// Everything the device lists; a driver that lists nothing yields an empty list.
  [[nodiscard]] Result<std::vector<V4l2Format>> formats() const;
  [[nodiscard]] Result<std::vector<V4l2Control>> controls() const;
  /// Fault device_gone when it is.
  [[nodiscard]] Result<void> check_presence() const;

  /// Sets the format, leaving bytes per row to the driver; returns what it set.
  [[nodiscard]] Result<V4l2StreamFormat> set_format(const std::string& fourcc, int width,
                                                    int height);
  [[nodiscard]] Result<V4l2StreamFormat> format() const;
  /// Nothing where the driver has no cropping.
  [[nodiscard]] Result<std::optional<V4l2Crop>> crop() const;
  /// Returns the region set, which may differ.
  [[nodiscard]] Result<V4l2Rect> set_crop(const V4l2Rect& region);
  /// Requests a rate; returns the rate set, or 0 where the driver has none.
  [[nodiscard]] Result<double> set_fps(double fps);
  /// By the 64-bit calls, or by the older ones where the driver has no others.
  [[nodiscard]] Result<std::int64_t> control(const V4l2Control& control) const;
  [[nodiscard]] Result<void> set_control(const V4l2Control& control, std::int64_t value);
  /// Subscribes to changes; false where the driver cannot report them.
  [[nodiscard]] Result<bool> watch_control(std::uint32_t id);
  [[nodiscard]] Result<bool> watch_source();
  /// The oldest pending change, kind none when there is none.
  [[nodiscard]] Result<V4l2Event> take_event();

  /// Requests buffers, maps what the driver grants and queues all of them; returns how many.
  [[nodiscard]] Result<int> make_buffers(int n);
  [[nodiscard]] std::size_t buffer_bytes() const noexcept;  ///< of the smallest buffer
  [[nodiscard]] Result<void> stream_on();
  /// Stops streaming; every buffer comes back unfilled. Callers that close ignore a fault.
  [[nodiscard]] Result<void> stream_off();
  [[nodiscard]] Result<void> queue(int index);
  [[nodiscard]] Result<void> queue_all();
  /// Waits until `deadline` at most. Fault timeout, io.
  [[nodiscard]] Result<V4l2Ready> wait(std::chrono::steady_clock::time_point deadline) const;
  /// A filled buffer, without waiting: fault timeout when there is none.
  [[nodiscard]] Result<V4l2Filled> dequeue();

 private:
  struct Mapping {
    void* data = nullptr;
    std::size_t size = 0;
  };
  V4l2Device(Fd fd, std::string node) : fd_(std::move(fd)), node_(std::move(node)) {}
  void unmap() noexcept;
  [[nodiscard]] Result<void> call(unsigned long request, void* argument,
                                  const char* name) const;
  /// False: the driver has no such event.
  [[nodiscard]] Result<bool> subscribe(std::uint32_t type, std::uint32_t id);
  [[nodiscard]] Result<V4l2Size> describe_size(V4l2Size size, std::uint32_t fourcc) const;
  [[nodiscard]] Result<std::vector<V4l2MenuEntry>> menu_of(const V4l2Control& control,
                                                           bool has_names) const;
  /// The next control after `id`; nothing at the end.
  [[nodiscard]] Result<std::optional<V4l2Control>> next_control(std::uint32_t id) const;
  [[nodiscard]] Result<V4l2Rect> selection(std::uint32_t target, const char* name) const;
  [[nodiscard]] Result<void> map_buffer(int index);

  Fd fd_;
  std::string node_;
  V4l2Identity identity_;
  bool is_multiplanar_ = false;
  std::uint32_t n_planes_ = 1;
  std::vector<Mapping> mappings_;
};

/// The fault's code for an errno of a V4L2 call.
[[nodiscard]] Errc errc_of_v4l2(int error) noexcept;

/// A control's name as `v4l2-ctl -L` spells it. Pure.
[[nodiscard]] std::string control_key(std::string_view driver_name);

// Control ids that need special treatment, as in linux/v4l2-controls.h.
namespace control_id {
inline constexpr std::uint32_t kAutoWhiteBalance = 0x0098090c;
inline constexpr std::uint32_t kExposure = 0x00980911;
inline constexpr std::uint32_t kAutoGain = 0x00980912;
inline constexpr std::uint32_t kGain = 0x00980913;
inline constexpr std::uint32_t kPowerLineFrequency = 0x00980918;
inline constexpr std::uint32_t kExposureAuto = 0x009a0901;
inline constexpr std::uint32_t kExposureAbsolute = 0x009a0902;
inline constexpr std::uint32_t kExposurePriority = 0x009a0903;
inline constexpr std::uint32_t kFocusAuto = 0x009a090c;
inline constexpr std::uint32_t kAnalogueGain = 0x009e0903;
}  // namespace control_id

}  // namespace haarlight::capture
