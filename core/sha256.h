// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <memory>
#include <span>
#include <string>
#include <string_view>

/// @file
/// SHA-256 (OpenSSL's, which uses the processor's own instructions) and the Merkle tree of RFC
/// 6962 over named files. XXH3 (haarlight/core/files.h) detects damage faster; this also withstands
/// deliberate collisions. Only the .cpp sees OpenSSL.

namespace haarlight {

using Sha256Digest = std::array<std::byte, 32>;

/// Hashes what it is given, piece by piece. Move-only. @throws Error(internal)  libcrypto
/// refused
class Sha256 {
 public:
  Sha256();
  ~Sha256();
  Sha256(Sha256&&) noexcept;
  Sha256& operator=(Sha256&&) noexcept;
  Sha256(const Sha256&) = delete;
  Sha256& operator=(const Sha256&) = delete;

  Sha256& add(std::span<const std::byte> bytes);
  Sha256& add(std::string_view text);
  /// Once, at the end.
  [[nodiscard]] Sha256Digest digest();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// A leaf of the tree: SHA-256(0x00, name, 0x00, bytes). A name contains no zero byte.
[[nodiscard]] Sha256Digest leaf_hash(std::string_view name, std::span<const std::byte> bytes);
[[nodiscard]] Sha256Digest leaf_hash(std::string_view name, std::string_view text);

/// The root over at least one leaf. One leaf: itself; n leaves: SHA-256(0x01, root of the first
/// k, root of the others), k the largest power of two below n.
[[nodiscard]] Sha256Digest merkle_root(std::span<const Sha256Digest> leaves);

/// 64 lower-case hexadecimal digits, and back. @throws Error(bad_input)  malformed digits
[[nodiscard]] std::string to_hex(const Sha256Digest& digest);
[[nodiscard]] Sha256Digest sha256_from_hex(std::string_view digits);

}  // namespace haarlight
