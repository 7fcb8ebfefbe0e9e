// SPDX-License-Identifier: Apache-2.0
#include "relight/shadow/rig_predict_words.h"

#include <cmath>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

namespace haarlight::relight {

namespace {

std::string words(const Span& span) {
  if (span.most - span.least < 0.005 * span.most) {
    return fmt::format("{:.2f} mm", span.middle);
  }
  return fmt::format("{:.2f} mm ({:.2f} to {:.2f} over the plane)", span.middle, span.least,
                     span.most);
}

nlohmann::json json_of(const Span& span) {
  return {{"least", span.least}, {"middle", span.middle}, {"most", span.most}};
}

nlohmann::json json_of(const EdgePrediction& edge) {
  nlohmann::json json = {{"height_mm", edge.height_mm},
                         {"spacing_mm", json_of(edge.spacing_mm)},
                         {"penumbra_mm", json_of(edge.penumbra_mm)},
                         {"ripple", edge.ripple},
                         {"sun_penumbra_mm", edge.sun_penumbra_mm},
                         {"hard_sun_error_mm", nullptr},
                         {"off_grid_error_mm", edge.off_grid_error_mm},
                         {"largest_pixel_mm", edge.largest_pixel_mm},
                         {"receivers", nlohmann::json::array()}};
  if (edge.hard_sun_error_mm) {
    json["hard_sun_error_mm"] = *edge.hard_sun_error_mm;
  }
  for (const ReceiverPrediction& receiver : edge.receivers) {
    json["receivers"].push_back({{"height_mm", receiver.height_mm},
                                 {"penumbra_mm", receiver.penumbra_mm},
                                 {"drawn_mm", receiver.drawn_mm}});
  }
  return json;
}

nlohmann::json json_of(const RigPrediction& prediction) {
  nlohmann::json planes = nlohmann::json::array();
  for (const PlanePrediction& plane : prediction.planes) {
    nlohmann::json edges = nlohmann::json::array();
    for (const EdgePrediction& edge : plane.edges) {
      edges.push_back(json_of(edge));
    }
    planes.push_back({{"face", plane.face},
                      {"plane", plane.plane},
                      {"tilt_deg", plane.tilt_deg},
                      {"light_height_mm", plane.light_height_mm},
                      {"lowest_light_mm", plane.lowest_light_mm},
                      {"edges", std::move(edges)}});
  }
  nlohmann::json pixels = nlohmann::json::array();
  for (const PixelPrediction& pixel : prediction.pixels) {
    pixels.push_back({{"camera", pixel.camera},
                      {"plane", pixel.plane},
                      {"seen_share", pixel.seen_fraction},
                      {"pixel_mm", json_of(pixel.pixel_mm)}});
  }
  return {{"planes", std::move(planes)},
          {"pixels", std::move(pixels)},
          {"notes", prediction.notes}};
}

std::string edge_text(const EdgePrediction& edge, double strip_mm) {
  std::string text = fmt::format("  an edge {:g} mm over the plane\n", edge.height_mm);
  const auto line = [&text](const char* name, const std::string& value) {
    text += fmt::format("    {:<24}{}\n", name, value);
  };
  line("shadow spacing", words(edge.spacing_mm));
  line("penumbra", words(edge.penumbra_mm));
  line("ripple from the gaps",
       fmt::format("{:.2g} % of the shadow of a strip {:g} mm wide, all lights on",
                   100.0 * edge.ripple, strip_mm));
  line("hard sun",
       edge.hard_sun_error_mm
           ? fmt::format("its penumbra is {:.2f} mm; drawn by one LED: squared error {:.3f} mm "
                         "a mm of edge",
                         edge.sun_penumbra_mm, *edge.hard_sun_error_mm)
           : fmt::format("its penumbra of {:.2f} mm is wider than one LED's: use several",
                         edge.sun_penumbra_mm));
  line("light between two LEDs",
       fmt::format("squared error {:.3f} mm a mm of edge", edge.off_grid_error_mm));
  line("largest camera pixel", fmt::format("{:.2f} mm on the plane", edge.largest_pixel_mm));
  for (const ReceiverPrediction& receiver : edge.receivers) {
    line("on a surface",
         receiver.height_mm >= edge.height_mm
             ? fmt::format("at {:+g} mm: over this edge, lit", receiver.height_mm)
             : fmt::format(
                   "at {:+g} mm: penumbra {:.2f} mm, drawn {:.2f} mm ({:+.0f} %)",
                   receiver.height_mm, receiver.penumbra_mm, receiver.drawn_mm,
                   std::round(100.0 * (receiver.drawn_mm / receiver.penumbra_mm - 1.0)) + 0.0));
  }
  return text;
}

}  // namespace

std::string prediction_text(const RigPrediction& prediction, double strip_mm) {
  std::string text;
  for (const PlanePrediction& plane : prediction.planes) {
    text += fmt::format(
        "face \"{}\" over plane \"{}\": {:.0f} mm above it{}\n", plane.face, plane.plane,
        plane.light_height_mm,
        plane.tilt_deg > 0.01 ? fmt::format(", tilted by {:.1f} degrees", plane.tilt_deg) : "");
    for (const EdgePrediction& edge : plane.edges) {
      text += edge_text(edge, strip_mm);
    }
  }
  for (const PixelPrediction& pixel : prediction.pixels) {
    text += fmt::format(
        "camera \"{}\" on plane \"{}\": pixels of {}, sees {:.0f} % of its picture\n",
        pixel.camera, pixel.plane, words(pixel.pixel_mm), 100.0 * pixel.seen_fraction);
    for (const PlanePrediction& plane : prediction.planes) {
      const EdgePrediction& low = plane.edges.front();
      if (plane.plane == pixel.plane && low.height_mm > 0.0 &&
          pixel.pixel_mm.most > low.largest_pixel_mm) {
        text +=
            fmt::format("  too coarse for the penumbra of face \"{}\" at {:g} mm ({:.2f} mm)\n",
                        plane.face, low.height_mm, low.penumbra_mm.least);
      }
    }
  }
  for (const std::string& note : prediction.notes) {
    text += fmt::format("note: {}\n", note);
  }
  return text;
}

std::string prediction_json(const RigPrediction& prediction) {
  return json_of(prediction).dump(2);
}

void add_to_report(const PredictOptions& options, const RigPrediction& prediction,
                   Report& report) {
  report.add_requested("object_height_mm",
                       std::vector<double>{options.low_mm, options.high_mm});
  const PlanePrediction& first = prediction.planes.front();
  const EdgePrediction& high = first.edges.back();
  report.add_achieved("spacing_mm", high.spacing_mm.middle);
  report.add_achieved("penumbra_mm", high.penumbra_mm.middle);
  report.add_achieved("ripple", high.ripple);
  report.add_achieved("largest_pixel_mm", first.edges.front().largest_pixel_mm);
}

}  // namespace haarlight::relight
