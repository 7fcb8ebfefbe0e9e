// SPDX-License-Identifier: Apache-2.0
#include "apps/viewer/publish_basis.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <numbers>
#include <numeric>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "apps/viewer/viewer_site.h"
#include "core/count.h"
#include "core/text_limits.h"
#include "haarlight/core/error.h"
#include "haarlight/relight/light/light_weights.h"
#include "haarlight/render/light/cubemap.h"
#include "relight/pipeline/captured_lights.h"
#include "relight/view/gpu_pages.h"

namespace haarlight::apps {

namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

bool is_lossless(const relight::BasisFile& basis) {
  return basis.header().coding != relight::BasisCoding::quantised;
}

/// What each picture (of a coefficient, or of a light) adds to the squared norm of the light
/// transport matrix: Haar keeps norms.
std::vector<double> energies(const relight::BasisFile& basis) {
  const relight::BasisTables& tables = basis.tables();
  const std::vector<float>& norms =
      is_lossless(basis) ? tables.light_norms : tables.coefficient_norms;
  std::vector<double> sums(count(basis.header().dims.n_lights), 0.0);
  for (std::size_t i = 0; i < norms.size(); ++i) {
    sums[i % sums.size()] += double(norms[i]) * double(norms[i]);
  }
  return sums;
}

/// Which pictures are kept, and what that costs.
struct Choice {
  std::vector<char> is_kept;  ///< by picture
  PublishedBasis told;
};

Choice choose_pictures(const relight::BasisFile& basis, const PublishBasisOptions& options) {
  const std::vector<double> energy = energies(basis);
  std::vector<std::size_t> ranked(energy.size());
  std::iota(ranked.begin(), ranked.end(), std::size_t{0});
  std::stable_sort(ranked.begin(), ranked.end(),
                   [&](std::size_t a, std::size_t b) { return energy[a] > energy[b]; });
  Choice choice;
  choice.told.terms_all = static_cast<int>(energy.size());
  choice.told.own_error = basis.header().achieved.relative_l2;
  const double norm = basis.header().stack_norm;
  // left[n]: relative norm of what is left out when n are kept; summed from the smallest up.
  std::vector<double> left(energy.size() + 1, 0.0);
  double sum = 0.0;
  for (std::size_t n = energy.size(); n-- > 0;) {
    sum += energy[ranked[n]];
    left[n] = norm > 0.0 ? std::sqrt(sum) / norm : 0.0;
  }
  std::size_t kept = energy.size();
  if (options.max_error) {
    while (kept > 0 && choice.told.own_error + left[kept - 1] <= *options.max_error) {
      --kept;
    }
  }
  if (options.terms) {
    kept = std::min(kept, count(*options.terms));
  }
  choice.told.terms = static_cast<int>(kept);
  choice.told.error = choice.told.own_error + left[kept];
  choice.is_kept.assign(energy.size(), 0);
  for (std::size_t n = 0; n < kept; ++n) {
    choice.is_kept[ranked[n]] = 1;
  }
  return choice;
}

std::uint32_t u32_at(const std::string& bytes, std::size_t at) {
  std::uint32_t value = 0;
  for (unsigned i = 0; i < 4; ++i) {
    value |= std::uint32_t{static_cast<unsigned char>(bytes[at + i])} << (8U * i);
  }
  return value;
}

/// The pages of kept pictures alone (docs/reference/http-api.md, "Pages").
std::string kept_pages(const std::string& pages, const std::vector<char>& is_kept) {
  constexpr std::size_t kHead = 16;
  constexpr std::size_t kRecord = 8;
  const std::size_t n = u32_at(pages, 4);
  const std::size_t page_bytes = u32_at(pages, 8);
  std::string records;
  std::string bodies;
  for (std::size_t p = 0; p < n; ++p) {
    const std::size_t at = kHead + kRecord * p;
    if (is_kept[u32_at(pages, at)] != 0) {
      records.append(pages, at, kRecord);
      bodies.append(pages, kHead + kRecord * n + page_bytes * p, page_bytes);
    }
  }
  std::string head = pages.substr(0, kHead);
  const auto n_kept = static_cast<std::uint32_t>(records.size() / kRecord);
  for (unsigned i = 0; i < 4; ++i) {
    head[4 + i] = static_cast<char>((n_kept >> (8U * i)) & 0xffU);
  }
  return head + records + bodies;
}

/// Writes what the page will ask for, in runs of tiles as it cuts them (web/viewer/basis.js).
class PageWriter {
 public:
  PageWriter(const relight::BasisFile& basis, PublishFolder& folder, const Choice& choice,
             Progress& progress)
      : basis_(basis), folder_(folder), choice_(choice), progress_(progress) {}

  void write() {
    const relight::BasisHeader& header = basis_.header();
    const int side = relight::page_side(header);
    const int values = side * side;
    folder_.add_data("tables", basis_table_bytes(basis_));
    for (int c = 0; c < header.dims.channels; ++c) {
      if (header.plate_rank > 0) {
        each_run(1, 2 * values, [&](relight::TileRun tiles, const std::string& run) {
          folder_.add_data(fmt::format("gains/{}/{}", c, run),
                           relight::gain_pages(basis_, c, tiles));
        });
        each_run(1, 4 * header.n_plate(), [&](relight::TileRun tiles, const std::string& run) {
          folder_.add_data(fmt::format("polynomials/{}/{}", c, run),
                           relight::plate_polynomials(basis_, c, tiles));
        });
      }
      if (!is_lossless(basis_)) {
        each_run(1, values, [&](relight::TileRun tiles, const std::string& run) {
          folder_.add_data(fmt::format("shifts/{}/{}", c, run),
                           relight::shift_pages(basis_, c, tiles));
        });
      }
    }
    const int page_bytes = values * (is_lossless(basis_) ? 2 : 1);
    for (int g = 0; g < basis_.n_groups(); ++g) {
      const int n_pictures = basis_.group_end(g) - basis_.group_begin(g);
      for (int c = 0; c < header.dims.channels && has_kept(g); ++c) {
        each_run(n_pictures, page_bytes, [&](relight::TileRun tiles, const std::string& run) {
          folder_.add_data(
              fmt::format("pages/{}/{}/{}", c, g, run),
              kept_pages(relight::coefficient_pages(basis_, c, g, tiles), choice_.is_kept));
        });
      }
      progress_.advance();
    }
  }

  [[nodiscard]] bool has_kept(int group) const {
    for (int k = basis_.group_begin(group); k < basis_.group_end(group); ++k) {
      if (choice_.is_kept[count(basis_.order()[count(k)])] != 0) {
        return true;
      }
    }
    return false;
  }

 private:
  template <class Write>
  void each_run(int n_pictures, int page_bytes, const Write& write) {
    constexpr int kRequestBytes = 2 << 20;
    const std::int64_t bytes = std::int64_t{n_pictures} * page_bytes;
    const int step = static_cast<int>(
        std::max<std::int64_t>(1, kRequestBytes / std::max<std::int64_t>(1, bytes)));
    for (int first = 0; first < basis_.n_tiles(); first += step) {
      const int last = std::min(first + step, basis_.n_tiles()) - 1;
      write(relight::TileRun{first, last}, fmt::format("{}-{}", first, last));
    }
  }

  const relight::BasisFile& basis_;
  PublishFolder& folder_;
  const Choice& choice_;
  Progress& progress_;
};

/// Weights of all turns: 32-bit floats, turn by turn, colour by colour, a light after another.
Json write_environment(const relight::BasisFile& basis, const std::string& file,
                       std::size_t number, PublishFolder& folder, Progress& progress) {
  const render::Environment environment = render::Environment::read(file);
  const relight::CapturedLights lights(basis);
  std::vector<float> all;
  Json missing = Json::array();
  Eigen::Index columns = 1;
  for (int turn = 0; turn < kPublishedTurns; ++turn) {
    const relight::EnvironmentWeights found =
        lights.weights(environment, 2.0 * std::numbers::pi * turn / kPublishedTurns);
    columns = found.weights.cols();
    for (Eigen::Index c = 0; c < columns; ++c) {
      for (Eigen::Index k = 0; k < found.weights.rows(); ++k) {
        all.push_back(static_cast<float>(found.weights(k, c)));
      }
    }
    missing.push_back(found.missing_fraction);
    progress.advance();
  }
  const std::string name = fmt::format("environments/{}", number);
  folder.add_data(name,
                  {reinterpret_cast<const char*>(all.data()), all.size() * sizeof(float)});
  return {{"file", name},
          {"name", fs::path(file).filename().string()},
          {"layout", std::string(to_string(environment.layout()))},
          {"colours", columns},
          {"turns", kPublishedTurns},
          {"missing_share", missing}};
}

}  // namespace

PublishedBasis publish_basis(const relight::BasisFile& basis, PublishFolder& folder,
                             const PublishBasisOptions& options, const PublishNotes& notes) {
  const Choice choice = choose_pictures(basis, options);
  Progress progress("publish",
                    count(basis.n_groups()) + options.environments.size() * kPublishedTurns,
                    options.progress);
  PageWriter writer(basis, folder, choice, progress);
  writer.write();
  Json about = parse_json<Json>(basis_description(basis, ViewerConfig{}), basis.name());
  Json groups = Json::array();
  for (int g = 0; g < basis.n_groups(); ++g) {
    if (writer.has_kept(g)) {
      groups.push_back(g);
    }
  }
  Json left_out = Json::array();
  for (std::size_t k = 0; k < choice.is_kept.size(); ++k) {
    if (choice.is_kept[k] == 0) {
      left_out.push_back(k);
    }
  }
  about["published"] = {{"groups", groups},
                        {"left_out", left_out},
                        {"own_error", choice.told.own_error},
                        {"error", choice.told.error}};
  Json environments = Json::array();
  for (std::size_t i = 0; i < options.environments.size(); ++i) {
    environments.push_back(
        write_environment(basis, options.environments[i], i, folder, progress));
  }
  about["environments"] = environments;
  folder.commit("index.html", about.dump(), notes);
  return choice.told;
}

}  // namespace haarlight::apps
