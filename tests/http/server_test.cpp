// SPDX-License-Identifier: Apache-2.0
#include "http/server.h"

#include <filesystem>
#include <fstream>
#include <mutex>
#include <thread>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

#include "tests/http/raw_client.h"

namespace haarlight::http {
namespace {

constexpr const char* kToken = "0123456789abcdef";
constexpr const char* kBearer = "Authorization: Bearer 0123456789abcdef\r\n";

HttpSite echo_site() {
  HttpSite site;
  site.get("/v1/state",
           [](const HttpRequest&) { return HttpResponse{.body = R"({"state": "idle"})"}; });
  site.get("/v1/sessions/{id}", [](const HttpRequest& request) {
    return HttpResponse{.body = request.captures.at("id") + "?" + request.query_or("q", "-")};
  });
  site.get("/v1/sessions/new",
           [](const HttpRequest&) { return HttpResponse{.body = "literal"}; });
  site.post("/v1/run", [](const HttpRequest& request) {
    return HttpResponse{.status = 202, .body = request.body};
  });
  site.get("/v1/broken", [](const HttpRequest&) -> HttpResponse {
    throw Error("no \"plan\"", "plan.toml:3", "write one");
  });
  site.get("/v1/bug",
           [](const HttpRequest&) -> HttpResponse { throw std::logic_error("bug"); });
  site.add({"GET", "/healthz", [](const HttpRequest&) { return HttpResponse{.body = "ok"}; },
            Access::open, false});
  return site;
}

TEST(HttpServer, AnswersRoutesMostParticularFirst) {
  const HttpServer server({}, echo_site());
  EXPECT_EQ(exchange(server.port(), "GET", "/v1/state").body, R"({"state": "idle"})");
  EXPECT_EQ(exchange(server.port(), "GET", "/v1/sessions/a%20b?q=1").body, "a b?1");
  EXPECT_EQ(exchange(server.port(), "GET", "/v1/sessions/new").body, "literal");
  const RawResponse posted = exchange(server.port(), "POST", "/v1/run", {}, "plan");
  EXPECT_EQ(posted.status, 202);
  EXPECT_EQ(posted.body, "plan");
}

TEST(HttpServer, KeepsNothingUnlessTheHandlerSaysHowLong) {
  HttpSite site = echo_site();
  site.get("/v1/fixed", [](const HttpRequest&) {
    return HttpResponse{.headers = {{"Cache-Control", "private, immutable"}, {"X-Kind", "a"}}};
  });
  const HttpServer server({}, std::move(site));
  EXPECT_EQ(exchange(server.port(), "GET", "/v1/state").headers.at("cache-control"),
            "no-store");
  RawClient client(server.port());
  client.send("GET /v1/fixed HTTP/1.1\r\nHost: localhost\r\n\r\n");
  const std::string head = client.read_until("\r\n\r\n");
  EXPECT_NE(head.find("Cache-Control: private, immutable\r\n"), std::string::npos) << head;
  EXPECT_NE(head.find("X-Kind: a\r\n"), std::string::npos) << head;
  EXPECT_EQ(head.find("no-store"), std::string::npos) << "said once: " << head;
}

TEST(HttpServer, KeepsAConnectionForSeveralRequests) {
  const HttpServer server({}, echo_site());
  RawClient client(server.port());
  for (int i = 0; i < 3; ++i) {
    client.send("GET /v1/state HTTP/1.1\r\nHost: localhost\r\n\r\n");
    const auto response = client.read_response();
    ASSERT_TRUE(response);
    EXPECT_EQ(response->status, 200);
  }
}

TEST(HttpServer, ReportsErrorsInOneForm) {
  const HttpServer server({}, echo_site());
  const auto check = [&](const char* method, const char* path, int status) {
    const RawResponse response = exchange(server.port(), method, path);
    EXPECT_EQ(response.status, status) << path;
    const auto error = nlohmann::json::parse(response.body).at("error");
    EXPECT_FALSE(error.at("what").get<std::string>().empty());
    EXPECT_FALSE(error.at("where").get<std::string>().empty());
    EXPECT_FALSE(error.at("cure").get<std::string>().empty());
  };
  check("GET", "/v1/broken", 400);
  check("GET", "/v1/bug", 500);
  check("GET", "/v1/nothing", 404);
  check("POST", "/v1/state", 405);
  check("DELETE", "/v1/run", 405);
  check("GET", "/v1/../x", 400);
  EXPECT_EQ(exchange(server.port(), "DELETE", "/v1/run").headers.at("allow"), "POST");
}

TEST(HttpServer, RefusesTwoHostsAndPagesOfOtherSitesWithoutOrigin) {
  const HttpServer server({}, echo_site());
  const auto status = [&server](const std::string& headers) {
    RawClient client(server.port());
    client.send("GET /v1/state HTTP/1.1\r\n" + headers + "\r\n");
    const auto response = client.read_response();
    return response ? response->status : 0;
  };
  EXPECT_EQ(status("Host: localhost\r\nHost: evil.example\r\n"), 400);
  EXPECT_EQ(status("Host: localhost\r\nhost: localhost\r\n"), 400);
  EXPECT_EQ(status("Host: localhost\r\nSec-Fetch-Site: cross-site\r\n"), 403);
  EXPECT_EQ(status("Host: localhost\r\nSec-Fetch-Site: same-origin\r\n"), 200);
}

TEST(HttpServer, BehindAProxyEverythingNeedsTheTokenAndAPostIsTaken) {
  EXPECT_THROW(HttpServer({.allowed_hosts = {"rig.example"}}, echo_site()), Error);
  const HttpServer server({.token = kToken, .allowed_hosts = {"rig.example"}}, echo_site());
  const std::string page =
      "Origin: https://rig.example\r\nSec-Fetch-Site: same-origin\r\n"
      "X-Forwarded-For: 192.0.2.7\r\nX-Forwarded-Proto: https\r\n";
  EXPECT_EQ(exchange(server.port(), "POST", "/v1/run", page, "p").status, 401);
  EXPECT_EQ(exchange(server.port(), "GET", "/v1/state", page).status, 401);
  EXPECT_EQ(exchange(server.port(), "POST", "/v1/run", page + kBearer, "p").status, 202);
  const RawResponse login = exchange(server.port(), "POST", "/v1/login", page, kToken);
  EXPECT_EQ(login.status, 204);
  EXPECT_NE(login.headers.at("set-cookie").find("; Secure"), std::string::npos);
}

TEST(HttpServer, RefusesAForeignHostOrOrigin) {
  const HttpServer server({}, echo_site());
  const auto status = [&](std::string_view headers) {
    return exchange(server.port(), "GET", "/v1/state", headers).status;
  };
  EXPECT_EQ(status("Host: evil.example\r\n"), 403);
  EXPECT_EQ(status("Host: 127.0.0.1.evil.example\r\n"), 403);
  EXPECT_EQ(status("Host: 10.0.0.1\r\n"), 403);
  EXPECT_EQ(status("Host: localhost:1\r\n"), 200);
  EXPECT_EQ(status("Host: [::1]:80\r\n"), 200);
  EXPECT_EQ(status("Host: a b\r\n"), 400);
  EXPECT_EQ(status("Origin: http://evil.example\r\n"), 403);
  EXPECT_EQ(status("Origin: null\r\n"), 403);
  EXPECT_EQ(status("Origin: http://127.0.0.1\r\n"), 200);
  EXPECT_EQ(status("Host: localhost:5\r\nOrigin: http://localhost:6\r\n"), 403);
}

TEST(HttpServer, NeedsTheTokenToWrite) {
  const HttpServer server({.token = kToken}, echo_site());
  const auto status = [&](std::string_view headers) {
    return exchange(server.port(), "POST", "/v1/run", headers, "x").status;
  };
  EXPECT_EQ(status(""), 401);
  EXPECT_EQ(status("Authorization: Bearer 0123456789abcdeX\r\n"), 401);
  EXPECT_EQ(status("Authorization: Bearer \r\n"), 401);
  EXPECT_EQ(status("Authorization: Basic 0123456789abcdef\r\n"), 401);
  EXPECT_EQ(status("Cookie: haarlight=0123456789abcdef\r\n"), 401);
  EXPECT_EQ(status(kBearer), 202);
  EXPECT_EQ(exchange(server.port(), "POST", "/v1/run?token=0123456789abcdef", "", "x").status,
            401);
  EXPECT_EQ(exchange(server.port(), "GET", "/v1/state").status, 200);  // reading, on loopback
}

TEST(HttpServer, LogsInWithACookieThatScriptsCannotRead) {
  const HttpServer server({.token = kToken}, echo_site());
  EXPECT_EQ(exchange(server.port(), "POST", "/v1/login", {}, "wrong").status, 401);
  const RawResponse response = exchange(server.port(), "POST", "/v1/login", {}, kToken);
  EXPECT_EQ(response.status, 204);
  const std::string cookie = response.headers.at("set-cookie");
  EXPECT_NE(cookie.find("HttpOnly"), std::string::npos);
  EXPECT_NE(cookie.find("SameSite=Strict"), std::string::npos);
  EXPECT_EQ(cookie.find(kToken), std::string::npos);
  const std::string header = "Cookie: " + cookie.substr(0, cookie.find(';')) + "\r\n";
  EXPECT_EQ(exchange(server.port(), "POST", "/v1/run", header, "x").status, 202);
}

TEST(HttpServer, NeedsTheTokenToReadWhenOthersCanConnect) {
  const HttpServer server({.address = "0.0.0.0", .token = kToken}, echo_site());
  EXPECT_EQ(exchange(server.port(), "GET", "/v1/state").status, 401);
  EXPECT_EQ(exchange(server.port(), "GET", "/v1/state", kBearer).status, 200);
  EXPECT_EQ(exchange(server.port(), "GET", "/healthz").status, 200);
}

TEST(HttpServer, RefusesABadConfiguration) {
  EXPECT_THROW(HttpServer({.address = "0.0.0.0"}, {}), Error);
  EXPECT_THROW(HttpServer({.address = "localhost"}, {}), Error);
  EXPECT_THROW(HttpServer({.token = "short"}, {}), Error);
  const HttpServer first({}, {});
  try {
    const HttpServer second({.port = first.port()}, {});
    FAIL() << "two servers on one port";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ExitCode::unavailable);
  }
}

TEST(HttpServer, ServesTheFilesOfOneFolder) {
  const auto folder =
      std::filesystem::temp_directory_path() / ("haarlight_www_" + std::to_string(::getpid()));
  std::filesystem::create_directories(folder);
  std::ofstream(folder / "index.html") << "<p>hello";
  std::filesystem::create_symlink("/etc/passwd", folder / "link");
  HttpSite site = echo_site();
  site.set_static_files("/", folder);
  const HttpServer server({.address = "0.0.0.0", .token = kToken}, std::move(site));
  const RawResponse page = exchange(server.port(), "GET", "/");
  EXPECT_EQ(page.status, 200);
  EXPECT_EQ(page.body, "<p>hello");
  EXPECT_EQ(page.headers.at("x-content-type-options"), "nosniff");
  RawClient head(server.port());
  head.send("HEAD / HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n");
  const std::string head_answer = head.read_until("never");
  EXPECT_NE(head_answer.find("Content-Length: 8"), std::string::npos);
  EXPECT_EQ(head_answer.find("hello"), std::string::npos);
  for (const char* path :
       {"/../../etc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "/..%2f..%2fetc/passwd", "/link",
        "/none", "//etc/passwd", "/.%00/x"}) {
    EXPECT_GE(exchange(server.port(), "GET", path).status, 400) << path;
  }
  std::filesystem::remove_all(folder);
}

TEST(HttpServer, StreamsEventsAndResumes) {
  std::mutex mutex;
  std::vector<Event> journal;
  auto stream = std::make_shared<EventStream>(
      EventStreamOptions{.replay = [&](std::int64_t after, std::size_t max) {
        const std::lock_guard lock(mutex);
        std::vector<Event> page;
        for (const Event& event : journal) {
          if (event.id > after && page.size() < max) {
            page.push_back(event);
          }
        }
        return page;
      }});
  const auto record = [&](std::int64_t id) {
    {
      const std::lock_guard lock(mutex);
      journal.push_back({id, "shot", std::to_string(id)});
    }
    stream->publish(id, "shot", std::to_string(id));
  };
  HttpSite site = echo_site();
  site.add_events("/v1/events", stream);
  const HttpServer server({.heartbeat = std::chrono::milliseconds(40)}, std::move(site));
  {
    RawClient client(server.port());
    client.send("GET /v1/events HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n");
    EXPECT_NE(client.read_until("retry: 1000\n\n").find("text/event-stream"),
              std::string::npos);
    std::jthread worker([&] {
      for (std::int64_t id = 1; id <= 5; ++id) {
        record(id);
      }
    });
    EXPECT_NE(client.read_until("data: 5\n\n").find("id: 1\n"), std::string::npos);
    EXPECT_NE(client.read_until(": heartbeat\n\n").find(": heartbeat"), std::string::npos);
  }
  for (std::int64_t id = 6; id <= 9; ++id) {
    record(id);  // nobody listens
  }
  RawClient client(server.port());
  client.send("GET /v1/events HTTP/1.1\r\nHost: 127.0.0.1\r\nLast-Event-ID: 5\r\n\r\n");
  const std::string text = client.read_until("data: 9\n\n");
  EXPECT_EQ(text.find("id: 5\n"), std::string::npos);
  for (const char* id : {"id: 6\n", "id: 7\n", "id: 8\n", "id: 9\n"}) {
    EXPECT_NE(text.find(id), std::string::npos) << id;
  }
  record(10);
  EXPECT_NE(client.read_until("data: 10\n\n").find("id: 10\n"), std::string::npos);
  EXPECT_EQ(exchange(server.port(), "GET", "/v1/events", "Last-Event-ID: x\r\n").status, 400);
}

TEST(HttpServer, NoticesThatAListenerHasGone) {
  auto stream = std::make_shared<EventStream>();
  HttpSite site;
  site.add_events("/v1/events", stream);
  const HttpServer server({.heartbeat = std::chrono::milliseconds(20)}, std::move(site));
  {
    RawClient client(server.port());
    client.send("GET /v1/events HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n");
    (void)client.read_until("retry");
    EXPECT_EQ(stream->n_listeners(), 1U);
  }
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(5);
  while (stream->n_listeners() > 0 && std::chrono::steady_clock::now() < deadline) {
    std::this_thread::yield();
  }
  EXPECT_EQ(stream->n_listeners(), 0U);
}

}  // namespace
}  // namespace haarlight::http
