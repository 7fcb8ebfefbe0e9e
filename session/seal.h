// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "haarlight/session/session.h"

/// @file
/// The root of a session: one SHA-256 over everything in it that must not change. Definition:
/// docs/reference/session-format.md. Unsigned, it reveals accidents and careless editing;
/// session.json, which holds it, can be signed (session/signature.h), which reveals every
/// change after signing.

namespace haarlight::session {

/// "haarlight 0.9.0".
[[nodiscard]] std::string program_name();

/// The files under the root other than the listed frames and session.json itself, by name:
/// start.json, plan.json, rig.toml, and all of frames/ and aside/. Excludes links.
/// @throws Error(io)  a folder or file cannot be read
[[nodiscard]] std::vector<std::string> list_sealed_names(const std::filesystem::path& folder,
                                                         const SessionInfo& info);

/// Fills in info.files and info.root; every frame has its sha256 already.
/// @param journal_text  Journal::text(); empty: the session has no journal
/// @throws Error(io)  a file cannot be read
void seal_session(const std::filesystem::path& folder, const std::string& journal_text,
                  SessionInfo& info);

/// The bytes of session.json covered by its root: all before the line of the root, which is the
/// last but one. Empty: the file does not end with such a line.
[[nodiscard]] std::string_view sealed_part(std::string_view session_json);

/// The root over session.json's covered part, the frames' leaves and the files' leaves as
/// listed.
/// @throws Error  a listed leaf is not a SHA-256
[[nodiscard]] std::string root_of(std::string_view sealed_part, const SessionInfo& info);

}  // namespace haarlight::session
