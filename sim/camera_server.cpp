// SPDX-License-Identifier: Apache-2.0
#include "sim/camera_server.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstring>
#include <deque>
#include <mutex>
#include <system_error>
#include <thread>
#include <unordered_map>
#include <vector>

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "capture/camera/camera.h"
#include "capture/camera/remote_camera_protocol.h"
#include "core/log.h"
#include "core/random.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"

namespace haarlight::sim {

namespace {

constexpr std::int64_t kTransferNs = 200'000;  // from the last readout to the host's memory
constexpr std::int64_t kFar = std::int64_t{1} << 62;

std::int64_t now_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

[[noreturn]] void throw_os_error(const std::string& operation, const std::string& where,
                                 const std::string& hint) {
  const int error = errno;
  throw Error(fmt::format("{}: {}", operation, std::generic_category().message(error)), where,
              hint, ExitCode::unavailable);
}

std::uint32_t fourcc_of(const std::string& format) {
  std::uint32_t code = 0;
  for (std::size_t i = 0; i < 4; ++i) {
    const auto c = static_cast<unsigned char>(i < format.size() ? format[i] : ' ');
    code |= std::uint32_t{c} << (8U * static_cast<unsigned>(i));
  }
  return code;
}

sockaddr_un address_of(const std::filesystem::path& path) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  const std::string text = path.string();
  if (text.size() >= sizeof address.sun_path) {
    throw Error(fmt::format("a socket's path of {} characters", text.size()), text,
                fmt::format("use fewer than {}", sizeof address.sun_path));
  }
  std::memcpy(address.sun_path, text.c_str(), text.size() + 1);
  return address;
}

/// A frame's memory: written here, read by the client through its own read-only descriptor.
class FrameMemory {
 public:
  explicit FrameMemory(std::size_t bytes) : size_(bytes) {
    const Fd writable(::memfd_create("haarlight-frame", MFD_CLOEXEC | MFD_ALLOW_SEALING));
    if (!writable.is_open() || ::ftruncate(writable.get(), static_cast<off_t>(bytes)) != 0) {
      throw_os_error("memfd_create", "camera server", "free some memory");
    }
    const std::string again = fmt::format("/proc/self/fd/{}", writable.get());
    fd_ = Fd(::open(again.c_str(), O_RDONLY | O_CLOEXEC));
    data_ = ::mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_SHARED, writable.get(), 0);
    // The client may map only what cannot shrink underneath it.
    const bool is_sealed =
        ::fcntl(writable.get(), F_ADD_SEALS, F_SEAL_SHRINK | F_SEAL_GROW) == 0;
    if (!fd_.is_open() || data_ == MAP_FAILED || !is_sealed) {
      throw_os_error("mmap of a frame", "camera server", "free some memory");
    }
  }
  ~FrameMemory() {
    if (data_ != MAP_FAILED) {
      ::munmap(data_, size_);
    }
  }
  FrameMemory(FrameMemory&& other) noexcept
      : size_(other.size_), fd_(std::move(other.fd_)), data_(other.data_) {
    other.data_ = MAP_FAILED;
  }
  FrameMemory& operator=(FrameMemory&&) = delete;
  FrameMemory(const FrameMemory&) = delete;
  FrameMemory& operator=(const FrameMemory&) = delete;

  [[nodiscard]] std::uint16_t* words() const { return static_cast<std::uint16_t*>(data_); }
  [[nodiscard]] int fd() const { return fd_.get(); }

 private:
  std::size_t size_;
  Fd fd_;
  void* data_ = MAP_FAILED;
};

struct Buffer {
  FrameMemory memory;
  std::uint64_t sequence = 0;
  int n_held = 0;  ///< copies waiting to be sent or held by the client
};

/// An exposure in progress.
struct Running {
  std::uint64_t sequence = 0;
  Exposure exposure;
  std::int64_t ready_ns = 0;
};

/// A frame on its way to the client.
struct Outgoing {
  capture::RemoteHeader header;
  std::size_t buffer = 0;
  std::int64_t send_ns = 0;
};

enum class FrameFault { none, late, drop, duplicate, stale, swap };

}  // namespace

class CameraServer::Impl {
 public:
  Impl(const CameraSpec& spec, const ControllerSpec& controller, const Transport& transport,
       LightSource light, std::filesystem::path socket, const CameraServerOptions& options)
      : spec_(spec),
        options_(options),
        camera_(spec, controller, transport, options.camera),
        light_(std::move(light)),
        path_(std::move(socket)),
        stop_(::eventfd(0, EFD_CLOEXEC)),
        pulse_(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)),
        cut_(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
    HAARLIGHT_EXPECTS(options.n_buffers >= 1 && options.n_buffers <= 1024, "1 to 1024 buffers");
    exposure_us_ = spec.exposure_us;
    gain_db_ = spec.gain_db;
    fps_ = spec.fps;
    if (options.is_prepared) {
      prepare();
    }
    listen();
    thread_ = std::jthread([this] { run(); });
  }

  ~Impl() {
    const std::uint64_t one = 1;
    [[maybe_unused]] const ssize_t n = ::write(stop_.get(), &one, sizeof one);
    thread_.join();
    std::error_code ignored;
    std::filesystem::remove(path_, ignored);
  }
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  [[nodiscard]] const std::filesystem::path& path() const { return path_; }

  [[nodiscard]] CameraServerCounts counts() const {
    const std::lock_guard lock(counts_mutex_);
    return counts_;
  }

  [[nodiscard]] std::optional<std::int64_t> first_frame_ns() const {
    const std::int64_t first = first_frame_ns_.load();
    return first == 0 ? std::nullopt : std::optional(first);
  }

  void trigger_line(std::int64_t t_ns) {
    {
      const std::lock_guard lock(pulses_mutex_);
      pulses_.push_back(t_ns);
    }
    const std::uint64_t one = 1;
    [[maybe_unused]] const ssize_t n = ::write(pulse_.get(), &one, sizeof one);
  }

  void cut_client() const {
    const std::uint64_t one = 1;
    [[maybe_unused]] const ssize_t n = ::write(cut_.get(), &one, sizeof one);
  }

 private:
  void listen() {
    const sockaddr_un address = address_of(path_);
    std::error_code failed;
    if (!path_.parent_path().empty()) {
      std::filesystem::create_directories(path_.parent_path(), failed);
    }
    const auto* name = reinterpret_cast<const sockaddr*>(&address);
    // A socket that does not answer is left over from a killed process.
    const Fd probe(::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0));
    if (::connect(probe.get(), name, sizeof address) == 0) {
      throw Error("another camera answers on this socket", path_.string(),
                  "stop it, or give another path in the rig file", ExitCode::unavailable);
    }
    if (std::filesystem::is_socket(path_, failed)) {
      std::filesystem::remove(path_, failed);
    }
    listen_ = Fd(::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
    if (!listen_.is_open() || ::bind(listen_.get(), name, sizeof address) != 0 ||
        ::listen(listen_.get(), 4) != 0) {
      throw_os_error("bind", path_.string(), "choose a path in a folder that can be written");
    }
  }

  void count(std::uint64_t CameraServerCounts::*which) {
    const std::lock_guard lock(counts_mutex_);
    ++(counts_.*which);
  }

  // ---- the loop ----

  void run() {
    try {
      while (step()) {
      }
    } catch (const std::exception& error) {
      log_error(fmt::format("camera server {}: {}", path_.string(), error.what()));
      drop_client();
      listen_.reset();
    }
  }

  /// False when stopping.
  bool step() {
    const std::int64_t until = next_event_ns();
    const std::int64_t left = std::max<std::int64_t>(0, until - now_ns());
    const timespec timeout{left / 1'000'000'000, left % 1'000'000'000};
    std::array<pollfd, 5> fds = {pollfd{stop_.get(), POLLIN, 0}, pollfd{cut_.get(), POLLIN, 0},
                                 pollfd{listen_.get(), POLLIN, 0},
                                 pollfd{client_.get(), POLLIN, 0},
                                 pollfd{pulse_.get(), POLLIN, 0}};
    const int n = ::ppoll(fds.data(), fds.size(), until == kFar ? nullptr : &timeout, nullptr);
    if (n > 0) {
      if (fds[0].revents != 0) {
        return false;
      }
      if (fds[1].revents != 0) {
        std::uint64_t ignored = 0;
        [[maybe_unused]] const ssize_t got = ::read(cut_.get(), &ignored, sizeof ignored);
        drop_client();
      } else if (fds[3].revents != 0) {
        // Frames that are due begin before the client's new messages are read.
        run_sensor(now_ns());
        if (client_.is_open()) {
          hear_client();
        }
      }
      if (fds[2].revents != 0) {
        accept_client();
      }
      if (fds[4].revents != 0) {
        take_pulses();
      }
    }
    run_sensor(now_ns());
    return true;
  }

  [[nodiscard]] std::int64_t next_event_ns() const {
    std::int64_t next = kFar;
    if (is_streaming_) {
      next =
          std::min(next, next_start_ns_ - (next_start_ns_ == kFar ? 0 : options_.lookahead_ns));
      if (!running_.empty()) {
        next = std::min(next, running_.front().ready_ns);
      }
      if (!outgoing_.empty()) {
        next = std::min(next, outgoing_.front().send_ns);
      }
    }
    return next;
  }

  // ---- the client ----

  void accept_client() {
    Fd fd(::accept4(listen_.get(), nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK));
    if (!fd.is_open()) {
      return;
    }
    if (client_.is_open()) {
      capture::RemoteHeader busy;
      busy.message = static_cast<std::uint16_t>(capture::RemoteMessage::error);
      busy.flags = EBUSY;
      [[maybe_unused]] const ssize_t n = ::send(fd.get(), &busy, sizeof busy, MSG_NOSIGNAL);
      return;
    }
    client_ = std::move(fd);
  }

  void drop_client() {
    client_.reset();
    stop_streaming();
  }

  void stop_streaming() {
    is_streaming_ = false;
    running_.clear();
    requested_us_.clear();
    outgoing_.clear();
    swapped_.reset();
    buffers_.clear();
    last_words_.clear();
  }

  void reply(const capture::RemoteHeader& header) {
    if (::send(client_.get(), &header, sizeof header, MSG_NOSIGNAL) < 0) {
      drop_client();
    }
  }

  void refuse(int error) {
    capture::RemoteHeader header;
    header.message = static_cast<std::uint16_t>(capture::RemoteMessage::error);
    header.flags = static_cast<std::uint32_t>(error);
    reply(header);
  }

  [[nodiscard]] capture::RemoteHeader state_header(capture::RemoteMessage message) const {
    capture::RemoteHeader header;
    header.message = static_cast<std::uint16_t>(message);
    header.width = static_cast<std::uint32_t>(spec_.frame_width);
    header.height = static_cast<std::uint32_t>(spec_.frame_height);
    header.fourcc = fourcc_of(spec_.format);
    header.stride = header.width * 2U;
    header.bytes = header.stride * header.height;
    header.exposure_us = static_cast<float>(exposure_us_);
    header.gain_db = static_cast<float>(gain_db_);
    header.fps = static_cast<float>(fps_);
    header.n_buffers = static_cast<std::uint32_t>(options_.n_buffers);
    return header;
  }

  void hear_client() {
    capture::RemoteHeader header;
    const ssize_t n = ::recv(client_.get(), &header, sizeof header, MSG_DONTWAIT | MSG_TRUNC);
    if (n < 0 && (errno == EAGAIN || errno == EINTR)) {
      return;
    }
    if (n <= 0) {
      drop_client();
      return;
    }
    if (n != static_cast<ssize_t>(sizeof header) || header.magic != capture::kRemoteMagic ||
        header.version != capture::kRemoteVersion) {
      refuse(EPROTO);
      drop_client();
      return;
    }
    switch (static_cast<capture::RemoteMessage>(header.message)) {
      case capture::RemoteMessage::setup:
        set_up(header);
        return;
      case capture::RemoteMessage::set_exposure:
        if (!is_exposure(header.exposure_us)) {
          refuse(EINVAL);
          return;
        }
        exposure_us_ = static_cast<double>(header.exposure_us);
        reply(state_header(capture::RemoteMessage::set_exposure));
        return;
      case capture::RemoteMessage::start:
        start_streaming();
        return;
      case capture::RemoteMessage::stop:
        stop_streaming();
        return;
      case capture::RemoteMessage::trigger:
        if (trigger_ == capture::TriggerSource::software) {
          trigger(now_ns());
        }
        return;
      case capture::RemoteMessage::release:
        release(header.sequence);
        return;
      case capture::RemoteMessage::frame:
      case capture::RemoteMessage::error:
        break;
    }
    refuse(EPROTO);
  }

  static bool is_exposure(float us) { return us >= 1.0F && us <= 1e7F; }

  void set_up(const capture::RemoteHeader& wanted) {
    if (is_streaming_) {
      refuse(EBUSY);
      return;
    }
    // Zero means: no change. The size and form of the sensor are fixed; the client reads them
    // back. The rate is at most the sensor's own.
    if (wanted.exposure_us != 0.0F) {
      if (!is_exposure(wanted.exposure_us)) {
        refuse(EINVAL);
        return;
      }
      exposure_us_ = static_cast<double>(wanted.exposure_us);
    }
    if (std::isfinite(wanted.gain_db) && std::abs(wanted.gain_db) <= 60.0F) {
      gain_db_ = static_cast<double>(wanted.gain_db);
    }
    trigger_ = wanted.sequence <= static_cast<std::uint64_t>(capture::TriggerSource::line)
                   ? static_cast<capture::TriggerSource>(wanted.sequence)
                   : capture::TriggerSource::free;
    if (wanted.fps > 0.0F) {
      fps_ = std::min(spec_.fps, static_cast<double>(wanted.fps));
    }
    capture::RemoteHeader set = state_header(capture::RemoteMessage::setup);
    set.sequence = static_cast<std::uint64_t>(trigger_);
    reply(set);
  }

  void start_streaming() {
    if (is_streaming_) {
      refuse(EBUSY);
      return;
    }
    const auto bytes = static_cast<std::size_t>(spec_.frame_width) *
                       static_cast<std::size_t>(spec_.frame_height) * 2U;
    for (int i = 0; i < options_.n_buffers; ++i) {
      buffers_.push_back(Buffer{FrameMemory(bytes), 0, 0});
    }
    for (Buffer& buffer : buffers_) {
      fill(buffer);
    }
    is_streaming_ = true;
    next_sequence_ = 0;
    free_from_ns_ = 0;
    n_clean_.clear();
    const std::int64_t start_ns = now_ns() + 1'000'000 + options_.lookahead_ns;
    next_start_ns_ = trigger_ == capture::TriggerSource::free ? start_ns : kFar;
    std::int64_t none = 0;
    first_frame_ns_.compare_exchange_strong(none, start_ns);
  }

  /// Noise on grey, generated once: so a stream starts at once.
  void prepare() {
    noise_.resize(static_cast<std::size_t>(spec_.frame_width) *
                  static_cast<std::size_t>(spec_.active_rows));
    const auto grey = static_cast<unsigned>(1U << static_cast<unsigned>(spec_.bits - 1));
    for (std::size_t i = 0; i < noise_.size(); ++i) {
      noise_[i] =
          static_cast<std::uint16_t>(grey + (hash_key(31, i / 4) >> (16U * (i % 4))) % 64U);
    }
  }

  /// A prepared picture: the noise, starting at an offset that is the buffer's own.
  void fill(Buffer& buffer) const {
    if (noise_.empty()) {
      return;
    }
    const auto number = static_cast<std::size_t>(&buffer - buffers_.data());
    const auto begin =
        noise_.begin() + static_cast<std::ptrdiff_t>(number * 7919 % noise_.size());
    std::rotate_copy(noise_.begin(), begin, noise_.end(), buffer.memory.words());
  }

  // ---- triggers ----

  void take_pulses() {
    std::uint64_t ignored = 0;
    [[maybe_unused]] const ssize_t got = ::read(pulse_.get(), &ignored, sizeof ignored);
    std::deque<std::int64_t> pulses;
    {
      const std::lock_guard lock(pulses_mutex_);
      pulses.swap(pulses_);
    }
    if (trigger_ == capture::TriggerSource::line) {
      for (const std::int64_t t_ns : pulses) {
        trigger(t_ns);
      }
    }
  }

  void trigger(std::int64_t t_ns) {
    if (!is_streaming_ || t_ns < free_from_ns_) {
      return;
    }
    next_start_ns_ = t_ns;
    start_frame();
    next_start_ns_ = kFar;
    free_from_ns_ = running_.back().ready_ns;
  }

  void release(std::uint64_t sequence) {
    for (Buffer& buffer : buffers_) {
      if (buffer.n_held > 0 && buffer.sequence == sequence) {
        --buffer.n_held;
        return;
      }
    }
  }

  // ---- the sensor ----

  [[nodiscard]] std::int64_t period_ns(double exposure_us) const {
    // An exposure and the next one cannot overlap on one row.
    return std::max(std::llround(1e9 / fps_), std::llround(exposure_us * 1e3) + 20'000);
  }

  void run_sensor(std::int64_t now) {
    while (is_streaming_ && next_start_ns_ <= now + options_.lookahead_ns) {
      start_frame();
    }
    while (is_streaming_ && !running_.empty() && running_.front().ready_ns <= now) {
      const Running frame = running_.front();
      running_.pop_front();
      if (now - frame.ready_ns > 3 * period_ns(frame.exposure.exposure_us)) {
        count(&CameraServerCounts::n_overrun);
        continue;
      }
      finish_frame(frame);
    }
    while (is_streaming_ && !outgoing_.empty() && outgoing_.front().send_ns <= now) {
      const Outgoing frame = outgoing_.front();
      outgoing_.pop_front();
      send_frame(frame);
    }
  }

  void start_frame() {
    Running frame;
    frame.sequence = next_sequence_++;
    double jitter_us = 0.0;
    if (options_.faults.jitter_us > 0.0) {
      const double z = standard_normal(hash_key(options_.fault_seed, 11, frame.sequence));
      jitter_us = std::clamp(z, -3.0, 3.0) * options_.faults.jitter_us;
    }
    requested_us_.push_back(exposure_us_);
    if (static_cast<int>(requested_us_.size()) > options_.exposure_delay_frames + 1) {
      requested_us_.pop_front();
    }
    const double exposure_us = requested_us_.front();
    frame.exposure = {next_start_ns_ + std::llround(jitter_us * 1e3), exposure_us, gain_db_};
    const std::int64_t end = camera_.end_ns(frame.exposure);
    frame.ready_ns = camera_.read_out_ns(frame.exposure) + kTransferNs;
    running_.push_back(frame);
    if (light_.strobe) {
      announce_strobe(frame.sequence, end);
    }
    next_start_ns_ += period_ns(exposure_us);
  }

  /// The edge at the exposure's end, unless a fault removes it or adds one before it. Never
  /// both close together: that is undetectable for the step counter
  /// (capture/sequencer/strobe_proof.h).
  void announce_strobe(std::uint64_t sequence, std::int64_t end_ns) {
    const double u = uniform_unit(hash_key(options_.fault_seed, 13, sequence));
    const bool may_fail = sequence >= next_strobe_fault_;
    if (may_fail && u < options_.strobe_lost_probability) {
      next_strobe_fault_ = sequence + 20;
      count(&CameraServerCounts::n_faults);
      return;
    }
    if (may_fail && u > 1.0 - options_.strobe_false_probability) {
      next_strobe_fault_ = sequence + 20;
      count(&CameraServerCounts::n_faults);
      const double where = uniform_unit(hash_key(options_.fault_seed, 14, sequence));
      light_.strobe(end_ns - static_cast<std::int64_t>(
                                 where * static_cast<double>(period_ns(exposure_us_))));
    }
    light_.strobe(end_ns);
  }

  [[nodiscard]] FrameFault fault_of(std::uint64_t sequence) const {
    const FrameFaults& f = options_.faults;
    double u = uniform_unit(hash_key(options_.fault_seed, 12, sequence));
    const std::array<std::pair<double, FrameFault>, 5> fractions = {
        {{f.late_fraction, FrameFault::late},
         {f.drop_fraction, FrameFault::drop},
         {f.duplicate_fraction, FrameFault::duplicate},
         {f.stale_fraction, FrameFault::stale},
         {f.swap_fraction, FrameFault::swap}}};
    for (const auto& [fraction, fault] : fractions) {
      if (u < fraction) {
        return fault;
      }
      u -= fraction;
    }
    return FrameFault::none;
  }

  void finish_frame(const Running& frame) {
    const FrameFault fault = fault_of(frame.sequence);
    if (fault != FrameFault::none) {
      count(&CameraServerCounts::n_faults);
    }
    if (fault == FrameFault::drop) {
      return;
    }
    const firmware_iface::LightHistory history = light_.history(
        camera_.history_begin_ns(frame.exposure), camera_.end_ns(frame.exposure));
    const LightSeen seen = camera_.look(history, frame.exposure);
    const bool is_doubtful = !seen.tag.is_mixed && static_cast<double>(frame.exposure.start_ns -
                                                                       seen.last_change_ns) <
                                                       options_.doubtful_us * 1e3;
    if (is_doubtful) {
      count(&CameraServerCounts::n_doubtful);
      return;
    }
    const auto free = std::find_if(buffers_.begin(), buffers_.end(),
                                   [](const Buffer& buffer) { return buffer.n_held == 0; });
    if (free == buffers_.end()) {
      count(&CameraServerCounts::n_no_buffer);
      return;
    }
    const ImageView<std::uint16_t> words(free->memory.words(), spec_.frame_height,
                                         spec_.frame_width, 1);
    const std::size_t n_words = static_cast<std::size_t>(spec_.frame_height) *
                                static_cast<std::size_t>(spec_.frame_width);
    if (options_.is_prepared) {
      take_prepared(seen, frame.sequence, words);
    } else if (fault == FrameFault::stale && !swapped_ && last_words_.size() == n_words) {
      // The pixels of a frame already sent: a buffer that was not refilled would hold different
      // ones.
      std::copy(last_words_.begin(), last_words_.end(), words.data());
    } else {
      camera_.take(history, frame.exposure, seen, noise_key(seen, frame.sequence), words);
      if (options_.faults.stale_fraction > 0.0) {
        last_words_.assign(words.data(), words.data() + n_words);
      }
    }
    if (seen.tag.is_mixed) {
      count(&CameraServerCounts::n_mixed);
    }
    free->sequence = frame.sequence;
    Outgoing out;
    out.header = state_header(capture::RemoteMessage::frame);
    out.header.sequence = frame.sequence;
    out.header.timestamp_ns = camera_.timestamp_ns(frame.exposure);
    out.header.flags = capture::kFrameMonotonic;
    out.header.exposure_us = static_cast<float>(frame.exposure.exposure_us);
    out.header.gain_db = static_cast<float>(frame.exposure.gain_db);
    out.buffer = static_cast<std::size_t>(free - buffers_.begin());
    out.send_ns = frame.ready_ns;
    if (fault == FrameFault::late) {
      out.send_ns += std::llround(options_.faults.late_ms * 1e6);
    }
    free->n_held = fault == FrameFault::duplicate ? 2 : 1;
    if (fault == FrameFault::swap && !swapped_) {
      swapped_ = out;  // waits for its successor
      return;
    }
    queue(out);
    if (fault == FrameFault::duplicate) {
      queue(out);
    }
    if (swapped_) {
      queue(*swapped_);
      swapped_.reset();
    }
  }

  /// Only what must differ from frame to frame: one word, and the tag.
  void take_prepared(const LightSeen& seen, std::uint64_t sequence,
                     ImageView<std::uint16_t> words) const {
    words(0, 0) = static_cast<std::uint16_t>(1 + sequence % 251);
    words(0, 1) = static_cast<std::uint16_t>(1 + (sequence / 251) % 251);
    camera_.write_tag(seen, words);
  }

  /// Frames leave in order: one after a late one is late too.
  void queue(Outgoing out) {
    if (!outgoing_.empty()) {
      out.send_ns = std::max(out.send_ns, outgoing_.back().send_ns);
    }
    outgoing_.push_back(out);
  }

  /// The noise of a clean frame depends on the pattern's tag and on how many clean frames of it
  /// came before: a repeated capture gives the same pixels, and no two frames are the same,
  /// even where a light is lit again.
  [[nodiscard]] std::uint64_t noise_key(const LightSeen& seen, std::uint64_t sequence) {
    if (seen.tag.is_mixed) {
      return hash_key(21, sequence);
    }
    return hash_key(22, seen.tag.tag, n_clean_[seen.tag.tag]++);
  }

  void send_frame(const Outgoing& frame) {
    Buffer& buffer = buffers_[frame.buffer];
    iovec part{const_cast<capture::RemoteHeader*>(&frame.header), sizeof frame.header};
    alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof(int))> control{};
    msghdr message{};
    message.msg_iov = &part;
    message.msg_iovlen = 1;
    message.msg_control = control.data();
    message.msg_controllen = control.size();
    cmsghdr* rights = CMSG_FIRSTHDR(&message);
    rights->cmsg_level = SOL_SOCKET;
    rights->cmsg_type = SCM_RIGHTS;
    rights->cmsg_len = CMSG_LEN(sizeof(int));
    const int fd = buffer.memory.fd();
    std::memcpy(CMSG_DATA(rights), &fd, sizeof fd);
    if (::sendmsg(client_.get(), &message, MSG_NOSIGNAL | MSG_DONTWAIT) >= 0) {
      count(&CameraServerCounts::n_delivered);
      return;
    }
    --buffer.n_held;
    if (errno == EAGAIN || errno == ETOOMANYREFS) {  // the client does not read
      count(&CameraServerCounts::n_no_buffer);
    } else {
      drop_client();
    }
  }

  CameraSpec spec_;
  CameraServerOptions options_;
  VirtualCamera camera_;
  LightSource light_;
  std::filesystem::path path_;
  Fd stop_;
  Fd pulse_;
  Fd cut_;
  Fd listen_;
  // Used by the camera's thread only.
  Fd client_;
  bool is_streaming_ = false;
  double exposure_us_ = 0.0;
  double gain_db_ = 0.0;
  double fps_ = 0.0;
  std::uint64_t next_sequence_ = 0;
  std::int64_t next_start_ns_ = kFar;
  capture::TriggerSource trigger_ = capture::TriggerSource::free;
  std::int64_t free_from_ns_ = 0;  ///< earlier triggers are ignored
  std::uint64_t next_strobe_fault_ = 0;
  std::deque<Running> running_;
  std::deque<double> requested_us_;  // at the start of the latest frames
  std::deque<Outgoing> outgoing_;
  std::optional<Outgoing> swapped_;
  std::vector<Buffer> buffers_;
  std::vector<std::uint16_t> last_words_;
  std::vector<std::uint16_t> noise_;                          ///< of prepared pictures
  std::unordered_map<std::uint32_t, std::uint64_t> n_clean_;  ///< frames, per tag
  // Shared.
  std::mutex pulses_mutex_;
  std::deque<std::int64_t> pulses_;
  mutable std::mutex counts_mutex_;
  CameraServerCounts counts_;
  std::atomic<std::int64_t> first_frame_ns_{0};
  std::jthread thread_;
};

CameraServer::CameraServer(const CameraSpec& spec, const ControllerSpec& controller,
                           const Transport& transport, LightSource light,
                           std::filesystem::path socket, const CameraServerOptions& options)
    : impl_(std::make_unique<Impl>(spec, controller, transport, std::move(light),
                                   std::move(socket), options)) {}
CameraServer::~CameraServer() = default;
const std::filesystem::path& CameraServer::socket() const { return impl_->path(); }
CameraServerCounts CameraServer::counts() const { return impl_->counts(); }
std::optional<std::int64_t> CameraServer::first_frame_ns() const {
  return impl_->first_frame_ns();
}
void CameraServer::trigger_line(std::int64_t t_ns) { impl_->trigger_line(t_ns); }
void CameraServer::disconnect_client() { impl_->cut_client(); }

}  // namespace haarlight::sim
