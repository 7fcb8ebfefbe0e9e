// SPDX-License-Identifier: Apache-2.0
#include "capture/camera/v4l2_device.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <fstream>
#include <limits>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <linux/videodev2.h>
#include <poll.h>
#include <sys/ioctl.h>
#include <sys/mman.h>

namespace haarlight::capture {

namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;

static_assert(control_id::kAutoWhiteBalance == V4L2_CID_AUTO_WHITE_BALANCE);
static_assert(control_id::kExposure == V4L2_CID_EXPOSURE);
static_assert(control_id::kAutoGain == V4L2_CID_AUTOGAIN);
static_assert(control_id::kGain == V4L2_CID_GAIN);
static_assert(control_id::kPowerLineFrequency == V4L2_CID_POWER_LINE_FREQUENCY);
static_assert(control_id::kExposureAuto == V4L2_CID_EXPOSURE_AUTO);
static_assert(control_id::kExposureAbsolute == V4L2_CID_EXPOSURE_ABSOLUTE);
static_assert(control_id::kExposurePriority == V4L2_CID_EXPOSURE_AUTO_PRIORITY);
static_assert(control_id::kFocusAuto == V4L2_CID_FOCUS_AUTO);
static_assert(control_id::kAnalogueGain == V4L2_CID_ANALOGUE_GAIN);

// A longer list comes from a broken driver: no device has this many.
constexpr std::uint32_t kMaxListed = 256;
constexpr std::uint32_t kMaxControls = 1024;
constexpr int kMaxPollMs = 60'000;
constexpr std::uint32_t kBigEndian = 1U << 31U;

/// A kernel's struct, all zero.
template <class T>
T zeroed() {
  T value;
  std::memset(&value, 0, sizeof value);
  return value;
}

std::uint32_t fourcc_of(const std::string& letters) {
  std::array<char, 4> four{' ', ' ', ' ', ' '};
  std::copy_n(letters.begin(), std::min<std::size_t>(letters.size(), 4), four.begin());
  const auto byte = [&](std::size_t i) {
    return static_cast<std::uint32_t>(static_cast<unsigned char>(four[i])) << (8U * i);
  };
  const std::uint32_t code = byte(0) | byte(1) | byte(2) | byte(3);
  return letters.size() > 4 && letters.substr(4) == "-BE" ? code | kBigEndian : code;
}

std::string letters_of(std::uint32_t fourcc) {
  std::string letters;
  for (unsigned i = 0; i < 4; ++i) {
    letters += static_cast<char>(fourcc >> (8U * i) & 0x7FU);
  }
  return (fourcc & kBigEndian) != 0 ? letters + "-BE" : letters;
}

template <std::size_t N>
std::string text_of(const __u8 (&field)[N]) {
  const auto* begin = reinterpret_cast<const char*>(field);
  return {begin, ::strnlen(begin, N)};
}

double fps_of(const v4l2_fract& interval) {
  return interval.numerator == 0 || interval.denominator == 0
             ? 0.0
             : static_cast<double>(interval.denominator) / interval.numerator;
}

std::string first_line(const fs::path& file) {
  std::ifstream in(file);
  std::string line;
  std::getline(in, line);
  return line;
}

/// What sysfs knows in addition to the driver: serial number and index.
void complete_identity(V4l2Identity& identity, const fs::path& node, const V4l2Paths& paths) {
  std::error_code ec;
  const fs::path real = fs::canonical(node, ec);
  if (ec) {
    return;
  }
  const fs::path folder = paths.sysfs / "class/video4linux" / real.filename();
  const std::string index = first_line(folder / "index");
  if (!index.empty() && std::all_of(index.begin(), index.end(),
                                    [](unsigned char c) { return std::isdigit(c) != 0; })) {
    identity.index = std::atoi(index.c_str());
  }
  // The node's parent is a USB interface, whose parent is the USB device. A device without a
  // serial number must not be given its hub's.
  fs::path up = fs::canonical(folder / "device", ec);
  for (int depth = 0; !ec && depth < 8 && up.has_relative_path(); ++depth) {
    if (fs::exists(up / "idVendor", ec)) {
      identity.serial = first_line(up / "serial");
      return;
    }
    up = up.parent_path();
  }
}

V4l2ControlKind kind_of(std::uint32_t type) {
  switch (type) {
    case V4L2_CTRL_TYPE_INTEGER:
    case V4L2_CTRL_TYPE_INTEGER64:
    case V4L2_CTRL_TYPE_BITMASK:
      return V4l2ControlKind::integer;
    case V4L2_CTRL_TYPE_BOOLEAN:
      return V4l2ControlKind::boolean;
    case V4L2_CTRL_TYPE_MENU:
    case V4L2_CTRL_TYPE_INTEGER_MENU:
      return V4l2ControlKind::menu;
    case V4L2_CTRL_TYPE_BUTTON:
      return V4l2ControlKind::button;
    default:
      return V4l2ControlKind::other;
  }
}

}  // namespace

Errc errc_of_v4l2(int error) noexcept {
  switch (error) {
    case ENODEV:
    case ENXIO:
    case ENOENT:
    case ESHUTDOWN:
      return Errc::device_gone;
    case EBUSY:
      return Errc::device_busy;
    case EAGAIN:
    case ETIMEDOUT:
      return Errc::timeout;
    case EACCES:
    case EPERM:
      return Errc::refused;
    case EINVAL:
    case ENOTTY:
    case ERANGE:
      return Errc::unsupported;
    default:
      return Errc::io;
  }
}

std::string control_key(std::string_view driver_name) {
  std::string key;
  for (const char c : driver_name) {
    const auto letter = static_cast<unsigned char>(c);
    if (std::isalnum(letter) != 0) {
      key += static_cast<char>(std::tolower(letter));
    } else if (!key.empty() && key.back() != '_') {
      key += '_';
    }
  }
  while (!key.empty() && key.back() == '_') {
    key.pop_back();
  }
  return key;
}

bool V4l2Size::holds(int w, int h) const {
  if (max_width <= width && max_height <= height) {
    return w == width && h == height;
  }
  return w >= width && w <= max_width && h >= height && h <= max_height &&
         (w - width) % std::max(1, step_width) == 0 &&
         (h - height) % std::max(1, step_height) == 0;
}

// ---- opening ----

Result<V4l2Device> V4l2Device::open(const fs::path& node, const V4l2Paths& paths) {
  Fd fd;
  do {
    fd.reset(::open(node.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC));
  } while (!fd.is_open() && errno == EINTR);
  if (!fd.is_open()) {
    const int error = errno;
    return fail(errc_of_v4l2(error),
                fmt::format("open {}: {}{}", node.string(), std::strerror(error),
                            error == EACCES ? " (add this user to the group \"video\")" : ""),
                error);
  }
  V4l2Device device(std::move(fd), node.string());
  auto capability = zeroed<v4l2_capability>();
  if (auto answer = device.call(VIDIOC_QUERYCAP, &capability, "VIDIOC_QUERYCAP"); !answer) {
    return tl::unexpected<Fault>(answer.error());
  }
  const std::uint32_t caps = (capability.capabilities & V4L2_CAP_DEVICE_CAPS) != 0
                                 ? capability.device_caps
                                 : capability.capabilities;
  device.is_multiplanar_ = (caps & V4L2_CAP_VIDEO_CAPTURE) == 0;
  if ((caps & (V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_VIDEO_CAPTURE_MPLANE)) == 0 ||
      (caps & V4L2_CAP_STREAMING) == 0) {
    return fail(Errc::unsupported,
                fmt::format("{} ({}): no node that streams pictures; a camera has several "
                            "nodes, take another one",
                            node.string(), text_of(capability.card)));
  }
  device.identity_ = {.card = text_of(capability.card),
                      .driver = text_of(capability.driver),
                      .bus_info = text_of(capability.bus_info),
                      .serial = {},
                      .index = 0};
  complete_identity(device.identity_, node, paths);
  return device;
}

V4l2Device::V4l2Device(V4l2Device&& other) noexcept
    : fd_(std::move(other.fd_)),
      node_(std::move(other.node_)),
      identity_(std::move(other.identity_)),
      is_multiplanar_(other.is_multiplanar_),
      n_planes_(other.n_planes_),
      mappings_(std::exchange(other.mappings_, {})) {}

V4l2Device& V4l2Device::operator=(V4l2Device&& other) noexcept {
  if (this != &other) {
    unmap();
    fd_ = std::move(other.fd_);
    node_ = std::move(other.node_);
    identity_ = std::move(other.identity_);
    is_multiplanar_ = other.is_multiplanar_;
    n_planes_ = other.n_planes_;
    mappings_ = std::exchange(other.mappings_, {});
  }
  return *this;
}

V4l2Device::~V4l2Device() { unmap(); }

void V4l2Device::unmap() noexcept {
  for (const Mapping& mapping : mappings_) {
    ::munmap(mapping.data, mapping.size);
  }
  mappings_.clear();
}

Result<void> V4l2Device::call(unsigned long request, void* argument, const char* name) const {
  int error = 0;
  do {
    error = ::ioctl(fd_.get(), request, argument) == 0 ? 0 : errno;
  } while (error == EINTR);
  if (error != 0) {
    return fail(errc_of_v4l2(error),
                fmt::format("{} {}: {}", name, node_, std::strerror(error)), error);
  }
  return {};
}

Result<void> V4l2Device::check_presence() const {
  auto capability = zeroed<v4l2_capability>();
  return call(VIDIOC_QUERYCAP, &capability, "VIDIOC_QUERYCAP");
}

// ---- what it offers ----

Result<V4l2Size> V4l2Device::describe_size(V4l2Size size, std::uint32_t fourcc) const {
  for (std::uint32_t i = 0; i < kMaxListed; ++i) {
    auto interval = zeroed<v4l2_frmivalenum>();
    interval.index = i;
    interval.pixel_format = fourcc;
    interval.width = static_cast<std::uint32_t>(size.width);
    interval.height = static_cast<std::uint32_t>(size.height);
    const auto answer =
        call(VIDIOC_ENUM_FRAMEINTERVALS, &interval, "VIDIOC_ENUM_FRAMEINTERVALS");
    if (!answer && answer.error().code != Errc::unsupported) {
      return tl::unexpected<Fault>(answer.error());
    }
    if (!answer) {
      break;
    }
    if (interval.type == V4L2_FRMIVAL_TYPE_DISCRETE) {
      size.fps.push_back(fps_of(interval.discrete));
      continue;
    }
    size.is_fps_range = true;
    size.fps = {fps_of(interval.stepwise.max), fps_of(interval.stepwise.min)};
    break;
  }
  return size;
}

Result<std::vector<V4l2Format>> V4l2Device::formats() const {
  std::vector<V4l2Format> formats;
  for (std::uint32_t i = 0; i < kMaxListed; ++i) {
    auto format = zeroed<v4l2_fmtdesc>();
    format.index = i;
    format.type =
        is_multiplanar_ ? V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE : V4L2_BUF_TYPE_VIDEO_CAPTURE;
    const auto listed = call(VIDIOC_ENUM_FMT, &format, "VIDIOC_ENUM_FMT");
    if (!listed && listed.error().code != Errc::unsupported) {
      return tl::unexpected<Fault>(listed.error());
    }
    if (!listed) {
      break;
    }
    V4l2Format offered{letters_of(format.pixelformat), text_of(format.description), {}};
    for (std::uint32_t j = 0; j < kMaxListed; ++j) {
      auto frame = zeroed<v4l2_frmsizeenum>();
      frame.index = j;
      frame.pixel_format = format.pixelformat;
      const auto answer = call(VIDIOC_ENUM_FRAMESIZES, &frame, "VIDIOC_ENUM_FRAMESIZES");
      if (!answer && answer.error().code != Errc::unsupported) {
        return tl::unexpected<Fault>(answer.error());
      }
      if (!answer) {
        break;
      }
      const auto number = [](std::uint32_t n) {
        return static_cast<int>(std::min(n, 1U << 20U));
      };
      V4l2Size size;
      const bool is_discrete = frame.type == V4L2_FRMSIZE_TYPE_DISCRETE;
      if (is_discrete) {
        size.width = size.max_width = number(frame.discrete.width);
        size.height = size.max_height = number(frame.discrete.height);
      } else {
        size.width = number(frame.stepwise.min_width);
        size.height = number(frame.stepwise.min_height);
        size.max_width = number(frame.stepwise.max_width);
        size.max_height = number(frame.stepwise.max_height);
        size.step_width = number(frame.stepwise.step_width);
        size.step_height = number(frame.stepwise.step_height);
      }
      auto described = describe_size(size, format.pixelformat);
      if (!described) {
        return tl::unexpected<Fault>(described.error());
      }
      offered.sizes.push_back(*std::move(described));
      if (!is_discrete) {
        break;
      }
    }
    formats.push_back(std::move(offered));
  }
  return formats;
}

Result<std::vector<V4l2MenuEntry>> V4l2Device::menu_of(const V4l2Control& control,
                                                       bool has_names) const {
  std::vector<V4l2MenuEntry> entries;
  const std::int64_t first = std::clamp<std::int64_t>(control.min, 0, INT32_MAX);
  const std::int64_t last = std::min<std::int64_t>(control.max, first + kMaxListed);
  for (std::int64_t i = first; i <= last; ++i) {
    auto menu = zeroed<v4l2_querymenu>();
    menu.id = control.id;
    menu.index = static_cast<std::uint32_t>(i);
    const auto answer = call(VIDIOC_QUERYMENU, &menu, "VIDIOC_QUERYMENU");
    if (answer) {
      const std::int64_t value = menu.value;  // the struct is packed
      entries.push_back({i, has_names ? text_of(menu.name) : std::to_string(value)});
    } else if (answer.error().code != Errc::unsupported) {  // entries may be missing
      return tl::unexpected<Fault>(answer.error());
    }
  }
  return entries;
}

Result<std::optional<V4l2Control>> V4l2Device::next_control(std::uint32_t id) const {
  auto query = zeroed<v4l2_query_ext_ctrl>();
  query.id = id | V4L2_CTRL_FLAG_NEXT_CTRL | V4L2_CTRL_FLAG_NEXT_COMPOUND;
  auto listed = call(VIDIOC_QUERY_EXT_CTRL, &query, "VIDIOC_QUERY_EXT_CTRL");
  if (!listed && listed.error().sys_errno == ENOTTY) {
    auto old = zeroed<v4l2_queryctrl>();
    old.id = id | V4L2_CTRL_FLAG_NEXT_CTRL;
    listed = call(VIDIOC_QUERYCTRL, &old, "VIDIOC_QUERYCTRL");
    query.id = old.id;
    query.type = old.type;
    std::memcpy(query.name, old.name, sizeof query.name);
    query.minimum = old.minimum;
    query.maximum = old.maximum;
    query.step = static_cast<std::uint64_t>(std::max(1, old.step));
    query.default_value = old.default_value;
    query.flags = old.flags;
  }
  if (!listed && listed.error().code != Errc::unsupported) {
    return tl::unexpected<Fault>(listed.error());
  }
  if (!listed || query.id <= id) {
    return std::optional<V4l2Control>();
  }
  const auto has = [&](std::uint32_t flag) { return (query.flags & flag) != 0; };
  V4l2Control control;
  control.id = query.id;
  control.name = control_key({query.name, ::strnlen(query.name, sizeof query.name)});
  // Headings of the list and what the driver disabled are not controls; compound controls are
  // listed only.
  const bool is_array = has(V4L2_CTRL_FLAG_HAS_PAYLOAD) || query.nr_of_dims > 0;
  control.kind = is_array ? V4l2ControlKind::other : kind_of(query.type);
  control.is_inactive = has(V4L2_CTRL_FLAG_INACTIVE);
  control.is_wide = query.type == V4L2_CTRL_TYPE_INTEGER64;
  if (has(V4L2_CTRL_FLAG_DISABLED) || query.type == V4L2_CTRL_TYPE_CTRL_CLASS) {
    control.name.clear();
    return std::optional(control);
  }
  const bool is_button = control.kind == V4l2ControlKind::button;
  // Nothing is set that cannot be read back; a button has nothing to read.
  control.is_settable = control.kind != V4l2ControlKind::other &&
                        !has(V4L2_CTRL_FLAG_READ_ONLY) &&
                        (is_button || !has(V4L2_CTRL_FLAG_WRITE_ONLY));
  if (is_button || control.kind == V4l2ControlKind::other) {
    return std::optional(control);
  }
  control.min = query.minimum;
  control.max = query.maximum;
  control.step = static_cast<std::int64_t>(
      std::clamp<std::uint64_t>(query.step, 1, std::numeric_limits<std::int64_t>::max()));
  control.default_value = query.default_value;
  if (control.kind == V4l2ControlKind::menu) {
    auto entries = menu_of(control, query.type == V4L2_CTRL_TYPE_MENU);
    if (!entries) {
      return tl::unexpected<Fault>(entries.error());
    }
    control.entries = *std::move(entries);
  }
  if (has(V4L2_CTRL_FLAG_WRITE_ONLY)) {
    return std::optional(control);
  }
  if (const auto value = this->control(control)) {
    control.value = *value;
  } else if (value.error().code == Errc::device_gone) {
    return tl::unexpected<Fault>(value.error());
  }
  return std::optional(control);
}

Result<std::vector<V4l2Control>> V4l2Device::controls() const {
  std::vector<V4l2Control> controls;
  std::uint32_t id = 0;
  for (std::uint32_t i = 0; i < kMaxControls; ++i) {
    auto control = next_control(id);
    if (!control) {
      return tl::unexpected<Fault>(control.error());
    }
    if (!*control) {
      break;
    }
    id = (*control)->id;
    if (!(*control)->name.empty()) {
      controls.push_back(**std::move(control));
    }
  }
  return controls;
}

// ---- setting ----

namespace {

V4l2StreamFormat stream_format(const v4l2_format& format) {
  if (format.type == V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE) {
    const v4l2_pix_format_mplane& pix = format.fmt.pix_mp;
    return {letters_of(pix.pixelformat),  static_cast<int>(pix.width),
            static_cast<int>(pix.height), pix.plane_fmt[0].bytesperline,
            pix.plane_fmt[0].sizeimage,   pix.field == V4L2_FIELD_NONE};
  }
  const v4l2_pix_format& pix = format.fmt.pix;
  return {letters_of(pix.pixelformat),
          static_cast<int>(pix.width),
          static_cast<int>(pix.height),
          pix.bytesperline,
          pix.sizeimage,
          pix.field == V4L2_FIELD_NONE};
}

}  // namespace

Result<V4l2StreamFormat> V4l2Device::set_format(const std::string& fourcc, int width,
                                                int height) {
  // All zero: some drivers would keep a stale bytesperline of an earlier program.
  auto format = zeroed<v4l2_format>();
  const auto fill = [&](auto& pix) {
    pix.pixelformat = fourcc_of(fourcc);
    pix.width = static_cast<std::uint32_t>(width);
    pix.height = static_cast<std::uint32_t>(height);
    pix.field = V4L2_FIELD_NONE;
  };
  if (is_multiplanar_) {
    format.type = V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE;
    fill(format.fmt.pix_mp);
  } else {
    format.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    fill(format.fmt.pix);
  }
  if (auto answer = call(VIDIOC_S_FMT, &format, "VIDIOC_S_FMT"); !answer) {
    return tl::unexpected<Fault>(answer.error());
  }
  if (is_multiplanar_) {
    n_planes_ = std::clamp<std::uint32_t>(format.fmt.pix_mp.num_planes, 1, VIDEO_MAX_PLANES);
  }
  return stream_format(format);
}

Result<V4l2StreamFormat> V4l2Device::format() const {
  auto format = zeroed<v4l2_format>();
  format.type =
      is_multiplanar_ ? V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE : V4L2_BUF_TYPE_VIDEO_CAPTURE;
  if (auto answer = call(VIDIOC_G_FMT, &format, "VIDIOC_G_FMT"); !answer) {
    return tl::unexpected<Fault>(answer.error());
  }
  return stream_format(format);
}

namespace {

V4l2Rect rect_of(const v4l2_rect& r) {
  const auto size = [](std::uint32_t n) {
    return static_cast<int>(std::min<std::uint32_t>(n, INT32_MAX));
  };
  return {r.left, r.top, size(r.width), size(r.height)};
}

}  // namespace

Result<V4l2Rect> V4l2Device::selection(std::uint32_t target, const char* name) const {
  auto selection = zeroed<v4l2_selection>();
  selection.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;  // with several planes too
  selection.target = target;
  if (auto answer = call(VIDIOC_G_SELECTION, &selection, name); !answer) {
    return tl::unexpected<Fault>(answer.error());
  }
  return rect_of(selection.r);
}

Result<std::optional<V4l2Crop>> V4l2Device::crop() const {
  const auto whole = selection(V4L2_SEL_TGT_CROP_BOUNDS, "VIDIOC_G_SELECTION CROP_BOUNDS");
  const auto usual =
      whole ? selection(V4L2_SEL_TGT_CROP_DEFAULT, "VIDIOC_G_SELECTION CROP_DEFAULT") : whole;
  const auto now = usual ? selection(V4L2_SEL_TGT_CROP, "VIDIOC_G_SELECTION CROP") : usual;
  if (now) {
    return std::optional(V4l2Crop{*now, *usual, *whole});
  }
  // ENODATA: not for this input.
  if (now.error().code == Errc::unsupported || now.error().sys_errno == ENODATA) {
    return std::optional<V4l2Crop>();
  }
  return tl::unexpected<Fault>(now.error());
}

Result<V4l2Rect> V4l2Device::set_crop(const V4l2Rect& region) {
  auto selection = zeroed<v4l2_selection>();
  selection.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  selection.target = V4L2_SEL_TGT_CROP;
  selection.r = {region.left, region.top, static_cast<std::uint32_t>(region.width),
                 static_cast<std::uint32_t>(region.height)};
  if (auto answer = call(VIDIOC_S_SELECTION, &selection, "VIDIOC_S_SELECTION CROP"); !answer) {
    return tl::unexpected<Fault>(answer.error());
  }
  return rect_of(selection.r);
}

Result<double> V4l2Device::set_fps(double fps) {
  auto parameters = zeroed<v4l2_streamparm>();
  parameters.type =
      is_multiplanar_ ? V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE : V4L2_BUF_TYPE_VIDEO_CAPTURE;
  const auto got = call(VIDIOC_G_PARM, &parameters, "VIDIOC_G_PARM");
  if (!got && got.error().code == Errc::unsupported) {
    return 0.0;
  }
  if (!got) {
    return tl::unexpected<Fault>(got.error());
  }
  v4l2_captureparm& capture = parameters.parm.capture;
  if ((capture.capability & V4L2_CAP_TIMEPERFRAME) == 0) {
    return fps_of(capture.timeperframe);
  }
  const bool is_whole = std::abs(fps - std::round(fps)) < 1e-9;
  capture.timeperframe.numerator = is_whole ? 1 : 1001;
  capture.timeperframe.denominator =
      static_cast<std::uint32_t>(std::lround(is_whole ? fps : fps * 1001.0));
  if (auto answer = call(VIDIOC_S_PARM, &parameters, "VIDIOC_S_PARM"); !answer) {
    return tl::unexpected<Fault>(answer.error());
  }
  return fps_of(capture.timeperframe);
}

namespace {

/// One control for the calls that take several.
struct ControlCall {
  explicit ControlCall(const V4l2Control& of)
      : control(zeroed<v4l2_ext_control>()), list(zeroed<v4l2_ext_controls>()) {
    control.id = of.id;
    list.which = V4L2_CTRL_WHICH_CUR_VAL;
    list.count = 1;
    list.controls = &control;
  }
  ~ControlCall() = default;
  ControlCall(const ControlCall&) = delete;
  ControlCall& operator=(const ControlCall&) = delete;

  v4l2_ext_control control;
  v4l2_ext_controls list;
};

/// ENOTTY: the driver has only the older calls; EINVAL: some support these for a few controls
/// only.
bool has_older_call(const V4l2Control& control, const Fault& fault) {
  return !control.is_wide && (fault.sys_errno == ENOTTY || fault.sys_errno == EINVAL);
}

}  // namespace

Result<std::int64_t> V4l2Device::control(const V4l2Control& control) const {
  ControlCall get(control);
  auto answer = call(VIDIOC_G_EXT_CTRLS, &get.list, "VIDIOC_G_EXT_CTRLS");
  if (answer) {
    // Members of a union: other controls fill only 32 bits of it.
    const std::int64_t wide = get.control.value64;
    const std::int32_t narrow = get.control.value;
    return control.is_wide ? wide : narrow;
  }
  if (!has_older_call(control, answer.error())) {
    return tl::unexpected<Fault>(answer.error());
  }
  v4l2_control old{.id = control.id, .value = 0};
  if (answer = call(VIDIOC_G_CTRL, &old, "VIDIOC_G_CTRL"); !answer) {
    return tl::unexpected<Fault>(answer.error());
  }
  return old.value;
}

Result<void> V4l2Device::set_control(const V4l2Control& control, std::int64_t value) {
  ControlCall set(control);
  if (control.is_wide) {
    set.control.value64 = value;
  } else {
    set.control.value = static_cast<std::int32_t>(value);
  }
  auto answer = call(VIDIOC_S_EXT_CTRLS, &set.list, "VIDIOC_S_EXT_CTRLS");
  if (answer || !has_older_call(control, answer.error())) {
    return answer;
  }
  v4l2_control old{.id = control.id, .value = static_cast<std::int32_t>(value)};
  return call(VIDIOC_S_CTRL, &old, "VIDIOC_S_CTRL");
}

Result<bool> V4l2Device::subscribe(std::uint32_t type, std::uint32_t id) {
  auto subscription = zeroed<v4l2_event_subscription>();
  subscription.type = type;
  subscription.id = id;
  const auto answer = call(VIDIOC_SUBSCRIBE_EVENT, &subscription, "VIDIOC_SUBSCRIBE_EVENT");
  if (!answer && answer.error().code != Errc::unsupported) {
    return tl::unexpected<Fault>(answer.error());
  }
  return answer.has_value();
}

Result<bool> V4l2Device::watch_control(std::uint32_t id) {
  return subscribe(V4L2_EVENT_CTRL, id);
}

Result<bool> V4l2Device::watch_source() { return subscribe(V4L2_EVENT_SOURCE_CHANGE, 0); }

Result<V4l2Event> V4l2Device::take_event() {
  auto event = zeroed<v4l2_event>();
  const auto answer = call(VIDIOC_DQEVENT, &event, "VIDIOC_DQEVENT");
  if (!answer && answer.error().sys_errno == ENOENT) {
    return V4l2Event{};
  }
  if (!answer) {
    return tl::unexpected<Fault>(answer.error());
  }
  if (event.type == V4L2_EVENT_CTRL) {
    const bool has_value = (event.u.ctrl.changes & V4L2_EVENT_CTRL_CH_VALUE) != 0;
    const bool is_wide = event.u.ctrl.type == V4L2_CTRL_TYPE_INTEGER64;
    return V4l2Event{has_value ? V4l2Event::Kind::control : V4l2Event::Kind::other, event.id,
                     is_wide ? event.u.ctrl.value64 : event.u.ctrl.value};
  }
  return V4l2Event{
      event.type == V4L2_EVENT_SOURCE_CHANGE ? V4l2Event::Kind::source : V4l2Event::Kind::other,
      0, 0};
}

// ---- streaming ----

namespace {

/// A buffer argument, with the array of planes that the multi-planar calls require.
struct BufferCall {
  BufferCall(bool is_multiplanar, std::uint32_t n_planes, std::uint32_t index)
      : buffer(zeroed<v4l2_buffer>()) {
    std::memset(planes.data(), 0, sizeof planes);
    buffer.memory = V4L2_MEMORY_MMAP;
    buffer.index = index;
    buffer.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    if (is_multiplanar) {
      buffer.type = V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE;
      buffer.m.planes = planes.data();
      buffer.length = n_planes;
    }
  }
  ~BufferCall() = default;
  BufferCall(const BufferCall&) = delete;
  BufferCall& operator=(const BufferCall&) = delete;

  v4l2_buffer buffer;
  std::array<v4l2_plane, VIDEO_MAX_PLANES> planes;
};

}  // namespace

Result<void> V4l2Device::map_buffer(int index) {
  BufferCall ask(is_multiplanar_, n_planes_, static_cast<std::uint32_t>(index));
  if (auto answer = call(VIDIOC_QUERYBUF, &ask.buffer, "VIDIOC_QUERYBUF"); !answer) {
    return answer;
  }
  // Luma is in the first plane of every format that haarlight reads.
  const std::size_t size = is_multiplanar_ ? ask.planes[0].length : ask.buffer.length;
  const std::uint32_t offset =
      is_multiplanar_ ? ask.planes[0].m.mem_offset : ask.buffer.m.offset;
  void* data = ::mmap(nullptr, size, PROT_READ | PROT_WRITE, MAP_SHARED, fd_.get(),
                      static_cast<off_t>(offset));
  if (data == MAP_FAILED) {
    const int error = errno;
    return fail(errc_of_v4l2(error) == Errc::device_gone ? Errc::device_gone : Errc::io,
                fmt::format("mmap of buffer {} of {}: {}", index, node_, std::strerror(error)),
                error);
  }
  mappings_.push_back({data, size});
  return {};
}

Result<int> V4l2Device::make_buffers(int n) {
  unmap();
  auto request = zeroed<v4l2_requestbuffers>();
  request.count = static_cast<std::uint32_t>(n);
  request.type =
      is_multiplanar_ ? V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE : V4L2_BUF_TYPE_VIDEO_CAPTURE;
  request.memory = V4L2_MEMORY_MMAP;
  if (auto answer = call(VIDIOC_REQBUFS, &request, "VIDIOC_REQBUFS"); !answer) {
    return tl::unexpected<Fault>(answer.error());
  }
  if (request.count < 2 || request.count > VIDEO_MAX_FRAME) {
    return fail(Errc::protocol, fmt::format("VIDIOC_REQBUFS {}: requested {} buffers, got {}",
                                            node_, n, request.count));
  }
  for (std::uint32_t i = 0; i < request.count; ++i) {
    if (auto mapped = map_buffer(static_cast<int>(i)); !mapped) {
      return tl::unexpected<Fault>(mapped.error());
    }
  }
  if (auto queued = queue_all(); !queued) {
    return tl::unexpected<Fault>(queued.error());
  }
  return static_cast<int>(request.count);
}

std::size_t V4l2Device::buffer_bytes() const noexcept {
  std::size_t least = mappings_.empty() ? 0 : mappings_.front().size;
  for (const Mapping& mapping : mappings_) {
    least = std::min(least, mapping.size);
  }
  return least;
}

Result<void> V4l2Device::queue(int index) {
  BufferCall give(is_multiplanar_, n_planes_, static_cast<std::uint32_t>(index));
  return call(VIDIOC_QBUF, &give.buffer, "VIDIOC_QBUF");
}

Result<void> V4l2Device::queue_all() {
  for (std::size_t i = 0; i < mappings_.size(); ++i) {
    if (auto queued = queue(static_cast<int>(i)); !queued) {
      return queued;
    }
  }
  return {};
}

Result<void> V4l2Device::stream_on() {
  int type = is_multiplanar_ ? V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE : V4L2_BUF_TYPE_VIDEO_CAPTURE;
  auto on = call(VIDIOC_STREAMON, &type, "VIDIOC_STREAMON");
  if (!on && on.error().sys_errno == ENOSPC) {
    // The kernel's way of saying "no bandwidth left on the bus".
    return fail(Errc::device_busy,
                fmt::format("VIDIOC_STREAMON {}: not enough USB bandwidth (this is not about "
                            "the disk); put the camera on a bus of its own, or lower its size, "
                            "bits or frame rate",
                            node_),
                ENOSPC);
  }
  return on;
}

Result<void> V4l2Device::stream_off() {
  int type = is_multiplanar_ ? V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE : V4L2_BUF_TYPE_VIDEO_CAPTURE;
  return call(VIDIOC_STREAMOFF, &type, "VIDIOC_STREAMOFF");
}

Result<V4l2Ready> V4l2Device::wait(Clock::time_point deadline) const {
  for (;;) {
    const auto left = std::chrono::ceil<milliseconds>(deadline - Clock::now());
    pollfd wait{.fd = fd_.get(), .events = POLLIN | POLLPRI, .revents = 0};
    const int n =
        ::poll(&wait, 1, static_cast<int>(std::clamp<long long>(left.count(), 0, kMaxPollMs)));
    const int error = errno;
    if (n < 0 && error != EINTR) {
      return fail(Errc::io, fmt::format("poll {}: {}", node_, std::strerror(error)), error);
    }
    if (n > 0) {
      const auto has = [&](int bits) { return (wait.revents & bits) != 0; };
      return V4l2Ready{has(POLLIN), has(POLLPRI), has(POLLERR | POLLHUP | POLLNVAL)};
    }
    if (Clock::now() >= deadline) {
      return fail(Errc::timeout, fmt::format("poll {}: no frame before the deadline", node_));
    }
  }
}

Result<V4l2Filled> V4l2Device::dequeue() {
  BufferCall take(is_multiplanar_, n_planes_, 0);
  if (auto answer = call(VIDIOC_DQBUF, &take.buffer, "VIDIOC_DQBUF"); !answer) {
    return tl::unexpected<Fault>(answer.error());
  }
  const std::int64_t arrival_ns = std::chrono::duration_cast<std::chrono::nanoseconds>(
                                      std::chrono::steady_clock::now().time_since_epoch())
                                      .count();
  const v4l2_buffer& buffer = take.buffer;
  if (buffer.index >= mappings_.size()) {
    return fail(Errc::protocol, fmt::format("VIDIOC_DQBUF {}: buffer {} of {}", node_,
                                            buffer.index, mappings_.size()));
  }
  const Mapping& mapping = mappings_[buffer.index];
  const std::size_t begin =
      std::min<std::size_t>(is_multiplanar_ ? take.planes[0].data_offset : 0, mapping.size);
  const std::size_t end = std::clamp<std::size_t>(
      is_multiplanar_ ? take.planes[0].bytesused : buffer.bytesused, begin, mapping.size);
  V4l2Filled filled;
  filled.arrival_ns = arrival_ns;
  filled.index = static_cast<int>(buffer.index);
  filled.bytes = {static_cast<const std::byte*>(mapping.data) + begin, end - begin};
  filled.sequence = buffer.sequence;
  filled.timestamp_ns = static_cast<std::int64_t>(buffer.timestamp.tv_sec) * 1'000'000'000 +
                        static_cast<std::int64_t>(buffer.timestamp.tv_usec) * 1'000;
  filled.is_error = (buffer.flags & V4L2_BUF_FLAG_ERROR) != 0;
  filled.is_monotonic =
      (buffer.flags & V4L2_BUF_FLAG_TIMESTAMP_MASK) == V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC;
  filled.is_timestamped_at_start =
      (buffer.flags & V4L2_BUF_FLAG_TSTAMP_SRC_MASK) == V4L2_BUF_FLAG_TSTAMP_SRC_SOE;
  return filled;
}

}  // namespace haarlight::capture
