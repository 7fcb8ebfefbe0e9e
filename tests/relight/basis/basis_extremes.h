// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "core/count.h"
#include "haarlight/relight/basis/compress.h"
#include "tests/relight/basis/made_stack.h"
#include "tests/temporary_folder.h"

/// @file
/// Stacks and files that the extremes of compressing and of relighting share.

namespace haarlight::test {

using relight::BasisFile;
using relight::CompressOptions;
using relight::CompressSource;
using relight::CompressSummary;

/// 64 lights, more than a tile wide.
inline const MemoryStack& small_stack() {
  return make_stack({.width = 33, .height = 9, .grid = 8});
}

inline MemoryStack scaled(const MemoryStack& stack, double factor) {
  std::vector<float> values(stack.values().begin(), stack.values().end());
  for (float& v : values) {
    v = static_cast<float>(v * factor);
  }
  return {stack.dims(), std::move(values)};
}

/// A stack that says which of its lights was clipped.
class ClippedStack final : public StackSource {
 public:
  ClippedStack(const MemoryStack& stack, int light) : stack_(stack), light_(light) {}
  [[nodiscard]] StackDims dims() const override { return stack_.dims(); }
  void read_tile(const TileRect& rect, std::span<float> out) const override {
    stack_.read_tile(rect, out);
  }
  [[nodiscard]] bool tells_clipped() const override { return true; }
  [[nodiscard]] std::vector<std::uint8_t> clipped_in(const TileRect& rect) const override {
    std::vector<std::uint8_t> marks(count(rect.n_pixels()) * count(dims().n_lights));
    for (std::size_t i = count(light_); i < marks.size(); i += count(dims().n_lights)) {
      marks[i] = 1;
    }
    return marks;
  }

 private:
  const MemoryStack& stack_;
  int light_;
};

inline BasisFile compressed(const CompressSource& source, const CompressOptions& options,
                            CompressSummary* summary = nullptr) {
  const testing::TemporaryFolder folder;
  const CompressSummary found = compress_stack(source, folder / "a.hlb", options);
  if (summary != nullptr) {
    *summary = found;
  }
  return BasisFile::open(folder / "a.hlb");  // mapped: outlives its name
}

}  // namespace haarlight::test
