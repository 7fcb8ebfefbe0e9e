// SPDX-License-Identifier: Apache-2.0
#include "sim/fault_script.h"

#include "core/config_table.h"
#include "haarlight/core/files.h"

namespace haarlight::sim {

FaultScript parse_fault_script(const std::string& text, const std::string& name) {
  ConfigTable root = ConfigTable::parse_text(text, name);
  FaultScript script;
  constexpr Range kFraction{.min = 0.0, .max = 1.0};
  constexpr Range kTime{.min = 0.0, .max = 1e6};
  if (auto frames = root.table("frames")) {
    FrameFaults& f = script.frames;
    f.late_fraction = frames->number_or("late_share", 0.0, kFraction);
    f.late_ms = frames->number_or("late_ms", f.late_ms, kTime);
    f.drop_fraction = frames->number_or("drop_share", 0.0, kFraction);
    f.duplicate_fraction = frames->number_or("duplicate_share", 0.0, kFraction);
    f.stale_fraction = frames->number_or("stale_share", 0.0, kFraction);
    f.swap_fraction = frames->number_or("swap_share", 0.0, kFraction);
    f.jitter_us = frames->number_or("jitter_us", 0.0, kTime);
    if (f.late_fraction + f.drop_fraction + f.duplicate_fraction + f.stale_fraction +
            f.swap_fraction >
        1.0) {
      frames->problem("", "the fractions add up to more than 1",
                      "each frame suffers one fault at most");
    }
  }
  for (ConfigTable& table : root.tables("bus")) {
    BusFault bus;
    bus.at_s = table.number("at_s", kTime);
    bus.for_s = table.number("for_s", kTime);
    bus.is_dead = table.choice("kind", {"dead", "slow"}) == 0;
    bus.delay_ms = table.number_or("delay_ms", 0.0, kTime);
    if (!bus.is_dead && bus.delay_ms == 0.0) {
      table.problem("delay_ms", "a slow bus needs a delay", "add delay_ms");
    }
    script.bus.push_back(bus);
  }
  for (ConfigTable& table : root.tables("restart")) {
    ControllerRestart restart;
    restart.at_s = table.number("at_s", kTime);
    restart.off_ms = table.number_or("off_ms", restart.off_ms, kTime);
    script.restarts.push_back(restart);
  }
  if (auto late = root.table("late_light")) {
    firmware_iface::LateActing& l = script.late_light;
    const auto microseconds = [&late](const char* key, std::chrono::microseconds fallback) {
      const double ms = late->number_or(key, 1e-3 * static_cast<double>(fallback.count()),
                                        Range{.min = 0.0, .max = 1e4});
      return std::chrono::microseconds(static_cast<std::int64_t>(ms * 1e3));
    };
    l.fraction = late->number("share", kFraction);
    l.least = microseconds("least_ms", l.least);
    l.most = microseconds("most_ms", l.most);
    if (l.most < l.least) {
      late->problem("most_ms", "is shorter than least_ms", "give the range from short to long");
    }
    if (late->has("shows")) {
      l.shows = static_cast<firmware_iface::LateActing::Shows>(
          late->choice("shows", {"with_light", "at_once", "in_order"}));
    }
  }
  root.finish();
  return script;
}

FaultScript read_fault_script(const std::filesystem::path& path) {
  return parse_fault_script(read_file(path, 1U << 20U), path.string());
}

}  // namespace haarlight::sim
