// SPDX-License-Identifier: Apache-2.0
#include "firmware_iface/usb_bus.h"

#include <utility>
#include <vector>

#include <fmt/format.h>

#include "firmware_iface/register_pdu.h"
#include "firmware_iface/usb_frame.h"
#include "firmware_iface/usb_link.h"

namespace haarlight::firmware_iface {

namespace {

using registers::Exception;

std::uint8_t number_of(usb::ControlRequest request) {
  return static_cast<std::uint8_t>(request);
}

class UsbBus final : public RegisterBus {
 public:
  UsbBus(std::string serial, UsbTiming timing) : serial_(std::move(serial)), timing_(timing) {}

  [[nodiscard]] BusRecovery recovery() const override { return BusRecovery::settle; }
  [[nodiscard]] std::string name() const override { return "USB " + serial_; }

  [[nodiscard]] Result<void> open() override {
    has_trouble_ = false;
    if (auto opened = link_.open(serial_, UsbUse::claimed, timing_.open); !opened) {
      return named(opened.error(), "opening");
    }
    if (auto identified = identify(); !identified) {
      link_.close();
      return identified;
    }
    // A previous program may have left half a request or an answer.
    auto fresh = link_.control_out(number_of(usb::ControlRequest::resync), timing_.turnaround);
    if (!fresh) {
      auto fault = named(fresh.error(), "starting");
      link_.close();
      return fault;
    }
    return {};
  }

  void close() noexcept override { link_.close(); }

  [[nodiscard]] Result<void> settle() override {
    if (!link_.is_open() || link_.is_lost()) {
      return fail(Errc::device_gone, name() + ": the device left, or the system hangs");
    }
    if (!has_trouble_) {
      return {};
    }
    auto cleared = link_.clear_halts(timing_.open);
    if (cleared) {
      cleared = link_.control_out(number_of(usb::ControlRequest::resync), timing_.turnaround);
    }
    if (!cleared) {
      // Only a new connection helps a device whose endpoint 0 fails.
      return fail(Errc::device_gone,
                  fmt::format("{}: starting anew: {}", name(), cleared.error().what));
    }
    has_trouble_ = false;
    return {};
  }

  [[nodiscard]] Result<Exception> read_input(std::uint16_t first,
                                             std::span<std::uint16_t> words) override {
    return read(ReadFunction::input, first, words, "reading input registers");
  }
  [[nodiscard]] Result<Exception> read_holding(std::uint16_t first,
                                               std::span<std::uint16_t> words) override {
    return read(ReadFunction::holding, first, words, "reading holding registers");
  }
  [[nodiscard]] Result<Exception> write_holding(std::uint16_t first,
                                                std::span<const std::uint16_t> words) override {
    return write(write_registers_request(first, words), "writing registers");
  }
  [[nodiscard]] Result<Exception> write_coils(std::uint16_t first,
                                              std::span<const std::uint8_t> bits) override {
    return write(write_coils_request(first, bits), "writing on bits");
  }

 private:
  [[nodiscard]] tl::unexpected<Fault> named(Fault fault, const char* operation) const {
    fault.what = fmt::format("{}: {}: {}", name(), operation, fault.what);
    return tl::unexpected<Fault>(std::move(fault));
  }

  [[nodiscard]] Result<void> identify() {
    const auto bytes = link_.control_in(number_of(usb::ControlRequest::identity),
                                        usb::kIdentityBytes, timing_.turnaround);
    if (!bytes) {
      return named(bytes.error(), "asking for its identity");
    }
    if (!usb::decode_identity_reply(*bytes)) {
      return fail(Errc::unsupported,
                  fmt::format("{}: not a light controller of USB protocol version {}", name(),
                              usb::kWireVersion));
    }
    return {};
  }

  /// Sends a request and returns its reply's PDU.
  [[nodiscard]] Result<std::vector<std::uint8_t>> request(std::vector<std::uint8_t> pdu,
                                                          const char* operation) {
    if (!link_.is_open() || link_.is_lost()) {
      has_trouble_ = true;
      return fail(Errc::device_gone, fmt::format("{}: {}: not there", name(), operation));
    }
    if (has_trouble_) {
      return fail(Errc::protocol, name() + ": not settled after a fault");
    }
    const std::uint32_t sequence = ++sequence_;
    const auto frame = usb::encode_frame({usb::FrameKind::request, sequence, std::move(pdu)},
                                         link_.max_packet());
    const auto classify = [sequence](std::span<const std::uint8_t> bytes) {
      const auto reply = usb::decode_frame(bytes);
      if (!reply || reply->kind != usb::FrameKind::reply) {
        return UsbVerdict::broken;
      }
      if (reply->sequence == sequence) {
        return UsbVerdict::mine;
      }
      // We never requested sequence numbers ahead of ours.
      return static_cast<std::int32_t>(reply->sequence - sequence) < 0 ? UsbVerdict::older
                                                                       : UsbVerdict::broken;
    };
    auto bytes = link_.exchange(frame, classify, timing_.turnaround);
    if (!bytes) {
      has_trouble_ = true;
      return named(bytes.error(), operation);
    }
    return std::move(usb::decode_frame(*bytes)->pdu);
  }

  /// After a reply that does not fit its request the link is no longer trusted.
  [[nodiscard]] Result<Exception> classified(Result<Exception> answer, const char* operation) {
    if (!answer) {
      has_trouble_ = true;
      return named(answer.error(), operation);
    }
    return answer;
  }

  [[nodiscard]] Result<Exception> read(ReadFunction function, std::uint16_t first,
                                       std::span<std::uint16_t> words, const char* operation) {
    const auto reply = request(read_request(function, first, words.size()), operation);
    if (!reply) {
      return tl::unexpected<Fault>(reply.error());
    }
    return classified(read_reply(*reply, function, words), operation);
  }

  [[nodiscard]] Result<Exception> write(const std::vector<std::uint8_t>& pdu,
                                        const char* operation) {
    const auto reply = request(pdu, operation);
    if (!reply) {
      return tl::unexpected<Fault>(reply.error());
    }
    return classified(write_reply(*reply, pdu), operation);
  }

  std::string serial_;
  UsbTiming timing_;
  UsbLink link_;
  std::uint32_t sequence_ = 0;
  bool has_trouble_ = false;
};

}  // namespace

std::unique_ptr<RegisterBus> make_usb_bus(std::string serial, UsbTiming timing) {
  return std::make_unique<UsbBus>(std::move(serial), timing);
}

Result<void> usb_all_off(const std::string& serial, UsbTiming timing) {
  UsbLink link;
  auto done = link.open(serial, UsbUse::only_control, timing.open);
  if (done) {
    done = link.control_out(number_of(usb::ControlRequest::all_off), timing.turnaround);
  }
  if (!done) {
    done.error().what = fmt::format("USB {}: all off: {}", serial, done.error().what);
  }
  return done;
}

}  // namespace haarlight::firmware_iface
