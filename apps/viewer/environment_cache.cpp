// SPDX-License-Identifier: Apache-2.0
#include "apps/viewer/environment_cache.h"

#include <algorithm>
#include <exception>
#include <numbers>
#include <utility>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "relight/pipeline/light_choice.h"

namespace haarlight::apps {

EnvironmentCache::EnvironmentCache(const relight::BasisFile& basis) : lights_(basis) {
  worker_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
}

EnvironmentCache::~EnvironmentCache() = default;

std::string EnvironmentCache::add(std::string bytes, std::string name) {
  auto entry = std::make_shared<Entry>();
  entry->name = std::move(name);
  entry->bytes = std::move(bytes);
  const std::lock_guard lock(mutex_);
  entry->id = std::to_string(++n_added_);
  entries_.push_front(entry);
  if (entries_.size() > kMostKept) {
    entries_.pop_back();
  }
  work_.notify_all();
  return entry->id;
}

std::shared_ptr<EnvironmentCache::Entry> EnvironmentCache::find_locked(
    const std::string& id) const {
  const auto found = std::find_if(entries_.begin(), entries_.end(),
                                  [&id](const auto& entry) { return entry->id == id; });
  if (found == entries_.end()) {
    throw Error(fmt::format("no environment {}", id), "viewer",
                fmt::format("load it again: the last {} are kept", kMostKept));
  }
  if ((*found)->problem) {
    throw Error(*(*found)->problem);
  }
  return *found;
}

std::optional<std::string> EnvironmentCache::layout(const std::string& id) {
  const std::lock_guard lock(mutex_);
  const std::shared_ptr<Entry> entry = find_locked(id);
  if (!entry->full) {
    return std::nullopt;
  }
  return std::string(to_string(entry->full->layout()));
}

std::optional<relight::EnvironmentWeights> EnvironmentCache::weights(const std::string& id,
                                                                     double rotate_deg,
                                                                     Quality quality) {
  std::shared_ptr<const render::Environment> quick;
  {
    const std::lock_guard lock(mutex_);
    const std::shared_ptr<Entry> entry = find_locked(id);
    if (quality == Quality::exact) {
      if (entry->found && entry->found_deg == rotate_deg) {
        return entry->found;
      }
      entry->wanted_deg = rotate_deg;
      work_.notify_all();
      return std::nullopt;
    }
    quick = entry->quick;
  }
  return quick ? std::optional(weights_of(*quick, rotate_deg)) : std::nullopt;
}

relight::EnvironmentWeights EnvironmentCache::weights_of(const render::Environment& environment,
                                                         double rotate_deg) const {
  return lights_.weights(environment, rotate_deg * std::numbers::pi / 180.0);
}

void EnvironmentCache::read(const std::shared_ptr<Entry>& entry) {
  std::string bytes;
  {
    const std::lock_guard lock(mutex_);
    bytes = std::move(entry->bytes);
    entry->bytes.clear();
  }
  std::shared_ptr<const render::Environment> full;
  std::optional<Error> problem;
  try {
    full = std::make_shared<const render::Environment>(
        relight::environment_from_bytes(bytes, entry->name));
  } catch (const Error& error) {
    problem = error;
  } catch (const std::exception& error) {
    problem = Error(error.what(), entry->name, "give another picture", ExitCode::internal);
  }
  auto quick = full ? std::make_shared<const render::Environment>(full->reduced(kQuickAcross))
                    : std::shared_ptr<const render::Environment>();
  const std::lock_guard lock(mutex_);
  entry->full = std::move(full);
  entry->quick = std::move(quick);
  entry->problem = std::move(problem);
}

void EnvironmentCache::integrate(const std::shared_ptr<Entry>& entry) {
  std::shared_ptr<const render::Environment> full;
  double angle = 0.0;
  {
    const std::lock_guard lock(mutex_);
    full = entry->full;
    angle = *entry->wanted_deg;
  }
  std::optional<relight::EnvironmentWeights> found;
  std::optional<Error> problem;
  try {
    found = weights_of(*full, angle);
  } catch (const Error& error) {
    problem = error;
  } catch (const std::exception& error) {
    problem = Error(error.what(), entry->name, "give another picture", ExitCode::internal);
  }
  const std::lock_guard lock(mutex_);
  entry->problem = std::move(problem);
  entry->found = std::move(found);
  entry->found_deg = angle;
  if (entry->wanted_deg == angle) {
    entry->wanted_deg.reset();
  }
}

void EnvironmentCache::run(const std::stop_token& stop) {
  std::unique_lock lock(mutex_);
  while (!stop.stop_requested()) {
    const auto is_unread = [](const auto& e) { return !e->full && !e->problem; };
    const auto is_wanted = [](const auto& e) {
      return e->full && !e->problem && e->wanted_deg;
    };
    auto next = std::find_if(entries_.begin(), entries_.end(), is_unread);
    const bool reads = next != entries_.end();
    if (!reads) {
      next = std::find_if(entries_.begin(), entries_.end(), is_wanted);
    }
    if (next == entries_.end()) {
      work_.wait(lock, stop, [&] {
        return std::any_of(entries_.begin(), entries_.end(),
                           [&](const auto& e) { return is_unread(e) || is_wanted(e); });
      });
      continue;
    }
    const std::shared_ptr<Entry> entry = *next;
    lock.unlock();
    if (reads) {
      read(entry);
    } else {
      integrate(entry);
    }
    lock.lock();
  }
}

}  // namespace haarlight::apps
