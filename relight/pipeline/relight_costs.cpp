// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/relight_costs.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/count.h"
#include "core/cpu_time.h"
#include "core/most_threads.h"
#include "relight/basis/light_query.h"
#include "relight/basis/prepared_basis.h"
#include "relight/basis/relight_pilot.h"

namespace haarlight::relight {

namespace {

// Pictures of an animation that the pilot sums; the others' norms follow from theirs.
constexpr std::size_t kMostPiloted = 8;

/// Evenly spaced ones.
std::vector<LightWeights> piloted(std::span<const LightWeights> weights) {
  const std::size_t n = std::min(weights.size(), kMostPiloted);
  std::vector<LightWeights> some;
  some.reserve(n);
  for (std::size_t i = 0; i < n; ++i) {
    some.push_back(weights[i * weights.size() / n]);
  }
  return some;
}

/// Sum of |w_k| ||T_k||: what the norm of a picture is at most.
double most_norm(const BasisFile& basis, const LightWeights& weights) {
  const std::size_t n_lights = count(basis.header().dims.n_lights);
  const int channels = std::max(static_cast<int>(weights.cols()), basis.header().dims.channels);
  double energy = 0.0;
  for (int c = 0; c < channels; ++c) {
    const float* norms = basis.tables().light_norms.data() +
                         (basis.header().dims.channels == 1 ? 0 : count(c)) * n_lights;
    double sum = 0.0;
    for (std::size_t k = 0; k < n_lights; ++k) {
      sum += double{norms[k]} *
             std::abs(weights(static_cast<Eigen::Index>(k), weights.cols() == 1 ? 0 : c));
    }
    energy += sum * sum;
  }
  return std::sqrt(energy);
}

/// The norms of all pictures: those of the pilot are these fractions of the most, the least of
/// which is taken for all where not every picture was piloted.
std::vector<double> norms_of(const BasisFile& basis, std::span<const LightWeights> weights,
                             std::span<const LightWeights> some,
                             std::span<const double> norms) {
  if (some.size() == weights.size()) {
    return {norms.begin(), norms.end()};
  }
  double fraction = 1.0;
  for (std::size_t i = 0; i < some.size(); ++i) {
    const double most = most_norm(basis, some[i]);
    fraction = std::min(fraction, most > 0.0 ? norms[i] / most : 1.0);
  }
  std::vector<double> all;
  all.reserve(weights.size());
  for (const LightWeights& w : weights) {
    all.push_back(fraction * most_norm(basis, w));
  }
  return all;
}

double relative_bound(double error, double norm) {
  return error <= 0.0   ? 0.0
         : norm > error ? error / (norm - error)
                        : std::numeric_limits<double>::infinity();
}

/// An exact file's tiles take the same time each, and its bounds need no norm.
std::vector<int> tiles_for(const BasisFile& basis) {
  return basis.header().coding == BasisCoding::quantised
             ? pilot_tiles(basis)
             : std::vector<int>{basis.n_tiles() / 2};
}

class Costs {
 public:
  Costs(const BasisFile& basis, std::span<const LightWeights> weights,
        const RelightCostPlan& plan)
      : basis_(basis),
        weights_(weights),
        plan_(plan),
        tiles_(tiles_for(basis)),
        some_(piloted(weights)),
        pilot_(pilot_file(basis, some_, tiles_)),
        norms_(norms_of(basis, weights, some_, pilot_.norms)),
        bounds_start_(thread_cpu_seconds()),
        queries_(basis.header(), basis.tables(), basis.name(), weights),
        threads_(std::max(1, std::min(most_threads(), basis.n_tiles()))) {
    if (basis.header().coding == BasisCoding::quantised) {
      for (std::size_t e = 0; e < weights.size(); ++e) {
        dropped_.push_back(queries_.dropped_by_terms(static_cast<int>(e), plan.order));
      }
    }
    bounds_seconds_ = thread_cpu_seconds() - bounds_start_;
  }

  /// The sums will find coefficients, terms and bounds once more.
  [[nodiscard]] std::vector<FormCost> forms() {
    std::vector<FormCost> forms = without_bounds();
    for (FormCost& form : forms) {
      for (std::vector<double>& seconds : form.seconds) {
        for (double& s : seconds) {
          s += bounds_seconds_ / double(weights_.size());
        }
      }
    }
    return forms;
  }

 private:
  [[nodiscard]] std::vector<FormCost> without_bounds() {
    std::vector<FormCost> forms;
    if (basis_.header().coding != BasisCoding::quantised) {
      forms.push_back(exact());
      if (is_half_possible()) {
        forms.push_back(half());
      }
      return forms;
    }
    forms.push_back(terms_from_file());
    if (is_memory_possible()) {
      forms.push_back(terms_in_memory());
    }
    return forms;
  }
  [[nodiscard]] std::size_t shared_by() const {
    return std::clamp<std::size_t>(plan_.at_once, 1, weights_.size());
  }
  [[nodiscard]] bool is_half_possible() const {
    return !plan_.is_in_passing && plan_.may_be_halved && plan_.order == TermOrder::transport &&
           DenseHalf::bytes_of(basis_.header().dims) <= plan_.memory_bytes;
  }
  [[nodiscard]] bool is_memory_possible() const {
    return !plan_.is_in_passing && PreparedBasis::can_hold(basis_, plan_.memory_bytes);
  }

  /// All lights, whatever the terms.
  [[nodiscard]] FormCost exact() const {
    FormCost cost;
    const double each =
        pilot_.cost.summing / double(some_.size()) + pilot_.cost.reading / double(shared_by());
    for (std::size_t e = 0; e < weights_.size(); ++e) {
      cost.seconds.push_back({each / threads_});
      cost.errors.push_back({relative_bound(queries_.coded(e), norms_[e])});
    }
    cost.least_terms = most_terms();
    return cost;
  }

  [[nodiscard]] FormCost half() const {
    const HalfCost found = pilot_half(basis_, some_, tiles_[tiles_.size() / 2]);
    FormCost cost = exact();
    cost.form = RelightForm::half;
    cost.prepare = found.store / threads_;
    for (std::size_t e = 0; e < weights_.size(); ++e) {
      cost.seconds[e] = {found.picture / threads_};
      cost.errors[e][0] += found.error;
    }
    return cost;
  }

  /// The errors of the first K terms, and as many seconds.
  void add_errors(FormCost& cost) {
    cost.least_terms = basis_.header().plate_rank > 0 ? 0 : 1;
    for (std::size_t e = 0; e < weights_.size(); ++e) {
      const double coded = queries_.coded(e);
      std::vector<double> errors = dropped_[e];
      for (double& error : errors) {
        // The picture that is made may lack as much as it drops.
        error = relative_bound(error + coded, std::max(0.0, norms_[e] - error));
      }
      const std::size_t dropped = std::min(count(cost.least_terms), errors.size() - 1);
      errors.erase(errors.begin(), errors.begin() + static_cast<std::ptrdiff_t>(dropped));
      cost.errors.push_back(std::move(errors));
      std::vector<double>& seconds = cost.seconds[e];
      seconds.erase(seconds.begin(), seconds.begin() + static_cast<std::ptrdiff_t>(dropped));
      for (double& s : seconds) {
        s /= threads_;
      }
    }
  }

  [[nodiscard]] FormCost terms_from_file() {
    FormCost cost;
    for (std::size_t e = 0; e < weights_.size(); ++e) {
      cost.seconds.push_back(file_seconds_by_terms(basis_, pilot_.cost, queries_,
                                                   static_cast<int>(e), plan_.order,
                                                   double(shared_by())));
    }
    add_errors(cost);
    return cost;
  }

  [[nodiscard]] FormCost terms_in_memory() {
    FormCost cost;
    cost.form = RelightForm::memory;
    const MemoryCost found = pilot_memory(
        basis_, static_cast<int>(std::min<std::size_t>(weights_.size(), 10000)), tiles_);
    cost.prepare = found.unpack / threads_;
    for (std::size_t e = 0; e < weights_.size(); ++e) {
      cost.seconds.push_back(memory_seconds_by_terms(found, pilot_.cost.picture, queries_,
                                                     static_cast<int>(e), plan_.order));
    }
    add_errors(cost);
    return cost;
  }

  [[nodiscard]] int most_terms() const {
    int most = 0;
    for (const LightQuery& query : queries_.queries()) {
      most = std::max(most, query.terms_all);
    }
    return most;
  }

  const BasisFile& basis_;
  std::span<const LightWeights> weights_;
  const RelightCostPlan& plan_;
  std::vector<int> tiles_;
  std::vector<LightWeights> some_;
  FilePilot pilot_;
  std::vector<double> norms_;  ///< (pictures)
  double bounds_start_;
  LightQueries queries_;
  double threads_;
  std::vector<std::vector<double>> dropped_;  ///< (pictures, terms)
  double bounds_seconds_ = 0.0;
};

}  // namespace

bool costs_less_than_prediction(const BasisFile& basis) {
  return pilot_share(basis, tiles_for(basis)) >= 1.0;
}

std::vector<FormCost> predict_costs(const BasisFile& basis,
                                    std::span<const LightWeights> weights,
                                    const RelightCostPlan& plan) {
  return Costs(basis, weights, plan).forms();
}

}  // namespace haarlight::relight
