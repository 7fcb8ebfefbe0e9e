// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <functional>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "haarlight/relight/basis/relight.h"

/// @file
/// What relighting needs from a basis, wherever it is held (file or memory): lighting
/// coefficients, terms in order of worth, bounds on what is left out. Method:
/// docs/numerics/relight.md, "Relighting".

namespace haarlight::relight {

/// The query of one colour of one environment to one channel of the basis.
struct LightQuery {
  int environment = 0;
  int out_channel = 0;
  int channel = 0;            ///< of the basis
  std::vector<double> given;  ///< w_k
  std::vector<double> light;  ///< l_i in light-domain index order; 0 where dropped
  std::vector<double> plate;  ///< (rank): gain step * V_j . w
  double dropped = 0.0;
  double coded = 0.0;
  double clipped = 0.0;        ///< sum |w_k| ||T_k, clipped||
  double clipped_count = 0.0;  ///< values that were clipped, of the lights in use
  double lit_count = 0.0;      ///< values of the lights in use
  int terms = 0;
  int terms_all = 0;
};

/// Bounds on the norm of a tail: entry K bounds ||sum of l_i C_i over ranked[K], ranked[K+1],
/// ...||; one more entry than `ranked`, the last one 0. Default: the triangle inequality.
using TailBound =
    std::function<std::vector<double>(const LightQuery& query, std::span<const int> ranked)>;

/// The queries of several environments. Borrows header, tables and name. One thread.
class LightQueries {
 public:
  /// @throws Error  weights with a wrong number of lights or colours
  LightQueries(const BasisHeader& header, const BasisTables& tables, const std::string& name,
               std::span<const LightWeights> weights, TailBound tail_bound = {});

  /// Keeps the first terms[environment] terms of every colour.
  void keep(const std::vector<int>& terms, TermOrder order);
  /// Entry K bounds what the colours of an environment's picture drop together when each keeps
  /// its first K terms; descends to 0 at the most terms that any of them has.
  [[nodiscard]] std::vector<double> dropped_by_terms(int environment, TermOrder order);
  /// The terms of queries()[q] in descending worth, as light-domain indices.
  [[nodiscard]] const std::vector<int>& ranked(std::size_t q, TermOrder order) {
    return ranking(q, order).terms;
  }
  /// The smallest K whose dropped terms are bounded by `allowed`; none when allowed is
  /// negative.
  [[nodiscard]] std::optional<int> terms_within(int environment, double allowed,
                                                TermOrder order);

  [[nodiscard]] const std::vector<LightQuery>& queries() const noexcept { return queries_; }
  [[nodiscard]] std::size_t n_environments() const noexcept { return out_channels_.size(); }
  /// RelightBound::coded of one environment.
  [[nodiscard]] double coded(std::size_t environment) const;
  /// Adds to the bound of a picture of all lights that was summed elsewhere: the file's own
  /// error and `more`, and what was clipped.
  void add_coded(std::size_t environment, double more, RelightBound& bound) const;
  /// Black pictures of the environments' shapes, in the memory of `reuse` where it fits: fresh
  /// pages cost as much as summing a sparse picture.
  [[nodiscard]] std::vector<RelitPicture> black_pictures(
      std::vector<RelitPicture> reuse = {}) const;
  /// Terms and bounds of pictures that were summed for the terms kept now; their
  /// `bound.rounding` is set already.
  void finish(std::vector<RelitPicture>& pictures) const;

 private:
  /// Terms in descending worth, and bounds on what is dropped after each.
  struct Ranking {
    TermOrder order = TermOrder::transport;
    std::vector<int> terms;
    std::vector<double> tails;
  };

  [[nodiscard]] double reach(const LightQuery& query, int i) const;
  [[nodiscard]] std::vector<int> rank_terms(const LightQuery& query, TermOrder order) const;
  void sharpen_tails(const LightQuery& query, Ranking& ranking) const;
  /// For all_[q]; kept until another order is requested.
  [[nodiscard]] const Ranking& ranking(std::size_t q, TermOrder order);
  [[nodiscard]] double coded_bound(const LightQuery& query, const Eigen::VectorXd& w) const;
  void state_clipped(std::size_t environment, RelightBound& bound) const;
  void count_clipped(const Eigen::VectorXd& w, LightQuery& query) const;

  const BasisHeader& header_;
  const BasisTables& tables_;
  TailBound tail_bound_;
  std::vector<int> order_;  ///< coefficient_order()
  std::vector<int> out_channels_;
  std::vector<LightQuery> all_;                   ///< every term
  std::vector<LightQuery> queries_;               ///< with the terms kept
  std::vector<std::optional<Ranking>> rankings_;  ///< of all_
};

/// Upper bound on ||sum_i l_i P_i||, by a bound stored in a file.
/// @param norms    (n_lights) of one channel, by light-domain index: p_i >= ||P_i||
/// @param light    (n_lights): l_i, by light-domain index
/// @param order    coefficient_order()
/// @param channel  of the file
[[nodiscard]] double picture_bound(const PictureBound& bound, std::span<const float> norms,
                                   std::span<const double> light, std::span<const int> order,
                                   int channel);

/// RelightBound::relative_l2 from the others, and that of each channel.
void set_relative_bound(RelightBound& bound);

/// Runs `sum` (which sums the terms kept now and calls finish()) as the options request: once,
/// or, for a maximum error, until the bound is met or no term is left.
/// @param options  terms_each: none, or one for every environment
[[nodiscard]] std::vector<RelitPicture> relight_as_requested(
    LightQueries& queries, const RelightOptions& options,
    const std::function<std::vector<RelitPicture>()>& sum);

}  // namespace haarlight::relight
