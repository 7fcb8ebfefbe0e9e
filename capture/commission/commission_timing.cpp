// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include <fmt/format.h>

#include "capture/commission/commission.h"
#include "capture/commission/exposure_verdict.h"
#include "core/order_statistics.h"
#include "haarlight/core/error.h"

namespace haarlight::capture {

namespace {

constexpr double kGolden = 0.6180339887498949;  // distributes any number of steps evenly
constexpr int kReferenceFrames = 12;
constexpr double kMinLevelSigma = 1e-3;   // the light source itself is no steadier
constexpr double kUsable = 0.2;           // of the brightest band: darker ones are not used
constexpr double kHigh = 0.85;            // of white: no bright pixel above
constexpr double kShortFraction = 0.125;  // the short exposure, of the long one
constexpr double kLongFraction = 0.6;     // the long exposure at most, of the frame period
constexpr double kLinearTol = 0.01;       // of the signal: shortfall when the exposure doubles
constexpr double kBackOff = 0.6;          // of a level that was not linear: try this one next
constexpr double kNearlyDark = 0.2;       // of what is required, with half of the lights left
constexpr int kLinearAttempts = 8;
constexpr double kSureOfSettle = 2.33;  // sigmas: 99 %, one-sided
constexpr double kGoodPhaseUs = 80.0;   // 23 us of uncertainty
constexpr int kMostScans = 4;
constexpr int kMostFineRounds = 5;  // of steps at the short and the long exposure
constexpr double kSlowAck = 4.0;    // times the median until shown: such a step is dropped

double us_between(std::int64_t later, std::int64_t earlier) {
  return static_cast<double>(later - earlier) / 1e3;
}
std::int64_t ns_of(double us) { return static_cast<std::int64_t>(std::llround(us * 1e3)); }

/// A pattern and what the bands show of it, dark and lit, at one exposure.
struct Lamp {
  double exposure_us = 0.0;
  int n = 0;
  LightPattern pattern;
  SteadyLevel dark;
  SteadyLevel lit;
  std::vector<std::size_t> usable;  // bands
  double sigma = kMinLevelSigma;    // of a band's fraction
  double dark_mean = 0.0;           // over the usable bands
  double lit_mean = 0.0;
};

void take_references(CommissionBench& bench, Lamp& lamp) {
  lamp.exposure_us = bench.exposure_us();
  lamp.dark = bench.look_steady({}, kReferenceFrames);
  lamp.lit = bench.look_steady(lamp.pattern, kReferenceFrames);
  double top = 0.0;
  for (std::size_t b = 0; b < lamp.lit.bands.size(); ++b) {
    top = std::max(top, lamp.lit.bands[b] - lamp.dark.bands[b]);
  }
  const double noise = std::max(lamp.lit.frame_scatter, lamp.dark.frame_scatter);
  if (top < 3.0 || top < 8.0 * noise) {
    throw Error(fmt::format("the camera sees no light: {:.1f} counts more with {} lights on",
                            top, lamp.n),
                bench.rig().file.string(),
                "lens cap? a white card or the empty plane in view? exposure_us long enough?");
  }
  lamp.usable.clear();
  lamp.dark_mean = lamp.lit_mean = 0.0;
  double signal = 0.0;
  for (std::size_t b = 0; b < lamp.lit.bands.size(); ++b) {
    const double difference = lamp.lit.bands[b] - lamp.dark.bands[b];
    if (difference >= kUsable * top) {
      lamp.usable.push_back(b);
      signal += difference;
      lamp.dark_mean += lamp.dark.bands[b];
      lamp.lit_mean += lamp.lit.bands[b];
    }
  }
  const auto n = static_cast<double>(lamp.usable.size());
  lamp.dark_mean /= n;
  lamp.lit_mean /= n;
  lamp.sigma = std::max(kMinLevelSigma, noise / (signal / n));
}

/// As many lights as expose the picture well at the bench's exposure, starting with `n`; 1 % of
/// the pixels may be brighter than `high` counts.
Lamp find_lamp(CommissionBench& bench, int n, double high) {
  Lamp lamp;
  lamp.n = std::clamp(n, 1, bench.n_allowed());
  const SteadyLevel dark = bench.look_steady({}, 2);
  std::uint16_t level = firmware_iface::registers::kMaxLevel;
  bool went_down = false;
  int least = 1;  // lights
  int above = 0;  // the number that was too bright
  for (;;) {
    lamp.pattern = bench.brightest(lamp.n);
    for (firmware_iface::ElementLevel& element : lamp.pattern) {
      element.level = level;
    }
    const SteadyLevel lit = bench.look_steady(lamp.pattern, 2);
    const double fraction = (lit.high_level - dark.high_level) / (high - dark.high_level);
    if (lit.high_level > high && (lamp.n > least || level > 4096)) {
      went_down = true;
      if (lamp.n > least) {
        above = lamp.n;
        lamp.n = (lamp.n + 1) / 2;
      } else {
        level /= 2;
      }
    } else if (above > lamp.n && fraction < kNearlyDark) {
      // The remaining ones are dead or dim: the light came from the others.
      lamp.n = least = above;
      level /= 2;
    } else if (!went_down && lamp.n < bench.n_allowed() && fraction < 0.4) {
      lamp.n = std::min(2 * lamp.n, bench.n_allowed());
    } else {
      return lamp;
    }
  }
}

/// How much the brightest of the bands with signal falls short of twice its level at half the
/// exposure, in excess of noise: a saturated sensor gives less.
double shortfall(CommissionBench& bench, const Lamp& lamp) {
  const auto signals = [&](double* exposure_us, double* scatter) {
    const SteadyLevel dark = bench.look_steady({}, kReferenceFrames);
    const SteadyLevel lit = bench.look_steady(lamp.pattern, kReferenceFrames);
    *exposure_us = bench.exposure_us();
    *scatter = std::hypot(dark.frame_scatter, lit.frame_scatter);
    std::vector<double> signal;
    for (std::size_t b = 0; b < lit.bands.size(); ++b) {
      signal.push_back(lit.bands[b] - dark.bands[b]);
    }
    return signal;
  };
  double whole_us = 0.0;
  double half_us = 0.0;
  double whole_scatter = 0.0;
  double half_scatter = 0.0;
  const std::vector<double> whole = signals(&whole_us, &whole_scatter);
  (void)bench.set_exposure(0.5 * whole_us);
  const std::vector<double> half = signals(&half_us, &half_scatter);
  (void)bench.set_exposure(whole_us);
  const double top = *std::max_element(half.begin(), half.end());
  if (top < 3.0 || top < kSureSigmas * half_scatter) {
    return 0.0;  // no light at all: take_references() says so
  }
  // The mean over bands counts too: its noise is far below one band's.
  double worst = 0.0;
  double sum_whole = 0.0;
  double sum_half = 0.0;
  for (std::size_t b = 0; b < whole.size(); ++b) {
    if (half[b] >= kUsable * top && half[b] > 0.0) {
      const double expected = half[b] * whole_us / half_us;
      const double noise = std::hypot(whole_scatter, half_scatter * whole_us / half_us) /
                           std::sqrt(static_cast<double>(kReferenceFrames));
      worst = std::max(worst, (expected - whole[b] - kSureSigmas * noise) / expected);
      sum_whole += whole[b];
      sum_half += expected;
    }
  }
  return std::max(worst, sum_half > 0.0 ? 1.0 - sum_whole / sum_half : 0.0);
}

/// A set of lights to which the sensor responds linearly: it may saturate far below white.
Lamp find_linear_lamp(CommissionBench& bench) {
  double high = kHigh * bench.white();
  for (int attempt = 0; attempt < kLinearAttempts; ++attempt) {
    Lamp lamp = find_lamp(bench, 1, high);
    if (shortfall(bench, lamp) < kLinearTol) {
      return lamp;
    }
    const SteadyLevel lit = bench.look_steady(lamp.pattern, 2);
    high = kBackOff * std::min(high, lit.high_level);
  }
  throw Error("twice the exposure does not give twice the light, however weak the light is",
              bench.rig().file.string(),
              "is automatic exposure or gain on, or a gamma? is the exposure so long that one "
              "light fills the sensor?");
}

/// Switches the lights at requested moments and records what the frames show.
class StepRun {
 public:
  StepRun(CommissionBench& bench, std::vector<StepSample>& samples)
      : bench_(bench), samples_(samples) {}

  /// Dark, with no earlier light change pending.
  void begin(const Lamp& lamp) {
    lamp_ = &lamp;
    is_on_ = false;
    (void)bench_.show({});
    bench_.settle();
  }

  /// @param t_light_ns   requested middle of the latch request
  /// @param horizon_us   frames timestamped later than this after it end the step
  void step(std::int64_t t_light_ns, double horizon_us) {
    bench_.drain_until(t_light_ns - bench_.lead_ns());
    is_on_ = !is_on_;
    const firmware_iface::LatchReceipt receipt =
        bench_.show(is_on_ ? lamp_->pattern : LightPattern{});
    const std::int64_t t_light = (receipt.t_command_ns + receipt.t_ack_ns) / 2;
    const double round_trip = us_between(receipt.t_ack_ns, receipt.t_command_ns);
    round_trips_.push_back(round_trip);
    references_.push_back(us_between(settle_reference_ns(receipt), t_light));
    shown_.push_back(us_between(settle_reference_ns(receipt), receipt.t_command_ns));
    for (;;) {
      const ArrivedFrame arrived = bench_.next_frame();
      const std::int64_t frame_ns = arrived.frame.info().timestamp_ns;
      arrivals_.push_back(us_between(arrived.arrival_ns, frame_ns));
      const double after = us_between(frame_ns, t_light);
      const std::vector<double> means = bench_.band_means(arrived.frame);
      for (const std::size_t b : lamp_->usable) {
        StepSample s;
        s.step = n_steps_;
        s.rises = is_on_;
        s.after_us = after;
        s.jitter_us = std::max(1.0, round_trip / (2.0 * std::sqrt(3.0)));
        s.exposure_us = lamp_->exposure_us;
        s.row = bench_.bands()[b].position;
        s.level =
            (means[b] - lamp_->dark.bands[b]) / (lamp_->lit.bands[b] - lamp_->dark.bands[b]);
        s.sigma = lamp_->sigma;
        samples_.push_back(s);
      }
      if (after > horizon_us) {
        break;
      }
    }
    ++n_steps_;
  }

  /// Steps spread evenly over the frame period, each observed long enough for any timestamp
  /// meaning.
  /// @param first  number of the first, when continuing an earlier scan
  void scan(const Lamp& lamp, int n, int first = 0) {
    begin(lamp);
    const double period = bench_.period_us();
    for (int i = first; i < first + n; ++i) {
      const double phase = std::fmod(i * kGolden, 1.0) * period;
      const std::int64_t soon = bench_.now_ns() + bench_.lead_ns() + 1'000'000;
      const double past = us_between(soon, bench_.last_timestamp_ns());
      const double wait = std::fmod(phase - std::fmod(past, period) + period, period);
      step(soon + ns_of(wait), 3.0 * period + lamp.exposure_us);
    }
  }

  [[nodiscard]] const std::vector<double>& round_trips() const { return round_trips_; }
  /// Per step: from sending to the read-back that shows it; the light switches in between.
  [[nodiscard]] const std::vector<double>& shown() const { return shown_; }
  /// Per step: the moment that captures count from, after t_l.
  [[nodiscard]] const std::vector<double>& references() const { return references_; }
  /// Times from timestamp to host at the current exposure.
  [[nodiscard]] const std::vector<double>& arrivals() const { return arrivals_; }
  void forget_arrivals() { arrivals_.clear(); }

 private:
  CommissionBench& bench_;
  std::vector<StepSample>& samples_;
  const Lamp* lamp_ = nullptr;
  bool is_on_ = false;
  int n_steps_ = 0;
  std::vector<double> arrivals_;
  std::vector<double> round_trips_;
  std::vector<double> references_;
  std::vector<double> shown_;
};

/// Without the steps that were slow to show: they say little, a delay on the way back alone
/// would shift them, and a gateway may have acted long after its acknowledgement.
std::vector<StepSample> prompt_steps(const std::vector<StepSample>& samples,
                                     const std::vector<double>& shown) {
  const double limit = kSlowAck * upper_median(shown);
  std::vector<StepSample> kept;
  for (const StepSample& s : samples) {
    if (shown[static_cast<std::size_t>(s.step)] <= limit) {
      kept.push_back(s);
    }
  }
  return kept;
}

[[noreturn]] void throw_no_steps(const CommissionBench& bench) {
  throw Error("the camera does not see the light change", bench.rig().file.string(),
              "is automatic exposure or gain on? does another program control the lights? are "
              "exposures far shorter than the camera says (exposure_unit_us, "
              "docs/reference/cameras.md)?");
}

/// Exposure switched between two values under steady light; when does it take effect?
class ControlRun {
 public:
  ControlRun(CommissionBench& bench, double slope, const Lamp& one, const Lamp& two)
      : bench_(bench), slope_(slope), one_(one), two_(two) {}

  /// @param n  at least this many trials; up to four times as many while the moment matters and
  /// is known no better than kGoodPhaseUs
  std::vector<ControlTrial> run(int n) {
    (void)bench_.show(one_.pattern);
    (void)bench_.set_exposure(one_.exposure_us);
    bench_.settle();
    reference_ns_ = bench_.last_timestamp_ns() - ns_of(slope_ * one_.exposure_us);
    const double period = bench_.period_us();
    std::vector<ControlTrial> trials;
    bool is_two = false;
    const auto is_known = [&] {
      const auto phase = control_phase(trials, period, period);
      return slope_ == 0.0 || (phase && phase->high_us - phase->low_us < kGoodPhaseUs);
    };
    for (int i = 0; i < n || (i < 4 * n && !is_known()); ++i) {
      is_two = !is_two;
      double wanted = std::fmod(i * kGolden, 1.0) * period;  // reference - moment of setting
      if (i >= 6) {
        if (const auto phase = control_phase(trials, period, period)) {
          // Around the middle: the shortest request on either side narrows it most.
          const double spread = std::max(phase->high_us - phase->low_us, 50.0);
          wanted = phase->value_us() + (std::fmod(i * kGolden, 1.0) - 0.5) * spread;
        }
      }
      const std::int64_t soon = bench_.now_ns() + 1'000'000;
      const double ahead = us_between(soon, reference_ns_) + wanted;
      const std::int64_t target =
          reference_ns_ + ns_of(std::ceil(ahead / period) * period - wanted);
      if (const auto trial = change(is_two ? two_ : one_, is_two ? one_ : two_, target)) {
        trials.push_back(*trial);
      }
    }
    (void)bench_.set_exposure(one_.exposure_us);
    bench_.settle();
    return trials;
  }

 private:
  [[nodiscard]] double mean_level(const Frame& frame) const {
    const std::vector<double> means = bench_.band_means(frame);
    double sum = 0.0;
    for (const std::size_t b : one_.usable) {
      sum += means[b];
    }
    return sum / static_cast<double>(one_.usable.size());
  }

  /// Nothing when a frame was lost just then.
  std::optional<ControlTrial> change(const Lamp& to, const Lamp& from, std::int64_t target_ns) {
    bench_.drain_until(target_ns);
    std::int64_t before = 0;
    std::int64_t after = 0;
    const double set = bench_.set_exposure(to.exposure_us, &before, &after);
    const double threshold = 0.5 * (to.lit_mean + from.lit_mean);
    std::optional<std::uint64_t> last;
    for (int i = 0; i < 60; ++i) {
      const ArrivedFrame arrived = bench_.next_frame();
      const FrameInfo info = arrived.frame.info();
      const bool is_new =
          (mean_level(arrived.frame) > threshold) == (to.lit_mean > from.lit_mean);
      if (is_new) {
        reference_ns_ = info.timestamp_ns - ns_of(slope_ * set);
        if (!last || info.sequence != *last + 1) {
          return std::nullopt;
        }
        return ControlTrial{us_between(before, origin_ns_), us_between(after, origin_ns_),
                            us_between(reference_ns_, origin_ns_)};
      }
      last = info.sequence;
    }
    throw Error("a new exposure does not show in the picture", bench_.spec().device,
                "is automatic exposure on? haarlight rig doctor tells");
  }

  CommissionBench& bench_;
  double slope_;
  const Lamp& one_;
  const Lamp& two_;
  std::int64_t reference_ns_ = 0;
  std::int64_t origin_ns_ = bench_.now_ns();
};

/// The measurement, step after step; each leaves here what later ones need.
class TimingMeasurement {
 public:
  TimingMeasurement(CommissionBench& bench, const CommissionOptions& options)
      : bench_(bench), options_(options), period_(bench.period_us()), run_(bench, samples_) {}

  TimingResult measure() {
    find_light();
    progress(0.1);
    scan_period();
    progress(0.4);
    time_control();
    progress(0.55);
    take_fine_steps();
    StepFit tied = fit_fine_steps();
    while (!is_slope_sure(result_.line.slope_sigma) && n_fine_rounds_ < kMostFineRounds) {
      take_fine_round();
      tied = fit_fine_steps();
    }
    classify(tied);
    find_latest_change(tied);
    progress(1.0);
    return std::move(result_);
  }

 private:
  void progress(double fraction) const {
    if (options_.progress) {
      options_.progress("timing", fraction);
    }
  }

  /// The long exposure and its lights.
  void find_light() {
    // Long: the rig's own exposure, as far as two of them and a step fit.
    const double wanted = std::min(bench_.exposure_us(), kLongFraction * period_);
    if (wanted != bench_.exposure_us()) {
      (void)bench_.set_exposure(wanted);
    }
    full_ = find_linear_lamp(bench_);
    take_references(bench_, full_);
    result_.long_us = full_.exposure_us;
    result_.n_lights = full_.n;
    result_.linear_dn = full_.lit.high_level - full_.dark.high_level;
    result_.count_per_us = (full_.lit.high_level - full_.dark.high_level) /
                           (full_.exposure_us * static_cast<double>(full_.n)) *
                           (static_cast<double>(firmware_iface::registers::kMaxLevel) /
                            static_cast<double>(full_.pattern.front().level));
  }

  [[nodiscard]] std::vector<StepSample> prompt() const {
    return prompt_steps(samples_, run_.shown());
  }

  /// Where in the frame the step falls is unknown: the whole period at two exposures.
  void scan_period() {
    const auto scan_steps = [&](double exposure) {
      return static_cast<int>(std::clamp(std::ceil(8.0 * period_ / exposure), 14.0, 80.0));
    };
    run_.scan(full_, scan_steps(full_.exposure_us));
    arrivals_ = run_.arrivals();
    progress(0.25);
    (void)bench_.set_exposure(0.5 * full_.exposure_us);
    half_ = full_;
    take_references(bench_, half_);
    run_.scan(half_, scan_steps(half_.exposure_us));
    // More steps between those before. Latches that scatter can all miss a short exposure.
    int n_scans = 1;
    const auto scan_again = [&] {
      for (const Lamp* lamp : {&full_, &half_}) {
        (void)bench_.set_exposure(lamp->exposure_us);
        const int n = scan_steps(lamp->exposure_us);
        run_.scan(*lamp, n, n_scans * n);
      }
      ++n_scans;
    };
    // The fine steps tell more anyway: here, only check what may be certain already.
    require_true_exposure(
        {full_.exposure_us, half_.exposure_us, kSureSigmas, bench_.spec().device},
        [&] { return prompt(); }, [&](int) { scan_again(); });
    std::optional<StepFit> coarse = fit_steps(prompt());
    while (!coarse) {
      if (n_scans >= kMostScans) {
        throw_no_steps(bench_);
      }
      scan_again();
      coarse = fit_steps(prompt());
    }
    model_ = coarse->model;
    slope_ = std::round(offset_line(*coarse).slope);
  }

  /// The exposure's own delay.
  void time_control() {
    ControlRun control(bench_, slope_, full_, half_);
    const std::vector<ControlTrial> trials = control.run(options_.control_trials);
    phase_ = control_phase(trials, period_, std::max(100.0, 0.01 * period_));
    if (phase_) {
      const int delay =
          static_cast<int>(std::ceil(std::max(0.0, phase_->value_us()) / period_));
      bench_.set_settle_frames(std::max(4, delay + 3));
    }
  }

  /// Fine: steps at chosen phases of a short and of the long exposure.
  void take_fine_steps() {
    (void)bench_.set_exposure(std::max(20.0, kShortFraction * full_.exposure_us));
    bench_.settle();
    // No brighter than what was seen to be linear.
    brief_ = find_lamp(bench_, static_cast<int>(std::ceil(full_.n / kShortFraction)),
                       std::max(full_.lit.high_level, full_.dark.high_level + 3.0));
    take_references(bench_, brief_);
    result_.short_us = brief_.exposure_us;
    take_fine_round();
    require_true_exposure(
        {full_.exposure_us, brief_.exposure_us, kDoubtSigmas, bench_.spec().device},
        [&] { return prompt(); }, [&](int) { take_fine_round(); });
  }

  /// Further steps at both exposures; all of them so far are in result.samples.
  void take_fine_round() {
    step_finely(brief_, n_fine_rounds_);
    run_.forget_arrivals();
    step_finely(full_, n_fine_rounds_);
    ++n_fine_rounds_;
    result_.samples = prompt();
  }

  void step_finely(const Lamp& lamp, int round) {
    (void)bench_.set_exposure(lamp.exposure_us);
    bench_.settle();
    run_.begin(lamp);
    const double e = lamp.exposure_us;
    const double offset = model_.offset_us.back() + slope_ * (e - model_.exposures_us.back());
    const double skew = std::max(0.0, model_.skew_us);
    const double ramp = std::max(model_.rise_us, model_.fall_us);
    for (int i = 0; i < options_.fine_steps; ++i) {
      // The middle row ends its exposure x after the light begins to change.
      const double span = e + std::min(ramp, e) + skew;
      const int pair = (round * options_.fine_steps + i) / 2;  // one switch on, one off
      const double u = std::fmod(pair * kGolden + 0.5 * (i % 2), 1.0);
      const double x = -0.15 * e - 0.5 * skew + u * (span + 0.3 * e);
      const double behind_timestamp = 0.5 * skew + e - offset - x;
      const std::int64_t base = bench_.last_timestamp_ns() + ns_of(behind_timestamp);
      const double late =
          us_between(bench_.now_ns() + bench_.lead_ns() + 1'000'000, base) / period_;
      const std::int64_t target = base + ns_of(std::ceil(std::max(0.0, late)) * period_);
      run_.step(target, offset + ramp + 500.0);
      progress(0.55 + 0.2 * (&lamp == &full_ ? 1.0 : 0.0) +
               0.2 * (i + 1.0) / options_.fine_steps);
    }
  }

  /// Fills result.line and result.fit. @return  with D tied to the line's slope
  StepFit fit_fine_steps() {
    const std::optional<StepFit> free = fit_steps(result_.samples);
    if (!free) {
      throw_no_steps(bench_);
    }
    result_.line = offset_line(*free);
    StepFitOptions fit_options{std::round(result_.line.slope), free->model,
                               delay_scatter(step_delays(result_.samples, free->model))};
    scatter_us_ = fit_options.scatter_us;
    const std::optional<StepFit> tied = fit_steps(result_.samples, fit_options);
    if (!tied) {
      throw_no_steps(bench_);
    }
    result_.fit = *tied;
    fit_options.start = tied->model;
    fit_options.has_own_delays = true;
    if (const std::optional<StepFit> own = fit_steps(result_.samples, fit_options)) {
      result_.fit.model.skew_us = own->model.skew_us;
      // The bands' dark and lit levels are means of kReferenceFrames and the same for every
      // step, so the jackknife cannot see their error: half of each on average, as a slope over
      // rows of standard deviation 1 / sqrt(12).
      const auto n_bands = static_cast<double>(full_.usable.size());
      const double of_levels = full_.exposure_us * full_.sigma /
                               std::sqrt(2.0 * kReferenceFrames) * std::sqrt(12.0 / n_bands);
      result_.fit.skew_sigma_us = std::hypot(own->skew_sigma_us, of_levels);
    }
    return *tied;
  }

  /// Fills result.evidence and what it says of the timestamp's meaning.
  void classify(const StepFit& tied) {
    const double ack = upper_median(run_.round_trips());
    result_.ack_us = {ack, 0.0, static_cast<std::int64_t>(run_.round_trips().size())};
    TimestampEvidence& e = result_.evidence;
    e.slope = result_.line.slope;
    e.slope_sigma = result_.line.slope_sigma;
    e.offset_us = tied.model.offset_us.front() -
                  std::round(result_.line.slope) * tied.model.exposures_us.front();
    // When the latch acts between sending and acknowledgement is unknown.
    e.offset_sigma_us = std::hypot(tied.offset_sigma_us.front(), ack / (2.0 * std::sqrt(3.0)));
    e.skew_us = result_.fit.model.skew_us;
    e.exposure_us = full_.exposure_us;
    arrivals_.insert(arrivals_.end(), run_.arrivals().begin(), run_.arrivals().end());
    std::sort(arrivals_.begin(), arrivals_.end());
    e.arrival_us = arrivals_.front();
    e.arrival_sigma_us = arrivals_[arrivals_.size() / 20] - arrivals_.front();
    e.period_us = period_;
    e.control = phase_;
    e.written_latch_us = bench_.rig().controller.latch_us;
    const std::optional<TimestampVerdict> verdict = classify_timestamp(e);
    if (!verdict) {
      throw Error(
          fmt::format("the timestamp fits none of the three meanings: it moves by {:.3f} +- "
                      "{:.3f} of the exposure",
                      e.slope, e.slope_sigma),
          bench_.spec().device,
          "is automatic exposure on? a timestamp must mean start of exposure, start of "
          "readout or end of frame");
    }
    result_.verdict = *verdict;
  }

  /// The latest light change, counted from where captures count; with this verdict's latch, so
  /// that it matches the read_us of the same file.
  void find_latest_change(const StepFit& tied) {
    double latest = -std::numeric_limits<double>::infinity();
    const std::vector<StepDelay> delays = step_delays(result_.samples, tied.model);
    for (const StepDelay& delay : delays) {
      latest = std::max(
          latest, delay.late_us - run_.references()[static_cast<std::size_t>(delay.step)]);
    }
    // A delay shows half of any extra ramp length. Uniform ramps of width w scatter the delays
    // by w / (4 sqrt 3), and end w / 4 later than the latest delay suggests.
    latest += std::sqrt(3.0) * scatter_us_;
    const double latch_mean = result_.verdict.latch_us.value;
    result_.latch_most_us = {std::max(0.0, latch_mean + (delays.empty() ? 0.0 : latest) +
                                               kSureOfSettle * tied.settle_sigma_us),
                             tied.settle_sigma_us, static_cast<std::int64_t>(delays.size())};
  }

  CommissionBench& bench_;
  const CommissionOptions& options_;
  double period_;
  std::vector<StepSample> samples_;
  StepRun run_;
  TimingResult result_;
  Lamp full_;   // the long exposure
  Lamp half_;   // half of it, with the same lights
  Lamp brief_;  // the short exposure
  int n_fine_rounds_ = 0;
  std::vector<double> arrivals_;
  StepModel model_;     // of the coarse scan
  double slope_ = 0.0;  // of the timestamp's offset over the exposure: -1, 0 or 1
  std::optional<ControlPhase> phase_;
  double scatter_us_ = 0.0;  // of the fine steps' delays
};

}  // namespace

TimingResult measure_timing(CommissionBench& bench, const CommissionOptions& options) {
  return TimingMeasurement(bench, options).measure();
}

}  // namespace haarlight::capture
