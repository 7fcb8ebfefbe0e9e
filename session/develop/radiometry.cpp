// SPDX-License-Identifier: Apache-2.0
#include "session/develop/radiometry.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <span>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "session/develop/merge_exposures.h"

namespace haarlight::session {

namespace {

using Json = nlohmann::ordered_json;

constexpr int kStrip = 64;  // rows of a TIFF's strip, read at once
// Two exposures are compared where a sample's neighbours predict this signal to noise ratio in
// the shorter, and less than this fraction of the clip level in the longer.
constexpr double kComparedSnr = 10.0;
constexpr double kComparedFraction = 0.7;
constexpr double kSureSigmas = 5.0;  // of the levels' ratio: beyond it is not noise
constexpr double kMovedSigmas = 6.0;

double rounded(double value) {
  constexpr double kDigits = 1e6;
  return std::isfinite(value) && std::abs(value) < 1e9 ? std::round(value * kDigits) / kDigits
                                                       : value;
}

std::vector<const FrameRecord*> frames_of(const Session& session, ShotKind kind) {
  std::vector<const FrameRecord*> frames;
  for (const FrameRecord& frame : session.info().frames) {
    if (session.info().shots[static_cast<std::size_t>(frame.shot)].kind == kind) {
      frames.push_back(&frame);
    }
  }
  return frames;
}

/// Stored samples as floats, to.size() of them.
void widen_samples(SampleType sample, std::span<const std::byte> stored, std::span<float> to) {
  switch (sample) {
    case SampleType::u8:
      widen(std::span(reinterpret_cast<const std::uint8_t*>(stored.data()), to.size()),
            to.data());
      break;
    case SampleType::u16:
      widen(std::span(reinterpret_cast<const std::uint16_t*>(stored.data()), to.size()),
            to.data());
      break;
    case SampleType::f32:
      std::memcpy(to.data(), stored.data(), to.size_bytes());
      break;
  }
}

[[noreturn]] void refuse_sample(const Session& session, const FrameRecord& frame,
                                std::size_t sample, int y0) {
  const FrameForm& form = session.info().form;
  const std::size_t pixel = sample / static_cast<std::size_t>(form.channels);
  const auto width = static_cast<std::size_t>(form.width);
  throw Error(fmt::format("pixel (x {}, y {}) is not a finite number", pixel % width,
                          pixel / width + static_cast<std::size_t>(y0)),
              (session.folder() / frame.file).string(),
              "repair or replace this picture and import again");
}

}  // namespace

std::string RadiometryOptions::key() const {
  return fmt::format("{} {} {} {} {} {} {} {}", has_dark, has_flat, has_drift, to_string(flat),
                     flat_session.string(), bad_pixels == BadPixels::keep, max_drift,
                     max_level_error);
}

void MergeTally::add(const MergeTally& other) {
  n_pixels += other.n_pixels;
  n_saturated += other.n_saturated;
  n_compared += other.n_compared;
  n_moved += other.n_moved;
  for (const auto& [scales, pair] : other.levels) {
    LevelPair& sum = levels[scales];
    sum.sum_longer += pair.sum_longer;
    sum.sum_predicted += pair.sum_predicted;
    sum.var_longer += pair.var_longer;
    sum.var_predicted += pair.var_predicted;
  }
}

double LevelPair::sigma() const {
  return std::sqrt(var_longer + ratio() * ratio() * var_predicted) / sum_predicted;
}

/// Constants of one frame's samples. In steps (DN) where the noise is unknown:
/// electrons_per_step is then 1.
struct Radiometry::Factors {
  double electrons_per_step = 1.0;
  double per_unit = 1.0;    ///< electrons of radiance 1
  double floor = 0.0;       ///< variance without light, electrons^2, the dark model's included
  double dark_floor = 0.0;  ///< of it: the dark model's
  double dark_level = 0.0;
  double drift_sigma = 0.0;
  double scale = 1.0;  ///< exposure and gain: identifies the exposure in the tally
};

Radiometry::Radiometry(const Session& session, const ExposurePlan& plan, Transfer transfer,
                       RadiometryOptions options)
    : session_(&session),
      reader_(session),
      options_(std::move(options)),
      response_(sensor_response(session)),
      linear_(session.info().form, transfer, response_) {
  if (options_.has_dark && !plan.dark.empty()) {
    dark_ = DarkModel(session, plan.dark, linear_, response_);
    mark_hot(dark_.brightest(), linear_.range(), bad_);
  }
  measure_flat_field(plan, transfer);
  if (bad_.n_hot + bad_.n_dead == 0) {
    bad_.is_bad.clear();
  } else {
    require_few_bad(session, bad_);
  }
  if (options_.has_drift && !plan.sentinels.empty()) {
    const auto lit_of = [&](const FrameRecord* frame) {
      return session.info().shots[static_cast<std::size_t>(frame->shot)].lit;
    };
    std::vector<const FrameRecord*> same;
    for (const FrameRecord* frame : plan.sentinels) {
      if (lit_of(frame) == lit_of(plan.sentinels.front())) {
        same.push_back(frame);
      }
    }
    n_ignored_sentinels_ = static_cast<int>(plan.sentinels.size() - same.size());
    drift_ = DriftModel(session, same, dark_, linear_, response_);
    const double drift = std::max(drift_.greatest() - 1.0, 1.0 - drift_.least());
    if (drift > options_.max_drift) {
      throw Error(fmt::format("the sentinel light drifts by {:.1f} % (from {:.4f} to {:.4f} of "
                              "its median brightness), allowed are {:.1f} %",
                              100.0 * drift, drift_.least(), drift_.greatest(),
                              100.0 * options_.max_drift),
                  session.folder().string(),
                  "let the rig warm up and capture again, or allow it with --max-drift");
    }
  }
}

void Radiometry::measure_flat_field(const ExposurePlan& plan, Transfer transfer) {
  if (!options_.has_flat) {
    return;
  }
  if (options_.flat_session.empty()) {
    if (!plan.flat.empty()) {
      flat_ =
          measure_flat(*session_, plan.flat, dark_, linear_, response_, options_.flat, bad_);
    }
    return;
  }
  const Session other = Session::open(options_.flat_session);
  const FrameForm& form = session_->info().form;
  const FrameForm& theirs = other.info().form;
  if (theirs.width != form.width || theirs.height != form.height ||
      theirs.channels != form.channels || theirs.bayer != form.bayer) {
    throw Error(
        fmt::format("flat frames of {} x {} x {} for a session of {} x {} x {}", theirs.width,
                    theirs.height, theirs.channels, form.width, form.height, form.channels),
        options_.flat_session.string(),
        "take the flat frames with this camera and this region of its sensor");
  }
  std::vector<const FrameRecord*> frames = frames_of(other, ShotKind::flat);
  if (frames.empty()) {
    frames = frames_of(other, ShotKind::light);
  }
  if (frames.empty()) {
    throw Error("a flat field session without flat or light frames",
                options_.flat_session.string(), "capture a plan with flats = 16");
  }
  const SensorResponse response = sensor_response(other);
  const Transfer their_transfer = theirs.transfer == form.transfer ? transfer : theirs.transfer;
  const Lineariser linear(theirs, their_transfer, response);
  const std::vector<const FrameRecord*> darks = frames_of(other, ShotKind::dark);
  const DarkModel dark =
      darks.empty() ? DarkModel() : DarkModel(other, darks, linear, response);
  flat_ = measure_flat(other, frames, dark, linear, response, options_.flat, bad_);
}

Radiometry::Factors Radiometry::factors_of(const ScaledFrame& frame) const {
  const double gain_db = frame.frame->evidence.gain_db;
  const DriftGain drift = drift_.at(time_of(*frame.frame));
  Factors factors;
  factors.scale = frame.scale;
  factors.drift_sigma = drift.gain > 0.0 ? drift.sigma / drift.gain : 0.0;
  if (response_.is_measured) {
    factors.electrons_per_step = response_.electrons_per_dn_at(gain_db);
    factors.floor = response_.floor_variance(gain_db);
  }
  factors.per_unit = linear_.range() * factors.electrons_per_step * frame.scale * drift.gain;
  if (!dark_.is_empty()) {
    factors.dark_level = dark_.level_of(*session_, *frame.frame);
    if (response_.is_measured) {
      const double k = factors.electrons_per_step;
      factors.dark_floor = k * k * dark_.variance(factors.dark_level);
      factors.floor += factors.dark_floor + k * std::max(factors.dark_level, 0.0);
    }
  }
  return factors;
}

double Radiometry::step_of(const ScaledFrame& frame) const {
  const Factors factors = factors_of(frame);
  const bool is_alike = session_->info().form.gains.empty();  // every channel has its own
  return linear_.is_linear() && is_alike && factors.per_unit > 0.0
             ? factors.electrons_per_step / factors.per_unit
             : 0.0;
}

/// One row of a strip: samples[i * n_frames + k] is sample i of exposure k, shortest first.
struct Radiometry::StripRow {
  std::span<const ExposureSample> samples;
  std::size_t n_frames = 0;
  std::size_t channels = 1;
};

void Radiometry::compare_levels(const StripRow& row, std::vector<LevelPair>& levels) const {
  const std::size_t m = row.n_frames;
  const std::size_t n = row.samples.size() / m;
  const std::size_t step = 2 * row.channels;  // the same colour, in a mosaic too
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t k = 1; k < m; ++k) {
      const ExposureSample& shorter = row.samples[i * m + k - 1];
      const ExposureSample& longer = row.samples[i * m + k];
      if (shorter.is_clipped() || longer.is_clipped()) {
        continue;
      }
      // What the neighbours see in both exposures: their noise is independent of this sample's.
      double signal = 0.0;
      double per_unit = 0.0;
      for (const std::size_t j : {i - step, i + step}) {
        if (j < n) {  // i - step wraps round at the left edge
          for (const std::size_t e : {k - 1, k}) {
            const ExposureSample& s = row.samples[j * m + e];
            signal += s.electrons;
            per_unit += s.per_unit;
          }
        }
      }
      if (!(per_unit > 0.0)) {
        continue;
      }
      const double radiance = std::max(signal / per_unit, 0.0);
      const double expected = radiance * shorter.per_unit;
      if (expected > kComparedSnr * std::sqrt(expected + shorter.floor) &&
          radiance * longer.per_unit < kComparedFraction * longer.clip) {
        const double scale = longer.per_unit / shorter.per_unit;
        LevelPair& pair = levels[k];
        pair.sum_longer += longer.electrons;
        pair.sum_predicted += shorter.electrons * scale;
        pair.var_longer += radiance * longer.per_unit + longer.floor;
        pair.var_predicted += (expected + shorter.floor) * scale * scale;
      }
    }
  }
}

Image<float> Radiometry::read_rows(const FrameRecord& frame, int y0, int y1) const {
  const FrameForm& form = session_->info().form;
  std::vector<std::byte> stored(reader_.row_bytes() * static_cast<std::size_t>(y1 - y0));
  reader_.read(frame, y0, y1, stored);
  Image<float> rows(y1 - y0, form.width, form.channels);
  widen_samples(form.sample, stored, rows.pixels());
  return rows;
}

void Radiometry::measure_strip(const PatternGroup& group, const Rows& rows, int y0, int y1,
                               RadianceRows& out) const {
  const FrameForm& form = session_->info().form;
  const auto row_samples =
      static_cast<std::size_t>(form.width) * static_cast<std::size_t>(form.channels);
  const std::size_t n = static_cast<std::size_t>(y1 - y0) * row_samples;
  const std::size_t in_picture = static_cast<std::size_t>(y0) * row_samples;
  const std::size_t in_rows = static_cast<std::size_t>(y0 - rows.y0) * row_samples;
  const std::size_t n_frames = group.frames.size();
  std::vector<Factors> factors;
  std::vector<Image<float>> words;
  std::vector<LevelPair> levels(n_frames);
  for (const ScaledFrame& frame : group.frames) {
    factors.push_back(factors_of(frame));
    if (rows.is_combined) {
      factors.back().floor -= factors.back().dark_floor;
    }
    words.push_back(read_rows(*frame.frame, y0, y1));
  }
  std::vector<ExposureSample> row(row_samples * n_frames);
  for (std::size_t i = 0; i < n; ++i) {
    const std::span<ExposureSample> samples =
        std::span(row).subspan(i % row_samples * n_frames, n_frames);
    const std::size_t at = in_picture + i;
    const double gain = form.gains.empty() ? 1.0 : form.gains[i % form.gains.size()];
    const double flat = (flat_.relative.is_empty() ? 1.0 : flat_.relative.pixels()[at]) / gain;
    for (std::size_t k = 0; k < n_frames; ++k) {
      const Factors& f = factors[k];
      const float dn = words[k].pixels()[i];
      if (!std::isfinite(dn)) {
        refuse_sample(*session_, *group.frames[k].frame, i, y0);
      }
      const double dark = dark_.is_empty() ? 0.0 : dark_.at(at, f.dark_level);
      const bool is_clipped = linear_.is_clipped(dn);
      const double clip = (linear_.clip() - dark) * f.electrons_per_step;
      const double electrons = (linear_(dn) - dark) * f.electrons_per_step;
      samples[k] = {is_clipped ? std::max(electrons, clip) : electrons, f.per_unit * flat,
                    f.floor, clip};
    }
    MergedRadiance merged;
    if (n_frames == 1) {
      const ExposureSample& s = samples[0];
      merged.radiance = s.electrons / s.per_unit;
      merged.variance = (std::max(s.electrons, 0.0) + s.floor) / (s.per_unit * s.per_unit);
      merged.is_saturated = s.is_clipped();
    } else {
      merged = response_.is_measured ? merge_exposures(samples) : merge_by_photons(samples);
    }
    out.value.pixels()[in_rows + i] = static_cast<float>(merged.radiance);
    const double common = factors[0].drift_sigma * factors[0].drift_sigma +
                          (rows.is_combined ? 0.0 : flat_.relative_variance);
    out.variance.pixels()[in_rows + i] =
        merged.is_saturated
            ? -1.0F
            : static_cast<float>(merged.variance + merged.radiance * merged.radiance * common);
    const int y = y0 + static_cast<int>(i / row_samples);
    if (y < rows.count_from || y >= rows.count_to) {
      continue;
    }
    MergeTally& tally = out.tally;
    ++tally.n_pixels;
    if (n_frames > 1 && merged.n_used > 1) {
      ++tally.n_compared;
      tally.n_moved +=
          merged.chi_square > kMovedSigmas * kMovedSigmas + merged.n_used ? 1U : 0U;
    }
    if (n_frames > 1 && (i + 1) % row_samples == 0) {
      compare_levels({row, n_frames, static_cast<std::size_t>(form.channels)}, levels);
    }
  }
  for (std::size_t k = 1; k < n_frames; ++k) {
    if (levels[k].sum_predicted > 0.0) {
      LevelPair& pair = out.tally.levels[{factors[k - 1].scale, factors[k].scale}];
      pair.sum_longer += levels[k].sum_longer;
      pair.sum_predicted += levels[k].sum_predicted;
      pair.var_longer += levels[k].var_longer;
      pair.var_predicted += levels[k].var_predicted;
    }
  }
}

/// A row being measured.
struct Radiometry::RowBuffers {
  std::span<const std::byte> stored;
  std::vector<float> dn;
  std::vector<float> linear;
  std::vector<float> dark;
  std::vector<double> flat;
  std::span<float> values;
  std::size_t n_clipped = 0;
  [[nodiscard]] SampleRow samples() const { return {dn, linear, dark, flat}; }
};

void Radiometry::measure_row(const ScaledFrame& frame, int y, const FrameScale& scale,
                             double dark_level, RowBuffers& row) const {
  const FrameForm& form = session_->info().form;
  const std::size_t n = row.values.size();
  row.dn.resize(n);
  widen_samples(form.sample, row.stored, row.dn);
  if (form.sample == SampleType::f32) {
    for (std::size_t i = 0; i < n; ++i) {
      if (!std::isfinite(row.dn[i])) {
        refuse_sample(*session_, *frame.frame, i, y);
      }
    }
  }
  row.linear.resize(n);
  linear_.apply(row.dn, row.linear.data());
  const std::size_t at = static_cast<std::size_t>(y) * n;
  if (!dark_.is_empty()) {
    row.dark.resize(n);
    for (std::size_t i = 0; i < n; ++i) {
      row.dark[i] = dark_.at(at + i, dark_level);
    }
  }
  if (!form.gains.empty() || !flat_.relative.is_empty()) {
    row.flat.resize(n);
    for (std::size_t i = 0; i < n; ++i) {
      const double gain = form.gains.empty() ? 1.0 : form.gains[(at + i) % form.gains.size()];
      row.flat[i] = (flat_.relative.is_empty() ? 1.0 : flat_.relative.pixels()[at + i]) / gain;
    }
  }
  row.n_clipped = radiance_of_row(scale, row.samples(), row.values.data());
}

void Radiometry::measure_single(const ScaledFrame& frame, const Rows& rows,
                                RadianceRows& out) const {
  const FrameForm& form = session_->info().form;
  const Factors factors = factors_of(frame);
  const FrameScale scale{factors.electrons_per_step, factors.per_unit, linear_.clip_dn(),
                         linear_.clip()};
  const std::size_t row_bytes = reader_.row_bytes();
  std::vector<std::byte> stored(row_bytes * static_cast<std::size_t>(rows.y1 - rows.y0));
  reader_.read(*frame.frame, rows.y0, rows.y1, stored);
  RowBuffers row;
  for (int y = rows.y0; y < rows.y1; ++y) {
    const int i = y - rows.y0;
    row.stored = std::span(stored).subspan(row_bytes * static_cast<std::size_t>(i), row_bytes);
    row.values = out.value.view().row(i);
    measure_row(frame, y, scale, factors.dark_level, row);
    if (row.n_clipped > 0) {
      if (out.clipped.is_empty()) {
        out.clipped = Image<std::uint8_t>(rows.y1 - rows.y0, form.width, form.channels);
      }
      mark_clipped(scale, row.samples(), out.clipped.view().row(i).data());
    }
    if (y >= rows.count_from && y < rows.count_to) {
      out.tally.n_pixels += row.values.size();
      out.tally.n_saturated += row.n_clipped;
    }
  }
}

void Radiometry::measure(const PatternGroup& group, const Rows& rows, RadianceRows& out) const {
  const FrameForm& form = session_->info().form;
  const int height = rows.y1 - rows.y0;
  const auto make_room = [&](Image<float>& image) {
    if (image.height() != height || image.width() != form.width ||
        image.channels() != form.channels) {
      image = Image<float>(height, form.width, form.channels);
    }
  };
  make_room(out.value);
  out.clipped = {};
  out.tally = {};
  const bool is_inpainted = !bad_.is_empty() && options_.bad_pixels == BadPixels::inpaint;
  if (group.frames.size() == 1 && !rows.has_variance && !is_inpainted) {
    measure_single(group.frames.front(), rows, out);
    return;
  }
  make_room(out.variance);
  PatternGroup sorted = group;
  std::stable_sort(
      sorted.frames.begin(), sorted.frames.end(),
      [](const ScaledFrame& a, const ScaledFrame& b) { return a.scale < b.scale; });
  for (int y = rows.y0; y < rows.y1;) {
    const int end = std::min(rows.y1, (y / kStrip + 1) * kStrip);
    measure_strip(sorted, rows, y, end, out);
    y = end;
  }
  if (is_inpainted) {
    inpaint(form, bad_, rows.y0, out.value, out.variance);
  }
  for (int y = std::max(rows.y0, rows.count_from); y < std::min(rows.y1, rows.count_to); ++y) {
    for (const float variance : out.variance.view().row(y - rows.y0)) {
      out.tally.n_saturated += variance < 0.0F ? 1U : 0U;
    }
  }
  out.clipped = clipped_marks(out.variance);
}

void Radiometry::expect(const PatternGroup& group, int y0, int y1) const noexcept {
  for (const ScaledFrame& frame : group.frames) {
    reader_.expect(*frame.frame, y0, y1);
  }
}

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

double Radiometry::dark_sigma(const PatternGroup& group) const {
  double sigma = 0.0;
  double longest = 0.0;
  for (const ScaledFrame& frame : group.frames) {
    const Factors factors = factors_of(frame);
    if (factors.scale > longest) {
      longest = factors.scale;
      sigma = std::sqrt(factors.dark_floor) / factors.per_unit;
    }
  }
  return sigma;
}

void Radiometry::require_levels(const MergeTally& tally) const {
  for (const auto& [scales, pair] : tally.levels) {
    const double sigma = response_.is_measured ? pair.sigma() : 0.0;
    if (std::abs(pair.ratio() - 1.0) > options_.max_level_error + kSureSigmas * sigma) {
      throw Error(
          fmt::format("an exposure {:.4g} times longer is {:.4f} +- {:.4f} times as bright as "
                      "the shorter one predicts (allowed: {:.0f} % off)",
                      scales.second / scales.first, pair.ratio(), sigma,
                      100.0 * options_.max_level_error),
          session_->folder().string(),
          "correct the black level, check that the camera takes its exposures on, or allow it "
          "with --max-level-error");
    }
  }
}

std::string Radiometry::record(const MergeTally& tally) const {
  Json json;
  json["noise"] = {{"source", response_.is_measured ? "rig" : "unknown"},
                   {"electrons_per_dn", response_.electrons_per_dn},
                   {"read_e", response_.read_e},
                   {"black_dn", response_.black_dn},
                   {"white_dn", response_.white_dn},
                   {"clip_dn", response_.clip_dn}};
  if (!session_->info().form.gains.empty()) {
    json["gains"] = session_->info().form.gains;
  }
  json["dark"] = {{"frames", dark_.n_frames()}};
  if (!dark_.is_empty()) {
    json["dark"]["exposures"] = dark_.n_exposures();
    json["dark"]["least_level_dn"] = rounded(dark_.least_level());
    json["dark"]["greatest_level_dn"] = rounded(dark_.greatest_level());
    json["dark"]["slope_by_pixel"] = dark_.has_slope();
  }
  json["bad_pixels"] = {
      {"hot", bad_.n_hot},
      {"dead", bad_.n_dead},
      {"made", options_.bad_pixels == BadPixels::inpaint ? "median of neighbours" : "kept"}};
  json["flat"] = {{"frames", flat_.n_frames}};
  if (flat_.n_frames > 0) {
    json["flat"]["kind"] = to_string(options_.flat);
    json["flat"]["from"] = options_.flat_session.string();
    json["flat"]["least"] = rounded(flat_.least);
    json["flat"]["greatest"] = rounded(flat_.greatest);
  }
  json["drift"] = {{"sentinels", drift_.n_sentinels()}, {"ignored", n_ignored_sentinels_}};
  if (!drift_.is_empty()) {
    json["drift"]["least"] = rounded(drift_.least());
    json["drift"]["greatest"] = rounded(drift_.greatest());
    json["drift"]["largest_step"] = rounded(drift_.largest_step());
    json["drift"]["sigma"] = rounded(drift_.largest_sigma());
  }
  const auto fraction = [](std::uint64_t part, std::uint64_t whole) {
    return whole > 0 ? rounded(static_cast<double>(part) / static_cast<double>(whole)) : 0.0;
  };
  Json levels = Json::array();
  for (const auto& [scales, pair] : tally.levels) {
    levels.push_back(
        {{"ratio", rounded(scales.second / scales.first)}, {"level", rounded(pair.ratio())}});
  }
  json["merge"] = {{"weights", response_.is_measured ? "measured noise" : "photon noise"},
                   {"samples", tally.n_pixels},
                   {"saturated_in_all", tally.n_saturated},
                   {"compared", tally.n_compared},
                   {"moved_share", fraction(tally.n_moved, tally.n_compared)},
                   {"levels", std::move(levels)}};
  return json.dump();
}

}  // namespace haarlight::session
