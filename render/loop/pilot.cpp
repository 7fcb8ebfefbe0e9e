// SPDX-License-Identifier: Apache-2.0
#include "render/loop/pilot.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <ctime>
#include <utility>

#include "core/cpu_time.h"
#include "core/parallel.h"
#include "core/random.h"
#include "haarlight/core/error.h"
#include "render/loop/looks.h"
#include "render/sampling/sampler.h"

namespace haarlight::render {

namespace {

using Clock = std::chrono::steady_clock;

constexpr int kSide = 8;               // of a patch
constexpr std::uint32_t kSamples = 2;  // of each of its pixels: rather more pixels than more
constexpr std::size_t kPerRound = 16;  // patches
constexpr std::size_t kFewRounds = 4;  // before which no candidate is given up
constexpr std::size_t kMostRounds = 256;
constexpr double kSure = 2.0;        // standard errors
constexpr double kAlike = 0.1;       // efficiencies that differ by less are alike
constexpr double kWellKnown = 0.1;   // standard error of the logarithm of the samples
constexpr double kLargeShare = 0.1;  // of the variance, in one pixel
constexpr double kToldWell = 0.25;   // standard error of the logarithm of what another tells
constexpr double kUnmet = 1e-3;      // of the light, that a candidate may never meet
constexpr double kDoubtful = 2.0;    // a factor to either side of the samples
constexpr double kHope = 4.0;        // how many times the samples the pilot allows for
/// Of the picture's squares: a smaller variance is rounding. Below any error that can be requested.
constexpr double kRounding = 1e-14;

double process_cpu_seconds() { return static_cast<double>(std::clock()) / CLOCKS_PER_SEC; }

double seconds_since(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

/// The patch that a pixel is in, of a picture so many patches wide, row by row.
std::size_t cell_of(int x, int y, int across) {
  return static_cast<std::size_t>(y / kSide) * static_cast<std::size_t>(across) +
         static_cast<std::size_t>(x / kSide);
}

/// Patches of a picture in an order that is even over it at any time, each once before any again.
class Patches {
 public:
  explicit Patches(const PilotOptions& options)
      : width_(options.width),
        height_(options.height),
        numbers_(SamplerKind::sobol, hash_key(options.seed, kOrderKey), 0, 0),
        is_used_(static_cast<std::size_t>(across()) * static_cast<std::size_t>(down())) {}

  /// How often all of them have been handed out.
  [[nodiscard]] std::size_t pass(std::size_t number) const { return number / size(); }
  [[nodiscard]] std::size_t size() const noexcept { return is_used_.size(); }
  [[nodiscard]] int across() const { return (width_ + kSide - 1) / kSide; }

  const Tile& operator[](std::size_t number) {
    const std::size_t i = number % is_used_.size();
    while (order_.size() <= i) {
      const Eigen::Vector2d at = numbers_.two(next_++, 0);
      const int x = std::min(across() - 1, static_cast<int>(at.x() * across()));
      const int y = std::min(down() - 1, static_cast<int>(at.y() * down()));
      const std::size_t cell = cell_of(kSide * x, kSide * y, across());
      if (is_used_[cell] == 0) {
        is_used_[cell] = 1;
        order_.push_back({.x0 = kSide * x,
                          .y0 = kSide * y,
                          .x1 = std::min(kSide * (x + 1), width_),
                          .y1 = std::min(kSide * (y + 1), height_)});
      }
    }
    return order_[i];
  }

 private:
  static constexpr std::uint64_t kOrderKey = 0x6f72646572;
  [[nodiscard]] int down() const { return (height_ + kSide - 1) / kSide; }

  int width_;
  int height_;
  PixelSamples numbers_;
  std::uint32_t next_ = 0;
  std::vector<std::uint8_t> is_used_;
  std::vector<Tile> order_;
};

/// Adds a pixel's samples. @param values  (samples, channels) of them
void add_pixel(std::span<const double> values, std::size_t channels, PilotPatch& patch) {
  const std::size_t n = values.size() / channels;
  double squared = 0.0;
  double light = 0.0;
  for (std::size_t c = 0; c < channels; ++c) {
    double mean = 0.0;
    for (std::size_t s = 0; s < n; ++s) {
      mean += values[s * channels + c] / static_cast<double>(n);
    }
    light += mean * mean;
    if (c < 3) {
      patch.radiance[static_cast<Eigen::Index>(c)] += mean;
    }
    for (std::size_t s = 0; s < n; ++s) {
      const double off = values[s * channels + c] - mean;
      squared += off * off;
    }
  }
  const double variance = squared / static_cast<double>(n - 1);
  patch.variance += variance + kRounding * light;
  patch.light += light - variance / static_cast<double>(n);
  patch.most_variance = std::max(patch.most_variance, variance);
  ++patch.pixels;
}

/// A patch, and what its samples sent to any pixel of the picture.
struct RenderedPatch {
  PilotPatch patch;
  std::vector<FilmTile::Splat> splats;  ///< of one sample of a pixel: over the picture's pixels
};

/// As many samples as pixels come together, each of which may send to any of them: the mean of a splat's
/// variance over the pixels is that of its squares over the samples, wherever it goes.
void add_splats(std::vector<FilmTile::Splat> splats, double pixels, RenderedPatch& rendered) {
  PilotPatch& patch = rendered.patch;
  for (FilmTile::Splat& splat : splats) {
    splat.value /= pixels;
    const double squares = splat.value.squaredNorm() / kSamples;
    patch.variance += squares;
    patch.most_variance = std::max(patch.most_variance, squares);
    patch.splats += splat.value.sum() / kSamples;
    rendered.splats.push_back(splat);
  }
}

/// @param tells   of others, by its last layer
/// @param pixels  of the picture
RenderedPatch render_patch(const TileRenderer& renderer, const std::vector<FilmLayer>& layers,
                           bool tells, double pixels, const Tile& area, SampleRange samples) {
  RenderedPatch rendered;
  PilotPatch& patch = rendered.patch;
  const auto n_pixels =
      static_cast<std::size_t>(area.width()) * static_cast<std::size_t>(area.height());
  const auto channels = static_cast<std::size_t>(layers.front().channels);
  const std::size_t n = samples.end - samples.first;
  std::vector<double> values(n_pixels * n * channels);  // pixel by pixel
  for (std::uint32_t i = samples.first; i < samples.end; ++i) {
    FilmTile tile(area, layers);
    tile.set_samples(i);
    const double start = thread_cpu_seconds();
    static_cast<void>(renderer.render_tile({.first = i, .end = i + 1}, tile));
    patch.seconds += thread_cpu_seconds() - start;
    const std::span<const double> sums = tile.sums();
    const std::size_t per_pixel = sums.size() / n_pixels;
    for (std::size_t pixel = 0; pixel < n_pixels; ++pixel) {
      std::copy_n(sums.data() + pixel * per_pixel, channels,
                  values.data() + (pixel * n + i - samples.first) * channels);
      if (tells) {
        const double* const told = sums.data() + (pixel + 1) * per_pixel - 2;
        patch.squares_of_others += told[0] / static_cast<double>(n);
        patch.unmet += told[1] / static_cast<double>(n);
      }
    }
    add_splats(tile.take_splats(), pixels, rendered);
  }
  for (std::size_t pixel = 0; pixel < n_pixels; ++pixel) {
    add_pixel(std::span(values).subspan(pixel * n * channels, n * channels), channels, patch);
  }
  return rendered;
}

PilotPatch sum_of(std::span<const PilotPatch> patches) {
  PilotPatch sum;
  for (const PilotPatch& patch : patches) {
    sum.variance += patch.variance;
    sum.light += patch.light;
    sum.seconds += patch.seconds;
    sum.most_variance = std::max(sum.most_variance, patch.most_variance);
    sum.pixels += patch.pixels;
    sum.radiance += patch.radiance;
    sum.splats += patch.splats;
    sum.squares_of_others += patch.squares_of_others;
    sum.unmet += patch.unmet;
  }
  return sum;
}

/// The delete-one jackknife's standard error. @param without  the statistic without patch i
template <class Without>
double jackknife(std::size_t n, const Without& without) {
  if (n < 2) {
    return std::numeric_limits<double>::infinity();
  }
  std::vector<double> found(n);
  double mean = 0.0;
  for (std::size_t i = 0; i < n; ++i) {
    found[i] = without(i);
    mean += found[i] / static_cast<double>(n);
  }
  double squares = 0.0;
  for (const double value : found) {
    squares += (value - mean) * (value - mean);
  }
  const double error = std::sqrt(squares * static_cast<double>(n - 1) / static_cast<double>(n));
  return std::isfinite(error) ? error : std::numeric_limits<double>::infinity();
}

PilotPatch without(const PilotPatch& all, const PilotPatch& one) {
  PilotPatch rest = all;
  rest.variance -= one.variance;
  rest.light -= one.light;
  return rest;
}

/// Of the logarithm of variance / light: what samples_for_unit is uncertain by.
double log_error_of_samples(std::span<const PilotPatch> patches) {
  const PilotPatch all = sum_of(patches);
  return jackknife(patches.size(), [&](std::size_t i) {
    const PilotPatch rest = without(all, patches[i]);
    return std::log(rest.variance / rest.light);
  });
}

/// Patches of one whose samples another tells of, with the variance that this one found.
std::vector<PilotPatch> told_patches(std::span<const PilotPatch> own,
                                     std::span<const PilotPatch> teller) {
  std::vector<PilotPatch> told(own.begin(), own.end());
  told.resize(std::min(own.size(), teller.size()));
  for (std::size_t i = 0; i < told.size(); ++i) {
    told[i].variance = teller[i].squares_of_others - told[i].light;
    told[i].most_variance = 0.0;
  }
  return told;
}

/// Of all light, what others than the teller never meet, beyond doubt; 0 where that is next to nothing.
double unmet_share(std::span<const PilotPatch> teller) {
  const PilotPatch sum = sum_of(teller);
  const auto share = [](double unmet, double radiance, double splats) {
    return unmet / (radiance + splats);
  };
  const double found = share(sum.unmet, sum.radiance.sum(), sum.splats);
  const double error = jackknife(teller.size(), [&](std::size_t i) {
    return share(sum.unmet - teller[i].unmet, sum.radiance.sum() - teller[i].radiance.sum(),
                 sum.splats - teller[i].splats);
  });
  return found - kSure * error > kUnmet ? found : 0.0;
}

/// Splats of a candidate's patches, by where they went.
class Landed {
 public:
  /// @param pixels  of the picture, which is cut into cells of a patch each
  Landed(std::size_t n_cells, double pixels) : pixels_(pixels), cells_(n_cells) {}

  void add(std::span<const FilmTile::Splat> splats, int across) {
    for (const FilmTile::Splat& splat : splats) {
      Cell& cell = cells_.at(cell_of(splat.x, splat.y, across));
      cell.light += splat.value;
      cell.squares += splat.value.squaredNorm();
    }
  }

  /// Their patches with what these show of all splats, even within a patch: what came of some pixels'
  /// samples for the picture's, less the squares that it scatters by.
  [[nodiscard]] std::vector<PilotPatch> on(std::span<const PilotPatch> own) const {
    double n = 0.0;  // samples
    for (const PilotPatch& patch : own) {
      n += kSamples * static_cast<double>(patch.pixels);
    }
    std::vector<PilotPatch> patches(own.begin(), own.end());
    for (PilotPatch& patch : patches) {
      const Cell& cell = cells_[patch.cell];
      const double scale = pixels_ / (n * patch.pixels);
      patch.light += 2.0 * scale * patch.radiance.dot(cell.light) +
                     patch.pixels * scale * scale * (cell.light.squaredNorm() - cell.squares);
    }
    return patches;
  }

 private:
  struct Cell {
    Eigen::Vector3d light = Eigen::Vector3d::Zero();
    double squares = 0.0;
  };
  double pixels_;
  std::vector<Cell> cells_;
};

/// Whether the one's samples have not met light that the other tells of: it is known, and its own
/// variance is beyond doubt smaller, or of few pixels.
bool is_told_better(std::span<const PilotPatch> own, std::span<const PilotPatch> told) {
  const PilotPatch own_sum = sum_of(own.first(told.size()));
  const PilotPatch told_sum = sum_of(told);
  const double logarithm = std::log(told_sum.variance / own_sum.variance);
  const double of_told = jackknife(told.size(), [&](std::size_t i) {
    return std::log(told_sum.variance - told[i].variance);
  });
  const double of_both = jackknife(told.size(), [&](std::size_t i) {
    return std::log((told_sum.variance - told[i].variance) /
                    (own_sum.variance - own[i].variance));
  });
  return of_told < kToldWell && (logarithm - kSure * of_both > 0.0 ||
                                 own_sum.most_variance > kLargeShare * own_sum.variance);
}

class Pilot {
 public:
  Pilot(std::span<const PilotCandidate> candidates, const PilotOptions& options)
      : candidates_(candidates),
        options_(options),
        order_(options),
        patches_(candidates.size()),
        rated_(candidates.size()),
        is_told_(candidates.size()),
        landed_(candidates.size()),
        unmet_(candidates.size()),
        tells_(candidates.size()) {
    for (const PilotCandidate& candidate : candidates) {
      if (candidate.told_by) {
        tells_.at(*candidate.told_by) = 1;
      }
    }
    for (std::size_t i = 0; i < candidates.size(); ++i) {
      const double bias = candidates[i].bias;
      if (bias == 0.0 || 2.0 * bias <= options.relative_l2) {
        renderers_.push_back(candidates[i].make(hash_key(options.seed, kPilotKey)));
        asked_.push_back(i);
        if (candidates[i].layers.front().has_splats) {
          landed_[i].emplace(order_.size(), pixels());
        }
      } else {
        renderers_.push_back(nullptr);
      }
    }
  }

  PilotResult operator()() {
    for (std::size_t round = 0; round < kMostRounds; ++round) {
      const double cpu_before = cpu_seconds_;
      render_round(round);
      rate();
      give_up(round + 1);
      if (is_enough(round + 1, cpu_seconds_ - cpu_before)) {
        break;
      }
    }
    result_.seconds = seconds_since(start_);
    result_.cpu_seconds = process_cpu_seconds() - cpu_start_;
    foretell();
    return std::move(result_);
  }

 private:
  static constexpr std::uint64_t kPilotKey = 0x70696c6f74;  // other samples than the run's

  void render_round(std::size_t round) {
    const std::size_t n = asked_.size();
    std::vector<RenderedPatch> found(kPerRound * n);
    std::vector<Tile> areas;
    std::vector<SampleRange> samples;
    for (std::size_t i = 0; i < kPerRound; ++i) {
      const std::size_t number = round * kPerRound + i;
      areas.push_back(order_[number]);
      const auto first = kSamples * static_cast<std::uint32_t>(order_.pass(number));
      samples.push_back({.first = first, .end = first + kSamples});
    }
    const Clock::time_point start = Clock::now();
    // Candidates in turns: what else the machine does meets all of them.
    parallel_for(found.size(), 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        const std::size_t candidate = asked_[i % n];
        found[i] = render_patch(*renderers_[candidate], candidates_[candidate].layers,
                                tells_[candidate] != 0, pixels(), areas[i / n], samples[i / n]);
      }
    });
    loop_seconds_ += seconds_since(start);
    for (std::size_t i = 0; i < found.size(); ++i) {
      const std::size_t candidate = asked_[i % n];
      PilotPatch& patch = found[i].patch;
      patch.cell = cell_of(areas[i / n].x0, areas[i / n].y0, order_.across());
      patches_[candidate].push_back(patch);
      cpu_seconds_ += patch.seconds;
      if (landed_[candidate]) {
        landed_[candidate]->add(found[i].splats, order_.across());
      }
    }
  }

  /// What is told of light that a candidate's own samples have met too rarely; what splats show.
  void look_beyond_patches() {
    for (std::size_t i = 0; i < candidates_.size(); ++i) {
      rated_[i].clear();
      is_told_[i] = 0;
      if (landed_[i]) {
        rated_[i] = landed_[i]->on(patches_[i]);
      }
      if (candidates_[i].told_by) {
        const std::span<const PilotPatch> teller = patches_[*candidates_[i].told_by];
        std::vector<PilotPatch> told = told_patches(patches_[i], teller);
        if (is_told_better(patches_[i], told)) {
          rated_[i] = std::move(told);
          is_told_[i] = 1;
        }
      }
    }
    for (std::size_t teller = 0; teller < candidates_.size(); ++teller) {
      if (tells_[teller] == 0) {
        continue;
      }
      const double unmet = unmet_share(patches_[teller]);
      for (std::size_t i = 0; i < candidates_.size(); ++i) {
        unmet_[i] = landed_[i] ? 0.0 : unmet;
      }
    }
  }

  /// By which a candidate is rated.
  [[nodiscard]] std::span<const PilotPatch> known_of(std::size_t candidate) const {
    return rated_[candidate].empty() ? patches_[candidate] : rated_[candidate];
  }

  /// The best of those that are better than the first beyond doubt.
  void rate() {
    look_beyond_patches();
    result_.scores.assign(candidates_.size(), {});
    // Of those that meet all light, where there is one: nothing makes good for what is missing.
    const auto meets_all =
        std::ranges::find_if(unmet_, [](double unmet) { return unmet == 0.0; });
    result_.chosen =
        meets_all == unmet_.end() ? 0 : static_cast<std::size_t>(meets_all - unmet_.begin());
    const std::size_t fallback = result_.chosen;
    for (std::size_t i = 0; i < candidates_.size(); ++i) {
      const PilotPatch sum = sum_of(known_of(i));
      if (sum.pixels == 0) {
        continue;
      }
      PilotScore& score = result_.scores[i];
      score.patches = patches_[i].size();
      score.is_told = is_told_[i] != 0;
      score.unmet = unmet_[i];
      score.samples_for_unit =
          sum.light > 0.0 ? sum.variance / sum.light : std::numeric_limits<double>::infinity();
      score.sample_seconds = sum.seconds / (kSamples * static_cast<double>(sum.pixels));
      score.largest_share = sum.variance > 0.0 ? sum.most_variance / sum.variance : 0.0;
      const EfficiencyRatio ratio = efficiency_ratio(known_of(i), known_of(0));
      score.efficiency = std::exp(ratio.logarithm);
      score.log_error = ratio.error;
      const EfficiencyRatio gain = efficiency_ratio(known_of(i), known_of(fallback));
      if (unmet_[i] == 0.0 && gain.logarithm - kSure * gain.error > 0.0 &&
          score.largest_share <= kLargeShare &&
          score.efficiency > result_.scores[result_.chosen].efficiency) {
        result_.chosen = i;
      }
    }
  }

  /// Asks no more what is known to be worse than the chosen one, or as good.
  void give_up(std::size_t rounds) {
    if (rounds < kFewRounds) {
      return;
    }
    std::erase_if(asked_, [this](std::size_t i) {
      if (i == result_.chosen) {
        return false;
      }
      if (unmet_[i] > 0.0) {
        return true;
      }
      const EfficiencyRatio ratio = efficiency_ratio(known_of(i), known_of(result_.chosen));
      return ratio.logarithm + kSure * ratio.error < kAlike;
    });
  }

  [[nodiscard]] bool is_enough(std::size_t rounds, double round_cpu_seconds) const {
    const double log_error = log_error_of_samples(known_of(result_.chosen));
    if (asked_.empty() ||
        (rounds >= kFewRounds && asked_.size() == 1 && log_error < kWellKnown)) {
      return true;
    }
    const double hope = std::min(kHope, std::exp(kSure * log_error));
    const double spent = process_cpu_seconds() - cpu_start_;
    return spent + round_cpu_seconds >
           std::max(options_.free_seconds, options_.share * run_cpu_seconds(hope));
  }

  [[nodiscard]] double pixels() const {
    return static_cast<double>(options_.width) * static_cast<double>(options_.height);
  }
  /// Wall-clock seconds of a CPU second, on the threads that there are.
  [[nodiscard]] double wall_per_cpu() const {
    return cpu_seconds_ > 0.0 ? loop_seconds_ / cpu_seconds_ : 1.0;
  }
  [[nodiscard]] double samples_for_error() const {
    const double error = options_.relative_l2;
    return result_.scores[result_.chosen].samples_for_unit / (error * error);
  }

  /// Of the run by the chosen one: what is foreseen now, with so many times the samples; 0 where
  /// nothing can be.
  [[nodiscard]] double run_cpu_seconds(double hope) const {
    double seconds = options_.seconds / wall_per_cpu();
    if (options_.relative_l2 > 0.0) {
      seconds = std::min(seconds, static_cast<double>(look_after(hope * samples_for_error())) *
                                      pixels() * result_.scores[result_.chosen].sample_seconds);
    }
    return std::isfinite(seconds) ? seconds : 0.0;
  }

  void foretell() {
    const PilotScore& score = result_.scores[result_.chosen];
    const std::span<const PilotPatch> patches = known_of(result_.chosen);
    const PilotPatch sum = sum_of(patches);
    result_.samples = kSamples * static_cast<std::uint64_t>(sum.pixels);
    result_.is_black = sum.light <= 0.0 && sum.variance <= 0.0;
    const double log_error = log_error_of_samples(patches);
    result_.is_doubtful =
        !result_.is_black && (score.largest_share > kLargeShare || score.is_told ||
                              !(kSure * log_error <= std::log(kDoubtful)));
    const double pass_seconds = pixels() * score.sample_seconds * wall_per_cpu();
    if (options_.relative_l2 > 0.0 && std::isfinite(score.samples_for_unit)) {
      const std::uint32_t end = look_after(samples_for_error());
      result_.for_error = PilotPrediction{.samples = samples_for_error(),
                                          .factor = std::exp(kSure * log_error),
                                          .end = end,
                                          .seconds = end * pass_seconds};
    }
    if (std::isfinite(options_.seconds) && std::isfinite(score.samples_for_unit)) {
      const double left = std::max(0.0, options_.seconds - result_.seconds);
      const double n = std::max(2.0, left / pass_seconds);
      result_.error_in_time = std::sqrt(score.samples_for_unit / n);
    }
  }

  std::span<const PilotCandidate> candidates_;
  const PilotOptions& options_;
  Patches order_;
  const Clock::time_point start_ = Clock::now();
  const double cpu_start_ = process_cpu_seconds();
  std::vector<std::unique_ptr<TileRenderer>> renderers_;
  std::vector<std::size_t> asked_;
  std::vector<std::vector<PilotPatch>> patches_;  ///< by candidate; those of all begin alike
  std::vector<std::vector<PilotPatch>> rated_;    ///< by candidate; empty: patches_ are
  std::vector<std::uint8_t> is_told_;             ///< by candidate: PilotScore::is_told
  std::vector<std::optional<Landed>> landed_;     ///< by candidate: with splats
  std::vector<double> unmet_;                     ///< by candidate: PilotScore::unmet
  std::vector<std::uint8_t> tells_;               ///< by candidate: of others
  double cpu_seconds_ = 0.0;                      ///< of the patches
  double loop_seconds_ = 0.0;
  PilotResult result_;
};

}  // namespace

EfficiencyRatio efficiency_ratio(std::span<const PilotPatch> one,
                                 std::span<const PilotPatch> other) {
  const std::size_t n = std::min(one.size(), other.size());
  const PilotPatch a = sum_of(one.first(n));
  const PilotPatch b = sum_of(other.first(n));
  const auto logarithm = [](double variance_a, double seconds_a, double variance_b,
                            double seconds_b) {
    return std::log(variance_b * seconds_b / (variance_a * seconds_a));
  };
  EfficiencyRatio ratio;
  ratio.logarithm = logarithm(a.variance, a.seconds, b.variance, b.seconds);
  if (!std::isfinite(ratio.logarithm)) {  // black so far
    return {.logarithm = 0.0, .error = std::numeric_limits<double>::infinity()};
  }
  ratio.error = jackknife(n, [&](std::size_t i) {
    return logarithm(a.variance - one[i].variance, a.seconds - one[i].seconds,
                     b.variance - other[i].variance, b.seconds - other[i].seconds);
  });
  return ratio;
}

PilotResult run_pilot(std::span<const PilotCandidate> candidates, const PilotOptions& options) {
  HAARLIGHT_EXPECTS(!candidates.empty() && candidates.front().bias == 0.0,
                    "an unbiased renderer to fall back on");
  HAARLIGHT_EXPECTS(options.width > 0 && options.height > 0, "a picture");
  return Pilot(candidates, options)();
}

}  // namespace haarlight::render
