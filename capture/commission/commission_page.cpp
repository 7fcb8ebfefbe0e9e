// SPDX-License-Identifier: Apache-2.0
#include "capture/commission/commission_page.h"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "core/markup.h"
#include "core/plot.h"
#include "core/report.h"

namespace haarlight::capture {

namespace {

constexpr std::size_t kMaxDots = 1200;

/// The measurements as dots, the model as a line.
std::string figure(PlotPanel panel, std::vector<std::pair<double, double>> measured,
                   std::vector<std::pair<double, double>> model) {
  const std::string title = panel.title;
  panel.series.push_back(
      {.name = "measured", .points = std::move(measured), .look = 0, .style = PlotStyle::dots});
  panel.series.push_back(
      {.name = "model", .points = std::move(model), .look = 1, .style = PlotStyle::line});
  return draw_panels(title, {panel}, 1);
}

std::string step_figure(const TimingResult& timing, bool rises) {
  const StepModel& m = timing.fit.model;
  const double slope = std::round(timing.line.slope);
  const double e = timing.short_us;
  const double ramp = rises ? m.rise_us : m.fall_us;
  const double offset = m.offset_us.front() + slope * (e - m.exposures_us.front());
  std::vector<std::pair<double, double>> dots;
  std::vector<const StepSample*> shown;
  for (const StepSample& s : timing.samples) {
    if (s.rises == rises && s.exposure_us == e) {
      shown.push_back(&s);
    }
  }
  const std::size_t stride = std::max<std::size_t>(1, shown.size() / kMaxDots);
  for (std::size_t i = 0; i < shown.size(); i += stride) {
    const StepSample& s = *shown[i];
    dots.emplace_back(s.after_us + s.row * m.skew_us + e - offset, s.level);
  }
  std::vector<std::pair<double, double>> curve;
  for (int i = 0; i <= 200; ++i) {
    const double x = -0.3 * e + (1.6 * e + ramp) * i / 200.0;
    const double fraction = lit_fraction(x, e, ramp);
    curve.emplace_back(x, rises ? fraction : 1.0 - fraction);
  }
  return figure({.title = rises ? "light switched on" : "light switched off",
                 .x_name = "from the LED's first change to the end of a row's exposure, us",
                 .y_name = "fraction of the lit level",
                 .scale = PlotScale::linear,
                 .x_range = PlotRange{-0.3 * e, 1.3 * e + ramp},
                 .y_range = PlotRange{-0.05, 1.05}},
                std::move(dots), std::move(curve));
}

std::string transfer_figure(const NoiseResult& noise) {
  const double black = noise.sensor.black_dn.value;
  double x_max = 10.0;
  double y_max = 10.0;
  for (const TransferBin& bin : noise.bins) {
    if (bin.degrees > 0.0) {
      x_max = std::max(x_max, bin.level() - black);
      y_max = std::max(y_max, bin.variance());
    }
  }
  const double y_min = std::max(0.3 * noise.sensor.dark_variance_dn2, 0.01);
  std::vector<std::pair<double, double>> dots;
  for (const TransferBin& bin : noise.bins) {
    if (bin.degrees > 0.0) {
      dots.emplace_back(bin.level() - black, bin.variance());
    }
  }
  std::vector<std::pair<double, double>> curve;
  for (int i = 0; i <= 200; ++i) {
    const double x = std::pow(10.0, std::log10(x_max) * (i - 100.0) / 100.0);
    curve.emplace_back(x,
                       noise.sensor.dark_variance_dn2 + x / noise.sensor.gain_e_per_dn.value);
  }
  return figure({.title = "photon transfer curve",
                 .x_name = "signal above black, counts",
                 .y_name = "temporal variance, counts squared",
                 .x_range = PlotRange{std::max(1.0, x_max / 1e4), 1.3 * x_max},
                 .y_range = PlotRange{y_min, 2.0 * std::max(y_max, 2.0 * y_min)}},
                std::move(dots), std::move(curve));
}

std::string linearity_figure(const NoiseResult& noise) {
  if (noise.levels.size() < 2) {
    return {};
  }
  const double black = noise.sensor.black_dn.value;
  const ExposureLevel& last = noise.levels.back();
  std::vector<std::pair<double, double>> dots;
  for (const ExposureLevel& l : noise.levels) {
    dots.emplace_back(l.exposure_us, l.mean_dn - black);
  }
  return figure({.title = "linearity",
                 .x_name = "exposure, us",
                 .y_name = "mean signal above black, counts",
                 .scale = PlotScale::linear,
                 .x_range = PlotRange{0.0, 1.05 * last.exposure_us},
                 .y_range = PlotRange{0.0, 1.05 * (last.mean_dn - black)}},
                std::move(dots), {{0.0, 0.0}, {last.exposure_us, last.mean_dn - black}});
}

std::string light_map(const Rig& rig, const LightSurvey& survey) {
  std::string out;
  std::size_t k = 0;
  for (const Face& face : rig.faces) {
    const double cell = std::min(24.0, 480.0 / std::max(face.cols, face.rows));
    out += fmt::format(
        "<h3>{}</h3><svg class='map' viewBox='0 0 {:.0f} {:.0f}' role='img' "
        "aria-label='lights of face {}'>",
        escaped(face.id), cell * face.cols, cell * face.rows, escaped(face.id));
    for (int row = 0; row < face.rows; ++row) {
      for (int col = 0; col < face.cols; ++col, ++k) {
        const int light = static_cast<int>(k);
        const auto in = [light](const std::vector<int>& list) {
          return std::find(list.begin(), list.end(), light) != list.end();
        };
        const double p = survey.power[k];
        const std::string colour =
            in(survey.dead)     ? "#c0392b"
            : in(survey.unseen) ? "#888888"
            : in(survey.miswired)
                ? "#8e44ad"
                : fmt::format("hsl(45 90% {:.0f}%)", std::clamp(65.0 * p, 8.0, 95.0));
        out += fmt::format(
            "<rect x='{:.1f}' y='{:.1f}' width='{:.1f}' height='{:.1f}' fill='{}'>"
            "<title>light {}: power {:.3f}</title></rect>",
            col * cell + 0.5, (face.rows - 1 - row) * cell + 0.5, cell - 1.0, cell - 1.0,
            colour, light, p);
      }
    }
    out += "</svg>";
  }
  return out +
         "<p class='key'>Red: dead. Violet: shines from another light's position. Grey: not "
         "seen. "
         "The brighter, the more power. Point at a light for its number.</p>";
}

std::string list_of(const std::vector<int>& lights) {
  return lights.empty() ? "none" : fmt::format("{}", fmt::join(lights, ", "));
}

}  // namespace

std::vector<CommissionRow> commission_rows(const Rig& rig, int camera,
                                           const CommissionResult& result) {
  std::vector<CommissionRow> rows;
  const auto add = [&rows](std::string name, const std::optional<Measured>& m,
                           std::string_view unit, std::string written, std::string meaning) {
    if (m) {
      rows.push_back({std::move(name), fmt::format("{:.4g}{}", m->value, unit),
                      fmt::format("{:.2g}{}", m->sigma, unit), std::move(written),
                      std::move(meaning)});
    }
  };
  const auto us = [](double value) { return fmt::format("{:.4g} us", value); };
  const MeasuredController& light = *result.measured.controller;
  const CameraSpec& spec = rig.cameras.at(static_cast<std::size_t>(camera));
  const MeasuredCamera& c = result.measured.cameras.front();
  add("latch", light.latch_us, " us", us(rig.controller.latch_us),
      "from the controller's latch to the light's first change");
  add("latch, latest", light.latch_most_us, " us", "",
      "what captures wait for: the latest of all steps, from the read-back that shows the "
      "pattern");
  add("rise", light.rise_us, " us", us(rig.controller.rise_us), "an LED's way up");
  add("fall", light.fall_us, " us", us(rig.controller.fall_us), "and down");
  rows.push_back({"timestamp", c.timestamp ? std::string(to_string(*c.timestamp)) : "", "",
                  std::string(to_string(spec.timestamp)), "what a frame's timestamp means"});
  add("read_us", c.read_us, " us", us(spec.read_us),
      "from the end of the first row's exposure to the timestamp");
  add("skew_us", c.skew_us, " us", us(spec.skew_us),
      "the last row begins that much after the first");
  add("ready", c.ready_us, " us", "",
      "from the end of the last row's exposure to the computer's memory");
  add("exposure delay", c.exposure_delay_frames, " frames",
      fmt::format("{} frames", spec.exposure_delay_frames),
      "frames that still have the old exposure after a new one was set");
  add("gain", c.gain_e_per_dn, " e/DN", fmt::format("{:.4g} e/DN", spec.noise.gain_e_per_dn),
      "electrons a count");
  add("read noise", c.read_e, " e", fmt::format("{:.4g} e", spec.noise.read_e),
      "scatter of a dark pixel");
  add("full well", c.full_well_e, " e", fmt::format("{:.4g} e", spec.noise.full_well_e),
      "electrons at which the signal stops growing");
  add("black level", c.black_dn, " DN", fmt::format("{:.4g} DN", spec.noise.black_dn),
      "counts without light");
  add("linearity", c.linearity_percent, " %", "",
      "largest departure from a straight line, 5 to 95 % of the range");
  if (result.survey) {
    const LightSurvey& s = *result.survey;
    rows.push_back(
        {"dead lights", list_of(s.dead), "", "", "below 5 % of what they should give"});
    rows.push_back({"dim lights", list_of(s.dim), "", "", "below 70 %"});
    if (!s.unseen.empty()) {
      rows.push_back({"unseen lights", list_of(s.unseen), "", "", "too little light to tell"});
    }
    std::vector<std::string> swapped;
    for (std::size_t i = 0; i < s.miswired.size(); ++i) {
      swapped.push_back(fmt::format("{} at {}", s.miswired[i], s.miswired_to[i]));
    }
    rows.push_back({"miswired lights",
                    fmt::format("{}{}{}", fmt::join(swapped, ", "),
                                swapped.empty() && s.can_see_wiring ? "none" : "",
                                s.can_see_wiring  ? ""
                                : swapped.empty() ? "not all can be seen"
                                                  : "; not all can be seen"),
                    "", "", "lights that shine from another one's position"});
  }
  return rows;
}

std::string commission_page(const Rig& rig, int camera, const CommissionResult& result) {
  std::string out = fmt::format(
      "<!doctype html><html lang='en'><head><meta charset='utf-8'>"
      "<meta name='viewport' content='width=device-width'><title>Commissioning of {0}</title>"
      "<style>body{{font:16px/1.5 system-ui,sans-serif;max-width:52rem;margin:2rem auto;"
      "padding:0 1rem;color-scheme:light dark}}svg{{width:100%;font:12px system-ui}}"
      "svg text{{fill:currentColor}}svg.map{{max-width:480px}}table{{border-collapse:collapse;"
      "width:100%}}td,th{{text-align:left;padding:.25rem .6rem .25rem 0;vertical-align:top;"
      "border-bottom:1px solid #8886}}.wrong{{color:#c0392b;font-weight:600}}"
      ".key{{opacity:.75}}</style></head><body><h1>Commissioning of {0}</h1>"
      "<p>{1}, {2}, camera {3}, controller {4}.</p>",
      escaped(rig.name), escaped(result.measured.date), escaped(result.measured.tool),
      escaped(result.measured.cameras.front().identity),
      escaped(result.measured.controller->identity));
  for (const std::string& text : result.contradictions) {
    out += "<p class='wrong'>" + escaped(text) + "</p>";
  }
  for (const std::string& text : result.faults) {
    out += "<p class='wrong'>" + escaped(text) + "</p>";
  }
  for (const std::string& text : result.notes) {
    out += "<p>" + escaped(text) + "</p>";
  }
  out +=
      "<table><tr><th>quantity</th><th>measured</th><th>uncertainty (1 sigma)</th>"
      "<th>rig file</th><th>meaning</th></tr>";
  for (const CommissionRow& row : commission_rows(rig, camera, result)) {
    out += fmt::format("<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
                       escaped(row.name), escaped(row.measured), escaped(row.sigma),
                       escaped(row.written), escaped(row.meaning));
  }
  out += "</table><p>Evidence for the timestamp: " +
         escaped(result.measured.cameras.front().evidence) + ".</p>";
  out += fmt::format(
      "<h2>Step response</h2><p>Dots: rows of frames exposed for {:.0f} us while the light "
      "changed. Line: the fit of {} switches ({:.2f} times the expected scatter).</p>",
      result.timing.short_us, result.timing.fit.n_steps, result.timing.fit.scatter);
  out += "<h3>On</h3>" + step_figure(result.timing, true);
  out += "<h3>Off</h3>" + step_figure(result.timing, false);
  if (result.noise) {
    out +=
        "<h2>Photon transfer</h2><p>Dots: pixel pairs of alike level. Line: the fit; its slope "
        "is the gain, its level at the left the read noise.</p>" +
        transfer_figure(*result.noise) + "<h2>Linearity</h2>" + linearity_figure(*result.noise);
  }
  if (result.survey) {
    out += "<h2>Lights</h2>" + light_map(rig, *result.survey);
  }
  return out + "</body></html>\n";
}

}  // namespace haarlight::capture
