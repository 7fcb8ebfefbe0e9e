// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>

#include "haarlight/session/session.h"
#include "session/journal.h"
#include "session/verify.h"

/// @file
/// The parts of `verify_session`, for use by its own files only. Each adds its findings to the
/// report.

namespace haarlight::session {

/// Everything session.json repeats from start.json, plan.json and rig.toml.
/// @param json  session.json's bytes
void check_texts(const std::filesystem::path& folder, const std::string& json,
                 const SessionInfo& info, VerifyReport& report);

/// journal.sqlite against session.json, the files and itself.
void check_journal(const std::filesystem::path& folder, const SessionInfo& info,
                   VerifyReport& report);

/// Links and foreign files in the folder; the files under the root (the frames' bytes and the
/// journal are checked elsewhere); the root; the signature.
/// @param signers  an allowed_signers file; empty: the signer is not checked
void check_seal(const std::filesystem::path& folder, const std::string& json,
                const SessionInfo& info, const std::filesystem::path& signers,
                VerifyReport& report);

}  // namespace haarlight::session
