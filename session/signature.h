// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>

/// @file
/// A session's signature: OpenSSH's detached form over session.json, made with `ssh-keygen -Y
/// sign -f KEY -n haarlight SESSION/session.json`. Checked by ssh-keygen too (Debian's
/// openssh-client): keys, agents and hardware tokens are left to it.

namespace haarlight::session {

inline constexpr const char* kSignatureFile = "session.json.sig";

struct SignatureCheck {
  bool is_good = false;
  std::string said;  ///< who signed, or what is wrong, in words
};

/// Checks an existing session.json.sig.
/// @param signers  an allowed_signers file (ssh-keygen(1)); empty: only that the signature
/// matches these bytes, whatever the key
/// @throws Error(unavailable)  ssh-keygen cannot be started
[[nodiscard]] SignatureCheck check_signature(const std::filesystem::path& folder,
                                             const std::filesystem::path& signers);

}  // namespace haarlight::session
