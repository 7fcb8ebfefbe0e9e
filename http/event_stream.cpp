// SPDX-License-Identifier: Apache-2.0
#include "http/event_stream.h"

#include <algorithm>
#include <utility>

namespace haarlight::http {
namespace {

constexpr std::size_t kReplayPage =
    256;  // events requested at a time: bounds memory per listener

}  // namespace

std::string format_event(const Event& event) {
  std::string text;
  if (event.id != 0) {
    text += "id: " + std::to_string(event.id) + "\n";
  }
  if (!event.event.empty()) {
    text += "event: ";
    for (const char c : event.event) {
      text += c == '\n' || c == '\r' ? ' ' : c;
    }
    text += '\n';
  }
  text += "data: ";
  for (std::size_t i = 0; i < event.data.size(); ++i) {
    const char c = event.data[i];
    if (c == '\r' && i + 1 < event.data.size() && event.data[i + 1] == '\n') {
      continue;
    }
    text += c == '\r' ? '\n' : c;
    if (c == '\n' || c == '\r') {
      text += "data: ";
    }
  }
  text += "\n\n";
  return text;
}

std::optional<std::size_t> EventSubscription::read(std::span<char> out,
                                                   const std::function<void()>& park) {
  std::unique_lock lock(mutex_);
  while (true) {
    if (is_closed_) {
      return std::nullopt;
    }
    if (n_read_ < unread_.size()) {
      const std::size_t n = std::min(out.size(), unread_.size() - n_read_);
      std::copy_n(unread_.begin() + static_cast<std::ptrdiff_t>(n_read_), n, out.begin());
      n_read_ += n;
      if (n_read_ == unread_.size()) {
        unread_.clear();
        n_read_ = 0;
      }
      return n;
    }
    if (!is_replaying_) {
      is_parked_ = true;
      park();
      return 0;
    }
    has_news_ = false;
    const std::int64_t after = last_id_;
    lock.unlock();  // the replay may read a disk
    const std::vector<Event> page = options_->replay(after, kReplayPage);
    lock.lock();
    for (const Event& event : page) {
      unread_ += format_event(event);
      last_id_ = std::max(last_id_, event.id);
    }
    is_replaying_ = !page.empty() || has_news_;
  }
}

void EventSubscription::push(std::int64_t id, std::string_view text) {
  const std::lock_guard lock(mutex_);
  if (is_closed_) {
    return;
  }
  if (is_replaying_ && id != 0) {
    has_news_ = true;  // included in the replay's next page
    return;
  }
  if (id != 0 && id <= last_id_) {
    return;
  }
  if (unread_.size() - n_read_ + text.size() > options_->max_unread_bytes) {
    is_closed_ = true;
  } else {
    unread_ += text;
    last_id_ = std::max(last_id_, id);
  }
  if (is_parked_) {
    is_parked_ = false;
    wake_();
  }
}

void EventSubscription::close() {
  const std::lock_guard lock(mutex_);
  is_closed_ = true;
  if (is_parked_) {
    is_parked_ = false;
    wake_();
  }
}

EventStream::EventStream(EventStreamOptions options) : options_(std::move(options)) {}

void EventStream::publish(std::int64_t id, std::string_view event, std::string_view data) {
  const std::string text = format_event({id, std::string(event), std::string(data)});
  const std::lock_guard lock(mutex_);
  for (const auto& subscription : subscriptions_) {
    subscription->push(id, text);
  }
}

void EventStream::send_heartbeat() {
  const std::lock_guard lock(mutex_);
  for (const auto& subscription : subscriptions_) {
    subscription->push(0, ": heartbeat\n\n");
  }
}

std::size_t EventStream::n_listeners() const {
  const std::lock_guard lock(mutex_);
  return subscriptions_.size();
}

std::shared_ptr<EventSubscription> EventStream::subscribe(
    std::optional<std::int64_t> last_event_id, std::function<void()> wake) {
  auto subscription = std::make_shared<EventSubscription>();
  subscription->options_ = &options_;
  subscription->wake_ = std::move(wake);
  subscription->unread_ = ": haarlight\nretry: 1000\n\n";
  if (last_event_id && options_.replay) {
    subscription->last_id_ = *last_event_id;
    subscription->is_replaying_ = true;
  }
  const std::lock_guard lock(mutex_);
  subscription->is_closed_ = is_closed_;
  subscriptions_.push_back(subscription);
  return subscription;
}

void EventStream::unsubscribe(const std::shared_ptr<EventSubscription>& subscription) {
  const std::lock_guard lock(mutex_);
  std::erase(subscriptions_, subscription);
}

void EventStream::end(EventSubscription& subscription) { subscription.close(); }

void EventStream::close() {
  const std::lock_guard lock(mutex_);
  is_closed_ = true;
  for (const auto& subscription : subscriptions_) {
    subscription->close();
  }
}

}  // namespace haarlight::http
