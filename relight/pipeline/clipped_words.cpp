// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/clipped_words.h"

#include <limits>

#include <fmt/format.h>

namespace haarlight::relight {

namespace {

constexpr const char* kNotReported =
    "  what was clipped is not known: the basis file is older than that count; compress the "
    "session again\n";

}  // namespace

std::string clipped_words(const BasisHeader& header) {
  if (!header.clipped || header.clipped->n_values == 0.0) {
    return {};
  }
  return fmt::format(
      "  lower bounds: {:.2g} % of the values were clipped in every exposure, at least "
      "{:.2g} % of the stack's norm; what they lack is in no error above\n",
      100.0 * header.clipped->fraction(header.dims), 100.0 * header.clipped->least_norm);
}

void report_clipped(const BasisHeader& header, Report& report) {
  if (header.clipped) {
    report.add_achieved("clipped_values", static_cast<std::int64_t>(header.clipped->n_values));
    report.add_achieved("clipped_share", header.clipped->fraction(header.dims));
    report.add_achieved("clipped_least_norm", header.clipped->least_norm);
  }
}

PictureClipping picture_clipping(const RelightBound& bound) {
  const double truth = bound.picture_norm - bound.dropped - bound.coded - bound.rounding;
  const double none = bound.clipped > 0.0 ? std::numeric_limits<double>::infinity() : 0.0;
  return {bound.clipped_fraction.value_or(0.0), truth > 0.0 ? bound.clipped / truth : none};
}

std::string clipped_words(const BasisHeader& header, const PictureClipping& clipping) {
  if (!header.clipped) {
    return header.content == BasisContent::plate ? "" : kNotReported;
  }
  if (clipping.fraction == 0.0) {
    return {};
  }
  return fmt::format(
      "  lower bounds: {:.2g} % of the values under these lights were clipped in every "
      "exposure, and that error does not cover them: every 1 % that they lack adds up to "
      "{:.2g} %\n",
      100.0 * clipping.fraction, clipping.relative);
}

void report_clipped(const BasisHeader& header, const PictureClipping& clipping,
                    Report& report) {
  if (header.clipped) {
    report.add_achieved("clipped_share", clipping.fraction);
    report.add_achieved("clipped_relative", clipping.relative);
  }
}

}  // namespace haarlight::relight
