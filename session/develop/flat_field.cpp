// SPDX-License-Identifier: Apache-2.0
#include "session/develop/flat_field.h"

#include <algorithm>
#include <array>
#include <cmath>

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/session/develop/demosaic.h"

namespace haarlight::session {

namespace {

constexpr float kDeadFraction = 0.02F;  // of the mean: a pixel with less light is dead
constexpr double kMostClipped = 1e-3;
constexpr int kDegree = 4;
constexpr int kTerms = (kDegree + 1) * (kDegree + 2) / 2;
using Terms = Eigen::Matrix<double, kTerms, 1>;

/// Calls visit(i, colour, y, x) for every sample.
template <class Visit>
void for_each(const FrameForm& form, Visit visit) {
  std::size_t i = 0;
  for (int y = 0; y < form.height; ++y) {
    for (int x = 0; x < form.width; ++x) {
      for (int c = 0; c < form.channels; ++c, ++i) {
        const int colour =
            form.bayer == BayerPattern::none ? c : bayer_colour(form.bayer, y, x);
        visit(i, static_cast<std::size_t>(colour), y, x);
      }
    }
  }
}

/// The monomials of degree up to 4 in x and y, both from -1 to 1.
Terms terms_at(const FrameForm& form, int y, int x) {
  const double u = (2.0 * x + 1.0) / form.width - 1.0;
  const double v = (2.0 * y + 1.0) / form.height - 1.0;
  Terms terms;
  int i = 0;
  double power_v = 1.0;
  for (int a = 0; a <= kDegree; ++a, power_v *= v) {
    double power = power_v;
    for (int b = 0; a + b <= kDegree; ++b, power *= u) {
      terms[i++] = power;
    }
  }
  return terms;
}

/// Divides out the least-squares polynomial of each colour.
void remove_smooth_part(const FrameForm& form, const BadPixelMap& bad, Image<float>& flat) {
  std::array<Eigen::Matrix<double, kTerms, kTerms>, 3> normal;
  std::array<Terms, 3> right;
  for (std::size_t colour = 0; colour < 3; ++colour) {
    normal[colour].setIdentity();
    normal[colour] *= 1e-9;  // a small picture has fewer pixels than terms
    right[colour].setZero();
  }
  for_each(form, [&](std::size_t i, std::size_t colour, int y, int x) {
    if (!bad.is_bad[i / static_cast<std::size_t>(form.channels)]) {
      const Terms terms = terms_at(form, y, x);
      normal[colour] += terms * terms.transpose();
      right[colour] += terms * static_cast<double>(flat.pixels()[i]);
    }
  });
  std::array<Terms, 3> smooth;
  for (std::size_t colour = 0; colour < 3; ++colour) {
    smooth[colour] = normal[colour].ldlt().solve(right[colour]);
  }
  for_each(form, [&](std::size_t i, std::size_t colour, int y, int x) {
    const double fitted = smooth[colour].dot(terms_at(form, y, x));
    flat.pixels()[i] =
        fitted > 0.0 ? static_cast<float>(flat.pixels()[i] / fitted) : flat.pixels()[i];
  });
}

/// Scales to a mean of 1 over the good pixels of each colour.
void normalise(const FrameForm& form, const BadPixelMap& bad, Image<float>& flat) {
  std::array<double, 3> sum{};
  std::array<double, 3> count{};
  for_each(form, [&](std::size_t i, std::size_t colour, int, int) {
    if (!bad.is_bad[i / static_cast<std::size_t>(form.channels)]) {
      sum[colour] += flat.pixels()[i];
      count[colour] += 1.0;
    }
  });
  for_each(form, [&](std::size_t i, std::size_t colour, int, int) {
    flat.pixels()[i] = sum[colour] > 0.0
                           ? static_cast<float>(flat.pixels()[i] * count[colour] / sum[colour])
                           : 0.0F;
  });
}

}  // namespace

FlatField measure_flat(const Session& session, const std::vector<const FrameRecord*>& frames,
                       const DarkModel& dark, const Lineariser& linear,
                       const SensorResponse& response, FlatKind kind, BadPixelMap& bad) {
  HAARLIGHT_EXPECTS(!frames.empty(), "at least one flat frame");
  const FrameForm& form = session.info().form;
  bad.is_bad.resize(static_cast<std::size_t>(form.width) *
                    static_cast<std::size_t>(form.height));
  FlatField field;
  field.n_frames = static_cast<int>(frames.size());
  field.relative = Image<float>(form.height, form.width, form.channels);
  Image<float>& flat = field.relative;
  std::size_t n_clipped = 0;
  double electrons = 0.0;
  const auto n_samples = static_cast<double>(flat.pixels().size());
  for (const FrameRecord* frame : frames) {
    const Image<float> rows = session.read_rows(*frame, 0, form.height);
    const double level = dark.is_empty() ? 0.0 : dark.level_of(session, *frame);
    double sum = 0.0;
    for (std::size_t i = 0; i < flat.pixels().size(); ++i) {
      const float dn = rows.pixels()[i];
      const float value = linear(dn) - (dark.is_empty() ? 0.0F : dark.at(i, level));
      flat.pixels()[i] += value;
      sum += value;
      n_clipped += linear.is_clipped(dn) ? 1U : 0U;
    }
    electrons += sum / n_samples * response.electrons_per_dn_at(frame->evidence.gain_db);
  }
  const double clipped = static_cast<double>(n_clipped) / (n_samples * field.n_frames);
  if (clipped > kMostClipped) {
    throw Error(fmt::format("{:.2g} of the flat field's samples are clipped", clipped),
                (session.folder() / frames.front()->file).string(),
                "shorten the flat frames' exposure");
  }
  normalise(form, bad, flat);
  for (std::size_t i = 0; i < flat.pixels().size(); ++i) {
    const std::size_t pixel = i / static_cast<std::size_t>(form.channels);
    if (!(flat.pixels()[i] > kDeadFraction) && !bad.is_bad[pixel]) {
      bad.is_bad[pixel] = true;
      ++bad.n_dead;
    }
  }
  if (kind == FlatKind::fine) {
    remove_smooth_part(form, bad, flat);
  }
  normalise(form, bad, flat);
  field.least = 1e300;
  field.greatest = -1e300;
  for (std::size_t i = 0; i < flat.pixels().size(); ++i) {
    if (bad.is_bad[i / static_cast<std::size_t>(form.channels)]) {
      flat.pixels()[i] = 1.0F;
    } else {
      field.least = std::min<double>(field.least, flat.pixels()[i]);
      field.greatest = std::max<double>(field.greatest, flat.pixels()[i]);
    }
  }
  field.relative_variance = response.is_measured && electrons > 0.0 ? 1.0 / electrons : 0.0;
  return field;
}

}  // namespace haarlight::session
