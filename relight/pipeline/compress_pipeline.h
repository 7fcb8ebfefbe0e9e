// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <optional>
#include <string>
#include <vector>

#include "core/report.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/relight/basis/compress.h"
#include "relight/pipeline/pipeline_settings.h"

/// @file
/// From a session to a basis file: which basis its lights allow, which error its noise
/// warrants, and the compression itself (haarlight/relight/basis/compress_session.h).

namespace haarlight::relight {

struct CompressCaptureOptions {
  std::string session;
  std::string output;
  /// Relative L2 error of the whole stack, in [0, 1]; 0 is exact. Nothing: kNoiseTarget times
  /// the capture's noise, or 0.01 where it was not measured.
  std::optional<double> max_error;
  std::optional<double> worst_pixel;  ///< bound on every pixel's own error; nothing: none
  bool is_integer = false;            ///< every value as whole steps of the camera, exactly
  std::string plate;                  ///< as PlateChoice::parse; empty: automatic
  /// An Error where the lights' grids do not allow it. Nothing: Haar where they form grids, else
  /// direct, which is reported.
  std::optional<BasisKind> basis;
  std::optional<Transfer> unknown_as;  ///< for the unknown curve of a camera's YUYV or NV12
  Rank rank;                           ///< of several processes that share the work
  PipelineSettings settings;
};

struct CompressCaptureSummary {
  CompressSummary compressed;
  double relative_l2_requested = 0.0;  ///< infinite for whole steps
  std::string request_reason;          ///< the reason for it, for the user
  std::optional<double> noise;         ///< of the capture, if measured and requested
  std::vector<PipelineNote> notes;     ///< all messages
};

/// If killed, it resumes where it stopped when called again.
/// @throws Error  a session that cannot be read, a clean plate that does not fit, lights
///                without the grids that the basis needs, an output that exists; as compress_session()
[[nodiscard]] CompressCaptureSummary compress_capture(const CompressCaptureOptions& options);

/// What was requested and achieved.
void add_to_report(const CompressCaptureOptions& options, const CompressCaptureSummary& summary,
                   Report& report);

}  // namespace haarlight::relight
