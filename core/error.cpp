// SPDX-License-Identifier: Apache-2.0
#include "haarlight/core/error.h"

namespace haarlight {

namespace {

std::string compose(const std::string& what, const std::string& where,
                    const std::string& hint) {
  std::string text = where.empty() ? what : where + ": " + what;
  if (!hint.empty()) {
    text += "\n  hint: " + hint;
  }
  return text;
}

}  // namespace

Error::Error(std::string what, std::string where, std::string hint, ExitCode code)
    : std::runtime_error(compose(what, where, hint)),
      problem_(std::move(what)),
      where_(std::move(where)),
      hint_(std::move(hint)),
      code_(code) {}

void throw_contract_violation(const char* condition, std::string_view message, const char* file,
                              int line) {
  throw ContractViolation(std::string(file) + ":" + std::to_string(line) + ": expected " +
                          condition + " (" + std::string(message) + ")");
}

std::string_view to_string(Errc code) noexcept {
  switch (code) {
    case Errc::device_gone:
      return "device gone";
    case Errc::device_busy:
      return "device busy";
    case Errc::timeout:
      return "timeout";
    case Errc::protocol:
      return "protocol error";
    case Errc::refused:
      return "refused";
    case Errc::io:
      return "input/output error";
    case Errc::no_space:
      return "no space";
    case Errc::unsupported:
      return "unsupported";
  }
  return "unknown";
}

}  // namespace haarlight
