// SPDX-License-Identifier: Apache-2.0
/// @file
/// What a light's read-back costs: from the controller's acknowledgement to the status that
/// shows the pattern, against the simulated controller in this process, by TCP on the loopback
/// and by Modbus RTU on a pseudo-terminal that takes as long as a line of 115200 baud. Median
/// and 95th percentile of 300 changes of light. docs/reference/sync-modes.md has its figures.

#include <algorithm>
#include <cstdio>
#include <vector>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/firmware_iface/light_array.h"
#include "sim/virtual_rig.h"

namespace haarlight {
namespace {

constexpr int kChanges = 300;

void measure(const char* name, const Rig& rig) {
  auto lights = firmware_iface::make_light_array(rig.controller, rig.n_lights());
  if (!lights) {
    throw Error(lights.error().what, name, "see the message");
  }
  if (const auto found = (*lights)->connect(); !found) {
    throw Error(found.error().what, name, "see the message");
  }
  std::vector<double> read_back;
  std::vector<double> command;
  for (int i = 0; i < kChanges; ++i) {
    const std::vector<firmware_iface::ElementLevel> pattern{{i % rig.n_lights(), 1000}};
    const auto receipt = (*lights)->show(pattern, static_cast<std::uint32_t>(i + 1));
    if (!receipt) {
      throw Error(receipt.error().what, name, "see the message");
    }
    command.push_back(1e-6 * static_cast<double>(receipt->t_ack_ns - receipt->t_command_ns));
    read_back.push_back(1e-6 * static_cast<double>(receipt->t_shown_ns - receipt->t_ack_ns));
  }
  const auto print = [name](const char* what, std::vector<double> ms) {
    std::sort(ms.begin(), ms.end());
    fmt::print("{} {}: median {:.3f} ms, 95 % {:.3f} ms\n", name, what, ms[ms.size() / 2],
               ms[ms.size() * 95 / 100]);
  };
  print("latch request", command);
  print("read-back", read_back);
  if (const auto off = (*lights)->all_off(); !off) {
    throw Error(off.error().what, name, "see the message");
  }
  (*lights)->disconnect();
}

int run(const char* file) {
  Rig rig = read_rig(file);
  sim::ControllerServerOptions options;
  options.controller = firmware_iface::controller_config(rig);
  options.unit = rig.controller.unit;
  options.has_rtu = true;
  const sim::ControllerServer server(options);
  rig.controller.kind = ControllerKind::modbus_tcp;
  rig.controller.address = server.tcp_address();
  measure("TCP", rig);
  rig.controller.kind = ControllerKind::modbus_rtu;
  rig.controller.address = server.rtu_address();
  measure("RTU", rig);
  return 0;
}

}  // namespace
}  // namespace haarlight

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fprintf(stderr, "usage: read_back RIG.toml\n");
    return 64;
  }
  try {
    return haarlight::run(argv[1]);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
