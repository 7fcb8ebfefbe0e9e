// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/calibrate/found_lights.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include <Eigen/Geometry>
#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "core/counted.h"
#include "core/order_statistics.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/session/light_file.h"

namespace haarlight::relight {

namespace {

namespace fs = std::filesystem;
using Eigen::Vector3d;

constexpr std::size_t kMostRows = 100;  // of the table

enum class ListForm { folder, json, lp, csv };

ListForm form_of(const fs::path& out) {
  const std::string ending = out.extension().string();
  return ending == ".json"  ? ListForm::json
         : ending == ".lp"  ? ListForm::lp
         : ending == ".csv" ? ListForm::csv
                            : ListForm::folder;
}

double median_or_0(std::vector<double> values) {
  return values.empty() ? 0.0 : upper_median(std::move(values));
}

/// The list that import, fit and shape read: without unseen lights.
std::string json_of(const FoundLights& found) {
  nlohmann::ordered_json root;
  root["schema"] = 1;
  root["kind"] = "calibrated lights";
  root["program"] = fmt::format("haarlight {}", kVersion);
  root["frame"] = found.frame;
  root["lights"] = nlohmann::ordered_json::array();
  for (const FoundLight& light : found.lights) {
    if (!light.is_seen()) {
      continue;
    }
    nlohmann::ordered_json one;
    one["name"] = light.name;
    const Vector3d& position = light.position_mm ? *light.position_mm : light.direction;
    one[light.position_mm ? "position_mm" : "direction"] = {position.x(), position.y(),
                                                            position.z()};
    if (light.sigma_mm) {
      one["sigma_mm"] = {light.sigma_mm->x(), light.sigma_mm->y(), light.sigma_mm->z()};
    }
    if (light.sigma_deg) {
      one["sigma_deg"] = *light.sigma_deg;
    }
    if (light.lobe) {
      one["axis"] = {light.lobe->axis.x(), light.lobe->axis.y(), light.lobe->axis.z()};
      one["lobe_mu"] = light.lobe->mu;
    }
    if (found.has_powers) {
      one["relative_power"] = light.power.mean();
      if (light.power_sigma) {
        one["relative_power_sigma"] = *light.power_sigma * light.power.mean();
      }
    }
    root["lights"].push_back(std::move(one));
  }
  return root.dump(1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
}

std::string lp_of(const FoundLights& found) {
  std::vector<Vector3d> directions;
  std::vector<std::string> names;
  for (const FoundLight& light : found.lights) {
    if (light.is_seen()) {
      directions.push_back(light.direction);
      names.push_back(light.name);
    }
  }
  return session::format_lp(directions, names);
}

std::string quoted(const std::string& text) {
  std::string out = "\"";
  for (const char c : text) {
    out += c == '"' ? std::string("\"\"") : std::string(1, c);
  }
  return out + "\"";
}

std::string csv_of(const FoundLights& found) {
  std::string out =
      "name,finding,x_mm,y_mm,z_mm,sigma_x_mm,sigma_y_mm,sigma_z_mm,direction_x,direction_y,"
      "direction_z,sigma_deg,axis_x,axis_y,axis_z,lobe_mu,power_r,power_g,power_b,relative_"
      "power_sigma,"
      "used_share\n";
  const auto number = [](std::optional<double> value) {
    return value ? fmt::format(",{:.9g}", *value) : std::string(",");
  };
  const auto vector = [&](const std::optional<Vector3d>& v) {
    return v ? number(v->x()) + number(v->y()) + number(v->z()) : std::string(",,,");
  };
  for (const FoundLight& light : found.lights) {
    out += quoted(light.name) + "," + quoted(light.finding);
    out += vector(light.position_mm) + vector(light.sigma_mm);
    out += vector(light.is_seen() ? std::optional<Vector3d>(light.direction) : std::nullopt);
    out += number(light.sigma_deg);
    out += vector(light.lobe ? std::optional<Vector3d>(light.lobe->axis) : std::nullopt);
    out += number(light.lobe ? std::optional<double>(light.lobe->mu) : std::nullopt);
    const bool has_power = found.has_powers && light.is_seen();
    out += vector(has_power ? std::optional<Vector3d>(light.power) : std::nullopt);
    out += number(light.power_sigma) + number(light.used) + "\n";
  }
  return out;
}

std::string row_of(const FoundLight& light, bool has_powers) {
  if (!light.is_seen()) {
    return fmt::format("  {:<20} {}", light.name, light.finding);
  }
  std::string out = fmt::format("  {:<20}", light.name);
  if (light.position_mm) {
    const Vector3d& p = *light.position_mm;
    out += fmt::format(" {:9.2f} {:9.2f} {:9.2f} mm", p.x(), p.y(), p.z());
    out += light.sigma_mm ? fmt::format(" +- {:.2f} {:.2f} {:.2f}", light.sigma_mm->x(),
                                        light.sigma_mm->y(), light.sigma_mm->z())
                          : std::string();
  } else {
    const Vector3d& d = light.direction;
    out += fmt::format(" {:8.5f} {:8.5f} {:8.5f}", d.x(), d.y(), d.z());
    out += light.sigma_deg ? fmt::format(" +- {:.3f} degrees", *light.sigma_deg) : "";
  }
  if (has_powers) {
    out += fmt::format("  power {:.4f}", light.power.mean());
    out += light.power_sigma
               ? fmt::format(" +- {:.4f}", *light.power_sigma * light.power.mean())
               : "";
  }
  return out + (light.finding == "good" ? "" : "  " + light.finding);
}

/// Statistics over all lights.
struct FoundStatistics {
  std::int64_t n_seen = 0;
  std::int64_t n_weak = 0;
  std::vector<double> mm;       ///< standard errors of positions, 3-D
  std::vector<double> degrees;  ///< of directions
};

FoundStatistics statistics_of(const FoundLights& found) {
  FoundStatistics out;
  for (const FoundLight& light : found.lights) {
    out.n_seen += light.is_seen() ? 1 : 0;
    out.n_weak += light.is_seen() && light.finding != "good" ? 1 : 0;
    if (light.sigma_mm) {
      out.mm.push_back(light.sigma_mm->norm());
    }
    if (light.sigma_deg) {
      out.degrees.push_back(*light.sigma_deg);
    }
  }
  return out;
}

}  // namespace

double direction_sigma_deg(const Vector3d& position_mm, const Eigen::Matrix3d& covariance_mm2) {
  const double length = position_mm.norm();
  const Vector3d d = position_mm / length;
  const Eigen::Matrix3d across = Eigen::Matrix3d::Identity() - d * d.transpose();
  return std::sqrt(0.5 * (across * covariance_mm2 * across).trace()) / length * 180.0 /
         std::numbers::pi;
}

void require_writable(const fs::path& out, bool overwrites) {
  require_absent(out, overwrites);
  std::error_code ignored;
  const bool is_folder = fs::is_directory(out, ignored);
  if (is_folder != (form_of(out) == ListForm::folder) && fs::exists(out, ignored)) {
    throw Error(is_folder ? "a folder of that name is there" : "a file of that name is there",
                out.string(), "choose another name", ExitCode::usage);
  }
}

std::uint64_t write_found(const FoundLights& found, const fs::path& out) {
  const ListForm form = form_of(out);
  if (form != ListForm::folder) {
    const std::string text = form == ListForm::json ? json_of(found)
                             : form == ListForm::lp ? lp_of(found)
                                                    : csv_of(found);
    write_file_atomically(out, text);
    return text.size();
  }
  // All texts first: a failure then leaves nothing written.
  const std::string json = json_of(found);
  const std::string lp = lp_of(found);
  const std::string csv = csv_of(found);
  std::error_code error;
  fs::create_directories(out, error);
  if (error) {
    throw Error("cannot make a folder: " + error.message(), out.string(),
                "check the folder's rights and free space", ExitCode::io);
  }
  write_file_atomically(out / "lights.json", json);
  write_file_atomically(out / "lights.lp", lp);
  write_file_atomically(out / "lights.csv", csv);
  std::uint64_t bytes = json.size() + lp.size() + csv.size();
  if (!found.picture.is_empty()) {
    write_image(out / found.picture_name, found.picture.view(), found.picture_exposure);
    bytes += fs::file_size(out / found.picture_name);
  }
  return bytes;
}

std::string found_table(const FoundLights& found) {
  std::string text;
  if (found.lights.size() <= kMostRows) {
    for (const FoundLight& light : found.lights) {
      text += row_of(light, found.has_powers) + "\n";
    }
  }
  return text;
}

std::string found_line(const FoundLights& found) {
  const FoundStatistics all = statistics_of(found);
  std::string how = all.mm.empty() ? ""
                                   : fmt::format(", positions +- {:.2f} mm (3-D, median)",
                                                 median_or_0(all.mm));
  how += all.degrees.empty()
             ? ""
             : fmt::format(", directions +- {:.3f} degrees (median)", median_or_0(all.degrees));
  if (how.empty()) {
    how = ", no +- is known";
  }
  return fmt::format("{} of {} found{}{}\n", all.n_seen, counted(found.lights.size(), "light"),
                     all.n_weak > 0 ? fmt::format(", {} of them weak", all.n_weak) : "", how);
}

void report_found(const FoundLights& found, Report& report) {
  const FoundStatistics all = statistics_of(found);
  report.add_achieved("lights", static_cast<std::int64_t>(found.lights.size()));
  report.add_achieved("lights_seen", all.n_seen);
  report.add_achieved("lights_weak", all.n_weak);
  if (!all.mm.empty()) {
    report.add_achieved("position_sigma_mm_median", median_or_0(all.mm));
    report.add_achieved("position_sigma_mm_largest",
                        *std::max_element(all.mm.begin(), all.mm.end()));
  }
  if (!all.degrees.empty()) {
    report.add_achieved("direction_sigma_deg_median", median_or_0(all.degrees));
    report.add_achieved("direction_sigma_deg_largest",
                        *std::max_element(all.degrees.begin(), all.degrees.end()));
  }
  report.add_detail("frame", found.frame);
}

}  // namespace haarlight::relight
