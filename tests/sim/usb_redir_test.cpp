// SPDX-License-Identifier: Apache-2.0
#include <array>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <map>
#include <thread>

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>
#include <usbredirparser.h>

#include "firmware_iface/register_pdu.h"
#include "firmware_iface/usb_frame.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "sim/usb_device.h"
#include "sim/usb_redir_server.h"
#include "tests/temporary_folder.h"

/// @file
/// The usb-redir server against the other half of the protocol's own library: what QEMU sees,
/// without QEMU.

namespace haarlight::sim {
namespace {

using namespace std::chrono_literals;
using Bytes = std::vector<std::uint8_t>;

/// The virtual machine's end of the line.
class Guest {
 public:
  struct Answer {
    int status = -1;
    Bytes data;
  };

  explicit Guest(const std::filesystem::path& path)
      : socket_(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0)) {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    std::strncpy(address.sun_path, path.c_str(), sizeof address.sun_path - 1);
    if (::connect(socket_.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address) !=
        0) {
      throw std::runtime_error("connecting to the usb-redir server");
    }
    parser_ = usbredirparser_create();
    parser_->priv = this;
    parser_->log_func = [](void*, int, const char*) {};
    parser_->read_func = [](void* self, std::uint8_t* data, int n) {
      const ssize_t got = ::read(me(self).socket_.get(), data, static_cast<std::size_t>(n));
      return got > 0 ? static_cast<int>(got) : got < 0 && errno == EAGAIN ? 0 : -1;
    };
    parser_->write_func = [](void* self, std::uint8_t* data, int n) {
      return static_cast<int>(
          ::write(me(self).socket_.get(), data, static_cast<std::size_t>(n)));
    };
    parser_->hello_func = [](void*, usb_redir_hello_header*) {};
    parser_->interface_info_func = [](void* self, usb_redir_interface_info_header* info) {
      me(self).interface_class = info->interface_class[0];
    };
    parser_->ep_info_func = [](void* self, usb_redir_ep_info_header* info) {
      me(self).endpoints = *info;
    };
    parser_->device_connect_func = [](void* self, usb_redir_device_connect_header* device) {
      me(self).vendor = device->vendor_id;
      me(self).is_connected = true;
    };
    parser_->device_disconnect_func = [](void* self) { me(self).is_connected = false; };
    parser_->control_packet_func =
        [](void* self, std::uint64_t id, usb_redir_control_packet_header* header,
           std::uint8_t* data, int n) { me(self).note(id, header->status, data, n); };
    parser_->bulk_packet_func = [](void* self, std::uint64_t id,
                                   usb_redir_bulk_packet_header* header, std::uint8_t* data,
                                   int n) { me(self).note(id, header->status, data, n); };
    std::array<std::uint32_t, USB_REDIR_CAPS_SIZE> abilities{};
    for (const int ability :
         {usb_redir_cap_connect_device_version, usb_redir_cap_ep_info_max_packet_size,
          usb_redir_cap_64bits_ids, usb_redir_cap_32bits_bulk_length}) {
      usbredirparser_caps_set_cap(abilities.data(), ability);
    }
    usbredirparser_init(parser_, "test", abilities.data(), USB_REDIR_CAPS_SIZE, 0);
  }
  ~Guest() { usbredirparser_destroy(parser_); }
  Guest(const Guest&) = delete;
  Guest& operator=(const Guest&) = delete;

  template <class Done>
  bool run_until(Done done, std::chrono::milliseconds limit = 10s) {
    const auto deadline = std::chrono::steady_clock::now() + limit;
    for (;;) {
      while (usbredirparser_has_data_to_write(parser_) > 0) {
        usbredirparser_do_write(parser_);
      }
      if (done()) {
        return true;
      }
      if (std::chrono::steady_clock::now() > deadline) {
        return false;
      }
      pollfd line{socket_.get(), POLLIN, 0};
      if (::poll(&line, 1, 10) > 0) {
        usbredirparser_do_read(parser_);
      }
    }
  }

  std::uint64_t send_control(std::uint8_t type, std::uint8_t request, std::uint16_t value,
                             std::uint16_t length, std::uint16_t index = 0) {
    usb_redir_control_packet_header header{};
    header.endpoint = static_cast<std::uint8_t>(type & 0x80U);
    header.request = request;
    header.requesttype = type;
    header.value = value;
    header.index = index;
    header.length = length;
    usbredirparser_send_control_packet(parser_, ++id_, &header, nullptr, 0);
    return id_;
  }
  std::uint64_t send_bulk(std::uint8_t endpoint, Bytes data, std::uint16_t length) {
    usb_redir_bulk_packet_header header{};
    header.endpoint = endpoint;
    header.length = data.empty() ? length : static_cast<std::uint16_t>(data.size());
    usbredirparser_send_bulk_packet(parser_, ++id_, &header, data.data(),
                                    static_cast<int>(data.size()));
    return id_;
  }
  void cancel(std::uint64_t id) { usbredirparser_send_cancel_data_packet(parser_, id); }

  Answer wait(std::uint64_t id) {
    const bool came = run_until([&] { return answers_.count(id) != 0; });
    return came ? answers_[id] : Answer{};
  }
  [[nodiscard]] bool has_answer(std::uint64_t id) const { return answers_.count(id) != 0; }

  bool is_connected = false;
  std::uint16_t vendor = 0;
  std::uint8_t interface_class = 0;
  usb_redir_ep_info_header endpoints{};

 private:
  static Guest& me(void* self) { return *static_cast<Guest*>(self); }
  void note(std::uint64_t id, int status, std::uint8_t* data, int n) {
    answers_[id] = {status, Bytes(data, data + (n > 0 ? n : 0))};
    if (data != nullptr) {
      usbredirparser_free_packet_data(parser_, data);
    }
  }

  Fd socket_;
  usbredirparser* parser_ = nullptr;
  std::uint64_t id_ = 0;
  std::map<std::uint64_t, Answer> answers_;
};

ControllerServerOptions server_options() {
  ControllerServerOptions options;
  options.controller.groups = {{0, 16, Watts(5.0), Watts(80.0)}};
  options.controller.max_power = Watts(80.0);
  options.has_tcp = false;
  return options;
}

class UsbRedir : public ::testing::Test {
 protected:
  testing::TemporaryFolder folder_;
  ControllerServer controller_{server_options()};
  UsbLightDevice device_{{}, controller_};
  UsbRedirServer server_{device_, folder_ / "usb.sock"};
  Guest guest_{folder_ / "usb.sock"};

  void SetUp() override {
    ASSERT_TRUE(guest_.run_until([this] { return guest_.is_connected; }));
  }
  Bytes request(std::uint32_t sequence, const Bytes& pdu) {
    return firmware_iface::usb::encode_frame(
        {firmware_iface::usb::FrameKind::request, sequence, pdu}, 512);
  }
};

TEST_F(UsbRedir, PlugsInADeviceWithItsDescriptors) {
  EXPECT_EQ(guest_.vendor, 0x1209);
  EXPECT_EQ(guest_.interface_class, firmware_iface::usb::kInterfaceClass);
  EXPECT_EQ(guest_.endpoints.type[2], usb_redir_type_bulk);
  EXPECT_EQ(guest_.endpoints.type[16 + 3], usb_redir_type_bulk);
  EXPECT_EQ(guest_.endpoints.max_packet_size[2], 512);
  const auto device = guest_.wait(guest_.send_control(0x80, 6, 0x0100, 18));
  EXPECT_EQ(device.status, usb_redir_success);
  EXPECT_EQ(device.data, device_.device_descriptor());
  const auto serial = guest_.wait(guest_.send_control(0x80, 6, 0x0303, 255));
  ASSERT_EQ(serial.data.size(), 2U + 2 * device_.config().serial.size());
  EXPECT_EQ(serial.data[2], 'H');
  const auto qualifier = guest_.wait(guest_.send_control(0x80, 6, 0x0600, 10));
  EXPECT_EQ(qualifier.status, usb_redir_stall);
}

TEST_F(UsbRedir, CarriesARequestAndItsReply) {
  const std::array<std::uint16_t, 1> level = {777};
  const Bytes pdu = firmware_iface::write_registers_request(
      firmware_iface::registers::holding::kLevels, level);
  const auto out = guest_.wait(guest_.send_bulk(2, request(5, pdu), 0));
  EXPECT_EQ(out.status, usb_redir_success);
  const auto in = guest_.wait(guest_.send_bulk(0x83, {}, 512));
  EXPECT_EQ(in.status, usb_redir_success);
  const auto reply = firmware_iface::usb::decode_frame(in.data);
  ASSERT_TRUE(reply);
  EXPECT_EQ(reply->sequence, 5U);
  EXPECT_EQ(firmware_iface::write_reply(reply->pdu, pdu),
            firmware_iface::registers::Exception::none);
}

TEST_F(UsbRedir, AReadWaitsForItsReplyAndCanBeCancelled) {
  const auto early = guest_.send_bulk(0x83, {}, 512);
  EXPECT_FALSE(guest_.run_until([&] { return guest_.has_answer(early); }, 50ms));
  guest_.cancel(early);
  EXPECT_EQ(guest_.wait(early).status, usb_redir_cancelled);
  controller_.set_reply_delay(60ms);
  const auto t0 = std::chrono::steady_clock::now();
  guest_.wait(guest_.send_bulk(
      2, request(6, firmware_iface::read_request(firmware_iface::ReadFunction::input, 0, 1)),
      0));
  const auto in = guest_.wait(guest_.send_bulk(0x83, {}, 512));
  EXPECT_GE(std::chrono::steady_clock::now() - t0, 60ms);
  EXPECT_EQ(firmware_iface::usb::decode_frame(in.data)->sequence, 6U);
}

TEST_F(UsbRedir, StallsUntilTheHaltIsCleared) {
  device_.inject({.kind = UsbStatus::stall, .only = UsbTransfer::bulk_out});
  const Bytes read =
      request(1, firmware_iface::read_request(firmware_iface::ReadFunction::input, 0, 1));
  EXPECT_EQ(guest_.wait(guest_.send_bulk(2, read, 0)).status, usb_redir_stall);
  EXPECT_EQ(guest_.wait(guest_.send_bulk(2, read, 0)).status, usb_redir_stall);
  const auto cleared = guest_.wait(guest_.send_control(0x02, 1, 0, 0, 2));
  EXPECT_EQ(cleared.status, usb_redir_success);
  EXPECT_EQ(guest_.wait(guest_.send_bulk(2, read, 0)).status, usb_redir_success);
}

TEST_F(UsbRedir, AllOffPassesByTheControlEndpoint) {
  device_.inject({.kind = UsbStatus::hang, .count = -1, .only = UsbTransfer::bulk_out});
  const auto jammed = guest_.send_bulk(
      2, request(1, firmware_iface::read_request(firmware_iface::ReadFunction::input, 0, 1)),
      0);
  const auto off = guest_.wait(guest_.send_control(
      firmware_iface::usb::kVendorOut,
      static_cast<std::uint8_t>(firmware_iface::usb::ControlRequest::all_off), 0, 0));
  EXPECT_EQ(off.status, usb_redir_success);
  EXPECT_FALSE(guest_.has_answer(jammed));
}

TEST_F(UsbRedir, UnplugsAndReplugs) {
  server_.unplug();
  ASSERT_TRUE(guest_.run_until([this] { return !guest_.is_connected; }));
  server_.replug();
  ASSERT_TRUE(guest_.run_until([this] { return guest_.is_connected; }));
  device_.inject({.kind = UsbStatus::gone, .only = UsbTransfer::bulk_out});
  guest_.send_bulk(
      2, request(1, firmware_iface::read_request(firmware_iface::ReadFunction::input, 0, 1)),
      0);
  ASSERT_TRUE(guest_.run_until([this] { return !guest_.is_connected; }));
}

TEST(UsbRedirSocket, IsNotTakenFromALiveServer) {
  const testing::TemporaryFolder folder;
  ControllerServer controller(server_options());
  UsbLightDevice device({}, controller);
  UsbRedirServer server(device, folder / "usb.sock");
  EXPECT_THROW(UsbRedirServer(device, folder / "usb.sock"), Error);
}

}  // namespace
}  // namespace haarlight::sim
