// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <stdexcept>
#include <string>
#include <string_view>

#include <tl/expected.hpp>

/// @file
/// The three kinds of failure: the caller's bug (ContractViolation), bad input from outside
/// (Error), and a device fault that is an ordinary event (Fault in a Result<T>).

namespace haarlight {

/// Exit codes of every program; the table in docs/reference/exit-codes.md is the same list.
enum class ExitCode : int {
  done = 0,
  target_missed = 1,  ///< an error target was not met, or a check failed
  usage = 2,
  bad_input = 65,
  unavailable = 69,  ///< device or daemon not there
  internal = 70,     ///< our own bug
  io = 74,
  interrupted = 75,  ///< try again: the command resumes
};

/// Bad input or an unusable environment: what happened, where (file, file:line, offset), and a
/// hint what to do about it.
class Error : public std::runtime_error {
 public:
  Error(std::string what, std::string where, std::string hint,
        ExitCode code = ExitCode::bad_input);

  [[nodiscard]] const std::string& problem() const noexcept { return problem_; }
  [[nodiscard]] const std::string& where() const noexcept { return where_; }
  [[nodiscard]] const std::string& hint() const noexcept { return hint_; }
  [[nodiscard]] ExitCode code() const noexcept { return code_; }

 private:
  std::string problem_;
  std::string where_;
  std::string hint_;
  ExitCode code_;
};

/// A bug of ours: a broken precondition on a shape, range or state.
class ContractViolation : public std::logic_error {
 public:
  using std::logic_error::logic_error;
};

[[noreturn]] void throw_contract_violation(const char* condition, std::string_view message,
                                           const char* file, int line);

/// What can go wrong with a device or a store; the sequencer has a defined recovery for each.
enum class Errc {
  device_gone,  ///< unplugged, closed by the other side
  device_busy,  ///< in use, or answering "busy"
  timeout,      ///< no answer before the deadline
  protocol,     ///< an answer that breaks the protocol
  refused,      ///< the device understood and said no (power limit, range)
  io,           ///< read, write or sync failed
  no_space,     ///< the disk is full
  unsupported,  ///< the device cannot do this
};

[[nodiscard]] std::string_view to_string(Errc code) noexcept;

/// A device fault. `what` names the operation, the object, and what was observed and expected.
struct Fault {
  Errc code = Errc::io;
  std::string what;
  int sys_errno = 0;
  const char* file = "";
  int line = 0;
};

template <class T>
using Result = tl::expected<T, Fault>;

[[nodiscard]] inline auto fail(Errc code, std::string what, int sys_errno = 0,
                               const char* file = __builtin_FILE(),
                               int line = __builtin_LINE()) {
  return tl::unexpected<Fault>(Fault{code, std::move(what), sys_errno, file, line});
}

}  // namespace haarlight

/// Always checked; throws ContractViolation.
#define HAARLIGHT_EXPECTS(condition, message) \
  ((condition)                                \
       ? void(0)                              \
       : ::haarlight::throw_contract_violation(#condition, message, __FILE__, __LINE__))

/// Checked in debug builds only: for inner loops.
#ifdef NDEBUG
#define HAARLIGHT_ASSERT(condition) void(0)
#else
#define HAARLIGHT_ASSERT(condition) HAARLIGHT_EXPECTS(condition, "assertion")
#endif
