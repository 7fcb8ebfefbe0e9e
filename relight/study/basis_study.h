// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "haarlight/core/progress.h"
#include "haarlight/core/stack/stack_source.h"
#include "relight/basis/light_basis.h"
#include "relight/study/array_grid.h"
#include "relight/study/capture_regions.h"
#include "relight/study/study_lightings.h"

/// @file
/// Compares bases on one capture: how many coefficients and bytes each needs for a given error,
/// and its error at a given size, over the stack, in pictures under several lightings, and in
/// each kind of region. Method and definitions: docs/numerics/bases.md.

namespace haarlight::relight {

/// The data of the comparison. Borrows its sources.
struct StudyCapture {
  const StackSource* stack = nullptr;
  const StackSource* plate = nullptr;  ///< 1 channel, or the stack's; none: no clean plate
  ArrayGrid grid;
  std::vector<StudyLight> lights;
  Eigen::Vector3d object_centre = Eigen::Vector3d::Zero();
  std::optional<CameraModel> camera;  ///< with a plane: assumed position of the surface
  std::optional<ShadowPlane> plane;
  std::vector<StudyLighting> lightings;
  std::vector<Region> regions;  ///< per pixel; empty: by classify_pixel()
};

struct BasisStudyOptions {
  std::vector<std::string> bases;  ///< words of known_bases(); empty: all
  std::vector<double> errors = {0.03, 0.01, 0.003};
  std::vector<double> sizes = {4.0, 16.0, 64.0};  ///< numbers per pixel and channel
  int sh_order = 15;
  int pca_rank = 512;  ///< the most vectors tried
  int n_tiles = 0;     ///< number of tiles studied, spread over the picture; 0: all
  std::uint64_t memory_bytes = std::uint64_t{4} << 30U;
  ProgressStyle progress = ProgressStyle::none;
};

/// [0] over all pixels, [r] over those of Region r. NaN where there are none.
using ByRegion = std::array<double, kRegions>;

/// Errors of one lighting's picture.
struct PictureErrors {
  ByRegion relative_l2{};
  ByRegion psnr_db{};  ///< peak: 99.9th percentile of the whole exact picture
};

enum class PointKind { error, size };

/// One basis coded once.
struct BasisPoint {
  PointKind kind = PointKind::error;
  double requested = 0.0;  ///< relative L2 of the stack, or numbers per pixel
  bool is_achieved = true;
  double step = 0.0;
  int n_patterns = 0;          ///< light patterns used; for PCA the vectors kept
  double coefficients = 0.0;   ///< nonzero, per pixel and channel
  double table_numbers = 0.0;  ///< of the patterns to be stored, per pixel of the capture
  std::uint64_t bytes = 0;     ///< of the pixels studied: coefficients, gains, part of tables
  std::uint64_t gain_bytes = 0;
  std::uint64_t table_bytes = 0;
  /// Kind error: numbers per pixel (tables too) that a bare threshold keeps for the same error,
  /// values unrounded. Negative: not achievable.
  double threshold_numbers = -1.0;
  ByRegion stack_error{};               ///< relative L2
  std::vector<PictureErrors> pictures;  ///< a lighting
  double code_seconds = 0.0;            ///< transform, quantise, pack; wall clock, one run
  double decode_seconds = 0.0;          ///< back to the lights, measured against the capture
  [[nodiscard]] double numbers() const { return coefficients + table_numbers; }
};

struct BasisResult {
  std::string name;
  std::string title;  ///< with " + plate" where one is subtracted
  bool has_plate = false;
  int n_patterns = 0;        ///< of the transform
  double floor_error = 0.0;  ///< least relative L2 at any size; 0 for complete bases
  std::vector<BasisPoint> points;
};

struct LeftOut {
  std::string title;
  std::string reason;
};

/// The array with bins of side x side lights.
struct BinningResult {
  int side = 2;            ///< lights per bin, per side
  int rows = 0;            ///< of bins, per face
  bool is_area = true;     ///< false: one light at the bin's middle instead of all
  ByRegion stack_error{};  ///< over every light by itself
  std::vector<PictureErrors> pictures;
};

struct BasisStudy {
  StackDims dims;
  int tile = 0;
  int n_tiles = 0;
  int n_tiles_studied = 0;
  std::uint64_t n_pixels = 0;                           ///< studied
  std::array<std::uint64_t, kRegions> region_pixels{};  ///< [0]: none
  std::vector<Region> regions;  ///< of the whole picture; none where not studied
  std::vector<std::string> lightings;
  std::vector<BasisResult> results;
  std::vector<LeftOut> left_out;
  std::vector<BinningResult> binned;
  double seconds = 0.0;
};

/// @throws Error  a black capture, NaN or infinity (names light and pixel), a clean plate of
///                another shape, an unknown basis, too little memory
[[nodiscard]] BasisStudy study_bases(const StudyCapture& capture,
                                     const BasisStudyOptions& options);

}  // namespace haarlight::relight
