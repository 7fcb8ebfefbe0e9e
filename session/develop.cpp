#include "session/develop.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "core/error.h"
#include "core/files.h"
#include "core/image_io.h"
#include "core/log.h"
#include "core/parallel.h"
#include "session/demultiplex.h"
#include "session/exposure_plan.h"

namespace haarlight {

namespace {

namespace fs = std::filesystem;

constexpr std::string_view kRecipe =
    "develop 1";  // part of the cache's key: bump when results change
// A dark pixel is hot when it stands this many robust sigmas above the frame's median and by
// this share of the range: 8 sigma keeps false alarms below one in 10^14 normal pixels.
constexpr double kHotSigmas = 8.0;
constexpr double kHotShare = 0.01;
constexpr double kSigmaPerMad = 1.4826;
constexpr float kDeadShare = 0.02F;  // of the flat's mean: less light than this is a dead pixel

/// Turns stored samples into linear shares of the range: (DN - black) / (white - black), or the
/// sRGB curve undone. Saturated samples are those at or above white.
class Lineariser {
 public:
  Lineariser(const FrameForm& form, Transfer transfer)
      : black_(static_cast<float>(form.black_level)),
        white_(static_cast<float>(form.white_level)),
        is_srgb_(transfer == Transfer::srgb) {
    if (is_srgb_ && form.sample != SampleType::f32) {
      table_.resize(form.sample == SampleType::u8 ? 256U : 65536U);
      for (std::size_t i = 0; i < table_.size(); ++i) {
        table_[i] = linear_from_srgb((static_cast<float>(i) - black_) / (white_ - black_));
      }
    }
  }

  [[nodiscard]] float operator()(float dn) const {
    if (!table_.empty()) {
      return table_[static_cast<std::size_t>(dn)];
    }
    const float share = (dn - black_) / (white_ - black_);
    return is_srgb_ ? linear_from_srgb(share) : share;
  }
  [[nodiscard]] bool is_saturated(float dn) const { return dn >= white_; }

 private:
  float black_;
  float white_;
  bool is_srgb_;
  std::vector<float> table_;
};

/// What is the same for every light: dark and flat pictures as linear shares, and bad pixels.
struct Corrections {
  Image<float> dark;         ///< mean dark minus black, linear share; empty: none
  Image<float> flat;         ///< relative sensitivity, mean 1 a colour; empty: none
  std::vector<bool> is_bad;  ///< a pixel; empty: none
};

Image<float> mean_linear(const Session& session, const std::vector<const FrameRecord*>& frames,
                         const Lineariser& linear) {
  const FrameForm& form = session.info().form;
  Image<float> sum(form.height, form.width, form.channels);
  for (const FrameRecord* frame : frames) {
    const Image<float> rows = session.read_rows(*frame, 0, form.height);
    for (std::size_t i = 0; i < sum.pixels().size(); ++i) {
      sum.pixels()[i] += linear(rows.pixels()[i]) / static_cast<float>(frames.size());
    }
  }
  return sum;
}

int colour_of(const FrameForm& form, int y, int x, int c) {
  return form.bayer == BayerPattern::none ? c : bayer_colour(form.bayer, y, x);
}

void mark_hot(const FrameForm& form, const Image<float>& dark, std::vector<bool>& is_bad) {
  std::vector<float> sorted(dark.pixels().begin(), dark.pixels().end());
  const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2);
  std::nth_element(sorted.begin(), middle, sorted.end());
  const float median = *middle;
  for (float& value : sorted) {
    value = std::abs(value - median);
  }
  std::nth_element(sorted.begin(), middle, sorted.end());
  const double sigma = kSigmaPerMad * *middle;
  const double limit = median + std::max(kHotSigmas * sigma, kHotShare);
  for (std::size_t i = 0; i < dark.pixels().size(); ++i) {
    if (dark.pixels()[i] > limit) {
      is_bad[i / static_cast<std::size_t>(form.channels)] = true;
    }
  }
}

void make_flat(const FrameForm& form, Corrections& corrections) {
  Image<float>& flat = corrections.flat;
  std::array<double, 3> sum{};
  std::array<double, 3> count{};
  const auto for_each = [&](auto visit) {
    std::size_t i = 0;
    for (int y = 0; y < form.height; ++y) {
      for (int x = 0; x < form.width; ++x) {
        for (int c = 0; c < form.channels; ++c, ++i) {
          visit(i, static_cast<std::size_t>(colour_of(form, y, x, c)));
        }
      }
    }
  };
  for_each([&](std::size_t i, std::size_t colour) {
    if (!corrections.dark.is_empty()) {
      flat.pixels()[i] -= corrections.dark.pixels()[i];
    }
    sum[colour] += flat.pixels()[i];
    count[colour] += 1.0;
  });
  for_each([&](std::size_t i, std::size_t colour) {
    const double mean = count[colour] > 0.0 ? sum[colour] / count[colour] : 0.0;
    const float relative = mean > 0.0 ? static_cast<float>(flat.pixels()[i] / mean) : 0.0F;
    const bool is_dead = !(relative > kDeadShare);
    if (is_dead) {
      corrections.is_bad[i / static_cast<std::size_t>(form.channels)] = true;
    }
    flat.pixels()[i] = is_dead ? 1.0F : relative;
  });
}

Corrections make_corrections(const Session& session, const ExposurePlan& plan,
                             const Lineariser& linear) {
  const FrameForm& form = session.info().form;
  Corrections corrections;
  if (plan.dark.empty() && plan.flat.empty()) {
    return corrections;
  }
  corrections.is_bad.assign(
      static_cast<std::size_t>(form.width) * static_cast<std::size_t>(form.height), false);
  if (!plan.dark.empty()) {
    corrections.dark = mean_linear(session, plan.dark, linear);
    mark_hot(form, corrections.dark, corrections.is_bad);
  }
  if (!plan.flat.empty()) {
    corrections.flat = mean_linear(session, plan.flat, linear);
    make_flat(form, corrections);
  }
  const auto n_bad = std::count(corrections.is_bad.begin(), corrections.is_bad.end(), true);
  if (n_bad * 20 > static_cast<std::ptrdiff_t>(corrections.is_bad.size())) {
    throw Error(
        fmt::format("{} of {} pixels are hot in the dark frames or dead in the flat field",
                    n_bad, corrections.is_bad.size()),
        session.folder().string(),
        "take the dark and flat frames again: the cap off, the flat lit evenly");
  }
  if (n_bad == 0) {
    corrections.is_bad.clear();
  }
  return corrections;
}

/// Bad pixels become the median of the good ones of their colour in the 3 x 3 (mosaic: 5 x 5)
/// window. Rows are those from y0 of the picture.
void mend(const FrameForm& form, const Corrections& corrections, int y0, Image<float>& rows) {
  if (corrections.is_bad.empty()) {
    return;
  }
  const auto is_bad = [&](int y, int x) {
    return corrections
        .is_bad[static_cast<std::size_t>(y) * static_cast<std::size_t>(form.width) +
                static_cast<std::size_t>(x)];
  };
  const int step = form.bayer == BayerPattern::none ? 1 : 2;
  const Image<float> before = rows;
  for (int y = 0; y < rows.height(); ++y) {
    for (int x = 0; x < rows.width(); ++x) {
      if (!is_bad(y0 + y, x)) {
        continue;
      }
      for (int c = 0; c < rows.channels(); ++c) {
        std::vector<float> good;
        for (int reach = 1; good.empty() && reach <= 2; ++reach) {
          for (int dy = -reach * step; dy <= reach * step; dy += step) {
            for (int dx = -reach * step; dx <= reach * step; dx += step) {
              const int v = y + dy;
              const int u = x + dx;
              if (v >= 0 && v < rows.height() && u >= 0 && u < rows.width() &&
                  !is_bad(y0 + v, u)) {
                good.push_back(before(v, u, c));
              }
            }
          }
        }
        if (!good.empty()) {
          const auto middle = good.begin() + static_cast<std::ptrdiff_t>(good.size() / 2);
          std::nth_element(good.begin(), middle, good.end());
          rows(y, x, c) = *middle;
        }
      }
    }
  }
}

/// Linear radiance of a group's rows [y0, y1): the exposures merged. With w_i = scale_i, the
/// inverse variance under photon noise, sum(w r) / sum(w) = sum(signal) / sum(scale) over the
/// unsaturated exposures; where all are saturated the shortest one stands.
Image<float> measure_group(const Session& session, const PatternGroup& group,
                           const Lineariser& linear, const Corrections& corrections, int y0,
                           int y1) {
  const FrameForm& form = session.info().form;
  Image<float> signal(y1 - y0, form.width, form.channels);
  const std::size_t n = signal.pixels().size();
  const auto shortest = std::min_element(
      group.frames.begin(), group.frames.end(),
      [](const ScaledFrame& a, const ScaledFrame& b) { return a.scale < b.scale; });
  const std::size_t first = static_cast<std::size_t>(y0) *
                            static_cast<std::size_t>(form.width) *
                            static_cast<std::size_t>(form.channels);
  std::vector<double> scale_sum(n, 0.0);
  std::vector<float> fallback(n, 0.0F);
  const bool is_merged = group.frames.size() > 1;
  for (const ScaledFrame& frame : group.frames) {
    const Image<float> rows = session.read_rows(*frame.frame, y0, y1);
    const bool is_shortest = &frame == &*shortest;
    for (std::size_t i = 0; i < n; ++i) {
      const float dn = rows.pixels()[i];
      if (!std::isfinite(dn)) {
        const std::size_t pixel = i / static_cast<std::size_t>(form.channels);
        const auto width = static_cast<std::size_t>(form.width);
        throw Error(fmt::format("pixel (x {}, y {}) is not a finite number", pixel % width,
                                pixel / width + static_cast<std::size_t>(y0)),
                    (session.folder() / frame.frame->file).string(),
                    "repair or replace this picture and import again");
      }
      float value = linear(dn);
      if (!corrections.dark.is_empty()) {
        value -= corrections.dark.pixels()[first + i];
      }
      if (!corrections.flat.is_empty()) {
        value /= corrections.flat.pixels()[first + i];
      }
      if (is_shortest) {
        fallback[i] = static_cast<float>(value / frame.scale);
      }
      if (!is_merged || !linear.is_saturated(dn)) {
        signal.pixels()[i] += value;
        scale_sum[i] += frame.scale;
      }
    }
  }
  for (std::size_t i = 0; i < n; ++i) {
    signal.pixels()[i] = scale_sum[i] > 0.0
                             ? static_cast<float>(signal.pixels()[i] / scale_sum[i])
                             : fallback[i];
  }
  mend(form, corrections, y0, signal);
  return signal;
}

/// (rows, width, channels) a light -> (channels, rows, width, lights).
std::vector<float> interleave(const std::vector<Image<float>>& pictures, int skip, int rows) {
  const int width = pictures[0].width();
  const int channels = pictures[0].channels();
  const std::size_t n_lights = pictures.size();
  std::vector<float> values(static_cast<std::size_t>(channels) *
                            static_cast<std::size_t>(rows) * static_cast<std::size_t>(width) *
                            n_lights);
  parallel_for(
      static_cast<std::size_t>(channels) * static_cast<std::size_t>(rows), 1,
      [&](std::size_t begin, std::size_t end) {
        for (std::size_t line = begin; line < end; ++line) {
          const int c = static_cast<int>(line) / rows;
          const int y = static_cast<int>(line) % rows;
          float* out = values.data() + line * static_cast<std::size_t>(width) * n_lights;
          for (std::size_t k = 0; k < n_lights; ++k) {
            const Image<float>& picture = pictures[k];
            for (int x = 0; x < width; ++x) {
              out[static_cast<std::size_t>(x) * n_lights + k] = picture(skip + y, x, c);
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
  StackShape shape;
  int margin = 0;
  std::vector<double> power;  ///< of each light, relative
  PlatePixels plate;          ///< for shots that hold less than their lights do
};

/// Rows a band so that raw pictures, demosaiced ones and the band together stay in the budget.
int choose_band_rows(const Job& job, std::uint64_t memory_bytes) {
  const FrameForm& form = job.session->info().form;
  const std::uint64_t n = std::max<std::uint64_t>(
      job.plan.groups.size(), static_cast<std::uint64_t>(job.shape.n_lights));
  const std::uint64_t row = static_cast<std::uint64_t>(form.width) * n * sizeof(float);
  const bool is_mosaic = job.demosaic != Demosaic::none;
  const auto channels = static_cast<std::uint64_t>(job.shape.channels);
  const std::uint64_t raw_copies = job.plan.is_single ? 1 : 2;
  const std::uint64_t a_row = row * (static_cast<std::uint64_t>(form.channels) * raw_copies +
                                     channels + (is_mosaic ? channels : 0));
  const std::uint64_t margins = 2 * static_cast<std::uint64_t>(job.margin) * a_row;
  // Corrections, one frame being read by each thread, and the stack's pages on their way out.
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

std::vector<float> develop_band(const Job& job, const Lineariser& linear,
                                const Corrections& corrections, int i_band) {
  const int height = job.shape.height;
  const int y0 = i_band * job.shape.band_rows;
  const int y1 = std::min(height, y0 + job.shape.band_rows);
  // The first row read is even, so that the mosaic keeps its phase.
  const int top = std::max(0, y0 - job.margin) / 2 * 2;
  const int from = job.margin > 0 ? top : y0;
  const int to = std::min(height, y1 + job.margin);
  std::vector<Image<float>> pictures(job.plan.groups.size());
  parallel_for(pictures.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t g = begin; g < end; ++g) {
      pictures[g] =
          measure_group(*job.session, job.plan.groups[g], linear, corrections, from, to);
    }
  });
  if (!job.plan.is_single) {
    demultiplex_rows(*job.plan.inverse, job.power, job.plate, from, pictures);
  }
  if (job.demosaic != Demosaic::none) {
    const BayerPattern bayer = job.session->info().form.bayer;
    parallel_for(pictures.size(), 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t k = begin; k < end; ++k) {
        pictures[k] = demosaic(pictures[k].view(), bayer, job.demosaic);
      }
    });
  }
  return interleave(pictures, y0 - from, y1 - y0);
}

/// The curve of the samples, an unknown one only under the name that the user gave it.
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
        "capture in a raw format (docs/cameras.md), or name the curve that develop or compress "
        "is to undo: --transfer srgb or --transfer linear");
  }
  return *options.unknown_as;
}

/// Everything that the stack's values depend on.
std::string cache_key(const Session& session, Demosaic method, Transfer transfer,
                      const std::string& plate) {
  SessionInfo info = session.info();
  info.created.clear();
  info.form.transfer = transfer;
  return content_hash(fmt::format("{}\n{}\n{}\n{}", kRecipe, to_string(method), plate,
                                  session_info_to_json(info)));
}

/// A cached stack, or nothing when there is none or it is damaged (then it is made again).
std::unique_ptr<LightStack> open_cached(const fs::path& file) {
  std::error_code ignored;
  if (!fs::exists(file, ignored)) {
    return nullptr;
  }
  try {
    return std::make_unique<LightStack>(LightStack::open(file));
  } catch (const Error& error) {
    log_warning(fmt::format("{}; making it again", error.what()));
    return nullptr;
  }
}

}  // namespace

LightStack develop(const Session& session, const DevelopOptions& options) {
  const FrameForm& form = session.info().form;
  const Transfer transfer = transfer_of(session, options);
  Job job;
  job.session = &session;
  const bool is_mosaic = form.bayer != BayerPattern::none && !options.keep_bayer &&
                         form.width >= 2 && form.height >= 2;
  job.demosaic = is_mosaic ? options.demosaic : Demosaic::none;
  // Only captures that need a plate depend on it.
  const PatternFamily family = session.info().patterns.family;
  const bool may_need_plate = family == PatternFamily::bins || family == PatternFamily::haar ||
                              family == PatternFamily::target;
  const std::string without_plate = options.share_evenly ? "even" : "none";
  const std::string plate_key = !may_need_plate            ? std::string()
                                : options.plate.is_empty() ? without_plate
                                                           : options.plate.key;
  const fs::path folder =
      options.cache_folder.empty() ? session.folder() / "cache" : options.cache_folder;
  const fs::path file = folder / fmt::format("stack-{}.hls", cache_key(session, job.demosaic,
                                                                       transfer, plate_key));
  if (options.use_cache) {
    if (const auto cached = open_cached(file)) {
      return std::move(*cached);
    }
  }
  job.plan = plan_exposures(session);
  job.shape.width = form.width;
  job.shape.height = form.height;
  job.shape.channels = job.demosaic != Demosaic::none ? 3 : form.channels;
  job.shape.n_lights = static_cast<int>(session.info().lights.size());
  const Lineariser linear(form, transfer);
  const Corrections corrections = make_corrections(session, job.plan, linear);
  const bool needs_margin = job.demosaic != Demosaic::none || !corrections.is_bad.empty();
  job.margin = needs_margin ? 2 * kDemosaicMargin : 0;
  job.shape.band_rows = choose_band_rows(job, options.memory_bytes);
  for (const SessionLight& light : session.info().lights) {
    job.power.push_back(light.relative_power);
  }
  if (!job.plan.is_single && job.plan.inverse->needs_plate()) {
    if (options.plate.is_empty() && !options.share_evenly) {
      throw Error(
          fmt::format(
              "{} shots of {} patterns hold less than {} lights: a clean plate must say "
              "how each shot's light is shared out",
              job.plan.groups.size(), to_string(session.info().patterns.family),
              job.power.size()),
          session.folder().string(),
          "develop with a rig that has a [[plane]], or with --plate; --plate even shares alike",
          ExitCode::usage);
    }
    job.plate = options.plate;
  }
  std::error_code error;
  fs::create_directories(folder, error);
  if (error) {
    throw Error("cannot make the cache's folder: " + error.message(), folder.string(),
                "make the session writable, or name another folder for its cache",
                ExitCode::io);
  }
  LightStackWriter writer(file, job.shape);
  Progress progress("develop", static_cast<std::size_t>(job.shape.n_bands()), options.progress);
  for (int i = 0; i < job.shape.n_bands(); ++i) {
    writer.append_band(develop_band(job, linear, corrections, i));
    progress.advance();
  }
  writer.finish();
  return LightStack::open(file);
}

}  // namespace haarlight
