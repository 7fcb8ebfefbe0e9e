// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "capture/sequencer/sequencer_messages.h"
#include "haarlight/core/enum_words.h"
#include "haarlight/core/rig/rig.h"

/// @file
/// What the daemon has recently observed of its devices: whether controller and camera answer,
/// and temperature, power and duty over time. Sees every event and action of the sequencer,
/// queries no device, and keeps a bounded history.

namespace haarlight::capture {

/// The state of a device, from its last report.
struct DeviceState {
  enum class Link {
    unused,  ///< not needed yet, or idle
    good,
    lost,
  };
  Link link = Link::unused;
  std::int64_t since_ns = 0;  ///< of the link; CLOCK_MONOTONIC
  std::string problem;        ///< the latest fault since it was last good; empty: none
  Errc code = Errc::io;       ///< of the problem
};

/// Equal time steps, oldest first, ending with the latest complete one.
struct RigHistory {
  double step_s = 1.0;
  /// Mean of the controller's reports; nothing while it was not queried, that is between runs.
  std::vector<std::optional<double>> temperature_c;
  std::vector<double> watts;  ///< mean over the step, from the patterns shown
  /// Highest duty of any light at the step's end, as the controller computes it: an element's
  /// drive, averaged with its face's heat_tau_s.
  std::vector<double> duty;
  std::vector<double> frames;  ///< delivered by the camera, per second
};

enum class HistorySpan {
  minutes,  ///< the last ten, in seconds
  hours,    ///< the last twelve, in minutes
};
inline constexpr auto kHistorySpanWords = std::to_array<std::string_view>({"minutes", "hours"});
constexpr std::span<const std::string_view> words_of(HistorySpan) { return kHistorySpanWords; }

/// Thread-safe: written by the control thread, read by HTTP.
class RigWatch {
 public:
  RigWatch(const Rig& rig, std::int64_t now_ns);

  using Patterns =
      std::shared_ptr<const std::vector<std::vector<firmware_iface::ElementLevel>>>;
  /// A run or a preview begins. @param patterns  by shot
  void begin(Patterns patterns);
  void see(std::int64_t now_ns, const EventBody& event);
  void see(std::int64_t now_ns, const Action& action);

  [[nodiscard]] RigHistory history(std::int64_t now_ns, HistorySpan span);
  [[nodiscard]] DeviceState controller() const;
  [[nodiscard]] DeviceState camera() const;

 private:
  struct Point {
    double temperature_sum = 0.0;
    int n_temperatures = 0;
    double watts = 0.0;
    double duty = 0.0;
    double frames = 0.0;
  };

  void advance(std::int64_t now_ns);
  void add_energy(std::int64_t until_ns);
  void close_second();
  void add_second(const Point& point);
  void show(std::int64_t now_ns, int shot);  ///< -1: dark
  void heat_to(std::int64_t now_ns, const firmware_iface::ElementLevel& lit, double drive);
  void take_temperature(const std::optional<double>& temperature_c);
  static void set_link(DeviceState& device, DeviceState::Link link, std::int64_t now_ns);

  // From the rig, by element and by face.
  std::vector<int> face_of_;
  std::vector<double> watts_of_face_;
  std::vector<double> tau_s_of_face_;

  mutable std::mutex mutex_;
  DeviceState controller_;
  DeviceState camera_;

  Patterns patterns_;
  std::uint64_t show_job_ = 0;  ///< whose answer means show_shot_ is lit
  int show_shot_ = -1;
  std::vector<firmware_iface::ElementLevel> lit_;
  int lit_shot_ = -1;
  double lit_watts_ = 0.0;
  bool was_lit_ = false;          ///< since the last whole second
  std::int64_t reckoned_ns_ = 0;  ///< energy is summed up to here
  std::int64_t second_ns_ = 0;    ///< start of the current one
  std::vector<double> heat_;
  std::vector<std::int64_t> heat_ns_;  ///< the time heat_ refers to
  std::vector<double> peak_of_face_;   ///< greatest heat, at second_ns_

  Point second_;
  Point minute_;
  int n_seconds_ = 0;  ///< in minute_
  std::deque<Point> seconds_;
  std::deque<Point> minutes_;
};

}  // namespace haarlight::capture
