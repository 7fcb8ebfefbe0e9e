// SPDX-License-Identifier: Apache-2.0
#include "session/signature.h"

#include <array>
#include <cerrno>
#include <cstring>
#include <vector>

#include <fcntl.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"

namespace haarlight::session {

namespace {

constexpr const char* kNamespace = "haarlight";

struct Answer {
  bool is_good = false;
  std::string text;  ///< its output
};

/// Runs ssh-keygen with a file as its standard input.
Answer run_ssh_keygen(std::vector<std::string> arguments, const std::filesystem::path& input) {
  arguments.insert(arguments.begin(), "ssh-keygen");
  std::vector<char*> pointers;
  pointers.reserve(arguments.size() + 1);
  for (std::string& argument : arguments) {
    pointers.push_back(argument.data());
  }
  pointers.push_back(nullptr);
  std::array<int, 2> ends = {-1, -1};
  if (::pipe2(ends.data(), O_CLOEXEC) != 0) {
    throw Error(std::string("pipe: ") + std::strerror(errno), "ssh-keygen",
                "close other programs", ExitCode::io);
  }
  const Fd reading(ends[0]);
  Fd writing(ends[1]);
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addopen(&actions, STDIN_FILENO, input.c_str(), O_RDONLY, 0);
  posix_spawn_file_actions_adddup2(&actions, writing.get(), STDOUT_FILENO);
  posix_spawn_file_actions_adddup2(&actions, writing.get(), STDERR_FILENO);
  pid_t child = 0;
  const int error =
      ::posix_spawnp(&child, "ssh-keygen", &actions, nullptr, pointers.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  writing.reset();
  if (error != 0) {
    throw Error(std::string("cannot be started: ") + std::strerror(error), "ssh-keygen",
                "install Debian's openssh-client", ExitCode::unavailable);
  }
  Answer answer;
  std::array<char, 4096> piece{};
  for (ssize_t n = 0; (n = ::read(reading.get(), piece.data(), piece.size())) != 0;) {
    if (n > 0) {
      answer.text.append(piece.data(), static_cast<std::size_t>(n));
    } else if (errno != EINTR) {
      break;
    }
  }
  int status = 0;
  while (::waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  answer.is_good = WIFEXITED(status) && WEXITSTATUS(status) == 0;
  while (!answer.text.empty() && (answer.text.back() == '\n' || answer.text.back() == '\r')) {
    answer.text.pop_back();
  }
  return answer;
}

}  // namespace

SignatureCheck check_signature(const std::filesystem::path& folder,
                               const std::filesystem::path& signers) {
  const std::filesystem::path session = folder / "session.json";
  const std::string signature = folder / kSignatureFile;
  if (signers.empty()) {
    const Answer answer =
        run_ssh_keygen({"-Y", "check-novalidate", "-n", kNamespace, "-s", signature}, session);
    return {answer.is_good, answer.text};
  }
  const Answer found = run_ssh_keygen(
      {"-Y", "find-principals", "-s", signature, "-f", signers.string()}, session);
  if (!found.is_good) {
    return {false, "not by a key of " + signers.string() + ": " + found.text};
  }
  const std::string name = found.text.substr(0, found.text.find_first_of(",\n"));
  const Answer answer = run_ssh_keygen(
      {"-Y", "verify", "-f", signers.string(), "-I", name, "-n", kNamespace, "-s", signature},
      session);
  return {answer.is_good, answer.text};
}

}  // namespace haarlight::session
