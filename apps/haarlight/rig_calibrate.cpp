// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/rig_calibrate.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include <fmt/format.h>

#include "core/files.h"
#include "core/markup.h"
#include "core/rig/measured_rig.h"
#include "relight/calibration/rig_light_calibration.h"
#include "relight/pipeline/calibrate/measured_file.h"
#include "session/develop/develop.h"

namespace haarlight {

namespace {

constexpr double kDegrees = 180.0 / std::numbers::pi;

/// The session must have been shot with the rig as it is written today.
void require_same_rig(const Session& session, const Rig& written) {
  if (!session.rig().has_value()) {
    throw Error("the session has no rig", session.folder().string(),
                "calibrate from a capture of the rig itself");
  }
  if (split_rig_text(session.rig()->text).written != split_rig_text(written.text).written) {
    throw Error("the session was shot with another rig file than this one",
                session.folder().string(),
                "give the rig file as it was then (SESSION/rig.toml has it), or capture the "
                "sheet again");
  }
}

/// A grid of numbers as coloured squares, from `low` (blue) over white to `high` (red).
std::string map_svg(const std::vector<double>& values, int rows, int cols, double low,
                    double high) {
  constexpr int kSide = 12;
  std::string out = fmt::format(
      "<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {} {}' width='{}' role='img'>",
      cols * kSide, rows * kSide, std::min(cols * kSide, 560));
  for (int y = 0; y < rows; ++y) {
    for (int x = 0; x < cols; ++x) {
      const double value = values[static_cast<std::size_t>(y) * static_cast<std::size_t>(cols) +
                                  static_cast<std::size_t>(x)];
      std::string colour = "#888";
      if (std::isfinite(value)) {
        const double t = std::clamp((value - low) / std::max(high - low, 1e-300), 0.0, 1.0);
        const int fade = static_cast<int>(255.0 * (1.0 - std::abs(2.0 * t - 1.0)));
        colour = t < 0.5 ? fmt::format("#{0:02x}{0:02x}ff", fade)
                         : fmt::format("#ff{0:02x}{0:02x}", fade);
      }
      out += fmt::format(
          "<rect x='{}' y='{}' width='{}' height='{}' fill='{}'><title>{},{}: {:.4g}</title>"
          "</rect>",
          x * kSide, y * kSide, kSide, kSide, colour, y, x, value);
    }
  }
  return out + "</svg>";
}

std::string mapped(std::string_view title, const std::vector<double>& values, int rows,
                   int cols) {
  double low = std::numeric_limits<double>::max();
  double high = std::numeric_limits<double>::lowest();
  for (const double value : values) {
    if (std::isfinite(value)) {
      low = std::min(low, value);
      high = std::max(high, value);
    }
  }
  return fmt::format("<figure><figcaption>{} (blue {:.4g}, red {:.4g})</figcaption>{}</figure>",
                     escaped(title), low, high, map_svg(values, rows, cols, low, high));
}

MeasuredFace measured_face(const Face& face, const FaceCalibration& found) {
  MeasuredFace m;
  m.id = face.id;
  m.with = describe_face(face);
  m.centre = found.world_from_face.translation();
  const Eigen::Matrix3d& turn = found.world_from_face.linear();
  m.u = turn.col(0);
  m.v = turn.col(1);
  m.emits = (face.u.cross(face.v).dot(face.emits) > 0.0 ? 1.0 : -1.0) * turn.col(2);
  for (int c = 0; c < 3; ++c) {
    m.turn_sigma_deg[c] = kDegrees * std::sqrt(found.pose_world(c, c));
    m.centre_sigma[c] = std::sqrt(found.pose_world(3 + c, 3 + c));
  }
  std::int64_t n = 0;
  for (const CalibratedLight& light : found.lights.lights) {
    const bool is_seen = light.finding != LightFinding::unseen;
    m.power.push_back(is_seen ? light.light.power.mean() : 0.0);
    m.power_sigma.push_back(is_seen ? light.sigma.power : 0.0);
    n += light.counts.used;
  }
  if (found.lights.mu_sigma > 0.0) {
    m.lobe_mu = Measured{found.lights.mu, found.lights.mu_sigma, n};
  }
  m.reduced_chi2 = found.lights.reduced_chi2;
  return m;
}

/// "roughness 0.153 +- 0.004 (slope 0.21), sheen ..." of the terms that were fitted.
std::string sheet_text(const LightCalibration& found) {
  std::string out;
  for (std::size_t i = 0; i < kSheetTerms; ++i) {
    const auto term = static_cast<SheetTerm>(i);
    if (!(found.sheet_sigma[term] > 0.0)) {
      continue;
    }
    out += fmt::format("{}{} {:.4f} +- {:.4f}", out.empty() ? "" : ", ", to_string(term),
                       found.sheet[term], found.sheet_sigma[term]);
    if (term == SheetTerm::roughness) {
      out += fmt::format(" (slope {:.2f})", slope_of_roughness(found.sheet[term]));
    }
  }
  return out;
}

std::string page_of(const Rig& rig, const SheetSamples& sheet,
                    const std::vector<FaceCalibration>& faces, const std::string& date,
                    const std::string& session) {
  std::string body;
  for (const FaceCalibration& found : faces) {
    const Face& face = rig.faces[static_cast<std::size_t>(found.face)];
    const MeasuredFace m = measured_face(face, found);
    body += fmt::format("<h2>Face {}</h2><table>", escaped(face.id));
    const auto row = [&body](std::string_view name, const std::string& value) {
      body += fmt::format("<tr><th>{}</th><td>{}</td></tr>", name, value);
    };
    const bool is_known = !found.lights.is_model_wrong();
    row("middle, mm",
        fmt::format("{:.3f} {:.3f} {:.3f}", m.centre.x(), m.centre.y(), m.centre.z()) +
            (is_known ? fmt::format(" &plusmn; {:.3f} {:.3f} {:.3f}", m.centre_sigma.x(),
                                    m.centre_sigma.y(), m.centre_sigma.z())
                      : std::string(": the model is wrong, the error is not known")));
    row("test of the model", test_text(found.lights.test));
    row("moved from the rig file's place",
        fmt::format("{:.3f} mm, turned {:.3f} degrees", found.moved_mm, found.turned_deg));
    if (is_known) {
      row("turn known to, degrees", fmt::format("{:.4f} {:.4f} {:.4f}", m.turn_sigma_deg.x(),
                                                m.turn_sigma_deg.y(), m.turn_sigma_deg.z()));
      row("sheet and lens", escaped(sheet_text(found.lights)));
    }
    row("lobe exponent", fmt::format("{:.4f}", found.lights.mu) +
                             (is_known ? fmt::format(" &plusmn; {:.4f}", found.lights.mu_sigma)
                                       : std::string()));
    row("fit", fmt::format("chi&sup2; {:.3f} a degree of freedom (1: noise alone)",
                           found.lights.reduced_chi2));
    std::vector<double> used;
    std::int64_t saturated = 0;
    std::int64_t dark = 0;
    std::int64_t shadowed = 0;
    std::int64_t outlying = 0;
    for (const CalibratedLight& light : found.lights.lights) {
      used.push_back(static_cast<double>(light.counts.used));
      saturated += light.counts.saturated;
      dark += light.counts.dark;
      shadowed += light.counts.shadowed;
      outlying += light.counts.outlying;
    }
    row("left out", fmt::format("{} saturated, {} dark, {} shadowed, {} outlying samples",
                                saturated, dark, shadowed, outlying));
    body += "</table>";
    std::vector<double> power = m.power;
    for (double& p : power) {
      p = p > 0.0 ? p : std::numeric_limits<double>::quiet_NaN();
    }
    body += mapped("Power of each light", power, face.rows, face.cols);
    body += mapped("Samples used of each light", used, face.rows, face.cols);
    std::vector<double> albedo(
        found.lights.albedo.begin(),
        found.lights.albedo.begin() + static_cast<std::ptrdiff_t>(sheet.samples.n_points()));
    for (double& a : albedo) {
      a = a > 0.0 ? a : std::numeric_limits<double>::quiet_NaN();
    }
    body += mapped("What remains of the sheet: its albedo times the camera's vignetting",
                   albedo, sheet.samples.rows, sheet.samples.cols);
  }
  return fmt::format(
      "<!doctype html><html lang='en'><meta charset='utf-8'><title>Lights of {0}</title>"
      "<style>body{{font-family:sans-serif;max-width:60em;margin:2em auto}}"
      "th{{text-align:left;padding-right:1em}}figure{{margin:1em 0}}</style>"
      "<h1>Lights of {0}, calibrated</h1><p>{1}, from {2}; {3} x {4} blocks of {5} x {5} "
      "pixels, noise {6:.2f} % a block.</p>{7}</html>\n",
      escaped(rig.name), escaped(date), escaped(session), sheet.samples.cols,
      sheet.samples.rows, sheet.block, 100.0 * sheet.relative_noise, body);
}

}  // namespace

std::string test_text(const ModelTest& test) {
  if (!test.is_done) {
    return "not done: too few samples";
  }
  return fmt::format(
      "{}: smooth residuals of {:.0f}, expected {} ({:+.1f} sigma, limit {:.1f}); lobe "
      "{:+.1f}, "
      "limit {:.1f}",
      test.is_passed() ? "passed" : "FAILED", test.chi2, test.n, test.z, ModelTest::kMostZ,
      test.lobe_z, ModelTest::kMostLobeZ);
}

RigFaces fit_rig_faces(const Session& session, const Rig& rig,
                       const CalibrateArguments& arguments, const CommonOptions& common) {
  const bool is_noise_known = !rig.cameras.empty() &&
                              rig.cameras.front().noise.full_well_e > 0.0 &&
                              session.info().form.transfer == Transfer::linear &&
                              session.info().form.sample == SampleType::u16;
  DevelopOptions develop_options;
  develop_options.memory_bytes = common.memory_bytes;
  develop_options.progress = common.progress();
  develop_options.has_standard_error = is_noise_known;
  const Developed developed = develop_all(session, develop_options);
  SheetOptions sheet_options;
  sheet_options.height_mm = arguments.sheet_mm;
  if (!arguments.region.empty()) {
    sheet_options.region = SheetRegion{arguments.region[0], arguments.region[1],
                                       arguments.region[2], arguments.region[3]};
  }
  RigFaces out;
  out.sheet = sample_sheet(rig, developed.stack,
                           developed.standard_error ? &*developed.standard_error : nullptr,
                           sheet_options);
  CalibrationOptions options;
  options.mask.saturation = std::numeric_limits<double>::max();  // the stack's errors tell
  options.lobe = arguments.lobe == "free" ? Lobe::free : Lobe::given;
  options.sheet = sheet_priors(rig, out.sheet);
  for (const SheetTerm term : {SheetTerm::bow_xx, SheetTerm::bow_xy, SheetTerm::bow_yy}) {
    options.sheet.sigma[term] = arguments.bow_mm;
  }
  out.faces = calibrate_faces(rig, out.sheet, options);
  out.is_plane_measured = options.sheet.is_free(SheetTerm::height);
  out.is_noise_known = developed.standard_error.has_value();
  for (const FaceCalibration& found : out.faces) {
    out.is_good = out.is_good && found.lights.is_usable() && !found.lights.is_model_wrong();
  }
  return out;
}

void tell_faces(const Rig& rig, const RigFaces& fit, const CommonOptions& common,
                Report& report) {
  for (const FaceCalibration& found : fit.faces) {
    const Face& face = rig.faces[static_cast<std::size_t>(found.face)];
    const MeasuredFace m = measured_face(face, found);
    const bool is_wrong = found.lights.is_model_wrong();
    fmt::print("face {:<8} moved {:.3f} mm, turned {:.3f} degrees; middle {}\n  {}\n", face.id,
               found.moved_mm, found.turned_deg,
               is_wrong ? std::string("of unknown error: the model is wrong")
                        : fmt::format("+- {:.3f} mm", m.centre_sigma.norm()),
               found.lights.brief_report());
    report.add_reached("moved_mm_" + face.id, found.moved_mm);
    report.add_reached("turned_deg_" + face.id, found.turned_deg);
    if (is_wrong) {
      fmt::print(
          stderr,
          "face {}: the pictures hold something that no unknown of the model can follow; "
          "test {}\n  cure: a flatter and more matte sheet without dirt, no stray light; "
          "see the page, and docs/numerics/near-light.md\n",
          face.id, test_text(found.lights.test));
    } else {
      fmt::print("  {}\n", sheet_text(found.lights));
      report.add_reached("centre_sigma_mm_" + face.id, m.centre_sigma.norm());
    }
    report.add_reached("model_test_sigma_" + face.id, found.lights.test.z);
    report.add_reached("lobe_mu_" + face.id, found.lights.mu);
    report.add_reached("reduced_chi2_" + face.id, found.lights.reduced_chi2);
  }
  if (!fit.is_plane_measured && !common.quiet) {
    fmt::print(stderr,
               "note: the plane was not measured: +- is relative to where the rig file has it\n"
               "  cure: haarlight rig calibrate plane, before\n");
  }
  if (!fit.is_noise_known && !common.quiet) {
    fmt::print(stderr,
               "note: the camera's noise is not known: saturated samples could not be left "
               "out\n  cure: haarlight rig commission, or noise = {{ ... }} in the rig file\n");
  }
}

RigFaces store_rig_faces(const CalibrateArguments& arguments, const CommonOptions& common,
                         Report& report) {
  const Rig written = read_rig_as_written(arguments.rig);
  std::filesystem::path page = arguments.page;
  if (page.empty()) {
    page = arguments.rig;
    page.replace_extension(".lights.html");
  }
  if (arguments.session.empty()) {
    throw Error("no pictures to calibrate from", arguments.rig,
                "capture a flat matte sheet on the plane, then name it: --session SESSION",
                ExitCode::usage);
  }
  require_absent(page, common.force);
  const Session session = Session::open(arguments.session);
  require_same_rig(session, written);
  // The lens, the plane and the lights as they are known today.
  RigFaces fit = fit_rig_faces(session, read_rig(arguments.rig), arguments, common);
  MeasuredFile stored(written);
  MeasuredRig& measured = stored.values;
  measured.faces.clear();
  for (const FaceCalibration& found : fit.faces) {
    measured.faces.push_back(
        measured_face(written.faces[static_cast<std::size_t>(found.face)], found));
  }
  tell_faces(written, fit, common, report);
  write_file_atomically(
      page, page_of(written, fit.sheet, fit.faces, measured.date, arguments.session));
  fmt::print("page: {}\n", page.string());
  if (!fit.is_good) {
    fmt::print(stderr, "the fit did not end well; nothing was stored beside the rig file\n");
    return fit;
  }
  report.set_bytes(stored.write());
  fmt::print("measured values: {}\n", stored.path().string());
  return fit;
}

ExitCode run_calibrate_lights(const CalibrateArguments& arguments, const CommonOptions& common,
                              Report& report) {
  return store_rig_faces(arguments, common, report).is_good ? ExitCode::done
                                                            : ExitCode::target_missed;
}

}  // namespace haarlight
