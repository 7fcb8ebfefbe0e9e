// SPDX-License-Identifier: Apache-2.0
#include "tests/capture/camera/v4l2/v4l2_shim.h"

#include <algorithm>
#include <array>
#include <cerrno>
#include <climits>
#include <cstdarg>
#include <cstdlib>
#include <optional>
#include <utility>

#include <fcntl.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/mman.h>
#include <unistd.h>

#include "tests/capture/camera/v4l2/v4l2_shim_world.h"

namespace haarlight::shim {

namespace {

// A sanitizer that reports out of a lock reads its symbols through the calls below: they look
// at their arguments first, and take the lock for cameras only.
constexpr std::size_t kMaxDescriptors = 65536;
std::atomic<bool> is_any_plugged{false};  // for ever: closed descriptors must stay known
std::array<std::atomic<bool>, kMaxDescriptors> is_camera{};

bool may_be_camera(int fd) {
  return fd >= 0 && static_cast<std::size_t>(fd) < kMaxDescriptors &&
         is_camera[static_cast<std::size_t>(fd)];
}

World& world() {
  static auto* const the = new World;  // outlives every destructor that may still close
  return *the;
}

void take_away(World& w, const std::string& path) {
  const auto found = w.devices.find(path);
  if (found == w.devices.end()) {
    return;
  }
  found->second->is_gone = true;
  for (auto& [fd, handle] : w.handles) {
    if (handle.device == found->second) {
      wake(handle);
    }
  }
  w.devices.erase(found);
}

/// Counts a call; the errno that it must fail with, or 0.
int count_call(World& w, unsigned long request, const std::string& path) {
  const std::size_t n = w.calls[request]++;
  for (const Fault& fault : w.faults) {
    if (fault.request != request || n < fault.n || n >= fault.n + fault.times) {
      continue;
    }
    if (fault.error == 0) {
      take_away(w, path);
      return 0;
    }
    return fault.error;
  }
  return 0;
}

std::string real_path(const char* path) {
  std::array<char, PATH_MAX> buffer{};
  return ::realpath(path, buffer.data()) == nullptr ? std::string() : buffer.data();
}

/// The descriptor of a camera, -1 with errno, or nothing when the path is none.
std::optional<int> open_device(const char* path) {
  if (!is_any_plugged || path == nullptr) {
    return std::nullopt;
  }
  const std::string name = real_path(path);
  if (name.find("/dev/") == std::string::npos) {
    return std::nullopt;
  }
  World& w = world();
  const std::lock_guard lock(w.mutex);
  const auto found = w.devices.find(name);
  if (found == w.devices.end()) {
    return std::nullopt;
  }
  const auto device = found->second;
  if (const int error = count_call(w, kOpen, name); error != 0) {
    errno = error;
    return -1;
  }
  if (device->is_gone) {
    errno = ENODEV;
    return -1;
  }
  Handle handle;
  handle.device = device;
  handle.wake = ::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
  handle.memory = ::memfd_create("v4l2 buffers", MFD_CLOEXEC);
  const int fd = handle.wake;
  is_camera.at(static_cast<std::size_t>(fd)) = true;
  w.handles.insert_or_assign(fd, std::move(handle));
  return fd;
}

/// A camera's open descriptor under the world's lock; null and no lock for any other.
struct LockedHandle {
  std::unique_lock<std::mutex> lock;
  Handle* handle = nullptr;
};

LockedHandle lock_handle(int fd) {
  if (!may_be_camera(fd)) {
    return {};
  }
  World& w = world();
  std::unique_lock lock(w.mutex);
  const auto found = w.handles.find(fd);
  if (found == w.handles.end()) {
    return {};
  }
  return {std::move(lock), &found->second};
}

/// True when the descriptor was a camera's.
bool forget(int fd) {
  const auto [lock, handle] = lock_handle(fd);
  if (handle == nullptr) {
    return false;
  }
  if (handle->device->owner == fd) {
    handle->device->owner = -1;
  }
  real<int(int)>("close")(handle->memory);  // ours would come back here
  world().handles.erase(fd);
  is_camera[static_cast<std::size_t>(fd)] = false;
  return true;
}

std::optional<int> control_device(int fd, unsigned long request, void* argument) {
  const auto [lock, handle] = lock_handle(fd);
  if (handle == nullptr) {
    return std::nullopt;
  }
  int error = count_call(world(), request, handle->device->path);
  if (handle->device->is_gone) {
    error = ENODEV;
  }
  error = error != 0 ? error : answer(world(), fd, *handle, request, argument);
  if (error != 0) {
    errno = error;
    return -1;
  }
  return 0;
}

/// Descriptor of the buffers' memory for a camera's, -1 with errno, nothing for another.
std::optional<int> memory_of(int fd) {
  const auto [lock, handle] = lock_handle(fd);
  if (handle == nullptr) {
    return std::nullopt;
  }
  if (const int error = count_call(world(), kMmap, handle->device->path); error != 0) {
    errno = error;
    return -1;
  }
  if (handle->device->is_gone) {
    errno = ENODEV;
    return -1;
  }
  return handle->memory;
}

using Poll = int(pollfd*, nfds_t, int);

/// The answer of poll for one camera, or nothing for another descriptor.
std::optional<int> poll_device(pollfd* wait, int timeout_ms) {
  const std::int64_t end = timeout_ms < 0 ? INT64_MAX : now_ns() + timeout_ms * 1'000'000LL;
  bool is_first = true;
  for (;;) {
    std::int64_t until = end;
    {
      const auto [lock, handle] = lock_handle(wait->fd);
      if (handle == nullptr) {
        return std::nullopt;
      }
      const int error = is_first ? count_call(world(), kPoll, handle->device->path) : 0;
      is_first = false;
      if (error == EINTR) {
        errno = error;
        return -1;
      }
      wait->revents = static_cast<short>((error != 0 ? POLLERR : poll_bits(*handle)) &
                                         (wait->events | POLLERR | POLLHUP));
      if (wait->revents != 0) {
        return 1;
      }
      if ((handle->device->camera.period_ns > 0 || is_triggered(*handle->device)) &&
          !handle->device->is_silent) {
        until = std::min(until, next_frame_ns(*handle));
      }
    }
    const std::int64_t now = now_ns();
    if (now >= end) {
      return 0;
    }
    pollfd woken{.fd = wait->fd, .events = POLLIN, .revents = 0};
    const std::int64_t left_ms = std::clamp<std::int64_t>((until - now) / 1'000'000 + 1, 1, 50);
    if (real<Poll>("poll")(&woken, 1, static_cast<int>(left_ms)) > 0) {
      std::uint64_t count = 0;
      (void)!::read(wait->fd, &count, sizeof count);
    }
  }
}

}  // namespace

void plug(const std::string& path, Camera camera) {
  World& w = world();
  const std::lock_guard lock(w.mutex);
  auto device = std::make_shared<Device>();
  device->path = real_path(path.c_str());
  device->camera = std::move(camera);
  device->region = device->camera.sensor.value_or(Region{});
  w.devices.insert_or_assign(device->path, device);
  is_any_plugged = true;
}

void unplug(const std::string& path) {
  World& w = world();
  const std::lock_guard lock(w.mutex);
  take_away(w, real_path(path.c_str()));
}

void unplug_all() {
  World& w = world();
  const std::lock_guard lock(w.mutex);
  while (!w.devices.empty()) {
    const std::string path = w.devices.begin()->first;
    take_away(w, path);
  }
}

namespace {

/// The device of a path under the lock, or null.
template <class Work>
void with_device(const std::string& path, Work work) {
  World& w = world();
  const std::lock_guard lock(w.mutex);
  const auto found = w.devices.find(real_path(path.c_str()));
  if (found != w.devices.end()) {
    work(w, *found->second);
  }
}

}  // namespace

std::int64_t control_value(const std::string& path, std::uint32_t id) {
  std::int64_t value = -1;
  with_device(path, [&](World&, Device& device) { value = control_of(device, id)->value; });
  return value;
}

void move_control(const std::string& path, std::uint32_t id, std::int64_t value, bool is_told) {
  with_device(path, [&](World& w, Device& device) {
    if (is_told) {
      (void)set_control(w, -1, device, id, value);
      device.set_ids.pop_back();
    } else {
      control_of(device, id)->value = value;
    }
  });
}

std::vector<std::uint32_t> controls_set(const std::string& path) {
  std::vector<std::uint32_t> ids;
  with_device(path, [&](World&, Device& device) { ids = device.set_ids; });
  return ids;
}

std::size_t n_fired(const std::string& path) {
  std::size_t n = 0;
  with_device(path, [&](World&, Device& device) { n = device.n_fired; });
  return n;
}

Region region(const std::string& path) {
  Region found;
  with_device(path, [&](World&, Device& device) { found = device.region; });
  return found;
}

void set_region(const std::string& path, const Region& region) {
  with_device(path, [&](World&, Device& device) { device.region = region; });
}

void break_stream(const std::string& path) {
  with_device(path, [](World& w, Device& device) {
    for (auto& [fd, handle] : w.handles) {
      if (handle.device.get() == &device) {
        handle.is_broken = true;
        wake(handle);
      }
    }
  });
}

void set_silent(const std::string& path, bool is_silent) {
  with_device(path, [is_silent](World&, Device& device) { device.is_silent = is_silent; });
}

void fail_call(unsigned long request, std::size_t n, int error, std::size_t times) {
  World& w = world();
  const std::lock_guard lock(w.mutex);
  w.faults.push_back({request, w.calls[request] + n, times, error});
}

void unplug_at_call(unsigned long request, std::size_t n) { fail_call(request, n, 0); }

void reset_calls() {
  World& w = world();
  const std::lock_guard lock(w.mutex);
  w.calls.clear();
  w.faults.clear();
}

std::map<unsigned long, std::size_t> calls() {
  World& w = world();
  const std::lock_guard lock(w.mutex);
  return w.calls;
}

std::size_t n_open() {
  World& w = world();
  const std::lock_guard lock(w.mutex);
  return w.handles.size();
}

}  // namespace haarlight::shim

// ---- instead of the C library's ----

namespace shim = haarlight::shim;

// The C library's own declarations carry attributes and variadic forms; these stand beside
// them.
#pragma GCC diagnostic ignored "-Wattributes"
#if !defined(__clang__)
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"
#endif

extern "C" {

#define HAARLIGHT_SHIM_MODE(last)             \
  mode_t mode = 0;                            \
  if ((flags & (O_CREAT | O_TMPFILE)) != 0) { \
    va_list rest;                             \
    va_start(rest, last);                     \
    mode = va_arg(rest, mode_t);              \
    va_end(rest);                             \
  }

int open(const char* path, int flags, ...) {
  HAARLIGHT_SHIM_MODE(flags)
  const auto fd = shim::open_device(path);
  return fd ? *fd : shim::real<int(const char*, int, ...)>("open")(path, flags, mode);
}

int open64(const char* path, int flags, ...) {
  HAARLIGHT_SHIM_MODE(flags)
  const auto fd = shim::open_device(path);
  return fd ? *fd : shim::real<int(const char*, int, ...)>("open64")(path, flags, mode);
}

int openat(int folder, const char* path, int flags, ...) {
  HAARLIGHT_SHIM_MODE(flags)
  const bool is_plain = path[0] == '/' || folder == AT_FDCWD;
  const auto fd = is_plain ? shim::open_device(path) : std::nullopt;
  return fd ? *fd
            : shim::real<int(int, const char*, int, ...)>("openat")(folder, path, flags, mode);
}

int openat64(int folder, const char* path, int flags, ...) {
  HAARLIGHT_SHIM_MODE(flags)
  const bool is_plain = path[0] == '/' || folder == AT_FDCWD;
  const auto fd = is_plain ? shim::open_device(path) : std::nullopt;
  return fd ? *fd
            : shim::real<int(int, const char*, int, ...)>("openat64")(folder, path, flags,
                                                                      mode);
}

// What open and poll become under _FORTIFY_SOURCE.
// NOLINTBEGIN(bugprone-reserved-identifier, cert-dcl37-c, readability-identifier-naming)
int __open_2(const char* path, int flags) {
  const auto fd = shim::open_device(path);
  return fd ? *fd : shim::real<int(const char*, int)>("__open_2")(path, flags);
}

int __open64_2(const char* path, int flags) {
  const auto fd = shim::open_device(path);
  return fd ? *fd : shim::real<int(const char*, int)>("__open64_2")(path, flags);
}

int __poll_chk(pollfd* waits, nfds_t n, int timeout_ms, std::size_t /*size*/) {
  return poll(waits, n, timeout_ms);
}
// NOLINTEND(bugprone-reserved-identifier, cert-dcl37-c, readability-identifier-naming)

int close(int fd) {
  (void)shim::forget(fd);
  return shim::real<int(int)>("close")(fd);
}

int ioctl(int fd, unsigned long request, ...) noexcept {
  va_list rest;
  va_start(rest, request);
  void* argument = va_arg(rest, void*);
  va_end(rest);
  // The kernel looks at 32 bits; clients pass signed constants.
  const auto done = shim::control_device(fd, request & 0xFFFF'FFFFUL, argument);
  return done ? *done
              : shim::real<int(int, unsigned long, ...)>("ioctl")(fd, request, argument);
}

void* mmap(void* address, std::size_t length, int protection, int flags, int fd,
           off_t offset) noexcept {
  const auto memory = fd >= 0 ? shim::memory_of(fd) : std::nullopt;
  if (memory && *memory < 0) {
    return MAP_FAILED;
  }
  return shim::real<void*(void*, std::size_t, int, int, int, off_t)>("mmap")(
      address, length, protection, flags, memory.value_or(fd), offset);
}

void* mmap64(void* address, std::size_t length, int protection, int flags, int fd,
             off_t offset) noexcept {
  return mmap(address, length, protection, flags, fd, offset);
}

int poll(pollfd* waits, nfds_t n, int timeout_ms) {
  const auto answer = n == 1 ? shim::poll_device(waits, timeout_ms) : std::nullopt;
  return answer ? *answer : shim::real<shim::Poll>("poll")(waits, n, timeout_ms);
}

}  // extern "C"
