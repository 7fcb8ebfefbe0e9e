// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/enum_words.h"
#include "haarlight/core/rig/patterns.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/session/session.h"

/// @file
/// What to photograph: a declarative plan file (docs/reference/plan-file.md) expands, for one
/// rig, to an immutable list of shots with a hash. The same file and rig always give the same
/// bytes. A plan that exceeds the rig's power limits is refused here, before anything is lit.

namespace haarlight::capture {

enum class PlanPatterns {
  one_at_a_time,
  bins,
  s_matrix,
  haar,
  list,
  lighting_haar,    ///< the wavelets that matter most to one lighting
  lighting_target,  ///< one shot (per colour) at the light weights of one lighting
};
inline constexpr auto kPlanPatternsWords = std::to_array<std::string_view>(
    {"one_at_a_time", "bins", "s_matrix", "haar", "list", "lighting_haar", "lighting_target"});
constexpr std::span<const std::string_view> words_of(PlanPatterns) {
  return kPlanPatternsWords;
}

/// The order in which the patterns are shown.
enum class ShotOrder {
  raster,             ///< by light number
  bit_reversed,       ///< index bits reversed: successive lights are far apart, O(n log n)
  greatest_distance,  ///< the next pattern is the farthest from the last eight, O(n^2)
};
inline constexpr auto kShotOrderWords =
    std::to_array<std::string_view>({"raster", "bit_reversed", "greatest_distance"});
constexpr std::span<const std::string_view> words_of(ShotOrder) { return kShotOrderWords; }

/// What a frame must satisfy to be accepted (capture/proof/frame_checks.h). A frame that does
/// not is retaken, each attempt kept in the session's aside/; the last attempt stands, with its
/// verdict in the evidence.
struct FrameLimits {
  double max_saturated_fraction = 1.0;  ///< of the plan's shortest exposure; 1 = no limit
  /// (mean - dark) / (white - black) of the longest exposure, at least; 0 = no limit
  double min_signal_fraction = 0.0;
  /// Greatest relative deviation of a frame's level from the prediction by an earlier frame of
  /// the same pattern; 0 = not checked.
  double level_tolerance = 0.2;
  int attempts = 3;  ///< per shot, at least 1
  /// Frames of the same lights whose pictures contradict each other are retaken until two
  /// agree; needs repeats (capture/proof/picture_agreement.h). Otherwise this is only reported.
  bool retake_wrong_light = false;
  friend bool operator==(const FrameLimits&, const FrameLimits&) = default;
};

/// The plan file's keys, range-checked but not yet checked against a rig.
struct PlanSettings {
  std::string name;
  PlanPatterns patterns = PlanPatterns::one_at_a_time;
  std::uint16_t level = 65535;  ///< of every light of a pattern, except `list`
  int bin = 2;                  ///< side of a block, for `bins`
  std::vector<std::vector<session::LightLevel>> list;  ///< for `list`
  std::string environment;  ///< for the lighting patterns: a picture, relative to the file
  int wavelets = 64;        ///< for `lighting_haar`: how many are kept
  std::vector<int> lights;  ///< subset for one_at_a_time; empty = all
  std::vector<double> exposures_us;  ///< brackets; empty = the camera's own
  int repeats = 1;
  int darks_every = 0;     ///< light shots between darks; 0 = none
  int sentinel_every = 0;  ///< light shots between sentinels; 0 = none
  int sentinel_light = 0;
  double darks_every_s = 0.0;     ///< predicted seconds between darks; 0 = none
  double sentinel_every_s = 0.0;  ///< predicted seconds between sentinels; 0 = none
  /// A spare dark frame as soon as the controller's temperature has changed by this much; 0 =
  /// none.
  double darks_every_c = 0.0;
  int spare_darks = 0;  ///< of each exposure, at its end unless called earlier by temperature
  int flats = 0;        ///< flat frames (all lights) before everything else
  std::uint16_t flat_level = 65535;
  double flat_exposure_us = 0.0;  ///< 0 = the first of the exposures
  ShotOrder order = ShotOrder::raster;
  double reserve_mb = 0.0;  ///< to be left free in addition to the frames' own space
  FrameLimits limits;
  std::string where;  ///< file name, for messages
};

/// @throws Error  every problem with file:line and a hint
[[nodiscard]] PlanSettings read_plan_file(const std::filesystem::path& path);
[[nodiscard]] PlanSettings parse_plan_file(const std::string& text, const std::string& name);

/// A lighting known before the capture: the light weights it needs.
struct Lighting {
  Eigen::MatrixXd weights;  ///< (n_lights, 1 or 3), not negative
  /// (n_lights) ||T_i|| of each Haar coefficient's picture, in any unit, from an earlier
  /// capture of the rig; empty: the rule for edges at unknown positions, size^1.5.
  Eigen::VectorXd norms;
};
/// Integrates an environment over the rig's lights. Only programs that may read pictures
/// provide one; the daemon does not.
using LightingReader = std::function<Lighting(const std::filesystem::path&, const Rig&)>;

/// The `n` coefficients that matter most to a lighting, including every face's mean: greatest
/// |l_i| ||T_i|| first (l_i over the colours by root sum of squares), ties by index. Ascending.
/// @param face  side of the faces, a power of two
[[nodiscard]] std::vector<int> choose_wavelets(const Lighting& lighting, int face, int n);

/// The immutable list of shots.
struct Plan {
  std::string name;
  int n_lights = 0;
  PatternParameters patterns;  ///< how develop recovers single lights from the shots
  double reserve_mb = 0.0;
  FrameLimits limits;
  /// Degrees C from the last dark frame's temperature at which the next is taken early; 0 =
  /// never.
  double darks_every_c = 0.0;
  std::vector<session::Shot> shots;
  std::string hash;  ///< content_hash of the JSON without its "hash" entry
};

/// Expands the settings for a rig. For each exposure, each repeat: [dark] [sentinel] patterns
/// in order with darks and sentinels between, and a closing dark and sentinel; after the
/// repeats of an exposure its spare darks.
/// @throws Error  a light the rig does not have, a family that does not fit the grid, a pattern
///                above a face's max_watts (face, watts and limit named), more than 10^6 shots
/// @param lighting  for the lighting patterns, which are refused without it
[[nodiscard]] Plan expand_plan(const PlanSettings& settings, const Rig& rig,
                               const Lighting* lighting = nullptr);

/// plan.json: canonical, so equal plans have equal bytes.
[[nodiscard]] std::string plan_to_json(const Plan& plan);
/// @throws Error  not a plan, or its hash does not match its shots; `where` is the file's name
[[nodiscard]] Plan plan_from_json(const std::string& json, const std::string& where);
/// Reads a plan file, or an existing plan.json, by its extension, and checks it against the
/// rig.
/// @throws Error  as above
[[nodiscard]] Plan load_plan(const std::filesystem::path& path, const Rig& rig,
                             const LightingReader& read_lighting = {});

/// Checks a plan against the watts of faces and strings, whole PWM periods where lights are
/// dimmed by PWM, the elements' duty and the sync mode: everything for which a plan is refused
/// before anything is lit.
/// @throws Error  naming shot, face, what it needs and the limit
void require_limits(const Plan& plan, const Rig& rig, const std::string& where);

/// @throws Error  naming shot, face or string, watts and limit
void require_power(const Plan& plan, const Rig& rig, const std::string& where);

/// @throws Error  camera leads: an exposure that does not fit, with the arithmetic and hints
void require_sync(const Plan& plan, const Rig& rig, const std::string& where);

/// What a plan will cost.
struct DryRun {
  int n_shots = 0;
  int n_light_shots = 0;
  double frames_a_shot = 0.0;  ///< frame times from one latch to the next
  double seconds = 0.0;        ///< of all shots, including dark_seconds
  /// Before the first light where the camera free-runs, and again after each restart of the
  /// camera: its period is learnt.
  double dark_seconds = 0.0;
  std::uint64_t bytes = 0;      ///< of all frames on disk
  double bytes_a_second = 0.0;  ///< over the time of the shots
  double peak_watts = 0.0;      ///< of the worst shot, all faces
  double mean_watts = 0.0;      ///< over the time of the shots
  double highest_duty = 0.0;    ///< fraction of the shots' time with the busiest light on
  int busiest_light = -1;
};

/// Time by sync mode: in free-run from latch round trip, settle, exposure and readout; in the
/// triggered modes one frame time per shot.
[[nodiscard]] DryRun dry_run(const Plan& plan, const Rig& rig);

}  // namespace haarlight::capture
