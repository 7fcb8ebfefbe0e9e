// SPDX-License-Identifier: Apache-2.0
#include "sim/controller_server.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <deque>
#include <list>
#include <mutex>
#include <optional>
#include <system_error>
#include <thread>
#include <type_traits>
#include <vector>

#include <arpa/inet.h>
#include <fcntl.h>
#include <fmt/format.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <pty.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <termios.h>
#include <unistd.h>

#include "firmware_iface/modbus_frame.h"
#include "firmware_iface/modbus_request.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"

namespace haarlight::sim {

namespace {

using namespace std::chrono_literals;

constexpr int kBitsPerByte = 11;  // start, 8 data, parity, stop
constexpr int kMaxConnections = 16;
constexpr std::int64_t kRtuPauseNs = 50'000'000;  // then an unfinished request is discarded
constexpr std::uint8_t kAnyUnit = 255;            // TCP: "the device itself"

std::int64_t now_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

[[noreturn]] void throw_os_error(const std::string& operation, const std::string& where) {
  const int error = errno;
  throw Error(fmt::format("{}: {}", operation, std::generic_category().message(error)), where,
              "choose a free port, or 0 for any", ExitCode::unavailable);
}

/// Waits for input on `fd` (-1: only for time or the stop). Returns false when stopping.
bool wait_for_input(int fd, int stop_fd, std::int64_t until_ns, bool& is_ready) {
  is_ready = false;
  const std::int64_t left = until_ns < 0 ? -1 : std::max<std::int64_t>(until_ns - now_ns(), 0);
  const timespec timeout{left / 1'000'000'000, left % 1'000'000'000};
  std::array<pollfd, 2> fds = {pollfd{stop_fd, POLLIN, 0}, pollfd{fd, POLLIN, 0}};
  const int n = ::ppoll(fds.data(), fds.size(), left < 0 ? nullptr : &timeout, nullptr);
  if (n > 0 && fds[0].revents != 0) {
    return false;
  }
  is_ready = n > 0 && fds[1].revents != 0;
  return true;
}

}  // namespace

class ControllerServer::Impl {
 public:
  explicit Impl(ControllerServerOptions options)
      : options_(std::move(options)),
        controller_(options_.controller, options_.first_boot_id, now_ns()),
        stop_(::eventfd(0, EFD_CLOEXEC)),
        tcp_wake_(::eventfd(0, EFD_CLOEXEC)),
        rtu_wake_(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
    if (!stop_.is_open() || !tcp_wake_.is_open() || !rtu_wake_.is_open()) {
      throw_os_error("eventfd", "controller server");
    }
    if (options_.has_tcp) {
      listen_tcp(options_.tcp_port);
    }
    if (options_.has_rtu) {
      std::string folder = std::filesystem::temp_directory_path() / "haarlight-rtu-XXXXXX";
      if (::mkdtemp(folder.data()) == nullptr) {
        throw_os_error("mkdtemp", folder);
      }
      rtu_folder_ = folder;
      open_line();
    }
    if (options_.has_tcp) {
      accept_thread_ = std::jthread([this] { serve_accept(); });
    }
    if (options_.has_rtu) {
      rtu_thread_ = std::jthread([this] { serve_rtu(); });
    }
  }

  ~Impl() {
    signal(stop_);
    if (accept_thread_.joinable()) {
      accept_thread_.join();
    }
    if (rtu_thread_.joinable()) {
      rtu_thread_.join();
    }
    connections_.clear();  // joins
    if (!rtu_folder_.empty()) {
      std::error_code ignored;
      std::filesystem::remove_all(rtu_folder_, ignored);
    }
  }
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  [[nodiscard]] int port() const { return port_; }
  [[nodiscard]] const ControllerServerOptions& options() const { return options_; }
  [[nodiscard]] std::filesystem::path rtu_path() const { return rtu_folder_ / "controller"; }
  [[nodiscard]] std::uint64_t n_requests() const { return n_requests_.load(); }

  template <class Function>
  auto with_controller(Function function) {
    const std::lock_guard lock(controller_mutex_);
    const std::int64_t t = now_ns();
    // Lease and thermal cuts happen at their own times however late they are queried, so no
    // thread has to wait for them.
    while (!strobes_.empty() && strobes_.front() <= t) {
      controller_.strobe(strobes_.front());
      strobes_.pop_front();
    }
    controller_.advance(t);
    if constexpr (std::is_void_v<std::invoke_result_t<
                      Function, firmware_iface::LightController&, std::int64_t>>) {
      function(controller_, t);
      pass_trigger();
    } else {
      auto result = function(controller_, t);
      pass_trigger();
      return result;
    }
  }

  void strobe_at(std::int64_t t_ns) {
    const std::lock_guard lock(controller_mutex_);
    strobes_.insert(std::upper_bound(strobes_.begin(), strobes_.end(), t_ns), t_ns);
  }

  void restart(std::chrono::milliseconds off_for) {
    off_until_ns_.store(now_ns() + off_for.count() * 1'000'000);
    with_controller([](firmware_iface::LightController& c, std::int64_t t) {
      c.reboot(c.boot_id() + 1, t);
      return 0;
    });
    {
      const std::lock_guard lock(connections_mutex_);
      for (Connection& connection : connections_) {
        ::shutdown(connection.fd.get(), SHUT_RDWR);
      }
    }
    signal(tcp_wake_);
  }

  void unplug() {
    const std::lock_guard lock(line_mutex_);
    line_master_.reset();
    line_slave_.reset();
    std::error_code ignored;
    std::filesystem::remove(rtu_path(), ignored);
    signal(rtu_wake_);
  }

  void replug() {
    const std::lock_guard lock(line_mutex_);
    open_line();
    signal(rtu_wake_);
  }

  void set_reply_delay(std::chrono::microseconds delay) {
    reply_delay_ns_.store(delay.count() * 1000);
  }

  WireExchange exchange(std::span<const std::uint8_t> pdu) {
    if (now_ns() < off_until_ns_.load()) {
      ++n_requests_;
      return {};
    }
    const int function = pdu.empty() ? 0 : pdu[0];
    WireExchange exchanged{.fault = next_fault(function)};
    if (is_fault(exchanged.fault, WireFault::drop_request)) {
      ++n_requests_;
      return exchanged;
    }
    if (is_fault(exchanged.fault, WireFault::exception)) {
      ++n_requests_;
      exchanged.pdu = firmware_iface::exception_reply(static_cast<std::uint8_t>(function),
                                                      exchanged.fault->exception);
    } else {
      exchanged.pdu =
          with_controller([this, pdu](firmware_iface::LightController& c, std::int64_t t) {
            auto reply = firmware_iface::answer_request(c, pdu, t);
            ++n_requests_;
            return reply;
          });
    }
    exchanged.delay = std::chrono::nanoseconds(reply_delay_ns_.load());
    if (is_fault(exchanged.fault, WireFault::delay_reply)) {
      exchanged.delay += exchanged.fault->delay;
    }
    return exchanged;
  }

  void inject(const WireFaultRule& rule) {
    const std::lock_guard lock(rules_mutex_);
    rules_.push_back(rule);
  }
  void clear_faults() {
    const std::lock_guard lock(rules_mutex_);
    rules_.clear();
  }

 private:
  void pass_trigger() {
    if (controller_.n_triggers() != n_triggers_) {
      n_triggers_ = controller_.n_triggers();
      if (options_.trigger) {
        options_.trigger(controller_.last_trigger_ns());
      }
    }
  }

  struct Connection {
    Fd fd;
    std::atomic<bool> is_done{false};
    std::jthread thread;
  };

  static void signal(const Fd& event) {
    const std::uint64_t one = 1;
    [[maybe_unused]] const ssize_t n = ::write(event.get(), &one, sizeof one);
  }
  static void drain(const Fd& event) {
    std::uint64_t count = 0;
    [[maybe_unused]] const ssize_t n = ::read(event.get(), &count, sizeof count);
  }

  /// False when stopping.
  [[nodiscard]] bool sleep_until(std::int64_t until_ns) const {
    bool is_ready = false;
    while (now_ns() < until_ns) {
      if (!wait_for_input(-1, stop_.get(), until_ns, is_ready)) {
        return false;
      }
    }
    return true;
  }

  [[nodiscard]] std::optional<WireFaultRule> next_fault(int function) {
    const std::lock_guard lock(rules_mutex_);
    for (WireFaultRule& rule : rules_) {
      if (rule.count == 0 || (rule.function != 0 && rule.function != function)) {
        continue;
      }
      if (rule.skip > 0) {
        --rule.skip;
        continue;
      }
      if (rule.count > 0) {
        --rule.count;
      }
      return rule;
    }
    return std::nullopt;
  }

  /// What is sent back on the wire, and how.
  struct Reply {
    std::vector<std::uint8_t> pdu;  ///< empty: nothing
    std::optional<WireFaultRule> fault;
    bool is_slept = true;  ///< false: stopping
  };

  Reply answer(const firmware_iface::ModbusRequest& request) {
    const std::int64_t busy_ns = with_controller(
        [](firmware_iface::LightController& c, std::int64_t) { return c.busy_until_ns(); });
    if (!sleep_until(busy_ns)) {
      return {.pdu = {}, .fault = {}, .is_slept = false};
    }
    WireExchange exchanged = exchange(request.pdu);
    const bool is_slept =
        exchanged.delay.count() == 0 || sleep_until(now_ns() + exchanged.delay.count());
    return {std::move(exchanged.pdu), exchanged.fault, is_slept};
  }

  /// The bytes of a reply after its fault is applied; empty for silence.
  static std::vector<std::uint8_t> spoil(std::vector<std::uint8_t> frame,
                                         const std::optional<WireFaultRule>& fault) {
    if (!fault) {
      return frame;
    }
    switch (fault->kind) {
      case WireFault::drop_request:
      case WireFault::drop_reply:
      case WireFault::close:
        return {};
      case WireFault::half_reply:
        frame.resize(frame.size() / 2);
        return frame;
      case WireFault::garbage_reply:
        for (std::size_t i = 0; i < frame.size(); ++i) {
          frame[i] = static_cast<std::uint8_t>(0xA5U ^ (i * 37U));
        }
        return frame;
      case WireFault::delay_reply:
      case WireFault::wrong_unit:
      case WireFault::wrong_transaction:
      case WireFault::exception:
        return frame;
    }
    return frame;
  }

  static bool is_fault(const std::optional<WireFaultRule>& fault, WireFault kind) {
    return fault.has_value() && fault->kind == kind;
  }

  // ---- TCP ----

  void listen_tcp(int port) {
    const std::string where = fmt::format("127.0.0.1:{}", port);
    Fd fd(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
    const int on = 1;
    ::setsockopt(fd.get(), SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<std::uint16_t>(port));
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof address;
    if (!fd.is_open() ||
        ::bind(fd.get(), reinterpret_cast<const sockaddr*>(&address), size) != 0 ||
        ::listen(fd.get(), kMaxConnections) != 0 ||
        ::getsockname(fd.get(), reinterpret_cast<sockaddr*>(&address), &size) != 0) {
      throw_os_error("listening for Modbus TCP", where);
    }
    port_ = ntohs(address.sin_port);
    listener_ = std::move(fd);
  }

  void serve_accept() {
    for (;;) {
      std::array<pollfd, 3> fds = {pollfd{stop_.get(), POLLIN, 0},
                                   pollfd{tcp_wake_.get(), POLLIN, 0},
                                   pollfd{listener_.get(), POLLIN, 0}};
      ::poll(fds.data(), fds.size(), -1);
      if (fds[0].revents != 0) {
        close_connections();
        return;
      }
      if (fds[1].revents != 0) {
        drain(tcp_wake_);
        listener_.reset();
        close_connections();
        if (!sleep_until(off_until_ns_.load()) || !listen_again()) {
          return;
        }
        continue;
      }
      if ((fds[2].revents & POLLIN) == 0) {
        continue;
      }
      Fd fd(::accept4(listener_.get(), nullptr, nullptr, SOCK_CLOEXEC));
      if (fd.is_open() && now_ns() >= off_until_ns_.load()) {
        add_connection(std::move(fd));
      }
    }
  }

  /// Listens on the same port again; false when stopping.
  bool listen_again() {
    for (;;) {
      try {
        listen_tcp(port_);
        return true;
      } catch (const Error&) {
        // Another program took the port for a moment: the device is simply not back yet.
        if (!sleep_until(now_ns() + 20'000'000)) {
          return false;
        }
      }
    }
  }

  void add_connection(Fd fd) {
    const int on = 1;
    ::setsockopt(fd.get(), IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    const std::lock_guard lock(connections_mutex_);
    connections_.remove_if([](const Connection& c) { return c.is_done.load(); });
    if (connections_.size() >= kMaxConnections) {
      return;
    }
    Connection& connection = connections_.emplace_back();
    connection.fd = std::move(fd);
    connection.thread = std::jthread([this, &connection] {
      serve_connection(connection.fd.get());
      ::shutdown(connection.fd.get(), SHUT_RDWR);
      connection.is_done.store(true);
    });
  }

  void close_connections() {
    const std::lock_guard lock(connections_mutex_);
    for (Connection& connection : connections_) {
      ::shutdown(connection.fd.get(), SHUT_RDWR);
    }
  }

  void serve_connection(int fd) {
    std::vector<std::uint8_t> bytes;
    for (;;) {
      bool is_ready = false;
      if (!wait_for_input(fd, stop_.get(), -1, is_ready)) {
        return;
      }
      std::array<std::uint8_t, 512> chunk{};
      const ssize_t n = ::recv(fd, chunk.data(), chunk.size(), 0);
      if (n <= 0) {
        return;
      }
      bytes.insert(bytes.end(), chunk.begin(), chunk.begin() + n);
      for (;;) {
        const firmware_iface::FrameScan scan = firmware_iface::scan_tcp_request(bytes);
        if (scan.verdict == firmware_iface::ScanVerdict::need_more) {
          break;
        }
        if (scan.verdict == firmware_iface::ScanVerdict::broken ||
            !answer_tcp(fd, scan.request)) {
          return;
        }
        bytes.erase(bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(scan.n_bytes));
      }
    }
  }

  /// False when the connection must end.
  bool answer_tcp(int fd, const firmware_iface::ModbusRequest& request) {
    Reply reply;
    if (request.unit == options_.unit || request.unit == 0 || request.unit == kAnyUnit) {
      reply = answer(request);
    } else {
      reply.pdu = firmware_iface::exception_reply(
          request.pdu[0], firmware_iface::registers::Exception::gateway_target);
    }
    if (!reply.is_slept || is_fault(reply.fault, WireFault::close)) {
      return false;
    }
    if (reply.pdu.empty()) {
      return true;
    }
    const auto transaction = static_cast<std::uint16_t>(
        request.transaction + (is_fault(reply.fault, WireFault::wrong_transaction) ? 1 : 0));
    const auto unit = static_cast<std::uint8_t>(
        request.unit + (is_fault(reply.fault, WireFault::wrong_unit) ? 1 : 0));
    const auto frame =
        spoil(firmware_iface::frame_tcp(transaction, unit, reply.pdu), reply.fault);
    return frame.empty() || ::send(fd, frame.data(), frame.size(), MSG_NOSIGNAL) ==
                                static_cast<ssize_t>(frame.size());
  }

  // ---- RTU ----

  /// A new pseudo-terminal behind the link. line_mutex_ is held, or no thread runs yet.
  void open_line() {
    int master = -1;
    int slave = -1;
    std::array<char, 128> name{};
    termios settings{};
    if (::openpty(&master, &slave, name.data(), nullptr, nullptr) != 0) {
      throw_os_error("openpty", "controller server");
    }
    line_master_.reset(master);
    line_slave_.reset(slave);  // held open: a master without any slave reports a hang-up
    ::tcgetattr(slave, &settings);
    ::cfmakeraw(&settings);
    ::tcsetattr(slave, TCSANOW, &settings);
    ::fcntl(master, F_SETFD, FD_CLOEXEC);
    ::fcntl(slave, F_SETFD, FD_CLOEXEC);
    ::fcntl(master, F_SETFL, O_NONBLOCK);
    const std::filesystem::path fresh = rtu_folder_ / "controller.new";
    std::filesystem::create_symlink(name.data(), fresh);
    std::filesystem::rename(fresh, rtu_path());
  }

  [[nodiscard]] std::int64_t wire_ns(std::size_t n_bytes) const {
    return options_.baud <= 0 ? 0
                              : static_cast<std::int64_t>(n_bytes) * kBitsPerByte *
                                    1'000'000'000 / options_.baud;
  }

  void serve_rtu() {
    std::vector<std::uint8_t> bytes;
    std::int64_t first_byte_ns = 0;
    for (;;) {
      // The line may be replaced at any time: a duplicate keeps the number from being reused.
      Fd line;
      {
        const std::lock_guard lock(line_mutex_);
        if (line_master_.is_open()) {
          line.reset(::fcntl(line_master_.get(), F_DUPFD_CLOEXEC, 0));
        }
      }
      bytes.clear();
      for (;;) {
        std::array<pollfd, 3> fds = {pollfd{stop_.get(), POLLIN, 0},
                                     pollfd{rtu_wake_.get(), POLLIN, 0},
                                     pollfd{line.get(), POLLIN, 0}};
        const int pause_ms = bytes.empty() ? -1 : static_cast<int>(kRtuPauseNs / 1'000'000);
        const int n = ::poll(fds.data(), fds.size(), pause_ms);
        if (fds[0].revents != 0) {
          return;
        }
        if (fds[1].revents != 0) {
          drain(rtu_wake_);
          break;
        }
        if (n == 0) {
          bytes.clear();
          continue;
        }
        std::array<std::uint8_t, 512> chunk{};
        const ssize_t got = ::read(line.get(), chunk.data(), chunk.size());
        if (got <= 0) {
          continue;
        }
        if (bytes.empty()) {
          first_byte_ns = now_ns();
        }
        bytes.insert(bytes.end(), chunk.begin(), chunk.begin() + got);
        for (firmware_iface::FrameScan scan = firmware_iface::scan_rtu_request(bytes);
             scan.verdict != firmware_iface::ScanVerdict::need_more;
             scan = firmware_iface::scan_rtu_request(bytes)) {
          if (scan.verdict == firmware_iface::ScanVerdict::broken) {
            bytes.clear();  // until the pause; a real device does not answer noise
            break;
          }
          if (!sleep_until(first_byte_ns + wire_ns(scan.n_bytes)) ||
              !answer_rtu(line.get(), scan.request)) {
            return;
          }
          bytes.erase(bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(scan.n_bytes));
          first_byte_ns = now_ns();
        }
      }
    }
  }

  /// False when stopping.
  bool answer_rtu(int line, const firmware_iface::ModbusRequest& request) {
    if (request.unit != options_.unit) {
      return true;  // another device's request on the bus
    }
    const Reply reply = answer(request);
    if (!reply.is_slept) {
      return false;
    }
    if (is_fault(reply.fault, WireFault::close)) {
      unplug();
      return true;
    }
    if (reply.pdu.empty()) {
      return true;
    }
    const auto unit = static_cast<std::uint8_t>(
        request.unit + (is_fault(reply.fault, WireFault::wrong_unit) ? 1 : 0));
    return write_paced(line, spoil(firmware_iface::frame_rtu(unit, reply.pdu), reply.fault));
  }

  /// Writes bytes to the line when the last of their bits would have been sent, a millisecond's
  /// worth at a time. False when stopping.
  bool write_paced(int line, const std::vector<std::uint8_t>& frame) {
    const std::size_t slice =
        options_.baud <= 0 ? frame.size()
                           : std::max<std::size_t>(1, static_cast<std::size_t>(options_.baud) /
                                                          (std::size_t{kBitsPerByte} * 1000));
    const std::int64_t start_ns = now_ns();
    for (std::size_t sent = 0; sent < frame.size();) {
      const std::size_t n = std::min(slice, frame.size() - sent);
      if (!sleep_until(start_ns + wire_ns(sent + n))) {
        return false;
      }
      if (::write(line, frame.data() + sent, n) != static_cast<ssize_t>(n)) {
        return true;  // without a reader the bytes are lost, as on a real line
      }
      sent += n;
    }
    return true;
  }

  ControllerServerOptions options_;
  std::mutex controller_mutex_;
  firmware_iface::LightController controller_;
  std::deque<std::int64_t> strobes_;  ///< to come, in order
  std::uint64_t n_triggers_ = 0;
  std::atomic<std::uint64_t> n_requests_{0};
  std::atomic<std::int64_t> off_until_ns_{0};
  std::atomic<std::int64_t> reply_delay_ns_{0};
  std::mutex rules_mutex_;
  std::vector<WireFaultRule> rules_;
  Fd stop_;
  Fd tcp_wake_;
  Fd rtu_wake_;
  int port_ = 0;
  Fd listener_;  // the accept thread's
  std::mutex connections_mutex_;
  std::list<Connection> connections_;
  std::filesystem::path rtu_folder_;
  std::mutex line_mutex_;
  Fd line_master_;
  Fd line_slave_;
  std::jthread accept_thread_;
  std::jthread rtu_thread_;
};

ControllerServer::ControllerServer(ControllerServerOptions options)
    : impl_(std::make_unique<Impl>(std::move(options))) {}
ControllerServer::~ControllerServer() = default;

std::string ControllerServer::tcp_address() const {
  return fmt::format("127.0.0.1:{}", impl_->port());
}
std::filesystem::path ControllerServer::rtu_path() const { return impl_->rtu_path(); }
std::string ControllerServer::rtu_address() const {
  const int baud = impl_->options().baud > 0 ? impl_->options().baud : 115200;
  return fmt::format("{}:{}", impl_->rtu_path().string(), baud);
}

WireExchange ControllerServer::exchange(std::span<const std::uint8_t> pdu) {
  return impl_->exchange(pdu);
}
void ControllerServer::all_off() {
  impl_->with_controller([](firmware_iface::LightController& c, std::int64_t t) {
    const std::array<std::uint16_t, 1> word = {firmware_iface::registers::kAct};
    return c.write_holding(firmware_iface::registers::holding::kAllOff, word, t);
  });
}
std::vector<std::uint16_t> ControllerServer::identity() {
  std::vector<std::uint16_t> words(firmware_iface::registers::input::kIdentityCount);
  impl_->with_controller([&words](firmware_iface::LightController& c, std::int64_t t) {
    return c.read_input(firmware_iface::registers::input::kMagic, words, t);
  });
  return words;
}

firmware_iface::LightHistory ControllerServer::transitions(std::int64_t t0_ns,
                                                           std::int64_t t1_ns) {
  return impl_->with_controller([=](firmware_iface::LightController& c, std::int64_t) {
    return c.transitions(t0_ns, t1_ns);
  });
}
firmware_iface::LightTransition ControllerServer::lit() {
  return impl_->with_controller(
      [](firmware_iface::LightController& c, std::int64_t) { return c.lit(); });
}
double ControllerServer::total_on_seconds(int element) {
  return impl_->with_controller([=](firmware_iface::LightController& c, std::int64_t) {
    return c.total_on_seconds(element);
  });
}
std::uint32_t ControllerServer::boot_id() {
  return impl_->with_controller(
      [](firmware_iface::LightController& c, std::int64_t) { return c.boot_id(); });
}
std::uint64_t ControllerServer::n_requests() const { return impl_->n_requests(); }

void ControllerServer::strobe() {
  impl_->with_controller([](firmware_iface::LightController& c, std::int64_t t) {
    c.strobe(t);
    return 0;
  });
}
void ControllerServer::strobe_at(std::int64_t t_ns) { impl_->strobe_at(t_ns); }
void ControllerServer::restart(std::chrono::milliseconds off_for) { impl_->restart(off_for); }
void ControllerServer::set_interlock_open(bool is_open) {
  impl_->with_controller([=](firmware_iface::LightController& c, std::int64_t t) {
    c.set_interlock_open(is_open, t);
    return 0;
  });
}
void ControllerServer::set_temperature(double temperature_c) {
  impl_->with_controller([=](firmware_iface::LightController& c, std::int64_t t) {
    c.set_temperature(temperature_c, t);
    return 0;
  });
}
void ControllerServer::set_late_acting(const firmware_iface::LateActing& late) {
  impl_->with_controller([&late](firmware_iface::LightController& c, std::int64_t) {
    c.set_late_acting(late);
    return 0;
  });
}
void ControllerServer::unplug_rtu() { impl_->unplug(); }
void ControllerServer::replug_rtu() { impl_->replug(); }
void ControllerServer::set_reply_delay(std::chrono::microseconds delay) {
  impl_->set_reply_delay(delay);
}
void ControllerServer::inject(const WireFaultRule& rule) { impl_->inject(rule); }
void ControllerServer::clear_faults() { impl_->clear_faults(); }

}  // namespace haarlight::sim
