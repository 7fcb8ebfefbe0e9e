// SPDX-License-Identifier: Apache-2.0
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "haarlight/capture/daemon/daemon_client.h"
#include "tests/capture/daemon_bench.h"

/// @file
/// Bodies that would overflow a parser's stack, sent to a daemon in mid-run.

namespace haarlight::capture {
namespace {

using ::testing::HasSubstr;

std::string repeat(const std::string& text, int n) {
  std::string out;
  for (int i = 0; i < n; ++i) {
    out += text;
  }
  return out;
}

/// 80 kB and more of depth, in every form that TOML and JSON have.
std::vector<std::string> deep_bodies() {
  constexpr int kDeep = 60000;
  const std::string keys = repeat("a.", kDeep);
  return {keys + "a = 1\n",
          "schema = 1\n[" + keys + "a]\n",
          "[[" + keys + "a]]\n",
          "x = {" + keys + "a = 1}\n",
          "x = " + repeat("[", kDeep),
          "x = " + repeat("[", kDeep) + repeat("]", kDeep) + "\n",
          "x = " + repeat("{a=", kDeep) + "1" + repeat("}", kDeep) + "\n",
          "x = " + repeat("{a.b=[", kDeep),
          "{\"shots\": " + repeat("[", kDeep) + repeat("]", kDeep) + "}",
          repeat("{\"shots\":", kDeep) + "1" + repeat("}", kDeep)};
}

class DaemonInput : public testing::DaemonBench {
 protected:
  /// The run stands still while this thread sends.
  DaemonInput() : DaemonBench(testing::BenchTime::virtual_time) {}
};

TEST_F(DaemonInput, DeepTextsAreRefusedInMidRun) {
  start(true);
  DaemonClient client({.url = "http://127.0.0.1:" + std::to_string(daemon_->http_port())});
  ASSERT_EQ(client
                .post("/v1/run?name=p.toml",
                      "schema = 1\nname = \"p\"\npatterns = \"one_at_a_time\"\n")
                .status,
            202);
  ASSERT_TRUE(wait_for_commits(3));
  for (const std::string& body : deep_bodies()) {
    const DaemonReply reply = client.post("/v1/dry-run?name=deep.toml", body);
    EXPECT_EQ(reply.status, 400) << body.substr(0, 30);
    EXPECT_THAT(reply.body, ::testing::AnyOf(HasSubstr("parts"), HasSubstr("brackets")))
        << body.substr(0, 30);
    EXPECT_THAT(reply.body, HasSubstr("\"cure\""));
  }
  for (const char* path : {"/v1/run", "/v1/reshoot", "/v1/preview"}) {
    for (const std::string& body : deep_bodies()) {
      EXPECT_EQ(client.post(path, body).status / 100, 4) << path << body.substr(0, 30);
    }
  }
  ASSERT_TRUE(wait_for(Phase::done));
  EXPECT_EQ(daemon_->state().n_committed, 64);
  EXPECT_EQ(client.get("/healthz").status, 200);
}

}  // namespace
}  // namespace haarlight::capture
