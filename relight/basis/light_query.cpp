// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/light_query.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <memory>
#include <numeric>

#include <fmt/format.h>

#include "core/count.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "relight/basis/error_gram.h"
#include "relight/basis/light_basis.h"

namespace haarlight::relight {

namespace {

/// l = H w: the environment in the basis' domain. The basis is orthonormal, so that
/// sum_k w_k T_k = sum_i l_i C_i.
std::vector<double> light_coefficients(const FixedBasis& basis, const Eigen::VectorXd& w) {
  std::vector<double> light(w.data(), w.data() + w.size());
  basis.forward(std::span(light));
  return light;
}

/// Each channel alone, in fixed pieces with eight sums each: the same bits on any number of
/// threads.
std::vector<double> channel_norms(const Image<float>& picture) {
  constexpr std::size_t kPiece = std::size_t{1} << 16U;
  constexpr std::size_t kLanes = 8;
  const std::span<const float> values = picture.pixels();
  const std::size_t channels = count(picture.channels());
  const std::size_t n_pixels = values.size() / channels;
  const std::size_t n_pieces = (n_pixels + kPiece - 1) / kPiece;
  std::vector<double> energies(n_pieces * channels);
  parallel_for(energies.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const std::size_t piece = i / channels;
      const std::size_t size = std::min(kPiece, n_pixels - piece * kPiece);
      const float* from = values.data() + piece * kPiece * channels + i % channels;
      std::array<double, kLanes> sums{};
      for (std::size_t p = 0; p < size; ++p) {
        const double value = from[p * channels];
        sums[p % kLanes] += value * value;
      }
      energies[i] = std::accumulate(sums.begin(), sums.end(), 0.0);
    }
  });
  std::vector<double> norms(channels);
  for (std::size_t i = 0; i < energies.size(); ++i) {
    norms[i % channels] += energies[i];
  }
  std::transform(norms.begin(), norms.end(), norms.begin(),
                 [](double energy) { return std::sqrt(energy); });
  return norms;
}

double norm_of(std::span<const double> parts) {
  double energy = 0.0;
  for (const double part : parts) {
    energy += part * part;
  }
  return std::sqrt(energy);
}

double error_of(const RelightBound& bound) {
  return bound.dropped + bound.coded + bound.rounding;
}

/// For each environment the K terms that it begins with where their bound keeps `max_error`,
/// else the smallest K that does. The first picture gives a lower bound on the whole one's norm:
/// truth >= ||P_K|| - its error's bound.
std::vector<RelitPicture> relight_within(
    LightQueries& queries, double max_error, TermOrder order, std::vector<int> terms,
    const std::function<std::vector<RelitPicture>()>& sum) {
  constexpr int kGrowth = 4;
  const std::size_t n_environments = queries.n_environments();
  std::vector<double> truth(n_environments, 0.0);  // lower bounds on the true pictures' norms
  while (true) {
    queries.keep(terms, order);
    std::vector<RelitPicture> pictures = sum();
    bool is_done = true;
    for (std::size_t e = 0; e < n_environments; ++e) {
      RelightBound& bound = pictures[e].bound;
      const double error = error_of(bound);
      if (std::isfinite(bound.picture_norm)) {
        truth[e] = std::max(truth[e], bound.picture_norm - error);
      }
      if (error > 0.0 && truth[e] > 0.0 && std::isfinite(bound.picture_norm)) {
        bound.relative_l2 = std::min(bound.relative_l2, error / truth[e]);
      }
      if (bound.relative_l2 <= max_error || pictures[e].terms >= pictures[e].terms_all) {
        continue;
      }
      is_done = false;
      const std::optional<int> enough =
          truth[e] > 0.0
              ? queries.terms_within(static_cast<int>(e),
                                     max_error * truth[e] - bound.coded - bound.rounding, order)
              : std::nullopt;
      // Always more terms than before: sums in another order differ in their last bits.
      terms[e] =
          std::max(pictures[e].terms + 1,
                   enough ? *enough : std::min(kGrowth * terms[e], pictures[e].terms_all));
    }
    if (is_done) {
      return pictures;
    }
  }
}

}  // namespace

LightQueries::LightQueries(const BasisHeader& header, const BasisTables& tables,
                           const std::string& name, std::span<const LightWeights> weights,
                           TailBound tail_bound)
    : header_(header),
      tables_(tables),
      tail_bound_(std::move(tail_bound)),
      order_(coefficient_order(header)) {
  const std::shared_ptr<const FixedBasis> basis = make_basis(header);
  for (std::size_t e = 0; e < weights.size(); ++e) {
    const LightWeights& w = weights[e];
    if (w.rows() != header.dims.n_lights) {
      throw Error(fmt::format("{} weights for the basis file's {} lights", w.rows(),
                              header.dims.n_lights),
                  name, "give one weight per light");
    }
    const int colours = static_cast<int>(w.cols());
    HAARLIGHT_EXPECTS(w.allFinite(), "weights are finite");
    if (colours != 1 && header.dims.channels != 1 && colours != header.dims.channels) {
      throw Error(fmt::format("weights of {} colours for a basis file of {} channels", colours,
                              header.dims.channels),
                  name, "give one colour, or as many as the file has channels");
    }
    const int channels = std::max(colours, header.dims.channels);
    out_channels_.push_back(channels);
    for (int c = 0; c < channels; ++c) {
      LightQuery query;
      query.environment = static_cast<int>(e);
      query.out_channel = c;
      query.channel = header.dims.channels == 1 ? 0 : c;
      const Eigen::VectorXd column = w.col(colours == 1 ? 0 : c);
      query.given.assign(column.data(), column.data() + column.size());
      query.light = light_coefficients(*basis, column);
      for (int j = 0; j < header.plate_rank; ++j) {
        const float* vector =
            tables.plate_vectors.data() + count(j) * count(header.dims.n_lights);
        double product = 0.0;
        for (Eigen::Index k = 0; k < column.size(); ++k) {
          product += column[k] * double{vector[k]};
        }
        query.plate.push_back(header.gain_step * product);
      }
      query.coded = coded_bound(query, column);
      count_clipped(column, query);
      query.terms_all = static_cast<int>(rank_terms(query, TermOrder::transport).size());
      query.terms = query.terms_all;
      all_.push_back(std::move(query));
    }
  }
  queries_ = all_;
  rankings_.resize(all_.size());
}

double picture_bound(const PictureBound& bound, std::span<const float> norms,
                     std::span<const double> light, std::span<const int> order, int channel) {
  constexpr double kRounding = 1e-9;  // of these sums: 2^-53 times a few thousand
  const std::size_t n_lights = light.size();
  const std::size_t n_vectors = count(bound.n_vectors);
  const int n_blocks = n_gram_blocks(static_cast<int>(n_lights));
  double sum = 0.0;
  for (int b = 0; b < n_blocks; ++b) {
    const std::size_t begin = count(b) * count(kGramBlock);
    const std::size_t end = std::min(n_lights, begin + count(kGramBlock));
    std::vector<double> x(end - begin);
    double energy = 0.0;
    double size = 0.0;
    for (std::size_t i = begin; i < end; ++i) {
      const std::size_t k = count(order[i]);
      x[i - begin] = double{norms[k]} * light[k];
      energy += x[i - begin] * x[i - begin];
      size += std::abs(light[k]);
    }
    const std::size_t block = count(channel) * count(n_blocks) + count(b);
    double square = double{bound.fractions[block]} * energy;
    for (std::size_t j = 0; j < n_vectors; ++j) {
      const float* v =
          bound.vectors.data() + (count(channel) * n_vectors + j) * n_lights + begin;
      double product = 0.0;
      for (std::size_t i = 0; i < x.size(); ++i) {
        product += double{v[i]} * x[i];
      }
      square += product * product;
    }
    sum += std::sqrt(square) + double{bound.rests[block]} * size;
  }
  return sum * (1.0 + kRounding);
}

/// Which part of the light in use was clipped.
void LightQueries::count_clipped(const Eigen::VectorXd& w, LightQuery& query) const {
  const std::size_t start = count(query.channel) * query.given.size();
  const auto n_pixels = static_cast<double>(header_.dims.n_pixels());
  for (std::size_t k = 0; k < query.given.size(); ++k) {
    const double weight = std::abs(w[static_cast<Eigen::Index>(k)]);
    if (weight > 0.0) {
      query.lit_count += n_pixels;
      if (!tables_.clipped_counts.empty()) {
        query.clipped_count += double{tables_.clipped_counts[start + k]};
        query.clipped += weight * double{tables_.clipped_norms[start + k]};
      }
    }
  }
}

/// The smallest of the bounds on ||sum_k w_k E_k||, E the error of the coded stack: triangle
/// inequality over coefficients, over lights, Cauchy-Schwarz, and the file's bound on how the
/// errors correlate.
double LightQueries::coded_bound(const LightQuery& query, const Eigen::VectorXd& w) const {
  const std::size_t start = count(query.channel) * query.light.size();
  double by_coefficient = 0.0;
  double by_light = 0.0;
  double energy = 0.0;
  for (std::size_t i = 0; i < query.light.size(); ++i) {
    const double light_error = tables_.light_errors[start + i];
    by_coefficient += std::abs(query.light[i]) * double{tables_.coefficient_errors[start + i]};
    by_light += std::abs(w[static_cast<Eigen::Index>(i)]) * light_error;
    energy += light_error * light_error;
  }
  double least = std::min({by_coefficient, by_light, std::sqrt(energy) * w.norm()});
  if (!tables_.coded_bound.is_empty()) {
    least = std::min(
        least,
        picture_bound(tables_.coded_bound,
                      std::span(tables_.coefficient_errors).subspan(start, query.light.size()),
                      query.light, order_, query.channel));
  }
  return least;
}

/// What a term adds to the picture at most: |l_i| ||C_i||.
double LightQueries::reach(const LightQuery& query, int i) const {
  const std::size_t start = count(query.channel) * query.light.size();
  return std::abs(query.light[count(i)]) * double{tables_.coefficient_norms[start + count(i)]};
}

/// Terms in descending order of worth; those that add nothing are left out.
std::vector<int> LightQueries::rank_terms(const LightQuery& query, TermOrder order) const {
  std::vector<double> worth(query.light.size());
  std::vector<int> terms;
  for (std::size_t i = 0; i < worth.size(); ++i) {
    const double most = reach(query, static_cast<int>(i));
    worth[i] = order == TermOrder::transport ? most : std::abs(query.light[i]);
    if (most > 0.0) {
      terms.push_back(static_cast<int>(i));
    }
  }
  std::stable_sort(terms.begin(), terms.end(),
                   [&](int a, int b) { return worth[count(a)] > worth[count(b)]; });
  return terms;
}

/// By the file's bound on how the terms' pictures correlate; from the last term backwards.
void LightQueries::sharpen_tails(const LightQuery& query, Ranking& ranking) const {
  const PictureBound& bound = tables_.term_bound;
  const std::size_t n_lights = query.light.size();
  const std::size_t n_vectors = count(bound.n_vectors);
  const std::size_t n_blocks = count(n_gram_blocks(static_cast<int>(n_lights)));
  const float* vectors = bound.vectors.data() + count(query.channel) * n_vectors * n_lights;
  const float* norms = tables_.coefficient_norms.data() + count(query.channel) * n_lights;
  std::vector<int> indices(n_lights);
  for (std::size_t i = 0; i < n_lights; ++i) {
    indices[count(order_[i])] = static_cast<int>(i);
  }
  std::vector<double> products(n_blocks * n_vectors);
  std::vector<double> energies(n_blocks);
  std::vector<double> parts(n_blocks);
  for (std::size_t r = ranking.terms.size(); r-- > 0;) {
    const std::size_t k = count(ranking.terms[r]);
    const std::size_t index = count(indices[k]);
    const std::size_t b = index / count(kGramBlock);
    const double x = double{norms[k]} * query.light[k];
    energies[b] += x * x;
    double square = double{bound.fractions[count(query.channel) * n_blocks + b]} * energies[b];
    for (std::size_t j = 0; j < n_vectors; ++j) {
      double& product = products[b * n_vectors + j];
      product += double{vectors[j * n_lights + index]} * x;
      square += product * product;
    }
    parts[b] = std::sqrt(square) * (1.0 + 1e-9);  // these sums' rounding
    ranking.tails[r] =
        std::min(ranking.tails[r], std::accumulate(parts.begin(), parts.end(), 0.0));
  }
}

const LightQueries::Ranking& LightQueries::ranking(std::size_t q, TermOrder order) {
  std::optional<Ranking>& kept = rankings_[q];
  if (kept && kept->order == order) {
    return *kept;
  }
  const LightQuery& query = all_[q];
  Ranking ranking{order, rank_terms(query, order), {}};
  ranking.tails.assign(ranking.terms.size() + 1, 0.0);
  for (std::size_t r = ranking.terms.size(); r-- > 0;) {
    ranking.tails[r] = ranking.tails[r + 1] + reach(query, ranking.terms[r]);
  }
  if (tail_bound_) {
    const std::vector<double> sharper = tail_bound_(query, ranking.terms);
    std::transform(sharper.begin(), sharper.end(), ranking.tails.begin(), ranking.tails.begin(),
                   [](double a, double b) { return std::min(a, b); });
  } else if (!tables_.term_bound.is_empty()) {
    sharpen_tails(query, ranking);
  }
  kept = std::move(ranking);
  return *kept;
}

void LightQueries::keep(const std::vector<int>& terms, TermOrder order) {
  queries_ = all_;
  for (std::size_t q = 0; q < queries_.size(); ++q) {
    LightQuery& query = queries_[q];
    if (terms[count(query.environment)] >= query.terms_all) {
      continue;  // all of them: nothing to rank
    }
    const Ranking& ranked = ranking(q, order);
    query.terms =
        std::min(terms[count(query.environment)], static_cast<int>(ranked.terms.size()));
    query.dropped = ranked.tails[count(query.terms)];
    for (std::size_t r = count(query.terms); r < ranked.terms.size(); ++r) {
      query.light[count(ranked.terms[r])] = 0.0;
    }
  }
}

std::vector<double> LightQueries::dropped_by_terms(int environment, TermOrder order) {
  std::vector<double> dropped(1);
  for (std::size_t q = 0; q < all_.size(); ++q) {
    if (all_[q].environment == environment) {
      const std::vector<double>& bounds = ranking(q, order).tails;
      dropped.resize(std::max(dropped.size(), bounds.size()));
      for (std::size_t r = 0; r < bounds.size(); ++r) {
        dropped[r] += bounds[r] * bounds[r];
      }
    }
  }
  std::transform(dropped.begin(), dropped.end(), dropped.begin(),
                 [](double square) { return std::sqrt(square); });
  return dropped;
}

std::optional<int> LightQueries::terms_within(int environment, double allowed,
                                              TermOrder order) {
  if (allowed < 0.0) {
    return std::nullopt;
  }
  const std::vector<double> dropped = dropped_by_terms(environment, order);
  const auto enough = std::find_if(dropped.begin(), dropped.end(),
                                   [allowed](double bound) { return bound <= allowed; });
  return static_cast<int>(enough - dropped.begin());
}

std::vector<RelitPicture> LightQueries::black_pictures(std::vector<RelitPicture> reuse) const {
  std::vector<RelitPicture> pictures(out_channels_.size());
  reuse.resize(pictures.size());
  for (std::size_t e = 0; e < pictures.size(); ++e) {
    Image<float>& old = reuse[e].picture;
    if (old.height() == header_.dims.height && old.width() == header_.dims.width &&
        old.channels() == out_channels_[e]) {
      std::fill(old.pixels().begin(), old.pixels().end(), 0.0F);
      pictures[e].picture = std::move(old);
    } else {
      pictures[e].picture =
          Image<float>(header_.dims.height, header_.dims.width, out_channels_[e]);
    }
  }
  return pictures;
}

double LightQueries::coded(std::size_t environment) const {
  double square = 0.0;
  for (const LightQuery& query : queries_) {
    if (count(query.environment) == environment) {
      square += query.coded * query.coded;
    }
  }
  return std::sqrt(square);
}

void LightQueries::state_clipped(std::size_t environment, RelightBound& bound) const {
  if (!header_.clipped) {
    return;
  }
  double square = 0.0;
  double n_clipped = 0.0;
  double n_lit = 0.0;
  for (const LightQuery& query : all_) {
    if (count(query.environment) == environment) {
      square += query.clipped * query.clipped;
      n_clipped += query.clipped_count;
      n_lit += query.lit_count;
    }
  }
  bound.clipped_fraction = n_lit > 0.0 ? n_clipped / n_lit : 0.0;
  bound.clipped = std::sqrt(square);
}

void LightQueries::add_coded(std::size_t environment, double more, RelightBound& bound) const {
  bound.coded += coded(environment) + more;
  for (const LightQuery& query : all_) {
    if (count(query.environment) == environment) {
      bound.channels[count(query.out_channel)].error += query.coded + more;
    }
  }
  state_clipped(environment, bound);
  set_relative_bound(bound);
}

void LightQueries::finish(std::vector<RelitPicture>& pictures) const {
  std::vector<double> dropped(pictures.size());
  for (const LightQuery& query : queries_) {
    RelitPicture& picture = pictures[count(query.environment)];
    picture.terms = std::max(picture.terms, query.terms);
    picture.terms_all = std::max(picture.terms_all, query.terms_all);
    dropped[count(query.environment)] += query.dropped * query.dropped;
  }
  for (std::size_t e = 0; e < pictures.size(); ++e) {
    RelightBound& bound = pictures[e].bound;
    bound.dropped = std::sqrt(dropped[e]);
    bound.coded = coded(e);
    state_clipped(e, bound);
    const std::vector<double> norms = channel_norms(pictures[e].picture);
    bound.picture_norm = norm_of(norms);
    bound.channels.resize(norms.size());
    for (const LightQuery& query : queries_) {
      if (count(query.environment) == e) {
        const std::size_t c = count(query.out_channel);
        bound.channels[c] = {query.dropped + query.coded, norms[c], 0.0};
      }
    }
    set_relative_bound(bound);
  }
}

namespace {

double relative_bound(double error, double picture_norm) {
  if (!std::isfinite(picture_norm)) {  // beyond the range of floats
    return std::numeric_limits<double>::infinity();
  }
  const double truth = picture_norm - error;
  const double fraction = truth > 0.0 ? error / truth : std::numeric_limits<double>::infinity();
  return error > 0.0 ? fraction : 0.0;
}

}  // namespace

void set_relative_bound(RelightBound& bound) {
  bound.relative_l2 = relative_bound(error_of(bound), bound.picture_norm);
  for (ChannelBound& channel : bound.channels) {
    channel.relative_l2 = relative_bound(channel.error + bound.rounding, channel.picture_norm);
  }
}

std::vector<RelitPicture> relight_as_requested(
    LightQueries& queries, const RelightOptions& options,
    const std::function<std::vector<RelitPicture>()>& sum) {
  HAARLIGHT_EXPECTS(!options.terms || *options.terms >= 0, "a number of terms");
  HAARLIGHT_EXPECTS(!options.terms || !options.max_error, "terms or an error, not both");
  HAARLIGHT_EXPECTS(
      options.terms_each.empty() ||
          (!options.terms && options.terms_each.size() == queries.n_environments()),
      "one number of terms for each picture");
  const std::size_t n = queries.n_environments();
  if (options.max_error) {
    constexpr int kFirst = 16;
    return relight_within(
        queries, *options.max_error, options.order,
        options.terms_each.empty() ? std::vector<int>(n, kFirst) : options.terms_each, sum);
  }
  if (options.terms) {
    queries.keep(std::vector<int>(n, *options.terms), options.order);
  } else if (!options.terms_each.empty()) {
    queries.keep(options.terms_each, options.order);
  }
  return sum();
}

}  // namespace haarlight::relight
