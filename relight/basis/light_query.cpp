#include "relight/basis/light_query.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>

#include <fmt/format.h>

#include "core/error.h"
#include "core/parallel.h"
#include "relight/basis/haar.h"

namespace haarlight {

namespace {

std::size_t count(int n) { return static_cast<std::size_t>(n); }

/// l = H w: the environment in the basis' domain. The Haar basis is orthonormal, so that
/// sum_k w_k T_k = sum_i l_i C_i.
std::vector<double> light_coefficients(const BasisHeader& header, const Eigen::VectorXd& w) {
  std::vector<double> light(w.data(), w.data() + w.size());
  if (header.basis == BasisKind::haar) {
    const std::size_t per_grid = count(header.grid) * count(header.grid);
    for (std::size_t g = 0; g < light.size(); g += per_grid) {
      haar_forward(std::span(light).subspan(g, per_grid), header.grid);
    }
  }
  return light;
}

/// In fixed pieces and eight sums a piece: the same bits on any number of threads.
double norm_of(const Image<float>& picture) {
  constexpr std::size_t kPiece = std::size_t{1} << 16U;
  constexpr std::size_t kLanes = 8;
  const std::span<const float> values = picture.pixels();
  std::vector<double> energies((values.size() + kPiece - 1) / kPiece);
  parallel_for(energies.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t piece = begin; piece < end; ++piece) {
      const std::size_t size = std::min(kPiece, values.size() - piece * kPiece);
      const float* from = values.data() + piece * kPiece;
      std::array<double, kLanes> sums{};
      std::size_t i = 0;
      for (; i + kLanes <= size; i += kLanes) {
        for (std::size_t k = 0; k < kLanes; ++k) {
          sums[k] += double{from[i + k]} * double{from[i + k]};
        }
      }
      for (; i < size; ++i) {
        sums[0] += double{from[i]} * double{from[i]};
      }
      energies[piece] = std::accumulate(sums.begin(), sums.end(), 0.0);
    }
  });
  return std::sqrt(std::accumulate(energies.begin(), energies.end(), 0.0));
}

double error_of(const RelightBound& bound) {
  return bound.dropped + bound.coded + bound.rounding;
}

/// The smallest K for each environment whose bound keeps `max_error`. A picture of few terms
/// first tells how bright the whole one must be at least: truth >= ||P_K|| - its error's bound.
std::vector<RelitPicture> relight_within(
    LightQueries& queries, double max_error, TermOrder order,
    const std::function<std::vector<RelitPicture>()>& sum) {
  constexpr int kFirst = 16;
  constexpr int kGrowth = 4;
  const std::size_t n_environments = queries.n_environments();
  std::vector<double> truth(n_environments, 0.0);  // lower bounds on the true pictures' norms
  std::vector<int> terms(n_environments, kFirst);
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
      // Always more terms than before: sums taken in another order differ in their last bits.
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
    : header_(header), tables_(tables), tail_bound_(std::move(tail_bound)) {
  for (std::size_t e = 0; e < weights.size(); ++e) {
    const LightWeights& w = weights[e];
    if (w.rows() != header.dims.n_lights) {
      throw Error(fmt::format("{} weights for the basis file's {} lights", w.rows(),
                              header.dims.n_lights),
                  name, "give one weight a light");
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
      query.light = light_coefficients(header, column);
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
      query.terms_all = static_cast<int>(rank_terms(query, TermOrder::transport).size());
      query.terms = query.terms_all;
      all_.push_back(std::move(query));
    }
  }
  queries_ = all_;
  rankings_.resize(all_.size());
}

/// The smallest of three bounds on ||sum_k w_k E_k||, E the error of the coded stack: triangle
/// inequality over coefficients, over lights, and Cauchy-Schwarz.
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
  return std::min({by_coefficient, by_light, std::sqrt(energy) * w.norm()});
}

/// What a term adds to the picture at most: |l_i| ||C_i||.
double LightQueries::reach(const LightQuery& query, int i) const {
  const std::size_t start = count(query.channel) * query.light.size();
  return std::abs(query.light[count(i)]) * double{tables_.coefficient_norms[start + count(i)]};
}

/// Terms in the order of their worth; those that add nothing are left out.
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
  }
  kept = std::move(ranking);
  return *kept;
}

void LightQueries::keep(const std::vector<int>& terms, TermOrder order) {
  queries_ = all_;
  for (std::size_t q = 0; q < queries_.size(); ++q) {
    LightQuery& query = queries_[q];
    const Ranking& ranked = ranking(q, order);
    query.terms =
        std::min(terms[count(query.environment)], static_cast<int>(ranked.terms.size()));
    query.dropped = ranked.tails[count(query.terms)];
    for (std::size_t r = count(query.terms); r < ranked.terms.size(); ++r) {
      query.light[count(ranked.terms[r])] = 0.0;
    }
  }
}

std::optional<int> LightQueries::terms_within(int environment, double allowed,
                                              TermOrder order) {
  if (allowed < 0.0) {
    return std::nullopt;
  }
  // squares[K]: what the colours drop when K terms are kept.
  std::vector<double> squares(count(header_.dims.n_lights) + 1);
  for (std::size_t q = 0; q < all_.size(); ++q) {
    if (all_[q].environment == environment) {
      const std::vector<double>& bounds = ranking(q, order).tails;
      for (std::size_t r = 0; r < bounds.size(); ++r) {
        squares[r] += bounds[r] * bounds[r];
      }
    }
  }
  const auto enough = std::find_if(squares.begin(), squares.end(), [allowed](double square) {
    return std::sqrt(square) <= allowed;
  });
  return static_cast<int>(enough - squares.begin());
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
    bound.picture_norm = norm_of(pictures[e].picture);
    set_relative_bound(bound);
  }
}

void set_relative_bound(RelightBound& bound) {
  const double error = error_of(bound);
  const double truth = bound.picture_norm - error;
  if (!std::isfinite(bound.picture_norm)) {  // brighter than floats can tell
    bound.relative_l2 = std::numeric_limits<double>::infinity();
  } else if (error > 0.0) {
    bound.relative_l2 = truth > 0.0 ? error / truth : std::numeric_limits<double>::infinity();
  }
}

std::vector<RelitPicture> relight_as_asked(
    LightQueries& queries, const RelightOptions& options,
    const std::function<std::vector<RelitPicture>()>& sum) {
  HAARLIGHT_EXPECTS(!options.terms || *options.terms >= 0, "a number of terms");
  HAARLIGHT_EXPECTS(!options.terms || !options.max_error, "terms or an error, not both");
  if (options.max_error) {
    return relight_within(queries, *options.max_error, options.order, sum);
  }
  if (options.terms) {
    queries.keep(std::vector<int>(queries.n_environments(), *options.terms), options.order);
  }
  return sum();
}

}  // namespace haarlight
