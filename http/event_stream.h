// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

/// @file
/// Server-sent events (WHATWG HTML, section 9.2): one EventStream feeds every listening page.
/// Independent of sockets; server.cpp connects it to them.

namespace haarlight::http {

struct Event {
  std::int64_t id = 0;  ///< the journal row; 0: transient news without an id, never replayed
  std::string event;    ///< one line
  std::string data;     ///< any text; sent as one "data:" line per line
};

struct EventStreamOptions {
  /// Events with id > `after`, ascending, at most `max`; empty when there are none. Called on
  /// the HTTP thread when a listener returns with Last-Event-ID. Publish an event only after
  /// this function would return it: then nothing is lost or sent twice.
  std::function<std::vector<Event>(std::int64_t after, std::size_t max)> replay;
  /// A listener with more than this unread is disconnected; it reconnects and replays.
  std::size_t max_unread_bytes = std::size_t{1} << 20U;
};

/// The text of one event as sent.
[[nodiscard]] std::string format_event(const Event& event);

/// One listener's position in the stream. Used by the server; thread-safe.
class EventSubscription {
 public:
  /// Fills `out` with what to send next.
  /// @param park  called under the lock when there is nothing; the next event calls `wake`
  /// @return      bytes written; 0 after `park`; nothing when the stream has ended
  [[nodiscard]] std::optional<std::size_t> read(std::span<char> out,
                                                const std::function<void()>& park);

 private:
  friend class EventStream;
  void push(std::int64_t id, std::string_view text);
  void close();

  std::mutex mutex_;
  const EventStreamOptions* options_ = nullptr;
  std::function<void()> wake_;
  std::string unread_;
  std::size_t n_read_ = 0;    ///< of unread_, already sent
  std::int64_t last_id_ = 0;  ///< newest id queued
  bool is_replaying_ = false;
  bool has_news_ = false;  ///< published while replaying
  bool is_parked_ = false;
  bool is_closed_ = false;
};

/// Thread-safe: any thread may publish.
class EventStream {
 public:
  explicit EventStream(EventStreamOptions options = {});

  /// Sends to every listener; never blocks on a slow one. Ids ascend.
  void publish(std::int64_t id, std::string_view event, std::string_view data);

  /// A comment line, so that both ends notice a dead connection.
  void send_heartbeat();

  /// Current number of listeners.
  [[nodiscard]] std::size_t n_listeners() const;

  // The server's side.

  /// @param last_event_id  replay from there; nothing: only what is published from now on
  [[nodiscard]] std::shared_ptr<EventSubscription> subscribe(
      std::optional<std::int64_t> last_event_id, std::function<void()> wake);
  void unsubscribe(const std::shared_ptr<EventSubscription>& subscription);
  /// Ends one: it wakes and reads the end.
  static void end(EventSubscription& subscription);
  /// Ends every subscription, including future ones.
  void close();

 private:
  EventStreamOptions options_;
  mutable std::mutex mutex_;
  std::vector<std::shared_ptr<EventSubscription>> subscriptions_;
  bool is_closed_ = false;
};

}  // namespace haarlight::http
