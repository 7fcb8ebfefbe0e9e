// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/light/light_weights.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>

#include <Eigen/Geometry>
#include <fmt/format.h>

#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "haarlight/render/analytic/polygon_light.h"
#include "haarlight/render/light/environment_texels.h"
#include "haarlight/render/light/rig_lights.h"

namespace haarlight::relight {

namespace {

constexpr double kOverlapTol = 1e-6;  // fraction of a texel that two faces may both claim

/// The part of a texel that falls on one light's cell.
struct Piece {
  int light = 0;
  double fraction = 0.0;  ///< of the texel's solid angle
};

/// Scratch memory for clipping; one per worker.
struct Scratch {
  render::DirectionPolygon inside;
  render::DirectionPolygon strip;
  render::DirectionPolygon cell;
  render::DirectionPolygon spare;
  std::vector<Piece> pieces;
  std::vector<int> candidates;
  std::vector<double> dots;
};

/// A partition of (part of) the sphere into cells.
class LightCells {
 public:
  LightCells() = default;
  virtual ~LightCells() = default;
  LightCells(const LightCells&) = delete;
  LightCells& operator=(const LightCells&) = delete;
  LightCells(LightCells&&) = delete;
  LightCells& operator=(LightCells&&) = delete;
  /// False only where no cell reaches a texel of this centre: cut() would find no piece.
  [[nodiscard]] virtual bool may_reach(const Eigen::Vector3d& centre) const = 0;
  /// Fills scratch.pieces. @return  fraction of the texel in the union of the cells, measured
  /// without the cuts between cells: the pieces' fractions must add up to it
  virtual double cut(const render::EnvironmentTexel& texel, Scratch& scratch) const = 0;
};

void clip_in_place(render::DirectionPolygon& polygon, const Eigen::Vector3d& normal,
                   render::DirectionPolygon& spare) {
  render::clip_polygon(polygon, normal, spare);
  polygon.swap(spare);
}

/// Cells of a face, first and last along each axis.
struct CellRange {
  int first_col = 0;
  int last_col = 0;
  int first_row = 0;
  int last_row = 0;
};

/// One face: the planes through the object's centre and the cells' borders. A direction d that
/// meets the face's plane in front at centre + a u + b v has column.dot(d) >= 0 <=> a >=
/// border.
class FaceCells {
 public:
  /// @param most_radius  of a texel
  FaceCells(const Face& face, const Eigen::Vector3d& object_centre, int first_light,
            double most_radius)
      : face_(face), first_light_(first_light), to_centre_(face.centre - object_centre) {
    is_lit_ = face.emits.dot(to_centre_) < 0.0;
    front_ = face.u.cross(face.v);
    const double side = front_.dot(to_centre_) < 0.0 ? -1.0 : 1.0;
    front_ *= side;
    distance_ = front_.dot(to_centre_);
    is_lit_ = is_lit_ && distance_ > 0.0;
    axis_ = to_centre_.normalized();
    double smallest = 1.0;
    for (const double a : {-1.0, 1.0}) {
      for (const double b : {-1.0, 1.0}) {
        const Eigen::Vector3d corner = to_centre_ +
                                       0.5 * a * face.cols * face.pitch_mm * face.u +
                                       0.5 * b * face.rows * face.pitch_mm * face.v;
        smallest = std::min(smallest, axis_.dot(corner.normalized()));
      }
    }
    radius_ = std::acos(smallest) + 1e-6;
    least_ = least_cosine(most_radius);
    for (int col = 0; col <= face.cols; ++col) {
      const double a = (col - 0.5 * face.cols) * face.pitch_mm;
      columns_.emplace_back(side * face.v.cross(to_centre_ + a * face.u));
    }
    for (int row = 0; row <= face.rows; ++row) {
      const double b = (row - 0.5 * face.rows) * face.pitch_mm;
      rows_.emplace_back(-side * face.u.cross(to_centre_ + b * face.v));
    }
  }

  [[nodiscard]] bool may_reach(const Eigen::Vector3d& centre) const {
    return is_lit_ && axis_.dot(centre) >= least_;
  }

  /// @return  fraction of the texel on the whole face
  double cut(const render::EnvironmentTexel& texel, Scratch& scratch) const {
    if (!may_reach(texel.centre) || axis_.dot(texel.centre) < least_cosine(texel.radius)) {
      return 0.0;
    }
    const bool is_whole = contains(texel.corners);
    if (!is_whole) {
      scratch.inside = texel.corners;
      for (const Eigen::Vector3d& plane :
           {front_, columns_.front(), Eigen::Vector3d(-columns_.back()), rows_.front(),
            Eigen::Vector3d(-rows_.back())}) {
        clip_in_place(scratch.inside, plane, scratch.spare);
      }
      if (scratch.inside.size() < 3) {
        return 0.0;
      }
    }
    const render::DirectionPolygon& inside = is_whole ? texel.corners : scratch.inside;
    const CellRange cells = range(inside);
    if (is_whole && cells.first_col == cells.last_col && cells.first_row == cells.last_row) {
      scratch.pieces.push_back({light(cells.first_col, cells.first_row), 1.0});
      return 1.0;
    }
    const double texel_area = render::solid_angle(texel.corners);
    for (int col = cells.first_col; col <= cells.last_col; ++col) {
      scratch.strip = inside;
      if (col > cells.first_col) {
        clip_in_place(scratch.strip, border(columns_, col), scratch.spare);
      }
      if (col < cells.last_col) {
        clip_in_place(scratch.strip, -border(columns_, col + 1), scratch.spare);
      }
      for (int row = cells.first_row; row <= cells.last_row; ++row) {
        scratch.cell = scratch.strip;
        if (row > cells.first_row) {
          clip_in_place(scratch.cell, border(rows_, row), scratch.spare);
        }
        if (row < cells.last_row) {
          clip_in_place(scratch.cell, -border(rows_, row + 1), scratch.spare);
        }
        if (scratch.cell.size() >= 3) {
          scratch.pieces.push_back(
              {light(col, row), render::solid_angle(scratch.cell) / texel_area});
        }
      }
    }
    return is_whole ? 1.0 : render::solid_angle(inside) / texel_area;
  }

 private:
  [[nodiscard]] static const Eigen::Vector3d& border(
      const std::vector<Eigen::Vector3d>& borders, int i) {
    return borders[static_cast<std::size_t>(i)];
  }
  [[nodiscard]] int light(int col, int row) const {
    return first_light_ + row * face_.cols + col;
  }
  /// Of the angle between the face's centre and that of a texel which still touches it.
  [[nodiscard]] double least_cosine(double texel_radius) const {
    return std::cos(std::min(radius_ + texel_radius, std::numbers::pi));
  }
  [[nodiscard]] bool contains(const render::DirectionPolygon& polygon) const {
    const Eigen::Vector3d& left = columns_.front();
    const Eigen::Vector3d& right = columns_.back();
    const Eigen::Vector3d& low = rows_.front();
    const Eigen::Vector3d& high = rows_.back();
    return std::all_of(polygon.begin(), polygon.end(), [&](const Eigen::Vector3d& d) {
      return front_.dot(d) > 0.0 && left.dot(d) >= 0.0 && right.dot(d) <= 0.0 &&
             low.dot(d) >= 0.0 && high.dot(d) <= 0.0;
    });
  }

  /// Cells that a polygon on the face may touch; one more on each side where a corner lies
  /// within rounding of a border.
  [[nodiscard]] CellRange range(const render::DirectionPolygon& polygon) const {
    double low_col = face_.cols;
    double high_col = 0.0;
    double low_row = face_.rows;
    double high_row = 0.0;
    for (const Eigen::Vector3d& d : polygon) {
      // The point o + t d on the plane: t = distance / (front . d); its coordinates from the
      // face's centre, in cells from the first border.
      const double t = distance_ / front_.dot(d);
      const Eigen::Vector3d point = t * d - to_centre_;
      const double col = face_.u.dot(point) / face_.pitch_mm + 0.5 * face_.cols;
      const double row = face_.v.dot(point) / face_.pitch_mm + 0.5 * face_.rows;
      low_col = std::min(low_col, col);
      high_col = std::max(high_col, col);
      low_row = std::min(low_row, row);
      high_row = std::max(high_row, row);
    }
    const auto first = [](double low, int n) {
      return std::clamp(static_cast<int>(std::floor(low - kCellRounding)), 0, n - 1);
    };
    const auto last = [](double high, int first_cell, int n) {
      return std::clamp(static_cast<int>(std::floor(high + kCellRounding)), first_cell, n - 1);
    };
    CellRange cells{.first_col = first(low_col, face_.cols),
                    .first_row = first(low_row, face_.rows)};
    cells.last_col = last(high_col, cells.first_col, face_.cols);
    cells.last_row = last(high_row, cells.first_row, face_.rows);
    return cells;
  }

  static constexpr double kCellRounding = 1e-9;  // of a cell

  Face face_;
  int first_light_;
  Eigen::Vector3d to_centre_;
  Eigen::Vector3d front_;
  Eigen::Vector3d axis_;
  std::vector<Eigen::Vector3d> columns_;  ///< (cols + 1): planes of the borders
  std::vector<Eigen::Vector3d> rows_;     ///< (rows + 1)
  double distance_ = 0.0;
  double radius_ = 0.0;
  double least_ = 0.0;  ///< least_cosine() of the largest texel
  bool is_lit_ = true;
};

class RigCells final : public LightCells {
 public:
  RigCells(const Rig& rig, double most_radius) {
    int first = 0;
    for (const Face& face : rig.faces) {
      faces_.emplace_back(face, rig.object_centre, first, most_radius);
      first += face.n_lights();
    }
  }

  [[nodiscard]] bool may_reach(const Eigen::Vector3d& centre) const override {
    return std::any_of(faces_.begin(), faces_.end(),
                       [&](const FaceCells& face) { return face.may_reach(centre); });
  }

  double cut(const render::EnvironmentTexel& texel, Scratch& scratch) const override {
    scratch.pieces.clear();
    double claimed = 0.0;
    for (const FaceCells& face : faces_) {
      claimed += face.cut(texel, scratch);
    }
    if (claimed > 1.0 + kOverlapTol) {
      throw Error(
          "two faces of the rig cover the same directions as seen from the object's centre",
          fmt::format("direction ({:.3f}, {:.3f}, {:.3f})", texel.centre.x(), texel.centre.y(),
                      texel.centre.z()),
          "correct the faces or object_centre in the rig file: this light would count "
          "twice");
    }
    return claimed;
  }

 private:
  std::vector<FaceCells> faces_;
};

/// Light k's cell: d . (n_k - n_j) >= 0 for every j.
class VoronoiCells final : public LightCells {
 public:
  explicit VoronoiCells(std::vector<Eigen::Vector3d> directions)
      : directions_(std::move(directions)) {}

  [[nodiscard]] bool may_reach(const Eigen::Vector3d& /*centre*/) const override {
    return true;
  }

  double cut(const render::EnvironmentTexel& texel, Scratch& scratch) const override {
    scratch.pieces.clear();
    scratch.candidates.clear();
    scratch.dots.resize(directions_.size());
    double nearest = -1.0;
    for (std::size_t k = 0; k < directions_.size(); ++k) {
      scratch.dots[k] = texel.centre.dot(directions_[k]);
      nearest = std::max(nearest, scratch.dots[k]);
    }
    // A light can be nearest somewhere in the texel only if its angle from the centre is within
    // two radii of the smallest one.
    const double reach = std::min(
        std::acos(std::clamp(nearest, -1.0, 1.0)) + 2.0 * texel.radius, std::numbers::pi);
    const double least = std::cos(reach);
    for (std::size_t k = 0; k < directions_.size(); ++k) {
      if (scratch.dots[k] >= least) {
        scratch.candidates.push_back(static_cast<int>(k));
      }
    }
    if (scratch.candidates.size() == 1) {
      scratch.pieces.push_back({scratch.candidates.front(), 1.0});
      return 1.0;
    }
    const double area = render::solid_angle(texel.corners);
    for (const int k : scratch.candidates) {
      const Eigen::Vector3d& own = directions_[static_cast<std::size_t>(k)];
      int equals = 1;
      scratch.cell = texel.corners;
      for (const int j : scratch.candidates) {
        if (j == k) {
          continue;
        }
        const Eigen::Vector3d apart = own - directions_[static_cast<std::size_t>(j)];
        if (apart.squaredNorm() < 1e-24) {
          ++equals;
          continue;
        }
        clip_in_place(scratch.cell, apart, scratch.spare);
        if (scratch.cell.size() < 3) {
          break;
        }
      }
      if (scratch.cell.size() >= 3) {
        scratch.pieces.push_back({k, render::solid_angle(scratch.cell) / area / equals});
      }
    }
    return 1.0;  // every direction has a nearest light
  }

 private:
  std::vector<Eigen::Vector3d> directions_;
};

/// Sums of a run of texel rows.
struct Sums {
  Eigen::MatrixXd radiance;
  Eigen::VectorXd solid_angle;
  Eigen::Vector3d total = Eigen::Vector3d::Zero();
  Eigen::Vector3d missing = Eigen::Vector3d::Zero();
};

EnvironmentWeights integrate(const render::EnvironmentTexels& texels, const LightCells& cells,
                             int colours, int n_lights) {
  constexpr std::size_t kRuns = 64;  // fixed: the order of sums is independent of threads
  const auto n_rows = static_cast<std::size_t>(texels.n_rows());
  const std::size_t rows_per_run = (n_rows + kRuns - 1) / kRuns;
  const std::size_t n_runs = (n_rows + rows_per_run - 1) / rows_per_run;
  std::vector<Sums> runs(n_runs);
  parallel_for(n_runs, 1, [&](std::size_t begin, std::size_t end) {
    Scratch scratch;
    for (std::size_t run = begin; run < end; ++run) {
      Sums& sums = runs[run];
      sums.radiance = Eigen::MatrixXd::Zero(n_lights, colours);
      sums.solid_angle = Eigen::VectorXd::Zero(n_lights);
      const std::size_t last = std::min(n_rows, (run + 1) * rows_per_run);
      for (std::size_t row = run * rows_per_run; row < last; ++row) {
        texels.for_each(
            static_cast<int>(row),
            [&](const Eigen::Vector3d& centre) { return cells.may_reach(centre); },
            [&](const render::EnvironmentTexel& texel) {
              const bool is_reached = !texel.corners.empty();
              const double claimed = is_reached ? cells.cut(texel, scratch) : 0.0;
              const Eigen::Vector3d light = texel.solid_angle * texel.radiance;
              sums.total += light;
              if (!is_reached) {
                sums.missing += light;
                return;
              }
              for (const Piece& piece : scratch.pieces) {
                const double area = piece.fraction * texel.solid_angle;
                sums.solid_angle[piece.light] += area;
                sums.radiance.row(piece.light) +=
                    area * texel.radiance.head(colours).transpose();
              }
              sums.missing += (1.0 - claimed) * texel.solid_angle * texel.radiance;
            });
      }
    }
  });
  EnvironmentWeights result;
  result.cell_radiance = Eigen::MatrixXd::Zero(n_lights, colours);
  result.cell_solid_angle = Eigen::VectorXd::Zero(n_lights);
  for (const Sums& sums : runs) {
    result.cell_radiance += sums.radiance;
    result.cell_solid_angle += sums.solid_angle;
    result.total += sums.total;
    result.missing += sums.missing;
  }
  const double total = result.total.head(colours).sum();
  if (total > 0.0) {
    const double missing = result.missing.head(colours).sum();
    // 1 - claimed is rounding where faces meet within a texel: no negative fraction is
    // reported.
    result.missing_fraction = std::max(0.0, missing / total);
    result.conservation_error = std::abs(result.cell_radiance.sum() + missing - total) / total;
  }
  return result;
}

}  // namespace

double facing_irradiance(const LightElement& light, const Eigen::Vector3d& object_centre) {
  return render::light_irradiance(render::square_light(light), object_centre,
                                  (light.centre - object_centre).normalized());
}

EnvironmentWeights rig_weights(const render::Environment& environment, const Rig& rig,
                               double turn_rad) {
  const render::EnvironmentTexels texels(environment, turn_rad);
  EnvironmentWeights result = integrate(texels, RigCells(rig, texels.most_radius()),
                                        environment.is_colour() ? 3 : 1, rig.n_lights());
  result.weights = result.cell_radiance;
  for (int k = 0; k < rig.n_lights(); ++k) {
    const double g = facing_irradiance(light_element(rig, k), rig.object_centre);
    if (g > 0.0) {
      result.weights.row(k) /= g;
    } else {
      result.weights.row(k).setZero();
    }
  }
  return result;
}

EnvironmentWeights voronoi_weights(const render::Environment& environment,
                                   const std::vector<Eigen::Vector3d>& directions,
                                   double turn_rad) {
  HAARLIGHT_EXPECTS(!directions.empty(), "at least one light");
  for (const Eigen::Vector3d& direction : directions) {
    HAARLIGHT_EXPECTS(std::abs(direction.norm() - 1.0) < 1e-6, "unit directions");
  }
  EnvironmentWeights result =
      integrate(render::EnvironmentTexels(environment, turn_rad), VoronoiCells(directions),
                environment.is_colour() ? 3 : 1, static_cast<int>(directions.size()));
  result.weights = result.cell_radiance;
  return result;
}

}  // namespace haarlight::relight
