#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Faults of a renderer, put into its sources one by one: do the tests see them?

    faults.py BUILD [NAME...]     BUILD: a release build with the programs below

A fault's source is compiled and linked before the library, so that nothing in BUILD or in the sources is
touched. Each has to make one of the tests named beside it fail, which `./check` runs. A fault whose line is no longer found is an error. Prints
a row of the tables in docs/numerics/surface.md, soft-shadow.md and volume.md for each; exits with 1 where one is not caught.
"""

import json
import pathlib
import re
import shlex
import subprocess
import sys
import tempfile
import time

PATHS = ("surface_test", "closed_form_test")
PHOTONS = ("render/surface/photon_", "render/light/emitted_ray")
SOFT = "render/soft_shadow/"
VOLUME = "render/volume/"
GLTF = "render/scene/gltf"
RADIOSITY = "render/radiosity/"
BIDIRECTIONAL = "render/surface/bidirectional_integrator.cpp"
TREE = "render/surface/photon_tree.cpp"
SHOOTING = "render/surface/photon_shooting.cpp"
PHOTON_GATHER = "render/surface/photon_integrator.cpp"
EMITTED = "render/light/emitted_ray.cpp"
# Whose tests look for a fault of a source, by how its path begins; else PATHS.
TESTED_BY = {
    **dict.fromkeys(PHOTONS, "photon_test"),
    SOFT: "soft_shadow_test", GLTF: "gltf_test", VOLUME: "volume_test", RADIOSITY: "radiosity_test",
    BIDIRECTIONAL: "bidirectional_test", "render/light/emission.cpp": "bidirectional_test", "render/film/film.cpp": "bidirectional_test"}
PROGRAMS = (*PATHS, *dict.fromkeys(TESTED_BY.values()))
INTEGRATOR = "render/surface/path_integrator.cpp"
LIGHT = "render/light/light.cpp"
LIGHTS = "render/light/scene_lights.cpp"
LANES = "render/surface/vertex_lanes.cpp"
RAYS = "render/rays/ray_caster.cpp"
TRIANGLES = "render/rays/triangle_lanes.cpp"
OFFSETS = "render/rays/ray_offset.h"
OCTREE = "render/surface/irradiance_octree.cpp"
GATHER = "render/surface/irradiance_gather.cpp"

PILOT = "render/loop/pilot.cpp"

# name: (file, words, words instead, tests that have to see it)
FAULTS = {
    "a pilot that forgets what a sample costs": (
        PILOT, "std::log(variance_b * seconds_b / (variance_a * seconds_a))", "std::log(variance_b / variance_a)", "Pilot.*"),
    "a pilot that takes noise for light": (
        PILOT, "light - variance / static_cast<double>(n);", "light;", "Pilot.*"),
    "a pilot that divides by all samples": (
        PILOT, "squared / static_cast<double>(n - 1)", "squared / static_cast<double>(n)", "Pilot.*"),
    "a pilot that takes chance for a difference": (
        PILOT, "gain.logarithm - kSure * gain.error > 0.0", "gain.logarithm > 0.0", "Pilot.*"),
    "a biased integrator for any error": (
        PILOT, "2.0 * bias <= options.relative_l2", "true", "Pilot.*"),
    "a glass pane under a lamp counts as opaque": (
        "render/surface/direct_scene.cpp", "material.bsdf != BsdfKind::dielectric", "true", "DirectScene.*"),
    "half of the albedo for albedo over pi": (
        INTEGRATOR, "std::numbers::inv_pi * path.throughput.cwiseProduct(rho)", "0.5 * path.throughput.cwiseProduct(rho)",
        "IrradianceCache.AFurnace*"),
    "a cache that holds direct light, too": (
        INTEGRATOR, ".counts_lights = false});", ".counts_lights = true});", "IrradianceCache.AFurnace*"),
    "what the cache has told is traced again": (
        INTEGRATOR, "path.beyond = (all.array() > 0.0).select(glossy.array() / all.array(), 0.0);", "(void)glossy;",
        "IrradianceCache.AFurnace*"),
    "a record's weight without the square": (
        OCTREE, "return (1.0 - error) * (1.0 - error);", "return 1.0 - error;", "ReuseWeight.*"),
    "a record's normal is not looked at": (
        OCTREE, "if (!(cosine > kLeastCosine)) {", "if (cosine > 1e9) {", "ReuseWeight.*"),
    "a record before the surface is used": (
        OCTREE, "< -kMostBefore * record.radius_mm", "< -1e9 * record.radius_mm", "ReuseWeight.*"),
    "an octree that ends at its nodes' borders": (
        OCTREE, "((reach.point - corner).array() >= -reaches).all()", "((reach.point - corner).array() >= 0.0).all()",
        "IrradianceOctree.*"),
    "a radius without limits": (
        GATHER, "std::clamp(harmonic_mean, limits.least_mm, limits.most_mm)", "harmonic_mean", "RecordOf.*"),
    "a record that reaches beyond a wall": (
        GATHER, "std::min(radius, nearest)", "radius", "IrradianceCache.HardlyLeaks*"),
    "a gradient the wrong way": (
        GATHER, "by_shift += scale *", "by_shift -= scale *", "IrradianceCache.OfPlates*"),
    "a light's probability forgotten": (
        INTEGRATOR, "const double asked = chosen.probability * density;", "const double asked = density;",
        "*ClosedForm*/one_of_each"),
    "its probability forgotten in MIS": (
        INTEGRATOR, "lights_.probability(light, path.from) * density(lights_[light]", "density(lights_[light]",
        "*ClosedForm*/one_of_each"),
    "cosine twice": (
        INTEGRATOR, "return weight * to_light.z() / asked;", "return weight * to_light.z() * to_light.z() / asked;",
        "*ClosedForm*/a_point"),
    "MIS on one side only": (
        INTEGRATOR, "return power_heuristic(path.density, asked);", "return 1.0;", "*ClosedForm*/a_disk_near"),
    "a light asked has no MIS weight": (
        INTEGRATOR, "weight = power_heuristic(asked,", "weight = 0.0 * power_heuristic(asked,",
        "*ClosedForm*/one_of_each:*ClosedForm*/a_sphere*"),
    "a mirrored instance inside out": (
        RAYS, "is_mirrored ? -1.0 : 1.0;", "is_mirrored ? 1.0 : 1.0;", "Instances.*"),
    "an instance's normals turned like its points": (
        RAYS, ".for_normals = linear.inverse().transpose(),", ".for_normals = linear,", "Instances.*"),
    "a ray leaves without the length of its triangle": (
        OFFSETS, "longest_side * (kOfSide + kOfThinSide * at_most)",
        "0.0 * longest_side * (kOfSide + kOfThinSide * at_most)", "RayOffset.*"),
    "a ray leaves without its distance from the middle": (
        TRIANGLES, "(kOfDistance * from_middle + of_triangle)", "(0.0 * from_middle + of_triangle)", "RayOffset.*"),
    "a shadow ray leaves at the scene's offset": (
        INTEGRATOR, "light_ray(vertex.hit, light, light_offset)",
        "light_ray([&] { Hit other = vertex.hit; other.offset_mm = caster_->ray_offset_mm(); return other; }(), "
        "light, light_offset)", "PathIntegrator.ASmallPart*"),
    "in vectors it leaves at its surface": (
        LANES, "lanes.from.z[i] + lanes.offset_mm[i] * side.z[i]", "lanes.from.z[i]", "LightLanes.*"),
    "in vectors it ends at the light's surface": (
        LANES, "+ off * lanes.normal.z[i] - from_z", "- from_z", "LightLanes.*"),
    "ray casting without the cosine": (
        "render/surface/ray_integrator.cpp", "to_light.z() / light.density * f", "1.0 / light.density * f", "RayCasting.*"),
    "a light asked by one ray is not hidden": (
        "render/surface/ray_integrator.cpp", "if (blocked[i] == 0) {", "if (true) {", "RayCasting.*"),
    "a mirror of Whitted's loses nothing": (
        "render/surface/ray_integrator.cpp", "way.throughput = way.throughput.cwiseProduct(next->weight);", "", "Whitted.*"),
    "a new path for each length, and a light that is met counts again": (
        "render/surface/path_baselines.cpp", "is_found_by_chance = next->is_delta;", "is_found_by_chance = true;",
        "NaivePaths.*"),
    "a vertex by area without the distance's square": (
        "render/surface/path_baselines.cpp", "throughput *= cosine / (at.hit.distance_mm * at.hit.distance_mm);",
        "throughput *= cosine / at.hit.distance_mm;", "AreaPaths.*"),
    "radiosity: rays without the cosine law": (
        f"{RADIOSITY}patch_rays.cpp", "frame_of(hit.flat_normal) * cosine_direction(square)",
        "frame_of(hit.flat_normal) * cosine_direction(Vector2d(square.x() * square.x(), square.y()))", "FormFactors.*"),
    "radiosity: what is met is lit on its other side": (
        f"{RADIOSITY}patch_rays.cpp", "return 2 * met.patch + (is_front ? 0 : 1);",
        "return 2 * met.patch + (is_front ? 1 : 0);", "FormFactors.*"),
    "radiosity: what arrives without what lamps send": (
        f"{RADIOSITY}exchange.cpp", "const VectorXd arrives = first + exchange.times(reflected);",
        "const VectorXd arrives = exchange.times(reflected);", "Radiosity.Systems*"),
    "radiosity: rows are not balanced": (
        f"{RADIOSITY}exchange.cpp", "balance(met, exchange); return", "return", "FormFactors.*"),
    "radiosity: what a block covers counts as floor": (
        f"{RADIOSITY}elements.cpp", "if (within_[side] == 0 || !other_end) {", "if (true) {", "Elements.*"),
    "radiosity: groups of points are not joined": (
        f"{RADIOSITY}elements.cpp", "if (common.empty()) {", "if (true) {", "Elements.*"),
    "radiosity: upside down a slope is not turned": (
        f"{RADIOSITY}element_slopes.cpp", "slope = -slope;", "", "ElementSlopes.*"),
    "radiosity: the middle part is not turned": (
        f"{RADIOSITY}vertex_light.cpp", "child == 3 ? 1.0 - 2.0 * weights.at(k)", "child == 3 ? weights.at(k)",
        "VertexLight.*"),
    "radiosity: no patch is shown in parts": (
        f"{RADIOSITY}vertex_light.cpp", "return !(face.error > kError);", "return true;", "VertexLight.*"),
    "radiosity: patches upside down are not turned": (
        f"{RADIOSITY}patches.cpp", "from + Vector2d::Ones() - in_patch", "from + in_patch", "Patches.*"),
    "radiosity: a light that is met without pi": (
        f"{RADIOSITY}patch_rays.cpp", "return std::numbers::pi * power_heuristic(followed, asked) * radiance;",
        "return power_heuristic(followed, asked) * radiance;", "Radiosity.AFurnace*"),
    "smoothing: a pixel gives by its own neighbours alone": (
        "render/film/smoothing.cpp", "/ std::max(sums[p], sums[q]);", "/ sums[p];", "Smoothing.*"),
    "smoothing: the median's rest is lost": (
        "render/film/smoothing.cpp", "values[i] += middle[i];", "values[i] = middle[i];", "Smoothing.*"),
    "roulette without its weight": (
        INTEGRATOR, "path.throughput /= survives;", "", "PathIntegrator.AFurnaceShows*"),
    "both sides of a lamp shine": (
        INTEGRATOR, "if (!light || !hit.is_front || !path.counts_lights) {", "if (!light || !path.counts_lights) {", "PathIntegrator.OnlyTheFront*"),
    "roulette by the number of the lobe": (
        INTEGRATOR, "dimension_of(bounce, roulette))", "dimension_of(bounce, lobe))", "PathIntegrator.*:SpecularPaths.*"),
    "the same numbers at every bounce": (
        INTEGRATOR, "kPerBounce * static_cast<std::uint32_t>(bounce) + which", "which",
        "IndirectLight.*:PathIntegrator.*:SpecularPaths.*"),
    "a pixel's corner for its centre": (
        INTEGRATOR, "x + 0.5 + at.offset.x()", "x + at.offset.x()", "PathIntegrator.*:TexturedSurface*"),
    "refraction without its scale": (
        "render/bsdf/specular.cpp", "drawn.radiance_scale = 1.0 / (ior * ior);", "drawn.radiance_scale = 1.0;",
        "SpecularPaths.*:*Bsdf*"),
    "density by area, not by angle": (
        LIGHT, "density_per_mm2 * distance * distance * distance / towards", "density_per_mm2",
        "Light.*"),
    "a lamp's cosine forgotten": (
        LIGHT, "density_per_mm2 * distance * distance * distance / towards",
        "density_per_mm2 * distance * distance", "Light.*"),
    "in vectors, too": (
        LANES, "density_per_mm2[i] * distance * distance * distance / towards",
        "density_per_mm2[i] * distance * distance", "LightLanes.*:*ClosedForm*/a_disk_near"),
    "a Lambertian vertex's cosine twice": (
        LANES, "power_heuristic(asked, followed) * cosine / asked",
        "power_heuristic(asked, followed) * cosine * cosine / asked", "*ClosedForm*/a_disk_near"),
    "its light has no MIS weight": (
        LANES, "power_heuristic(asked, followed) * cosine / asked", "cosine / asked",
        "*ClosedForm*/a_disk_near"),
    "triangles drawn by their number": (
        LIGHT, "sum += 0.5 * area.norm();", "sum += 1.0 + 0.0 * area.norm();", "Light.*:*ClosedForm*/a_quad*"),
    "points of a triangle uneven": (
        LIGHT, "const double root = std::sqrt(cut.within);", "const double root = cut.within;",
        "*ClosedForm*/a_quad*"),
    "a sphere's cone without its roundness": (
        LIGHT, "return s * s / (1.0 + std::sqrt(1.0 - s * s));", "return 0.5 * s * s;", "Light.*"),
    "a spot fades in a straight line": (
        LIGHT, "part = t * t * (3.0 - 2.0 * t);", "part = t;", "*ClosedForm*/a_spot*"),
    "distance not squared": (
        LIGHT, "part / (distance * distance) * light.intensity", "part / distance * light.intensity",
        "*ClosedForm*/a_point"),
    "texels drawn without their solid angle": (
        "render/light/environment_light.cpp", "(rows_.back() * environment_->solid_angle_density(position))",
        "(rows_.back() * 1e-3)", "Light.*"),
    "far lights twice as likely as said": (
        LIGHTS, "(is_far ? 1.0 :", "(is_far ? 0.5 :", "SceneLights.*"),
    "a tree that loses lights": (
        "render/light/light_bvh.cpp", "cos_light = cos_less(cos_less(cos_axis, bounds.cos_normals), cos_extent);",
        "cos_light = cos_axis;", "SceneLights.*"),
    "a lobe drawn more often than said": (
        "render/bsdf/blinn_phong.cpp", "if (lobe < glossy_fraction(*this)) {", "if (lobe < 0.5) {", "*Bsdf*"),
    "half vectors' Jacobian": (
        "render/bsdf/blinn_phong.cpp", "(4.0 * towards)", "4.0", "*Bsdf*"),
    "a filter without its weight": (
        "render/film/filter.cpp", ".weight = x.weight * y.weight};", ".weight = 1.0};", "*Filter*"),
    "the same sequence for both axes": (
        "render/sampling/sampler.cpp", "hash_upwards(times_pascal(keys.index), keys.second)",
        "hash_upwards(keys.index, keys.second)", "Sampler.*"),
    "a disk uneven": (
        "render/sampling/warp.h", "return r * at_turns(", "return r * r * at_turns(",
        "*ClosedForm*/a_disk*"),
    "glTF: y up stays y up": (
        f"{GLTF}.cpp", "0.0, 0.0, -kMillimetres, // 0.0, kMillimetres, 0.0;",
        "0.0, kMillimetres, 0.0, 0.0, 0.0, kMillimetres;", "Gltf.*"),
    "glTF: z the other way": (
        f"{GLTF}.cpp", "0.0, 0.0, -kMillimetres, //", "0.0, 0.0, kMillimetres, //", "Gltf.*"),
    "glTF: candela are watts": (
        f"{GLTF}_light.cpp", "(intensity / kLumensPerWatt)", "intensity", "GltfLight.*"),
    "glTF: a point's intensity in metres": (
        f"{GLTF}_light.cpp", "radiometric * (kMillimetres * kMillimetres)", "radiometric * kMillimetres", "GltfLight.*"),
    "glTF: a mirrored mesh inside out": (
        f"{GLTF}_mesh.cpp", "if (is_mirrored) {", "if (false) {", "Gltf.*"),
    "glTF: every triangle of a strip alike": (
        f"{GLTF}_mesh.cpp", "corners[i + 1 + i % 2], corners[i + 2 - i % 2]", "corners[i + 1], corners[i + 2]", "Gltf.*"),
    "glTF: pictures upside down": (
        f"{GLTF}_mesh.cpp", "1.0 - uv.y()", "uv.y()", "GltfMaterial.*"),
    "glTF: roughness not squared": (
        f"{GLTF}_material.cpp", "of.roughness * of.roughness", "of.roughness", "GltfMaterial.*"),
    "glTF: a node's scale before its turn": (
        f"{GLTF}.cpp", "local.rotate(turn.normalized()); local.scale(Vector3d(s[0], s[1], s[2]));",
        "local.scale(Vector3d(s[0], s[1], s[2])); local.rotate(turn.normalized());", "Gltf.*"),
    "glTF: an accessor's stride forgotten": (
        f"{GLTF}_document.cpp", "place->bytes.data() + i * place->stride", "place->bytes.data() + i * read.width * n_bytes",
        "Gltf.*"),
    "glTF: a view may reach beyond its buffer": (
        f"{GLTF}_document.cpp", "if (offset + length > bytes.size()) {", "if (false) {", "GltfBroken.*"),
    "bidirectional: a splat is not one of all samples": (
        "render/film/film.cpp", "seen.mean += sent[i] / n_all;", "seen.mean += sent[i] / n;", "Bidirectional.All*:Film.*"),
    "bidirectional: a splat's part of the error forgotten": (
        "render/film/film.cpp", "seen.squared_error += squared_error(n_all, sent[i], squares[i]);", "",
        "Bidirectional.States*:Film.*"),
    "bidirectional: an area density without its cosine": (
        BIDIRECTIONAL, "walk.connects *= mis(hit.distance_mm * hit.distance_mm / met.cosine); walk.earlier /= mis(met.cosine); add_emission",
        "walk.connects *= mis(hit.distance_mm * hit.distance_mm); walk.earlier /= mis(met.cosine); add_emission",
        "Bidirectional.All*"),
    "bidirectional: light that is met counts whole": (
        BIDIRECTIONAL, "const double w = weight(asked + traced);", "const double w = 1.0;", "Bidirectional.All*"),
    "bidirectional: what it tells of path tracing forgets unmet light": (
        BIDIRECTIONAL, "return {0.0, value.sum()};", "return {0.0, 0.0};", "Bidirectional.Tells*"),
    "bidirectional: what it tells forgets how a splat is seen": (
        BIDIRECTIONAL, "const double by_path_tracing = seen * (", "const double by_path_tracing = 1.0 * (", "Bidirectional.Tells*"),
    "a pilot that listens even to less": (
        PILOT, "if (is_told_better(patches_[i], told)) {", "if (true) {", "Pilot.*"),
    "a pilot that trusts its own samples alone": (
        PILOT, "if (is_told_better(patches_[i], told)) {", "if (false) {", "Pilot.*"),
    "a pilot that forgets splats": (
        PILOT, "patch.variance += squares;", "", "Pilot.*"),
    "a pilot that takes one that misses light": (
        PILOT, "return found - kSure * error > kUnmet ? found : 0.0;", "return 0.0;", "Pilot.*"),
    "bidirectional: flux is scaled as radiance is": (
        BIDIRECTIONAL, "(next.radiance_scale * met.cosine * shading_out)", "(met.cosine * shading_out)",
        "Bidirectional.GlassIs*"),
    "bidirectional: the camera's importance without its distance": (
        BIDIRECTIONAL, "here.eye_cosine * sight->pixels_per_sr / (sight->distance_mm * sight->distance_mm)",
        "here.eye_cosine * sight->pixels_per_sr / (600.0 * 600.0)", "Bidirectional.Light*"),
    "bidirectional: all light paths leave one light": (
        "render/light/emission.cpp", ".power = ray.flux() / probability(cut.index)}", ".power = ray.flux()}", "Emission.*"),
    "bidirectional: connections drawn count once": (
        BIDIRECTIONAL, "connection.value / batch.survival[k]", "connection.value", "Bidirectional.All*"),
    "photons: k for k - 1": (
        TREE, "weights.front() = 0.0;", "", "PhotonMaps.*"),
    "photons: the kernel of a line": (
        TREE, "? 2.0 * even *", "? 1.5 * even *", "PhotonTree.*:PhotonMaps.*"),
    "photons: light passes sheets": (
        TREE, "if (photon.normal.dot(at.normal) < kSameSide) {", "if (false) {", "PhotonMaps.*"),
    "photons: a lit sheet lights what is below": (
        TREE, "return height <= slope", "return true || height <= slope", "PhotonMaps.*"),
    "photons: any of the nearest sets the radius": (
        TREE, "std::ranges::push_heap(*heap_, is_nearer);", "", "PhotonTree.*"),
    "photons: the power of all in each": (
        SHOOTING, "shooting.power_of_lights() / options.photons", "shooting.power_of_lights()", "PhotonMaps.*"),
    "photons: refraction changes the flux": (
        SHOOTING, "adjoint / drawn.radiance_scale *", "adjoint *", "PhotonMaps.*"),
    "photons: roulette without its weight": (
        SHOOTING, "flight.flux = flux / survives;", "flight.flux = flux;", "PhotonMaps.*"),
    "photons: a caustic is indirect light": (
        SHOOTING, ": flight.is_specular ? PhotonKind::caustic", ": false ? PhotonKind::caustic", "PhotonMap*"),
    "photons: the light of caustics twice": (
        PHOTON_GATHER, "if (light && depth == 0 && there.hit.is_front) {", "if (light && there.hit.is_front) {",
        "PhotonMapping.*"),
    "photons: a lamp that a gather ray meets counts whole": (
        PHOTON_GATHER, "return power_heuristic(gather_rays_ * density, asked);", "return 1.0;", "PhotonMapping.*"),
    "photons: a lobe of another exponent": (
        EMITTED, "std::pow(1.0 - square.x(), 1.0 / (mu + 1.0))", "std::pow(1.0 - square.x(), 1.0 / (mu + 2.0))",
        "EmittedRay.*"),
    "photons: a far light's disk is too small": (
        EMITTED, "const Vector2d at = radius * concentric_disk(square);",
        "const Vector2d at = 0.9 * radius * concentric_disk(square);", "EmittedRay.*"),
    "soft shadow: an edge has one triangle": (
        f"{SOFT}soft_shadow.cpp", "jump += is_front ? edge.ways.at(f) : -edge.ways.at(f);",
        "jump = is_front ? edge.ways.at(f) : -edge.ways.at(f);", "SoftShadowExact.*"),
    "an edge beyond the point is not cut off": (
        f"{SOFT}soft_shadow.cpp", "} else if (end->z() > last) {", "} else if (false) {", "*SoftShadowOf.*:SoftShadowE*"),
    "an edge behind the light is not cut off": (
        f"{SOFT}soft_shadow.cpp", "if (end->z() < kNearestZ) { cut_at(*end, other, kNearestZ);",
        "if (false) { cut_at(*end, other, kNearestZ);", "*SoftShadowOf.*:SoftShadowE*"),
    "no ray tells whether the least covered part is seen": (
        f"{SOFT}soft_shadow.cpp", "if (work.blocked[i] != 0) {", "if (false) {", "SoftShadowExact.*"),
    "a grid kept for points beyond it": (
        f"{SOFT}soft_shadow.cpp", "return !(x.z() > kNearestZ) || grid->covers(x);", "return true;",
        "SoftShadowInTurn.*"),
    "a grid kept with curved surfaces in it": (
        f"{SOFT}soft_shadow.cpp", "if (has_curved) {", "if (false) {", "SoftShadowInTurn.*"),
    "the light hides itself": (
        f"{SOFT}ray_ends.cpp", "x.z() + 2.0 * off; if", "x.z(); if", "SoftShadowE*:SoftShadowCovers.*"),
    "the light hides itself from traced rays": (
        f"{SOFT}soft_shadow.cpp", "is_surface ? kOfWay * kRounding * length + light_offset_mm : 0.0;", "0.0;",
        "SoftShadowE*:SoftShadowCovers.NoLight*"),
    "what passes through the light has edges alone": (
        f"{SOFT}soft_shadow.cpp", "is_cut = is_cut || (n >= 2", "is_cut = is_cut || (false && n >= 2", "SoftShadowE*"),
    "single precision decides beside an edge": (
        f"{SOFT}soft_shadow.cpp", "if (!may_pass_edge(x, least, work)) {", "{", "SoftShadowExtremes.*"),
    "single precision decides at the light": (
        f"{SOFT}ray_ends.cpp", "half >= free_half_ && has_face_about_target(x, on_plane(target))", "false",
        "SoftShadowCovers.*"),
    "single precision decides at the point": (
        f"{SOFT}ray_ends.cpp", "return off < kWithin * least &&", "return false && off < kWithin * least &&",
        "SoftShadowCovers.*"),
    "a silhouette for no point is kept from all": (
        f"{SOFT}soft_shadow.cpp", "(!is_certain || jump != 0)", "(is_certain && jump != 0)", "SoftShadowExact.*"),
    "a sphere's box is half as large": (
        f"{SOFT}soft_shadow.cpp", "Vector3d::Constant(sphere.radius_mm / light.radius_mm));",
        "Vector3d::Constant(0.5 * sphere.radius_mm / light.radius_mm));", "SoftShadow*"),
    "traced points are not where the light is": (
        f"{SOFT}soft_shadow.cpp", "const double radius = std::sqrt(u);", "const double radius = u;", "TracedShadows.*"),
    "an edge's reach is half of it": (
        f"{SOFT}shadow_grid.cpp", ".radius = std::max(0.0, 1.0 / q.z() - farthest_inverse_z_)",
        ".radius = 0.5 * std::max(0.0, 1.0 / q.z() - farthest_inverse_z_)", "SoftShadowE*"),
    "a face hides the cells of its corners alone": (
        f"{SOFT}shadow_grid.cpp", "left = std::min({left, x0, x1}); right = std::max({right, x0, x1});",
        "left = x0; right = x0;", "SoftShadowE*"),
    "a chord's other side": (
        f"{SOFT}light_outline.cpp", "if (segment.jump > 0) {", "if (segment.jump < 0) {", "SoftShadowE*:LightOutline.*"),
    "layers begin anew in each slab": (
        f"{SOFT}light_outline.cpp", "lowest_layers += layers_below(scratch.before, x0, y)",
        "lowest_layers = layers_below(scratch.before, x0, y)", "LightOutline.*:SoftShadowE*"),
    "an arc is its chord": (
        f"{SOFT}light_outline.cpp", "return {.low_mean = -mean, .high_mean = mean, .low = -high, .high = high};",
        "return {.low_mean = -high, .high_mean = high, .low = -high, .high = high};", "LightOutline.*:SoftShadowE*"),
    "crossings of edges are no events": (
        f"{SOFT}light_outline.cpp", "if ((before < 0.0) != (after < 0.0)) {", "if (false) {", "LightOutline.*:SoftShadowE*"),
    "vertices at one place are two": (
        f"{SOFT}occluder_edges.cpp", "if (i == 0 || position(order[i]) != position(order[i - 1])) {", "if (true) {",
        "DBuffer.*"),
    "a square's disk has its diagonal": (
        f"{SOFT}flat_light.cpp", "std::sqrt(signed_area(corners) / std::numbers::pi);",
        "std::sqrt(0.5 * signed_area(corners));", "FlatLight.*"),
    "D-buffer: the farthest umbra plane of a piece": (
        f"{SOFT}d_buffer.cpp", "if (distance < least.distance) {", "if (least.edge == kNone || distance > least.distance) {",
        "DBuffer.*"),
    "D-buffer: cones on all sides": (
        f"{SOFT}d_buffer.cpp", "if (plane.dot(w - v) < -kOnSide * (w - v).norm()) {", "if (false) {", "DBuffer.*"),
    "D-buffer: no cones": (
        f"{SOFT}d_buffer.cpp", "if (!(k > reach) || reach == 0.0) {", "if (true) {", "DBuffer.*"),
    "D-buffer: t of a tilted edge as of a level one": (
        f"{SOFT}d_buffer.cpp", "if (options_.test == VolumeTest::by_piece && !winner.is_cone) {", "if (false) {",
        "DBuffer.*"),
    "silhouettes of the centre by its own side": (
        f"{SOFT}soft_shadow.cpp", "is_by_centre ? plane[3] < 0.0", "is_by_centre ? plane[3] >= 0.0", "PointSilhouette.*"),
    "volume: a product without its rounding error": (
        f"{VOLUME}side_of_ray.cpp", "for (const double factor : {low, high}) {", "for (const double factor : {0.0 * low, high}) {",
        "SideOfRay.*"),
    "volume: through an edge is left of it": (
        f"{VOLUME}side_of_ray.cpp", "if (const int side = sign_of_sum({{from.y, to.w, 1.0}, {-from.w, to.y, 1.0}})) {",
        "if (const int side = 1) {", "SideOfRay.*"),
    "volume: an eye on an edge's line is not moved": (
        f"{VOLUME}side_of_ray.cpp", "return side_of_moved_eye(p, from, to);", "return 1;", "SideOfRay.*"),
    "volume: faces seen edge-on by their areas": (
        f"{VOLUME}passed_face.cpp", "constexpr double kWide = 0.02;", "constexpr double kWide = 0.0;", "VolumeViews.*"),
    "volume: a cell is affine that is not": (
        f"{VOLUME}cell_map.cpp", "is_affine_ = has_parallel_sides();", "is_affine_ = true;", "VolumeCells.*"),
    "volume: one step of Newton's method": (
        f"{VOLUME}cell_map.cpp", "constexpr int kMostSteps = 40;", "constexpr int kMostSteps = 1;", "CellMap.*"),
    "volume: a pyramid's tip is where the next search begins": (
        f"{VOLUME}cell_map.cpp", "rst_.z() > kNearTip", "false", "VolumeCells.*"),
    "volume: a contour's normal by a cell's coordinates": (
        f"{VOLUME}cell_map.cpp", "return jacobian().transpose().inverse() * slope;", "return slope;", "Contours.*"),
    "volume: a curve's turn is not looked for": (
        f"{VOLUME}curve.cpp", "if (std::abs(x) < 1.0) {", "if (false) {", "VolumeCells.*:Contours.*:VolumeRayCaster.*"),
    "volume: nor that of a higher degree": (
        f"{VOLUME}curve.cpp", "if ((slope(from) < 0.0) != (slope(to) < 0.0)) {", "if (false) {", "Curve.*"),
    "volume: a quadratic field is linear": (
        f"{VOLUME}curve.cpp", "std::abs(curve.c_[2]) > kNoise * largest ?", "false ?", "VolumeCells.*"),
    "volume: a crossing is halfway": (
        f"{VOLUME}curve.cpp", "double s = 0.5 * (from + to); constexpr int kMostSteps = 100;",
        "double s = 0.5 * (from + to); constexpr int kMostSteps = 0;", "VolumeCells.*:Contours.*"),
    "volume: half of a face of four corners": (
        f"{VOLUME}cell_faces.cpp", "add(loop[0], loop[2], loop[3]);", "", "VolumeCells.*"),
    "volume: faces of four corners parted by their cell": (
        f"{VOLUME}cell_faces.cpp", "std::rotate(loop.begin(), smallest, loop.end());", "(void)smallest;", "VolumeCells.*"),
    "volume: a face seen from behind": (
        f"{VOLUME}cell_faces.cpp", "{{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}}", "{{1, 2, 3}, {0, 2, 3}, {0, 1, 3}, {0, 2, 1}}",
        "VolumeRayCaster.*"),
    "volume: bent edges are taken for straight": (
        f"{VOLUME}cell_faces.cpp", "bend_of(mesh, i); bend > 0.0", "bend_of(mesh, i); bend > 1e9", "BentCells.*"),
    "volume: a face is one by its corners alone": (
        f"{VOLUME}cell_faces.cpp", "if (!face.is_bent() && !other.is_bent()) {", "if (true) {", "BentCells.*"),
    "volume: each cell has a bent face its own way": (
        f"{VOLUME}cell_faces.cpp", "given.at((first + 1) % n) > given.at((first + n - 1) % n);", "first > 99;",
        "BentCells.*:BentFaces.*"),
    "volume: a ray in doubt stays where it is": (
        f"{VOLUME}volume_ray_caster.cpp", "n_moves == 0 ? 0.0 :", "n_moves >= 0 ? 0.0 :", "BentCells.*"),
    "volume: a ray passes a bent face once": (
        f"{VOLUME}bent_face.cpp", "if (std::ranges::none_of(roots_, is_same)) {",
        "if (roots_.clear(); !is_same(Root{.at = Form::At::Constant(9.0)})) {", "BentCells.*"),
    "volume: a serendipity face is flat in its middle": (
        f"{VOLUME}bent_face.cpp", "middles - 0.75 * corners", "0.25 * corners", "CurvedFaces.*"),
    "volume: a cubic edge's nodes are swapped": (
        f"{VOLUME}bent_face.cpp", "3.0 * x.at(k) - 1.5 * x.at(k + 1)", "3.0 * x.at(k + 1) - 1.5 * x.at(k)", "CurvedFaces.*"),
    "volume: a bent face of four corners is known by its cell's first three": (
        f"{VOLUME}cell_faces.cpp", "const bool is_second = nodes[loop[1]] < nodes[loop[3]];", "const bool is_second = true;",
        "CurvedCells.*"),
    "volume: a pixel's corner for its centre": (
        f"{VOLUME}volume_view.cpp", "(x + 0.5 - camera.cx, y + 0.5 - camera.cy)", "(x - camera.cx, y - camera.cy)",
        "VolumeRayCaster.*"),
    "volume: a face about the eye's plane in a few tiles": (
        f"{VOLUME}volume_view.cpp", "if (n_in_front != all.size() && n_behind != all.size()) {", "if (false) {", "VolumeRayCaster.*:VolumeViews.*"),
    "volume: nothing is far": (
        f"{VOLUME}volume_view.cpp", "if (scene.optics.far_mm > 0.0) {", "if (false) {", "VolumeRayCaster.*"),
    "volume: glass seen edge-on is not thicker": (
        f"{VOLUME}contours.cpp", "-std::expm1(std::log1p(-contour.opacity) / c)", "contour.opacity", "Contours.*"),
    "volume: a highlight about the normal": (
        f"{VOLUME}contours.cpp", "std::max(0.0, 2.0 * c * c - 1.0)", "c", "Contours.*"),
    "volume: a contour in a face counts twice": (
        f"{VOLUME}contours.cpp", "before * after < 0", "before * after <= 0 && after != 0", "Contours.*"),
    "volume: rays leave a cell where they enter it": (
        f"{VOLUME}visibility_order.cpp", "is_exit_[i] = sign > 0 ? 1 : 0;", "is_exit_[i] = sign > 0 ? 0 : 1;", "CellProjection.*"),
    "volume: cells across a gap have no order": (
        f"{VOLUME}boundary_relations.cpp", "if (test.is_nearer(exit, entry)) {", "if (false) {", "VisibilityOrder.*"),
    "volume: cells that touch have no order": (
        f"{VOLUME}boundary_relations.cpp", "return width > kWide || (width > kLine && exact_ >= 0);", "return false;",
        "VisibilityOrder.*:VolumeViews.*"),
    "volume: the witness is blind": (
        f"{VOLUME}cell_projection.cpp", "std::min(passed.surely, surely_end) - surely_begin > kOverlap * view_.size;", "false;",
        "CellProjection.*"),
    "volume: a cell is transparent if its ends are": (
        f"{VOLUME}cell_projection.cpp", "if (density.values()[static_cast<std::size_t>(i)] > 0.0) {", "if (false) {", "CellProjection.*"),
    "volume: a surface behind hides nothing of the cells": (
        f"{VOLUME}cell_projection.cpp", "std::min(within[1], far_));", "within[1]);", "VolumeBehind.*"),
    "volume: nor of the rays": (
        f"{VOLUME}volume_ray_caster.cpp", "light_.limit(left_at, far);",
        "light_.limit(left_at, std::numeric_limits<double>::infinity()); (void)far;", "VolumeBehind.*"),
    "volume: half is hidden halfway": (
        f"{VOLUME}cell_light.cpp", "zero_of(too_deep, {u, before - kHalfDepth}, {v, hidden_->optical_depth - kHalfDepth}, u + x * (v - u));",
        "((void)too_deep, (void)x, 0.5 * (u + v));", "VolumeBehind.*"),
    "volume: a background upside down": (
        f"{VOLUME}backdrop.cpp", "const double of_bottom = (y + 0.5) / height;", "const double of_bottom = 1.0 - (y + 0.5) / height;",
        "VolumeBehind.*"),
    "volume: half of Gauss' error": (
        f"{VOLUME}segment_rule.cpp", "double log_gamma = (2.0 * n + 1.0) * std::numbers::ln2", "double log_gamma = 2.0 * n * std::numbers::ln2",
        "SegmentRule.*"),
}
# A header's fault is in every source that includes it and matters here.
INCLUDED_BY = {"render/sampling/warp.h": [LIGHT, "render/camera/camera.cpp"], OFFSETS: [RAYS, TRIANGLES, LANES]}


def compiled(build, source, folder):
    """The object of the mutated source, its command line taken from the build."""
    database = json.loads((build / "compile_commands.json").read_text())
    entry = next(e for e in database if e["file"].endswith("/" + source))
    command = shlex.split(entry["command"])
    result = folder / (source.replace("/", "_") + ".o")
    command[command.index("-o") + 1] = str(result)
    at = next(i for i, word in enumerate(command) if word.endswith(source))
    command[at] = str(folder / source)
    first = next(i for i, word in enumerate(command) if re.search(r"/(c\+\+|g\+\+|clang\+\+)[-0-9]*$", word))
    command = command[first:]  # without the compiler cache
    command += ["-w"]  # a name may be unused
    command[1:1] = ["-I", str(folder)]  # a mutated header is found first
    subprocess.run(command, cwd=entry["directory"], check=True, capture_output=True)
    return result


def linked(build, program, objects, folder):
    lines = subprocess.run(["ninja", "-C", build, "-t", "commands", f"tests/render/{program}"],
                           capture_output=True, text=True, check=True).stdout.splitlines()
    command = shlex.split(lines[-1].removeprefix(": && ").removesuffix(" && :"))
    at = command.index("-o")
    result = folder / program
    command[at + 1] = str(result)
    command[at:at] = [str(path) for path in objects]
    subprocess.run(command, cwd=build, check=True, capture_output=True)
    return result


def programs_of(source):
    """Whose tests look for a fault of it."""
    return next(((program,) for start, program in TESTED_BY.items() if source.startswith(start)), PATHS)


def first_failure(program, tests):
    """The first of the tests that fails, or None. One that hangs fails."""
    try:
        run = subprocess.run([program, f"--gtest_filter={tests}", "--gtest_fail_fast", "--gtest_brief=1"],
                             capture_output=True, text=True, timeout=600)
    except subprocess.TimeoutExpired:
        return "hangs"
    if run.returncode == 0:
        return None
    failed = re.search(r"\[  FAILED  \] (\S+)", run.stdout)
    if not failed:
        sys.exit(f"{program}: ends with {run.returncode} without a test that failed: {run.stdout[-500:]}{run.stderr[-500:]}")
    return failed.group(1).rstrip(",").removeprefix("Lights/")


def main():
    build = pathlib.Path(sys.argv[1]).resolve()
    root = pathlib.Path(__file__).resolve().parents[2]
    names = sys.argv[2:] or list(FAULTS)
    programs = {program for name in names for program in programs_of(FAULTS[name][0])}
    subprocess.run(["ninja", "-C", build, *sorted(programs)], check=True, stdout=subprocess.DEVNULL)
    missed = 0
    print("| fault | caught by | s |\n|---|---|---|")
    for name in names:
        source, words, instead, tests = FAULTS[name]
        start = time.monotonic()
        with tempfile.TemporaryDirectory() as scratch:
            folder = pathlib.Path(scratch)
            text = (root / source).read_text()
            # Lines are broken where they are too long.
            pattern = r"\s+".join(re.escape(word) for word in words.split())
            if len(re.findall(pattern, text)) != 1:
                sys.exit(f"{source}: '{words}' is not there once: mend the fault '{name}'")
            mutated = re.sub(pattern, lambda _: instead, text)
            sources = INCLUDED_BY.get(source, [source])
            for path in {source, *sources}:
                (folder / path).parent.mkdir(parents=True, exist_ok=True)
                (folder / path).write_text(mutated if path == source else (root / path).read_text())
            objects = [compiled(build, path, folder) for path in sources]
            failure = None
            for program in programs_of(source):
                failure = first_failure(linked(build, program, objects, folder), tests)
                if failure:
                    break
        print(f"| {name} | {f'`{failure}`' if failure else '**not caught**'} | {time.monotonic() - start:.0f} |",
              flush=True)
        missed += failure is None
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
