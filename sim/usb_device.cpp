// SPDX-License-Identifier: Apache-2.0
#include "sim/usb_device.h"

#include <algorithm>
#include <utility>

#include "firmware_iface/register_light_array.h"
#include "firmware_iface/usb_frame.h"

namespace haarlight::sim {

namespace {

// Standard requests and descriptors [USB 2.0, chapter 9].
constexpr std::uint8_t kTypeMask = 0x60;
constexpr std::uint8_t kTypeVendor = 0x40;
constexpr std::uint8_t kRecipientMask = 0x1F;
constexpr std::uint8_t kRecipientEndpoint = 2;
constexpr std::uint8_t kGetStatus = 0;
constexpr std::uint8_t kClearFeature = 1;
constexpr std::uint8_t kGetDescriptor = 6;
constexpr std::uint8_t kGetConfiguration = 8;
constexpr std::uint8_t kGetInterface = 10;
constexpr std::uint8_t kDescriptorDevice = 1;
constexpr std::uint8_t kDescriptorConfiguration = 2;
constexpr std::uint8_t kDescriptorString = 3;
constexpr std::uint8_t kDescriptorInterface = 4;
constexpr std::uint8_t kDescriptorEndpoint = 5;
constexpr std::uint8_t kSelfPowered = 0xC0;
constexpr std::uint8_t kBulk = 2;
constexpr std::uint8_t kStringManufacturer = 1;
constexpr std::uint8_t kStringProduct = 2;
constexpr std::uint8_t kStringSerial = 3;
constexpr std::uint8_t kStringInterface = 4;

std::uint8_t low(unsigned value) { return static_cast<std::uint8_t>(value & 0xFFU); }
std::uint8_t high(unsigned value) { return static_cast<std::uint8_t>((value >> 8U) & 0xFFU); }

UsbAnswer stalled() { return {UsbStatus::stall, {}}; }

}  // namespace

UsbLightDevice::UsbLightDevice(UsbDeviceConfig config, ControllerServer& controller)
    : config_(std::move(config)), controller_(controller) {}

std::vector<std::uint8_t> UsbLightDevice::device_descriptor() const {
  return {18,
          kDescriptorDevice,
          0x00,
          0x02,  // USB 2.00
          0,
          0,
          0,   // class by interface
          64,  // packet size of endpoint 0
          low(config_.vendor),
          high(config_.vendor),
          low(config_.product),
          high(config_.product),
          0x00,
          0x01,  // device 1.00
          kStringManufacturer,
          kStringProduct,
          kStringSerial,
          1};
}

std::vector<std::uint8_t> UsbLightDevice::configuration_descriptor() const {
  constexpr std::uint8_t kTotal = 9 + 9 + 7 + 7;
  const std::uint8_t packet_low = low(config_.max_packet);
  const std::uint8_t packet_high = high(config_.max_packet);
  return {9,
          kDescriptorConfiguration,
          kTotal,
          0,
          1,  // interfaces
          1,  // this configuration's value
          0,
          kSelfPowered,
          50,  // 100 mA from the bus
          9,
          kDescriptorInterface,
          0,  // number
          0,  // alternate setting
          2,  // endpoints
          firmware_iface::usb::kInterfaceClass,
          firmware_iface::usb::kInterfaceSubclass,
          firmware_iface::usb::kInterfaceProtocol,
          kStringInterface,
          7,
          kDescriptorEndpoint,
          config_.endpoint_out,
          kBulk,
          packet_low,
          packet_high,
          0,
          7,
          kDescriptorEndpoint,
          config_.endpoint_in,
          kBulk,
          packet_low,
          packet_high,
          0};
}

std::vector<std::uint8_t> UsbLightDevice::string_descriptor(std::uint8_t index) const {
  if (index == 0) {
    return {4, kDescriptorString, 0x09, 0x04};  // English (United States)
  }
  std::string text;
  switch (index) {
    case kStringManufacturer:
      text = "haarlight";
      break;
    case kStringProduct:
      text = config_.product_name;
      break;
    case kStringSerial:
      text = config_.serial;
      break;
    case kStringInterface:
      text = "registers";
      break;
    default:
      return {};
  }
  std::vector<std::uint8_t> bytes = {low(static_cast<unsigned>(2 + 2 * text.size())),
                                     kDescriptorString};
  for (const char c : text) {
    bytes.push_back(static_cast<std::uint8_t>(c));
    bytes.push_back(0);
  }
  return bytes;
}

// ---- faults ----

std::optional<UsbStatus> UsbLightDevice::next_fault(UsbTransfer transfer) {
  ++n_transfers_;
  for (UsbFaultRule& rule : rules_) {
    if (rule.count == 0 || (rule.only && *rule.only != transfer)) {
      continue;
    }
    if (rule.skip > 0) {
      --rule.skip;
      continue;
    }
    if (rule.count > 0) {
      --rule.count;
    }
    return rule.kind;
  }
  return std::nullopt;
}

void UsbLightDevice::inject(const UsbFaultRule& rule) {
  const std::lock_guard lock(mutex_);
  rules_.push_back(rule);
}

void UsbLightDevice::clear_faults() {
  const std::lock_guard lock(mutex_);
  rules_.clear();
}

std::uint64_t UsbLightDevice::n_transfers() const {
  const std::lock_guard lock(mutex_);
  return n_transfers_;
}

// ---- control ----

UsbAnswer UsbLightDevice::standard_request(const UsbSetup& setup) {
  std::vector<std::uint8_t> data;
  switch (setup.request) {
    case kGetDescriptor:
      switch (high(setup.value)) {
        case kDescriptorDevice:
          data = device_descriptor();
          break;
        case kDescriptorConfiguration:
          data = configuration_descriptor();
          break;
        case kDescriptorString:
          data = string_descriptor(low(setup.value));
          break;
        default:
          break;
      }
      if (data.empty()) {
        return stalled();
      }
      break;
    case kGetStatus: {
      const bool is_halted = (setup.index == config_.endpoint_in && is_in_halted_) ||
                             (setup.index == config_.endpoint_out && is_out_halted_);
      const bool is_endpoint = (setup.request_type & kRecipientMask) == kRecipientEndpoint;
      data = {static_cast<std::uint8_t>(is_endpoint && is_halted ? 1 : 0), 0};
      break;
    }
    case kGetConfiguration:
      data = {1};
      break;
    case kGetInterface:
      data = {0};
      break;
    case kClearFeature:
      if ((setup.request_type & kRecipientMask) != kRecipientEndpoint) {
        return stalled();
      }
      if (setup.index == config_.endpoint_in) {
        is_in_halted_ = false;
      } else if (setup.index == config_.endpoint_out) {
        is_out_halted_ = false;
        received_.clear();
      }
      break;
    default:
      return stalled();
  }
  data.resize(std::min<std::size_t>(data.size(), setup.length));
  return {UsbStatus::ok, std::move(data)};
}

UsbAnswer UsbLightDevice::vendor_request(const UsbSetup& setup) {
  if (const auto fault = next_fault(UsbTransfer::control)) {
    return {*fault, {}};
  }
  if (setup.request_type == firmware_iface::usb::kVendorIn &&
      setup.request ==
          static_cast<std::uint8_t>(firmware_iface::usb::ControlRequest::identity)) {
    std::vector<std::uint8_t> data =
        firmware_iface::usb::encode_identity(controller_.identity());
    data.resize(std::min<std::size_t>(data.size(), setup.length));
    return {UsbStatus::ok, std::move(data)};
  }
  if (setup.request_type != firmware_iface::usb::kVendorOut || setup.length != 0) {
    return stalled();
  }
  switch (static_cast<firmware_iface::usb::ControlRequest>(setup.request)) {
    case firmware_iface::usb::ControlRequest::resync:
      received_.clear();
      replies_.clear();
      return {};
    case firmware_iface::usb::ControlRequest::all_off:
      controller_.all_off();
      return {};
    case firmware_iface::usb::ControlRequest::identity:
      break;
  }
  return stalled();
}

UsbAnswer UsbLightDevice::control(const UsbSetup& setup,
                                  std::span<const std::uint8_t> /*data*/) {
  const std::lock_guard lock(mutex_);
  return (setup.request_type & kTypeMask) == kTypeVendor ? vendor_request(setup)
                                                         : standard_request(setup);
}

// ---- bulk ----

UsbAnswer UsbLightDevice::carry_out() {
  const std::optional<std::size_t> size = firmware_iface::usb::frame_size(received_);
  if (size && (*size == 0 || received_.size() < *size)) {
    return {};  // the rest follows with the next transfer
  }
  const std::optional<firmware_iface::usb::Frame> request =
      firmware_iface::usb::decode_frame(received_);
  received_.clear();
  if (!request || request->kind != firmware_iface::usb::FrameKind::request) {
    is_out_halted_ = true;
    return stalled();
  }
  WireExchange exchanged = controller_.exchange(request->pdu);
  firmware_iface::usb::Frame reply{firmware_iface::usb::FrameKind::reply, request->sequence,
                                   std::move(exchanged.pdu)};
  const auto is_hit = [&exchanged](WireFault kind) {
    return exchanged.fault.has_value() && exchanged.fault->kind == kind;
  };
  if (reply.pdu.empty() || is_hit(WireFault::drop_reply)) {
    return {};
  }
  if (is_hit(WireFault::close)) {
    return {UsbStatus::gone, {}};
  }
  if (is_hit(WireFault::wrong_transaction)) {
    ++reply.sequence;
  }
  if (is_hit(WireFault::wrong_unit)) {
    reply.kind = firmware_iface::usb::FrameKind::request;
  }
  std::vector<std::uint8_t> bytes =
      firmware_iface::usb::encode_frame(reply, config_.max_packet);
  if (is_hit(WireFault::half_reply)) {
    bytes.resize(bytes.size() / 2);
  }
  if (is_hit(WireFault::garbage_reply)) {
    for (std::size_t i = 0; i < bytes.size(); ++i) {
      bytes[i] = static_cast<std::uint8_t>(0xA5U ^ (i * 37U));
    }
  }
  replies_.push_back(
      {std::move(bytes), firmware_iface::monotonic_now_ns() + exchanged.delay.count()});
  return {};
}

UsbAnswer UsbLightDevice::bulk_out(std::span<const std::uint8_t> data) {
  const std::lock_guard lock(mutex_);
  if (const auto fault = next_fault(UsbTransfer::bulk_out)) {
    is_out_halted_ = is_out_halted_ || *fault == UsbStatus::stall;
    return {*fault, {}};
  }
  if (is_out_halted_) {
    return stalled();
  }
  received_.insert(received_.end(), data.begin(), data.end());
  return carry_out();
}

UsbAnswer UsbLightDevice::take_reply() {
  if (is_in_halted_) {
    return stalled();
  }
  if (replies_.empty() || replies_.front().ready_ns > firmware_iface::monotonic_now_ns()) {
    return {UsbStatus::pending, {}};
  }
  UsbAnswer answer{UsbStatus::ok, std::move(replies_.front().bytes)};
  replies_.erase(replies_.begin());
  return answer;
}

UsbAnswer UsbLightDevice::begin_bulk_in() {
  const std::lock_guard lock(mutex_);
  if (const auto fault = next_fault(UsbTransfer::bulk_in)) {
    is_in_halted_ = is_in_halted_ || *fault == UsbStatus::stall;
    return {*fault, {}};
  }
  return take_reply();
}

UsbAnswer UsbLightDevice::poll_bulk_in() {
  const std::lock_guard lock(mutex_);
  return take_reply();
}

std::optional<std::int64_t> UsbLightDevice::next_reply_ns() const {
  const std::lock_guard lock(mutex_);
  return replies_.empty() ? std::nullopt : std::optional(replies_.front().ready_ns);
}

void UsbLightDevice::clear_halt(std::uint8_t endpoint) {
  const std::lock_guard lock(mutex_);
  if (endpoint == config_.endpoint_in) {
    is_in_halted_ = false;
  } else if (endpoint == config_.endpoint_out) {
    is_out_halted_ = false;
    received_.clear();
  }
}

void UsbLightDevice::reset() {
  const std::lock_guard lock(mutex_);
  is_in_halted_ = false;
  is_out_halted_ = false;
  received_.clear();
  replies_.clear();
}

}  // namespace haarlight::sim
