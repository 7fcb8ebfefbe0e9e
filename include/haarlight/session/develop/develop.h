// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "haarlight/core/line_allocator.h"
#include "haarlight/core/stack/light_stack.h"
#include "haarlight/session/develop/develop_options.h"
#include "haarlight/session/session.h"

/// @file
/// From raw frames to the light stack. A target of its own, haarlight::develop (it uses oneTBB,
/// which the daemon does not link).

namespace haarlight::session {

/// A light stack and what is known about it.
struct Developed {
  LightStack stack;
  std::optional<LightStack> standard_error;  ///< same shape; if requested
  /// What each step did, as JSON (docs/reference/session-format.md); next to the stack as
  /// stack-KEY.json.
  std::string record;
  std::uint64_t n_saturated = 0;  ///< values clipped in every exposure: lower bounds
  double moved_fraction = 0.0;    ///< of compared values whose exposures contradict each other
};

/// Linear steps above black -> dark -> exposure, gain, drift, drive and power -> flat -> merge
/// of exposures -> bad pixels -> demultiplexing -> demosaic, for every light of a session.
/// Computed once and then cached in SESSION/cache/ under a key of everything it depends on. Out
/// of core: bands are sized to the memory budget.
///
/// Values of the light transport matrix: T = ((DN - black) / (white - black)) / (exposure in s
/// * 10^(gain/20) * level/65535 * relative power); an exposure of 0 (an import) counts as 1 s.
/// Two sessions of one rig are thus in the same units whatever their exposures. A value clipped
/// in every exposure is the greatest lower bound: counted in the record, -1 in the standard
/// error.
/// @throws Error  samples through an unknown curve (a camera's YUYV) unless `unknown_as` names
///                one; a light without a frame, a frame that does not fit, NaN (by name), drift
///                or exposures out of bounds, a standard error without known noise, disk full
[[nodiscard]] Developed develop_all(const Session& session, const DevelopOptions& options = {});
/// The stack alone.
[[nodiscard]] LightStack develop(const Session& session, const DevelopOptions& options = {});

/// The same values row by row, straight from the frames: nothing is written, no stack is kept.
class Developer {
 public:
  /// Borrows the session. @throws Error  as develop_all()
  Developer(const Session& session, const DevelopOptions& options);
  ~Developer();
  Developer(Developer&&) noexcept;
  Developer& operator=(Developer&&) = delete;
  Developer(const Developer&) = delete;
  Developer& operator=(const Developer&) = delete;

  [[nodiscard]] StackDims dims() const noexcept;
  /// As many rows at a time as fit the memory budget.
  [[nodiscard]] StackBands bands() const noexcept;
  /// Hash of everything that the values depend on: the key of develop_all()'s cache.
  [[nodiscard]] const std::string& key() const noexcept;

  struct Rows {
    LineFloats values;  ///< (channels, y1 - y0, width, n_lights)
    LineFloats errors;  ///< likewise, standard errors; empty unless requested
    /// Likewise: 1 where every exposure (of a shot that the light needs) is clipped, or that of
    /// a neighbour whose colour was used; empty where none is, or unless requested.
    std::vector<std::uint8_t> clipped;
  };
  /// Rows [y0, y1). One caller at a time; frames are read by several threads. Frames are stored
  /// in strips of 64 rows: whole strips are read once.
  /// @param room  rows that are no longer wanted, for their memory: fresh pages cost more than
  ///              the values that fill them
  [[nodiscard]] Rows rows(int y0, int y1, Rows room = {});

  /// The size of one camera step in each light's values, (n_lights); empty where values combine
  /// several samples (exposures, patterns, colours from a mosaic) or follow a curve. Values are
  /// whole multiples where neither dark frames nor a flat field are applied.
  [[nodiscard]] std::vector<double> steps() const;

  /// After all rows have been computed: what each step did (Developed::record).
  /// @throws Error  exposures that contradict each other by more than the bound
  [[nodiscard]] std::string record() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace haarlight::session
