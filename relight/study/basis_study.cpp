// SPDX-License-Identifier: Apache-2.0
#include "relight/study/basis_study.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <map>
#include <memory>
#include <numeric>
#include <utility>

#include <fmt/format.h>

#include "core/count.h"
#include "core/order_statistics.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "relight/study/array_binning.h"
#include "relight/study/cdf53.h"
#include "relight/study/coefficient_coder.h"
#include "relight/study/dyadic_transform.h"
#include "relight/study/error_tally.h"
#include "relight/study/pca.h"
#include "relight/study/spherical_harmonics.h"
#include "relight/study/study_tiles.h"

namespace haarlight::relight {

namespace {

using Clock = std::chrono::steady_clock;

constexpr std::size_t kPiece = 64;     // pixels transformed together
constexpr std::size_t kColumns = 64;   // coefficients whose pictures are transformed together
constexpr double kErrorAgrees = 0.01;  // an error this close to the requested one counts as met
constexpr int kMaxRounds = 7;
constexpr double kFloorFraction = 0.01;  // of the floor's energy: added by quantisation there

double seconds_since(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

/// One basis with or without the clean plate.
struct Subject {
  const KnownBasis* known = nullptr;
  bool has_plate = false;
  std::shared_ptr<const LightBasis> transform;
  std::optional<Wavelet> image;
  std::vector<MagnitudeHistogram> histograms;  ///< one, or if ranked one per group of patterns
  std::vector<std::size_t> group_ends;         ///< last + 1 of each group
  double missed = 0.0;            ///< energy outside the span of all patterns; measured
  double analysis_seconds = 0.0;  ///< of the last pass

  [[nodiscard]] std::size_t width() const { return count(transform->n_coefficients()); }
  [[nodiscard]] bool is_orthonormal() const {
    return transform->is_orthonormal() && image != Wavelet::cdf53;
  }
};

/// A basis at a size: what was tried, and the best result.
struct Job {
  std::size_t subject = 0;
  PointKind kind = PointKind::error;
  double requested = 0.0;
  bool is_threshold = false;  ///< bare threshold: values unrounded, nothing packed
  bool is_settled = false;
  double step = 0.0;  ///< or threshold
  std::size_t n_kept = 0;
  std::vector<std::pair<double, double>> tried;  ///< (step, error)
  BasisPoint point;                              ///< of the best try
  bool has_point = false;
};

/// What one pass measures of a job.
struct Measured {
  explicit Measured(std::size_t n_lightings) : tally(n_lightings) {}
  ErrorTally tally;
  std::uint64_t n_kept = 0;
  std::uint64_t bytes = 0;
  std::uint64_t gain_bytes = 0;
  double code_seconds = 0.0;
  double decode_seconds = 0.0;
};

class Study {
 public:
  Study(const StudyCapture& capture, const BasisStudyOptions& options)
      : capture_(capture), options_(options), tiles_(capture, options) {
    dims_ = capture.stack->dims();
    HAARLIGHT_EXPECTS(capture.lights.size() == count(dims_.n_lights), "every light's position");
    HAARLIGHT_EXPECTS(!capture.lightings.empty(), "a lighting");
    const auto n_lightings = static_cast<Eigen::Index>(capture.lightings.size());
    weights_.resize(dims_.n_lights, n_lightings);
    for (Eigen::Index i = 0; i < n_lightings; ++i) {
      const Eigen::VectorXd& w = capture.lightings[static_cast<std::size_t>(i)].weights;
      HAARLIGHT_EXPECTS(w.size() == dims_.n_lights, "one weight per light");
      weights_.col(i) = w;
    }
    n_values_ = double(tiles_.n_pixels()) * dims_.channels;
  }

  BasisStudy run() {
    const auto start = Clock::now();
    survey();
    make_subjects();
    analyse();
    make_jobs();
    for (int round = 1; round <= kMaxRounds; ++round) {
      if (!run_round(round)) {
        break;
      }
    }
    BasisStudy study = collect();
    study.seconds = seconds_since(start);
    return study;
  }

 private:
  /// Norms, regions, exact pictures, the array with fewer lights.
  void survey();
  void find_regions();
  void classify_regions();
  /// By side and whether points.
  void keep_binnings(const std::map<std::pair<int, bool>, ErrorTally>& binned);
  void make_subjects();
  void add_subject(const KnownBasis& known, bool has_plate,
                   std::shared_ptr<const LightBasis> transform);
  void analyse();
  void make_jobs();
  bool run_round(int round);
  void measure(const StudyTile& tile, Subject& subject, std::span<Job* const> jobs,
               std::vector<Measured>& measured);
  void evaluate(Job& job, const Measured& measured, int round);
  [[nodiscard]] BasisStudy collect() const;

  void transform_tile(const Subject& subject, const StudyTile& tile,
                      std::vector<float>& coefficients) const;
  [[nodiscard]] double missed_energy(const Subject& subject, const StudyTile& tile,
                                     std::span<const float> coefficients) const;
  [[nodiscard]] Region region_at(const TileRect& rect, std::size_t pixel) const {
    const int x = rect.x0 + static_cast<int>(pixel) % rect.width;
    const int y = rect.y0 + static_cast<int>(pixel) / rect.width;
    return regions_[count(y) * count(dims_.width) + count(x)];
  }
  [[nodiscard]] double table_numbers(const Subject& subject, std::size_t n) const {
    return subject.transform->table_bytes(static_cast<int>(n)) > 0
               ? double(n) * dims_.n_lights / (double(dims_.n_pixels()) * dims_.channels)
               : 0.0;
  }
  /// Fraction of the capture's pixels studied: tables serve all of them.
  [[nodiscard]] double studied_fraction() const {
    return double(tiles_.n_pixels()) / double(dims_.n_pixels());
  }
  /// Step and number of patterns that need the fewest coefficients for an error.
  void choose_for_error(const Subject& subject, Job& job) const;
  /// Those with the smallest error for a size.
  void choose_for_size(const Subject& subject, Job& job) const;
  template <class Work>
  void for_ranks(const Subject& subject, Work work) const;
  [[nodiscard]] PictureErrors picture_errors(const ErrorTally& tally, std::size_t i) const;

  const StudyCapture& capture_;
  const BasisStudyOptions& options_;
  StudyTiles tiles_;
  StackDims dims_;
  Eigen::MatrixXd weights_;  ///< (n_lights, lightings)
  double n_values_ = 0.0;    ///< pixels studied, times channels
  double dark_norm_ = 0.0;
  std::vector<Region> regions_;
  std::array<std::uint64_t, kRegions> region_pixels_{};
  std::optional<ErrorTally> truth_;
  std::vector<double> peaks_;  ///< per lighting
  std::vector<BinningResult> binned_;
  std::optional<LightCovariance> covariance_[2];  ///< without and with plate
  std::vector<Subject> subjects_;
  std::vector<LeftOut> left_out_;
  std::vector<Job> jobs_;
};

bool is_wanted(const BasisStudyOptions& options, std::string_view name) {
  return options.bases.empty() ||
         std::find(options.bases.begin(), options.bases.end(), name) != options.bases.end();
}

void Study::find_regions() {
  const std::size_t n_pixels = dims_.n_pixels();
  double energy = 0.0;
  const std::size_t n_lights = count(dims_.n_lights);
  tiles_.for_each(false, [&](const StudyTile& tile) {
    for (std::size_t i = 0; i < tile.lights.size(); ++i) {
      if (!std::isfinite(tile.lights[i])) {
        const int pixel = static_cast<int>(i / n_lights);
        throw Error(fmt::format("light {} at pixel ({}, {}) is not a number", i % n_lights,
                                tile.rect.x0 + pixel % tile.rect.width,
                                tile.rect.y0 + pixel / tile.rect.width),
                    "light stack", "capture it again, or look at its frames");
      }
    }
    const RowSums sums = sum_rows(tile.lights, Eigen::MatrixXd(dims_.n_lights, 0));
    energy += std::accumulate(sums.energy.begin(), sums.energy.end(), 0.0);
  });
  if (!(energy > 0.0)) {
    throw Error("the capture is black: no basis can be compared on it", "light stack",
                "capture with light");
  }
  dark_norm_ = RegionRules{}.dark * std::sqrt(energy / n_values_);
  if (!capture_.regions.empty()) {
    HAARLIGHT_EXPECTS(capture_.regions.size() == n_pixels, "one region per pixel");
    regions_ = capture_.regions;
  } else {
    regions_.assign(n_pixels, Region::none);
  }
}

/// The point on the plane seen by each pixel's centre, or the object's centre.
Eigen::Vector3d surface_point(const StudyCapture& capture, int x, int y) {
  if (capture.camera && capture.plane) {
    const CameraRay ray = ray_through(*capture.camera, x + 0.5, y + 0.5);
    const double slope = capture.plane->n.dot(ray.direction_world);
    const double t = -(capture.plane->n.dot(ray.origin_world) + capture.plane->d) / slope;
    if (slope != 0.0 && std::isfinite(t) && t > 0.0) {
      return ray.origin_world + t * ray.direction_world;
    }
  }
  return capture.object_centre;
}

/// Each region by the mean of the channels, which all come before the next tile.
void Study::classify_regions() {
  const auto n_lights = count(dims_.n_lights);
  std::vector<float> mean;
  tiles_.for_each(false, [&](const StudyTile& tile) {
    if (tile.channel == 0) {
      mean.assign(tile.lights.size(), 0.0F);
    }
    const float fraction = 1.0F / static_cast<float>(dims_.channels);
    for (std::size_t i = 0; i < mean.size(); ++i) {
      mean[i] += fraction * tile.lights[i];
    }
    if (tile.channel + 1 < dims_.channels) {
      return;
    }
    parallel_for(count(tile.rect.n_pixels()), kPiece, [&](std::size_t begin, std::size_t end) {
      for (std::size_t p = begin; p < end; ++p) {
        const int x = tile.rect.x0 + static_cast<int>(p) % tile.rect.width;
        const int y = tile.rect.y0 + static_cast<int>(p) / tile.rect.width;
        const Eigen::Matrix3Xd factors =
            light_factors(capture_.lights, surface_point(capture_, x, y));
        regions_[count(y) * count(dims_.width) + count(x)] =
            classify_pixel({mean.data() + p * n_lights, n_lights}, factors, dark_norm_).region;
      }
    });
  });
}

void Study::survey() {
  find_regions();
  const auto n_lights = count(dims_.n_lights);
  const std::vector<BinChoice> choices = bin_choices(capture_.grid);
  const Eigen::Index n_lightings = weights_.cols();
  // Columns: the exact pictures, then what each binning changes of each lighting.
  Eigen::MatrixXd columns(dims_.n_lights,
                          n_lightings * static_cast<Eigen::Index>(1 + choices.size()));
  columns.leftCols(n_lightings) = weights_;
  for (std::size_t i = 0; i < choices.size(); ++i) {
    for (Eigen::Index j = 0; j < n_lightings; ++j) {
      columns.col(n_lightings * static_cast<Eigen::Index>(i + 1) + j) =
          binned_weights(weights_.col(j), capture_.grid, choices[i]) - weights_.col(j);
    }
  }
  truth_.emplace(static_cast<std::size_t>(n_lightings));
  std::map<std::pair<int, bool>, ErrorTally> binned;  // by side and whether points
  for (const BinChoice& choice : choices) {
    binned.try_emplace({choice.side, !choice.is_area}, static_cast<std::size_t>(n_lightings));
  }
  const auto picture_size = static_cast<std::size_t>(n_values_);
  std::vector<std::vector<float>> pictures(static_cast<std::size_t>(n_lightings),
                                           std::vector<float>(picture_size));
  const bool needs_pca = is_wanted(options_, "pca");
  if (needs_pca) {
    covariance_[0].emplace(dims_.n_lights);
    if (capture_.plate != nullptr) {
      covariance_[1].emplace(dims_.n_lights);
    }
  }
  Progress progress("capture", tiles_.rects().size() * count(dims_.channels),
                    options_.progress);
  if (capture_.regions.empty()) {
    classify_regions();
  }
  tiles_.for_each(needs_pca, [&](const StudyTile& tile) {
    if (needs_pca) {
      covariance_[0]->add(tile.lights);
      if (covariance_[1]) {
        covariance_[1]->add(tile.residual);
      }
    }
    const RowSums sums = sum_rows(tile.lights, columns);
    std::vector<std::vector<double>> off(choices.size(),
                                         std::vector<double>(sums.energy.size()));
    parallel_for(sums.energy.size(), kPiece, [&](std::size_t begin, std::size_t end) {
      for (std::size_t p = begin; p < end; ++p) {
        for (std::size_t i = 0; i < choices.size(); ++i) {
          off[i][p] = binned_energy({tile.lights.data() + p * n_lights, n_lights},
                                    capture_.grid, choices[i]);
        }
      }
    });
    const auto n = static_cast<std::size_t>(n_lightings);
    for (std::size_t p = 0; p < sums.energy.size(); ++p) {
      const Region region = region_at(tile.rect, p);
      if (tile.channel == 0) {
        ++region_pixels_[static_cast<std::size_t>(region)];
      }
      const double* row = sums.pictures.data() + p * static_cast<std::size_t>(columns.cols());
      truth_->add(region, sums.energy[p], {row, n});
      for (std::size_t j = 0; j < n; ++j) {
        pictures[j][tile.first + p] = static_cast<float>(row[j]);
      }
      for (std::size_t i = 0; i < choices.size(); ++i) {
        binned.at({choices[i].side, !choices[i].is_area})
            .add(region, off[i][p], {row + n * (i + 1), n}, choices[i].is_area ? 1.0 : 0.25);
      }
    }
    progress.advance();
  });
  for (std::vector<float>& picture : pictures) {
    for (float& value : picture) {
      value = std::abs(value);
    }
    peaks_.push_back(double{quantile(picture, 0.999)});
  }
  keep_binnings(binned);
}

void Study::keep_binnings(const std::map<std::pair<int, bool>, ErrorTally>& binned) {
  for (const auto& [key, tally] : binned) {
    BinningResult result;
    result.side = key.first;
    result.is_area = !key.second;
    result.rows = capture_.grid.rows / key.first;
    result.stack_error = relative_errors(tally.stack(), truth_->stack());
    for (std::size_t i = 0; i < capture_.lightings.size(); ++i) {
      result.pictures.push_back(picture_errors(tally, i));
    }
    binned_.push_back(std::move(result));
  }
}

PictureErrors Study::picture_errors(const ErrorTally& tally, std::size_t i) const {
  PictureErrors errors;
  errors.relative_l2 = relative_errors(tally.picture(i), truth_->picture(i));
  for (std::size_t r = 0; r < errors.psnr_db.size(); ++r) {
    const double n =
        (r == 0 ? double(tiles_.n_pixels()) : double(region_pixels_[r])) * dims_.channels;
    const double mean_square = tally.picture(i)[r] / n;
    errors.psnr_db[r] = n > 0.0 ? 10.0 * std::log10(peaks_[i] * peaks_[i] / mean_square)
                                : std::numeric_limits<double>::quiet_NaN();
  }
  return errors;
}

void Study::add_subject(const KnownBasis& known, bool has_plate,
                        std::shared_ptr<const LightBasis> transform) {
  Subject subject;
  subject.known = &known;
  subject.has_plate = has_plate;
  subject.transform = std::move(transform);
  if (known.word == "haar-haar") {
    subject.image = Wavelet::haar;
  } else if (known.word == "haar-cdf53") {
    subject.image = Wavelet::cdf53;
  }
  if (subject.transform->is_ranked()) {
    // 1, 2, 3, ... then a quarter more each time: the numbers of patterns tried.
    for (std::size_t end = 1; end < subject.width(); end += std::max<std::size_t>(1, end / 4)) {
      subject.group_ends.push_back(end);
    }
  }
  subject.group_ends.push_back(subject.width());
  subject.histograms.resize(subject.group_ends.size());
  subjects_.push_back(std::move(subject));
}

void Study::make_subjects() {
  const ArrayGrid& grid = capture_.grid;
  for (const KnownBasis& known : known_bases()) {
    if (!is_wanted(options_, known.word)) {
      continue;
    }
    const HaarGrid face{grid.rows, grid.cols};
    const std::string missing = missing_grid(known.need, face);
    if (!missing.empty()) {
      left_out_.push_back({std::string(known.title), missing});
      continue;
    }
    std::shared_ptr<const LightBasis> transform;
    if (known.kind) {
      transform = make_basis(*known.kind, face, dims_.n_lights);
    } else if (known.word == "haar-haar" || known.word == "haar-cdf53") {
      transform = make_basis(BasisKind::haar, face, dims_.n_lights);
    } else if (known.word == "cdf53") {
      transform = make_cdf53_basis(grid);
    } else if (known.word == "sh") {
      transform = make_spherical_harmonics(
          light_directions_from(capture_.lights, capture_.object_centre), options_.sh_order);
    }
    for (const bool has_plate : {false, true}) {
      if (has_plate && capture_.plate == nullptr) {
        continue;
      }
      if (known.word == "pca") {
        transform = make_pca_transform(
            principal_vectors(covariance_[has_plate ? 1 : 0]->matrix(), options_.pca_rank));
      }
      add_subject(known, has_plate, transform);
    }
  }
  if (capture_.plate == nullptr) {
    left_out_.push_back({"every basis with the clean plate", "there is no clean plate"});
  }
  covariance_[0].reset();
  covariance_[1].reset();
  if (subjects_.empty()) {
    throw Error("no basis is left to compare: " + left_out_.front().title + ": " +
                    left_out_.front().reason,
                "--basis", "name others, such as direct, sh, pca");
  }
}

void Study::transform_tile(const Subject& subject, const StudyTile& tile,
                           std::vector<float>& coefficients) const {
  const std::span<const float> values = tile.values(subject.has_plate);
  const std::size_t n_pixels = count(tile.rect.n_pixels());
  const std::size_t n_lights = count(dims_.n_lights);
  const std::size_t width = subject.width();
  coefficients.resize(n_pixels * width);
  parallel_for(n_pixels, kPiece, [&](std::size_t begin, std::size_t end) {
    subject.transform->analyse(
        values.subspan(begin * n_lights, (end - begin) * n_lights),
        std::span(coefficients).subspan(begin * width, (end - begin) * width));
  });
  if (subject.image) {
    const DyadicTransform image(*subject.image, tile.rect.height, tile.rect.width);
    parallel_for(width, kColumns, [&](std::size_t begin, std::size_t end) {
      image.forward(coefficients, width, begin, end - begin);
    });
  }
}

/// A tile's energy after subtracting all coefficients. Not a difference of energies: rounded
/// patterns are not orthonormal to that many digits.
double Study::missed_energy(const Subject& subject, const StudyTile& tile,
                            std::span<const float> coefficients) const {
  const std::span<const float> values = tile.values(subject.has_plate);
  const std::size_t n_lights = count(dims_.n_lights);
  const std::size_t width = subject.width();
  std::vector<float> rest(values.size());
  parallel_for(values.size() / n_lights, kPiece, [&](std::size_t begin, std::size_t end) {
    const std::span<float> rows =
        std::span(rest).subspan(begin * n_lights, (end - begin) * n_lights);
    subject.transform->synthesise(coefficients.subspan(begin * width, (end - begin) * width),
                                  rows);
    for (std::size_t i = 0; i < rows.size(); ++i) {
      rows[i] = values[begin * n_lights + i] - rows[i];
    }
  });
  const RowSums sums = sum_rows(rest, Eigen::MatrixXd(dims_.n_lights, 0));
  return std::accumulate(sums.energy.begin(), sums.energy.end(), 0.0);
}

void Study::analyse() {
  Progress progress("transforms",
                    tiles_.rects().size() * count(dims_.channels) * subjects_.size(),
                    options_.progress);
  std::vector<float> coefficients;
  tiles_.for_each(true, [&](const StudyTile& tile) {
    for (Subject& subject : subjects_) {
      const auto start = Clock::now();
      transform_tile(subject, tile, coefficients);
      subject.analysis_seconds += seconds_since(start);
      const std::size_t width = subject.width();
      const std::size_t n_pixels = coefficients.size() / width;
      if (subject.histograms.size() > 1) {
        parallel_for(subject.histograms.size(), 1, [&](std::size_t begin, std::size_t end) {
          for (std::size_t g = begin; g < end; ++g) {
            const std::size_t first = g == 0 ? 0 : subject.group_ends[g - 1];
            for (std::size_t p = 0; p < n_pixels; ++p) {
              for (std::size_t i = first; i < subject.group_ends[g]; ++i) {
                subject.histograms[g].add(double{coefficients[p * width + i]});
              }
            }
          }
        });
      } else {
        constexpr std::size_t kPart = 2048;  // pixels: 8 histograms per tile of 128
        std::vector<MagnitudeHistogram> parts((n_pixels + kPart - 1) / kPart);
        parallel_for(parts.size(), 1, [&](std::size_t begin, std::size_t end) {
          for (std::size_t part = begin; part < end; ++part) {
            const std::size_t last = std::min(coefficients.size(), (part + 1) * kPart * width);
            for (std::size_t i = part * kPart * width; i < last; ++i) {
              parts[part].add(double{coefficients[i]});
            }
          }
        });
        for (const MagnitudeHistogram& part : parts) {
          subject.histograms.front().merge(part);
        }
      }
      if (!subject.transform->is_complete()) {
        subject.missed += missed_energy(subject, tile, coefficients);
      }
      progress.advance();
    }
  });
}

/// Calls work(n, histogram of the first n coefficients, energy missed) for the numbers of
/// patterns worth trying.
template <class Work>
void Study::for_ranks(const Subject& subject, Work work) const {
  std::vector<double> missed(subject.histograms.size() + 1, subject.missed);
  for (std::size_t g = subject.histograms.size(); g-- > 1;) {
    missed[g] = missed[g + 1] + CoefficientCurve(subject.histograms[g]).energy();
  }
  MagnitudeHistogram some;
  for (std::size_t g = 0; g < subject.histograms.size(); ++g) {
    some.merge(subject.histograms[g]);
    work(subject.group_ends[g], some, missed[g + 1]);
  }
}

void Study::choose_for_error(const Subject& subject, Job& job) const {
  const double allowed = job.requested * job.requested * truth_->stack()[0];
  double fewest = std::numeric_limits<double>::infinity();
  job.point.is_achieved = false;
  for_ranks(subject, [&](std::size_t n, const MagnitudeHistogram& some, double missed) {
    const CoefficientCurve curve(some);
    const bool is_achieved = missed < allowed;
    const double left = is_achieved ? allowed - missed : kFloorFraction * missed;
    const double largest =
        std::max(1.1 * curve.threshold_for_count(1.0), std::numeric_limits<double>::min());
    const double step =
        job.is_threshold ? curve.threshold_for_energy(left) : some.choose_step(left, largest);
    const double kept = curve.count_from(job.is_threshold ? step : kDeadZone * step);
    const double numbers = kept / n_values_ + table_numbers(subject, n);
    // Where none achieves it, the transform that comes closest: the last.
    if (is_achieved ? numbers < fewest : !job.point.is_achieved) {
      fewest = is_achieved ? numbers : fewest;
      job.point.is_achieved = is_achieved;
      job.step = step;
      job.n_kept = n;
    }
  });
}

void Study::choose_for_size(const Subject& subject, Job& job) const {
  double least = std::numeric_limits<double>::infinity();
  job.point.is_achieved = false;
  for_ranks(subject, [&](std::size_t n, const MagnitudeHistogram& some, double missed) {
    const double budget = (job.requested - table_numbers(subject, n)) * n_values_;
    if (budget < 1.0) {
      return;
    }
    const CoefficientCurve curve(some);
    double threshold = curve.threshold_for_count(budget);
    if (threshold == 0.0) {  // all of them: a step that hardly rounds
      threshold = 1e-4 * curve.threshold_for_count(0.5 * curve.count_from(0.0));
    }
    const double step = std::max(threshold / kDeadZone, std::numeric_limits<double>::min());
    const double error = missed + some.error_energy(step);
    if (error < least) {
      least = error;
      job.point.is_achieved = true;
      job.step = step;
      job.n_kept = n;
    }
  });
}

void Study::make_jobs() {
  for (std::size_t i = 0; i < subjects_.size(); ++i) {
    const Subject& subject = subjects_[i];
    const auto add = [&](PointKind kind, double requested, bool is_threshold) {
      Job job;
      job.subject = i;
      job.kind = kind;
      job.requested = requested;
      job.is_threshold = is_threshold;
      kind == PointKind::error ? choose_for_error(subject, job) : choose_for_size(subject, job);
      if (job.n_kept == 0 || !(job.step > 0.0)) {
        job.is_settled = true;  // a size smaller than the tables
        job.point.is_achieved = false;
      }
      if (kind == PointKind::error && !is_threshold && job.point.is_achieved &&
          subject.is_orthonormal()) {
        Job bare = job;
        bare.is_threshold = true;
        choose_for_error(subject, bare);
        double kept = 0.0;
        for_ranks(subject, [&](std::size_t n, const MagnitudeHistogram& some, double) {
          kept = n == bare.n_kept ? CoefficientCurve(some).count_from(bare.step) : kept;
        });
        job.point.threshold_numbers = kept / n_values_ + table_numbers(subject, bare.n_kept);
      }
      jobs_.push_back(std::move(job));
    };
    for (const double error : options_.errors) {
      add(PointKind::error, error, false);
      if (!subject.is_orthonormal()) {
        add(PointKind::error, error, true);
      }
    }
    for (const double size : options_.sizes) {
      add(PointKind::size, size, false);
    }
  }
}

void Study::measure(const StudyTile& tile, Subject& subject, std::span<Job* const> jobs,
                    std::vector<Measured>& measured) {
  std::vector<float> coefficients;
  auto start = Clock::now();
  transform_tile(subject, tile, coefficients);
  const double analysis = seconds_since(start);
  const std::span<const float> values = tile.values(subject.has_plate);
  const std::size_t n_pixels = count(tile.rect.n_pixels());
  const std::size_t n_lights = count(dims_.n_lights);
  const std::size_t width = subject.width();
  std::optional<DyadicTransform> image;
  std::span<const int> order;
  if (subject.image) {
    image.emplace(*subject.image, tile.rect.height, tile.rect.width);
    order = image->order();
  }
  std::vector<float> kept;
  std::vector<float> errors(n_pixels * n_lights);
  for (std::size_t j = 0; j < jobs.size(); ++j) {
    const Job& job = *jobs[j];
    Measured& found = measured[j];
    start = Clock::now();
    kept = coefficients;
    if (job.is_threshold) {
      found.n_kept += threshold_values(kept, width, job.n_kept, static_cast<float>(job.step));
    } else {
      const auto step = static_cast<float>(job.step);
      found.n_kept += quantise_values(kept, width, job.n_kept, step);
      found.bytes += packed_bytes(kept, width, job.n_kept, step, order);
      if (subject.has_plate) {
        found.gain_bytes += packed_half_bytes(tile.gains);
      }
    }
    found.code_seconds += analysis + seconds_since(start);
    start = Clock::now();
    if (image) {
      parallel_for(width, kColumns, [&](std::size_t begin, std::size_t end) {
        image->inverse(kept, width, begin, end - begin);
      });
    }
    parallel_for(n_pixels, kPiece, [&](std::size_t begin, std::size_t end) {
      const std::span<float> rows =
          std::span(errors).subspan(begin * n_lights, (end - begin) * n_lights);
      subject.transform->synthesise_first(
          std::span<const float>(kept).subspan(begin * width, (end - begin) * width),
          static_cast<int>(job.n_kept), rows);
      for (std::size_t i = 0; i < rows.size(); ++i) {
        rows[i] -= values[begin * n_lights + i];
      }
    });
    const RowSums sums = sum_rows(errors, weights_);
    for (std::size_t p = 0; p < n_pixels; ++p) {
      found.tally.add(region_at(tile.rect, p), sums.energy[p],
                      {sums.pictures.data() + p * static_cast<std::size_t>(weights_.cols()),
                       static_cast<std::size_t>(weights_.cols())});
    }
    found.decode_seconds += seconds_since(start);
  }
}

bool Study::run_round(int round) {
  std::vector<std::vector<Job*>> of_subject(subjects_.size());
  std::vector<std::vector<Measured>> measured(subjects_.size());
  std::size_t n_jobs = 0;
  for (Job& job : jobs_) {
    if (!job.is_settled) {
      of_subject[job.subject].push_back(&job);
      measured[job.subject].emplace_back(capture_.lightings.size());
      ++n_jobs;
    }
  }
  if (n_jobs == 0) {
    return false;
  }
  Progress progress(fmt::format("coding, round {}", round),
                    tiles_.rects().size() * count(dims_.channels) * n_jobs, options_.progress);
  tiles_.for_each(true, [&](const StudyTile& tile) {
    for (std::size_t i = 0; i < subjects_.size(); ++i) {
      if (!of_subject[i].empty()) {
        measure(tile, subjects_[i], of_subject[i], measured[i]);
        progress.advance(of_subject[i].size());
      }
    }
  });
  for (std::size_t i = 0; i < subjects_.size(); ++i) {
    for (std::size_t j = 0; j < of_subject[i].size(); ++j) {
      evaluate(*of_subject[i][j], measured[i][j], round);
    }
  }
  return true;
}

void Study::evaluate(Job& job, const Measured& measured, int round) {
  const Subject& subject = subjects_[job.subject];
  const ByRegion errors = relative_errors(measured.tally.stack(), truth_->stack());
  const double error = errors[0];
  const bool must_agree = job.kind == PointKind::error && job.point.is_achieved;
  const auto is_fine = [&](double e) { return e <= job.requested * (1.0 + kErrorAgrees); };
  // The best: the coarsest that meets the error; failing that, the finest.
  const bool is_better =
      !job.has_point || !must_agree ||
      (is_fine(error) ? !is_fine(job.point.stack_error[0]) || error > job.point.stack_error[0]
                      : error < job.point.stack_error[0]);
  if (is_better) {
    BasisPoint& point = job.point;
    job.has_point = true;
    point.kind = job.kind;
    point.requested = job.requested;
    point.step = job.step;
    point.n_patterns = static_cast<int>(job.n_kept);
    point.coefficients = double(measured.n_kept) / n_values_;
    point.table_numbers = table_numbers(subject, job.n_kept);
    point.table_bytes = static_cast<std::uint64_t>(std::ceil(
        studied_fraction() * double(subject.transform->table_bytes(point.n_patterns))));
    point.gain_bytes = measured.gain_bytes;
    point.bytes = measured.bytes + point.gain_bytes + point.table_bytes;
    point.stack_error = errors;
    point.pictures.clear();
    for (std::size_t i = 0; i < capture_.lightings.size(); ++i) {
      point.pictures.push_back(picture_errors(measured.tally, i));
    }
    point.code_seconds = measured.code_seconds;
    point.decode_seconds = measured.decode_seconds;
  }
  if (!must_agree || std::abs(error / job.requested - 1.0) <= kErrorAgrees ||
      round >= kMaxRounds) {
    job.is_settled = true;
    return;
  }
  // Error is nearly a power of step: the line through the last two tries, in logarithms.
  double slope = 1.0;
  if (!job.tried.empty()) {
    const auto& [step, before] = job.tried.back();
    const double run = std::log(job.step / step);
    const double rise = std::log(error / before);
    slope = run != 0.0 && rise / run > 0.2 ? std::min(rise / run, 2.0) : 1.0;
  }
  job.tried.emplace_back(job.step, error);
  const double factor = std::pow(job.requested / std::max(error, 1e-30), 1.0 / slope);
  job.step *= std::clamp(factor, 0.25, 4.0);
}

BasisStudy Study::collect() const {
  BasisStudy study;
  study.dims = dims_;
  study.tile = tiles_.tile();
  study.n_tiles = tiles_.n_tiles();
  study.n_tiles_studied = static_cast<int>(tiles_.rects().size());
  study.n_pixels = tiles_.n_pixels();
  study.region_pixels = region_pixels_;
  study.regions = regions_;
  for (const StudyLighting& lighting : capture_.lightings) {
    study.lightings.push_back(lighting.name);
  }
  for (std::size_t i = 0; i < subjects_.size(); ++i) {
    const Subject& subject = subjects_[i];
    BasisResult result;
    result.name = subject.known->word;
    result.title = std::string(subject.known->title) + (subject.has_plate ? " + plate" : "");
    result.has_plate = subject.has_plate;
    result.n_patterns = subject.transform->n_coefficients();
    double missed = 0.0;
    for_ranks(subject, [&](std::size_t, const MagnitudeHistogram&, double m) { missed = m; });
    result.floor_error = std::sqrt(missed / truth_->stack()[0]);
    for (const Job& job : jobs_) {
      if (job.subject != i) {
        continue;
      }
      if (job.is_threshold) {  // belongs to the point before it
        if (!result.points.empty() && job.has_point && job.point.is_achieved) {
          result.points.back().threshold_numbers = job.point.numbers();
        }
      } else {
        BasisPoint point = job.point;
        point.kind = job.kind;
        point.requested = job.requested;
        if (job.has_point && job.kind == PointKind::error && point.is_achieved) {
          point.is_achieved = point.stack_error[0] <= job.requested * (1.0 + kErrorAgrees);
        }
        if (job.has_point) {
          result.points.push_back(std::move(point));
        }
      }
    }
    study.results.push_back(std::move(result));
  }
  study.left_out = left_out_;
  study.binned = binned_;
  return study;
}

}  // namespace

BasisStudy study_bases(const StudyCapture& capture, const BasisStudyOptions& options) {
  HAARLIGHT_EXPECTS(capture.stack != nullptr, "a capture");
  for (const std::string& name : options.bases) {
    const auto& all = known_bases();
    if (std::none_of(all.begin(), all.end(),
                     [&](const KnownBasis& known) { return known.word == name; })) {
      throw Error("no basis is called " + name, "--basis", "see haarlight bases --help",
                  ExitCode::usage);
    }
  }
  return Study(capture, options).run();
}

}  // namespace haarlight::relight
