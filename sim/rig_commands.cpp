// SPDX-License-Identifier: Apache-2.0
#include "sim/rig_commands.h"

#include <charconv>
#include <optional>
#include <string>
#include <vector>

#include "haarlight/core/error.h"

namespace haarlight::sim {

namespace {

constexpr int kLongestMs = 3'600'000;

std::vector<std::string> words_of(std::string_view line) {
  std::vector<std::string> words;
  for (std::size_t i = 0; i < line.size();) {
    const std::size_t begin = line.find_first_not_of(" \t\r\n", i);
    if (begin == std::string_view::npos) {
      break;
    }
    const std::size_t end = std::min(line.find_first_of(" \t\r\n", begin), line.size());
    words.emplace_back(line.substr(begin, end - begin));
    i = end;
  }
  return words;
}

/// The words of one command, taken from the left.
class Words {
 public:
  explicit Words(std::string_view line) : line_(line), words_(words_of(line)) {}

  [[noreturn]] void refuse(const std::string& what) const {
    throw Error(what, std::string(line_), "see docs/reference/simulator.md for the commands",
                ExitCode::usage);
  }
  [[nodiscard]] bool is_empty() const { return next_ == words_.size(); }
  [[nodiscard]] std::string take() { return is_empty() ? std::string() : words_[next_++]; }
  [[nodiscard]] std::optional<std::string> take_if(const std::vector<std::string>& known) {
    for (const std::string& word : known) {
      if (!is_empty() && words_[next_] == word) {
        ++next_;
        return word;
      }
    }
    return std::nullopt;
  }
  [[nodiscard]] int number() {
    const std::string word = take();
    int value = 0;
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
    if (error != std::errc() || end != word.data() + word.size() || word.empty() ||
        value < -1 || value > kLongestMs) {
      refuse("expected a number, got '" + word + "'");
    }
    return value;
  }
  [[nodiscard]] int number_or(int fallback) { return is_empty() ? fallback : number(); }
  void finish() const {
    if (!is_empty()) {
      refuse("'" + words_[next_] + "' is too much");
    }
  }

 private:
  std::string_view line_;
  std::vector<std::string> words_;
  std::size_t next_ = 0;
};

void move_plug(VirtualRig& rig, const Words& words, bool is_in) {
  if (UsbRedirServer* usb = rig.usb_server()) {
    is_in ? usb->replug() : usb->unplug();
  } else if (rig.rig().controller.kind == ControllerKind::modbus_rtu) {
    is_in ? rig.controller().replug_rtu() : rig.controller().unplug_rtu();
  } else {
    words.refuse("a TCP controller has no plug");
  }
}

void fail_usb(VirtualRig& rig, Words& words, UsbStatus kind) {
  UsbFaultRule rule{.kind = kind};
  if (const auto transfer = words.take_if({"out", "in", "control"})) {
    rule.only = *transfer == "out"  ? UsbTransfer::bulk_out
                : *transfer == "in" ? UsbTransfer::bulk_in
                                    : UsbTransfer::control;
  }
  rule.skip = words.number_or(0);
  rule.count = words.number_or(1);
  words.finish();
  if (rig.usb_device() == nullptr) {
    words.refuse("the controller is not on USB");
  }
  rig.usb_device()->inject(rule);
}

void fail_request(VirtualRig& rig, Words& words, WireFaultRule rule) {
  rule.skip = words.number_or(0);
  rule.count = words.number_or(1);
  words.finish();
  rig.controller().inject(rule);
}

}  // namespace

void obey_rig_command(VirtualRig& rig, std::string_view line) {
  Words words(line);
  const std::string verb = words.take();
  if (verb == "unplug" || verb == "replug") {
    words.finish();
    move_plug(rig, words, verb == "replug");
  } else if (verb == "stall") {
    fail_usb(rig, words, UsbStatus::stall);
  } else if (verb == "hang") {
    fail_usb(rig, words, UsbStatus::hang);
  } else if (verb == "gone") {
    fail_usb(rig, words, UsbStatus::gone);
  } else if (verb == "drop") {
    fail_request(rig, words, {.kind = WireFault::drop_reply});
  } else if (verb == "late") {
    const std::chrono::milliseconds delay(words.number());
    fail_request(rig, words, {.kind = WireFault::delay_reply, .delay = delay});
  } else if (verb == "delay") {
    const std::chrono::milliseconds delay(words.number());
    words.finish();
    rig.controller().set_reply_delay(delay);
  } else if (verb == "restart") {
    const std::chrono::milliseconds off(words.number());
    words.finish();
    rig.controller().restart(off);
  } else if (verb == "interlock") {
    const auto state = words.take_if({"open", "closed"});
    words.finish();
    if (!state) {
      words.refuse("an interlock is open or closed");
    }
    rig.controller().set_interlock_open(*state == "open");
  } else if (verb == "strobe") {
    words.finish();
    rig.controller().strobe();
  } else if (verb == "clear") {
    words.finish();
    rig.controller().clear_faults();
    rig.controller().set_reply_delay(std::chrono::microseconds(0));
    if (rig.usb_device() != nullptr) {
      rig.usb_device()->clear_faults();
    }
  } else {
    words.refuse("'" + verb + "' is no command");
  }
}

}  // namespace haarlight::sim
