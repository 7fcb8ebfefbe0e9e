// SPDX-License-Identifier: Apache-2.0
#include "relight/shadow/shadow_points.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <mutex>
#include <numbers>
#include <numeric>

#include "core/parallel.h"
#include "core/random.h"
#include "haarlight/core/error.h"
#include "haarlight/relight/shadow/receiver_light.h"
#include "haarlight/render/light/light_tree.h"
#include "relight/shadow/light_balls.h"
#include "relight/shadow/sample_limit.h"
#include "relight/shadow/shadow_tables.h"
#include "relight/shadow/sum_effort.h"

namespace haarlight::relight {
namespace {

constexpr std::size_t kGrain = 256;  // receivers per task
/// Lights per side of a root. Fixed, so that sums have one order and lights share the tests of
/// the scene's own shadows (haarlight/render/direct_light.h) whatever the memory limit.
constexpr int kRootSide = 16;
/// With fewer lights, blocks cost more than they save, and their errors are rare and large.
/// The noise of so few does not average out either.
constexpr int kFewLights = 32;
/// Fewer miss the rare large errors.
constexpr std::size_t kFewestChecked = 2048;
constexpr std::size_t kCheckedOf = 8;  // else one receiver of so many
constexpr std::size_t kPilotOf =
    16;  // of the checked ones, one of so many tells what takes too long
constexpr double kMostByBlocks = 0.75;  // of the exact sums' time; else these are taken
constexpr double kMostOfExact = 0.1;    // what checks may add to the exact sums
constexpr int kFinestThreshold = 20;    // 2^-20 of the rms irradiance
constexpr std::size_t kAround = 8;      // look-ups around a receiver for its spread
constexpr double kDeviations = 3.0;     // of a measured value, in the spread

bool faces(const render::SurfacePoint& at, const render::SquareLight& light) {
  return at.flat_normal.dot(light.centre - at.point) > 0.0;
}

/// One light's irradiance at weight 1, without the scene's own shadows.
double leaf_irradiance(const render::SquareLight& light, const render::SurfacePoint& at) {
  return faces(at, light) ? light.radiance * receiver_irradiance(light, at.point, at.normal)
                          : 0.0;
}

/// @param spread  of the visibility, but for noise
void add(const Eigen::Vector3d& lit, double flux, const ShadowLook& look, double spread,
         PointTotal& total) {
  total.light += flux;
  switch (look.side) {
    case PlaneSide::no_point:
      total.no_point += flux;
      break;
    case PlaneSide::on:
      total.on += flux;
      break;
    case PlaneSide::above:
      total.above += flux;
      break;
    case PlaneSide::below:
      total.below += flux;
      break;
  }
  total.unknown += look.unknown > 0.0 ? flux : 0.0;
  total.outside += look.outside * flux;
  total.from_occluder += look.from_occluder * flux;
  total.widening = std::max(total.widening, look.widening);
  total.unshadowed += lit;
  total.shadowed += look.value * lit;
  total.unseen += std::max(look.lower, look.upper) * lit.cwiseAbs();
  total.spread += spread * lit.cwiseAbs();
  total.variance += (look.deviation * lit).cwiseAbs2();
}

/// How far a measured value that is noisy is moved towards an occluder that hides the light
/// entirely or leaves it clear: all the way where the two agree within kDeviations, and the less
/// the more they contradict each other, as they do where the object is transparent.
/// @param measured  the part of the window that is measured, `weight` of it
double settled_by(const OccluderLook& occluder, double measured, double weight,
                  const ShadowLook& look) {
  if (!(look.deviation > 0.0) || (occluder.value != 0.0 && occluder.value != 1.0)) {
    return 0.0;
  }
  const double off = weight * occluder.value - measured;
  const double allowed = kDeviations * look.deviation;
  return std::abs(off) <= allowed ? off : allowed * allowed / off;
}

/// What the occluder tells, in place of what the pictures do not.
void complete(const OccluderLook& occluder, ShadowMethod method, ShadowLook& look) {
  const bool is_measured = look.side == PlaneSide::on || look.side == PlaneSide::below;
  const double missing = look.unknown + look.outside;
  const double fraction = method == ShadowMethod::hull || !is_measured ? 1.0 : missing;
  // The measured part of the window, without what stands for the rest of it.
  const double measured = fraction < 1.0 ? look.value - 0.5 * look.unknown - look.outside : 0.0;
  const double of_heights = fraction < 1.0 ? look.lower - 0.5 * look.unknown : 0.0;
  look.moved = fraction < 1.0 ? settled_by(occluder, measured, 1.0 - fraction, look) : 0.0;
  look.value = measured + look.moved + fraction * occluder.value;
  look.lower = of_heights + fraction * (occluder.value - occluder.low);
  look.upper = of_heights + fraction * (occluder.high - occluder.value);
  look.deviation = fraction < 1.0 ? look.deviation : 0.0;
  look.from_occluder = fraction;
  look.widening = fraction < 1.0 ? look.widening : 1.0;
}

/// A chunk of receivers and their coordinates relative to the planes.
struct Chunk {
  PointRows rows;
  std::vector<PlaneSpot> spots;  ///< [plane * size + i]
  std::size_t size = 0;
};

class Job {
 public:
  static constexpr std::size_t kMaxPlanes = 8;

  Job(std::span<const render::SurfacePoint> receivers, std::span<const SamplingPlane> planes,
      std::span<const render::SquareLight> lights, std::span<const Eigen::Vector3d> weights,
      const PointsOptions& options)
      : receivers_(receivers),
        planes_(planes),
        lights_(lights),
        weights_(weights),
        options_(options),
        tables_(planes) {}

  PointsResult run() {
    PointsResult result;
    PointsReport& report = result.report;
    result.totals.resize(receivers_.size());
    report.totals_bytes = result.totals.size() * sizeof(PointTotal);
    roots_ = render::build_light_trees(lights_, weights_, kRootSide);
    for (const render::LightRoot& root : roots_) {
      report.n_lights += static_cast<int>(root.leaves.size());
    }
    settles_ = options_.method == ShadowMethod::both && report.n_lights < kFewLights;
    double threshold = 0.0;
    if (may_use_blocks() && report.n_lights >= kFewLights && choose_side(report)) {
      tables_.plan(roots_, options_.memory_bytes);
      if (pays_to_check(report)) {
        threshold = find_threshold(report);
      } else {
        roots_ = render::build_light_trees(lights_, weights_, kRootSide);
        tables_.plan(roots_, 0);
      }
    }
    Progress progress("shadow", static_cast<std::size_t>(report.n_lights), options_.progress);
    report.is_exact = threshold == 0.0;
    if (options_.has_spread) {
      around_ = steps_around();  // only now: finding the threshold needs no spread
    }
    Effort effort;
    const std::vector<std::uint32_t> which =
        take_checked(report.is_exact, result.totals, effort);
    std::vector<PointTotal> totals(which.size());
    for (std::size_t at = 0; at < roots_.size(); ++at) {
      if (report.is_exact) {
        sum_exactly(at, which, totals, effort, progress);
      } else {
        sum_by_blocks(roots_[at], tables_.tree(at, &progress), {&threshold, 1}, which, totals,
                      {&effort, 1});
      }
      tables_.release(at);
    }
    for (std::size_t i = 0; i < which.size(); ++i) {
      result.totals[which[i]] = totals[i];
    }
    report.count = tables_.count();
    report.table_bytes = tables_.peak_bytes();
    if (options_.has_spread) {
      finish_spreads(result.totals);
    }
    if (!receivers_.empty()) {
      report.lookups_a_point =
          static_cast<double>(effort.n_lookups) / static_cast<double>(receivers_.size());
    }
    report.block_side = report.is_exact ? 1 : side_;
    if (report.is_exact) {
      report.achieved = {0.0, 0.0, std::numeric_limits<double>::infinity()};
      report.relative_l2_limit = 0.0;
      report.threshold = 0.0;
    }
    return result;
  }

 private:
  using Tables = ShadowTables::Tables;
  using Effort = SumEffort;

  // ---- exact or blocks ----

  [[nodiscard]] bool has_no_negative_weight() const {
    return std::all_of(weights_.begin(), weights_.end(),
                       [](const Eigen::Vector3d& weight) { return weight.minCoeff() >= 0.0; });
  }

  [[nodiscard]] bool may_use_blocks() const {
    return options_.tolerance.relative_l2 > 0.0 && options_.tolerance.worst_pixel > 0.0 &&
           has_no_negative_weight() && options_.n_checked > 0 &&
           receivers_.size() > 2 * static_cast<std::size_t>(options_.n_checked) &&
           !roots_.empty();
  }

  /// As few of a small job's receivers that their exact sums cost little beside all.
  [[nodiscard]] std::size_t n_checked() const {
    return std::min(static_cast<std::size_t>(options_.n_checked),
                    std::max(kFewestChecked, receivers_.size() / kCheckedOf));
  }

  /// False: pictures that must be made twice cost more than blocks can be sure to save.
  [[nodiscard]] bool pays_to_check(const PointsReport& report) const {
    double picture = 0.0;
    for (const SamplingPlane& plane : planes_) {
      picture += plane.picture_lookups;
    }
    const double lookups = static_cast<double>(receivers_.size()) * report.n_lights *
                           (options_.has_spread ? 1.0 + kAround : 1.0);
    return picture * static_cast<double>(tables_.n_lights_not_kept()) <= kMostOfExact * lookups;
  }

  /// The largest blocks whose tables fit. False: not even blocks of two lights fit.
  bool choose_side(const PointsReport& report) {
    for (side_ = kRootSide; side_ > 1; side_ /= 2) {
      std::vector<render::LightRoot> roots =
          render::build_light_trees(lights_, weights_, side_);
      std::size_t most = 0;
      for (const render::LightRoot& root : roots) {
        most = std::max(most, root.nodes.size());
      }
      if (most * tables_.bytes_a_light() <= options_.memory_bytes) {
        const bool has_blocks = static_cast<int>(roots.size()) < report.n_lights;
        if (has_blocks) {
          roots_ = std::move(roots);
        }
        return has_blocks;
      }
    }
    return false;
  }

  /// The exact sums of the checked receivers serve an exact result; in one by blocks they would
  /// stand out from what is around them.
  /// @return  the receivers that are still to be summed
  [[nodiscard]] std::vector<std::uint32_t> take_checked(bool is_exact,
                                                        std::span<PointTotal> totals,
                                                        Effort& effort) {
    std::vector<bool> is_done(receivers_.size());
    if (is_exact && !options_.has_spread) {
      for (std::size_t i = 0; i < checked_.size(); ++i) {
        totals[checked_[i]] = exact_[i];
        is_done[checked_[i]] = true;
      }
      effort.add(of_exact_);
    }
    std::vector<std::uint32_t> rest;
    for (std::size_t i = 0; i < receivers_.size(); ++i) {
      if (!is_done[i]) {
        rest.push_back(static_cast<std::uint32_t>(i));
      }
    }
    return rest;
  }

  /// Coarsest threshold whose error on the checked receivers meets the tolerance; 0: none does,
  /// or only where exact sums take little more.
  double find_threshold(PointsReport& report) {
    const std::size_t stride = receivers_.size() / n_checked();
    for (std::size_t first = 0; first < kPilotOf;
         ++first) {  // every part is spread over the job
      for (std::size_t i = first; i < n_checked(); i += kPilotOf) {
        checked_.push_back(static_cast<std::uint32_t>(i * stride + hash_key(11, i) % stride));
      }
    }
    const Tolerance& tolerance = options_.tolerance;
    std::vector<double> fractions;
    for (int i = 1; i <= kFinestThreshold; ++i) {
      const double fraction = std::ldexp(1.0, -i);
      if (fraction <= 4.0 * tolerance.relative_l2 && fraction >= tolerance.relative_l2 / 64.0) {
        fractions.push_back(fraction);
      }
    }
    const double rms = rms_unshadowed(checked_);
    if (!(rms > 0.0)) {
      checked_.clear();
      return 0.0;
    }
    std::vector<double> thresholds(fractions);
    std::ranges::for_each(thresholds, [rms](double& threshold) { threshold *= rms; });
    exact_.resize(checked_.size());
    std::vector<PointTotal> tries(checked_.size() * thresholds.size());
    std::size_t n_tried = thresholds.size();
    std::vector<Effort> of_pilot(n_tried);
    std::vector<Effort> of_rest(n_tried);
    const std::size_t n_pilot = (checked_.size() + kPilotOf - 1) / kPilotOf;
    const std::span<const std::uint32_t> which(checked_);
    const auto walk = [&](const render::LightRoot& root, const Tables& tables,
                          std::size_t first, std::size_t n, std::vector<Effort>& efforts) {
      sum_by_blocks(root, tables, std::span(thresholds).first(n_tried), which.subspan(first, n),
                    std::span(tries).subspan(first * thresholds.size(), n * thresholds.size()),
                    std::span(efforts).first(n_tried));
    };
    for (std::size_t at = 0; at < roots_.size(); ++at) {
      const render::LightRoot& root = roots_[at];
      const Tables& tables = tables_.tree(at, nullptr);
      sum_leaves(root, 0, root.leaves.size(), leaf_tables(root, tables, planes_.size()),
                 checked_, exact_, of_exact_);
      // What a few receivers show to be too slow is not tried on the others.
      walk(root, tables, 0, n_pilot, of_pilot);
      const double most =
          kMostByBlocks * of_exact_.light_by_light() / static_cast<double>(checked_.size());
      while (n_tried > 0 &&
             of_pilot[n_tried - 1].by_blocks() > most * static_cast<double>(n_pilot)) {
        --n_tried;
      }
      walk(root, tables, n_pilot, checked_.size() - n_pilot, of_rest);
    }
    report.n_checked = static_cast<std::int64_t>(checked_.size());
    std::vector<PointTotal> found(checked_.size());
    for (std::size_t t = 0; t < n_tried; ++t) {
      for (std::size_t i = 0; i < found.size(); ++i) {
        found[i] = tries[i * thresholds.size() + t];
      }
      if (keeps_tolerance(exact_, found, report)) {
        report.threshold = fractions[t];
        return thresholds[t];
      }
    }
    return 0.0;
  }

  [[nodiscard]] double rms_unshadowed(std::span<const std::uint32_t> checked) const {
    std::vector<double> squares(checked.size());
    parallel_for(checked.size(), 16, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        Eigen::Vector3d sum = Eigen::Vector3d::Zero();
        for (std::size_t k = 0; k < lights_.size(); ++k) {
          if (!weights_[k].isZero(0.0)) {
            sum += leaf_irradiance(lights_[k], receivers_[checked[i]]) * weights_[k];
          }
        }
        squares[i] = sum.squaredNorm();
      }
    });
    return std::sqrt(std::accumulate(squares.begin(), squares.end(), 0.0) /
                     static_cast<double>(checked.size()));
  }

  [[nodiscard]] bool keeps_tolerance(std::span<const PointTotal> exact,
                                     std::span<const PointTotal> found,
                                     PointsReport& report) const {
    std::vector<double> squares;
    double norm = 0.0;
    std::vector<float> a;
    std::vector<float> b;
    for (std::size_t i = 0; i < exact.size(); ++i) {
      squares.push_back((found[i].shadowed - exact[i].shadowed).squaredNorm());
      norm += exact[i].shadowed.squaredNorm();
      for (Eigen::Index c = 0; c < 3; ++c) {
        a.push_back(static_cast<float>(found[i].shadowed[c]));
        b.push_back(static_cast<float>(exact[i].shadowed[c]));
      }
    }
    report.achieved = compare(a, b);
    report.relative_l2_limit =
        norm > 0.0
            ? std::sqrt(limit_of_mean(squares) * static_cast<double>(exact.size()) / norm)
            : 0.0;
    return norm > 0.0 && report.relative_l2_limit <= options_.tolerance.relative_l2 &&
           report.achieved.worst_pixel <= options_.tolerance.worst_pixel;
  }

  // ---- receivers ----

  [[nodiscard]] Chunk gather(std::span<const std::uint32_t> which) const {
    Chunk chunk;
    chunk.size = which.size();
    chunk.rows.reserve(which.size());
    for (const std::uint32_t i : which) {
      chunk.rows.add(receivers_[i]);
    }
    for (const SamplingPlane& plane : planes_) {
      for (const std::uint32_t i : which) {
        chunk.spots.push_back(locate_point(plane.frame, receivers_[i].point));
      }
    }
    return chunk;
  }

  [[nodiscard]] std::vector<render::SquareLight> leaf_lights(
      const render::LightRoot& root) const {
    std::vector<render::SquareLight> lights;
    for (const int leaf : root.leaves) {
      lights.push_back(root.nodes[static_cast<std::size_t>(leaf)].block);
    }
    return lights;
  }

  /// Irradiance of every leaf at weight 1, including the scene's own shadows.
  void own_shadows(const render::DirectLight& direct, std::uint32_t receiver,
                   std::span<render::LightContribution> contributions) const {
    const render::Material lambert;
    (void)direct.evaluate(receivers_[receiver], lambert, receiver, contributions);
  }

  [[nodiscard]] ShadowLook look(const render::LightNode& node,
                                std::span<const PlaneLight> placed,
                                const WindowSums* const* tables, const PlaneSpot* spots,
                                std::size_t spot_stride) const {
    const LookRule rule{options_.rule, node.n_children > 0};
    if (planes_.size() == 1) {
      return look_up(planes_[0].frame, planes_[0].object, rule, placed[0], *tables[0],
                     spots[0]);
    }
    std::array<ShadowLook, kMaxPlanes> looks;
    for (std::size_t p = 0; p < planes_.size(); ++p) {
      looks[p] =
          look_up(planes_[p].frame, planes_[p].object, {options_.rule, node.n_children > 0},
                  placed[p], *tables[p], spots[p * spot_stride]);
    }
    return combine({looks.data(), planes_.size()});
  }

  [[nodiscard]] bool needs_occluder(const ShadowLook& look) const {
    const bool is_measured = look.side == PlaneSide::on || look.side == PlaneSide::below;
    return options_.method == ShadowMethod::hull ||
           (options_.method == ShadowMethod::both &&
            (!is_measured || look.unknown > 0.0 || look.outside > 0.0 ||
             (settles_ && look.deviation > 0.0)));
  }

  /// What the occluder says of a ball of lights; asked once, and only if it is needed.
  struct BallLook {
    bool is_asked = false;
    std::optional<OccluderLook> look;  ///< of every light in it, if all are alike
  };

  /// complete_look() of one light of a ball.
  void complete_look(const Eigen::Vector3d& point, const render::SquareLight& light,
                     const LightBall& ball, BallLook& known, ShadowLook& look,
                     Effort& effort) const {
    if (!needs_occluder(look)) {
      return;
    }
    if (!known.is_asked) {
      known = {true, options_.occluder->look_at_all(point, ball.centre, ball.radius_mm)};
      ++effort.n_asked;
    }
    effort.n_asked += known.look ? 0 : 1;
    complete(known.look ? *known.look : options_.occluder->look(point, light), options_.method,
             look);
  }

  /// Asks the occluder where the method says so. @return  how often
  int complete_look(const Eigen::Vector3d& point, const render::SquareLight& light,
                    ShadowLook& look) const {
    if (!needs_occluder(look)) {
      return 0;
    }
    complete(options_.occluder->look(point, light), options_.method, look);
    return 1;
  }

  /// Adds the noise; with positive weights the truth lies between no light and all of it.
  void finish_spreads(std::span<PointTotal> totals) const {
    const bool is_bounded = has_no_negative_weight();
    for (PointTotal& total : totals) {
      total.spread += kDeviations * total.variance.cwiseSqrt();
      if (is_bounded) {
        total.spread =
            total.spread.cwiseMin(total.shadowed.cwiseMax(total.unshadowed - total.shadowed));
      }
    }
  }

  /// Steps within the resolution, in the plane's directions.
  [[nodiscard]] std::vector<Eigen::Vector3d> steps_around() const {
    double reach = options_.occluder != nullptr ? options_.occluder->resolution_mm() : 0.0;
    for (const SamplingPlane& plane : planes_) {
      reach = std::max({reach, plane.frame.texel_mm, plane.resolution_mm});
    }
    const PlaneFrame& frame = planes_[0].frame;
    std::vector<Eigen::Vector3d> steps;
    for (std::size_t i = 0; i < kAround; ++i) {
      const double angle = 2.0 * std::numbers::pi * static_cast<double>(i) / kAround;
      steps.emplace_back(reach * (std::cos(angle) * frame.u + std::sin(angle) * frame.v));
    }
    return steps;
  }

  /// The spread of a visibility, but for noise. An edge may lie anywhere within the resolution,
  /// so the answers around the receiver are possible here too.
  [[nodiscard]] double spread_of(const ShadowLook& found, const render::LightNode& node,
                                 std::span<const PlaneLight> placed,
                                 const WindowSums* const* tables,
                                 const Eigen::Vector3d& point) const {
    if (around_.empty()) {
      return 0.0;
    }
    double low = found.value - std::max(0.0, found.moved) - found.lower;
    double high = found.value - std::min(0.0, found.moved) + found.upper;
    std::array<PlaneSpot, kMaxPlanes> spots;
    for (const Eigen::Vector3d& step : around_) {
      for (std::size_t p = 0; p < planes_.size(); ++p) {
        spots[p] = locate_point(planes_[p].frame, point + step);
      }
      ShadowLook beside = look(node, placed, tables, spots.data(), 1);
      complete_look(point + step, node.block, beside);
      low = std::min(low, beside.value - beside.lower);
      high = std::max(high, beside.value + beside.upper);
    }
    return std::max(found.value - low, high - found.value);
  }

  [[nodiscard]] std::vector<PlaneLight> place(const render::SquareLight& light) const {
    std::vector<PlaneLight> placed;
    for (const SamplingPlane& plane : planes_) {
      placed.push_back(place_light(plane.frame, light));
    }
    return placed;
  }

  // ---- exact ----

  void sum_exactly(std::size_t at, std::span<const std::uint32_t> which,
                   std::span<PointTotal> totals, Effort& effort, Progress& progress) {
    const render::LightRoot& root = roots_[at];
    if (tables_.has_tree(at)) {
      sum_leaves(root, 0, root.leaves.size(),
                 leaf_tables(root, tables_.tree(at, &progress), planes_.size()), which, totals,
                 effort);
      return;
    }
    const auto batch = static_cast<std::size_t>(std::max<std::uint64_t>(
        1, options_.memory_bytes / std::max<std::uint64_t>(1, tables_.bytes_a_light())));
    for (std::size_t first = 0; first < root.leaves.size(); first += batch) {
      const std::size_t last = std::min(root.leaves.size(), first + batch);
      const Tables tables = tables_.load_leaves(root, first, last, &progress);
      std::vector<const WindowSums*> positions;
      for (const WindowSums& table : tables) {
        positions.push_back(&table);
      }
      sum_leaves(root, first, last, positions, which, totals, effort);
    }
  }

  /// Adds leaves first .. last to the totals; `totals[i]` belongs to receiver which[i].
  void sum_leaves(const render::LightRoot& root, std::size_t first, std::size_t last,
                  std::span<const WindowSums* const> tables,
                  std::span<const std::uint32_t> which, std::span<PointTotal> totals,
                  Effort& effort) {
    std::mutex mutex;
    std::optional<render::DirectLight> direct;
    if (options_.own_shadows != nullptr) {
      direct.emplace(*options_.own_shadows, leaf_lights(root));
    }
    const LightBalls balls = light_balls(root);
    std::vector<std::vector<PlaneLight>> placed;
    for (std::size_t leaf = first; leaf < last; ++leaf) {
      placed.push_back(place(root.nodes[static_cast<std::size_t>(root.leaves[leaf])].block));
    }
    parallel_for(which.size(), kGrain, [&](std::size_t begin, std::size_t end) {
      const Chunk chunk = gather(which.subspan(begin, end - begin));
      const std::size_t n_leaves = root.leaves.size();
      std::vector<render::LightContribution> contributions;
      std::vector<double> own;  // [leaf - first][i]
      if (direct) {
        contributions.resize(n_leaves);
        own.resize((last - first) * chunk.size);
        for (std::size_t i = 0; i < chunk.size; ++i) {
          own_shadows(*direct, which[begin + i], contributions);
          for (std::size_t leaf = first; leaf < last; ++leaf) {
            own[(leaf - first) * chunk.size + i] =
                std::numbers::pi * contributions[leaf].diffuse;
          }
        }
      }
      std::vector<BallLook> ball_looks(balls.balls.size() * chunk.size);
      std::vector<double> E(chunk.size);
      Effort mine;
      for (std::size_t leaf = first; leaf < last; ++leaf) {
        const render::LightNode& node = root.nodes[static_cast<std::size_t>(root.leaves[leaf])];
        const std::size_t at = leaf - first;
        if (direct) {
          std::copy_n(&own[at * chunk.size], chunk.size, E.begin());
        } else {
          irradiance(node.block, chunk, which.subspan(begin, end - begin), E);
        }
        for (std::size_t i = 0; i < chunk.size; ++i) {
          if (!(E[i] > 0.0)) {
            continue;
          }
          ShadowLook found =
              look(node, placed[at], &tables[at * planes_.size()], &chunk.spots[i], chunk.size);
          const Eigen::Vector3d& point = receivers_[which[begin + i]].point;
          const std::size_t ball = balls.of_leaf[leaf];
          complete_look(point, node.block, balls.balls[ball], ball_looks[ball * chunk.size + i],
                        found, mine);
          mine.n_lookups += planes_.size() * (1 + around_.size());
          add(E[i] * node.weight, E[i] * std::abs(node.weight.mean()), found,
              spread_of(found, node, placed[at], &tables[at * planes_.size()], point),
              totals[begin + i]);
        }
      }
      const std::lock_guard lock(mutex);
      effort.add(mine);
    });
  }

  /// One light at a chunk of receivers.
  void irradiance(const render::SquareLight& light, const Chunk& chunk,
                  std::span<const std::uint32_t> which, std::span<double> E) const {
    irradiance_far(light, chunk.rows, E);
    for (std::size_t i = 0; i < chunk.size; ++i) {
      const render::SurfacePoint& at = receivers_[which[i]];
      const double towards = at.flat_normal.dot(light.centre - at.point);
      if (!(towards > 0.0)) {
        E[i] = 0.0;
      } else if (E[i] < 0.0) {
        E[i] = leaf_irradiance(light, at);
      } else {
        E[i] *= light.radiance;
      }
    }
  }

  // ---- blocks ----

  /// One node's contribution to one receiver.
  struct Part {
    Eigen::Vector3d lit = Eigen::Vector3d::Zero();  ///< irradiance with V = 1
    double flux = 0.0;
    ShadowLook look;
    bool is_usable = false;  ///< `lit` is valid; a block at the horizon must be refined
    bool is_lit = false;     ///< nothing below this node is in shadow
  };

  /// Everything needed to traverse a tree for one receiver.
  struct Walk {
    const render::LightRoot& root;
    const Tables& tables;
    std::span<const std::vector<PlaneLight>> blocks;   ///< by node, by plane
    std::span<const std::vector<PlaneLight>> centres;  ///< the same for LightNode::centres
    const render::SurfacePoint& at;
    const PlaneSpot* spots;
    std::size_t spot_stride;
    std::span<const Eigen::Vector3d> own;  ///< with own shadows: `lit` by node
    std::span<const double> thresholds;    ///< from coarse to fine
    std::span<PointTotal> totals;          ///< one per threshold
    std::span<Effort> efforts;             ///< [t]: what threshold t needs and t - 1 does not
  };

  using NodeTables = std::array<const WindowSums*, kMaxPlanes>;
  [[nodiscard]] NodeTables tables_of(const Walk& walk, int at) const {
    NodeTables tables{};
    for (std::size_t p = 0; p < planes_.size(); ++p) {
      tables[p] = &walk.tables[static_cast<std::size_t>(at) * planes_.size() + p];
    }
    return tables;
  }

  /// Adds a node to the totals of thresholds first .. last.
  void add_part(Walk& walk, int at, const Part& part, std::size_t first,
                std::size_t last) const {
    const auto i = static_cast<std::size_t>(at);
    const NodeTables tables = tables_of(walk, at);
    walk.efforts[first].n_lookups += planes_.size() * around_.size();
    const double spread =
        spread_of(part.look, walk.root.nodes[i], walk.blocks[i], tables.data(), walk.at.point);
    for (std::size_t t = first; t < last; ++t) {
      add(part.lit, part.flux, part.look, spread, walk.totals[t]);
    }
  }

  void find_light(const Walk& walk, int at, Part& part) const {
    const render::LightNode& node = walk.root.nodes[static_cast<std::size_t>(at)];
    part.is_usable = true;
    if (!walk.own.empty()) {
      part.lit = walk.own[static_cast<std::size_t>(at)];
    } else if (node.n_children == 0) {
      part.lit = leaf_irradiance(node.block, walk.at) * node.weight;
    } else {
      const Eigen::Vector3d to = node.centres.centre - walk.at.point;
      const auto reach = [&](const Eigen::Vector3d& n) {
        const render::SquareLight& one = lights_[static_cast<std::size_t>(
            walk.root.nodes[static_cast<std::size_t>(node.member)].light)];
        return 0.5 * (std::abs(n.dot(node.block.u)) * (node.centres.width_mm + one.width_mm) +
                      std::abs(n.dot(node.block.v)) * (node.centres.height_mm + one.height_mm));
      };
      const double flat = walk.at.flat_normal.dot(to);
      const double shaded = walk.at.normal.dot(to);
      const double before = -node.block.emits.dot(to);
      const double flat_reach = reach(walk.at.flat_normal);
      if (before <= 0.0 || flat + flat_reach <= 0.0) {
        part.lit = Eigen::Vector3d::Zero();
      } else if (flat > flat_reach && shaded > reach(walk.at.normal)) {
        part.lit = node.block.radiance * node.area_ratio *
                   block_irradiance(node.block, walk.at) * node.weight;
      } else {
        part.is_usable = false;
      }
    }
    part.flux = part.lit.mean();
  }

  /// @param first  the coarsest threshold that needs this node
  void find_shadow(Walk& walk, int at, std::size_t first, Part& part) const {
    const std::size_t n_planes = planes_.size();
    const render::LightNode& node = walk.root.nodes[static_cast<std::size_t>(at)];
    const auto i = static_cast<std::size_t>(at);
    if (node.n_children > 0) {
      part.is_lit = true;
      for (std::size_t p = 0; p < n_planes && part.is_lit; ++p) {
        part.is_lit =
            is_all_lit(planes_[p].frame, planes_[p].object, options_.rule, walk.centres[i][p],
                       walk.blocks[static_cast<std::size_t>(node.member)][p],
                       walk.tables[i * n_planes + p], walk.spots[p * walk.spot_stride]);
      }
    }
    if (part.is_usable && !(part.flux > 0.0)) {
      return;
    }
    const NodeTables tables = tables_of(walk, at);
    part.look = look(node, walk.blocks[i], tables.data(), walk.spots, walk.spot_stride);
    walk.efforts[first].n_lookups += n_planes;
    if (part.is_lit) {
      part.look.value = 1.0;
      part.look.lower = part.look.upper = part.look.deviation = 0.0;
    } else {
      walk.efforts[first].n_asked +=
          static_cast<std::uint64_t>(complete_look(walk.at.point, node.block, part.look));
    }
  }

  /// @param first  the coarsest threshold that did not end above this node
  void visit(Walk& walk, int at, const Part& part, std::size_t first) const {
    const render::LightNode& node = walk.root.nodes[static_cast<std::size_t>(at)];
    if (part.is_usable && !(part.flux > 0.0)) {
      return;  // the receiver faces away from all of it
    }
    const std::size_t n = walk.thresholds.size();
    if (node.n_children == 0) {
      add_part(walk, at, part, first, n);
      return;
    }
    std::array<Part, 4> children;
    bool is_usable = part.is_usable;
    Eigen::Vector3d difference = -part.look.value * part.lit;
    for (int c = 0; c < node.n_children; ++c) {
      Part& child = children[static_cast<std::size_t>(c)];
      find_light(walk, node.first_child + c, child);
      if (part.is_lit) {
        child.is_lit = true;
        child.look = part.look;
      } else {
        find_shadow(walk, node.first_child + c, first, child);
      }
      is_usable = is_usable && child.is_usable;
      difference += child.look.value * child.lit;
    }
    // The children are good enough for the coarser thresholds; the finer ones go on.
    std::size_t next = first;
    while (is_usable && next < n && difference.norm() <= walk.thresholds[next]) {
      ++next;
    }
    for (int c = 0; c < node.n_children; ++c) {
      const Part& child = children[static_cast<std::size_t>(c)];
      if (next > first) {
        add_part(walk, node.first_child + c, child, first, next);
      }
      if (next < n) {
        visit(walk, node.first_child + c, child, next);
      }
    }
  }

  /// One way down the tree for all thresholds: the sums of each are those that it gets alone.
  /// @param thresholds  from coarse to fine
  /// @param totals      as many for each receiver, at least one per threshold
  /// @param efforts     of each threshold alone
  void sum_by_blocks(const render::LightRoot& root, const Tables& tables,
                     std::span<const double> thresholds, std::span<const std::uint32_t> which,
                     std::span<PointTotal> totals, std::span<Effort> efforts) {
    const std::size_t n = thresholds.size();
    if (n == 0 || which.empty()) {
      return;
    }
    const std::size_t stride = totals.size() / which.size();
    std::mutex mutex;
    std::optional<render::DirectLight> direct;
    if (options_.own_shadows != nullptr) {
      direct.emplace(*options_.own_shadows, leaf_lights(root));
    }
    std::vector<std::vector<PlaneLight>> blocks;
    std::vector<std::vector<PlaneLight>> centres;
    for (const render::LightNode& node : root.nodes) {
      blocks.push_back(place(node.block));
      centres.push_back(place(node.centres));
    }
    parallel_for(which.size(), kGrain, [&](std::size_t begin, std::size_t end) {
      const Chunk chunk = gather(which.subspan(begin, end - begin));
      std::vector<render::LightContribution> contributions(root.leaves.size());
      std::vector<Eigen::Vector3d> own;
      std::vector<Effort> steps(n);
      for (std::size_t i = 0; i < chunk.size; ++i) {
        const std::uint32_t receiver = which[begin + i];
        if (direct) {
          own_shadows(*direct, receiver, contributions);
          sum_own(root, contributions, own);
        }
        Walk walk{root,
                  tables,
                  blocks,
                  centres,
                  receivers_[receiver],
                  &chunk.spots[i],
                  chunk.size,
                  own,
                  thresholds,
                  totals.subspan((begin + i) * stride, n),
                  steps};
        Part part;
        find_light(walk, 0, part);
        find_shadow(walk, 0, 0, part);
        visit(walk, 0, part, 0);
      }
      const std::lock_guard lock(mutex);
      Effort sum;
      for (std::size_t t = 0; t < n; ++t) {
        sum.add(steps[t]);
        efforts[t].add(sum);
      }
    });
  }

  /// `lit` of every node from its leaves'.
  static void sum_own(const render::LightRoot& root,
                      std::span<const render::LightContribution> contributions,
                      std::vector<Eigen::Vector3d>& own) {
    own.assign(root.nodes.size(), Eigen::Vector3d::Zero());
    for (std::size_t leaf = 0; leaf < root.leaves.size(); ++leaf) {
      const auto at = static_cast<std::size_t>(root.leaves[leaf]);
      own[at] = std::numbers::pi * contributions[leaf].diffuse * root.nodes[at].weight;
    }
    for (std::size_t at = root.nodes.size(); at-- > 0;) {
      const render::LightNode& node = root.nodes[at];
      for (int c = 0; c < node.n_children; ++c) {
        const int child = node.first_child + c;
        own[at] += own[static_cast<std::size_t>(child)];
      }
    }
  }

  std::span<const render::SurfacePoint> receivers_;
  std::span<const SamplingPlane> planes_;
  std::span<const render::SquareLight> lights_;
  std::span<const Eigen::Vector3d> weights_;
  const PointsOptions& options_;
  std::vector<Eigen::Vector3d> around_;  ///< steps_around(); empty: no spread
  std::vector<render::LightRoot> roots_;
  int side_ = 1;
  bool settles_ = false;  ///< asks the occluder about noisy values too
  ShadowTables tables_;
  std::vector<std::uint32_t> checked_;  ///< receivers that the tolerance was tried on
  std::vector<PointTotal> exact_;       ///< their sums light by light, without spread
  Effort of_exact_;
};

}  // namespace

PointsResult shadow_at_points(std::span<const render::SurfacePoint> receivers,
                              std::span<const SamplingPlane> planes,
                              std::span<const render::SquareLight> lights,
                              std::span<const Eigen::Vector3d> weights,
                              const PointsOptions& options) {
  HAARLIGHT_EXPECTS(lights.size() == weights.size(), "one weight per light");
  HAARLIGHT_EXPECTS(!planes.empty() && planes.size() <= Job::kMaxPlanes, "1 to 8 planes");
  HAARLIGHT_EXPECTS(options.method == ShadowMethod::plane || options.occluder != nullptr,
                    "an occluder for the methods that ask it");
  return Job(receivers, planes, lights, weights, options).run();
}

std::vector<int> visiting_order(std::span<const render::SquareLight> lights,
                                std::span<const Eigen::Vector3d> weights) {
  std::vector<int> order;
  for (const render::LightRoot& root : render::build_light_trees(lights, weights, kRootSide)) {
    for (const int leaf : root.leaves) {
      order.push_back(root.nodes[static_cast<std::size_t>(leaf)].light);
    }
  }
  return order;
}

}  // namespace haarlight::relight
