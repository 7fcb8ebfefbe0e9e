// SPDX-License-Identifier: Apache-2.0
#include "capture/plan/advice_words.h"

#include <cmath>

#include <fmt/format.h>

namespace haarlight::capture {

namespace {

std::string db(double value) { return std::isnan(value) ? "?" : fmt::format("{:.1f}", value); }

std::string family_text(const FamilyAdvice& family, bool is_best) {
  std::string text = fmt::format("{} {:<16}",
                                 is_best                   ? "*"
                                 : family.refusals.empty() ? " "
                                                           : "x",
                                 family.name);
  if (family.predictions.empty()) {
    text += "\n";
  } else {
    text += fmt::format("{:>6} shots {:>8.1f} s {:>10.1f} us {:>8.1f} W\n", family.cost.n_shots,
                        family.cost.seconds, family.exposure_us, family.cost.peak_watts);
  }
  for (const Prediction& p : family.predictions) {
    const double bias_db = 20.0 * std::log10(p.peak_e / p.bias_e);
    text += fmt::format("      {:<22} {:>6} dB   noise alone {:>6} dB, bias alone {:>6} dB\n",
                        p.lighting, db(p.psnr_db), db(p.noise_psnr_db),
                        p.bias_e == 0.0 ? std::string("none") : db(bias_db));
  }
  for (const std::string& note : family.notes) {
    text += fmt::format("      {}\n", note);
  }
  for (const std::string& refusal : family.refusals) {
    text += fmt::format("      refused: {}\n", refusal);
  }
  return text;
}

void report_family(const FamilyAdvice& family, Report& report) {
  const std::string head = "advice." + family.name + ".";
  report.add_detail(head + "shots", std::int64_t{family.cost.n_shots});
  report.add_detail(head + "seconds", family.cost.seconds);
  report.add_detail(head + "exposure_us", family.exposure_us);
  report.add_detail(head + "peak_watts", family.cost.peak_watts);
  for (std::size_t i = 0; i < family.refusals.size(); ++i) {
    report.add_detail(fmt::format("{}refused.{}", head, i), family.refusals[i]);
  }
  for (const Prediction& p : family.predictions) {
    const auto add = [&](const char* key, double value) {
      if (std::isfinite(value)) {
        report.add_detail(fmt::format("{}{}.{}", head, p.lighting, key), value);
      }
    };
    add("psnr_db", p.psnr_db);
    add("noise_psnr_db", p.noise_psnr_db);
    add("peak_e", p.peak_e);
    add("noise_e", p.noise_e);
    add("bias_e", p.bias_e);
  }
}

}  // namespace

std::string advice_text(const Rig& rig, const AdviceScene& scene, const Advice& advice,
                        double target_db) {
  std::string text = fmt::format("rig \"{}\", signal from {}\n", rig.name, scene.source);
  if (!scene.resolves_lights) {
    text +=
        "bias \"?\": what a block of lights hides is not known without a pilot that lit "
        "every light (--pilot SESSION)\n";
  }
  for (std::size_t i = 0; i < advice.families.size(); ++i) {
    text += family_text(advice.families[i], static_cast<int>(i) == advice.best);
  }
  if (advice.best < 0) {
    return text + fmt::format("none of them {}\n",
                              target_db > 0.0 ? fmt::format("reaches {:.1f} dB", target_db)
                                              : "may be used");
  }
  return text + fmt::format("* {}: {}\n",
                            advice.families[static_cast<std::size_t>(advice.best)].name,
                            target_db > 0.0 ? "the fastest that reaches the target"
                                            : "the best under the worst lighting");
}

void add_to_report(const Advice& advice, Report& report) {
  for (const FamilyAdvice& family : advice.families) {
    report_family(family, report);
  }
  if (advice.best >= 0) {
    report.add_achieved("best", advice.families[static_cast<std::size_t>(advice.best)].name);
  }
}

}  // namespace haarlight::capture
