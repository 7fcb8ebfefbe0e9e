// SPDX-License-Identifier: Apache-2.0
#include "sim/v4l2_output.h"

#include <array>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <optional>
#include <span>
#include <string>
#include <system_error>
#include <thread>
#include <vector>

#include <fcntl.h>
#include <fmt/format.h>
#include <linux/videodev2.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <unistd.h>

#include "core/log.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"

namespace haarlight::sim {

namespace {

// Few: a queued frame is old by the time it is seen.
constexpr std::uint32_t kBuffers = 2;
constexpr std::int64_t kReopenNs = 100'000'000;  // interval of the search for a lost node

std::int64_t now_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

std::string error_text(int error) { return std::generic_category().message(error); }

int call(const Fd& fd, unsigned long request, void* argument) {
  int result = 0;
  do {
    result = ::ioctl(fd.get(), request, argument);
  } while (result < 0 && errno == EINTR);
  return result;
}

std::uint32_t fourcc_of(const std::string& format) {
  std::array<char, 4> letters{' ', ' ', ' ', ' '};
  std::copy_n(format.begin(), std::min<std::size_t>(4, format.size()), letters.begin());
  return v4l2_fourcc(letters[0], letters[1], letters[2], letters[3]);
}

/// Bytes per pixel; 0 = a format that this program does not write.
std::size_t bytes_per_pixel(std::uint32_t fourcc) {
  switch (fourcc) {
    case V4L2_PIX_FMT_Y16:
    case V4L2_PIX_FMT_Y12:
    case V4L2_PIX_FMT_Y10:
      return 2;
    case V4L2_PIX_FMT_GREY:
      return 1;
    default:
      return 0;
  }
}

/// One of the driver's buffers, mapped.
class MappedBuffer {
 public:
  MappedBuffer(const Fd& fd, const v4l2_buffer& buffer)
      : size_(buffer.length),
        data_(::mmap(nullptr, buffer.length, PROT_READ | PROT_WRITE, MAP_SHARED, fd.get(),
                     static_cast<off_t>(buffer.m.offset))) {}
  ~MappedBuffer() {
    if (data_ != MAP_FAILED) {
      ::munmap(data_, size_);
    }
  }
  MappedBuffer(MappedBuffer&& other) noexcept : size_(other.size_), data_(other.data_) {
    other.data_ = MAP_FAILED;
  }
  MappedBuffer& operator=(MappedBuffer&&) = delete;
  MappedBuffer(const MappedBuffer&) = delete;
  MappedBuffer& operator=(const MappedBuffer&) = delete;

  [[nodiscard]] bool is_mapped() const { return data_ != MAP_FAILED; }
  [[nodiscard]] std::span<std::byte> bytes() const {
    return {static_cast<std::byte*>(data_), size_};
  }

 private:
  std::size_t size_;
  void* data_;
};

/// Writes frames.raw and frames.txt in a folder.
class Record {
 public:
  explicit Record(const std::filesystem::path& folder) {
    std::filesystem::create_directories(folder);
    raw_.reset(std::fopen((folder / "frames.raw").c_str(), "wb"));
    text_.reset(std::fopen((folder / "frames.txt").c_str(), "w"));
    if (raw_ == nullptr || text_ == nullptr) {
      throw Error("the record of the frames cannot be written: " + error_text(errno),
                  folder.string(), "choose a folder that can be written",
                  ExitCode::unavailable);
    }
  }
  /// False when the disk is full.
  bool add(std::span<const std::uint16_t> words, const Exposure& exposure, std::int64_t end_ns,
           capture::FrameTag tag) {
    fmt::print(text_.get(), "{} {} {} {}\n", exposure.start_ns, end_ns, tag.tag,
               tag.is_mixed ? 1 : 0);
    return std::fwrite(words.data(), sizeof(std::uint16_t), words.size(), raw_.get()) ==
           words.size();
  }

 private:
  struct Close {
    void operator()(std::FILE* file) const noexcept { std::fclose(file); }
  };
  std::unique_ptr<std::FILE, Close> raw_;
  std::unique_ptr<std::FILE, Close> text_;
};

}  // namespace

class V4l2Output::Impl {
 public:
  Impl(const CameraSpec& spec, const ControllerSpec& controller, const Transport& transport,
       LightSource light, const std::filesystem::path& node, const V4l2OutputOptions& options)
      : spec_(spec),
        camera_(spec, controller, transport, options.camera),
        light_(std::move(light)),
        node_(node.string()),
        stop_(::eventfd(0, EFD_CLOEXEC)) {
    open();
    set_format();
    map_buffers();
    words_.resize(static_cast<std::size_t>(spec.frame_width) *
                  static_cast<std::size_t>(spec.frame_height));
    if (!options.record.empty()) {
      record_ = std::make_unique<Record>(options.record);
    }
    thread_ = std::jthread([this] { run(); });
  }

  ~Impl() {
    const std::uint64_t one = 1;
    [[maybe_unused]] const ssize_t n = ::write(stop_.get(), &one, sizeof one);
    thread_.join();
  }
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  [[nodiscard]] V4l2OutputCounts counts() const { return {n_written_.load(), n_mixed_.load()}; }

 private:
  [[noreturn]] void refuse(const std::string& what, const std::string& hint) const {
    throw Error(what, node_, hint, ExitCode::unavailable);
  }

  void open() {
    fd_ = Fd(::open(node_.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC));
    if (!fd_.is_open()) {
      refuse("the output node cannot be opened: " + error_text(errno),
             "load vivid with an output node, or v4l2loopback, and name its node");
    }
    v4l2_capability capability{};
    if (call(fd_, VIDIOC_QUERYCAP, &capability) != 0) {
      refuse("VIDIOC_QUERYCAP: " + error_text(errno), "name a V4L2 node");
    }
    const std::uint32_t caps = (capability.capabilities & V4L2_CAP_DEVICE_CAPS) != 0
                                   ? capability.device_caps
                                   : capability.capabilities;
    if ((caps & V4L2_CAP_VIDEO_OUTPUT) == 0 || (caps & V4L2_CAP_STREAMING) == 0) {
      refuse("no video output node that streams",
             "v4l2-ctl --list-devices shows the nodes; vivid needs node_types=0x101");
    }
  }

  void set_format() {
    const std::uint32_t fourcc = fourcc_of(spec_.format);
    pixel_bytes_ = bytes_per_pixel(fourcc);
    if (pixel_bytes_ == 0) {
      refuse(fmt::format("frames of format \"{}\" are not written", spec_.format),
             "use \"Y16 \", \"Y12 \", \"Y10 \" or \"GREY\"");
    }
    v4l2_format format{};
    format.type = V4L2_BUF_TYPE_VIDEO_OUTPUT;
    format.fmt.pix.width = static_cast<std::uint32_t>(spec_.frame_width);
    format.fmt.pix.height = static_cast<std::uint32_t>(spec_.frame_height);
    format.fmt.pix.pixelformat = fourcc;
    format.fmt.pix.field = V4L2_FIELD_NONE;
    if (call(fd_, VIDIOC_S_FMT, &format) != 0) {
      refuse("VIDIOC_S_FMT: " + error_text(errno), "stop whoever else streams to it");
    }
    const v4l2_pix_format& pix = format.fmt.pix;
    if (pix.width != static_cast<std::uint32_t>(spec_.frame_width) ||
        pix.height != static_cast<std::uint32_t>(spec_.frame_height) ||
        pix.pixelformat != fourcc) {
      refuse(
          fmt::format("requested {} x {} {}, got {} x {} {:#x}", spec_.frame_width,
                      spec_.frame_height, spec_.format, pix.width, pix.height, pix.pixelformat),
          "give the rig file a size and format that the node takes");
    }
    stride_ = pix.bytesperline;
    image_bytes_ = pix.sizeimage;
  }

  void map_buffers() {
    v4l2_requestbuffers request{};
    request.count = kBuffers;
    request.type = V4L2_BUF_TYPE_VIDEO_OUTPUT;
    request.memory = V4L2_MEMORY_MMAP;
    if (call(fd_, VIDIOC_REQBUFS, &request) != 0 || request.count == 0) {
      refuse("VIDIOC_REQBUFS: " + error_text(errno), "stop whoever else streams to it");
    }
    const std::size_t needed = stride_ * static_cast<std::size_t>(spec_.frame_height - 1) +
                               pixel_bytes_ * static_cast<std::size_t>(spec_.frame_width);
    for (std::uint32_t i = 0; i < request.count; ++i) {
      v4l2_buffer buffer = buffer_of(i);
      if (call(fd_, VIDIOC_QUERYBUF, &buffer) != 0) {
        refuse("VIDIOC_QUERYBUF: " + error_text(errno), "reload its driver");
      }
      buffers_.emplace_back(fd_, buffer);
      if (!buffers_.back().is_mapped() || buffer.length < needed) {
        refuse(fmt::format("a buffer of {} bytes, {} needed", buffer.length, needed),
               "reload its driver");
      }
    }
  }

  [[nodiscard]] static v4l2_buffer buffer_of(std::uint32_t index) {
    v4l2_buffer buffer{};
    buffer.index = index;
    buffer.type = V4L2_BUF_TYPE_VIDEO_OUTPUT;
    buffer.memory = V4L2_MEMORY_MMAP;
    return buffer;
  }

  /// Why a stream ended.
  enum class End { requested, node_lost, record_full };

  void run() {
    try {
      for (;;) {
        const End end = stream();
        if (end != End::node_lost) {
          return;
        }
        close();
        do {
          if (!wait_for(nullptr, now_ns() + kReopenNs)) {
            return;
          }
        } while (!reopen());
      }
    } catch (const std::exception& error) {
      log_error(fmt::format("output camera {}: {}", node_, error.what()));
    }
  }

  End stream() {
    for (std::uint32_t i = 0; i < buffers_.size(); ++i) {
      if (const auto end = write_frame(i)) {
        return *end;
      }
    }
    int type = V4L2_BUF_TYPE_VIDEO_OUTPUT;
    if (call(fd_, VIDIOC_STREAMON, &type) != 0) {
      return lost("VIDIOC_STREAMON", errno);
    }
    while (wait_for(&fd_, -1)) {
      v4l2_buffer buffer = buffer_of(0);
      if (call(fd_, VIDIOC_DQBUF, &buffer) != 0) {
        if (errno == EAGAIN) {
          continue;
        }
        return lost("VIDIOC_DQBUF", errno);
      }
      if (const auto end = write_frame(buffer.index)) {
        return *end;
      }
    }
    return End::requested;
  }

  [[nodiscard]] End lost(const char* operation, int error) const {
    log_warning(fmt::format("output camera {}: {}: {}; waiting for the node", node_, operation,
                            error_text(error)));
    return End::node_lost;
  }

  void close() {
    buffers_.clear();
    fd_.reset();
  }

  bool reopen() {
    try {
      open();
      set_format();
      map_buffers();
      log_info("output camera " + node_ + ": the node is back");
      return true;
    } catch (const Error&) {  // still away
      close();
      return false;
    }
  }

  /// Waits until the node returns a buffer (`node` not null) or the time has come.
  /// @return false when requested to stop
  bool wait_for(const Fd* node, std::int64_t until_ns) const {
    for (;;) {
      timespec timeout{};
      if (until_ns >= 0) {
        const std::int64_t left = until_ns - now_ns();
        if (left <= 0) {
          return true;
        }
        timeout = {left / 1'000'000'000, left % 1'000'000'000};
      }
      std::array<pollfd, 2> fds = {pollfd{stop_.get(), POLLIN, 0},
                                   pollfd{node != nullptr ? node->get() : -1, POLLOUT, 0}};
      ::ppoll(fds.data(), fds.size(), until_ns >= 0 ? &timeout : nullptr, nullptr);
      if (fds[0].revents != 0) {
        return false;
      }
      if (fds[1].revents != 0) {
        return true;
      }
    }
  }

  /// Exposes a frame from now on and queues it. @return nothing, or why the stream must end
  std::optional<End> write_frame(std::uint32_t index) {
    const auto period_ns = static_cast<std::int64_t>(std::llround(1e9 / spec_.fps));
    if (!wait_for(nullptr, last_start_ns_ + period_ns)) {
      return End::requested;
    }
    Exposure exposure;
    exposure.start_ns = now_ns();
    exposure.exposure_us = spec_.exposure_us;
    exposure.gain_db = spec_.gain_db;
    last_start_ns_ = exposure.start_ns;
    const std::int64_t end_ns = camera_.end_ns(exposure);
    if (!wait_for(nullptr, end_ns + 1)) {
      return End::requested;
    }
    const firmware_iface::LightHistory history =
        light_.history(camera_.history_begin_ns(exposure), end_ns);
    const LightSeen seen = camera_.look(history, exposure);
    const ImageView<std::uint16_t> words(words_.data(), spec_.frame_height, spec_.frame_width,
                                         1);
    // No two frames have the same noise: so a repeated one is recognisable.
    camera_.take(history, exposure, seen, n_written_.load(), words);
    if (light_.strobe) {
      light_.strobe(now_ns());
    }
    copy_to(buffers_[index].bytes());
    if (record_ != nullptr && !record_->add(words_, exposure, end_ns, seen.tag)) {
      log_error("output camera " + node_ + ": the record's disk is full; no more frames");
      return End::record_full;
    }
    ++n_written_;
    if (seen.tag.is_mixed) {
      ++n_mixed_;
    }
    v4l2_buffer buffer = buffer_of(index);
    buffer.bytesused = image_bytes_;
    buffer.field = V4L2_FIELD_NONE;
    if (call(fd_, VIDIOC_QBUF, &buffer) != 0) {
      return lost("VIDIOC_QBUF", errno);
    }
    return std::nullopt;
  }

  void copy_to(std::span<std::byte> bytes) const {
    const auto width = static_cast<std::size_t>(spec_.frame_width);
    for (std::size_t y = 0; y < static_cast<std::size_t>(spec_.frame_height); ++y) {
      const std::uint16_t* row = words_.data() + y * width;
      std::byte* out = bytes.data() + y * stride_;
      if (pixel_bytes_ == 2) {
        std::memcpy(out, row, 2 * width);  // V4L2's words are little-endian, as ours are
      } else {
        for (std::size_t x = 0; x < width; ++x) {
          out[x] = static_cast<std::byte>(row[x]);
        }
      }
    }
  }

  CameraSpec spec_;
  VirtualCamera camera_;
  LightSource light_;
  std::string node_;
  Fd stop_;
  Fd fd_;
  std::size_t pixel_bytes_ = 2;
  std::size_t stride_ = 0;
  std::uint32_t image_bytes_ = 0;
  std::vector<MappedBuffer> buffers_;
  std::vector<std::uint16_t> words_;
  std::unique_ptr<Record> record_;
  std::int64_t last_start_ns_ = 0;
  std::atomic<std::uint64_t> n_written_{0};
  std::atomic<std::uint64_t> n_mixed_{0};
  std::jthread thread_;
};

V4l2Output::V4l2Output(const CameraSpec& spec, const ControllerSpec& controller,
                       const Transport& transport, LightSource light,
                       const std::filesystem::path& node, const V4l2OutputOptions& options)
    : impl_(std::make_unique<Impl>(spec, controller, transport, std::move(light), node,
                                   options)) {}
V4l2Output::~V4l2Output() = default;
V4l2OutputCounts V4l2Output::counts() const { return impl_->counts(); }

}  // namespace haarlight::sim
