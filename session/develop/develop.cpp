// SPDX-License-Identifier: Apache-2.0
#include "haarlight/session/develop/develop.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <sys/mman.h>

#include "core/json_value.h"
#include "core/log.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/session/develop/demosaic.h"
#include "session/develop/demultiplex.h"
#include "session/develop/exposure_plan.h"
#include "session/develop/interleave.h"
#include "session/develop/radiometry.h"

namespace haarlight::session {

namespace {

namespace fs = std::filesystem;

constexpr std::string_view kMethodVersion =
    "develop 3";  // part of the cache's key: bump when results change

struct Job {
  const Session* session = nullptr;
  ExposurePlan plan;
  Demosaic demosaic = Demosaic::none;
  StackDims shape;
  int band_rows = 0;
  int margin = 0;
  bool has_error = false;
  bool marks_clipped = false;
  std::vector<double> power;  ///< of each light, relative
  PlatePixels plate;          ///< for shots that do not resolve their lights
};

/// Rows per band such that raw pictures, demosaiced ones and the band together fit the budget.
int choose_band_rows(const Job& job, std::uint64_t memory_bytes) {
  const FrameForm& form = job.session->info().form;
  const std::uint64_t n = std::max<std::uint64_t>(
      job.plan.groups.size(), static_cast<std::uint64_t>(job.shape.n_lights));
  const std::uint64_t row = static_cast<std::uint64_t>(form.width) * n * sizeof(float);
  const bool is_mosaic = job.demosaic != Demosaic::none;
  const auto channels = static_cast<std::uint64_t>(job.shape.channels);
  constexpr std::uint64_t kOne = 1;
  // Values and, where computed, their variances.
  const bool has_variances = job.has_error || (job.marks_clipped && !job.plan.is_single);
  const std::uint64_t raw_copies =
      (job.plan.is_single ? kOne : 2 * kOne) * (has_variances ? 2 : 1);
  const std::uint64_t marks = job.marks_clipped ? row / sizeof(float) * 2 * channels : 0;
  const std::uint64_t a_row =
      marks + row * (static_cast<std::uint64_t>(form.channels) * raw_copies +
                     channels * (job.has_error ? 2 : 1) + (is_mosaic ? channels : 0));
  const std::uint64_t margins = 2 * static_cast<std::uint64_t>(job.margin) * a_row;
  // Corrections, one frame being read by each thread, and the stack's pages being written.
  const std::uint64_t fixed = 16 * static_cast<std::uint64_t>(form.width) *
                                  static_cast<std::uint64_t>(form.height) *
                                  static_cast<std::uint64_t>(form.channels) +
                              margins;
  const std::uint64_t budget = memory_bytes > fixed ? (memory_bytes - fixed) / a_row : 0;
  if (budget < 1) {
    throw Error(fmt::format("one row of {} pictures needs {} MiB", n, (fixed + a_row) >> 20U),
                job.session->folder().string(), "give more --memory", ExitCode::usage);
  }
  auto rows = static_cast<int>(
      std::min<std::uint64_t>(budget, static_cast<std::uint64_t>(form.height)));
  constexpr int kStrip = 64;  // frames are stored in strips of 64 rows: read each once
  if (rows < form.height && rows > kStrip) {
    rows = rows / kStrip * kStrip;
  } else if (rows < form.height && rows > 1) {
    rows = rows / 2 * 2;
  }
  return rows;
}

/// The variance of demosaiced colours: bilinear weights w sum to 1, so that sum w var is an
/// upper bound of sum w^2 var. A neighbour clipped in every exposure marks the pixel too.
Image<float> demosaic_variance(const Image<float>& variance, BayerPattern bayer) {
  constexpr float kMark = 1e30F;
  constexpr float kMarked = 1e25F;  // a ninth of the mark, and less
  Image<float> marked = variance;
  for (float& value : marked.pixels()) {
    value = value < 0.0F ? kMark : value;
  }
  Image<float> colour = demosaic(marked.view(), bayer, Demosaic::bilinear);
  for (float& value : colour.pixels()) {
    value = value > kMarked ? -1.0F : value;
  }
  return colour;
}

/// Variances of the patterns become the lights'; a flat field's error is common to all of them
/// and comes out as the same fraction of each light.
void demultiplex_errors(const Job& job, const Radiometry& radiometry, int y0,
                        const std::vector<Image<float>>& lights,
                        std::vector<Image<float>>& variances) {
  std::vector<double> dark_sigma;
  dark_sigma.reserve(job.plan.groups.size());
  for (const PatternGroup& group : job.plan.groups) {
    dark_sigma.push_back(radiometry.dark_sigma(group));
  }
  demultiplex_variance_rows(*job.plan.inverse, job.power, job.plate, y0, dark_sigma, variances);
  const double flat = radiometry.flat_variance();
  for (std::size_t k = 0; flat > 0.0 && k < variances.size(); ++k) {
    for (std::size_t i = 0; i < variances[k].pixels().size(); ++i) {
      const double value = double{lights[k].pixels()[i]};
      float& variance = variances[k].pixels()[i];
      variance =
          variance < 0.0F ? -1.0F : static_cast<float>(double{variance} + flat * value * value);
    }
  }
}

/// Rows of a pattern's picture before demultiplexing and demosaicing.
struct PatternShape {
  int height = 0;
  int width = 0;
  int channels = 1;
};

/// Marks as variances: -1 where marked, else 0.
Image<float> marks_as_variance(const Image<std::uint8_t>& marks, const PatternShape& shape) {
  Image<float> variance(shape.height, shape.width, shape.channels);
  if (marks.height() > 0) {
    std::transform(marks.pixels().begin(), marks.pixels().end(), variance.pixels().begin(),
                   [](std::uint8_t mark) { return mark != 0 ? -1.0F : 0.0F; });
  }
  return variance;
}

/// The patterns' marks become the lights', and those of a mosaic its colours'.
/// @param from  the first row that the pictures have; skip: how many of them are not wanted
std::vector<std::uint8_t> marks_of_lights(const Job& job,
                                          std::vector<Image<std::uint8_t>> marks,
                                          const PatternShape& shape, int from, int skip,
                                          int rows) {
  if (std::all_of(marks.begin(), marks.end(), [](const auto& m) { return m.height() == 0; })) {
    return {};
  }
  if (!job.plan.is_single) {
    std::vector<Image<float>> variances;
    variances.reserve(marks.size());
    for (Image<std::uint8_t>& of_pattern : marks) {
      variances.push_back(marks_as_variance(of_pattern, shape));
      of_pattern = {};
    }
    const std::vector<double> none(marks.size(), 0.0);
    demultiplex_variance_rows(*job.plan.inverse, job.power, job.plate, from, none, variances);
    marks.resize(variances.size());
    std::transform(variances.begin(), variances.end(), marks.begin(), clipped_marks);
  }
  const BayerPattern bayer = job.session->info().form.bayer;
  parallel_for(marks.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t k = begin; k < end; ++k) {
      if (job.demosaic != Demosaic::none && marks[k].height() > 0) {
        marks[k] = clipped_marks(demosaic_variance(marks_as_variance(marks[k], shape), bayer));
      }
    }
  });
  return interleave_marks(marks, static_cast<std::size_t>(skip), static_cast<std::size_t>(rows),
                          static_cast<std::size_t>(job.shape.width),
                          static_cast<std::size_t>(job.shape.channels));
}

/// Rows [y0, y1) are wanted, [from, to) needed for them.
struct RowRange {
  int y0 = 0;
  int y1 = 0;
  int from = 0;
  int to = 0;
  [[nodiscard]] std::size_t n() const { return static_cast<std::size_t>(y1 - y0); }
  [[nodiscard]] std::size_t skip() const { return static_cast<std::size_t>(y0 - from); }
};

RowRange range_of(const Job& job, int y0, int y1) {
  // The first row read is even, so that the mosaic keeps its phase.
  const int top = std::max(0, y0 - job.margin) / 2 * 2;
  return {y0, y1, job.margin > 0 ? top : y0, std::min(job.shape.height, y1 + job.margin)};
}

Radiometry::Rows measured_rows(const Job& job, const RowRange& range) {
  return {range.from,   range.to, range.y0, range.y1, !job.plan.is_single && job.has_error,
          job.has_error};
}

/// Standard errors of variances, -1 for a lower bound.
void take_roots(Image<float>& variance) {
  for (float& value : variance.pixels()) {
    value = value < 0.0F ? -1.0F : std::sqrt(value);
  }
}

/// Room that is there already is used again, whatever it holds: every value will be written.
StackRows room_for(const Job& job, const RowRange& range, LineFloats& values) {
  const std::size_t n = range.n() * job.shape.row_values();
  const auto n_lights = static_cast<std::size_t>(job.shape.n_lights);
  if (n <= values.capacity()) {
    values.resize(n);
    return {values.data(), range.n(), n_lights};
  }
  values = {};  // first, so that both are never held at once
  values.reserve(n);
  // Only a hint: written all over, pages of 2 MB cost a fraction of small ones.
  constexpr std::size_t kPage = std::size_t{2} << 20U;
  const std::size_t past = reinterpret_cast<std::uintptr_t>(values.data()) % kPage;
  const std::size_t skip = past == 0 ? 0 : kPage - past;
  const std::size_t n_bytes = n * sizeof(float);
  if (n_bytes >= skip + kPage) {
    (void)::madvise(reinterpret_cast<std::byte*>(values.data()) + skip,
                    (n_bytes - skip) / kPage * kPage, MADV_HUGEPAGE);
  }
  values.resize(n);
  return {values.data(), range.n(), n_lights};
}

/// Some neighbouring lights' pictures at a time, where each pattern is one light: nothing but
/// the result is held for all of them.
void develop_single(const Job& job, const Radiometry& radiometry, const RowRange& range,
                    MergeTally& tally, Developer::Rows& band) {
  const std::size_t n_groups = job.plan.groups.size();
  const StackRows values = room_for(job, range, band.values);
  StackRows errors;
  if (job.has_error) {
    errors = room_for(job, range, band.errors);
  }
  std::vector<Image<std::uint8_t>> marks(job.marks_clipped ? n_groups : 0);
  std::vector<MergeTally> tallies(n_groups);
  const BayerPattern bayer = job.session->info().form.bayer;
  const std::size_t n_blocks = (n_groups + kLightBlock - 1) / kLightBlock;
  parallel_for(n_blocks, 1, [&](std::size_t begin, std::size_t end) {
    std::vector<RadianceRows> measured(kLightBlock);
    std::vector<Image<float>> pictures;
    std::vector<Image<float>> variances;
    for (std::size_t first = begin * kLightBlock; first < std::min(n_groups, end * kLightBlock);
         first += kLightBlock) {
      const std::size_t n = std::min(kLightBlock, n_groups - first);
      pictures.resize(n);
      variances.resize(job.has_error ? n : 0);
      for (std::size_t k = 0; k < n; ++k) {
        RadianceRows& rows = measured[k];
        radiometry.measure(job.plan.groups[first + k], measured_rows(job, range), rows);
        tallies[first + k] = std::move(rows.tally);
        if (job.marks_clipped) {
          marks[first + k] = std::move(rows.clipped);
        }
        if (job.demosaic != Demosaic::none) {
          pictures[k] = demosaic(rows.value.view(), bayer, job.demosaic);
        } else {
          std::swap(pictures[k], rows.value);
        }
        if (job.has_error) {
          variances[k] = job.demosaic != Demosaic::none
                             ? demosaic_variance(rows.variance, bayer)
                             : std::move(rows.variance);
          take_roots(variances[k]);
        }
      }
      interleave(pictures, range.skip(), first, values);
      if (job.has_error) {
        interleave(variances, range.skip(), first, errors);
      }
      for (std::size_t k = 0; k < n && job.demosaic == Demosaic::none; ++k) {
        std::swap(pictures[k], measured[k].value);  // their memory is used again
      }
    }
  });
  for (const MergeTally& of_group : tallies) {
    tally.add(of_group);
  }
  if (job.marks_clipped) {
    const FrameForm& form = job.session->info().form;
    band.clipped = marks_of_lights(job, std::move(marks),
                                   {range.to - range.from, form.width, form.channels},
                                   range.from, range.y0 - range.from, range.y1 - range.y0);
  }
}

/// All patterns' pictures together become the lights'.
void develop_patterns(const Job& job, const Radiometry& radiometry, const RowRange& range,
                      MergeTally& tally, Developer::Rows& band) {
  const std::size_t n_groups = job.plan.groups.size();
  std::vector<Image<float>> pictures(n_groups);
  std::vector<Image<float>> variances(job.has_error ? n_groups : 0);
  std::vector<Image<std::uint8_t>> marks(job.marks_clipped ? n_groups : 0);
  std::vector<MergeTally> tallies(n_groups);
  parallel_for(n_groups, 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t g = begin; g < end; ++g) {
      RadianceRows rows;
      radiometry.measure(job.plan.groups[g], measured_rows(job, range), rows);
      pictures[g] = std::move(rows.value);
      tallies[g] = std::move(rows.tally);
      if (job.marks_clipped) {
        marks[g] = std::move(rows.clipped);
      }
      if (job.has_error) {
        variances[g] = std::move(rows.variance);
      }
    }
  });
  for (const MergeTally& of_group : tallies) {
    tally.add(of_group);
  }
  if (job.marks_clipped) {
    const Image<float>& any = pictures.front();
    band.clipped =
        marks_of_lights(job, std::move(marks), {any.height(), any.width(), any.channels()},
                        range.from, range.y0 - range.from, range.y1 - range.y0);
  }
  demultiplex_rows(*job.plan.inverse, job.power, job.plate, range.from, pictures);
  if (job.has_error) {
    demultiplex_errors(job, radiometry, range.from, pictures, variances);
  }
  const BayerPattern bayer = job.session->info().form.bayer;
  const auto put = [&](std::vector<Image<float>>& from, const StackRows& to, bool is_error) {
    const std::size_t n_blocks = (from.size() + kLightBlock - 1) / kLightBlock;
    parallel_for(n_blocks, 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t first = begin * kLightBlock;
           first < std::min(from.size(), end * kLightBlock); first += kLightBlock) {
        const std::span<Image<float>> block =
            std::span(from).subspan(first, std::min(kLightBlock, from.size() - first));
        for (Image<float>& picture : block) {
          if (job.demosaic != Demosaic::none) {
            picture = is_error ? demosaic_variance(picture, bayer)
                               : demosaic(picture.view(), bayer, job.demosaic);
          }
          if (is_error) {
            take_roots(picture);
          }
        }
        interleave(block, range.skip(), first, to);
        std::fill(block.begin(), block.end(), Image<float>());
      }
    });
  };
  put(pictures, room_for(job, range, band.values), false);
  if (job.has_error) {
    put(variances, room_for(job, range, band.errors), true);
  }
}

void develop_rows(const Job& job, const Radiometry& radiometry, int y0, int y1,
                  MergeTally& tally, Developer::Rows& band) {
  const RowRange range = range_of(job, y0, y1);
  band.clipped.clear();
  if (!job.has_error) {
    band.errors.clear();
  }
  (job.plan.is_single ? develop_single : develop_patterns)(job, radiometry, range, tally, band);
}

/// The transfer curve of the samples; an unknown one only under the name given by the user.
Transfer transfer_of(const Session& session, const DevelopOptions& options) {
  const Transfer transfer = session.info().form.transfer;
  if (transfer != Transfer::unknown) {
    return transfer;
  }
  if (!options.unknown_as) {
    throw Error(
        "its samples went through a curve of the camera's own (YUYV, NV12 and the like): they "
        "are not linear in light",
        session.folder().string(),
        "capture in a raw format (docs/reference/cameras.md), or name the curve that develop "
        "or compress "
        "is to undo: --transfer srgb or --transfer linear");
  }
  return *options.unknown_as;
}

/// How a mosaic becomes colours; none where there is no mosaic, or it is to be kept.
Demosaic demosaic_of(const Session& session, const DevelopOptions& options) {
  const FrameForm& form = session.info().form;
  const bool is_mosaic = form.bayer != BayerPattern::none && !options.keep_bayer &&
                         form.width >= 2 && form.height >= 2;
  return is_mosaic ? options.demosaic : Demosaic::none;
}

/// What the distribution of light depends on; empty where no capture of its family needs it.
std::string plate_key_of(const Session& session, const DevelopOptions& options) {
  const PatternFamily family = session.info().patterns.family;
  const bool may_need_plate = family == PatternFamily::bins || family == PatternFamily::haar ||
                              family == PatternFamily::target;
  if (!may_need_plate) {
    return {};
  }
  const std::string without_plate = options.distribute_evenly ? "even" : "none";
  return options.plate.is_empty() ? without_plate : options.plate.key;
}

/// Everything that the stack's values depend on.
std::string cache_key(const Session& session, Demosaic method, Transfer transfer,
                      const DevelopOptions& options) {
  SessionInfo info = session.info();
  info.created.clear();
  info.form.transfer = transfer;
  std::string flat;
  if (!options.radiometry.flat_session.empty()) {
    SessionInfo other = Session::open(options.radiometry.flat_session).info();
    other.created.clear();
    flat = session_info_to_json(other);
  }
  return content_hash(fmt::format(
      "{}\n{}\n{}\n{}\n{}\n{}\n{}", kMethodVersion, to_string(method),
      plate_key_of(session, options), options.radiometry.key(), flat,
      session.rig() ? session.rig()->hash : std::string(), session_info_to_json(info)));
}

/// A cached stack, or nothing when there is none or it is damaged (then it is recomputed).
std::optional<LightStack> open_cached(const fs::path& file) {
  std::error_code ignored;
  if (!fs::exists(file, ignored)) {
    return {};
  }
  try {
    return LightStack::open(file);
  } catch (const Error& error) {
    log_warning(fmt::format("{}; making it again", error.what()));
    return {};
  }
}

void note_counts(Developed& developed, const std::string& where) {
  const JsonValue merge = JsonValue::parse(developed.record, where)["radiometry"]["merge"];
  developed.n_saturated = merge["saturated_in_all"].unsigned_integer();
  developed.moved_fraction = merge["moved_share"].number(0.0, 1.0);
}

std::optional<Developed> open_all_cached(const fs::path& folder, const std::string& key,
                                         bool has_error) {
  std::optional<LightStack> stack = open_cached(folder / fmt::format("stack-{}.hls", key));
  std::error_code ignored;
  const fs::path record = folder / fmt::format("stack-{}.json", key);
  if (!stack || !fs::exists(record, ignored)) {
    return {};
  }
  Developed developed{*std::move(stack), {}, read_file(record, std::uintmax_t{1} << 24U)};
  note_counts(developed, record.string());
  if (has_error) {
    developed.standard_error = open_cached(folder / fmt::format("error-{}.hls", key));
    if (!developed.standard_error) {
      return {};
    }
  }
  return developed;
}

void require_error_known(const Session& session, const Radiometry& radiometry) {
  if (!radiometry.response().is_measured) {
    throw Error(
        "the camera's noise is not known: no standard error can be given",
        session.folder().string(),
        "measure it (haarlight rig commission), or set noise = { gain, read, full_well, "
        "black } in the rig file");
  }
}

void require_plate(const Session& session, const Job& job, const DevelopOptions& options) {
  if (!options.plate.is_empty() || options.distribute_evenly) {
    return;
  }
  throw Error(
      fmt::format("{} shots of {} patterns hold less than {} lights: a clean plate must say "
                  "how each shot's light is distributed",
                  job.plan.groups.size(), to_string(session.info().patterns.family),
                  job.power.size()),
      session.folder().string(),
      "develop with a rig that has a [[plane]], or with --plate; --plate even distributes it "
      "equally",
      ExitCode::usage);
}

}  // namespace

struct Developer::Impl {
  Job job;
  std::string key;
  std::unique_ptr<Radiometry> radiometry;
  MergeTally tally;
};

Developer::Developer(const Session& session, const DevelopOptions& options)
    : impl_(std::make_unique<Impl>()) {
  const FrameForm& form = session.info().form;
  const Transfer transfer = transfer_of(session, options);
  Job& job = impl_->job;
  job.session = &session;
  job.has_error = options.has_standard_error;
  job.marks_clipped = options.marks_clipped;
  job.demosaic = demosaic_of(session, options);
  impl_->key = cache_key(session, job.demosaic, transfer, options);
  job.plan = plan_exposures(session);
  job.shape.width = form.width;
  job.shape.height = form.height;
  job.shape.channels = job.demosaic != Demosaic::none ? 3 : form.channels;
  job.shape.n_lights = static_cast<int>(session.info().lights.size());
  impl_->radiometry =
      std::make_unique<Radiometry>(session, job.plan, transfer, options.radiometry);
  if (job.has_error) {
    require_error_known(session, *impl_->radiometry);
  }
  const bool needs_margin =
      job.demosaic != Demosaic::none || impl_->radiometry->has_bad_pixels();
  job.margin = needs_margin ? 2 * kDemosaicMargin : 0;
  job.band_rows = choose_band_rows(job, options.memory_bytes);
  for (const SessionLight& light : session.info().lights) {
    job.power.push_back(light.relative_power);
  }
  if (!job.plan.is_single && job.plan.inverse->needs_plate()) {
    require_plate(session, job, options);
    job.plate = options.plate;
  }
}

Developer::~Developer() = default;
Developer::Developer(Developer&&) noexcept = default;

StackDims Developer::dims() const noexcept { return impl_->job.shape; }

StackBands Developer::bands() const noexcept {
  return {impl_->job.shape.height, impl_->job.band_rows};
}
const std::string& Developer::key() const noexcept { return impl_->key; }

Developer::Rows Developer::rows(int y0, int y1, Rows room) {
  const Job& job = impl_->job;
  HAARLIGHT_EXPECTS(0 <= y0 && y0 < y1 && y1 <= job.shape.height, "rows of the picture");
  Rows rows = std::move(room);
  develop_rows(job, *impl_->radiometry, y0, y1, impl_->tally, rows);
  if (y1 - y0 > 1 && y1 < job.shape.height) {
    // The disk may fetch those that will be asked for next, while these are used.
    const RowRange next = range_of(job, y1, std::min(job.shape.height, 2 * y1 - y0));
    for (const PatternGroup& group : job.plan.groups) {
      impl_->radiometry->expect(group, next.from, next.to);
    }
  }
  return rows;
}

std::vector<double> Developer::steps() const {
  const Job& job = impl_->job;
  std::vector<double> steps;
  if (!job.plan.is_single || job.demosaic != Demosaic::none) {
    return steps;
  }
  for (const PatternGroup& group : job.plan.groups) {
    const double step =
        group.frames.size() == 1 ? impl_->radiometry->step_of(group.frames.front()) : 0.0;
    if (!(step > 0.0)) {
      return {};
    }
    steps.push_back(step);
  }
  return steps;
}

std::string Developer::record() const {
  impl_->radiometry->require_levels(impl_->tally);
  return fmt::format(
      "{{\"recipe\": \"{}\", \"demosaic\": \"{}\", \"patterns\": {}, \"lights\": {}, "
      "\"radiometry\": {}}}\n",
      kMethodVersion, to_string(impl_->job.demosaic), impl_->job.plan.groups.size(),
      impl_->job.shape.n_lights, impl_->radiometry->record(impl_->tally));
}

Developed develop_all(const Session& session, const DevelopOptions& options) {
  const fs::path folder =
      options.cache_folder.empty() ? session.folder() / "cache" : options.cache_folder;
  const std::string key =
      cache_key(session, demosaic_of(session, options), transfer_of(session, options), options);
  const bool has_error = options.has_standard_error;
  if (options.use_cache) {
    if (std::optional<Developed> cached = open_all_cached(folder, key, has_error)) {
      return *std::move(cached);
    }
  }
  Developer developer(session, options);
  std::error_code error;
  fs::create_directories(folder, error);
  if (error) {
    throw Error("cannot make the cache's folder: " + error.message(), folder.string(),
                "make the session writable, or name another folder for its cache",
                ExitCode::io);
  }
  const fs::path file = folder / fmt::format("stack-{}.hls", key);
  const fs::path error_file = folder / fmt::format("error-{}.hls", key);
  const StackDims dims = developer.dims();
  const StackBands bands = developer.bands();
  LightStackWriter writer(file, dims, bands.rows);
  std::optional<LightStackWriter> error_writer;
  if (has_error) {
    error_writer.emplace(error_file, dims, bands.rows);
  }
  Progress progress("develop", static_cast<std::size_t>(bands.n()), options.progress);
  for (int i = 0; i < bands.n(); ++i) {
    const Developer::Rows band = developer.rows(bands.first_row(i), bands.end_row(i));
    writer.append_band(band.values);
    if (error_writer) {
      error_writer->append_band(band.errors);
    }
    progress.advance();
  }
  const std::string record = developer.record();
  writer.finish();
  if (error_writer) {
    error_writer->finish();
  }
  write_file_atomically(folder / fmt::format("stack-{}.json", key), record);
  Developed developed{LightStack::open(file), {}, record};
  note_counts(developed, file.string());
  if (has_error) {
    developed.standard_error = LightStack::open(error_file);
  }
  return developed;
}

LightStack develop(const Session& session, const DevelopOptions& options) {
  return develop_all(session, options).stack;
}

}  // namespace haarlight::session
