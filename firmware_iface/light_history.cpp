// SPDX-License-Identifier: Apache-2.0
#include "firmware_iface/light_history.h"

#include <algorithm>

#include "haarlight/core/error.h"

namespace haarlight::firmware_iface {

std::uint16_t LightTransition::level(int element) const {
  const auto found =
      std::lower_bound(pattern->begin(), pattern->end(), element,
                       [](const ElementLevel& e, int wanted) { return e.element < wanted; });
  return found != pattern->end() && found->element == element ? found->level : std::uint16_t{0};
}

double on_seconds(const LightHistory& history, int element, std::int64_t t0_ns,
                  std::int64_t t1_ns) {
  double sum_ns = 0.0;
  for (std::size_t i = 0; i < history.states.size(); ++i) {
    const std::int64_t from = std::max(history.states[i].t_ns, t0_ns);
    const std::int64_t to =
        i + 1 < history.states.size() ? std::min(history.states[i + 1].t_ns, t1_ns) : t1_ns;
    if (to > from) {
      sum_ns += static_cast<double>(to - from) *
                (static_cast<double>(history.states[i].level(element)) / 65535.0);
    }
  }
  return sum_ns * 1e-9;
}

TransitionLog::TransitionLog(std::size_t capacity)
    : capacity_(std::max<std::size_t>(capacity, 1)) {}

void TransitionLog::add(LightTransition transition) {
  HAARLIGHT_EXPECTS(transition.pattern != nullptr, "a transition needs a pattern");
  HAARLIGHT_EXPECTS(kept_.empty() || kept_.back().t_ns <= transition.t_ns,
                    "transitions come in rising time");
  kept_.push_back(std::move(transition));
  if (kept_.size() > capacity_) {
    kept_.pop_front();
    is_truncated_ = true;
  }
}

LightHistory TransitionLog::between(std::int64_t t0_ns, std::int64_t t1_ns) const {
  LightHistory history;
  // The last state that began at or before t0 is in force at t0.
  auto first = std::upper_bound(
      kept_.begin(), kept_.end(), t0_ns,
      [](std::int64_t t, const LightTransition& state) { return t < state.t_ns; });
  if (first == kept_.begin()) {
    history.is_complete = !is_truncated_;
  } else {
    --first;
  }
  for (auto it = first; it != kept_.end() && (it == first || it->t_ns <= t1_ns); ++it) {
    history.states.push_back(*it);
  }
  return history;
}

}  // namespace haarlight::firmware_iface
