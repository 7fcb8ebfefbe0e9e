// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

/// @file
/// Records of irradiance and where each may be used [Ward88]: an octree finds those of a point.

namespace haarlight::render {

/// Where a record may be used: about a point of a surface.
struct RecordReach {
  Eigen::Vector3d point = Eigen::Vector3d::Zero();    ///< world, mm
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();  ///< unit, world
  double radius_mm = 0.0;                             ///< R, above 0
};

/// What a record has of another point: (1 - err)^2 with err = d/(R n.n'), where err < 1, n.n' > 0.01
/// and the point is no further before the record than (x - p).(n + n')/2 >= -0.01 R [Ward88]; else 0.
[[nodiscard]] double reuse_weight(const RecordReach& record, const Eigen::Vector3d& point,
                                  const Eigen::Vector3d& normal);

/// Indirect irradiance at a point, RGB, and how it changes about it [Ward92].
struct IrradianceRecord {
  RecordReach reach;
  Eigen::Vector3d irradiance = Eigen::Vector3d::Zero();
  /// dE/dturn and dE/dshift, a row for each colour: E changes by turn.(n x n') + shift.(x - p).
  Eigen::Matrix3d by_turn = Eigen::Matrix3d::Zero();
  Eigen::Matrix3d by_shift = Eigen::Matrix3d::Zero();

  /// As this record alone foretells it elsewhere, at least 0.
  [[nodiscard]] Eigen::Vector3d at(const Eigen::Vector3d& point,
                                   const Eigen::Vector3d& normal) const {
    return (irradiance + by_turn * reach.normal.cross(normal) +
            by_shift * (point - reach.point))
        .cwiseMax(0.0);
  }
};

/// A record is in the nodes of one level that the box about its sphere overlaps, where nodes are as large
/// as its radius or up to twice that: a point's records are found on one way from the root.
class IrradianceOctree {
 public:
  /// @param lower, side_mm  a cube about all points
  IrradianceOctree(const Eigen::Vector3d& lower, double side_mm);

  void add(const IrradianceRecord& record);

  [[nodiscard]] std::span<const IrradianceRecord> records() const noexcept { return records_; }
  /// Of records and nodes.
  [[nodiscard]] std::uint64_t bytes() const noexcept;

  /// The mean over the records of the point, by their weights; nothing: there is none. Thread-safe
  /// while none is added. @param normal  unit
  [[nodiscard]] std::optional<Eigen::Vector3d> irradiance(const Eigen::Vector3d& point,
                                                          const Eigen::Vector3d& normal) const;
  /// The same without the record of that number.
  [[nodiscard]] std::optional<Eigen::Vector3d> irradiance_without(
      std::size_t record, const Eigen::Vector3d& point, const Eigen::Vector3d& normal) const;
  [[nodiscard]] bool has_records_at(const Eigen::Vector3d& point,
                                    const Eigen::Vector3d& normal) const;
  /// The numbers of the records of the point, in the order in which they are summed.
  [[nodiscard]] std::vector<std::uint32_t> records_at(const Eigen::Vector3d& point,
                                                      const Eigen::Vector3d& normal) const;

 private:
  struct Node {
    std::array<std::int32_t, 8> children{-1, -1, -1, -1, -1, -1, -1, -1};
    std::vector<std::uint32_t> records;
  };
  void add(std::uint32_t record, std::size_t node, const Eigen::Vector3d& lower,
           double side_mm);
  template <class Visit>
  void visit(const Eigen::Vector3d& point, const Eigen::Vector3d& normal,
             const Visit& visit) const;

  Eigen::Vector3d lower_;
  double side_mm_;
  std::vector<Node> nodes_;
  std::vector<RecordReach> reaches_;  ///< those of the records, close together
  std::vector<IrradianceRecord> records_;
  std::uint64_t n_entries_ = 0;
};

}  // namespace haarlight::render
