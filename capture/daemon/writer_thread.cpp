// SPDX-License-Identifier: Apache-2.0
#include "capture/daemon/writer_thread.h"

#include <algorithm>
#include <array>
#include <cstdlib>
#include <ctime>
#include <span>
#include <utility>

#include <fmt/format.h>

#include "capture/plan/timing.h"
#include "core/log.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "http/json_text.h"
#include "session/rig_session.h"

namespace haarlight::capture {

namespace {

constexpr std::size_t kQueue = 1024;
constexpr std::size_t kBestEffortLimit =
    kQueue / 2;  // best-effort log lines may use no more of it

std::string iso_now() {
  const std::time_t now = std::time(nullptr);
  std::tm parts{};
  ::gmtime_r(&now, &parts);
  std::array<char, 32> text{};
  (void)std::strftime(text.data(), text.size(), "%Y-%m-%dT%H:%M:%SZ", &parts);
  return text.data();
}

std::string line_json(const action::LogEvent& line) {
  return line.shot >= 0 ? fmt::format(R"({{"text": {}, "shot": {}}})",
                                      http::json_quote(line.text), line.shot)
                        : fmt::format(R"({{"text": {}}})", http::json_quote(line.text));
}

}  // namespace

session::SessionInfo session_info_of(const Rig& rig, const Plan& plan, const std::string& id) {
  session::SessionInfo info;
  info.id = id;
  info.created = iso_now();
  info.plan_hash = plan.hash;
  info.rig_hash = rig.hash;
  session::describe_rig(rig, info);
  info.patterns = plan.patterns;
  info.shots = plan.shots;
  return info;
}

WriterThread::WriterThread(WriterThreadConfig config, FrameStore& store)
    : config_(std::move(config)),
      store_(store),
      thread_(config_.clock->start([this](const std::stop_token& stop) { run(stop); })) {}

WriterThread::~WriterThread() { config_.clock->stop(thread_); }

void WriterThread::enqueue(Work work) {
  if (!work_.try_push(std::move(work))) {
    // Far larger than the camera's buffer count: a frame's commit would be lost.
    log_error("our own bug: the writer's queue is full");
    std::abort();
  }
}

void WriterThread::open(SessionOrder order) { enqueue(std::move(order)); }
void WriterThread::post(const action::CommitFrame& commit) { enqueue(commit); }
void WriterThread::keep_refused(RefusedFrame refused) {
  if (!work_.try_push(std::move(refused), kQueue - kBestEffortLimit)) {
    log_warning("a refused attempt is not kept: the disk is too slow");
  }
}
void WriterThread::post(const action::RetryCommits& retry) { enqueue(retry); }
void WriterThread::post(const action::ForgetCommits& forget) { enqueue(forget); }
void WriterThread::post(const action::WithdrawShots& withdraw) { enqueue(withdraw); }
void WriterThread::post(const action::MarkAborted& mark) { enqueue(mark); }
void WriterThread::post(const action::FinishSession& finish) { enqueue(finish); }
void WriterThread::post(const action::LogEvent& line) {
  if (!work_.try_push(line, kQueue - kBestEffortLimit)) {
    ++n_lines_dropped_;
  }
}

void WriterThread::run(const std::stop_token& stop) {
  for (;;) {
    // With commits waiting: collect whatever else is there, then commit all of it together.
    const bool has_commits = !waiting_.empty() && !is_stuck_;
    const auto wait = std::chrono::milliseconds(has_commits ? 0 : 250);
    std::optional<Work> work = work_.pop(config_.clock->now() + wait, stop);
    const ThreadPulse::Busy busy(pulse_);
    if (work) {
      do_work(*std::move(work));
    } else if (has_commits) {
      commit_waiting();
    } else if (stop.stop_requested()) {
      return;
    }
  }
}

void WriterThread::do_work(Work work) {
  if (auto* order = std::get_if<SessionOrder>(&work)) {
    open_session(std::move(*order));
  } else if (auto* commit = std::get_if<action::CommitFrame>(&work)) {
    waiting_.push_back(std::move(*commit));
  } else if (std::get_if<action::RetryCommits>(&work) != nullptr) {
    retry();
  } else if (std::get_if<action::ForgetCommits>(&work) != nullptr) {
    waiting_.clear();
    is_stuck_ = false;
  } else if (const auto* withdraw = std::get_if<action::WithdrawShots>(&work)) {
    withdrawals_.insert(withdrawals_.end(), withdraw->shots.begin(), withdraw->shots.end());
    withdraw_waiting();
  } else if (const auto* mark = std::get_if<action::MarkAborted>(&work)) {
    mark_aborted(mark->why);
  } else if (std::get_if<action::FinishSession>(&work) != nullptr) {
    finish();
  } else if (const auto* refused = std::get_if<RefusedFrame>(&work)) {
    write_refused(*refused);
  } else if (const auto* line = std::get_if<action::LogEvent>(&work)) {
    log(line->kind, line_json(*line));
  }
}

void WriterThread::open_session(SessionOrder order) {
  waiting_.clear();
  withdrawals_.clear();
  is_stuck_ = false;
  writer_.reset();
  try {
    auto opened = make_or_reopen(std::move(order));
    if (opened) {
      id_ = opened->id;
      folder_ = opened->folder;
    } else {
      writer_.reset();  // the previous one stays open for reshoots
    }
    config_.opened(std::move(opened));
  } catch (const std::exception& error) {
    writer_.reset();
    config_.opened(fail(Errc::protocol, error.what()));
  }
}

Result<OpenSession> WriterThread::make_or_reopen(SessionOrder order) {
  if (order.is_new) {
    const CameraSpec& camera = config_.rig.cameras.front();
    const double frame_bytes =
        2.0 * camera.frame_width * camera.frame_height + kFrameOverheadBytes;
    const double reserve_bytes = frame_bytes * static_cast<double>(order.plan.shots.size()) +
                                 1e6 * (config_.rig.storage.reserve_mb + order.plan.reserve_mb);
    auto made = session::SessionWriter::create(
        order.folder, session_info_of(config_.rig, order.plan, order.id), order.rig_toml,
        plan_to_json(order.plan), static_cast<std::uint64_t>(reserve_bytes), *config_.storage);
    if (!made) {
      return tl::unexpected<Fault>(made.error());
    }
    writer_.emplace(*std::move(made));
  } else {
    auto reopened = session::SessionWriter::reopen(order.folder, *config_.storage);
    if (!reopened) {
      return tl::unexpected<Fault>(reopened.error());
    }
    writer_.emplace(*std::move(reopened));
    order.plan = plan_from_json(writer_->plan_json(), (order.folder / "plan.json").string());
    if (writer_->info().rig_hash != config_.rig.hash) {
      return fail(
          Errc::refused,
          fmt::format("session {} was begun with another rig file; start the daemon with "
                      "its rig.toml to go on",
                      order.id));
    }
  }
  OpenSession session;
  session.id = order.id;
  session.folder = order.folder;
  session.form = writer_->info().form;
  session.committed = writer_->committed();
  for (std::size_t i = 0; i < order.plan.shots.size(); ++i) {
    session.next_attempt.push_back(writer_->next_attempt(static_cast<int>(i)));
  }
  if (order.plan.limits.retake_wrong_light) {
    session.evidence = writer_->committed_evidence();
  }
  session.recovery = writer_->recovery();
  session.plan = std::make_shared<const Plan>(std::move(order.plan));
  return session;
}

bool WriterThread::is_folder_gone() const {
  const auto is_missing = [](const std::filesystem::path& path) {
    std::error_code error;
    return std::filesystem::status(path, error).type() == std::filesystem::file_type::not_found;
  };
  return !folder_.empty() &&
         (is_missing(folder_ / "start.json") || is_missing(folder_ / "frames"));
}

void WriterThread::report(const Fault& fault) {
  if (is_folder_gone()) {
    config_.send(event::CommitFault{
        Errc::device_gone,
        fmt::format("its folder {} was moved or deleted: put it back, or abort ({})",
                    folder_.string(), fault.what)});
  } else {
    config_.send(event::CommitFault{fault.code, fault.what});
  }
}

void WriterThread::get_stuck(const Fault& fault) {
  is_stuck_ = true;
  report(fault);
}

void WriterThread::retry() {
  is_stuck_ = false;
  withdraw_waiting();
  if (!is_stuck_) {
    commit_waiting();
  }
  if (!is_stuck_) {
    config_.send(event::DiskGood{});
  }
}

void WriterThread::commit_waiting() {
  if (waiting_.empty()) {
    return;
  }
  if (!writer_) {
    waiting_.clear();
    return;
  }
  std::vector<std::shared_ptr<const Frame>> frames;
  std::vector<session::PendingFrame> pending;
  std::vector<action::CommitFrame> kept;
  for (action::CommitFrame& commit : waiting_) {
    auto frame = store_.get(commit.frame);
    if (frame == nullptr) {
      continue;  // dropped by an abort
    }
    pending.push_back(session::PendingFrame{.shot = commit.shot,
                                            .attempt = commit.attempt,
                                            .evidence = commit.evidence,
                                            .pixels = frame->pixels()});
    frames.push_back(std::move(frame));
    kept.push_back(std::move(commit));
  }
  waiting_ = std::move(kept);
  if (waiting_.empty()) {
    return;
  }
  const auto done = writer_->commit(pending);
  if (done) {
    std::string shots;
    for (const action::CommitFrame& commit : waiting_) {
      shots += fmt::format("{}{}", shots.empty() ? "" : ", ", commit.shot);
    }
    log(session::EventKind::committed, fmt::format(R"({{"shots": [{}]}})", shots));
    for (const action::CommitFrame& commit : waiting_) {
      config_.send(event::FrameCommitted{commit.frame, commit.shot});
    }
    waiting_.clear();
    return;
  }
  if (done.error().code == Errc::refused || done.error().code == Errc::protocol) {
    commit_one_by_one();
    return;
  }
  get_stuck(done.error());
}

/// A frame of the group failed: find out which, and have its shot retaken.
void WriterThread::commit_one_by_one() {
  while (!waiting_.empty()) {
    const action::CommitFrame& commit = waiting_.front();
    const auto frame = store_.get(commit.frame);
    if (frame != nullptr) {
      const session::PendingFrame pending{.shot = commit.shot,
                                          .attempt = commit.attempt,
                                          .evidence = commit.evidence,
                                          .pixels = frame->pixels()};
      const auto done = writer_->commit(std::span(&pending, 1));
      if (done) {
        log(session::EventKind::committed, fmt::format(R"({{"shots": [{}]}})", commit.shot));
        config_.send(event::FrameCommitted{commit.frame, commit.shot});
      } else if (done.error().code == Errc::refused || done.error().code == Errc::protocol) {
        config_.send(
            event::FrameChecked{commit.frame, commit.shot, commit.evidence, done.error().what});
      } else {
        get_stuck(done.error());
        return;
      }
    }
    waiting_.erase(waiting_.begin());
  }
}

void WriterThread::finish() {
  if (!writer_) {
    return;
  }
  const auto done = writer_->finish();
  if (!done) {
    report(done.error());
    return;
  }
  std::error_code ignored;
  std::filesystem::remove(folder_ / kAbortMark, ignored);
  config_.logged(JournalLine{id_, 0, session::EventKind::finished,
                             fmt::format(R"({{"session": {}}})", http::json_quote(id_))});
  config_.send(event::SessionFinished{});
}

/// Never makes the capture wait: what cannot be written is logged and dropped.
void WriterThread::write_refused(const RefusedFrame& refused) {
  if (!writer_ || writer_->is_finished()) {
    return;
  }
  const auto done = is_stuck_
                        ? Result<void>(fail(Errc::no_space, "the disk does not answer"))
                        : writer_->keep_refused({refused.shot, refused.attempt,
                                                 refused.evidence, refused.frame->pixels()},
                                                refused.problem);
  if (!done) {
    log_warning(fmt::format("attempt {} of shot {} was refused ({}) and is not kept: {}",
                            refused.attempt, refused.shot, refused.problem, done.error().what));
  }
}

/// A finished session is reopened first. What a full disk refuses is retried.
void WriterThread::withdraw_waiting() {
  while (!withdrawals_.empty()) {
    if (!writer_ || writer_->is_finished()) {
      writer_.reset();
      auto reopened = session::SessionWriter::reopen(folder_, *config_.storage);
      if (!reopened) {
        get_stuck(reopened.error());
        return;
      }
      writer_.emplace(*std::move(reopened));
    }
    const auto done = writer_->withdraw(withdrawals_.front(), "taken again by request");
    if (!done) {
      get_stuck(done.error());
      return;
    }
    withdrawals_.erase(withdrawals_.begin());
  }
}

/// The existence of the mark counts, not its text.
void WriterThread::mark_aborted(const std::string& why) {
  std::error_code ignored;
  if (folder_.empty() || std::filesystem::exists(folder_ / "session.json", ignored)) {
    return;  // finished before the request arrived
  }
  const std::filesystem::path file = folder_ / kAbortMark;
  auto done = config_.storage->write(file, std::as_bytes(std::span(why)));
  if (done) {
    done = config_.storage->sync_file(file);
  }
  if (done) {
    done = config_.storage->sync_folder(folder_);
  }
  if (!done) {
    log_warning("the session's mark of being aborted is not safe: " + done.error().what);
  }
}

void WriterThread::log(session::EventKind kind, const std::string& json) {
  JournalLine line{id_, 0, kind, json};
  if (writer_) {
    const auto row = writer_->log_event(kind, json);
    line.row = row ? *row : 0;
  }
  config_.logged(line);
}

}  // namespace haarlight::capture
