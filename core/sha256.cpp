// SPDX-License-Identifier: Apache-2.0
#include "core/sha256.h"

#include <bit>

#include <openssl/evp.h>

#include "haarlight/core/error.h"

namespace haarlight {

namespace {

void require_done(int result) {
  if (result != 1) {
    throw Error("libcrypto's SHA-256 failed", "libcrypto",
                "reinstall Debian's libssl3, or switch off a policy that forbids SHA-256",
                ExitCode::internal);
  }
}

struct FreeContext {
  void operator()(EVP_MD_CTX* context) const noexcept { EVP_MD_CTX_free(context); }
};

}  // namespace

struct Sha256::State {
  std::unique_ptr<EVP_MD_CTX, FreeContext> context{EVP_MD_CTX_new()};
};

Sha256::Sha256() : state_(std::make_unique<State>()) {
  require_done(state_->context != nullptr ? 1 : 0);
  require_done(EVP_DigestInit_ex(state_->context.get(), EVP_sha256(), nullptr));
}
Sha256::~Sha256() = default;
Sha256::Sha256(Sha256&&) noexcept = default;
Sha256& Sha256::operator=(Sha256&&) noexcept = default;

Sha256& Sha256::add(std::span<const std::byte> bytes) {
  require_done(EVP_DigestUpdate(state_->context.get(), bytes.data(), bytes.size()));
  return *this;
}

Sha256& Sha256::add(std::string_view text) { return add(std::as_bytes(std::span(text))); }

Sha256Digest Sha256::digest() {
  Sha256Digest digest{};
  require_done(EVP_DigestFinal_ex(state_->context.get(),
                                  reinterpret_cast<unsigned char*>(digest.data()), nullptr));
  return digest;
}

Sha256Digest leaf_hash(std::string_view name, std::span<const std::byte> bytes) {
  constexpr std::string_view kZero("\0", 1);
  return Sha256().add(kZero).add(name).add(kZero).add(bytes).digest();
}

Sha256Digest leaf_hash(std::string_view name, std::string_view text) {
  return leaf_hash(name, std::as_bytes(std::span(text)));
}

Sha256Digest merkle_root(std::span<const Sha256Digest> leaves) {
  HAARLIGHT_EXPECTS(!leaves.empty(), "a tree with leaves");
  if (leaves.size() == 1) {
    return leaves.front();
  }
  const std::size_t k = std::bit_floor(leaves.size() - 1);
  return Sha256()
      .add(std::string_view("\x01", 1))
      .add(merkle_root(leaves.first(k)))
      .add(merkle_root(leaves.subspan(k)))
      .digest();
}

std::string to_hex(const Sha256Digest& digest) {
  constexpr std::string_view kDigits = "0123456789abcdef";
  std::string text;
  for (const std::byte byte : digest) {
    const auto value = std::to_integer<unsigned>(byte);
    text += kDigits[value >> 4U];
    text += kDigits[value & 15U];
  }
  return text;
}

Sha256Digest sha256_from_hex(std::string_view digits) {
  constexpr std::string_view kDigits = "0123456789abcdef";
  Sha256Digest digest{};
  bool is_good = digits.size() == 2 * digest.size();
  for (std::size_t i = 0; is_good && i < digits.size(); ++i) {
    const std::size_t value = kDigits.find(digits[i]);
    is_good = value != std::string_view::npos;
    digest[i / 2] |= static_cast<std::byte>(is_good ? value << (i % 2 == 0 ? 4U : 0U) : 0U);
  }
  if (!is_good) {
    throw Error("not a SHA-256: 64 digits 0 to 9, a to f", std::string(digits.substr(0, 80)),
                "compare with docs/reference/session-format.md");
  }
  return digest;
}

}  // namespace haarlight
