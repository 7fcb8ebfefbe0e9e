// SPDX-License-Identifier: Apache-2.0
#include "capture/sequencer/model_rig.h"

#include <algorithm>
#include <array>
#include <cmath>

#include <fmt/format.h>

#include "core/random.h"
#include "session/clean_rule.h"

namespace haarlight::capture {

namespace {

constexpr std::int64_t kUs = 1000;
constexpr std::int64_t kMs = 1'000'000;
constexpr std::uint64_t kMaxEvents = 2'000'000;
constexpr std::int64_t kAbortPromiseNs = 200 * kMs;

double draw(std::uint64_t seed, std::uint64_t i) { return uniform_unit(hash_key(seed, i)); }

}  // namespace

ModelRigConfig random_model_rig(std::uint64_t seed) {
  std::uint64_t i = 1000;
  const auto u = [&] { return draw(seed, ++i); };
  // A third of the faults is absent from each rig, so that their combinations differ.
  const auto p = [&](double most) { return u() < 0.33 ? 0.0 : most * u(); };
  ModelRigConfig rig;
  rig.seed = seed;
  constexpr std::array<double, 4> kFps{30.0, 60.0, 120.0, 240.0};
  rig.fps = kFps[static_cast<std::size_t>(u() * 4.0)];
  const double frame_us = 1e6 / rig.fps;
  rig.skew_us = u() < 0.5 ? 0.0 : 0.4 * frame_us * u();
  rig.read_us = frame_us * (0.05 + 0.5 * u());
  rig.timestamp = static_cast<TimestampMeaning>(static_cast<int>(u() * 3.0));
  rig.latch_us = 500.0 * u();
  rig.rise_us = 300.0 * u();
  rig.bus_us = 100.0 + 20000.0 * u() * u();
  rig.commit_us = 200.0 + 60000.0 * u() * u();
  rig.timestamp_jitter_us = 40.0 * u();
  rig.n_buffers = 3 + static_cast<int>(u() * 8.0);
  set_sync_mode(rig, static_cast<SyncMode>(static_cast<int>(u() * 4.0)));
  rig.faults = {.frame_late = p(0.1),
                .frame_dropped = p(0.1),
                .frame_repeated = p(0.1),
                .frame_stale = p(0.1),
                .frame_swapped = p(0.1),
                .frame_damaged = p(0.1),
                .light_timeout = p(0.1),
                .light_wrong_echo = p(0.05),
                .strobe_lost = p(0.05),
                .strobe_false = p(0.05),
                .entry_wrong = p(0.1),
                .poll_slow = p(0.02),
                .trigger_lost = p(0.1),
                .check_failed = p(0.1),
                .commit_full = p(0.1),
                .controller_reboot_rate = p(1.0),
                .interlock_rate = p(0.4),
                .lease_lost_rate = p(1.0),
                .camera_gone_rate = p(0.7),
                .pause_rate = p(0.7),
                .safe_off_rate = p(0.4),
                .abort_rate = p(0.4),
                .reshoot_rate = p(0.7)};
  rig.warming_c_per_s = 20.0 * u() - 10.0;
  return rig;
}

void set_sync_mode(ModelRigConfig& rig, SyncMode sync) {
  std::uint64_t i = 3000;
  const auto u = [&] { return draw(rig.seed, ++i); };
  rig.sync = sync;
  if (sync == SyncMode::camera_leads) {
    // The step counter is read a few times per frame.
    rig.bus_us = std::min(rig.bus_us, 0.2e6 / rig.fps);
    rig.strobe_every = 1 + static_cast<int>(u() * u() * 3.0);
    rig.skew_us *= 0.5;
    rig.table_depth = u() < 0.5 ? 1024 : 1 + static_cast<int>(u() * 8.0);
    rig.n_buffers += 3;
  } else {
    rig.strobe_every = 1;
  }
  rig.trigger_us = rig.latch_us + rig.rise_us + 0.85 * rig.bus_us + 200.0;
}

std::shared_ptr<const SequencerPlan> random_model_plan(const ModelRigConfig& rig,
                                                       int max_shots) {
  std::uint64_t i = 2000;
  const auto u = [&] { return draw(rig.seed, ++i); };
  auto plan = std::make_shared<SequencerPlan>();
  const double frame_us = 1e6 / rig.fps;
  const int n = 1 + static_cast<int>(u() * max_shots);
  const double settle_us = rig.latch_us + rig.rise_us + 100.0;
  // Camera leads: E + skew + settle fits into the frames of a step, with a margin for the
  // timestamps.
  const double room_us = 0.95 * rig.strobe_every * frame_us - rig.skew_us - settle_us - 200.0;
  const double most_us = rig.sync == SyncMode::camera_leads
                             ? std::clamp(room_us, 0.05 * frame_us, 0.9 * frame_us)
                             : 0.55 * frame_us;
  const auto exposure = [&] { return 0.05 * frame_us + (most_us - 0.05 * frame_us) * u(); };
  const double e1 = exposure();
  const double e2 = u() < 0.5 ? e1 : exposure();
  for (int k = 0; k < n; ++k) {
    plan->shots.push_back({.tag = kFirstTag + static_cast<std::uint32_t>(k),
                           .exposure_us = k < n / 2 ? e1 : e2,
                           .pattern_id = k});
  }
  plan->timestamp = rig.timestamp;
  plan->read_us = rig.read_us;
  plan->skew_us = rig.skew_us;
  plan->frame_us = frame_us;
  plan->settle_ns = static_cast<std::int64_t>(settle_us * 1e3);
  plan->sync = rig.sync;
  plan->trigger_delay_ns = static_cast<std::int64_t>(rig.trigger_us * 1e3);
  plan->strobe_every = rig.strobe_every;
  plan->max_held = 1 + static_cast<int>(u() * 6.0);
  plan->darks_every_c = u() < 0.5 ? 0.0 : 0.2 + 2.0 * u();
  for (SequencedShot& shot : plan->shots) {
    shot.is_dark = u() < 0.3;
  }
  return plan;
}

ModelRig::ModelRig(ModelRigConfig config, std::shared_ptr<const SequencerPlan> plan)
    : config_(config), plan_(std::move(plan)) {
  light_.push_back({0, 0, true});
  commit_counts_.resize(plan_->shots.size());
}

ModelRig::~ModelRig() = default;

double ModelRig::chance() { return draw(config_.seed, hash_key(7, ++draws_)); }
std::int64_t ModelRig::some_ns(double most_us) {
  return static_cast<std::int64_t>(1e3 * most_us * (0.05 + 0.95 * chance()));
}

void ModelRig::at(std::int64_t t_ns, std::function<void()> work) {
  queue_.push(Pending{std::max(t_ns, now_ns_), ++order_, std::move(work)});
}

void ModelRig::fail(const std::string& problem) {
  if (outcome_.problem.empty()) {
    outcome_.problem =
        fmt::format("at {:.6f} s: {}", static_cast<double>(now_ns_) * 1e-9, problem);
  }
}

void ModelRig::send(EventBody body) {
  ++n_events_;
  StepResult result = step(std::move(state_), TimedEvent{now_ns_, std::move(body)});
  state_ = std::move(result.state);
  for (const Action& action : result.actions) {
    perform(action);
  }
  if (state_.deadline_ns != kNever && state_.deadline_ns != tick_ns_) {
    tick_ns_ = state_.deadline_ns;
    at(tick_ns_, [this, t = tick_ns_] {
      if (t == tick_ns_) {
        tick_ns_ = kNever;
        send(event::Tick{});
      }
    });
  }
}

void ModelRig::perform(const Action& action) {
  if (const auto* connect = std::get_if<action::ConnectLight>(&action)) {
    queue_job([this, job = connect->job] {
      at(now_ns_ + some_ns(config_.bus_us), [this, job] {
        if (now_ns_ < bus_back_ns_) {
          end_job(event::LightFault{job, Errc::device_gone, "no route to the controller"});
          return;
        }
        is_connected_ = true;
        disarm();
        change_light(0, 0);
        end_job(event::LightConnected{job, boot_id_, config_.table_depth});
      });
    });
  } else if (const auto* show_shot = std::get_if<action::ShowShot>(&action)) {
    queue_job([this, a = *show_shot] { light_job(a.job, a.tag, a.confirm); });
  } else if (const auto* table = std::get_if<action::UploadTable>(&action)) {
    queue_job([this, a = *table] { upload(a); });
  } else if (const auto* block = std::get_if<action::ArmBlock>(&action)) {
    queue_job([this, a = *block] { arm(a); });
  } else if (const auto* more = std::get_if<action::ExtendBlock>(&action)) {
    at(now_ns_ + some_ns(config_.bus_us), [this, n = static_cast<std::uint32_t>(more->count)] {
      if (is_connected_ && n_armed_ > 0 && step_counter_ <= n_armed_) {
        n_armed_ = std::max(n_armed_, n);
      }
    });
  } else if (std::get_if<action::TriggerCamera>(&action) != nullptr) {
    at(now_ns_ + some_ns(500.0), [this] { trigger(); });
  } else if (const auto* off = std::get_if<action::LightsOff>(&action)) {
    queue_job([this, a = *off] { light_job(a.job, 0, a.confirm); });
  } else if (const auto* start = std::get_if<action::StartCamera>(&action)) {
    ++generation_;
    is_streaming_ = false;
    after_camera(some_ns(20000.0), [this, a = *start, g = generation_] {
      start_camera(g, a.stream, a.exposure_us);
    });
  } else if (std::get_if<action::StopCamera>(&action) != nullptr) {
    ++generation_;
    is_streaming_ = false;
  } else if (const auto* set = std::get_if<action::SetExposure>(&action)) {
    after_camera(some_ns(2000.0), [this, a = *set, g = generation_] {
      if (g != generation_) {  // stopped since: this is now obsolete, and so is its answer
        send(event::ExposureSet{a.request, a.exposure_us});
      } else if (is_streaming_) {
        next_exposure_us_ = a.exposure_us;
        exposure_delay_ = 1 + static_cast<int>(chance() * 2.0);
        send(event::ExposureSet{a.request, a.exposure_us});
      }
    });
  } else if (const auto* drop = std::get_if<action::DropFrame>(&action)) {
    if (frames_.erase(drop->frame) == 0) {
      fail("a frame was dropped twice");
    }
  } else if (const auto* check = std::get_if<action::CheckFrame>(&action)) {
    at(now_ns_ + some_ns(500.0), [this, c = *check] {
      const bool is_bad = happens(config_.faults.check_failed);
      send(event::FrameChecked{c.frame, c.shot, c.evidence, is_bad ? "saturated" : ""});
    });
  } else if (const auto* commit = std::get_if<action::CommitFrame>(&action)) {
    commits_.push_back(*commit);
    commit_next();
  } else if (std::get_if<action::RetryCommits>(&action) != nullptr) {
    if (commits_.empty() && !is_committing_) {
      answer_of_disk();
    }
    commit_next();
  } else if (std::get_if<action::ForgetCommits>(&action) != nullptr) {
    commits_.clear();
  } else if (const auto* withdraw = std::get_if<action::WithdrawShots>(&action)) {
    for (const int shot : withdraw->shots) {
      is_committed_[static_cast<std::size_t>(shot)] = false;
    }
    if (now_ns_ < disk_back_ns_) {
      answer_of_disk();
    }
  } else if (std::get_if<action::FinishSession>(&action) != nullptr) {
    at(now_ns_ + some_ns(5000.0), [this] {
      if (now_ns_ < disk_back_ns_ || (finish_ && !finish_())) {
        send(event::CommitFault{Errc::no_space, "session.json: no space left"});
      } else {
        send(event::SessionFinished{});
      }
    });
  } else if (const auto* line = std::get_if<action::LogEvent>(&action)) {
    log_.push_back(fmt::format("{:.6f} {} {} {}", static_cast<double>(now_ns_) * 1e-9,
                               to_string(line->kind), line->shot, line->text));
    if (log_.size() > 60) {
      log_.pop_front();
    }
  }
}

// ---- camera ----

void ModelRig::after_camera(std::int64_t takes_ns, std::function<void()> work) {
  camera_idle_ns_ = std::max(now_ns_, camera_idle_ns_) + takes_ns;
  at(camera_idle_ns_, std::move(work));
}

void ModelRig::start_camera(std::uint64_t generation, std::uint64_t stream,
                            double exposure_us) {
  if (now_ns_ < camera_back_ns_) {
    send(event::CameraFault{stream, Errc::device_gone, "no such device"});
    return;
  }
  if (generation != generation_) {  // stopped since: it answers, but delivers nothing
    send(event::CameraStarted{stream, exposure_us, config_.n_buffers});
    return;
  }
  stream_ = stream;
  is_streaming_ = true;
  exposure_us_ = next_exposure_us_ = exposure_us;
  exposure_delay_ = 0;
  sequence_ = 0;
  delivered_.clear();
  swapped_.reset();
  send(event::CameraStarted{stream, exposure_us, config_.n_buffers});
  camera_free_ns_ = 0;
  lost_frame_ = false_frame_ = 0;
  const bool is_free =
      config_.sync == SyncMode::free_run || config_.sync == SyncMode::camera_leads;
  if (is_free) {
    at(now_ns_ + some_ns(10'000.0), [this, g = generation_] { expose(g); });
  }
}

/// Exposes one frame, unless the camera is still busy with the previous one.
void ModelRig::trigger() {
  if (!is_streaming_ || now_ns_ < camera_free_ns_ || happens(config_.faults.trigger_lost)) {
    return;
  }
  expose_frame(generation_);
  const double busy_us = exposure_us_ + std::max(config_.read_us, config_.skew_us) + 50.0;
  camera_free_ns_ = now_ns_ + static_cast<std::int64_t>(busy_us * 1e3);
}

/// The free-running sensor, which never stops.
void ModelRig::expose(std::uint64_t generation) {
  if (generation != generation_ || !is_streaming_) {
    return;
  }
  const auto frame_ns =
      static_cast<std::int64_t>(1e9 / config_.fps * (1.0 + 1e-6 * config_.camera_ppm));
  at(now_ns_ + frame_ns, [this, generation] { expose(generation); });
  expose_frame(generation);
}

std::int64_t ModelRig::timestamp_jitter_ns() {
  std::int64_t jitter_ns = some_ns(config_.timestamp_jitter_us);
  if (config_.timestamp_sigma_us > 0.0) {
    const double z = standard_normal(hash_key(config_.seed, 17, ++draws_));
    jitter_ns += static_cast<std::int64_t>(1e3 * config_.timestamp_sigma_us * z);
  }
  return jitter_ns;
}

std::int64_t ModelRig::timestamp_error_ns() {
  const double late = config_.faults.timestamp_late;
  const double early = config_.faults.timestamp_early;
  const double u = late + early > 0.0 ? chance() : 1.0;
  if (u >= late + early) {
    return 0;
  }
  const auto lie_ns = static_cast<std::int64_t>(1e6 * (0.1 + 1.8 * chance()));
  return u < late ? lie_ns : -lie_ns;
}

/// A frame's exposure begins now; it is delivered after its readout.
void ModelRig::expose_frame(std::uint64_t generation) {
  if (exposure_delay_ > 0 && --exposure_delay_ == 0) {
    exposure_us_ = next_exposure_us_;
  }
  const std::uint64_t sequence = sequence_++;
  const std::int64_t start_ns = now_ns_;
  const double exposure_us = exposure_us_;
  // In whole ns as in exposure_window(): a frame delivered at its very end arrived after it.
  const std::int64_t exposure_ns = std::llround(exposure_us * 1e3);
  const std::int64_t end_ns = start_ns + exposure_ns + std::llround(config_.skew_us * 1e3);
  const std::int64_t read_ns = start_ns + exposure_ns + std::llround(config_.read_us * 1e3);
  schedule_strobes(sequence, end_ns);
  // The timestamp is taken before the frame is delivered.
  const std::int64_t jitter_ns = timestamp_jitter_ns();
  at(std::max(end_ns, read_ns) + std::max<std::int64_t>(jitter_ns, 0), [=, this] {
    if (generation != generation_ || !is_streaming_) {
      return;
    }
    ModelFrame frame;
    frame.start_ns = start_ns;
    frame.truth = truth_between(start_ns, end_ns);
    const bool is_next =
        !frame.truth.is_mixed && frame.truth.tag == clean_tag_ && clean_latch_ == n_latches_;
    n_clean_ = is_next ? n_clean_ + 1 : 0;
    clean_tag_ = frame.truth.tag;
    clean_latch_ = n_latches_;
    frame.n_clean = n_clean_;
    const std::int64_t lie_ns = timestamp_error_ns();
    frame.is_timestamp_false = lie_ns != 0;
    const std::int64_t timestamp_ns =
        config_.timestamp == TimestampMeaning::start_exposure  ? start_ns
        : config_.timestamp == TimestampMeaning::start_readout ? start_ns + exposure_ns
                                                               : read_ns;
    frame.info = {.sequence = sequence,
                  .timestamp_ns = timestamp_ns + jitter_ns + lie_ns,
                  .flags = kFrameMonotonic,
                  .exposure_us = exposure_us,
                  .gain_db = 0.0};
    frame.pixel_hash = hash_key(config_.seed, generation, sequence, 99);
    const ModelFaults& faults = config_.faults;
    if (happens(faults.frame_dropped)) {
      return;
    }
    if (happens(faults.frame_damaged)) {
      frame.info.flags |= kFrameError;
    }
    if (!delivered_.empty() && happens(faults.frame_stale)) {
      const auto i =
          static_cast<std::size_t>(chance() * static_cast<double>(delivered_.size()));
      frame.start_ns = delivered_[i].start_ns;
      frame.truth = delivered_[i].truth;
      frame.pixel_hash = delivered_[i].pixel_hash;
    }
    if (swapped_) {
      const ModelFrame earlier = *swapped_;
      swapped_.reset();
      deliver(frame);
      deliver(earlier);
      return;
    }
    if (happens(faults.frame_swapped)) {
      swapped_ = frame;
      return;
    }
    const std::int64_t late_ns =
        happens(faults.frame_late) ? some_ns(3e6 / config_.fps) : 10 * kUs;
    at(now_ns_ + late_ns, [this, frame, generation] {
      if (generation == generation_ && is_streaming_) {
        deliver(frame);
        if (happens(config_.faults.frame_repeated)) {
          deliver(frame);
        }
      }
    });
  });
}

void ModelRig::deliver(const ModelFrame& frame) {
  if (static_cast<int>(frames_.size()) >= config_.n_buffers) {
    return;  // no free buffer: the driver loses the frame
  }
  delivered_.push_back(frame);
  if (delivered_.size() > static_cast<std::size_t>(config_.n_buffers)) {
    delivered_.pop_front();
  }
  const std::uint64_t id = next_frame_++;
  frames_.emplace(id, frame);
  const SequencerCounters before = state_.counters;
  const std::int64_t trigger_ns =
      config_.sync == SyncMode::light_leads
          ? (state_.trigger_ns == kNever ? state_.triggered_ns : kNever)
          : state_.receipt.t_command_ns + static_cast<std::int64_t>(config_.trigger_us * 1e3);
  const bool is_shots_own =
      state_.current >= 0 &&
      (state_.step == ShotStep::settle || state_.step == ShotStep::collect) &&
      frame.start_ns >= trigger_ns && !frame.truth.is_mixed &&
      frame.truth.tag == plan_->shots[static_cast<std::size_t>(state_.current)].tag;
  FrameInfo info = frame.info;
  info.arrival_ns = now_ns_;
  send(event::FrameArrived{id, stream_, info, frame.pixel_hash, true});
  outcome_.n_false += frame.is_timestamp_false ? 1 : 0;
  // Triggered: from the shot's own trigger and light, with nothing else against it, and
  // refused.
  const SequencerCounters& after = state_.counters;
  const auto n_faulty = [](const SequencerCounters& c) {
    return c.frames_damaged + c.frames_out_of_order + c.timestamps_ahead + c.duplicates +
           c.wrong_exposure;
  };
  const bool is_triggered =
      config_.sync == SyncMode::light_leads || config_.sync == SyncMode::controller_leads;
  const bool is_refused = is_triggered && is_shots_own && n_faulty(after) == n_faulty(before) &&
                          after.frames_unused > before.frames_unused;
  const bool is_suspected = is_refused || after.off_rhythm > before.off_rhythm;
  outcome_.n_suspected += !frame.is_timestamp_false && is_suspected ? 1 : 0;
}

// ---- disk ----

/// Answers a withdrawal, which needs the disk like a commit. The writer is one thread: it never
/// reports that all is good after a later commit has failed.
void ModelRig::answer_of_disk() {
  const bool is_full = now_ns_ < disk_back_ns_;
  at(now_ns_ + some_ns(1000.0), [this, is_full] {
    if (is_full) {
      send(event::CommitFault{Errc::no_space, "withdrawal: no space left on device"});
    } else if (commits_.empty()) {
      send(event::DiskGood{});
    }
  });
}

void ModelRig::commit_next() {
  if (is_committing_ || commits_.empty()) {
    return;
  }
  is_committing_ = true;
  at(now_ns_ + some_ns(config_.commit_us), [this] {
    is_committing_ = false;
    if (commits_.empty()) {
      return;
    }
    if (now_ns_ >= disk_back_ns_ && happens(config_.faults.commit_full)) {
      disk_back_ns_ = now_ns_ + some_ns(2'000'000.0);
    }
    const action::CommitFrame& commit = commits_.front();
    const auto it = frames_.find(commit.frame);
    if (it == frames_.end()) {
      fail(fmt::format("shot {}: its buffer was given back before the commit", commit.shot));
      return;
    }
    if (now_ns_ < disk_back_ns_ || (commit_ && !commit_(commit, it->second))) {
      send(event::CommitFault{Errc::no_space, "no space left on device"});
      return;
    }
    const ModelFrame& frame = it->second;
    const std::uint32_t tag = plan_->shots[static_cast<std::size_t>(commit.shot)].tag;
    const bool is_wrong = frame.truth.is_mixed || frame.truth.tag != tag;
    outcome_.n_wrong += is_wrong ? 1 : 0;
    if (is_wrong && !config_.counts_wrong) {
      fail(fmt::format(
          "shot {} committed a frame that saw tag {}{}, not {}; evidence: start {} end "
          "{} stable {} next {}",
          commit.shot, frame.truth.tag, frame.truth.is_mixed ? " mixed" : "", tag,
          commit.evidence.t_exposure_start_ns, commit.evidence.t_exposure_end_ns,
          commit.evidence.t_stable_ns, commit.evidence.t_next_change_ns));
    }
    session::FrameEvidence evidence = commit.evidence;
    evidence.pixel_hash = "of no pixels";
    if (const std::string why = session::find_evidence_problem(evidence); !why.empty()) {
      fail(fmt::format("shot {} committed with evidence that does not hold: {}", commit.shot,
                       why));
    }
    const double requested_us = plan_->shots[static_cast<std::size_t>(commit.shot)].exposure_us;
    if (std::abs(frame.info.exposure_us - requested_us) > 0.006 * requested_us) {
      fail(fmt::format("shot {} committed a frame of another exposure", commit.shot));
    }
    const auto i = static_cast<std::size_t>(commit.shot);
    ++commit_counts_[i];
    ++outcome_.n_commits;
    is_committed_[i] = true;
    attempts_[i] = std::max(attempts_[i], commit.attempt + 1);
    const event::FrameCommitted done{commit.frame, commit.shot};
    commits_.pop_front();
    send(done);
    commit_next();
  });
}

// ---- the world ----

void ModelRig::every(double rate, const std::function<void()>& work) {
  if (rate <= 0.0) {
    return;
  }
  const auto wait_ns = static_cast<std::int64_t>(-1e9 * std::log(1.0 - chance()) / rate);
  at(now_ns_ + wait_ns, [this, rate, work] {
    work();
    every(rate, work);
  });
}

void ModelRig::schedule_rates() {
  const ModelFaults& faults = config_.faults;
  every(faults.controller_reboot_rate, [this] { reboot(); });
  every(faults.interlock_rate, [this] {
    interlock_closes_ns_ = now_ns_ + some_ns(1'500'000.0);
    darken_by_itself();
  });
  every(faults.lease_lost_rate, [this] { darken_by_itself(); });
  every(faults.camera_gone_rate, [this] {
    if (is_streaming_) {
      is_streaming_ = false;
      camera_back_ns_ = now_ns_ + some_ns(500'000.0);
      send(event::CameraFault{stream_, Errc::device_gone, "unplugged"});
    }
  });
  every(faults.pause_rate, [this] {
    send(event::Pause{});
    at(now_ns_ + some_ns(300'000.0), [this] { send(event::Resume{}); });
  });
  every(faults.safe_off_rate, [this] {
    send(event::SafeOff{});
    at(now_ns_ + some_ns(300'000.0), [this] { send(event::Resume{}); });
  });
  every(faults.abort_rate, [this] {
    send(event::Abort{});
    if (state_.phase == Phase::aborting) {
      abort_ns_ = now_ns_;
    }
  });
  every(faults.reshoot_rate, [this] {
    if (outcome_.n_commits > 3 * static_cast<int>(plan_->shots.size())) {
      return;  // the operator gives up
    }
    const int shot = static_cast<int>(chance() * static_cast<double>(plan_->shots.size()));
    send(event::Reshoot{{shot}});
  });
}

ModelOutcome ModelRig::run(std::vector<bool> committed, std::vector<int> next_attempt,
                           double limit_s) {
  is_committed_ = std::move(committed);
  attempts_ = std::move(next_attempt);
  const std::int64_t begin_ns = now_ns_;
  const auto limit_ns = begin_ns + static_cast<std::int64_t>(limit_s * 1e9);
  send(event::Booted{});
  send(event::Recovered{});
  schedule_rates();
  send(event::Run{plan_, is_committed_, attempts_});
  while (outcome_.problem.empty() && state_.phase != Phase::done) {
    if (state_.phase == Phase::idle) {
      abort_ns_ = kNever;
      commits_.clear();
      send(event::Run{plan_, is_committed_, attempts_});  // the operator starts it again
      continue;
    }
    if (abort_ns_ != kNever && now_ns_ > abort_ns_ + kAbortPromiseNs) {
      fail("an abort took more than 200 ms");
    }
    if (now_ns_ > limit_ns || n_events_ > kMaxEvents || queue_.empty()) {
      fail(fmt::format("stuck in {} ({}), {} of {} committed", to_string(state_.phase),
                       reasons_text(state_.reasons), state_.n_committed, state_.shots.size()));
      break;
    }
    Pending next = queue_.top();
    queue_.pop();
    now_ns_ = next.t_ns;
    next.work();
  }
  outcome_.is_done = state_.phase == Phase::done;
  outcome_.seconds = static_cast<double>(now_ns_ - begin_ns) * 1e-9;
  outcome_.n_events = n_events_;
  outcome_.counters = state_.counters;
  if (outcome_.is_done) {
    if (!frames_.empty()) {
      fail(fmt::format("{} buffers were never given back", frames_.size()));
    }
    if (std::find(is_committed_.begin(), is_committed_.end(), false) != is_committed_.end()) {
      fail("done, but a shot has no frame");
    }
  }
  return outcome_;
}

}  // namespace haarlight::capture
