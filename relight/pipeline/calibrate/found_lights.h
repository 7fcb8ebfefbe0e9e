// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "core/report.h"
#include "haarlight/core/image.h"
#include "haarlight/session/session.h"

/// @file
/// Lights as a calibration found them: the lists that import, fit and shape read, a table for
/// users, entries of a report.

namespace haarlight::relight {

/// A light as it was found. Frame: x right, y up, z to the camera; for a rig its world.
struct FoundLight {
  std::string name;
  std::string finding = "good";  ///< "weak", "unseen: why"
  std::optional<Eigen::Vector3d> position_mm;
  std::optional<Eigen::Vector3d> sigma_mm;              ///< nothing: not known
  Eigen::Vector3d direction = Eigen::Vector3d::Zero();  ///< unit, from the origin; 0: unseen
  std::optional<double> sigma_deg;
  Eigen::Vector3d power = Eigen::Vector3d::Ones();  ///< mean 1 over the lights
  std::optional<double> power_sigma;                ///< relative; nothing: not known
  std::optional<double> used;                       ///< fraction of the samples
  std::optional<session::LightLobe> lobe;

  [[nodiscard]] bool is_seen() const { return !direction.isZero(0.0); }
};

/// The result of a calibration.
struct FoundLights {
  std::vector<FoundLight> lights;
  std::string frame;  ///< in words
  bool has_powers = false;
  bool is_good =
      true;  ///< false: the pictures contradict the model, or the fit did not converge
  /// A picture next to the lists, and its name; empty: none.
  Image<float> picture;
  std::string picture_name;
  double picture_exposure = 1.0;
};

/// Refuses what could not be written, before any work is done.
/// @throws Error(usage)  it exists and may not be overwritten; a folder where a list is
///                       requested, or vice versa
void require_writable(const std::filesystem::path& out, bool overwrites);
/// The lists (lights.json, lights.lp, lights.csv) and the picture into a folder, or the one
/// list that `out` names by its extension. @return  bytes
/// @throws Error(io)
std::uint64_t write_found(const FoundLights& found, const std::filesystem::path& out);

/// A line for each light with its end; empty if there are too many to read.
[[nodiscard]] std::string found_table(const FoundLights& found);
/// How many were found, and how accurately: one line with its end.
[[nodiscard]] std::string found_line(const FoundLights& found);
/// The same for a report.
void report_found(const FoundLights& found, Report& report);

/// The standard error of a direction from that of a position, degrees along each of two axes.
[[nodiscard]] double direction_sigma_deg(const Eigen::Vector3d& position_mm,
                                         const Eigen::Matrix3d& covariance_mm2);

}  // namespace haarlight::relight
