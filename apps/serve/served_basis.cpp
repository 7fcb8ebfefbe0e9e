// SPDX-License-Identifier: Apache-2.0
#include "apps/serve/served_basis.h"

#include <algorithm>
#include <numbers>
#include <span>

#include "haarlight/core/files.h"
#include "relight/basis/basis_check.h"

namespace haarlight::apps {

namespace {

constexpr std::size_t kFoundBytes = std::size_t{32} << 20U;  // of weights kept

/// Every block is decoded once: now, where they are not unpacked anyway.
relight::Relighter make_relighter(const relight::BasisFile& basis, std::uint64_t memory_bytes) {
  if (relight::ResidentBasis::bytes_of(basis) > memory_bytes) {
    relight::check_basis(basis);
  }
  return {basis, {.use = relight::RelighterPlan::Use::served, .memory_bytes = memory_bytes}};
}

}  // namespace

ServedBasis::ServedBasis(const std::filesystem::path& file, std::uint64_t memory_bytes)
    : name_(file.stem().string()),
      bytes_(read_file(file, memory_bytes)),
      basis_(relight::BasisFile::from_bytes(std::as_bytes(std::span(bytes_)), file.string())),
      lights_(basis_),
      relighter_(make_relighter(basis_, memory_bytes - bytes_.size())),
      most_found_(std::clamp<std::size_t>(
          kFoundBytes /
              (static_cast<std::size_t>(basis_.header().dims.n_lights) * 7 * sizeof(double)),
          4, 1024)) {}

std::shared_ptr<const relight::EnvironmentWeights> ServedBasis::weights(
    const SkyShelf::Sky& sky, double rotate_deg) const {
  {
    const std::lock_guard lock(mutex_);
    const auto same = std::find_if(found_.begin(), found_.end(), [&](const Found& found) {
      return found.rotate_deg == rotate_deg && found.environment.lock() == sky.environment;
    });
    if (same != found_.end()) {
      found_.splice(found_.begin(), found_, same);
      return found_.front().weights;
    }
  }
  auto weights = std::make_shared<const relight::EnvironmentWeights>(
      lights_.weights(*sky.environment, rotate_deg * std::numbers::pi / 180.0));
  const std::lock_guard lock(mutex_);
  found_.push_front({sky.environment, rotate_deg, weights});
  if (found_.size() > most_found_) {
    found_.pop_back();
  }
  return weights;
}

}  // namespace haarlight::apps
