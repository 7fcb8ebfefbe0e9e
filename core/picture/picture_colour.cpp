// SPDX-License-Identifier: Apache-2.0
#include "core/picture/picture_colour.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <optional>
#include <string_view>

#include <Eigen/Core>
#include <Eigen/LU>
#include <fmt/format.h>
#include <lcms2.h>

namespace haarlight {

namespace {

struct CloseProfile {
  void operator()(void* profile) const noexcept { cmsCloseProfile(profile); }
};
using Profile = std::unique_ptr<void, CloseProfile>;

struct FreeCurve {
  void operator()(cmsToneCurve* curve) const noexcept { cmsFreeToneCurve(curve); }
};
using Curve = std::unique_ptr<cmsToneCurve, FreeCurve>;

struct DeleteTransform {
  void operator()(void* transform) const noexcept { cmsDeleteTransform(transform); }
};

constexpr Chromaticities kRec709{0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290};
// Adobe RGB (1998) Color Image Encoding, version 2005-05
constexpr Chromaticities kAdobeRgb{0.64, 0.33, 0.21, 0.71, 0.15, 0.06, 0.3127, 0.3290};
constexpr double kAdobeGamma = 563.0 / 256.0;

constexpr const char* kHint = "save the picture as sRGB, with a good profile or none";

Curve gamma_curve(double gamma) { return Curve(cmsBuildGamma(nullptr, gamma)); }

Curve srgb_curve() {
  // IEC 61966-2-1 as ICC's function of type 3
  const std::array<double, 5> parameters{2.4, 1.0 / 1.055, 0.055 / 1.055, 1.0 / 12.92, 0.04045};
  return Curve(cmsBuildParametricToneCurve(nullptr, 4, parameters.data()));
}

/// Null where the chromaticities are degenerate.
Profile rgb_profile(const Chromaticities& c, cmsToneCurve* curve) {
  const cmsCIExyY white{c[6], c[7], 1.0};
  const cmsCIExyYTRIPLE primaries{{c[0], c[1], 1.0}, {c[2], c[3], 1.0}, {c[4], c[5], 1.0}};
  cmsToneCurve* curves[3] = {curve, curve, curve};
  return Profile(cmsCreateRGBProfile(&white, &primaries, curves));
}

/// Columns: the D50-adapted XYZ of red, green and blue.
std::optional<Eigen::Matrix3d> colorants_of(cmsHPROFILE profile) {
  constexpr std::array<cmsTagSignature, 3> kTags{cmsSigRedColorantTag, cmsSigGreenColorantTag,
                                                 cmsSigBlueColorantTag};
  Eigen::Matrix3d matrix;
  for (int c = 0; c < 3; ++c) {
    const auto* xyz =
        static_cast<const cmsCIEXYZ*>(cmsReadTag(profile, kTags[static_cast<std::size_t>(c)]));
    if (xyz == nullptr) {
      return std::nullopt;
    }
    matrix.col(c) << xyz->X, xyz->Y, xyz->Z;
  }
  return matrix;
}

/// An ICC curve as a function; a table is interpolated between its 16-bit entries.
class CurveTable {
 public:
  explicit CurveTable(const cmsToneCurve* curve) : curve_(cmsDupToneCurve(curve)) {
    if (cmsGetToneCurveParametricType(curve) == 0) {
      const std::uint16_t* first = cmsGetToneCurveEstimatedTable(curve);
      table_.assign(first, first + cmsGetToneCurveEstimatedTableEntries(curve));
    }
  }

  [[nodiscard]] float operator()(float code) const {
    if (table_.size() < 2) {
      return cmsEvalToneCurveFloat(curve_.get(), code);
    }
    const double position =
        std::clamp(double{code}, 0.0, 1.0) * static_cast<double>(table_.size() - 1);
    const auto below = std::min(static_cast<std::size_t>(position), table_.size() - 2);
    const double fraction = position - static_cast<double>(below);
    constexpr double kWhite = 65535.0;
    return static_cast<float>(
        (table_[below] * (1.0 - fraction) + table_[below + 1] * fraction) / kWhite);
  }

 private:
  Curve curve_;
  std::vector<std::uint16_t> table_;
};

/// One curve per channel, then a matrix: the form of camera and display profiles.
class MatrixConversion final : public ColourConversion {
 public:
  MatrixConversion(std::vector<CurveTable> curves, const Eigen::Matrix3d& matrix)
      : curves_(std::move(curves)), matrix_(matrix.cast<float>()) {}

  void to_linear(std::span<float> pixels, int channels) const override {
    if (channels == 1) {
      // Grey through a three-colour profile is white's fraction of each.
      for (float& value : pixels) {
        const Eigen::Vector3f rgb = linear(value, value, value);
        value = curves_.size() == 1 ? rgb.x() : luminance(rgb);
      }
      return;
    }
    for (std::size_t i = 0; i + 2 < pixels.size(); i += 3) {
      const Eigen::Vector3f rgb = linear(pixels[i], pixels[i + 1], pixels[i + 2]);
      std::copy_n(rgb.data(), 3, &pixels[i]);
    }
  }

 private:
  static float luminance(const Eigen::Vector3f& rgb) {
    return rgb.dot(Eigen::Vector3f(0.2126F, 0.7152F, 0.0722F));  // ITU-R BT.709
  }
  [[nodiscard]] Eigen::Vector3f linear(float r, float g, float b) const {
    const std::size_t last = curves_.size() - 1;  // the first in a grey profile
    return matrix_ * Eigen::Vector3f(curves_[0](r), curves_[std::min<std::size_t>(1, last)](g),
                                     curves_[last](b));
  }

  std::vector<CurveTable> curves_;
  Eigen::Matrix3f matrix_;
};

/// A lookup table of colours, as in scanner and printer profiles: by lcms2, in floats.
class TableConversion final : public ColourConversion {
 public:
  TableConversion(void* transform, int channels) : transform_(transform), channels_(channels) {}

  void to_linear(std::span<float> pixels, int channels) const override {
    std::vector<float> from(static_cast<std::size_t>(channels_));
    std::array<float, 3> to{};
    const auto n = static_cast<std::size_t>(channels);
    for (std::size_t i = 0; i + n <= pixels.size(); i += n) {
      for (std::size_t c = 0; c < from.size(); ++c) {
        from[c] = pixels[i + std::min(c, n - 1)];
      }
      cmsDoTransform(transform_.get(), from.data(), to.data(), 1);
      if (n == 1) {
        pixels[i] = to[1];
      } else {
        std::copy_n(to.begin(), 3, &pixels[i]);
      }
    }
  }

 private:
  std::unique_ptr<void, DeleteTransform> transform_;
  int channels_;
};

std::shared_ptr<const ColourConversion> table_conversion(cmsHPROFILE profile, bool is_grey) {
  const Curve straight = gamma_curve(1.0);
  const Profile linear = rgb_profile(kRec709, straight.get());
  void* transform = cmsCreateTransform(profile, is_grey ? TYPE_GRAY_FLT : TYPE_RGB_FLT,
                                       linear.get(), TYPE_RGB_FLT, INTENT_RELATIVE_COLORIMETRIC,
                                       cmsFLAGS_NOCACHE | cmsFLAGS_NOOPTIMIZE);
  return transform == nullptr ? nullptr
                              : std::make_shared<TableConversion>(transform, is_grey ? 1 : 3);
}

/// Null where the profile lacks what its type requires.
std::shared_ptr<const ColourConversion> conversion_of(cmsHPROFILE profile) {
  const bool is_grey = cmsGetColorSpace(profile) == cmsSigGrayData;
  if (cmsIsTag(profile, cmsSigAToB0Tag) != 0 || cmsGetPCS(profile) != cmsSigXYZData) {
    return table_conversion(profile, is_grey);
  }
  constexpr std::array<cmsTagSignature, 3> kCurves{cmsSigRedTRCTag, cmsSigGreenTRCTag,
                                                   cmsSigBlueTRCTag};
  std::vector<CurveTable> curves;
  for (int c = 0; c < (is_grey ? 1 : 3); ++c) {
    const auto* curve = static_cast<const cmsToneCurve*>(
        cmsReadTag(profile, is_grey ? cmsSigGrayTRCTag : kCurves[static_cast<std::size_t>(c)]));
    if (curve == nullptr) {
      return nullptr;
    }
    curves.emplace_back(curve);
  }
  if (is_grey) {
    return std::make_shared<MatrixConversion>(std::move(curves), Eigen::Matrix3d::Identity());
  }
  const Curve straight = gamma_curve(1.0);
  const Profile linear = rgb_profile(kRec709, straight.get());
  const auto from = colorants_of(profile);
  const auto to = colorants_of(linear.get());
  if (!from || !to || !from->allFinite() || std::abs(from->determinant()) < 1e-6) {
    return nullptr;
  }
  return std::make_shared<MatrixConversion>(std::move(curves), to->inverse() * *from);
}

/// All 8-bit greys, and six steps of each colour.
std::vector<float> probes() {
  std::vector<float> result;
  for (int code = 0; code < 256; ++code) {
    result.insert(result.end(), 3, static_cast<float>(code) / 255.0F);
  }
  constexpr int kSteps = 6;
  for (int i = 0; i < kSteps * kSteps * kSteps; ++i) {
    for (const int step : {i / (kSteps * kSteps), i / kSteps % kSteps, i % kSteps}) {
      result.push_back(static_cast<float>(step) / (kSteps - 1));
    }
  }
  return result;
}

/// sRGB or linear light, where the conversion agrees with one of these to half an 8-bit sRGB
/// code.
std::optional<Transfer> known_as(const ColourConversion& conversion, int channels) {
  const std::vector<float> codes = probes();
  std::vector<float> light = codes;
  conversion.to_linear(light, channels);
  const auto is = [&](auto expected) {
    for (std::size_t i = 0; i < codes.size(); ++i) {
      if (!(std::abs(srgb_from_linear(light[i]) - srgb_from_linear(expected(codes[i]))) <
            0.5F / 255.0F)) {
        return false;
      }
    }
    return true;
  };
  if (is([](float code) { return linear_from_srgb(code); })) {
    return Transfer::srgb;
  }
  return is([](float code) { return code; }) ? std::optional(Transfer::linear) : std::nullopt;
}

std::string name_of(cmsHPROFILE profile) {
  std::array<char, 65> text{};
  cmsGetProfileInfoASCII(profile, cmsInfoDescription, "en", "US", text.data(),
                         static_cast<cmsUInt32Number>(text.size() - 1));
  std::string name = text.data();
  std::replace_if(
      name.begin(), name.end(), [](char c) { return c < ' ' || c > '~'; }, '?');
  return name.empty() ? "without a name" : name;
}

PictureColours colours_by(const PictureSource& source, const PictureContent& content,
                          cmsHPROFILE profile, const std::string& name) {
  const int channels = content.pixels.channels();
  const bool is_grey = cmsGetColorSpace(profile) == cmsSigGrayData;
  if (is_grey && channels == 3) {
    refuse_picture(source, fmt::format("its colour profile \"{}\" is of grey pictures", name),
                   kHint);
  }
  const std::shared_ptr<const ColourConversion> conversion = conversion_of(profile);
  if (conversion == nullptr) {
    refuse_picture(source, fmt::format("its colour profile \"{}\" is damaged", name), kHint);
  }
  const std::optional<Transfer> known = known_as(*conversion, channels);
  // Floats with an sRGB profile are still sRGB codes: a transfer of srgb is for integers.
  if (known && (*known == Transfer::linear || !content.is_floating)) {
    return {.transfer = *known};
  }
  return {.conversion = conversion, .name = name};
}

/// From the numbers in the file alone.
PictureColours colours_by(const PictureSource& source, const PictureContent& content,
                          const Chromaticities& primaries, const Curve& curve,
                          const std::string& name) {
  const Profile profile = rgb_profile(primaries, curve.get());
  if (profile == nullptr || !colorants_of(profile.get())) {
    refuse_picture(source, fmt::format("its colours ({}) span nothing", name), kHint);
  }
  return colours_by(source, content, profile.get(), name);
}

Profile open_profile(const PictureSource& source, const std::vector<std::byte>& icc) {
  Profile profile(cmsOpenProfileFromMem(icc.data(), static_cast<cmsUInt32Number>(icc.size())));
  constexpr std::size_t kHeaderBytes = 128;
  if (profile == nullptr || icc.size() < kHeaderBytes) {
    refuse_picture(source, "its colour profile is damaged", kHint);
  }
  // From the header itself: lcms2 returns its words as an enumeration, whatever their values.
  const auto word_at = [&icc](std::size_t at) {
    return std::string_view(reinterpret_cast<const char*>(icc.data()) + at, 4);
  };
  const std::string_view colours = word_at(16);
  const std::string_view connection = word_at(20);
  if ((colours != "RGB " && colours != "GRAY") ||
      (connection != "XYZ " && connection != "Lab ")) {
    refuse_picture(
        source,
        fmt::format("its colour profile \"{}\" is not of RGB or grey", name_of(profile.get())),
        kHint);
  }
  return profile;
}

PictureColours colours_by_png(const PictureSource& source, const PictureContent& content) {
  const ColourTags& tags = content.tags.colour;
  std::string name = "PNG's";
  Curve curve = srgb_curve();
  if (tags.gamma) {
    constexpr double kLeast = 0.01;
    if (*tags.gamma < kLeast || *tags.gamma > 1.0 / kLeast) {
      refuse_picture(source, fmt::format("its gAMA chunk says {}", *tags.gamma), kHint);
    }
    // Encoders write 1/2.2 for sRGB's curve. The same 5 % as libpng's own equality test.
    constexpr double kUsual = 2.2;
    if (std::abs(*tags.gamma * kUsual - 1.0) > 0.05) {
      curve = gamma_curve(std::abs(*tags.gamma - 1.0) < 0.005 ? 1.0 : 1.0 / *tags.gamma);
      name += fmt::format(" gAMA {:.5g}", *tags.gamma);
    }
  }
  if (tags.primaries && content.pixels.channels() == 3) {
    name += " cHRM";
  }
  return colours_by(source, content,
                    content.pixels.channels() == 3 ? tags.primaries.value_or(kRec709) : kRec709,
                    curve, name);
}

}  // namespace

PictureColours colours_of(const PictureSource& source, const PictureContent& content) {
  const ColourTags& tags = content.tags.colour;
  if (tags.is_icc_damaged) {
    refuse_picture(source, "its colour profile is damaged", kHint);
  }
  if (!tags.icc.empty()) {
    const Profile profile = open_profile(source, tags.icc);
    return colours_by(source, content, profile.get(), name_of(profile.get()));
  }
  PictureColours plain{.transfer = content.is_floating || content.is_linear ? Transfer::linear
                                                                            : Transfer::srgb};
  if (content.is_floating) {
    return tags.primaries && content.pixels.channels() == 3
               ? colours_by(source, content, *tags.primaries, gamma_curve(1.0),
                            "OpenEXR chromaticities")
               : plain;
  }
  if (tags.is_srgb) {
    return plain;
  }
  if (tags.gamma || tags.primaries) {
    return colours_by_png(source, content);
  }
  if (tags.is_adobe_rgb) {
    return colours_by(source, content, kAdobeRgb, gamma_curve(kAdobeGamma),
                      "Adobe RGB (1998), by EXIF");
  }
  return plain;
}

std::vector<std::byte> linear_profile(int channels) {
  const Curve straight = gamma_curve(1.0);
  const cmsCIExyY white{kRec709[6], kRec709[7], 1.0};
  const Profile profile = channels == 3 ? rgb_profile(kRec709, straight.get())
                                        : Profile(cmsCreateGrayProfile(&white, straight.get()));
  cmsUInt32Number size = 0;
  std::vector<std::byte> bytes;
  if (profile == nullptr || cmsSaveProfileToMem(profile.get(), nullptr, &size) == 0) {
    refuse_encoding("no colour profile could be made");
  }
  bytes.resize(size);
  if (cmsSaveProfileToMem(profile.get(), bytes.data(), &size) == 0) {
    refuse_encoding("no colour profile could be made");
  }
  // The header's creation time (ICC.1, 7.2.1): the same picture gives the same bytes.
  constexpr std::array<unsigned char, 12> kFirstOf2000{0x07, 0xd0, 0, 1, 0, 1};
  std::memcpy(&bytes.at(24), kFirstOf2000.data(), kFirstOf2000.size());
  return bytes;
}

}  // namespace haarlight
