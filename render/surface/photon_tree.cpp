// SPDX-License-Identifier: Apache-2.0
#include "render/surface/photon_tree.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include <nanoflann.hpp>

#include "haarlight/core/error.h"

namespace haarlight::render {

namespace {

using Eigen::Vector3f;

constexpr float kSameSide = 0.7071F;    // cosine of 45 degrees
constexpr float kBent = 0.1F;           // height over distance, where a surface is bent
constexpr float kFlat = 1e-3F;          // of another surface beside it
constexpr float kSiteRounding = 1e-6F;  // some roundings of coordinates of size 1
constexpr double kLeastRadius = 1e-6;   // photons that coincide but for rounding
constexpr std::size_t kLeafPhotons = 16;

struct SiteCloud {
  std::vector<PhotonSite> sites;
  // Names that nanoflann asks for.
  [[nodiscard]] std::size_t kdtree_get_point_count() const { return sites.size(); }
  [[nodiscard]] float kdtree_get_pt(std::uint32_t i, std::size_t axis) const {
    return sites[i].position[static_cast<Eigen::Index>(axis)];
  }
  template <class Box>
  bool kdtree_get_bbox(Box& /*box*/) const {
    return false;
  }
};

using Index = nanoflann::KDTreeSingleIndexAdaptor<
    nanoflann::L2_Simple_Adaptor<float, SiteCloud, float, std::uint32_t>, SiteCloud, 3,
    std::uint32_t>;

bool is_nearer(const NearPhoton& a, const NearPhoton& b) {
  return std::pair(a.squared_distance, a.index) < std::pair(b.squared_distance, b.index);
}

/// The k nearest so far, in a heap [Jensen01]: the farthest is on top.
class NearestHeap {
 public:
  using DistanceType = float;

  NearestHeap(const SiteCloud& cloud, const PhotonSite& at, std::size_t k, float most_squared,
              std::vector<NearPhoton>& heap)
      : cloud_(&cloud), at_(&at), k_(k), most_squared_(most_squared), heap_(&heap) {
    heap.clear();
  }

  [[nodiscard]] std::size_t size() const { return heap_->size(); }
  [[nodiscard]] bool full() const { return true; }  // there is always a farthest distance
  [[nodiscard]] float worstDist() const {           // NOLINT(readability-identifier-naming)
    return heap_->size() == k_ ? heap_->front().squared_distance : most_squared_;
  }
  bool addPoint(float squared_distance, std::uint32_t index) {  // NOLINT
    if (!(squared_distance < worstDist()) || !is_on_same_side(cloud_->sites[index], *at_)) {
      return true;
    }
    if (heap_->size() == k_) {
      std::ranges::pop_heap(*heap_, is_nearer);
      heap_->pop_back();
    }
    heap_->push_back({squared_distance, index});
    std::ranges::push_heap(*heap_, is_nearer);
    return true;
  }

 private:
  const SiteCloud* cloud_;
  const PhotonSite* at_;
  std::size_t k_;
  float most_squared_;
  std::vector<NearPhoton>* heap_;
};

/// The nearest so far.
class NearestOne {
 public:
  using DistanceType = float;

  NearestOne(const SiteCloud& cloud, const PhotonSite& at, float most_squared)
      : cloud_(&cloud), at_(&at), worst_(most_squared) {}

  [[nodiscard]] const std::optional<std::uint32_t>& found() const { return found_; }
  [[nodiscard]] std::size_t size() const { return found_ ? 1 : 0; }
  [[nodiscard]] bool full() const { return true; }
  [[nodiscard]] float worstDist() const { return worst_; }      // NOLINT
  bool addPoint(float squared_distance, std::uint32_t index) {  // NOLINT
    if (squared_distance < worst_ && is_on_same_side(cloud_->sites[index], *at_)) {
      worst_ = squared_distance;
      found_ = index;
    }
    return true;
  }

 private:
  const SiteCloud* cloud_;
  const PhotonSite* at_;
  float worst_;
  std::optional<std::uint32_t> found_;
};

}  // namespace

bool is_on_same_side(const PhotonSite& photon, const PhotonSite& at) {
  if (photon.normal.dot(at.normal) < kSameSide) {
    return false;
  }
  const Vector3f way = photon.position - at.position;
  const float height = std::abs(way.dot(at.normal));
  const float slope = photon.surface == at.surface ? kBent : kFlat;
  return height <= slope * way.norm() + kSiteRounding;
}

struct SiteTree::Impl {
  explicit Impl(std::vector<PhotonSite> all)
      : cloud{std::move(all)},
        index(3, cloud, nanoflann::KDTreeSingleIndexAdaptorParams(kLeafPhotons)),
        order(index.vAcc) {
    // A leaf's sites beside each other: they are searched together.
    std::vector<PhotonSite> in_order;
    in_order.reserve(order.size());
    for (std::size_t i = 0; i < order.size(); ++i) {
      in_order.push_back(cloud.sites[order[i]]);
      index.vAcc[i] = static_cast<std::uint32_t>(i);
    }
    cloud.sites = std::move(in_order);
  }
  SiteCloud cloud;
  Index index;
  std::vector<std::uint32_t> order;
};

SiteTree::SiteTree(std::vector<PhotonSite> sites)
    : impl_(std::make_unique<Impl>(std::move(sites))) {}
SiteTree::~SiteTree() = default;
SiteTree::SiteTree(SiteTree&&) noexcept = default;
SiteTree& SiteTree::operator=(SiteTree&&) noexcept = default;

std::uint64_t SiteTree::bytes_needed(std::size_t n_sites) {
  // Leaves are at least half full; two nodes for each, of nanoflann's pool.
  constexpr std::uint64_t kNode = 64;
  return n_sites * (sizeof(PhotonSite) + 2 * sizeof(std::uint32_t) + 4 * kNode / kLeafPhotons);
}

std::size_t SiteTree::size() const noexcept { return impl_->cloud.sites.size(); }

const PhotonSite& SiteTree::operator[](std::size_t i) const { return impl_->cloud.sites[i]; }

const std::vector<std::uint32_t>& SiteTree::order() const noexcept { return impl_->order; }

std::optional<std::uint32_t> SiteTree::nearest(const PhotonSite& at, double most_radius) const {
  if (size() == 0) {
    return std::nullopt;
  }
  NearestOne one(impl_->cloud, at, static_cast<float>(most_radius * most_radius));
  impl_->index.findNeighbors(one, at.position.data(), nanoflann::SearchParams());
  return one.found();
}

void SiteTree::nearest(const PhotonSite& at, std::size_t k, double most_radius,
                       NearPhotons& found) const {
  HAARLIGHT_EXPECTS(k >= 1, "at least one photon");
  found.radius = most_radius;
  found.has_kth = false;
  found.photons.clear();
  if (size() == 0) {
    return;
  }
  NearestHeap heap(impl_->cloud, at, k, static_cast<float>(most_radius * most_radius),
                   found.photons);
  impl_->index.findNeighbors(heap, at.position.data(), nanoflann::SearchParams());
  if (found.photons.size() == k) {
    found.has_kth = true;
    found.radius =
        std::max(kLeastRadius, std::sqrt(double{found.photons.front().squared_distance}));
  }
}

void weigh(PhotonKernel kernel, const NearPhotons& found, std::vector<double>& weights) {
  const double squared_radius = found.radius * found.radius;
  const double even = 1.0 / (std::numbers::pi * squared_radius);
  weights.resize(found.photons.size());
  for (std::size_t i = 0; i < weights.size(); ++i) {
    weights[i] = kernel == PhotonKernel::epanechnikov
                     ? 2.0 * even *
                           std::max(0.0, 1.0 - double{found.photons[i].squared_distance} /
                                                   squared_radius)
                     : even;
  }
  // The k-th sets the radius, and is not counted: so is its part of an even density.
  if (kernel == PhotonKernel::constant && found.has_kth) {
    weights.front() = 0.0;
  }
}

}  // namespace haarlight::render
