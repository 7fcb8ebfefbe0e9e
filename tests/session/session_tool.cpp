// SPDX-License-Identifier: Apache-2.0
/// @file
/// Sessions for tests in Python, without a camera:
///     session_tool make SEED N FOLDER RIG        N sessions of all kinds, FOLDER/0 ...
///     session_tool verify SIGNERS|- FOLDER...    a line of JSON each: problems and notes
///     session_tool rebuild FOLDER
///     session_tool hash FILE...                  XXH3-128 of each

#include <cstdlib>
#include <iostream>
#include <optional>
#include <random>
#include <stdexcept>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "haarlight/capture/plan/plan.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/session/import/import.h"
#include "session/clean_rule.h"
#include "session/frame_check.h"
#include "session/rig_session.h"
#include "session/session_writer.h"
#include "session/verify.h"

namespace haarlight::session {
namespace {

namespace fs = std::filesystem;
using Random = std::mt19937_64;

int below(Random& random, int n) {
  return static_cast<int>(random() % static_cast<std::uint64_t>(n));
}

template <class T>
T require(Result<T> result) {
  if (!result) {
    throw std::runtime_error(result.error().what);
  }
  if constexpr (!std::is_void_v<T>) {
    return std::move(*result);
  }
}

Image<std::uint16_t> noise(const FrameForm& form, Random& random) {
  Image<std::uint16_t> pixels(form.stored_height, form.width, form.channels);
  const int level = 200 + below(random, 10000);
  for (std::uint16_t& value : pixels.pixels()) {
    value = static_cast<std::uint16_t>(level + below(random, 60));
  }
  return pixels;
}

/// A measured frame on a clock of its own: each call is later than the one before.
FrameEvidence evidence_of(const Rig& rig, const SessionInfo& info, int shot,
                          ImageView<const std::uint16_t> stored, std::int64_t& now) {
  const CameraSpec& camera = rig.cameras.front();
  FrameEvidence e;
  e.pattern_id = shot;
  e.tag = static_cast<std::uint32_t>(shot) + 1;
  e.tag_echo = e.tag;
  e.exposure_requested_us = info.shots[static_cast<std::size_t>(shot)].exposure_us;
  e.exposure_read_us = e.exposure_requested_us;
  e.read_us = camera.read_us;
  e.skew_us = camera.skew_us;
  e.timestamp_meaning = camera.timestamp;
  e.sync = rig.sync;
  e.t_command_ns = now;
  e.t_ack_ns = now + 100'000;
  e.t_stable_ns = now + 400'000;
  e.timestamp_ns =
      now + 1'000'000 +
      static_cast<std::int64_t>(1e3 * (e.exposure_read_us + e.read_us + e.skew_us));
  const ExposureWindow window = exposure_window(
      {e.timestamp_ns, e.timestamp_meaning, e.exposure_read_us, e.read_us, e.skew_us});
  e.t_exposure_start_ns = window.start_ns;
  e.t_exposure_end_ns = window.end_ns;
  e.t_next_change_ns = e.timestamp_ns + 1'000'000;
  e.margin_us = assess_clean(window, e.t_stable_ns, e.t_next_change_ns).margin_us;
  e.sequence = static_cast<std::uint64_t>(now / 10'000'000);
  e.temperature_c = 31.25;
  now = e.t_next_change_ns + 20'000'000;
  describe_pixels(
      ImageView<const std::uint16_t>(stored.data(), info.form.height, info.form.width,
                                     info.form.channels, stored.row_stride()),
      info.form, e);
  return e;
}

struct Bench {
  Rig rig;
  Random* random = nullptr;
  std::int64_t now = 1'000'000'000;

  void commit(SessionWriter& writer, int shot) {
    const Image<std::uint16_t> pixels = noise(writer.info().form, *random);
    const PendingFrame frame{shot, writer.next_attempt(shot),
                             evidence_of(rig, writer.info(), shot, pixels.view(), now),
                             pixels.view()};
    require(writer.commit(std::span(&frame, 1)));
  }
  void commit_pending(SessionWriter& writer, int most) {
    const std::vector<bool> committed = writer.committed();
    for (int shot = 0; shot < static_cast<int>(committed.size()) && most > 0; ++shot) {
      if (!committed[static_cast<std::size_t>(shot)]) {
        commit(writer, shot);
        --most;
      }
    }
  }
  void refuse(SessionWriter& writer, int shot) {
    const Image<std::uint16_t> pixels = noise(writer.info().form, *random);
    const PendingFrame frame{shot, writer.next_attempt(shot),
                             evidence_of(rig, writer.info(), shot, pixels.view(), now),
                             pixels.view()};
    require(writer.keep_refused(frame, "too dark"));
  }
};

std::string plan_text(Random& random) {
  if (below(random, 6) == 0) {
    return "schema = 1\nname = \"s\"\npatterns = \"list\"\n[[pattern]]\nlights = [0, 5, 9]\n"
           "levels = [65535, 20000, 1]\n[[pattern]]\nlights = [63]\n[[pattern]]\nlights = "
           "[1]\n";
  }
  std::string lights;
  const int n = 2 + below(random, 4);
  for (int i = 0; i < n; ++i) {
    lights += fmt::format("{}{}", i == 0 ? "" : ", ", i * 7 + below(random, 7));
  }
  std::string text = fmt::format(
      "schema = 1\nname = \"one\"\npatterns = \"one_at_a_time\"\nlights = [{}]\n", lights);
  text += below(random, 2) == 0 ? "exposures_us = [1000.0, 2500.5]\n" : "";
  text += below(random, 3) == 0 ? "repeats = 2\n" : "";
  text += below(random, 2) == 0 ? "darks_every = 2\n" : "";
  text += below(random, 2) == 0 ? "sentinel_every = 2\n" : "";
  text += below(random, 3) == 0 ? "flats = 1\n" : "";
  return text;
}

/// @param has_all  resumed, with a refused and with a withdrawn frame, whatever the chance
void make_capture(const fs::path& folder, const std::string& rig, Random& random,
                  bool has_all) {
  Bench bench;
  bench.random = &random;
  bench.rig = read_rig_as_written(rig);
  const capture::Plan plan =
      capture::expand_plan(capture::parse_plan_file(plan_text(random), "plan.toml"), bench.rig);
  SessionInfo info;
  info.id = fmt::format("{:016x}", random());
  info.created = "2026-12-01T12:00:00Z";
  info.plan_hash = plan.hash;
  info.rig_hash = bench.rig.hash;
  describe_rig(bench.rig, info);
  info.patterns = plan.patterns;
  info.shots = plan.shots;
  const int n = static_cast<int>(info.shots.size());
  DiskStorage storage;
  std::optional<SessionWriter> writer(require(SessionWriter::create(
      folder, info, bench.rig.text, capture::plan_to_json(plan), 0, storage)));
  (void)require(writer->log_event(EventKind::state, R"({"state": "running"})"));
  if (below(random, 2) == 0 || has_all) {  // resumed
    bench.commit_pending(*writer, 1 + below(random, n - 1));
    writer.reset();
    writer.emplace(require(SessionWriter::reopen(folder, storage)));
  }
  if (below(random, 3) == 0 || has_all) {
    bench.refuse(*writer, n - 1);
  }
  bench.commit_pending(*writer, n);
  if (below(random, 3) == 0 || has_all) {  // withdrawn while it ran
    const int shot = below(random, n);
    require(writer->withdraw(shot, "a hand"));
    bench.commit(*writer, shot);
  }
  require(writer->finish());
  writer.reset();
  const int later = below(random, 8);
  if (later == 0) {  // taken again when all was done
    writer.emplace(require(SessionWriter::reopen(folder, storage)));
    const int shot = below(random, n);
    require(writer->withdraw(shot, "taken again by request"));
    bench.commit(*writer, shot);
    require(writer->finish());
  } else if (later == 1) {
    (void)rebuild_session(folder, storage);
  }
}

void make_import(const fs::path& folder, Random& random) {
  const fs::path from = folder.string() + ".pictures";
  fs::create_directories(from);
  const int n = 2 + below(random, 4);
  const int channels = below(random, 2) == 0 ? 1 : 3;
  const char* ending = below(random, 2) == 0 ? "exr" : "png";
  std::string list = fmt::format("{}\n", n);
  const bool has_dark = below(random, 2) == 0;
  for (int k = 0; k < n + (has_dark ? 1 : 0); ++k) {
    Image<float> picture(7, 9, channels);
    for (float& value : picture.pixels()) {
      value = 0.01F + 1e-4F * static_cast<float>(below(random, 8000));
      value *= k < n ? 1.0F : 0.01F;  // a dark picture leaves the white patch its light
    }
    const std::string name =
        k < n ? fmt::format("l{}.{}", k, ending) : std::string("dark.") + ending;
    write_image(from / name, picture.view());
    if (k < n) {
      list += fmt::format("{} {} {} {}\n", name, 100.0 + 17.3 * k, -30.0 * k, 400.0 + 0.1 * k);
    }
  }
  write_file_atomically(from / "list.lp", list);
  ImportOptions options;
  options.coordinates = LightCoordinates::positions;
  if (has_dark) {
    options.match.dark = {std::string("dark.") + ending};
  }
  if (below(random, 2) == 0) {
    options.crop = PixelRectangle{2, 1, 6, 5};
  }
  if (channels == 3 && below(random, 2) == 0) {
    options.white = WhitePatch{{1, 1, 4, 4}, {}};
  }
  (void)import_pictures(from, from / "list.lp", folder, options);
  fs::remove_all(from);
}

int run(const std::vector<std::string>& words) {
  if (words.size() == 5 && words[0] == "make") {
    for (int i = 0; i < std::stoi(words[2]); ++i) {
      Random random(std::stoull(words[1]) + static_cast<std::uint64_t>(i));
      const fs::path folder = fs::path(words[3]) / std::to_string(i);
      i % 4 == 3 ? make_import(folder, random) : make_capture(folder, words[4], random, i == 0);
    }
    return 0;
  }
  if (words.size() >= 3 && words[0] == "verify") {
    for (std::size_t i = 2; i < words.size(); ++i) {
      nlohmann::ordered_json line = {{"folder", words[i]}};
      try {
        const VerifyReport report =
            verify_session(words[i], ProgressStyle::none, words[1] == "-" ? "" : words[1]);
        line["problems"] = report.problems;
        line["notes"] = report.notes;
      } catch (const Error& error) {
        line["problems"] = {std::string(error.what())};
      }
      std::cout << line.dump(-1, ' ', true, nlohmann::ordered_json::error_handler_t::replace)
                << '\n';
    }
    return 0;
  }
  if (words.size() == 2 && words[0] == "rebuild") {
    DiskStorage storage;
    return rebuild_session(words[1], storage).n_pending == 0 ? 0 : 1;
  }
  if (words.size() >= 2 && words[0] == "hash") {
    for (std::size_t k = 1; k < words.size(); ++k) {
      std::cout << content_hash(read_file(words[k])) << '\n';
    }
    return 0;
  }
  std::cerr << "session_tool make | verify | rebuild | hash: see its source\n";
  return 2;
}

}  // namespace
}  // namespace haarlight::session

int main(int argc, char** argv) {
  try {
    return haarlight::session::run({argv + 1, argv + argc});
  } catch (const std::exception& error) {
    std::cerr << error.what() << '\n';
    return 1;
  }
}
