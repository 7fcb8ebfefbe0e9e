// SPDX-License-Identifier: Apache-2.0
/// @file
/// The controller's part of the rig check.

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <optional>

#include <fmt/format.h>
#include <unistd.h>

#include "capture/doctor/rig_doctor.h"
#include "core/rig/measured_rig.h"
#include "firmware_iface/modbus_bus.h"
#include "firmware_iface/serial_ports.h"
#include "haarlight/firmware_iface/light_array.h"
#include "haarlight/firmware_iface/register_map.h"

namespace haarlight::capture {

namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;
using namespace firmware_iface::registers;

constexpr int kRoundTrips = 20;
constexpr double kSlowMs = 20.0;  // a status read at 115200 baud takes 6 ms
constexpr firmware_iface::ModbusTiming kQuick{std::chrono::milliseconds(250),
                                              std::chrono::milliseconds(500),
                                              std::chrono::milliseconds(300)};

struct Identity {
  int magic = 0;
  int map_version = 0;
  std::uint32_t serial = 0;
  int elements = 0;
  std::string model;
};

std::uint32_t wide(std::span<const std::uint16_t> words, std::uint16_t at) {
  return (std::uint32_t{words[at]} << 16U) | words[at + 1U];
}

/// The identity block; a fault or exception in words when there is none.
tl::expected<Identity, std::string> read_identity(firmware_iface::RegisterBus& bus) {
  if (const auto opened = bus.open(); !opened) {
    return tl::unexpected<std::string>(opened.error().what);
  }
  std::array<std::uint16_t, input::kIdentityCount> words{};
  const auto answer = bus.read_input(input::kMagic, words);
  if (!answer) {
    return tl::unexpected<std::string>(answer.error().what);
  }
  if (*answer != Exception::none) {
    return tl::unexpected<std::string>(
        fmt::format("it answers with Modbus exception {}", static_cast<int>(*answer)));
  }
  Identity id;
  id.magic = words[input::kMagic];
  id.map_version = words[input::kMapVersion];
  id.serial = wide(words, input::kSerial);
  id.elements = words[input::kElements];
  for (std::size_t i = 0; i < 8; ++i) {
    for (const unsigned shift : {8U, 0U}) {
      const char c = static_cast<char>((words[input::kModel + i] >> shift) & 0xffU);
      if (c >= ' ' && c < 127) {
        id.model += c;
      }
    }
  }
  return id;
}

bool is_light_controller(firmware_iface::RegisterBus& bus) {
  const auto id = read_identity(bus);
  bus.close();
  return id && id->magic == firmware_iface::registers::kMagic;
}

/// Where else, or under which unit number, a light controller answers; empty: nowhere.
Hint find_elsewhere(const ControllerSpec& spec, const TcpAddress& address,
                    const DoctorOptions& options, bool port_answers) {
  if (port_answers) {
    for (const int unit : options.other_units) {
      if (unit != spec.unit &&
          is_light_controller(*firmware_iface::make_modbus_tcp_bus(address, unit, kQuick))) {
        return {HintText::write_unit, {std::to_string(unit)}};
      }
    }
  }
  for (const int port : options.other_ports) {
    const TcpAddress other{address.host, std::to_string(port)};
    if (other.service != address.service &&
        is_light_controller(*firmware_iface::make_modbus_tcp_bus(other, spec.unit, kQuick))) {
      return {HintText::write_address, {address.host, std::to_string(port)}};
    }
  }
  return {};
}

/// What can be checked of the serial line without talking; `line` becomes wrong when it cannot
/// work.
std::vector<DoctorLine> examine_serial(const SerialAddress& address,
                                       const DoctorOptions& options) {
  std::vector<DoctorLine> lines;
  DoctorLine line{"serial line", Finding::good, address.device, ""};
  const std::vector<firmware_iface::SerialPort> ports =
      firmware_iface::list_serial_ports(options.root);
  std::error_code failed;
  if (!fs::exists(address.device, failed)) {
    std::vector<std::string> others;
    others.reserve(ports.size());
    for (const firmware_iface::SerialPort& port : ports) {
      others.push_back((port.by_id.empty() ? port.device : port.by_id).string());
    }
    line.finding = Finding::wrong;
    line.found = "no such device";
    line.hint = others.empty() ? Hint(HintText::plug_in_adapter)
                               : Hint(HintText::choose_serial_port,
                                      {fmt::format("{}", fmt::join(others, ", "))});
    return {line};
  }
  if (::access(address.device.c_str(), R_OK | W_OK) != 0) {
    line.finding = Finding::wrong;
    line.found = std::strerror(errno);
    line.hint = HintText::join_dialout;
    return {line};
  }
  const fs::path node = fs::canonical(address.device, failed);
  line.found = node.string();
  const auto port =
      std::find_if(ports.begin(), ports.end(), [&](const firmware_iface::SerialPort& p) {
        return p.device.filename() == node.filename();
      });
  if (port != ports.end() && address.device.find("/by-") == std::string::npos) {
    line.finding = Finding::warning;
    line.hint = port->by_id.empty() ? Hint(HintText::use_lasting_path)
                                    : Hint(HintText::use_lasting_name, {port->by_id.string()});
  }
  lines.push_back(line);
  if (port != ports.end() && port->latency_ms) {
    DoctorLine latency{"latency timer", Finding::good, "1 ms",
                       fmt::format("{} ms", *port->latency_ms)};
    if (*port->latency_ms > 1) {
      latency.finding = Finding::warning;
      latency.hint = {HintText::lower_latency,
                      {std::to_string(*port->latency_ms), node.filename().string()}};
    }
    lines.push_back(latency);
  }
  return lines;
}

/// True when the device is present and may be opened.
bool examine_usb(const ControllerSpec& spec, const DoctorOptions& options,
                 std::vector<DoctorLine>& lines) {
  DoctorLine line{"USB", Finding::good, "controller with serial number " + spec.address, ""};
  const auto wrong = [&](std::string found, Hint hint) {
    line.finding = Finding::wrong;
    line.found = std::move(found);
    line.hint = std::move(hint);
    lines.push_back(line);
    return false;
  };
  const auto all =
      options.list_usb ? options.list_usb() : firmware_iface::list_usb_controllers();
  if (!all) {
    return wrong(all.error().what, HintText::check_usb_bus);
  }
  std::vector<std::string> there;
  const firmware_iface::UsbController* mine = nullptr;
  bool is_barred = false;
  for (const firmware_iface::UsbController& one : *all) {
    there.push_back(fmt::format("{} ({}{}{})", one.serial.empty() ? "one" : one.serial,
                                one.location, one.problem.empty() ? "" : ": ", one.problem));
    is_barred = is_barred || !one.problem.empty();
    if (one.problem.empty() && one.serial == spec.address) {
      mine = &one;
    }
  }
  if (mine != nullptr) {
    line.found = fmt::format("{}, {}", mine->product, mine->location);
    lines.push_back(line);
    return true;
  }
  if (all->empty()) {
    return wrong("no light controller on USB", controller_hint(spec));
  }
  std::string found = fmt::format("{}", fmt::join(there, ", "));
  if (!is_barred) {
    return wrong(std::move(found), HintText::write_serial_number);
  }
  // It may be the one: without permission to open a device its serial number cannot be read.
  bool has_rule = false;
  std::error_code failed;
  for (const char* folder : {"etc/udev/rules.d", "lib/udev/rules.d", "usr/lib/udev/rules.d"}) {
    has_rule = has_rule || fs::exists(options.root / folder / "99-haarlight.rules", failed);
  }
  return wrong(std::move(found),
               has_rule ? HintText::join_plugdev : HintText::install_udev_rule);
}

std::string fault_words(std::uint32_t faults) {
  std::vector<std::string> words;
  const auto add = [&](std::uint32_t bit, const char* word) {
    if ((faults & bit) != 0U) {
      words.emplace_back(word);
    }
  };
  add(kFaultLeaseExpired, "its lease ran out once");
  add(kFaultOverPower, "a pattern beyond its power was refused");
  add(kFaultElementDuty, "an element was cut for its duty");
  add(kFaultOverTemperature, "too hot");
  add(kFaultInterlock, "interlock open");
  add(kFaultBankSum, "a latch named another bank sum");
  return fmt::format("{}", fmt::join(words, ", "));
}

/// A controller that answers: is it the right one, and healthy?
std::vector<DoctorLine> examine_answer(const Rig& rig, DoctorLine line, const Identity& id) {
  const std::string self = fmt::format("{}, serial {}", id.model, id.serial);
  line.found =
      fmt::format("{}, {} elements, register map {}", self, id.elements, id.map_version);
  if (id.map_version != kMapVersion) {
    line.finding = Finding::wrong;
    line.hint = HintText::update_firmware;
  } else if (id.elements != rig.n_lights()) {
    line.finding = Finding::wrong;
    line.hint = {HintText::correct_light_count, {std::to_string(rig.n_lights())}};
  } else if (rig.measured != nullptr && rig.measured->controller &&
             !rig.measured->controller->identity.empty() &&
             rig.measured->controller->identity != self) {
    line.finding = Finding::wrong;
    line.found += fmt::format("; measured was {}", rig.measured->controller->identity);
    line.hint = HintText::connect_measured;
  }
  return {line};
}

/// The one of another address or unit that answers, else what to look at.
Hint no_identity_hint(const ControllerSpec& spec, const std::optional<TcpAddress>& tcp,
                      const DoctorOptions& options) {
  if (!tcp) {
    return controller_hint(spec);
  }
  auto any = firmware_iface::make_modbus_tcp_bus(*tcp, spec.unit, kQuick);
  const bool port_answers = any->open().has_value();
  any->close();
  const Hint elsewhere = find_elsewhere(spec, *tcp, options, port_answers);
  return !elsewhere.is_empty() ? elsewhere
         : port_answers        ? HintText::correct_unit
                               : controller_hint(spec);
}

/// What answers on the bus, by our register map. `line`: what is expected; `tcp`: the address,
/// when that is the bus.
std::vector<DoctorLine> examine_identity(const Rig& rig, DoctorLine line,
                                         firmware_iface::RegisterBus& bus,
                                         const std::optional<TcpAddress>& tcp,
                                         const DoctorOptions& options) {
  const auto id = read_identity(bus);
  bus.close();
  if (id && id->magic == firmware_iface::registers::kMagic) {
    return examine_answer(rig, line, *id);
  }
  line.finding = Finding::wrong;
  line.found = id ? fmt::format(
                        "a Modbus device, but no light controller (0x{:04X} where 0x{:04X} "
                        "should be)",
                        id->magic, firmware_iface::registers::kMagic)
                  : id.error();
  line.hint = id ? HintText::name_profile : no_identity_hint(rig.controller, tcp, options);
  return {line};
}

/// False when it does not answer each time.
bool examine_state(firmware_iface::LightArray& lights, std::vector<DoctorLine>& lines) {
  DoctorLine state{"controller state", Finding::good, "dark, no faults, quick answers", ""};
  std::vector<double> trips;
  std::optional<firmware_iface::ControllerStatus> status;
  for (int i = 0; i < kRoundTrips; ++i) {
    const auto begin = Clock::now();
    const auto read = lights.status();
    if (!read) {
      state.finding = Finding::wrong;
      state.found = read.error().what;
      state.hint = HintText::check_link;
      lines.push_back(state);
      return false;
    }
    trips.push_back(std::chrono::duration<double, std::milli>(Clock::now() - begin).count());
    status = *read;
  }
  std::sort(trips.begin(), trips.end());
  const double typical = trips[trips.size() / 2];
  state.found = fmt::format("{}, {:.1f} ms per request (longest {:.1f}), {:.1f} deg C",
                            status->is_dark ? "dark" : "lit", typical, trips.back(),
                            status->temperature_c);
  const std::string faults = fault_words(status->faults);
  if ((status->faults & (kFaultInterlock | kFaultOverTemperature)) != 0U) {
    state.finding = Finding::wrong;
    state.found += "; " + faults;
    state.hint = HintText::close_interlock;
  } else if (!status->is_dark) {
    state.finding = Finding::warning;
    state.hint = HintText::end_light_user;
  } else if (!faults.empty()) {
    state.found += "; " + faults;  // history, cleared at the next capture
  }
  if (state.finding == Finding::good && typical > kSlowMs) {
    state.finding = Finding::warning;
    state.hint = HintText::speed_up_link;
  }
  lines.push_back(state);
  return true;
}

}  // namespace

Hint controller_hint(const ControllerSpec& spec) {
  switch (spec.kind) {
    case ControllerKind::modbus_tcp:
      return HintText::check_network;
    case ControllerKind::modbus_rtu:
      return HintText::check_serial_line;
    case ControllerKind::usb:
      return HintText::plug_in_controller;
  }
  return {};
}

std::vector<DoctorLine> examine_controller(const Rig& rig, const DoctorOptions& options) {
  const ControllerSpec& spec = rig.controller;
  DoctorLine line{"controller", Finding::good,
                  fmt::format("{} {}, unit {}, {} elements",
                              spec.kind == ControllerKind::modbus_tcp   ? "Modbus TCP"
                              : spec.kind == ControllerKind::modbus_rtu ? "Modbus RTU"
                                                                        : "USB",
                              spec.address, spec.unit, rig.n_lights()),
                  ""};
  std::vector<DoctorLine> lines;
  const auto wrong = [&](std::string found, Hint hint) {
    line.finding = Finding::wrong;
    line.found = std::move(found);
    line.hint = std::move(hint);
    lines.push_back(line);
    return lines;
  };
  std::unique_ptr<firmware_iface::RegisterBus> bus;
  std::optional<TcpAddress> tcp;
  if (spec.kind == ControllerKind::modbus_tcp) {
    const auto address = parse_tcp_address(spec.address);
    if (!address) {
      return wrong(address.error().what, HintText::write_tcp_address);
    }
    tcp = *address;
    bus = firmware_iface::make_modbus_tcp_bus(*address, spec.unit, kQuick);
  } else if (spec.kind == ControllerKind::modbus_rtu) {
    const auto address = parse_serial_address(spec.address);
    if (!address) {
      return wrong(address.error().what, HintText::write_serial_address);
    }
    lines = examine_serial(*address, options);
    if (!is_healthy(lines)) {
      return lines;
    }
    bus = firmware_iface::make_modbus_rtu_bus(*address, spec.unit, kQuick);
  } else if (!examine_usb(spec, options, lines)) {
    return lines;
  }
  // Another vendor's map lacks our identity block: its profile's own driver connects.
  const bool is_own_map = spec.profile.empty() || spec.profile == "haarlight";
  if (bus != nullptr && is_own_map) {
    const std::vector<DoctorLine> answer = examine_identity(rig, line, *bus, tcp, options);
    lines.insert(lines.end(), answer.begin(), answer.end());
    if (!is_healthy(lines)) {
      return lines;
    }
  }
  auto lights = firmware_iface::make_light_array(spec, rig.n_lights());
  if (!lights) {
    return wrong(lights.error().what, HintText::correct_controller);
  }
  const auto connected = (*lights)->connect();
  if (!connected) {
    return wrong(connected.error().what, HintText::check_controller_user);
  }
  if (lines.empty() || lines.back().subject != "controller") {
    line.found = fmt::format("{}, serial {}, {} elements", connected->model, connected->serial,
                             connected->n_elements);
    if (connected->n_elements != rig.n_lights()) {
      line.finding = Finding::wrong;
      line.hint = HintText::correct_elements;
    }
    lines.push_back(line);
  }
  if (examine_state(**lights, lines)) {
    (*lights)->disconnect();
  }
  return lines;
}

}  // namespace haarlight::capture
