// SPDX-License-Identifier: Apache-2.0
#include "core/mapped_files.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <csignal>
#include <cstdint>
#include <cstring>
#include <mutex>
#include <string_view>

#include <unistd.h>

#include "haarlight/core/error.h"

namespace haarlight {

namespace {

constexpr std::size_t kMostMappings = 256;
constexpr std::size_t kLongestName = 512;

struct Mapping {
  std::atomic<const std::byte*> begin = nullptr;  ///< null: free
  std::atomic<std::size_t> size = 0;
  std::array<char, kLongestName> name{};
};

std::mutex mutex;  // of those who write; the handler only reads
std::array<Mapping, kMostMappings> mappings;
const char* program_name = "haarlight";

void say(std::string_view text) {
  while (!text.empty()) {
    const ssize_t n = ::write(STDERR_FILENO, text.data(), text.size());
    if (n <= 0) {
      return;
    }
    text.remove_prefix(static_cast<std::size_t>(n));
  }
}

/// Calls nothing that a signal's handler may not.
void on_bus_error(int /*signal*/, siginfo_t* info, void* /*context*/) {
  const auto* const address = static_cast<const std::byte*>(info->si_addr);
  for (const Mapping& mapping : mappings) {
    const std::byte* begin = mapping.begin.load();
    if (begin == nullptr || address < begin || address >= begin + mapping.size.load()) {
      continue;
    }
    say(program_name);
    say(": ");
    say(mapping.name.data());
    say(": it cannot be read any more: another program has cut it short, or its disk failed\n"
        "  hint: run the command again once the file is whole\n");
    ::_exit(static_cast<int>(ExitCode::io));
  }
  std::signal(SIGBUS, SIG_DFL);  // it comes again
}

}  // namespace

void end_where_mapped_files_fail(const char* program) {
  program_name = program;
  struct sigaction action {};
  action.sa_sigaction = on_bus_error;
  action.sa_flags = SA_SIGINFO;
  ::sigemptyset(&action.sa_mask);
  ::sigaction(SIGBUS, &action, nullptr);
}

void note_mapping(std::span<const std::byte> bytes,
                  const std::filesystem::path& path) noexcept {
  const std::scoped_lock lock(mutex);
  const auto free =
      std::ranges::find(mappings, nullptr, [](const Mapping& m) { return m.begin.load(); });
  if (free == mappings.end()) {
    return;
  }
  const std::string_view name = path.native();
  const std::size_t n = std::min(name.size(), kLongestName - 1);
  std::memcpy(free->name.data(), name.data(), n);
  free->name.at(n) = '\0';
  free->size = bytes.size();
  free->begin = bytes.data();
}

void forget_mapping(const std::byte* begin) noexcept {
  const std::scoped_lock lock(mutex);
  const auto found =
      std::ranges::find(mappings, begin, [](const Mapping& m) { return m.begin.load(); });
  if (found != mappings.end()) {
    found->begin = nullptr;
  }
}

}  // namespace haarlight
