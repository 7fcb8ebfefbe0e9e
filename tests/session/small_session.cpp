// SPDX-License-Identifier: Apache-2.0
#include "tests/session/small_session.h"

#include <fstream>
#include <iterator>
#include <stdexcept>

#include <fmt/format.h>

#include "core/random.h"
#include "haarlight/core/files.h"
#include "haarlight/session/session.h"
#include "session/clean_rule.h"
#include "session/frame_check.h"

namespace haarlight::test {

namespace fs = std::filesystem;

TemporaryFolder::TemporaryFolder()
    : haarlight::TemporaryFolder(fs::is_directory("/dev/shm") ? fs::path("/dev/shm")
                                                              : fs::temp_directory_path()) {}

session::SessionInfo small_info(int n_lights) {
  session::SessionInfo info;
  info.id = "small";
  info.created = "2026-12-01T12:00:00Z";
  info.plan_hash = content_hash(kSmallPlan);
  info.form.width = kSmallWidth;
  info.form.height = kSmallHeight;
  info.form.stored_height = kSmallStored;
  info.form.black_level = 64.0;
  info.form.white_level = 4095.0;
  for (int k = 0; k < n_lights; ++k) {
    session::SessionLight light;
    const int row = k / 8;
    const int col = k % 8;
    light.name = fmt::format("top/{}/{}", row, col);
    light.is_position = true;
    light.coordinates = {col * 30.0, row * 30.0, 500.0};
    info.lights.push_back(light);
    session::Shot shot;
    shot.index = k;
    shot.lit = {{k, 65535}};
    shot.exposure_us = 4000.0;
    info.shots.push_back(shot);
  }
  return info;
}

Image<std::uint16_t> small_pixels(int shot) {
  Image<std::uint16_t> pixels(kSmallStored, kSmallWidth, 1);
  for (int y = 0; y < kSmallStored; ++y) {
    for (int x = 0; x < kSmallWidth; ++x) {
      const auto key = hash_key(static_cast<std::uint64_t>(shot), static_cast<std::uint64_t>(y),
                                static_cast<std::uint64_t>(x));
      pixels(y, x) = static_cast<std::uint16_t>(100 + key % 3000);
    }
  }
  return pixels;
}

session::FrameEvidence small_evidence(const session::SessionInfo& info, int shot, int attempt,
                                      ImageView<const std::uint16_t> stored) {
  session::FrameEvidence e;
  constexpr std::int64_t kMillisecond = 1'000'000;
  const std::int64_t t0 = (std::int64_t{shot} * 8 + attempt + 1) * 100 * kMillisecond;
  e.pattern_id = shot;
  e.tag = static_cast<std::uint32_t>(shot) + 1;
  e.tag_echo = e.tag;
  e.t_command_ns = t0;
  e.t_ack_ns = t0 + kMillisecond;
  e.t_shown_ns = e.t_ack_ns;
  e.t_stable_ns = t0 + 2 * kMillisecond;
  e.exposure_requested_us = 4000.0;
  e.exposure_read_us = 4000.0;
  e.read_us = 250.5;
  e.skew_us = 1000.25;
  e.timestamp_ns = t0 + 10 * kMillisecond;
  e.timestamp_meaning = TimestampMeaning::end_frame;
  const session::ExposureWindow window = session::exposure_window(
      {e.timestamp_ns, e.timestamp_meaning, e.exposure_read_us, e.read_us, e.skew_us});
  e.t_exposure_start_ns = window.start_ns;
  e.t_exposure_end_ns = window.end_ns;
  e.t_next_change_ns = t0 + 50 * kMillisecond;
  e.margin_us = session::assess_clean(window, e.t_stable_ns, e.t_next_change_ns).margin_us;
  e.sequence = static_cast<std::uint64_t>(shot) * 8U + static_cast<std::uint64_t>(attempt);
  const ImageView<const std::uint16_t> active(stored.data(), info.form.height, info.form.width,
                                              info.form.channels, stored.row_stride());
  session::describe_pixels(active, info.form, e);
  return e;
}

Result<void> capture_all(session::SessionWriter& writer, int group) {
  const session::SessionInfo info = writer.info();
  const std::vector<bool> committed = writer.committed();
  std::vector<Image<std::uint16_t>> pixels;
  std::vector<session::PendingFrame> frames;
  const auto flush = [&]() -> Result<void> {
    auto done = frames.empty() ? Result<void>() : writer.commit(frames);
    frames.clear();
    pixels.clear();
    return done;
  };
  pixels.reserve(static_cast<std::size_t>(group));
  for (int shot = 0; shot < static_cast<int>(info.shots.size()); ++shot) {
    if (committed[static_cast<std::size_t>(shot)]) {
      continue;
    }
    const int attempt = writer.next_attempt(shot);
    pixels.push_back(small_pixels(shot));
    frames.push_back({shot, attempt, small_evidence(info, shot, attempt, pixels.back().view()),
                      pixels.back().view()});
    if (static_cast<int>(frames.size()) == group) {
      if (auto done = flush(); !done) {
        return done;
      }
    }
  }
  if (auto done = flush(); !done) {
    return done;
  }
  return writer.finish();
}

void make_small_session(const fs::path& folder, int n_lights) {
  session::DiskStorage storage;
  auto writer = session::SessionWriter::create(folder, small_info(n_lights), "", kSmallPlan,
                                               1U << 16U, storage);
  if (!writer) {
    throw std::runtime_error(writer.error().what);
  }
  if (auto done = capture_all(*writer, 5); !done) {
    throw std::runtime_error(done.error().what);
  }
}

void make_session(const fs::path& folder, const session::SessionInfo& info,
                  const std::function<Image<std::uint16_t>(int shot)>& pixels,
                  const std::string& rig_toml) {
  session::DiskStorage storage;
  auto writer = session::SessionWriter::create(folder, info, rig_toml, kSmallPlan, 0, storage);
  const auto require = [](const auto& result) {
    if (!result) {
      throw std::runtime_error(result.error().what);
    }
  };
  require(writer);
  for (const session::Shot& shot : info.shots) {
    const Image<std::uint16_t> stored = pixels(shot.index);
    session::FrameEvidence evidence;
    evidence.kind = session::EvidenceKind::asserted;
    evidence.exposure_read_us = shot.exposure_us;
    const ImageView<const std::uint16_t> active(stored.pixels().data(), info.form.height,
                                                info.form.width, info.form.channels);
    session::describe_pixels(active, info.form, evidence);
    const session::PendingFrame frame{shot.index, 0, evidence, stored.view()};
    require(writer->commit(std::span(&frame, 1)));
  }
  require(writer->finish());
}

std::vector<std::string> committed_set(const fs::path& folder) {
  const session::Session session = session::Session::open(folder);
  std::vector<std::string> set = {session.info().plan_hash + " " +
                                  session.info().plan_file_hash};
  for (const session::FrameRecord& frame : session.info().frames) {
    set.push_back(fmt::format("{} {} {} {} {}", frame.shot, frame.evidence.pattern_id,
                              frame.evidence.tag, frame.evidence.tag_echo,
                              frame.evidence.pixel_hash));
  }
  return set;
}

std::string read_text(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

void write_text(const fs::path& file, const std::string& text) {
  std::ofstream out(file, std::ios::binary | std::ios::trunc);
  out << text;
}

}  // namespace haarlight::test
