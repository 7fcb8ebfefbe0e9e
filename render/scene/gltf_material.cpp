// SPDX-License-Identifier: Apache-2.0
#include "render/scene/gltf_material.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include <fmt/format.h>

#include "render/bsdf/fresnel.h"
#include "render/scene/gltf_values.h"

namespace haarlight::render {

namespace {

using Eigen::Vector3d;

constexpr GltfRange kFraction{.min = 0.0, .max = 1.0};
constexpr double kMetal = 0.5;  // from here on
constexpr double kLowestRoughness = 1e-4;
constexpr double kLowestCoatIor = 1.2;  // of the table of coats, render/bsdf/
constexpr double kHighestCoatIor = 2.5;

Vector3d to_vector(const std::array<double, 3>& numbers) {
  return {numbers[0], numbers[1], numbers[2]};
}

/// Seen straight on.
double reflectance_of(double ior) { return std::pow((ior - 1.0) / (ior + 1.0), 2.0); }
double ior_of(double reflectance) {
  return (1.0 + std::sqrt(reflectance)) / (1.0 - std::sqrt(reflectance));
}

struct Index {
  double eta;
  double k;
};

/// [Gulbrandsen14]: all pairs that reflect r seen straight on, by the tint of the edge.
Index index_of(double r, double tint) {
  const double root = std::sqrt(r);
  const double eta = tint * (1.0 - r) / (1.0 + r) + (1.0 - tint) * (1.0 + root) / (1.0 - root);
  const double k2 = (r * (eta + 1.0) * (eta + 1.0) - (eta - 1.0) * (eta - 1.0)) / (1.0 - r);
  return {.eta = eta, .k = std::sqrt(std::max(k2, 0.0))};
}

/// Under light from everywhere: the mean weighted by the cosine, by midpoints.
double mean_reflectance(const Index& index) {
  constexpr int kPoints = 64;
  const Vector3d eta = Vector3d::Constant(index.eta);
  const Vector3d k = Vector3d::Constant(index.k);
  double sum = 0.0;
  for (int i = 0; i < kPoints; ++i) {
    const double cosine = (i + 0.5) / kPoints;
    sum += 2.0 * cosine * fresnel_conductor(cosine, eta, k).x();
  }
  return sum / kPoints;
}

/// The tint of which a surface that reflects r straight on reflects what Schlick's formula does under
/// light from everywhere, (20 r + 1)/21, as far as any does.
double tint_at(double r) {
  const double wanted = (20.0 * r + 1.0) / 21.0;
  double low = 0.0;  // the mean rises with the tint
  double high = 1.0;
  for (int i = 0; i < 20; ++i) {
    const double middle = 0.5 * (low + high);
    (mean_reflectance(index_of(r, middle)) < wanted ? low : high) = middle;
  }
  return 0.5 * (low + high);
}

constexpr double kLeastReflectance = 1e-4;
constexpr int kTints = 513;

double reflectance_at(int i) {
  return kLeastReflectance + (1.0 - 2.0 * kLeastReflectance) * i / (kTints - 1);
}

/// tint_at() from a table, made when first asked for.
double tint_of(double r) {
  static const std::array<double, kTints> kTable = [] {
    std::array<double, kTints> table{};
    for (int i = 0; i < kTints; ++i) {
      table.at(static_cast<std::size_t>(i)) = tint_at(reflectance_at(i));
    }
    return table;
  }();
  const double at = (r - kLeastReflectance) / (1.0 - 2.0 * kLeastReflectance) * (kTints - 1);
  const auto below = static_cast<std::size_t>(std::clamp(at, 0.0, kTints - 2.0));
  const double beyond = at - static_cast<double>(below);
  return (1.0 - beyond) * kTable.at(below) + beyond * kTable.at(below + 1);
}

/// The extension of that name of a value, or nothing.
std::optional<JsonValue> extension_of(const JsonValue& json, std::string_view name) {
  if (!json.has("extensions") || !json["extensions"].has(name)) {
    return std::nullopt;
  }
  return json["extensions"][name];
}

class MaterialReader {
 public:
  MaterialReader(GltfDocument& document, const JsonValue& json, GltfWarnings& warnings)
      : document_(document), json_(json), warnings_(warnings) {}

  GltfMaterial read(double emission_scale) {
    Material& material = read_.material;
    material.name = json_.has("name") ? json_["name"].text() : place();
    read_.is_double_sided = json_.has("doubleSided") && json_["doubleSided"].truth();
    read_emission(emission_scale);
    read_base();
    read_extensions();
    warn_of_the_rest();
    read_.has_base_texture =
        !material.kd_texture.file.empty() ||
        (read_.has_base_texture && !averaged_.roughness_texture.file.empty());
    if (!averaged_.roughness_texture.file.empty() || !averaged_.emission_texture.file.empty() ||
        (is_metal() && !averaged_.base_texture.file.empty())) {
      material.averaged = std::make_shared<const MetallicRoughness>(averaged_);
    }
    return std::move(read_);
  }

 private:
  [[nodiscard]] std::string place() const { return place_of(json_, document_.name()); }
  void warn(const std::string& what) { warnings_.add(what, place()); }
  [[nodiscard]] bool is_metal() const { return averaged_.metallic >= kMetal; }

  /// @param info  glTF's textureInfo
  MaterialTexture texture_of(const JsonValue& info) {
    const JsonValue& texture =
        document_.textures[document_.number_of(info["index"], document_.textures)];
    if (!texture.has("source")) {
      texture.refuse("a texture without a picture, or with one in a format of an extension",
                     "export the scene with PNG or JPEG pictures");
    }
    const JsonValue& image =
        document_.images[document_.number_of(texture["source"], document_.images)];
    const GltfDocument::Picture picture = document_.picture(image);
    return {.file = picture.file, .bytes = picture.bytes, .where = info.location()};
  }

  void read_emission(double scale) {
    const Vector3d factor =
        to_vector(numbers_or<3>(json_, "emissiveFactor", {0.0, 0.0, 0.0}, {.min = 0.0}));
    double strength = 1.0;
    if (const auto extension = extension_of(json_, "KHR_materials_emissive_strength")) {
      strength = number_or(*extension, "emissiveStrength", 1.0, {.min = 0.0, .max = 1e20});
    }
    const Vector3d emits = factor * (strength * scale);
    if (!(emits.maxCoeff() <= 1e30)) {
      json_.refuse("it emits more than 1e30", "give it a smaller emission");
    }
    read_.material.emits = emits;
    if (json_.has("emissiveTexture") && emits.maxCoeff() > 0.0) {
      averaged_.emission_texture = texture_of(json_["emissiveTexture"]);
      warn("an emissive texture counts by the mean of its texels");
    }
  }

  void read_base() {
    std::array<double, 4> base{1.0, 1.0, 1.0, 1.0};
    if (json_.has("pbrMetallicRoughness")) {
      const JsonValue pbr = json_["pbrMetallicRoughness"];
      base = numbers_or<4>(pbr, "baseColorFactor", base, kFraction);
      averaged_.metallic = number_or(pbr, "metallicFactor", 1.0, kFraction);
      averaged_.roughness = number_or(pbr, "roughnessFactor", 1.0, kFraction);
      if (pbr.has("metallicRoughnessTexture")) {
        averaged_.roughness_texture = texture_of(pbr["metallicRoughnessTexture"]);
        warn("a metallic-roughness texture counts by the mean of its texels");
      }
      if (pbr.has("baseColorTexture")) {
        read_base_texture(pbr["baseColorTexture"]);
      }
    }
    averaged_.base = {base[0], base[1], base[2]};
    if (is_metal() && read_.has_base_texture) {
      warn("a metal's base colour texture counts by the mean of its texels");
    }
    if (averaged_.metallic > 0.05 && averaged_.metallic < 0.95 &&
        averaged_.roughness_texture.file.empty()) {
      warn("a material that is partly metallic is a metal from one half on, none below");
    }
  }

  void read_base_texture(const JsonValue& info) {
    averaged_.base_texture = texture_of(info);
    read_.has_base_texture = true;
    std::int64_t set = info.has("texCoord") ? info["texCoord"].integer(0, 255) : 0;
    if (const auto moved = extension_of(info, "KHR_texture_transform")) {
      set = moved->has("texCoord") ? (*moved)["texCoord"].integer(0, 255) : set;
      const auto offset = numbers_or<2>(*moved, "offset", {0.0, 0.0}, {-1e6, 1e6});
      const auto scale = numbers_or<2>(*moved, "scale", {1.0, 1.0}, {-1e6, 1e6});
      const double angle = number_or(*moved, "rotation", 0.0, {-1e6, 1e6});
      // Counter-clockwise as seen in the picture, where v goes down.
      read_.uv_transform = Eigen::Translation2d(offset[0], offset[1]) *
                           Eigen::Rotation2Dd(-angle) * Eigen::Scaling(scale[0], scale[1]);
    }
    read_.uv_attribute = fmt::format("TEXCOORD_{}", set);
    const JsonValue& texture =
        document_.textures[document_.number_of(info["index"], document_.textures)];
    if (texture.has("sampler")) {
      const JsonValue& sampler =
          document_.samplers[document_.number_of(texture["sampler"], document_.samplers)];
      constexpr int kRepeat = 10497;
      for (const char* side : {"wrapS", "wrapT"}) {
        read_.is_repeated = read_.is_repeated && number_or(sampler, side, kRepeat) == kRepeat;
      }
      constexpr int kNearest = 9728;
      if (number_or(sampler, "magFilter", 0.0) == kNearest) {
        warn("a texture whose texels have hard edges is smoothed between them");
      }
    }
  }

  void read_extensions() {
    Material& material = read_.material;
    const auto ior_of_it = extension_of(json_, "KHR_materials_ior");
    double ior = ior_of_it ? number_or(*ior_of_it, "ior", 1.5, {.min = 0.0, .max = 1e3}) : 1.5;
    ior = ior < 1.0 ? 1.5 : ior;  // 0: for renderers of another model
    const auto transmission = extension_of(json_, "KHR_materials_transmission");
    const double passed =
        transmission ? number_or(*transmission, "transmissionFactor", 0.0, kFraction) : 0.0;
    if (!is_metal() && passed >= 0.5) {
      read_glass(ior, passed);
      return;
    }
    if (passed > 0.0) {
      warn("a material that lets less than half of the light through is opaque");
    }
    double reflectance = reflectance_of(ior);
    if (const auto specular = extension_of(json_, "KHR_materials_specular")) {
      const Vector3d colour = to_vector(
          numbers_or<3>(*specular, "specularColorFactor", {1.0, 1.0, 1.0}, {.min = 0.0}));
      reflectance = std::min(reflectance * colour.mean(), 1.0) *
                    number_or(*specular, "specularFactor", 1.0, kFraction);
      if (colour.maxCoeff() - colour.minCoeff() > 0.01) {
        warn("a coloured highlight is grey");
      }
      for (const char* texture : {"specularTexture", "specularColorTexture"}) {
        if (specular->has(texture)) {
          warn("a texture of the strength or colour of a highlight is left out");
        }
      }
    }
    averaged_.is_matte = reflectance < 0.5 * reflectance_of(kLowestCoatIor);
    material.ior =
        std::clamp(ior_of(std::min(reflectance, 0.9)), kLowestCoatIor, kHighestCoatIor);
    set_metallic_roughness(material, averaged_);
  }

  void read_glass(double ior, double passed) {
    Material& material = read_.material;
    material.bsdf = BsdfKind::dielectric;
    material.ior = std::min(ior, 4.0);
    const bool is_coloured = averaged_.base.minCoeff() < 0.999 || read_.has_base_texture;
    read_.has_base_texture = false;
    averaged_.base_texture = {};
    averaged_.roughness_texture = {};
    if (is_coloured) {
      warn("coloured glass is clear");
    }
    if (averaged_.roughness > 0.05) {
      warn("rough glass is smooth");
    }
    if (passed < 0.95) {
      warn("a material that lets half of the light through or more is glass");
    }
    if (const auto volume = extension_of(json_, "KHR_materials_volume")) {
      if (volume->has("attenuationDistance")) {
        warn("glass that absorbs is clear");
      }
    }
  }

  void warn_of_the_rest() {
    if (json_.has("normalTexture")) {
      warn("a normal map is left out");
    }
    if (json_.has("alphaMode")) {
      const std::string mode = json_["alphaMode"].text();
      if (mode != "OPAQUE") {
        warn(fmt::format("alphaMode {} is opaque", mode.substr(0, 20)));
      }
    }
  }

  GltfDocument& document_;
  const JsonValue& json_;
  GltfWarnings& warnings_;
  GltfMaterial read_;
  MetallicRoughness averaged_;
};

}  // namespace

void set_index_of(Material& material, const Vector3d& f0) {
  for (int c = 0; c < 3; ++c) {
    const double r = std::clamp(f0[c], kLeastReflectance, 1.0 - kLeastReflectance);
    const Index found = index_of(r, tint_of(r));
    material.eta[c] = found.eta;
    material.k[c] = found.k;
  }
}

void set_metallic_roughness(Material& material, const MetallicRoughness& of) {
  material.roughness = std::clamp(of.roughness * of.roughness, kLowestRoughness, 1.0);
  material.kd_texture = {};
  material.is_kd_seen = false;
  if (of.metallic >= kMetal) {
    material.bsdf = BsdfKind::conductor;
    set_index_of(material, of.base);
    return;
  }
  material.kd = of.base;
  material.kd_texture = of.base_texture;
  material.bsdf = of.is_matte ? BsdfKind::blinn_phong : BsdfKind::coated;  // without a lobe
  material.is_kd_seen = !of.is_matte;
}

Material default_gltf_material() {
  Material material{.name = "glTF's default"};
  set_metallic_roughness(material, {});
  return material;
}

GltfMaterial read_gltf_material(GltfDocument& document, const JsonValue& json,
                                double emission_scale, GltfWarnings& warnings) {
  return MaterialReader(document, json, warnings).read(emission_scale);
}

}  // namespace haarlight::render
