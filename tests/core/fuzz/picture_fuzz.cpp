/// @file
/// Any bytes as a picture of each format that OpenImageIO reads for us: pixels or an Error, and
/// never more memory than the limit (what OpenImageIO takes counts too).

#include <cstdint>

#include "core/error.h"
#include "core/image_io.h"
#include "tests/memory_file.h"

// libpng leaves OpenImageIO's functions by longjmp, past the destructors of their strings: 31
// bytes a damaged PNG, which is not ours to mend.
// NOLINTNEXTLINE(readability-identifier-naming): the sanitizer's name
extern "C" const char* __asan_default_options() { return "detect_leaks=0"; }

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  haarlight::limit_picture_memory(std::uint64_t{256} << 20U);
  const haarlight::testing::MemoryFile file(data, size);
  try {
    (void)haarlight::read_linear_image(file.path());
  } catch (const haarlight::Error&) {  // NOLINT(bugprone-empty-catch): refused
  }
  return 0;
}
