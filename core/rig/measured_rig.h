// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "haarlight/core/rig/rig.h"

/// @file
/// What a command measured on a rig: NAME.measured.toml next to the hand-written NAME.toml.
/// read_rig() joins both texts, the written one first, to one valid TOML file, which is what a
/// session keeps as its rig.toml, so that the rig of a session is exactly the one it was shot
/// with. Measured values win. Keys: docs/reference/rig-file.md.

namespace haarlight {

/// A measured number with its standard uncertainty and how many samples it came from.
struct Measured {
  double value = 0.0;
  double sigma = 0.0;
  std::int64_t n = 0;
};

/// A camera's lens from pictures of a chessboard, as in CameraModel.
struct MeasuredLens {
  Eigen::Vector4d k = Eigen::Vector4d::Zero();  ///< fx, fy, cx, cy, pixels (centres at +0.5)
  Eigen::Vector4d k_sigma = Eigen::Vector4d::Zero();
  Eigen::Matrix<double, 5, 1> distortion = Eigen::Matrix<double, 5, 1>::Zero();
  Eigen::Matrix<double, 5, 1> distortion_sigma = Eigen::Matrix<double, 5, 1>::Zero();
  double rms_px = 0.0;
  int n_views = 0;
};

struct MeasuredCamera {
  std::string id;
  std::string with;      ///< describe_camera() at that time
  std::string identity;  ///< as the camera identified itself; empty: not known
  std::optional<TimestampMeaning> timestamp;
  std::string evidence;  ///< for the timestamp, in words
  std::optional<Measured> read_us;
  std::optional<Measured> skew_us;
  std::optional<Measured> ready_us;  ///< end of exposure to the frame's arrival at the host
  std::optional<Measured> exposure_delay_frames;
  std::optional<Measured> gain_e_per_dn;
  std::optional<Measured> read_e;
  std::optional<Measured> full_well_e;
  std::optional<Measured> black_dn;
  std::optional<Measured> linearity_percent;  ///< largest departure from a line, 5 to 95 %
  std::optional<MeasuredLens> lens;
};

/// A shadow plane from a picture of a chessboard on it, in the world of its camera's pose.
struct MeasuredPlane {
  std::string id;
  std::string with;  ///< describe_view() of the camera that saw it
  std::string camera;
  Eigen::Vector3d n = Eigen::Vector3d::UnitZ();
  double d = 0.0;
  double distance_sigma = 0.0;  ///< of its distance from the camera, mm
  double tilt_sigma_deg = 0.0;
  double rms_px = 0.0;
};

struct MeasuredController {
  std::string with;      ///< describe_controller() at that time
  std::string identity;  ///< "haarlight-sim, serial 1"
  std::optional<Measured> latch_us;
  /// The latest change of light, with 99 % confidence and this file's read_us: what captures
  /// wait for. Empty in files of versions that measured only the mean.
  std::optional<Measured> latch_most_us;
  std::optional<Measured> rise_us;
  std::optional<Measured> fall_us;
  std::optional<Measured> ack_us;  ///< round trip of the latch request
};

struct MeasuredLights {
  std::string with;  ///< describe_lights() at that time
  std::vector<int> dead;
  std::vector<int> unseen;       ///< too little of their light reaches the camera
  std::vector<int> miswired;     ///< light k ...
  std::vector<int> miswired_to;  ///< ... shines from the position of this one
  std::vector<double> power;     ///< of each light, 1 = the median; 0 = dead
  double power_sigma = 0.0;
  std::int64_t n = 0;  ///< frames per light
};

/// A face as calibration found it.
struct MeasuredFace {
  std::string id;
  std::string with;  ///< describe_face() at that time
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  Eigen::Vector3d centre_sigma = Eigen::Vector3d::Zero();  ///< mm, along the world's axes
  Eigen::Vector3d u = Eigen::Vector3d::UnitX();
  Eigen::Vector3d v = Eigen::Vector3d::UnitY();
  Eigen::Vector3d emits = -Eigen::Vector3d::UnitZ();
  Eigen::Vector3d turn_sigma_deg = Eigen::Vector3d::Zero();  ///< about the world's axes
  std::optional<Measured> lobe_mu;
  std::vector<double> power;        ///< of each light, mean 1; 0: unseen
  std::vector<double> power_sigma;  ///< relative
  double reduced_chi2 = 0.0;        ///< 1: noise alone
};

struct MeasuredRig {
  std::string date;      ///< ISO 8601, UTC
  std::string tool;      ///< "haarlight 0.1.0"
  std::string rig_hash;  ///< content_hash of the hand-written text at that time
  std::optional<MeasuredController> controller;
  std::optional<MeasuredLights> lights;
  std::vector<MeasuredFace> faces;
  std::vector<MeasuredPlane> planes;
  std::vector<MeasuredCamera> cameras;
};

/// NAME.measured.toml for NAME.toml.
[[nodiscard]] std::filesystem::path measured_path(const std::filesystem::path& rig_file);

/// The TOML text. parse_measured() of it gives the same values (numbers to 9 digits).
[[nodiscard]] std::string to_toml(const MeasuredRig& measured);
/// @throws Error  every problem with file:line and a hint
[[nodiscard]] MeasuredRig parse_measured(const std::string& text, const std::string& name);

/// What a file of an earlier version lacks, as text for a warning; empty: nothing.
struct MeasuredGap {
  std::string problem;
  std::string hint;
};
[[nodiscard]] MeasuredGap find_gap(const MeasuredRig& measured);

/// A rig's text in its two parts, the second empty when there is no measured one.
struct RigText {
  std::string written;   ///< ends with a line end when something follows
  std::string measured;  ///< begins with its marker line
};
[[nodiscard]] RigText split_rig_text(const std::string& text);
/// @throws Error  `measured` has no marker line
[[nodiscard]] std::string join_rig_text(const RigText& text, const std::string& measured_name);

/// The settings for which a measurement holds, as text; a different text makes it stale.
/// Addresses and device nodes are not among them: the device's identity represents them.
[[nodiscard]] std::string describe_camera(const CameraSpec& camera);
[[nodiscard]] std::string describe_controller(const ControllerSpec& controller);
[[nodiscard]] std::string describe_lights(const Rig& rig);
[[nodiscard]] std::string describe_face(const Face& face);
/// The camera's pose, as in the rig file.
[[nodiscard]] std::string describe_view(const CameraSpec& camera);

/// Puts the measured values over the written ones and keeps them in rig.measured.
/// @throws Error  measured with other settings than the rig has now
void apply_measured(MeasuredRig measured, const std::string& name, Rig& rig);

/// What differs, for the log: "latch 812 us (the rig file says 200)". Empty: nothing.
[[nodiscard]] std::string describe_changes(const Rig& written, const Rig& merged);

/// @throws Error(unavailable)  the camera that answers is not the one that was measured; no
///                             error where nothing was measured or the identity is not known
void require_measured_camera(const Rig& rig, std::string_view camera_id,
                             const std::string& identity);

}  // namespace haarlight
