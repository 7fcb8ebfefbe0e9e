// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "apps/haarlight/verb.h"
#include "core/image.h"
#include "core/picture/image_io.h"
#include "core/rig/camera_model.h"
#include "session/session.h"

/// @file
/// `haarlight calibrate INPUT -o OUT`: where lights are and how strong, from pictures of a flat
/// sheet or of mirror balls. What its parts share: options, pictures, the list of lights that
/// was found.

namespace haarlight {

struct FindLightsArguments {
  std::string input;
  std::string out;
  std::string target;  ///< "ball", "sheet"; empty: what the input says
  std::vector<std::string> exclude;
  std::string transfer = "file";
  double width_mm = 0.0;   ///< 0: not given
  double camera_mm = 0.0;  ///< 0: not given
  double focal_px = 0.0;   ///< 0: not given
  // balls
  std::vector<std::string> masks;
  int n_balls = 1;
  std::vector<double> radius_mm;
  double edge_px = 0.5;
  // a sheet
  std::vector<double> region;
  std::string aim = "centre";
  double aim_deg = 3.0;
  double tilt_deg = 1.0;
  double led_mm = 0.0;
  std::string lobe = "free";
  double mu = 1.0;
  double bow_mm = 1.0;
  int samples = 32;
  bool is_bent = false;
  std::vector<int> grid;  ///< rows, columns
  double pitch_mm = 0.0;
  // a rig
  std::string rig;
  double sheet_mm = 0.0;
  std::string page;
};

/// One picture a light, read when it is asked for.
class LightPictures {
 public:
  /// A session, or a folder of pictures in natural order of their names.
  /// @throws Error  nothing there, fewer than one picture, one picture twice
  [[nodiscard]] static LightPictures open(const FindLightsArguments& arguments,
                                          const CommonOptions& common);

  [[nodiscard]] const std::vector<std::string>& names() const { return names_; }
  [[nodiscard]] int size() const { return static_cast<int>(names_.size()); }
  /// Of the first picture.
  [[nodiscard]] int width() const { return width_; }
  [[nodiscard]] int height() const { return height_; }
  [[nodiscard]] int channels() const { return channels_; }
  [[nodiscard]] const Session* session() const { return session_ ? &*session_ : nullptr; }

  /// In order, each in linear light. `clip`: from here on a value is saturated.
  /// @throws Error  naming the picture that cannot be read, is of another size, or holds a
  ///                number that is none
  using Visit = std::function<void(int light, const Image<float>& picture, float clip)>;
  void for_each(const Visit& visit) const;

 private:
  void for_each_file(const Visit& visit) const;

  std::filesystem::path folder_;
  std::vector<std::string> names_;
  std::optional<Transfer> transfer_;
  std::optional<Session> session_;
  std::string unknown_as_;
  CommonOptions common_;
  int width_ = 0;
  int height_ = 0;
  int channels_ = 0;
};

/// A light as it was found. Frame: x right, y up, z to the camera; of a rig its world.
struct FoundLight {
  std::string name;
  std::string finding = "good";  ///< "weak", "unseen: why"
  std::optional<Eigen::Vector3d> position_mm;
  std::optional<Eigen::Vector3d> sigma_mm;              ///< nothing: not known
  Eigen::Vector3d direction = Eigen::Vector3d::Zero();  ///< unit, from the origin; 0: unseen
  std::optional<double> sigma_deg;
  Eigen::Vector3d power = Eigen::Vector3d::Ones();  ///< mean 1 over the lights
  std::optional<double> power_sigma;                ///< relative; nothing: not known
  std::optional<double> used;                       ///< share of the samples
  std::optional<LightLobe> lobe;

  [[nodiscard]] bool is_seen() const { return !direction.isZero(0.0); }
};

/// What a calibration ends with.
struct FoundLights {
  std::vector<FoundLight> lights;
  std::string frame;  ///< in words
  bool has_powers = false;
  bool is_good = true;  ///< false: exit code 1
  /// A picture beside the lists, and its name; empty: none.
  Image<float> picture;
  std::string picture_name;
  double picture_exposure = 1.0;
};

/// Refuses what could not be written, before the work is done.
void require_writable(const FindLightsArguments& arguments, const CommonOptions& common);
/// The lists (lights.json, lights.lp, lights.csv) and the picture into a folder, or the one
/// list that OUT names by its ending. @return  bytes
std::uint64_t write_found(const FoundLights& found, const FindLightsArguments& arguments);
/// A table of the lights, and what is known of all of them, into report and standard output.
void tell_found(const FoundLights& found, const CommonOptions& common, Report& report);

/// The standard error of a direction from that of a place, degrees along each of two axes.
[[nodiscard]] double direction_sigma_deg(const Eigen::Vector3d& position_mm,
                                         const Eigen::Matrix3d& covariance_mm2);

FoundLights find_by_balls(const FindLightsArguments& arguments, const LightPictures& pictures,
                          const CommonOptions& common, Report& report);
FoundLights find_by_sheet(const FindLightsArguments& arguments, const LightPictures& pictures,
                          const CommonOptions& common, Report& report);
/// Of a session with a rig: each face as a rigid array, as `haarlight rig calibrate lights`.
FoundLights find_by_rig(const FindLightsArguments& arguments, const Session& session,
                        const CommonOptions& common, Report& report);

}  // namespace haarlight
