// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

/// @file
/// Where a light stack's values come from: a stack file, memory, a rig's closed form, or
/// another basis file. Everything that compresses or compares reads through this interface,
/// tile by tile.

namespace haarlight {

/// Pixels [x0, x0 + width) x [y0, y0 + height) of the picture.
struct TileRect {
  int x0 = 0;
  int y0 = 0;
  int width = 0;
  int height = 0;
  [[nodiscard]] int n_pixels() const noexcept { return width * height; }
  friend bool operator==(const TileRect&, const TileRect&) = default;
};

struct StackDims {
  int width = 0;
  int height = 0;
  int channels = 1;
  int n_lights = 0;
  [[nodiscard]] std::size_t n_pixels() const {
    return static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
  }
  /// Of all channels and lights.
  [[nodiscard]] std::size_t row_values() const {
    return static_cast<std::size_t>(width) * static_cast<std::size_t>(channels) *
           static_cast<std::size_t>(n_lights);
  }
  friend bool operator==(const StackDims&, const StackDims&) = default;
};

/// @throws ContractViolation  unless the tile lies inside the picture and `n_values` is what it
///             holds
void require_tile(const StackDims& dims, const TileRect& rect, std::size_t n_values);

/// The light transport matrix T[pixel][light] by tiles. read_tile is thread-safe.
class StackSource {
 public:
  StackSource() = default;
  virtual ~StackSource() = default;
  StackSource(const StackSource&) = default;
  StackSource& operator=(const StackSource&) = default;
  StackSource(StackSource&&) = default;
  StackSource& operator=(StackSource&&) = default;
  [[nodiscard]] virtual StackDims dims() const = 0;
  /// @param out  (channels, rect.height, rect.width, n_lights)
  /// @throws Error  what the medium throws
  virtual void read_tile(const TileRect& rect, std::span<float> out) const = 0;
  /// The same of some lights only. Where a light alone costs less than all of them, a source
  /// does it.
  /// @param lights  indices, in any order
  /// @param out     (channels, rect.height, rect.width, lights.size())
  virtual void read_lights(const TileRect& rect, std::span<const int> lights,
                           std::span<float> out) const;
  /// True where every pixel costs a computation and neighbours differ smoothly: few pixels are
  /// then requested.
  [[nodiscard]] virtual bool is_closed_form() const { return false; }
  /// True if the source knows which of its values were clipped.
  [[nodiscard]] virtual bool tells_clipped() const { return false; }
  /// In the order of read_tile: nonzero where a value was clipped in every exposure and so is a
  /// lower bound. Empty: none of the tile's was, or unknown. Thread-safe.
  [[nodiscard]] virtual std::vector<std::uint8_t> clipped_in(const TileRect& rect) const {
    static_cast<void>(rect);
    return {};
  }
};

/// A stack that is produced row by row: frames still to be developed, or generated values. Call
/// load_rows() first, from one thread; read_tile then serves those rows. Rows already loaded
/// cost nothing.
class RowSource : public StackSource {
 public:
  /// Makes rows [y0, y1) available, and may drop others. @throws Error  what the medium throws
  virtual void load_rows(int y0, int y1) = 0;
  /// Rows to load at a time: what fits the memory given to the source.
  [[nodiscard]] virtual int rows_at_once() const = 0;
  /// Called when every row was served: checks that need all of them.
  /// @throws Error  the values contradict each other
  virtual void finish() {}
};

/// A stack in memory, (channels, height, width, n_lights).
class MemoryStack final : public StackSource {
 public:
  explicit MemoryStack(const StackDims& dims);
  MemoryStack(const StackDims& dims, std::vector<float> values);
  [[nodiscard]] StackDims dims() const override { return dims_; }
  void read_tile(const TileRect& rect, std::span<float> out) const override;
  [[nodiscard]] float& at(int channel, int y, int x, int light);
  [[nodiscard]] std::span<const float> values() const noexcept { return values_; }

 private:
  StackDims dims_;
  std::vector<float> values_;
};

/// Reads a whole source. @throws Error  when it is larger than `max_bytes`
[[nodiscard]] MemoryStack read_all(const StackSource& source,
                                   std::size_t max_bytes = std::size_t{2} << 30U);

}  // namespace haarlight
