#include "relight/basis/relight.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include <fmt/format.h>

#include "core/error.h"
#include "core/parallel.h"
#include "relight/basis/haar.h"
#include "relight/basis/tile_plate.h"

namespace haarlight {

namespace {

std::size_t count(int n) { return static_cast<std::size_t>(n); }

/// What one colour of one environment asks of one channel of the file.
struct Query {
  int environment = 0;
  int out_channel = 0;
  int channel = 0;            ///< of the file
  std::vector<double> given;  ///< w_k
  std::vector<double> light;  ///< l_i in light-domain index order; 0 where dropped
  std::vector<double> plate;  ///< (rank): gain step * V_j . w
  double dropped = 0.0;
  double coded = 0.0;
  int terms = 0;
  int terms_all = 0;
};

/// l = H w: the environment in the file's domain. The Haar basis is orthonormal, so that
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

/// The smallest of three bounds on ||sum_k w_k E_k||, E the error of the coded stack: triangle
/// inequality over coefficients, over lights, and Cauchy-Schwarz.
double coded_bound(const BasisFile& basis, const Query& query, const Eigen::VectorXd& w) {
  const BasisTables& tables = basis.tables();
  const std::size_t start = count(query.channel) * query.light.size();
  double by_coefficient = 0.0;
  double by_light = 0.0;
  double energy = 0.0;
  for (std::size_t i = 0; i < query.light.size(); ++i) {
    const double light_error = tables.light_errors[start + i];
    by_coefficient += std::abs(query.light[i]) * double{tables.coefficient_errors[start + i]};
    by_light += std::abs(w[static_cast<Eigen::Index>(i)]) * light_error;
    energy += light_error * light_error;
  }
  return std::min({by_coefficient, by_light, std::sqrt(energy) * w.norm()});
}

/// What a term adds to the picture at most: |l_i| ||C_i||.
double reach(const BasisFile& basis, const Query& query, int i) {
  const std::size_t start = count(query.channel) * query.light.size();
  return std::abs(query.light[count(i)]) *
         double{basis.tables().coefficient_norms[start + count(i)]};
}

/// Terms in the order of their worth; those that add nothing are left out.
std::vector<int> rank_terms(const BasisFile& basis, const Query& query, TermOrder order) {
  std::vector<double> worth(query.light.size());
  std::vector<int> terms;
  for (std::size_t i = 0; i < worth.size(); ++i) {
    const double most = reach(basis, query, static_cast<int>(i));
    worth[i] = order == TermOrder::transport ? most : std::abs(query.light[i]);
    if (most > 0.0) {
      terms.push_back(static_cast<int>(i));
    }
  }
  std::stable_sort(terms.begin(), terms.end(),
                   [&](int a, int b) { return worth[count(a)] > worth[count(b)]; });
  return terms;
}

class Relighting {
 public:
  Relighting(const BasisFile& basis, std::span<const LightWeights> weights);
  /// Keeps the first K terms of every colour, one K an environment.
  void keep(const std::vector<int>& terms, TermOrder order);
  /// The smallest K whose dropped terms are bounded by `allowed`; none when allowed is
  /// negative.
  [[nodiscard]] std::optional<int> terms_within(int environment, double allowed,
                                                TermOrder order) const;
  [[nodiscard]] std::vector<RelitPicture> sum();

 private:
  void sum_tile(int i_tile, std::vector<RelitPicture>& pictures,
                std::vector<std::uint64_t>& bytes) const;
  void sum_quantised(int i_tile, const TileRect& rect, int channel,
                     std::vector<std::vector<double>>& sums) const;
  void sum_lossless(int i_tile, const TileRect& rect, int channel,
                    std::vector<std::vector<double>>& sums) const;
  [[nodiscard]] bool is_group_needed(int channel, int group) const;

  const BasisFile& basis_;
  std::size_t n_environments_;
  std::vector<int> out_channels_;
  std::vector<Query> all_;                             ///< every term
  std::vector<Query> queries_;                         ///< with the terms kept
  std::vector<std::vector<double>> lossless_weights_;  ///< a query: what each light gets
};

Relighting::Relighting(const BasisFile& basis, std::span<const LightWeights> weights)
    : basis_(basis), n_environments_(weights.size()) {
  const BasisHeader& header = basis.header();
  for (std::size_t e = 0; e < weights.size(); ++e) {
    const LightWeights& w = weights[e];
    if (w.rows() != header.dims.n_lights) {
      throw Error(fmt::format("{} weights for the basis file's {} lights", w.rows(),
                              header.dims.n_lights),
                  basis.name(), "give one weight a light");
    }
    const int colours = static_cast<int>(w.cols());
    HAARLIGHT_EXPECTS(w.allFinite(), "weights are finite");
    if (colours != 1 && header.dims.channels != 1 && colours != header.dims.channels) {
      throw Error(fmt::format("weights of {} colours for a basis file of {} channels", colours,
                              header.dims.channels),
                  basis.name(), "give one colour, or as many as the file has channels");
    }
    const int channels = std::max(colours, header.dims.channels);
    out_channels_.push_back(channels);
    for (int c = 0; c < channels; ++c) {
      Query query;
      query.environment = static_cast<int>(e);
      query.out_channel = c;
      query.channel = header.dims.channels == 1 ? 0 : c;
      const Eigen::VectorXd column = w.col(colours == 1 ? 0 : c);
      query.given.assign(column.data(), column.data() + column.size());
      query.light = light_coefficients(header, column);
      for (int j = 0; j < header.plate_rank; ++j) {
        const float* vector =
            basis.tables().plate_vectors.data() + count(j) * count(header.dims.n_lights);
        double product = 0.0;
        for (Eigen::Index k = 0; k < column.size(); ++k) {
          product += column[k] * double{vector[k]};
        }
        query.plate.push_back(header.gain_step * product);
      }
      query.coded = coded_bound(basis, query, column);
      query.terms_all = static_cast<int>(rank_terms(basis, query, TermOrder::transport).size());
      query.terms = query.terms_all;
      all_.push_back(std::move(query));
    }
  }
  queries_ = all_;
}

void Relighting::keep(const std::vector<int>& terms, TermOrder order) {
  queries_ = all_;
  for (Query& query : queries_) {
    const std::vector<int> ranked = rank_terms(basis_, query, order);
    query.terms = std::min(terms[count(query.environment)], static_cast<int>(ranked.size()));
    for (std::size_t r = count(query.terms); r < ranked.size(); ++r) {
      query.dropped += reach(basis_, query, ranked[r]);
      query.light[count(ranked[r])] = 0.0;
    }
  }
}

std::optional<int> Relighting::terms_within(int environment, double allowed,
                                            TermOrder order) const {
  if (allowed < 0.0) {
    return std::nullopt;
  }
  // tails[K]: what a colour drops when K terms are kept, squared and summed over the colours.
  std::vector<double> tails(count(basis_.header().dims.n_lights) + 1);
  for (const Query& query : all_) {
    if (query.environment != environment) {
      continue;
    }
    const std::vector<int> ranked = rank_terms(basis_, query, order);
    double tail = 0.0;
    for (std::size_t r = ranked.size(); r-- > 0;) {
      tail += reach(basis_, query, ranked[r]);
      tails[r] += tail * tail;
    }
  }
  const auto enough = std::find_if(tails.begin(), tails.end(), [allowed](double tail) {
    return std::sqrt(tail) <= allowed;
  });
  return static_cast<int>(enough - tails.begin());
}

bool Relighting::is_group_needed(int channel, int group) const {
  for (std::size_t q = 0; q < queries_.size(); ++q) {
    if (queries_[q].channel != channel) {
      continue;
    }
    const bool is_lossless = basis_.header().coding == BasisCoding::lossless;
    const std::vector<double>& values = is_lossless ? lossless_weights_[q] : queries_[q].light;
    for (int place = basis_.group_begin(group); place < basis_.group_end(group); ++place) {
      if (values[count(basis_.order()[count(place)])] != 0.0) {
        return true;
      }
    }
  }
  return false;
}

void Relighting::sum_quantised(int i_tile, const TileRect& rect, int channel,
                               std::vector<std::vector<double>>& sums) const {
  const std::size_t n_pixels = count(rect.n_pixels());
  for (int g = 0; g < basis_.n_groups(); ++g) {
    if (basis_.is_group_empty(i_tile, channel, g) || !is_group_needed(channel, g)) {
      continue;
    }
    const SparseBlock block = basis_.sparse(i_tile, channel, g);
    for (std::size_t q = 0; q < queries_.size(); ++q) {
      if (queries_[q].channel != channel) {
        continue;
      }
      const std::vector<double>& light = queries_[q].light;
      double* sum = sums[q].data();
      // Cells of one coefficient are neighbours: its factor is looked up once.
      for (std::size_t e = 0; e < block.cell.size();) {
        const std::size_t place = block.cell[e] / n_pixels;
        const std::size_t base = place * n_pixels;
        const double factor =
            light[count(basis_.order()[count(basis_.group_begin(g)) + place])];
        if (factor == 0.0) {
          e = static_cast<std::size_t>(
              std::lower_bound(block.cell.begin() + static_cast<std::ptrdiff_t>(e),
                               block.cell.end(), base + n_pixels) -
              block.cell.begin());
          continue;
        }
        for (; e < block.cell.size() && block.cell[e] < base + n_pixels; ++e) {
          sum[block.cell[e] - base] += factor * block.value[e];
        }
      }
    }
  }
  const BasisHeader& header = basis_.header();
  const PixelBlock pixels = basis_.pixels(i_tile, channel);
  std::vector<double> plate(n_pixels);
  for (std::size_t q = 0; q < queries_.size(); ++q) {
    if (queries_[q].channel != channel) {
      continue;
    }
    plate_sums(rect, header.plate_degree, pixels.plate, queries_[q].plate, plate);
    for (std::size_t p = 0; p < n_pixels; ++p) {
      sums[q][p] = std::ldexp(header.step, -int{pixels.shift[p]}) * sums[q][p] +
                   plate[p] * pixels.gain[p];
    }
  }
}

void Relighting::sum_lossless(int i_tile, const TileRect& rect, int channel,
                              std::vector<std::vector<double>>& sums) const {
  const std::size_t n_pixels = count(rect.n_pixels());
  for (int g = 0; g < basis_.n_groups(); ++g) {
    if (basis_.is_group_empty(i_tile, channel, g) || !is_group_needed(channel, g)) {
      continue;
    }
    const std::vector<float> rows = basis_.floats(i_tile, channel, g);
    for (std::size_t q = 0; q < queries_.size(); ++q) {
      if (queries_[q].channel != channel) {
        continue;
      }
      for (int k = basis_.group_begin(g); k < basis_.group_end(g); ++k) {
        const double w = lossless_weights_[q][count(k)];
        if (w == 0.0) {
          continue;
        }
        const float* row = rows.data() + count(k - basis_.group_begin(g)) * n_pixels;
        for (std::size_t p = 0; p < n_pixels; ++p) {
          sums[q][p] += w * double{row[p]};
        }
      }
    }
  }
}

void Relighting::sum_tile(int i_tile, std::vector<RelitPicture>& pictures,
                          std::vector<std::uint64_t>& bytes) const {
  const BasisHeader& header = basis_.header();
  const TileRect rect = basis_.tile_rect(i_tile);
  const std::size_t n_pixels = count(rect.n_pixels());
  std::vector<std::vector<double>> sums(queries_.size(), std::vector<double>(n_pixels));
  for (int c = 0; c < header.dims.channels; ++c) {
    if (header.coding == BasisCoding::lossless) {
      sum_lossless(i_tile, rect, c, sums);
    } else {
      sum_quantised(i_tile, rect, c, sums);
    }
    for (int g = 0; g < basis_.n_groups(); ++g) {
      if (is_group_needed(c, g)) {
        bytes[count(i_tile)] += basis_.group_bytes(i_tile, c, g);
      }
    }
  }
  for (std::size_t q = 0; q < queries_.size(); ++q) {
    Image<float>& picture = pictures[count(queries_[q].environment)].picture;
    for (int p = 0; p < rect.n_pixels(); ++p) {
      picture(rect.y0 + p / rect.width, rect.x0 + p % rect.width, queries_[q].out_channel) =
          static_cast<float>(sums[q][count(p)]);
    }
  }
}

double norm_of(const Image<float>& picture) {
  double energy = 0.0;
  for (const float v : picture.pixels()) {
    energy += double{v} * double{v};
  }
  return std::sqrt(energy);
}

std::vector<RelitPicture> Relighting::sum() {
  const BasisHeader& header = basis_.header();
  lossless_weights_.clear();
  if (header.coding == BasisCoding::lossless) {
    // sum over kept i of l_i C_i = sum_k (H^-1 l)_k T_k.
    for (const Query& query : queries_) {
      std::vector<double> w = query.light;
      if (header.basis == BasisKind::haar && query.terms < query.terms_all) {
        const std::size_t per_grid = count(header.grid) * count(header.grid);
        for (std::size_t g = 0; g < w.size(); g += per_grid) {
          haar_inverse(std::span(w).subspan(g, per_grid), header.grid);
        }
      } else if (query.terms == query.terms_all) {
        w = query.given;
      }
      lossless_weights_.push_back(std::move(w));
    }
  }
  std::vector<RelitPicture> pictures(n_environments_);
  for (std::size_t e = 0; e < n_environments_; ++e) {
    pictures[e].picture = Image<float>(header.dims.height, header.dims.width, out_channels_[e]);
  }
  std::vector<std::uint64_t> bytes(count(basis_.n_tiles()));
  parallel_for(bytes.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t t = begin; t < end; ++t) {
      sum_tile(static_cast<int>(t), pictures, bytes);
    }
  });
  const std::uint64_t bytes_read =
      std::accumulate(bytes.begin(), bytes.end(), std::uint64_t{0});
  std::vector<double> dropped(n_environments_);
  std::vector<double> coded(n_environments_);
  for (const Query& query : queries_) {
    RelitPicture& picture = pictures[count(query.environment)];
    picture.terms = std::max(picture.terms, query.terms);
    picture.terms_all = std::max(picture.terms_all, query.terms_all);
    dropped[count(query.environment)] += query.dropped * query.dropped;
    coded[count(query.environment)] += query.coded * query.coded;
  }
  for (std::size_t e = 0; e < n_environments_; ++e) {
    RelightBound& bound = pictures[e].bound;
    pictures[e].bytes_read = bytes_read;
    bound.dropped = std::sqrt(dropped[e]);
    bound.coded = std::sqrt(coded[e]);
    bound.picture_norm = norm_of(pictures[e].picture);
    const double error = bound.dropped + bound.coded;
    if (error > 0.0) {
      const double truth = bound.picture_norm - error;
      bound.relative_l2 = truth > 0.0 ? error / truth : std::numeric_limits<double>::infinity();
    }
  }
  return pictures;
}

/// The smallest K for each environment whose bound keeps `max_error`. A picture of few terms
/// first tells how bright the whole one must be at least: truth >= ||P_K|| - dropped(K) -
/// coded.
std::vector<RelitPicture> relight_within(Relighting& work, std::size_t n_environments,
                                         double max_error, TermOrder order) {
  constexpr int kFirst = 16;
  constexpr int kGrowth = 4;
  std::vector<double> truth(n_environments, 0.0);  // lower bounds on the true pictures' norms
  std::vector<int> terms(n_environments, kFirst);
  while (true) {
    work.keep(terms, order);
    std::vector<RelitPicture> pictures = work.sum();
    bool is_done = true;
    for (std::size_t e = 0; e < n_environments; ++e) {
      RelightBound& bound = pictures[e].bound;
      const double error = bound.dropped + bound.coded;
      truth[e] = std::max(truth[e], bound.picture_norm - error);
      if (error > 0.0 && truth[e] > 0.0) {
        bound.relative_l2 = std::min(bound.relative_l2, error / truth[e]);
      }
      if (bound.relative_l2 <= max_error || pictures[e].terms >= pictures[e].terms_all) {
        continue;
      }
      is_done = false;
      const std::optional<int> enough =
          truth[e] > 0.0 ? work.terms_within(static_cast<int>(e),
                                             max_error * truth[e] - bound.coded, order)
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

std::vector<RelitPicture> relight(const BasisFile& basis, std::span<const LightWeights> weights,
                                  const RelightOptions& options) {
  HAARLIGHT_EXPECTS(!options.terms || *options.terms >= 0, "a number of terms");
  HAARLIGHT_EXPECTS(!options.terms || !options.max_error, "terms or an error, not both");
  Relighting work(basis, weights);
  if (options.max_error) {
    return relight_within(work, weights.size(), *options.max_error, options.order);
  }
  if (options.terms) {
    work.keep(std::vector<int>(weights.size(), *options.terms), options.order);
  }
  return work.sum();
}

RelitPicture relight(const BasisFile& basis, const LightWeights& weights,
                     const RelightOptions& options) {
  return std::move(relight(basis, std::span(&weights, 1), options).front());
}

Image<float> relight_stack(const StackSource& stack, const LightWeights& weights) {
  constexpr int kTile = 32;
  const StackDims dims = stack.dims();
  const int colours = static_cast<int>(weights.cols());
  HAARLIGHT_EXPECTS(weights.rows() == dims.n_lights, "one weight a light");
  HAARLIGHT_EXPECTS(colours == 1 || dims.channels == 1 || colours == dims.channels,
                    "one colour, or as many as the stack has channels");
  const int channels = std::max(colours, dims.channels);
  Image<float> picture(dims.height, dims.width, channels);
  const int tiles_x = (dims.width + kTile - 1) / kTile;
  const int tiles_y = (dims.height + kTile - 1) / kTile;
  parallel_for(count(tiles_x) * count(tiles_y), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t t = begin; t < end; ++t) {
      const int x0 = static_cast<int>(t) % tiles_x * kTile;
      const int y0 = static_cast<int>(t) / tiles_x * kTile;
      const TileRect rect{x0, y0, std::min(kTile, dims.width - x0),
                          std::min(kTile, dims.height - y0)};
      const std::size_t n_pixels = count(rect.n_pixels());
      std::vector<float> values(count(dims.channels) * n_pixels * count(dims.n_lights));
      stack.read_tile(rect, values);
      for (int c = 0; c < channels; ++c) {
        const double* w = weights.data() + (colours == 1 ? 0 : c) * weights.rows();
        const std::size_t from = dims.channels == 1 ? 0 : count(c);
        for (std::size_t p = 0; p < n_pixels; ++p) {
          const float* row = values.data() + (from * n_pixels + p) * count(dims.n_lights);
          double sum = 0.0;
          for (int k = 0; k < dims.n_lights; ++k) {
            sum += w[k] * double{row[k]};
          }
          picture(y0 + static_cast<int>(p) / rect.width, x0 + static_cast<int>(p) % rect.width,
                  c) = static_cast<float>(sum);
        }
      }
    }
  });
  return picture;
}

}  // namespace haarlight
