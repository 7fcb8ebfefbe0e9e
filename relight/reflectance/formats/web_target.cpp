// SPDX-License-Identifier: Apache-2.0
#include "relight/reflectance/formats/web_target.h"

#include <utility>

#include <fmt/format.h>

#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

constexpr double kWorst = 1.0;
constexpr double kBest = 100.0;
constexpr int kHalvings = 8;

}  // namespace

WebFiles code_to_bytes(const ReflectanceModel& model, std::uint64_t most_bytes,
                       const std::string& where) {
  WebFiles best = code_web_folder(model, {.quality = kBest}, where);
  if (best.bytes() <= most_bytes) {
    return best;
  }
  best = code_web_folder(model, {.quality = kWorst}, where);
  if (best.bytes() > most_bytes) {
    throw Error(fmt::format("{} bytes do not hold {} planes of {} x {}: {} is the least",
                            most_bytes, model.n_planes(), model.planes.width(),
                            model.planes.height(), best.bytes()),
                where, "give more, or fit fewer planes: --planes 9, --resolution 12");
  }
  double low = kWorst;
  double high = kBest;
  for (int i = 0; i < kHalvings; ++i) {
    const double middle = 0.5 * (low + high);
    WebFiles files = code_web_folder(model, {.quality = middle}, where);
    if (files.bytes() <= most_bytes) {
      low = middle;
      best = std::move(files);
    } else {
      high = middle;
    }
  }
  return best;
}

WebFiles code_to_psnr(const ReflectanceModel& model, double psnr_db,
                      const MeasurePictures& measure, const std::string& where) {
  const auto achieved = [&](const WebFiles& files) {
    return measure(decode_web_files(files, where));
  };
  WebFiles best = code_web_folder(model, {.quality = kBest}, where);
  const double most = achieved(best);
  if (most < psnr_db) {
    throw Error(fmt::format("{:.2f} dB cannot be achieved: the best quality gives {:.2f} dB",
                            psnr_db, most),
                where, "ask for less, or fit another basis or more planes");
  }
  double low = kWorst;
  double high = kBest;
  for (int i = 0; i < kHalvings; ++i) {
    const double middle = 0.5 * (low + high);
    WebFiles files = code_web_folder(model, {.quality = middle}, where);
    if (achieved(files) >= psnr_db) {
      high = middle;
      best = std::move(files);
    } else {
      low = middle;
    }
  }
  return best;
}

}  // namespace haarlight::relight
