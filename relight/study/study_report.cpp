// SPDX-License-Identifier: Apache-2.0
#include "relight/study/study_report.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "core/plot.h"
#include "haarlight/core/error.h"
#include "relight/basis/light_basis.h"

namespace haarlight::relight {

namespace {

using Json = nlohmann::ordered_json;

constexpr Region kAssessed[] = {Region::specular, Region::diffuse, Region::attached,
                                Region::cast};

std::size_t index(Region region) { return static_cast<std::size_t>(region); }

/// Text in columns: the first left-aligned, numbers right-aligned.
class Table {
 public:
  explicit Table(std::vector<std::string> head) { rows_.push_back(std::move(head)); }
  void add(std::vector<std::string> row) { rows_.push_back(std::move(row)); }
  [[nodiscard]] std::string text() const {
    std::vector<std::size_t> widths(rows_.front().size());
    for (const auto& row : rows_) {
      for (std::size_t i = 0; i < row.size(); ++i) {
        widths[i] = std::max(widths[i], row[i].size());
      }
    }
    std::string out;
    for (std::size_t r = 0; r < rows_.size(); ++r) {
      std::string line = "  ";
      for (std::size_t i = 0; i < rows_[r].size(); ++i) {
        line += i == 0 ? fmt::format("{:<{}}", rows_[r][i], widths[i])
                       : fmt::format("  {:>{}}", rows_[r][i], widths[i]);
      }
      out += line + "\n";
      if (r == 0) {
        std::size_t all = 0;
        for (const std::size_t w : widths) {
          all += w + 2;
        }
        out += "  " + std::string(all - 2, '-') + "\n";
      }
    }
    return out;
  }

 private:
  std::vector<std::vector<std::string>> rows_;
};

std::string percent(double fraction) {
  return std::isfinite(fraction) ? fmt::format("{:.3g}", 100.0 * fraction) : "-";
}

std::string decibels(double db) {
  if (std::isnan(db)) {
    return "-";
  }
  return std::isinf(db) ? "exact" : fmt::format("{:.1f}", db);
}

/// The requested values of one kind, in order.
std::vector<double> requested_values(const BasisStudy& study, PointKind kind) {
  std::vector<double> requested;
  for (const BasisResult& result : study.results) {
    for (const BasisPoint& point : result.points) {
      if (point.kind == kind &&
          std::find(requested.begin(), requested.end(), point.requested) == requested.end()) {
        requested.push_back(point.requested);
      }
    }
  }
  return requested;
}

const BasisPoint* find_point(const BasisResult& result, PointKind kind, double requested) {
  for (const BasisPoint& point : result.points) {
    if (point.kind == kind && point.requested == requested) {
      return &point;
    }
  }
  return nullptr;
}

std::string point_title(PointKind kind, double requested) {
  return kind == PointKind::error
             ? fmt::format("Equal error: {} % of the stack", percent(requested))
             : fmt::format("Equal size: {:g} numbers per pixel", requested);
}

const KnownBasis& known_of(const BasisResult& result) {
  const auto all = known_bases();
  const auto found = std::find_if(all.begin(), all.end(), [&](const KnownBasis& known) {
    return known.word == result.name;
  });
  HAARLIGHT_EXPECTS(found != all.end(), "a basis of the table");
  return *found;
}

std::string summary_table(const BasisStudy& study, PointKind kind, double requested) {
  std::vector<std::string> head = {"", "numbers", "bytes", "--basis", "error %"};
  if (kind == PointKind::error) {
    head.insert(head.begin() + 1, "bare");
  }
  for (const std::string& lighting : study.lightings) {
    head.push_back(lighting + " dB");
  }
  Table table(head);
  for (const BasisResult& result : study.results) {
    const BasisPoint* point = find_point(result, kind, requested);
    if (point == nullptr) {
      table.add({result.title, "too small for its tables"});
      continue;
    }
    std::vector<std::string> row = {
        result.title, fmt::format("{:.1f}", point->numbers()), fmt::format("{}", point->bytes),
        known_of(result).kind ? result.name : "-", percent(point->stack_error[0])};
    if (kind == PointKind::error) {
      row.insert(row.begin() + 1, point->threshold_numbers >= 0.0
                                      ? fmt::format("{:.1f}", point->threshold_numbers)
                                      : "-");
      if (!point->is_achieved) {
        row[5] += " not achieved";
      }
    }
    for (const PictureErrors& picture : point->pictures) {
      row.push_back(decibels(picture.psnr_db[0]));
    }
    table.add(row);
  }
  return point_title(kind, requested) + "\n" + table.text() + "\n";
}

constexpr double kByteBudgets[] = {4.0, 8.0, 16.0, 32.0, 64.0};  // per pixel

std::string equal_bytes_table(const BasisStudy& study) {
  std::vector<std::string> head = {"error in %"};
  for (const double budget : kByteBudgets) {
    head.push_back(fmt::format("{:g} bytes", budget));
  }
  Table table(head);
  for (const BasisResult& result : study.results) {
    std::vector<std::string> row = {result.title};
    for (const double budget : kByteBudgets) {
      row.push_back(percent(error_at_bytes(result, budget, study.n_pixels)));
    }
    table.add(row);
  }
  return "Equal bytes per pixel: between the points above, straight in logarithms\n" +
         table.text() + "\n";
}

/// The median of the requested values.
double middle(const std::vector<double>& requested) { return requested[requested.size() / 2]; }

std::string region_table(const BasisStudy& study, PointKind kind, double requested,
                         int lighting) {
  std::vector<std::string> head = {"error in %", "all"};
  for (const Region region : kAssessed) {
    head.emplace_back(to_string(region));
  }
  Table table(head);
  for (const BasisResult& result : study.results) {
    const BasisPoint* point = find_point(result, kind, requested);
    if (point == nullptr) {
      continue;
    }
    const ByRegion& errors =
        lighting < 0 ? point->stack_error
                     : point->pictures[static_cast<std::size_t>(lighting)].relative_l2;
    std::vector<std::string> row = {result.title, percent(errors[0])};
    for (const Region region : kAssessed) {
      row.push_back(percent(errors[index(region)]));
    }
    table.add(row);
  }
  return fmt::format("{}; {}\n{}\n", point_title(kind, requested),
                     lighting < 0 ? "every light by itself"
                                  : study.lightings[static_cast<std::size_t>(lighting)],
                     table.text());
}

Json number(double value) { return std::isfinite(value) ? Json(value) : Json(nullptr); }

Json by_region(const ByRegion& values) {
  Json json = {{"all", number(values[0])}};
  for (const Region region : kAssessed) {
    json[std::string(to_string(region))] = number(values[index(region)]);
  }
  return json;
}

Json pictures_json(const BasisStudy& study, const std::vector<PictureErrors>& pictures) {
  Json json = Json::object();
  for (std::size_t i = 0; i < pictures.size(); ++i) {
    json[study.lightings[i]] = {{"relative_l2", by_region(pictures[i].relative_l2)},
                                {"psnr_db", by_region(pictures[i].psnr_db)}};
  }
  return json;
}

std::string binning_title(const BinningResult& binned) {
  return fmt::format("{} bins per side, {}", binned.rows,
                     binned.is_area ? "area lights" : "one LED per bin");
}

/// Look of a basis in the figures: its index in known_bases().
int look_of(const BasisResult& result) {
  return static_cast<int>(&known_of(result) - known_bases().data());
}

/// A panel with one line per basis: `x` and `y` of each of its points.
template <class X, class Y>
PlotPanel basis_panel(const BasisStudy& study, const std::string& title,
                      const std::string& x_name, X x, Y y) {
  PlotPanel panel{title, x_name, "relative L2 error", {}};
  for (const BasisResult& result : study.results) {
    PlotSeries series{result.title, {}, look_of(result), !result.has_plate};
    for (const BasisPoint& point : result.points) {
      series.points.emplace_back(x(point), y(point));
    }
    std::sort(series.points.begin(), series.points.end());
    panel.series.push_back(std::move(series));
  }
  return panel;
}

}  // namespace

double error_at_bytes(const BasisResult& result, double bytes_per_pixel,
                      std::uint64_t n_pixels) {
  std::vector<std::pair<double, double>> points;  // logarithms of bytes and error
  for (const BasisPoint& point : result.points) {
    if (point.bytes > 0 && point.stack_error[0] > 0.0) {
      points.emplace_back(std::log(double(point.bytes)), std::log(point.stack_error[0]));
    }
  }
  std::sort(points.begin(), points.end());
  const double at = std::log(bytes_per_pixel * double(n_pixels));
  for (std::size_t i = 0; i + 1 < points.size(); ++i) {
    const auto& [x0, y0] = points[i];
    const auto& [x1, y1] = points[i + 1];
    if (at >= x0 && at <= x1 && x1 > x0) {
      return std::exp(y0 + (y1 - y0) * (at - x0) / (x1 - x0));
    }
  }
  return std::numeric_limits<double>::quiet_NaN();
}

std::string summary_tables(const BasisStudy& study) {
  std::string out = fmt::format(
      "{} x {} pixels, {} channel(s), {} lights; {} of {} tiles of {} studied ({} pixels)\n",
      study.dims.width, study.dims.height, study.dims.channels, study.dims.n_lights,
      study.n_tiles_studied, study.n_tiles, study.tile, study.n_pixels);
  out += "regions:";
  for (const Region region : kAssessed) {
    out += fmt::format(
        " {} {} %,", to_string(region),
        percent(double(study.region_pixels[index(region)]) / double(study.n_pixels)));
  }
  out += fmt::format(" none {} %\n",
                     percent(double(study.region_pixels[0]) / double(study.n_pixels)));
  for (const LeftOut& left : study.left_out) {
    out += fmt::format("left out: {}: {}\n", left.title, left.reason);
  }
  out += "\n";
  for (const PointKind kind : {PointKind::error, PointKind::size}) {
    for (const double requested : requested_values(study, kind)) {
      out += summary_table(study, kind, requested);
    }
  }
  return out + equal_bytes_table(study);
}

std::vector<Recommendation> recommendations(const BasisStudy& study) {
  std::vector<Recommendation> all;
  for (const double error : requested_values(study, PointKind::error)) {
    const BasisResult* best = nullptr;
    const BasisResult* smallest = nullptr;
    const auto bytes = [error](const BasisResult& result) {
      return find_point(result, PointKind::error, error)->bytes;
    };
    for (const BasisResult& result : study.results) {
      const BasisPoint* point = find_point(result, PointKind::error, error);
      if (point == nullptr || !point->is_achieved) {
        continue;
      }
      if (smallest == nullptr || bytes(result) < bytes(*smallest)) {
        smallest = &result;
      }
      if (known_of(result).kind && (best == nullptr || bytes(result) < bytes(*best))) {
        best = &result;
      }
    }
    if (best != nullptr) {
      all.push_back({error, best->name, best->has_plate, bytes(*best),
                     smallest == best ? "" : smallest->title});
    }
  }
  return all;
}

std::string recommended_command(const Recommendation& found, const std::string& compress,
                                const std::string& plate) {
  const std::string with_plate = plate.empty() ? "" : " --plate " + plate;
  return fmt::format("{} --basis {}{} --max-error {:g}", compress, found.basis,
                     found.has_plate ? with_plate : " --plate none", found.error);
}

std::string recommendation_text(const BasisStudy& study, const std::string& compress,
                                const std::string& plate) {
  std::string out = "What compress can write\n";
  const BasisResult* before = nullptr;  // the one without the clean plate
  for (const BasisResult& result : study.results) {
    const KnownBasis& known = known_of(result);
    if (before != nullptr && before->name == result.name) {
      continue;
    }
    before = &result;
    out += known.kind ? fmt::format("  {}: yes, --basis {}\n", known.title, known.word)
                      : fmt::format("  {}: no: {}\n", known.title, known.why_not);
  }
  for (const Recommendation& found : recommendations(study)) {
    out += fmt::format("smallest that compress can write, {} % of the stack: {}{}\n  {}\n",
                       percent(found.error), found.basis, found.has_plate ? " + plate" : "",
                       recommended_command(found, compress, plate));
    if (!found.smaller.empty()) {
      out += fmt::format("  (smaller, but not to be written: {})\n", found.smaller);
    }
  }
  return out + "\n";
}

std::string region_tables(const BasisStudy& study) {
  std::string out;
  for (const PointKind kind : {PointKind::error, PointKind::size}) {
    const std::vector<double> requested = requested_values(study, kind);
    if (requested.empty()) {
      continue;
    }
    for (int i = -1; i < static_cast<int>(study.lightings.size()); ++i) {
      out += region_table(study, kind, middle(requested), i);
    }
  }
  return out;
}

std::string binning_table(const BasisStudy& study) {
  if (study.binned.empty()) {
    return {};
  }
  std::vector<std::string> head = {"error in %", "every light"};
  for (const std::string& lighting : study.lightings) {
    head.push_back(lighting);
  }
  std::string out;
  const auto add = [&](std::size_t region, const std::string& title) {
    Table table(head);
    for (const BinningResult& binned : study.binned) {
      std::vector<std::string> row = {binning_title(binned),
                                      percent(binned.stack_error[region])};
      for (const PictureErrors& picture : binned.pictures) {
        row.push_back(percent(picture.relative_l2[region]));
      }
      table.add(row);
    }
    out += title + "\n" + table.text() + "\n";
  };
  add(0, "Fewer lights");
  add(index(Region::cast), "Fewer lights, cast shadow alone");
  return out;
}

std::string study_json(const BasisStudy& study, const std::string& name,
                       const std::string& compress, const std::string& plate) {
  Json json = {{"capture", name},
               {"width", study.dims.width},
               {"height", study.dims.height},
               {"channels", study.dims.channels},
               {"lights", study.dims.n_lights},
               {"tile", study.tile},
               {"tiles", study.n_tiles},
               {"tiles_studied", study.n_tiles_studied},
               {"pixels_studied", study.n_pixels},
               {"seconds", study.seconds},
               {"lightings", study.lightings}};
  json["region_pixels"]["none"] = study.region_pixels[0];
  for (const Region region : kAssessed) {
    json["region_pixels"][std::string(to_string(region))] = study.region_pixels[index(region)];
  }
  json["left_out"] = Json::array();
  for (const LeftOut& left : study.left_out) {
    json["left_out"].push_back({{"basis", left.title}, {"reason", left.reason}});
  }
  json["bases"] = Json::array();
  for (const BasisResult& result : study.results) {
    Json points = Json::array();
    for (const BasisPoint& point : result.points) {
      points.push_back(
          {{"equal", point.kind == PointKind::error ? "error" : "size"},
           {"asked", point.requested},
           {"is_reached", point.is_achieved},
           {"step", point.step},
           {"patterns", point.n_patterns},
           {"coefficients_per_pixel", point.coefficients},
           {"table_numbers_per_pixel", point.table_numbers},
           {"numbers_per_pixel", point.numbers()},
           {"bare_threshold_numbers_per_pixel",
            point.threshold_numbers >= 0.0 ? Json(point.threshold_numbers) : Json(nullptr)},
           {"bytes", point.bytes},
           {"gain_bytes", point.gain_bytes},
           {"table_bytes", point.table_bytes},
           {"stack_relative_l2", by_region(point.stack_error)},
           {"pictures", pictures_json(study, point.pictures)},
           {"code_seconds", point.code_seconds},
           {"decode_seconds", point.decode_seconds}});
    }
    Json equal_bytes = Json::object();
    for (const double budget : kByteBudgets) {
      equal_bytes[fmt::format("{:g}", budget)] =
          number(error_at_bytes(result, budget, study.n_pixels));
    }
    const KnownBasis& known = known_of(result);
    json["bases"].push_back(
        {{"name", result.name},
         {"title", result.title},
         {"compress_writes_it", known.kind.has_value()},
         {"compress_why_not", known.kind ? Json(nullptr) : Json(std::string(known.why_not))},
         {"has_plate", result.has_plate},
         {"patterns", result.n_patterns},
         {"floor_relative_l2", result.floor_error},
         {"error_at_bytes_a_pixel_between_points", std::move(equal_bytes)},
         {"points", std::move(points)}});
  }
  json["recommended"] = Json::array();
  for (const Recommendation& found : recommendations(study)) {
    json["recommended"].push_back(
        {{"error", found.error},
         {"basis", found.basis},
         {"has_plate", found.has_plate},
         {"bytes", found.bytes},
         {"smaller_but_not_written",
          found.smaller.empty() ? Json(nullptr) : Json(found.smaller)},
         {"command", recommended_command(found, compress, plate)}});
  }
  json["fewer_lights"] = Json::array();
  for (const BinningResult& binned : study.binned) {
    json["fewer_lights"].push_back({{"bins_a_side", binned.rows},
                                    {"lights_a_bin_side", binned.side},
                                    {"is_area", binned.is_area},
                                    {"stack_relative_l2", by_region(binned.stack_error)},
                                    {"pictures", pictures_json(study, binned.pictures)}});
  }
  return json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n";
}

std::vector<TradeoffRecord> study_records(const BasisStudy& study, const std::string& command,
                                          int n_threads) {
  std::vector<TradeoffRecord> records;
  const auto add = [&](const BasisResult& result, const BasisPoint& point,
                       const std::string& of, double error) {
    if (!std::isfinite(error)) {
      return;  // a black picture: no relative error
    }
    TradeoffRecord record;
    record.algorithm = "haarlight";
    record.mode = fmt::format("basis {}, {}", result.title,
                              point.kind == PointKind::error
                                  ? fmt::format("for {} %", percent(point.requested))
                                  : fmt::format("{:g} numbers per pixel", point.requested));
    record.error_norm = "relative L2";
    record.error = error;
    set_times({point.code_seconds + point.decode_seconds}, record);
    record.bytes = double(point.bytes);
    TradeoffConditions& at = record.conditions;
    at.threads = n_threads;
    at.lights = study.dims.n_lights;
    at.pixels = static_cast<long long>(study.n_pixels);
    at.repeats = 1;
    at.coefficients_per_pixel = point.coefficients;
    at.command = command;
    at.more = {{"bytes_are", std::string("compressed size, tables and gains too")},
               {"seconds_are", std::string("coding and decoding of the whole stack")},
               {"error_of", of}};
    records.push_back(std::move(record));
  };
  for (const BasisResult& result : study.results) {
    for (const BasisPoint& point : result.points) {
      add(result, point, "stack", point.stack_error[0]);
      for (std::size_t i = 0; i < point.pictures.size(); ++i) {
        add(result, point, study.lightings[i], point.pictures[i].relative_l2[0]);
        for (const Region region : kAssessed) {
          add(result, point, fmt::format("{}, {}", study.lightings[i], to_string(region)),
              point.pictures[i].relative_l2[index(region)]);
        }
      }
    }
  }
  return records;
}

std::vector<StudyFigure> study_figures(const BasisStudy& study) {
  const auto numbers = [](const BasisPoint& point) { return point.numbers(); };
  const auto bytes = [](const BasisPoint& point) { return double(point.bytes); };
  const auto stack = [](const BasisPoint& point) { return point.stack_error[0]; };
  std::vector<StudyFigure> figures;
  figures.push_back(
      {"sizes.svg",
       draw_panels("Error of the whole stack, by size",
                   {basis_panel(study, "numbers", "numbers per pixel", numbers, stack),
                    basis_panel(study, "bytes", "bytes, packed", bytes, stack)},
                   2)});
  std::vector<PlotPanel> pictures;
  std::vector<PlotPanel> regions;
  for (std::size_t i = 0; i < study.lightings.size(); ++i) {
    pictures.push_back(
        basis_panel(study, study.lightings[i], "bytes, packed", bytes,
                    [i](const BasisPoint& point) { return point.pictures[i].relative_l2[0]; }));
    for (const Region region : kAssessed) {
      regions.push_back(
          basis_panel(study, fmt::format("{}: {}", study.lightings[i], to_string(region)),
                      "bytes, packed", bytes, [i, region](const BasisPoint& point) {
                        return point.pictures[i].relative_l2[index(region)];
                      }));
    }
  }
  figures.push_back(
      {"lightings.svg", draw_panels("Error of relit pictures, by size", pictures, 3)});
  figures.push_back(
      {"regions.svg", draw_panels("Error of relit pictures, regions apart", regions, 4)});
  if (!study.binned.empty()) {
    const auto binning_panel = [&](const std::string& title, std::size_t region) {
      PlotPanel panel{title, "bins per side", "relative L2 error", {}};
      for (std::size_t i = 0; i < study.lightings.size(); ++i) {
        for (const bool is_area : {true, false}) {
          PlotSeries series{study.lightings[i] + (is_area ? ", area" : ", one LED per bin"),
                            {},
                            static_cast<int>(i),
                            !is_area};
          for (const BinningResult& binned : study.binned) {
            if (binned.is_area == is_area) {
              series.points.emplace_back(binned.rows, binned.pictures[i].relative_l2[region]);
            }
          }
          panel.series.push_back(std::move(series));
        }
      }
      return panel;
    };
    figures.push_back(
        {"fewer_lights.svg", draw_panels("The array with fewer lights",
                                         {binning_panel("whole picture", 0),
                                          binning_panel("cast shadow", index(Region::cast))},
                                         2)});
  }
  return figures;
}

}  // namespace haarlight::relight
