// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/reflectance/formats/web_folder.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <span>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "core/json_value.h"
#include "core/parallel.h"
#include "core/picture/jpeg.h"
#include "core/text_limits.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/relight/reflectance/formats/quantise.h"
#include "relight/reflectance/formats/plane_weights.h"
#include "session/photographed.h"

namespace haarlight::relight {

namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr double kWhite = 255.0;
constexpr double kMiddleByte = 127.0;  ///< of an axis: 0
constexpr std::int64_t kMostPlanes = 300;
constexpr std::int64_t kLongestSide = 65500;                        // JPEG's
constexpr std::uintmax_t kMaxPicture = std::uintmax_t{256} << 20U;  // a JPEG of one plane
constexpr std::uintmax_t kMaxInfo = std::uintmax_t{4} << 20U;       // a million numbers
constexpr double kLargestNumber = 1e9;

enum class ColourSpace { rgb, lrgb, mrgb, mycc };
const std::vector<std::string_view> kColourSpaces{"rgb", "lrgb", "mrgb", "mycc"};
const std::vector<std::string_view> kTypes{"ptm", "hsh", "rbf", "bilinear"};

bool has_axes(ColourSpace space) {
  return space == ColourSpace::mrgb || space == ColourSpace::mycc;
}

/// The term that is the file's i-th; Relight orders a .ptm's as 1, u, v, u^2, uv, v^2.
int term_of_file(ReflectanceBasis basis, int i) {
  constexpr std::array<int, 6> kPtm{5, 3, 4, 0, 2, 1};
  return basis == ReflectanceBasis::ptm ? kPtm[static_cast<std::size_t>(i)] : i;
}

/// The model's plane corresponding to the file's plane `k`.
int plane_of_file(const ReflectanceModel& model, int k) {
  switch (model.colour) {
    case ReflectanceColour::rgb:
      return (k % 3) * model.n_terms + term_of_file(model.basis, k / 3);
    case ReflectanceColour::lrgb:
      return k < 3 ? model.n_terms + k : term_of_file(model.basis, k - 3);
    case ReflectanceColour::pca:
      return k;
  }
  return k;
}

std::string picture_name(int i) { return fmt::format("plane_{}.jpg", i); }

/// What info.json contains besides the model.
struct WebInfo {
  int width = 0;
  int height = 0;
  int n_planes = 0;   ///< of the file: as many as the model's
  int n_triples = 0;  ///< mycc: pictures holding Y, Cb, Cr
};

std::vector<double> read_numbers(const JsonValue& list, std::size_t n) {
  const std::vector<JsonValue> elements = list.elements();
  if (elements.size() != n) {
    list.refuse(fmt::format("{} numbers where {} belong", elements.size(), n),
                "make the folder again with its program");
  }
  std::vector<double> numbers;
  numbers.reserve(n);
  for (const JsonValue& element : elements) {
    numbers.push_back(element.number(-kLargestNumber, kLargestNumber));
  }
  return numbers;
}

void read_plane_counts(const JsonValue& root, ColourSpace space, WebInfo& info) {
  if (space != ColourSpace::mycc) {
    info.n_planes = static_cast<int>(root["nplanes"].integer(1, kMostPlanes));
    return;
  }
  const JsonValue list = root["yccplanes"];
  const std::vector<double> counts = read_numbers(list, 3);
  for (const double count : counts) {
    if (count < 1.0 || count > static_cast<double>(kMostPlanes) || count != std::floor(count)) {
      list.refuse("not a number of planes", "make the folder again with its program");
    }
  }
  if (counts[1] != counts[2] || counts[1] > counts[0]) {
    list.refuse(
        fmt::format("{} planes of Y, {} of Cb, {} of Cr", counts[0], counts[1], counts[2]),
        "make the folder again: as many of Cb as of Cr, and no more than of Y");
  }
  info.n_triples = static_cast<int>(counts[1]);
  info.n_planes = static_cast<int>(counts[0] + counts[1] + counts[2]);
}

int terms_in(const JsonValue& root, ReflectanceColour colour, int n_planes) {
  if (colour == ReflectanceColour::pca) {
    return n_planes;
  }
  const int n_terms = colour == ReflectanceColour::rgb ? n_planes / 3 : n_planes - 3;
  if (n_terms < 1 || n_planes_of(colour, n_terms) != n_planes) {
    root["nplanes"].refuse(fmt::format("{} planes", n_planes),
                           "make the folder again with its program");
  }
  return n_terms;
}

/// Rows of Y, Cb, Cr to rows of R, G, B: G = Y + Cr/2, B = Y - Cr/2 - Cb/2, R = B + Cb.
void ycc_to_rgb(Eigen::MatrixXf& axes, int n_triples) {
  for (Eigen::Index p = 0; p < axes.rows(); ++p) {
    // Row 0 is the mean and has all three. A plane of a triple has only its own part, the
    // planes after the triples only Y.
    const Eigen::Index part = p == 0 ? -1 : p <= Eigen::Index{3} * n_triples ? (p - 1) % 3 : 0;
    for (Eigen::Index at = 0; at < axes.cols(); at += 3) {
      Eigen::Vector3f ycc = axes.row(p).segment<3>(at);
      if (part >= 0) {
        const float kept = ycc[part];
        ycc.setZero();
        ycc[part] = kept;
      }
      const float g = ycc[0] + ycc[2] / 2.0F;
      const float b = ycc[0] - ycc[2] / 2.0F - ycc[1] / 2.0F;
      axes.row(p).segment<3>(at) = Eigen::RowVector3f(b + ycc[1], g, b);
    }
  }
}

void read_axes(const JsonValue& root, const JsonValue& material, ColourSpace space,
               const WebInfo& info, ReflectanceModel& model) {
  const auto n_nodes = model.basis == ReflectanceBasis::rbf
                           ? model.lights.size()
                           : static_cast<std::size_t>(model.resolution) *
                                 static_cast<std::size_t>(model.resolution);
  const std::size_t n_columns = 3 * n_nodes;
  const JsonValue list = root["basis"];
  const std::vector<JsonValue> bytes = list.elements();
  const std::size_t n_rows = static_cast<std::size_t>(model.n_terms) + 1;
  if (bytes.size() != n_rows * n_columns) {
    list.refuse(fmt::format("{} numbers where {} rows of {} nodes are {}", bytes.size(), n_rows,
                            n_nodes, n_rows * n_columns),
                "make the folder again with its program");
  }
  const std::vector<double> range = read_numbers(material["range"], n_rows - 1);
  model.axes.resize(static_cast<Eigen::Index>(n_rows), static_cast<Eigen::Index>(n_columns));
  for (std::size_t p = 0; p < n_rows; ++p) {
    if (p > 0 && range[p - 1] == 0.0) {
      material["range"].refuse("a range of 0", "make the folder again with its program");
    }
    for (std::size_t i = 0; i < n_columns; ++i) {
      const auto byte = static_cast<double>(bytes[p * n_columns + i].integer(0, 255));
      const double value = p == 0 ? byte / kWhite : (byte - kMiddleByte) / range[p - 1];
      model.axes(static_cast<Eigen::Index>(p), static_cast<Eigen::Index>(i)) =
          static_cast<float>(value);
    }
  }
  if (space == ColourSpace::mycc) {
    ycc_to_rgb(model.axes, info.n_triples);
  }
}

void read_lights(const JsonValue& root, ReflectanceModel& model) {
  if (!root.has("lights")) {
    if (model.basis == ReflectanceBasis::rbf) {
      root.refuse("rbf without lights", "make the folder again with its program");
    }
    return;
  }
  const JsonValue list = root["lights"];
  const std::size_t n = list.elements().size();
  constexpr std::size_t kMostLights = 100'000;
  if (n % 3 != 0 || n / 3 > kMostLights) {
    list.refuse(fmt::format("{} numbers are not x, y, z of lights", n),
                "make the folder again with its program");
  }
  const std::vector<double> numbers = read_numbers(list, n);
  for (std::size_t i = 0; i < n; i += 3) {
    const Eigen::Vector3d light(numbers[i], numbers[i + 1], numbers[i + 2]);
    constexpr double kLeastLength = 1e-6;
    if (light.norm() < kLeastLength) {
      list.refuse("a light without a direction", "make the folder again with its program");
    }
    model.lights.push_back(light.normalized());  // three decimals are not quite unit length
  }
}

void read_scales(const JsonValue& material, const WebInfo& info, ReflectanceModel& model) {
  const auto n = static_cast<std::size_t>(info.n_planes);
  const std::vector<double> scale = read_numbers(material["scale"], n);
  const std::vector<double> bias = read_numbers(material["bias"], n);
  model.scales.resize(n);
  for (std::size_t k = 0; k < n; ++k) {
    const int p = plane_of_file(model, static_cast<int>(k));
    model.scales[static_cast<std::size_t>(p)] = {scale[k] / kWhite, -bias[k] * scale[k]};
  }
}

/// For lrgb: the brightest colour that the scales can express becomes 1, the luminance absorbs
/// the rest. Writers differ in which of the two is large.
void bring_colours_to_one(ReflectanceModel& model) {
  if (model.colour != ReflectanceColour::lrgb) {
    return;
  }
  const auto colours = model.scales.begin() + model.n_terms;
  double largest = 0.0;
  for (auto plane = colours; plane != model.scales.end(); ++plane) {
    largest = std::max({largest, plane->offset, plane->offset + kWhite * plane->scale});
  }
  if (largest <= 0.0 || largest == 1.0) {
    return;
  }
  for (auto plane = model.scales.begin(); plane != model.scales.end(); ++plane) {
    const double factor = plane < colours ? largest : 1.0 / largest;
    plane->scale *= factor;
    plane->offset *= factor;
  }
}

/// Everything but the planes.
ReflectanceModel read_info(const JsonValue& root, WebInfo& info) {
  if (root.has("format") && root["format"].text() != "jpg") {
    root["format"].refuse(fmt::format("\"{}\" is not read", root["format"].text()),
                          "export the folder as jpg, without tiles");
  }
  info.width = static_cast<int>(root["width"].integer(1, kLongestSide));
  info.height = static_cast<int>(root["height"].integer(1, kLongestSide));
  constexpr std::array<ReflectanceBasis, 4> kBases{ReflectanceBasis::ptm, ReflectanceBasis::hsh,
                                                   ReflectanceBasis::rbf,
                                                   ReflectanceBasis::bilinear};
  ReflectanceModel model;
  if (root.has("photographed")) {
    model.photographed = session::facts_from_json(root["photographed"]);
  }
  model.basis = kBases[root["type"].choice(kTypes)];
  const auto space = static_cast<ColourSpace>(root["colorspace"].choice(kColourSpaces));
  const bool is_pca =
      model.basis == ReflectanceBasis::rbf || model.basis == ReflectanceBasis::bilinear;
  if (is_pca != has_axes(space)) {
    root["colorspace"].refuse(fmt::format("{} in {}", to_string(model.basis),
                                          kColourSpaces[static_cast<std::size_t>(space)]),
                              "ptm and hsh go with rgb or lrgb, rbf and bilinear with mrgb or "
                              "mycc");
  }
  model.colour = is_pca                       ? ReflectanceColour::pca
                 : space == ColourSpace::lrgb ? ReflectanceColour::lrgb
                                              : ReflectanceColour::rgb;
  read_plane_counts(root, space, info);
  model.n_terms = terms_in(root, model.colour, info.n_planes);
  if (model.basis == ReflectanceBasis::ptm && model.n_terms != 6) {
    root["nplanes"].refuse(fmt::format("a ptm of {} terms", model.n_terms),
                           "make the folder again with its program");
  }
  const std::vector<JsonValue> materials = root["materials"].elements();
  if (materials.size() != 1) {
    root["materials"].refuse(fmt::format("{} materials: only one is read", materials.size()),
                             "make the folder again with one material");
  }
  read_lights(root, model);
  read_scales(materials[0], info, model);
  bring_colours_to_one(model);
  model.least_elevation = model.basis == ReflectanceBasis::hsh ? kWebLeastElevation : 0.0;
  if (is_pca) {
    if (model.basis == ReflectanceBasis::bilinear) {
      model.resolution = static_cast<int>(root["resolution"].integer(2, 1024));
    } else if (root.has("sigma")) {
      (void)root["sigma"].number(0.0, 1e3);  // viewers ignore it
    }
    read_axes(root, materials[0], space, info, model);
  }
  return model;
}

void read_planes(const WebInfo& info, const OpenPart& open, const std::string& where,
                 std::uint64_t most_bytes, ReflectanceModel& model) {
  const int n_pictures = (info.n_planes + 2) / 3;
  const auto n_planes = static_cast<std::size_t>(info.n_planes);
  std::vector<std::string> pictures;
  const auto position = [&](int i) { return where + "/" + picture_name(i); };
  for (int i = 0; i < n_pictures; ++i) {
    pictures.push_back(open(picture_name(i)));
    const JpegShape shape = jpeg_shape(pictures.back(), position(i));
    if (shape.width != info.width || shape.height != info.height) {
      throw Error(fmt::format("{} x {} pixels where info.json says {} x {}", shape.width,
                              shape.height, info.width, info.height),
                  position(i), "make the folder again with its program");
    }
  }
  model.planes = allocate_planes(info.height, info.width, info.n_planes, most_bytes, where);
  for (int i = 0; i < n_pictures; ++i) {
    std::array<std::size_t, 3> planes{};
    const int n = std::min(3, info.n_planes - 3 * i);
    for (int c = 0; c < n; ++c) {
      planes[static_cast<std::size_t>(c)] =
          static_cast<std::size_t>(plane_of_file(model, 3 * i + c));
    }
    decode_jpeg(pictures[static_cast<std::size_t>(i)], 3, position(i),
                [&](int y, std::span<const std::uint8_t> samples) {
                  const auto row = model.planes.view().row(y);
                  for (std::size_t x = 0; x < samples.size() / 3; ++x) {
                    for (std::size_t c = 0; c < static_cast<std::size_t>(n); ++c) {
                      row[x * n_planes + planes[c]] = samples[3 * x + c];
                    }
                  }
                });
  }
}

void require_writable(const std::string& where, const ReflectanceModel& model) {
  require_consistent(model, where);
  if (model.basis == ReflectanceBasis::hsh &&
      (model.n_terms > 9 || (model.colour == ReflectanceColour::lrgb && model.n_terms != 9))) {
    throw Error(
        fmt::format("viewers do not show {} terms of hsh{} in a web folder", model.n_terms,
                    model.colour == ReflectanceColour::lrgb ? " with a luminance" : ""),
        where, "fit 9 terms in rgb: haarlight convert --terms 9");
  }
  if (model.transfer != Transfer::srgb) {
    throw Error("viewers show a web folder as sRGB, and these colours are not", where,
                "fit it to sRGB first: haarlight convert does");
  }
  if (model.basis == ReflectanceBasis::rbf) {
    throw Error("viewers light rbf by rules of their own, which are not those of the fit",
                where,
                "fit the same capture with --basis bilinear, or write hsh: haarlight convert");
  }
  HAARLIGHT_EXPECTS(obeys(ScaleRule::any, model), "scales above 0");
}

/// Removes earlier content: info.json first, so that it never describes other pictures.
void remove_former(const fs::path& folder) {
  std::error_code ignored;
  fs::remove(folder / "info.json", ignored);
  for (int i = 0; fs::remove(folder / picture_name(i), ignored); ++i) {
  }
}

/// info.json's list of axes, and the range of each row.
void add_axes(const ReflectanceModel& model, int n_planes, Json& root, Json& material) {
  Json basis = Json::array();
  Json ranges = Json::array();
  for (Eigen::Index p = 0; p <= n_planes; ++p) {
    const bool is_padding = p >= model.axes.rows();
    const double largest =
        is_padding ? 0.0 : static_cast<double>(model.axes.row(p).cwiseAbs().maxCoeff());
    const double range = largest > 0.0 ? kMiddleByte / largest : 1.0;
    for (Eigen::Index i = 0; i < model.axes.cols(); ++i) {
      const double value = is_padding ? 0.0 : static_cast<double>(model.axes(p, i));
      const double byte = p == 0 ? value * kWhite : value * range + kMiddleByte;
      basis.push_back(static_cast<int>(std::clamp(std::round(byte), 0.0, kWhite)));
    }
    if (p > 0) {
      ranges.push_back(range);
    }
  }
  material["range"] = std::move(ranges);
  root["basis"] = std::move(basis);
}

Json info_json(const ReflectanceModel& model, int n_planes, const WebInfoWords& words) {
  Json root;
  root["width"] = model.planes.width();
  root["height"] = model.planes.height();
  root["format"] = words.format;
  root["type"] = to_string(model.basis);
  root["colorspace"] = model.colour == ReflectanceColour::pca    ? "mrgb"
                       : model.colour == ReflectanceColour::lrgb ? "lrgb"
                                                                 : "rgb";
  root["nplanes"] = n_planes;
  root["quality"] = words.quality;
  root["colorprofile"] = "sRGB";
  if (words.mm_per_pixel) {
    root["pixelSizeInMM"] = *words.mm_per_pixel;
  }
  if (has_facts(model.photographed)) {
    root["photographed"] =
        parse_json<Json>(session::facts_to_json(model.photographed), "photographed");
  }
  if (!model.lights.empty()) {
    Json lights = Json::array();
    for (const Eigen::Vector3d& light : model.lights) {
      for (const double part : light) {
        lights.push_back(std::round(part * 1e6) / 1e6);
      }
    }
    root["lights"] = std::move(lights);
  }
  Json material;
  Json scale = Json::array();
  Json bias = Json::array();
  for (int k = 0; k < n_planes; ++k) {
    const bool is_padding = k >= model.n_planes();
    const PlaneScale plane =
        is_padding ? PlaneScale{}
                   : model.scales[static_cast<std::size_t>(plane_of_file(model, k))];
    // By the file's order: lrgb's colours are the first picture.
    const double raised = model.colour != ReflectanceColour::lrgb ? 1.0
                          : k < 3                                 ? 1.0 / kWebLuminance
                                                                  : kWebLuminance;
    const double factor = plane.scale * kWhite;
    scale.push_back(factor * raised);
    bias.push_back(plane.offset == 0.0 ? 0.0 : -plane.offset / factor);
  }
  material["scale"] = std::move(scale);
  material["bias"] = std::move(bias);
  if (model.colour == ReflectanceColour::pca) {
    root["resolution"] = model.resolution;
    add_axes(model, n_planes, root, material);
  }
  root["materials"] = Json::array({std::move(material)});
  return root;
}

/// The quantisation steps of a picture's three parts, in bytes, that change lit pictures by
/// `step`.
/// @param weights  of its planes: 0 if there is none
JpegSteps picture_steps(const Eigen::Vector3d& weights, bool is_ycc, double step) {
  // Contribution of each part to R, G, B: JFIF's conversion.
  const Eigen::Matrix3d parts = is_ycc ? (Eigen::Matrix3d() << 1.0, 0.0, 1.402, 1.0, -0.344136,
                                          -0.714136, 1.0, 1.772, 0.0)
                                             .finished()
                                       : Eigen::Matrix3d::Identity();
  JpegSteps steps{.is_ycc = is_ycc};
  for (Eigen::Index i = 0; i < 3; ++i) {
    const double moved = parts.col(i).cwiseProduct(weights).norm();  // per byte
    const double wanted = moved > 0.0 ? step / moved : kWhite;
    steps.step[static_cast<std::size_t>(i)] =
        static_cast<int>(std::clamp(std::round(wanted), 1.0, kWhite));
  }
  return steps;
}

/// The file's i-th picture.
std::string code_picture(const ReflectanceModel& model, int i,
                         const std::vector<double>& weights, double step,
                         const std::string& where) {
  const auto n_planes = static_cast<std::size_t>(model.n_planes());
  std::vector<std::size_t> planes;
  Eigen::Vector3d of_planes = Eigen::Vector3d::Zero();
  for (int k = 3 * i; k < std::min(3 * i + 3, model.n_planes()); ++k) {
    planes.push_back(static_cast<std::size_t>(plane_of_file(model, k)));
    of_planes[k - 3 * i] = weights[planes.back()];
  }
  const auto give = [&](int y, std::span<std::uint8_t> samples) {
    const auto row = model.planes.view().row(y);
    for (std::size_t c = 0; c < planes.size(); ++c) {  // others are zeros
      for (std::size_t x = 0; x < samples.size() / 3; ++x) {
        samples[3 * x + c] = row[x * n_planes + planes[c]];
      }
    }
  };
  // R, G and B of one term are correlated (Y, Cb, Cr take 3/5 of the bytes); axes and terms of
  // a luminance are not, and its colours too little.
  const bool is_ycc = model.colour == ReflectanceColour::rgb;
  const JpegShape shape{model.planes.height(), model.planes.width()};
  return encode_jpeg(shape, picture_steps(of_planes, is_ycc, step), where, give);
}

}  // namespace

bool is_web_folder(const fs::path& path) {
  std::error_code ignored;
  return fs::is_regular_file(path / "info.json", ignored);
}

ReflectanceModel parse_web_folder(std::string_view info_text, const OpenPart& open,
                                  const std::string& where, std::uint64_t most_bytes) {
  const JsonValue root = JsonValue::parse(info_text, where + "/info.json");
  WebInfo info;
  ReflectanceModel model = read_info(root, info);
  read_planes(info, open, where, most_bytes, model);
  require_consistent(model, where);
  return model;
}

ReflectanceModel read_web_folder(const fs::path& folder, std::uint64_t most_bytes) {
  const auto open = [&](const std::string& name) {
    const fs::path path = folder / name;
    if (!fs::exists(path)) {
      throw Error("this picture is missing (a folder of tiles is not read)", path.string(),
                  "export the folder with plane_0.jpg, plane_1.jpg ..., without tiles");
    }
    return read_file(path, kMaxPicture);
  };
  return parse_web_folder(read_file(folder / "info.json", kMaxInfo), open, folder.string(),
                          most_bytes);
}

std::array<int, 3> planes_of_picture(const ReflectanceModel& model, int picture) {
  std::array<int, 3> planes{-1, -1, -1};
  for (int c = 0; c < 3 && 3 * picture + c < model.n_planes(); ++c) {
    planes[static_cast<std::size_t>(c)] = plane_of_file(model, 3 * picture + c);
  }
  return planes;
}

std::string web_info_text(const ReflectanceModel& model, const std::string& where,
                          const WebInfoWords& words) {
  require_writable(where, model);
  return info_json(model, (model.n_planes() + 2) / 3 * 3, words).dump() + "\n";
}

WebSize web_folder_size(const fs::path& folder) {
  const fs::path path = folder / "info.json";
  const JsonValue root = JsonValue::parse(read_file(path, kMaxInfo), path.string());
  WebInfo info;
  (void)read_info(root, info);
  return {info.width, info.height, info.n_planes};
}

std::optional<double> web_mm_per_pixel(const fs::path& folder) {
  const fs::path path = folder / "info.json";
  const JsonValue root = JsonValue::parse(read_file(path, kMaxInfo), path.string());
  if (!root.has("pixelSizeInMM")) {
    return {};
  }
  const double mm = root["pixelSizeInMM"].number(0.0, kLargestNumber);
  return mm > 0.0 ? std::optional(mm) : std::nullopt;
}

double web_step(double quality) noexcept {
  constexpr double kMeanStep = 16.0;  // of JPEG's example table (ITU T.81, K.1), first entry
  const double percent = quality < 50.0 ? 5000.0 / quality : 200.0 - 2.0 * quality;
  return kMeanStep * percent / 100.0;
}

std::uint64_t WebFiles::bytes() const noexcept {
  std::uint64_t sum = info.size();
  for (const std::string& picture : pictures) {
    sum += picture.size();
  }
  return sum;
}

WebFiles code_web_folder(const ReflectanceModel& model, const WebOptions& options,
                         const std::string& where) {
  HAARLIGHT_EXPECTS(options.quality >= 1.0 && options.quality <= 100.0, "quality 1 to 100");
  require_writable(where, model);
  const int n_pictures = (model.n_planes() + 2) / 3;
  const std::vector<double> weights = plane_weights(model);
  const double step = web_step(options.quality) / kWhite;
  WebFiles files;
  files.quality = options.quality;
  files.pictures.resize(static_cast<std::size_t>(n_pictures));
  parallel_for(files.pictures.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      files.pictures[i] = code_picture(model, static_cast<int>(i), weights, step,
                                       where + "/" + picture_name(static_cast<int>(i)));
    }
  });
  files.info = info_json(model, 3 * n_pictures, {.quality = options.quality}).dump() + "\n";
  return files;
}

ReflectanceModel decode_web_files(const WebFiles& files, const std::string& where,
                                  std::uint64_t most_bytes) {
  const auto open = [&](const std::string& name) {
    for (std::size_t i = 0; i < files.pictures.size(); ++i) {
      if (name == picture_name(static_cast<int>(i))) {
        return files.pictures[i];
      }
    }
    throw Error("this picture is missing", where + "/" + name, "report it", ExitCode::internal);
  };
  return parse_web_folder(files.info, open, where, most_bytes);
}

void write_web_files(const fs::path& folder, const WebFiles& files) {
  std::error_code error;
  fs::create_directories(folder, error);
  if (error) {
    throw Error(fmt::format("cannot make the folder: {}", error.message()), folder.string(),
                "check the name and its rights", ExitCode::io);
  }
  remove_former(folder);
  for (std::size_t i = 0; i < files.pictures.size(); ++i) {
    write_file_atomically(folder / picture_name(static_cast<int>(i)), files.pictures[i]);
  }
  write_file_atomically(folder / "info.json", files.info);
}

void write_web_folder(const fs::path& folder, const ReflectanceModel& model,
                      const WebOptions& options) {
  write_web_files(folder, code_web_folder(model, options, folder.string()));
}

}  // namespace haarlight::relight
