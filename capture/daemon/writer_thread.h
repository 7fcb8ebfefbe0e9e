// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "capture/daemon/camera_thread.h"
#include "capture/daemon/work_queue.h"
#include "capture/sequencer/sequencer.h"
#include "core/thread_pulse.h"
#include "haarlight/capture/plan/plan.h"
#include "session/session_writer.h"

/// @file
/// The one thread that writes to the disk: creates and reopens sessions, commits frames in
/// groups (all waiting frames go into one journal transaction), keeps the journal's event log.

namespace haarlight::capture {

/// What to capture, and where.
struct SessionOrder {
  std::filesystem::path folder;
  bool is_new = true;
  bool is_recovery = false;  ///< issued by the daemon itself, at startup
  std::string id;
  std::string rig_toml;
  Plan plan;  ///< of a reopened session: filled in by the writer
};

/// A session opened for capture, as the control thread needs it.
struct OpenSession {
  std::string id;
  std::filesystem::path folder;
  std::shared_ptr<const Plan> plan;
  session::FrameForm form;  ///< as at the session's start
  std::vector<bool> committed;
  std::vector<int> next_attempt;
  /// Of the committed frames, where the plan requires frames to agree with each other
  /// (retake_wrong_light).
  std::vector<std::pair<int, session::FrameEvidence>> evidence;
  session::RecoveryReport recovery;
};

/// A frame that the pixel checks refused, for the session's aside/.
struct RefusedFrame {
  std::shared_ptr<const Frame> frame;  ///< held until it is written
  int shot = 0;
  int attempt = 0;
  session::FrameEvidence evidence;
  std::string problem;
};

/// A line of the journal's event log, durable now or with the next commit.
struct JournalLine {
  std::string session;
  std::int64_t row = 0;  ///< 0: no session was open, the line is not in a journal
  session::EventKind kind = session::EventKind::state;
  std::string json;
};

struct WriterThreadConfig {
  Rig rig;
  session::Storage* storage = nullptr;
  std::function<void(EventBody)> send;
  /// A session is open (for a Run), or failed to open.
  std::function<void(Result<OpenSession>)> opened;
  std::function<void(const JournalLine&)> logged;
  Clock* clock = &real_clock();
};

class WriterThread {
 public:
  WriterThread(WriterThreadConfig config, FrameStore& store);
  ~WriterThread();
  WriterThread(const WriterThread&) = delete;
  WriterThread& operator=(const WriterThread&) = delete;

  /// Closes what is open and opens this; answered by `opened`.
  void open(SessionOrder order);
  void post(const action::CommitFrame& commit);
  /// The shot is meanwhile retaken. A full or stuck disk loses the frame, which is logged.
  void keep_refused(RefusedFrame refused);
  void post(const action::RetryCommits& retry);
  void post(const action::ForgetCommits& forget);
  void post(const action::WithdrawShots& withdraw);
  void post(const action::MarkAborted& mark);
  void post(const action::FinishSession& finish);
  /// Dropped (and counted) when the disk is too slow for best-effort log lines.
  void post(const action::LogEvent& line);

  [[nodiscard]] const ThreadPulse& pulse() const { return pulse_; }
  [[nodiscard]] std::uint64_t n_lines_dropped() const { return n_lines_dropped_; }

 private:
  using Work = std::variant<SessionOrder, action::CommitFrame, action::RetryCommits,
                            action::ForgetCommits, action::WithdrawShots, action::MarkAborted,
                            action::FinishSession, action::LogEvent, RefusedFrame>;

  void run(const std::stop_token& stop);
  void enqueue(Work work);
  void do_work(Work work);
  void open_session(SessionOrder order);
  [[nodiscard]] Result<OpenSession> make_or_reopen(SessionOrder order);
  void retry();
  void write_refused(const RefusedFrame& refused);
  void withdraw_waiting();
  void commit_waiting();
  void commit_one_by_one();
  void finish();
  void mark_aborted(const std::string& why);
  void get_stuck(const Fault& fault);
  /// Reports what could not be written, and that the folder is gone, when it is.
  void report(const Fault& fault);
  [[nodiscard]] bool is_folder_gone() const;
  void log(session::EventKind kind, const std::string& json);
  [[nodiscard]] session::SessionInfo new_session_info(const SessionOrder& order) const;

  WriterThreadConfig config_;
  FrameStore& store_;
  WorkQueue<Work> work_{1024, *config_.clock};
  ThreadPulse pulse_{"writer", *config_.clock};
  std::atomic<std::uint64_t> n_lines_dropped_{0};
  // Used by this thread only.
  std::optional<session::SessionWriter> writer_;
  std::filesystem::path folder_;
  std::string id_;
  std::vector<int> withdrawals_;  ///< shots; go before the commits that replace them
  std::vector<action::CommitFrame> waiting_;
  bool is_stuck_ = false;  ///< the disk failed: wait for RetryCommits
  std::jthread thread_;    // last member: stops first
};

/// In a session's folder: it was aborted by the operator, or for a permanent reason.
inline constexpr const char* kAbortMark = "aborted.txt";

/// The session's lights, grid and form as given by a rig.
[[nodiscard]] session::SessionInfo session_info_of(const Rig& rig, const Plan& plan,
                                                   const std::string& id);

}  // namespace haarlight::capture
