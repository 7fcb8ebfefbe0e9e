// SPDX-License-Identifier: Apache-2.0
#include "firmware_iface/modbus_bus.h"

#include <algorithm>
#include <array>
#include <cerrno>
#include <system_error>

#include <fcntl.h>
#include <fmt/format.h>
#include <modbus.h>
#include <poll.h>
#include <sys/file.h>
#include <sys/ioctl.h>
#include <sys/select.h>
#include <termios.h>
#include <unistd.h>

#include "core/log.h"
#include "firmware_iface/register_light_array.h"
#include "firmware_iface/serial_ports.h"
#include "haarlight/core/files.h"

namespace haarlight::firmware_iface {

namespace {

using registers::Exception;

constexpr int kBitsPerByte = 11;  // start, 8 data, parity or second stop, stop
constexpr std::int64_t kNsPerMs = 1'000'000;
constexpr int kQuietPollMs = 20;
constexpr int kLongestSettle = 3;                 // times the quiet time: then the line is
                                                  // babbling
constexpr std::size_t kReadRequestBytes = 8;      // RTU: unit, function, address, count, CRC
constexpr std::size_t kReadReplyOverhead = 5;     // unit, function, byte count, CRC
constexpr std::size_t kWriteRequestOverhead = 9;  // unit, function, address, count, bytes, CRC
constexpr std::size_t kWriteReplyBytes = 8;

struct ModbusClose {
  void operator()(modbus_t* m) const noexcept {
    modbus_close(m);
    modbus_free(m);
  }
};
using ModbusHandle = std::unique_ptr<modbus_t, ModbusClose>;

/// The exception code corresponding to a libmodbus errno; none when there is none.
Exception exception_of(int error) {
  switch (error) {
    case EMBXILFUN:
      return Exception::illegal_function;
    case EMBXILADD:
      return Exception::illegal_address;
    case EMBXILVAL:
      return Exception::illegal_value;
    case EMBXSFAIL:
      return Exception::device_failure;
    case EMBXSBUSY:
      return Exception::busy;
    case EMBXMEMPAR:
      return Exception::bank_sum;
    case EMBXGPATH:
    case EMBXGTAR:
      return Exception::gateway_target;
    default:
      return Exception::none;
  }
}

Errc code_of(int error) {
  switch (error) {
    case ETIMEDOUT:
    case EAGAIN:
    case EINPROGRESS:
      return Errc::timeout;
    case EACCES:
    case EPERM:
    case EBUSY:
      return Errc::device_busy;
    case EIO:
    case ECONNRESET:
    case ECONNREFUSED:
    case ECONNABORTED:
    case EPIPE:
    case EBADF:
    case ENODEV:
    case ENXIO:
    case ENOENT:
    case ENOTCONN:
    case EHOSTUNREACH:
    case ENETUNREACH:
    case ENETDOWN:
      return Errc::device_gone;
    default:
      // EMBBADCRC, EMBBADDATA, EMBBADEXC, EMBUNKEXC, EMBMDATA, EMBBADSLAVE, EMBXACK, EMBXNACK
      return error >= MODBUS_ENOBASE ? Errc::protocol : Errc::io;
  }
}

/// What both kinds have in common: requests, deadlines, and the check for unsolicited bytes.
class ModbusBus : public RegisterBus {
 public:
  ModbusBus(int unit, ModbusTiming timing) : unit_(unit), timing_(timing) {}

  void close() noexcept override {
    handle_.reset();
    leave_line();
  }

  [[nodiscard]] Result<void> open() override {
    close();
    // libmodbus waits by select(), which writes out of bounds for large descriptors.
    const Fd probe(::open("/dev/null", O_RDONLY | O_CLOEXEC));
    if (!probe.is_open() || probe.get() >= FD_SETSIZE - 1) {
      return fail(Errc::io,
                  fmt::format("{}: no file descriptor below {} is free", name(), FD_SETSIZE));
    }
    ModbusHandle handle(make_context());
    if (!handle) {
      return open_fault(errno);
    }
    modbus_t* m = handle.get();
    modbus_set_error_recovery(m, MODBUS_ERROR_RECOVERY_NONE);
    if (modbus_set_slave(m, unit_) != 0) {
      return fail(Errc::unsupported, fmt::format("{}: unit {} is not 1 to 247", name(), unit_));
    }
    set_response_timeout(m, timing_.connect.count() * kNsPerMs);
    const std::int64_t turnaround_us = timing_.turnaround.count() * 1000;
    modbus_set_byte_timeout(m, static_cast<std::uint32_t>(turnaround_us / 1'000'000),
                            static_cast<std::uint32_t>(turnaround_us % 1'000'000));
    if (auto own = take_line(); !own) {
      return own;
    }
    if (modbus_connect(m) != 0) {
      auto fault = open_fault(errno);
      leave_line();
      return fault;
    }
    handle_ = std::move(handle);
    trouble_ns_ = 0;
    opened(modbus_get_socket(m));
    modbus_flush(m);
    return {};
  }

  [[nodiscard]] Result<Exception> read_input(std::uint16_t first,
                                             std::span<std::uint16_t> words) override {
    HAARLIGHT_EXPECTS(!words.empty() && words.size() <= registers::kMaxRegistersRead,
                      "one request's worth of registers");
    return request("reading input registers", words.size(), kReadRequestBytes,
                   kReadReplyOverhead + 2 * words.size(), [&](modbus_t* m) {
                     return modbus_read_input_registers(
                         m, first, static_cast<int>(words.size()), words.data());
                   });
  }

  [[nodiscard]] Result<Exception> read_holding(std::uint16_t first,
                                               std::span<std::uint16_t> words) override {
    HAARLIGHT_EXPECTS(!words.empty() && words.size() <= registers::kMaxRegistersRead,
                      "one request's worth of registers");
    return request("reading holding registers", words.size(), kReadRequestBytes,
                   kReadReplyOverhead + 2 * words.size(), [&](modbus_t* m) {
                     return modbus_read_registers(m, first, static_cast<int>(words.size()),
                                                  words.data());
                   });
  }

  [[nodiscard]] Result<Exception> write_holding(std::uint16_t first,
                                                std::span<const std::uint16_t> words) override {
    HAARLIGHT_EXPECTS(!words.empty() && words.size() <= registers::kMaxRegistersWritten,
                      "one request's worth of registers");
    return request("writing registers", words.size(), kWriteRequestOverhead + 2 * words.size(),
                   kWriteReplyBytes, [&](modbus_t* m) {
                     return modbus_write_registers(m, first, static_cast<int>(words.size()),
                                                   words.data());
                   });
  }

  [[nodiscard]] Result<Exception> write_coils(std::uint16_t first,
                                              std::span<const std::uint8_t> bits) override {
    HAARLIGHT_EXPECTS(!bits.empty() && bits.size() <= registers::kMaxCoilsWritten,
                      "one request's worth of bits");
    return request(
        "writing on bits", bits.size(), kWriteRequestOverhead + (bits.size() + 7) / 8,
        kWriteReplyBytes, [&](modbus_t* m) {
          return modbus_write_bits(m, first, static_cast<int>(bits.size()), bits.data());
        });
  }

  [[nodiscard]] Result<Exception> read_coils(std::uint16_t first,
                                             std::span<std::uint8_t> bits) override {
    HAARLIGHT_EXPECTS(!bits.empty() && bits.size() <= registers::kMaxCoilsRead,
                      "one request's worth of bits");
    return request("reading coils", bits.size(), kReadRequestBytes,
                   kReadReplyOverhead + (bits.size() + 7) / 8, [&](modbus_t* m) {
                     return modbus_read_bits(m, first, static_cast<int>(bits.size()),
                                             bits.data());
                   });
  }

  [[nodiscard]] Result<Exception> write_coil(std::uint16_t address, bool is_on) override {
    return request("writing one coil", 1, kWriteReplyBytes, kWriteReplyBytes,
                   [&](modbus_t* m) { return modbus_write_bit(m, address, is_on ? 1 : 0); });
  }

  [[nodiscard]] Result<Exception> write_register(std::uint16_t address,
                                                 std::uint16_t value) override {
    return request("writing one register", 1, kWriteReplyBytes, kWriteReplyBytes,
                   [&](modbus_t* m) { return modbus_write_register(m, address, value); });
  }

 protected:
  /// A new context, or null with errno set.
  [[nodiscard]] virtual modbus_t* make_context() const = 0;
  /// Transmission time of `n_bytes`.
  [[nodiscard]] virtual std::int64_t wire_ns(std::size_t n_bytes) const = 0;
  /// Claims the line for us alone, before libmodbus opens it. Faults device_busy, device_gone.
  [[nodiscard]] virtual Result<void> take_line() { return {}; }
  virtual void leave_line() noexcept {}
  virtual void opened(int fd) = 0;

  [[nodiscard]] modbus_t* handle() const { return handle_.get(); }
  [[nodiscard]] const ModbusTiming& timing() const { return timing_; }
  /// When a fault was last seen; 0 = the line is trusted.
  [[nodiscard]] std::int64_t trouble_ns() const { return trouble_ns_; }
  void trust_line() { trouble_ns_ = 0; }

  [[nodiscard]] tl::unexpected<Fault> open_fault(int error) const {
    const Errc code =
        code_of(error) == Errc::device_busy ? Errc::device_busy : Errc::device_gone;
    return fail(code, fmt::format("{}: opening: {}", name(), modbus_strerror(error)), error);
  }

  [[nodiscard]] tl::unexpected<Fault> fault(const char* operation, int error) {
    trouble_ns_ = monotonic_now_ns();
    return fail(code_of(error),
                fmt::format("{}: {}: {}", name(), operation, modbus_strerror(error)), error);
  }

 private:
  static void set_response_timeout(modbus_t* m, std::int64_t timeout_ns) {
    const std::int64_t us = std::max<std::int64_t>(timeout_ns / 1000, 1);
    modbus_set_response_timeout(m, static_cast<std::uint32_t>(us / 1'000'000),
                                static_cast<std::uint32_t>(us % 1'000'000));
  }

  /// 0 when the line is silent, otherwise an errno: unsolicited bytes are a late or duplicate
  /// answer, end of file is a lost link.
  [[nodiscard]] int check_silence() const {
    const int fd = modbus_get_socket(handle_.get());
    pollfd line{fd, POLLIN, 0};
    if (::poll(&line, 1, 0) <= 0) {
      return 0;
    }
    if ((line.revents & POLLNVAL) != 0) {
      return EBADF;
    }
    int n_waiting = 0;
    if (::ioctl(fd, FIONREAD, &n_waiting) == 0 && n_waiting > 0) {
      return EMBBADDATA;
    }
    return (line.revents & (POLLHUP | POLLERR | POLLIN)) != 0 ? ECONNRESET : 0;
  }

  template <class Call>
  Result<Exception> request(const char* operation, std::size_t n, std::size_t request_bytes,
                            std::size_t reply_bytes, Call call) {
    if (!handle_) {
      return fail(Errc::device_gone, name() + ": not open", ENOTCONN);
    }
    if (trouble_ns_ != 0) {
      return fail(Errc::protocol, name() + ": the line is not trusted after a fault");
    }
    if (const int error = check_silence(); error != 0) {
      return fault(operation, error);
    }
    set_response_timeout(handle_.get(), timing_.turnaround.count() * kNsPerMs +
                                            wire_ns(request_bytes) + wire_ns(reply_bytes));
    errno = 0;
    const int done = call(handle_.get());
    const int error = errno;
    if (done == static_cast<int>(n)) {
      return Exception::none;
    }
    if (done >= 0) {
      return fault(operation, EMBBADDATA);
    }
    if (const Exception exception = exception_of(error); exception != Exception::none) {
      return exception;
    }
    return fault(operation, error);
  }

  int unit_;
  ModbusTiming timing_;
  ModbusHandle handle_;
  std::int64_t trouble_ns_ = 0;
};

class ModbusTcpBus final : public ModbusBus {
 public:
  ModbusTcpBus(TcpAddress address, int unit, ModbusTiming timing)
      : ModbusBus(unit, timing), address_(std::move(address)) {}

  [[nodiscard]] BusRecovery recovery() const override { return BusRecovery::reopen; }
  [[nodiscard]] Result<void> settle() override {
    if (trouble_ns() != 0) {
      return fail(Errc::device_gone, name() + ": to be reopened after a fault");
    }
    return {};
  }
  [[nodiscard]] std::string name() const override {
    return fmt::format("Modbus TCP {}:{}", address_.host, address_.service);
  }

 protected:
  [[nodiscard]] modbus_t* make_context() const override {
    return modbus_new_tcp_pi(address_.host.c_str(), address_.service.c_str());
  }
  [[nodiscard]] std::int64_t wire_ns(std::size_t) const override { return 0; }
  void opened(int) override {}

 private:
  TcpAddress address_;
};

class ModbusRtuBus final : public ModbusBus {
 public:
  ModbusRtuBus(SerialAddress address, int unit, ModbusTiming timing)
      : ModbusBus(unit, timing), address_(std::move(address)) {}

  [[nodiscard]] BusRecovery recovery() const override { return BusRecovery::settle; }

  [[nodiscard]] Result<void> settle() override {
    if (handle() == nullptr) {
      return fail(Errc::device_gone, name() + ": not open", ENOTCONN);
    }
    if (trouble_ns() == 0) {
      return {};
    }
    const int fd = modbus_get_socket(handle());
    const std::int64_t quiet_ns = timing().quiet.count() * kNsPerMs;
    const std::int64_t give_up_ns = monotonic_now_ns() + kLongestSettle * quiet_ns;
    std::int64_t last_sound_ns = trouble_ns();
    for (;;) {
      const std::int64_t now = monotonic_now_ns();
      pollfd line{fd, POLLIN, 0};
      const int wait_ms = now - last_sound_ns >= quiet_ns ? 0 : kQuietPollMs;
      if (::poll(&line, 1, wait_ms) > 0) {
        std::array<std::uint8_t, 256> dropped{};
        const ssize_t n = ::read(fd, dropped.data(), dropped.size());
        if (n <= 0 && errno != EAGAIN && errno != EINTR) {
          return fault("waiting for silence", n == 0 ? ECONNRESET : errno);
        }
        last_sound_ns = monotonic_now_ns();
        if (last_sound_ns > give_up_ns) {
          return fault("waiting for silence: the line keeps talking", EMBBADDATA);
        }
      } else if (wait_ms == 0) {
        trust_line();
        return {};
      }
    }
  }

  [[nodiscard]] std::string name() const override {
    return fmt::format("Modbus RTU {} at {}", address_.device, address_.baud);
  }

 protected:
  [[nodiscard]] modbus_t* make_context() const override {
    return modbus_new_rtu(address_.device.c_str(), address_.baud,
                          static_cast<char>(address_.parity), address_.data_bits,
                          address_.stop_bits);
  }
  [[nodiscard]] std::int64_t wire_ns(std::size_t n_bytes) const override {
    return static_cast<std::int64_t>(n_bytes) * kBitsPerByte * 1'000'000'000 / address_.baud;
  }
  /// A second program on the line would interleave its requests with ours. TIOCEXCL, set below,
  /// keeps others from opening it, but not root; the lock keeps out every program that takes
  /// it, including another daemon of root's.
  [[nodiscard]] Result<void> take_line() override {
    lock_.reset(::open(address_.device.c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC));
    if (!lock_.is_open()) {
      return open_fault(errno);
    }
    if (::flock(lock_.get(), LOCK_EX | LOCK_NB) != 0) {
      const int error = errno;
      lock_.reset();
      return fail(Errc::device_busy,
                  fmt::format("{}: another program has this serial line", name()), error);
    }
    return {};
  }
  void leave_line() noexcept override { lock_.reset(); }

  void opened(int fd) override {
    ::ioctl(fd, TIOCEXCL);
    ::fcntl(fd, F_SETFD, FD_CLOEXEC);
    if (!has_advised_) {
      has_advised_ = true;
      for (const std::string& advice : serial_advice(address_.device)) {
        log_warning(advice);
      }
    }
  }

 private:
  SerialAddress address_;
  Fd lock_;  ///< a second descriptor of the line: holds the lock while the bus is open
  bool has_advised_ = false;
};

}  // namespace

std::unique_ptr<RegisterBus> make_modbus_tcp_bus(const TcpAddress& address, int unit,
                                                 ModbusTiming timing) {
  return std::make_unique<ModbusTcpBus>(address, unit, timing);
}

std::unique_ptr<RegisterBus> make_modbus_rtu_bus(const SerialAddress& address, int unit,
                                                 ModbusTiming timing) {
  return std::make_unique<ModbusRtuBus>(address, unit, timing);
}

}  // namespace haarlight::firmware_iface
