// SPDX-License-Identifier: Apache-2.0
#include "sim/usb_redir_server.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <system_error>
#include <thread>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>
#include <usbredirparser.h>

#include "core/log.h"
#include "firmware_iface/register_light_array.h"
#include "firmware_iface/usb_frame.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"

namespace haarlight::sim {

namespace {

constexpr int kRetryMs = 200;  // between two openings of a character device
constexpr std::uint8_t kDirectionIn = 0x80;
constexpr std::uint8_t kInvalidEndpoint = usb_redir_type_invalid;

[[noreturn]] void throw_os_error(const std::string& operation, const std::string& where) {
  const int error = errno;
  throw Error(fmt::format("{}: {}", operation, std::generic_category().message(error)), where,
              "give an unused path in a folder that can be written", ExitCode::unavailable);
}

struct ParserDestroy {
  void operator()(usbredirparser* parser) const noexcept { usbredirparser_destroy(parser); }
};
using ParserHandle = std::unique_ptr<usbredirparser, ParserDestroy>;

std::uint8_t status_of(UsbStatus status) {
  switch (status) {
    case UsbStatus::ok:
      return usb_redir_success;
    case UsbStatus::stall:
      return usb_redir_stall;
    case UsbStatus::pending:
    case UsbStatus::hang:
    case UsbStatus::gone:
      break;
  }
  return usb_redir_ioerror;
}

/// The descriptors' slot of an endpoint: 0..15 out, 16..31 in.
std::size_t slot_of(std::uint8_t endpoint) {
  return (endpoint & 0x0FU) + ((endpoint & kDirectionIn) != 0 ? 16U : 0U);
}

}  // namespace

class UsbRedirServer::Impl {
 public:
  Impl(UsbLightDevice& device, std::filesystem::path path)
      : device_(device),
        path_(std::move(path)),
        is_character_device_(std::filesystem::is_character_file(path_)),
        stop_(::eventfd(0, EFD_CLOEXEC)),
        wake_(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
    if (!stop_.is_open() || !wake_.is_open()) {
      throw_os_error("eventfd", path_.string());
    }
    if (!is_character_device_) {
      listen();
    }
    thread_ = std::jthread([this] { run(); });
  }

  ~Impl() {
    signal(stop_);
    thread_.join();
    if (!is_character_device_) {
      std::error_code ignored;
      std::filesystem::remove(path_, ignored);
    }
  }
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  void set_plugged(bool is_plugged) {
    is_plugged_ = is_plugged;
    signal(wake_);
  }
  [[nodiscard]] bool is_attached() const { return is_attached_; }
  [[nodiscard]] const std::filesystem::path& path() const { return path_; }

 private:
  /// A transfer that awaits an answer or its cancellation.
  struct Parked {
    std::uint64_t id = 0;
    bool is_control = false;
    bool hangs = false;
    usb_redir_control_packet_header control{};
    usb_redir_bulk_packet_header bulk{};
  };

  static void signal(const Fd& event) {
    const std::uint64_t one = 1;
    [[maybe_unused]] const ssize_t n = ::write(event.get(), &one, sizeof one);
  }

  void listen() {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    const std::string text = path_.string();
    if (text.size() >= sizeof address.sun_path) {
      throw Error("a socket's path is at most 107 bytes long", text, "choose a shorter one");
    }
    std::memcpy(address.sun_path, text.data(), text.size());
    const auto* const generic = reinterpret_cast<const sockaddr*>(&address);
    {
      const Fd probe(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
      if (::connect(probe.get(), generic, sizeof address) == 0) {
        throw Error("somebody serves this socket already", text, "choose another path",
                    ExitCode::unavailable);
      }
    }
    std::error_code ignored;
    if (std::filesystem::is_socket(path_, ignored)) {
      std::filesystem::remove(path_, ignored);
    }
    listener_.reset(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
    if (!listener_.is_open() || ::bind(listener_.get(), generic, sizeof address) != 0 ||
        ::listen(listener_.get(), 1) != 0) {
      throw_os_error("listening for usb-redir", text);
    }
  }

  void run() {
    try {
      while (!is_stopping_) {
        wait_for_peer();
        if (line_.is_open()) {
          serve_peer();
        }
      }
    } catch (const std::exception& error) {
      log_error(fmt::format("usb-redir {}: {}", path_.string(), error.what()));
    }
  }

  /// Fills line_, or notes the stop.
  void wait_for_peer() {
    std::array<pollfd, 3> fds = {pollfd{stop_.get(), POLLIN, 0}, pollfd{wake_.get(), POLLIN, 0},
                                 pollfd{listener_.get(), POLLIN, 0}};
    ::poll(fds.data(), fds.size(), is_character_device_ ? kRetryMs : -1);
    if (fds[0].revents != 0) {
      is_stopping_ = true;
      return;
    }
    drain_wake();
    if (is_character_device_) {
      line_.reset(::open(path_.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC));
    } else if ((fds[2].revents & POLLIN) != 0) {
      line_.reset(::accept4(listener_.get(), nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK));
    }
  }

  void drain_wake() {
    std::uint64_t count = 0;
    [[maybe_unused]] const ssize_t n = ::read(wake_.get(), &count, sizeof count);
  }

  void serve_peer() {
    is_broken_ = false;
    has_hello_ = false;
    parked_.clear();
    make_parser();
    while (!is_stopping_ && !is_broken_) {
      if (has_hello_) {
        follow_plug();
      }
      answer_parked();
      while (!is_broken_ && usbredirparser_has_data_to_write(parser_.get()) > 0 &&
             !is_blocked_) {
        is_broken_ = usbredirparser_do_write(parser_.get()) != 0;
      }
      wait_for_bytes();
    }
    is_attached_ = false;
    parser_.reset();
    line_.reset();
  }

  void wait_for_bytes() {
    if (is_broken_) {
      return;
    }
    const auto events = static_cast<short>(is_blocked_ ? POLLIN | POLLOUT : POLLIN);
    std::array<pollfd, 3> fds = {pollfd{stop_.get(), POLLIN, 0}, pollfd{wake_.get(), POLLIN, 0},
                                 pollfd{line_.get(), events, 0}};
    timespec timeout{};
    const timespec* limit = nullptr;
    const bool is_waiting = std::any_of(parked_.begin(), parked_.end(),
                                        [](const Parked& parked) { return !parked.hangs; });
    if (const auto next = device_.next_reply_ns(); next && is_waiting) {
      const std::int64_t left =
          std::max<std::int64_t>(*next - firmware_iface::monotonic_now_ns(), 0);
      timeout = {left / 1'000'000'000, left % 1'000'000'000};
      limit = &timeout;
    }
    ::ppoll(fds.data(), fds.size(), limit, nullptr);
    is_stopping_ = fds[0].revents != 0;
    if (fds[1].revents != 0) {
      drain_wake();
    }
    if ((fds[2].revents & POLLOUT) != 0) {
      is_blocked_ = false;
    }
    if ((fds[2].revents & (POLLIN | POLLHUP | POLLERR)) != 0) {
      const int done = usbredirparser_do_read(parser_.get());
      is_broken_ = is_broken_ || done == usbredirparser_read_io_error;
    }
  }

  /// Updates the peer on whether the device is plugged in.
  void follow_plug() {
    const bool is_plugged = is_plugged_;
    if (is_plugged == is_attached_) {
      return;
    }
    if (is_plugged) {
      attach();
    } else {
      parked_.clear();
      usbredirparser_send_device_disconnect(parser_.get());
    }
    is_attached_ = is_plugged;
  }

  void attach() {
    device_.reset();
    usb_redir_ep_info_header endpoints{};
    std::fill(std::begin(endpoints.type), std::end(endpoints.type), kInvalidEndpoint);
    const std::size_t control_slots[] = {0, 16};
    for (const std::size_t slot : control_slots) {
      endpoints.type[slot] = usb_redir_type_control;
      endpoints.max_packet_size[slot] = 64;
    }
    for (const std::uint8_t endpoint :
         {device_.config().endpoint_out, device_.config().endpoint_in}) {
      endpoints.type[slot_of(endpoint)] = usb_redir_type_bulk;
      endpoints.max_packet_size[slot_of(endpoint)] = device_.config().max_packet;
    }
    usbredirparser_send_ep_info(parser_.get(), &endpoints);
    usb_redir_interface_info_header interfaces{};
    interfaces.interface_count = 1;
    interfaces.interface_class[0] = firmware_iface::usb::kInterfaceClass;
    interfaces.interface_subclass[0] = firmware_iface::usb::kInterfaceSubclass;
    interfaces.interface_protocol[0] = firmware_iface::usb::kInterfaceProtocol;
    usbredirparser_send_interface_info(parser_.get(), &interfaces);
    usb_redir_device_connect_header device{};
    device.speed =
        device_.config().max_packet == 512 ? usb_redir_speed_high : usb_redir_speed_full;
    device.vendor_id = device_.config().vendor;
    device.product_id = device_.config().product;
    device.device_version_bcd = 0x0100;
    usbredirparser_send_device_connect(parser_.get(), &device);
  }

  /// The device itself left the bus (through a fault).
  void fall_off() { is_plugged_ = false; }

  void answer(const Parked& transfer, const UsbAnswer& answered) {
    const std::uint8_t status = status_of(answered.status);
    std::vector<std::uint8_t> data = answered.data;
    if (transfer.is_control) {
      usb_redir_control_packet_header header = transfer.control;
      header.status = status;
      const bool is_in = (header.requesttype & kDirectionIn) != 0;
      if (is_in || status != usb_redir_success) {
        header.length = static_cast<std::uint16_t>(data.size());
      }
      usbredirparser_send_control_packet(parser_.get(), transfer.id, &header, data.data(),
                                         static_cast<int>(data.size()));
      return;
    }
    usb_redir_bulk_packet_header header = transfer.bulk;
    header.status = status;
    if ((header.endpoint & kDirectionIn) != 0) {
      const std::size_t requested =
          (static_cast<std::size_t>(header.length_high) << 16U) | header.length;
      data.resize(std::min(data.size(), requested));
      header.length = static_cast<std::uint16_t>(data.size());
      header.length_high = 0;
    } else if (status != usb_redir_success) {
      header.length = 0;
      header.length_high = 0;
    }
    usbredirparser_send_bulk_packet(parser_.get(), transfer.id, &header, data.data(),
                                    static_cast<int>(data.size()));
  }

  /// Answers at once, or parks the transfer.
  void complete(Parked transfer, const UsbAnswer& answered) {
    switch (answered.status) {
      case UsbStatus::ok:
      case UsbStatus::stall:
        answer(transfer, answered);
        return;
      case UsbStatus::gone:
        fall_off();
        return;
      case UsbStatus::pending:
      case UsbStatus::hang:
        transfer.hangs = answered.status == UsbStatus::hang;
        parked_.push_back(transfer);
        return;
    }
  }

  void answer_parked() {
    for (std::size_t i = 0; i < parked_.size();) {
      if (parked_[i].hangs) {
        ++i;
        continue;
      }
      const UsbAnswer answered = device_.poll_bulk_in();
      if (answered.status == UsbStatus::pending) {
        return;
      }
      const Parked transfer = parked_[i];
      parked_.erase(parked_.begin() + static_cast<std::ptrdiff_t>(i));
      complete(transfer, answered);
    }
  }

  // ---- the peer's requests ----

  void on_control(std::uint64_t id, const usb_redir_control_packet_header& header,
                  std::span<const std::uint8_t> data) {
    Parked transfer{.id = id, .is_control = true, .control = header};
    const UsbSetup setup{header.requesttype, header.request, header.value, header.index,
                         header.length};
    complete(transfer, device_.control(setup, data));
  }

  void on_bulk(std::uint64_t id, const usb_redir_bulk_packet_header& header,
               std::span<const std::uint8_t> data) {
    Parked transfer{.id = id, .bulk = header};
    if (header.endpoint == device_.config().endpoint_out) {
      complete(transfer, device_.bulk_out(data));
    } else if (header.endpoint == device_.config().endpoint_in) {
      complete(transfer, device_.begin_bulk_in());
    } else {
      answer(transfer, {UsbStatus::stall, {}});
    }
  }

  void on_cancel(std::uint64_t id) {
    const auto it = std::find_if(parked_.begin(), parked_.end(),
                                 [id](const Parked& parked) { return parked.id == id; });
    if (it == parked_.end()) {
      return;  // answered already: the two crossed
    }
    Parked transfer = *it;
    parked_.erase(it);
    if (transfer.is_control) {
      transfer.control.status = usb_redir_cancelled;
      transfer.control.length = 0;
      usbredirparser_send_control_packet(parser_.get(), id, &transfer.control, nullptr, 0);
    } else {
      transfer.bulk.status = usb_redir_cancelled;
      transfer.bulk.length = 0;
      transfer.bulk.length_high = 0;
      usbredirparser_send_bulk_packet(parser_.get(), id, &transfer.bulk, nullptr, 0);
    }
  }

  static Impl& self(void* priv) { return *static_cast<Impl*>(priv); }

  /// Takes ownership of a packet's data from the parser, and frees it after use.
  template <class Use>
  void with_data(std::uint8_t* data, int n, Use use) {
    use(std::span<const std::uint8_t>(data, n > 0 ? static_cast<std::size_t>(n) : 0));
    if (data != nullptr) {
      usbredirparser_free_packet_data(parser_.get(), data);
    }
  }

  void make_parser() {
    is_blocked_ = false;
    parser_.reset(usbredirparser_create());
    if (!parser_) {
      throw std::bad_alloc();
    }
    usbredirparser* p = parser_.get();
    p->priv = this;
    p->log_func = [](void* priv, int level, const char* message) {
      if (level <= usbredirparser_warning) {
        log_warning(fmt::format("usb-redir {}: {}", self(priv).path_.string(), message));
      }
    };
    p->read_func = [](void* priv, std::uint8_t* data, int count) {
      const ssize_t n = ::read(self(priv).line_.get(), data, static_cast<std::size_t>(count));
      if (n < 0 && (errno == EAGAIN || errno == EINTR)) {
        return 0;
      }
      if (n <= 0) {
        self(priv).is_broken_ = true;
        return -1;
      }
      return static_cast<int>(n);
    };
    p->write_func = [](void* priv, std::uint8_t* data, int count) {
      Impl& server = self(priv);
      const ssize_t n =
          server.is_character_device_
              ? ::write(server.line_.get(), data, static_cast<std::size_t>(count))
              : ::send(server.line_.get(), data, static_cast<std::size_t>(count), MSG_NOSIGNAL);
      if (n < 0 && (errno == EAGAIN || errno == EINTR)) {
        server.is_blocked_ = errno == EAGAIN;
        return 0;
      }
      if (n < 0) {
        server.is_broken_ = true;
        return -1;
      }
      return static_cast<int>(n);
    };
    p->hello_func = [](void* priv, usb_redir_hello_header*) { self(priv).has_hello_ = true; };
    p->reset_func = [](void* priv) { self(priv).device_.reset(); };
    p->set_configuration_func = [](void* priv, std::uint64_t id,
                                   usb_redir_set_configuration_header* requested) {
      usb_redir_configuration_status_header status{usb_redir_success, requested->configuration};
      usbredirparser_send_configuration_status(self(priv).parser_.get(), id, &status);
    };
    p->get_configuration_func = [](void* priv, std::uint64_t id) {
      usb_redir_configuration_status_header status{usb_redir_success, 1};
      usbredirparser_send_configuration_status(self(priv).parser_.get(), id, &status);
    };
    p->set_alt_setting_func = [](void* priv, std::uint64_t id,
                                 usb_redir_set_alt_setting_header* requested) {
      usb_redir_alt_setting_status_header status{usb_redir_success, requested->interface,
                                                 requested->alt};
      usbredirparser_send_alt_setting_status(self(priv).parser_.get(), id, &status);
    };
    p->get_alt_setting_func = [](void* priv, std::uint64_t id,
                                 usb_redir_get_alt_setting_header* requested) {
      usb_redir_alt_setting_status_header status{usb_redir_success, requested->interface, 0};
      usbredirparser_send_alt_setting_status(self(priv).parser_.get(), id, &status);
    };
    p->cancel_data_packet_func = [](void* priv, std::uint64_t id) { self(priv).on_cancel(id); };
    p->control_packet_func = [](void* priv, std::uint64_t id,
                                usb_redir_control_packet_header* header, std::uint8_t* data,
                                int n) {
      self(priv).with_data(data, n, [&](std::span<const std::uint8_t> bytes) {
        self(priv).on_control(id, *header, bytes);
      });
    };
    p->bulk_packet_func = [](void* priv, std::uint64_t id, usb_redir_bulk_packet_header* header,
                             std::uint8_t* data, int n) {
      self(priv).with_data(data, n, [&](std::span<const std::uint8_t> bytes) {
        self(priv).on_bulk(id, *header, bytes);
      });
    };
    // Without any one of the last three QEMU's xhci refuses the device, and reports that only
    // on its own stderr.
    std::array<std::uint32_t, USB_REDIR_CAPS_SIZE> capabilities{};
    for (const int capability :
         {usb_redir_cap_connect_device_version, usb_redir_cap_ep_info_max_packet_size,
          usb_redir_cap_64bits_ids, usb_redir_cap_32bits_bulk_length}) {
      usbredirparser_caps_set_cap(capabilities.data(), capability);
    }
    usbredirparser_init(p, "haarlight-sim", capabilities.data(), USB_REDIR_CAPS_SIZE,
                        usbredirparser_fl_usb_host);
  }

  UsbLightDevice& device_;
  std::filesystem::path path_;
  bool is_character_device_;
  std::atomic<bool> is_plugged_{true};
  std::atomic<bool> is_attached_{false};
  Fd stop_;
  Fd wake_;
  Fd listener_;
  // Used by this thread only.
  bool is_stopping_ = false;
  bool is_broken_ = false;
  bool is_blocked_ = false;
  bool has_hello_ = false;
  Fd line_;
  ParserHandle parser_;
  std::vector<Parked> parked_;
  std::jthread thread_;
};

UsbRedirServer::UsbRedirServer(UsbLightDevice& device, std::filesystem::path path)
    : impl_(std::make_unique<Impl>(device, std::move(path))) {}
UsbRedirServer::~UsbRedirServer() = default;
void UsbRedirServer::unplug() { impl_->set_plugged(false); }
void UsbRedirServer::replug() { impl_->set_plugged(true); }
bool UsbRedirServer::is_attached() const { return impl_->is_attached(); }
const std::filesystem::path& UsbRedirServer::path() const { return impl_->path(); }

}  // namespace haarlight::sim
