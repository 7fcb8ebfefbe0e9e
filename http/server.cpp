// SPDX-License-Identifier: Apache-2.0
#include "http/server.h"

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <charconv>
#include <cstdarg>
#include <cstdio>
#include <cstring>
#include <exception>
#include <mutex>
#include <optional>
#include <stop_token>
#include <thread>
#include <tuple>
#include <unordered_map>
#include <utility>

#include <fmt/format.h>
#include <microhttpd.h>
#include <strings.h>
#include <sys/random.h>
#include <sys/socket.h>

#include "core/log.h"
#include "http/listen_address.h"
#include "http/request_worker.h"
#include "http/static_files.h"
#include "http/stranger.h"

namespace haarlight::http {
namespace {

constexpr std::size_t kMinTokenLength = 16;
constexpr unsigned kSpareConnections = 64;  // accepted while evicted ones are still closing
constexpr std::string_view kCookieName = "haarlight";
constexpr std::string_view kLoginPath = "/v1/login";

/// The state of a socket; guarded by Impl::mutex.
struct Connection {
  /// waiting for a request's header; busy with its body or answer; working: in a lane
  enum class State { waiting, busy, working, streaming };
  int fd = -1;
  State state = State::waiting;
  std::string address;                              ///< of the peer, without the port
  bool has_token = false;                           ///< streaming: of the listener
  std::shared_ptr<EventSubscription> subscription;  ///< streaming
  Clock::Time since;
  bool is_doomed = false;  ///< shut down, close pending
};

/// One request from its first line to its last byte. Used by the HTTP thread only.
struct Exchange {
  std::string raw_target;
  HttpRequest request;
  const HttpSite::Entry* entry = nullptr;
  bool is_login = false;
  bool has_header = false;  ///< the first call of the access handler is done
  bool is_too_large = false;
  bool is_crowded = false;             ///< too much was being received already
  std::size_t n_body_bytes = 0;        ///< of its body, counted in Impl's
  std::optional<HttpResponse> answer;  ///< of a lane, once the connection is resumed
};

bool equal_in_constant_time(std::string_view a, std::string_view b) {
  unsigned difference = a.size() == b.size() ? 0U : 1U;
  for (std::size_t i = 0; i < a.size() && i < b.size(); ++i) {
    difference |= static_cast<unsigned>(static_cast<unsigned char>(a[i]) ^
                                        static_cast<unsigned char>(b[i]));
  }
  return difference == 0;
}

/// 128 random bits as hexadecimal digits.
std::string make_session_key() {
  unsigned char bytes[16];
  if (::getrandom(bytes, sizeof(bytes), 0) != static_cast<ssize_t>(sizeof(bytes))) {
    throw Error("no random numbers for the login cookie", "getrandom", "check the kernel",
                ExitCode::io);
  }
  std::string key;
  for (const unsigned char byte : bytes) {
    key += fmt::format("{:02x}", byte);
  }
  return key;
}

/// A header of the request, or empty.
std::string_view header_of(MHD_Connection* connection, const char* name) {
  const char* value = MHD_lookup_connection_value(connection, MHD_HEADER_KIND, name);
  return value == nullptr ? std::string_view{} : std::string_view(value);
}

extern "C" {
static MHD_Result haarlight_take_host(void* cls, MHD_ValueKind /*kind*/, const char* name,
                                      const char* value) {
  if (name != nullptr && ::strcasecmp(name, MHD_HTTP_HEADER_HOST) == 0) {
    static_cast<std::vector<std::string_view>*>(cls)->emplace_back(value == nullptr ? ""
                                                                                    : value);
  }
  return MHD_YES;
}
}

Caller caller_of(MHD_Connection* connection) {
  Caller caller;
  MHD_get_connection_values(connection, MHD_HEADER_KIND, haarlight_take_host, &caller.hosts);
  caller.origin = header_of(connection, MHD_HTTP_HEADER_ORIGIN);
  caller.fetch_site = header_of(connection, "Sec-Fetch-Site");
  caller.fetch_mode = header_of(connection, "Sec-Fetch-Mode");
  caller.fetch_dest = header_of(connection, "Sec-Fetch-Dest");
  return caller;
}

struct ResponseDelete {
  void operator()(MHD_Response* response) const noexcept { MHD_destroy_response(response); }
};
using ResponseHandle = std::unique_ptr<MHD_Response, ResponseDelete>;

void add_header(MHD_Response* response, const std::string& name, const std::string& value) {
  MHD_add_response_header(response, name.c_str(), value.c_str());
}

void add_common_headers(MHD_Response* response, const std::string& content_type,
                        const char* caching) {
  if (!content_type.empty()) {
    add_header(response, "Content-Type", content_type);
  }
  add_header(response, "Cache-Control", caching);
  add_header(response, "X-Content-Type-Options", "nosniff");
  add_header(response, "X-Frame-Options", "DENY");
  add_header(response, "Referrer-Policy", "no-referrer");
  add_header(response, "Cross-Origin-Resource-Policy", "same-origin");
  add_header(response, "Content-Security-Policy",
             "default-src 'self'; img-src 'self' data: blob:; frame-ancestors 'none'; "
             "base-uri 'none'; form-action 'self'");
}

/// An event stream going out on one connection.
struct Listener {
  MHD_Connection* connection = nullptr;
  std::shared_ptr<EventStream> stream;
  std::shared_ptr<EventSubscription> subscription;
};

extern "C" {
static ssize_t haarlight_read_stream(void* cls, std::uint64_t /*position*/, char* buffer,
                                     std::size_t size) {
  auto* listener = static_cast<Listener*>(cls);
  try {
    const auto n = listener->subscription->read(
        {buffer, size}, [listener] { MHD_suspend_connection(listener->connection); });
    return n ? static_cast<ssize_t>(*n) : MHD_CONTENT_READER_END_OF_STREAM;
  } catch (const std::exception& error) {
    log_error(fmt::format("http: replay of events failed: {}", error.what()));
    return MHD_CONTENT_READER_END_WITH_ERROR;
  }
}

static void haarlight_free_stream(void* cls) {
  const std::unique_ptr<Listener> listener(static_cast<Listener*>(cls));
  listener->stream->unsubscribe(listener->subscription);
}
}

}  // namespace

struct HttpServer::Impl {
  HttpServerConfig config;
  HttpSite site;
  bool is_loopback = true;
  bool is_exposed = false;  ///< reachable from elsewhere: reading needs the token too
  std::string session_key;
  int port = 0;
  MHD_Daemon* daemon = nullptr;

  Clock& clock;
  mutable std::mutex mutex;
  ClockCondition tick;
  std::unordered_map<Connection*, std::unique_ptr<Connection>> connections;
  std::size_t n_busy = 0;        ///< working ones included
  std::size_t n_body_bytes = 0;  ///< of all requests; the HTTP thread alone uses it
  std::atomic<std::uint64_t> n_requests{0};
  std::atomic<std::uint64_t> n_refused{0};
  std::uint64_t n_evicted = 0;    // mutex
  std::uint64_t n_timed_out = 0;  // mutex
  RequestWorker looks;
  RequestWorker works;
  std::jthread timer;

  Impl(HttpServerConfig requested, HttpSite pages)
      : config(std::move(requested)),
        site(std::move(pages)),
        clock(*config.clock),
        tick(clock),
        looks(config.max_waiting, config.lane_patience, clock, config.look_threads),
        works(config.max_waiting, config.lane_patience, clock) {}
  ~Impl();
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;
  void start();

  // Connections.
  void open_connection(MHD_Connection* connection, void** context);
  void close_connection(Connection* known);
  void set_state(MHD_Connection* connection, Connection::State state);
  void make_room_locked(const Connection* newest);
  /// False: every other listener has a better claim to its slot.
  bool make_room_for_listener(bool is_with_token);
  void doom_locked(Connection& connection);
  void close_late_locked(Clock::Time now);
  void run_timer(const std::stop_token& stop);

  // Requests.
  MHD_Result receive(MHD_Connection* connection, const char* method, const char* upload,
                     std::size_t* upload_size, void** context);
  std::optional<HttpResponse> refuse(MHD_Connection* connection, Exchange& exchange);
  std::optional<HttpResponse> find_route(Exchange& exchange) const;
  [[nodiscard]] bool has_token(MHD_Connection* connection) const;
  [[nodiscard]] std::size_t most_body_bytes(const Exchange& exchange) const;
  [[nodiscard]] HttpResponse too_large(const Exchange& exchange) const;
  [[nodiscard]] static HttpResponse crowded(const Exchange& exchange);
  void take_body(Exchange& exchange, std::string_view upload);
  void forget_body(Exchange& exchange);
  MHD_Result answer(MHD_Connection* connection, Exchange& exchange);
  /// Never throws.
  [[nodiscard]] static HttpResponse respond(const Exchange& exchange);
  [[nodiscard]] HttpResponse log_in(MHD_Connection* connection, const Exchange& exchange) const;
  MHD_Result send(MHD_Connection* connection, const HttpResponse& response);
  MHD_Result send_file(MHD_Connection* connection, const Exchange& exchange);
  MHD_Result send_stream(MHD_Connection* connection, const Exchange& exchange);
  [[nodiscard]] std::optional<std::vector<std::string>> static_segments(
      const std::vector<std::string>& segments) const;
};

namespace {

bool is_busy(Connection::State state) {
  return state == Connection::State::busy || state == Connection::State::working;
}

Connection* connection_context(MHD_Connection* connection) {
  const MHD_ConnectionInfo* info =
      MHD_get_connection_info(connection, MHD_CONNECTION_INFO_SOCKET_CONTEXT);
  return info == nullptr ? nullptr : static_cast<Connection*>(info->socket_context);
}

}  // namespace

// ---- connections ----

void HttpServer::Impl::open_connection(MHD_Connection* connection, void** context) {
  const MHD_ConnectionInfo* info =
      MHD_get_connection_info(connection, MHD_CONNECTION_INFO_CONNECTION_FD);
  auto known = std::make_unique<Connection>();
  known->fd = info == nullptr ? -1 : info->connect_fd;
  const MHD_ConnectionInfo* peer =
      MHD_get_connection_info(connection, MHD_CONNECTION_INFO_CLIENT_ADDRESS);
  known->address = address_of(peer == nullptr ? nullptr : peer->client_addr);
  known->since = clock.now();
  *context = known.get();
  const std::lock_guard lock(mutex);
  Connection* newest = known.get();
  connections.emplace(newest, std::move(known));
  make_room_locked(newest);
}

void HttpServer::Impl::close_connection(Connection* known) {
  const std::lock_guard lock(mutex);
  const auto it = connections.find(known);
  if (it == connections.end()) {
    return;
  }
  n_busy -= is_busy(known->state) ? 1 : 0;
  connections.erase(it);
}

void HttpServer::Impl::set_state(MHD_Connection* connection, Connection::State state) {
  Connection* known = connection_context(connection);
  if (known == nullptr) {
    return;
  }
  const std::lock_guard lock(mutex);
  n_busy -= is_busy(known->state) ? 1 : 0;
  n_busy += is_busy(state) ? 1 : 0;
  known->state = state;
  known->since = clock.now();
}

void HttpServer::Impl::doom_locked(Connection& connection) {
  // The descriptor is open until close_connection has removed this entry, so this cannot hit
  // another file. The HTTP thread sees the end of the connection and frees it.
  connection.is_doomed = true;
  ::shutdown(connection.fd, SHUT_RDWR);
}

void HttpServer::Impl::make_room_locked(const Connection* newest) {
  std::size_t n_alive = 0;
  Connection* oldest = nullptr;
  for (const auto& [key, connection] : connections) {
    if (connection->is_doomed) {
      continue;
    }
    ++n_alive;
    if (connection.get() == newest || connection->state == Connection::State::streaming ||
        connection->state == Connection::State::working) {  // it ends by itself
      continue;
    }
    const auto rank = [](const Connection& c) {
      return std::pair(c.state == Connection::State::busy, c.since);
    };
    if (oldest == nullptr || rank(*connection) < rank(*oldest)) {
      oldest = connection.get();
    }
  }
  if (n_alive > config.max_connections && oldest != nullptr) {
    doom_locked(*oldest);
    ++n_evicted;
  }
}

bool HttpServer::Impl::make_room_for_listener(bool is_with_token) {
  std::shared_ptr<EventSubscription> ended;
  {
    const std::lock_guard lock(mutex);
    std::vector<Connection*> listeners;
    std::unordered_map<std::string, std::size_t> n_of_address;
    for (const auto& [key, other] : connections) {
      if (other->state == Connection::State::streaming && !other->is_doomed) {
        listeners.push_back(other.get());
        ++n_of_address[other->address];
      }
    }
    if (listeners.size() < config.max_listeners) {
      return true;
    }
    const auto right = [&](const Connection* c) {
      return std::tuple(c->has_token, -static_cast<std::ptrdiff_t>(n_of_address[c->address]),
                        c->since);
    };
    Connection* last = *std::min_element(
        listeners.begin(), listeners.end(),
        [&](const Connection* a, const Connection* b) { return right(a) < right(b); });
    if (last->has_token && !is_with_token) {
      return false;
    }
    doom_locked(*last);
    ++n_evicted;
    ended = last->subscription;
  }
  EventStream::end(*ended);  // a sleeping one does not notice that its connection was shut down
  return true;
}

void HttpServer::Impl::close_late_locked(Clock::Time now) {
  for (const auto& [key, connection] : connections) {
    if (connection->is_doomed || connection->state == Connection::State::streaming ||
        connection->state == Connection::State::working) {
      continue;
    }
    const bool has_header = connection->state == Connection::State::busy;
    if (now - connection->since > (has_header ? config.request_timeout : config.idle_timeout)) {
      doom_locked(*connection);
      ++n_timed_out;
    }
  }
}

void HttpServer::Impl::run_timer(const std::stop_token& stop) {
  const auto shortest =
      std::min({config.idle_timeout, config.request_timeout, config.heartbeat});
  const auto period =
      std::clamp(shortest / 4, std::chrono::milliseconds(5), std::chrono::milliseconds(250));
  Clock::Time next_heartbeat = clock.now() + config.heartbeat;
  std::unique_lock lock(mutex);
  while (!stop.stop_requested()) {
    (void)tick.wait_until(lock, stop, clock.now() + period, [] { return false; });
    const Clock::Time now = clock.now();
    close_late_locked(now);
    if (now >= next_heartbeat) {
      next_heartbeat = now + config.heartbeat;
      lock.unlock();  // a listener's wake-up must neither wait for this lock nor hold it
      for (const HttpSite::Entry& entry : site.entries()) {
        if (entry.stream) {
          entry.stream->send_heartbeat();
        }
      }
      lock.lock();
    }
  }
}

// ---- requests ----

std::optional<std::vector<std::string>> HttpServer::Impl::static_segments(
    const std::vector<std::string>& segments) const {
  const std::vector<std::string>& prefix = site.static_prefix();
  if (site.static_folder().empty() || segments.size() < prefix.size() ||
      !std::equal(prefix.begin(), prefix.end(), segments.begin())) {
    return std::nullopt;
  }
  return std::vector<std::string>(segments.begin() + static_cast<std::ptrdiff_t>(prefix.size()),
                                  segments.end());
}

std::optional<HttpResponse> HttpServer::Impl::find_route(Exchange& exchange) const {
  HttpRequest& request = exchange.request;
  const std::string_view raw = exchange.raw_target;
  request.path = raw.substr(0, raw.find('?'));
  auto target = parse_target(raw);
  if (!target) {
    return error_response(400, "the path is not well formed", request.path,
                          "check the percent escapes; a path has no empty, . or .. part");
  }
  request.query = std::move(target->query);
  exchange.is_login = request.path == kLoginPath && request.method == "POST";
  if (exchange.is_login) {
    return std::nullopt;
  }
  std::string allowed;
  for (const HttpSite::Entry& entry : site.entries()) {
    auto captures = entry.pattern.match(target->segments);
    if (!captures) {
      continue;
    }
    if (entry.route.method == request.method) {
      exchange.entry = &entry;
      request.captures = std::move(*captures);
      return std::nullopt;
    }
    allowed += (allowed.empty() ? "" : ", ") + entry.route.method;
  }
  if (!allowed.empty()) {
    HttpResponse response = error_response(405, request.method + " is not possible here",
                                           request.path, "use " + allowed);
    response.headers["Allow"] = allowed;
    return response;
  }
  if (request.method == "GET" && static_segments(target->segments)) {
    return std::nullopt;
  }
  return error_response(404, "there is nothing at this path", request.path,
                        "docs/reference/http-api.md lists the paths");
}

bool HttpServer::Impl::has_token(MHD_Connection* connection) const {
  const std::string_view bearer = header_of(connection, MHD_HTTP_HEADER_AUTHORIZATION);
  constexpr std::string_view kBearer = "Bearer ";
  if (bearer.substr(0, kBearer.size()) == kBearer &&
      equal_in_constant_time(bearer.substr(kBearer.size()), config.token)) {
    return true;
  }
  const auto cookie = find_cookie(header_of(connection, MHD_HTTP_HEADER_COOKIE), kCookieName);
  return cookie && equal_in_constant_time(*cookie, session_key);
}

std::optional<HttpResponse> HttpServer::Impl::refuse(MHD_Connection* connection,
                                                     Exchange& exchange) {
  const Caller caller = caller_of(connection);
  if (auto response = refuse_stranger(caller, is_loopback, config.allowed_hosts)) {
    return response;
  }
  if (auto response = find_route(exchange)) {
    return response;
  }
  if (auto response = refuse_cross_site(caller, exchange.entry == nullptr)) {
    return response;
  }
  const bool is_always = exchange.entry != nullptr && exchange.entry->route.is_always;
  if (!is_always) {
    const std::lock_guard lock(mutex);
    if (n_busy > config.max_connections / 2) {
      return error_response(503, "too many requests at once", exchange.request.path,
                            "try again in a moment");
    }
  }
  const Access access = exchange.entry == nullptr ? Access::open : exchange.entry->route.access;
  const bool needs_token = !config.token.empty() &&
                           (access == Access::write || (access == Access::read && is_exposed));
  if (needs_token && !has_token(connection)) {
    HttpResponse response =
        error_response(401, "the token is missing or wrong", exchange.request.path,
                       "send \"Authorization: Bearer TOKEN\", or log in on the page");
    response.headers["WWW-Authenticate"] = "Bearer";
    return response;
  }
  const std::string_view length = header_of(connection, MHD_HTTP_HEADER_CONTENT_LENGTH);
  std::uint64_t n_bytes = 0;
  const auto parsed = std::from_chars(length.data(), length.data() + length.size(), n_bytes);
  if (!length.empty() && (parsed.ec != std::errc() || n_bytes > most_body_bytes(exchange))) {
    return too_large(exchange);
  }
  if (n_bytes > config.max_bodies_bytes - std::min(n_body_bytes, config.max_bodies_bytes)) {
    return crowded(exchange);
  }
  return std::nullopt;
}

std::size_t HttpServer::Impl::most_body_bytes(const Exchange& exchange) const {
  return exchange.entry != nullptr && exchange.entry->route.max_body_bytes > 0
             ? exchange.entry->route.max_body_bytes
             : config.max_body_bytes;
}

HttpResponse HttpServer::Impl::too_large(const Exchange& exchange) const {
  return error_response(413, "the body is too large", exchange.request.path,
                        fmt::format("send at most {} bytes", most_body_bytes(exchange)));
}

HttpResponse HttpServer::Impl::crowded(const Exchange& exchange) {
  HttpResponse response = error_response(503, "too much is being received at once",
                                         exchange.request.path, "try again in a second");
  response.headers["Retry-After"] = "1";
  return response;
}

/// What is refused is read to its end, and not kept.
void HttpServer::Impl::take_body(Exchange& exchange, std::string_view upload) {
  std::string& body = exchange.request.body;
  // A chunked body reveals its length only on arrival.
  exchange.is_too_large =
      exchange.is_too_large || body.size() + upload.size() > most_body_bytes(exchange);
  exchange.is_crowded =
      exchange.is_crowded || n_body_bytes + upload.size() > config.max_bodies_bytes;
  if (exchange.is_too_large || exchange.is_crowded) {
    forget_body(exchange);
    body = {};
    return;
  }
  body.append(upload);
  exchange.n_body_bytes += upload.size();
  n_body_bytes += upload.size();
}

void HttpServer::Impl::forget_body(Exchange& exchange) {
  n_body_bytes -= std::exchange(exchange.n_body_bytes, 0);
}

MHD_Result HttpServer::Impl::receive(MHD_Connection* connection, const char* method,
                                     const char* upload, std::size_t* upload_size,
                                     void** context) {
  auto& exchange = *static_cast<Exchange*>(*context);
  if (!exchange.has_header) {
    exchange.has_header = true;
    set_state(connection, Connection::State::busy);
    exchange.request.method = std::string_view(method) == "HEAD" ? "GET" : method;
    if (const auto response = refuse(connection, exchange)) {
      return send(connection, *response);
    }
    for (const auto& [name, key] : {std::pair(MHD_HTTP_HEADER_ACCEPT, "accept"),
                                    std::pair(MHD_HTTP_HEADER_CONTENT_TYPE, "content-type"),
                                    std::pair(MHD_HTTP_HEADER_IF_NONE_MATCH, "if-none-match"),
                                    std::pair(MHD_HTTP_HEADER_RANGE, "range")}) {
      if (const std::string_view value = header_of(connection, name); !value.empty()) {
        exchange.request.headers[key] = value;
      }
    }
    return MHD_YES;
  }
  if (*upload_size > 0) {
    take_body(exchange, {upload, *upload_size});
    *upload_size = 0;
    return MHD_YES;
  }
  return answer(connection, exchange);
}

MHD_Result HttpServer::Impl::answer(MHD_Connection* connection, Exchange& exchange) {
  if (exchange.answer) {
    set_state(connection, Connection::State::busy);
    return send(connection, *exchange.answer);
  }
  if (exchange.is_too_large) {
    return send(connection, too_large(exchange));
  }
  if (exchange.is_crowded) {
    return send(connection, crowded(exchange));
  }
  if (exchange.is_login) {
    return send(connection, log_in(connection, exchange));
  }
  if (exchange.entry == nullptr) {
    return send_file(connection, exchange);
  }
  if (exchange.entry->stream) {
    return send_stream(connection, exchange);
  }
  const HttpRoute& route = exchange.entry->route;
  if (route.lane == Lane::here) {
    return send(connection, respond(exchange));
  }
  const std::string client = exchange.request.query_or("client", "");
  set_state(connection, Connection::State::working);
  MHD_suspend_connection(connection);
  // The exchange lives until the connection is resumed, which `done` does, once.
  (route.lane == Lane::work ? works : looks)
      .push({.key = route.lane == Lane::work && !client.empty() ? route.pattern + " " + client
                                                                : std::string(),
             .answer = [&exchange] { return respond(exchange); },
             .done =
                 [connection, &exchange](HttpResponse response) {
                   exchange.answer = std::move(response);
                   MHD_resume_connection(connection);
                 }});
  return MHD_YES;
}

HttpResponse HttpServer::Impl::respond(const Exchange& exchange) {
  try {
    return exchange.entry->route.handler(exchange.request);
  } catch (const Error& error) {
    return error_response(error);
  } catch (const std::exception& error) {
    log_error(fmt::format("http: {} {}: {}", exchange.request.method, exchange.request.path,
                          error.what()));
    return error_response(500, "the server made a mistake", exchange.request.path,
                          "the log has the details");
  }
}

HttpResponse HttpServer::Impl::log_in(MHD_Connection* connection,
                                      const Exchange& exchange) const {
  std::string_view given = exchange.request.body;
  while (!given.empty() &&
         (given.back() == '\n' || given.back() == '\r' || given.back() == ' ')) {
    given.remove_suffix(1);
  }
  if (config.token.empty()) {
    return {204, "", "", {}};
  }
  if (!equal_in_constant_time(given, config.token)) {
    return error_response(401, "the token is wrong", std::string(kLoginPath),
                          "the daemon's token file has it");
  }
  // A page that came by TLS never sends its cookie without.
  const bool is_tls = header_of(connection, MHD_HTTP_HEADER_ORIGIN).starts_with("https://");
  const std::string cookie = fmt::format("{}={}; HttpOnly; SameSite=Strict; Path=/{}",
                                         kCookieName, session_key, is_tls ? "; Secure" : "");
  return {204, "", "", {{"Set-Cookie", cookie}}};
}

MHD_Result HttpServer::Impl::send(MHD_Connection* connection, const HttpResponse& response) {
  ++n_requests;
  n_refused += response.status >= 400 ? 1 : 0;
  // libmicrohttpd copies; the void* is for C.
  const ResponseHandle handle(MHD_create_response_from_buffer(
      response.body.size(), const_cast<char*>(response.body.data()), MHD_RESPMEM_MUST_COPY));
  if (!handle) {
    return MHD_NO;
  }
  const auto caching = response.headers.find(MHD_HTTP_HEADER_CACHE_CONTROL);
  add_common_headers(handle.get(), response.content_type,
                     caching == response.headers.end() ? "no-store" : caching->second.c_str());
  for (const auto& [name, value] : response.headers) {
    if (name != MHD_HTTP_HEADER_CACHE_CONTROL) {
      add_header(handle.get(), name, value);
    }
  }
  return MHD_queue_response(connection, static_cast<unsigned>(response.status), handle.get());
}

MHD_Result HttpServer::Impl::send_file(MHD_Connection* connection, const Exchange& exchange) {
  const auto target = parse_target(exchange.raw_target);
  const auto segments = target ? static_segments(target->segments) : std::nullopt;
  auto file = segments ? open_static_file(site.static_folder(), *segments) : std::nullopt;
  if (!file) {
    return send(connection, error_response(404, "there is no such file", exchange.request.path,
                                           "check the address"));
  }
  ++n_requests;
  const ResponseHandle handle(MHD_create_response_from_fd64(file->size, file->fd.get()));
  if (!handle) {
    return MHD_NO;
  }
  (void)file->fd.release();  // the response closes it
  add_common_headers(handle.get(), file->content_type, "no-cache");
  return MHD_queue_response(connection, MHD_HTTP_OK, handle.get());
}

MHD_Result HttpServer::Impl::send_stream(MHD_Connection* connection, const Exchange& exchange) {
  std::optional<std::int64_t> last_id;
  if (const std::string_view text = header_of(connection, "Last-Event-ID"); !text.empty()) {
    std::int64_t id = 0;
    const auto parsed = std::from_chars(text.data(), text.data() + text.size(), id);
    if (parsed.ec != std::errc() || parsed.ptr != text.data() + text.size() || id < 0) {
      return send(connection, error_response(400, "Last-Event-ID is no event's number",
                                             exchange.request.path, "leave it out"));
    }
    last_id = id;
  }
  const bool is_with_token = !config.token.empty() && has_token(connection);
  if (!make_room_for_listener(is_with_token)) {
    return send(connection, error_response(503, "too many listeners", exchange.request.path,
                                           "close another page, or log in"));
  }
  auto listener = std::make_unique<Listener>();
  listener->connection = connection;
  listener->stream = exchange.entry->stream;
  listener->subscription =
      listener->stream->subscribe(last_id, [connection] { MHD_resume_connection(connection); });
  Listener* raw = listener.get();
  const ResponseHandle handle(MHD_create_response_from_callback(
      MHD_SIZE_UNKNOWN, 4096, haarlight_read_stream, raw, haarlight_free_stream));
  if (!handle) {
    haarlight_free_stream(listener.release());
    return MHD_NO;
  }
  (void)listener.release();  // haarlight_free_stream deletes it
  ++n_requests;
  add_common_headers(handle.get(), "text/event-stream", "no-store");
  add_header(handle.get(), "X-Accel-Buffering", "no");
  if (Connection* known = connection_context(connection); known != nullptr) {
    const std::lock_guard lock(mutex);
    known->has_token = is_with_token;
    known->subscription = raw->subscription;
  }
  set_state(connection, Connection::State::streaming);
  return MHD_queue_response(connection, MHD_HTTP_OK, handle.get());
}

// ---- the C side: no exception leaves these ----

namespace {

extern "C" {
static void* haarlight_begin_request(void* /*cls*/, const char* uri,
                                     MHD_Connection* /*connection*/) {
  try {
    auto exchange = std::make_unique<Exchange>();
    exchange->raw_target = uri;
    return exchange.release();
  } catch (const std::exception&) {
    return nullptr;
  }
}

static MHD_Result haarlight_receive(void* cls, MHD_Connection* connection, const char* /*url*/,
                                    const char* method, const char* /*version*/,
                                    const char* upload, std::size_t* upload_size,
                                    void** context) {
  try {
    if (*context == nullptr) {
      return MHD_NO;
    }
    return static_cast<HttpServer::Impl*>(cls)->receive(connection, method, upload, upload_size,
                                                        context);
  } catch (const std::exception& error) {
    log_error(fmt::format("http: {}", error.what()));
    return MHD_NO;
  }
}

static void haarlight_end_request(void* cls, MHD_Connection* connection, void** context,
                                  MHD_RequestTerminationCode /*why*/) {
  const std::unique_ptr<Exchange> exchange(static_cast<Exchange*>(*context));
  if (exchange) {
    static_cast<HttpServer::Impl*>(cls)->forget_body(*exchange);
  }
  *context = nullptr;
  static_cast<HttpServer::Impl*>(cls)->set_state(connection, Connection::State::waiting);
}

static void haarlight_notify_connection(void* cls, MHD_Connection* connection, void** context,
                                        MHD_ConnectionNotificationCode code) {
  auto* impl = static_cast<HttpServer::Impl*>(cls);
  try {
    if (code == MHD_CONNECTION_NOTIFY_STARTED) {
      impl->open_connection(connection, context);
    } else {
      impl->close_connection(static_cast<Connection*>(*context));
      *context = nullptr;
    }
  } catch (const std::exception& error) {
    log_error(fmt::format("http: {}", error.what()));
  }
}

static void haarlight_log_http(void* /*cls*/, const char* format, va_list arguments) {
  char line[256];
  // Malformed requests from strangers do not belong in the log.
  if (std::vsnprintf(line, sizeof(line), format, arguments) > 0) {
    log_debug(std::string("http: ") + line);
  }
}
}

}  // namespace

void HttpServer::Impl::start() {
  const BindAddress address = parse_bind_address(config.address, config.port);
  is_loopback = address.is_loopback;
  is_exposed = !is_loopback || !config.allowed_hosts.empty();
  if (is_exposed && config.token.empty()) {
    throw Error(
        fmt::format("{} can be reached from other machines and there is no token",
                    is_loopback ? config.allowed_hosts.front() : config.address),
        is_loopback ? "http.allowed_hosts" : "http.address",
        is_loopback ? "set http.token_file" : "set http.token_file, or listen on 127.0.0.1");
  }
  for (const std::string& host : config.allowed_hosts) {
    if (!parse_authority(host)) {
      throw Error(fmt::format("\"{}\" is no name of a host", host), "http.allowed_hosts",
                  "write for example \"rig.example\" or \"rig.example:8443\"");
    }
  }
  if (!config.token.empty() && config.token.size() < kMinTokenLength) {
    throw Error(fmt::format("the token has {} characters", config.token.size()),
                "http.token_file", fmt::format("use {} or more", kMinTokenLength));
  }
  if (!site.static_folder().empty() && !std::filesystem::is_directory(site.static_folder())) {
    throw Error("the folder of the page's files is missing", site.static_folder().string(),
                "install the program whole, or name the folder");
  }
  HAARLIGHT_EXPECTS(config.max_listeners < config.max_connections,
                    "listeners leave room for requests");
  session_key = make_session_key();
  unsigned flags = MHD_USE_EPOLL_INTERNAL_THREAD | MHD_ALLOW_SUSPEND_RESUME | MHD_USE_ERROR_LOG;
  if (address.is_v6) {
    flags |= MHD_USE_IPv6;
  }
  const auto timeout_s =
      static_cast<unsigned>(std::chrono::ceil<std::chrono::seconds>(
                                std::max(config.idle_timeout, config.request_timeout))
                                .count() +
                            1);
  errno = 0;
  daemon = MHD_start_daemon(
      flags, 0, nullptr, nullptr, haarlight_receive, this,                               //
      MHD_OPTION_EXTERNAL_LOGGER, haarlight_log_http, nullptr,                           //
      MHD_OPTION_SOCK_ADDR, reinterpret_cast<const sockaddr*>(&address.storage),         //
      MHD_OPTION_URI_LOG_CALLBACK, haarlight_begin_request, this,                        //
      MHD_OPTION_NOTIFY_COMPLETED, haarlight_end_request, this,                          //
      MHD_OPTION_NOTIFY_CONNECTION, haarlight_notify_connection, this,                   //
      MHD_OPTION_CONNECTION_LIMIT,                                                       //
      static_cast<unsigned>(config.max_connections) + kSpareConnections,                 //
      MHD_OPTION_CONNECTION_MEMORY_LIMIT, config.max_header_bytes + std::size_t{16384},  //
      MHD_OPTION_CONNECTION_TIMEOUT, timeout_s,                                          //
      MHD_OPTION_STRICT_FOR_CLIENT, 1, MHD_OPTION_END);
  if (daemon == nullptr) {
    const int error = errno;
    throw Error(fmt::format("cannot listen: {}", std::strerror(error)),
                fmt::format("{}:{}", config.address, config.port),
                "stop the other program on this port, or choose another one",
                ExitCode::unavailable);
  }
  const MHD_DaemonInfo* info = MHD_get_daemon_info(daemon, MHD_DAEMON_INFO_BIND_PORT);
  port = info != nullptr && info->port != 0 ? info->port : config.port;
  timer = clock.start([this](const std::stop_token& stop) {
    try {
      run_timer(stop);
    } catch (const std::exception& error) {
      log_error(fmt::format("http timer: {}", error.what()));
    }
  });
}

HttpServer::Impl::~Impl() {
  clock.stop(timer);
  // None may sleep while the server is stopping.
  looks.close();
  works.close();
  for (const HttpSite::Entry& entry : site.entries()) {
    if (entry.stream) {
      entry.stream->close();  // wakes every listener
    }
  }
  if (daemon != nullptr) {
    MHD_stop_daemon(daemon);
  }
}

HttpServer::HttpServer(HttpServerConfig config, HttpSite site)
    : impl_(std::make_unique<Impl>(std::move(config), std::move(site))) {
  impl_->start();
}

HttpServer::~HttpServer() = default;

int HttpServer::port() const noexcept { return impl_->port; }

HttpCounters HttpServer::counters() const {
  const std::lock_guard lock(impl_->mutex);
  return {impl_->n_requests, impl_->n_refused, impl_->n_evicted, impl_->n_timed_out,
          impl_->connections.size()};
}

}  // namespace haarlight::http
