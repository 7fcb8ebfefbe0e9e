// SPDX-License-Identifier: Apache-2.0
/// @file
/// What SHA-256 over every byte costs a session of 5 MP: a frame's commit, finish, a capture
/// that goes on, verify; CPU time, on a disk in memory where there is one.
///
///     build/release/bench/session/seal_cost

#include <algorithm>
#include <cstdlib>
#include <optional>

#include <fmt/format.h>
#include <sys/resource.h>

#include "core/random.h"
#include "core/sha256.h"
#include "session/session_writer.h"
#include "session/verify.h"
#include "tests/session/small_session.h"

namespace haarlight {
namespace {

constexpr int kFrames = 24;
constexpr int kWidth = 2592;
constexpr int kHeight = 1944;
constexpr double kFramesASecond = 35.0;

double cpu_seconds() {
  rusage usage{};
  ::getrusage(RUSAGE_SELF, &usage);
  const auto seconds = [](const timeval& t) {
    return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec);
  };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

template <class Work>
double seconds_of(Work work) {
  const double begin = cpu_seconds();
  if (!work()) {
    fmt::print(stderr, "seal_cost: a step failed\n");
    std::exit(1);
  }
  return cpu_seconds() - begin;
}

void run() {
  const test::TemporaryFolder folder;
  const std::filesystem::path s = folder.path() / "s";
  session::SessionInfo info = test::small_info(kFrames);
  info.form.width = kWidth;
  info.form.height = kHeight;
  info.form.stored_height = kHeight;
  session::DiskStorage storage;
  auto writer = session::SessionWriter::create(s, info, "", test::kSmallPlan, 0, storage);
  Image<std::uint16_t> pixels(kHeight, kWidth, 1);
  double commit = 0.0;
  for (int shot = 0; shot < kFrames && writer; ++shot) {
    std::uint64_t key = hash_key(static_cast<std::uint64_t>(shot), 1);
    for (std::uint16_t& value : pixels.pixels()) {
      key = key * 6364136223846793005U + 1442695040888963407U;
      value = static_cast<std::uint16_t>(100 + (key >> 52U));
    }
    const session::PendingFrame frame{
        shot, 0, test::small_evidence(info, shot, 0, pixels.view()), pixels.view()};
    commit += seconds_of([&] { return writer->commit(std::span(&frame, 1)).has_value(); });
  }
  const double finish = seconds_of([&] { return writer && writer->finish().has_value(); });
  const auto bytes = std::as_bytes(std::span<const std::uint16_t>(pixels.pixels()));
  double leaf = 1e9;
  for (int i = 0; i < 20; ++i) {
    leaf = std::min(leaf, seconds_of([&] {
                      return leaf_hash("frames/000000_a0.tif", bytes) != Sha256Digest{};
                    }));
  }
  const double verify = seconds_of([&] { return session::verify_session(s).is_good(); });
  std::optional<Result<session::SessionWriter>> again;
  const double reopen = seconds_of([&] {
    again.emplace(session::SessionWriter::reopen(s, storage));
    return again->has_value();
  });
  const double megabytes = static_cast<double>(bytes.size()) / 1e6;
  fmt::print(
      "SHA-256 of {:.2f} MB: {:.2f} ms, {:.0f} MB/s, {:.1f} % of a core at {} a second\n",
      megabytes, 1e3 * leaf, megabytes / leaf, 100.0 * leaf * kFramesASecond, kFramesASecond);
  fmt::print(
      "a frame: commit {:.2f} ms, going on {:.2f} ms, verify {:.2f} ms; finish {:.1f} ms\n",
      1e3 * commit / kFrames, 1e3 * reopen / kFrames, 1e3 * verify / kFrames, 1e3 * finish);
}

}  // namespace
}  // namespace haarlight

int main() {
  haarlight::run();
  return 0;
}
