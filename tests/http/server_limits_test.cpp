// SPDX-License-Identifier: Apache-2.0
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

#include "core/virtual_clock.h"
#include "http/server.h"
#include "tests/http/raw_client.h"

namespace haarlight::http {
namespace {

using std::chrono::milliseconds;

/// A test waits so long for what does not come: what it asks about the server is not its speed.
constexpr std::chrono::seconds kHang{20};

HttpSite small_site() {
  HttpSite site;
  site.get("/v1/state", [](const HttpRequest&) { return HttpResponse{.body = "{}"}; });
  site.post("/v1/run", [](const HttpRequest& request) {
    return HttpResponse{.body = std::to_string(request.body.size())};
  });
  site.add({"POST", "/v1/all-off",
            [](const HttpRequest&) { return HttpResponse{.body = "dark"}; }, Access::write,
            true, Lane::here});
  return site;
}

TEST(HttpLimits, RefusesABodyThatIsTooLarge) {
  const HttpServer server({.max_body_bytes = 1000}, small_site());
  EXPECT_EQ(exchange(server.port(), "POST", "/v1/run", {}, std::string(1000, 'x')).body,
            "1000");
  RawClient announced(server.port());
  announced.send("POST /v1/run HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1001\r\n\r\n");
  EXPECT_EQ(announced.read_response()->status, 413);
  RawClient absurd(server.port());
  absurd.send(
      "POST /v1/run HTTP/1.1\r\nHost: localhost\r\n"
      "Content-Length: 99999999999999999999999\r\n\r\n");
  EXPECT_GE(absurd.read_response()->status, 400);
  RawClient chunked(server.port());
  chunked.send(
      "POST /v1/run HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n"
      "400\r\n" +
      std::string(1024, 'x') + "\r\n0\r\n\r\n");
  EXPECT_EQ(chunked.read_response()->status, 413);
}

TEST(HttpLimits, RefusesBodiesThatTogetherAreTooLarge) {
  HttpSite site = small_site();
  site.add({.method = "POST",
            .pattern = "/v1/large",
            .handler =
                [](const HttpRequest& request) {
                  return HttpResponse{.body = std::to_string(request.body.size())};
                },
            .max_body_bytes = 3000});
  const HttpServer server({.max_body_bytes = 1000, .max_bodies_bytes = 4000}, std::move(site));
  EXPECT_EQ(exchange(server.port(), "POST", "/v1/large", {}, std::string(3000, 'x')).body,
            "3000");
  EXPECT_EQ(exchange(server.port(), "POST", "/v1/large", {}, std::string(3001, 'x')).status,
            413);
  EXPECT_EQ(exchange(server.port(), "POST", "/v1/run", {}, std::string(1001, 'x')).status, 413);
  RawClient slow(server.port());
  slow.send("POST /v1/large HTTP/1.1\r\nHost: localhost\r\nContent-Length: 3000\r\n\r\n" +
            std::string(2500, 'x'));
  const auto deadline = std::chrono::steady_clock::now() + kHang;
  int status = 200;
  while (status == 200 && std::chrono::steady_clock::now() < deadline) {
    status = exchange(server.port(), "POST", "/v1/large", {}, std::string(2000, 'x')).status;
  }
  EXPECT_EQ(status, 503);
  slow.send(std::string(500, 'x'));
  EXPECT_EQ(slow.read_response()->body, "3000");
  EXPECT_EQ(exchange(server.port(), "POST", "/v1/large", {}, std::string(2000, 'x')).status,
            200);
}

TEST(HttpLimits, RefusesAHeaderThatIsTooLarge) {
  const HttpServer server({.max_header_bytes = 4096}, small_site());
  RawClient client(server.port());
  client.send("GET /v1/state HTTP/1.1\r\nHost: localhost\r\nX: " + std::string(100000, 'x') +
              "\r\n\r\n");
  const auto response = client.read_response();
  EXPECT_TRUE(!response || response->status >= 400);
  EXPECT_EQ(exchange(server.port(), "GET", "/v1/state").status, 200);
}

TEST(HttpLimits, SurvivesBrokenRequests) {
  const HttpServer server({.idle_timeout = milliseconds(200)}, small_site());
  for (const char* broken :
       {"\r\n\r\n", "GET\r\n\r\n", "GET / HTTP/9.9\r\n\r\n", "\x16\x03\x01\x02",
        "GET / HTTP/1.1\r\n\r\n", "GET http://x/ HTTP/1.1\r\nHost: x\r\n\r\n",
        "GET / HTTP/1.1\r\nHost\r\n\r\n",
        "POST /v1/run HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n",
        "POST /v1/run HTTP/1.1\r\nHost: localhost\r\nContent-Length: -5\r\n\r\n",
        "GET /%00 HTTP/1.1\r\nHost: localhost\r\n\r\n",
        " GET / HTTP/1.1\r\nHost: localhost\r\n\r\n"}) {
    RawClient client(server.port());
    client.send(broken);
    const auto response = client.read_response(milliseconds(1000));
    EXPECT_TRUE(!response || response->status >= 400) << broken;
  }
  EXPECT_EQ(exchange(server.port(), "GET", "/v1/state").status, 200);
}

/// Until the server has seen so many connections.
void wait_for_connections(const HttpServer& server, std::size_t n) {
  while (server.counters().open_connections < n) {
    std::this_thread::sleep_for(milliseconds(1));
  }
}

TEST(HttpLimits, ClosesASlowHeaderAndASlowBody) {
  VirtualClock clock;
  const VirtualClock::Member here(clock);
  const HttpServerConfig config{.clock = &clock};
  const HttpServer server(config, small_site());
  RawClient silent(server.port());
  RawClient header(server.port());
  RawClient body(server.port());
  body.send(
      "POST /v1/run HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100\r\n"
      "Expect: 100-continue\r\n\r\n");
  (void)body.read_until("100 Continue");  // its header was read
  wait_for_connections(server, 3);
  const auto drip = [&](std::chrono::milliseconds length) {
    for (int i = 0; i < 10; ++i) {  // a byte now and then keeps an inactivity timer happy
      header.send("G");
      body.send("x");
      clock.sleep_for(length / 10);
    }
  };
  // The timer looks four times a second.
  constexpr milliseconds kTick{250};
  drip(config.request_timeout);
  EXPECT_EQ(server.counters().timed_out, 0U);
  clock.sleep_for(kTick + milliseconds(1));
  EXPECT_EQ(server.counters().timed_out, 1U);
  EXPECT_TRUE(body.is_closed_within(kHang));
  clock.sleep_for(config.idle_timeout - config.request_timeout - kTick - milliseconds(1));
  EXPECT_EQ(server.counters().timed_out, 1U);
  clock.sleep_for(kTick + milliseconds(1));
  EXPECT_EQ(server.counters().timed_out, 3U);
  EXPECT_TRUE(silent.is_closed_within(kHang));
  EXPECT_TRUE(header.is_closed_within(kHang));
}

// How fast it is answered among thousands of connections: scripts/all_off_test.py.
TEST(HttpLimits, AnswersBeside200IdleConnections) {
  const HttpServer server({}, small_site());
  std::vector<std::unique_ptr<RawClient>> idle;
  for (int i = 0; i < 200; ++i) {
    idle.push_back(std::make_unique<RawClient>(server.port()));
  }
  for (int i = 0; i < 21; ++i) {
    EXPECT_EQ(exchange(server.port(), "POST", "/v1/all-off").body, "dark");
  }
  EXPECT_GE(server.counters().open_connections, 200U);
  EXPECT_EQ(server.counters().evicted, 0U) << "none had to go for it";
}

TEST(HttpLimits, MakesRoomForAllOffWhenFull) {
  const HttpServer server({.max_connections = 32, .max_listeners = 4}, small_site());
  std::vector<std::unique_ptr<RawClient>> idle;
  for (int i = 0; i < 400; ++i) {
    idle.push_back(std::make_unique<RawClient>(server.port()));
  }
  for (int i = 0; i < 5; ++i) {
    EXPECT_EQ(exchange(server.port(), "POST", "/v1/all-off").body, "dark");
  }
  EXPECT_GE(server.counters().evicted, 300U);
}

TEST(HttpLimits, ServesAllOffButNoOtherWhenOverloaded) {
  const HttpServer server({.max_connections = 8, .max_listeners = 2}, small_site());
  std::vector<std::unique_ptr<RawClient>> slow;
  for (int i = 0; i < 6; ++i) {
    slow.push_back(std::make_unique<RawClient>(server.port()));
    slow.back()->send(
        "POST /v1/all-off HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100\r\n\r\n");
  }
  const auto deadline = std::chrono::steady_clock::now() + kHang;
  int status = 0;
  while (status != 503 && std::chrono::steady_clock::now() < deadline) {
    status = exchange(server.port(), "GET", "/v1/state").status;
  }
  EXPECT_EQ(status, 503);
  EXPECT_EQ(exchange(server.port(), "POST", "/v1/all-off").body, "dark");
}

std::unique_ptr<RawClient> listen(int port, const std::string& headers = {}) {
  auto client = std::make_unique<RawClient>(port);
  client->send("GET /v1/events HTTP/1.1\r\nHost: localhost\r\n" + headers + "\r\n");
  (void)client->read_until("retry", kHang);
  return client;
}

TEST(HttpLimits, ANewListenerReplacesTheOldestOne) {
  auto stream = std::make_shared<EventStream>();
  HttpSite site = small_site();
  site.add_events("/v1/events", stream);
  const HttpServer server({.heartbeat = std::chrono::seconds(60)}, std::move(site));
  std::vector<std::unique_ptr<RawClient>> silent;
  for (int i = 0; i < 200; ++i) {
    silent.push_back(listen(server.port()));
  }
  const auto page = listen(server.port());
  stream->publish(0, "state", "news");
  EXPECT_NE(page->read_until("news", kHang).find("news"), std::string::npos);
  EXPECT_TRUE(silent.front()->is_closed_within(kHang));
  EXPECT_LE(stream->n_listeners(), 65U);  // one may be closing
  EXPECT_EQ(exchange(server.port(), "GET", "/v1/state").status, 200);
  EXPECT_EQ(server.counters().evicted, 137U);
}

TEST(HttpLimits, AListenerWithTheTokenGoesForNoneWithout) {
  auto stream = std::make_shared<EventStream>();
  HttpSite site = small_site();
  site.add_events("/v1/events", stream);
  const HttpServer server({.token = "0123456789abcdef", .max_listeners = 2}, std::move(site));
  const std::string bearer = "Authorization: Bearer 0123456789abcdef\r\n";
  const auto stranger = listen(server.port());
  const auto first = listen(server.port(), bearer);
  const auto second = listen(server.port(), bearer);
  EXPECT_TRUE(stranger->is_closed_within(kHang));
  EXPECT_EQ(exchange(server.port(), "GET", "/v1/events").status, 503);
  stream->publish(0, "state", "news");
  for (const auto& page : {&first, &second}) {
    EXPECT_NE((*page)->read_until("news", kHang).find("news"), std::string::npos);
  }
  const auto third = listen(server.port(), bearer);
  EXPECT_TRUE(first->is_closed_within(kHang));
}

/// A site whose POST /v1/dry-run lasts until it is let go.
struct SlowSite {
  std::mutex mutex;
  std::condition_variable changed;
  bool is_open = false;
  std::atomic<int> n_begun{0};

  HttpSite site() {
    HttpSite site = small_site();
    site.post(
        "/v1/dry-run",
        [this](const HttpRequest& request) {
          ++n_begun;
          std::unique_lock lock(mutex);
          changed.wait(lock, [this] { return is_open; });
          return HttpResponse{.body = request.body};
        },
        Lane::work);
    return site;
  }
  void let_go() {
    const std::lock_guard lock(mutex);
    is_open = true;
    changed.notify_all();
  }
};

void send_dry_run(RawClient& client, const std::string& body, const std::string& query = {}) {
  client.send("POST /v1/dry-run" + query + " HTTP/1.1\r\nHost: localhost\r\nContent-Length: " +
              std::to_string(body.size()) + "\r\n\r\n" + body);
}

TEST(HttpLimits, AllOffAndLooksDoNotWaitBehindWork) {
  SlowSite slow;
  const HttpServer server({}, slow.site());
  RawClient asking(server.port());
  send_dry_run(asking, "plan");
  while (slow.n_begun == 0) {
    std::this_thread::sleep_for(milliseconds(1));
  }
  for (int i = 0; i < 21; ++i) {  // each answered while the work is still held up
    EXPECT_EQ(exchange(server.port(), "POST", "/v1/all-off").body, "dark");
  }
  EXPECT_EQ(exchange(server.port(), "GET", "/v1/state").body, "{}");
  slow.let_go();
  EXPECT_EQ(asking.read_response()->body, "plan");
}

TEST(HttpLimits, TheQueueBeforeALaneIsBounded) {
  SlowSite slow;
  const HttpServer server({.max_waiting = 2}, slow.site());
  std::vector<std::unique_ptr<RawClient>> asking;
  for (int i = 0; i < 3; ++i) {
    asking.push_back(std::make_unique<RawClient>(server.port()));
    send_dry_run(*asking.back(), std::to_string(i));
    while (slow.n_begun == 0) {  // the first is at work, the others wait
      std::this_thread::sleep_for(milliseconds(1));
    }
  }
  RawResponse full;
  const auto deadline = std::chrono::steady_clock::now() + kHang;
  while (full.status != 503 && std::chrono::steady_clock::now() < deadline) {
    RawClient more(server.port());
    send_dry_run(more, "more");
    full = more.read_response(milliseconds(300)).value_or(RawResponse{});
  }
  EXPECT_EQ(full.status, 503);
  EXPECT_EQ(full.headers["retry-after"], "1");
  slow.let_go();
  EXPECT_EQ(asking[0]->read_response()->body, "0");
}

TEST(HttpLimits, ANewerRequestOfTheSameClientReplacesTheWaitingOne) {
  SlowSite slow;
  const HttpServer server({}, slow.site());
  RawClient at_work(server.port());
  send_dry_run(at_work, "first", "?client=a");
  while (slow.n_begun == 0) {
    std::this_thread::sleep_for(milliseconds(1));
  }
  RawClient other(server.port());
  send_dry_run(other, "other", "?client=b");
  std::vector<std::unique_ptr<RawClient>> typed;
  for (int i = 0; i < 20; ++i) {
    typed.push_back(std::make_unique<RawClient>(server.port()));
    send_dry_run(*typed.back(), std::to_string(i), "?client=a");
    if (i > 0) {
      EXPECT_EQ(typed[typed.size() - 2]->read_response()->status, 409);
    }
  }
  slow.let_go();
  EXPECT_EQ(at_work.read_response()->body, "first");
  EXPECT_EQ(other.read_response()->body, "other");
  EXPECT_EQ(typed.back()->read_response()->body, "19");
  EXPECT_EQ(slow.n_begun, 3);
}

TEST(HttpLimits, EndsWhileWorkWaits) {
  SlowSite slow;
  auto server = std::make_unique<HttpServer>(HttpServerConfig{}, slow.site());
  std::vector<std::unique_ptr<RawClient>> asking;
  for (int i = 0; i < 8; ++i) {
    asking.push_back(std::make_unique<RawClient>(server->port()));
    send_dry_run(*asking.back(), "plan");
  }
  while (slow.n_begun == 0) {
    std::this_thread::sleep_for(milliseconds(1));
  }
  asking.pop_back();  // one goes away meanwhile
  std::thread ending([&server] { server.reset(); });
  std::this_thread::sleep_for(milliseconds(50));
  slow.let_go();
  ending.join();
  EXPECT_EQ(slow.n_begun, 1);
}

}  // namespace
}  // namespace haarlight::http
