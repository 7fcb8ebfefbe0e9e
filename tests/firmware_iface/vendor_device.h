// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <functional>
#include <map>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include <sys/socket.h>
#include <unistd.h>

#include "firmware_iface/modbus_frame.h"
#include "firmware_iface/modbus_request.h"
#include "haarlight/core/files.h"
#include "tests/firmware_iface/loopback_listener.h"

/// @file
/// Other vendors' controllers on Modbus TCP, written from their register tables and sharing no
/// code with the driver but the framing.

namespace haarlight::firmware_iface {

/// Registers and coils that are just there; what a vendor adds, a function does after each
/// write. Functions 1, 3, 5, 6, 15, 16.
class VendorDevice {
 public:
  using Words = std::map<std::uint16_t, std::uint16_t>;

  VendorDevice(Words words, std::map<std::uint16_t, bool> coils)
      : words_(std::move(words)), coils_(std::move(coils)) {
    address_ = "127.0.0.1:" + listener_.port();
    thread_ = std::jthread([this](const std::stop_token& stop) { serve(stop); });
  }

  [[nodiscard]] const std::string& address() const { return address_; }
  [[nodiscard]] std::uint16_t word(std::uint16_t address) {
    const std::lock_guard lock(mutex_);
    return words_.at(address);
  }
  [[nodiscard]] bool coil(std::uint16_t address) {
    const std::lock_guard lock(mutex_);
    return coils_.at(address);
  }
  /// Somebody else's hand, or a power cut.
  void set_word(std::uint16_t address, std::uint16_t value) {
    const std::lock_guard lock(mutex_);
    words_[address] = value;
  }
  void set_coil(std::uint16_t address, bool is_on) {
    const std::lock_guard lock(mutex_);
    coils_[address] = is_on;
  }
  /// Writes to this address are acknowledged and not carried out.
  void break_address(int address) { broken_ = address; }
  /// The next requests get no answer.
  void drop(int n) { n_to_drop_ = n; }
  [[nodiscard]] int n_requests() const { return n_requests_; }
  /// Called under the lock after each write, with the words.
  void on_write(std::function<void(Words&)> act) {
    const std::lock_guard lock(mutex_);
    after_write_ = std::move(act);
  }

 private:
  static std::uint16_t number(const std::vector<std::uint8_t>& pdu, std::size_t at) {
    return static_cast<std::uint16_t>((pdu[at] << 8U) | pdu[at + 1]);
  }

  void store(std::uint16_t address, std::uint16_t value) {
    if (broken_ != address) {
      words_[address] = value;
    }
  }

  std::vector<std::uint8_t> answer(const std::vector<std::uint8_t>& pdu) {
    const std::lock_guard lock(mutex_);
    const std::uint8_t function = pdu[0];
    const std::uint16_t first = number(pdu, 1);
    const std::uint16_t n = number(pdu, 3);
    const auto is_there = [&](const auto& cells, std::size_t count) {
      for (std::size_t k = 0; k < count; ++k) {
        if (cells.count(static_cast<std::uint16_t>(first + k)) == 0) {
          return false;
        }
      }
      return true;
    };
    auto refused = exception_reply(function, registers::Exception::illegal_address);
    std::vector<std::uint8_t> echo(pdu.begin(), pdu.begin() + 5);
    switch (function) {
      case 1: {
        if (!is_there(coils_, n)) {
          return refused;
        }
        std::vector<std::uint8_t> reply(2 + (n + 7U) / 8U);
        reply[0] = function;
        reply[1] = static_cast<std::uint8_t>(reply.size() - 2);
        for (std::size_t k = 0; k < n; ++k) {
          if (coils_[static_cast<std::uint16_t>(first + k)]) {
            reply[2 + k / 8] = static_cast<std::uint8_t>(reply[2 + k / 8] | (1U << (k % 8)));
          }
        }
        return reply;
      }
      case 3: {
        if (!is_there(words_, n)) {
          return refused;
        }
        std::vector<std::uint8_t> reply = {function, static_cast<std::uint8_t>(2 * n)};
        for (std::size_t k = 0; k < n; ++k) {
          const std::uint16_t value = words_[static_cast<std::uint16_t>(first + k)];
          reply.push_back(static_cast<std::uint8_t>(value >> 8U));
          reply.push_back(static_cast<std::uint8_t>(value & 0xFFU));
        }
        return reply;
      }
      case 5:
        if (!is_there(coils_, 1)) {
          return refused;
        }
        if (broken_ != first) {
          coils_[first] = n == 0xFF00;
        }
        return echo;
      case 6:
        if (!is_there(words_, 1)) {
          return refused;
        }
        store(first, n);
        break;
      case 15:
        if (!is_there(coils_, n)) {
          return refused;
        }
        for (std::size_t k = 0; k < n; ++k) {
          if (broken_ != static_cast<int>(first + k)) {
            coils_[static_cast<std::uint16_t>(first + k)] =
                ((pdu[6 + k / 8] >> (k % 8)) & 1U) != 0;
          }
        }
        return echo;
      case 16:
        if (!is_there(words_, n)) {
          return refused;
        }
        for (std::size_t k = 0; k < n; ++k) {
          store(static_cast<std::uint16_t>(first + k), number(pdu, 6 + 2 * k));
        }
        break;
      default:
        return exception_reply(function, registers::Exception::illegal_function);
    }
    if (after_write_) {
      after_write_(words_);
    }
    return echo;
  }

  void serve(const std::stop_token& stop) {
    while (!stop.stop_requested()) {
      if (!listener_.is_called()) {
        continue;
      }
      const Fd fd = listener_.accept();
      std::vector<std::uint8_t> bytes;
      while (!stop.stop_requested()) {
        if (!testing::is_readable(fd.get())) {
          continue;
        }
        std::array<std::uint8_t, 300> chunk{};
        const ssize_t n = ::recv(fd.get(), chunk.data(), chunk.size(), 0);
        if (n <= 0) {
          break;
        }
        bytes.insert(bytes.end(), chunk.begin(), chunk.begin() + n);
        const FrameScan scan = scan_tcp_request(bytes);
        if (scan.verdict != ScanVerdict::complete) {
          continue;
        }
        bytes.clear();
        ++n_requests_;
        if (n_to_drop_ > 0) {
          --n_to_drop_;
          continue;
        }
        const auto frame =
            frame_tcp(scan.request.transaction, scan.request.unit, answer(scan.request.pdu));
        ::send(fd.get(), frame.data(), frame.size(), MSG_NOSIGNAL);
      }
    }
  }

  std::mutex mutex_;
  Words words_;
  std::map<std::uint16_t, bool> coils_;
  std::function<void(Words&)> after_write_;
  std::atomic<int> broken_{-1};
  std::atomic<int> n_to_drop_{0};
  std::atomic<int> n_requests_{0};
  std::string address_;
  testing::LoopbackListener listener_;
  std::jthread thread_;
};

/// LEDsc4 as https://ledsc.eu/docs/communication describes it: registers 0-3 are the outputs'
/// values up to register 6; they show while register 5, "live mode", is not 0.
class Ledsc4 {
 public:
  Ledsc4()
      : device({{0, 0}, {1, 0}, {2, 0}, {3, 0}, {4, 500}, {5, 1}, {6, 1000}, {7, 0}, {8, 0}},
               {}) {
    device.on_write([this](VendorDevice::Words& words) {
      if (words[5] == 0) {
        return;
      }
      for (std::uint16_t k = 0; k < 4; ++k) {
        shown[k] = words[6] == 0 ? 0.0 : double{1} * words[k] / words[6];
      }
      ++n_shown;
      if (words[4] != 0) {
        ++n_faded;
      }
    });
  }
  std::array<std::atomic<double>, 4> shown{};  ///< drive of each output
  std::atomic<int> n_shown{0};
  std::atomic<int> n_faded{0};  ///< changes with a transition time
  VendorDevice device;
};

/// Waveshare Modbus RTU Relay 32CH, as its wiki's development protocol describes it.
inline std::map<std::uint16_t, bool> relay_coils() {
  std::map<std::uint16_t, bool> coils;
  for (std::uint16_t k = 0; k < 32; ++k) {
    coils[k] = false;
  }
  return coils;
}

}  // namespace haarlight::firmware_iface
