// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/relit_picture.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "relight/pipeline/display_exposure.h"
#include "relight/pipeline/picture_notes.h"

namespace haarlight::relight {

namespace {

/// How many products may be spent on the sharper bound on dropped terms: a product costs about
/// four times what adding a coefficient to a picture does (0.7 and 0.15 ns on one core), and the
/// pictures save no more than all their additions.
double products_worth(const BasisHeader& header, int n_frames) {
  constexpr double kAdditionsPerProduct = 4.0;
  return n_frames * header.mean_coefficients * header.dims.channels *
         static_cast<double>(header.dims.n_pixels()) / kAdditionsPerProduct;
}

bool can_be_halved(const RelightOptions& options) {
  return options.max_error && options.order == TermOrder::transport &&
         *options.max_error >= kHalfError;
}

}  // namespace

Relighter::Relighter(const BasisFile& basis, const RelighterPlan& plan) : basis_(basis) {
  using Use = RelighterPlan::Use;
  const BasisHeader& header = basis.header();
  const bool is_quantised = header.coding == BasisCoding::quantised;
  if (plan.use == Use::once) {
    return;
  }
  if (plan.use == Use::served && ResidentBasis::bytes_of(basis) <= plan.memory_bytes) {
    resident_.emplace(basis, plan.memory_bytes);
    return;
  }
  PrepareOptions options{.memory_bytes = plan.memory_bytes};
  if (plan.form) {
    is_half_chosen_ = *plan.form == RelightForm::half;
    if (*plan.form != RelightForm::file) {
      options.form = is_half_chosen_ ? PreparedForm::dense : PreparedForm::sparse;
      options.bound_products = 0.0;  // the terms are chosen already
      prepared_.emplace(basis, options);
    }
    return;
  }
  if (is_quantised) {
    if (plan.use == Use::frames) {
      options.form = PreparedForm::sparse;
      const bool drops_terms = plan.has_terms || plan.max_error;
      options.bound_products =
          drops_terms ? std::min(options.bound_products, products_worth(header, plan.n_frames))
                      : 0.0;
      prepared_.emplace(basis, options);
    }
    return;
  }
  options.form = PreparedForm::dense;
  if (plan.use == Use::served && DenseHalf::bytes_of(header.dims) <= plan.memory_bytes) {
    prepared_.emplace(basis, options);
  }
}

std::vector<RelitPicture> Relighter::relight(std::span<const LightWeights> weights,
                                             RelightOptions options) const {
  const bool is_quantised = basis_.header().coding == BasisCoding::quantised;
  const bool wants_half = !is_quantised && (is_half_chosen_ || can_be_halved(options));
  const double max_error = options.max_error.value_or(
      is_half_chosen_ ? std::numeric_limits<double>::infinity() : 0.0);
  if (!is_quantised && options.order == TermOrder::transport) {
    options.max_error.reset();  // all lights are read anyway: all are summed
    options.terms_each.clear();
  }
  if (resident_) {
    return haarlight::relight::relight(*resident_, weights, options);
  }
  if (!prepared_ || (prepared_->form() == PreparedForm::dense && !wants_half)) {
    return haarlight::relight::relight(basis_, weights, options);
  }
  std::vector<RelitPicture> pictures = prepared_->relight(weights, options);
  for (std::size_t i = 0; i < pictures.size(); ++i) {
    if (wants_half && pictures[i].bound.relative_l2 > max_error) {
      pictures[i] = haarlight::relight::relight(basis_, weights[i], options);
    }
  }
  return pictures;
}

std::uint64_t Relighter::bytes() const noexcept {
  return resident_ ? resident_->bytes() : prepared_ ? prepared_->bytes() : 0;
}

const char* Relighter::held() const noexcept {
  if (resident_) {
    return basis_.header().coding == BasisCoding::quantised ? "coefficients" : "floats";
  }
  return prepared_ ? "half floats" : "nothing";
}

bool is_for_display(const std::filesystem::path& name) { return name.extension() == ".png"; }

double relit_exposure(const RelitDisplay& display, const std::filesystem::path& name,
                      const Image<float>& picture) {
  const double factor = std::exp2(display.stops);
  if (!is_for_display(name) || display.exposure) {
    return factor * display.exposure.value_or(1.0);
  }
  return factor * display_exposure(picture.pixels(), kDisplayFraction);
}

PictureNotes relit_notes(const BasisHeader& header, const RelitPicture& relit,
                         const LightWeights& weights, std::optional<double> max_error) {
  PictureNotes notes = notes_of(header);
  add_weights(weights, notes);
  add_error(max_error, relit.bound.relative_l2, notes);
  add_clipped(relit.bound, notes);
  return notes;
}

}  // namespace haarlight::relight
