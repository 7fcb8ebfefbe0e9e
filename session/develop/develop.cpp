// SPDX-License-Identifier: Apache-2.0
#include "haarlight/session/develop/develop.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <optional>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "core/json_value.h"
#include "core/log.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/session/develop/demosaic.h"
#include "session/develop/demultiplex.h"
#include "session/develop/exposure_plan.h"
#include "session/develop/radiometry.h"

namespace haarlight::session {

namespace {

namespace fs = std::filesystem;

constexpr std::string_view kMethodVersion =
    "develop 3";  // part of the cache's key: bump when results change
/// (rows, width, channels) per light -> (channels, rows, width, lights).
std::vector<float> interleave(const std::vector<Image<float>>& pictures, int skip, int rows) {
  constexpr std::size_t kBlock = 16;  // adjacent lights: one cache line
  const auto count_of = [](int n) { return static_cast<std::size_t>(n); };
  const int width = pictures[0].width();
  const int channels = pictures[0].channels();
  const std::size_t n_lights = pictures.size();
  std::vector<float> values(static_cast<std::size_t>(channels) *
                            static_cast<std::size_t>(rows) * static_cast<std::size_t>(width) *
                            n_lights);
  parallel_for(static_cast<std::size_t>(channels) * static_cast<std::size_t>(rows), 1,
               [&](std::size_t begin, std::size_t end) {
                 for (std::size_t line = begin; line < end; ++line) {
                   const int c = static_cast<int>(line) / rows;
                   const int y = static_cast<int>(line) % rows;
                   float* out =
                       values.data() + line * static_cast<std::size_t>(width) * n_lights;
                   for (std::size_t first = 0; first < n_lights; first += kBlock) {
                     const std::size_t n = std::min(kBlock, n_lights - first);
                     std::array<const float*, kBlock> from{};
                     for (std::size_t k = 0; k < n; ++k) {
                       from[k] = pictures[first + k].view().row(skip + y).data() + c;
                     }
                     for (std::size_t x = 0; x < count_of(width); ++x) {
                       for (std::size_t k = 0; k < n; ++k) {
                         out[x * n_lights + first + k] = from[k][x * count_of(channels)];
                       }
                     }
                   }
                 }
               });
  return values;
}

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

/// Marks of (rows, width, channels), 1 where the variance is that of a lower bound; empty if
/// there are none.
Image<std::uint8_t> clipped_marks(const Image<float>& variance) {
  const std::span<const float> values = variance.pixels();
  if (std::none_of(values.begin(), values.end(), [](float v) { return v < 0.0F; })) {
    return {};
  }
  Image<std::uint8_t> marks(variance.height(), variance.width(), variance.channels());
  std::transform(values.begin(), values.end(), marks.pixels().begin(),
                 [](float v) { return static_cast<std::uint8_t>(v < 0.0F ? 1 : 0); });
  return marks;
}

/// Marks as variances: -1 where marked, else 0.
Image<float> marks_as_variance(const Image<std::uint8_t>& marks, const Image<float>& like) {
  Image<float> variance(like.height(), like.width(), like.channels());
  if (marks.height() > 0) {
    std::transform(marks.pixels().begin(), marks.pixels().end(), variance.pixels().begin(),
                   [](std::uint8_t mark) { return mark != 0 ? -1.0F : 0.0F; });
  }
  return variance;
}

/// Like interleave(), for sparse marks: lines without one are skipped.
std::vector<std::uint8_t> interleave_marks(const StackDims& shape,
                                           const std::vector<Image<std::uint8_t>>& marks,
                                           int skip, int rows) {
  const auto width = static_cast<std::size_t>(shape.width);
  const auto channels = static_cast<std::size_t>(shape.channels);
  const std::size_t n_lights = marks.size();
  const auto n_rows = static_cast<std::size_t>(rows);
  std::vector<std::uint8_t> out(channels * n_rows * width * n_lights);
  parallel_for(n_rows, 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin * n_lights; i < end * n_lights; ++i) {
      const std::size_t y = i / n_lights;
      const std::size_t k = i % n_lights;
      if (marks[k].height() == 0) {
        continue;
      }
      const auto line = marks[k].view().row(skip + static_cast<int>(y));
      if (std::memchr(line.data(), 1, line.size()) == nullptr) {
        continue;
      }
      for (std::size_t j = 0; j < line.size(); ++j) {
        const std::size_t c = j % channels;
        out[((c * n_rows + y) * width + j / channels) * n_lights + k] = line[j];
      }
    }
  });
  return out;
}

/// The patterns' marks become the lights', and those of a mosaic its colours'.
/// @param shape_of  a pattern's picture before either
std::vector<std::uint8_t> marks_of_lights(const Job& job,
                                          std::vector<Image<std::uint8_t>> marks,
                                          const Image<float>& shape_of, int from, int skip,
                                          int rows) {
  if (std::all_of(marks.begin(), marks.end(), [](const auto& m) { return m.height() == 0; })) {
    return {};
  }
  if (!job.plan.is_single) {
    std::vector<Image<float>> variances;
    variances.reserve(marks.size());
    for (Image<std::uint8_t>& of_pattern : marks) {
      variances.push_back(marks_as_variance(of_pattern, shape_of));
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
        marks[k] =
            clipped_marks(demosaic_variance(marks_as_variance(marks[k], shape_of), bayer));
      }
    }
  });
  return interleave_marks(job.shape, marks, skip, rows);
}

Developer::Rows develop_rows(const Job& job, const Radiometry& radiometry, int y0, int y1,
                             MergeTally& tally) {
  const int height = job.shape.height;
  // The first row read is even, so that the mosaic keeps its phase.
  const int top = std::max(0, y0 - job.margin) / 2 * 2;
  const int from = job.margin > 0 ? top : y0;
  const int to = std::min(height, y1 + job.margin);
  const std::size_t n_groups = job.plan.groups.size();
  std::vector<Image<float>> pictures(n_groups);
  std::vector<Image<float>> variances(job.has_error ? n_groups : 0);
  std::vector<Image<std::uint8_t>> marks(job.marks_clipped ? n_groups : 0);
  std::vector<MergeTally> tallies(n_groups);
  parallel_for(n_groups, 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t g = begin; g < end; ++g) {
      RadianceRows rows = radiometry.measure(
          job.plan.groups[g], {from, to, y0, y1, !job.plan.is_single && job.has_error});
      pictures[g] = std::move(rows.value);
      tallies[g] = std::move(rows.tally);
      if (job.marks_clipped) {
        marks[g] = clipped_marks(rows.variance);
      }
      if (job.has_error) {
        variances[g] = std::move(rows.variance);
      }
    }
  });
  for (const MergeTally& of_group : tallies) {
    tally.add(of_group);
  }
  Developer::Rows band;
  if (job.marks_clipped) {
    band.clipped =
        marks_of_lights(job, std::move(marks), pictures.front(), from, y0 - from, y1 - y0);
  }
  if (!job.plan.is_single) {
    demultiplex_rows(*job.plan.inverse, job.power, job.plate, from, pictures);
    if (job.has_error) {
      demultiplex_errors(job, radiometry, from, pictures, variances);
    }
  }
  const BayerPattern bayer = job.session->info().form.bayer;
  if (job.demosaic != Demosaic::none) {
    parallel_for(pictures.size(), 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t k = begin; k < end; ++k) {
        pictures[k] = demosaic(pictures[k].view(), bayer, job.demosaic);
      }
    });
  }
  band.values = interleave(pictures, y0 - from, y1 - y0);
  pictures.clear();
  if (job.has_error) {
    parallel_for(variances.size(), 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t k = begin; k < end; ++k) {
        if (job.demosaic != Demosaic::none) {
          variances[k] = demosaic_variance(variances[k], bayer);
        }
        for (float& value : variances[k].pixels()) {
          value = value < 0.0F ? -1.0F : std::sqrt(value);
        }
      }
    });
    band.errors = interleave(variances, y0 - from, y1 - y0);
  }
  return band;
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

Developer::Rows Developer::rows(int y0, int y1) {
  HAARLIGHT_EXPECTS(0 <= y0 && y0 < y1 && y1 <= impl_->job.shape.height, "rows of the picture");
  return develop_rows(impl_->job, *impl_->radiometry, y0, y1, impl_->tally);
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
