// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/calibrate/rig_lights_pipeline.h"

#include <cmath>
#include <limits>
#include <numbers>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/session/develop/develop.h"
#include "relight/pipeline/calibrate/measured_file.h"
#include "relight/pipeline/calibrate/rig_lights_page.h"

namespace haarlight::relight {

namespace {

constexpr double kDegrees = 180.0 / std::numbers::pi;

/// The session must have been shot with the rig as currently written.
void require_same_rig(const session::Session& session, const Rig& written) {
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

}  // namespace

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

/// "roughness 0.153 +- 0.004 (slope 0.21), sheen ..." for the terms that were fitted.
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

RigFaces fit_rig_faces(const session::Session& session, const Rig& rig,
                       const RigLightsOptions& options) {
  const bool is_noise_known = !rig.cameras.empty() &&
                              rig.cameras.front().noise.full_well_e > 0.0 &&
                              session.info().form.transfer == Transfer::linear &&
                              session.info().form.sample == session::SampleType::u16;
  session::DevelopOptions develop_options;
  develop_options.memory_bytes = options.settings.memory_bytes;
  develop_options.progress = options.settings.progress;
  develop_options.has_standard_error = is_noise_known;
  const session::Developed developed = session::develop_all(session, develop_options);
  SheetOptions sheet_options;
  sheet_options.height_mm = options.sheet_mm;
  sheet_options.region = options.region;
  RigFaces out;
  out.sheet = sample_sheet(rig, developed.stack,
                           developed.standard_error ? &*developed.standard_error : nullptr,
                           sheet_options);
  CalibrationOptions calibration;
  calibration.mask.saturation = std::numeric_limits<double>::max();  // the stack's errors tell
  calibration.lobe = options.lobe;
  calibration.sheet = sheet_priors(rig, out.sheet);
  for (const SheetTerm term : {SheetTerm::bow_xx, SheetTerm::bow_xy, SheetTerm::bow_yy}) {
    calibration.sheet.sigma[term] = options.bow_mm;
  }
  out.faces = calibrate_faces(rig, out.sheet, calibration);
  out.is_plane_measured = calibration.sheet.is_free(SheetTerm::height);
  out.is_noise_known = developed.standard_error.has_value();
  for (const FaceCalibration& found : out.faces) {
    out.is_good = out.is_good && found.lights.is_usable() && !found.lights.is_model_wrong();
  }
  return out;
}

void add_face_notes(const Rig& rig, const RigFaces& fit, PipelineNotes& notes) {
  for (const FaceCalibration& found : fit.faces) {
    const Face& face = rig.faces[static_cast<std::size_t>(found.face)];
    const MeasuredFace m = measured_face(face, found);
    const bool is_wrong = found.lights.is_model_wrong();
    notes.add(NoteKind::result,
              fmt::format("face {:<8} moved {:.3f} mm, turned {:.3f} degrees; middle {}\n  {}",
                          face.id, found.moved_mm, found.turned_deg,
                          is_wrong ? std::string("of unknown error: the model is wrong")
                                   : fmt::format("+- {:.3f} mm", m.centre_sigma.norm()),
                          found.lights.brief_report()));
    if (is_wrong) {
      notes.add(
          NoteKind::caution,
          fmt::format(
              "face {}: the pictures hold something that no unknown of the model can follow; "
              "test {}\n  hint: a flatter and more matte sheet without dirt, no stray light; "
              "see the page, and docs/numerics/near-light.md",
              face.id, test_text(found.lights.test)));
    } else {
      notes.add(NoteKind::result, fmt::format("  {}", sheet_text(found.lights)));
    }
  }
  if (!fit.is_plane_measured) {
    notes.add(NoteKind::note,
              "the plane was not measured: +- is relative to where the rig file has it\n"
              "  hint: haarlight rig calibrate plane, before");
  }
  if (!fit.is_noise_known) {
    notes.add(NoteKind::note,
              "the camera's noise is not known: saturated samples could not be left "
              "out\n  hint: haarlight rig commission, or noise = { ... } in the rig file");
  }
}

void report_faces(const Rig& rig, const RigFaces& fit, Report& report) {
  for (const FaceCalibration& found : fit.faces) {
    const Face& face = rig.faces[static_cast<std::size_t>(found.face)];
    report.add_achieved("moved_mm_" + face.id, found.moved_mm);
    report.add_achieved("turned_deg_" + face.id, found.turned_deg);
    if (!found.lights.is_model_wrong()) {
      report.add_achieved("centre_sigma_mm_" + face.id,
                          measured_face(face, found).centre_sigma.norm());
    }
    report.add_achieved("model_test_sigma_" + face.id, found.lights.test.z);
    report.add_achieved("lobe_mu_" + face.id, found.lights.mu);
    report.add_achieved("reduced_chi2_" + face.id, found.lights.reduced_chi2);
  }
}

RigLightsSummary calibrate_rig_lights(const RigLightsOptions& options) {
  RigLightsSummary summary;
  summary.rig = read_rig_as_written(options.rig);
  summary.page = options.page;
  if (summary.page.empty()) {
    summary.page = options.rig;
    summary.page.replace_extension(".lights.html");
  }
  if (options.session.empty()) {
    throw Error("no pictures to calibrate from", options.rig.string(),
                "capture a flat matte sheet on the plane, then name it: --session SESSION",
                ExitCode::usage);
  }
  require_absent(summary.page, options.settings.overwrites);
  const session::Session session = session::Session::open(options.session);
  require_same_rig(session, summary.rig);
  // The lens, the plane and the lights as currently known.
  summary.faces = fit_rig_faces(session, read_rig(options.rig), options);
  MeasuredFile stored(summary.rig);
  MeasuredRig& measured = stored.values;
  measured.faces.clear();
  for (const FaceCalibration& found : summary.faces.faces) {
    measured.faces.push_back(
        measured_face(summary.rig.faces[static_cast<std::size_t>(found.face)], found));
  }
  PipelineNotes notes(options.settings.tell);
  add_face_notes(summary.rig, summary.faces, notes);
  write_file_atomically(summary.page, rig_lights_page(summary.rig, summary.faces, measured.date,
                                                      options.session.string()));
  notes.add(NoteKind::result, fmt::format("page: {}", summary.page.string()));
  if (summary.faces.is_good) {
    summary.bytes = stored.write();
    summary.measured = stored.path();
    notes.add(NoteKind::result, fmt::format("measured values: {}", stored.path().string()));
  } else {
    notes.add(NoteKind::caution,
              "the fit did not end well; nothing was stored beside the rig file");
  }
  summary.notes = notes.all();
  return summary;
}

}  // namespace haarlight::relight
