// SPDX-License-Identifier: Apache-2.0
#include "http/event_stream.h"

#include <array>
#include <string>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

namespace haarlight::http {
namespace {

/// Everything that can be read without waiting.
std::string drain(EventSubscription& subscription) {
  std::string text;
  bool is_parked = false;
  while (!is_parked) {
    std::array<char, 7> piece{};  // small: events are cut anywhere
    const auto n = subscription.read(piece, [&] { is_parked = true; });
    if (!n) {
      return text + "<end>";
    }
    text.append(piece.data(), *n);
  }
  return text;
}

constexpr const char* kHello = ": haarlight\nretry: 1000\n\n";

TEST(FormatEvent, WritesOneDataLineALine) {
  EXPECT_EQ(format_event({7, "state", "a\nb\r\nc\rd"}),
            "id: 7\nevent: state\ndata: a\ndata: b\ndata: c\ndata: d\n\n");
  EXPECT_EQ(format_event({0, "x\ndata: forged", ""}), "event: x data: forged\ndata: \n\n");
}

TEST(EventStream, SendsOnlyNewsToANewListener) {
  EventStream stream;
  stream.publish(1, "e", "old");
  const auto listener = stream.subscribe(std::nullopt, [] {});
  stream.publish(2, "e", "new");
  EXPECT_EQ(drain(*listener), std::string(kHello) + "id: 2\nevent: e\ndata: new\n\n");
}

TEST(EventStream, ReplaysFromLastEventIdWithoutGapOrRepetition) {
  std::vector<Event> journal;
  EventStream stream({.replay = [&](std::int64_t after, std::size_t max) {
    std::vector<Event> page;
    for (const Event& event : journal) {
      if (event.id > after && page.size() < max) {
        page.push_back(event);
      }
    }
    return page;
  }});
  const auto record = [&](std::int64_t id) {
    journal.push_back({id, "e", "x"});
    stream.publish(id, "e", "x");
  };
  for (std::int64_t id = 1; id <= 600; ++id) {
    record(id);
  }
  const auto listener = stream.subscribe(10, [] {});
  record(601);  // while the replay has not begun
  std::string text = drain(*listener);
  record(602);
  text += drain(*listener);
  std::string expected = kHello;
  for (std::int64_t id = 11; id <= 602; ++id) {
    expected += format_event({id, "e", "x"});
  }
  EXPECT_EQ(text, expected);
}

TEST(EventStream, DropsAListenerThatDoesNotRead) {
  EventStream stream({.replay = {}, .max_unread_bytes = 100});
  int n_woken = 0;
  const auto listener = stream.subscribe(std::nullopt, [&] { ++n_woken; });
  (void)drain(*listener);
  stream.publish(1, "e", std::string(200, 'x'));
  EXPECT_EQ(n_woken, 1);
  EXPECT_EQ(drain(*listener), "<end>");
}

TEST(EventStream, EndsEveryListenerOnClose) {
  EventStream stream;
  const auto before = stream.subscribe(std::nullopt, [] {});
  stream.close();
  const auto after = stream.subscribe(std::nullopt, [] {});
  EXPECT_EQ(drain(*before), "<end>");
  EXPECT_EQ(drain(*after), "<end>");
}

TEST(EventStream, TakesNewsFromManyThreads) {
  EventStream stream;
  const auto listener = stream.subscribe(std::nullopt, [] {});
  {
    std::vector<std::jthread> threads;
    for (int i = 0; i < 4; ++i) {
      threads.emplace_back([&] {
        for (int j = 0; j < 100; ++j) {
          stream.publish(0, "e", "x");
        }
      });
    }
  }
  constexpr std::size_t kBytes = 18;  // "event: e\ndata: x\n\n"
  EXPECT_EQ(drain(*listener).size(), std::string(kHello).size() + 400 * kBytes);
}

}  // namespace
}  // namespace haarlight::http
