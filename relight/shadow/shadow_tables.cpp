// SPDX-License-Identifier: Apache-2.0
#include "relight/shadow/shadow_tables.h"

#include <algorithm>
#include <utility>

#include "core/parallel.h"
#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

constexpr std::size_t kLoadAtOnce = 16;  // pictures that wait for their tables

}  // namespace

ShadowTables::ShadowTables(std::span<const SamplingPlane> planes) : planes_(planes) {
  for (const SamplingPlane& plane : planes) {
    // Visible and unknown; the latter is usually shared, but need not be.
    bytes_a_light_ += 16ULL * static_cast<std::uint64_t>(plane.frame.width + 1) *
                      static_cast<std::uint64_t>(plane.frame.height + 1);
  }
}

void ShadowTables::hold(std::size_t n_tables) {
  peak_bytes_ = std::max<std::uint64_t>(peak_bytes_, kept_bytes_ + n_tables * bytes_a_light_);
}

void ShadowTables::count_picture(int light, std::size_t plane, const VisibilityCount& count) {
  const std::size_t at = static_cast<std::size_t>(light) * planes_.size() + plane;
  if (at >= is_counted_.size()) {
    is_counted_.resize(at + 1);
  }
  if (!is_counted_[at]) {
    is_counted_[at] = true;
    count_.add(count);
  }
}

ShadowTables::Tables ShadowTables::load_leaves(const render::LightRoot& root, std::size_t first,
                                               std::size_t last, Progress* progress) {
  const std::size_t n_planes = planes_.size();
  std::vector<std::optional<WindowSums>> loaded((last - first) * n_planes);
  std::vector<Visibility> pictures;
  const auto make_tables = [&](std::size_t end) {
    const std::size_t begin = end - pictures.size();
    parallel_for(pictures.size(), 1, [&](std::size_t from, std::size_t to) {
      for (std::size_t i = from; i < to; ++i) {
        loaded[begin + i].emplace(pictures[i].value.view(), pictures[i].known.view(),
                                  pictures[i].deviation);
      }
    });
    for (std::size_t i = begin; i < end; ++i) {
      if (i >= n_planes) {
        loaded[i]->share_unknown(*loaded[i - n_planes]);
      }
    }
    pictures.clear();
  };
  for (std::size_t i = 0; i < loaded.size(); ++i) {
    const SamplingPlane& plane = planes_[i % n_planes];
    const auto node = static_cast<std::size_t>(root.leaves[first + i / n_planes]);
    const int light = root.nodes[node].light;
    Visibility picture = plane.visibility(light);
    HAARLIGHT_EXPECTS(picture.value.width() == plane.frame.width &&
                          picture.value.height() == plane.frame.height,
                      "visibility in the plane's frame");
    count_picture(light, i % n_planes, picture.count);
    pictures.push_back(std::move(picture));
    if (pictures.size() == kLoadAtOnce * n_planes || i + 1 == loaded.size()) {
      make_tables(i + 1);
    }
    if (progress != nullptr && i % n_planes == 0) {
      progress->advance();
    }
  }
  Tables tables;
  tables.reserve(loaded.size());
  for (std::optional<WindowSums>& table : loaded) {
    tables.push_back(std::move(*table));
  }
  hold(last - first);
  return tables;
}

ShadowTables::Tables ShadowTables::load_tree(const render::LightRoot& root,
                                             Progress* progress) {
  const std::size_t n_planes = planes_.size();
  Tables leaves = load_leaves(root, 0, root.leaves.size(), progress);
  std::vector<std::optional<WindowSums>> made(root.nodes.size() * n_planes);
  for (std::size_t i = 0; i < root.leaves.size(); ++i) {
    for (std::size_t p = 0; p < n_planes; ++p) {
      made[static_cast<std::size_t>(root.leaves[i]) * n_planes + p].emplace(
          std::move(leaves[i * n_planes + p]));
    }
  }
  for (std::size_t at = root.nodes.size(); at-- > 0;) {
    const render::LightNode& node = root.nodes[at];
    if (node.n_children == 0) {
      continue;
    }
    parallel_for(n_planes, 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t p = begin; p < end; ++p) {
        std::vector<const WindowSums*> parts;
        std::vector<double> fractions;
        for (int c = 0; c < node.n_children; ++c) {
          const int child_index = node.first_child + c;
          const auto child = static_cast<std::size_t>(child_index);
          parts.push_back(&*made[child * n_planes + p]);
          fractions.push_back(root.nodes[child].fraction);
        }
        made[at * n_planes + p].emplace(parts, fractions);
      }
    });
  }
  Tables tables;
  tables.reserve(made.size());
  for (std::optional<WindowSums>& table : made) {
    tables.push_back(std::move(*table));
  }
  hold(root.nodes.size());
  return tables;
}

void ShadowTables::plan(std::span<const render::LightRoot> roots, std::uint64_t memory_bytes) {
  roots_ = roots;
  std::vector<std::uint64_t> largest(roots.size() + 1, 0);  // of the roots from here on
  for (std::size_t at = roots.size(); at-- > 0;) {
    largest[at] =
        std::max<std::uint64_t>(largest[at + 1], roots[at].nodes.size() * bytes_a_light_);
  }
  std::size_t n_kept = 0;
  std::uint64_t bytes = 0;
  for (; n_kept < roots.size(); ++n_kept) {
    bytes += roots[n_kept].nodes.size() * bytes_a_light_;
    if (bytes + largest[n_kept + 1] > memory_bytes) {
      break;
    }
  }
  kept_.assign(n_kept, std::nullopt);
  n_lights_not_kept_ = 0;
  for (const render::LightRoot& root : roots.subspan(n_kept)) {
    n_lights_not_kept_ += root.leaves.size();
  }
}

const ShadowTables::Tables& ShadowTables::tree(std::size_t at, Progress* progress) {
  const render::LightRoot& root = roots_[at];
  passing_.reset();
  if (has_tree(at)) {
    if (progress != nullptr) {
      progress->advance(root.leaves.size());
    }
    return *kept_[at];
  }
  std::optional<Tables>& made = at < kept_.size() ? kept_[at] : passing_;
  made = load_tree(root, progress);
  if (at < kept_.size()) {
    kept_bytes_ += root.nodes.size() * bytes_a_light_;
  }
  return *made;
}

void ShadowTables::release(std::size_t at) {
  passing_.reset();
  if (has_tree(at)) {
    kept_[at].reset();
    kept_bytes_ -= roots_[at].nodes.size() * bytes_a_light_;
  }
}

std::vector<const WindowSums*> leaf_tables(const render::LightRoot& root,
                                           const ShadowTables::Tables& tables,
                                           std::size_t n_planes) {
  std::vector<const WindowSums*> found;
  for (const int leaf : root.leaves) {
    for (std::size_t p = 0; p < n_planes; ++p) {
      found.push_back(&tables[static_cast<std::size_t>(leaf) * n_planes + p]);
    }
  }
  return found;
}

}  // namespace haarlight::relight
