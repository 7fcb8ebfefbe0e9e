// SPDX-License-Identifier: Apache-2.0
#include "render/surface/irradiance_octree.h"

#include <cmath>

#include "haarlight/core/error.h"

namespace haarlight::render {

using Eigen::Vector3d;

namespace {

constexpr double kLeastCosine = 0.01;
constexpr double kMostBefore = 0.01;  // of R

}  // namespace

double reuse_weight(const RecordReach& record, const Vector3d& point, const Vector3d& normal) {
  const Vector3d way = point - record.point;
  const double squared = way.squaredNorm();
  if (!(squared < record.radius_mm * record.radius_mm)) {
    return 0.0;  // most of them: n.n' is at most 1
  }
  const double cosine = record.normal.dot(normal);
  if (!(cosine > kLeastCosine)) {
    return 0.0;
  }
  const double error = std::sqrt(squared) / (record.radius_mm * cosine);
  if (!(error < 1.0)) {
    return 0.0;
  }
  if (0.5 * way.dot(record.normal + normal) < -kMostBefore * record.radius_mm) {
    return 0.0;
  }
  return (1.0 - error) * (1.0 - error);
}

IrradianceOctree::IrradianceOctree(const Vector3d& lower, double side_mm)
    : lower_(lower), side_mm_(side_mm), nodes_(1) {
  HAARLIGHT_EXPECTS(side_mm >= 0.0 && lower.allFinite(), "a cube");
}

std::uint64_t IrradianceOctree::bytes() const noexcept {
  return records_.size() * (sizeof(IrradianceRecord) + sizeof(RecordReach)) +
         nodes_.size() * sizeof(Node) + n_entries_ * sizeof(std::uint32_t);
}

void IrradianceOctree::add(const IrradianceRecord& record) {
  HAARLIGHT_EXPECTS(record.reach.radius_mm > 0.0 && record.reach.point.allFinite(),
                    "a record that may be used somewhere");
  const auto number = static_cast<std::uint32_t>(records_.size());
  records_.push_back(record);
  reaches_.push_back(record.reach);
  add(number, 0, lower_, side_mm_);
}

void IrradianceOctree::add(std::uint32_t record, std::size_t node, const Vector3d& lower,
                           double side_mm) {
  const RecordReach& reach = reaches_[record];
  if (side_mm < 2.0 * reach.radius_mm) {
    nodes_[node].records.push_back(record);
    ++n_entries_;
    return;
  }
  const double half = 0.5 * side_mm;
  for (unsigned child = 0; child < 8; ++child) {
    const Vector3d corner =
        lower + half * Vector3d(child & 1U, (child >> 1U) & 1U, (child >> 2U) & 1U);
    // The borders belong to both sides: a point next to one is found however it is rounded.
    const double reaches = reach.radius_mm * (1.0 + 1e-9) + 1e-12 * side_mm_;
    if (((reach.point - corner).array() >= -reaches).all() &&
        ((reach.point - corner).array() <= half + reaches).all()) {
      std::int32_t next = nodes_[node].children[child];
      if (next < 0) {
        next = static_cast<std::int32_t>(nodes_.size());
        nodes_[node].children[child] = next;
        nodes_.emplace_back();
      }
      add(record, static_cast<std::size_t>(next), corner, half);
    }
  }
}

/// @param visit  (number, weight); returns whether to go on
template <class Visit>
void IrradianceOctree::visit(const Vector3d& point, const Vector3d& normal,
                             const Visit& visit) const {
  std::size_t node = 0;
  Vector3d lower = lower_;
  double half = 0.5 * side_mm_;
  for (;;) {
    for (const std::uint32_t record : nodes_[node].records) {
      const double weight = reuse_weight(reaches_[record], point, normal);
      if (weight > 0.0 && !visit(record, weight)) {
        return;
      }
    }
    unsigned child = 0;
    for (int axis = 0; axis < 3; ++axis) {
      if (point[axis] >= lower[axis] + half) {
        child |= 1U << static_cast<unsigned>(axis);
        lower[axis] += half;
      }
    }
    const std::int32_t next = nodes_[node].children[child];
    if (next < 0) {
      return;
    }
    node = static_cast<std::size_t>(next);
    half *= 0.5;
  }
}

std::optional<Vector3d> IrradianceOctree::irradiance(const Vector3d& point,
                                                     const Vector3d& normal) const {
  return irradiance_without(records_.size(), point, normal);
}

std::optional<Vector3d> IrradianceOctree::irradiance_without(std::size_t excluded,
                                                             const Vector3d& point,
                                                             const Vector3d& normal) const {
  Vector3d sum = Vector3d::Zero();
  double weights = 0.0;
  visit(point, normal, [&](std::uint32_t record, double weight) {
    if (record != excluded) {
      sum += weight * records_[record].at(point, normal);
      weights += weight;
    }
    return true;
  });
  return weights > 0.0 ? std::optional<Vector3d>(sum / weights) : std::nullopt;
}

bool IrradianceOctree::has_records_at(const Vector3d& point, const Vector3d& normal) const {
  bool has = false;
  visit(point, normal, [&](std::uint32_t /*record*/, double /*weight*/) {
    has = true;
    return false;
  });
  return has;
}

std::vector<std::uint32_t> IrradianceOctree::records_at(const Vector3d& point,
                                                        const Vector3d& normal) const {
  std::vector<std::uint32_t> found;
  visit(point, normal, [&](std::uint32_t record, double /*weight*/) {
    found.push_back(record);
    return true;
  });
  return found;
}

}  // namespace haarlight::render
