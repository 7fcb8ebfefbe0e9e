// SPDX-License-Identifier: Apache-2.0
#include "haarlight/capture/daemon/daemon_client.h"

#include <mutex>

#include <curl/curl.h>
#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "core/text_limits.h"
#include "haarlight/core/error.h"

namespace haarlight::capture {

namespace {

struct FreeCurl {
  void operator()(CURL* curl) const noexcept { curl_easy_cleanup(curl); }
};
struct FreeHeaders {
  void operator()(curl_slist* list) const noexcept { curl_slist_free_all(list); }
};

std::size_t append(char* data, std::size_t size, std::size_t count, void* out) {
  static_cast<std::string*>(out)->append(data, size * count);
  return size * count;
}

void start_curl_once() {
  static std::once_flag once;
  std::call_once(once, [] { curl_global_init(CURL_GLOBAL_DEFAULT); });
}

}  // namespace

struct DaemonClient::Impl {
  DaemonClientConfig config;
  std::unique_ptr<CURL, FreeCurl> curl;

  DaemonReply ask(const std::string& path, const std::string* body) const {
    CURL* c = curl.get();
    curl_easy_reset(c);
    const std::string url = config.url + path;
    DaemonReply reply;
    std::unique_ptr<curl_slist, FreeHeaders> headers;
    if (!config.token.empty()) {
      headers.reset(
          curl_slist_append(nullptr, ("Authorization: Bearer " + config.token).c_str()));
    }
    curl_easy_setopt(c, CURLOPT_URL, url.c_str());
    curl_easy_setopt(c, CURLOPT_NOSIGNAL, 1L);
    curl_easy_setopt(c, CURLOPT_PROXY, "");
    curl_easy_setopt(c, CURLOPT_TIMEOUT_MS, static_cast<long>(config.timeout.count()));
    curl_easy_setopt(c, CURLOPT_PROTOCOLS_STR, "http,https");
    curl_easy_setopt(c, CURLOPT_WRITEFUNCTION, append);
    curl_easy_setopt(c, CURLOPT_WRITEDATA, &reply.body);
    if (headers != nullptr) {
      curl_easy_setopt(c, CURLOPT_HTTPHEADER, headers.get());
    }
    if (body != nullptr) {
      curl_easy_setopt(c, CURLOPT_POST, 1L);
      curl_easy_setopt(c, CURLOPT_POSTFIELDS, body->data());
      curl_easy_setopt(c, CURLOPT_POSTFIELDSIZE_LARGE, static_cast<curl_off_t>(body->size()));
    }
    const CURLcode code = curl_easy_perform(c);
    if (code != CURLE_OK) {
      throw Error(fmt::format("the daemon does not answer: {}", curl_easy_strerror(code)), url,
                  "start haarlightd, or name its address with --daemon", ExitCode::unavailable);
    }
    long status = 0;
    curl_easy_getinfo(c, CURLINFO_RESPONSE_CODE, &status);
    reply.status = static_cast<int>(status);
    return reply;
  }
};

DaemonClient::DaemonClient(DaemonClientConfig config) : impl_(std::make_unique<Impl>()) {
  start_curl_once();
  while (!config.url.empty() && config.url.back() == '/') {
    config.url.pop_back();
  }
  impl_->config = std::move(config);
  impl_->curl.reset(curl_easy_init());
  HAARLIGHT_EXPECTS(impl_->curl != nullptr, "libcurl");
}
DaemonClient::~DaemonClient() = default;

DaemonReply DaemonClient::get(const std::string& path) { return impl_->ask(path, nullptr); }
DaemonReply DaemonClient::post(const std::string& path, const std::string& body) {
  return impl_->ask(path, &body);
}

std::string DaemonClient::escape(const std::string& text) {
  std::string out;
  for (const char c : text) {
    const bool is_plain = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') ||
                          (c >= '0' && c <= '9') || c == '-' || c == '_' || c == '.';
    out += is_plain ? std::string(1, c) : fmt::format("%{:02X}", static_cast<unsigned char>(c));
  }
  return out;
}

void DaemonClient::require_good(const DaemonReply& reply) {
  if (reply.status < 400) {
    return;
  }
  nlohmann::json json;
  try {
    json = parse_json<nlohmann::json>(reply.body, "haarlightd");
  } catch (const Error&) {  // a proxy's error page: report only the status
  }
  const auto error =
      json.is_object() ? json.value("error", nlohmann::json()) : nlohmann::json();
  const auto text = [&error](const char* key, const std::string& fallback) {
    return error.is_object() && error.contains(key) && error[key].is_string()
               ? error[key].get<std::string>()
               : fallback;
  };
  const ExitCode code = reply.status == 409   ? ExitCode::interrupted
                        : reply.status == 503 ? ExitCode::unavailable
                        : reply.status >= 500 ? ExitCode::internal
                                              : ExitCode::bad_input;
  throw Error(text("what", fmt::format("the daemon answers {}", reply.status)),
              text("where", "haarlightd"), text("cure", "see docs/reference/http-api.md"),
              code);
}

std::string fetch_local(const std::string& url) {
  const std::size_t path = url.find('/', url.find("//") + 2);
  try {
    DaemonClient client(
        {.url = url.substr(0, path), .token = {}, .timeout = std::chrono::milliseconds(1500)});
    const DaemonReply reply = client.get(url.substr(path));
    return reply.body.empty() ? fmt::format("HTTP {}", reply.status) : reply.body;
  } catch (const Error&) {
    return {};
  }
}

}  // namespace haarlight::capture
