// SPDX-License-Identifier: Apache-2.0
#include "capture/doctor/doctor_hints.h"

#include <array>

namespace haarlight::capture {

namespace {

constexpr auto kHints = std::to_array<std::string_view>({
    "measure them: `haarlight rig commission {}`.",
    "measure again: `haarlight rig commission {} --force`.",
    "use a kernel with high-resolution timers (CONFIG_HIGH_RES_TIMERS).",
    "the kernel gave up the processor's own clock: see `dmesg | grep clocksource`; boot with "
    "tsc=reliable where the machine's TSC is sound.",
    "for the whole examination stop it: `systemctl stop haarlightd`.",
    "give [http] another port, or end that program.",
    "correct storage.folder.",
    "make the folder writable for the user that runs the daemon, or correct storage.folder.",
    "mend or replace the disk, or correct storage.folder.",
    "make room, or put storage.folder on another disk.",
    "captures will wait for the disk: put storage.folder on a faster one.",
    "is the disk mounted? Restart the daemon when the folder is there again.",
    "free some space; a run waits meanwhile and loses no frame.",

    "no permission; add yourself to the group {} (`sudo usermod -aG {} $USER`), then log in "
    "again.",
    "the system refuses ({}): plug it out and in again, then try once more.",
    "this format is not linear in light: choose a raw one where the camera has it "
    "(docs/reference/cameras.md).",
    "this format is for looking only: choose a raw one (docs/reference/cameras.md).",
    "its timestamps are not CLOCK_MONOTONIC: use a driver that sets such ones (for uvcvideo: "
    "options uvcvideo clock=CLOCK_MONOTONIC).",
    "damaged frames mean a bad cable, hub or too little USB bandwidth.",
    "write fps = {}, or a shorter exposure_us: a camera slows down when the exposure does not "
    "fit.",
    "write exposure_us = {}: the camera's nearest value.",
    "frames are lost before they reach the host: another program on the same USB bus, or a "
    "busy computer.",
    "plug it in, or correct serial; there {}.",
    "set device to one that is there: there {}.",
    "plug the camera in; this machine shows no camera at all.",
    "start the camera's program (haarlight-sim, or your bridge), or correct device.",
    "correct device: the folder of a session.",
    "correct device: the socket of the camera's program.",
    "another program has the camera: end it.",
    "nobody listens any more: start the camera's program again.",
    "correct size, format or fps in [[camera]].",
    "plug it out and in again, then try once more.",
    "correct kind in [[camera]].",
    "does it wait for a trigger? is the cable (USB 2 in a USB 3 port) good?",
    "check the cable; `dmesg` tells what the driver says.",
    "check its cable and its power; it is tried again by itself.",

    "write unit = {}: a light controller answers to it.",
    "write address = \"{}:{}\": a light controller answers there.",
    "write address = \"host:port\".",
    "write address = \"/dev/serial/by-id/...:baud\".",
    "plug the adapter in; it then appears in /dev/serial/by-id.",
    "write address with one of: {}.",
    "add yourself to the group dialout (`sudo usermod -aG dialout $USER`), then log in again.",
    "this name changes with the order of plugging in; use {}.",
    "this name changes with the order of plugging in; use its name in /dev/serial/by-path.",
    "each answer waits up to {} ms in the adapter: install 99-haarlight.rules, or "
    "`echo 1 | sudo tee /sys/bus/usb-serial/devices/{}/latency_timer`.",
    "use a machine with USB; does `lsusb` answer?",
    "write its serial number as address in [controller].",
    "99-haarlight.rules is installed: add yourself to the group plugdev (`sudo usermod -aG "
    "plugdev $USER`), log in again, plug the controller out and in.",
    "install 99-haarlight.rules into /etc/udev/rules.d, then `sudo udevadm control --reload`, "
    "and plug the controller out and in.",
    "its firmware speaks another register map: update it, or haarlight.",
    "the rig file describes {} lights: correct rows and cols of [[face]], or the address.",
    "correct rows and cols of [[face]], or the address.",
    "connect the controller that was measured, or measure again (haarlight rig commission).",
    "the port is open, but no controller answers to this unit: correct unit, or is another "
    "device at this address?",
    "correct address or unit, or name its register profile.",
    "the link is not sound: check the cable and its ends.",
    "close the interlock, let the boards cool: until then no light can be lit.",
    "close the interlock, let the boards cool, or light fewer elements at once: it goes on by "
    "itself.",
    "another program lights it: end that first.",
    "a slow link makes captures slow: a higher baud rate, the latency timer, a wired network.",
    "is it switched on and on this network? correct address; is a firewall between?",
    "correct the baud rate or unit; are A and B of the RS-485 pair swapped? is another program "
    "using the line?",
    "plug it in and switch it on; `lsusb` shows what is there.",
    "correct kind, profile or address in [controller].",
    "is it switched on? is another program using it?",
});
static_assert(kHints.size() == static_cast<std::size_t>(HintText::check_controller_user) + 1);

constexpr std::string_view kValue = "{}";

}  // namespace

std::span<const std::string_view> words_of(HintText /*text*/) { return kHints; }

Hint::Hint(HintText text, const std::vector<std::string>& values) {
  std::string_view rest = to_string(text);
  for (const std::string& value : values) {
    const std::size_t at = rest.find(kValue);
    HAARLIGHT_EXPECTS(at != std::string_view::npos, "no more values than the sentence takes");
    text_ += rest.substr(0, at);
    text_ += value;
    rest.remove_prefix(at + kValue.size());
  }
  HAARLIGHT_EXPECTS(rest.find(kValue) == std::string_view::npos, "a value for every {}");
  text_ += rest;
}

Hint::Hint(const Error& error) : text_(error.hint()) {
  if (!text_.empty() && std::string_view(".?!").find(text_.back()) == std::string_view::npos) {
    text_ += '.';
  }
}

}  // namespace haarlight::capture
