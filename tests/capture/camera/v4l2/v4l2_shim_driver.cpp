// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>

#include <poll.h>
#include <sys/mman.h>
#include <unistd.h>

#include "tests/capture/camera/v4l2/v4l2_shim_world.h"

namespace haarlight::shim {

namespace {

std::size_t page_up(std::size_t n) { return (n + 4095) / 4096 * 4096; }

std::uint32_t fourcc_of(const std::string& letters) {
  std::uint32_t code = 0;
  for (std::size_t i = 0; i < 4; ++i) {
    code |= std::uint32_t{static_cast<unsigned char>(letters[i])} << (8 * i);
  }
  return letters.size() > 4 ? code | 1U << 31U : code;
}

template <std::size_t N>
void write_text(__u8 (&field)[N], const std::string& text) {
  std::memset(field, 0, N);
  std::memcpy(field, text.data(), std::min(text.size(), N - 1));
}

std::int64_t ready_ns(const Handle& handle, std::uint64_t n) {
  const Camera& camera = handle.device->camera;
  return handle.t0_ns + static_cast<std::int64_t>(n) * camera.period_ns + camera.exposure_ns +
         camera.read_ns;
}

/// What the sensor did until now: frames into queued buffers, or lost.
void advance(Handle& handle) {
  Device& device = *handle.device;
  if (!handle.is_streaming || handle.is_broken || device.is_silent || device.is_gone) {
    return;
  }
  const std::int64_t now = now_ns();
  const auto expose = [&](std::int64_t ready) {
    if (!handle.queued.empty()) {
      handle.filled.push_back({handle.queued.front(), handle.n_next, ready});
      handle.queued.pop_front();
    }
    ++handle.n_next;
  };
  if (is_triggered(device)) {
    for (; !handle.fired.empty() && handle.fired.front() <= now; handle.fired.pop_front()) {
      expose(handle.fired.front());
    }
    return;
  }
  if (device.camera.period_ns == 0) {
    if (handle.filled.empty() && !handle.queued.empty()) {
      expose(0);
    }
    return;
  }
  while (ready_ns(handle, handle.n_next) <= now) {
    expose(ready_ns(handle, handle.n_next));
  }
}

Filling fill(Handle& handle, const Filled& filled, std::byte* memory) {
  const Device& device = *handle.device;
  const Camera& camera = device.camera;
  const std::int64_t end = filled.ready_ns > 0 ? filled.ready_ns : now_ns();
  Filling job{.bytes = {memory, device.size},
              .width = device.width,
              .height = device.height,
              .stride = device.stride,
              .n = filled.n,
              .start_ns = end - camera.read_ns - camera.exposure_ns,
              .end_ns = end - camera.read_ns,
              .sequence = camera.first_sequence + static_cast<std::uint32_t>(filled.n),
              .timestamp_ns = end,
              .flags = V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC | V4L2_BUF_FLAG_TSTAMP_SRC_EOF,
              .bytes_used = device.size};
  if (camera.fill) {
    camera.fill(job);
  } else {
    for (std::size_t i = 0; i < job.bytes.size(); ++i) {
      job.bytes[i] = static_cast<std::byte>(i * 7 + job.n * 13);
    }
  }
  return job;
}

}  // namespace

std::int64_t now_ns() {
  timespec t{};
  ::clock_gettime(CLOCK_MONOTONIC, &t);
  return std::int64_t{t.tv_sec} * 1'000'000'000 + t.tv_nsec;
}

void wake(const Handle& handle) {
  const std::uint64_t one = 1;
  (void)!::write(handle.wake, &one, sizeof one);
}

bool is_triggered(Device& device) {
  const Control* mode = control_of(device, device.camera.trigger_mode);
  return mode != nullptr && mode->value != 0;
}

short poll_bits(Handle& handle) {
  if (handle.device->is_gone) {
    return POLLERR | POLLHUP | POLLPRI;
  }
  advance(handle);
  short bits = handle.events.empty() ? 0 : POLLPRI;
  if (!handle.is_streaming || handle.is_broken) {
    return static_cast<short>(bits | POLLERR);
  }
  return static_cast<short>(bits | (handle.filled.empty() ? 0 : POLLIN));
}

std::int64_t next_frame_ns(const Handle& handle) {
  if (is_triggered(*handle.device)) {
    return handle.fired.empty() ? INT64_MAX : handle.fired.front();
  }
  return ready_ns(handle, handle.n_next);
}

Control* control_of(Device& device, std::uint32_t id) {
  for (Control& control : device.camera.controls) {
    if (control.id == id) {
      return &control;
    }
  }
  return nullptr;
}

namespace {

/// An exposure by trigger; EBUSY while one is under way.
int fire(World& w, Device& device) {
  for (auto& [fd, handle] : w.handles) {
    if (handle.device.get() != &device || !handle.is_streaming || !is_triggered(device)) {
      continue;
    }
    const std::int64_t now = now_ns();
    if (!handle.fired.empty() && now < handle.fired.back()) {
      return EBUSY;
    }
    const Camera& camera = device.camera;
    handle.fired.push_back(now + camera.trigger_delay_ns + camera.exposure_ns + camera.read_ns);
    ++device.n_fired;
    wake(handle);
  }
  return 0;
}

}  // namespace

int set_control(World& w, int fd, Device& device, std::uint32_t id, std::int64_t value) {
  Control* control = control_of(device, id);
  if (control == nullptr) {
    return EINVAL;
  }
  if ((control->flags & V4L2_CTRL_FLAG_READ_ONLY) != 0) {
    return EACCES;
  }
  if (id == device.camera.trigger_button) {
    return fire(w, device);
  }
  if (value < control->min || value > control->max) {
    return ERANGE;
  }
  device.set_ids.push_back(id);
  if (control->keeps) {
    control->value = value;
  }
  for (auto& [other, handle] : w.handles) {  // told to everyone but the one who did it
    if (other != fd && handle.device.get() == &device &&
        std::count(handle.watched.begin(), handle.watched.end(), id) > 0) {
      v4l2_event event{};
      event.type = V4L2_EVENT_CTRL;
      event.id = id;
      event.u.ctrl.type = control->type;
      event.u.ctrl.changes = V4L2_EVENT_CTRL_CH_VALUE;
      event.u.ctrl.value64 = control->value;
      handle.events.push_back(event);
      wake(handle);
    }
  }
  return 0;
}

namespace {

// ---- the ioctls ----

const Offer* offer_of(const Device& device, std::uint32_t fourcc) {
  for (const Offer& offer : device.camera.offers) {
    if (fourcc_of(offer.fourcc) == fourcc) {
      return &offer;
    }
  }
  return nullptr;
}

int query_capability(const Device& device, v4l2_capability& c) {
  write_text(c.driver, "shim");
  write_text(c.card, device.camera.card);
  write_text(c.bus_info, device.camera.bus_info);
  const std::uint32_t kind = !device.camera.is_capture      ? V4L2_CAP_META_CAPTURE
                             : device.camera.is_multiplanar ? V4L2_CAP_VIDEO_CAPTURE_MPLANE
                                                            : V4L2_CAP_VIDEO_CAPTURE;
  c.device_caps = kind | V4L2_CAP_STREAMING;
  // As a driver with several nodes: together they can more than each.
  c.capabilities = c.device_caps | V4L2_CAP_DEVICE_CAPS | V4L2_CAP_META_CAPTURE;
  return 0;
}

int list_format(const Device& device, v4l2_fmtdesc& f) {
  if (f.index >= device.camera.offers.size()) {
    return EINVAL;
  }
  f.pixelformat = fourcc_of(device.camera.offers[f.index].fourcc);
  write_text(f.description, device.camera.offers[f.index].fourcc);
  return 0;
}

int list_size(const Device& device, v4l2_frmsizeenum& f) {
  const Offer* offer = offer_of(device, f.pixel_format);
  if (offer == nullptr || f.index >= offer->sizes.size()) {
    return EINVAL;
  }
  f.type = V4L2_FRMSIZE_TYPE_DISCRETE;
  f.discrete.width = static_cast<std::uint32_t>(offer->sizes[f.index].first);
  f.discrete.height = static_cast<std::uint32_t>(offer->sizes[f.index].second);
  return 0;
}

int list_interval(const Device& device, v4l2_frmivalenum& f) {
  const Offer* offer = offer_of(device, f.pixel_format);
  if (offer == nullptr || f.index >= offer->fps.size()) {
    return EINVAL;
  }
  f.type = V4L2_FRMIVAL_TYPE_DISCRETE;
  f.discrete.numerator = 1;
  f.discrete.denominator = static_cast<std::uint32_t>(offer->fps[f.index]);
  return 0;
}

bool is_compound(const Control& control) {
  return (control.flags & V4L2_CTRL_FLAG_HAS_PAYLOAD) != 0;
}

bool is_wide(const Control& control) { return control.type == V4L2_CTRL_TYPE_INTEGER64; }

/// The next one, as the flags of `requested` say.
const Control* next_control(const Device& device, std::uint32_t requested) {
  const bool with_compound = (requested & V4L2_CTRL_FLAG_NEXT_COMPOUND) != 0;
  const std::uint32_t id = requested & V4L2_CTRL_ID_MASK;
  const Control* found = nullptr;
  for (const Control& control : device.camera.controls) {
    if (control.id > id && (with_compound || !is_compound(control)) &&
        (found == nullptr || control.id < found->id)) {
      found = &control;
    }
  }
  return found;
}

int query_control(const Device& device, v4l2_queryctrl& q) {
  const Control* found = next_control(device, q.id);
  if (found == nullptr) {
    return EINVAL;
  }
  const auto range = [&](std::int64_t value) {
    return is_wide(*found) ? 0 : static_cast<std::int32_t>(value);  // as the kernel says it
  };
  q.id = found->id;
  q.type = found->type;
  write_text(q.name, found->name);
  q.minimum = range(found->min);
  q.maximum = range(found->max);
  q.step = range(found->step);
  q.default_value = range(found->min);
  q.flags = found->flags;
  return 0;
}

int query_ext_control(const Device& device, v4l2_query_ext_ctrl& q) {
  const Control* found = next_control(device, q.id);
  if (found == nullptr) {
    return EINVAL;
  }
  q.id = found->id;
  q.type = found->type;
  std::memset(q.name, 0, sizeof q.name);
  std::memcpy(q.name, found->name.data(), std::min(found->name.size(), sizeof q.name - 1));
  q.minimum = found->min;
  q.maximum = found->max;
  q.step = static_cast<std::uint64_t>(found->step);
  q.default_value = found->min;
  q.flags = found->flags;
  q.nr_of_dims = is_compound(*found) ? 1 : 0;
  return 0;
}

/// `value` of a control that has a single one.
int get_control(Device& device, std::uint32_t id, std::int64_t& value) {
  const Control* control = control_of(device, id);
  if (control == nullptr || is_compound(*control)) {
    return EINVAL;
  }
  value = control->value;
  return (control->flags & V4L2_CTRL_FLAG_WRITE_ONLY) != 0 ? EACCES : 0;
}

int ext_controls(World& w, int fd, Device& device, v4l2_ext_controls& list, bool is_set) {
  for (std::uint32_t i = 0; i < list.count; ++i) {
    v4l2_ext_control& each = list.controls[i];
    const std::uint32_t id = each.id;
    const Control* control = control_of(device, id);
    list.error_idx = i;
    if (control == nullptr || is_compound(*control)) {
      return EINVAL;
    }
    std::int64_t value = 0;
    if (is_set) {
      value = is_wide(*control) ? std::int64_t{each.value64} : std::int64_t{each.value};
    }
    const int error =
        is_set ? set_control(w, fd, device, id, value) : get_control(device, id, value);
    if (error != 0) {
      return error;
    }
    if (is_wide(*control)) {
      each.value64 = value;
    } else {
      each.value = static_cast<std::int32_t>(value);  // and leaves the other half alone
    }
  }
  return 0;
}

v4l2_rect rect_of(const Region& r) {
  return {r.left, r.top, static_cast<std::uint32_t>(r.width),
          static_cast<std::uint32_t>(r.height)};
}

int selection(Device& device, v4l2_selection& s, bool is_set) {
  const auto& sensor = device.camera.sensor;
  if (!sensor) {
    return ENOTTY;
  }
  if (is_set) {
    if (s.target != V4L2_SEL_TGT_CROP) {
      return EINVAL;
    }
    if (device.owner >= 0) {
      return EBUSY;
    }
    const int step = device.camera.region_step;
    device.region = {s.r.left / step * step, s.r.top / step * step, static_cast<int>(s.r.width),
                     static_cast<int>(s.r.height)};
  }
  s.r = rect_of(s.target == V4L2_SEL_TGT_CROP ? device.region : *sensor);
  return 0;
}

int query_menu(Device& device, v4l2_querymenu& m) {
  const Control* control = control_of(device, m.id);
  if (control == nullptr || m.index >= control->entries.size() ||
      control->entries[m.index].empty()) {
    return EINVAL;
  }
  (void)std::snprintf(reinterpret_cast<char*>(m.name), sizeof m.name, "%s",
                      control->entries[m.index].c_str());
  return 0;
}

int get_format(const Device& device, v4l2_format& format) {
  if (device.camera.is_multiplanar) {
    v4l2_pix_format_mplane& pix = format.fmt.pix_mp;
    pix.pixelformat = device.fourcc;
    pix.width = static_cast<std::uint32_t>(device.width);
    pix.height = static_cast<std::uint32_t>(device.height);
    pix.field = V4L2_FIELD_NONE;
    pix.num_planes = 1;
    pix.plane_fmt[0].bytesperline = static_cast<std::uint32_t>(device.stride);
    pix.plane_fmt[0].sizeimage = static_cast<std::uint32_t>(device.size);
    return 0;
  }
  v4l2_pix_format& pix = format.fmt.pix;
  pix.pixelformat = device.fourcc;
  pix.width = static_cast<std::uint32_t>(device.width);
  pix.height = static_cast<std::uint32_t>(device.height);
  pix.field = V4L2_FIELD_NONE;
  pix.bytesperline = static_cast<std::uint32_t>(device.stride);
  pix.sizeimage = static_cast<std::uint32_t>(device.size);
  return 0;
}

int set_format(Handle& handle, v4l2_format& format) {
  Device& device = *handle.device;
  if (device.owner >= 0) {
    return EBUSY;
  }
  const Camera& camera = device.camera;
  const bool is_mp = camera.is_multiplanar;
  if (format.type !=
      (is_mp ? V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE : V4L2_BUF_TYPE_VIDEO_CAPTURE)) {
    return EINVAL;
  }
  const std::uint32_t requested =
      is_mp ? format.fmt.pix_mp.pixelformat : format.fmt.pix.pixelformat;
  const Offer* offer = offer_of(device, requested);
  offer = offer == nullptr ? &camera.offers.front() : offer;  // as drivers do: something else
  const auto width = static_cast<int>(is_mp ? format.fmt.pix_mp.width : format.fmt.pix.width);
  const auto height =
      static_cast<int>(is_mp ? format.fmt.pix_mp.height : format.fmt.pix.height);
  std::pair<int, int> size = offer->sizes.front();
  for (const auto& each : offer->sizes) {
    if (!camera.sets_other_size && each.first == width && each.second == height) {
      size = each;
    }
  }
  if (camera.format_forgets_region) {
    device.region = {0, 0, width, height};
  }
  if (camera.sensor) {
    size = {device.region.width, device.region.height};
  }
  device.fourcc = fourcc_of(offer->fourcc);
  device.width = size.first;
  device.height = size.second;
  const std::size_t row =
      (static_cast<std::size_t>(size.first) * static_cast<std::size_t>(camera.bits_per_sample) +
       7) /
      8;
  const std::size_t stale = is_mp ? 0 : format.fmt.pix.bytesperline;
  device.stride = std::max(row, stale) + camera.row_padding;
  device.size = device.stride * static_cast<std::size_t>(size.second);
  return get_format(device, format);
}

int parameters(Device& device, v4l2_streamparm& p, bool is_set) {
  const Offer* offer = offer_of(device, device.fourcc);
  if (offer == nullptr || offer->fps.empty()) {
    return EINVAL;
  }
  v4l2_captureparm& capture = p.parm.capture;
  if (is_set && capture.timeperframe.numerator > 0) {
    const int requested =
        static_cast<int>(capture.timeperframe.denominator / capture.timeperframe.numerator);
    device.fps =
        *std::min_element(offer->fps.begin(), offer->fps.end(), [requested](int a, int b) {
          return std::abs(a - requested) < std::abs(b - requested);
        });
  }
  device.fps = device.fps == 0 ? offer->fps.front() : device.fps;
  capture.capability = V4L2_CAP_TIMEPERFRAME;
  capture.timeperframe = {1, static_cast<std::uint32_t>(device.fps)};
  return 0;
}

int request_buffers(int fd, Handle& handle, v4l2_requestbuffers& r) {
  Device& device = *handle.device;
  if (device.owner >= 0 && device.owner != fd) {
    return EBUSY;
  }
  if (handle.is_streaming || device.size == 0) {
    return EINVAL;
  }
  handle.queued.clear();
  handle.filled.clear();
  if (r.count == 0) {
    device.owner = -1;
    handle.n_buffers = 0;
    return 0;
  }
  r.count = std::clamp(r.count, device.camera.least_buffers, device.camera.most_buffers);
  handle.n_buffers = r.count;
  handle.buffer_size = page_up(device.size);
  device.owner = fd;
  if (::ftruncate(handle.memory, static_cast<off_t>(handle.buffer_size * r.count)) != 0) {
    return ENOMEM;
  }
  return 0;
}

int query_buffer(const Handle& handle, v4l2_buffer& b) {
  if (b.index >= handle.n_buffers) {
    return EINVAL;
  }
  const auto offset = static_cast<std::uint32_t>(b.index * handle.buffer_size);
  const auto length = static_cast<std::uint32_t>(handle.device->size);
  if (handle.device->camera.is_multiplanar) {
    if (b.length < 1) {
      return EINVAL;
    }
    b.m.planes[0].length = length;
    b.m.planes[0].m.mem_offset = offset;
  } else {
    b.length = length;
    b.m.offset = offset;
  }
  return 0;
}

int queue_buffer(Handle& handle, const v4l2_buffer& b) {
  advance(handle);
  const bool is_out =
      std::count(handle.queued.begin(), handle.queued.end(), b.index) == 0 &&
      std::none_of(handle.filled.begin(), handle.filled.end(),
                   [&](const Filled& filled) { return filled.index == b.index; });
  if (b.index >= handle.n_buffers || !is_out) {
    return EINVAL;
  }
  handle.queued.push_back(b.index);
  return 0;
}

int dequeue_buffer(Handle& handle, v4l2_buffer& b) {
  if (!handle.is_streaming) {
    return EINVAL;
  }
  if (handle.is_broken) {
    return EIO;
  }
  advance(handle);
  if (handle.filled.empty()) {
    return EAGAIN;
  }
  const Filled filled = handle.filled.front();
  handle.filled.pop_front();
  const std::size_t size = handle.buffer_size;
  // By the file and not by a mapping, whose address may have been another file's:
  // ThreadSanitizer, to which this library is a kernel, would take the two for one memory.
  const auto offset = static_cast<off_t>(filled.index * size);
  std::vector<std::byte> memory(size);
  if (::pread(handle.memory, memory.data(), size, offset) != static_cast<ssize_t>(size)) {
    return EIO;
  }
  const Filling job = fill(handle, filled, memory.data());
  if (::pwrite(handle.memory, memory.data(), size, offset) != static_cast<ssize_t>(size)) {
    return EIO;
  }
  b.index = filled.index;
  b.sequence = job.sequence;
  b.flags = job.flags;
  b.timestamp.tv_sec = job.timestamp_ns / 1'000'000'000;
  b.timestamp.tv_usec = job.timestamp_ns % 1'000'000'000 / 1'000;
  if (handle.device->camera.is_multiplanar) {
    b.m.planes[0].bytesused = static_cast<std::uint32_t>(job.bytes_used);
    b.m.planes[0].data_offset = 0;
  } else {
    b.bytesused = static_cast<std::uint32_t>(job.bytes_used);
  }
  return 0;
}

int stream(Handle& handle, bool is_on) {
  if (is_on) {
    if (handle.n_buffers == 0) {
      return EINVAL;
    }
    handle.t0_ns = now_ns();
    handle.n_next = 0;
    handle.fired.clear();
    for (const auto& [id, value] : handle.device->camera.set_at_stream_on) {
      control_of(*handle.device, id)->value = value;
    }
  } else {
    handle.queued.clear();
    handle.filled.clear();
    handle.is_broken = false;
  }
  handle.is_streaming = is_on;
  return 0;
}

int take_event(Handle& handle, v4l2_event& event) {
  if (handle.events.empty()) {
    return ENOENT;
  }
  event = handle.events.front();
  handle.events.pop_front();
  return 0;
}

}  // namespace

int answer(World& w, int fd, Handle& handle, unsigned long request, void* argument) {
  Device& device = *handle.device;
  const auto as = [argument](auto* type) -> auto& {
    return *static_cast<std::remove_pointer_t<decltype(type)>*>(argument);
  };
  switch (request) {
    case VIDIOC_QUERYCAP:
      return query_capability(device, as(static_cast<v4l2_capability*>(nullptr)));
    case VIDIOC_ENUM_FMT:
      return list_format(device, as(static_cast<v4l2_fmtdesc*>(nullptr)));
    case VIDIOC_ENUM_FRAMESIZES:
      return list_size(device, as(static_cast<v4l2_frmsizeenum*>(nullptr)));
    case VIDIOC_ENUM_FRAMEINTERVALS:
      return list_interval(device, as(static_cast<v4l2_frmivalenum*>(nullptr)));
    case VIDIOC_QUERYCTRL:
      return query_control(device, as(static_cast<v4l2_queryctrl*>(nullptr)));
    case VIDIOC_QUERY_EXT_CTRL:
      return !device.camera.has_ext_controls
                 ? ENOTTY
                 : query_ext_control(device, as(static_cast<v4l2_query_ext_ctrl*>(nullptr)));
    case VIDIOC_G_EXT_CTRLS:
    case VIDIOC_S_EXT_CTRLS:
      return !device.camera.has_ext_controls
                 ? ENOTTY
                 : ext_controls(w, fd, device, as(static_cast<v4l2_ext_controls*>(nullptr)),
                                request == VIDIOC_S_EXT_CTRLS);
    case VIDIOC_G_SELECTION:
    case VIDIOC_S_SELECTION:
      return selection(device, as(static_cast<v4l2_selection*>(nullptr)),
                       request == VIDIOC_S_SELECTION);
    case VIDIOC_QUERYMENU:
      return query_menu(device, as(static_cast<v4l2_querymenu*>(nullptr)));
    case VIDIOC_G_CTRL: {
      auto& c = as(static_cast<v4l2_control*>(nullptr));
      std::int64_t value = 0;
      const int error = get_control(device, c.id, value);
      c.value = static_cast<std::int32_t>(value);
      return error != 0 || !is_wide(*control_of(device, c.id)) ? error : EINVAL;
    }
    case VIDIOC_S_CTRL: {
      const auto& c = as(static_cast<v4l2_control*>(nullptr));
      const Control* control = control_of(device, c.id);
      return control != nullptr && is_wide(*control)
                 ? EINVAL
                 : set_control(w, fd, device, c.id, c.value);
    }
    case VIDIOC_S_FMT:
      return set_format(handle, as(static_cast<v4l2_format*>(nullptr)));
    case VIDIOC_G_FMT:
      return get_format(device, as(static_cast<v4l2_format*>(nullptr)));
    case VIDIOC_G_PARM:
    case VIDIOC_S_PARM:
      return parameters(device, as(static_cast<v4l2_streamparm*>(nullptr)),
                        request == VIDIOC_S_PARM);
    case VIDIOC_REQBUFS:
      return request_buffers(fd, handle, as(static_cast<v4l2_requestbuffers*>(nullptr)));
    case VIDIOC_QUERYBUF:
      return query_buffer(handle, as(static_cast<v4l2_buffer*>(nullptr)));
    case VIDIOC_QBUF:
      return queue_buffer(handle, as(static_cast<v4l2_buffer*>(nullptr)));
    case VIDIOC_DQBUF:
      return dequeue_buffer(handle, as(static_cast<v4l2_buffer*>(nullptr)));
    case VIDIOC_STREAMON:
    case VIDIOC_STREAMOFF:
      return stream(handle, request == VIDIOC_STREAMON);
    case VIDIOC_SUBSCRIBE_EVENT:
      if (!device.camera.has_events) {
        return ENOTTY;
      }
      handle.watched.push_back(as(static_cast<v4l2_event_subscription*>(nullptr)).id);
      return 0;
    case VIDIOC_DQEVENT:
      return take_event(handle, as(static_cast<v4l2_event*>(nullptr)));
    default:
      return ENOTTY;
  }
}

}  // namespace haarlight::shim
